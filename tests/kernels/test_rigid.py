"""Kernels of rigid bodies against mpmath."""

import math

import mpmath as mp
import oracle as mo
import pytest
import rigid_oracle as ro

from fastatt.kernels import dcm, quat, rigid

N = 200
# a sum of three products of numbers of size 1, each rounded
PRODUCT = 4 * mo.EPS


def triples(low, high, n=N, seed=0):
    return list(zip(*(mo.uniform(low, high, n, seed + i) for i in range(3)), strict=True))


BODIES = triples(0.6, 1.0)
RATES = mo.vectors(N, 5)


# Euler's equations


def test_momentum_and_energy():
    for i, w in zip(BODIES, RATES, strict=True):
        assert mo.error(rigid.momentum(w, i), ro.momentum(i, mo.vec(w))) <= mo.EPS
        assert rigid.kinetic_energy(w, i) == pytest.approx(float(ro.kinetic_energy(i, mo.vec(w))))


@pytest.mark.parametrize("gap", [0.3, 1e-3, 1e-9, 1e-15])
def test_gyroscopic_coefficients_do_not_cancel(gap):
    """Relative error of a few ulps however near the moments are."""
    for a in mo.uniform(0.5, 2.0, N):
        i = (a, a * (1.0 + gap), a * (1.0 + 2.0 * gap))
        x = mo.vec(i)
        exact = (1 / x[2] - 1 / x[1], 1 / x[0] - 1 / x[2], 1 / x[1] - 1 / x[0])
        for found, c in zip(rigid.gyroscopic_coefficients(i), exact, strict=True):
            assert abs(found - c) <= 3 * mo.EPS * abs(c)


def test_gyroscopic_moment_and_acceleration():
    for i, w, torque in zip(BODIES, RATES, mo.vectors(N, 6), strict=True):
        m = rigid.momentum(w, i)
        found = rigid.gyroscopic(m, rigid.gyroscopic_coefficients(i))
        assert mo.distance(found, ro.cross(mo.vec(m), mo.vec(w))) <= PRODUCT * math.hypot(*m) * 3
        slope = ro.equations(i, lambda t, q, w, torque=torque: torque)
        exact = slope(0, (1, 0, 0, 0, *mo.vec(w)))[4:]
        size = (math.hypot(*w) ** 2 + math.hypot(*torque)) / min(i)
        assert mo.distance(rigid.acceleration(w, i, torque), exact) <= PRODUCT * size


def test_energy_of_a_symmetric_top_is_that_of_its_rates():
    """½ w·I w at the rates of 3-1-3 angles."""
    for angles, rates in zip(mo.vectors(N, 7), mo.vectors(N, 8), strict=True):
        w = mo.euler313_rate(angles, rates)
        exact = ro.kinetic_energy((0.8, 0.8, 1.3), w)
        found = rigid.kinetic_energy_symmetric(angles, rates, (0.8, 1.3))
        assert found == pytest.approx(float(exact), rel=PRODUCT)


# torques


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exp_decay(sign):
    """(e^−x, (1 − e^−x)/x) to 2 ulps from the smallest number to e^700."""
    for x in [*mo.powers(-320, 2.8, 2 * N), 1e-30, 0.99e-30, 5e-324]:
        x = mp.mpf(sign * x)
        decay, mean = rigid.exp_decay(float(x))
        assert abs(decay - mp.exp(-x)) <= 2 * mo.EPS * mp.exp(-x)
        exact = -mp.expm1(-x) / x
        assert abs(mean - exact) <= 2 * mo.EPS * exact
    assert rigid.exp_decay(0.0) == (1.0, 1.0)


# turns about one axis


@pytest.mark.parametrize(("name", "axis"), [("rotate_first", 0), ("rotate_third", 2)])
def test_turn_about_an_axis(name, axis):
    """q∘exp(θ e/2) and C exp(θ [e×]) from cosine and sine of half the angle."""
    for q, theta in zip(mo.quaternions(N, 3), mo.uniform(-10.0, 10.0, N), strict=True):
        u = [0.0, 0.0, 0.0]
        u[axis] = theta
        c, s = math.cos(0.5 * theta), math.sin(0.5 * theta)
        exact = mo.quat_mul(mo.vec(q), mo.quat_exp(u))
        assert mo.distance(getattr(quat, name)(q, c, s), exact) <= PRODUCT
        turned = getattr(dcm, name)(dcm.from_quat(q), c, s)
        assert mo.distance(turned, dcm.from_quat(mo.floats(exact))) <= 4 * PRODUCT


def test_mul_vector():
    for q, v in zip(mo.quaternions(N, 4), RATES, strict=True):
        exact = mo.quat_mul(mo.vec(q), mo.vec((0.0, *v)))
        assert mo.distance(quat.mul_vector(q, v), exact) <= PRODUCT * math.hypot(*v)
