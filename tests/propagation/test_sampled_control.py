"""Controllers whose torque is computed at sample times and held in between."""

import numpy as np
import pytest
from exact import body_motion
from test_states import Q0, W0, J, apart

import fastatt as fa
from fastatt.propagation.breakpoints import breaks_within

PERIOD, END = 0.25, 2.0
GAINS = (0.8, 0.3, 1.5)


def pid(t, q, w, s, p):
    """A discrete-time controller: s is the sum of the error, and the number of samples."""
    error = [2.0 * q[0] * x for x in q[1:]]
    torque = [-p[0] * e - p[1] * s[k] - p[2] * w[k] for k, e in enumerate(error)]
    return torque, (*(s[k] + PERIOD * e for k, e in enumerate(error)), s[3] + 1.0)


def sampled(**options):
    control = fa.torques.SampledControl(pid, PERIOD, GAINS, states=4, **options)
    return fa.Scene(inertia=J, torque=control)


SCENE = sampled()
S0 = np.zeros(7)


def truth(end, held=(0.0, 0.0, 0.0), memory=(0.0,) * 4, start=0.0):
    """(q, w, s) by DOP853 from one sample time to the next; the first is at ``start``."""
    y, t, torque = np.concatenate([Q0, W0]), 0.0, np.array(held)
    edges = [start + k * PERIOD for k in range(100)]
    for until in [*(x for x in edges if x < end), end]:
        if until > t:
            y = body_motion(J, lambda t, q, w, y, held=torque: held, y, t, until)
        t = until
        if until < end:
            found, memory = pid(t, y[:4], y[4:], memory, GAINS)
            torque = np.array(found)
    return y[:4], y[4:], np.array([*torque, *memory])


WANTED = truth(END)


# steps that divide the period, that it divides, and that do neither
@pytest.mark.parametrize("dt", [0.05, 0.25, 0.5, 0.07, 0.031, 0.4])
def test_any_step_size_gives_the_same_motion(dt):
    run = fa.propagate(SCENE, Q0, W0, s0=S0, dt=dt, t_end=END, method="rk8")
    assert run.s[-1, 6] == 8.0  # samples
    assert apart(run, WANTED) < (1e-11 if dt < 0.2 else 1e-7)


@pytest.mark.parametrize(("method", "steps"), [("rk4", (16, 64)), ("rk8", (2, 8))])
@pytest.mark.parametrize("shift", [0, 1], ids=["dividing", "other"])
def test_methods_keep_their_order(method, steps, shift):
    errors = [
        apart(fa.propagate(SCENE, Q0, W0, s0=S0, dt=END / n, n_steps=n, method=method), WANTED)
        for n in (8 * steps[0] + shift, 8 * steps[1] + shift)
    ]
    if method == "rk8":
        assert max(errors) < 1e-11
    else:
        assert errors[1] < errors[0] / 4.0**3.7


def test_samples_on_another_clock():
    """Where the run begins between two of them, the torque of ``s0`` is held at first."""
    scene, held = sampled(start=0.1), (0.1, -0.2, 0.05)
    run = fa.propagate(scene, Q0, W0, s0=[*held, 0, 0, 0, 0], dt=0.03, t_end=END, method="rk8")
    assert apart(run, truth(END, held, start=0.1)) < 1e-11
    late = sampled(start=-3.0)
    run = fa.propagate(late, Q0, W0, s0=S0, t0=7.0, dt=0.03, t_end=7.0 + END, method="rk8")
    assert apart(run, WANTED) < 1e-11


def test_saves_hold_what_was_before_the_jump():
    run = fa.propagate(SCENE, Q0, W0, s0=S0, dt=0.05, n_steps=15, save_every=5, method="rk8")
    assert run.s[:, 6].tolist() == [0.0, 1.0, 2.0, 3.0]
    first = pid(0.0, Q0, W0, (0.0,) * 4, GAINS)
    np.testing.assert_allclose(run.s[1], [*first[0], *first[1]], rtol=0.0, atol=1e-15)


def test_breakpoints_that_are_sample_times_to_rounding_count_once():
    law = fa.torques.SampledControl(pid, 0.1, GAINS, states=4)
    scene = fa.Scene(inertia=J, torque=law, breakpoints=(0.25, 0.3, 0.7))
    found = breaks_within(scene, 0.0, 1.0)
    np.testing.assert_allclose(found.times, np.sort([0.25, *np.arange(10) / 10]), rtol=1e-15)
    assert (found.jumps == (found.times != 0.25)).all()


def pulse(t, q, w, p):
    return (0.3 if 0.5 < t < 0.9 else 0.0), 0.0, 0.0


def test_breakpoints_beside_samples():
    """One of them is a sample time, and where they are equal there is one jump."""
    law = fa.torques.SampledControl(pid, PERIOD, GAINS, states=4)
    both = fa.torques.Sum((fa.torques.Custom(pulse, uses_rate=False), law))
    scene = fa.Scene(inertia=J, torque=both, breakpoints=(0.5, 0.9))
    runs = [
        fa.propagate(scene, Q0, W0, s0=S0, dt=dt, t_end=END, method="rk8") for dt in (0.01, 0.037)
    ]
    assert all(run.s[-1, 6] == 8.0 for run in runs)
    assert fa.angle_between(runs[0].q[-1], runs[1].q[-1]) < 1e-12
    assert fa.angle_between(runs[0].q[-1], WANTED[0]) > 1e-3


def test_a_model_is_sampled_and_wheels_follow():
    """What wheels are commanded is held too, and the momentum of all of it stays."""
    pd = fa.torques.QuaternionPD((0.8, 0.6, 0.5), 1.2, limit=0.3)
    plain = fa.Scene(inertia=J, torque=fa.torques.SampledControl(pd, PERIOD))
    wheels = fa.torques.ReactionWheels(np.eye(3), 0.01, fa.torques.SampledControl(pd, PERIOD))
    driven = fa.Scene(inertia=J, torque=wheels)
    h0 = wheels.momenta(0.0, W0)
    with_wheels = fa.propagate(
        driven, Q0, W0, s0=[*h0, 0, 0, 0], dt=0.05, n_steps=40, save_every=5, method="rk8"
    )
    assert fa.drift(with_wheels, driven).momentum.max() < 1e-12
    held = with_wheels.s[:, 3:]
    rates = np.diff(with_wheels.s[:, :3], axis=0) / PERIOD
    np.testing.assert_allclose(rates, -held[1:], atol=1e-12)
    alone = fa.propagate(plain, Q0, W0, s0=[0, 0, 0], dt=0.05, n_steps=5, method="rk8")
    np.testing.assert_allclose(alone.s[-1], held[1], atol=1e-12)
    # by axis: the first sample is limited along two axes
    first = fa.propagate(plain, Q0, W0, s0=[0, 0, 0], dt=0.05, n_steps=1, method="rk8")
    unlimited = -np.array((0.8, 0.6, 0.5)) * Q0[1:] - 1.2 * W0
    assert (np.abs(unlimited) > 0.3).tolist() == [True, False, True]
    np.testing.assert_allclose(first.s[-1], np.clip(unlimited, -0.3, 0.3), atol=1e-15)


def law(t, q, w, p):
    return [-0.1 * q[0] * q[k + 1] - 0.3 * w[k] for k in range(3)]


def push(t, q, w, p):
    return (0.01 if 20.0 < t < 40.0 else 0.0), 0.0, 0.0


CONTROL = fa.torques.SampledControl(law, period=2.0)
HELD = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=CONTROL)
BEGIN = {
    "q0": fa.rotation_vector_to_quat([0.5, -1.0, 1.2]), "w0": [0, 0, 0], "s0": [0, 0, 0],
}  # fmt: skip
#: within steps and between samples
INSIDE = np.arange(0.5, 200.0, 0.7)


def fine(scene):
    return fa.propagate(scene, **BEGIN, dt=0.02, t_end=200.3, method="rk8", save_at=INSIDE).q


def test_advice_takes_no_step_longer_than_the_period():
    """Errors are measured after steps, and longer steps would be divided at the samples."""
    advice = fa.recommend(HELD, **BEGIN, t_end=200.3, tol=1e-6, methods=["rk8"])
    run = fa.propagate(HELD, **BEGIN, **advice.arguments, save_at=INSIDE)
    assert abs(advice.dt) <= 2.0
    assert fa.angle_between(run.q, fine(HELD)).max() < 1e-6
    assert fa.check_convergence(HELD, **BEGIN, dt=0.5, n_steps=100, method="rk4").passed


def test_a_torque_that_jumps_at_sample_times_keeps_the_order():
    torque = fa.torques.Sum((CONTROL, fa.torques.Custom(push)))
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=torque)
    declared = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=torque, breakpoints=(20.0, 40.0))
    run = fa.propagate(scene, **BEGIN, dt=0.1, t_end=200.3, method="rk8", save_at=INSIDE)
    assert fa.angle_between(run.q, fine(declared)).max() < 1e-12
