"""Terms of a torque that read each other, beside loops with SciPy's DOP853."""

import itertools
import math
import pickle

import numpy as np
import pytest
from each import in_tiers
from exact import body_motion

import fastatt as fa

T = fa.torques
INERTIA = np.array([20.0, 18.0, 15.0])
Q0, W0 = fa.rotation_vector_to_quat([0.3, -0.6, 0.8]), np.array([0.01, -0.015, 0.008])


def to_body(q, v):
    return np.asarray(fa.quat_rotate([q[0], *(-x for x in q[1:])], v))


def went(y, begin, end, torque, inertia=INERTIA, more=lambda t, q, w, y: ()):
    return body_motion(inertia, torque, y, begin, end, more=more)


def apart(run, y):
    return max(fa.angle_between(run.q[-1], y[:4]), np.abs(run.w[-1] - y[4:7]).max())


def coils(t, q, w, h, p):
    unloading, strength, most = p
    phase = 2.2e-3 * t
    inertial = strength * math.cos(phase), strength * math.sin(phase), 0.3 * strength
    b = np.array(fa.kernels.quat.rotate_inverse(q, inertial))
    dipole = unloading * np.cross(np.array(h), b) / np.dot(b, b)
    return np.cross(np.array([most * math.tanh(x / most) for x in dipole]), b)


COILS = (5e-4, 3e-5, 60.0)


def unloading(reads="wheels", **names):
    wheels = T.ReactionWheels(
        np.eye(3), 0.02, T.QuaternionPD(1.0, 5.0), viscous=1e-5, coulomb=1e-3, coulomb_speed=2.0,
        max_torque=0.05, max_speed=600.0,
    )  # fmt: skip
    terms = {"wheels": wheels, "coils": T.Custom(coils, COILS, reads=reads)}
    named = {names.get(name, name): term for name, term in terms.items()}
    return fa.Scene(inertia=wheels.body_inertia(INERTIA), torque=T.Sum(named)), wheels


def test_coils_unload_wheels():
    scene, wheels = unloading()
    q0, end = fa.rotation_vector_to_quat([0.03, -0.06, 0.08]), 10.0
    h0 = wheels.momenta([100.0, -75.0, 50.0], [0.0, 0.0, 0.0])
    run = fa.propagate(scene, q0, [0, 0, 0], s0={"wheels": h0}, dt=0.02, t_end=end, method="rk8")

    def net(t, q, w, y):
        speed = y[7:] / 0.02 - w
        u = np.clip(math.copysign(1.0, q[0]) * q[1:] + 5.0 * w, -0.05, 0.05)
        room = (600.0 - np.where(u < 0.0, -speed, speed)) / 6.0
        friction = 1e-5 * speed + 1e-3 * speed / np.sqrt(4.0 + speed * speed)
        return u * np.clip(room, 0.0, 1.0) - friction

    def torque(t, q, w, y):
        return np.cross(y[7:], w) - net(t, q, w, y) + coils(t, q, w, y[7:], COILS)

    y = went(np.array([*q0, 0, 0, 0, *h0]), 0.0, end, torque, INERTIA - 0.02, net)
    assert apart(run, y) < 1e-13
    np.testing.assert_allclose(run.s[-1, scene.parts["wheels"]], y[7:], rtol=0.0, atol=1e-12)
    moved = fa.quat_rotate(run.q[-1], INERTIA * run.w[-1] + y[7:]) - fa.quat_rotate(q0, h0)
    assert np.linalg.norm(moved) > 1e-4  # the coils do act


TIMES = np.linspace(0.0, 400.0, 81)
PHASE = 4.0 * math.pi / 5400.0 * TIMES
FIELD = fa.TimeSeries(
    TIMES,
    3e-5 * np.stack([np.cos(PHASE), np.sin(PHASE), 0.4 * np.cos(0.5 * PHASE)], axis=1),
    kind="cubic",
)


def bdot(t, q, w, s, p):
    b = fa.kernels.quat.rotate_inverse(q, FIELD(t))
    dipole = [-p[0] * (x - y) / 0.2 for x, y in zip(b, s, strict=True)]
    return [min(p[1], max(-p[1], x)) for x in dipole], b


def test_a_dipole_is_held():
    inertia, gains = np.array([0.05, 0.06, 0.02]), (2e5, 0.2)
    held = T.SampledControl(bdot, 0.2, params=gains, states=3, holds=3)
    torque = T.Sum({"bdot": held, "rods": T.MagneticDipole("bdot", FIELD)})
    scene = fa.Scene(inertia=inertia, torque=torque)
    w0, y = 10.0 * W0, np.concatenate([Q0, 10.0 * W0])
    memory = to_body(Q0, FIELD(0.0))
    s0 = {"bdot": [0.0, 0.0, 0.0, *memory]}
    runs = [
        fa.propagate(scene, Q0, w0, s0=s0, dt=dt, t_end=40.0, method="rk8") for dt in (0.1, 0.07)
    ]
    saturated = 0
    for k in range(200):
        b = to_body(y[:4], FIELD(0.2 * k))
        m, memory = np.clip(-gains[0] * (b - memory) / 0.2, -0.2, 0.2), b
        saturated += np.count_nonzero(np.abs(m) == 0.2)

        def torque(t, q, w, y, m=m):
            return np.cross(m, to_body(q, FIELD(t)))

        y = went(y, 0.2 * k, 0.2 * (k + 1), torque, inertia)
    for run in runs:
        assert apart(run, y) < 2e-12
        np.testing.assert_allclose(run.s[-1, :3], m, rtol=0.0, atol=1e-12)
    assert 100 < saturated < 500


def guide(t, q, w, p):
    a = 0.5 * min(p[0] * t, 1.0)
    return math.cos(a), 0.0, 0.3 * math.sin(a), math.sqrt(0.91) * math.sin(a)


def follow(t, q, w, target, p):
    e = fa.kernels.quat.mul(fa.kernels.quat.conj(target), q)
    sign = 1.0 if e[0] > 0.0 else -1.0
    return [-p[0] * sign * x - p[1] * v for x, v in zip(e[1:], w, strict=True)]


OFTEN = [("guidance", 0, False), ("guidance", 2, True), ("control", 0, True)]


@pytest.mark.parametrize(
    ("first", "delay", "is_model"),
    in_tiers(OFTEN, itertools.product(("guidance", "control"), (0, 2), (False, True))),
)
def test_control_follows_slower_guidance(first, delay, is_model):
    """A controller reads what one before it computes now, and what a later one held."""
    guidance, gains = T.SampledControl(guide, 2.0, params=(0.02,), holds=4), (4.0, 12.0)
    how = {"params": gains, "reads": "guidance"}
    how = {} if is_model else how
    law = T.QuaternionPD(*gains, target="guidance") if is_model else follow
    terms = {"guidance": guidance, "control": T.SampledControl(law, 0.25, delay=delay, **how)}
    torque = T.Sum({name: terms[name] for name in sorted(terms, reverse=first == "guidance")})
    scene, end = fa.Scene(inertia=INERTIA, torque=torque), 12.0
    assert [*scene.parts] == sorted(terms, reverse=first == "guidance")
    s0 = {"guidance": [1.0, 0.0, 0.0, 0.0]}
    runs = [
        fa.propagate(scene, Q0, W0, s0=s0, dt=dt, t_end=end, method="rk8") for dt in (0.125, 0.07)
    ]
    y, target, waiting = np.concatenate([Q0, W0]), np.array(s0["guidance"]), [np.zeros(3)] * delay
    for k in range(48):
        new = np.array(guide(0.25 * k, y, y, (0.02,))) if k % 8 == 0 else target
        seen = new if first == "guidance" else target
        waiting.append(np.array(follow(0.25 * k, y[:4], y[4:], seen, gains)))
        held, target = waiting.pop(0), new
        y = went(y, 0.25 * k, 0.25 * (k + 1), lambda t, q, w, y, held=held: held)
    for run in runs:
        assert apart(run, y) < 1e-13
        np.testing.assert_allclose(run.s[-1, scene.parts["guidance"]], target, rtol=1e-15)


def on_time(t, q, w, p):
    return min(1.0, max(-1.0, -p[0] * q[0] * q[3] - p[1] * w[2]))


def gate(t, q, w, on, s, p):
    """The valve of a pulse: s counts the ticks since the pulse began."""
    is_open = s[0] * p[0] < abs(on[0]) - 1e-9
    return (math.copysign(1.0, on[0]) if is_open else 0.0), (s[0] + 1.0 if s[0] < 48.5 else 0.0,)


def jets(t, q, w, valve, p):
    return 0.0, 0.0, p[0] * valve[0]


def thrust(t, q, w, v, valve, p):
    return p[0] * abs(valve[0]), 0.0, 0.0


def test_pulses_end_with_a_gate():
    """A valve that a gate opens for some of 50 ticks, in a torque and in a force."""
    gains, tick, arm, mass, newton = (1.5, 6.0), 0.02, 0.6, 50.0, 2.0
    terms = {
        "on": T.SampledControl(on_time, 1.0, params=gains, holds=1),
        "gate": T.SampledControl(gate, tick, params=(tick,), states=1, holds=1, reads="on"),
        "jets": T.Custom(jets, (arm,), reads="gate"),
    }
    force = fa.forces.Custom(thrust, (newton,), reads="gate")
    scene = fa.Scene(inertia=INERTIA, mass=mass, torque=T.Sum(terms), force=force)
    q0, w0 = fa.rotation_vector_to_quat([0.0, 0.0, 0.4]), [0.01, -0.02, 0.03]
    how = {"v0": [0, 0, 0], "s0": {}, "dt": 0.25, "t_end": 8.0, "method": "rk8"}
    run = fa.propagate(scene, q0, w0, **how)
    y = np.array([*q0, *w0, 0.0, 0.0, 0.0])
    for k in range(8):
        on = on_time(0.0, y[:4], y[4:7], gains)
        end = k + tick * math.ceil((abs(on) - 1e-9) / tick)
        for sign, a, b in ((np.sign(on), k, end), (0.0, end, k + 1)):

            def moved(t, q, w, y, sign=sign):
                return np.array([newton * abs(sign) / mass, 0.0, 0.0]) - np.cross(w, y[7:])

            if b > a:
                z = np.array([0.0, 0.0, arm * sign])
                y = went(y, a, b, lambda t, q, w, y, z=z: z, more=moved)
    assert max(apart(run, y), np.abs(run.v[-1] - y[7:]).max()) < 1e-12


def growth(t, q, w, other, s, p):
    return (0.0, 0.0, 0.0), (p[0] * other[0],)


def test_states_read_each_other():
    """x' = y, y' = -x: a circle of states, not of torques."""
    terms = {
        "x": T.Custom(growth, (1.0,), states=1, reads="y"),
        "y": T.Custom(growth, (-1.0,), states=1, reads=["x"]),
    }
    scene = fa.Scene(inertia=(1.0, 1.0, 1.0), torque=T.Sum(terms))
    run = fa.propagate(
        scene, [1, 0, 0, 0], [0, 0, 0], s0={"x": 1.0, "y": 0.0}, dt=0.1, t_end=10.0, method="rk8"
    )
    np.testing.assert_allclose(run.s[-1], [math.cos(10), -math.sin(10)], rtol=0.0, atol=1e-13)


def test_speeds_in_a_sampled_command_are_those_that_a_function_takes():
    def by_speeds(t, q, w, speeds, p):
        return [-2.0 * q[0] * x - 8.0 * v - 1e-4 * s for x, v, s in zip(q[1:], w, speeds)]  # noqa: B905

    def by_wheel(t, q, w, speeds, p):
        return [-x for x in by_speeds(t, q, w, speeds, p)]

    def scene(command, **options):
        wheels = T.ReactionWheels(np.eye(3), 0.02, command, max_torque=0.5, **options)
        return fa.Scene(inertia=wheels.body_inertia(INERTIA), torque=T.Sum({"wheels": wheels}))

    read = scene(T.SampledControl(by_speeds, 0.25, reads="wheels.speeds"))
    taken = scene(by_wheel, period=0.25)
    s0 = [0.5, -0.2, 0.3, 0.0, 0.0, 0.0]
    runs = [fa.propagate(x, Q0, W0, s0=s0, dt=0.05, t_end=5.0) for x in (read, taken)]
    assert fa.angle_between(runs[0].q[-1], runs[1].q[-1]) < 1e-15
    np.testing.assert_allclose(runs[0].s[-1, :3], runs[1].s[-1, :3], rtol=1e-14)


@pytest.mark.parametrize("n", [1, 5])
def test_terms_of_bodies_and_of_turned_axes(n):
    """Numbers of each body; a tensor's run equals the function that is written by hand."""
    tensor = np.array([[20.0, 1.0, 0.5], [1.0, 18.0, -0.7], [0.5, -0.7, 15.0]])
    gains = np.linspace(1e-4, 3e-4, n)[:, None]

    def drag(t, q, w, speeds, p):
        return [-p[0] * x * y for x, y in zip(speeds, w, strict=True)]

    def by_hand(t, q, w, h, p):
        speeds = [x / 0.02 - y for x, y in zip(h, w, strict=True)]
        motor = [(1.0 if q[0] > 0.0 else -1.0) * x + 5.0 * y for x, y in zip(q[1:], w, strict=True)]
        inside = np.cross(np.array(h), np.array(w))
        return inside - np.array(motor) + np.array(drag(t, q, w, speeds, p)), motor

    wheels = T.ReactionWheels(np.eye(3), 0.02, T.QuaternionPD(1.0, 5.0))
    terms = {"wheels": wheels, "drag": T.Custom(drag, gains, reads="wheels.speeds")}
    scene = fa.Scene(inertia=tensor, torque=T.Sum(terms))
    hand = fa.Scene(inertia=tensor, torque=by_hand, states=3, params=gains)
    q0, w0 = np.tile(Q0, (n, 1)), np.tile(W0, (n, 1))
    how = {"s0": np.tile([0.5, -0.2, 0.3], (n, 1)), "dt": 0.05, "n_steps": 100, "method": "rk8"}
    run, wanted = (fa.propagate(x, q0, w0, **how) for x in (scene, hand))
    assert fa.angle_between(run.q[-1], wanted.q[-1]).max() < 1e-14
    if n > 1:
        some = how | {"s0": how["s0"][:2]}
        part = fa.propagate(scene[[4, 1]], q0[:2], w0[:2], **some)
        np.testing.assert_array_equal(part.q[-1], run.q[-1, [4, 1]])
        assert scene[[4, 1]].torque.names == ("wheels", "drag")


@pytest.mark.parametrize("options", in_tiers([{"representation": "mrp"}, {"dtype": "float32"}], [
    {"representation": "dcm"}, {"representation": "mrp"}, {"representation": "euler313"},
    {"dtype": "float32"}, {"compensated": True}, {"method": "rk4"}, {"method": "gbs16"},
]))  # fmt: skip
def test_every_way_of_a_run_reads(options):
    scene, wheels = unloading()
    how = {"s0": wheels.momenta([10.0, -7.0, 5.0], W0), "dt": 0.02, "t_end": 2.0}
    run = fa.propagate(scene, Q0, W0, **how, method="rk8")
    other = fa.propagate(scene, Q0, W0, **how, **options)
    bound = 1e-5 if options.get("dtype") else 1e-10
    assert fa.angle_between(other.q[-1], run.q[-1]) < bound


def test_names_are_part_of_a_scene():
    scene, _ = unloading()
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene == unloading()[0]
    assert hash(again) == hash(scene)
    renamed = unloading("a", wheels="a")[0]
    assert scene not in (unloading("wheels.speeds")[0], renamed)
    assert [*renamed.parts] == ["a"]


def held(t, q, w, p):
    return w


HELD = T.SampledControl(held, 1.0, holds=3)


def scene_of(torque, **options):
    return fa.Scene(inertia=(1.0, 1.0, 1.0), torque=torque, **options)


def pulsed(t, q, w, on, p):
    """A valve that is open for a time after each whole second."""
    since = t - math.floor(t)
    return 0.0, 0.0, p[0] * (1.0 if since < on[0] else 0.0)


def test_a_pulse_within_a_step_is_told():
    on = T.SampledControl(on_time, 1.0, params=(1.5, 6.0), holds=1)
    terms = {"on": on, "jets": T.Custom(pulsed, (0.6,), reads="on")}
    with pytest.warns(fa.StepWarning, match="^torque: found pulsed.* compares the time with on"):
        scene_of(T.Sum(terms))
    force = fa.forces.Custom(lambda t, q, w, v, on, p: (1.0 if t < on[0] else 0.0,) * 3, reads="on")
    with pytest.warns(fa.StepWarning, match="^force: found .* compares the time with on"):
        scene_of(T.Sum({"on": on}), mass=1.0, force=force)


def test_momentum_of_wheels_in_a_sum(tmp_path):
    """Numbers that exert nothing leave the momentum as it is; coils do not."""
    wheels = T.ReactionWheels(np.eye(3), 0.02, T.QuaternionPD(1.0, 5.0))
    terms = {"held": HELD, "wheels": wheels, "rotor": T.Rotor((0.0, 0.1, 0.0))}
    scene = fa.Scene(inertia=wheels.body_inertia(INERTIA), torque=T.Sum(terms))
    how = {"dt": 0.05, "n_steps": 100, "save_every": 50, "method": "rk8"}
    run = fa.propagate(scene, Q0, W0, s0={"wheels": [0.5, -0.2, 0.3]}, **how)
    assert fa.drift(run, scene).momentum.max() < 1e-14
    total = np.asarray(scene.inertia) @ run.w[..., None]
    total = total[..., 0] + run.s[:, run.parts["wheels"]] + [0.0, 0.1, 0.0]
    moved = fa.quat_rotate(run.q, total)
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), rtol=0.0, atol=1e-14)
    coiled, _ = unloading()
    run = fa.propagate(coiled, Q0, W0, s0=[0.5, -0.2, 0.3], **how)
    assert fa.drift(run, coiled).momentum is None
    run.to_csv(tmp_path / "run.csv")
    header = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert header == "t,q0,q1,q2,q3,wx,wy,wz,wheels0,wheels1,wheels2,status"


@pytest.mark.parametrize(
    ("is_terminal", "tilt"),
    in_tiers([(False, 0.0), (True, 0.3)], itertools.product((False, True), (0.0, 0.3))),
)
def test_events_read_names(is_terminal, tilt):
    """Momenta and speeds of wheels, beside events of all states and of the speeds at each save."""
    wheels = T.ReactionWheels(np.eye(3), 0.02, T.QuaternionPD(1.0, 5.0))
    terms = {"held": HELD, "wheels": wheels}
    inertia = np.diag(INERTIA) + tilt if tilt else INERTIA
    scene = fa.Scene(inertia=wheels.body_inertia(inertia), torque=T.Sum(terms))
    how = {"s0": {"wheels": [0.5, -0.2, 0.3]}, "dt": 0.05, "method": "rk8"}

    def by_name(t, q, w, h, p):
        return h[1] + 0.4

    def by_state(t, q, w, s, p):
        return s[4] + 0.4

    def by_speed(t, q, w, speeds, h, s, p):
        return speeds[1] - (s[4] / 0.02 - w[1]) + h[1] + 0.4

    events = [
        fa.event(by_name, terminal=is_terminal, reads="wheels"),
        fa.event(by_state, terminal=is_terminal),
        fa.event(by_speed, terminal=is_terminal, reads=("wheels.speeds", "wheels")),
    ]
    each = [
        fa.propagate(scene, Q0, W0, t_end=10.0, events=[x], **how).event_times[0] for x in events
    ]
    assert 0.1 < each[0] < 9.9
    assert each[0] == each[1]
    assert each[2] == pytest.approx(each[0], abs=1e-10)
    end = fa.propagate(scene, Q0, W0, save_at=[each[0]], **how)
    assert end.s[-1, 4] == pytest.approx(-0.4, abs=1e-12)
    with pytest.raises(ValueError, match=r"^event: reads: found 'coils'; accepted: 'held'"):
        fa.propagate(scene, Q0, W0, t_end=1.0, events=[fa.event(by_name, reads="coils")], **how)
    with pytest.raises(TypeError, match=r"accepted: event\(t, q, w, wheels, p\), "):
        fa.propagate(scene, Q0, W0, t_end=1.0, events=[fa.event(held, reads="wheels")], **how)
