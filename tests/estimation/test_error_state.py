"""Transition, noise and covariance of attitude and gyro bias against definitions in mpmath."""

import math

import mpmath as mp
import numpy as np
import pytest
from each import each
from oracle import EPS, hat, vec

import fastatt as fa
from fastatt import estimation
from fastatt.kernels import error_state, so3

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
# to both sides of 2π, where Jr⁻¹ is singular and nothing here is
ANGLES = [0.0, 1e-300, 1e-8, 1e-3, 0.7, 3.1, 3.2, 2 * math.pi - 1e-6, 2 * math.pi + 1e-6, 9.0]
H = 0.375
SIGMA_V, SIGMA_U = 0.3, 0.2


def rate(theta):
    return AXIS * theta / H


def turn(w):
    return tuple(H * c for c in w.tolist())


def exact(w):
    """(Φ, Q) of δθ̇ = −ω×δθ − δb − n_v, ḃ = n_u by one matrix exponential (Van Loan 1978)."""
    a = mp.zeros(6)
    a[0:3, 0:3] = -hat(vec(w))
    for i in range(3):
        a[i, i + 3] = -1
    q = mp.diag([mp.mpf(SIGMA_V) ** 2] * 3 + [mp.mpf(SIGMA_U) ** 2] * 3)
    big = mp.zeros(12)
    big[0:6, 0:6] = -a
    big[0:6, 6:12] = q
    big[6:12, 6:12] = a.T
    e = mp.expm(big * mp.mpf(H), method="taylor")
    phi = e[6:12, 6:12].T
    return phi, phi * e[0:6, 6:12]


def full(numbers):
    return np.array(numbers).reshape(6, 6)


def gap(found, true, rows, columns):
    """Largest difference of a block, in relation to the largest element of the true one."""
    block = [(i, j) for i in rows for j in columns]
    size = max(abs(true[i, j]) for i, j in block)
    return float(max(abs(mp.mpf(float(found[i, j])) - true[i, j]) for i, j in block) / size)


@each("theta", ANGLES)
def test_transition_and_noise(theta):
    w = rate(theta)
    u = turn(w)
    phi, q = exact(w)
    first, second = range(3), range(3, 6)
    found = full(error_state.transition_matrix(error_state.transition(u, H)))
    # an ulp of each u = ωh turns the matrix by an ulp of θ
    bound = 4 * EPS * (1 + theta)
    assert gap(found, phi, first, first) <= bound
    assert gap(found, phi, first, second) <= bound
    assert (found[3:] == np.eye(6)[3:]).all()
    found = full(error_state.matrix(error_state.noise(u, H, SIGMA_V**2, SIGMA_U**2)))
    for rows, columns in ((first, first), (first, second), (second, second)):
        assert gap(found, q, rows, columns) <= bound
    # the bias's share of Q11 alone
    bias = full(error_state.matrix(error_state.noise(u, H, 0.0, SIGMA_U**2)))
    alone = q - mp.diag([mp.mpf(SIGMA_V) ** 2 * mp.mpf(H)] * 3 + [0] * 3)
    assert gap(bias, alone, first, first) <= bound


def test_at_rest_is_farrenkopf_and_short_by_the_stated_shares():
    still = error_state.matrix(error_state.noise((0.0, 0.0, 0.0), H, SIGMA_V**2, SIGMA_U**2))
    rest = error_state.matrix(error_state.noise_at_rest(H, SIGMA_V**2, SIGMA_U**2))
    assert np.abs(np.subtract(still, rest)).max() <= 2 * EPS * max(still)
    theta = 0.01
    q = full(error_state.matrix(error_state.noise(turn(rate(theta)), H, 0.0, 1.0)))
    r = full(error_state.matrix(error_state.noise_at_rest(H, 0.0, 1.0)))
    norm = lambda a: np.linalg.norm(a, 2)  # noqa: E731
    # of an axis across the turn; the next terms are smaller by θ²
    assert norm((q - r)[:3, :3]) / norm(r[:3, :3]) == pytest.approx(theta**2 / 20, rel=1e-3)
    assert norm((q - r)[:3, 3:]) / norm(r[:3, 3:]) == pytest.approx(theta / 3, rel=1e-3)


def covariance(seed=0):
    a = np.random.default_rng(seed).normal(size=(6, 6))
    return a @ a.T


def test_predict_is_the_matrix_product():
    w = rate(1.3)
    p = covariance()
    phi = estimation.transition_matrix(w, H)
    q = estimation.process_noise(w, H, angle_noise=SIGMA_V, bias_noise=SIGMA_U)
    true = phi @ p @ phi.T + q
    found = estimation.predict_covariance(p, w, H, angle_noise=SIGMA_V, bias_noise=SIGMA_U)
    assert np.abs(found - true).max() <= 16 * EPS * np.abs(true).max()
    assert (found == found.T).all()


def test_inertial_axes():
    q = np.array([0.1, -0.5, 0.7, 0.5])
    c = fa.quat_to_dcm(q)
    p = covariance(1)
    g = np.kron(np.diag([1.0, 0.0]), c) + np.kron(np.diag([0.0, 1.0]), np.eye(3))
    found = estimation.covariance_to_inertial(p, q)
    assert np.abs(found - g @ p @ g.T).max() <= 16 * EPS * np.abs(p).max()
    back = estimation.covariance_to_body(found, q)
    assert np.abs(back - p).max() <= 32 * EPS * np.abs(p).max()
    # the same rotation: C exp(δθ) = exp(C δθ) C
    d = np.array([0.2, -0.1, 0.3])
    body = fa.quat_multiply(q, fa.rotation_vector_to_quat(d))
    space = fa.quat_multiply(fa.rotation_vector_to_quat(c @ d), q)
    assert fa.angle_between(body, space) <= 4 * EPS


def test_rows_are_the_kernels():
    generator = np.random.default_rng(3)
    w = generator.normal(size=(5, 3))
    noise = {"angle_noise": SIGMA_V, "bias_noise": SIGMA_U}
    u = H * w
    for found, kernel in (
        (estimation.right_jacobian(u), so3.right_jacobian),
        (estimation.left_jacobian(u), so3.left_jacobian),
        (estimation.right_jacobian_inverse(u), so3.right_jacobian_inverse),
        (estimation.left_jacobian_inverse(u), so3.left_jacobian_inverse),
    ):
        true = [np.reshape(kernel(tuple(x)), (3, 3)) for x in u]
        assert np.abs(found - true).max() <= 2 * EPS
    inverse = estimation.right_jacobian(u) @ estimation.right_jacobian_inverse(u)
    assert np.abs(inverse - np.eye(3)).max() <= 8 * EPS
    p = np.array([covariance(k) for k in range(5)])
    many = estimation.predict_covariance(p, w, H, **noise)
    for k in range(5):
        one = estimation.predict_covariance(p[k], w[k], H, **noise)
        assert one.shape == (6, 6)
        assert (one == many[k]).all()
    assert estimation.transition_matrix(w, H).shape == (5, 6, 6)
    assert estimation.covariance_to_inertial(p, [1, 0, 0, 0]).shape == (5, 6, 6)
