"""Runs at given rates: parameters, saves, users' functions, the method chosen."""

import numpy as np
import pytest
from exact import EPS, START, angle, generic, steady
from numba import njit

import fastatt as fa

N, STEPS, H = 200, 70, 0.02  # more than three tiles of 64 bodies, and more than a block of 64 steps
BODIES = generic(N)
Q0 = np.random.default_rng(3).normal(size=(N, 4))


def run(scene, q0, **options):
    return fa.propagate(scene, q0, **{"dt": H, "n_steps": STEPS, "method": "magnus4"} | options)


def test_parameters_of_each_body_and_of_all():
    """They agree to round-off; rates of the trajectory are those of the model."""
    own = run(BODIES.take([0] * N).scene, Q0)
    assert angle(own.q, run(BODIES.shared, Q0).q).max() < STEPS * 4 * EPS
    traj = run(BODIES.scene, Q0, save_every=7, t0=0.3)
    assert np.abs(traj.w - BODIES.rate(traj.t)).max() < 8 * EPS


@pytest.mark.parametrize("method", ["magnus4", "cf4"])
def test_saves_do_not_change_a_body_that_comes_to_turn_fast(method):
    """From below π a step to above and back within a block of steps."""
    bodies = steady([[0.0, 0.0, 10.0]] * 3)
    bodies.c[1] += [[0.3, 0.0, 0.0], [0.0, 0.1, 1400.0], [0.0, 0.0, -1000.0]]
    plain = run(bodies.scene, Q0[:3], method=method, save_every=1)
    assert plain.status.tolist() == [0, fa.Status.STEP_TOO_LARGE, 0]
    for every in (None, 5, 64):
        traj = run(bodies.scene, Q0[:3], method=method, save_every=every)
        assert traj.q.tobytes() == plain.q[np.round(traj.t / H).astype(int)].tobytes()


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
        assert angle(traj.q[-1], run(bodies.scene, START[None]).q[-1, 0]) < STEPS * 8 * EPS
        assert traj.w[-1] == pytest.approx([0.0, gain, gain * STEPS * H])


def test_default_method_fits_the_representation():
    for representation, method in (("quat", "magnus6"), ("euler313", "rk4")):
        given = {"dt": H, "n_steps": 1, "representation": representation}
        assert fa.propagate(BODIES.shared, START, **given).method == method
