"""Functions followed by their execution paths: the operations give what Python gives."""

import inspect
import math
import time
from typing import NamedTuple

import numpy as np
import pytest
from each import each
from numba import njit
from random_functions import IMPURE, PLACES, impure, of_functions, of_impure, of_values

import fastatt as fa
from fastatt.kernels import quat
from fastatt.tracing import source
from fastatt.tracing.dual import derivatives, seed, value
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import RefusedError, TraceError
from fastatt.tracing.paths import follow
from fastatt.tracing.user import user_function

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


def aliases(x, y):
    u = np.array([x, y, 1.0])
    v, w = u, u[1:]
    if x > 0.5:
        v *= 0.5
        w += x
    if y > 0.5:
        u[0] = 0.0
    out = [x, y]
    same = out
    if y > x:
        same[0] = 7.0
    return (*u, *out)


def set_first(u, x):
    if x > 1.0:
        return u
    u[0] = x
    return u


def helpers_that_write(x, y):
    u = -np.array([x, y])
    set_first(u, y)
    z = set_first(u, x)[1] if x < 0.5 else 0.5
    return u[0], u[1], z


def selected_arrays(x, y):
    u = np.array([x, y])
    total = np.zeros(2)
    if x > y:
        total = total + u
    kept = total
    if x > 0.0:
        total = u * 2.0
    total[0] = 5.0
    return (*total, *kept)


def iterators(x, y):
    rest = iter((1.0, 2.0, 3.0, 4.0, 5.0))
    a = next(rest) if x > 0.0 else 0.0
    if y > 0.0:
        a = math.fsum(rest)
    return a, len([*rest])


def texts_and_truths(x, y):
    mode = "fast" if x > 1.0 else "slow" if y > 0.0 else "off"
    on = x > 0.0
    n = 0
    for v in (x, y):
        if v > 0.25:
            n += 1
    return (
        {"fast": 1.0, "slow": 2.0, "off": 3.0}[mode],
        float(on == 1),
        (1.0, 5.0, 7.0)[n],
        n**-2 if n else 0,
    )


def masks(x, y):
    u = np.array([x, y, 0.25])
    u[u > 0.3] = 0.3
    return (*u, np.where(u > 0.0, u, 2.0)[0], float(np.any(u < 0.0)), np.clip(u, 0.0, y)[1])


def whole_numbers(x, y):
    k = int(4.0 * x)
    n = math.floor(y) % 3
    return float(k), float(k // 2), k / 4, float(n), float(k * n), float(round(x) ** 3), -k % 5


def tables(x, y):
    k = int(abs(y))
    a, b = np.interp(x, XS, YS), np.interp(2.0, XS, YS)
    return a, b, ROW[k], ROW[-1 - k], *TABLE[k % 2], TABLE[k % 2, 1]


XS, YS = np.array([-0.5, 0.0, 0.75, 2.0]), np.array([1.0, -1.0, 3.0, 0.5])
ROW = np.array([0.5, 3.0, 7.0, -2.0])


def defaults_of_objects(x, y):
    return BOX.scaled(x) + BOX.twice * y + BOX(y) + BOX.kind


class Box:
    kind = 0.25

    def __init__(self):
        self.gain = 1.5

    def scaled(self, x):
        return self.gain * x if x > 0.0 else x

    @property
    def twice(self):
        return 2.0 * self.gain

    def __call__(self, x):
        return -self.gain * x


BOX = Box()


def of_kernels(x, y):
    q = fa.kernels.quat.exp((x, y, 0.5))
    return fa.kernels.quat.rotate(q, (1.0, 0.0, x))


FUNCTIONS = [
    f for f in [*globals().values()]
    if inspect.isfunction(f) and [*inspect.signature(f).parameters] == ["x", "y"]
]  # fmt: skip


class Numbers:
    """n numbers, and as many results as the function gives."""

    def __init__(self, function, n, results):
        self.size, self.results = n, results

    nested = staticmethod(tuple)

    def in_a_row(self, result):
        found = result if isinstance(result, (tuple, list, np.ndarray)) else (result,)
        assert len(found) == self.results
        return found


def followed(function, n=2):
    with np.errstate(all="ignore"):
        size = np.size(function(*[0.3, 0.4][:n]))
    return follow(function, Numbers(function, n, size))


def by_paths(function, n=2):
    kept = followed(function, n).recording
    return lambda *given: [float(x) for x in kept.replay(given)]


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.__name__)
def test_every_path_gives_what_python_gives(function):
    kept = followed(function).recording
    points = np.array([(x, y) for x in GRID for y in GRID])
    values = kept.evaluate(points.T)
    for k, (x, y) in enumerate(points.tolist()):
        expected = np.ravel(np.array(function(x, y), float))
        found = [float(np.broadcast_to(values[i], len(points))[k]) for i in kept.results]
        # sums of a few products, each within an ulp of the largest
        for given in (found, [float(v) for v in kept.replay((x, y))]):
            np.testing.assert_allclose(given, expected, rtol=4e-15, atol=4e-15, err_msg=f"{x} {y}")


def test_not_a_number_goes_pythons_way():
    def function(x, y):
        return (
            min(x, y),
            max(x, y),
            np.minimum(x, y),
            1.0 * math.isnan(x),
            (0.0 <= x < 2.0) * 1.0,
        )

    run = by_paths(function)
    for x, y in ((math.nan, 1.0), (1.0, math.nan), (1.0, 2.0)):
        np.testing.assert_array_equal(run(x, y), np.array(function(x, y), float))


def rare(x, y):
    if x > 1e6:
        raise ValueError(f"far: {x}")
    if y > 1e6:
        z = 1.0
    u = NUMBERS[0] if y < -1e6 else ROW[int(y)]
    return x + (z if y > 1e6 else 0.0), u


def unset(x, y):
    if x > 0.0:
        z = 1.0
    return z + y


def test_errors_of_python_are_no_number():
    run = by_paths(rare)
    assert run(1.0, 2.0) == [1.0, 7.0]
    for given in ((2e6, 0.0), (0.0, 4.0), (0.0, -5.0), (0.0, 2e6), (0.0, math.inf)):
        assert np.isnan(run(*given)).all()
    assert by_paths(unset)(1.0, 2.0) == [3.0]
    assert np.isnan(by_paths(unset)(-1.0, 2.0)).all()


def thrusters(x, y):
    torque = np.zeros(2)
    for push in np.arange(24.0).reshape(12, 2):
        if x * push[0] > y:
            torque += 0.5 * push
    if torque[0] > 50.0:
        return 0.0 * torque
    return torque


def test_statements_that_only_add_to_an_array_take_one_path():
    """Selections, not 4096 paths, whatever branches after them."""
    found = followed(thrusters)
    assert sorted(map(len, found.paths)) == [1] * 26
    assert sum(node.op == "select" for node in found.recording.nodes) == 25
    assert by_paths(thrusters)(0.3, 1.0) == thrusters(0.3, 1.0).tolist()


def test_a_function_without_its_source_is_followed():
    scope = {}
    exec("def function(x, y):\n    return (x if x > y else y), 0.0", scope)
    assert by_paths(scope["function"])(1.0, 2.0) == [2.0, 0.0]


def test_precision_and_derivatives_are_those_of_the_call():
    kept = followed(lambda x, y: (x * math.sin(y) + 0.5, x if x > y else y * y)).recording
    graph = Graph()
    flat = Flat(graph, kept.replay(graph.inputs("single", "x", 2)), "single")
    assert {n.precision for n in flat.nodes} <= {"single", ""}
    graph = Graph()
    found = kept.replay(seed(graph.inputs("double", "x", 2), 2))
    rows = [value(x) for x in found] + [d for x in found for d in derivatives(x, 2)]
    run = source.function(Flat(graph, rows, "double"))
    x, y = 0.7, 1.2
    expected = (x * math.sin(y) + 0.5, y * y, math.sin(y), x * math.cos(y), 0.0, 2.0 * y)
    np.testing.assert_allclose(run(x, y), expected, rtol=1e-14)


# what is not followed


def data_loop(x, y):
    while x > y:
        x = x - 1.0
    return x


def asks_the_same(x, y):
    n = 0
    while x > 100.0 and n >= 0:
        n += 0
    return y


def tries(x, y):
    try:
        return x / y
    except ZeroDivisionError:
        return 0.0


def too_many_paths(x, y):
    n = 0
    for k in range(12):
        if x > k:
            n += NUMBERS.index(1.0)
        elif y > k * x:
            n += NUMBERS.index(2.0)
    return n


def too_long(x, y):
    for k in range(3000):
        x = x * y + k
    return x


NOT_FOLLOWED = [
    (data_loop, "a loop whose end is not known", "while x > y:"),
    (asks_the_same, "a loop whose end is not known", "while x > 100.0"),
    (lambda x, y: math.gamma(x), "math.gamma of numbers", "math.gamma(x)"),
    (lambda x, y: np.linalg.det(((x, y), (y, x))), "numpy.linalg.det of numbers", "np.linalg.det("),
    (lambda x, y: np.array([x], dtype=int)[0], "an array of another type than float", "dtype=int"),
    (tries, "tries catches errors", ""),
    (lambda x, y: x**y, "a power that is not known", "x**y"),
    (lambda x, y: x if isinstance(x, np.floating) else y, "isinstance, which is not among", "isin"),
    (too_many_paths, "more than 512 execution paths", "def too_many_paths"),
    (too_long, "more than 5000 operations", "x = x * y + k"),
    (
        lambda x, y: NUMBERS[int(x)],
        "a number that is not known beforehand, where Python wants a whole",
        "NUMBERS[",
    ),
]


@pytest.mark.parametrize(
    ("function", "what", "line"), NOT_FOLLOWED, ids=lambda x: getattr(x, "__name__", "")
)
def test_what_is_not_followed_is_named_with_its_line(function, what, line):
    with pytest.raises(TraceError) as error:
        follow(function, Numbers(function, 2, 1))
    assert str(error.value).startswith(what)
    assert line in str(error.value)


# what is refused


def is_true(x, y):
    on = x > 0.0
    return 1.0 if on is True else 0.0


def untaken(x, y):
    return time.time() if x > 1e9 else y


REFUSED = [
    (is_true, "`is` with True or False", "on is True"),
    (untaken, "time, which may differ", "time.time()"),
    (lambda x, y: np.random.normal(), "random, which may differ", "np.random"),  # noqa: NPY002
    (lambda x, y: float(hash(x)), "hash, which may differ", "hash(x)"),
    (lambda x, y: len(f"{x:.3f}"), "the text of a number", "{x:.3f}"),
    (lambda x, y: NUMBERS.append(x), "a list from outside", "NUMBERS.append(x)"),
    (lambda x, y: print(x) or y, "print, which may differ", "print(x)"),
]


@each(("function", "what", "line"), REFUSED)
def test_what_is_refused_is_named_with_its_line(function, what, line):
    with pytest.raises(RefusedError) as error:
        follow(function, Numbers(function, 2, 1))
    message = str(error.value)
    assert message.startswith(what)
    assert line in message
    assert "; accepted: a function that" in message
    assert NUMBERS == [1.0, 2.0, 4.0]


@each(("first", "value"), IMPURE)
def test_what_differs_between_calls_or_writes_outside_is_refused(first, value):
    """And nothing is written."""
    assert impure(first, value, PLACES[0]) == ("refused", "")


# the trial beside Python


def tried(monkeypatch, change):
    """A torque that is followed with another operation than Python's."""
    real = follow

    def other(function, given):
        found = real(function, given)
        nodes = tuple(map(change, found.recording.nodes))
        return found._replace(recording=found.recording._replace(nodes=nodes))

    monkeypatch.setattr("fastatt.tracing.user.follow", other)

    def torque(t, q, w, p):
        return (w[0] if t < 7e3 and w[1] < 300.0 else w[0] - w[2]), 0.0, 0.0

    return user_function(torque, "torque", 0)


def test_another_value_in_python_is_not_trusted(monkeypatch):
    """Also where a rare condition decides."""
    made = tried(monkeypatch, lambda x: x._replace(op={"-": "+"}.get(x.op, x.op)))
    assert made.reason.startswith("other values than in Python")
    assert tried(monkeypatch, lambda node: node).followed


def test_a_condition_of_which_one_side_is_not_met_is_called():
    def torque(t, q, w, p):
        return (
            (1.0 if math.sin(t) * math.sin(w[0]) > 0.9999999 + 1e-9 * w[1] ** 2 else 0.0),
            0.0,
            0.0,
        )

    made = user_function(torque, "torque", 0)
    assert made.reason == "a condition of which no trial met both sides"


def test_sides_that_no_number_meets_need_no_trial():
    def torque(t, q, w, p):
        x = abs(w[0]) if abs(w[0]) >= 0.0 else math.nan
        y = min(x, 1.0)
        if q[0] > 1.0 or y > 1.5 or math.sin(t) > 2.0 or t % 2.0 < 0.0:
            return math.nan, 0.0, 0.0
        k = 0
        while k < 5 and w[1] > k:  # not above 0, then above 1
            k += 1
        return x, y, k

    assert user_function(torque, "torque", 0).followed


def test_rounding_is_no_difference():
    def rate(t, p):
        """The second is 0 but for rounding."""
        s, c = math.sin(t), math.cos(t)
        return 1e3 * s, 1e3 * (s * s + c * c - 1.0), p[0]

    assert user_function(rate, "rate", 1).followed


def test_points_where_python_raises_are_left_out():
    def rate(t, p):
        return math.sqrt(t - 5.0), 1.0 / p[0], 0.0

    assert user_function(rate, "rate", 1).followed
    with pytest.raises(TypeError, match="an error in Python at every point where it was tried"):
        user_function(lambda t, p: (math.sqrt(-1.0 - t * t), 0.0, math.gamma(t)), "rate", 1)


def test_functions_made_at_random():
    """``tests/testers`` has more of each kind."""
    for run, least in ((of_functions, 0.6), (of_values, 0.6), (of_impure, 0.0)):
        found = [run(seed) for seed in range(5000, 5030)]
        assert [why for how, why in found if how == "error"] == []
        assert sum(how == "followed" for how, _ in found) >= least * len(found)
