"""What filters refuse: covariances, deviations and measurements that are none."""

from __future__ import annotations

import numpy as np
import pytest

from fastatt import estimation as es

H, REFERENCE = 0.1, np.array([0.6, 0.8, 0.0])
START = np.array([0.8, 0.0, 0.6, 0.0])
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
P0 = np.diag([0.05**2] * 3 + [1e-3**2] * 3)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (np.eye(6)[::-1] * [0, 0, 0, 0, 0, 1e-3], "is not symmetric"),
        (np.diag([0, 0, 0, 0, -1.0, 0]), "has a negative variance"),
        (np.eye(6)[::-1], "has a negative variance"),
    ],
    ids=["asymmetric", "negative", "indefinite"],
)
def test_what_is_no_covariance_is_refused(change, what):
    """Half of such a matrix was read, or its roots cut off."""
    bad, beside = P0 + change, np.zeros(3)
    particles = es.ParticleFilter.around(START, beside, P0, 8, rng=0)
    fixes = es.MEKF(START, P0, **NOISE)
    tried = {
        "covariance": (
            lambda: es.MEKF(START, bad, **NOISE),
            lambda: es.UKF(START, beside, bad),
            lambda: particles.scatter(bad),
            lambda: es.ParticleFilter.around(START, beside, bad, 8),
        ),
        "noise": (
            lambda: es.UKF(START, beside, P0).predict(es.gyro_motion((0.1, 0.2, 0.3), H), bad),
        ),
        "P": (lambda: es.covariance_to_body(bad, START),),
        "sigma": (lambda: fixes.update_attitude(START, bad[[[0], [4], [5]], [0, 4, 5]]),),
    }
    if what != "has a negative variance" or change[4, 4] != 0.0:
        del tried["sigma"]  # not in the corner that is left
    for name, calls in tried.items():
        for call in calls:
            with pytest.raises(ValueError, match=f"{name}: {what}; accepted: a covariance"):
                call()
    with pytest.raises(ValueError, match=rf"covariance\[1\]: {what}"):
        es.MEKF(START, np.stack([P0, bad]), **NOISE)


@pytest.mark.parametrize("kind", [es.MEKF, es.UKF, es.ParticleFilter])
def test_deviations_and_shapes_of_measurements_that_are_refused(kind):
    if kind is es.MEKF:
        f = es.MEKF(START, P0, **NOISE)
    elif kind is es.UKF:
        f = es.UKF(START, np.zeros(3), P0)
    else:
        f = es.ParticleFilter.around(START, np.zeros(3), P0, 8, rng=0)
    for measured in (0.3, [0.3], np.zeros((5, 3))):
        with pytest.raises(ValueError, match=r"measured: has shape .*; accepted: \(3,\)"):
            f.update_vector(measured, REFERENCE, 0.1)
    with pytest.raises(ValueError, match=r"measured: has shape \(5, 4\); accepted: \(4,\)"):
        f.update_attitude(np.tile(START, (5, 1)), 0.1)
    for sigma in (0.0, -1.0):
        with pytest.raises(ValueError, match=f"sigma: found {sigma}; accepted: a number above 0"):
            f.update_vector(REFERENCE, REFERENCE, sigma)
    for sigma in (-0.1, [0.1, -0.1, 0.1]):
        with pytest.raises(ValueError, match=r"sigma: found -0\.1; accepted: at least 0"):
            f.update_attitude(START, sigma)


def test_a_bias_has_three_numbers():
    f = es.UKF(START, [0.5], P0[:4, :4])
    with pytest.raises(ValueError, match=r"y: has shape \(9, 1\); accepted: a bias of three"):
        f.predict(es.gyro_motion((0.0, 0.0, 1.0), H), P0[:4, :4])


def test_attitudes_of_any_length():
    for f in (es.covariance_to_inertial, es.covariance_to_body):
        assert np.array_equal(f(P0, 4.0 * START), f(P0, START))
    rest = es.preintegrate(np.ones((2, 3)), np.ones((2, 3)), H)
    doubled, same = (rest.predict(k * START, np.ones(3), np.ones(3)) for k in (2.0, 1.0))
    assert all(np.array_equal(a, b) for a, b in zip(doubled, same, strict=True))
