"""The error budget of a log: each share beside the true one, of motions whose attitude is known."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pytest
from numpy.polynomial import Polynomial

import fastatt as fa
from fastatt.rounding import StepWarning
from fastatt.trade.ensembles import coning_rates
from fastatt.trade.error_budget import _Log, error_budget
from fastatt.trade.reference import coning_attitudes

H = 0.02
T = H * np.arange(601)
START = np.array([1.0, 0.0, 0.0, 0.0])
FINE = 20  # instants an interval of what is taken for exact


def generic(t):
    """Smooth rates about all axes, rad/s."""
    rng = np.random.default_rng(2)
    a, f, p = rng.normal(size=(4, 3)), rng.uniform(0.3, 3.0, (4, 3)), rng.uniform(0, 6, (4, 3))
    return (a[:, None] * np.sin(f[:, None] * t[None, :, None] + p[:, None])).sum(axis=0)


def between(t):
    """The instants t with others between them."""
    h = t[1] / FINE
    return h * np.arange((len(t) - 1) * FINE + 1)


def tight(rates, t):
    """Attitudes at t from rates at ``between(t)``: 20 times as many, order 4, 1e-5 of the error."""
    return fa.integrate_rates(rates, t[1] / FINE, method="coning3")[::FINE]


def motion(name, t):
    """Rates at t, and the true attitudes."""
    if name == "coning":
        a, f = np.array([0.8]), np.array([2.0])
        q = coning_attitudes(a, f, t)[:, 0]
        return coning_rates(a, f, t)[0], fa.quat_multiply(q[0] * (1, -1, -1, -1), q)
    return generic(t), tight(generic(between(t)), t)


def polynomials(method, t, w):
    """What the method takes for the rates between the samples."""
    if method == "trapezoid":
        return np.stack([np.interp(between(t), t, c) for c in w.T], axis=1)
    history, span, degree = {"previous": (1, 1, 2), "coning3": (0, 3, 3)}[method]
    out = np.empty((len(between(t)), 3))
    for k in range(0, len(t) - 1, span):
        first = min(max(k - history, 0), len(t) - 1 - degree)
        nodes = slice(first, first + degree + 1)
        inside = slice(k * FINE, (k + span) * FINE + 1)
        for axis in range(3):
            out[inside, axis] = Polynomial.fit(t[nodes], w[nodes, axis], degree)(between(t)[inside])
    return out


@pytest.mark.parametrize("method", ["trapezoid", "previous", "coning3"])
@pytest.mark.parametrize("name", ["coning", "generic"])
def test_interpolation_and_truncation_are_the_true_ones(name, method):
    w, q = motion(name, T)
    known = tight(polynomials(method, T, w), T)
    found = fa.integrate_rates(w, H, method=method)
    log = _Log(w, H, START, None)
    sampling = log.extrapolated(log.exact, method, 0.0)
    for share, true in (
        (sampling.error, fa.angle_between(known, q).max()),
        (log.truncation(method), fa.angle_between(found, known).max()),
    ):
        assert 0.5 < share / true < 2.0
    assert sampling.order == pytest.approx(fa.METHODS[method].order, abs=0.5)
    total = log.extrapolated(log.attitudes, method, 0.0)
    assert total.error == pytest.approx(fa.angle_between(found, q).max(), rel=0.5)
    assert log.noise_density() == 0.0


def test_a_rate_that_is_held_has_no_truncation():
    w, q = motion("generic", T)
    log = _Log(w, H, START, None)
    true = fa.angle_between(fa.integrate_rates(w, H, method="hold"), q).max()
    assert log.truncation("hold") == 0.0
    assert log.extrapolated(log.exact, "hold", 0.0).error == pytest.approx(true, rel=0.3)


def test_a_better_method_is_named():
    """By what was run: the log with every second sample left out, in one digit."""
    w, q = motion("generic", T)
    budget = error_budget(w, H, method="trapezoid", rivals=["coning3"])
    q_whole = {m: fa.integrate_rates(w, H, method=m) for m in ("trapezoid", "coning3")}
    true = fa.angle_between(q_whole["trapezoid"], q).max()
    assert budget.total == pytest.approx(true, rel=0.5)
    degrees = {}
    for name, whole in q_whole.items():
        half = fa.integrate_rates(w[::2], 2 * H, method=name)
        changed = fa.angle_between(half[::3], whole[::6]).max()
        assert budget.half_rate[name] == pytest.approx(changed, rel=1e-12)
        degrees[name] = f"{np.degrees(changed):.0e} deg"
    assert budget.verdict == (
        f"with every second sample the attitude changes by {degrees['trapezoid']}, by coning3 "
        f"{degrees['coning3']}: it is more accurate"
    )
    assert "times" not in str(budget)


@pytest.mark.parametrize("density", [1e-4, 1e-2])
def test_noise_is_the_true_one(density):
    """Root mean square over 60 logs with different noise of the same density."""
    w, _ = motion("generic", T)
    noise = np.random.default_rng(5).normal(scale=density / np.sqrt(H), size=(60, *w.shape))
    logs = fa.integrate_rates(w + noise, H, method="coning3")[:, -1]
    end = fa.integrate_rates(w, H, method="coning3")[-1]
    true = np.sqrt(np.mean(fa.angle_between(logs, end) ** 2))
    for own in noise[:3]:
        budget = error_budget(w + own, H, method="coning3", rivals=[])
        assert 0.5 < budget.noise / true < 2.0
        assert budget.noise_density == pytest.approx(density, rel=0.15)
        assert budget.limited_by == "noise"
        assert "noise limits" in budget.verdict
        assert "another method will not help" in budget.verdict


def longdouble(w):
    """The mean of two samples a turn, in extended precision."""
    w = np.asarray(w, dtype=np.longdouble)
    q = np.array([1, 0, 0, 0], dtype=np.longdouble)
    for a, b in pairwise(w):
        u = np.longdouble(H) * (a + b) / 4
        angle = np.sqrt(u @ u)
        c, v = np.cos(angle), u * np.sin(angle) / angle
        q = np.concatenate([[q[0] * c - q[1:] @ v], q[0] * v + c * q[1:] + np.cross(q[1:], v)])
    return q


def test_round_off_is_the_true_one():
    """Of logs of which each has its own, mean of eight at the end."""
    shares, true = [], []
    for k in range(8):
        w = np.roll(generic(T), k, axis=1) * (1.0 + 0.1 * k)
        shares.append(error_budget(w, H, method="trapezoid", rivals=[]).round_off)
        q = fa.integrate_rates(w, H, method="trapezoid")[-1].astype(np.longdouble)
        exact = longdouble(w)
        sign = np.sign(q @ exact)
        apart = q - sign * exact
        true.append(float(2 * np.linalg.norm(apart - exact * (apart @ exact))))
    assert 0.5 < np.mean(shares) / np.mean(true) < 2.0


def test_single_precision_is_what_limits_clean_data():
    w = generic(0.1 * T).astype(np.float32)
    budget = error_budget(w, 0.1 * H, method="coning3", rivals=[])
    same = fa.integrate_rates(w, 0.1 * H, method="coning3")
    better = fa.integrate_rates(w.astype(np.float64), 0.1 * H, method="coning3")
    assert budget.round_off == pytest.approx(fa.angle_between(same, better).max(), rel=0.1)
    # the samples' own rounding looks like noise, and is
    assert budget.limited_by in ("round-off", "noise")


def test_where_the_sample_rate_limits_no_method_helps():
    """Rates with kinks between the samples: every polynomial is wrong there."""
    w = np.abs((0.7 * T[:, None] + [0.0, 0.3, 0.7]) % 2.0 - 1.0)
    budget = error_budget(w, H, method="coning3", rivals=["trapezoid"])
    assert budget.limited_by == "interpolation"
    assert (
        "a better integrator will not help; with every second sample the attitude changes"
        in str(budget)
    )


@pytest.mark.parametrize("method", ["previous", "coning3"])
def test_truncation_of_a_log_with_a_gap_is_of_its_own_polynomials(method):
    """Noise, whose polynomials across the gap of half a second are far from the samples."""
    spans = np.full(100, 0.01)
    spans[50] = 0.5
    noise = 1e-3 * np.random.default_rng(0).normal(size=(101, 3))
    assert _Log(noise, spans, START, 1.0).truncation(method) < 1e-9


@pytest.mark.parametrize("per_cycle", [2.6, 4.0, 9.0])
def test_motion_with_too_few_samples_is_called_undersampled(per_cycle):
    w = 0.3 * coning_rates(np.array([0.8]), np.array([2.0 * np.pi / (per_cycle * H)]), T)[0]
    for noise in (0.0, 1e-3):
        own = noise * np.random.default_rng(0).normal(size=w.shape)
        budget = error_budget(w + own, H, method="previous", rivals=["coning3"])
        assert budget.limited_by == "undersampled"
        assert budget.samples_per_cycle == pytest.approx(per_cycle, rel=0.04)
        assert np.isnan([budget.interpolation, budget.noise, budget.total]).all()
        _, said = str(budget).splitlines()
        assert said == (
            f"  undersampled: {budget.samples_per_cycle:.2g} samples per cycle of the motion, an "
            f"estimate needs 12 or more (at least {600 / budget.samples_per_cycle:.3g} Hz)"
        )


def test_noise_and_slow_motion_are_not_undersampled():
    noise = np.random.default_rng(0).normal(size=(601, 3))
    for w in (noise, noise[:27] * [0.0, 0.0, 1.0], generic(T), generic(T) + 0.3 * noise):
        assert error_budget(w, H, rivals=[]).limited_by != "undersampled"


def test_intervals_are_joined_where_samples_are_left_out():
    log = _Log(np.zeros((9, 3)), np.arange(1.0, 9.0), START, 10.0)
    rates, joined, gap = log.part(3)
    assert rates.shape == (3, 3)
    assert joined.tolist() == [6.0, 15.0]
    assert gap == 30.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"rates": np.zeros((26, 3))}, "rates: found 26 samples; accepted: at least 27"),
        ({"rates": np.zeros((30, 2))}, "rates: has shape"),
        ({"method": "rk4"}, "method: found 'rk4'"),
        ({"rivals": ["rk4"]}, "rivals: found 'rk4'"),
        ({"dt": -1.0}, "dt: found -1.0"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        error_budget(**{"rates": np.zeros((30, 3)), "dt": H, **change})


def test_samples_left_out_on_purpose_are_not_warned_of():
    """Every second and third turn past the limit of a method that the log itself is within."""
    w, _ = motion("generic", T)
    w *= 0.09 / (H * np.linalg.norm(w, axis=1).max())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        error_budget(w, H, method="hold", rivals=[])
    with pytest.warns(StepWarning):
        fa.integrate_rates(w[::2], 2.0 * H, method="hold")


def test_a_log_that_does_not_turn():
    assert "does not rotate" in str(fa.error_budget(np.zeros((100, 3)), 0.01))
