"""Switches: sides that change where the steps of a body are divided; all crossings of events."""

import math
import pickle
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fastatt as fa
from fastatt.codegen import memory
from fastatt.engine import run_with_events
from fastatt.engine.run import Crossings

MOMENTS, LAG = np.array([2.0, 1.5, 1.0]), -0.02
RNG = np.random.default_rng(3)
N, END = 12, 8.0
Q0 = RNG.normal(size=(N, 4))
Q0 /= np.linalg.norm(Q0, axis=1)[:, None]
W0 = RNG.normal(size=(N, 3)) * 0.5
PUSH = RNG.uniform(0.5, 2.0, (N, 1))
REST = ([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def x_side(t, q, w, p):
    return q[0] * q[1] + p[0] * w[0]


def y_side(t, q, w, p):
    return q[0] * q[2] + p[0] * w[1] - 0.05


def jets(t, q, w, x, y, p):
    return -p[0] * x, -p[0] * y, 0.0


def about_z(t, q, w, side, p):
    return 0.0, 0.0, 0.2 * side


def summed(inertia=MOMENTS, **terms):
    return fa.Scene(inertia=inertia, torque=fa.torques.Sum(terms))


def thrusters(rows=slice(None)):
    switches = {
        "x": fa.torques.Switch(x_side, (LAG,)), "y": fa.torques.Switch(y_side, (LAG,)),
    }  # fmt: skip
    return summed(**switches, jets=fa.torques.Custom(jets, PUSH[rows], reads=("x", "y")))


def driven(g, *more, **options):
    """The rate about the third axis, at its rate of 0.1 s⁻² for a side of 1, and the run."""
    terms = {"side": fa.torques.Switch(g, *more), "motor": fa.torques.Custom(about_z, reads="side")}
    return fa.propagate(
        summed((1.0, 1.5, 2.0), **terms), *REST, **{"method": "rk8", "dt": 0.3, **options}
    )


def restarted(body, torque, *functions):
    """SciPy's DOP853 with held sides, begun again at each crossing: the end, and the crossings."""
    y, t, times = np.r_[Q0[body], W0[body]], 0.0, [[] for _ in functions]
    side = [np.sign(g(y)) for g in functions]

    def slope(t, y):
        q, w = y[:4], y[4:]
        turn = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.r_[turn, (np.cross(MOMENTS * w, w) + torque(body, y, side)) / MOMENTS]

    def until(k):
        crossing = lambda t, y: side[k] * functions[k](y)  # noqa: E731
        crossing.terminal, crossing.direction = True, -1
        return crossing

    while t < END:
        solved = solve_ivp(
            slope, (t, END), y, "DOP853", rtol=3e-14, atol=1e-15, max_step=0.05,
            events=[until(k) for k in range(len(functions))],
        )  # fmt: skip
        t, y = solved.t[-1], solved.y[:, -1]
        for k in range(len(functions)):
            if solved.t_events[k].size:
                times[k].append(t)
                side[k] = -side[k]
    return y, times


@pytest.fixture(scope="module")
def true():
    def torque(body, y, side):
        return np.array([-PUSH[body, 0] * side[0], -PUSH[body, 0] * side[1], 0.0])

    functions = (
        lambda y: y[0] * y[1] + LAG * y[4],
        lambda y: y[0] * y[2] + LAG * y[5] - 0.05,
    )
    return [restarted(body, torque, *functions) for body in range(N)]


@pytest.mark.parametrize(
    ("method", "n", "order", "bound"), [("rk4", 320, 4, 1e-5), ("rk8", 20, 8, 1e-7)]
)
def test_methods_keep_their_order(true, method, n, order, bound):
    """Two switches of each of 12 bodies cross 1 to 7 times, some twice in a step."""
    q = np.array([y[:4] for y, _ in true])
    errors = []
    for steps in (n, 2 * n):
        run = fa.propagate(thrusters(), Q0, W0, dt=END / steps, n_steps=steps, method=method)
        errors.append(np.median(fa.angle_between(run.q[-1], q)))
        assert (run.status == 0).all()
    assert errors[0] < bound
    assert errors[0] / errors[1] > 2.0 ** (order - 1)
    for k, name in enumerate("xy"):
        found = run.crossings(name)
        assert found.body.tolist() == [b for b in range(N) for _ in true[b][1][k]]
        # of the second order where a crossing is slow
        np.testing.assert_allclose(found.t, np.concatenate([x[k] for _, x in true]), atol=bound)
        values = [
            (x_side, y_side)[k](t, q, w, (LAG,))
            for t, q, w in zip(found.t, found.q, found.w, strict=True)
        ]
        assert np.abs(values).max() < 1e-13


def test_pd_divides_where_it_passes_half_a_turn():
    """Alone and within a Sum; 12 bodies pass 180° once or more."""
    gains, target = np.array([0.1, 0.08, 0.06]), np.array([0.1, 0.7, -0.5, 0.5])
    target /= np.linalg.norm(target)

    def error(y):
        p, a, q = target[0], -target[1:], y[:4]
        return np.r_[p * q[0] - a @ q[1:], p * q[1:] + q[0] * a + np.cross(a, q[1:])]

    def torque(body, y, side):
        return -gains * side[0] * error(y)[1:] - 0.01 * y[4:]

    true = [restarted(body, torque, lambda y: error(y)[0]) for body in range(N)]
    q = np.array([y[:4] for y, _ in true])
    pd = fa.torques.QuaternionPD(gains, 0.01, target=target, divides=True)
    scene = fa.Scene(inertia=MOMENTS, torque=pd)
    errors = []
    for n in (20, 40):
        run = fa.propagate(scene, Q0, W0, dt=END / n, n_steps=n, method="rk8")
        errors.append(np.median(fa.angle_between(run.q[-1], q)))
        assert (run.status == 0).all()
    assert errors[0] < 1e-8
    assert errors[0] / errors[1] > 2.0**7
    passes = np.concatenate([x[0] for _, x in true])
    assert passes.size > 5
    np.testing.assert_allclose(run.crossings("QuaternionPD").t, passes, atol=1e-9)
    named = fa.propagate(summed(pd=pd), Q0, W0, dt=END / n, n_steps=n, method="rk8")
    np.testing.assert_array_equal(named.q, run.q)
    np.testing.assert_array_equal(named.crossings("pd").t, run.crossings("QuaternionPD").t)
    with pytest.raises(ValueError, match=r"^representation: found mrp with a QuaternionPD"):
        fa.propagate(scene, Q0, W0, dt=0.1, n_steps=1, method="rk4", representation="mrp")


@pytest.mark.parametrize("is_model", [False, True])
def test_a_wheel_divides_where_it_stands(is_model):
    """Under a constant torque it reverses against Coulomb friction; all is linear in time."""
    j, inertia, u, rub, begin, end = 0.1, 1.5, 0.03, 0.01, -0.5, 3.0
    command = lambda t, q, w, s, p: u  # noqa: E731
    if is_model:
        command = fa.torques.Custom(lambda t, q, w, p: (0.0, 0.0, -u))
    wheel = fa.torques.ReactionWheels([[0, 0, 1]], j, command, coulomb=rub, divides=True)
    scene = fa.Scene(inertia=(2.0, 1.8, inertia), torque=wheel)
    s0 = [*wheel.momenta(begin, (0.0, 0.0, 0.0)), 0.0]
    run = fa.propagate(scene, *REST, s0=s0, dt=0.7, t_end=end, method="rk4")
    gain = 1.0 / j + 1.0 / inertia
    stands = -begin / ((u + rub) * gain)
    np.testing.assert_allclose(run.crossings("ReactionWheels").t, stands, rtol=1e-14)
    net = (u + rub) * stands + (u - rub) * (end - stands)
    np.testing.assert_allclose(run.w[-1], [0.0, 0.0, -net / inertia], rtol=1e-14)
    np.testing.assert_allclose(run.s[-1], [j * begin + net, 1.0], rtol=1e-14)
    assert run.status.tolist() == [0]


def test_saves_within_divided_steps():
    times = np.linspace(0.0, END, 57)
    coarse, fine = (
        fa.propagate(thrusters(), Q0, W0, dt=dt, save_at=times, method="gbs16")
        for dt in (0.4, 0.05)
    )
    assert fa.angle_between(coarse.q, fine.q).max() < 1e-11
    np.testing.assert_array_equal(coarse.s, fine.s)


def test_each_body_has_its_own_times():
    """Pulses of 5 bodies that begin and end within the same long step, and one on a step."""
    window = np.stack([[0.3, 0.475, 0.5, 0.825, 1.0], [0.35, 0.49, 1.9, 2.4, 3.0]], axis=1)
    scene = summed(
        (1.0, 1.5, 2.0),
        on=fa.torques.Switch(lambda t, q, w, p: t - p[0], window),
        off=fa.torques.Switch(lambda t, q, w, p: t - p[1], window),
        motor=fa.torques.Custom(
            lambda t, q, w, on, off, p: (0.0, 0.0, 2.0 * (on - off)), reads=("on", "off")
        ),
    )
    run = fa.propagate(scene, np.tile(REST[0], (5, 1)), REST[1], dt=0.5, n_steps=10, method="rk8")
    np.testing.assert_allclose(run.w[-1, :, 2], 2.0 * (window[:, 1] - window[:, 0]), atol=1e-14)
    np.testing.assert_allclose(run.crossings("on").t, window[:, 0], rtol=1e-14)


@pytest.mark.parametrize("dt", [0.05, 0.25, 0.3, 1.0])
def test_pulses_after_samples(dt):
    """A controller holds the width of a pulse, which may end within the first step of a period."""
    scene = summed(
        (1.0, 1.5, 2.0),
        width=fa.torques.SampledControl(lambda t, q, w, p: 0.2 + 0.1 * math.sin(t), 1.0, holds=1),
        gate=fa.torques.Switch(
            lambda t, q, w, width, p: width[0] - (t - math.floor(t + 1e-9)), reads="width"
        ),
        motor=fa.torques.Custom(lambda t, q, w, gate, p: (0.0, 0.0, 1.0 + gate), reads="gate"),
    )
    s0 = {"width": 0.0}
    run = fa.propagate(scene, *REST, s0=s0, dt=dt, t_end=5.0, method="rk8")
    widths = [0.2 + 0.1 * math.sin(k) for k in range(5)]
    np.testing.assert_allclose(run.w[-1, 2], sum(widths), atol=2e-8)
    ends = run.crossings("gate").t
    np.testing.assert_allclose(
        ends[np.abs(ends - ends.round()) > 0.1], np.arange(5) + widths, rtol=1e-13
    )


@pytest.mark.parametrize("dt", [0.05, 1.0, 2.0])
def test_events_in_divided_steps(dt):
    """The third is terminal, within a step in which the side changes again later."""
    events = [
        fa.event(lambda t, q, w, p: w[2] - 0.1, every=True),
        fa.event(lambda t, q, w, side, p: w[2] + 0.05 * side, -1, reads="side"),
        fa.event(lambda t, q, w, p: t - 7.05, terminal=True),
        fa.event(lambda t, q, w, p: t - 7.06, every=True),
    ]
    run = driven(lambda t, q, w, p: math.cos(t), dt=dt, t_end=20.0, events=events, save_at=[5, 20])
    turns = math.pi * np.array([0.5, 1.5])
    np.testing.assert_allclose(run.crossings("side").t, turns, rtol=1e-14)
    np.testing.assert_allclose(run.crossings(0).t, [1.0, math.pi - 1.0], rtol=1e-13)
    assert run.crossings(3).t.size == 0
    np.testing.assert_allclose(run.event_times[:3], [1.0, math.pi - 0.5, 7.05], rtol=1e-13)
    rates = 0.1 * (np.array([5.0, 7.05]) - 2.0 * math.pi)
    np.testing.assert_allclose(run.w[:, 2], rates, rtol=1e-12)
    assert run.status == 0


def test_all_crossings_of_an_event():
    """They do not change the run; two in one step and zeros on steps are found once each."""
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))
    events = [
        fa.event(lambda t, q, w, p: math.sin(math.pi * t), every=True),
        fa.event(lambda t, q, w, p: math.cos(2.0 * t) - 0.999, direction=-1, every=True),
    ]
    options = {"dt": 0.25, "n_steps": 4000, "save_every": 100, "method": "rk4"}
    run = fa.propagate(scene, [1, 0, 0, 0], events=events, **options)
    np.testing.assert_allclose(run.crossings(0).t, np.arange(1.0, 1000.0), rtol=1e-12)
    peaks = np.arange(0, 319) * math.pi + 0.5 * math.acos(0.999)
    np.testing.assert_allclose(run.crossings(1).t, peaks[peaks < 1000.0], rtol=1e-12)
    np.testing.assert_array_equal(run.crossings(1).w, np.tile((0.0, 0.0, 1.0), (319, 1)))
    plain = fa.propagate(scene, [1, 0, 0, 0], **options)
    np.testing.assert_array_equal(run.q, plain.q)
    for mine, other in zip(run.crossings(events[1]), run.crossings(1), strict=True):
        np.testing.assert_array_equal(mine, other)
    stored = pickle.loads(pickle.dumps(run))
    np.testing.assert_array_equal(stored.crossings(1).t, run.crossings(1).t)
    for found, what in (("no", run), (events[0], stored), (fa.event(jets, every=True), run)):
        with pytest.raises(ValueError, match=r"^event: found .*; accepted: 0, 1$"):
            what.crossings(found)


def test_crossings_take_no_more_room_than_there_is(monkeypatch):
    """Each batch has those since the one before; of each body and event some are kept."""
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))
    event, batches = fa.event(lambda t, q, w, p: math.sin(math.pi * t), every=True), []
    options = {"dt": 0.25, "n_steps": 400, "save_every": 4, "method": "rk4", "events": [event]}
    q = [[1, 0, 0, 0], [0, 1, 0, 0]]
    run = fa.propagate(scene, q, on_save=batches.append, **options)
    parts = [x.crossings(event) for x in batches]
    assert max(x.t.size for x in parts) < 40
    order = np.lexsort(np.concatenate([(x.t, x.body) for x in parts], axis=1))
    whole = run.crossings(event)
    assert whole.t.size == 200
    np.testing.assert_array_equal(np.concatenate([x.t for x in parts])[order], whole.t)
    monkeypatch.setattr(run_with_events, "MOST_CROSSINGS", 30)
    told = (
        r"^events\[0\]: found more than .* crossings, .* for 2 of 2 bodies, .* body 0; accepted: "
    )
    with pytest.warns(RuntimeWarning, match=told):
        run = fa.propagate(scene, q, **options)
    kept = run.crossings(event)
    np.testing.assert_array_equal(kept.t, whole.t[whole.t < 30.5])
    monkeypatch.setattr(Crossings, "_checked", 1000)
    monkeypatch.setattr(memory, "available", lambda: 1500)
    with pytest.raises(MemoryError, match=r"^crossings: those so far take .* accepted: fewer bod"):
        fa.propagate(scene, q, **{**options, "save_every": None})


def test_a_body_that_slides_is_flagged():
    """Dry friction stops a wheel at 2 s; from then on its rate is that of a step at most."""
    friction = fa.torques.Custom(lambda t, q, w, side, p: (0.0, 0.0, -0.2 * side), reads="side")
    scene = summed(
        (1.0, 1.5, 2.0), side=fa.torques.Switch(lambda t, q, w, p: w[2]), friction=friction
    )
    with pytest.warns(RuntimeWarning, match="SLIDING"):
        run = fa.propagate(
            scene, [[1, 0, 0, 0]] * 2, [[0, 0, 0.2], [0, 0, 9]], dt=0.1, n_steps=333, save_every=1,
            method="rk8",
        )  # fmt: skip
    assert run.status.tolist() == [fa.Status.SLIDING, 0]
    np.testing.assert_allclose(run.crossings("side").t, 2.0, rtol=1e-13)
    assert np.abs(run.w[20:, 0, 2]).max() < 0.011


@pytest.mark.parametrize(("before", "after", "flag"), [(0.0, 3.0, True), (3.0, 0.0, False)])
def test_jumps_of_models_in_divided_steps(before, after, flag):
    """A motor turns a body past 180° from the target after the middle of the step, or would."""

    def motor(t, q, w, side, p):
        return 0.0, 0.0, 0.5 * (p[0] + p[1]) + 0.5 * side * (p[1] - p[0])

    terms = {
        "side": fa.torques.Switch(lambda t, q, w, p: t - 0.5),
        "motor": fa.torques.Custom(motor, (before, after), reads="side"),
        "pd": fa.torques.QuaternionPD(1e-3, 0.0),
    }
    half = math.radians(85.0) if flag else math.radians(50.0)
    q0 = [math.cos(half), 0.0, 0.0, math.sin(half)]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        run = fa.propagate(summed((1, 1, 1), **terms), q0, REST[1], dt=1.0, n_steps=1, method="rk8")
    assert (run.status == fa.Status.JUMP) == (len(told) == 1) == flag


def test_zeros():
    """A side is that of the start or of ``s0``; a plateau at zero does not change it."""
    run = driven(lambda t, q, w, p: max(0.0, 1.0 - t), n_steps=10)
    assert (run.s[-1], run.crossings("side").t.size) == (1.0, 0)
    run = driven(
        lambda t, q, w, p: min(0.0, t - 1.0) + max(0.0, t - 2.0), n_steps=10, save_every=10
    )
    np.testing.assert_allclose(run.crossings("side").t, 2.0)
    assert run.s[:, 0].tolist() == [-1.0, 1.0]
    run = driven(lambda t, q, w, p: -t, n_steps=10)
    np.testing.assert_allclose(run.w[-1, 2], -0.3, rtol=1e-14)
    assert run.crossings("side").t.size == 0
    back = driven(lambda t, q, w, p: math.cos(t), t0=6.0, dt=-0.3, n_steps=20)
    np.testing.assert_allclose(back.w[-1, 2], 0.1 * (3.0 * math.pi - 6.0 - math.pi), rtol=1e-12)


def test_what_is_refused_and_told():
    switch = fa.torques.Switch(lambda t, q, w, p: w[2])
    with pytest.raises(ValueError, match=r"Switch without a name; accepted: a term of a Sum"):
        fa.Scene(inertia=MOMENTS, torque=switch)
    for method in ("strang2", "rkmk4", "exact"):
        with pytest.raises(ValueError, match=r"states|closed form"):
            driven(lambda t, q, w, p: w[2], method=method, n_steps=1)
    run = driven(lambda t, q, w, p: 5.0 - t, n_steps=2, save_every=1)
    with pytest.raises(ValueError, match="Switch"):
        fa.interpolate(run, [0.2])
    with pytest.raises(ValueError, match="Switch"):
        fa.single_step(thrusters())
    with pytest.raises(ValueError, match=r"Switch\S* is 0.5; accepted: 1, -1 or 0"):
        driven(lambda t, q, w, p: w[2], n_steps=1, s0=[0.5])
    with pytest.warns(RuntimeWarning, match="Switch 'side': found values that are not finite"):
        driven(lambda t, q, w, p: math.sqrt(1.0 - t), n_steps=10)


def test_forces_and_positions():
    """A push that changes its side 2 m along the first axis, on a body that does not rotate."""
    terms = {
        "far": fa.torques.Switch(lambda t, q, w, v, r, p: r[0] - 2.0, uses_position=True),
        "none": fa.torques.Constant((0.0, 0.0, 0.0)),
    }
    force = fa.forces.Custom(lambda t, q, w, v, far, p: (-3.0 * far, 0.0, 0.0), reads="far")
    scene = fa.Scene(inertia=MOMENTS, torque=fa.torques.Sum(terms), mass=3.0, force=force)
    run = fa.propagate(
        scene, *REST, v0=[0, 0, 0], r0=[0, 0, 0], dt=0.7, n_steps=5, method="rk8"
    )  # fmt: skip
    found = run.crossings("far")
    np.testing.assert_allclose([found.t[0], found.r[0, 0], found.v[0, 0]], 2.0, rtol=1e-13)
    np.testing.assert_allclose(run.v[-1, 0], 2.0 - 1.5, rtol=1e-12)


def test_a_crossing_between_a_false_alarm_and_the_end():
    """Of an event whose function comes near zero before, in the piece in which a body stops."""
    events = [
        fa.event(lambda t, q, w, p: (math.cos(2.0 * t) + 1.0001) * (t - 6.0)),
        fa.event(lambda t, q, w, p: t - 8.0, terminal=True),
    ]
    scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))
    run = fa.propagate(scene, [1, 0, 0, 0], dt=0.3, n_steps=100, method="rk4", events=events)
    np.testing.assert_allclose(run.event_times, [6.0, 8.0], rtol=1e-13)


def test_chunks_of_dask():
    dask = pytest.importorskip("fastatt.dask")
    options = {"dt": 0.05, "n_steps": 100, "method": "rk8"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        lazy = dask.propagate(thrusters(), Q0, W0, chunks=5, **options).compute()
    run = fa.propagate(thrusters(), Q0, W0, **options)
    for mine, other in zip(run.crossings("x"), lazy.crossings("x"), strict=True):
        np.testing.assert_array_equal(mine, other)
