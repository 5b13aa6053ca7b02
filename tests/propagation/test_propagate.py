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


def run(bodies, q0, method="magnus4", representation="quat", n=STEPS, h=H, **options):
    scene = bodies.scene if isinstance(bodies, Motion) else bodies
    options = {"method": method, "representation": representation, **options}
    return fa.propagate(scene, q0, dt=h, n_steps=n, **options)


def same(a, b):
    """Every bit: NaN equals NaN, 0 does not equal −0."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


def test_shared_and_own_parameters_agree_to_round_off():
    own = run(BODIES.take([0] * N), Q0)
    assert angle(own.q, run(BODIES.shared, Q0).q).max() < STEPS * 4 * EPS


def test_one_start_for_many_rates_is_not_guessed():
    with pytest.raises(ValueError, match=r"for 200 bodies; accepted: 1, .* q0 of shape \(200, 4\)"):
        run(BODIES, START)


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


@pytest.mark.parametrize("own", [False, True])
def test_users_functions(own):
    """With parameters that all share, and of each body."""
    a, omega = (BODIES.a, BODIES.omega) if own else (0.5, 1.2)
    scene = fa.Scene(rate=user_cone, params=np.stack([a, omega], axis=-1))
    ours = run(fa.Scene(rate=fa.rates.Coning(a, omega)), Q0, save_every=35)
    theirs = run(scene, Q0, save_every=35)
    assert angle(ours.q, theirs.q).max() < STEPS * 8 * EPS
    assert np.abs(ours.w - theirs.w).max() < 8 * EPS


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
    assert fa.propagate(BODIES.shared, START, dt=H, n_steps=1).method == "magnus6"
    angles = fa.propagate(BODIES.shared, START, dt=H, n_steps=1, representation="euler313")
    assert angles.method == "rk4"
