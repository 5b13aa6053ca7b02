"""Measurements that are angles, and vectors of other units than their references."""

import math

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt import estimation

VARIANCE = 0.02**2


def heading(q, y):
    """Of the first body axis, in (−π, π], rad."""
    ahead = fa.quat_rotate(q, (1.0, 0.0, 0.0))
    return np.arctan2(ahead[:, 1], ahead[:, 0])[:, None]


def both(q, y):
    """A heading in degrees, and a number that is no angle."""
    return np.concatenate([np.degrees(heading(q, y)), 100.0 + y[:, :1]], axis=1)


def updated(yaw, observe, noise, period, measured):
    q = fa.rotation_vector_to_quat([0.0, 0.0, yaw])
    ukf = estimation.UKF(q, np.zeros(3), np.diag([1e-6, 1e-6, 0.05**2, 1e-8, 1e-8, 1e-8]))
    nis = ukf.update(observe, measured, noise, period=period)
    back = fa.quat_multiply(np.asarray(q) * (1, -1, -1, -1), ukf.q)
    return fa.quat_to_rotation_vector(back)[2], math.sqrt(ukf.covariance[2, 2]), nis


@each("yaw", np.radians([0.0, 90.0, 170.0, 177.0, 179.9, 180.0, -179.9, -177.0]))
def test_a_heading_is_corrected_alike_everywhere(yaw):
    """By a Kalman filter of one angle: gain P/(P + R)."""
    seen = math.remainder(yaw + 0.01, 2.0 * math.pi)
    gain = 0.05**2 / (0.05**2 + VARIANCE)
    found = updated(yaw, heading, [[VARIANCE]], 2.0 * math.pi, [seen])
    np.testing.assert_allclose(found[0], 0.01 * gain, rtol=1e-4)
    np.testing.assert_allclose(found[1], math.sqrt((1.0 - gain) * 0.05**2), rtol=1e-4)
    np.testing.assert_allclose(found[2], 0.01**2 / (0.05**2 + VARIANCE), rtol=1e-4)
    noise = np.diag([math.degrees(0.02) ** 2, 1.0])
    other = updated(yaw, both, noise, (360.0, math.inf), [math.degrees(seen), 100.0])
    np.testing.assert_allclose(other, found, rtol=1e-6)


@each("filtered", ("MEKF", "UKF"))
@each("scale", (2.1, 47.0, 1.0 / 47.0, 0.4))
def test_vectors_in_another_unit_than_their_references(filtered, scale):
    q = [[1.0, 0.0, 0.0, 0.0]] * 2
    if filtered == "UKF":
        made = estimation.UKF(q, np.zeros((2, 3)), np.eye(6) * 1e-4)
    else:
        made = estimation.MEKF(q, np.eye(6) * 1e-4, angle_noise=1e-4, bias_noise=1e-6)
    reference = np.array([0.45, 0.0, 0.893])
    made.update_vector([reference] * 2, reference, 0.02)
    made.update_vector([1.9 * reference] * 2, reference, 0.02)
    with pytest.warns(RuntimeWarning, match=r"measured: found a vector of length .* \(filter 1\)"):
        made.update_vector([reference, scale * reference], reference, 0.02)
