"""Numbers that bodies have in common: found, and worked on once (the bits: test_one_result)."""

import math

import numpy as np
from machine_code import texts

import fastatt as fa
from fastatt.propagation import plan as plan_module

N = 70
CHANCE = np.random.default_rng(3)
Q0, W0 = CHANCE.normal(size=(N, 4)), CHANCE.normal(size=(N, 3))
SIZES = CHANCE.uniform(0.8, 1.2, size=(N, 1))
TURN = {"dt": 0.05, "n_steps": 12}


def swinging(t, q, w, p):
    return p[0] * math.sin(p[1] * t), p[2] - w[0], p[0] * q[1]


OWN = np.hstack([SIZES, np.full((N, 1), 1.7), SIZES[::-1]])
ORBIT = fa.torques.GravityGradient(0.3)
SCENES = {
    "cones": fa.Scene(rate=fa.rates.Coning(0.3 * SIZES[:, 0], 1.7)),
    "orbit": fa.Scene(inertia=SIZES * (2.0, 1.5, 1.0), torque=ORBIT),
    "long": fa.Scene(inertia=SIZES * (1.0, 0.0, 0.0) + (0.0, 1.5, 1.0)),
    "function": fa.Scene(inertia=(2.0, 1.5, 1.0), torque=swinging, params=OWN),
    "moved": fa.Scene(
        inertia=(2.0, 1.5, 1.0), mass=SIZES[:, 0], force=(1.0, 0.0, 0.5), torque=ORBIT
    ),
}


def alike(scene, method, n=N):
    return fa.plan(scene, n, method=method, **TURN).program.job.alike


def test_one_body_that_differs_is_enough():
    """By its last bit, or by the sign of a zero."""
    for value, other in ((1.7, np.nextafter(1.7, 2.0)), (0.0, -0.0)):
        rates = np.full(N, value)
        rates[-1] = other
        assert alike(fa.Scene(rate=fa.rates.Coning(0.3, rates)), "rk4") == (0,)
        rates[-1] = value
        assert alike(fa.Scene(rate=fa.rates.Coning(0.3, rates)), "rk4") == (0, 1)


def test_what_is_alike_is_worked_on_once(monkeypatch):
    """The sine of an orbit's angle, which bodies of different sizes are on: in no lanes' number."""
    assert len(alike(SCENES["orbit"], "rk4")) == 7  # the orbit's rate and axes
    found = {}
    for many in (64, N + 1):
        monkeypatch.setattr(plan_module, "_MANY", many)
        found[many] = vectors_of(fa.plan(SCENES["orbit"], N, method="rk4", **TURN).program.job)
    (few, turns), (more, sines) = found[64], found[N + 1]
    assert few < more - 100  # a sine and a cosine, and what turns by them
    assert turns == 0 < sines  # no angle is less whole turns in any lane


def vectors_of(job):
    """Operations on vectors in the loop's text, and those of them that round."""
    lines = [x for x in texts(job)[0].splitlines() if "<" in x]
    return sum(" x double>" in x for x in lines), sum("llvm.rint.v" in x for x in lines)
