"""Functions over rows of arrays: against numpy, whatever the number of rows, threads and axes."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from each import each

from fastatt.codegen import rows as module
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import RowFunction, rows
from fastatt.tracing import formulas, graph

RNG = np.random.default_rng(5)
LANES = {kind: processor().lanes(kind) for kind in ("double", "single")}
BLOCK = 4  # vectors
TYPES = {"double": np.float64, "single": np.float32}
EPS = {"double": 2.0**-53, "single": 2.0**-24}


def blend(q, v, t):
    """Something of every input, and a number that depends on none."""
    turned = formulas.quat.rotate(q, v)
    return (turned[0] + t, turned[1] * t, turned[2] / t), graph.choose(t > 0.5, q[0], -q[3]), 2.5


def blend_in_numpy(q, v, t):
    q, v, t = (np.asarray(x, dtype=np.float64) for x in (q, v, t))
    x = np.cross(q[..., 1:], v)
    turned = v + 2.0 * (q[..., :1] * x + np.cross(q[..., 1:], x))
    first = np.stack([turned[..., 0] + t, turned[..., 1] * t, turned[..., 2] / t], axis=-1)
    second = np.where(t > 0.5, q[..., 0], -q[..., 3])
    return first, np.broadcast_to(second, first.shape[:-1]), np.full(first.shape[:-1], 2.5)


SHAPE = {"q": 4, "v": 3, "t": None}
OUTPUTS = (3, None, None)


def given(q=(), v=(), t=(), dtype=np.float64):
    """Arrays with these leading axes."""
    q = RNG.normal(size=(*q, 4))
    return (
        (q / np.linalg.norm(q, axis=-1, keepdims=True)).astype(dtype),
        RNG.normal(size=(*v, 3)).astype(dtype),
        RNG.uniform(0.2, 0.9, size=t).astype(dtype),
    )


def assert_as_numpy(kind, arrays, **options):
    found = rows(blend, SHAPE, OUTPUTS, kind)(*arrays, **options)
    known = blend_in_numpy(*arrays)
    for x, y in zip(found, known, strict=True):
        assert x.shape == y.shape
        assert x.dtype == TYPES[kind]
        assert np.allclose(x, y, rtol=0.0, atol=128 * EPS[kind])
    return found


def sizes(kind):
    n = LANES[kind]
    return sorted({0, 1, n - 1, n, n + 1, BLOCK * n - 1, BLOCK * n, BLOCK * n + 1, 1000})


CASES = [(kind, n) for kind in TYPES for n in sizes(kind)]


@each(("kind", "n"), CASES)
def test_any_number_of_rows(kind, n):
    """Each row alone gives the same bits."""
    arrays = given((n,), (n,), (n,), TYPES[kind])
    found = assert_as_numpy(kind, arrays)
    for b in {0, n // 2, n - 1} if n else ():
        alone = rows(blend, SHAPE, OUTPUTS, kind)(*(x[b] for x in arrays))
        assert all(map(np.array_equal, alone, (x[b] for x in found)))


@each(
    "leads",
    [
        ((), (), ()),
        ((), (37,), (37,)),
        ((37,), (), ()),
        ((1,), (37,), (1,)),
        ((5, 37), (37,), (5, 1)),
        ((37,), (5, 1), ()),
        ((3, 1, 7), (2, 1), (3, 2, 7)),
        ((2, 3, 2, 5), (3, 1, 5), (1, 5)),
        ((0,), (), ()),
        ((4, 0), (4, 1), ()),
        ((3, 4, 0), (4, 1), ()),
    ],
)
@each("kind", TYPES)
def test_leading_axes_broadcast(kind, leads):
    assert_as_numpy(kind, given(*leads, TYPES[kind]))


@pytest.mark.parametrize("kind", TYPES)
def test_powers_of_two_and_exponents_are_exact(kind):
    """Of all normal numbers."""
    made = RowFunction(
        lambda n, x: (graph.apply("power_of_two", n), graph.apply("exponent", x)),
        {"n": None, "x": None}, (None, None), kind, native=True,
    )  # fmt: skip
    limits = np.finfo(TYPES[kind])
    n = np.arange(limits.minexp, limits.maxexp)
    for x in (1.0, 1.3, 2.0 - limits.eps):
        powers, exponents = made(n, np.ldexp(TYPES[kind](x), n))
        assert np.array_equal(powers, np.ldexp(TYPES[kind](1.0), n))
        assert np.array_equal(exponents, n)


@pytest.mark.parametrize("kind", TYPES)
def test_threads_change_nothing(kind):
    arrays = given((40, 1), (5001,), (40, 5001), TYPES[kind])
    made = rows(blend, SHAPE, OUTPUTS, kind)
    one, three = made(*arrays), made(*arrays, n_threads=3)
    assert all(map(np.array_equal, one, three))
    assert_as_numpy(kind, [x[..., -20:, :] if x.ndim > 1 and x.shape[-1] < 5 else x[..., -20:]
                           for x in arrays])  # fmt: skip


# what a function finds in memory


class Opaque:
    """What ``graph.opaque`` calls, written here in Python."""

    name = "swap"

    def __init__(self):
        double = ctypes.POINTER(ctypes.c_double)
        self._kept = ctypes.CFUNCTYPE(None, double, double)(self._call)
        self.address = ctypes.cast(self._kept, ctypes.c_void_p).value

    @staticmethod
    def _call(given, made):
        made[0], made[1] = given[1], given[0] * 10.0

    def __call__(self, a, b):
        return b, 10.0 * a


def product(a, t, constants):
    return (constants[0] * t + a[1], constants[1])


PREPARED = RowFunction(
    product, {"a": 2, "t": None}, (2,), constants=lambda a: (a[0] * a[0], a[0] - a[1])
)


@pytest.mark.parametrize("n_threads", [1, 3])
@pytest.mark.parametrize("bodies", [1, 3, 50, 700])
@pytest.mark.parametrize("times", [1, 2, 50, 700])
def test_constants_follow_their_inputs(bodies, times, n_threads):
    """Of each body at all times, whichever of them lie in lanes; whole numbers are exact."""
    a = RNG.integers(-9, 9, (bodies, 2)).astype(float)
    t = RNG.integers(-9, 9, (times, 1)).astype(float)
    (found,) = PREPARED(a, t, n_threads=n_threads)
    known = np.stack(
        [a[:, 0] ** 2 * t + a[:, 1], np.broadcast_to(a[:, 0] - a[:, 1], (times, bodies))], -1
    )
    np.testing.assert_array_equal(found, known)


def test_opaque_functions_and_tables():
    swap = Opaque()

    def looked_up(x):
        a, b = graph.opaque(swap, 2, (x[0], x[1]), x[0])
        return a, b, *graph.row(3, x[2], 1), *graph.row(5, x[2], 1)

    made = RowFunction(looked_up, {"x": 3}, (2, 2))
    tables = {5: np.arange(10)[::-1], 3: np.arange(10.0) ** 2}
    x = np.column_stack([RNG.normal(size=(21, 2)), np.arange(21) % 10])
    called, found = made(x, tables=tables)
    assert np.array_equal(called, np.column_stack([x[:, 1], 10.0 * x[:, 0]]))
    k = x[:, 2].astype(int)
    assert np.array_equal(found, np.column_stack([tables[3][k], tables[5][k]]))
    other = {**tables, 3: -tables[3]}
    assert np.array_equal(made(x, tables=other)[1][:, 0], -found[:, 0])


@pytest.mark.parametrize("kind", TYPES)
def test_successive_numbers_of_a_table(kind):
    counts = (1, 2, 3, 7, 12, 19)

    def looked_up(k):
        return [graph.row(0, graph.Double(k), n) for n in counts]

    made = RowFunction(looked_up, {"k": None}, counts, kind)
    k = RNG.integers(0, 80, 70)
    table = np.arange(100.0)
    for n, found in zip(counts, made(k, tables={0: table}), strict=True):
        assert np.array_equal(found, table[k[:, None] + np.arange(n)])


# what is kept


def test_made_once(monkeypatch):
    same = rows(blend, SHAPE, OUTPUTS)
    assert rows(blend, dict(SHAPE), list(OUTPUTS)) is same
    assert rows(blend, SHAPE, OUTPUTS, "single") is not same
    assert rows(blend, SHAPE, (3, 2)) is not same

    def doubled(factor):
        return rows(lambda x: x * factor, {"x": None}, (None,), key=("times", factor))

    assert doubled(2.0) is doubled(2.0)
    assert [doubled(x)(1.5)[0] for x in (2.0, 3.0)] == [3.0, 4.5]
    calls, compiled = [], module.lane_function
    monkeypatch.setattr(module, "lane_function", lambda *a: calls.append("c") or compiled(*a))
    made = RowFunction(lambda x: calls.append("t") or x * 0.5, {"x": None}, (None,))
    assert calls == []
    for n in (1, 5, 100):
        made(np.ones(n))
    assert sorted(calls) == ["c", "t"]
