"""Functions recorded: whatever way Python takes through them, the graph gives the same."""

import math
import operator
from math import atan2, sin
from typing import NamedTuple

import numpy as np
import pytest
from each import each
from numba import njit

from fastatt import kernels
from fastatt.kernels import quat
from fastatt.tracing import source
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph, flattened
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.trace import MAX_ANSWERS, traceable

GAIN = 2.5
TABLE = np.array([[0.5, -1.0], [2.0, 4.0]])
NUMBERS = [1.0, 2.0, 4.0]
SCALE = np.float64(1.5)
LOOKUP = {"a": 3.0}
GRID = [-1.0, -0.25, 0.0, 0.5, 1.0, 1.75, 3.0]


class Pair(NamedTuple):
    first: float
    second: float


LIMITS = Pair(-1.0, 1.0)


@njit
def jitted(x, y=2.0):
    return x * y if x > 0.0 else -x


def helper(x):
    return jitted(x) + GAIN


def gathered(x, /, *rest, scale=2.0, **named):
    if x > rest[0]:
        scale = -scale
    return scale * x + sum(rest) * named["shift"]


# functions of two numbers


def conditional(x, y):
    return x if x > y else -y if y > 0.5 else x * y


def logic(x, y):
    return 1.0 if (x > 0.0 and y > 0.0) or not x < 1.0 else 2.0 if not (x and y) else 3.0


def values_of_logic(x, y):
    return (x or 7.0) + (y and x) + ((x > 0.0) or y) + ((y > 0.0) and 2.0)


def chained(x, y):
    inside = -1.0 < x <= y < 2.0 != x
    return (1.0, x) if inside else (y, 0.0)


def assigned(x, y):
    a, b = 1.0, 2.0
    if x > y:
        a = x
        b += y
    elif x == y:
        a, b = b, a
    else:
        if y > 1.0:
            b *= 3.0
        a -= b
    return a + 10.0 * b


def one_branch_alone(x, y):
    if x > 0.0:
        z = math.sqrt(x)
    w = y
    if x > 0.0:
        w = w + z
    return w


def early(x, y):
    if x < 0.0:
        return -1.0
    if y < 0.0:
        if x > 1.0:
            return x
        y = -y
    elif y == 0.0:
        return 0.5
    return x * y


def falls_through(x, y):
    z = 0.0
    if x > 0.0:
        z = 1.0
        if y > 0.0:
            return z + y
    return z - y


def three_in_a_row(x, y):
    s = 0.0
    if x > 0.0:
        s += 1.0
    if y > 0.0:
        s += 2.0
    if x > y:
        s = s * 2.0
    return s


def loops(x, y):
    s = 0.0
    for k in range(4):
        s += x**k
    for a, b in ((1.0, x), (2.0, y)):
        if b > a:
            continue
        s -= a * b
    n = 3
    while n > 0:
        s = s * y
        n -= 1
    else:  # noqa: PLW0120
        s += 1.0
    return s


def look_up(x, y):
    """Ends early where a number says so."""
    for k in range(len(NUMBERS) - 1):
        if x < NUMBERS[k + 1]:
            return NUMBERS[k] + (x - NUMBERS[k]) * y
    return NUMBERS[-1]


def newton(x, y):
    """A loop with a bound."""
    z = 1.0 + abs(x)
    k = 0
    while abs(z * z - abs(x)) > 1e-3 and k < 6:
        z = 0.5 * (z + abs(x) / z)
        k += 1
    return z + k


def broken_off(x, y):
    s = 0.0
    for _ in range(5):
        s += x
        if s > y:
            break
    else:
        s = -100.0
    return s


def local_helpers(x, y):
    def inner(z, scale=y):
        if z > 1.0:
            z = z * scale
        return z + x

    square = lambda z: z * z  # noqa: E731
    return inner(x) + inner(y, 2.0) + (square(x) if y > 0.0 else square(y))


def changes_a_list(x, y):
    out = [0.0, x]
    if x > y:
        out[0] = 1.0
        out.append(2.0)
    z = out.pop() if y > 0.0 else 5.0
    return out[0] + 10.0 * out[-1] + 100.0 * len(out) + 1000.0 * z


def aliased(x, y):
    out = [x]
    if x > 0.0:
        out += [y]
    return sum(out)


def known_conditions(x, y):
    z = (x, y)
    a = z[2] if len(z) > 2 else z[0]
    if len(z) == 2 and a is not None:
        return z[1] * (1.0 / GAIN if GAIN else 0.0)
    return z[5]


def globals_(x, y):
    return (
        x * GAIN + TABLE[1, 0] * y - TABLE[0][1] + SCALE * NUMBERS[2] + LIMITS.first * LOOKUP["a"]
    )


def clamped(x, y):
    return max(LIMITS.first, min(x, LIMITS.second)) + max((x, y, 0.5)) + abs(y)


def calls(x, y):
    return jitted(x) + jitted(x, y=y) + helper(y) + quat.dot((x, y, 0.0, 1.0), (y, x, 1.0, 2.0))


def calls_with_any_arguments(x, y):
    return gathered(x, y, 1.0, shift=x) + gathered(y, x, scale=3.0, shift=2.0, unused=y)


def remainders(x, y):
    return x % 0.75 + x // 0.75 + 10.0 * (y % -0.5) + divmod(y, 0.375)[0] + 7.5 % (abs(x) + 1.0)


def powers(x, y):
    return x**2 + y**3 + abs(x) ** 0.5 + abs(y) ** 1.5 + pow(x, 2) + math.pow(y, 2.0)


def collected(x, y):
    a, *rest = (x, y, 1.0)
    total = sum(v * w for v, w in zip((x, y), NUMBERS, strict=False))
    squares = [v * v for v in rest]
    return total + squares[-1] + sum(squares) + max(v for v in (a, y))


def any_and_all(x, y):
    return float(any(v > 1.0 for v in (x, y))) + 2.0 * float(all(v < 1.0 for v in (x, y)))


def is_in(x, y):
    return 1.0 if x in (0.0, 1.0) else 2.0


def rounded(x, y):
    return math.floor(x) + 10 * math.ceil(y) + 100 * math.trunc(x) + 1000 * round(y) + np.rint(x)


def numpys(x, y):
    return (
        np.where(x > y, x, y)
        + np.minimum(x, y)
        + np.clip(x, -0.5, 0.5)
        + np.sign(y)
        + np.square(x)
        + np.copysign(x, y + 0.1)
        + np.pi
    )


def remainders_of_c(x, y):
    return math.fmod(x, 0.75) + np.mod(y, 0.375) + np.fmod(y, -0.25) + np.remainder(x, -0.375)


def remainders_to_the_nearest(x, y):
    return math.remainder(x, 0.75) + 8.0 * math.remainder(y, -0.375) + math.remainder(1.0, 2.0 + x)


def typed(x, y):
    F = type(x)
    return F(0.5) * x if y > F(1.0) else F(2.0)


def truth_as_number(x, y):
    return (x > 0.0) * y + 2.0 * (y > x) - (x < y) + (True - (y > 0.0)) * 3.0


def none_at_first(x, y):
    found = None
    if x > 0.0:
        found = y
    pair = (x, y) if y > 0.0 else (x,)
    if x > y:
        found, pair = 1.0, (x, y, y)
    return (0.0 if found is None else found) + 10.0 * len(pair)


def truth_of_comparison(x, y):
    a = x > 0.0
    b = y > 0.0
    if a == b:
        return 1.0
    if a != True:  # noqa: E712
        return 2.0
    return 3.0


def matched(x, y):
    match x:
        case 0.0:
            return y
        case 1.0 if y > 0.0:
            return 2.0 * y
    return x


FUNCTIONS = [
    *(conditional, logic, values_of_logic, chained, assigned, one_branch_alone, early),
    *(falls_through, three_in_a_row, loops, look_up, newton, broken_off, local_helpers),
    *(changes_a_list, aliased, known_conditions, globals_, clamped, calls, remainders, powers),
    *(collected, any_and_all, is_in, rounded, numpys, remainders_of_c, typed, matched),
    *(remainders_to_the_nearest, calls_with_any_arguments),
    *(truth_of_comparison, truth_as_number, none_at_first),
]


def by_trace(function, n=2):
    graph = Graph()
    result = traceable(function)(*graph.inputs("double", "x", n))
    flat = Flat(graph, flattened(result), "double")
    run = source.function(flat)
    places = [i for _, i in flat.inputs()]
    return lambda *given: run(*(given[i] for i in places))


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_every_way_gives_what_python_gives(function):
    run = by_trace(function)
    for x in GRID:
        for y in GRID:
            expected = np.array(flattened(function(x, y)), float)
            # sums of a few products, each within an ulp of the largest
            np.testing.assert_allclose(
                run(x, y), expected, rtol=4e-15, atol=4e-15, err_msg=f"{x} {y}"
            )


ONE_NUMBER = [
    *(np.sin, np.cos, np.tan, np.arctan, np.exp, np.sinh, np.cosh, np.tanh, np.exp2, np.deg2rad),
    *(math.sin, math.cos, math.atan, math.exp, math.fabs, math.degrees, math.radians),
]
OF_POSITIVE = [np.sqrt, np.log, np.log2, np.log10, np.reciprocal, math.log, math.sqrt]
WITHIN_ONE = [np.arcsin, np.arccos, math.asin, math.acos]
CASES = [
    *((f, GRID) for f in ONE_NUMBER),
    *((f, [0.25, 1.0, 3.0, 1e10]) for f in OF_POSITIVE),
    *((f, [-1.0, -0.75, -1e-9, 0.0, 0.5, 1.0]) for f in WITHIN_ONE),
]


@each(("name", "points"), CASES)
def test_functions_of_one_number(name, points):
    for function in (lambda x: name(x), closed_over(name)):
        run = by_trace(function, 1)
        for x in points:
            assert run(x)[0] == pytest.approx(name(x), rel=1e-15, abs=3e-16)


def closed_over(function):
    def call(x):
        return function(x)

    return call


def test_names_from_math():
    run = by_trace(lambda x, y: sin(x) + atan2(x, y) + math.hypot(x, y) + math.log(3.0 + x, 1.5))
    for x, y in ((0.3, -0.5), (-1.0, 2.0)):
        expected = sin(x) + atan2(x, y) + math.hypot(x, y) + math.log(3.0 + x, 1.5)
        assert run(x, y)[0] == pytest.approx(expected, rel=4e-16)


def test_not_a_number_goes_pythons_way():
    def function(x, y):
        return min(x, y), max(x, y), np.minimum(x, y), np.fmax(x, y), math.isnan(x), 0.0 <= x < 2.0

    def floats(x, y):
        return tuple(1.0 if k else 0.0 for k in function(x, y)[4:]), function(x, y)[:4]

    run = by_trace(floats)
    for x, y in ((math.nan, 1.0), (1.0, math.nan), (1.0, 2.0)):
        np.testing.assert_array_equal(run(x, y), flattened(floats(x, y)))


def test_equal_parts_of_ways_are_one():
    """Only what is chosen differs: a guard costs a comparison and a selection."""
    graph = Graph()
    x, y = graph.inputs("double", "x", 2)
    flat = Flat(graph, [traceable(early)(x, y)], "double")
    assert sum(n.op == "*" for n in flat.nodes) <= 2

    flat = Flat(graph, [traceable(three_in_a_row)(x, y)], "double")
    # one addition each, not one for every way
    assert sum(n.op == "+" for n in flat.nodes) <= 2


def test_kernels_through_their_modules():
    def function(x, y):
        q = kernels.quat.exp((x, y, 0.0))
        return kernels.quat.rotate(q, (0.0, 0.0, 1.0))

    np.testing.assert_allclose(by_trace(function)(0.3, -0.4), function(0.3, -0.4), atol=4e-16)


# what a function refers to


def test_closures_and_defaults_have_their_own_values():
    def made(k):
        def function(x, y, scale=10.0 * k, *, shift=0.5 * k):
            return k * x + y * scale + shift

        return function

    first, second = made(1.0), made(3.0)
    assert by_trace(first)(2.0, 5.0) == (first(2.0, 5.0),)
    assert by_trace(second)(2.0, 5.0) == (second(2.0, 5.0),)


def test_lambdas_on_one_line():
    one, two = (lambda x, y: x + y), (lambda x, y: x * y)
    spread = [
        lambda x, y: x - y,
        lambda x, y: (
            x / y
        ),
    ]  # fmt: skip
    found = [by_trace(f)(3.0, 4.0)[0] for f in (one, two, *spread)]
    assert found == [7.0, 12.0, -1.0, 0.75]


factor = 2.0
row = np.array([1.0, 2.0])


def test_globals_are_those_of_the_time_when_it_was_traced():
    global factor  # noqa: PLW0603

    def function(x, y):
        return factor * x + row[1] * y

    first = by_trace(function)
    before = first(1.0, 1.0)
    factor = 3.0
    row[1] = 7.0
    assert first(1.0, 1.0) == before == (4.0,)
    assert by_trace(function)(1.0, 1.0) == (10.0,)


def test_a_function_that_is_let_go_is_forgotten():
    import gc
    import weakref

    def function(x, y):
        return x * y

    by_trace(function)
    alive = weakref.ref(function)
    del function
    if alive() is not None:  # all that the process ever made is looked through
        gc.collect()
    assert alive() is None


# what is no straight line


def data_loop(x, y):
    while x > y:
        x = x - 1.0
    return x


def index(x, y):
    return NUMBERS[int(x)]


def place(x, y):
    return NUMBERS[x]


def unknown_function(x, y):
    return math.gamma(x)


def unknown_of_numpy(x, y):
    return np.linalg.det(((x, y), (y, x)))


def random(x, y):
    return x + np.random.normal()  # noqa: NPY002


def prints(x, y):
    print(x)
    return y


def tries(x, y):
    try:
        return x / y
    except ZeroDivisionError:
        return 0.0


def undefined(x, y):
    return x + nowhere  # noqa: F821


def without_value(x, y):
    if x > 0.0:
        z = 1.0
    return z + y


def raises(x, y):
    if x > 0.0:
        raise ValueError("x is positive")
    return x


def two_lengths(x, y):
    return (x, y) if x > y else (x,)


def walrus(x, y):
    return (z := x) + z + y


def inner_problem(x, y):
    return helper(x) + index(x, y)


def asks_what_it_is(x, y):
    return x if isinstance(x, float) else y


def too_many_ways(x, y):
    n = 0
    for k in range(12):
        if x > k:
            n += 1
            if n > 40:
                return 0.0
        elif y > k * x:
            n += NUMBERS.index(1.0)
            if n == 50:
                return 1.0
    return x


def changes_a_global(x, y):
    NUMBERS[0] = x
    return y


def changes_an_array(x, y):
    TABLE[0, 1] = 5.0
    return y


def put(out, x):
    if x > 0.0:
        out[0] += x
    return x


def hands_over_a_list(x, y):
    """It would be changed once for each way through the other function."""
    out = [y]
    put(out, x)
    return out[0]


def counts(x, y):
    global factor  # noqa: PLW0603
    factor = 5.0
    return x


REFUSED = [
    (data_loop, "a loop whose end is not known", "while x > y:"),
    (index, "a whole number made of one that is not known", "return NUMBERS[int(x)]"),
    (place, "a whole number made of one", "return NUMBERS[x]"),
    (unknown_function, "math.gamma of numbers", "return math.gamma(x)"),
    (unknown_of_numpy, "numpy.linalg.det of numbers", "return np.linalg.det("),
    (
        random,
        "random numbers; accepted: ",
        "return x + np.random.normal()",
    ),
    (prints, "print, which is not among the functions", "print(x)"),
    (tries, "the statement try", "try:"),
    (undefined, "NameError: name 'nowhere' is not defined", "return x + nowhere"),
    (raises, "ValueError: x is positive", "raise ValueError"),
    (two_lengths, "a choice between tuples of two lengths", "def two_lengths"),
    (walrus, "the statement :=", "return (z := x)"),
    (inner_problem, "a whole number", "return NUMBERS[int(x)]"),
    (asks_what_it_is, "isinstance of a number", "return x if isinstance(x, float)"),
    (changes_a_global, "TypeError: 'tuple' object does not support", "NUMBERS[0] = x"),
    (changes_an_array, "ValueError: assignment destination is read-only", "TABLE[0, 1] = 5.0"),
    (hands_over_a_list, "TypeError: 'tuple' object does not support", "out[0] += x"),
    (counts, "the statement global", "global factor"),
    (too_many_ways, "more than 256 execution paths through a function", "def too_many_ways"),
]


@pytest.mark.parametrize(
    ("function", "what", "line"), REFUSED, ids=lambda x: getattr(x, "__name__", "")
)
def test_what_is_refused_is_named_with_its_line(function, what, line):
    graph = Graph()
    with pytest.raises(TraceError) as error:
        traceable(function)(*graph.inputs("double", "x", 2))
    message = str(error.value)
    assert message.startswith(what)
    assert line in message
    file, number = error.value.where.rsplit(":", 1)
    assert file == __file__
    with open(file) as text:  # noqa: PTH123
        assert line in text.read().splitlines()[int(number) - 1]


def test_source_that_can_not_be_read():
    scope = {}
    exec("def function(x):\n    return x", scope)
    with pytest.raises(TraceError, match="function: its source can't be read"):
        traceable(scope["function"])
    with pytest.raises(TraceError, match="no Python function"):
        traceable(operator.add)


def test_a_long_table_is_refused_and_a_short_one_is_not():
    def table(n):
        def function(x, y):
            for k in range(n):
                if x < k:
                    return k * y
            return y

        return function

    run = by_trace(table(MAX_ANSWERS))
    assert [run(x, 2.0)[0] for x in (-1.0, 10.5, 62.5, 99.0)] == [0.0, 22.0, 126.0, 2.0]
    with pytest.raises(TraceError, match="more than 64 branches in a row"):
        by_trace(table(MAX_ANSWERS + 1))


def test_a_name_without_a_value_on_one_way_is_that_of_the_other():
    """Python would raise there: the value means nothing, and is no number made up."""
    assert by_trace(without_value)(1.0, 2.0) == (3.0,)
