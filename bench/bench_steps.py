"""Single steps: from Python and inside a user's ``@njit`` loop, beside numpy and SciPy."""

from __future__ import annotations

import os

import numpy as np
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

import fastatt as fa
from fastatt.gyro import gyro_steps as steps

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
CALLS, LOOP = (10, 1000) if SMOKE else (2000, 1_000_000)
H = 0.01
W = (0.3, -0.5, 0.7)
START = (1.0, 0.0, 0.0, 0.0)
CONSTANT = fa.Scene(rate=fa.rates.Constant(W))
TRIAXIAL = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
RATE = fa.single_step(CONSTANT, method="magnus4")
BODY = fa.single_step(TRIAXIAL, method="rk4")
FREE = fa.single_step(TRIAXIAL, method="dmv10")
STEPPERS = {
    "magnus4": (RATE, CONSTANT),
    "rk4 of a body": (BODY, TRIAXIAL),
    "dmv10 of a body": (FREE, TRIAXIAL),
}
RATE_STATE = RATE.state(START)
BODY_STATE = BODY.state(START, W)
ARRAY = np.array(BODY_STATE)


def numpy_hold(q, w, h):
    """q∘exp(h w) in numpy, as one writes it by hand."""
    u = h * np.asarray(w)
    angle = np.linalg.norm(u)
    c, s = np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi)
    p, v, d = q[0], q[1:], s * u
    return np.concatenate([[p * c - v @ d], p * d + c * v + np.cross(v, d)])


ROTATION = Rotation.from_quat([0.0, 0.0, 0.0, 1.0])
FROM_PYTHON = {
    "hold": lambda: steps.hold(START, W, H),
    "trapezoid": lambda: steps.trapezoid(START, W, W, H),
    "magnus4": lambda: RATE.step(0.0, H, RATE_STATE, RATE.params),
    "magnus4, stepper(t, h, x)": lambda: RATE(0.0, H, RATE_STATE),
    "rk4 of a body": lambda: BODY.step(0.0, H, BODY_STATE, BODY.params),
    "rk4 of a body, in place": lambda: BODY.step_into(0.0, H, ARRAY, BODY.params),
    "dmv10 of a body": lambda: FREE.step(0.0, H, BODY_STATE, FREE.params),
    "numpy": lambda: numpy_hold(np.array(START), W, H),
    "scipy Rotation": lambda: ROTATION * Rotation.from_rotvec(np.multiply(H, W)),
}


@pytest.mark.benchmark(group="one step from Python")
@pytest.mark.parametrize("name", FROM_PYTHON)
def test_from_python(benchmark, name):
    call = FROM_PYTHON[name]
    call()
    rounds = 3 if SMOKE else 50
    benchmark.pedantic(call, rounds=rounds, iterations=CALLS, warmup_rounds=1)
    if name in ("hold", "trapezoid", "magnus4", "numpy"):
        found = call()
        exact = np.concatenate([[np.cos(0.5 * H * np.linalg.norm(W))], np.zeros(3)])
        exact[1:] = np.sin(0.5 * H * np.linalg.norm(W)) / np.linalg.norm(W) * np.array(W)
        benchmark.extra_info["error, rad"] = fa.angle_between(found, exact)


@njit
def hold_loop(q, rates, h):
    for i in range(rates.shape[0]):
        q = steps.hold(q, (rates[i, 0], rates[i, 1], rates[i, 2]), h)
    return q


@njit
def previous_loop(q, rates, h):
    a = (rates[0, 0], rates[0, 1], rates[0, 2])
    b = (rates[1, 0], rates[1, 1], rates[1, 2])
    for i in range(2, rates.shape[0]):
        c = (rates[i, 0], rates[i, 1], rates[i, 2])
        q = steps.previous(q, a, b, c, h, h)
        a, b = b, c
    return q


def own_loop(stepper):
    step = stepper.step

    @njit
    def loop(n, h, x, p):
        for i in range(n):
            x = step(i * h, h, x, p)
        return x

    return loop


def numpy_loop(q, rates, h):
    for w in rates:
        q = numpy_hold(q, w, h)
    return q


RATE_LOOP, BODY_LOOP, FREE_LOOP = own_loop(RATE), own_loop(BODY), own_loop(FREE)
LOG = np.random.default_rng(1).normal(0.0, 1.0, (LOOP, 3))
LOOPS = {
    "hold": (lambda: hold_loop(START, LOG, H), LOOP),
    "previous": (lambda: previous_loop(START, LOG, H), LOOP),
    "magnus4": (lambda: RATE_LOOP(LOOP, H, RATE_STATE, RATE.params), LOOP),
    "rk4 of a body": (lambda: BODY_LOOP(LOOP, H, BODY_STATE, BODY.params), LOOP),
    "dmv10 of a body": (lambda: FREE_LOOP(LOOP, H, BODY_STATE, FREE.params), LOOP),
    "numpy": (lambda: numpy_loop(np.array(START), LOG[: LOOP // 100], H), LOOP // 100),
}


@pytest.mark.benchmark(group="steps in a user's @njit loop")
@pytest.mark.parametrize("name", LOOPS)
def test_in_a_loop(benchmark, name):
    call, n = LOOPS[name]
    found = benchmark.pedantic(call, rounds=1 if SMOKE else 10, warmup_rounds=1)
    if benchmark.stats is not None:
        benchmark.extra_info["ns a step"] = round(benchmark.stats.stats.min / n * 1e9, 2)
    if name in STEPPERS:
        stepper, scene = STEPPERS[name]
        w = () if scene.kind == "rate" else (W,)
        traj = fa.propagate(scene, START, *w, dt=H, n_steps=n, method=stepper.method)
        apart = fa.angle_between(stepper.attitude(found), traj.q[-1])
        benchmark.extra_info["from the engine, rad"] = apart
    if name in ("hold", "numpy"):
        exact = fa.integrate_rates(
            np.concatenate([LOG[:n], LOG[n - 1 : n]]), H, START, method="hold"
        )[-1]
        benchmark.extra_info["from the engine, rad"] = fa.angle_between(np.array(found), exact)


@pytest.mark.benchmark(group="first call of a step: compiled now, s")
@pytest.mark.parametrize("method", ["magnus4", "rk4", "rk8", "strang2"])
def test_first_call(benchmark, method):
    """Of a scene's own formulas, once the process has compiled another step."""
    RATE(0.0, H, RATE_STATE)
    model = fa.rates.Coning(1.0, 1.0) if method == "magnus4" else None
    top = fa.torques.HeavyTop((0.1, 0.2, 0.3), 1.0)
    scene = fa.Scene(rate=model) if model else fa.Scene(inertia=(2.0, 1.0, 0.7), torque=top)
    stepper = fa.single_step(scene, method=method)
    x = stepper.state(START, *(() if model else (W,)))
    benchmark.pedantic(stepper, args=(0.0, H, x), rounds=1)
