"""Filters: an MEKF's predict both ways, and sigma points beside a plain ensemble run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
import pytest
from numba import njit
from scipy.linalg import block_diag, expm

import fastatt as fa
from fastatt import estimation as es

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
LOOP = 1000 if SMOKE else 100_000
FILTERS = 200 if SMOKE else 20_000
ROUNDS = 1 if SMOKE else 5
H = 0.01
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
VARIANCES = (NOISE["angle_noise"] ** 2, NOISE["bias_noise"] ** 2)
START = (1.0, 0.0, 0.0, 0.0)
GYRO = np.array([0.1, -0.2, 0.3])
P0 = np.diag([1e-4] * 3 + [1e-8] * 3)
BLOCKS = ((1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), (0.0,) * 9, (1e-8, 0.0, 0.0, 1e-8, 0.0, 1e-8))


def exact_covariance() -> np.ndarray:
    """One predict from P0 by the matrix exponential of van Loan."""
    A = np.zeros((6, 6))
    A[:3, :3] = -np.cross(np.eye(3), GYRO)  # rows e×ω: the cross-product matrix of ω
    A[:3, 3:] = -np.eye(3)
    G = np.diag([VARIANCES[0]] * 3 + [VARIANCES[1]] * 3)
    big = expm(H * np.block([[-A, G], [np.zeros((6, 6)), A.T]]))
    phi = big[6:, 6:].T
    return phi @ P0 @ phi.T + phi @ big[:6, 6:]


def numpy_predict(q, b, P, gyro, h):
    """Attitude, transition and Farrenkopf's noise in numpy, as one writes it by hand."""
    w = gyro - b
    u = h * w
    angle = np.linalg.norm(u)
    c, s = np.cos(0.5 * angle), 0.5 * np.sinc(0.5 * angle / np.pi)
    p, v, d = q[0], q[1:], s * u
    q = np.concatenate([[p * c - v @ d], p * d + c * v + np.cross(v, d)])
    W = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    W2 = W @ W
    sin, cos = np.sin(angle), np.cos(angle)
    phi = np.eye(6)
    phi[:3, :3] += (1 - cos) / angle**2 * W2 - sin / angle * W
    phi[:3, 3:] = -h * (np.eye(3) - (1 - cos) / angle**2 * W + (angle - sin) / angle**3 * W2)
    a, z = VARIANCES
    Q = block_diag((a * h + z * h**3 / 3) * np.eye(3), z * h * np.eye(3))
    Q[:3, 3:] = Q[3:, :3] = -0.5 * z * h**2 * np.eye(3)
    return q, phi @ P @ phi.T + Q


def from_python() -> dict[str, Callable[[], object]]:
    one = es.MEKF(START, P0, **NOISE)
    state = (START, (0.0, 0.0, 0.0), BLOCKS, tuple(GYRO.tolist()), H, *VARIANCES)
    return {
        "MEKF.predict": lambda: one.predict(GYRO, H),
        "mekf_predict": lambda: es.mekf_predict(*state),
        "MEKF.update_vector": lambda: one.update_vector(GYRO, GYRO, 0.1),
        "numpy": lambda: numpy_predict(np.array(START), np.zeros(3), P0, GYRO, H),
    }


@pytest.mark.benchmark(group="MEKF with gyro bias: one call from Python")
@pytest.mark.parametrize("name", ["MEKF.predict", "mekf_predict", "MEKF.update_vector", "numpy"])
def test_from_python(benchmark, name):
    call = from_python()[name]
    call()
    n = 10 if SMOKE else 1000
    benchmark.pedantic(call, rounds=3 if SMOKE else 50, iterations=n, warmup_rounds=1)
    exact = exact_covariance()
    if name == "MEKF.predict":
        f = es.MEKF(START, P0, **NOISE)
        f.predict(GYRO, H)
        found = f.covariance
    elif name == "numpy":
        found = call()[1]
    else:
        return
    scale = np.sqrt(np.outer(np.diag(exact), np.diag(exact)))
    benchmark.extra_info["error of P, correlation"] = float((np.abs(found - exact) / scale).max())


predict = es.mekf_predict


@njit
def predict_loop(q, b, P, gyro, h, v, u):
    for i in range(gyro.shape[0]):
        q, P = predict(q, b, P, (gyro[i, 0], gyro[i, 1], gyro[i, 2]), h, v, u)
    return q, P


@pytest.mark.benchmark(group="MEKF predict in a user's @njit loop, 6x6 covariance")
def test_in_a_loop(benchmark):
    log = np.random.default_rng(1).normal(0.0, 1.0, (LOOP, 3))
    arguments = (START, (0.0, 0.0, 0.0), BLOCKS, log, H, *VARIANCES)
    q, _ = benchmark.pedantic(predict_loop, args=arguments, rounds=ROUNDS, warmup_rounds=1)
    if benchmark.stats is not None:
        benchmark.extra_info["ns a predict"] = round(benchmark.stats.stats.min / LOOP * 1e9, 1)
    plain = fa.integrate_rates(np.concatenate([log, log[-1:]]), H, START, method="hold")[-1]
    benchmark.extra_info["from the engine, rad"] = fa.angle_between(np.array(q), plain)


@pytest.mark.benchmark(group="MEKF: an ensemble of filters, one thread")
def test_many_filters(benchmark):
    f = es.MEKF(np.tile(START, (FILTERS, 1)), P0, **NOISE)
    gyro = np.random.default_rng(1).normal(0.0, 1.0, (FILTERS, 3))
    benchmark.pedantic(f.predict, args=(gyro, H), rounds=ROUNDS, warmup_rounds=1)
    if benchmark.stats is not None:
        benchmark.extra_info["ns a filter"] = round(benchmark.stats.stats.min / FILTERS * 1e9, 1)


def in_turn(first: Callable[[], object], second: Callable[[], object]) -> float:
    """Median of the ratio of times, first over second, in pairs."""
    ratios = []
    for _ in range(ROUNDS):
        times = []
        for call in (first, second):
            begin = time.perf_counter()
            call()
            times.append(time.perf_counter() - begin)
        ratios.append(times[0] / times[1])
    return float(np.median(ratios))


SCENE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
METHOD = "rk4"


def bodies(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    q = fa.rotation_vector_to_quat(rng.normal(0.0, 0.1, (n, 3)))
    return q, rng.normal(0.0, 0.5, (n, 3))


def plain_bodies(q: np.ndarray, w: np.ndarray, n_steps: int) -> np.ndarray:
    return fa.propagate(SCENE, q, w, dt=H, n_steps=n_steps, method=METHOD).q[-1]


@pytest.mark.benchmark(group="UKF: sigma points through the engine")
@pytest.mark.parametrize("n_steps", [20, 100])
def test_sigma_points_of_bodies(benchmark, n_steps):
    """Filters of bodies without gyro, 13 sigma points each, between two fixes."""
    centre, rates = bodies(FILTERS)
    ukf = es.UKF(centre, rates, P0)
    q, y = (a.reshape(-1, a.shape[-1]) for a in ukf.sigma_points())
    motion = es.scene_motion(SCENE, H, n_steps, method=METHOD)

    def whole() -> None:
        es.UKF(centre, rates, P0).predict(motion, P0)

    def plain() -> np.ndarray:
        return plain_bodies(q, y, n_steps)

    whole()
    benchmark.pedantic(motion, args=(q, y), rounds=ROUNDS, warmup_rounds=1)
    benchmark.extra_info["motion: speed of plain"] = round(in_turn(plain, lambda: motion(q, y)), 3)
    benchmark.extra_info["whole predict: speed of plain"] = round(in_turn(plain, whole), 3)
    apart = fa.angle_between(motion(q, y)[0], plain())
    benchmark.extra_info["difference, rad"] = float(np.max(apart))
