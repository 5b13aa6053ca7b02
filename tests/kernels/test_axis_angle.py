"""Angular velocity of a moving axis and angle, against the derivative of their quaternion."""

import math

import mpmath as mp
import numpy as np
import pytest
from oracle import EPS, cross, directions, distance, floats, norm, quat_conj, quat_mul, vec, vectors

from fastatt.kernels import so3

N = 200
ANGLES = np.random.default_rng(6).uniform(-6.0, 6.0, N).tolist()


def axis(t):
    """A unit vector that moves."""
    e = mp.matrix([mp.cos(t) + mp.mpf(0.3), mp.sin(2 * t), 1 - t / 2])
    return e / norm(e)


def angle(t):
    return mp.mpf(0.4) + 2 * t - t**3 / 3


def attitude(t):
    """The quaternion (cos φ/2, e sin φ/2) of the motion above."""
    return mp.matrix([mp.cos(angle(t) / 2), *(mp.sin(angle(t) / 2) * axis(t))])


def difference(f, t, h=mp.mpf(10) ** -15):
    """Central difference, error 1e-30."""
    return (f(t + h) - f(t - h)) / (2 * h)


def tangents(n=N, seed=0):
    """Unit vectors e with a derivative ė ⊥ e, floats, so to an ulp."""
    for e, x in zip(directions(n, seed), vectors(n, seed + 1), strict=True):
        e = vec(e) / norm(e)
        yield floats(e), floats(cross(e, vec(x)))


@pytest.mark.parametrize("t", np.linspace(-1.5, 2.5, 17).tolist())
def test_rate(t):
    t = mp.mpf(t)
    motion = (axis(t), difference(axis, t), angle(t), difference(angle, t))
    e, edot = floats(motion[0]), floats(motion[1])
    phi, phidot = float(motion[2]), float(motion[3])
    q, qdot = attitude(t), difference(attitude, t)
    # e, ė, φ and φ̇ were rounded, each by half an ulp
    allowed = 4 * EPS * (abs(phidot) + norm(edot) * (2 + abs(phi)))
    inertial = 2 * quat_mul(qdot, quat_conj(q))
    assert distance(so3.axis_angle_rate(e, edot, phi, phidot), inertial[1:]) <= allowed
    body = 2 * quat_mul(quat_conj(q), qdot)
    opposite = so3.axis_angle_rate(e, edot, -phi, -phidot)
    assert distance([-c for c in opposite], body[1:]) <= allowed


def test_rate_of_a_small_angle_keeps_the_second_part():
    """(1 − cos φ) e×ė, lost below 1e-8 when written so, is still right to an ulp."""
    w = so3.axis_angle_rate((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), 1e-9, 0.0)
    assert w == pytest.approx((0.0, 1e-9, 5e-19), rel=2 * EPS, abs=0)


def test_derivative_inverts_rate():
    """cot φ/2 magnifies the rounding by 1/|sin φ/2|."""
    for (e, edot), phi, (phidot, _, _) in zip(tangents(), ANGLES, vectors(N, 3), strict=True):
        found, dot = so3.axis_angle_derivative(e, phi, so3.axis_angle_rate(e, edot, phi, phidot))
        allowed = 8 * EPS * (abs(phidot) + norm(edot)) / abs(math.sin(phi / 2))
        assert distance(found, edot) <= allowed
        assert abs(dot - phidot) <= 8 * EPS * (abs(phidot) + norm(edot))


def test_derivative_has_no_value_at_zero_angle():
    edot, phidot = so3.axis_angle_derivative((1.0, 0.0, 0.0), 0.0, (0.1, 0.2, 0.3))
    assert not np.isfinite(edot).all()
    assert phidot == 0.1
    # the float next to 2π is 2.4e-16 short of it
    edot, _ = so3.axis_angle_derivative((1.0, 0.0, 0.0), 2 * math.pi, (0.0, 1.0, 0.0))
    assert norm(edot) > 1e15
