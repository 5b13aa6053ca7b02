"""What filters do with measurements that are wrong, missing, or in other units; their arrays."""

from __future__ import annotations

import copy
import math
import pickle
import warnings

import numpy as np
import pytest
import scipy
from each import each
from exact import START, angle, exp, matrix, mul

import fastatt as fa
from fastatt import estimation as es

P0 = np.diag([0.05**2] * 3 + [1e-3**2] * 3)
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
MANY = np.tile(START, (4, 1))
DOWN = np.array([0.0, 0.0, 1.0])


# gates


def filters(kind, **options):
    if kind == "MEKF":
        return es.MEKF(MANY, P0, **NOISE, **options)
    return es.UKF(MANY, np.zeros(3), P0, **options)


def state(f):
    beside = f.bias if isinstance(f, es.MEKF) else f.y
    return f.q.copy(), beside.copy(), f.covariance.copy()


def changed(before, f):
    """Which of the estimates are others than before."""
    after = state(f)
    return [any((a[i] != b[i]).any() for a, b in zip(before, after, strict=True)) for i in range(4)]


def update(f, kind, errors, **options):
    """With measurements that are off by errors (4, 3), rad."""
    tilted = mul(MANY, exp(errors))
    if kind == "attitude":
        return f.update_attitude(tilted, 0.01, **options)
    return f.update_vector(np.einsum("nji,j->ni", matrix(tilted), DOWN), DOWN, 0.01, **options)


@each("measured", ["vector", "attitude"])
@each("kind", ["MEKF", "UKF"])
def test_what_is_beyond_the_gate_is_not_used(kind, measured):
    """Errors of 0.02 to 0.5 rad beside deviations of 0.05: NIS is given, the estimate is as before.

    One without a gate, and the same filter beside others, give the bits that a used one has.
    """
    errors = np.array([[0.02, 0, 0], [0.1, 0, 0], [0.3, 0, 0], [0.5, 0, 0]])
    free, f = filters(kind), filters(kind)
    nis = update(free, measured, errors)
    before = state(f)
    gate = float(np.sqrt(nis[1] * nis[2]))
    found = update(f, measured, errors, gate=gate)
    assert np.array_equal(found, nis)
    assert (np.diff(nis) > 0.0).all()
    assert changed(before, f) == [True, True, False, False]
    for a, b in zip(state(f), state(free), strict=True):
        assert np.array_equal(a[:2], b[:2])
    # NIS itself is within
    g = filters(kind)
    update(g, measured, errors, gate=float(nis[2]))
    assert changed(before, g) == [True, True, True, False]


def spread(P, n, seed):
    """A filter of each of n true attitudes about START, drawn from a covariance; the generator."""
    rng = np.random.default_rng(seed)
    true = mul(START, exp(rng.normal(size=(n, 3)) @ np.linalg.cholesky(P).T))
    covariance = scipy.linalg.block_diag(P, 1e-6 * np.eye(3))
    start = np.tile(START, (n, 1))
    return rng, true, es.MEKF(start, covariance, **NOISE), es.UKF(start, np.zeros(3), covariance)


def follows(nis, degrees):
    """A sample of χ²: its distribution to 0.015, 0.1 % of it above the limit of the guide."""
    above = (nis > scipy.stats.chi2.ppf(0.999, degrees)).mean()
    assert abs(above - 1e-3) < 5.0 * np.sqrt(1e-3 / len(nis))
    assert scipy.stats.kstest(nis, "chi2", (degrees,)).statistic < 0.015


# of one filter in some thousand
few_are_too_wide = pytest.mark.filterwarnings("ignore:measured. an attitude")
TILTED = matrix(START).T @ np.diag([1e-2, 1e-2, 0.3]) ** 2 @ matrix(START)


@few_are_too_wide
@each("P", [1e-4 * np.eye(3), 0.09 * np.eye(3), 0.25 * np.eye(3), TILTED])
@each(("reference", "sigma"), [([0.0, 0.6, -0.8], 1e-2), ([3.0, 4.0, 12.0], 1.3)])
def test_nis_of_vectors_is_chi_square(P, reference, sigma):
    """Whatever is known of the attitude; a direction, without a length of its own, has two."""
    rng, true, mekf, ukf = spread(P, 30_000, seed=5)
    seen = np.einsum("nji,j->ni", matrix(true), reference) + rng.normal(0.0, sigma, (len(true), 3))
    nis = mekf.update_vector(seen, reference, sigma)
    follows(nis, 3)
    assert np.array_equal(ukf.update_vector(seen, reference, sigma), nis)
    size = np.linalg.norm(reference)
    lengths = size / np.linalg.norm(seen, axis=1, keepdims=True)
    _, _, direction, _ = spread(P, len(true), seed=5)
    follows(direction.update_vector(lengths * seen, reference, sigma), 2)


@each("sigma", [(1e-2, 1e-2, 1e-2), (1e-1, 1e-3, 1e-3)])
@each("P", [0.25 * np.eye(3), TILTED])
def test_nis_of_attitudes_is_chi_square(P, sigma):
    rng, true, mekf, ukf = spread(P, 30_000, seed=6)
    seen = mul(true, exp(rng.normal(size=(len(true), 3)) * sigma))
    nis = mekf.update_attitude(seen, sigma)
    follows(nis, 3)
    assert np.array_equal(ukf.update_attitude(seen, sigma), nis)


def test_a_vector_opposite_to_the_expected_one_is_refused():
    """It is π away, about any axis across."""
    f = filters("MEKF")
    nis = f.update_vector(-matrix(START)[2], DOWN, 0.01)
    assert nis == pytest.approx(np.pi**2 / (0.05**2 + 0.01**2), rel=0.05)


@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
def test_a_gate_that_refuses_ten_measurements_in_a_row_warns(kind):
    """Of one filter among others; ignored measurements do not count, used ones begin anew."""
    f, good = filters(kind, invalid="skip"), np.zeros((4, 3))
    wrong, lost = (good + np.array([[0.0], [0.0], [x], [0.0]]) for x in (1.0, np.nan))
    before = f.q[2].copy()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for errors, times in ((wrong, 9), (good, 1), (wrong, 5), (lost, 5), (wrong, 4)):
            for _ in range(times):
                update(f, "vector", errors, gate=16.27)
    with pytest.warns(UserWarning, match="gate: filter 2 has refused 10 measurements in a row"):
        update(f, "attitude", wrong, gate=16.27)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        update(f, "vector", lost, gate=16.27)
        update(f, "vector", wrong, gate=16.27)
    assert angle(f.q[2], before) < 1e-9
    alone = es.MEKF(START, P0, **NOISE)
    with pytest.warns(UserWarning, match="gate: the filter has refused 10"):
        [alone.update_vector(matrix(START)[0], DOWN, 0.01, gate=16.27) for _ in range(10)]


# what is not finite


# attitudes are of any length
LEFT_OUT = [("vector", 1e200), *((m, x) for m in ("vector", "attitude") for x in (np.nan, np.inf))]


@each(("measured", "bad"), LEFT_OUT)
@each("kind", ["MEKF", "UKF"])
def test_measurements_that_are_not_finite_are_left_out(kind, measured, bad):
    """For their filter alone: the others are as if nothing was wrong."""
    f, good = filters(kind, invalid="skip"), filters(kind)
    gates = {"gate": np.inf} if bad == np.inf else {}
    rows = mul(MANY, exp(np.full((4, 3), 0.01)))
    if measured == "vector":
        rows = np.einsum("nji,j->ni", matrix(rows), DOWN)
    wrong = rows.copy()
    wrong[2, 1] = bad
    options = (DOWN, 0.01) if measured == "vector" else (0.01,)
    before = state(f)
    with np.errstate(over="ignore", invalid="ignore"):
        nis = getattr(f, f"update_{measured}")(wrong, *options, **gates)
    expected = getattr(good, f"update_{measured}")(rows, *options)
    assert not np.isfinite(nis[2])
    assert np.isnan(nis[2]) or not np.isnan(bad)
    assert changed(before, f) == [True, True, False, True]
    others = [0, 1, 3]
    assert np.array_equal(nis[others], expected[others])
    for a, b in zip(state(f), state(good), strict=True):
        assert np.array_equal(a[others], b[others])


@each("kind", ["MEKF", "UKF"])
def test_what_is_no_measurement_is_left_out(kind):
    """Where it is refused, it changes nothing."""
    zero, none = np.tile(DOWN, (4, 1)), MANY.copy()
    zero[1], none[1] = 0.0, 0.0
    f = filters(kind)
    before = state(f)
    for call in (lambda: f.update_vector(zero, DOWN, 0.01), lambda: f.update_attitude(none, -1.0)):
        with pytest.raises(ValueError, match="accepted"):
            call()
    assert changed(before, f) == [False] * 4
    for call in (
        lambda f: f.update_vector(zero, DOWN, 0.01),
        lambda f: f.update_vector(DOWN, zero, 0.01),
        lambda f: f.update_attitude(none, 0.01),
    ):
        skipping = filters(kind, invalid="skip")
        assert np.isnan(call(skipping)[1])
        assert not changed(before, skipping)[1]


def test_a_zero_vector_has_no_nis_in_compiled_code():
    zero = (0.0, 0.0, 0.0)
    P = (1e-2, 0.0, 0.0, 1e-2, 0.0, 1e-2), (0.0,) * 9, (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)
    for measured, reference in ((zero, tuple(DOWN)), (tuple(DOWN), zero)):
        found = es.mekf_update_vector(tuple(START), zero, P, measured, reference, 1e-4)
        assert np.isnan(found[3])


@pytest.mark.parametrize("copied", [lambda f: f, copy.deepcopy])
def test_gyro_samples_that_are_not_finite_are_held(copied):
    """The last good one of the filter; before the first it does not turn, bias off."""
    bias = np.array([0.01, 0.0, -0.02])
    w = np.array([0.1, -0.2, 0.3])
    f = es.MEKF(MANY, P0, bias=bias, invalid="skip", **NOISE)
    good = es.MEKF(MANY, P0, bias=bias, **NOISE)
    first, then = np.tile(w, (4, 1)), np.tile(2.0 * w, (4, 1))
    first[1, 0] = then[1, 2] = then[3, 1] = np.nan
    f.predict(first, 0.1)
    f = copied(f)
    f.predict(then, 0.1)
    good.predict(np.stack([w, bias, w, w]), 0.1)
    good.predict(np.stack([2.0 * w, bias, 2.0 * w, w]), 0.1)
    assert all(map(np.array_equal, state(f), state(good)))
    f.predict([np.nan] * 3, 0.1)
    good.predict(np.stack([2.0 * w, bias, 2.0 * w, w]), 0.1)
    assert np.array_equal(f.q, good.q)


# the mean of sigma points


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_the_mean_of_sigma_points_is_where_their_errors_cancel(size):
    """After a motion that bends them to one side: turns by δ become turns by δ and |δ|² about z."""

    def bend(q, y):
        d = es.attitude_error(START, q)
        more = np.zeros_like(d)
        more[:, 2] = (d**2).sum(axis=1)
        return mul(START, exp(d + more)), y

    P = np.diag([size**2 / 12.0] * 3 + [1e-6] * 3)
    f = es.UKF(START, np.zeros(3), P)
    q, y = f.sigma_points()
    moved, _ = bend(q[0], y[0])
    weights = np.array([1.0, *[0.5] * 12]) / 7.0
    f.predict(bend, np.zeros((6, 6)))
    errors = es.attitude_error(START, moved)
    begun, left = (np.linalg.norm(weights @ d) for d in (errors, es.attitude_error(f.q, moved)))
    assert begun > 0.01
    # a step is out by the second-order term of Jr⁻¹, |d|²/12
    assert left <= begun * ((errors**2).sum(axis=1).max() / 12.0) ** 2


# what is refused, and what is not


def test_attitudes_of_any_length():
    for f in (es.covariance_to_inertial, es.covariance_to_body):
        assert np.array_equal(f(P0, 4.0 * START), f(P0, START))
    rest = es.preintegrate(np.ones((2, 3)), np.ones((2, 3)), 0.1)
    doubled, same = (rest.predict(k * START, np.ones(3), np.ones(3)) for k in (2.0, 1.0))
    assert all(np.array_equal(a, b) for a, b in zip(doubled, same, strict=True))


def test_of_a_direction_without_variance():
    """NEES is 0 or beyond all bounds, and never below 0."""
    f = es.UKF(START, np.zeros(3), np.diag([1e-2] * 3 + [1e-6, 1e-6, 0.0]))
    assert 0.0 <= f.nees(START, np.zeros(3)) <= 1e-27
    assert f.nees(START, [1e-3, 0.0, 0.0]) == pytest.approx(1.0, rel=1e-12)
    assert f.nees(START, [0.0, 0.0, 1e-3]) == np.inf
    f.predict(es.gyro_motion((0.1, 0.2, 0.3), 0.1), np.zeros((6, 6)))
    assert f.covariance[5, 5] == 0.0
    values = np.random.default_rng(0).normal(size=(100, 6, 4))
    rounded = es.UKF(np.tile(START, (100, 1)), np.zeros(3), values @ np.swapaxes(values, 1, 2))
    assert (rounded.nees(START, [1.0, 2.0, 3.0]) >= 0.0).all()


def test_a_refused_noise_leaves_a_ukf_as_it_was():
    f, moved = filters("UKF"), []

    def motion(q, y):
        moved.append(q)
        return q, y + 1.0

    before = state(f)
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
    assert all(map(np.array_equal, before, state(f)))


def test_quaternions_that_a_motion_gives_may_have_any_length():
    f, same = filters("UKF"), filters("UKF")
    f.predict(lambda q, y: (3.0 * q, y), P0)
    same.predict(lambda q, y: (q, y), P0)
    assert np.abs(np.linalg.norm(f.q, axis=-1) - 1.0).max() <= 1e-15
    assert np.abs(f.q - same.q).max() <= 1e-15


def test_a_measurement_without_a_finite_nis_is_no_success():
    """Of numbers that overflow, where what is not finite is to be refused."""
    for kind in ("MEKF", "UKF"):
        f = filters(kind)
        before = f.q.copy()
        with (
            np.errstate(over="ignore", invalid="ignore"),
            pytest.raises(
                ValueError, match=r"measured\[0\]: has a normalised innovation squared of"
            ),
        ):
            f.update_vector([1e200, 0.0, 0.0], DOWN, 0.1)
        assert np.array_equal(f.q, before)


# arrays

RNG = np.random.default_rng(0)
GYRO, ACCEL = RNG.normal(size=(2, 3, 7, 3))


def filtered(n):
    f = es.MEKF(np.tile(START, (n, 1)), P0, **NOISE)
    f.predict(GYRO[0, 0], 0.1)
    f.update_vector(GYRO[0, 1], ACCEL[0, 0], 0.1)
    f.update_attitude(START, 0.2)
    return f.q, f.bias, f.covariance


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
@pytest.mark.parametrize("n", [None, 20])
def test_a_copy_of_a_filter_has_arrays_of_its_own(copied, n):
    q = START if n is None else np.tile(START, (n, 1))
    f = es.MEKF(q, P0, **NOISE)
    f.predict(GYRO[0, 0], 0.1)
    g = copied(f)
    before = f.q.copy()
    g.predict(GYRO[0, 1], 0.1)
    assert (f.q == before).all()
    f.predict(GYRO[0, 1], 0.1)
    assert (f.q == g.q).all()
    assert not (f.q == before).all()


def test_what_an_update_gives_is_not_changed_by_the_next():
    f = es.MEKF(np.tile(START, (3, 1)), np.eye(6), angle_noise=0.1, bias_noise=0.1)
    first = f.update_attitude(START, 0.1)
    kept = first.copy()
    f.update_attitude((1.0, 0.0, 0.0, 0.0), 0.1)
    assert (first == kept).all()


def test_many_filters_are_the_filters_alone():
    """Vectors of filters and single ones, by every operation, to the bit."""
    for many, one in zip(filtered(9), filtered(1), strict=True):
        assert (many == one).all()


# angles, and vectors of other units than their references

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
    ukf = es.UKF(q, np.zeros(3), np.diag([1e-6, 1e-6, 0.05**2, 1e-8, 1e-8, 1e-8]))
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
        made = es.UKF(q, np.zeros((2, 3)), np.eye(6) * 1e-4)
    else:
        made = es.MEKF(q, np.eye(6) * 1e-4, angle_noise=1e-4, bias_noise=1e-6)
    reference = np.array([0.45, 0.0, 0.893])
    made.update_vector([reference] * 2, reference, 0.02)
    made.update_vector([1.9 * reference] * 2, reference, 0.02)
    with pytest.warns(RuntimeWarning, match=r"measured: found a vector of length .* \(filter 1\)"):
        made.update_vector([reference, scale * reference], reference, 0.02)
