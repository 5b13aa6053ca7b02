"""Loops around formulas: over rows, over steps, over a log's samples, over what stays in place."""

import numpy as np
import pytest
from numba import njit
from oracle import EPS
from test_scalar import MACHINE, SINGLE, TABLE, looked_up

from fastatt.codegen.rows import LogFunction, RowFunction
from fastatt.codegen.scalar import scalar_function
from fastatt.tracing import dual, functions, graph
from fastatt.tracing.formulas import axpy, quat, scale
from fastatt.tracing.traced import Recurrence


def normalised(t, x, p):
    return quat.normalise(x), t * p[0]


def test_rows():
    repeated = RowFunction(normalised, {"t": None, "x": 4, "p": 2}, (4, None))
    n = 700
    x = np.random.default_rng(0).normal(size=(n, 4))
    t, p = np.linspace(0.0, 1.0, n), (2.0, 5.0)
    q, s = repeated(t, x, p)
    assert (s == 2.0 * t).all()
    one = scalar_function(quat.normalise)
    assert q.tolist() == [list(one(tuple(row))) for row in x.tolist()]
    threads = repeated(t, x, p, n_threads=3)
    assert all((a == b).all() for a, b in zip(threads, (q, s), strict=True))
    back, _ = repeated(0.0, x[::-1], p)
    assert (back == q[::-1]).all()
    with pytest.raises(ValueError, match="function: gives 5 numbers; accepted: 4"):
        RowFunction(normalised, {"t": None, "x": 4, "p": 2}, (4,))(t, x, p)
    with pytest.raises(ValueError, match=r"x: has shape \(700,\); accepted: \(..., 4\)"):
        repeated(t, t, p)


def derived(x, p):
    y = quat.exp(dual.seed(x, 3))
    return dual.value(y), tuple(s for c in y for s in dual.derivatives(c, 3)), p[0]


def test_rows_of_derivatives():
    x = np.random.default_rng(1).normal(size=(2, 5, 3))
    found = RowFunction(derived, {"x": 3, "p": 1}, (4, 12, None))(x, (2.0,))
    single = scalar_function(derived)
    true = [[single(tuple(row), (2.0,)) for row in rows] for rows in x.tolist()]
    for a, b in zip(found, range(3), strict=True):
        assert a.tolist() == np.array([[row[b] for row in rows] for rows in true]).tolist()


# steps in a loop

TABLE_OF_STEPS = [(0.5, 1.0), (0.25, -2.0), (1.0, 3.0)]


def spun(u, k, start):
    """A rotation in steps of u, whose derivatives come with the first; k and 2 stay."""
    return (start, 0.0), (k, 2.0)


def spin(x, e, row, u, k, start):
    (q, most), (kept, two) = x, e
    d = dual.seed(u, 3)
    q = quat.mul(q, quat.exp(scale(row[0] * kept * two, d)))
    return q, functions.larger(most, row[1] * row[1])


def stopped(x, e, u, k, start):
    q, most = x
    slopes = tuple(s for c in q for s in dual.derivatives(c, 3))
    return dual.value(q), slopes, most, e[1]


LOOPED = Recurrence(spun, spin, stopped, TABLE_OF_STEPS)
SPUN = (0.3, -0.2, 0.9), 0.75, (0.5, -0.5, 0.5, 0.5)


@pytest.mark.parametrize("kind", [float, SINGLE])
def test_a_recurrence_is_its_steps_written_out(kind):
    looped, straight = (
        scalar_function(LOOPED),
        scalar_function(lambda u, k, start: LOOPED(u, k, start)),
    )

    @njit
    def user(u, k, start):
        return looped(u, k, start)

    given = tuple(map(kind, SPUN[0])), kind(SPUN[1]), tuple(map(kind, SPUN[2]))
    found, true = looped(*given), straight(*given)
    bound = 4 * np.finfo(kind).eps
    for a in (found, user(*given)):
        assert np.abs(np.subtract(graph.flattened(a), graph.flattened(true))).max() <= bound
        assert a[2:] == (9.0, 2.0)
    (traced,) = looped._traced.values()
    assert traced.loop is not None
    assert traced.lanes == 4
    # one exponential, however many steps
    (whole,) = straight._traced.values()
    assert 2 * sum(len(flat.nodes) for flat in traced.flats) < len(whole.flat.nodes)
    assert {type(x) for x in graph.flattened(found)} == {kind}


def test_a_recurrence_over_rows():
    u = np.random.default_rng(2).normal(size=(3, 3))
    arguments = LOOPED, {"u": 3, "k": None, "start": 4}, (4, 12, None, None)
    given = u, *SPUN[1:]
    rows = RowFunction(*arguments)(*given)
    single = scalar_function(LOOPED)
    for i in range(3):
        assert [x[i].tolist() for x in rows[2:]] == [9.0, 2.0]
        one = single(tuple(u[i].tolist()), *SPUN[1:])
        assert [list(x[i]) for x in rows[:2]] == [list(x) for x in one[:2]]


def test_a_recurrence_finds_tables_and_opaque_functions():
    """d(x² y T[row])/dx twice, y and the look-up in every part."""

    def begin(x, y):
        (a,) = dual.seed((x,), 2)
        return (a * looked_up(y),), (functions.opaque(MACHINE, 2, (a, y), x)[1],)

    def step(s, e, row, x, y):
        table = functions.gather(0, graph.apply("floor", x * 0.0 + row[0]), "double")
        return (functions.opaque(MACHINE, 2, (s[0], e[0]), x)[0] * table,)

    def end(s, e, x, y):
        return dual.value(s[0]), dual.derivatives(s[0], 2), looked_up(y)

    made = scalar_function(Recurrence(begin, step, end, [(0.0,), (2.0,)]), {0: TABLE})

    @njit
    def user(x, y):
        return made(x, y)

    # s = 5 y x, then 3 y s², then 7 y s²
    x, y = 0.5, 1.5
    value = 7.0 * y * (3.0 * y * (5.0 * y * x) ** 2) ** 2
    for found in (user(x, y), made(x, y)):
        assert found[0] == pytest.approx(value, rel=4 * EPS)
        assert found[1] == pytest.approx((4.0 * value / x, 0.0), rel=1e-9)
        assert found[2] == 5.0 * y


# what goes from sample to sample


def turned(x, w, h, bias):
    q, t = x[:4], x[4]
    u = tuple(h[0] * (a - b) for a, b in zip(w, bias, strict=True))
    return quat.mul(q, quat.exp(u)), t + h[0]


FOLD = LogFunction(turned, 5, {"w": 3, "h": 1}, {"bias": 3})


def folded(n_logs, n_threads=1):
    generator = np.random.default_rng(3)
    w, bias = generator.normal(size=(19, 11, 3)), generator.normal(size=(19, 3))
    start = np.tile((1.0, 0.0, 0.0, 0.0, 0.0), (n_logs, 1))
    spans = np.linspace(0.1, 0.2, 11)[None, :, None]
    return FOLD(start, (w[:n_logs], spans), (bias[:n_logs],), n_threads), w, bias, spans


def test_a_fold_is_the_steps_of_each_log():
    found, w, bias, spans = folded(19)
    one = scalar_function(turned)
    for end, rates, b in zip(found, w, bias, strict=True):
        x = (1.0, 0.0, 0.0, 0.0, 0.0)
        for rate, h in zip(rates, spans[0], strict=True):
            q, t = one(x, tuple(rate.tolist()), tuple(h.tolist()), tuple(b.tolist()))
            x = (*q, t)
        assert end.tolist() == list(x)
    # however many there are, and however they are shared out
    for n, threads in ((1, 1), (3, 2), (19, 2)):
        assert (folded(n, threads)[0] == found[:n]).all()


def test_a_fold_refuses_a_step_to_another_state():
    with pytest.raises(ValueError, match="function: gives 1 numbers; accepted: 2"):
        LogFunction(lambda x, w: x[0] * w[0], 2, {"w": 1}, {})(
            np.ones((1, 2)), (np.ones((1, 3, 1)),), ()
        )


# arrays that stay where they are


@pytest.mark.parametrize("n", [1, 5, 40])
def test_in_place(n):
    def moved(x, y, k):
        return axpy(k[0], y, x), x[0]

    x, y, k, first = (
        np.arange(2.0 * n).reshape(n, 2),
        np.ones((n, 2)),
        np.array([[3.0]]),
        np.ones(n),
    )
    call = RowFunction(moved, {"x": 2, "y": 2, "k": 1}, (2, None)).bound((x, y, k), (x, first))
    start = x.copy()
    for i in range(1, 4):
        call()
        assert (first == start[:, 0] + 3.0 * (i - 1)).all()
        assert (x == start + 3.0 * i).all()
    k[:] = -9.0
    call()
    assert (x == start).all()
    with pytest.raises(ValueError, match="arrays: found float32; accepted: float64, C-contiguous"):
        RowFunction(moved, {"x": 2, "y": 2, "k": 1}, (2, None)).bound(
            (x, y, k.astype(SINGLE)), (x,)
        )
