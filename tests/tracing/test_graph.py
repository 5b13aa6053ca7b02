"""Every kernel traced: its text and its machine code against the kernel, in both precisions."""

import ctypes
import functools
import itertools
import math
import operator as op
import types
from fractions import Fraction

import numpy as np
import pytest
from each import each
from numba import types as numba_types
from numba.core.dispatcher import Dispatcher
from test_grammar import ARGUMENTS, KERNELS, cast, leaves

from fastatt.codegen.emitter import Emitter
from fastatt.codegen.modules import generated
from fastatt.codegen.processor import processor
from fastatt.tracing import source
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Double, Graph, choose, flattened, larger
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.trace import traceable

FLOATS = {"double": np.float64, "single": np.float32}
every_precision = pytest.mark.parametrize("kind", ["double", "single"])


# the kernels as they stand, in the precision of what they are given: math.sqrt gives a double
PLAIN_MATH = types.SimpleNamespace(sqrt=np.sqrt, pi=math.pi)


def plain(value):
    """A kernel, or what it refers to, without Numba."""
    if value is math:
        return PLAIN_MATH
    if isinstance(value, types.ModuleType) and value is not np:
        return types.SimpleNamespace(**{k: plain(v) for k, v in vars(value).items()})
    if not isinstance(value, Dispatcher):
        return value
    return lambda *args: function(value.py_func)(*args)


def function(f):
    found = {k: plain(f.__globals__[k]) for k in f.__code__.co_names if k in f.__globals__}
    return types.FunctionType(f.__code__, f.__globals__ | found)


def kernel_values(name, kind):
    arguments = cast(ARGUMENTS[name], FLOATS[kind])
    with np.errstate(all="ignore"):
        return leaves(plain(KERNELS[name])(*arguments))


def shaped(graph, kind, x, *name):
    if isinstance(x, tuple):
        return tuple(shaped(graph, kind, y, *name, i) for i, y in enumerate(x))
    return graph.input(kind, *name)


def recorded(name, kind):
    graph = Graph()
    result = traceable(KERNELS[name])(*shaped(graph, kind, ARGUMENTS[name], "x"))
    return Flat(graph, flattened(result), kind)


def given(flat, name, scale=1.0):
    """The arguments that a graph takes, in the order in which it does."""
    found = []
    for _, *at in flat.inputs():
        x = ARGUMENTS[name]
        for i in at:
            x = x[i]
        found.append(scale * x)
    return found


@pytest.mark.newest
@each(*every_precision.args)
@each("name", sorted(KERNELS))
def test_text_is_the_kernel_to_the_bit(name, kind):
    """Of numbers, and of arrays."""
    flat = recorded(name, kind)
    F = FLOATS[kind]
    assert {n.precision for n in flat.nodes} <= {kind, ""}
    run = source.function(flat)
    found, values = run(*map(F, given(flat, name))), kernel_values(name, kind)
    np.testing.assert_array_equal(found, values)
    assert {np.asarray(x).dtype for x in values} == {np.dtype(F)}
    double = kernel_values(name, "double")
    size = max(1.0, *np.abs(double))
    assert np.abs(np.subtract(found, double)).max() <= 16 * np.finfo(F).eps * size

    rows = [list(map(F, given(flat, name, scale))) for scale in (1.0, 0.5, -0.75, 1.25)]
    columns = [np.array(column, F) for column in zip(*rows, strict=True)]
    found = run(*columns)
    assert all(np.asarray(x).dtype == F for x in found)
    expected = np.array([run(*row) for row in rows])
    for k, column in enumerate(found):
        np.testing.assert_array_equal(np.broadcast_to(column, len(rows)), expected[:, k])


def exactly_fused(flat, values):
    """The graph in double precision, its fused operations rounded once."""

    def operate(node, args):
        if node.op not in ("fma", "fms", "fnma") or not all(map(math.isfinite, args)):
            return source.evaluated(node, args)
        a, b, c = map(Fraction, map(float, args))
        exact = {"fma": a * b + c, "fms": a * b - c, "fnma": c - a * b}[node.op]
        return np.float64(float(exact))

    results = source.performed(flat.nodes, map(np.float64, values), operate)
    return [results[i] for i in flat.results]


class Programs:
    """Graphs as functions of numbers, all compiled at once."""

    def __init__(self, flats, kind, fuses):
        self.kind, self.places = kind, {name: i for i, name in enumerate(flats)}
        real = numba_types.CPointer(
            numba_types.float64 if kind == "double" else numba_types.float32
        )
        emissions = {
            f"graph{i}": ((real, real), functools.partial(self.emit, flat, fuses))
            for i, flat in enumerate(flats.values())
        }
        calls = [f"    if k == {i}: graph{i}(x, y)" for i in range(len(flats))]
        text = "\n".join(["def run(k, x, y):", *calls, ""])
        key = "".join(flat.spelled(()) for flat in flats.values()) + str(fuses)
        self.code = generated(text, (numba_types.int64, real, real), emissions, key)
        pointer = ctypes.c_void_p
        self.function = ctypes.CFUNCTYPE(None, ctypes.c_int64, pointer, pointer)(self.code.address)

    @staticmethod
    def emit(flat, fuses, code, args):
        x, y = args
        order = {parts: i for i, parts in enumerate(flat.inputs())}
        write = Emitter(code, 1, {})
        write.fuses = fuses
        values = write(flat, lambda parts, _: (code.load(x, order[parts]), False))
        for i, (value, _) in enumerate(values):
            code.store(y, i, value)

    def __call__(self, name, values, n):
        F = FLOATS[self.kind]
        x, y = np.array(values, F), np.empty(n, F)
        self.function(self.places[name], x.ctypes.data, y.ctypes.data)
        return y


@pytest.mark.newest
def test_machine_code_is_the_text_to_the_bit():
    flats = {name: recorded(name, "double") for name in ARGUMENTS}
    programs = Programs(flats, "double", False)
    for name, flat in flats.items():
        values = given(flat, name)
        expected = source.function(flat)(*values)
        found = programs(name, values, len(expected))
        np.testing.assert_array_equal(found, expected, err_msg=name)


@pytest.mark.skipif(not processor().fuses, reason="a processor without fused operations")
@every_precision
def test_fused_machine_code(kind):
    """In double precision as with fused operations rounded once, to the bit.

    In both beside the kernel: each of a few roundings differs by half an ulp of the terms' size.
    """
    flats = {name: recorded(name, kind) for name in ARGUMENTS}
    programs = Programs(flats, kind, True)
    for name, flat in flats.items():
        values = given(flat, name)
        expected = np.array(kernel_values(name, kind))
        found = programs(name, values, len(expected))
        if kind == "double":
            np.testing.assert_array_equal(found, exactly_fused(flat, values), err_msg=name)
        size = max(1.0, *np.abs(expected))
        assert np.abs(found - expected).max() <= 4 * np.finfo(FLOATS[kind]).eps * size, name


COMPARISONS = (op.lt, op.le, op.gt, op.ge, op.eq, op.ne)


@every_precision
def test_machine_code_compares_as_floats_do(kind):
    """With NaN too, which is another number than any."""
    _, x, y = numbers(kind=kind)
    flat = Flat(x.graph, [choose(of(x, y), 1.0, 0.0) for of in COMPARISONS], kind)
    program = Programs({"compared": flat}, kind, False)
    for pair in itertools.product((1.0, 2.0, math.nan), repeat=2):
        found = program("compared", pair, len(COMPARISONS))
        assert found.tolist() == [float(of(*pair)) for of in COMPARISONS], pair


# numbers


def numbers(n=2, kind="double"):
    graph = Graph()
    return graph, *graph.inputs(kind, "x", n)


def value(graph, result, *given, kind="double"):
    (found,) = source.function(Flat(graph, [result], kind))(*given)
    return found


def test_the_sign_of_zero_counts():
    """0.0 and −0.0 are two constants, whichever comes first."""
    graph, x, y = numbers()
    graph.strict = True
    up, down = 1.0 / (x * 0.0), 1.0 / (y * -0.0)
    assert value(graph, up, 3.0) == math.inf
    assert value(graph, down, 3.0) == -math.inf
    flat = Flat(graph, [up, down], "double")
    assert source.function(flat)(3.0, 5.0) == (math.inf, -math.inf)


@every_precision
def test_two_constants_are_of_the_precision_of_what_is_compared(kind):
    _, x, y = numbers(kind=kind)
    found = choose((x < y) & (x > 0.0), 1.0, 2.0) * y
    assert type(found).precision == kind


@pytest.mark.parametrize("y", [0.1, -0.1, 1.0, 3.0, -7.25, 1e-3])
def test_remainders_are_pythons(y):
    """To the bit where multiplications are fused."""
    rng = np.random.default_rng(3)
    for x in [0.0, 5.0, -5.0, 3.0, -1e-20, 1e-20, *rng.normal(size=200) * 1e4]:
        for divisor in (y, None):
            graph, a, b = numbers()
            d = b if divisor is None else y
            flat = Flat(graph, [a // d, a % d], "double")
            given = [{"0": x, "1": y}[str(i)] for _, i in flat.inputs()]
            assert exactly_fused(flat, given) == [x // y, x % y], x
    graph, a, _ = numbers()
    assert value(graph, 7.5 % a, 2.0) == 1.5
    assert value(graph, 7.5 // a, -2.0) == -4.0
    assert value(graph, divmod(a, 2.0)[1], 7.5) == 1.5


@pytest.mark.parametrize("power", [1, 2, 3, 7, -1, -2, 0.5, 1.5, 2.5, -0.5, -1.5])
def test_powers(power):
    graph, x, _ = numbers()
    assert value(graph, x**power, 1.7) == pytest.approx(1.7**power, rel=4e-16)
    assert x**0 == 1.0


@pytest.mark.parametrize("power", [0.3, 65, math.inf, math.nan])
def test_powers_that_are_refused(power):
    _, x, y = numbers()
    with pytest.raises(TraceError, match="a power of"):
        x**power
    with pytest.raises(TraceError, match="not known beforehand"):
        2.0**x
    with pytest.raises(TraceError, match="not known beforehand"):
        x**y


def test_larger_keeps_nan():
    graph, x, y = numbers()
    assert value(graph, larger(x, y), 2.0, 3.0) == 3.0
    for given in ((2.0, math.nan), (math.nan, 2.0), (2.0, -math.nan), (-math.nan, 2.0)):
        assert math.isnan(value(graph, larger(x, y), *given))


@pytest.mark.parametrize("use", [float, int, bool, lambda x: [1.0, 2.0][x], lambda x: 0 < x < 2])
def test_what_must_be_known_is_refused(use):
    _, x, _ = numbers()
    with pytest.raises(TraceError, match="not known beforehand"):
        use(x)


# text


def test_text():
    graph, x, y = numbers()
    p = graph.inputs("double", "p", 2)
    z = x * p[0] + y
    flat = Flat(graph, [choose(z < p[1], -z, 1.0), (z + 2.0) / y], "double")
    assert str(source.GraphText(flat)) == (
        "t1 = x0 * p0 + x1\nt2 = where(t1 < p1, -t1, 1.0)\nt3 = (t1 + 2.0) / x1\nreturn t2, t3"
    )


def test_floats_divide_by_zero_as_processors_do():
    graph, x, y = numbers()
    assert value(graph, x / y, 1.0, 0.0) == math.inf
    assert math.isnan(value(graph, Double(x / y) * 0.5, 0.0, 0.0))
