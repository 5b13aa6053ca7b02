"""Jacobians of the exponential map against their definition by differences in mpmath."""

import math

import mpmath as mp
import oracle as mo
import pytest

from fastatt.kernels import so3, vec3

ANGLES = [0.0, 1e-300, 1e-160, 1e-8, 1e-4, 0.1, 1.0, 3.0, math.pi, 3.2, 4.0, 6.0, 6.28, 7.0, 100.0]

angles = pytest.mark.parametrize("theta", ANGLES)


def conditioning(theta):
    """How x cot x, x = θ/2, magnifies a relative error of θ, in relation to 1 − x cot x or 1."""
    x = max(0.5 * theta, 1e-300)
    return (1 + (x / math.sin(x)) ** 2) / max(1.0, abs(1 - x / math.tan(x)))


def phis(theta, n=10):
    return mo.rotation_vectors([theta] * n, seed=1)


# coefficients


def test_coefficients_up_to_pi():
    squares = [0.0, 1e-320, 1e-300, 1e-16, *mo.uniform(0, math.pi**2, 1000), math.pi**2]
    for z in squares:
        found = (*so3.jacobian_coefficients(z), so3.inverse_coefficient(z))
        true = (*mo.coefficients(z)[1:], mo.inverse_coefficient(z))
        for f, t in zip(found, true, strict=True):
            assert mo.error([f], [t]) <= 1e-15


def test_coefficients_beyond_pi():
    """(1 − cos θ)/θ² has zeros: its error is one of sin θ/2, by an ulp of θ/2."""
    for theta in mo.uniform(math.pi, 100, 300):
        z = theta * theta
        b, c = so3.jacobian_coefficients(z)
        _, b_true, c_true = mo.coefficients(z)
        assert abs(b - b_true) * z <= 2 * math.ulp(theta)
        assert mo.error([c], [c_true]) <= 1e-15
        k, k_true = so3.inverse_coefficient(z), mo.inverse_coefficient(z)
        allowed = 2 * mo.EPS * conditioning(theta) * max(1, abs(k_true * z))
        assert abs(k - k_true) * z <= allowed


# Jacobians


@angles
def test_jacobians(theta):
    for phi in phis(theta):
        true = mo.right_jacobian(phi)
        assert mo.error(so3.right_jacobian(phi), mo.entries(true)) <= 1e-15
        assert mo.error(so3.left_jacobian(phi), mo.entries(true.T)) <= 1e-15


@angles
def test_inverse_jacobians(theta):
    for phi in phis(theta):
        true = mp.inverse(mo.right_jacobian(phi))
        allowed = 1e-15 * conditioning(theta)
        assert mo.error(so3.right_jacobian_inverse(phi), mo.entries(true)) <= allowed
        assert mo.error(so3.left_jacobian_inverse(phi), mo.entries(true.T)) <= allowed


# the rotation vector's equation


@angles
def test_dexp_is_the_right_jacobian(theta):
    for phi, x in zip(phis(theta), mo.vectors(10, 2), strict=True):
        true = mo.right_jacobian(phi) * mo.vec(x)
        assert mo.distance(so3.dexp(phi, x), true) <= 2e-15 * mo.norm(x)


@angles
def test_dexpinv_inverts_dexp(theta):
    """Of the size of x times the norm of the inverse, which dexp's rounding meets."""
    for phi, x in zip(phis(theta), mo.vectors(10, 3), strict=True):
        inverse = mo.norm(so3.right_jacobian_inverse(phi))
        allowed = 2e-15 * conditioning(theta) * float(inverse * mo.norm(x))
        assert mo.distance(so3.dexpinv(phi, so3.dexp(phi, x)), x) <= allowed
        assert mo.distance(so3.dexp(phi, so3.dexpinv(phi, x)), x) <= allowed
        if theta < 3.1:
            assert so3.dexpinv_short(phi, x) == so3.dexpinv(phi, x)


# small parts


def test_hat_and_vee():
    for v, x in zip(mo.vectors(20, 5), mo.directions(20, 6), strict=True):
        assert so3.hat(v) == mo.floats(mo.entries(mo.hat(v)))
        assert so3.vee(so3.hat(v)) == v
        assert (
            mo.distance(mo.square(so3.hat(v)) * mo.vec(x), mo.cross(mo.vec(v), mo.vec(x))) <= 1e-45
        )
    assert so3.vee((9.0, -3.0, 2.0, 5.0, 9.0, -1.0, 4.0, 3.0, 9.0)) == (2.0, -1.0, 4.0)


def test_second_order():
    for v in mo.vectors(20, 7):
        assert (
            mo.error(so3.second_order(0.7, -0.3, v), mo.entries(mo.isotropic(0.7, -0.3, v)))
            <= 2 * mo.EPS
        )


def test_vec3():
    """Small whole numbers: every result is exact."""
    a, b, k = (1.0, -2.0, 3.0), (4.0, 7.0, -5.0), 6.0
    assert vec3.dot(a, b) == -25.0
    assert vec3.cross(a, b) == (-11.0, 17.0, 15.0)
    assert vec3.add(a, b) == (5.0, 5.0, -2.0)
    assert vec3.sub(a, b) == (-3.0, -9.0, 8.0)
    assert vec3.scale(k, a) == (6.0, -12.0, 18.0)
    assert vec3.axpy(k, a, b) == (10.0, -5.0, 13.0)
