"""What filters refuse: covariances, deviations and measurements that are none."""

from __future__ import annotations

import re

import numpy as np
import pytest
from each import each

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
    fixes = es.MEKF(START, P0, **NOISE)
    tried = {
        "covariance": (
            lambda: es.MEKF(START, bad, **NOISE),
            lambda: es.UKF(START, beside, bad),
            lambda: es.covariance_to_body(bad, START),
        ),
        "noise": (
            lambda: es.UKF(START, beside, P0).predict(es.gyro_motion((0.1, 0.2, 0.3), H), bad),
        ),
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


@pytest.mark.parametrize(
    ("block", "what"),
    [([[1, 2], [2, 1]], "has a negative variance"), ([[1, 0.5], [0.4, 1]], "is not symmetric")],
)
def test_small_blocks_of_covariances_count_by_their_own_size(block, what):
    """A bias of 1e-8 rad/s beside an attitude of 1 rad, whose rounding the whole block is."""
    P = np.diag([1.0] * 3 + [1e-16] * 3)
    es.MEKF(START, P, **NOISE)
    P[4:, 4:] = 1e-16 * np.array(block)
    for call in (lambda: es.MEKF(START, P, **NOISE), lambda: es.covariance_to_body(P, START)):
        with pytest.raises(ValueError, match=f": {what}; accepted: a covariance"):
            call()


@each("kind", [es.MEKF, es.UKF])
def test_deviations_and_shapes_of_measurements_that_are_refused(kind):
    f = one_filter(kind)
    before = f.covariance.copy()
    for measured in (0.3, [0.3], np.zeros((5, 3))):
        with pytest.raises(ValueError, match=r"measured: has shape .*; accepted: \(3,\)"):
            f.update_vector(measured, REFERENCE, 0.1)
    with pytest.raises(ValueError, match=r"measured: has shape \(5, 4\); accepted: \(4,\)"):
        f.update_attitude(np.tile(START, (5, 1)), 0.1)
    for sigma, message in (
        (0.0, "sigma: found 0.0; accepted: a number above 0"),
        (-0.1, "sigma: found -0.1; accepted: a number above 0"),
        (0.99e-150, "sigma: found 9.9e-151; accepted: 1e-150"),
        (1.01e150, "sigma: found 1.01e+150; accepted: 1e-150"),
    ):
        for call in (
            lambda x: f.update_attitude(START, x),
            lambda x: f.update_vector(REFERENCE, REFERENCE, x),
        ):
            with pytest.raises(ValueError, match=re.escape(message)):
                call(sigma)
    for sigma, message in (
        ([0.1, -0.1, 0.1], r"found -0\.1; accepted: a number above 0"),
        ([0.1, 0.0, 0.1], r"found 0\.0; accepted: a number above 0"),
        (np.diag([1.0, 1.0, 0.0]), "has no variance in some direction"),
        (np.ones((3, 3)), "has no variance in some direction"),
    ):
        with pytest.raises(ValueError, match=f"sigma: {message}"):
            f.update_attitude(START, sigma)
    assert np.array_equal(f.covariance, before)
    f.update_vector(REFERENCE, REFERENCE, 1e150)  # the largest
    assert np.isfinite(f.covariance).all()


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


def one_filter(kind):
    if kind is es.MEKF:
        return es.MEKF(START, P0, **NOISE)
    return es.UKF(START, np.zeros(3), P0)


@each("kind", [es.MEKF, es.UKF])
def test_truths_that_are_none(kind):
    f = one_filter(kind)
    name = "bias" if kind is es.MEKF else "y"
    with pytest.raises(ValueError, match="q is the zero quaternion"):
        f.nees(np.zeros(4), np.zeros(3))
    with pytest.raises(ValueError, match=rf"{name}\[1\] is nan"):
        f.nees(START, [0.0, np.nan, 0.0])
    with pytest.raises(ValueError, match=rf"{name}: has shape \(2,\); accepted: \(3,\)"):
        f.nees(START, np.zeros(2))
    assert f.nees(3.0 * START, np.zeros(3)) == pytest.approx(f.nees(START, np.zeros(3)), rel=1e-9)


def test_errors_of_zero_quaternions():
    for name, pair in (("q", (np.zeros(4), START)), ("q_true", (START, [START, np.zeros(4)]))):
        with pytest.raises(ValueError, match=f"{name}: found a zero quaternion"):
            es.attitude_error(*pair)


def test_of_a_direction_without_variance():
    """NEES is 0 or beyond all bounds, and never below 0."""
    f = es.UKF(START, np.zeros(3), np.diag([1e-2] * 3 + [1e-6, 1e-6, 0.0]))
    assert 0.0 <= f.nees(START, np.zeros(3)) <= 1e-27
    assert f.nees(START, [1e-3, 0.0, 0.0]) == pytest.approx(1.0, rel=1e-12)
    assert f.nees(START, [0.0, 0.0, 1e-3]) == np.inf
    f.predict(es.gyro_motion((0.1, 0.2, 0.3), H), np.zeros((6, 6)))
    assert f.covariance[5, 5] == 0.0
    values = np.random.default_rng(0).normal(size=(100, 6, 4))
    rounded = es.UKF(np.tile(START, (100, 1)), np.zeros(3), values @ np.swapaxes(values, 1, 2))
    assert (rounded.nees(START, [1.0, 2.0, 3.0]) >= 0.0).all()


def test_a_refused_noise_leaves_a_ukf_as_it_was():
    f, moved = es.UKF(START, np.zeros(3), P0), []

    def motion(q, y):
        moved.append(q)
        return q, y + 1.0

    before = f.q.copy(), f.y.copy(), f.covariance.copy()
    refused = (
        lambda: f.predict(motion, -np.eye(6)),
        lambda: f.predict(motion, np.eye(5)),
        lambda: f.update(lambda q, y: y, np.ones(3), -np.eye(3)),
        lambda: f.update(lambda q, y: y, np.ones(3), np.zeros((3, 3))),
        lambda: f.update(lambda q, y: y[:-1], np.ones(3), np.eye(3)),
        lambda: f.predict(lambda q, y: (q, y[:, :2]), P0),
        lambda: f.predict(lambda q, y: (0.0 * q, y), P0),
    )
    for call in refused:
        with pytest.raises(ValueError, match=r"(noise|observe|motion: [qy]).*accepted"):
            call()
    assert not moved
    after = f.q, f.y, f.covariance
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def test_quaternions_that_a_motion_gives_may_have_any_length():
    f, same = one_filter(es.UKF), one_filter(es.UKF)
    f.predict(lambda q, y: (3.0 * q, y), P0)
    same.predict(lambda q, y: (q, y), P0)
    assert np.abs(np.linalg.norm(f.q, axis=-1) - 1.0).max() <= 1e-15
    assert np.abs(f.q - same.q).max() <= 1e-15


def test_a_measurement_without_a_finite_nis_is_no_success():
    """Of numbers that overflow, where what is not finite is to be refused."""
    for kind in (es.MEKF, es.UKF):
        f = one_filter(kind)
        before = f.q.copy()
        with (
            np.errstate(over="ignore", invalid="ignore"),
            pytest.raises(ValueError, match="measured: has a normalised innovation squared of"),
        ):
            f.update_vector([1e200, 0.0, 0.0], REFERENCE, 0.1)
        assert np.array_equal(f.q, before)
