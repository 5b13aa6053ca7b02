"""Rotation over an interval from rates or increments: exactness, coefficients and order."""

import mpmath as mp
import numpy as np
import pytest
from each import each
from oracle import (
    EPS,
    attitude,
    cross,
    distance,
    error,
    floats,
    norm,
    polynomial,
    pure,
    quat_angle,
    quat_conj,
    quat_exp,
    quat_mul,
    slope,
    uniform,
    vec,
    vectors,
)

from fastatt.kernels import coning

SETS = 30
VECTORS = {
    2: coning.rotation_vector_linear,
    3: coning.rotation_vector_quadratic,
}

terms = pytest.mark.parametrize("terms", VECTORS)


def value(coefficients, t):
    return vec(polynomial(*coefficients)(mp.mpf(t)))


def integral(coefficients, t0, t1):
    """∫ of the polynomial from t0 to t1."""
    t0, t1 = mp.mpf(t0), mp.mpf(t1)
    parts = ((t1 ** (n + 1) - t0 ** (n + 1)) / (n + 1) * vec(c) for n, c in enumerate(coefficients))
    return sum(parts, mp.matrix(3, 1))


def fitted(found, true, total):
    """Coefficients within the rounding of the data, which divided differences magnify.

    Times are of order one: each of at most two differences divides by 0.5 or more, so a
    rounding of the data grows at most (2/0.5)² = 16 times, and to a rate once more by 2.
    """
    size = max(norm(c) * mp.mpf(total) ** n for n, c in enumerate(true))
    for f, t in zip(found, true, strict=True):
        assert distance(f, t) <= 128 * EPS * size


@each("seed", range(SETS))
def test_rates_fits_reproduce_polynomials(seed):
    t1, t2 = np.cumsum(uniform(0.5, 2.0, 2, seed)).tolist()
    parabola = vectors(3, seed)
    w = [floats(value(parabola, t)) for t in (0, t1, t2)]
    fitted(coning.rates_quadratic(*w, t1, t2), parabola, t2)


@each("seed", range(SETS))
def test_increments_fits_reproduce_polynomials(seed):
    h1, h2 = uniform(0.5, 2.0, 2, seed)
    line = vectors(2, seed)
    before, now = floats(integral(line, -h1, 0)), floats(integral(line, 0, h2))
    fitted(coning.increments_linear(before, now, h1, h2), line, h1 + h2)


# coefficients, as published for equal intervals


def compensated(increments, weights):
    """Σθ + Σ weight θi×θj."""
    total = sum((vec(i) for i in increments), mp.matrix(3, 1))
    for (i, j), weight in weights.items():
        total += mp.mpf(weight[0]) / weight[1] * cross(vec(increments[i]), vec(increments[j]))
    return total


@pytest.mark.parametrize("h", [1.0, 0.01, 1e3])
def test_published_coefficients(h):
    for seed in range(SETS):
        i, j = vectors(2, seed)
        a, b = coning.increments_linear(i, j, h, h)
        found = coning.rotation_vector_linear(a, b, h)
        assert error(found, vec(j) + cross(vec(i), vec(j)) / 12) <= 32 * EPS
        # the same line from the start of the first interval
        start = tuple(x - h * y for x, y in zip(a, b, strict=True))
        found = coning.rotation_vector_linear(start, b, 2.0 * h)
        assert error(found, compensated([i, j], {(0, 1): (2, 3)})) <= 32 * EPS


# rotation vector


@terms
@pytest.mark.parametrize("seed", range(3))
def test_rotation_vector_has_a_local_error_of_order_five(terms, seed):
    c = vectors(terms, seed)
    times = [0.08, 0.04, 0.02, 0.01]
    errors = []
    for t in times:
        found = quat_exp(VECTORS[terms](*c, t))
        # 16 terms are as good as 40, to 1e-27
        errors.append(quat_angle(found, attitude(polynomial(*c), 0, t, order=16)))
    assert slope(times, errors) == pytest.approx(5, abs=0.1)
    assert errors[-1] > 1e-14


@pytest.mark.parametrize("steps", [1, 3])
def test_reference_attitude_of_a_coning_body(steps):
    """q = exp(αt e3)∘q1∘exp(βt e3): w is β e3 + α q*∘e3∘q (body), α e3 + β q∘e3∘q* (space)."""
    alpha, beta, start = mp.mpf(1.25), mp.mpf(-0.5), quat_exp((0.5, 0.3, -0.2))

    def q(t):
        left, right = quat_exp((0, 0, alpha * t)), quat_exp((0, 0, beta * t))
        return quat_mul(quat_mul(left, start), right)

    def body(t):
        spun = quat_mul(quat_mul(quat_conj(q(t)), pure((0, 0, 1))), q(t))
        return [alpha * spun[1], alpha * spun[2], alpha * spun[3] + beta]

    def inertial(t):
        spun = quat_mul(quat_mul(q(t), pure((0, 0, 1))), quat_conj(q(t)))
        return [beta * spun[1], beta * spun[2], beta * spun[3] + alpha]

    assert distance(attitude(body, 0, 1, q(0), steps=steps), q(1)) <= 1e-30
    assert distance(attitude(inertial, 0, 1, q(0), steps=steps, inertial=True), q(1)) <= 1e-30
