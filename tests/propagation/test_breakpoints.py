"""Steps end at breakpoints: every method keeps its order across, whatever else a run does."""

import math
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from each import each, slow
from exact import body_motion
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp
from test_plan import bits

import fastatt as fa
from fastatt import angle_between as angle
from fastatt.propagation.breakpoints import breaks_within, corners_of

J = np.array((2.0, 1.0, 2.0 / 3.0))
W0 = np.array((0.1, 0.2, 0.3))
START = np.array((1.0, 0.0, 0.0, 0.0))
# two of them lie in one step of 0.25 s, one on a step's end
BREAKS = (1.03, 1.11, 2.5, 3.707)
END = 5.0


def level(t):
    """What acts at a time, the same on both sides of a breakpoint as written here."""
    return 1.0 if 1.03 < t < 1.11 or 2.5 < t < 3.707 else 0.0


def pulse(t, p):
    """Two of them, p[0] large, which hold at their ends where p[1] is 1."""
    inside = 1.03 < t < 1.11 or 2.5 < t < 3.707
    at_ends = 1.03 <= t <= 1.11 or 2.5 <= t <= 3.707
    return p[0] if inside or (p[1] > 0.0 and at_ends) else 0.0


def pulses(t, q, w, p):
    on = pulse(t, p)
    return on, 0.5 * on + 0.1 * q[1], 0.02 * t


def rate(t, p):
    on = pulse(t, p)
    return 0.3 + on, 0.2 * t, 0.1 - on * t


def body(breakpoints=BREAKS, *, closed=0.0):
    torque = fa.torques.Custom(pulses, (1.0, closed), uses_rate=False)
    return fa.Scene(inertia=J, torque=torque, breakpoints=breakpoints)


def turning(function, breakpoints=BREAKS, *, closed=0.0):
    return fa.Scene(rate=function, params=(1.0, closed), breakpoints=breakpoints)


# one program for both sides
OPEN, CLOSED = body(), body(closed=1.0)
RATES = turning(rate), turning(rate, closed=1.0)


def slope(t, y, on):
    q, w = y[:4], y[4:]
    if len(w):
        torque = np.array((on, 0.5 * on + 0.1 * q[1] / np.linalg.norm(q), 0.02 * t))
        wdot = (np.cross(J * w, w) + torque) / J
    else:
        w, wdot = np.array((0.3 + on, 0.2 * t, 0.1 - on * t)), np.zeros(0)
    a, v = q[0], q[1:]
    return np.concatenate([[-0.5 * v @ w], 0.5 * (a * w + np.cross(v, w)), wdot])


def truth(y, begin, end):
    """Where DOP853 ends that begins anew at each breakpoint."""
    edges = [begin, *(b for b in BREAKS if begin < b < end), end]
    for a, b in pairwise(edges):
        run = solve_ivp(
            slope, (a, b), y, "DOP853", args=(level((a + b) / 2),), rtol=2.3e-14, atol=1e-15
        )
        y = run.y[:, -1]
    return y / np.append(np.full(4, np.linalg.norm(y[:4])), np.ones(len(y) - 4))


BODY_END, RATE_END = truth(np.append(START, W0), 0.0, END), truth(START, 0.0, END)


def final(scene, **options):
    w0 = None if scene.kind == "rate" else W0
    return fa.propagate(scene, START, w0, **options)


@pytest.mark.parametrize(
    ("scenes", "method", "exact"),
    [((OPEN, CLOSED), x, BODY_END) for x in ("rk4", "strang2")]
    + [(RATES, x, RATE_END) for x in ("lie_euler", "magnus4")]
    + [slow((OPEN, CLOSED), x, BODY_END) for x in ("kahan_li8", "rkmk4", "gbs16")]
    + [slow(RATES, x, RATE_END) for x in ("rk4", "cg3", "magnus8")],
)
def test_order(scenes, method, exact):
    order = fa.METHODS[method].order_of(scenes[0].kind)
    steps = (40, 320) if order < 6 else (10, 40)
    found = []
    for scene in scenes:
        for n in steps:
            run = final(scene, dt=END / n, n_steps=n, method=method)
            found.append(angle(run.q[-1], exact[:4]))
            assert method == "lie_euler" or not run.status.any()
    # the side on which the breakpoint itself is said to lie is not seen
    assert found[:2] == found[2:]
    coarse, fine = found[:2]
    assert fine < 1e-13 or np.log(coarse / fine) / np.log(steps[1] / steps[0]) > order - 0.6
    assert fine < 0.05


def test_without_breakpoints_and_in_single_precision():
    run = final(body(()), dt=END / 40, n_steps=40, method="rk8")
    assert angle(run.q[-1], BODY_END[:4]) > 1e-4
    for options in ({}, {"save_at": [END]}):
        run = final(OPEN, dt=0.1, n_steps=50, method="rk8", dtype=np.float32, **options)
        assert angle(run.q[-1], BODY_END[:4]) < 5e-6


def test_times_of_each_body_are_declared_together():
    """Pulses about an axis of its own: the rate is the time that they last."""

    def pulse_of(t, q, w, p):
        return (1.0 if p[0] < t < p[1] else 0.0), 0.0, 0.0

    times = np.random.default_rng(1).uniform(0.0, END, (20, 2)).cumsum(axis=1) / 2.0
    scene = fa.Scene(
        inertia=(1.0, 1.0, 1.0), torque=pulse_of, params=times, breakpoints=np.unique(times)
    )
    run = fa.propagate(scene, [START] * 20, np.zeros((20, 3)), dt=0.25, t_end=END, method="rk4")
    assert_allclose(run.w[-1, :, 0], np.diff(times)[:, 0], rtol=1e-13)


@pytest.mark.parametrize("scene", [OPEN, CLOSED, *RATES])
def test_at_begin_and_end(scene):
    """A run from one breakpoint to another sees neither's far side; backwards too."""
    carried = BODY_END if scene.kind != "rate" else RATE_END
    begin = np.append(START, W0)[: carried.size]
    exact = [truth(begin, 0.0, 2.5)]
    exact.append(truth(exact[0], 2.5, 3.707))
    w = [None if scene.kind == "rate" else x[4:] for x in exact]
    method = "gauss12" if scene.kind == "rate" else "rk9"
    there = fa.propagate(scene, exact[0][:4], w[0], t0=2.5, dt=0.1, t_end=3.707, method=method)
    assert angle(there.q[-1], exact[1][:4]) < 1e-13
    assert there.t[-1] == 3.707
    back = fa.propagate(scene, exact[1][:4], w[1], t0=3.707, dt=-0.1, t_end=2.5, method=method)
    assert angle(back.q[-1], exact[0][:4]) < 1e-13


@pytest.mark.parametrize("method", ["rk8", "strang2", "kahan_li8"])
def test_backwards(method):
    """Steps back undo steps, whose parts they take in the other order."""
    there = final(OPEN, dt=0.01, n_steps=500, method=method)
    back = fa.propagate(
        OPEN, there.q[-1], there.w[-1], t0=5.0, dt=-0.01, n_steps=500, method=method
    )
    assert angle(back.q[-1], START) < 1e-12


def test_saves_keep_their_times():
    run = final(OPEN, dt=0.25, n_steps=20, save_every=1, method="rk9")
    np.testing.assert_array_equal(run.t, 0.25 * np.arange(21))
    exact = [truth(np.append(START, W0), 0.0, t) for t in run.t[1:]]
    assert angle(run.q[1:], np.array(exact)[:, :4]).max() < 1e-11
    times = [0.5, 1.03, 1.05, 1.11, 1.12, 2.5, 3.707, 4.9]
    exact = np.array([truth(np.append(START, W0), 0.0, t) for t in times])
    between = final(OPEN, dt=0.25, n_steps=20, save_at=times, method="rk9")
    np.testing.assert_array_equal(between.t, times)
    assert angle(between.q, exact[:, :4]).max() < 1e-11
    np.testing.assert_allclose(between.w, exact[:, 4:], atol=1e-11)


SAMPLES = np.random.default_rng(2).normal(size=(11, 3))
SAMPLED_AT = np.linspace(0.0, END, 11)
UNEVEN = np.sort(np.append(np.random.default_rng(6).uniform(0.0, END, 9), (0.0, END)))


def of_table(t, kind="linear"):
    return fa.TimeSeries(t, SAMPLES, kind=kind)


LINEAR = of_table(SAMPLED_AT)
# models with a linear table, the times of its samples, and the torque as NumPy has it
LINEAR_MODELS = {
    "even": (fa.torques.Constant(LINEAR), SAMPLED_AT),
    "table": (fa.torques.Constant(of_table(UNEVEN)), UNEVEN),
    "sum": (fa.torques.Sum((fa.torques.Damping(0.0), fa.torques.Constant(LINEAR))), SAMPLED_AT),
}


def table_truth(times, torque, angular=lambda t: np.zeros(3), inside=False):
    """(q, w) by DOP853 from sample to sample, under a torque(t, k) and a wheel's momentum."""
    y = np.append(START, W0)
    for k, (a, b) in enumerate(pairwise(times)):
        low, high = (np.nextafter(a, 9.0), np.nextafter(b, -9.0)) if inside else (a, b)

        def acting(t, q, w, y, k=k, low=low, high=high):
            t = np.clip(t, low, high)
            return np.cross(angular(t), w) + torque(t, k)

        y = body_motion(J, acting, y, a, b)
    return y[:4], y[4:]


def linear_truth(times):
    return table_truth(times, lambda t, k: [np.interp(t, times, x) for x in SAMPLES.T])[0]


@pytest.mark.parametrize("name", LINEAR_MODELS)
def test_linear_tables_bring_their_samples(name):
    """Models keep the order of a method with any step; a function has to declare them."""
    torque, times = LINEAR_MODELS[name]
    scene, exact = fa.Scene(inertia=J, torque=torque), linear_truth(times)
    options = {"dt": END / 41, "method": "rk8"}
    run = fa.propagate(scene, START, W0, n_steps=41, **options)
    assert angle(run.q[-1], exact) < 1e-10
    declared = fa.propagate(replace(scene, breakpoints=times), START, W0, n_steps=41, **options)
    assert bits(declared) == bits(run)
    at = fa.propagate(scene, START, W0, t_end=END, save_at=[1.7, END], **options)
    assert angle(at.q[-1], exact) < 1e-10
    counts = np.array((41, 37, 61))
    options["dt"] = END / counts
    each = fa.propagate(scene, np.tile(START, (3, 1)), W0, n_steps=counts, **options)
    assert angle(each.q[-1], exact).max() < 1e-10


@pytest.mark.parametrize("times", [0.1 * np.arange(51)[::5], UNEVEN], ids=["even", "uneven"])
def test_a_held_table_brings_its_samples(times):
    """Forwards and backwards; a function has to declare them."""
    held = of_table(times, "previous")
    exact, w = table_truth(times, lambda t, k: SAMPLES[k])
    steps = {"dt": END / 41, "n_steps": 41, "method": "rk8"}
    given = fa.Scene(inertia=J, torque=fa.torques.Constant(held))
    read = fa.Scene(inertia=J, torque=lambda t, q, w, p: held(t), breakpoints=held.t)
    for scene in (given, read):
        run = fa.propagate(scene, START, W0, **steps)
        assert angle(run.q[-1], exact) < 1e-10
        assert np.abs(run.w[-1] - w).max() < 1e-10
    back = fa.propagate(given, exact, w, **{**steps, "dt": -END / 41}, t0=END)
    assert angle(back.q[-1], START) < 1e-10
    late = fa.propagate(replace(read, breakpoints=()), START, W0, **steps)
    assert angle(late.q[-1], exact) > 1e-4


def test_held_tables_whose_times_differ_by_rounding_jump_together():
    """By up to 15 units in the last place; forwards and backwards, also at both ends of the run."""
    ways = np.nextafter(SAMPLED_AT, 9.0) - SAMPLED_AT
    found = []
    for shifts in (np.zeros((3, 11)), np.array([np.arange(11) % 4 + 2, np.zeros(11), [7] * 11])):
        tables = [
            fa.TimeSeries(SAMPLED_AT + k * ways, SAMPLES * x, kind="previous", outside="hold")
            for k, x in zip(shifts, (1.0, -0.4, 0.7), strict=True)
        ]
        torque = fa.torques.Sum(tuple(fa.torques.Constant(x) for x in tables))
        scene = fa.Scene(inertia=J, torque=torque)
        times = {"dt": 2.5 / 41, "n_steps": 41, "t0": 0.5, "method": "rk8"}
        run = fa.propagate(scene, START, W0, **times)
        back = fa.propagate(scene, START, W0, **{**times, "dt": -2.5 / 41, "t0": 3.0})
        found.append(np.concatenate([run.q[-1], run.w[-1], back.q[-1], back.w[-1]]))
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-13)


def test_a_switched_wheel_brings_its_samples():
    """Its torque is the slope of a cubic table, which has a corner at each sample."""
    momentum = fa.TimeSeries(SAMPLED_AT, 0.1 * SAMPLES)
    scene = fa.Scene(inertia=J, torque=fa.torques.Rotor(momentum))
    q, w = table_truth(SAMPLED_AT, lambda t, k: -np.array(momentum.slope(t)), momentum, inside=True)
    run = fa.propagate(scene, START, W0, dt=END / 83, n_steps=83, method="rk8")
    assert angle(run.q[-1], q) < 1e-10
    assert np.abs(run.w[-1] - w).max() < 1e-10


def test_cubic_tables_bring_none():
    torque = fa.torques.Constant(of_table(SAMPLED_AT, "cubic"))
    assert corners_of(fa.Scene(inertia=J, torque=torque)).size == 0


def test_corners_of_forces_commands_and_declared_ones():
    """Once each, also where a declared one differs from that of a table by rounding."""
    wheels = fa.torques.ReactionWheels(np.eye(3), 0.1, fa.torques.Constant(of_table(UNEVEN)))
    force = fa.forces.Constant(LINEAR)
    near = np.nextafter(SAMPLED_AT[3], 9.0)
    scene = fa.Scene(inertia=J, torque=wheels, mass=1.0, force=force, breakpoints=(near, 0.77))
    wanted = np.union1d(np.union1d(UNEVEN, SAMPLED_AT), 0.77)
    np.testing.assert_array_equal(breaks_within(scene, -1.0, 9.0).times[1:], wanted)
    # a controller that is sampled reads its table at sample times alone
    held = fa.torques.SampledControl(fa.torques.Constant(LINEAR), 0.7)
    assert corners_of(fa.Scene(inertia=J, torque=held)).size == 0


@pytest.mark.parametrize("method", ["magnus8", "rk4"])
def test_a_slew_brings_its_begin_and_end(method):
    slew = fa.rates.Slew((0.3, -0.2, 1.5), 2.0, 1.234)
    rate = fa.rates.Sum((slew, fa.rates.Constant((0.1, 0.2, 0.05))))
    runs = [
        fa.propagate(fa.Scene(rate=rate), START, dt=END / n, n_steps=n, method=method)
        for n in (20, 40, 4000)
    ]
    coarse, fine = (angle(run.q[-1], runs[2].q[-1]) for run in runs[:2])
    assert fine < 1e-13 or np.log2(coarse / fine) > fa.METHODS[method].order - 0.6
    many = fa.rates.Slew((0.3, -0.2, 1.5), 2.0, np.array([1.0, 2.0]))
    assert corners_of(fa.Scene(rate=many)).size == 0


@each("t0", [0.0, 100.0, -3.0, 1.7e9])
@each("sign", [1.0, -1.0])
def test_t_end_is_a_time(t0, sign):
    """Whole steps are recognised within the rounding of the two times."""
    scene, dt = fa.Scene(inertia=J), 0.1 * sign
    for length, n in ((60.3, 603), (60.31, 604)):
        t_end = t0 + sign * length
        for method in ("rk8", "exact"):
            run = fa.propagate(scene, START, W0, dt=dt, t0=t0, t_end=t_end, method=method)
            steps = fa.propagate(scene, START, W0, dt=dt, t0=t0, n_steps=n, method=method)
            exact = fa.closed_form.free_body(START, W0, J, t_end - t0)[0]
            assert angle(run.q[-1], exact) < 1e-6
            assert abs(run.t[-1] - t_end) <= np.spacing(abs(t_end))
            assert (run.q == steps.q).all() == (n == 603)
        own = fa.propagate(
            scene, [START] * 2, W0, dt=[dt, 0.5 * dt], t0=t0, t_end=t_end, method="rk8"
        )
        assert angle(own.q[-1], exact).max() < 1e-6
        assert own.t[-1] == t_end
    with pytest.raises(ValueError, match=r"t_end: found .*; accepted: a time (after|before) t0"):
        fa.propagate(scene, START, W0, dt=dt, t0=t0, t_end=t0)
    with pytest.raises(ValueError, match=r"t_end: found .*; accepted: a time (after|before) t0"):
        fa.propagate(scene, START, W0, dt=-dt, t0=t0, t_end=t0 + sign)


@pytest.mark.parametrize(("t0", "t_end"), [(1.7e9, 1.7e9 + 1e-6), (0.0, 0.07)])
def test_a_first_step_that_is_shorter_is_the_last(t0, t_end):
    """Below the rounding of times too."""
    run = fa.propagate(fa.Scene(inertia=J), START, W0, dt=0.1, t0=t0, t_end=t_end, method="rk9")
    assert run.t.tolist() == [t_end]


def test_saves_alone_end_the_run():
    scene, start = fa.Scene(inertia=J), ([1.0, 0.0, 0.0, 0.0], W0)
    for dt, at in ((0.1, [0.8, 2.57]), (-0.1, [0.5, -3.0]), (0.1, [0.5])):
        run = fa.propagate(scene, *start, dt=dt, save_at=at, t0=0.5, method="rk9")
        until = {"n_steps": 0} if at == [0.5] else {"t_end": at[-1]}
        same = fa.propagate(scene, *start, dt=dt, **until, t0=0.5, method="rk9")
        assert run.t.tolist() == at
        assert same.t.tolist() == at[-1:]
        assert angle(run.q[-1], same.q[-1]) == 0.0


def test_a_scene_with_breakpoints():
    assert body([2.0, 1.0, 2.0]).breakpoints == (1.0, 2.0)
    assert body(3) == body([3.0]) != OPEN
    assert pickle.loads(pickle.dumps(OPEN)).breakpoints == BREAKS


def test_a_function_that_is_not_traced():
    """What Numba compiles is called between breakpoints too, for each lane or once for all."""

    def called(t, p):
        on = p[0] * math.gamma(2.0 + 0.0 * t) if 1.03 <= t <= 1.11 or 2.5 <= t <= 3.707 else 0.0
        return 0.3 + on, 0.2 * t, 0.1 - on * t

    scene = turning(called)
    assert not scene.functions[0].followed
    for options in ({}, {"save_at": [END]}):
        run = fa.propagate(scene, START, dt=0.05, n_steps=100, method="magnus8", **options)
        assert angle(run.q[-1], RATE_END) < 1e-13
