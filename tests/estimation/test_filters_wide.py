"""Filters of attitudes that are hardly known: consistent, or a warning; a heading left unknown."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import scipy
from each import each
from exact import START, angle, exp, matrix, mul

import fastatt as fa
from fastatt import estimation as es

UP = np.array([0.0, 0.0, 1.0])
FIELD = np.array([0.5, 0.0, -0.8])
NO_NOISE = {"angle_noise": 0.0, "bias_noise": 0.0}
P_BIAS = [1e-6] * 3
N = 2000
# of a mean of χ² with 6 degrees of freedom over so many filters, five standard deviations
BAND = 5.0 * np.sqrt(12.0 / N)


def filters(deviation, seed):
    """N filters about START, with errors of this deviation about each axis, and of their biases."""
    rng = np.random.default_rng(seed)
    P = np.diag([deviation**2] * 3 + P_BIAS)
    start, bias = mul(START, exp(rng.normal(0.0, deviation, (N, 3)))), rng.normal(0.0, 1e-3, (N, 3))
    return rng, bias, es.MEKF(start, P, **NO_NOISE), es.UKF(start, np.zeros(3), P)


@pytest.mark.filterwarnings("ignore:measured. an attitude")  # of one filter in 2000
@pytest.mark.parametrize(("deviation", "sigma"), [(0.2, 1e-3), (0.4, 1e-2)])
def test_wide_starts_are_consistent_from_the_first_vector_on(deviation, sigma):
    """Two directions, 40 degrees apart, by turns: one linear update alone has 35 of 6."""
    rng, bias, mekf, ukf = filters(deviation, seed=1)
    for k in range(8):
        reference = np.array([np.cos(0.7 * (k % 2)), np.sin(0.7 * (k % 2)), 0.0])
        seen = matrix(START).T @ reference + rng.normal(0.0, sigma, (N, 3))
        for f in (mekf, ukf):
            f.update_vector(seen, reference, sigma)
            assert abs(np.mean(f.nees(START, bias)) - 6.0) < BAND


def test_filters_that_are_not_consistent_have_warned():
    """Of 0.5 rad beside vectors of 1e-4 rad some are far off, those where four passes are few."""
    rng, bias, mekf, _ = filters(0.5, seed=1)
    start, warned = mekf.q.copy(), np.zeros(200, dtype=bool)
    nees = np.zeros(200)
    for k in range(len(nees)):
        f = es.MEKF(start[k], np.diag([0.25] * 3 + P_BIAS), **NO_NOISE)
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            for reference in ([1.0, 0.0, 0.0], [0.8, 0.6, 0.0]):
                seen = matrix(START).T @ reference + rng.normal(0.0, 1e-4, 3)
                f.update_vector(seen, reference, 1e-4)
        warned[k], nees[k] = bool(found), f.nees(START, bias[k])
    off = nees > scipy.stats.chi2.ppf(0.9999, 6)
    assert off.sum() > 10
    assert warned[off].all()
    assert warned.mean() < 0.6


def test_wide_starts_are_consistent_by_what_a_user_defined_function_observes():
    """Of one linearisation: at 0.2 rad and 1e-2 the covariance is some per cent too large."""
    rng, bias, _, ukf = filters(0.2, seed=2)
    for k in range(8):
        reference = np.eye(3)[k % 2]
        seen = matrix(START).T @ reference + rng.normal(0.0, 1e-2, (N, 3))
        ukf.update(lambda q, y: fa.quat_rotate_inverse(q, reference), seen, 1e-4 * np.eye(3))  # noqa: B023
        assert 4.8 < np.mean(ukf.nees(START, bias)) < 6.0 + BAND


def heading(f):
    """Deviation of the rotation about the vertical, rad."""
    up = matrix(f.q).T @ UP
    return np.sqrt(up @ f.covariance[:3, :3] @ up)


def test_a_heading_that_nothing_measures_stays_unknown():
    """After a start that knows the vertical alone, through rest, turns and an accelerometer."""
    rng, bias = np.random.default_rng(4), np.array([3e-3, -2e-3, 1e-3])
    up = matrix(START).T @ UP
    unknown = np.outer(up, up)
    P = scipy.linalg.block_diag(
        2e-3**2 * (np.eye(3) - unknown) + np.pi**2 * unknown, 1e-4**2 * np.eye(3)
    )
    mekf = es.MEKF(START, P, bias=bias, **NO_NOISE)
    ukf = es.UKF(START, bias, P)
    truth = START
    for k in range(200):
        rate = np.array([0.3, -0.2, 0.1]) * (k > 50)
        truth = mul(truth, exp(0.05 * rate))
        seen = matrix(truth).T @ UP + rng.normal(0.0, 5e-3, 3)
        mekf.predict(rate + bias, 0.05)
        ukf.predict(es.gyro_motion(rate + bias, 0.05), np.zeros((6, 6)))
        for f in (mekf, ukf):
            f.update_vector(seen, UP, 5e-3)
    for f in (mekf, ukf):
        assert heading(f) == pytest.approx(np.pi, rel=1e-3)
        tilt = np.arccos(UP @ matrix(f.q) @ matrix(truth).T @ UP)
        assert tilt < 5.0 * np.sqrt(np.linalg.eigvalsh(f.covariance[:3, :3])[1])
        f.update_attitude(truth, 1e-3)
        assert angle(f.q, truth) < 5e-3
        assert heading(f) < 1.1e-3


# 2.3748 rad times √(6 + 1) is a whole turn: all sigma points were one attitude
@each("deviation", [0.5, 1.0, 1.19, 2.3748, np.pi, 6.0])
def test_a_motion_keeps_what_is_not_known(deviation):
    P = np.diag([1e-4, 4e-4, deviation**2, *P_BIAS])
    axes = matrix(exp(np.array([0.5, -1.0, 0.7])))
    turned = np.kron(np.diag([1.0, 0.0]), axes) + np.diag([0, 0, 0, 1, 1, 1])
    for start in (P, turned @ P @ turned.T):
        f, g = es.UKF(START, np.zeros(3), start), es.MEKF(START, start, **NO_NOISE)
        for _ in range(10):
            f.predict(es.gyro_motion((0.1, 0.2, -0.3), 0.1), np.zeros((6, 6)))
            g.predict((0.1, 0.2, -0.3), 0.1)
        # the bias times the second, at large angles in other shares
        assert np.abs(f.covariance - g.covariance).max() < 1e-4 * max(1.0, deviation) ** 2


@each("seconds", [0.5, 2.3748, 5.0])
def test_a_rate_that_is_not_known_spreads_the_attitude(seconds):
    """Of a sphere with 1 rad/s about each axis: after T s T rad, which a turn would have folded."""
    f = es.UKF(START, np.zeros(3), np.diag([1e-4] * 3 + [1.0] * 3))
    scene = fa.Scene(inertia=(1.0, 1.0, 1.0))
    f.predict(es.scene_motion(scene, 0.1 * seconds, 10, method="rk8"), np.zeros((6, 6)))
    spread = np.sqrt(np.diag(f.covariance)[:3])
    assert spread == pytest.approx(np.full(3, np.hypot(1e-2, seconds)), rel=1e-6)


def test_warnings():
    P = np.diag([1e-4, 1e-4, np.pi**2, *P_BIAS])
    one, other = es.MEKF(START, P, **NO_NOISE), es.UKF(START, np.zeros(3), P)
    seen = matrix(mul(START, exp(np.array([0.0, 0.0, 2.0])))).T @ FIELD
    for f in (one, other):
        with pytest.warns(
            UserWarning, match="known too little .* begin with an attitude that is known better"
        ):
            f.update_vector(seen, FIELD, 0.01)
    third = es.UKF(START, np.zeros(3), P)
    with pytest.warns(UserWarning, match="known too little"):
        third.update(lambda q, y: fa.quat_rotate_inverse(q, FIELD), seen, 1e-4 * np.eye(3))

    def whirl(q, y):
        return mul(q, exp(2.0 * y)), y

    spinning = es.UKF(START, np.zeros(3), np.diag([1e-4] * 3 + [0.25] * 3))
    with pytest.warns(UserWarning, match="motion: put sigma points .* rad from their mean"):
        spinning.predict(whirl, np.zeros((6, 6)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for f in (es.MEKF(START, P, **NO_NOISE), es.UKF(START, np.zeros(3), P)):
            f.update_vector(UP, matrix(START) @ UP, 0.01)
            f.update_attitude(START, 0.01)


def test_an_update_observes_the_sigma_points_that_are_public():
    """Where the attitude is wide enough to bring them nearer, and biases go with it."""
    P = np.diag([0.1, 0.1, np.pi**2, 1.0, 1.0, 1.0])
    P[2, 5] = P[5, 2] = 0.5 * np.pi
    ukf = es.UKF(START, np.zeros(3), P)
    expected, seen = ukf.sigma_points(), []

    def observe(q, y):
        seen.append((q, y))
        return y[:, :1]

    ukf.update(observe, [0.0], [[1.0]])
    ((q, y),) = seen
    assert np.array_equal(q, expected[0].reshape(-1, 4))
    assert np.array_equal(y, expected[1].reshape(-1, 3))
