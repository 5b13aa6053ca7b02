"""Reaction wheels beside SciPy's DOP853 and what their motion keeps."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fastatt as fa

WHOLE = np.array([[2.0, 0.1, -0.2], [0.1, 1.5, 0.15], [-0.2, 0.15, 1.2]])
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.48, -0.6, 0.64]])
INERTIA = np.array([0.02, 0.03, 0.025, 0.02])
FRICTION = {"viscous": (1e-3, 2e-3, 0.0, 1e-3), "coulomb": 0.01, "coulomb_speed": 2.0}
Q0 = np.array([0.8, 0.0, 0.6, 0.0])
W0 = np.array([0.3, -0.2, 0.4])
SPEEDS = np.array([6.0, -10.0, 3.0, 1.0])
RUN = {"dt": 0.02, "n_steps": 250, "method": "rk8"}
BY_RK4 = RUN | {"method": "rk4"}


def spin_up(t, q, w, s, p):
    return (p[0] * math.sin(t), -p[0] * w[0], p[1] * (20.0 - s[2]), 0.1 * q[1] * s[0] - 0.02 * s[3])


def pid(t, q, w, s, p):
    """Proportional, integral and derivative control; s is the integral of the error."""
    error = tuple(2.0 * q[0] * x for x in q[1:])
    torque = tuple(-p[0] * e - p[1] * s[k] - p[2] * w[k] for k, e in enumerate(error))
    return torque, error


def wheels(**options):
    return fa.torques.ReactionWheels(AXES, INERTIA, **options)


DRIVEN = wheels(command=spin_up, params=(0.3, 0.02), **FRICTION)
SCENE = fa.Scene(inertia=DRIVEN.body_inertia(WHOLE), torque=DRIVEN)
S0 = DRIVEN.momenta(SPEEDS, W0)
PUSH = (0.02, 0.0, -0.01)


def truth(end, motors, n_more=0, scene_torque=None, begin=None):
    """(q, w, speeds, more) at the end by DOP853, from Euler's equation of the whole spacecraft.

    Its unknowns are the speeds, whose equations J (Ω̇ + a·ẇ) = u are solved together with it.
    """
    tensor, count = WHOLE, len(AXES)
    mass = np.zeros((3 + count, 3 + count))
    mass[:3, :3], mass[:3, 3:] = tensor, AXES.T * INERTIA
    mass[3:, :3], mass[3:, 3:] = INERTIA[:, None] * AXES, np.diag(INERTIA)

    def slope(t, y):
        q, w, speeds = y[:4] / np.linalg.norm(y[:4]), y[4:7], y[7 : 7 + count]
        net, changes = motors(t, tuple(q), tuple(w), tuple(speeds), tuple(y[7 + count :]))
        inside = tensor @ w + AXES.T @ (INERTIA * speeds)
        outer = np.zeros(3) if scene_torque is None else scene_torque(t)
        found = np.linalg.solve(mass, np.concatenate([outer - np.cross(w, inside), net]))
        a, v = y[0], y[1:4]
        turned = 0.5 * np.concatenate([[-v @ w], a * w + np.cross(v, w)])
        return np.concatenate([turned, found, changes])

    begin = np.concatenate([Q0, W0, SPEEDS, np.zeros(n_more)] if begin is None else begin)
    y = solve_ivp(slope, (0.0, end), begin, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return y[:4] / np.linalg.norm(y[:4]), y[4:7], y[7 : 7 + count], y[7 + count :]


def friction(speeds):
    x = np.array(speeds)
    return np.array(FRICTION["viscous"]) * x + 0.01 * x / np.hypot(x, 2.0)


def pushed(model):
    """A spacecraft with wheels and a disturbance."""
    terms = fa.torques.Sum((fa.torques.Constant(PUSH), model))
    return fa.Scene(inertia=model.body_inertia(WHOLE), torque=terms)


def agree(run, model, wanted, within):
    q, w, speeds, more = wanted
    assert fa.angle_between(run.q[-1], q) < within
    np.testing.assert_allclose(run.w[-1], w, atol=within, rtol=0.0)
    found = model.speeds(run.s[-1], run.w[-1])
    np.testing.assert_allclose(found, speeds, atol=30.0 * within, rtol=0.0)
    np.testing.assert_allclose(run.s[-1][len(AXES) :], more, atol=within, rtol=0.0)


def test_a_commanded_spin_up_is_that_of_dop853():
    def motors(t, q, w, speeds, more):
        return np.array(spin_up(t, q, w, speeds, (0.3, 0.02))) - friction(speeds), more

    run = fa.propagate(SCENE, Q0, W0, s0=S0, **RUN)
    assert SCENE.states == 4
    assert not run.status.any()
    agree(run, DRIVEN, truth(5.0, motors), 1e-10)


@pytest.mark.filterwarnings("ignore:s0. wheel 1 of body 0 starts at 10 rad/s")
def test_motors_have_limits():
    limited = wheels(
        command=spin_up, params=(0.3, 0.02), max_torque=(0.1, 0.02, 0.2, 0.1), max_speed=8.0
    )
    scene = fa.Scene(inertia=limited.body_inertia(WHOLE), torque=limited)

    def motors(t, q, w, speeds, more):
        u = np.clip(spin_up(t, q, w, speeds, (0.3, 0.02)), *([-1], [1]) * limits)
        room = (8.0 - np.sign(u) * np.array(speeds)) / 0.08
        return u * np.clip(room, 0.0, 1.0), more

    limits = np.array([0.1, 0.02, 0.2, 0.1])
    run = fa.propagate(scene, Q0, W0, s0=S0, **RUN | {"dt": 0.0025, "n_steps": 2000})
    # corners cost the steps in which they lie their order
    agree(run, limited, truth(5.0, motors), 1e-6)
    # a wheel that the body's own acceleration takes beyond its largest speed is not driven there
    held = fa.propagate(scene, Q0, W0, s0=S0, **RUN, save_every=1)
    speeds = limited.speeds(held.s, held.w)[:, 2]
    beyond = (speeds[:-1] > 8.0) & (speeds[1:] > 8.0)
    assert 7.9 < speeds[-1] < speeds.max() < 8.1
    assert beyond.any()
    assert np.abs(np.diff(held.s[:, 2])[beyond]).max() == 0.0


@pytest.mark.parametrize("inertia", [WHOLE, (2.0, 1.5, 1.2)], ids=["tensor", "moments"])
def test_angular_momentum_in_inertial_axes_is_constant(inertia):
    scene = fa.Scene(inertia=DRIVEN.body_inertia(inertia), torque=DRIVEN)
    run = fa.propagate(scene, Q0, W0, s0=S0, **RUN, save_every=25)
    assert fa.drift(run, scene).momentum.max() < 1e-12
    inside = run.w @ DRIVEN.body_inertia(inertia) + DRIVEN.momentum(run.s)
    total = fa.quat_rotate(run.q, inside)
    assert np.abs(total - total[0]).max() < 1e-12
    # momentum has gone from wheels to the body and back
    assert np.ptp(DRIVEN.momentum(run.s), axis=0).min() > 0.05


def test_energy_is_what_motors_and_friction_leave():
    """d(T)/dt = Σ u Ω: of body and wheels together, integrated by Simpson's rule."""
    run = fa.propagate(SCENE, Q0, W0, s0=S0, dt=0.005, n_steps=1000, save_every=1, method="rk8")
    speeds = DRIVEN.speeds(run.s, run.w)
    energy = energy_of(run, SCENE)
    net = [
        np.array(spin_up(t, q, w, s, (0.3, 0.02))) - friction(s)
        for t, q, w, s in zip(run.t, run.q, run.w, speeds, strict=True)
    ]
    power = (np.array(net) * speeds).sum(axis=-1)
    work = (power[:-1:2] + 4.0 * power[1::2] + power[2::2]).sum() * 0.005 / 3.0
    assert abs(energy[-1] - energy[0]) > 0.05
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-9)


def energy_of(run, scene):
    return fa.kinetic_energy(run.w, scene.inertia) + (0.5 * run.s**2 / INERTIA).sum(axis=-1)


def test_a_model_commands_the_torque_on_the_body():
    """PID control by four wheels, of each body with gains of its own, beside a disturbance."""
    gains = np.array([[0.8, 0.2, 1.2], [0.5, 0.1, 1.0]])
    model = wheels(command=fa.torques.Custom(pid, gains, states=3), **FRICTION)
    scene = pushed(model)
    assert scene.states == 7
    assert [f.followed for f in scene.functions] == [True]
    for body, p in enumerate(gains):

        def motors(t, q, w, speeds, more, p=p):
            torque, changes = pid(t, q, w, more, p)
            return -np.linalg.pinv(AXES.T) @ torque - friction(speeds), changes

        run = fa.propagate(scene[[body]], Q0, W0, s0=np.append(S0, np.zeros(3)), **RUN)
        agree(run, model, truth(5.0, motors, 3, lambda t: np.array(PUSH)), 1e-10)


def law(t, q, w, s, p):
    """Rate damping and integral control that reads the speeds; s are these, then the integral."""
    speeds, integral = s[:4], s[4:]
    torque = [p[0] * w[k] + p[1] * integral[k] for k in range(3)]
    motors = tuple(0.4 * torque[k % 3] - 0.003 * x for k, x in enumerate(speeds))
    return motors, tuple(2.0 * q[0] * x - 0.1 * m for x, m in zip(q[1:], integral, strict=True))


def test_a_function_with_states_reads_the_speeds():
    model = wheels(command=law, params=(0.8, 0.2), states=3, **FRICTION)
    scene = pushed(model)
    assert scene.states == 7

    def motors(t, q, w, speeds, more):
        found, changes = law(t, q, w, (*speeds, *more), (0.8, 0.2))
        return np.array(found) - friction(speeds), changes

    run = fa.propagate(scene, Q0, W0, s0=np.append(S0, np.zeros(3)), **RUN)
    agree(run, model, truth(5.0, motors, 3, lambda t: np.array(PUSH)), 1e-10)


def test_a_sampled_function_reads_the_speeds():
    """What it holds from one sample time to the next is a torque of each wheel."""
    period = 0.27
    model = wheels(command=law, params=(0.8, 0.2), states=3, period=period, **FRICTION)
    scene = fa.Scene(inertia=model.body_inertia(WHOLE), torque=model)
    assert scene.states == 11
    s0 = np.append(S0, np.zeros(7))
    # a step size that does not divide the period
    run = fa.propagate(scene, Q0, W0, s0=s0, dt=0.02, t_end=5.0 * period + 0.1, method="rk8")
    found, memory = (Q0, W0, SPEEDS), np.zeros(3)
    for k in range(6):
        q, w, speeds = found[:3]
        held, memory = law(k * period, q, w, (*speeds, *memory), (0.8, 0.2))

        def motors(t, q, w, speeds, more, held=held):
            return np.array(held) - friction(speeds), more

        found = truth(period if k < 5 else 0.1, motors, begin=found[:3])
    agree(run, model, (*found[:3], np.concatenate([held, memory])), 1e-10)


def test_numbers_of_each_body():
    axes = np.stack([AXES, AXES[[1, 2, 0, 3]]])
    given = {"inertia": INERTIA, "command": spin_up, "params": (0.3, 0.02), "max_torque": 0.2}
    own = fa.torques.ReactionWheels(axes, coulomb=[[0.0], [0.01]], **given)
    scene = fa.Scene(inertia=own.body_inertia(WHOLE), torque=own)
    s0 = own.momenta(SPEEDS, W0)
    assert s0.shape == (2, 4)
    run = fa.propagate(scene, [Q0, Q0], W0, s0=s0, **BY_RK4)
    for body, coulomb in enumerate((0.0, 0.01)):
        one = fa.torques.ReactionWheels(axes[body], coulomb=coulomb, **given)
        alone = fa.Scene(inertia=one.body_inertia(WHOLE), torque=one)
        found = fa.propagate(alone, Q0, W0, s0=s0[body], **BY_RK4)
        assert fa.angle_between(found.q[-1], run.q[-1, body]) < 1e-14
        np.testing.assert_allclose(found.s[-1], run.s[-1, body], rtol=0.0, atol=1e-14)
    np.testing.assert_array_equal(scene[[1]].torque.axes, axes[[1]])
    assert pickle.loads(pickle.dumps(scene)) == scene
    back = own.speeds(run.s, run.w)
    assert back.shape == (1, 2, 4)
    np.testing.assert_allclose(own.momenta(back, run.w), run.s, atol=1e-14)


def test_a_command_may_depend_on_the_position():
    law = fa.torques.Custom(lambda t, q, w, v, r, p: (-0.1 * r[0], 0.0, 0.0), uses_position=True)
    three = fa.torques.ReactionWheels(np.eye(3), 0.1, law)
    scene = fa.Scene(
        inertia=(3.0, 2.0, 1.0), torque=three, mass=2.0, force=lambda t, q, w, v, p: (0.0, 0.0, 0.0)
    )
    run = fa.propagate(
        scene, [1, 0, 0, 0], [0, 0, 0], v0=[1.0, 0, 0], r0=[0, 0, 0], s0=[0, 0, 0], **BY_RK4
    )
    np.testing.assert_allclose(run.s[-1], [0.1 * 5.0**2 / 2.0, 0.0, 0.0], atol=1e-14)


def test_one_wheel_takes_a_number():
    one = fa.torques.ReactionWheels([[0, 0, 1]], 0.1, lambda t, q, w, s, p: 0.2)
    scene = fa.Scene(inertia=one.body_inertia((2.0, 2.0, 2.1)), torque=one)
    w0 = [0, 0, 0.35]
    run = fa.propagate(scene, [1, 0, 0, 0], w0, s0=one.momenta(10.0, w0), **BY_RK4)
    # about one axis all is closed: the body without the wheel has 2 kg·m²
    assert run.w[-1, 2] == pytest.approx(0.35 - 0.2 / 2.0 * 5.0, abs=1e-14)
    speed = 10.0 + 0.2 * 5.0 * (1.0 / 0.1 + 1.0 / 2.0)
    assert one.speeds(run.s, run.w)[-1, 0] == pytest.approx(speed, abs=1e-12)


def test_a_wheel_that_failed_gives_no_torque():
    failed = wheels(command=lambda t, q, w, s, p: (0.3,) * 4, max_torque=[0.1, 0.0, 1.0, 0.1])
    scene = fa.Scene(inertia=failed.body_inertia(WHOLE), torque=failed)
    run = fa.propagate(scene, Q0, W0, s0=failed.momenta(SPEEDS, W0), **BY_RK4)
    change = run.s[-1] - failed.momenta(SPEEDS, W0)
    assert change == pytest.approx(np.array([0.1, 0.0, 0.3, 0.1]) * 5.0, abs=1e-13)


def held(t, q, w, s, p):
    """Torques that tell the sample time, and one state of its own that counts samples."""
    return (1.0 + t, 2.0 + t), (s[-1] + 1.0,)


def on_body(t, q, w, s, p):
    return (1.0 + t, 2.0 + t, 3.0 + t), (s[0] + 1.0,)


@pytest.mark.parametrize(
    ("command", "options", "torques", "slopes"),
    [
        (held, {"period": 0.2, "states": 1}, (1.0, 2.0), (1.0, 2.0)),
        (fa.torques.SampledControl(on_body, 0.2, states=1), {}, (1.0, 2.0, 3.0), (-1.0, -2.0)),
    ],
    ids=["motors", "body"],
)
def test_states_are_momenta_held_torques_and_own_states(command, options, torques, slopes):
    """A save at a sample time holds what was held up to there."""
    pair = fa.torques.ReactionWheels(np.eye(3)[:2], 0.02, command, **options)
    scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=pair)
    first = [0.1, 0.2, *[9.0] * len(torques), 5.0]
    run = fa.propagate(
        scene, Q0, [0, 0, 0], s0=first, dt=0.1, n_steps=3, save_every=1, method="rk4"
    )
    momenta, kept, own = np.split(run.s, [2, -1], axis=1)
    assert run.s.shape[1] == scene.states == len(first)
    assert momenta[2] == pytest.approx([0.1, 0.2] + 0.2 * np.array(slopes), abs=1e-14)
    times = [0.0, 0.0, 0.2]
    assert kept[1:] == pytest.approx(np.add.outer(times, torques), abs=1e-14)
    assert (kept[0] == 9.0).all()
    assert own[:, 0].tolist() == [5.0, 6.0, 6.0, 7.0]


RATE, PLACE, MU = 0.05, np.array([3.0, -4.0, 12.0]), 7.0


def of_whole(o, rate):
    return 3.0 * rate**2 * np.cross(o, WHOLE @ o)


def on_a_circle(t, q, w, p):
    o = fa.kernels.quat.rotate_inverse(q, (math.cos(RATE * t), math.sin(RATE * t), 0.0))
    return tuple(of_whole(np.array(o), RATE))


def at_a_place(t, q, w, p):
    return tuple(of_whole(np.array(fa.kernels.quat.rotate_inverse(q, tuple(PLACE / 13.0))), FALL))


FALL = math.sqrt(MU / 13.0**3)


@pytest.mark.parametrize(
    ("model", "function", "representation", "axes"),
    [
        (fa.torques.GravityGradient(RATE), on_a_circle, "quat", AXES),
        (fa.torques.GravityGradientAt(PLACE, MU), at_a_place, "dcm", AXES[[3, 0]]),
    ],
    ids=["circle", "place"],
)
def test_gravity_gradient_beside_wheels_is_that_of_the_whole(model, function, representation, axes):
    driven = fa.torques.ReactionWheels(axes, 0.3, viscous=0.01)
    inertia = driven.body_inertia(WHOLE)
    options = {"s0": driven.momenta(4.0, W0), "dt": 0.05, "representation": representation}
    runs = []
    for beside in (model, fa.torques.Custom(function)):
        scene = fa.Scene(inertia=inertia, torque=fa.torques.Sum((driven, beside)))
        runs.append(fa.propagate(scene, Q0, W0, n_steps=200, method="rk8", **options))
    assert fa.angle_between(runs[0].q, runs[1].q).max() < 1e-13
    assert np.abs(runs[0].w - runs[1].w).max() < 1e-13


def test_gravity_gradient_at_the_propagated_position_is_that_of_the_whole():
    """As at a place that the body does not leave."""
    driven = fa.torques.ReactionWheels(AXES, 0.2)
    options = {"s0": driven.momenta(4.0, W0), "dt": 0.05, "n_steps": 100, "method": "rk4"}
    moved = fa.Scene(
        inertia=driven.body_inertia(WHOLE), mass=2.0, force=lambda t, q, w, v, p: (0.0, 0.0, 0.0),
        torque=fa.torques.Sum((fa.torques.CentralGravityGradient(MU), driven)),
    )  # fmt: skip
    still = fa.Scene(
        inertia=moved.inertia,
        torque=fa.torques.Sum((fa.torques.GravityGradientAt(PLACE, MU), driven)),
    )
    run = fa.propagate(moved, Q0, W0, v0=(0.0, 0.0, 0.0), r0=PLACE, **options)
    assert fa.angle_between(run.q, fa.propagate(still, Q0, W0, **options).q).max() < 1e-13


def test_axes_and_inertias_of_each_body_enter_the_gravity_gradient():
    rng = np.random.default_rng(4)
    axes = rng.normal(size=(5, 2, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    moments = rng.uniform(0.05, 0.2, (5, 2))

    def run(axes, moments):
        driven = fa.torques.ReactionWheels(axes, moments)
        terms = fa.torques.Sum((fa.torques.GravityGradient(RATE), driven))
        scene = fa.Scene(inertia=driven.body_inertia(WHOLE), torque=terms)
        s0 = np.ones(moments.shape)
        return fa.propagate(scene, Q0, W0, s0=s0, dt=0.1, n_steps=50, method="rk4").q[-1]

    together = run(axes, moments)
    for k in range(5):
        assert fa.angle_between(together[k], run(axes[k], moments[k])) < 1e-14
