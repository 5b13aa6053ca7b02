"""Kernels of rigid bodies against mpmath."""

from __future__ import annotations

import math

import mpmath as mp
import pytest
import rigid_oracle as ro
from oracle import (
    EPS,
    distance,
    error,
    floats,
    powers,
    quat_exp,
    quat_mul,
    quaternions,
    uniform,
    vec,
    vectors,
)

from fastatt.kernels import dcm, quat, rigid

N = 200
# a sum of three products of numbers of size 1, each rounded
PRODUCT = 4 * EPS


def triples(low, high, n=N, seed=0):
    return list(zip(*(uniform(low, high, n, seed + i) for i in range(3)), strict=True))


BODIES = triples(0.6, 1.0)
RATES = vectors(N, 5)


# Euler's equations


def test_momentum_and_energy():
    for i, w in zip(BODIES, RATES, strict=True):
        assert error(rigid.momentum(w, i), ro.momentum(i, vec(w))) <= EPS
        assert rigid.kinetic_energy(w, i) == pytest.approx(float(ro.kinetic_energy(i, vec(w))))


@pytest.mark.parametrize("gap", [0.3, 1e-3, 1e-9, 1e-15])
def test_gyroscopic_coefficients_do_not_cancel(gap):
    """Relative error of a few ulps however near the moments are."""
    for a in uniform(0.5, 2.0, N):
        i = (a, a * (1.0 + gap), a * (1.0 + 2.0 * gap))
        x = vec(i)
        exact = (1 / x[2] - 1 / x[1], 1 / x[0] - 1 / x[2], 1 / x[1] - 1 / x[0])
        for found, c in zip(rigid.gyroscopic_coefficients(i), exact, strict=True):
            assert abs(found - c) <= 3 * EPS * abs(c)


def test_gyroscopic_moment_and_acceleration():
    for i, w, torque in zip(BODIES, RATES, vectors(N, 6), strict=True):
        m = rigid.momentum(w, i)
        found = rigid.gyroscopic(m, rigid.gyroscopic_coefficients(i))
        assert distance(found, ro.cross(vec(m), vec(w))) <= PRODUCT * math.hypot(*m) * 3
        slope = ro.equations(i, lambda t, q, w, torque=torque: torque)
        exact = slope(0, (1, 0, 0, 0, *vec(w)))[4:]
        size = (math.hypot(*w) ** 2 + math.hypot(*torque)) / min(i)
        assert distance(rigid.acceleration(w, i, torque), exact) <= PRODUCT * size


def test_energy_of_a_symmetric_top_is_that_of_its_rates():
    """½ w·I w at the rates of 3-1-3 angles."""
    for angles, rates in zip(vectors(N, 7), vectors(N, 8), strict=True):
        w = ro.euler_rate(*vec(angles[1:]), *vec(rates))
        exact = ro.kinetic_energy((0.8, 0.8, 1.3), w)
        found = rigid.kinetic_energy_symmetric(angles, rates, (0.8, 1.3))
        assert found == pytest.approx(float(exact), rel=PRODUCT)


# torques


def test_damping():
    for w in RATES:
        linear = ro.linear_damping((0.1, 0.2, 0.3))(0, None, vec(w))
        assert error(rigid.damping(w, (0.1, 0.2, 0.3)), linear) <= PRODUCT
        quadratic = ro.quadratic_damping(0.7)(0, None, vec(w))
        assert error(rigid.quadratic_damping(w, 0.7), quadratic) <= PRODUCT
    assert rigid.quadratic_damping((0.0, 0.0, 0.0), 0.7) == (0.0, 0.0, 0.0)


def test_gravity_gradient():
    n = 0.5
    for q, i, t in zip(quaternions(N), BODIES, uniform(0.0, 100.0, N), strict=True):
        o = rigid.orbit_direction(t, n, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        assert distance(o, (mp.cos(n * mp.mpf(t)), mp.sin(n * mp.mpf(t)), 0)) <= PRODUCT
        found = rigid.gravity_gradient(quat.rotate_inverse(q, o), i, n)
        exact = ro.gravity_gradient(i, n)(mp.mpf(t), vec(q), None)
        assert distance(found, exact) <= 4 * PRODUCT


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_quaternion_feedback_turns_the_shorter_way(side):
    for q, target, w in zip(quaternions(N, 1), quaternions(N, 2), RATES, strict=True):
        e = rigid.target_error(target, tuple(side * c for c in q))
        found = rigid.quaternion_feedback(e, w, 1.2, 0.3)
        exact = ro.pd_control(1.2, 0.3, target)(0, vec(q), vec(w))
        assert distance(found, exact) <= 2 * PRODUCT


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exp_decay(sign):
    """(e^−x, (1 − e^−x)/x) to 2 ulps from the smallest number to e^700."""
    for x in [*powers(-320, 2.8, 2 * N), 1e-30, 0.99e-30, 5e-324]:
        x = mp.mpf(sign * x)
        decay, mean = rigid.exp_decay(float(x))
        assert abs(decay - mp.exp(-x)) <= 2 * EPS * mp.exp(-x)
        exact = -mp.expm1(-x) / x
        assert abs(mean - exact) <= 2 * EPS * exact
    assert rigid.exp_decay(0.0) == (1.0, 1.0)


# turns about one axis


@pytest.mark.parametrize(("name", "axis"), [("rotate_first", 0), ("rotate_third", 2)])
def test_turn_about_an_axis(name, axis):
    """q∘exp(θ e/2) and C exp(θ [e×]) from cosine and sine of half the angle."""
    for q, theta in zip(quaternions(N, 3), uniform(-10.0, 10.0, N), strict=True):
        u = [0.0, 0.0, 0.0]
        u[axis] = theta
        c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
        exact = quat_mul(vec(q), quat_exp(u))
        assert distance(getattr(quat, name)(q, c, s), exact) <= PRODUCT
        turned = getattr(dcm, name)(dcm.from_quat(q), c, s)
        assert distance(turned, dcm.from_quat(floats(exact))) <= 4 * PRODUCT


def test_mul_vector():
    for q, v in zip(quaternions(N, 4), RATES, strict=True):
        exact = quat_mul(vec(q), vec((0.0, *v)))
        assert distance(quat.mul_vector(q, v), exact) <= PRODUCT * math.hypot(*v)
