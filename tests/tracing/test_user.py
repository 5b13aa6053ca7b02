"""A user's functions: traced where they are straight lines, compiled where not."""

import ctypes
import gc
import linecache
import math
import random
import weakref

import numpy as np
import pytest
from numba import njit, types
from scipy.integrate import solve_ivp

import fastatt as fa
from fastatt.codegen.emitter import POINTERS, Emitter
from fastatt.codegen.modules import generated
from fastatt.tracing import called, source, user
from fastatt.tracing.called import ENTRY
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Double, Graph
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.user import UserFunction, user_function

P = (0.3, -0.7)


def spin(t, p):
    return p[0] * math.sin(t), p[1] * math.cos(t), t if t > 1.0 else 0.5


@njit
def jitted_spin(t, p):
    return spin_part(t, p[0]), 0.0, -p[1]


@njit
def spin_part(t, k):
    if t > 2.0:
        return k
    return k * t


def drag(t, q, w, p):
    size = math.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    return -p[0] * size * w[0], -p[0] * size * w[1], q[0] * t


def push(t, q, w, v, p):
    return v[0] + q[1], w[2] * t, p[1]


def energy(t, q, p):
    return p[0] * q[0] * q[0] + t


def until(t, p):
    """No straight line: a loop over data."""
    x = t
    while x > p[0]:
        x = x - 1.0
    return x, p[0], p[1]


@njit
def opaque_energy(t, q, p):
    x = t
    while x > 0.5:
        x -= 0.5
    return x + q[3] + p[1]


def inputs(graph, made, kind="double"):
    """Recorded arguments, and the names of their numbers."""
    numbers = []
    for k, n in enumerate(made.sizes):
        is_tuple = n or k == len(made.sizes) - 1
        group = graph.inputs(kind, "abcdefgh"[k], n if is_tuple else 1)
        numbers.append(group if is_tuple else group[0])
    return numbers


def values_of(made, *given):
    """What it gives, through the graph's text."""
    graph = Graph()
    result = made.call(*inputs(graph, made))
    results = result if isinstance(result, tuple) else (result,)
    flat = Flat(graph, results, "double")
    by_name = {}
    for k, x in enumerate(given):
        by_name |= {
            ("abcdefgh"[k], i): y for i, y in enumerate(x if isinstance(x, tuple) else (x,))
        }
    return source.function(flat)(*(by_name[name] for name in flat.inputs()))


Q, W, V = (0.5, -0.5, 0.1, 0.7), (0.3, -0.2, 0.9), (1.0, 2.0, -3.0)
STRAIGHT = [
    (spin, "rate", (1.5, P)),
    (spin, "rate", (0.5, P)),
    (jitted_spin, "rate", (1.5, P)),
    (jitted_spin, "rate", (2.5, P)),
    (drag, "torque", (1.5, Q, W, P)),
    (push, "force", (1.5, Q, W, V, P)),
    (energy, "potential", (1.5, Q, P)),
]


@pytest.mark.parametrize(("function", "argument", "given"), STRAIGHT)
def test_straight_functions_are_traced(function, argument, given):
    made = user_function(function, argument, 2)
    assert made.straight
    assert not made.reason
    expected = getattr(function, "py_func", function)(*given)
    expected = expected if isinstance(expected, tuple) else (expected,)
    np.testing.assert_allclose(values_of(made, *given), expected, rtol=4e-16, atol=4e-16)


def test_what_is_traced_is_of_the_precision_of_what_is_given():
    graph = Graph()
    made = user_function(spin, "rate", 2)
    found = made.call(*inputs(graph, made, "single"))
    assert {n.kind for n in Flat(graph, found, "single").nodes} <= {"single", ""}


@pytest.mark.parametrize(
    ("function", "argument", "given"),
    [(until, "rate", (3.2, P)), (opaque_energy, "potential", (1.3, Q, P))],
)
def test_others_are_called(function, argument, given):
    made = user_function(function, argument, 2)
    assert not made.straight
    assert "a loop whose end is not known" in made.reason
    assert __file__ in made.reason
    expected = getattr(function, "py_func", function)(*given)
    expected = expected if isinstance(expected, tuple) else (expected,)
    np.testing.assert_allclose(values_of(made, *given), expected, rtol=0, atol=4e-16)
    known = made.call(*given)
    np.testing.assert_allclose(known, expected[0] if argument == "potential" else expected)


def aligned(n):
    """Memory as vectors are loaded from."""
    memory = np.empty(n + 8)
    start = -memory.ctypes.data // 8 % 8
    return memory[start : start + n]


@pytest.mark.parametrize("lanes", [1, 4])
def test_called_from_machine_code(lanes):
    made = user_function(until, "rate", 2)
    graph = Graph()
    t, p = inputs(graph, made)
    x = [Double(y) for y in made.call(t, p)]
    flat = Flat(graph, [x[0] + p[1], x[1], x[2] * 2.0], "double")

    def emit(code, args):
        given, results, address = args
        resources = {("function", made): code.b.inttoptr(address, POINTERS["function"])}

        def load(name, kind):
            at = [("a", 0), ("b", 0), ("b", 1)].index(name) * lanes
            return code.vector(given, at, lanes), lanes > 1

        for i, value in enumerate(Emitter(code, lanes, resources).wide(flat, load)):
            code.store_vector(results, i * lanes, value)

    pointer = types.CPointer(types.float64)
    arguments = (pointer, pointer, types.int64)
    text = "def run(given, results, address): step(given, results, address)\n"
    key = flat.spelled([("function", made)]) + str(lanes)
    run = generated(text, arguments, {"step": (arguments, emit)}, key)
    times = np.array([3.2, -1.0, 0.75, 9.0])[:lanes]
    a, b = aligned(3 * lanes), aligned(3 * lanes)
    a[:] = [*times, *[P[0]] * lanes, *[P[1]] * lanes]
    doubles = ctypes.POINTER(ctypes.c_double)
    run.ctypes(*(ctypes.cast(x.ctypes.data, doubles) for x in (a, b)), made.address)
    for k, t in enumerate(times):
        x = until(t, P)
        np.testing.assert_array_equal(b[k::lanes], [x[0] + P[1], x[1], x[2] * 2.0])


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("method", ["lie_euler", "lie_midpoint"])
def test_what_bodies_share_is_asked_for_once(own, method, monkeypatch):
    """Once a tile and step, in each form of the step, for all; else each body asks."""
    times = []

    def winding(t, p):
        return until(t, p)

    def called_back(function, user):
        @ENTRY
        def entry(given, made):
            times.append(given[0])
            made[0], made[1], made[2] = function(given[0], (given[1], given[2]))

        entry.address = ctypes.cast(entry, ctypes.c_void_p).value
        return entry

    monkeypatch.setattr("fastatt.tracing.user.compiled", called_back)
    n, params = 64, (20.0, 20.0)
    numbers = np.outer(np.linspace(1.0, 1.1, n), params) if own else params
    scene = fa.Scene(rate=winding, params=numbers)
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    times.clear()
    with pytest.warns(fa.StepWarning):
        run = fa.propagate(scene, q0, t0=0.25, dt=0.5, n_steps=2, method=method, n_threads=1)
    asked = [x for x in times if x == times[0]]
    # the form for small angles, and when the other one is compiled both
    assert len(asked) == (3 * n if own else 3)
    assert own or (run.q == run.q[:, :1]).all()


def raising(t, p):
    if t > 5.0:
        raise ValueError
    return t, 0.0, 0.0


def test_an_error_leaves_nan():
    made = user_function(raising, "rate", 0)
    assert "ValueError" in made.reason
    assert made.call(1.0, ()) == (1.0, 0.0, 0.0)
    assert np.isnan(made.call(6.0, ())).all()


def test_made_once_and_let_go():
    def function(t, p):
        return t, p[0], 0.0

    made = user_function(function, "rate", 1)
    assert user_function(function, "rate", 1) is made
    assert user_function(function, "rate", 2) is not made
    alive = weakref.ref(function)
    del function
    if alive() is not None:  # all that the process ever made is looked through
        gc.collect()
    assert alive() is None
    assert made.straight


# what is compared


calls = []


def traced_differently(t, p):
    """Gives something else each time."""
    calls.append(t)
    return float(len(calls)), 0.0, 0.0


def edited(t, p):
    return t, 2.0 * t, p[0]


def test_another_value_in_python_is_not_trusted(monkeypatch):
    monkeypatch.setattr(user, "traceable", lambda f: lambda t, p: (t, 2.0 * t, p[0] + 1e-6))
    made = UserFunction(edited, "rate", 1)
    assert not made.straight
    assert made.reason == "other values in Python than as it was traced"
    assert values_of(made, 1.5, (0.25,)) == (1.5, 3.0, 0.25)


def test_rounding_is_no_difference():
    def function(t, p):
        """The second is 0 but for rounding."""
        s, c = math.sin(t), math.cos(t)
        return 1e3 * s, 1e3 * (s * s + c * c - 1.0), p[0]

    assert UserFunction(function, "rate", 1).straight


def test_points_where_python_raises_are_left_out():
    def function(t, p):
        return math.sqrt(t - 5.0), 1.0 / p[0], 0.0

    assert UserFunction(function, "rate", 1).straight
    made = UserFunction(function, "rate", 1, np.array([0.0]))
    assert not made.straight
    assert made.reason == "an error in Python at every point where it was tried"


def test_quaternions_that_are_tried_are_unit():
    def function(t, q, w, p):
        off = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1.0
        return math.sqrt(1e-12 - off * off), w[0], p[0]

    assert UserFunction(function, "torque", 1).straight


def test_given_parameters_are_tried():
    seen = []

    def function(t, p):
        return p[0], t, 0.0

    def in_python(f):
        return lambda t, p: seen.append(p) or f(t, p)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(user, "interpreted", in_python)
        UserFunction(function, "rate", 1, np.arange(16.0)[:, None])
    assert seen == [(float(k),) for k in range(0, 16, 2)]


def test_known_numbers_that_python_refuses():
    def function(t, p):
        return t / p[0], 1.0 / p[0], p[1]

    graph = Graph()
    made = UserFunction(function, "rate", 2)
    flat = Flat(graph, made.call(graph.input("double", "t"), (0.0, 2.0)), "double")
    assert source.function(flat)(1.0) == (math.inf, math.inf, 2.0)


def test_jitted_functions_are_not_compiled_to_be_traced():
    @njit
    def inner(x):
        return 2.0 * x

    @njit
    def function(t, p):
        return inner(t), 0.0, 0.0

    assert UserFunction(function, "rate", 0).straight
    assert not inner.signatures
    assert not function.signatures


# what is refused


def two(t, p):
    return t, t


def one(t, p):
    return t


def array(t, p):
    return np.array([t, t])


def a_list(t, p):
    return [t, t, t, t]


def nothing(t, p):
    pass


def truth(t, p):
    return t > 0.0, t, t


def unknown_name(t, p):
    return (
        t,
        nowhere(t),  # noqa: F821
        t,
    )


def too_few(t):
    return t, t, t


def beyond(t, p):
    return p[0], p[1], p[2]


GENERATOR = np.random.default_rng(1)
NORMAL = GENERATOR.normal


def draws(t, p):
    return GENERATOR.normal(), t, t


def draws_by_name(t, p):
    return NORMAL(), t, t


def draws_by_module(t, p):
    return random.gauss(0.0, t), t, t


def raises(t, p):
    raise ValueError("too slow")


def misnamed(t, p):
    return fa.kernels.quat.multiply(p, p)[:3]


def misplaced(t, p):
    return fa.quat.mul(p, p)[:3]


def calls_unknown(t, p):
    return math.isqrt(t), t, t


def three_energies(t, q, p):
    return t, t, t


def test_words_of_numba_have_no_colours():
    """Which it writes where ``colorama`` is installed."""
    error = TypeError("Failed in x\n\x1b[1m\x1b[31mUnknown name\x1b[0m 'a'\n\nDuring: typing")
    assert called._words_of(error) == "Unknown name 'a'"


@pytest.mark.parametrize(
    ("function", "argument", "message"),
    [
        (two, "rate", r"two\(t, p\) returns UniTuple\(float64 x 2\); accepted is a tuple of three"),
        (one, "rate", r"one\(t, p\) returns float64; accepted is a tuple of three floats, rad/s$"),
        (array, "rate", r"array\(t, p\) returns array\(float64, 1d, C\); accepted is a tuple of"),
        (a_list, "rate", r"a_list\(t, p\) returns .*list\(float64\)"),
        (nothing, "rate", r"nothing\(t, p\) returns none; accepted"),
        (truth, "rate", r"truth\(t, p\) returns Tuple\(bool, float64, float64\)"),
        (three_energies, "potential", r"returns .*; accepted is a float, J$"),
        (
            unknown_name,
            "rate",
            (
                r"unknown_name\(t, p\) does not compile for floats, with p a tuple of 2 floats "
                rf"\({__file__}:\d+\); accepted is a .* says: NameError: name 'nowhere' is not def"
            ),
        ),
        (too_few, "rate", r"found too_few\(t\); accepted: rate\(t, p\)"),
        (
            beyond,
            "rate",
            rf"\({__file__}:\d+\); accepted .* Numba says: .*tuple index out of range$",
        ),
        (
            calls_unknown,
            "rate",
            rf"\({__file__}:\d+\); accepted .* Numba says: Unknown attribute 'isqrt'",
        ),
        (
            draws,
            "rate",
            (
                r"found draws\(t, p\) with random numbers; accepted: .* fastatt.TimeSeries .*"
                rf"\({__file__}:\d+: return GENERATOR.normal"
            ),
        ),
        (draws_by_name, "rate", r"with random numbers; accepted: .*: return NORMAL\(\)"),
        (draws_by_module, "rate", r"with random numbers; accepted: .*: return random\.gauss"),
        (
            raises,
            "rate",
            rf"raises\(t, p\) raises ValueError: too slow \({__file__}:\d+\); accepted",
        ),
        (misnamed, "rate", r"no attribute 'multiply' \(nearest: mul\)"),
        (misplaced, "rate", r"no attribute 'quat' \(in fastatt.kernels: quat\)"),
        (3.0, "rate", r"found 3.0; accepted: a function rate\(t, p\)"),
        (math.sin, "torque", r"accepted: a function torque\(t, q, w, p\)"),
    ],
)
def test_wrong_functions_are_refused_each_time(function, argument, message):
    for _ in range(2):
        with pytest.raises(TypeError, match=f"^{argument}: .*{message}") as error:
            user_function(function, argument, 2)
        assert not isinstance(error.value, TraceError)
        assert error.value.__suppress_context__ or error.value.__context__ is None


def test_the_line_is_that_of_the_problem():
    with pytest.raises(TypeError, match="nowhere") as error:
        user_function(calls_nowhere, "rate", 0)
    number = int(str(error.value).split(f"{__file__}:")[1].split(")")[0])
    with open(__file__) as text:  # noqa: PTH123
        assert "nowhere(t)" in text.read().splitlines()[number - 1]


def calls_nowhere(t, p):
    x = 2.0 * t
    y = nowhere(t)  # noqa: F821
    return x, y, t


class Settings:
    gain = 1.0


def gain_of_a_global(t, p):
    return GAIN * p[0], 0.0, 0.0


def gain_of_an_array(t, p):
    return GAINS[0] * p[0], 0.0, 0.0


def gain_of_an_object(t, p):
    return SETTINGS.gain * p[0], 0.0, 0.0


def gain_of_another(t, p):
    return gain_of_a_global(t, p)


def gain_while(t, p):  # no straight line
    x = 0.0
    while x < GAIN * p[0]:
        x += 0.5
    return x, 0.0, 0.0


@njit
def gained(x):
    return GAIN * x


@njit
def gained_twice(x):
    return 2.0 * gained(0.5 * x)


@njit
def gain_of_a_jitted_helper(t, p):
    return gained_twice(p[0]), 0.0, 0.0


@njit
def gain_of_a_jitted_helper_while(t, p):  # no straight line
    x = 0.0
    while x < gained_twice(p[0]):
        x += 0.5
    return x, 0.0, 0.0


class Listed:
    def __init__(self):
        self.gains = [1.0]


def gain_of_a_list(t, p):
    return GAIN_LIST[0] * p[0], 0.0, 0.0


def gain_of_a_list_of_an_object(t, p):
    return LISTED.gains[0] * p[0], 0.0, 0.0


def doubled(x):
    return 1.0 * x


def gain_of_a_helper(t, p):
    return doubled(p[0]), 0.0, 0.0


def other_helper():
    def doubled(x):
        return 2.0 * x

    return doubled


GAIN, GAINS, SETTINGS = 1.0, np.ones(1), Settings()
GAIN_LIST, LISTED = [1.0], Listed()


@pytest.mark.parametrize(
    "rate",
    [
        gain_of_a_global,
        gain_of_an_array,
        gain_of_an_object,
        gain_of_a_list,
        gain_of_a_list_of_an_object,
        gain_of_a_helper,
        gain_of_another,
        gain_while,
        gain_of_a_jitted_helper,
        gain_of_a_jitted_helper_while,
    ],
)
def test_a_new_scene_sees_new_globals(rate, monkeypatch):
    """That of before keeps those with which it was made."""

    def turned(scene):
        run = fa.propagate(scene, [1, 0, 0, 0], dt=0.1, n_steps=10, method="lie_euler")
        return 2.0 * math.atan2(run.q[-1, 1], run.q[-1, 0])

    GAINS[0] = GAIN_LIST[0] = LISTED.gains[0] = 1.0
    before = fa.Scene(rate=rate, params=(0.5,))
    assert turned(before) == pytest.approx(0.5, abs=1e-14)
    monkeypatch.setitem(globals(), "GAIN", 2.0)
    GAINS[0] = 2.0
    monkeypatch.setattr(SETTINGS, "gain", 2.0)
    GAIN_LIST[0] = LISTED.gains[0] = 2.0
    monkeypatch.setitem(globals(), "doubled", other_helper())
    assert turned(fa.Scene(rate=rate, params=(0.5,))) == pytest.approx(1.0, abs=1e-14)
    assert turned(before) == pytest.approx(0.5, abs=1e-14)
    assert user_function(rate, "rate", 1) is user_function(rate, "rate", 1)


@pytest.mark.parametrize(
    ("rate", "t0"),
    [
        (lambda t, p: (p[0], 0.0 * math.sqrt(1.0 - t), 0.0), 0.0),
        (lambda t, p: (p[0], math.sqrt(1.0 - t) - math.sqrt(1.0 - t), 0.0), 0.0),
        (lambda t, p: (p[0], 0.0 / (t - 0.75), 0.0), 0.0),
        (lambda t, p: (p[0], 0.5 * math.sin(1e12 * t), 0.0), 1e5),
        (lambda t, p: (p[0], 0.0, 0.1 * math.tan(1e12 * t)), 1e5),
    ],
)
def test_what_is_no_number_in_python_or_has_no_digit_is_flagged(rate, t0):
    """Zeros that are known drop out of the library's own formulas, of a user's they do not."""
    made = user_function(rate, "rate", 1)
    scene = fa.Scene(rate=rate, params=(0.5,))
    run = fa.propagate(scene, [1, 0, 0, 0], dt=0.25, n_steps=8, t0=t0, method="rk4", invalid="flag")
    assert made.straight
    assert run.status == fa.Status.NON_FINITE


def test_complex_numbers_are_refused():
    with pytest.raises(TypeError, match=r"returns .*complex128.*; accepted is a tuple of three fl"):
        fa.Scene(rate=lambda t, p: (1j * t, 0.0, 0.0))


# traced, with very many operations


def series(n):
    """A torque of n sines, written out."""
    terms = " + ".join(f"math.sin({0.1 + 0.01 * k} * t + q[{k % 4}])" for k in range(n))
    scope = {"math": math}
    text = f"def series(t, q, w, p):\n    x = p[0] * ({terms})\n    return x, -0.5 * x, 0.2 * x\n"
    name = f"<series of {n}>"
    linecache.cache[name] = len(text), None, text.splitlines(keepends=True), name
    exec(compile(text, name, "exec"), scope)
    return scope["series"]


def test_a_function_that_would_compile_for_minutes_is_called():
    """The steps of rk8 would be 105000 operations with 150 sines, and are 4000 with five."""
    inertia = np.array([2.0, 1.0, 0.7])
    start = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.1, 0.2, 0.3])
    options = {"dt": 0.05, "n_steps": 40, "method": "rk8"}
    few, torque = series(5), series(150)
    short, long = (fa.Scene(inertia=inertia, torque=f, params=(1e-3,)) for f in (few, torque))
    assert short.functions[0].straight
    assert long.functions[0].straight
    assert not fa.plan(short, 1, **options).calls
    made = fa.plan(long, 1, **options)
    assert made.calls

    def slope(t, x):
        q, w = x[:4] / np.linalg.norm(x[:4]), x[4:]
        rate = fa.quat_multiply(q, [0.0, *(0.5 * w)])
        acting = np.array(torque(t, q, w, (1e-3,)))
        return np.concatenate([rate, (acting - np.cross(w, inertia * w)) / inertia])

    known = solve_ivp(slope, (0.0, 2.0), np.concatenate(start), "DOP853", rtol=1e-13, atol=1e-15)
    run = made(*start)
    assert fa.angle_between(run.q[-1], known.y[:4, -1]) < 1e-12
    assert run.w[-1] == pytest.approx(known.y[4:, -1], abs=1e-12)


FACTOR = 2.0


def test_a_long_function_is_traced_if_it_does_not_compile_as_it_was_traced(monkeypatch):
    """With a table, which Numba does not know; and with another number than at first."""
    monkeypatch.setattr(user, "MOST_OPERATIONS", 0)
    table = fa.TimeSeries([0.0, 1.0], [[1.0], [3.0]])
    before = FACTOR

    def is_called(torque):
        scene = fa.Scene(inertia=(2.0, 1.0, 0.7), torque=torque)
        monkeypatch.setitem(globals(), "FACTOR", 7.0)
        found = fa.plan(scene, 1, dt=0.05, n_steps=2, method="rk4")
        monkeypatch.setitem(globals(), "FACTOR", before)
        run = found((1, 0, 0, 0), (0, 0, 0))
        assert run.w[-1, 0] == pytest.approx(0.1 * torque(0.05, 1, 1, ())[0] / 2.0, rel=1e-3)
        return found.calls

    assert is_called(lambda t, q, w, p: (2.0 + math.sin(t), 0.0, 0.0))
    assert not is_called(lambda t, q, w, p: (table(t)[0], 0.0, 0.0))
    assert not is_called(lambda t, q, w, p: (FACTOR, 0.0, 0.0))


def test_an_expression_of_many_terms_is_compiled(monkeypatch):
    """Python's own stack limits how deeply an expression can be rewritten."""
    monkeypatch.setattr(user, "compiled", lambda function, made: ctypes.c_double())
    monkeypatch.setattr(UserFunction, "address", 0)
    found = user_function(series(1500), "torque", 1)
    assert not found.straight
    assert "nested" in found.reason
