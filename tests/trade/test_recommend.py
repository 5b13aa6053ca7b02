"""Advice: what is recommended meets the tolerance on all bodies, and says what is true of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fastatt as fa
from fastatt.arrays import normalised
from fastatt.cli import main
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade import advice, sample, search
from fastatt.trade.forcing import forcing
from fastatt.trade.ladder import Ladder
from fastatt.trade.measure import Case, Problem
from fastatt.trade.recommendation import Point
from fastatt.trade.reference import _own_error, reference

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
    angle, frequency = CONING.rate.angle[bodies], CONING.rate.frequency[bodies]
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
    """The step may be a seventh too small."""
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=tol, methods=RATES, **DOUBLE)
    true = found_error(CONING, None, chosen, coning_at)
    order = fa.METHODS[chosen.method].order
    assert true <= tol
    assert true >= tol / 1.17 ** (2 * order) / 1.1
    assert true <= chosen.expected_error <= tol
    assert (chosen.measured, chosen.n_bodies) == (N, N)
    assert chosen.dt * chosen.n_steps == pytest.approx(T_END, rel=1e-15)
    assert chosen.expected_seconds > 0.0
    assert chosen.limited_by == "truncation"


# which its controller brings to rest at a target: in the end every step is right
SETTLING = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.QuaternionPD(0.3, 0.5))
SETTLED = {"tol": 1e-3, "methods": ["rk4"], "sample": 64}


@pytest.mark.parametrize(("n", "t_end"), [(40, 200.0), (40, 5e3)])
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
        assert f"rad at most {where}, measured over" in str(chosen)
    over, end = errors
    assert over.max() <= 1e-3 < end.max()
    assert end[-1] <= 1e-3


@pytest.mark.parametrize("t_end", [200.0, 102400.0])
def test_what_settles_is_compared_on_the_way(t_end):
    """Bodies among themselves, and the reference with a finer one, are not judged by the end."""
    q0 = fa.rotation_vector_to_quat(np.random.default_rng(1).uniform(-1.0, 1.0, (40, 3)))
    problem = Problem(Ensemble(SETTLING, q0, np.full((40, 3), 0.05)), t_end)
    over, end = (Ladder(problem, Case("rk4"), int(t_end), most).halve() for most in (1024, 1))
    assert over.max() > 1e-4
    assert end.max() < 1e-9
    known = reference(problem, most=1024, goal=1e-6)
    fine = replace(problem, t_end=200.0).run(Case("rk8"), 6400, 200)
    apart = fa.angle_between(known.at(fine.t[1:]), fine.q[1:]).max()
    assert apart <= known.own_error.max() <= 1e-6


def test_the_command_tells_where_it_looks(capsys):
    scene = ["--rate", "Coning", "angle=0.5", "frequency=2", "--bodies", "20"]
    for at, where in (([], "over the run"), (["--at", "end"], "at the end")):
        assert (
            main(["recommend", "--t-end", "5", "--tol", "1e-6", "--methods", "rk4", *at, *scene])
            == 0
        )
        assert f"rad at most {where}, measured over 20 of 20 bodies" in capsys.readouterr().out


def test_saves_and_threads_are_the_callers_own():
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=1e-6, methods=RATES, **DOUBLE)
    run = fa.propagate(CONING, Q0, save_every=5, n_threads=2, **chosen.arguments)
    assert run.t[1] == 5 * chosen.dt
    assert run.t[-1] == pytest.approx(T_END, rel=1e-15)


def test_a_busy_machine_does_not_bring_up_what_was_not_made_sure_of(monkeypatch):
    """Though every timing of the last round is a thousand times as long as the guess."""
    monkeypatch.setattr(search.Search, "_clock", lambda self, look, n: 1e3 * look.seconds(n))
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
    assert chosen.measured >= 256
    assert found_error(GRADIENT, w0, chosen) <= 1e-6


def test_a_sample_of_easy_bodies_is_corrected_by_the_others(monkeypatch):
    """What is recommended is run on the others, too."""
    w0 = W0 * np.linspace(0.1, 1.0, N)[:, None]
    rows = np.arange(64), np.arange(N - 1, 63, -1)
    monkeypatch.setattr(sample.Sample, "_choose", lambda *a: rows)
    chosen = fa.recommend(GRADIENT, Q0, w0, t_end=T_END, tol=1e-6, methods=["rk8"])
    assert chosen.measured == N
    assert 1e-7 < found_error(GRADIENT, w0, chosen) <= 1e-6


def test_the_closed_form_needs_no_steps():
    options = {"methods": ["rk4", "exact"], "rng": np.random.default_rng(1), **DOUBLE}
    chosen = fa.recommend(FREE, Q0, W0, t_end=T_END, tol=1e-9, **options)
    assert (chosen.method, chosen.n_steps, chosen.limited_by) == ("exact", 1, "round-off")
    assert chosen.expected_error < 1e-12
    assert found_error(FREE, W0, chosen) < 1e-12


def test_a_budget_is_kept_and_used(monkeypatch):
    # by a clock of its own: 0.1 ms a call and 5 µs a step, whatever else runs here
    monkeypatch.setattr(sample.Sample, "_run_steps", lambda self, case, dt, n: 1e-4 + 5e-6 * n)
    monkeypatch.setattr(search.Search, "_clock", lambda self, look, n: look.seconds(n))
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


def test_long_runs_are_measured_on_fewer_bodies(monkeypatch):
    """Over all of their time."""
    monkeypatch.setattr(sample, "_LONG", 6e4)
    monkeypatch.setattr(sample, "_VERIFYING", 0.0)
    long = 1600.0
    chosen = fa.recommend(CONING, Q0, t_end=long, tol=1e-5, methods=["magnus4"], **DOUBLE)
    assert 8 <= chosen.measured < 64
    assert chosen.expected_error <= 1e-5 / 1.5
    run = fa.propagate(CONING, Q0, **chosen.arguments)
    assert 1e-6 < fa.angle_between(run.q[-1], coning_at(long)[0]).max() <= 1e-5


def test_steps_end_at_the_samples_of_a_torque():
    """A kink within a step costs far more."""
    t = np.linspace(0.0, T_END, 25)
    torque = 0.3 * np.sin(2.0 * t)[:, None] * (1.0, 0.5, 0.2)
    scene = fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.Sampled(torque, t[1]))
    chosen = fa.recommend(scene, Q0[:64], W0[:64], t_end=T_END, tol=1e-3, methods=["rk4"], **DOUBLE)
    assert chosen.n_steps % 24 == 0


def test_a_method_of_ones_own_is_recommended():
    """Alone, and beside a name that it cannot beat."""
    heun = fa.runge_kutta("heun", order=2, c=(0, 1), a=((1,),), b=(0.5, 0.5))
    bodies = slice(0, 40)
    scene = CONING[bodies]
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
        f"{chosen.expected_error:.1e} rad at most over the run, measured over 700 of 700 bodies",
        "limited by truncation",
        "runner-up  rk4 (quat, float64), 100 steps: 2.00 times as long",
        "reference  the exact coning motion",
    ):
        assert part in text


def test_the_error_of_a_closed_form_is_estimated():
    """In double precision it is compared with itself, and in single precision measured."""
    free = fa.Scene(inertia=(2.0, 1.0, 0.7))
    options = {"t_end": 5.0, "tol": 1e-4, "methods": ["exact"]}
    for dtype, word in (("float64", "estimated"), ("float32", "measured")):
        found = fa.recommend(free, Q0[:3], W0[:3], dtypes=[dtype], **options)
        assert f"over the run, {word} over 3 of 3 bodies" in str(found)
        assert (found.expected_error == found.reference_error) == (word == "estimated")


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
    known = reference(Problem(Ensemble(scene, q0, w0), 5.0))
    assert known.own_error.max() < 5e-3
    assert known.jump.startswith("the torque jumps near t = 1.")
    assert (fa.angle_between(known.end.q, q) <= 2.0 * known.own_error).all()


def pulse(t, q, w, p):
    return (1.0 if p[0] < t < p[1] else 0.0), 0.0, 0.0


def corner(t, q, w, p):
    return min(max(t - p[0], 0.0), 1.0), 0.0, 0.0


@pytest.mark.parametrize("end", [5.4, 5.04, 5.005])
def test_a_pulse_is_refused_with_its_time(end):
    """Shorter than a step it is seen all the same, and no single step is "round-off"."""
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=pulse, params=(5.0, end))
    words = r"the torque jumps near t = 5\S* s \(body \d+\), .*fa.Scene\(..., breakpoints=times\)"
    for tol in (1e-4, 1e-2):
        with pytest.raises(ValueError, match=words):
            fa.recommend(scene, Q0[:20], 0.1 * W0[:20], t_end=10.0, tol=tol, methods=["gbs16"])


def friction(t, q, w, p):
    return (-p[0] if w[0] > 0.0 else p[0]), 0.0, 0.0


@pytest.mark.parametrize("t0", [0.0, 1e6])
def test_a_jump_with_the_state_is_told_from_one_in_time(t0):
    """Friction of constant size reverses where the rotation does, at no time known beforehand."""
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=friction, params=(0.02,))
    words = r"the torque jumps with the state near t = \d.* \(body 0\), .*smooth.*Sampled.*event"
    with pytest.raises(ValueError, match=words) as caught:
        fa.recommend(scene, Q0[:1], (0.3, 0.3, 1.5), t_end=10.0, t0=t0, tol=1e-4, methods=["rk8"])
    assert "breakpoints" not in str(caught.value)


@pytest.mark.parametrize("function", [fa.recommend, fa.per_body_steps])
def test_a_pulse_of_one_body_of_many_is_refused(function):
    """The body is the only one of 4000 whose parameter is not 0, and the pulse is short."""
    params = np.full((4000, 3), (5.0, 5.002, 0.0))
    params[2501, 2] = 1.0
    scene = fa.Scene(
        inertia=(4.0, 3.0, 2.5),
        torque=lambda t, q, w, p: ((p[2] if p[0] < t < p[1] else 0.0), 0.0, 0.0),
        params=params,
    )
    options = {"methods": ["rk8"]} if function is fa.recommend else {"method": "rk8"}
    w0 = np.random.default_rng(4).normal(0.0, 0.3, (4000, 3))
    with pytest.raises(ValueError, match=r"the torque jumps near t = 5\S* s \(body 2501\)"):
        function(scene, (1, 0, 0, 0), w0, t_end=10.0, tol=1e-4, **options)


@pytest.mark.parametrize("end", [5.4, 5.04, 5.005])
def test_a_pulse_between_breakpoints_is_accepted(end):
    """Advice and per-body steps keep their promise; another jump is refused still."""
    options = {"inertia": (4.0, 3.0, 2.5), "torque": pulse, "params": (5.0, end)}
    scene = fa.Scene(**options, breakpoints=(5.0, end))
    bodies = Q0[:20], 0.1 * W0[:20]
    fine = fa.propagate(scene, *bodies, dt=1e-2, n_steps=1000, method="rk9")
    chosen = fa.recommend(scene, *bodies, t_end=10.0, tol=1e-9, methods=["rk4", "rk8"], **DOUBLE)
    run = fa.propagate(scene, *bodies, **chosen.arguments)
    rounding = 1e-13  # of the finer run
    error = fa.angle_between(run.q[-1], fine.q[-1]).max()
    assert error - rounding <= chosen.expected_error <= 1e-9
    steps = fa.per_body_steps(scene, *bodies, t_end=10.0, tol=1e-9)
    run = fa.propagate(scene, *bodies, **steps.arguments)
    error = fa.angle_between(run.q[-1], fine.q[-1]).max()
    assert error - rounding <= steps.expected_error <= 1e-9
    half = fa.Scene(**options, breakpoints=5.0)
    with pytest.raises(ValueError, match=r"the torque jumps near t = 5"):
        fa.recommend(half, *bodies, t_end=10.0, tol=1e-4, methods=["rk8"])


def test_orders_between_breakpoints():
    scene = fa.Scene(
        inertia=(4.0, 3.0, 2.5), torque=pulse, params=(5.0, 5.33), breakpoints=(5.0, 5.33)
    )
    check = fa.check_convergence(scene, Q0[:20], 0.1 * W0[:20], dt=0.25, n_steps=40, method="rk4")
    assert check.passed
    rows = fa.work_precision(
        scene, Q0[:20], W0[:20], t_end=10.0, methods=["rk4"], dtypes=["float64"], max_seconds=2.0
    ).rows
    orders = [row.order for row in rows if row.order is not None]
    assert 3.5 < np.median(orders) < 4.6


def test_a_corner_is_refused_below_what_the_reference_reaches():
    """An error that falls by order 2 in place of 8 is a finding; above it advice is kept."""
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=corner, params=(3.1,))
    options = {"t_end": 10.0, "methods": ["rk4"], **DOUBLE}
    chosen = fa.recommend(scene, Q0[:20], 0.1 * W0[:20], tol=1e-3, **options)
    run = fa.propagate(scene, Q0[:20], 0.1 * W0[:20], **chosen.arguments)
    fine = fa.propagate(scene, Q0[:20], 0.1 * W0[:20], dt=1e-3, n_steps=10_000, method="rk8")
    assert fa.angle_between(run.q[-1], fine.q[-1]).max() <= chosen.expected_error <= 1e-3
    words = (
        r"tol: found 1e-12; accepted: at least .* halving its step size divides its error by "
        r".*, where order 8 predicts 256.* fa\.Scene\(\.\.\., breakpoints=times\)"
    )
    with pytest.raises(ValueError, match=words):
        fa.recommend(scene, Q0[:20], 0.1 * W0[:20], tol=1e-12, **options)
    with pytest.raises(ValueError, match=words):
        fa.per_body_steps(scene, Q0[:4], 0.1 * W0[:4], t_end=10.0, tol=1e-12, method="rk8")


def test_the_error_of_the_reference_is_not_called_round_off(monkeypatch):
    """Across a corner errors fall by order 2 and irregularly, those of the reference too."""
    # by a clock of its own
    monkeypatch.setattr(sample.Sample, "_run_steps", lambda self, case, dt, n: 1e-4 + 5e-6 * n)
    monkeypatch.setattr(search.Search, "_clock", lambda self, look, n: look.seconds(n))
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=corner, params=(3.1,))
    bodies, options = (scene, Q0[:20], 0.1 * W0[:20]), {"t_end": 10.0, "methods": ["rk8"], **DOUBLE}
    fine = fa.recommend(*bodies, budget=0.6, **options)
    assert fine.expected_error <= 2.0 * fine.reference_error
    assert fine.limited_by == "reference"
    coarse = fa.recommend(*bodies, tol=1e-3, **options)
    assert coarse.reference_error < 0.1 * coarse.expected_error
    assert coarse.limited_by == "truncation"


@pytest.mark.parametrize("t_end", [1e15, 1e300])
@pytest.mark.parametrize("scene", [FREE, CONING, fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 1.0)))])
def test_a_duration_after_which_no_attitude_is_known_is_refused(scene, t_end):
    w0 = W0 if scene is FREE else None
    message = r"^t_end: found 1e\+.*; accepted: at most \d.* s, in which .* by 1e\+12 rad"
    calls = [
        (fa.recommend, {"tol": 1e-6}),
        (fa.recommend, {"budget": 1.0}),
        (fa.work_precision, {}),
    ]
    if w0 is not None:
        calls.append((fa.per_body_steps, {"tol": 1e-6}))
    for function, options in calls:
        with pytest.raises(ValueError, match=message):
            function(scene, Q0, w0, t_end=t_end, **options)


def shot(t, q, w, p):
    return math.exp(-(((t - 5.01) / 0.004) ** 2)), 0.0, 0.0


def test_steps_of_the_reference_resolve_what_acts():
    """A smooth pulse that large steps would miss, each of them."""
    problem = Problem(
        Ensemble(fa.Scene(inertia=(4, 3, 2.5), torque=shot), Q0[:9], 0.1 * W0[:9]), 10.0
    )
    found = forcing(problem, Case("rk8"), 10)
    assert 1000 < found.steps < 20_000
    assert not found.jump
    known = reference(problem, goal=1e-6)
    fine = problem.run(Case("rk4"), 100_000)
    assert fa.angle_between(known.end.q, fine.q[-1]).max() < 1e-9


def test_advice_for_a_later_start_is_run_from_there():
    scene = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=corner, params=(100.0,))
    chosen = fa.recommend(
        scene, Q0[:20], W0[:20], t_end=2.0, tol=1e-6, t0=110.0, methods=["rk8"], **DOUBLE
    )
    assert chosen.arguments["t0"] == 110.0
    run = fa.propagate(scene, Q0[:20], W0[:20], **chosen.arguments)
    fine = fa.propagate(scene, Q0[:20], W0[:20], dt=2e-3, n_steps=1000, t0=110.0, method="rk8")
    assert fa.angle_between(run.q[-1], fine.q[-1]).max() <= chosen.expected_error <= 1e-6


def test_one_step_over_the_whole_run_is_not_called_round_off():
    slow = fa.Scene(inertia=(4.0, 3.0, 2.5), torque=fa.torques.GravityGradient(1e-3))
    chosen = fa.recommend(
        slow, Q0[:20], 1e-3 * W0[:20], t_end=1.0, tol=1e-6, methods=["rk8"], **DOUBLE
    )
    assert (chosen.n_steps, chosen.limited_by) == (1, "truncation")


def test_no_runner_up_is_faster_than_the_choice(monkeypatch):
    """Whatever the last timing says of either."""
    clock = iter([3.0, 1.0, 3.0, 1.0])
    monkeypatch.setattr(search.Search, "_clock", lambda self, one, n: next(clock))
    chosen = fa.recommend(CONING, Q0, t_end=T_END, tol=1e-3, methods=["rk4", "magnus4"], **DOUBLE)
    assert chosen.runner_up is None or chosen.margin >= 1.0


class Falling(Ladder):
    """Changes that were found by halving, rad, and a floor of rounding."""

    floor = 1e-12

    def __init__(self, *changes):
        self.changes = [np.array([change]) for change in changes]


@pytest.mark.parametrize(
    ("changes", "own", "settled", "doubted"),
    [
        ((1e-3, 1e-5, 5e-8, 2e-10), 2e-10, True, False),  # order 8, to the goal
        ((1e-3, 4e-6, 1e-8), 1e-8, False, False),
        ((1e-5, 3e-8, 1e-13), 1e-13, True, False),  # order 8, to rounding
        ((1e-13, 2e-13), 2e-13, True, False),
        ((8e-8, 5e-9, 3e-9, 3e-14), 2e-8, False, True),  # by chance, of a corner
        ((1e-5, 1e-13), 4e-5, False, True),
        ((4e-11, 2e-11, 1e-11), 1.6e-10, True, True),  # of order 1, far enough below
        ((3e-8, 4e-8, 2e-8, 3e-8), 1.6e-7, True, True),  # rounding that grows
        ((1e-3, 5e-4, 2.5e-4, 1e-4), 2e-3, False, True),
    ],
)
def test_a_reference_is_trusted_where_its_error_falls_as_it_should(changes, own, settled, doubted):
    found, enough, doubt = _own_error(Falling(*changes), 8, 1e-9)
    assert found == pytest.approx([own])
    assert (enough, bool(doubt)) == (settled, doubted)
