"""Kernels of rigid bodies and of the Moser-Veselov step against mpmath and closed forms."""

from __future__ import annotations

import math

import mpmath as mp
import pytest
import rigid_oracle as ro
from oracle import (
    EPS,
    directions,
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
from fastatt.kernels import moser_veselov as mv

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


# the modified moments


def inverse_powers(level):
    """C and H of unit C of a turn about each axis, and what (1 + s)/I + d adds there.

    About a principal axis the step turns by arcsin of h m/K exactly: 1/K = sin θ/(θ I), with
    θ = h m/I, C = h²m²/2, H = C/I. Of sin θ/θ = Σ (−2C/I²)^n/(2n + 1)! the level n has its term.
    """
    return [
        (inertia, i, (-2 / mp.mpf(i) ** 2) ** level / mp.factorial(2 * level + 1) / mp.mpf(i))
        for inertia in BODIES
        for i in inertia
    ]


LEVELS = {
    1: (mv.coefficients2, mv.corrections2, 4),
    2: (mv.coefficients4, mv.corrections4, 6),
    3: (mv.coefficients6, mv.corrections6, 8),
    4: (mv.coefficients8, mv.corrections8, 10),
}


@pytest.mark.parametrize("level", LEVELS)
def test_corrections_of_a_turn_about_a_principal_axis(level):
    coefficients, corrections, count = LEVELS[level]
    for inertia, i, exact in inverse_powers(level):
        k = coefficients(inertia)
        assert len(k) == count
        s, d = corrections(1.0, 1.0 / i, k)
        size = max(abs(c) for c in k) * max(1.0, 1.0 / i**level) * count
        assert abs(s / i + d - exact) <= 20 * EPS * size


@pytest.mark.parametrize("level", LEVELS)
def test_corrections_are_homogeneous_and_symmetric(level):
    """Of degree n in C and H; the moments' order does not matter."""
    coefficients, corrections, _ = LEVELS[level]
    for inertia in BODIES[:20]:
        k = coefficients(inertia)
        one = corrections(0.3, 0.4, k)
        assert corrections(0.6, 0.8, k) == pytest.approx([2.0**level * c for c in one], rel=1e-13)
        for order in ((1, 2, 0), (1, 0, 2)):
            other = coefficients(tuple(inertia[i] for i in order))
            size = max(abs(c) for c in k)
            assert other == pytest.approx(k, rel=1e-11, abs=1e-12 * size)


# the implicit step


def solved(size):
    for inertia, u in zip(BODIES, directions(N, 9), strict=True):
        u = tuple(size * c for c in u)
        kappa = mv.asymmetry(mv.modified_inverse(inertia, 0.0, 0.0))
        yield u, kappa, *mv.solve(u, kappa)


def residual(u, kappa, c):
    c, u, kappa = vec(c), vec(u), vec(kappa)
    a = 1 + ro.dot(c, c)
    pairs = (c[1] * c[2], c[2] * c[0], c[0] * c[1])
    return [c[i] - a * u[i] - kappa[i] * pairs[i] for i in range(3)]


@pytest.mark.parametrize("size", [1e-150, 1e-6, 0.01, 0.05])
def test_solve(size):
    """c1 = (1 + |c|²) u1 + κ1 c2 c3, cyclic, to round-off for turns of up to 0.1 rad."""
    for u, kappa, c, change in solved(size):
        assert change < 1e-26
        assert float(mp.norm(mp.matrix(residual(u, kappa, c)))) <= 4 * EPS * math.hypot(*c)


@pytest.mark.parametrize("size", [0.6, 3.0])
def test_solve_says_where_there_is_no_solution(size):
    """c/(1 + |c|²) is at most ½."""
    for _, _, _, change in solved(size):
        assert not change < 1e-26


def test_rotation():
    for c in vectors(N, 10):
        r, inverse = mv.rotation(c)
        a = 1 + ro.dot(vec(c), vec(c))
        assert abs(inverse - 1 / a) <= PRODUCT * float(1 / a)
        assert distance(r, [x / mp.sqrt(a) for x in (1, *vec(c))]) <= PRODUCT


def test_step_keeps_momentum_and_energy():
    """Of the discrete equations: u + 2 κ c×c/(1 + |c|²) is the momentum seen from the new body."""
    for inertia, m in zip(BODIES, vectors(N, 11), strict=True):
        h = 0.05
        inverse = mv.modified_inverse(inertia, 0.0, 0.0)
        kappa = mv.asymmetry(inverse)
        u = tuple(0.5 * h * a * b for a, b in zip(inverse, m, strict=True))
        c, _ = mv.solve(u, kappa)
        r, share = mv.rotation(c)
        pairs = (c[1] * c[2], c[2] * c[0], c[0] * c[1])
        after = [u[i] + 2.0 * share * kappa[i] * pairs[i] for i in range(3)]
        m1 = [after[i] / (0.5 * h * inverse[i]) for i in range(3)]
        assert distance(quat.rotate_inverse(r, m), m1) <= 16 * EPS * math.hypot(*m)
        energy = [sum(x * x / i for x, i in zip(a, inertia, strict=True)) for a in (m, m1)]
        assert energy[1] == pytest.approx(energy[0], rel=32 * EPS)
