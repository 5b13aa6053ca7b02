"""Steps, filters and preintegration in a user's ``@njit`` loop, and calls of one step from Python.

Beside the time stands how far the end is from the engine's, or from numpy's version.
"""

from __future__ import annotations

import os
from functools import partial

import numpy as np
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

import fastatt as fa
from fastatt import estimation as es
from fastatt.estimation import preintegration as pre
from fastatt.gyro import gyro_steps as steps

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
CALLS, LOOP = (10, 1000) if SMOKE else (2000, 1_000_000)
H, W, START = 0.01, (0.3, -0.5, 0.7), (1.0, 0.0, 0.0, 0.0)
LOG = np.random.default_rng(1).normal(0.0, 1.0, (LOOP, 3))
CONSTANT = fa.Scene(rate=fa.rates.Constant(W))
TRIAXIAL = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
STEPPERS = {
    "magnus4": (fa.single_step(CONSTANT, method="magnus4"), CONSTANT, ()),
    "rk4 of a body": (fa.single_step(TRIAXIAL, method="rk4"), TRIAXIAL, (W,)),
    "dmv10 of a body": (fa.single_step(TRIAXIAL, method="dmv10"), TRIAXIAL, (W,)),
}
VARIANCES = (9e-8, 1e-10)  # of the angle, rad²/s, and of the bias, rad²/s³
BLOCKS = ((1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), (0.0,) * 9, (1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8))


def numpy_hold(q, w, h):
    """q∘exp(h w) in numpy, as one writes it by hand."""
    u = h * np.asarray(w)
    angle = np.linalg.norm(u)
    c, s = np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi)
    p, v, d = q[0], q[1:], s * u
    return np.concatenate([[p * c - v @ d], p * d + c * v + np.cross(v, d)])


@njit
def hold_loop(q, rates, h):
    for i in range(rates.shape[0]):
        q = steps.hold(q, (rates[i, 0], rates[i, 1], rates[i, 2]), h)
    return q


@njit
def predict_loop(q, P, rates, h, a, z):
    for i in range(rates.shape[0]):
        w = (rates[i, 0], rates[i, 1], rates[i, 2])
        q, P = es.mekf_predict(q, (0.0, 0.0, 0.0), P, w, h, a, z)
    return q


@njit
def preintegrated(gyro, accel, h, a, z):
    s = pre.begin(h)
    for i in range(len(gyro)):
        w = (gyro[i, 0], gyro[i, 1], gyro[i, 2])
        s = pre.add_sample(s, w, (accel[i, 0], accel[i, 1], accel[i, 2]), h, a, z)
    return s.rotation.q


def stepped(stepper, w):
    step, x, p = stepper.step, stepper.state(START, *w), stepper.params

    @njit
    def loop(n, h, x, p):
        for i in range(n):
            x = step(i * h, h, x, p)
        return x

    return lambda: stepper.attitude(loop(LOOP, H, x, p))


LOOPS = {
    "exponential": lambda: hold_loop(START, LOG, H),
    "MEKF, 6×6 covariance": lambda: predict_loop(START, BLOCKS, LOG, H, *VARIANCES),
    "preintegration, covariance": lambda: preintegrated(LOG, LOG, H, *VARIANCES),
    **{name: stepped(stepper, w) for name, (stepper, _, w) in STEPPERS.items()},
}


@pytest.mark.benchmark(group="a loop in @njit code")
@pytest.mark.parametrize("name", LOOPS)
def test_in_a_loop(benchmark, name):
    q = np.array(benchmark.pedantic(LOOPS[name], rounds=1 if SMOKE else 10, warmup_rounds=1))
    if benchmark.stats is not None:
        benchmark.extra_info["ns a step"] = round(benchmark.stats.stats.min / LOOP * 1e9, 2)
    if name in STEPPERS:
        stepper, scene, w = STEPPERS[name]
        run = fa.propagate(scene, START, *w, dt=H, n_steps=LOOP, method=stepper.method)
        known = run.q[-1]
    else:
        known = fa.integrate_rates(np.vstack([LOG, LOG[-1]]), H, START, method="hold")[-1]
    apart = float(fa.angle_between(q, known))
    benchmark.extra_info["from the engine, rad"] = apart
    assert apart < 1e-9


FILTER = es.MEKF(START, np.diag([1e-4] * 3 + [1e-8] * 3), angle_noise=3e-4, bias_noise=1e-5)
UNSCENTED, HELD = es.UKF(START, np.zeros(3), 1e-4 * np.eye(6)), es.gyro_motion(W, H)
ROTATION = Rotation.from_quat([0.0, 0.0, 0.0, 1.0])
FROM_PYTHON = {
    "hold": lambda: steps.hold(START, W, H),
    "MEKF.predict": lambda: FILTER.predict(np.array(W), H),
    "UKF.predict": lambda: UNSCENTED.predict(HELD, 1e-10 * np.eye(6)),
    "numpy": lambda: numpy_hold(np.array(START), W, H),
    "scipy Rotation": lambda: ROTATION * Rotation.from_rotvec(np.multiply(H, W)),
    **{
        name: partial(stepper, 0.0, H, stepper.state(START, *w))
        for name, (stepper, _, w) in STEPPERS.items()
    },
}


@pytest.mark.benchmark(group="one step from Python")
@pytest.mark.parametrize("name", FROM_PYTHON)
def test_from_python(benchmark, name):
    call, rounds = FROM_PYTHON[name], 3 if SMOKE else 50
    call()
    benchmark.pedantic(call, rounds=rounds, iterations=CALLS, warmup_rounds=1)
