"""Direction cosine matrices against mpmath, and the axioms that they obey."""

import math
from itertools import permutations, product

import mpmath as mp
import numpy as np
import oracle as mo
import pytest

from fastatt.kernels import dcm

N = 300
ONE = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# one product of a rotation with a vector or a matrix rounds by less than this
PRODUCT = 4 * mo.EPS

regimes = pytest.mark.parametrize("regime", mo.REGIMES)


def matrices(regime, n=N, seed=0):
    """The direction cosine matrices of ``rotations``, to the last ulp."""
    return [mo.floats(mo.entries(mo.rodrigues(u))) for u in mo.rotations(regime, n, seed)]


# exponential and logarithm


@regimes
def test_exp(regime):
    for u in mo.rotations(regime, 1000):
        found, true = mo.vec(dcm.exp(u)), mo.vec(mo.entries(mo.rodrigues(u)))
        assert mo.error(found, true) <= 1e-15
        assert max(abs(c) for c in found - true) <= 1e-15
        if regime == "tiny":
            across = [1, 2, 3, 5, 6, 7]
            assert mo.error([found[i] for i in across], [true[i] for i in across]) <= 1e-15


@regimes
def test_exp_short_is_exp(regime):
    for u in mo.rotations(regime, N):
        inside = tuple(c * (1.0 - 2.0 * mo.EPS) for c in u)
        assert dcm.exp_short(inside) == dcm.exp(inside)


def test_nothing_is_lost_at_zero():
    assert dcm.exp((0.0, 0.0, 0.0)) == dcm.exp_short((0.0, 0.0, 0.0)) == ONE
    assert dcm.log(ONE) == (0.0, 0.0, 0.0)


def test_exp_beyond_pi():
    """As for quaternions, of which a matrix moves by √8 (Frobenius), and its own rounding.

    The reference goes by way of the quaternion: Rodrigues' series would need many digits.
    """
    for u in mo.rotation_vectors(mo.powers(math.log10(math.pi), 6, N)):
        allowed = 3e-15 + math.sqrt(8) * 0.75 * math.ulp(float(mo.norm(u)))
        assert mo.distance(dcm.exp(u), mo.entries(mo.quat_matrix(mo.quat_exp(u)))) <= allowed


@pytest.mark.parametrize("size", [1e16, 1e200, 1e308])
def test_exp_of_huge_angles(size):
    for u in mo.rotation_vectors([size] * 50):
        c = dcm.exp(u)
        assert mo.norm(mo.entries(mo.square(c) * mo.square(c).T - mp.eye(3))) <= 12 * mo.EPS
        axis = mo.vec(u) / mo.norm(u)
        assert mo.distance(mo.square(c) * axis, axis) <= 4 * PRODUCT


@regimes
def test_log(regime):
    """The matrix is rounded before: a relative 1e-15 of that and of the logarithm's own."""
    for u in mo.rotations(regime, 1000):
        c = mo.floats(mo.entries(mo.rodrigues(u)))
        assert mo.vector_error(dcm.log(c), u) <= 1e-15


# matrix and quaternion


@regimes
def test_from_quat(regime):
    for q in mo.attitudes(regime, N, 1):
        true = mo.vec(mo.entries(mo.quat_matrix(q)))
        assert max(abs(c) for c in mo.vec(dcm.from_quat(q)) - true) <= 1e-15


@pytest.mark.parametrize("e", [1e-3, -1e-3, 1e-5])
def test_from_quat_sees_the_square_of_an_error_of_length(e):
    for q in mo.quaternions(20):
        true = mo.quat_matrix(q)
        found = mo.square(dcm.from_quat(mo.floats((1 + e) * mo.vec(q))))
        scale = mo.norm(mo.entries(true - mp.eye(3)))
        assert mo.norm(mo.entries(found - true)) == pytest.approx(
            4 * e * e * float(scale), rel=0.01
        )


@pytest.mark.parametrize("branch", range(4))
def test_to_quat_in_every_branch(branch):
    """The row used is that of the largest component."""
    members = [q for q in mo.quaternions(4 * N, 2) if np.argmax(np.abs(q)) == branch]
    assert len(members) > N // 2
    for q in members:
        c = mo.floats(mo.entries(mo.quat_matrix(q)))
        found = dcm.to_quat(c)
        assert mo.attitude_error(found, mo.vec(q) / mo.norm(q)) <= 5e-16
        assert found[0] >= 0.0


@pytest.mark.parametrize("signs", list(product([1.0, -1.0], repeat=3)))
def test_to_quat_where_branches_meet(signs):
    for q in [(0.5, *(0.5 * s for s in signs)), *set(permutations((0.0, 0.0, *(0.6, 0.8))))]:
        q = (q[0], *(s * c for s, c in zip(signs, q[1:], strict=True)))
        assert mo.attitude_error(dcm.to_quat(mo.floats(mo.entries(mo.quat_matrix(q)))), q) <= 5e-16


@regimes
def test_to_quat(regime):
    for u in mo.rotations(regime, N, 5):
        found = dcm.to_quat(mo.floats(mo.entries(mo.rodrigues(u))))
        assert mo.attitude_error(found, mo.quat_exp(u)) <= 5e-16


def test_to_quat_of_half_turns():
    """C = 2 e eᵀ − 1: the skew part is zero and only the branches with a squared e work."""
    axes = [
        *mo.directions(N, 3),
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, -1.0),
        (0.6, 0.8, 0.0),
    ]
    for e in axes:
        e = mo.vec(e) / mo.norm(e)
        c = mo.floats(mo.entries(2 * e * e.T - mp.eye(3)))
        assert mo.attitude_error(dcm.to_quat(c), [0, *e]) <= 5e-16
        assert mo.vector_error(dcm.log(c), mp.pi * e) <= 1e-15


# products


def test_product_and_transpose():
    a, b = np.random.default_rng(1).normal(size=(2, 9)).tolist()
    exact = mo.square(a) * mo.square(b)
    assert mo.error(dcm.mul(tuple(a), tuple(b)), mo.entries(exact)) <= PRODUCT
    assert dcm.transpose(tuple(a)) == mo.floats(mo.entries(mo.square(a).T))
    assert dcm.mul(ONE, tuple(a)) == dcm.mul(tuple(a), ONE) == tuple(a)


@regimes
def test_rotate(regime):
    for c, v in zip(matrices(regime), mo.vectors(N, 8), strict=True):
        assert mo.error(dcm.rotate(c, v), mo.square(c) * mo.vec(v)) <= PRODUCT
        assert mo.error(dcm.rotate_inverse(c, v), mo.square(c).T * mo.vec(v)) <= PRODUCT


# kinematics


@regimes
def test_derivative_is_poisson_and_rate_inverts_it(regime):
    for c, w in zip(matrices(regime, seed=12), mo.vectors(N, 13, size=100.0), strict=True):
        assert (
            mo.error(dcm.derivative(c, w), mo.entries(mo.square(c) * mo.hat(mo.vec(w)))) <= PRODUCT
        )
        assert dcm.derivative_row(c[3:6], w) == dcm.derivative(c, w)[3:6]
        assert mo.error(dcm.rate(c, dcm.derivative(c, w)), w) <= 4 * PRODUCT


# orthogonality


def crooked(sizes, seed=0):
    """For each size e a rotation plus a symmetric error with a norm_error of about e."""
    s = np.random.default_rng(seed).normal(size=(3, 3))
    s = (s + s.T) / np.linalg.norm(s + s.T)
    c = mo.square(mo.entries(mo.rodrigues((0.4, -1.0, 2.0))))
    return c, [
        mo.floats(mo.entries((mp.eye(3) + mp.matrix(s.tolist()) * e / 2) * c)) for e in sizes
    ]


def test_gram_and_defect():
    for c in np.random.default_rng(2).normal(size=(N, 9)).tolist():
        exact = mo.square(c) * mo.square(c).T
        upper = [exact[i, j] for i in range(3) for j in range(i, 3)]
        assert mo.error(dcm.gram(tuple(c)), upper) <= PRODUCT
        true = mo.norm(mo.entries(exact - mp.eye(3)))
        assert abs(dcm.norm_error(tuple(c)) - true) <= PRODUCT * (1 + mo.norm(upper))
    assert dcm.norm_error(ONE) == 0.0


def test_orthonormalise_is_of_second_order():
    sizes = [1e-2, 1e-3, 1e-4, 1e-5]
    rotation, bent = crooked(sizes)
    left = [dcm.norm_error(dcm.orthonormalise(c)) for c in bent]
    assert mo.slope(sizes, left) == pytest.approx(2, abs=0.01)
    for c, after in zip(bent, left, strict=True):
        assert after <= 0.75 * dcm.norm_error(c) ** 2 * (1 + dcm.norm_error(c)) + PRODUCT
    # a symmetric error is taken out without a turn: the nearest rotation is the first one
    assert mo.distance(dcm.orthonormalise(bent[-1]), mo.entries(rotation)) <= 1e-10


def test_orthonormalise_rows_is_of_second_order():
    sizes = [1e-2, 1e-3, 1e-4, 1e-5]
    left = []
    for c in crooked(sizes, 1)[1]:
        a, b = dcm.orthonormalise_rows(c[:3], c[3:6])
        left.append(dcm.norm_error(dcm.close_rows(a, b)))
    assert mo.slope(sizes, left) == pytest.approx(2, abs=0.02)
    assert left[-1] < 1e-9


def test_orthonormalise_leaves_a_rotation():
    for c in matrices("uniform"):
        assert mo.distance(dcm.orthonormalise(c), c) <= 2 * PRODUCT
        a, b = dcm.orthonormalise_rows(c[:3], c[3:6])
        assert mo.distance(dcm.close_rows(a, b), c) <= 2 * PRODUCT


def test_close_rows():
    for c in matrices("uniform"):
        assert mo.distance(dcm.close_rows(c[:3], c[3:6]), c) <= PRODUCT
        assert dcm.close_rows(c[:3], c[3:6])[:6] == c[:6]
