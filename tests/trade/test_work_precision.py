"""Work and precision on a user's scene: its rows, its reference, its files."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from exact import RALSTON3

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade.ladder import see
from fastatt.trade.measure import Case, Problem, measure
from fastatt.trade.reference import reference
from fastatt.trade.work_precision import Study, cases_of, spread

N = 48
RNG = np.random.default_rng(4)
Q0 = RNG.normal(size=(N, 4))
W0 = RNG.normal(size=(N, 3))
CONING = fa.Scene(rate=fa.rates.Coning(RNG.uniform(0.2, 1.2, N), RNG.uniform(0.5, 2.0, N)))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
GRADIENT = fa.Scene(
    inertia=RNG.uniform(1.0, 1.4, (N, 3)), torque=fa.torques.GravityGradient(mean_motion=0.3)
)
T_END = 5.0


@pytest.fixture(scope="module")
def coning():
    methods = ["lie_midpoint", "rk4", "magnus4", "magnus6"]
    return fa.work_precision(
        CONING, Q0, t_end=T_END, methods=methods, dtypes=["float64"], repeats=1, max_seconds=10.0
    )


@pytest.fixture(scope="module")
def free():
    options = {"methods": ["rk4", "exact"], "dtypes": ["float64"], "sample": 32}
    return fa.work_precision(FREE, Q0, W0, t_end=T_END, repeats=1, max_seconds=10.0, **options)


@pytest.mark.parametrize("method", ["lie_midpoint", "rk4", "magnus4", "magnus6"])
def test_orders_are_the_declared_ones_and_plateaus_are_named(coning, method):
    rows = [r for r in coning.rows if r.method == method]
    orders = [r.order for r in rows if r.order is not None and r.error_max < 1e-2]
    assert np.median(orders) == pytest.approx(fa.METHODS[method].order, abs=0.2)
    named = [r.plateau for r in rows]
    assert named == sorted(named)
    for row in rows:
        assert (row.order is None) == (row is rows[0] or row.plateau == "round-off")
        assert row.error_median <= row.error_max
    if method == "magnus6":
        assert named[-1] == "round-off"
        assert rows[-1].error_max < 1e-13


def test_free_bodies_keep_what_they_keep(free):
    (exact,) = [r for r in free.rows if r.method == "exact"]
    assert 0.0 < exact.error_max < 1e-12
    for row in free.rows:
        assert None not in (row.rate_error_max, row.energy_drift_max, row.momentum_drift_max)
        assert row.seconds_per_body <= row.seconds_lower <= row.seconds_upper
    assert free.study.title == f"32 of {N} bodies (free)"
    assert free.study.known.source == "the closed form"


def test_evaluations_and_the_share_of_the_call_are_told(free):
    """Four torques in a step of a body by rk4."""
    rk4 = [r for r in free.rows if r.method == "rk4"]
    assert {r.step_evaluations for r in rk4} == {4}
    assert [r.evaluations for r in rk4] == [4 * r.n_steps for r in rk4]
    assert 0.0 < rk4[-1].call_share < rk4[0].call_share <= 1.0
    (exact,) = [r for r in free.rows if r.method == "exact"]
    assert exact.evaluations == 0


def test_numbers_of_steps_can_be_chosen():
    options = {"methods": ["magnus4", "rk4"], "dtypes": ["float64"], "repeats": 1}
    found = fa.work_precision(CONING, Q0, t_end=T_END, n_steps=[80, 20, 40], **options)
    assert [(r.method, r.n_steps) for r in found.rows] == [
        (method, n) for method in ("magnus4", "rk4") for n in (20, 40, 80)
    ]
    assert found.rows[1].order == pytest.approx(4, abs=0.3)


def test_the_files_hold_the_rows(free, tmp_path):
    free.to_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(r["error_max"]) for r in rows] == [r.error_max for r in free.rows]
    free.plot(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 10_000
    assert "µs/body" in free.table()


def test_what_is_printed_is_a_summary(free):
    text = str(free)
    assert f"{len(free.rows)} rows (table() has all); the fastest at 1e-03, " in text
    assert len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines()[3:])) <= 100
    assert "exact" in text


# references


def problem(scene, w0):
    return Problem(Ensemble(scene, Q0 / np.linalg.norm(Q0, axis=1, keepdims=True), w0), T_END)


@pytest.mark.parametrize(
    ("scene", "w0", "method"),
    [(CONING, None, "magnus6"), (FREE, W0, "rk4"), (GRADIENT, W0, "rk8")],
    ids=["coning", "free", "gradient"],
)
def test_the_reference_is_as_good_as_it_says(scene, w0, method):
    """Another method comes as near as both may be off, and the tight run meets the closed form."""
    known = reference(problem(scene, w0))
    study = Study.of("", "", problem(scene, w0))
    assert known.error.max() < 1e-12
    assert study.apart.max() < known.error.max() + 1e-12
    tight = reference(problem(scene, w0), method=method)
    apart = fa.angle_between(tight.end.q, known.end.q)
    assert apart.max() < 1.5 * (tight.error.max() + known.error.max())


def test_the_reference_stops_at_its_goal():
    loose = reference(problem(GRADIENT, W0), goal=1e-5, method="rk4")
    known = reference(problem(GRADIENT, W0))
    true = fa.angle_between(loose.end.q, known.end.q)
    assert true.max() > 1e-10
    assert (true <= loose.error).all()
    assert loose.error.max() <= 1e-5


def pushed(n):
    """A history of torques with n intervals over the time."""
    torque = np.random.default_rng(5).normal(scale=0.3, size=(n + 1, 3))
    table = fa.TimeSeries(np.linspace(0.0, T_END, n + 1), torque, kind="linear")
    return fa.Scene(inertia=(2.0, 1.0, 1.5), torque=fa.torques.Constant(table))


@pytest.mark.parametrize(
    ("scene", "n"),
    [(CONING, 7), (GRADIENT, 7), (GRADIENT, 2500), (pushed(50), 7), (pushed(50), 224)],
)
def test_a_reference_knows_the_times_of_a_runs_steps(scene, n):
    """After each step or, of more than are compared, after the first and even ones."""
    whole = problem(scene, None if scene is CONING else W0)
    known = reference(whole)
    seen = see(whole, Case("rk4"), n, 1024)
    count = n if n <= 1024 else 1024 + -(-n // 3)
    assert len(seen.times) == len(seen.q) == count
    assert seen.times[-1] == pytest.approx(T_END, rel=1e-15)
    finer = Case("magnus6" if scene is CONING else "rk8")
    fine = see(whole, finer, n, 1024, -(-4000 // (50 * n)) * 50)
    assert fa.angle_between(fine.q, known.at(seen.times)).max() < 1e-12
    assert fa.angle_between(known.at(seen.times)[-1], known.end.q).max() < 1e-12


def test_cases_are_those_that_exist():
    found = cases_of(CONING, ["magnus4", "rk4"], ["quat", "euler313"], ["float64", "float32"])
    assert found == [
        *[Case("magnus4", dtype=d) for d in ("float64", "float32")],
        *[Case("rk4", rep, d) for rep in ("quat", "euler313") for d in ("float64", "float32")],
    ]
    every = {c.method for c in cases_of(GRADIENT, None, ["quat"], ["float64"])}
    assert every == set(methods_for(GRADIENT))


# samples


def test_the_extremes_are_in_the_sample():
    w0 = np.random.default_rng(1).normal(size=(1000, 3))
    speeds = np.linalg.norm(w0, axis=1)
    whole = Problem(Ensemble(FREE, np.tile([1.0, 0.0, 0.0, 0.0], (1000, 1)), w0), 1.0)
    rows = spread(whole, 64, np.random.default_rng(2))
    assert rows.size == np.unique(rows).size == 64
    assert set(np.argsort(-speeds)[:32]) <= set(rows)
    assert spread(whole, 1000, np.random.default_rng(2)).size == 1000


def test_methods_of_ones_own_stand_beside_names():
    options = {"methods": ["rk4", RALSTON3], "dtypes": ["float64"], "repeats": 1}
    found = fa.work_precision(CONING, Q0, t_end=T_END, n_steps=[40, 80, 160, 320], **options)
    assert {row.method for row in found.rows} == {"rk4", "ralston3"}
    orders = [r.order for r in found.rows if r.method == "ralston3" and r.error_max < 1e-2]
    assert np.median([x for x in orders if x is not None]) == pytest.approx(3, abs=0.2)


def test_status_is_counted():
    fast = Problem(Ensemble(FREE, Q0, 20.0 * W0), T_END)
    row = measure(fast, reference(fast).end, Case("rk4"), 20)
    assert "STEP_TOO_LARGE" in row.status
