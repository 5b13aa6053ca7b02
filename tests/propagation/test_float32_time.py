"""Single precision holds the state; time, parameters and the phases made of them are double."""

import math

import numpy as np
import pytest

import fastatt as fa
from fastatt.propagation.inspect_step import job_of
from fastatt.tracing.nodes import operands

N, STEPS, H = 5, 400, 0.01
ANGLE, OMEGA = np.linspace(0.3, 1.4, N), np.linspace(0.7, 3.1, N)
FAR = [0.0, -1e4, 1e6, 1.7e9]


def exact(t):
    s, half = np.sin(0.5 * ANGLE), 0.5 * ANGLE
    return np.stack([np.cos(half), s * np.cos(OMEGA * t), s * np.sin(OMEGA * t), 0.0 * OMEGA], -1)


def users(t, p):
    k = p[1] * math.sin(p[0])
    return -k * math.sin(p[1] * t), k * math.cos(p[1] * t), p[1] * (math.cos(p[0]) - 1.0)


SCENES = {
    "coning": fa.Scene(rate=fa.rates.Coning(ANGLE, OMEGA)),
    "user": fa.Scene(rate=users, params=np.stack([ANGLE, OMEGA], axis=-1)),
    "precession": fa.Scene(
        rate=fa.rates.Precession(
            OMEGA * np.sin(ANGLE), OMEGA * (np.cos(ANGLE) - 1.0), OMEGA, math.pi / 2
        )
    ),
}


@pytest.mark.parametrize("t0", FAR)
@pytest.mark.parametrize("name", SCENES)
def test_a_body_with_numbers_of_its_own_keeps_its_phase(name, t0):
    """Rounding of the state, 2⁻²⁴ a step as a random walk, twice that of a step's own angle."""
    found = fa.propagate(
        SCENES[name], exact(t0), dt=H, n_steps=STEPS, t0=t0, method="rk4", dtype="float32"
    )
    end = exact(t0 + STEPS * H)
    error = 2.0 * np.linalg.norm(found.q[-1] - end * np.sign(found.q[-1, :, :1]), axis=-1)
    # a time of double precision is right to an ulp, and a phase to as much times the frequency
    clock = 2.0 * OMEGA.max() * np.spacing(abs(t0) + STEPS * H)
    assert error.max() < 3.0 * 2.0**-24 * math.sqrt(STEPS) + clock
    assert not found.status.any()


@pytest.mark.parametrize("t0", FAR)
def test_a_torque_that_depends_on_time_keeps_its_phase(t0):
    """The same torque counted from a start of its own."""
    turns = 2.0 * math.pi / OMEGA  # whole ones lie behind t0
    began = np.round(t0 / turns) * turns

    def torque(t, q, w, p):
        return 0.1 * math.sin(p[0] * (t - p[1])), 0.0, 0.05 * math.cos(p[0] * (t - p[1]))

    def late(t, q, w, p):
        return torque(t, q, w, p)

    ends = []
    for start, dtype in ((0.0 * began, "float32"), (began, "float64")):
        scene = fa.Scene(
            inertia=(2.0, 1.0, 0.7), torque=late, params=np.stack([OMEGA, start], axis=-1)
        )
        run = fa.propagate(
            scene, [[1.0, 0, 0, 0]] * N, [0.1, 0.2, 0.3], dt=H, n_steps=STEPS, t0=t0, dtype=dtype
        )
        ends.append(run.w[-1])
    # whole turns in double precision: |t0| OMEGA 2⁻⁵² rad, and an ulp of the time
    clock = 8.0 * OMEGA.max() * np.spacing(max(1.0, abs(t0)))
    assert np.abs(ends[0] - ends[1]).max() < 8.0 * 2.0**-24 * math.sqrt(STEPS) + clock


def test_what_a_torque_makes_of_time_does_not_widen_the_state():
    """A direction that turns with time is rotated in single precision."""
    field = fa.torques.Sum((fa.torques.GravityGradient(0.5), fa.torques.Damping(0.02)))
    job = job_of(fa.Scene(inertia=(2.0, 1.0, 0.7), torque=field), "rk4", "quat", np.float32)
    flat = job.small_angle
    moving = {i for i, node in enumerate(flat.nodes) if node.args[:1] == ("x",)}
    for i, node in enumerate(flat.nodes):
        if moving & set(operands(node)):
            moving.add(i)
    assert len(moving) > 100
    assert {flat.nodes[i].precision for i in moving} <= {"single", ""}
