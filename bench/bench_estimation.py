"""Parts of estimators inside a user's ``@njit`` loop, with numpy's version of each beside it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numba import njit

import fastatt as fa
from fastatt import estimation
from fastatt.estimation import preintegration as pre
from fastatt.estimation.derivatives import Transition
from fastatt.estimation.inertial_logs import Preintegration
from fastatt.kernels import error_state, quat
from fastatt.propagation.choice_of_method import methods_for
from fastatt.trade.measure import best_time

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from differences import attitude_errors, derivative, displaced

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N = 100 if SMOKE else 20_000
FEW = 1 if SMOKE else None  # methods
H = 0.01
SIGMA_V, SIGMA_U = 1e-3, 1e-4
GENERATOR = np.random.default_rng(0)
GYRO, ACCEL = GENERATOR.normal(size=(N, 3)), GENERATOR.normal(size=(N, 3))
P0 = np.diag([1e-2] * 3 + [1e-4] * 3)


def report(benchmark, call: Callable[[], object], reference: Callable[[], object], n: int) -> None:
    """Time a call over n steps, and the reference's share of them, in ns a step."""
    benchmark.pedantic(call, rounds=1 if SMOKE else 7, warmup_rounds=1)
    if benchmark.stats is None:
        return
    own = benchmark.stats.stats.min / n
    few = min(n, 500)
    theirs, _ = best_time(reference, 3)
    benchmark.extra_info["ns a step"] = round(own * 1e9, 1)
    benchmark.extra_info["numpy, ns a step"] = round(theirs / few * 1e9)


def attitudes(exp):
    @njit
    def run(q, gyro, h):
        for i in range(len(gyro)):
            q = quat.mul(q, exp((h * gyro[i, 0], h * gyro[i, 1], h * gyro[i, 2])))
        return q

    return run


@njit
def predictions(q, p, gyro, h, v, u):
    for i in range(len(gyro)):
        turn = (h * gyro[i, 0], h * gyro[i, 1], h * gyro[i, 2])
        q = quat.mul(q, quat.exp(turn))
        noise = error_state.noise(turn, h, v, u)
        p = error_state.predict(p, error_state.transition(turn, h), noise)
    return q, p


def numpy_predictions(n: int) -> tuple[np.ndarray, np.ndarray]:
    """The same formulas in numpy, where the angles are far from 0."""
    q, p = np.array([1.0, 0.0, 0.0, 0.0]), P0
    phi, noise, one = np.eye(6), np.zeros((6, 6)), np.eye(3)
    for w in GYRO[:n]:
        u = H * w
        t = np.sqrt(u @ u)
        k = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
        kk = k @ k
        s, c = np.sin(t), np.cos(t)
        phi[:3, :3] = one - s / t * k + (1 - c) / t**2 * kk
        phi[:3, 3:] = -H * (one - (1 - c) / t**2 * k + (t - s) / t**3 * kk)
        a = SIGMA_U**2 * H**3
        # beside what is lost to cancellation, as in the formula that is quoted
        noise[:3, :3] = SIGMA_V**2 * H * one + a * (
            one / 3 + (t**3 / 3 - 2 * t + 2 * s) / t**5 * kk
        )
        b = -(SIGMA_U**2) * H**2
        noise[:3, 3:] = b * (one / 2 - (t - s) / t**3 * k + (t * t / 2 + c - 1) / t**4 * kk)
        noise[3:, :3] = noise[:3, 3:].T
        noise[3:, 3:] = SIGMA_U**2 * H * one
        p = phi @ p @ phi.T + noise
        half = np.concatenate([[np.cos(t / 2)], np.sin(t / 2) * u / t])
        v = half[1:]
        q = np.concatenate(
            [[q[0] * half[0] - q[1:] @ v], q[0] * v + half[0] * q[1:] + np.cross(q[1:], v)]
        )
    return q, p


@pytest.mark.benchmark(group="one step of an attitude filter, @njit")
@pytest.mark.parametrize("angles", ["any", "up to π"])
def test_quaternion_step(benchmark, angles):
    """By ``quat.exp``, and by ``quat.exp_short``, which a gyro's samples never outgrow."""
    run = attitudes(quat.exp if angles == "any" else quat.exp_short)
    start = (1.0, 0.0, 0.0, 0.0)
    n = min(N, 500)
    turns = [fa.rotation_vector_to_quat(H * w) for w in GYRO[:n]]

    def reference() -> np.ndarray:
        q = np.array(start)
        for d in turns:
            v = d[1:]
            q = np.concatenate(
                [[q[0] * d[0] - q[1:] @ v], q[0] * v + d[0] * q[1:] + np.cross(q[1:], v)]
            )
        return q

    report(benchmark, lambda: run(start, GYRO, H), reference, N)
    gap = np.subtract(run(start, GYRO[:n], H), reference())
    benchmark.extra_info["difference"] = float(np.abs(gap).max())


@pytest.mark.benchmark(group="one step of an attitude filter, @njit")
def test_prediction(benchmark):
    """Quaternion, Φ, exact noise and Φ P Φᵀ + Q of (δθ, δb)."""
    start, p = (1.0, 0.0, 0.0, 0.0), error_state.blocks(tuple(P0.ravel()))
    given = (H, SIGMA_V**2, SIGMA_U**2)
    report(
        benchmark,
        lambda: predictions(start, p, GYRO, *given),
        lambda: numpy_predictions(500),
        N,
    )
    n = min(N, 500)
    _, found = predictions(start, p, GYRO[:n], *given)
    _, true = numpy_predictions(n)
    gap = np.reshape(error_state.matrix(found), (6, 6)) - true
    scale = np.sqrt(np.outer(np.diag(true), np.diag(true)))
    benchmark.extra_info["difference"] = float(np.abs(gap / scale).max())


# the derivative of the step that a method takes

RATE_METHODS = [name for name, m in fa.METHODS.items() if "rate" in m.scenes][:FEW]
STEP = 0.01


@pytest.mark.benchmark(group="Φ12 of the step taken, @njit")
@pytest.mark.parametrize("method", RATE_METHODS)
def test_rate_transition(benchmark, method):
    """Coning of 0.3 rad at 2 Hz, steps of 0.1 s; and what the cheap −h Jr of its turn is off."""
    scene = fa.Scene(rate=fa.rates.Coning(0.3, 4 * np.pi))
    made = estimation.step_tangent(scene, method=method)
    step, p, h = made.step, made.params, 0.1

    @njit
    def run(n, h, b, p):
        total = 0.0
        for i in range(n):
            q, _, g = step(0.01 * i, h, b, p)
            total += q[1] + g[0] + g[1] + g[2] + g[3] + g[4] + g[5] + g[6] + g[7] + g[8]
        return total

    b = (0.0, 0.0, 0.0)
    benchmark.pedantic(lambda: run(N, h, b, p), rounds=1 if SMOKE else 7, warmup_rounds=1)
    q, _, g = step(0.3, h, b, p)
    nearby = [step(0.3, h, tuple(d), p)[0] for d in displaced(3, STEP)]
    true = derivative(attitude_errors(q, nearby), STEP)
    cheap = -h * estimation.right_jacobian(fa.quat_to_rotation_vector(np.array(q)))
    info = benchmark.extra_info
    info["error of Φ12 / h"] = float(np.abs(np.reshape(g, (3, 3)) - true).max() / h)
    info["of −h Jr / h"] = float(np.abs(cheap - true).max() / h)
    if benchmark.stats is not None:
        info["ns a step"] = round(benchmark.stats.stats.min / N * 1e9, 1)


SAMPLED = [
    (name, scene == "increments")
    for name, m in fa.METHODS.items()
    for scene in m.scenes
    if scene in {"sampled rates", "increments"} and m.window.iteration is None
][:FEW]


@pytest.mark.benchmark(group="Φ12 of every interval of a log")
@pytest.mark.parametrize(("method", "increments"), SAMPLED)
def test_sample_transitions(benchmark, method, increments):
    t = 0.1 * np.arange(37)
    a, w = 0.3, 4 * np.pi
    rates = w * np.stack(
        [-np.sin(a) * np.sin(w * t), np.sin(a) * np.cos(w * t), -2 * np.sin(a / 2) ** 2 + 0 * t], 1
    )
    log = 0.1 * rates[:-1] if increments else rates  # 36 intervals: whole windows

    def ours(bias) -> Transition:
        many = np.broadcast_to(log, (len(bias), *log.shape))
        return estimation.sample_transitions(
            many, 0.1, method=method, increments=increments, bias=bias
        )

    found = benchmark.pedantic(
        ours, args=(np.zeros((1, 3)),), rounds=1 if SMOKE else 7, warmup_rounds=1
    )
    nearby = ours(displaced(3, STEP)).rotation
    error, cheap = 0.0, 0.0
    for i in range(found.rotation.shape[1]):
        q = found.rotation[0, i]
        true = derivative(attitude_errors(q, nearby[:, i]), STEP)
        held = -0.1 * estimation.right_jacobian(fa.quat_to_rotation_vector(q))
        error = max(error, np.abs(found.bias[0, i] - true).max() / 0.1)
        cheap = max(cheap, np.abs(held - true).max() / 0.1)
    benchmark.extra_info["error of Φ12 / h"] = float(error)
    benchmark.extra_info["of −h Jr / h"] = float(cheap)
    if benchmark.stats is not None:
        each = benchmark.stats.stats.min / found.rotation.shape[1]
        benchmark.extra_info["ns an interval"] = round(each * 1e9)


BODIES = [
    name
    for name in methods_for(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), "quat")
    if fa.METHODS[name].is_stepped
][:FEW]


@pytest.mark.benchmark(group="tangent of a free body's step, @njit")
@pytest.mark.parametrize("method", BODIES)
def test_body_tangent(benchmark, method):
    """6×6 at h = 0.2; how far it is from symplectic, and from differences."""
    moments = np.array([2.0, 1.0, 2 / 3])
    made = estimation.step_tangent(fa.Scene(inertia=moments), method=method)
    step, p, h = made.step, made.params, 0.2
    q, m = (1.0, 0.0, 0.0, 0.0), (np.cos(1.1), 0.2, np.sin(1.1))
    n = 10 if SMOKE else 2000

    @njit
    def run(n, h, q, m, p):
        total = 0.0
        for i in range(n):
            _, b, phi = step(0.01 * i, h, q, m, p)
            m = (m[0] + 1e-12 * b[0], m[1], m[2])
            for c in phi:
                total += c
        return total

    benchmark.pedantic(lambda: run(n, h, q, m, p), rounds=1 if SMOKE else 7, warmup_rounds=1)
    q1, m1, phi = step(0.0, h, q, m, p)
    phi = np.reshape(phi, (6, 6))
    d = displaced(6, 4e-3)
    starts = fa.quat_multiply(q, fa.rotation_vector_to_quat(d[:, :3]))
    ends = [step(0.0, h, tuple(a), tuple(m + b), p) for a, b in zip(starts, d[:, 3:], strict=True)]
    theta = attitude_errors(q1, [end[0] for end in ends])
    change = np.hstack([theta, np.subtract([end[1] for end in ends], m1)])
    info = benchmark.extra_info
    info["error"] = float(np.abs(phi - derivative(change, 4e-3)).max())
    info["from symplectic"] = float(np.abs(phi.T @ form(m1) @ phi - form(m)).max())
    info["det - 1"] = float(np.linalg.det(phi) - 1)
    if benchmark.stats is not None:
        info["ns a step"] = round(benchmark.stats.stats.min / n * 1e9)


def form(m) -> np.ndarray:
    hat = np.reshape(fa.kernels.so3.hat(tuple(m)), (3, 3))
    return np.block([[-hat, np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])


def numpy_preintegration(n: int) -> np.ndarray:
    """Forster's form with its covariance and Jacobians."""
    one = np.eye(3)
    r, v, p, cov = one, np.zeros(3), np.zeros(3), np.zeros((9, 9))
    rg, vg, va, pg, pa = (np.zeros((3, 3)) for _ in range(5))
    q = np.diag([SIGMA_V**2 / H] * 3 + [SIGMA_U**2 / H] * 3)

    def skew(x):
        return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])

    for w, f in zip(GYRO[:n], ACCEL[:n], strict=True):
        u = H * w
        t = np.sqrt(u @ u)
        k = skew(u)
        kk = k @ k
        d = one + np.sin(t) / t * k + (1 - np.cos(t)) / t**2 * kk
        jr = one - (1 - np.cos(t)) / t**2 * k + (t - np.sin(t)) / t**3 * kk
        rf = r @ skew(f)
        a, b = np.eye(9), np.zeros((9, 6))
        a[:3, :3], a[3:6, :3], a[6:, :3], a[6:, 3:6] = d.T, -H * rf, -0.5 * H**2 * rf, H * one
        b[:3, :3], b[3:6, 3:], b[6:, 3:] = H * jr, H * r, 0.5 * H**2 * r
        cov = a @ cov @ a.T + b @ q @ b.T
        pg = pg + vg * H - 0.5 * rf @ rg * H**2
        pa = pa + va * H - 0.5 * r * H**2
        vg = vg - rf @ rg * H
        va = va - r * H
        rg = d.T @ rg - jr * H
        p = p + v * H + 0.5 * r @ f * H**2
        v = v + r @ f * H
        r = r @ d
    return p


@pytest.mark.benchmark(group="preintegration, one sample with Jacobians and covariance, @njit")
def test_preintegration(benchmark):
    """Error of position at samples of 20 ms against motion that bends within them."""
    add = pre.add_sample

    @njit
    def run(gyro, accel, h, g, a):
        s = pre.begin(h)
        for i in range(len(gyro)):
            w = (gyro[i, 0], gyro[i, 1], gyro[i, 2])
            f = (accel[i, 0], accel[i, 1], accel[i, 2])
            s = add(s, w, f, h, g, a)
        return s

    given = (SIGMA_V**2, SIGMA_U**2)
    report(
        benchmark,
        lambda: run(GYRO, ACCEL, H, *given),
        lambda: numpy_preintegration(500),
        N,
    )
    errors = {}
    for at, share in (("mean", 0.5), ("start", 0.0)):
        t = 0.02 * np.arange(50)
        fine = run(*motion(1e-4 * (np.arange(10_000) + 0.5)), 1e-4, *given)
        errors[at] = np.linalg.norm(
            np.subtract(run(*motion(t + 0.02 * share), 0.02, *given).p, fine.p)
        )
    for at, error in errors.items():
        benchmark.extra_info[f"error after 1 s, samples at the {at}, m"] = float(error)


def motion(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A hand's turns, some rad/s at 1 Hz, and specific force, some g."""
    w = 2 * np.pi * t
    gyro = np.stack([2 * np.sin(w), 1.5 * np.cos(w), np.sin(2 * w)], axis=1)
    accel = np.stack([3 * np.cos(w), 2 * np.sin(2 * w), 9.8 + np.sin(w)], axis=1)
    return gyro, accel


@pytest.mark.benchmark(group="preintegration of many logs, all threads")
def test_many_logs(benchmark):
    n_logs, n = (4, 10) if SMOKE else (10_000, 100)
    gyro, accel = GENERATOR.normal(size=(n_logs, n, 3)), GENERATOR.normal(size=(n_logs, n, 3))

    def ours() -> Preintegration:
        return estimation.preintegrate(gyro, accel, H, gyro_noise=SIGMA_V, accel_noise=SIGMA_U)

    benchmark.pedantic(ours, rounds=1 if SMOKE else 5, warmup_rounds=1)
    if benchmark.stats is not None:
        speed = n_logs * n / benchmark.stats.stats.min
        benchmark.extra_info["M samples/s"] = round(speed / 1e6, 2)
