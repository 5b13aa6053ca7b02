"""What the compiled code is: packed, free of the GIL, without allocation."""

import math
import threading
import tracemalloc

import numpy as np
import pytest
from exact import START, generic
from machine_code import (
    CALL,
    CONVERSION,
    arithmetic,
    assemblies,
    is_packed,
    job_of,
    large_loops,
    needs_avx,
)
from numba import njit

import fastatt as fa
from fastatt import _jit
from fastatt.engine.machine import tile_machine
from fastatt.engine.run import Run
from fastatt.gyro.loops import loop as gyro_loop

BODIES = generic(64)
Q0 = np.broadcast_to(START, (64, 4))


def run(scene=BODIES.scene, method="magnus4", representation="quat", n=4, h=0.01, q0=Q0, **options):
    w0 = None if scene.kind == "rate" else [0.1, 0.2, 0.3]
    options = {"method": method, "representation": representation, "n_threads": 1, **options}
    return fa.propagate(scene, q0, w0, dt=h, n_steps=n, **options)


def steps_of(monkeypatch, *args, **options):
    """For each program of a run its loops with a step's worth of arithmetic."""
    job = job_of(monkeypatch, lambda: run(*args, **options))
    return [large_loops(text) for text in assemblies(job)]


# packed arithmetic


ROWS = {
    "constant": fa.rates.Constant(BODIES.c[:, 0]),
    "polynomial": fa.rates.Polynomial(BODIES.c),
    "coning": fa.rates.Coning(BODIES.a, BODIES.omega),
}


@njit
def with_sine(t, p):
    return math.sin(p[0] * t), p[1], p[2]


def damped(t, q, w, p):
    return p[0] * q[1] - p[1] * w[0], -p[0] * q[2], p[2] * math.sin(t)


INERTIA = np.linspace([2.0, 1.0, 0.7], [3.0, 2.0, 1.5], len(BODIES.a))
FREE = fa.Scene(inertia=INERTIA)
TERMS = fa.torques.GravityGradient(BODIES.a), fa.torques.Damping(BODIES.omega[:, None])
TORQUED = fa.Scene(inertia=INERTIA, torque=fa.torques.Sum(TERMS))
PACKED = {
    "dcm": (BODIES.scene, "rk4", "dcm"),
    "quat": (BODIES.scene, "magnus4"),
    **{name: (fa.Scene(rate=rate),) for name, rate in ROWS.items()},
    "user": (fa.Scene(rate=with_sine, params=BODIES.c[:, 0]), "lie_midpoint"),
    "free": (FREE, "dmv10"),
    "torqued": (TORQUED, "rk4"),
    "splitting": (TORQUED, "kahan_li8"),
    "user's torque": (fa.Scene(inertia=INERTIA, torque=damped, params=BODIES.c[:, 0]), "rk4"),
}


@needs_avx
@pytest.mark.parametrize("args", PACKED.values(), ids=PACKED)
def test_step_is_packed(monkeypatch, args):
    """With coning, a parabola and each body's own parameters: sines, products and loads.

    All of it on the machine's widest vectors, in the loop for turns of up to π and in the one for
    any turn; with every model alone, and with a user's own function.
    """
    for loops in steps_of(monkeypatch, *args):
        assert loops
        assert all(map(is_packed, loops))


@needs_avx
@pytest.mark.parametrize("scene", [fa.Scene(rate=ROWS["constant"]), FREE], ids=["rates", "bodies"])
@pytest.mark.parametrize("method", ["rk4", "cf4"])
def test_float32_step_is_packed_without_conversions(monkeypatch, method, scene):
    quick, *_ = steps_of(monkeypatch, scene, method, dtype="float32")
    lines = max(quick, key=len)
    assert is_packed(lines, "ps")
    assert not [line for line in lines if CONVERSION.match(line)]


@needs_avx
@pytest.mark.parametrize("method", ["rk4", "magnus4", "magnus6", "cg3"])
def test_float32_phases_are_reduced_in_double_precision_and_no_more(monkeypatch, method):
    """Their sines are single: doubles are the angles alone, two vectors for one of floats."""
    scene = fa.Scene(rate=ROWS["coning"])
    for loops in steps_of(monkeypatch, scene, method, dtype="float32"):
        found = arithmetic(max(loops, key=len))
        assert 0 < found["pd"] < 0.7 * found["ps"]
        assert found["sd"] == found["ss"] == 0


@njit
def with_gamma(t, p):
    return math.gamma(1.0 + p[0] * p[0] * t * t), p[1], p[2]


@needs_avx
def test_an_opaque_call_makes_the_loop_another(monkeypatch):
    """What the criterion above is there to see."""
    scene = fa.Scene(rate=with_gamma, params=BODIES.c[:, 0])
    for loops in steps_of(monkeypatch, scene, "lie_midpoint"):
        assert not all(map(is_packed, loops))


# memory and the GIL


@pytest.mark.parametrize(("method", "representation"), [("magnus4", "quat"), ("rk4", "dcm")])
def test_steps_allocate_nothing(monkeypatch, method, representation):
    """A program calls nothing."""
    job = job_of(monkeypatch, lambda: run(BODIES.scene, method, representation))
    for text in assemblies(job):
        called = {match[1].strip() for line in text.splitlines() if (match := CALL.match(line))}
        assert called == set()


@pytest.fixture
def peak():
    """Most bytes that arrays and Python hold while a function runs."""

    def measured(function):
        function()  # what is made once
        tracemalloc.start()
        try:
            kept = function()
            return tracemalloc.get_traced_memory()[1], kept
        finally:
            tracemalloc.stop()

    return measured


def test_memory_is_that_of_the_state_and_its_saves(peak):
    """Not of the steps; a body takes its parameters, its state and what is handed out of it."""

    def most(bodies, n=20):
        scene, q0 = generic(bodies).scene, np.tile(START, (bodies, 1))
        return peak(lambda: run(scene, n=n, q0=q0))[0]

    few = most(2000)
    assert most(2000, 1000) == pytest.approx(few, abs=20_000)
    each = (most(12_000) - few) / 10_000
    # the parameters twice, q0, state, result, departure and watch; a few numbers on the way
    assert each < 8 * (2 * 11 + 4 + 4 + 4 + 1 + 3 + 8)


def test_memory_of_a_log_is_that_of_its_attitudes(peak):
    def most(n):
        rates = np.full((n, 3), 0.1)
        return peak(lambda: fa.integrate_rates(rates, 0.01, method="hold", n_threads=1))[0]

    each = (most(40_000) - most(10_000)) / 30_000
    assert each < 8 * (4 + 3)


def test_a_loop_releases_the_gil():
    """As its options say."""
    tile_machine("double", any_angle=False, forks=False)
    gyro_loop("double")
    assert all(loop.targetoptions["nogil"] for loop in _jit._MACHINES)


def test_bodies_run_on_several_threads(monkeypatch):
    """Pieces of an ensemble reach the program from as many threads as asked for."""
    seen = set()
    real = Run.perform
    barrier = threading.Barrier(2, timeout=20.0)

    def watched(*args):
        if threading.get_ident() not in seen:
            seen.add(threading.get_ident())
            barrier.wait()
        return real(*args)

    monkeypatch.setattr(Run, "perform", watched)
    bodies = generic(640)
    run(bodies.scene, n=4, q0=np.tile(START, (640, 1)), n_threads=2)
    assert len(seen) == 2
