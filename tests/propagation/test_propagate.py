"""The library call: ensembles, threads, saves, clocks, precision, users' functions, status."""

from __future__ import annotations

import math

import numpy as np
import pytest
from each import each
from exact import (
    EPS,
    START,
    Motion,
    angle,
    combinations,
    cone,
    coning,
    exp,
    generic,
    matrix,
    mul,
    steady,
)
from numba import njit

import fastatt as fa

N, STEPS, H = 200, 70, 0.02  # more than three tiles of 64 bodies, and more than a block of 64 steps
BODIES = generic(N)
rng = np.random.default_rng(3)
Q0 = rng.normal(size=(N, 4))
SIZES = [1, 2, 63, 64, 65]
SINGLES = [0, 1, 62, 63, 64, 128, 199]
SHARED = [("magnus4", "quat"), ("rk4", "quat"), ("rk4", "dcm")]


def run(bodies, q0, method="magnus4", representation="quat", n=STEPS, h=H, **options):
    scene = bodies.scene if isinstance(bodies, Motion) else bodies
    options = {"method": method, "representation": representation, **options}
    return fa.propagate(scene, q0, dt=h, n_steps=n, **options)


def same(a, b):
    """Every bit: NaN equals NaN, 0 does not equal −0."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


# an ensemble is its bodies


# every method on quaternions, and every representation: the tile's width is no matter of both
BOTH = [(m, r) for m, r in combinations() if r == "quat" or m in ("rk4", "magnus4")]


@pytest.mark.parametrize(("method", "representation"), BOTH)
def test_ensemble_is_single_runs_bit_for_bit(method, representation):
    """With parameters of their own."""
    options = {"method": method, "representation": representation, "save_every": 32}
    full = run(BODIES, Q0, **options)
    for n in SIZES:
        part = run(BODIES.take(slice(n)), Q0[:n], **options)
        for name in ("state", "norm_error", "q", "dcm"):
            assert same(getattr(part, name), getattr(full, name)[:, :n]), (name, n)
        assert same(part.status, full.status[:n])
    for b in SINGLES:
        one = run(BODIES.take([b]), Q0[[b]], **options)
        assert same(one.state[:, 0], full.state[:, b])


@pytest.mark.parametrize(("method", "representation"), SHARED)
def test_ensemble_of_one_rate_is_single_runs_bit_for_bit(method, representation):
    options = {"method": method, "representation": representation, "save_every": 32}
    full = run(BODIES.shared, Q0, **options)
    for n in SIZES:
        assert same(run(BODIES.shared, Q0[:n], **options).state, full.state[:, :n])
    for b in SINGLES:
        one = run(BODIES.shared, Q0[b], **options)
        assert one.q.shape == (full.t.size, 4)
        assert same(one.q, full.q[:, b])


def test_shared_and_own_parameters_agree_to_round_off():
    own = run(BODIES.take([0] * N), Q0)
    assert angle(own.q, run(BODIES.shared, Q0).q).max() < STEPS * 4 * EPS


def test_one_start_for_many_rates_is_not_guessed():
    with pytest.raises(ValueError, match=r"for 200 bodies; accepted: 1, .* q0 of shape \(200, 4\)"):
        run(BODIES, START)


@pytest.mark.parametrize(("method", "representation"), combinations())
def test_threads_change_no_bit(method, representation):
    options = {"method": method, "representation": representation, "save_every": 32}
    one, two, three = (run(BODIES, Q0, n_threads=k, **options) for k in (1, 2, 3))
    for name in ("state", "norm_error", "status"):
        assert same(getattr(one, name), getattr(two, name))
        assert same(getattr(one, name), getattr(three, name))


# saves


@each("n", [0, 1, 7, 63, 64, 65, 70, 128])
@each("every", [None, 1, 7, 64, "n", "2n"])
def test_saves(n, every):
    """The initial state, every k-th and the final one; None: the final one alone."""
    every = {"n": max(n, 1), "2n": 2 * n + 1}.get(every, every)
    all_of_them = run(BODIES, Q0[:N], n=128, save_every=1)
    traj = run(BODIES, Q0, n=n, save_every=every, t0=0.0)
    steps = [n] if every is None else [*range(0, n, every), n]
    assert same(traj.t, np.array(steps) * H)
    assert traj.q.shape == (len(steps), N, 4)
    assert same(traj.q, all_of_them.q[steps])
    assert same(traj.norm_error, all_of_them.norm_error[steps])


@pytest.mark.parametrize("every", [None, 1, 7, 70])
def test_saves_do_not_change_rk4_in_a_chart(every):
    """No step starts from a state that was brought back to the group for output."""
    for representation in ("quat", "dcm", "euler313"):
        options = {"method": "rk4", "representation": representation}
        plain = run(BODIES, Q0, save_every=1, **options)
        traj = run(BODIES, Q0, save_every=every, **options)
        steps = np.round(traj.t / H).astype(int)
        assert same(traj.state, plain.state[steps])


@pytest.mark.parametrize("method", ["magnus4", "cf4"])
def test_saves_do_not_change_a_body_that_comes_to_turn_fast(method):
    """From below π a step to above and back within a block of steps."""
    bodies = steady([[0.0, 0.0, 10.0]] * 3)
    bodies.c[1] += [[0.3, 0.0, 0.0], [0.0, 0.1, 1400.0], [0.0, 0.0, -1000.0]]
    plain = run(bodies, Q0[:3], method, save_every=1)
    assert plain.status.tolist() == [0, fa.Status.STEP_TOO_LARGE, 0]
    for every in (None, 5, 64):
        traj = run(bodies, Q0[:3], method, save_every=every)
        assert same(traj.q, plain.q[np.round(traj.t / H).astype(int)])


def test_shapes_of_one_body():
    traj = run(BODIES.shared, START, save_every=10)
    s = STEPS // 10 + 1
    assert (traj.t.shape, traj.q.shape, traj.w.shape) == ((s,), (s, 4), (s, 3))
    assert (traj.dcm.shape, traj.euler313.shape) == ((s, 3, 3), (s, 3))
    assert traj.status.shape == (1,)
    assert np.abs(traj.dcm - matrix(traj.q)).max() < 8 * EPS


def test_no_steps_give_the_initial_attitudes():
    traj = run(BODIES, Q0, n=0)
    assert traj.q.shape == (1, N, 4)
    assert angle(traj.q[0], Q0 / np.linalg.norm(Q0, axis=1, keepdims=True)).max() < 4 * EPS
    assert not traj.status.any()


# clocks


@pytest.mark.parametrize(("method", "representation"), [("magnus6", "quat"), ("rk4", "dcm")])
def test_t0_shifts_the_scene(method, representation):
    """c0 + c1 (t + s) + c2 (t + s)² is a polynomial too; the cone is left out."""
    s = 1.5
    bodies = generic(3)
    bodies.a = np.zeros(3)
    c0, c1, c2 = np.moveaxis(bodies.c, 1, 0)
    shifted = np.stack([c0 + s * c1 + s * s * c2, c1 + 2 * s * c2, c2], axis=1)
    later = Motion(bodies.a, bodies.omega, shifted)
    a = run(bodies, Q0[:3], method, representation, t0=s, save_every=10)
    b = run(later, Q0[:3], method, representation, save_every=10)
    assert same(a.t, s + b.t) or a.t == pytest.approx(s + b.t, abs=1e-15)
    assert angle(a.q, b.q).max() < STEPS * 8 * EPS
    assert angle(a.q[-1], bodies.attitude(s, s + STEPS * H, Q0[:3])).max() < 1e-6


def test_times_do_not_accumulate():
    traj = run(BODIES.shared, START, n=100_000, h=0.1, save_every=25_000, t0=3.0)
    assert same(traj.t, 3.0 + np.array([0, 25_000, 50_000, 75_000, 100_000]) * 0.1)


def test_rates_of_the_trajectory_are_those_of_the_model():
    traj = run(BODIES, Q0, save_every=7, t0=0.3)
    assert np.abs(traj.w - BODIES.rate(traj.t)).max() < 8 * EPS


@pytest.mark.parametrize("t0", [0.0, 1e5])
def test_float32_keeps_the_phase_of_shared_rates(t0):
    """At t = 1e5 s a float32 clock would stand still for 8 ms: rates take theirs in float64."""
    a, omega, h, n = 0.5, 3.0, 1e-3, 1000
    start = coning(t0, a, omega)
    traj = run(cone(a, omega).shared, start, n=n, h=h, t0=t0, dtype=np.float32)
    error = angle(traj.q[-1], coning(t0 + n * h, a, omega))
    # rounding of the state, one float32 ulp a step of 1000, as a random walk or a steady drift
    assert error < n * 2.0**-24 * 2.0


@pytest.mark.parametrize("method", ["rk4", "magnus4", "magnus6", "cg3"])
def test_float32_results_and_their_floor(method):
    n = 1000
    bodies, q0 = generic(3), Q0[:3].astype(np.float32)
    single = run(bodies, q0, method, n=n, h=2.0 / n, save_every=500)
    assert single.q.dtype == single.dcm.dtype == single.w.dtype == np.float32
    exact_start = run(bodies, q0.astype(float), method, n=n, h=2.0 / n, save_every=500)
    # each step rounds the state and the angle by some 2⁻²⁴, an exponential by 2 or 3 times that
    error = angle(single.q[-1], exact_start.q[-1]).max()
    each = max(1, fa.METHODS[method].exponentials)
    assert error < 2.0**-24 * 4.0 * math.sqrt(n) * each
    assert error > 1e-9  # it is not float64 in disguise
    asked = run(bodies, q0.astype(float), method, n=n, h=2.0 / n, save_every=500, dtype="float32")
    assert same(asked.q, single.q)


# neighbours


SLOW = generic(64)
FAST = {3: 7.0, 17: 1e3, 40: 1e6}  # body: rad a step


@pytest.mark.parametrize(("method", "representation"), combinations())
def test_fast_body_changes_no_bit_of_its_neighbours(method, representation):
    options = {"method": method, "representation": representation, "save_every": 9}
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    mixed = generic(64)
    for b, theta in FAST.items():
        mixed.a[b] = mixed.omega[b] = 0.0
        mixed.c[b] = 0.0
        mixed.c[b, 0] = theta / H * axis
    with np.errstate(all="raise"):
        alone, together = run(SLOW, Q0[:64], **options), run(mixed, Q0[:64], **options)
    others = [b for b in range(64) if b not in FAST]
    assert same(together.state[:, others], alone.state[:, others])
    assert same(together.status[others], alone.status[others])
    assert (together.status[list(FAST)] != 0).all()


@each("method", [m for m, r in combinations(exponential=True) if r == "quat"])
@each("theta", [0.1, 3.0, 4.0, 2 * math.pi, 100.0, 1e4, 1e6])
def test_constant_rate_is_exact_at_any_angle(method, theta):
    """To an ulp of the angle a step where the record says so; else flagged beyond the limit."""
    n = 10
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    scene = fa.Scene(rate=fa.rates.Constant(np.outer([theta / H], axis)))
    traj = run(scene, START[None], method, n=n)
    record = fa.METHODS[method]
    fine = theta < record.limit("quat") or record.exact_for_constant
    assert (traj.status == 0).tolist() == [fine]
    if fine:
        # an ulp of the product w h, one of its length, and the state's rounding
        ulps = 2.0 * np.spacing(theta) + 12 * EPS
        assert angle(traj.q[-1, 0], mul(START, exp(n * H * (theta / H * axis)))) < n * ulps


@pytest.mark.parametrize("method", [m for m, r in combinations(exponential=True) if r == "quat"])
def test_turns_past_the_limit_are_flagged_where_the_rate_may_vary(method):
    bodies = steady(np.outer([0.05, 7.0], [0.0, 0.0, 1.0]))
    traj = run(bodies, Q0[:2], method, h=1.0)
    assert traj.status.tolist() == [0, fa.Status.STEP_TOO_LARGE]
    assert traj.status_counts() == {"STEP_TOO_LARGE": 1}


def test_status_remembers_one_large_step():
    """A rate that peaks in the middle of the run."""
    peak = fa.rates.Polynomial([[0.0, 0.0, 0.0], [0.0, 0.0, 8.0], [0.0, 0.0, -8.0]])
    scene = fa.Scene(rate=fa.rates.Sum((fa.rates.Coning(0.0, 0.0), peak)))
    for h, flagged in ((0.1, False), (2.0, True)):
        traj = run(scene, START, n=round(1.0 / h) if h < 1 else 3, h=h, n_threads=1)
        assert bool(traj.status[0]) is flagged


def test_non_finite_state_is_flagged_for_that_body_alone():
    w = np.outer([0.1, 1e200, 0.1], [0.0, 0.6, 0.8])
    traj = run(steady(w), Q0[:3], "rk4", h=1.0)
    assert traj.status[1] & fa.Status.NON_FINITE
    assert traj.status[[0, 2]].tolist() == [0, 0]
    assert np.isfinite(traj.q[:, [0, 2]]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_parameters_that_are_not_finite_are_refused(bad):
    w = np.full((5, 3), 0.1)
    w[3, 1] = bad
    with pytest.raises(ValueError, match=rf"rate: Constant.w\[3, 1\] is {bad}; accepted"):
        fa.Scene(rate=fa.rates.Constant(w))


# a user's own rate


@njit
def user_cone(t, p):
    a, omega = p
    s = 2.0 * omega * math.sin(0.5 * a)
    c = math.cos(0.5 * a)
    return -s * c * math.sin(omega * t), s * c * math.cos(omega * t), -s * math.sin(0.5 * a)


def test_user_function_with_shared_parameters():
    scene = fa.Scene(rate=user_cone, params=(0.5, 1.2))
    ours = run(fa.Scene(rate=fa.rates.Coning(0.5, 1.2)), Q0[:5], save_every=35)
    theirs = run(scene, Q0[:5], save_every=35)
    assert angle(ours.q, theirs.q).max() < STEPS * 8 * EPS
    assert np.abs(ours.w - theirs.w).max() < 8 * EPS


def test_user_function_with_parameters_of_each_body():
    a, omega = BODIES.a, BODIES.omega
    scene = fa.Scene(rate=user_cone, params=np.stack([a, omega], axis=1))
    theirs = run(scene, Q0)
    ours = run(Motion(a, omega, np.zeros((N, 3, 3))), Q0)
    assert angle(ours.q, theirs.q).max() < STEPS * 8 * EPS
    one = run(fa.Scene(rate=user_cone, params=np.array([[a[70], omega[70]]])), Q0[[70]])
    assert same(one.q[:, 0], theirs.q[:, 70])


def closure(gain):
    def rate(t, p):
        return 0.0 * t, gain, gain * t

    return rate


def test_functions_that_close_over_a_number():
    """Two functions of one code are two rates; njit is optional, and so are parameters."""
    for gain, make in ((0.5, njit), (2.0, lambda function: function)):
        bodies = steady([[0.0, gain, 0.0]])
        bodies.c[0, 1, 2] = gain
        traj = run(fa.Scene(rate=make(closure(gain))), START)
        assert angle(traj.q[-1], run(bodies, START[None]).q[-1, 0]) < STEPS * 8 * EPS
        assert traj.w[-1] == pytest.approx([0.0, gain, gain * STEPS * H])


def test_arguments_are_not_changed():
    q0, a = Q0.copy(), BODIES.c.copy()
    run(BODIES, q0, save_every=1)
    assert same(q0, Q0)
    assert same(a, BODIES.c)


def test_default_method_fits_the_representation():
    assert fa.propagate(BODIES.shared, START, dt=H, n_steps=1).method == "magnus4"
    angles = fa.propagate(BODIES.shared, START, dt=H, n_steps=1, representation="euler313")
    assert angles.method == "rk4"
