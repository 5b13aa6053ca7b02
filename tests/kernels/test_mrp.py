"""Modified Rodrigues parameters against quaternions in many digits."""

import math

import mpmath as mp
import numpy as np
import pytest
from oracle import (
    EPS,
    attitude_error,
    directions,
    distance,
    norm,
    quat_mul,
    quaternions,
    vec,
    vectors,
)

from fastatt.kernels import mrp

N = 300
QUATERNIONS = [*quaternions(N), (1.0, 0.0, 0.0, 0.0), (0.0, 0.6, 0.0, -0.8), (-1.0, 0.0, 0.0, 0.0)]
PARAMETERS = [
    tuple(size * c for c in e)
    for e, size in zip(directions(N), np.geomspace(1e-8, 1e8, N).tolist(), strict=True)
]


def quaternion(x):
    """((1 − σ²), 2σ)/(1 + σ²), of the floats as they are."""
    s = vec(x)
    z = mp.fdot(s, s)
    return mp.matrix([(1 - z) / (1 + z), *(2 * c / (1 + z) for c in s)])


def test_quaternion_of_parameters():
    for x in PARAMETERS:
        assert distance(mrp.to_quat(x), quaternion(x)) <= 4 * EPS


@pytest.mark.parametrize("size", [1e153, 1e154, 1e155, 1e200, 1e308])
def test_quaternion_of_parameters_whose_squares_overflow(size):
    for x in ((size, 0.0, 0.0), (0.3 * size, -0.7 * size, 0.2 * size), (1.0, size, 1e-300)):
        found, true = mrp.to_quat(x), quaternion(x)
        for a, b in zip(found, true, strict=True):
            # relative, but for what is below the smallest normal number
            assert abs(a - b) <= 4 * EPS * abs(b) + 5e-324


def test_parameters_of_a_quaternion():
    """Of the two, those of at most half a turn."""
    for q in QUATERNIONS:
        x = mrp.from_quat(q)
        assert norm(vec(x)) <= 1.0 + 4 * EPS
        assert attitude_error(quaternion(x), vec(q) / norm(vec(q))) <= 8 * EPS


def test_the_inner_set_is_the_same_attitude():
    for x in PARAMETERS:
        found = mrp.inner(x)
        assert norm(vec(found)) <= 1.0 + 4 * EPS
        assert attitude_error(quaternion(found), quaternion(x)) <= 8 * EPS
        if norm(vec(x)) <= 1.0:
            assert found == x


def test_derivative_is_that_of_the_quaternion():
    """q̇ = ½ q∘w by the chain rule, at |σ| from 1e-8 to 1e8."""
    h = mp.mpf(10) ** -20
    for x, w in zip(PARAMETERS, vectors(N, 3), strict=True):
        found = mrp.derivative(x, w)
        s = vec(x)
        moved = [quaternion(s + sign * h * vec(found)) for sign in (1, -1)]
        slope = (moved[0] - moved[1]) / (2 * h)
        wanted = quat_mul(quaternion(x), vec([0.0, *w])) / 2
        # a change of σ is one of the attitude 4/(1 + σ²) times as large
        assert distance(slope, wanted) <= 8 * EPS * norm(vec(w))
        assert mrp.half_derivative(x, tuple(0.5 * c for c in w)) == found


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_not_finite(bad):
    assert np.isnan(mrp.to_quat((0.1, bad, 0.2))).any()
    assert not np.isfinite(mrp.derivative((0.1, bad, 0.2), (1.0, 1.0, 1.0))).all()
