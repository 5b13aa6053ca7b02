"""What filters refuse: covariances, deviations and measurements that are none."""

from __future__ import annotations

import numpy as np
import pytest

from fastatt import estimation as es

H, REFERENCE = 0.1, np.array([0.6, 0.8, 0.0])
START = np.array([0.8, 0.0, 0.6, 0.0])
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
P0 = np.diag([0.05**2] * 3 + [1e-3**2] * 3)


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
