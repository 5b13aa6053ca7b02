"""Attitude and gyro bias from a rest: right to their covariance, refused where there is none."""

from __future__ import annotations

import numpy as np
import pytest

import fastatt as fa
from fastatt import estimation as es

UP, FIELD = np.array([0.0, 0.0, 1.0]), np.array([0.0, 20.0, -45.0])
BIAS = np.array([3e-3, -2e-3, 1e-3])
N = 400
SIGMA = np.array([2e-3, 1e-2])


def rest(q, rng, *, tilts=True):
    """Samples at rest; the means of the directions are off by SIGMA too."""
    q = q / np.linalg.norm(q)
    out = [BIAS + rng.normal(0.0, 2e-3, (N, 3))]
    for along, size, sigma, noise in ((UP, 9.81, SIGMA[0], 0.05), (FIELD, 1.0, SIGMA[1], 0.5)):
        b = size * fa.quat_rotate_inverse(q, along)
        off = np.cross(rng.normal(0.0, sigma, 3), b) if tilts else 0.0
        out.append(b + off + rng.normal(0.0, noise, (N, 3)))
    return out


def test_errors_are_those_of_the_covariance():
    """δᵀ P⁻¹ δ of (δθ, δb) has the mean 6 and the variance 12: 5 deviations of 50 runs' mean."""
    rng, squares = np.random.default_rng(0), []
    for q in rng.normal(size=(50, 4)):
        found = es.static_start(*rest(q, rng), field=FIELD, sigma=SIGMA)
        d = np.concatenate([es.attitude_error(found.q, q / np.linalg.norm(q)), BIAS - found.bias])
        squares.append(d @ np.linalg.solve(found.covariance, d))
        assert abs(found.gravity - 9.81) < 5 * 0.05 / np.sqrt(N) + 9.81 * 1e-4
    assert abs(np.mean(squares) - 6.0) < 5.0 * np.sqrt(12.0 / 50.0)


@pytest.mark.parametrize(
    "q", [[1, 0, 0, 0], [0.3, -0.5, 0.7, 0.1], [0, 1, 0, 0], [1e-12, 1, 1, 0]],
    ids=["level", "any", "upside down", "nearly so"],
)  # fmt: skip
def test_without_a_magnetometer_the_heading_is_free(q):
    """Up is where it was seen; the turn is about a level axis."""
    gyro, accel, _ = rest(np.array(q, dtype=float), np.random.default_rng(1), tilts=False)
    found = es.static_start(gyro, accel, sigma=1e-3)
    mean = accel.mean(axis=0) / np.linalg.norm(accel.mean(axis=0))
    assert np.abs(fa.quat_rotate(found.q, mean) - UP).max() < 1e-15 * 4
    assert abs(found.q[3]) < 1e-15
    values = np.sqrt(np.linalg.eigvalsh(found.covariance[:3, :3]))
    assert values == pytest.approx([np.hypot(1e-3, 0.05 / 9.81 / 20.0)] * 2 + [np.pi], rel=0.1)
    # north, east and down: up is −z
    down = es.static_start(gyro, accel, sigma=1e-3, up=(0.0, 0.0, -1.0))
    assert np.abs(fa.quat_rotate(down.q, mean) + UP).max() < 1e-15 * 4


def changed(**parts):
    gyro, accel, mag = rest(np.array([1.0, 0.0, 0.0, 0.0]), np.random.default_rng(2))
    given = {"gyro": gyro, "accel": accel, "mag": mag, "field": FIELD, "sigma": SIGMA}
    return es.static_start(**(given | {k: f(given[k]) for k, f in parts.items()}))


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (
            {"gyro": lambda x: x + np.array([0.0, 0.0, 0.3])},
            "gyro: has a mean of 0.301 rad/s; accepted",
        ),
        (
            {"gyro": lambda x: x + np.linspace([-0.03] * 3, [0.03] * 3, N)},
            "gyro: quarters of the samples differ by 0.03",
        ),
        (
            {"accel": lambda x: x + np.linspace([-0.5, 0, 0], [0.5, 0, 0], N)},
            "accel: quarters of the samples differ",
        ),
        ({"accel": lambda x: x - x.mean(axis=0)}, "accel: has no mean above its noise"),
        ({"accel": lambda x: x[1:]}, "accel: found 399 samples; accepted: 400, as gyro"),
        ({"gyro": lambda x: x[:7]}, "gyro: found 7 samples; accepted: at least 8"),
        ({"mag": lambda x: None}, "field: found without mag"),
        ({"field": lambda x: [0.0, 45.0, -20.0]}, "mag: lies 0.725 rad otherwise to accel"),
        ({"sigma": lambda x: 0.0}, "sigma: found 0.0; accepted: above 0"),
    ],
)
def test_refusals(parts, message):
    with pytest.raises(ValueError, match=message):
        changed(**parts)


def test_an_up_of_no_length_is_refused():
    gyro, accel, _ = rest(np.array([1.0, 0.0, 0.0, 0.0]), np.random.default_rng(2))
    with pytest.raises(ValueError, match="up: found the zero vector"):
        es.static_start(gyro, accel, sigma=1e-3, up=np.zeros(3))
