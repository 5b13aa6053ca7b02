"""Work and precision on a user's scene: its rows, its reference, its files."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.inspect_step import inspect_step
from fastatt.trade.ladder import see
from fastatt.trade.measure import Case, Problem, measure
from fastatt.trade.reference import confirm, reference
from fastatt.trade.work_precision import cases_of, spread

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
        assert row.error_median <= row.error_p95 <= row.error_max
    if method == "magnus6":
        assert named[-1] == "round-off"
        assert rows[-1].error_max < 1e-13


def test_errors_are_those_of_the_library(coning):
    row = next(r for r in coning.rows if r.method == "rk4" and r.error_max < 1e-6)
    n = round(T_END / row.dt)
    end = fa.propagate(CONING, Q0, dt=row.dt, n_steps=n, method="rk4").q[-1]
    finer = fa.propagate(CONING, Q0, dt=row.dt / 64, n_steps=64 * n, method="rk4").q[-1]
    assert row.error_max == pytest.approx(fa.angle_between(end, finer).max(), rel=1e-4)


def test_frontier_is_monotone(coning):
    best = coning.frontier
    times, errors = [r.seconds_per_body for r in best], [r.error_max for r in best]
    assert times == sorted(times)
    assert errors == sorted(errors, reverse=True)


def test_free_bodies_keep_what_they_keep(free):
    (exact,) = [r for r in free.rows if r.method == "exact"]
    assert 0.0 < exact.error_max < 1e-12
    for row in free.rows:
        assert row.rate_error_median is not None
        assert row.rate_error_median <= row.rate_error_max
        assert None not in (row.energy_drift_max, row.momentum_drift_max)
    assert (free.sampled, free.n_bodies) == (32, N)
    assert free.reference == "the closed form"


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
    check = confirm(problem(scene, w0), known)
    assert known.error.max() < 1e-12
    assert check.apart.max() < known.error.max() + 1e-12
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


@pytest.mark.parametrize("frame", ["body", "inertial"])
def test_the_reference_of_a_constant_rate_is_one_exponential(frame):
    """At three times, in either frame."""
    w = RNG.normal(size=(N, 3))
    scene = fa.Scene(rate=fa.rates.Constant(w), frame=frame)
    known = reference(problem(scene, None))
    q = fa.quat_to_dcm(known.at(T_END * np.arange(1, 4) / 3))
    start = fa.quat_to_dcm(Q0 / np.linalg.norm(Q0, axis=1, keepdims=True))
    for k in range(3):
        angle = np.linalg.norm(w, axis=1) * T_END * (k + 1) / 3
        back = np.swapaxes(start, 1, 2)
        turn = back @ q[k] if frame == "body" else q[k] @ back
        assert np.trace(turn, axis1=1, axis2=2) == pytest.approx(1 + 2 * np.cos(angle), abs=1e-12)
        axis = np.einsum("nij,nj->ni", turn, w)
        assert axis == pytest.approx(w, abs=1e-12)


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
    assert {int(speeds.argmax()), int(speeds.argmin())} <= set(rows.tolist())
    assert spread(whole, 1000, np.random.default_rng(2)).size == 1000


BODY = {"inertia": (2.0, 1.0, 1.5)}
TORQUES = fa.torques.Damping(RNG.uniform(0, 1, (N, 1))), fa.torques.Constant((0.1, 0.2, 0.3))
HISTORY = fa.TimeSeries(0.1 * np.arange(N), np.ones((N, 3)), kind="linear")
WAVE = fa.rates.Sinusoidal(RNG.normal(size=(N, 3)), (1.0, 1.0, 1.0), (1.0, 2.0, 3.0))
MODELS = [
    GRADIENT,
    fa.Scene(inertia=np.eye(3) * RNG.uniform(1, 2, (N, 1, 1))),
    fa.Scene(inertia=np.diag([2.0, 1.5, 1.0])),
    fa.Scene(**BODY, torque=fa.torques.Sum(TORQUES)),
    fa.Scene(**BODY, torque=fa.torques.Constant(HISTORY)),
    fa.Scene(rate=fa.rates.Polynomial(RNG.normal(size=(N, 4, 3)))),
    fa.Scene(rate=fa.rates.Polynomial(RNG.normal(size=(4, 3)))),
    fa.Scene(rate=WAVE, frame="inertial"),
    fa.Scene(
        inertia=RNG.uniform(1, 1.2, (N, 3)),
        mass=RNG.uniform(1, 2, N),
        force=RNG.normal(size=(N, 3)),
    ),
]


@each("scene", MODELS)
def test_chosen_bodies_keep_their_own_numbers(scene):
    """The parameters that the engine gets are the rows of those of all."""
    w0 = None if scene.kind == "rate" else W0
    rows = np.array([5, 0, 41])
    few = Ensemble(scene, Q0, w0).take(rows)
    whole, packed = scene.packed(N), few.scene.packed(3)
    expected = whole.params[rows] if whole.params.ndim == 2 else whole.params
    assert packed.structure == whole.structure
    assert np.array_equal(packed.params, expected)
    assert np.array_equal(few.q0, Q0[rows])


def ralston():
    return fa.runge_kutta(
        "ralston3", order=3, c=(0, 1 / 2, 3 / 4), a=((1 / 2,), (0, 3 / 4)), b=(2 / 9, 1 / 3, 4 / 9)
    )


def middle(w, t, h):
    u = w(t + 0.5 * h)
    return ((h * u[0], h * u[1], h * u[2]),)


def test_methods_of_ones_own_stand_beside_names():
    mine = fa.lie_group(
        "mine", order=2, exponents=middle, limit=fa.METHODS["lie_midpoint"].limit("quat")
    )
    found = fa.work_precision(
        CONING, Q0, t_end=T_END, methods=["lie_midpoint", mine, ralston()], dtypes=["float64"],
        repeats=1, max_seconds=3.0, rng=np.random.default_rng(1),
    )  # fmt: skip
    rows = {name: [r for r in found.rows if r.method == name] for name in ("mine", "ralston3")}
    same = [r for r in found.rows if r.method == "lie_midpoint"]
    for own, other in zip(rows["mine"], same, strict=False):
        assert own.error_max == pytest.approx(other.error_max, rel=1e-6, abs=1e-13)
    for name, order in (("mine", 2), ("ralston3", 3)):
        measured = [r.order for r in rows[name] if r.order is not None and r.error_max < 1e-2]
        assert np.median(measured) == pytest.approx(order, abs=0.2)
    assert "ralston3" in found.table()


def test_what_stands_twice_or_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="methods: found 'rk4' twice; accepted: different names"):
        cases_of(CONING, ["rk4", "rk4"], ["quat"], ["float64"])
    with pytest.raises(ValueError, match=r"methods, .*: found \[\], .* of which nothing fits"):
        cases_of(CONING, [], ["quat"], ["float64"])
    mine = fa.lie_group("mine", order=2, exponents=middle)
    with pytest.raises(ValueError, match=r"methods: found mine, for rate; accepted .* \(free\): "):
        cases_of(FREE, [mine], ["quat"], ["float64"])
    assert cases_of(FREE, [fa.METHODS["rk4"]], ["quat"], ["float64"]) == [Case("rk4")]


def test_operations(coning):
    for row in coning.rows:
        text = inspect_step(CONING, row.method).splitlines()[0]
        assert f": {row.operations} floating-point operations a step" in text
    assert "ops/step" in coning.table()


def test_status_is_counted():
    fast = Problem(Ensemble(FREE, Q0, 20.0 * W0), T_END)
    row = measure(fast, reference(fast).end, Case("rk4"), 20, repeats=1)
    assert "STEP_TOO_LARGE" in row.status


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"t_end": 0.0}, "t_end: found 0.0"),
        ({"methods": ["exact"]}, "methods: found 'exact'; accepted: lie_euler"),
        ({"representations": ["gibbs"]}, "representations: found 'gibbs'"),
        ({"dtypes": ["float16"]}, "dtypes: found 'float16'"),
        ({"methods": ["magnus4"], "representations": ["euler313"]}, "of which nothing fits"),
        ({"sample": 0}, "sample: found 0"),
    ],
)
def test_bad_input(change, message):
    with pytest.raises(ValueError, match=message):
        fa.work_precision(CONING, Q0, **{"t_end": T_END, **change})
