"""Kernels and methods recorded: the graph gives what Python gives."""

import functools
import math
import operator
import warnings

import numpy as np
import pytest
from each import each
from test_paths import (
    GRID,
    calls,
    clamped,
    conditional,
    helper,
    known_conditions,
    of_kernels,
    powers,
    remainders,
    typed,
)

from fastatt.tracing import source
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph, flattened
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.operations import FUNCTIONS as KNOWN
from fastatt.tracing.operations import OPERATIONS
from fastatt.tracing.trace import traceable


def loops(x, y):
    s = 0.0
    for k in range(4):
        s += x**k
    return s - sum(a * b for a, b in zip((1.0, 2.0), (x, y), strict=True))


def of_numpy(x, y):
    return np.rint(x) + np.floor(y) + np.sqrt(abs(x)) + np.sign(y) + np.hypot(x, y)


FUNCTIONS = [
    *(conditional, known_conditions, loops, clamped, calls, remainders, powers, typed, of_numpy),
    *(of_kernels, functools.partial(lambda k, x, y: k * x + y, 3.0)),
]


def by_trace(function, n=2):
    graph = Graph()
    result = traceable(function)(*graph.inputs("double", "x", n))
    flat = Flat(graph, flattened(result), "double")
    run = source.function(flat)
    places = [i for _, i in flat.inputs()]
    return lambda *given: run(*(given[i] for i in places))


@each("function", FUNCTIONS)
def test_a_graph_gives_what_python_gives(function):
    run = by_trace(function)
    for x in GRID:
        for y in GRID:
            expected = np.array(flattened(function(x, y)), float)
            # sums of a few products, each within an ulp of the largest
            np.testing.assert_allclose(run(x, y), expected, rtol=4e-15, atol=4e-15)


#: functions of numbers of ``math`` and NumPy: those that are operations, and those that both have
LIBRARY = sorted(
    (module.__name__, name)
    for module in (math, np)
    for name in dir(module)
    if callable(value := getattr(module, name)) and not isinstance(value, type)
    and (value in KNOWN or (hasattr(math, name) and hasattr(np, name)))
)  # fmt: skip
NO_NUMBER = {"gcd", "lcm", "ldexp", "frexp", "modf", "prod", "sumprod", "nextafter", "logical_not"}
NO_NUMBER |= {"less", "greater", "equal"}
IN_BOTH = [[0.3, 0.7], [-0.5, 0.2], [0.8, -0.3], [-0.9, -0.4], [0.1, 0.6], [0.5, 0.5]]


@each("library", [x for x in LIBRARY if x[1] not in NO_NUMBER and "_equal" not in x[1]])
def test_a_function_of_a_library_is_its_own(library):
    """Of a name that both have, such as ``remainder``, each has its own meaning."""
    module = {"math": math, "numpy": np}[library[0]]
    value = getattr(module, library[1])
    op = OPERATIONS.get(KNOWN.get(value, ""))
    count = op.arity if op else 1

    scope = {"math": math, "np": np}
    text = f"{'np' if module is np else 'math'}.{library[1]}({', '.join('xy'[:count])})"
    written = eval(f"lambda x, y: {text}", scope)
    try:
        run = by_trace(written)
    except TraceError:
        assert op is None or op.traced is None or library[1] in ("power", "pow")
        return
    for x, y in IN_BOTH:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of newer NumPy
            try:
                expected = float(value(*(x, y)[:count]))
            except ValueError:  # where Python raises
                expected = math.nan
        assert float(run(x, y)[0]) == pytest.approx(expected, rel=4e-15, nan_ok=True), (x, y)


def test_a_choice_is_one_selection():
    graph = Graph()
    flat = Flat(graph, [traceable(conditional)(*graph.inputs("double", "x", 2))], "double")
    assert [n.op for n in flat.nodes].count("select") == 2


def test_closures_and_defaults_have_their_own_values():
    def made(k):
        def function(x, y, scale=10.0 * k, *, shift=0.5 * k):
            return k * x + y * scale + shift

        return function

    first, second = made(1.0), made(3.0)
    assert by_trace(first)(2.0, 5.0) == (first(2.0, 5.0),)
    assert by_trace(second)(2.0, 5.0) == (second(2.0, 5.0),)


factor = 2.0


def test_globals_are_those_of_the_time_when_it_was_traced():
    global factor  # noqa: PLW0603

    def function(x, y):
        return factor * x + y

    graph = Graph()
    formula = traceable(function)
    factor = 3.0
    flat = Flat(graph, [formula(*graph.inputs("double", "x", 2))], "double")
    assert source.function(flat)(1.0, 1.0) == (3.0,)
    assert by_trace(function)(1.0, 1.0) == (4.0,)


def branches(x, y):
    if x > y:
        return x
    return y


def unknown_function(x, y):
    return math.gamma(x)


def fails(x, y):
    return x.nothing


def inner_problem(x, y):
    return helper(x) + unknown_function(x, y)


@pytest.mark.parametrize(
    ("function", "what", "line"),
    [
        (branches, "a branch on a condition", "if x > y:"),
        (unknown_function, "math.gamma of numbers", "return math.gamma(x)"),
        (fails, "AttributeError: 'Double' object has no attribute", "return x.nothing"),
        (inner_problem, "math.gamma of numbers", "return math.gamma(x)"),
    ],
)
def test_what_is_refused_is_named_with_its_line(function, what, line):
    graph = Graph()
    with pytest.raises(TraceError) as error:
        traceable(function)(*graph.inputs("double", "x", 2))
    assert str(error.value).startswith(what)
    assert line in str(error.value)
    file, number = error.value.where.rsplit(":", 1)
    assert file == __file__
    with open(file) as text:  # noqa: PTH123
        assert line in text.read().splitlines()[int(number) - 1]


def test_what_is_no_function_is_refused():
    with pytest.raises(TraceError, match="no Python function"):
        traceable(operator.add)
