"""Preintegration against matrix exponentials, and differences."""

import math

import mpmath as mp
import numpy as np
import pytest
from differences import attitude_errors, derivative, displaced
from each import each
from oracle import EPS, hat, quat_matrix, vec

import fastatt as fa
from fastatt import estimation
from fastatt.estimation import preintegration as kernels

N, H = 6, 0.05
SIGMA_G, SIGMA_A = 0.02, 0.3
NOISE = {"gyro_noise": SIGMA_G, "accel_noise": SIGMA_A}
STEP = 0.02


def samples(seed=0, rate=1.0):
    generator = np.random.default_rng(seed)
    return rate * generator.normal(size=(N, 3)), 5.0 * generator.normal(size=(N, 3))


GYRO, ACCEL = samples()


def exact(gyro, accel, h):
    """(R, v, p) of held samples: X' = X G with X = [[R, v, p], [0, 1, t], [0, 0, 1]]."""
    x = mp.eye(5)
    for w, a in zip(gyro, accel, strict=True):
        g = mp.zeros(5)
        g[0:3, 0:3] = hat(vec(w))
        g[0:3, 3] = vec(a)
        g[3, 4] = 1
        x = x * mp.expm(g * mp.mpf(h), method="taylor")
    return x[0:3, 0:3], x[0:3, 3], x[0:3, 4]


def largest(a):
    return float(max(abs(c) for c in a))


@each("rate", [0.0, 1e-8, 1.0, 2 * math.pi / H * 0.999, 100.0 / H])
def test_increments(rate):
    axis = np.array([[2.0, -1.0, 2.0]]) / 3.0
    gyro = GYRO if rate == 1.0 else np.repeat(rate * axis, N, axis=0)
    found = estimation.preintegrate(gyro, ACCEL, H)
    r, v, p = exact(gyro, ACCEL, H)
    # each sample's turn is rounded to an ulp of itself
    bound = N * 2 * EPS * (1 + rate * H)
    assert largest(quat_matrix(vec(found.rotation)) - r) <= bound
    assert largest(vec(found.velocity) - v) <= bound * largest(v)
    assert largest(vec(found.position) - p) <= bound * max(largest(p), largest(v) * H)
    assert found.duration == pytest.approx(N * H, rel=4 * EPS)


@pytest.fixture(scope="module")
def biased():
    """A log and its neighbours along both biases, on both threads and on one."""
    d = np.vstack([np.zeros(6), displaced(6, STEP)])
    logs = np.broadcast_to(GYRO, (25, N, 3)), np.broadcast_to(ACCEL, (25, N, 3))
    found = estimation.preintegrate(
        *logs, H, gyro_bias=d[:, :3], accel_bias=d[:, 3:], n_threads=2, **NOISE
    )
    alone = estimation.preintegrate(
        *logs, H, gyro_bias=d[:, :3], accel_bias=d[:, 3:], n_threads=1, **NOISE
    )
    assert (found.rows == alone.rows).all()
    return found


def test_bias_derivatives(biased):
    found = biased
    theta = attitude_errors(found.rotation[0], found.rotation[1:])
    change = np.hstack(
        [theta, (found.velocity - found.velocity[0])[1:], (found.position - found.position[0])[1:]]
    )
    true = derivative(change, STEP)
    # truncation (STEP N H)⁴/30 of values of some 10, and rounding
    bound = 10 * (STEP * N * H) ** 4 / 30 / STEP
    assert np.abs(found.rotation_gyro[0] - true[:3, :3]).max() <= bound
    assert np.abs(true[:3, 3:]).max() <= bound
    assert np.abs(found.velocity_gyro[0] - true[3:6, :3]).max() <= bound
    assert np.abs(found.velocity_accel[0] - true[3:6, 3:]).max() <= bound
    assert np.abs(found.position_gyro[0] - true[6:, :3]).max() <= bound
    assert np.abs(found.position_accel[0] - true[6:, 3:]).max() <= bound


def test_covariance_of_held_noise(biased):
    """Σ over samples of (σ²/h) G Gᵀ, G the result's derivative to the sample, by differences."""
    step = 0.05
    d = displaced(6 * N, step).reshape(-1, N, 6)
    found = estimation.preintegrate(GYRO + d[..., :3], ACCEL + d[..., 3:], H)
    theta = attitude_errors(biased.rotation[0], found.rotation)
    g = derivative(np.hstack([theta, found.velocity - biased.velocity[0], found.position]), step)
    weights = np.tile([SIGMA_G**2 / H] * 3 + [SIGMA_A**2 / H] * 3, N)
    true = g * weights @ g.T
    covariance = biased.covariance[0]
    scale = np.sqrt(np.outer(np.diag(true), np.diag(true)))
    assert (np.abs(covariance - true) <= 1e-9 * scale).all()
    assert (covariance == covariance.T).all()


def test_kernels_add_the_samples_of_a_log():
    state, moved = kernels.begin(1.0), (0.01, -0.02, 0.03)
    for gyro, accel in zip(GYRO.tolist(), ACCEL.tolist(), strict=True):
        state = kernels.add_sample(state, (*gyro,), (*accel,), H, SIGMA_G**2, SIGMA_A**2)
    whole = estimation.preintegrate(GYRO, ACCEL, H, **NOISE)
    assert np.abs(state.rotation.q - whole.rotation).max() <= 8 * EPS
    assert np.abs(np.subtract(state.p, whole.position)).max() <= 8 * EPS * N
    variances = np.diag(whole.covariance)[6:]
    assert np.allclose([state.pp[k] for k in (0, 3, 5)], variances, rtol=32 * EPS, atol=0.0)
    change = kernels.corrected(state, moved, moved)
    for found, expected in zip(change, whole.corrected(moved, moved), strict=True):
        assert np.abs(found - expected).max() <= 16 * EPS * N


def test_gyro_alone(biased):
    found = estimation.preintegrate(GYRO, None, H, gyro_noise=SIGMA_G)
    assert np.abs(found.rotation - biased.rotation[0]).max() <= 2 * EPS
    assert np.abs(found.rotation_gyro - biased.rotation_gyro[0]).max() <= 2 * EPS
    rotation = biased.covariance[0, :3, :3]
    assert np.abs(found.covariance[:3, :3] - rotation).max() <= 4 * EPS * rotation.max()
    for unknown in (found.velocity, found.position, found.velocity_gyro, found.covariance[3:]):
        assert np.isnan(unknown).all()
    q, v, p = found.corrected((0.01, 0.0, 0.0))
    assert np.isfinite(q).all()
    assert np.isnan([v, p]).all()


def test_prediction_and_correction():
    g = np.array([0.3, -0.2, -9.81])
    found = estimation.preintegrate(GYRO, ACCEL, H)
    q0 = np.array([0.1, -0.5, 0.7, 0.5])
    v0, p0 = np.array([1.0, 2.0, -1.0]), np.array([5.0, 0.0, 2.0])
    q, v, p = found.predict(q0, v0, p0, gravity=g)
    c, t = fa.quat_to_dcm(q0), N * H
    assert np.abs(q - fa.quat_multiply(q0, found.rotation)).max() <= 4 * EPS
    assert np.abs(v - (v0 + g * t + c @ found.velocity)).max() <= 16 * EPS
    assert np.abs(p - (p0 + v0 * t + g * t * t / 2 + c @ found.position)).max() <= 32 * EPS
    # corrected to first order: what is left falls with the square of the change
    left = []
    for size in (1e-2, 1e-3):
        bg, ba = size * np.array([1.0, -2.0, 1.0]), size * np.array([3.0, 1.0, -2.0])
        true = estimation.preintegrate(GYRO, ACCEL, H, gyro_bias=bg, accel_bias=ba)
        _, v, p = found.corrected(bg, ba)
        left.append(np.abs(np.hstack([v - true.velocity, p - true.position])).max())
        q, *_ = found.corrected(bg, ba)
        assert fa.angle_between(q, true.rotation) <= (4 * size * t) ** 2
    assert 80 <= left[0] / left[1] <= 125
    many = found.predict(np.tile(q0, (4, 1)), v0, p0)
    assert [x.shape for x in many] == [(4, 4), (4, 3), (4, 3)]


def for_gtsam(imu, *, tangent):
    """As the guide to filters has it."""
    angles, along_j = np.eye(3), np.eye(3)
    if tangent:
        angles = estimation.right_jacobian_inverse(fa.quat_to_rotation_vector(imu.rotation))
    else:
        along_j = fa.quat_to_dcm(imu.rotation).T
    errors = np.kron(np.diag([1.0, 0.0, 0.0]), angles) + np.kron(np.diag([0.0, 1.0, 1.0]), along_j)
    order = [0, 1, 2, 6, 7, 8, 3, 4, 5]
    return (errors @ imu.covariance @ errors.T)[np.ix_(order, order)]


@pytest.mark.parametrize("tangent", [True, False])
def test_the_guides_covariance_is_that_of_gtsams_errors(tangent):
    """Of 40 000 noisy logs that turn by 1.7 rad: (θ, p, v), or of errors along the axes at j.

    GTSAM's TangentPreintegration holds θ = log ΔR, Δp and Δv; NavState::localCoordinates, of which
    ManifoldPreintegration has the covariance, log(ΔRᵀ ΔR'), ΔRᵀ (Δp' − Δp), ΔRᵀ (Δv' − Δv).
    """
    n, samples, sigma_g, sigma_a = 40_000, 10, 1e-2, 1e-1
    gyro, accel = np.tile([2.0, -1.0, 2.6], (samples, 1)), np.tile([1.0, 5.0, 9.0], (samples, 1))
    known = estimation.preintegrate(gyro, accel, H, gyro_noise=sigma_g, accel_noise=sigma_a)
    chance = np.random.default_rng(0)
    noisy = estimation.preintegrate(
        gyro + sigma_g / H**0.5 * chance.normal(size=(n, samples, 3)),
        accel + sigma_a / H**0.5 * chance.normal(size=(n, samples, 3)),
        H,
    )
    way, speed = noisy.position - known.position, noisy.velocity - known.velocity
    if tangent:
        turn = fa.quat_to_rotation_vector(noisy.rotation)
    else:
        turn = estimation.attitude_error(known.rotation, noisy.rotation)
        way, speed = (x @ fa.quat_to_dcm(known.rotation) for x in (way, speed))
    found = np.cov(np.concatenate([turn, way, speed], axis=1).T)
    expected = for_gtsam(known, tangent=tangent)
    size = np.sqrt(np.diag(expected))
    # of a correlation five standard errors, and the second order of turns of 0.01 rad
    assert np.abs((found - expected) / np.outer(size, size)).max() < 5.0 * (2.0 / n) ** 0.5
    other = for_gtsam(known, tangent=not tangent)
    assert np.abs((found - other) / np.outer(size, size)).max() > 0.2
