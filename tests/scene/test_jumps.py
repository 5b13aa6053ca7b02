"""Built-in torques that jump where the state passes a threshold: a step across is told."""

import numpy as np
import pytest
from each import each

import fastatt as fa

pytestmark = pytest.mark.filterwarnings("ignore:status.*JUMP")
JUMP = fa.Status.JUMP
INERTIA = [[12.0, -0.8, 0.4], [-0.8, 9.0, -0.3], [0.4, -0.3, 7.0]]
TARGET = np.array([0.1, 0.7, -0.5, 0.5])
TARGET /= np.linalg.norm(TARGET)
PD = fa.torques.QuaternionPD((0.2, 0.3, 0.1), 0.5, target=TARGET, limit=0.02)
SCENE = fa.Scene(inertia=INERTIA, torque=PD)
RNG = np.random.default_rng(11)
Q0, W0 = RNG.normal(size=(60, 4)), RNG.normal(0.0, 0.1, (60, 3))
RUN = {"dt": 0.1, "n_steps": 400, "method": "rk4"}


def passes(run):
    """Which bodies pass 180°, by the sign of the scalar part of an error that is continuous."""
    scalar = run.q @ TARGET  # of the product of one with the conjugate of the other
    return (np.sign(scalar[1:]) != np.sign(scalar[:-1])).any(axis=0)


@each(
    "options",
    [
        {}, {"representation": "dcm_rows"}, {"representation": "mrp"}, {"method": "rkmk4"},
        {"method": "gbs16", "dt": 0.4, "n_steps": 100}, {"compensated": True}, {"dtype": "f4"},
        {"dt": -0.1},
    ],
)  # fmt: skip
def test_pd_across_half_a_turn(options):
    """And no other body: not where a quaternion of a matrix changes its sign."""
    options = {**RUN, **options}
    plain = {**options, "representation": "quat", "save_every": 1}
    expected = passes(fa.propagate(SCENE, Q0, W0, **plain))
    run = fa.propagate(SCENE, Q0, W0, **options)
    assert 5 < expected.sum() < 55
    assert ((run.status & JUMP) != 0).tolist() == expected.tolist()


def test_a_step_across_is_told():
    with pytest.warns(RuntimeWarning, match=r"status: found JUMP \(\d+\), \d+ of 60 bodies"):
        fa.propagate(SCENE, Q0, W0, **RUN)


def test_what_is_told_is_kept(tmp_path):
    """By a run that goes on from a file."""
    whole = fa.propagate(SCENE, Q0, W0, **RUN)
    first = fa.propagate(SCENE, Q0, W0, **{**RUN, "n_steps": 100})
    first.save_end(tmp_path / "end")
    rest = fa.resume(SCENE, tmp_path / "end", n_steps=300)
    assert rest.status.tolist() == whole.status.tolist()
    assert 0 < (first.status != 0).sum() < (whole.status != 0).sum()


def test_a_body_that_stops_before_the_jump_has_no_flag():
    """The step in which it stops counts, those after it do not."""
    run = fa.propagate(SCENE, Q0, W0, **RUN, save_every=1)
    body = int(passes(run).argmax())
    scalar = run.q[:, body] @ TARGET
    step = int((np.sign(scalar[1:]) != np.sign(scalar[:-1])).argmax())
    for share in (-0.5, 0.5):
        time = run.t[step] + share * RUN["dt"]
        stop = fa.event(lambda t, q, w, p, time=time: t - time, terminal=True)
        stopped = fa.propagate(SCENE, Q0[body], W0[body], **RUN, events=[stop])
        assert stopped.event_times[0] == pytest.approx(time)
        assert stopped.status.tolist() == [JUMP * (share > 0.0)]


def wheels(slow, coulomb=2e-3):
    torque = fa.torques.ReactionWheels(
        np.eye(3), 0.01, fa.torques.QuaternionPD(0.2, 0.5), coulomb=coulomb, coulomb_speed=slow
    )
    scene = fa.Scene(inertia=torque.body_inertia((2.0, 1.5, 1.0)), torque=torque)
    return scene, torque.momenta([3.0, -2.0, 1.0], [0.02, -0.03, 0.01])


@each("slow, coulomb, is_told", [(0.01, 2e-3, True), (0.01, 0.0, False), (1.0, 2e-3, False)])
def test_friction_of_wheels_within_a_step(slow, coulomb, is_told):
    """Which half of the step confirms: it changes the attitude by 6e-5 rad or 2e-9 rad."""
    scene, s0 = wheels(slow, coulomb)
    start = {"q0": [0.9, 0.3, 0.2, -0.1], "w0": [0.02, -0.03, 0.01], "s0": s0}
    run, fine = (
        fa.propagate(scene, **start, dt=dt, t_end=20.0, method="rk4") for dt in (0.1, 0.05)
    )
    assert bool(run.status[0] & JUMP) == is_told
    assert (fa.angle_between(run.q[-1], fine.q[-1]) > 1e-6) == is_told


@each("is_sampled", [False, True])
def test_a_command_of_wheels(is_sampled):
    """A controller that is sampled is held within a step, whatever it jumps by."""
    pd = fa.torques.QuaternionPD(0.2, 0.5)
    command = fa.torques.SampledControl(pd, 0.1) if is_sampled else pd
    torque = fa.torques.ReactionWheels(np.eye(3), 0.01, command)
    scene = fa.Scene(inertia=torque.body_inertia((2.0, 1.5, 1.0)), torque=torque)
    w0 = [0.0, 0.0, 3.0]
    s0 = [*torque.momenta(0.0, w0), *[0.0] * (3 * is_sampled)]
    run = fa.propagate(scene, [0.6, 0.0, 0.0, 0.8], w0, s0=s0, dt=0.1, n_steps=100, method="rk4")
    assert bool(run.status[0] & JUMP) != is_sampled
