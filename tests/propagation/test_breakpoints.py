"""Steps end at breakpoints: every method keeps its order across, whatever else a run does."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fastatt as fa
from fastatt import angle_between as angle
from fastatt.propagation.breakpoints import corners_of, parts_of

J = np.array((2.0, 1.0, 2.0 / 3.0))
W0 = np.array((0.1, 0.2, 0.3))
START = np.array((1.0, 0.0, 0.0, 0.0))
# two of them lie in one step of 0.25 s, one on a step's end
BREAKS = (1.03, 1.11, 2.5, 3.707)
END = 5.0
N = 70  # more than a tile


def level(t):
    """What acts at a time, the same on both sides of a breakpoint as written here."""
    return 1.0 if 1.03 < t < 1.11 or 2.5 < t < 3.707 else 0.0


def pulses(t, q, w, p):
    """A torque of two pulses, p[0] large, which hold at their ends where p[1] is 1."""
    inside = 1.03 < t < 1.11 or 2.5 < t < 3.707
    at_ends = 1.03 <= t <= 1.11 or 2.5 <= t <= 3.707
    on = p[0] if inside or (p[1] > 0.0 and at_ends) else 0.0
    return on, 0.5 * on + 0.1 * q[1], 0.02 * t


def rate(t, p):
    inside = 1.03 < t < 1.11 or 2.5 < t < 3.707
    at_ends = 1.03 <= t <= 1.11 or 2.5 <= t <= 3.707
    on = p[0] if inside or (p[1] > 0.0 and at_ends) else 0.0
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


def stepped(scene):
    return [name for name in fa.methods_for(scene) if fa.METHODS[name].is_stepped]


@pytest.mark.parametrize("method", stepped(OPEN))
def test_order_of_bodies(method):
    check_order((OPEN, CLOSED), method, BODY_END)


@pytest.mark.parametrize("method", stepped(RATES[0]))
def test_order_of_rates(method):
    check_order(RATES, method, RATE_END)


def check_order(scenes, method, exact):
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


def test_without_breakpoints_the_order_is_lost():
    run = final(body(()), dt=END / 40, n_steps=40, method="rk8")
    assert angle(run.q[-1], BODY_END[:4]) > 1e-4


@pytest.mark.parametrize("scene", [OPEN, CLOSED, *RATES])
def test_at_begin_and_end(scene):
    """A run from one breakpoint to another sees neither's far side; backwards too."""
    carried = BODY_END if scene.kind != "rate" else RATE_END
    begin = np.append(START, W0)[: carried.size]
    exact = [truth(begin, 0.0, 2.5)]
    exact.append(truth(exact[0], 2.5, 3.707))
    w = [None if scene.kind == "rate" else x[4:] for x in exact]
    method = "gauss12" if scene.kind == "rate" else "rk9"
    there = fa.propagate(scene, exact[0][:4], w[0], t0=2.5, dt=0.1, t_end=1.207, method=method)
    assert angle(there.q[-1], exact[1][:4]) < 1e-13
    assert there.t[-1] == 3.707
    back = fa.propagate(scene, exact[1][:4], w[1], t0=3.707, dt=-0.1, t_end=-1.207, method=method)
    assert angle(back.q[-1], exact[0][:4]) < 1e-13


@pytest.mark.parametrize("method", ["rk8", "strang2", "suzuki4"])
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


def ensemble(n=N):
    rng = np.random.default_rng(3)
    return rng.normal(size=(n, 4)), rng.normal(size=(n, 3))


@pytest.mark.parametrize("method", ["rk4", "rk8", "strang2"])
def test_per_body_steps(method):
    """Bit for bit what each body does alone, and right."""
    q0, w0 = ensemble()
    counts = np.random.default_rng(5).integers(80, 160, size=N)
    counts[3] = 100  # 2.5 s ends one of its steps
    run = fa.propagate(OPEN, q0, w0, dt=END / counts, n_steps=counts, method=method)
    fine = fa.propagate(OPEN, q0, w0, dt=END / 4000, n_steps=4000, method="rk8")
    assert angle(run.q[-1], fine.q[-1]).max() < {"rk4": 1e-4, "rk8": 1e-11, "strang2": 0.03}[method]
    for b in (3, N - 1):
        h, n = END / counts[b], int(counts[b])
        alone = fa.propagate(OPEN, q0[b], w0[b], dt=h, n_steps=n, save_at=[END], method=method)
        np.testing.assert_array_equal(run.q[-1, b], alone.q[-1])


def same(a, b):
    np.testing.assert_array_equal(a.t, b.t)
    np.testing.assert_array_equal(a.q, b.q)
    np.testing.assert_array_equal(a.w, b.w)
    np.testing.assert_array_equal(a.status, b.status)


@pytest.mark.parametrize("method", ["rk4", "kahan_li6"])
@pytest.mark.parametrize("steps", [4, 5, 8, 9, 10, 11, 14, 19])
def test_resumed(method, steps, tmp_path):
    """To the bits of one run, wherever it was left: before, on and after a breakpoint."""
    q0, w0 = ensemble(3)
    whole = fa.propagate(OPEN, q0, w0, dt=0.25, n_steps=20, method=method)
    first = fa.propagate(OPEN, q0, w0, dt=0.25, n_steps=steps, method=method)
    first.save_end(tmp_path / "end")
    for end in (first, tmp_path / "end"):
        same(fa.propagate(OPEN, dt=0.25, n_steps=20 - steps, resume=end), whole)
    with pytest.raises(ValueError, match=r"^breakpoints: found \[\]; accepted: \[1.03"):
        fa.propagate(body(()), dt=0.25, n_steps=1, resume=first)


def test_saves_a_few_at_a_time(tmp_path):
    q0, w0 = ensemble()
    options = {"dt": 0.05, "t_end": 4.99, "save_every": 1, "method": "rk8"}
    whole = fa.propagate(OPEN, q0, w0, **options)
    found = []

    def keep(batch):
        found.append((batch.t.copy(), batch.q.copy()))

    run = fa.propagate(OPEN, q0, w0, **options, on_save=keep, resume=fa.checkpoint(tmp_path / "c"))
    np.testing.assert_array_equal(np.concatenate([t for t, _ in found]), whole.t)
    np.testing.assert_array_equal(np.concatenate([q for _, q in found]), whole.q)
    assert whole.t[-1] == 4.99
    again = fa.propagate(
        OPEN, q0, w0, **options, on_save=keep, resume=fa.checkpoint(tmp_path / "c")
    )
    np.testing.assert_array_equal(again.q, run.q)


@pytest.mark.parametrize("options", [{}, {"compensated": True}, {"normalise": 3}])
def test_threads_parts_and_projection(options):
    q0, w0 = ensemble(1500)
    runs = [
        fa.propagate(OPEN, q0, w0, dt=0.0125, n_steps=400, method="rk8", n_threads=n, **options)
        for n in (1, 2)
    ]
    same(*runs)
    some = fa.propagate(OPEN, q0[7], w0[7], dt=0.0125, n_steps=400, method="rk8", **options)
    np.testing.assert_array_equal(runs[0].q[:, 7], some.q)
    fine = fa.propagate(OPEN, q0, w0, dt=0.005, n_steps=1000, method="rk9")
    assert angle(runs[0].q[-1], fine.q[-1]).max() < 1e-11


def test_parts_cover_the_run():
    """Each second once, in order, and none on both sides of a breakpoint; of random runs."""
    rng = np.random.default_rng(0)
    for _ in range(500):
        h = float(rng.choice([0.25, 0.1, 0.3]) * rng.choice([1, -1]))
        n, t0 = int(rng.integers(1, 12)), float(rng.choice([0.0, 7.0, -1.0]))
        on_grid = rng.integers(0, 14, 4) * h
        breaks = t0 + np.where(rng.random(4) < 0.5, on_grid, rng.random(4) * h * n)
        end = None if rng.random() < 0.5 else float((n - rng.uniform(0.1, 0.9)) * h)
        clocks, steps = parts_of(tuple(np.unique(breaks).tolist()), t0, h, n, end)
        at, t, i, clock = 0, t0, 1, clocks[0]
        while at < n:
            begin, is_part = clock[2] + (clock[1] + at) * clock[0], False
            if i < len(steps) and steps[i] == at:
                clock, i = clocks[i], i + 1
                if not clock[5]:
                    continue
                begin, is_part = clock[2], True
            stop = begin + clock[0]
            assert begin == pytest.approx(t, abs=1e-12)
            assert clock[3] - 1e-12 <= min(begin, stop)
            assert max(begin, stop) <= clock[4] + 1e-12
            t = stop
            at += int(clock[6]) if is_part else 1
        assert t == pytest.approx(t0 + (n * h if end is None else end), abs=1e-12)
        assert i == len(steps)


def test_plan_of_any_begin():
    made = fa.plan(OPEN, 1, dt=0.3, t_end=2.0, method="rk8")
    for t0 in (0.0, 0.7, 2.5, 10.0):
        run = fa.propagate(OPEN, START, W0, t0=t0, dt=0.3, t_end=2.0, method="rk8")
        same(made(START, W0, t0=t0), run)
        same(pickle.loads(pickle.dumps(made))(START, W0, t0=t0), run)


def test_dask():
    fd = pytest.importorskip("fastatt.dask")
    q0, w0 = ensemble()
    lazy = fd.propagate(OPEN, q0, w0, dt=0.3, t_end=END, chunks=32, save_every=2)
    same(lazy.compute(), fa.propagate(OPEN, q0, w0, dt=0.3, t_end=END, save_every=2))


@pytest.mark.parametrize("scene", [OPEN, RATES[0]])
def test_float32(scene):
    exact = RATE_END if scene.kind == "rate" else BODY_END
    for options in ({}, {"save_at": [END]}):
        run = final(scene, dt=0.1, n_steps=50, method="rk8" if scene is OPEN else "magnus8",
                    dtype=np.float32, **options)  # fmt: skip
        assert run.q.dtype == np.float32
        assert angle(run.q[-1], exact[:4]) < 5e-6


def test_velocity_and_position():
    """A force that jumps; what moves is split into two runs by hand."""

    def push(t, q, w, v, p):
        return (2.0 if t < 1.234 else -1.0), 0.1 * v[1], 0.0

    def one(t, q, w, v, p):
        return 2.0, 0.1 * v[1], 0.0

    def other(t, q, w, v, p):
        return -1.0, 0.1 * v[1], 0.0

    def scene(force, breakpoints=()):
        return fa.Scene(inertia=J, mass=3.0, force=force, breakpoints=breakpoints)

    start = {"v0": (0.1, 0.2, 0.3), "r0": (0.0, 0.0, 0.0)}
    run = fa.propagate(scene(push, 1.234), START, W0, **start, dt=0.1, n_steps=30, method="rk8")
    half = fa.propagate(scene(one), START, W0, **start, dt=1.234 / 40, n_steps=40, method="rk8")
    start = {"v0": half.v[-1], "r0": half.r[-1]}
    rest = fa.propagate(
        scene(other), half.q[-1], half.w[-1], **start, dt=1.766 / 40, n_steps=40, method="rk8"
    )
    np.testing.assert_allclose(run.r[-1], rest.r[-1], atol=1e-13)
    np.testing.assert_allclose(run.v[-1], rest.v[-1], atol=1e-13)


SAMPLES = np.random.default_rng(2).normal(size=(11, 3))
SAMPLED_AT = np.linspace(0.0, END, 11)
UNEVEN = np.sort(np.append(np.random.default_rng(6).uniform(0.0, END, 9), (0.0, END)))


def of_table(t, kind="linear"):
    return fa.TimeSeries(t, SAMPLES, kind=kind)


def read_by_a_function(t, q, w, p):
    return LINEAR(t)


LINEAR = of_table(SAMPLED_AT)
# models with a linear table, the times of its samples, and the torque as NumPy has it
LINEAR_MODELS = {
    "history": (fa.torques.Sampled(SAMPLES, dt=0.5), SAMPLED_AT),
    "table": (fa.torques.Constant(of_table(UNEVEN)), UNEVEN),
    "sum": (fa.torques.Sum((fa.torques.Damping(0.0), fa.torques.Constant(LINEAR))), SAMPLED_AT),
}


def linear_truth(times):
    def slope(t, y):
        w = y[4:]
        torque = [np.interp(t, times, column) for column in SAMPLES.T]
        turned = 0.5 * np.array([-y[1:4] @ w, *(y[0] * w + np.cross(y[1:4], w))])
        return np.concatenate([turned, (np.cross(J * w, w) + torque) / J])

    y = np.append(START, W0)
    for a, b in pairwise(times):
        y = solve_ivp(slope, (a, b), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return y[:4] / np.linalg.norm(y[:4])


@pytest.mark.parametrize("name", LINEAR_MODELS)
def test_linear_tables_bring_their_samples(name):
    """Models keep the order of a method with any step; a function has to declare them."""
    torque, times = LINEAR_MODELS[name]
    scene, exact = fa.Scene(inertia=J, torque=torque), linear_truth(times)
    run = fa.propagate(scene, START, W0, dt=END / 41, n_steps=41, method="rk8")
    assert angle(run.q[-1], exact) < 1e-10
    declared = replace(scene, breakpoints=times)
    same(fa.propagate(declared, START, W0, dt=END / 41, n_steps=41, method="rk8"), run)
    at = fa.propagate(scene, START, W0, dt=END / 41, t_end=END, save_at=[1.7, END], method="rk8")
    assert angle(at.q[-1], exact) < 1e-10
    q0, w0 = np.tile(START, (3, 1)), np.tile(W0, (3, 1))
    each = fa.propagate(
        scene, q0, w0, dt=END / np.array((41, 37, 61)), n_steps=np.array((41, 37, 61)), method="rk8"
    )
    assert angle(each.q[-1], exact).max() < 1e-10
    first = fa.propagate(scene, START, W0, dt=END / 41, n_steps=17, method="rk8")
    rest = fa.propagate(scene, dt=END / 41, n_steps=24, resume=first)
    np.testing.assert_array_equal(rest.q, run.q)


def test_a_function_declares_the_samples_of_its_table():
    exact = linear_truth(SAMPLED_AT)
    errors = []
    for breakpoints in (LINEAR.t, ()):
        scene = fa.Scene(inertia=J, torque=read_by_a_function, breakpoints=breakpoints)
        run = fa.propagate(scene, START, W0, dt=END / 41, n_steps=41, method="rk8")
        errors.append(angle(run.q[-1], exact))
    assert errors[0] < 1e-10
    assert errors[1] > 1e-6


@pytest.mark.parametrize("times", [0.1 * np.arange(51)[::5], UNEVEN], ids=["even", "uneven"])
def test_a_held_table_brings_its_samples(times):
    """Forwards and backwards; a function has to declare them."""
    held = of_table(times, "previous")

    def slope(t, y, torque):
        w = y[4:]
        turned = 0.5 * np.array([-y[1:4] @ w, *(y[0] * w + np.cross(y[1:4], w))])
        return np.concatenate([turned, (np.cross(J * w, w) + torque) / J])

    y = np.append(START, W0)
    for k, (a, b) in enumerate(pairwise(times)):
        y = solve_ivp(
            slope, (a, b), y, "DOP853", rtol=1e-13, atol=1e-14, args=(SAMPLES[k],)
        ).y[:, -1]  # fmt: skip
    exact = y[:4] / np.linalg.norm(y[:4])
    steps = {"dt": END / 41, "n_steps": 41, "method": "rk8"}
    given = fa.Scene(inertia=J, torque=fa.torques.Constant(held))
    read = fa.Scene(inertia=J, torque=lambda t, q, w, p: held(t), breakpoints=held.t)
    for scene in (given, read):
        run = fa.propagate(scene, START, W0, **steps)
        assert angle(run.q[-1], exact) < 1e-10
        assert np.abs(run.w[-1] - y[4:]).max() < 1e-10
    back = fa.propagate(given, exact, y[4:], **{**steps, "dt": -END / 41}, t0=END)
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

    def slope(t, y):
        w, h, change = y[4:], np.array(momentum(t)), np.array(momentum.slope(t))
        turned = 0.5 * np.array([-y[1:4] @ w, *(y[0] * w + np.cross(y[1:4], w))])
        return np.concatenate([turned, (np.cross(J * w + h, w) - change) / J])

    y = np.append(START, W0)
    for a, b in pairwise(SAMPLED_AT):
        inside = np.nextafter(a, 9.0), np.nextafter(b, -9.0)
        y = solve_ivp(
            lambda t, y, inside=inside: slope(np.clip(t, *inside), y), (a, b), y, "DOP853",
            rtol=1e-13, atol=1e-14,
        ).y[:, -1]  # fmt: skip
    run = fa.propagate(scene, START, W0, dt=END / 83, n_steps=83, method="rk8")
    assert angle(run.q[-1], y[:4] / np.linalg.norm(y[:4])) < 1e-10
    assert np.abs(run.w[-1] - y[4:]).max() < 1e-10


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
    np.testing.assert_array_equal(corners_of(scene), wanted)
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


def test_a_flag_in_a_part():
    """A torque that is infinite in a pulse is seen, of that body alone."""
    q0, w0 = ensemble(3)
    params = np.array([[1.0, 0.0], [1e300, 0.0], [1.0, 0.0]])
    torque = fa.torques.Custom(pulses, params, uses_rate=False)
    scene = fa.Scene(inertia=J, torque=torque, breakpoints=BREAKS)
    run = fa.propagate(scene, q0, w0, dt=0.25, n_steps=20, method="rk8")
    assert run.status[1] != 0
    assert not run.status[[0, 2]].any()


@pytest.mark.parametrize("dt", [0.3, 0.25])
def test_t_end(dt):
    """Of whole steps the run of so many, else the last step is shorter."""
    scene = fa.Scene(inertia=J)
    for method in stepped(scene):
        order = fa.METHODS[method].order_of("free")
        run = fa.propagate(scene, START, W0, dt=dt, t_end=END, save_every=3, method=method)
        assert run.t[-1] == END
        np.testing.assert_array_equal(run.t[:-1], 3 * dt * np.arange(len(run.t) - 1))
        exact = fa.closed_form.free_body(START, W0, J, END)[0]
        whole = fa.propagate(scene, START, W0, dt=0.25, n_steps=20, method=method)
        assert angle(run.q[-1], exact) < 1.3 ** (order + 1) * angle(whole.q[-1], exact) + 1e-13
        if dt == 0.25:
            np.testing.assert_array_equal(run.q[-1], whole.q[-1])


def test_t_end_elsewhere():
    scene = fa.Scene(inertia=J)
    exact = fa.closed_form.free_body(START, W0, J, -END)[0]
    back = fa.propagate(scene, START, W0, dt=-0.3, t_end=-END, method="rk9")
    assert angle(back.q[-1], exact) < 1e-12
    q0, w0 = ensemble(3)
    steps = np.array((0.1, 0.07, 0.3))
    run = fa.propagate(scene, q0, w0, dt=steps, t_end=END, method="rk9")
    exact = fa.closed_form.free_body(q0, w0, J, END)[0]
    assert angle(run.q[-1], exact).max() < 1e-11
    assert run.t[-1] == END
    closed = fa.propagate(scene, q0, w0, dt=0.3, t_end=END, method="exact")
    assert angle(closed.q[-1], exact).max() < 1e-14
    assert fa.propagate(scene, q0, w0, dt=0.3, t_end=0.0).t.tolist() == [0.0]
    assert fa.propagate(scene, q0, w0, dt=0.3, t_end=0.1, method="rk9").t.tolist() == [0.1]


def test_saves_alone_end_the_run():
    scene, start = fa.Scene(inertia=J), ([1.0, 0.0, 0.0, 0.0], W0)
    for dt, at in ((0.1, [0.8, 2.57]), (-0.1, [0.5, -3.0]), (0.1, [0.5])):
        run = fa.propagate(scene, *start, dt=dt, save_at=at, t0=0.5, method="rk9")
        same = fa.propagate(scene, *start, dt=dt, t_end=at[-1] - 0.5, t0=0.5, method="rk9")
        assert run.t.tolist() == at
        assert same.t.tolist() == at[-1:]
        assert angle(run.q[-1], same.q[-1]) == 0.0
    with pytest.raises(ValueError, match=r"save_at\[0\] is -1; accepted: from 0.5 to 0.5"):
        fa.propagate(scene, *start, dt=0.1, save_at=[-1.0], t0=0.5)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "n_steps, t_end: found neither"),
        ({"n_steps": 3, "t_end": 1.0}, "n_steps, t_end: found both"),
        ({"t_end": -1.0}, "t_end: found -1.0 with dt 0.1; accepted: of the sign of dt"),
        ({"t_end": np.inf}, "t_end: found inf; accepted: a finite number"),
    ],
)
def test_refused_ends(options, text):
    for dt in (0.1, [0.1]):
        with pytest.raises(ValueError, match=text):
            fa.propagate(OPEN, START, W0, dt=dt, **options)


def test_refused():
    with pytest.raises(ValueError, match=r"^breakpoints: found for a free body; accepted"):
        fa.Scene(inertia=J, breakpoints=(1.0,))
    with pytest.raises(ValueError, match=r"^breakpoints\[1\] is nan"):
        body((1.0, np.nan))
    with pytest.raises(ValueError, match=r"^breakpoints: .*\(2, 1\).*accepted: times"):
        body([[1.0], [2.0]])
    with pytest.raises(TypeError, match=r"^breakpoints: "):
        body("soon")
    first = final(OPEN, dt=0.3, t_end=1.0)
    with pytest.raises(ValueError, match="does not hold its end"):
        fa.propagate(OPEN, dt=0.3, n_steps=1, resume=first)
    with pytest.raises(ValueError, match=r"^t_end: found with resume; accepted: n_steps"):
        fa.propagate(OPEN, dt=0.3, t_end=1.0, resume=final(OPEN, dt=0.3, n_steps=1))


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
    assert not scene.functions[0].straight
    for options in ({}, {"save_at": [END]}):
        run = fa.propagate(scene, START, dt=0.05, n_steps=100, method="magnus8", **options)
        assert angle(run.q[-1], RATE_END) < 1e-13
