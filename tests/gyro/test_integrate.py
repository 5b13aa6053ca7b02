"""Sampled rates and angle increments to attitudes."""

from __future__ import annotations

import functools
import itertools
import math
from itertools import pairwise

import numpy as np
import pytest
from each import each
from exact import EPS, LADDER, START, angle, cone, coning, conj, exp, generic, mul, observed_order

import fastatt as fa
from fastatt.gyro.intervals import cuts

KINDS = [False, True]
SAMPLED = [
    (m.name, inc)
    for m in fa.METHODS.values()
    for inc in KINDS
    if ("increments" if inc else "sampled rates") in m.scenes
]
# of increments hold needs no intervals, and Picard fits both kinds of samples by one routine
LEFT_OUT = [("hold", True), ("picard", True)]
ANY_INTERVALS = [pair for pair in SAMPLED if pair not in LEFT_OUT]
on_samples = pytest.mark.parametrize(("method", "increments"), SAMPLED)
# of windows of one interval, of two, and of those that iterate
REPRESENTATIVES = [("previous", False), ("coning2", True), ("picard", False)]
on_representatives = pytest.mark.parametrize(("method", "increments"), REPRESENTATIVES)
BODIES = generic(3)
START3 = np.broadcast_to(START, (3, 4))
SPAN = 2.0
attitude_at = functools.cache(lambda t: BODIES.attitude(0.0, t))


def integrate(data, dt, q0, method, increments, **options):
    return fa.integrate_rates(data, dt, q0, method=method, increments=increments, **options)


def declared(method, increments):
    return fa.METHODS[method].order_of("increments" if increments else "sampled rates")


def samples(bodies, t, increments):
    """(N, n, 3) of rates at the times, or of increments between them."""
    values = bodies.increments(t) if increments else bodies.rate(t)
    return np.ascontiguousarray(np.moveaxis(values, 0, 1))


def same(a, b):
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


# orders


def error_at_end(t, dt, method, increments):
    q = integrate(samples(BODIES, t, increments), dt, START3, method, increments)
    return angle(q[:, -1], attitude_at(t[-1])).max()


@pytest.mark.parametrize("more", [0, 1])
@on_samples
def test_observed_order_with_equal_intervals(method, increments, more):
    """Of whole windows, and where the last one borrows from samples before or beyond."""
    ladder = LADDER if more else LADDER[LADDER >= 12]  # multiples of 6
    assert more or not (ladder % fa.METHODS[method].window.span).any()

    def error(n):
        return error_at_end(SPAN / n * np.arange(n + 1 + more), SPAN / n, method, increments)

    found = observed_order(error, ladder=ladder)
    assert found == pytest.approx(declared(method, increments), abs=0.25)


# equal intervals make a window symmetric, which is worth an order to these
UNEVEN = {"coning2": 3, "picard": 7}


@pytest.mark.parametrize("pattern", ["alternate", "random"])
@pytest.mark.parametrize(("method", "increments"), ANY_INTERVALS)
def test_observed_order_with_uneven_intervals(method, increments, pattern):
    """By 30 %: long and short in turn, or at random (the mean of the logarithm over several logs).

    At random the windows' errors partly cancel, so that the order may come out higher.
    """
    rng = np.random.default_rng(1)

    def error(n):
        logs = []
        for _ in range(1 if pattern == "alternate" else 5):
            spans = np.resize([0.7, 1.3], n) if pattern == "alternate" else rng.uniform(0.7, 1.3, n)
            t = np.concatenate([[0.0], np.cumsum(spans * SPAN / spans.sum())])
            logs.append(np.log(error_at_end(t, np.diff(t), method, increments)))
        return math.exp(np.mean(logs))

    above = observed_order(error) - UNEVEN.get(method, declared(method, increments))
    assert -0.25 < above < (0.25 if pattern == "alternate" else 1.25)


# known figures


@pytest.mark.parametrize(("h", "known"), [(0.2, 3.9e-4), (0.05, 2.6e-6)])
def test_coning_with_one_increment_and_the_one_before(h, known):
    """Coning at 1 rad and 1 rad/s, after 20 s; how the first interval is done is left open."""
    t = np.linspace(0.0, 20.0, round(20.0 / h) + 1)
    inc = samples(cone(1.0, 1.0), t, True)[0]
    q = fa.integrate_rates(inc, h, coning(0.0, 1.0, 1.0), method="previous", increments=True)
    assert angle(q[-1], coning(20.0, 1.0, 1.0)) == pytest.approx(known, rel=0.06)


CONE, SPEED = math.radians(1.0), 4.0 * math.pi  # half the cone's angle, and 2 Hz


def coned(method, h, n):
    """Angles about the cone's axis from the truth, rad, after each of n increments."""
    t = h * np.arange(n + 1)
    inc = samples(cone(CONE, SPEED), t, True)[0]
    q = fa.integrate_rates(inc, h, coning(0.0, CONE, SPEED), method=method, increments=True)
    return t, mul(q, conj(coning(t, CONE, SPEED)))[:, 3] * 2.0


@pytest.mark.parametrize(
    ("method", "known"), [("hold", 1.038), ("coning2", 3.27e-3), ("previous", 3.28e-3)]
)
def test_drift_in_small_coning(method, known):
    """At 10 ms, deg/h, over whole periods; three digits are known.

    The first period is left out: it begins without an interval before.
    """
    t, turned = coned(method, 0.01, 50 * 60)
    drift = math.degrees((turned[-1] - turned[150]) / (t[-1] - t[150])) * 3600.0
    assert abs(drift) == pytest.approx(known, rel=0.006)


@pytest.mark.parametrize(("method", "n", "divisor"), [("hold", 1, 12.0), ("coning2", 2, 960.0)])
def test_drift_in_small_coning_is_the_formula(method, n, divisor):
    """a²Ω(ΩT)^(2n)/divisor for n samples in each span T, to the next power of ΩT."""
    h = 0.005
    t, turned = coned(method, h, 6000)
    known = CONE**2 * SPEED * (SPEED * n * h) ** (2 * n) / divisor
    assert abs(turned[-1] / t[-1]) == pytest.approx(known, rel=0.05)


# one log, many logs


def one_by_one(increments, q0):
    """q0, q0∘exp(θ1), q0∘exp(θ1)∘exp(θ2) … in plain Python order."""
    q = np.array([*itertools.accumulate(exp(increments), mul, initial=q0)])
    return q / np.linalg.norm(q, axis=1, keepdims=True)


LENGTHS = [1, 2, 3, 5, 23, 24, 25, 383, 384, 385, 1000, 20000]
LOG = np.random.default_rng(2).normal(size=(20000, 3))
PRODUCT = one_by_one(0.1 * LOG, START)


@each("n", LENGTHS)
@each("increments", KINDS)
def test_one_log_is_the_plain_product_of_its_turns(n, increments):
    """Held rates over n − 1 intervals are increments; the cuts into stretches leave no trace."""
    data, dt = (0.1 * LOG[:n], 1.0) if increments else (LOG[:n], 0.1)
    found = integrate(data, dt, START, "hold", increments)
    assert found.shape == (n + increments, 4)
    # a few roundings a factor in both products
    assert np.abs(found - PRODUCT[: len(found)]).max() < 6 * EPS * (n + 1)
    assert np.abs(np.linalg.norm(found, axis=1) - 1.0).max() < 24 * 6 * EPS


@on_representatives
@pytest.mark.parametrize("dtype", ["f8", "f4"])
@pytest.mark.parametrize("uneven", [False, True])
def test_lanes_and_threads_change_no_bit(method, increments, dtype, uneven):
    """One log a lane, and ten chunks of one side by side; some past π, which leaves neighbours."""
    data = (0.02 * LOG).reshape(40, 500, 3).astype(dtype)
    data[::7, 300:] *= 4.0 if method == "picard" else 200.0  # whose polynomial must not diverge
    rng = np.random.default_rng(0)
    q0, dt = rng.normal(size=(40, 4)), 1.0
    if uneven:
        dt = rng.uniform(0.9, 1.1, 500 - (not increments))
    alone = [integrate(x, dt, q, method, increments) for x, q in zip(data, q0, strict=True)]
    for n_logs, n_threads in ((1, 1), (3, 1), (16, 1), (40, 1), (40, 2), (40, 3)):
        batch = integrate(data[:n_logs], dt, q0[:n_logs], method, increments, n_threads=n_threads)
        assert all(map(same, batch, alone))


def inner(method, turn):
    """Error between the ends of a window that turns by ``turn`` rad at a constant rate.

    Picard's polynomial of degree 6 does not hold sin and cos of half the turn: θ⁷/(2⁷ 7! 4) or so.
    """
    return (0.5 * turn) ** 7 / 20160.0 if method == "picard" else 0.0


@each(*on_samples.args)
@each("n", [1, 2, 3, 4, 5, 6, 7, 25])
def test_short_logs_and_rests_of_windows(method, increments, n):
    """A constant rate is exact whatever the number of samples, fewer than a window too."""
    w = np.array([0.03, -0.02, 0.04])
    q = fa.integrate_rates(np.tile(w, (n, 1)), 0.5, START, method=method, increments=increments)
    factor = 1.0 if increments else 0.5
    t = np.arange(n + increments)[:, None]
    assert q.shape == (n + increments, 4)
    rounding = (n + 1) * 12 * EPS
    error = angle(q, mul(START, exp(factor * t * w)))
    assert error.max() < rounding + inner(method, 6.0 * factor * np.linalg.norm(w))
    assert error[:: fa.METHODS[method].window.span].max() < rounding


@pytest.mark.parametrize(("method", "increments"), ANY_INTERVALS)
def test_equal_intervals_as_an_array(method, increments):
    n = 100
    data = (0.01 if increments else 1.0) * LOG[:n]
    spans = np.full(n - (not increments), 0.01)
    a, b = (integrate(data, dt, START, method, increments) for dt in (0.01, spans))
    # interpolating noise by a sextic through 7 samples amplifies the rounding
    assert angle(a, b).max() < (40 if method == "picard" else 4) * n * EPS


@each(("method", "increments"), [p for p in SAMPLED if p[0] != "picard"])
@each("theta", [3.0, 4.0, 100.0, 1e6])
def test_constant_rate_is_exact_at_any_angle(method, increments, theta):
    """To some ulps of the angle of a window; Picard's polynomial in time holds no long turn."""
    n = 12
    w = theta * np.array([2.0, -1.0, 2.0]) / 3.0
    q = fa.integrate_rates(np.tile(w, (n, 1)), 1.0, START, method=method, increments=increments)
    t = np.arange(n + increments)[:, None]
    span = fa.METHODS[method].window.span
    assert angle(q, mul(START, exp(t * w))).max() < n * (4 * np.spacing(span * theta) + 12 * EPS)


@pytest.mark.parametrize(("method", "increments"), [p for p in ANY_INTERVALS if p[0] != "picard"])
@pytest.mark.parametrize("n_logs", [1, 20])
def test_constant_rate_is_exact_at_any_angle_with_any_intervals(method, increments, n_logs):
    """A few intervals are long enough for a turn past π."""
    spans = np.random.default_rng(4).uniform(0.01, 0.02, 60)
    spans[[7, 20, 21, 59]] = 1.0
    w = np.array([3.0, -2.0, 4.0])
    t = np.concatenate([[0.0], np.cumsum(spans)])
    data = np.tile(spans[:, None] * w if increments else np.tile(w, (61, 1)), (n_logs, 1, 1))
    options = {"method": method, "increments": increments, "max_gap": 2.0}
    with pytest.warns(fa.StepWarning, match=r"of log 0 rotates by 5\.39 rad"):
        q = fa.integrate_rates(data, spans, START, **options)
    assert angle(q, mul(START, exp(t[:, None] * w))).max() < 61 * 12 * EPS


@on_representatives
@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
def test_what_lanes_held_before_changes_no_bit(method, increments):
    options = {"method": method, "increments": increments}
    before = fa.integrate_rates(0.1 * LOG[:61], 0.1, **options)
    for value in (math.nan, math.inf):
        with pytest.raises(ValueError, match="accepted: "):
            fa.integrate_rates(np.full((20, 97, 3), value), 0.1, n_threads=1, **options)
        assert same(before, fa.integrate_rates(0.1 * LOG[:61], 0.1, **options))


@on_representatives
def test_logs_of_their_own_intervals_and_lengths_are_single_logs(method, increments):
    rng = np.random.default_rng(6)
    spans = rng.uniform(0.01, 0.02, (3, 130 + increments))
    spans[1, 40] = 0.2  # windows begin anew
    data, start = 0.01 * rng.normal(size=(3, 131, 3)), rng.normal(size=(3, 4))
    options = {"method": method, "increments": increments, "max_gap": 1.0}
    for ends in (131, 131, 131), (131, 60, 7):
        logs = data if ends[1:] == ends[:-1] else [x[:n] for x, n in zip(data, ends, strict=True)]
        own = [h[: n - (not increments)] for h, n in zip(spans, ends, strict=True)]
        many = fa.integrate_rates(logs, own, start, **options)
        for q, *log in zip(many, logs, own, start, strict=True):
            assert same(q, fa.integrate_rates(*log, **options))
    out = np.empty((3, 131 + increments, 4))
    assert fa.integrate_rates(data, spans, start, out=out, **options) is out
    assert same(
        out, np.array([*map(functools.partial(fa.integrate_rates, **options), data, spans, start)])
    )


def test_messages_name_the_log_of_its_own_intervals():
    spans, pair = np.full((3, 9), 0.1), [LOG[:10], LOG[:5]]
    spans[2, 4] = 0.0
    for data, dt, options, message in (
        (LOG[:30].reshape(3, 10, 3), spans, {}, r"log 2: dt\[4\] is 0.0: a repeated time stamp"),
        (
            LOG[:30].reshape(3, 10, 3),
            spans[:2],
            {},
            "dt: found 2 of them; accepted: a number, or 3",
        ),
        (pair, 0.1, {"q0": np.ones((3, 4))}, r"q0: found 3 of them; accepted: \(4,\), or 2"),
        (pair, 0.1, {"out": np.empty((10, 4))}, "out: .* accepted: None, for a list of logs"),
        ([LOG[:10], np.nan * LOG[:5]], 0.1, {}, r"log 1: rates\[0, 0\] is nan"),
    ):
        with pytest.raises((TypeError, ValueError), match=message):
            fa.integrate_rates(data, dt, **options)
    with pytest.warns(fa.StepWarning, match="interval 0 of log 1 rotates"):
        fa.integrate_rates([0.01 * LOG[:10], 5.0 + 0.0 * LOG[:5]], 0.5)


@pytest.mark.parametrize("length", [1e-200, 3.0, 1e200])
def test_start_of_any_length(length):
    a = fa.integrate_rates(LOG[:10], 0.1, START, method="hold")
    b = fa.integrate_rates(LOG[:10], 0.1, START * length, method="hold")
    assert np.abs(a - b).max() < 8 * EPS


def test_a_log_of_one_sample_has_no_intervals():
    q = fa.integrate_rates(LOG[:1], [], START, method="hold")
    assert q == pytest.approx(START[None], abs=1e-15)


def test_float32():
    data = (0.01 * LOG[:5000]).astype(np.float32)
    options = {"method": "previous"}
    single = fa.integrate_rates(data, 1.0, START, **options)
    double = fa.integrate_rates(data, 1.0, START, dtype=np.float64, **options)
    assert (single.dtype, double.dtype) == (np.float32, np.float64)
    error = angle(single[-1], double[-1])
    assert 1e-9 < error < 2.0**-24 * 4 * 5000
    assert same(fa.integrate_rates(data.astype(float), 1.0, START, dtype="f4", **options), single)


def test_arguments_are_not_changed():
    data, q0 = LOG[:100].copy(), 3.0 * START
    fa.integrate_rates(data, 0.1, q0)
    assert same(data, LOG[:100])
    assert same(q0, 3.0 * START)


@pytest.mark.parametrize("dtype", ["f8", "f4"])
@pytest.mark.parametrize("shape", [(50, 3), (2000, 3), (20, 90, 3)])
def test_out_anywhere_in_memory(shape, dtype):
    rates = np.random.default_rng(0).normal(size=shape).astype(dtype)
    expected = fa.integrate_rates(rates, 0.01)
    whole = np.zeros(expected.size + 3, dtype=dtype)
    for k in range(4):
        out = whole[k : k + expected.size].reshape(expected.shape)
        whole[:] = 7.0
        assert fa.integrate_rates(rates, 0.01, out=out) is out
        assert same(out, expected)
        assert (whole[:k] == 7.0).all()
        assert (whole[k + expected.size :] == 7.0).all()


def with_cuts(rng, n):
    """Intervals with long and short ones: single, two in a row, one within two of the last."""
    spans = rng.uniform(0.009, 0.011, n)
    spans[[17, 60, 61, 103, n - 2]] = [0.05, 0.09, 1e-5, 0.05, 0.001]
    return spans


@pytest.mark.parametrize(("method", "increments"), ANY_INTERVALS)
@pytest.mark.parametrize("n_logs", [1, 20])
def test_windows_begin_anew_at_cuts(method, increments, n_logs):
    """As if the log were cut there: a log of two rates or of one increment between."""
    spans = with_cuts(np.random.default_rng(3), 200)
    n = len(spans) + (not increments)
    data = 0.1 * np.random.default_rng(4).normal(size=(n_logs, n, 3))
    options = {"method": method, "increments": increments, "max_gap": 1.0}
    q = fa.integrate_rates(data, spans, START, **options)
    bounds = [0, 17, 18, 60, 61, 62, 103, 104, 198, 199, 200]
    apart = np.broadcast_to(START / np.linalg.norm(START), (n_logs, 4))
    for first, last in pairwise(bounds):
        own = data[:, first : last + (not increments)]
        part = fa.integrate_rates(own, spans[first:last], apart, **options)
        assert angle(q[:, first : last + 1], part).max() < 200 * 12 * EPS
        apart = part[:, -1]
    if n_logs == 1:
        assert same(fa.integrate_rates(data[0], spans, START, **options), q[0])


# noise of a body at rest, which polynomials through samples may magnify

of_polynomials = pytest.mark.parametrize("method", ["previous", "coning2", "picard"])


@of_polynomials
def test_a_gap_does_not_magnify_noise(method):
    """Over a gap of 0.5 s a few hundredths of a millirad."""
    spans = np.full(120, 0.01)
    spans[60] = 0.5
    noise = 1e-4 * np.random.default_rng(5).normal(size=(50, 121, 3))
    q = fa.integrate_rates(noise, spans, method=method, max_gap=1.0)
    turned = angle(q[:, 60], q[:, 61])
    # the mean of two samples: σ h √(3/2) on three axes
    assert np.sqrt(np.mean(turned**2)) == pytest.approx(0.5e-4 * math.sqrt(1.5), rel=0.2)


def magnified(method, noise, spans, increments=False):
    """How many times as far as a method without polynomials."""
    methods = method, "hold" if increments else "trapezoid"
    options = {"increments": increments, "max_gap": 1.0}
    far, straight = (fa.integrate_rates(noise, spans, method=m, **options) for m in methods)
    return angle(far, straight).max() / angle(straight, straight[:1]).max()


@of_polynomials
@pytest.mark.parametrize("increments", KINDS)
def test_samples_that_nearly_coincide_do_not_magnify_noise(method, increments):
    """The noise of a gyro or the resolution of its angle."""
    rng = np.random.default_rng(8)
    for short, at in ((4e-6, 300), (2e-7, 1), (5e-5, -1), (1e-9, slice(40, 600, 9))):
        times = np.arange(601) / 150.0
        times[at] = times[np.arange(601)[at] - 1] + short
        noise = rng.normal(0.0, 2e-5 if increments else 3e-3, (601 - increments, 3))
        assert magnified(method, noise, np.diff(times), increments) < 4.0


@of_polynomials
def test_random_latencies_do_not_magnify_noise(method):
    rng = np.random.default_rng(9)
    for latency in (rng.exponential(3e-3, 3001), rng.uniform(0.0, 0.02, 3001)):
        spans = np.diff(np.sort(np.arange(3001) / 100.0 + latency))
        assert magnified(method, rng.normal(0.0, 2e-3, (3001, 3)), spans) < 3.0


def test_cuts_are_those_of_the_medians():
    """Of intervals of all sizes, some before those that are looked at."""
    spans = np.random.default_rng(1).exponential(size=300)
    padded = np.concatenate([np.full(8, spans[0]), spans])
    medians = [float(np.median(padded[k : k + 8])) for k in range(300)]
    known = [(k, m) for k, m in enumerate(medians) if not m / 3.0 <= spans[k] <= 3.0 * m]
    assert len(known) > 20
    assert cuts(3.0, spans) == known
    for cut in (1, 5, 100):
        later = [(k - cut, m) for k, m in known if k >= cut]
        assert cuts(3.0, spans[cut:], spans[max(cut - 8, 0) : cut]) == later


def test_advice_of_the_sample_rate_is_above_1():
    limit = fa.METHODS["coning2"].limit("rates")
    for ratio, said in ((1.001, "1.1"), (1.43, "1.5"), (11.0, "12")):
        rates = np.tile([ratio * limit, 0.0, 0.0], (5, 1))
        with pytest.warns(fa.StepWarning, match=f"sample at least {said} times as often"):
            fa.integrate_rates(rates, 1.0, method="coning2")
