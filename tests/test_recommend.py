"""Advice: what is recommended meets the tolerance on all bodies, and says what is true of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fastatt as fa
from fastatt.arrays import normalised
from fastatt.cli import main
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade import advice, sample
from fastatt.trade.measure import Case, Problem
from fastatt.trade.recommendation import Point
from fastatt.trade.reference import reference

RNG = np.random.default_rng(6)
N = 700
Q0 = RNG.normal(size=(N, 4))
W0 = RNG.normal(size=(N, 3))
CONING = fa.Scene(rate=fa.rates.Coning(RNG.uniform(0.2, 1.2, N), RNG.uniform(0.5, 2.0, N)))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
INERTIA = RNG.uniform(1.0, 1.4, (N, 3))
GRADIENT = fa.Scene(inertia=INERTIA, torque=fa.torques.GravityGradient(mean_motion=0.3))
T_END = 6.0
# few, as compiling is what takes the time
RATES = ["rk4", "magnus4", "magnus6"]
DOUBLE = {"dtypes": ["float64"]}


def coning_at(t, bodies=slice(None)):
    angle, frequency = (x[bodies] for x in CONING.rate)
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    phase = frequency * np.atleast_1d(t)[:, None]
    path = np.stack([c + 0 * phase, s * np.cos(phase), s * np.sin(phase), 0 * phase], axis=-1)
    first = np.stack([c, s, 0 * c, 0 * c], axis=-1) * (1, -1, -1, -1)
    return fa.quat_multiply(normalised(Q0[bodies]), fa.quat_multiply(first, path))


def found_error(scene, w0, chosen, exact=None):
    """The largest after any step, of any body; without a closed form beside a fine run by rk8."""
    run = fa.propagate(scene, Q0, w0, save_every=1, n_threads=1, **chosen.arguments)
    assert not run.status.any()
    if exact is None:
        k = -(-2000 // chosen.n_steps)
        q = fa.propagate(
            scene, Q0, w0, dt=chosen.dt / k, n_steps=k * chosen.n_steps, save_every=k, method="rk8"
        ).q
    else:
        q = exact(run.t)
    return fa.angle_between(run.q, q).max()


@pytest.mark.parametrize("tol", [1e-3, 1e-6, 1e-9, 1e-12])
def test_the_tolerance_is_met_by_all_bodies_and_not_by_far(tol):
    """The sample is a fifth of the bodies; the step may be a seventh too small."""
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=tol, methods=RATES, **DOUBLE)
    true = found_error(CONING, None, chosen, coning_at)
    order = fa.METHODS[chosen.method].order
    assert true <= tol
    assert true >= tol / 1.17 ** (2 * order) / chosen.safety
    assert true <= chosen.expected_error <= tol
    assert (chosen.sampled, chosen.n_bodies) == (128, N)
    assert chosen.dt * chosen.n_steps == pytest.approx(T_END, rel=1e-15)
    assert chosen.expected_seconds > 0.0
    assert chosen.limited_by == "truncation"


# which its controller brings to rest at a target: in the end every step is right
SETTLING = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.QuaternionPD(0.3, 0.5))
SETTLED = {"tol": 1e-3, "methods": ["rk4"], "sample": 64}


@pytest.mark.parametrize(("n", "t_end"), [(200, 200.0), (40, 2e4)])
def test_what_settles_is_right_on_the_way(n, t_end):
    """By default, of a long run too; the end alone forgives any step that is stable."""
    q0 = fa.rotation_vector_to_quat(np.random.default_rng(1).uniform(-1.0, 1.0, (n, 3)))
    w0 = 0.02 * W0[:n]
    errors = []
    for at in ("run", "end"):
        chosen = fa.recommend(SETTLING, q0, w0, t_end=t_end, at=at, **SETTLED, **DOUBLE)
        run = fa.propagate(SETTLING, q0, w0, save_every=1, **chosen.arguments)
        k = max(3, -(-4000 // chosen.n_steps))
        fine = fa.propagate(
            SETTLING, q0, w0, dt=chosen.dt / k, n_steps=k * chosen.n_steps, save_every=k,
            method="rk8",
        )  # fmt: skip
        errors.append(fa.angle_between(run.q, fine.q).max(axis=1))
        where = "over the run" if at == "run" else "at the end"
        assert f"rad at most {where}, from" in str(chosen)
    over, end = errors
    assert over.max() <= 1e-3 < end.max()
    assert end[-1] <= 1e-3


@pytest.mark.parametrize(("t_end", "part"), [(200.0, 1), (102400.0, 512)])
def test_what_settles_is_compared_on_the_way(t_end, part):
    """Bodies among themselves, and the reference with a finer one, are not judged by the end."""
    q0 = fa.rotation_vector_to_quat(np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3)))
    problem = Problem(Ensemble(SETTLING, q0, np.full((40, 3), 0.05)), t_end)
    n = int(t_end)
    two = (Case("rk4"), n), (Case("rk4"), 2 * n)
    (over, flagged), (end, _) = (sample.changed(problem, at, *two) for at in ("run", "end"))
    assert not flagged
    assert over.max() > 1e-4
    assert end.max() < 1e-9
    known = reference(problem, looks=1024, goal=1e-6)
    fine = replace(problem, t_end=200.0).run(Case("rk8"), 6400, 200)
    apart = fa.angle_between(known.even(32, part), fine.q[1:]).max()
    assert apart <= known.own_error.max() <= 1e-6


def test_the_command_tells_where_it_looks(capsys):
    scene = ["--rate", "Coning", "angle=0.5", "frequency=2", "--bodies", "20"]
    for at, where in (([], "over the run"), (["--at", "end"], "at the end")):
        assert (
            main(["recommend", "--t-end", "5", "--tol", "1e-6", "--methods", "rk4", *at, *scene])
            == 0
        )
        assert f"rad at most {where}, from 20 of 20" in capsys.readouterr().out


def test_saves_and_threads_are_the_callers_own():
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=1e-6, methods=RATES, **DOUBLE)
    run = fa.propagate(CONING, Q0, save_every=5, n_threads=2, **chosen.arguments)
    assert run.t[1] == 5 * chosen.dt
    assert run.t[-1] == pytest.approx(T_END, rel=1e-15)


def test_a_busy_machine_does_not_bring_up_what_was_not_made_sure_of(monkeypatch):
    """Though every timing of the last round is a thousand times as long as the guess."""
    monkeypatch.setattr(advice.Search, "_clock", lambda self, look, n: 1e3 * look.seconds(n))
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=1e-3, methods=RATES, **DOUBLE)
    assert found_error(CONING, None, chosen, coning_at) <= chosen.expected_error <= 1e-3


def test_hard_bodies_that_are_few_are_found():
    """Three bodies among 700 spin ten times as fast as the others."""
    w0 = 0.1 * W0
    w0[[50, 333, 699]] *= 30.0
    chosen = fa.recommend(GRADIENT, Q0, w0, t_end=T_END, tol=1e-6, methods=["rk8"], sample=64)
    assert found_error(GRADIENT, w0, chosen) <= 1e-6


def test_bodies_are_chosen_where_few_can_be_screened(monkeypatch):
    """As of long runs: no more than the sample, half of them the fastest of all."""
    monkeypatch.setattr(sample, "_SCREENING", 0.0)
    w0 = W0.copy()
    w0[123] *= 20.0
    chosen = fa.recommend(GRADIENT, Q0, w0, t_end=T_END, tol=1e-6, methods=["rk8"], sample=256)
    assert chosen.sampled == 256
    assert found_error(GRADIENT, w0, chosen) <= 1e-6


def test_a_sample_of_easy_bodies_is_corrected_by_the_others(monkeypatch):
    """What the step and its half change on the others shows how much harder they are."""
    w0 = W0 * np.linspace(0.1, 1.0, N)[:, None]
    rows = np.arange(64), np.arange(N - 1, 63, -1)
    monkeypatch.setattr(sample.Sample, "_choose", lambda *a: rows)
    chosen = fa.recommend(GRADIENT, Q0, w0, t_end=T_END, tol=1e-6, methods=["rk8"])
    assert chosen.safety > 10.0
    assert 1e-7 < found_error(GRADIENT, w0, chosen) <= 1e-6


def test_the_closed_form_needs_no_steps():
    chosen = fa.recommend(FREE, Q0, W0, t_end=T_END, tol=1e-9, methods=["rk4", "exact"], **DOUBLE)
    assert (chosen.method, chosen.n_steps, chosen.limited_by) == ("exact", 1, "round-off")
    assert chosen.expected_error < 1e-12
    assert found_error(FREE, W0, chosen) < 1e-12


def test_saves_fall_on_the_times_asked_for():
    chosen = fa.recommend(
        CONING, Q0, t_end=T_END, tol=1e-6, save_interval=0.6, methods=RATES, **DOUBLE
    )
    run = fa.propagate(CONING, Q0, **chosen.arguments)
    assert run.t == pytest.approx(np.linspace(0.0, T_END, 11), abs=1e-12)
    assert chosen.n_steps == 10 * chosen.save_every


def test_a_budget_is_kept_and_used(monkeypatch):
    # by a clock of its own: 0.1 ms a call and 5 µs a step, whatever else runs here
    monkeypatch.setattr(sample.Sample, "_run_steps", lambda self, case, dt, n: 1e-4 + 5e-6 * n)
    monkeypatch.setattr(advice.Search, "_clock", lambda self, look, n: look.seconds(n))
    # of order 2, which no time here brings down to round-off
    small, middle = (
        fa.recommend(CONING, Q0, t_end=T_END, budget=t, methods=["lie_midpoint"], **DOUBLE)
        for t in (5e-3, 0.1)
    )
    assert middle.expected_error < small.expected_error
    large = fa.recommend(CONING, Q0, t_end=T_END, budget=0.1, methods=RATES, **DOUBLE)
    assert large.expected_seconds <= 0.1
    assert large.expected_error < middle.expected_error
    assert found_error(CONING, None, large, coning_at) < 1e-12
    assert large.limited_by == "round-off"
    assert large.tol is None


def test_out_of_reach():
    with pytest.raises(ValueError, match=r"tol: found 1e-16; accepted: at least \d"):
        fa.recommend(CONING, Q0, t_end=T_END, tol=1e-16)
    with pytest.raises(ValueError, match=r"tol: found 1e-09; accepted: what can be reached, \d"):
        fa.recommend(CONING, Q0, t_end=T_END, tol=1e-9, methods=["rk4"], dtypes=["float32"])
    with pytest.raises(ValueError, match=r"budget: found 1e-07 s; accepted: at least the "):
        fa.recommend(CONING, Q0, t_end=T_END, budget=1e-7, methods=["rk4"], **DOUBLE)


def test_long_runs_are_measured_over_a_part(monkeypatch):
    """What a part of the time shows, carried on, is right within a few tens of percent."""
    monkeypatch.setattr(sample, "_LONG", 1e-12)
    long = 1600.0
    bodies = slice(0, 64)
    scene = fa.Scene(rate=fa.rates.Coning(*(x[bodies] for x in CONING.rate)))
    chosen = fa.recommend(scene, Q0[bodies], t_end=long, tol=1e-5, methods=["magnus4"], **DOUBLE)
    assert chosen.extrapolated_from < 0.3 * long
    run = fa.propagate(scene, Q0[bodies], **chosen.arguments)
    half = fa.propagate(scene, Q0[bodies], dt=chosen.dt / 2, n_steps=2 * chosen.n_steps)
    true = fa.angle_between(run.q[-1], half.q[-1]).max() * 16.0 / 15.0
    assert 0.2e-5 < true <= 1e-5


def pushed(n):
    """A sine as torque, n samples over the time."""
    t = np.linspace(0.0, T_END, n)
    torque = 0.3 * np.sin(2.0 * t)[:, None] * (1.0, 0.5, 0.2)
    return fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.Sampled(torque, t[1]))


@pytest.mark.parametrize("n", [25, 26])
def test_the_interval_of_a_history_may_limit(n):
    """What the line between samples costs is what a hundred times as many samples change."""
    chosen = fa.recommend(
        pushed(n), Q0[:64], W0[:64], t_end=T_END, tol=1e-3, methods=["rk4"], **DOUBLE
    )
    ends = [
        fa.propagate(pushed(m), Q0[:64], W0[:64], dt=T_END / k, n_steps=k, method="rk4").q[-1]
        for m, k in ((n, 50 * (n - 1)), (100 * (n - 1) + 1, 50 * (n - 1)))
    ]
    assert chosen.n_steps % (n - 1) == 0  # a kink within a step costs far more
    assert chosen.limited_by == "sampling"
    assert chosen.sampling_error == pytest.approx(fa.angle_between(*ends).max(), rel=0.5)
    assert "the torque's interval costs" in str(chosen)


def test_a_method_of_ones_own_is_recommended():
    """Alone, and beside a name that it cannot beat."""
    heun = fa.runge_kutta("heun", order=2, c=(0, 1), a=((1,),), b=(0.5, 0.5))
    bodies = slice(0, 40)
    scene = fa.Scene(rate=fa.rates.Coning(*(x[bodies] for x in CONING.rate)))
    alone = fa.recommend(scene, Q0[bodies], t_end=T_END, tol=1e-4, methods=[heun], **DOUBLE)
    assert alone.method == "heun"
    assert str(alone).startswith("heun (quat, float64): ")
    run = fa.propagate(scene, Q0[bodies], **alone.arguments)
    assert run.record is heun
    assert fa.angle_between(run.q[-1], coning_at(T_END, bodies)[0]).max() <= 1e-4
    both = fa.recommend(
        scene, Q0[bodies], t_end=T_END, tol=1e-7, methods=[heun, "magnus4"], **DOUBLE
    )
    assert both.method == both.arguments["method"] == "magnus4"


def test_text_names_what_matters():
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=1e-6, methods=RATES, **DOUBLE)
    up = Point(Case("rk4"), 100, 1e-7, 2.0 * chosen.expected_seconds)
    text = str(replace(chosen, runner_up=up, margin=2.0))
    for part in (
        f"{chosen.method} (quat, float64): {chosen.n_steps} steps",
        "tol 1e-06",
        "from 128 of 700 bodies",
        "limited by truncation",
        "runner-up  rk4 (quat, float64), 100 steps: 2.00 times as long",
        "reference  the exact coning motion",
    ):
        assert part in text
    assert {p.case.method for p in chosen.curve} == set(RATES)
    for p in chosen.curve:
        assert p.seconds > 0.0


def test_cases_far_from_the_tolerance_are_not_looked_at():
    cases = [Case(m, dtype=d) for m in ("strang2", "rk4", "rk8") for d in ("float64", "float32")]
    assert advice._hopeful(cases, 1e-2) == cases
    assert {c.method for c in advice._hopeful(cases, 1e-9)} == {"rk4", "rk8"}
    assert {c.dtype for c in advice._hopeful(cases, 1e-9)} == {"float64"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "tol, budget: found neither"),
        ({"tol": 1e-3, "budget": 1.0}, "tol, budget: found both"),
        ({"tol": 0.0}, "tol: found 0.0; accepted: a number above 0"),
        ({"budget": -1.0}, "budget: found -1.0"),
        ({"tol": 1e-3, "t_end": -1.0}, "t_end: found -1.0"),
        ({"tol": 1e-3, "save_interval": 0.7}, "save_interval: found 0.7; accepted: t_end, 6.0,"),
        ({"tol": 1e-3, "methods": ["rk8"]}, "methods: found 'rk8'"),
        ({"tol": 1e-3, "sample": 0}, "sample: found 0"),
        ({"tol": 1e-3, "at": "start"}, "at: found 'start'; accepted: run, end"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(ValueError, match=message):
        fa.recommend(CONING, Q0, **{"t_end": T_END, **change})


def jet(t, q, w, p):
    return (p[0] if 1.03 < t < 1.31 else 0.0), 0.0, -p[1] * w[2]


def test_a_torque_that_jumps_is_not_taken_for_smooth():
    """Of high order is what changes with the step by chance: the declared order says nothing."""
    scene = fa.Scene(inertia=(2.0, 1.0, 1.4), torque=jet, params=(3.0, 0.1))
    rng = np.random.default_rng(5)
    q0, w0 = rng.normal(size=(128, 4)), rng.normal(0.0, 1.0, (128, 3))
    q, w = q0, w0
    for push, duration in ((0.0, 1.03), (3.0, 0.28), (0.0, 3.69)):  # from jump to jump
        part = fa.Scene(
            inertia=(2.0, 1.0, 1.4),
            torque=fa.torques.Custom(lambda t, q, w, p: (p[0], 0.0, -0.1 * w[2]), (push,)),
        )
        run = fa.propagate(part, q, w, dt=duration / 400, n_steps=400, method="rk8")
        q, w = run.q[-1], run.w[-1]
    known = reference(Problem(Ensemble(scene, q0, w0), 5.0), goal=1e-3)
    assert (fa.angle_between(known.end.q, q) <= 2.0 * known.own_error).all()
