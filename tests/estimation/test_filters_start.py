"""Filters' starts from directions, and what they do with measurements that are wrong or missing."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import scipy
from exact import START, angle, exp, matrix, mul

from fastatt import estimation as es

EPS = 2.0**-52
P0 = np.diag([0.05**2] * 3 + [1e-3**2] * 3)
NOISE = {"angle_noise": 3e-4, "bias_noise": 1e-5}
REFERENCE = np.array([[0.6, 0.8, 0.0], [0.0, 0.3, 2.0]])
SEEN = REFERENCE @ matrix(START)  # rows Cᵀ r
MANY = np.tile(START, (4, 1))
DOWN = np.array([0.0, 0.0, 1.0])


# directions


def test_the_attitude_of_directions_without_noise():
    """Of any lengths; N at once, the references shared or not."""
    turns = exp(np.random.default_rng(0).normal(0.0, 2.0, (50, 3)))
    seen = 3.0 * REFERENCE @ matrix(turns)
    for reference in (REFERENCE, np.tile(REFERENCE, (50, 1, 1))):
        q, P = es.attitude_from_vectors(seen, reference, 0.1)
        assert angle(q, turns).max() <= 16 * EPS
        assert P.shape == (50, 3, 3)
    q, P = es.attitude_from_vectors(SEEN, REFERENCE, [0.1, 0.2])
    assert (q.shape, P.shape) == ((4,), (3, 3))
    assert angle(q, START) <= 16 * EPS


@pytest.mark.parametrize("sigmas", [(0.02, 0.02, 0.02), (0.005, 0.02, 0.03)])
def test_the_attitude_of_noisy_directions_is_scipys(sigmas):
    rng = np.random.default_rng(1)
    r = rng.normal(size=(3, 3))
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    b = r @ matrix(START) + np.multiply(rng.normal(size=(3, 3)), np.reshape(sigmas, (3, 1)))
    q, _ = es.attitude_from_vectors(b, r, sigmas)
    unit = b / np.linalg.norm(b, axis=1, keepdims=True)
    theirs = scipy.spatial.transform.Rotation.align_vectors(
        r, unit, weights=1.0 / np.square(sigmas)
    )[0].as_quat()
    # two Gauss-Newton steps from the answer stay there to the square of the residuals' curvature
    assert angle(q, theirs[[3, 0, 1, 2]]) <= 1e-9


@pytest.mark.parametrize("sigmas", [(1e-3, 1e-3), (1e-3, 2e-2)])
def test_the_covariance_of_a_start_is_that_of_its_errors(sigmas):
    """Mean NEES of 5000 starts within the 99.9 % band of χ² with three degrees of freedom."""
    n = 5000
    rng = np.random.default_rng(2)
    unit = SEEN / np.linalg.norm(SEEN, axis=1, keepdims=True)
    noisy = unit + np.reshape(sigmas, (2, 1)) * rng.normal(size=(n, 2, 3))
    q, P = es.attitude_from_vectors(noisy, REFERENCE, sigmas)
    d = es.attitude_error(q, START)
    nees = np.einsum("ni,nij,nj->n", d, np.linalg.inv(P), d).mean()
    low, high = scipy.stats.chi2.ppf([5e-4, 1 - 5e-4], 3 * n) / n
    assert low < nees < high


def test_directions_of_very_different_precision():
    """The precise one to rounding, the other to its own angle: eigenvectors lose the second."""
    off = np.array([0.0, 0.0, 1e-3])  # about the first direction's axis, seen from the body
    axis = SEEN[0] / np.linalg.norm(SEEN[0])
    turned = mul(START, exp(off[2] * axis))
    seen = np.stack([SEEN[0], REFERENCE[1] @ matrix(turned)])
    q, P = es.attitude_from_vectors(seen, REFERENCE, [1e-9, 1e-2])
    assert angle(q, turned) <= 16 * EPS * 1e-2 / 1e-9
    assert np.abs(REFERENCE[0] @ matrix(q) - seen[0]).max() <= 16 * EPS
    across = np.linalg.norm(np.cross(axis, seen[1] / np.linalg.norm(seen[1])))
    assert np.sqrt(axis @ P @ axis) == pytest.approx(1e-2 / across, rel=1e-6)


@pytest.mark.parametrize(
    ("measured", "reference", "sigma", "message"),
    [
        (SEEN[:1], REFERENCE[:1], 0.1, "accepted: as many of each, at least two"),
        (SEEN, REFERENCE[[0, 1, 1]], 0.1, r"measured: has shape \(2, 3\), reference \(3, 3\)"),
        (np.tile(SEEN, (3, 1, 1)), np.tile(REFERENCE, (2, 1, 1)), 0.1, "as many of each"),
        (SEEN, REFERENCE, 0.0, "sigma: found 0.0; accepted: above 0"),
        (SEEN, REFERENCE, [0.1] * 3, r"sigma: has shape \(3,\); accepted: a number or \(2,\)"),
        (SEEN * [[1], [0]], REFERENCE, 0.1, r"measured\[1\] is the zero vector"),
        (SEEN * [[1], [np.nan]], REFERENCE, 0.1, r"measured\[1, 0\] is nan"),
        (SEEN, [REFERENCE[0], -2.0 * REFERENCE[0]], 0.1, "reference: has directions near one line"),
        # free, though the references are not near one line: equal ones, opposite ones, left-handed
        (SEEN[[0, 0]], REFERENCE, 0.1, r"measured: its directions lie otherwise .* axis is free"),
        (SEEN[[0, 0]] * [[1], [-2]], REFERENCE, 0.1, "measured: its directions lie otherwise"),
        (-np.eye(3), np.eye(3), 0.1, "measured: its directions lie otherwise"),
        ([SEEN, SEEN[[0, 0]]], REFERENCE, 0.1, r"measured\[1\]: its directions lie otherwise"),
        (SEEN, REFERENCE, [1e-9, 0.02], "sigma: found 1e-09 to 0.02; accepted"),
        (
            np.tile(SEEN, (2, 1, 1)),
            [REFERENCE, [REFERENCE[0], REFERENCE[0] + [0, 0, 0.13]]],
            0.1,
            r"reference\[1\]: has directions near one line",
        ),
    ],
)
def test_directions_that_are_refused(measured, reference, sigma, message):
    with pytest.raises(ValueError, match=message):
        es.attitude_from_vectors(measured, reference, sigma)


@pytest.mark.parametrize("apart", [0.125, 0.16])
def test_directions_near_one_line(apart):
    """Two of 0.1 rad: the turn about both is known to 0.1 √2/apart, or it is refused."""
    r = np.array([[1.0, 0.0, 0.0], [np.cos(apart), np.sin(apart), 0.0]])
    if apart < 0.1 * np.sqrt(2.0):
        with pytest.raises(ValueError, match="near one line"):
            es.attitude_from_vectors(r, r, 0.1)
    else:
        _, P = es.attitude_from_vectors(r, r, 0.1)
        # two sines of half the angle in place of two halves of it
        expected = 0.01 / (2.0 * np.sin(0.5 * apart) ** 2)
        assert np.linalg.eigvalsh(P)[-1] == pytest.approx(expected, rel=1e-12)


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


@pytest.mark.parametrize("measured", ["vector", "attitude"])
@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
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


@pytest.mark.parametrize("gate", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
def test_gates_that_are_none(kind, gate):
    with pytest.raises(ValueError, match=r"gate: found .*; accepted: a number above 0, or None"):
        update(filters(kind), "attitude", np.zeros((4, 3)), gate=gate)


def test_a_gate_keeps_a_filter_that_one_wrong_fix_would_lose():
    """Fixes with a deviation of 1 mrad, of which 3 in 60 are wrong by a radian."""
    rng = np.random.default_rng(3)
    lost, kept = (es.MEKF(START, P0, **NOISE) for _ in range(2))
    refused = []
    for k in range(60):
        error = rng.normal(0.0, 1e-3, 3) + (k % 20 == 19) * np.array([1.0, 0.0, 0.0])
        seen = mul(START, exp(error))
        for f, gate in ((lost, None), (kept, scipy.stats.chi2.ppf(0.9999, 3))):
            f.predict(np.zeros(3), 1.0)
            nis = f.update_attitude(seen, 1e-3, gate=gate)
        if not nis <= scipy.stats.chi2.ppf(0.9999, 3):
            refused.append(k)
    assert refused == [19, 39, 59]
    assert kept.nees(START, np.zeros(3)) < scipy.stats.chi2.ppf(0.999, 6)
    assert lost.nees(START, np.zeros(3)) > 1e4


# what is not finite


# attitudes are of any length
LEFT_OUT = [("vector", 1e200), *((m, x) for m in ("vector", "attitude") for x in (np.nan, np.inf))]


@pytest.mark.parametrize(("measured", "bad"), LEFT_OUT)
@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
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


@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
def test_measurements_that_are_not_finite_are_refused(kind):
    f = filters(kind)
    before = state(f)
    rows = np.tile(DOWN, (4, 1))
    rows[2, 1] = np.nan
    with pytest.raises(ValueError, match=r"measured\[2, 1\] is nan; accepted: finite numbers"):
        f.update_vector(rows, DOWN, 0.01)
    with pytest.raises(ValueError, match=r"reference\[2, 1\] is nan"):
        f.update_vector(DOWN, rows, 0.01)
    with pytest.raises(ValueError, match=r"measured\[0\] is inf"):
        f.update_vector([np.inf, 0.0, 0.0], DOWN, 0.01)
    with pytest.raises(ValueError, match=r"measured\[1, 2\] is nan"):
        f.update_attitude(np.where(np.arange(16).reshape(4, 4) == 6, np.nan, MANY), 0.01)
    with pytest.raises(ValueError, match=r"sigma: found -0\.1; accepted: a number above 0"):
        f.update_vector(DOWN, DOWN, -0.1)
    with pytest.raises(ValueError, match="invalid: found 'flag'; accepted: raise, skip"):
        filters(kind, invalid="flag")
    assert changed(before, f) == [False] * 4


@pytest.mark.parametrize("kind", ["MEKF", "UKF"])
def test_a_zero_quaternion_is_no_measurement(kind):
    f, rows = filters(kind, invalid="skip"), MANY.copy()
    rows[1] = 0.0
    before = state(f)
    assert np.isnan(f.update_attitude(rows, 0.01)[1])
    assert changed(before, f) == [True, False, True, True]


def test_gyro_samples_that_are_not_finite_are_refused():
    f = filters("MEKF")
    before = state(f)
    rates = np.zeros((4, 3))
    rates[3, 0] = np.inf
    with pytest.raises(ValueError, match=r"gyro\[3, 0\] is inf; accepted: finite numbers"):
        f.predict(rates, 0.1)
    with pytest.raises(ValueError, match=r"gyro\[1\] is nan"):
        es.MEKF(START, P0, **NOISE).predict([0.0, np.nan, 0.0], 0.1)
    for dt in (0.0, -0.1, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"dt: found .*; accepted: an interval above 0"):
            f.predict(np.zeros(3), dt)
    assert changed(before, f) == [False] * 4


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
    for a, b in zip(state(f), state(good), strict=True):
        assert np.array_equal(a, b)
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
