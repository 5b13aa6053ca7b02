"""Functions of users: followed, called or refused; what a scene was given is what it runs."""

import copy
import ctypes
import dataclasses
import linecache
import math
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest
from numba import njit

import fastatt as fa
from fastatt.tracing import called, source
from fastatt.tracing.called import ENTRY
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.user import user_function

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
    """Recorded arguments."""
    return made.nested(graph.inputs(kind, "x", made.signature.size))


def values_of(made, *given):
    """What it gives, through the graph's text."""
    graph = Graph()
    result = made.call(*inputs(graph, made))
    results = result if isinstance(result, tuple) else (result,)
    flat = Flat(graph, results, "double")
    numbers = [y for x in given for y in (x if isinstance(x, tuple) else (x,))]
    return source.function(flat)(*(numbers[k] for _, k in flat.inputs()))


Q, W, V = (0.5, -0.5, 0.1, 0.7), (0.3, -0.2, 0.9), (1.0, 2.0, -3.0)
GIVEN = [
    (spin, "rate", (1.5, P)),
    (spin, "rate", (0.5, P)),
    (jitted_spin, "rate", (1.5, P)),
    (jitted_spin, "rate", (2.5, P)),
    (drag, "torque", (1.5, Q, W, P)),
    (push, "force", (1.5, Q, W, V, P)),
    (energy, "potential", (1.5, Q, P)),
    (until, "rate", (3.2, P)),
    (opaque_energy, "potential", (1.3, Q, P)),
]


@pytest.mark.parametrize(("function", "argument", "given"), GIVEN)
def test_functions_are_followed_and_others_called(function, argument, given):
    made = user_function(function, argument, 2)
    if function in (until, opaque_energy):
        assert not made.followed
        assert re.search(f"a loop whose end is not known.*{__file__}", made.reason)
    else:
        assert (made.followed, made.reason) == (True, "")
        assert repr(made) == f"<{argument} {function.__name__}: followed>"
    expected = getattr(function, "py_func", function)(*given)
    for found in (values_of(made, *given), made.call(*given)):
        np.testing.assert_allclose(np.ravel(found), np.ravel(expected), rtol=4e-16, atol=4e-16)


@pytest.mark.parametrize("own", [False, True])
@pytest.mark.parametrize("method", ["lie_euler", "lie_midpoint"])
def test_what_bodies_share_is_asked_for_once(own, method, monkeypatch):
    """Once a tile and step, in each form of the step, for all; else each body asks."""
    times = []

    def winding(t, p):
        return until(t, p)

    def called_back(code, user):
        @ENTRY
        def entry(given, made):
            times.append(given[0])
            made[0], made[1], made[2] = until(given[0], (given[1], given[2]))

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


def loop(t):
    """No path has an end that is known."""
    n = 0
    while n < t:
        n += 1
    return n


TABLE = np.array([0.5, 3.0, 7.0])


def checked(t, p):
    k = int(p[0]) + 0 * loop(t)
    u = np.zeros(3)
    u[k] = 1.0
    return TABLE[k], 7 // (k - 1), u[0] + math.sin(p[1])


def test_a_called_function_is_checked_as_python_is():
    made = user_function(checked, "rate", 2, np.array([2.0, 0.3]))
    assert not made.followed
    assert made(0.5, 0.0, 0.3) == (0.5, -7.0, pytest.approx(1.0 + math.sin(0.3), rel=1e-15))
    # beyond a table, a division by 0, no whole number, a sine without a digit
    for p in (3.0, -4.0, 1.0, math.nan, math.inf, 1e300):
        assert np.isnan(made(0.5, p, 0.3)).all()
    assert np.isnan(made(0.5, 0.0, 1e16)[2])


def test_jitted_functions_are_not_compiled_to_be_followed():
    @njit
    def inner(x):
        return 2.0 * x

    @njit
    def function(t, p):
        return inner(t), 0.0, 0.0

    assert user_function(function, "rate", 0).followed
    assert not inner.signatures
    assert not function.signatures


def test_known_numbers_that_python_refuses():
    def function(t, p):
        return t / p[0], 1.0 / p[0], p[1]

    graph = Graph()
    made = user_function(function, "rate", 2)
    flat = Flat(graph, made.call(graph.input("double", "t"), (0.0, 2.0)), "double")
    assert source.function(flat)(1.0) == (math.inf, math.inf, 2.0)


# what is refused


def nothing(t, p):
    pass


def calls_unknown(t, p):
    return math.isqrt(t), t, t


def raises(t, p):
    raise ValueError("too slow")


def misnamed(t, p):
    return fa.kernels.quat.multiply(p, p)[:3]


@pytest.mark.filterwarnings("ignore::numba.core.errors.NumbaTypeSafetyWarning")
@pytest.mark.parametrize(
    ("function", "argument", "message"),
    [
        (lambda t, p: [t, t, t, t], "rate", "a result that is list of 4; accepted: 3 numbers"),
        (lambda t, p: (t, 1j * t, t), "rate", "arithmetic with complex .*; and not compiled: "),
        (lambda t, q, p: (t, t, t), "potential", "tuple of 3; accepted: 1 numbers, J"),
        (nothing, "rate", "a result that is NoneType; accepted: 3 numbers"),
        (lambda t, p: p[2:5], "rate", "a result that is tuple of 0; accepted: 3 numbers"),
        (calls_unknown, "rate", r"isqrt.*isqrt\(t\), t, t\); and not compiled: Unknown attribute"),
        (raises, "rate", "is not followed: an error on every path"),
        (misnamed, "rate", "has no attribute 'multiply'"),
        (lambda t, p: (t, t, np.random.normal()), "rate", "np.random.*accepted: a function that"),  # noqa: NPY002
        (3.0, "rate", r"found 3.0; accepted: a function rate\(t, p\)"),
        (math.sin, "torque", r"accepted: a function torque\(t, q, w, p\)"),
    ],
)
def test_wrong_functions_are_refused_each_time(function, argument, message):
    for _ in range(2):
        with pytest.raises(TypeError, match=f"^{argument}: .*{message}") as error:
            user_function(function, argument, 2)
        assert not isinstance(error.value, TraceError)
        assert "accepted" in str(error.value)


def test_words_of_numba_have_no_colours():
    """Which it writes where ``colorama`` is installed."""
    error = TypeError("Failed in x\n\x1b[1m\x1b[31mUnknown name\x1b[0m 'a'\n\nDuring: typing")
    assert called.words_of(error) == "Unknown name 'a'"


# what a scene was given is what it runs

GAIN = 0.5


def gain(t, p):
    return GAIN * p[0], 0.0, 0.0


def gain_of_a_loop(t, p):
    return (GAIN + 0 * loop(t)) * p[0], 0.0, 0.0


def first_rate(scene):
    """Of the scene's function, at t = 1 s for its first body."""
    p = np.atleast_2d(scene.params)[0]
    return scene.functions[0].call(1.0, tuple(p))[0]


@pytest.mark.parametrize("rate", [gain, gain_of_a_loop])
@pytest.mark.parametrize("params", [(1.0,), [[1.0], [2.0]]])
def test_copies_run_what_was_given(rate, params, monkeypatch):
    scene = fa.Scene(rate=rate, params=params)
    early = pickle.dumps(scene)
    monkeypatch.setitem(globals(), "GAIN", 0.9)
    copies = [
        *(scene, copy.copy(scene), copy.deepcopy(scene), dataclasses.replace(scene), scene[:1]),
        *(pickle.loads(early), pickle.loads(pickle.dumps(scene))),
    ]
    assert [first_rate(x) for x in copies] == [0.5] * len(copies)
    assert all(x == scene and hash(x) == hash(scene) for x in copies[:4])
    assert copies[-1] == scene
    new = fa.Scene(rate=rate, params=params)
    assert first_rate(new) == 0.9
    assert new != scene


def test_a_function_is_for_the_parameters_that_it_was_made_for():
    scene = fa.Scene(rate=gain, params=(1.0,))
    with pytest.raises(
        TypeError, match=r"found <rate gain: followed>, made for rate\(t, p\) with 1"
    ):
        dataclasses.replace(scene, params=(1.0, 2.0))
    assert dataclasses.replace(scene, rate=gain, params=(1.0, 2.0)) != scene


def test_another_process_reads_called_functions(tmp_path):
    made = user_function(gain_of_a_loop, "rate", 1)
    path = tmp_path / "made.pickle"
    path.write_bytes(pickle.dumps(made))
    text = (
        f"import pickle; made = pickle.load(open({str(path)!r}, 'rb')); print(made, made(1.0, 2.0))"
    )
    run = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("<rate gain_of_a_loop: called (a loop whose end")
    assert run.stdout.endswith("(1.0, 0.0, 0.0)\n")


def test_a_resumed_run_has_the_same_called_function(monkeypatch):
    scene = fa.Scene(rate=gain_of_a_loop, params=(1.0,))
    run = fa.propagate(scene, [1, 0, 0, 0], dt=0.1, n_steps=3, method="rk4")
    assert fa.resume(scene, run, n_steps=2).t[-1] == pytest.approx(0.5)
    monkeypatch.setitem(globals(), "GAIN", 0.9)
    with pytest.raises(ValueError, match="scene: differs from that of the run"):
        fa.resume(fa.Scene(rate=gain_of_a_loop, params=(1.0,)), run, n_steps=2)


def test_events_have_the_values_of_the_begin_of_a_run(monkeypatch):
    body, event = fa.Scene(inertia=(3.0, 2.0, 1.0)), fa.event(lambda t, q, w, p: t - GAIN)
    options = {"dt": 0.1, "method": "rk8", "events": [event]}
    given = [1, 0, 0, 0], [0.1, 0, 0]
    planned = fa.plan(body, 1, n_steps=20, **options)

    def times(n):
        return fa.propagate(body, *given, n_steps=n, **options).event_times[0]

    before = times(20)
    monkeypatch.setitem(globals(), "GAIN", 0.9)
    kept = [pickle.loads(pickle.dumps(planned)), planned]
    assert before == pytest.approx(0.5)
    assert times(20) == times(21) == pytest.approx(0.9)
    assert [x(*given).event_times[0] for x in kept] == [before, before]


def test_a_called_rate_moves_a_body_as_its_formula_does():
    scenes = [fa.Scene(rate=f, params=(1.0,)) for f in (gain, gain_of_a_loop)]
    runs = [fa.propagate(x, [1, 0, 0, 0], dt=0.1, n_steps=10, method="magnus4") for x in scenes]
    assert fa.angle_between(runs[0].q, runs[1].q).max() < 1e-15


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
    scene = fa.Scene(rate=rate, params=(0.5,))
    run = fa.propagate(scene, [1, 0, 0, 0], dt=0.25, n_steps=8, t0=t0, method="rk4")
    assert scene.functions[0].followed
    assert run.status == fa.Status.NON_FINITE


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
    """150 sines are 6000 operations, and five 300."""
    assert user_function(series(5), "torque", 1).followed
    torque = series(150)
    made = user_function(torque, "torque", 1)
    assert "more than 5000 operations" in made.reason
    given = 1.5, Q, W, (1e-3,)
    np.testing.assert_allclose(made.call(*given), torque(*given), rtol=1e-13)
