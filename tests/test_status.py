"""What a run says of each body: flags, counts, a summary, warnings; neighbours never feel it."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from numba import njit
from numpy.testing import assert_array_equal

import fastatt as fa
from fastatt.kernels.trig import sincos

FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
N = 300
GENERATOR = np.random.default_rng(5)
Q0, W0 = GENERATOR.normal(size=(N, 4)), GENERATOR.normal(size=(N, 3))
BAD = {3: "nan q", 64: "zero q", 65: "inf w", 130: "nan w", 131: "runaway", 299: "inf q"}


def spoilt():
    q, w = Q0.copy(), W0.copy()
    q[3, 1] = np.nan
    q[64] = 0.0
    w[65, 0] = np.inf
    w[130] = np.nan
    w[131] = 1e9
    q[299, 3] = -np.inf
    return q, w


@pytest.mark.parametrize("method", ["rk4", "dmv10", "strang2", "exact"])
def test_bad_bodies_harm_no_neighbour(method):
    options = {"dt": 0.01, "n_steps": 100, "method": method, "save_every": 50}
    alone = fa.propagate(FREE, Q0, W0, **options)
    q, w = spoilt()
    together = fa.propagate(FREE, q, w, invalid="flag", **options)
    bad = np.isin(np.arange(N), list(BAD))
    assert_array_equal(together.q[:, ~bad], alone.q[:, ~bad])
    assert_array_equal(together.w[:, ~bad], alone.w[:, ~bad])
    assert_array_equal(together.status[~bad], alone.status[~bad])
    for body, what in BAD.items():
        if what != "runaway":
            assert together.status[body] & fa.Status.NON_FINITE, what
        elif method != "exact":  # which is right at any rate
            assert together.status[body] & (fa.Status.STEP_TOO_LARGE | fa.Status.NON_FINITE), what
    assert together.status_counts()["NON_FINITE"] >= 5


@pytest.mark.parametrize("method", ["rk4", "dmv10"])
def test_three_bad_bodies_in_a_hundred_thousand(method):
    """The others are, to the last bit, what they are in an ensemble without them."""
    n, bad = 100_000, [12_345, 54_321, 99_999]
    generator = np.random.default_rng(6)
    q, w = generator.normal(size=(n, 4)), generator.normal(size=(n, 3))
    q[bad[0], 2], w[bad[1], 1], w[bad[2]] = np.nan, np.inf, 1e9
    options = {"dt": 0.01, "n_steps": 50, "method": method}
    together = fa.propagate(FREE, q, w, invalid="flag", **options)
    without = fa.propagate(FREE, np.delete(q, bad, 0), np.delete(w, bad, 0), **options)
    assert_array_equal(np.delete(together.q[-1], bad, 0), without.q[-1])
    assert_array_equal(np.delete(together.w[-1], bad, 0), without.w[-1])
    assert_array_equal(np.flatnonzero(together.status), bad)
    assert not without.status.any()


@njit
def coning(t, p):
    s, c = sincos(p[1] * t)
    a, b = sincos(0.5 * p[0])
    k = 2.0 * p[1] * a
    return -k * b * s, k * b * c, -k * a


@pytest.mark.parametrize("method", ["rk4", "magnus4", "cf4"])
def test_turns_known_beforehand_are_judged_as_those_that_are_watched(method):
    """Steps of 0.01 to 10 rad: of a model, whose bound is known, and of a user's function."""
    generator = np.random.default_rng(7)
    p = np.stack([generator.uniform(0.2, 1.5, N), 10.0 ** generator.uniform(0.0, 3.0, N)], axis=1)
    options = {"dt": 0.01, "n_steps": 130, "method": method}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fa.StepWarning)
        known = fa.propagate(fa.Scene(rate=fa.rates.Coning(*p.T)), Q0, **options)
        watched = fa.propagate(fa.Scene(rate=coning, params=p), Q0, **options)
    assert_array_equal(known.status, watched.status)
    good = known.status == 0
    assert 0.2 * N < good.sum() < 0.9 * N
    assert fa.angle_between(known.q[-1], watched.q[-1])[good].max() < 1e-13
    alone = fa.propagate(fa.Scene(rate=fa.rates.Coning(*p[good].T)), Q0[good], **options)
    assert_array_equal(known.q[:, good], alone.q)


@njit
def burst(t, p):
    """p[2] rad/s from p[0] to p[1] of every p[4] s, once around the clock in a second; else 0.1."""
    since = t % p[4]
    speed = p[2] * np.cos(2.0 * np.pi * (t - p[3])) if p[0] <= since < p[1] else 0.1
    return speed, 0.0, 0.0


def bursts(method, first, last, n_steps, *, period=1e9, **options):
    """Bursts of whole steps of 1 s: from node to node the rate changes its sign."""
    phase = 0.0 if method in ("lie_euler", "lie_midpoint", "rk4", "rkmk4") else 0.25
    scene = fa.Scene(rate=burst, params=[first, last, 5.0, phase, period])
    return fa.propagate(scene, Q0[:1], dt=1.0, n_steps=n_steps, method=method, **options)


@pytest.mark.parametrize(
    "method", ["lie_euler", "lie_midpoint", "rk4", "magnus4", "magnus6", "rkmk4", "cf4", "cg3"]
)
def test_bursts_of_seven_steps_do_not_pass_unseen(method):
    for first in (0, 5, 61, 92, 250, 256, 293):
        run = bursts(method, first, first + 7, 300)
        assert run.status[0] & fa.Status.STEP_TOO_LARGE, first


@pytest.mark.parametrize("period", [2, 7, 8, 10, 16, 32, 64])
def test_a_pulse_of_one_step_in_many_is_seen_before_long(period):
    for phase in range(0, period, max(1, period // 8)):
        run = bursts("magnus4", phase, phase + 1, 4000, period=period)
        assert run.status[0] & fa.Status.STEP_TOO_LARGE, phase


@pytest.mark.parametrize("method", ["magnus4", "magnus6"])
def test_the_last_step_before_a_save_is_looked_at(method):
    """And all steps of runs of up to six between saves."""
    for first, n_steps, options in (
        (10, 11, {}),
        (10, 100, {"save_every": 11}),
        (43, 100, {"save_every": 11}),
        *((k, 12, {"save_every": 6}) for k in range(12)),
    ):
        assert bursts(method, first, first + 1, n_steps, **options).status[0]


@njit
def slew(t, p):
    """p rad/s in the third step, 0.1 else."""
    speed = p[0] if 2.0 <= t < 3.0 else 0.1
    return 0.6 * speed, 0.0, -0.8 * speed


# a float32 quaternion is spoilt by 1e-3 before its length says so; 1000 rad have an ulp of 6e-5
@pytest.mark.parametrize(
    ("representation", "compensated", "single"),
    [("quat", False, 1e-3), ("quat", True, 1e-3), ("dcm", False, 1e-4), ("dcm_rows", False, 1e-4)],
)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_what_a_short_exponential_spoilt_is_run_again(representation, compensated, dtype, single):
    """One step of up to 1000 rad, at which nobody looks, in a hundred of 0.1."""
    angles = np.concatenate([np.linspace(3.0, 30.0, 2000), np.geomspace(30.0, 1000.0, 200)])
    run = fa.propagate(
        fa.Scene(rate=slew, params=angles[:, None]),
        np.tile(np.eye(4)[0], (angles.size, 1)),
        dt=1.0,
        n_steps=100,
        method="lie_midpoint",
        representation=representation,
        dtype=dtype,
        compensated=compensated,
    )
    half = 0.5 * (angles.astype(dtype).astype(np.float64) + 0.1 * 99)
    expected = [np.cos(half), 0.6 * np.sin(half), 0.0 * half, -0.8 * np.sin(half)]
    off = fa.angle_between(run.q[-1].astype(np.float64), np.stack(expected, axis=-1))
    assert off.max() < (single if dtype is np.float32 else 2e-12)


def test_one_step_beyond_its_limit_shows_in_the_norm_of_rk4():
    limit = fa.METHODS["rk4"].limits["quat"]
    for first in range(8):
        p = np.array([first, first + 1.01, 1.02 * limit, 0.0, 1e9])
        run = fa.propagate(fa.Scene(rate=burst, params=p), Q0[:1], dt=1.0, n_steps=16, method="rk4")
        assert run.status[0] & fa.Status.NORM_LOST


def test_rates_that_single_precision_does_not_hold_are_flagged_without_a_step():
    scene = fa.Scene(rate=fa.rates.Constant([(1e300, 0.0, 0.0), (1.0, 0.0, 0.0)]))
    run = fa.propagate(scene, np.eye(4)[:2], dt=0.1, n_steps=0, dtype=np.float32)
    assert run.status.tolist() == [fa.Status.NON_FINITE, 0]


def test_invalid_bodies_are_refused_unless_asked_for():
    q, w = spoilt()
    for arguments in ((q, W0), (Q0, w)):
        with pytest.raises(ValueError, match=r"\[(3|65)"):
            fa.propagate(FREE, *arguments, dt=0.01, n_steps=1)
    with pytest.raises(ValueError, match="invalid: found 'ignore'; accepted: raise, flag"):
        fa.propagate(FREE, Q0, W0, dt=0.01, n_steps=1, invalid="ignore")


def test_summary_names_what_went_wrong():
    q, w = spoilt()
    run = fa.propagate(FREE, q, w, dt=0.01, n_steps=10, method="rk4", invalid="flag")
    lines = run.summary().splitlines()
    assert lines[0].startswith("rk4 on quat, float64: 300 bodies to t = 0.1 s by 0.01 s, 1 saves")
    assert lines[1] == "NON_FINITE (1): 6 of 300, body 3, 64, 65, 130, 131, …"
    fine = fa.propagate(FREE, Q0[0], W0[0], dt=0.01, n_steps=10, method="rk4")
    assert fine.summary().count("\n") == 0
    assert "1 body" in fine.summary()


def test_energy_that_leaves_its_bound_is_flagged():
    """RK4 at 1.4 rad a step, which it may still take, loses energy; dmv10 keeps it."""
    w0 = np.array([0.9, 1.0, 0.5])
    lossy = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=1.0, n_steps=200, method="rk4")
    assert lossy.status[0] & fa.Status.INVARIANT
    energy = fa.kinetic_energy(lossy.w[-1], (2.0, 1.0, 2.0 / 3.0))
    assert energy < 0.99 * fa.kinetic_energy(w0, (2.0, 1.0, 2.0 / 3.0))
    kept = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=0.3, n_steps=1000, method="dmv10")
    assert not kept.status[0] & fa.Status.INVARIANT


# warnings, with a number and a remedy


def remedy(text):
    return float(text.split("<= ")[1].split(",")[0])


@pytest.mark.parametrize("method", ["rk4", "strang2", "dmv10"])
def test_steps_past_the_limit_are_warned_of_with_a_step_that_is_not(method):
    w0 = np.array([[0.1, 0.0, 0.0], [8.0, 5.0, -7.0]])
    with pytest.warns(fa.StepWarning, match=r"a step of body 1 is .*\(1 of 2 bodies") as found:
        run = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=1.0, n_steps=2, method=method)
    assert run.status[0] == 0
    assert run.status[1] & ~fa.Status.INVARIANT
    assert found[0].filename == __file__
    enough = 0.95 * remedy(str(found[0].message))
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        run = fa.propagate(FREE, [1, 0, 0, 0], w0, dt=enough, n_steps=2, method=method)
    assert not (run.status & (fa.Status.STEP_TOO_LARGE | fa.Status.NOT_CONVERGED)).any()


def test_strong_damping_is_warned_of():
    inertia = (2.0, 1.0, 2.0 / 3.0)
    scene = fa.Scene(inertia=inertia, torque=fa.torques.Damping(2.0))
    call = {"n_steps": 10, "q0": [1, 0, 0, 0], "w0": [0.01, 0.01, 0.01]}
    with pytest.warns(fa.StepWarning, match=r"damping takes 3 of the rate a step; rk4") as found:
        run = fa.propagate(scene, dt=1.0, method="rk4", **call)
    assert run.status[0] & fa.Status.STEP_TOO_LARGE
    fine = fa.propagate(scene, dt=0.99 * remedy(str(found[0].message)), method="rk4", **call)
    assert fine.status[0] == 0
    damped = fa.propagate(scene, dt=1.0, method="strang2", **call)
    assert damped.status[0] == 0
    # c/I exactly, whatever the step; little turns, so that axes hardly mix
    assert damped.w[-1] == pytest.approx(0.01 * np.exp(-10.0 * 2.0 / np.array(inertia)), rel=0.03)


def test_fastest_decay_of_every_damping():
    moments = np.array([[2.0, 1.0, 0.5], [1.0, 1.0, 4.0]])
    t = fa.torques
    for model, expected in (
        (None, 0.0),
        (t.Damping(3.0), [6.0, 3.0]),
        (t.Damping([3.0, 1.0]), [6.0, 1.0]),
        (t.AxisDamping((0.1, 0.2, 0.3)), [0.6, 0.3]),
        (t.QuaternionPD(1.0, 2.0), [4.0, 2.0]),
        (t.Sum((t.Damping(1.0), t.AxisDamping((1.0, 0.0, 0.0)))), [4.0, 2.0]),
    ):
        found = np.broadcast_to(t.fastest_decay(model, moments), 2)
        assert found == pytest.approx(np.broadcast_to(expected, 2))


@pytest.mark.parametrize(
    "method", ["hold", "trapezoid", "previous", "coning2", "coning3", "picard"]
)
def test_samples_too_far_apart_are_warned_of(method):
    limit = fa.METHODS[method].limit("rates")
    rates = np.zeros((3, 500, 3))
    rates[:, :, 2] = 0.9 * limit
    with warnings.catch_warnings():
        warnings.simplefilter("error", fa.StepWarning)
        fa.integrate_rates(rates, 1.0, method=method)
    rates[1, 77, 0] = 2.0 * limit
    with pytest.warns(fa.StepWarning, match=f"interval 77 of log 1 .* {method}'s limit is"):
        fa.integrate_rates(rates, 1.0, method=method)
    with pytest.warns(fa.StepWarning, match="interval 77 of log 0"):
        fa.integrate_rates(rates[1], 1.0, method=method)
