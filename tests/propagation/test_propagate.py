"""Runs at given rates: parameters, saves, clocks, users' functions, the method chosen."""

from __future__ import annotations

import numpy as np
import pytest
from exact import EPS, START, Motion, angle, generic, steady
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


# clocks


def test_times_do_not_accumulate():
    traj = run(BODIES.shared, START, n=100_000, h=0.1, save_every=25_000, t0=3.0)
    assert same(traj.t, 3.0 + np.array([0, 25_000, 50_000, 75_000, 100_000]) * 0.1)


def test_rates_of_the_trajectory_are_those_of_the_model():
    traj = run(BODIES, Q0, save_every=7, t0=0.3)
    assert np.abs(traj.w - BODIES.rate(traj.t)).max() < 8 * EPS


# a user's own rate


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


def test_default_method_fits_the_representation():
    assert fa.propagate(BODIES.shared, START, dt=H, n_steps=1).method == "magnus6"
    angles = fa.propagate(BODIES.shared, START, dt=H, n_steps=1, representation="euler313")
    assert angles.method == "rk4"
