"""Values that are finite and most likely wrong: a run says so, once."""

import math
import warnings

import numpy as np
import pytest
from each import each, in_tiers

import fastatt as fa

Q0, W0 = [1.0, 0.0, 0.0, 0.0], [0.05, 0.0, 0.1]


def flexible(t, q, w, s, p):
    return (0.0, 0.0, 0.0), (s[1], -(p[0] ** 2) * s[0] - 0.01 * p[0] * s[1])


def lagging(t, q, w, s, p):
    return (0.0, 0.0, 0.0), (-p[0] * s[0] + w[2], 0.1 * s[0])


def driven(t, s, p):
    return (0.0, 0.0, 1e-3 * s[0]), (-p[0] * s[0], 0.0)


def of_states(function, rate, bodies=1):
    """A scene whose states change at a rate, 1/s, those of the last body alone."""
    rates = np.full((bodies, 1), 0.1)
    rates[-1] = rate
    acting = {"rate": function} if function is driven else {"inertia": (3.0, 2.0, 1.0)}
    acting |= {} if function is driven else {"torque": function}
    return fa.Scene(**acting, states=2, params=rates)


def run_states(scene, method, dt=0.1):
    bodies = scene.rows
    more = {} if scene.kind == "rate" else {"w0": [W0] * bodies}
    return fa.propagate(
        scene, [Q0] * bodies, **more, s0=[[1.0, 0.0]] * bodies, dt=dt, n_steps=3, method=method
    )


METHODS = [m.name for m in fa.METHODS.values() if m.couples]
FUNCTIONS = (flexible, 0.5), (lagging, 1.0), (driven, 1.0)
OFTEN = [("rk4", *FUNCTIONS[0]), ("gbs16", *FUNCTIONS[2])]


@pytest.mark.parametrize(
    ("method", "function", "share"), in_tiers(OFTEN, [(m, *f) for m in METHODS for f in FUNCTIONS])
)
def test_states_that_change_too_fast(method, function, share):
    limit = share * fa.METHODS[method].damping_limit
    for bodies in (1, 70):
        for dt in (0.1, -0.1):
            if function is not flexible and dt < 0.0:
                continue  # it grows
            with pytest.warns(fa.StepWarning, match=r"dt: a state of the scene .* take \|dt\| <= "):
                run_states(of_states(function, 1.05 * limit / 0.1, bodies), method, dt)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                run_states(of_states(function, 0.95 * limit / 0.1, bodies), method, dt)


def test_the_step_that_is_advised_for_states_is_good():
    """To what the closed form of the damped oscillator says."""
    scene = of_states(flexible, 60.0)
    with pytest.warns(fa.StepWarning) as told:
        run_states(scene, "rk8")
    h = 0.5 * float(str(told[0].message).rpartition("<= ")[2])
    n = round(2.0 / h)
    run = fa.propagate(scene, [Q0], [W0], s0=[[1.0, 0.0]], dt=2.0 / n, n_steps=n, method="rk8")
    decay = 0.005 * 60.0
    turn = math.sqrt(60.0**2 - decay**2)
    right = math.exp(-decay * 2.0) * (math.cos(turn * 2.0) + decay / turn * math.sin(turn * 2.0))
    assert abs(run.s[-1, 0, 0] - right) < 1e-2


WHEELS = fa.torques.ReactionWheels(np.eye(3), 0.01, max_torque=0.05, max_speed=400.0)


@each("torque", (WHEELS, fa.torques.Sum([fa.torques.Damping(0.1), WHEELS]),
                 fa.torques.Sum({"wheels": WHEELS})))  # fmt: skip
def test_wheels_that_start_beyond_their_largest_speed(torque):
    scene = fa.Scene(inertia=WHEELS.body_inertia((20.0, 18.0, 15.0)), torque=torque)
    steps = {"dt": 0.02, "n_steps": 2, "method": "rk8"}
    for s0 in ([1.0, -450.0, 2.0], [[1.0, 2.0, 3.0], [1.0, 100.0, 3.0]]):
        bodies = np.ndim(s0) == 2
        with pytest.warns(RuntimeWarning, match=r"s0: wheel 1 of body \d starts at .*momenta\("):
            fa.propagate(scene, [Q0] * 2 if bodies else Q0, W0, s0=s0, **steps)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fa.propagate(scene, Q0, W0, s0=WHEELS.momenta([399.0, -399.0, 1.0], W0), **steps)
