"""The trade study: its numbers are those of the library, its files are there."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from each import in_tiers
from scipy import interpolate

import fastatt as fa
from fastatt.cli import main
from fastatt.gyro.integrate import methods_for_samples
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade import ensembles, long_run, summary
from fastatt.trade.ensembles import BODY_SCENES, SCENES, coning_attitudes, coning_rates
from fastatt.trade.long_run import Drifted
from fastatt.trade.measure import (
    Case,
    Problem,
    State,
    frontier,
    measure,
    row_of,
    table,
    with_orders,
)

# of two families, one of them the reference's
BODIES = {"free": ("dmv10", "exact"), "top": ("rk8", "kahan_li8"), "torqued": ("rk8", "rkmk4")}


@pytest.fixture(scope="module")
def samples():
    return ensembles.study("samples", 32).rows(Case("previous"), (120, 240))


@pytest.fixture(scope="module", params=in_tiers(["free", "torqued"], BODIES))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def bodies(name):
    return ensembles.study(name, 6)


@pytest.fixture(scope="module")
def body_rows(name, bodies):
    cases = [Case(method) for method in BODIES[name]]
    return [row for case in cases for row in bodies.rows(case, (50, 100))]


@pytest.mark.parametrize("scene", SCENES)
def test_every_method_is_planned_on_quaternions_and_matrices(scene):
    cases = ensembles.cases(scene)
    if scene == "samples":
        assert cases == [Case(method) for method in methods_for_samples()]
        return
    fitting = methods_for(ensembles.problem(scene, 2).ensemble.scene)
    assert [c.method for c in cases if c.representation == "quat"] == fitting
    assert [c for c in cases if c.representation == "dcm"] == [
        Case(m, "dcm") for m in fitting if "dcm" in fa.METHODS[m].representations
    ]


def test_methods_for_samples_are_measured_at_the_ends_of_steps(samples):
    coarse, fine = samples
    assert (coarse.method, coarse.order, coarse.rate_error_max) == ("previous", None, None)
    assert abs(fine.order - fa.METHODS["previous"].order) < 0.7
    assert fine.status == ""


def test_reference_is_confirmed(bodies):
    assert bodies.apart.shape == (6,)
    assert bodies.apart.max() < 2e-12
    assert bodies.known.error.max() < 1e-12
    text = str(bodies)
    assert text.startswith("6 ")
    assert " over 10 s; reference: " in text
    assert f"{bodies.apart.max():.1e} rad at most" in text


def test_rows_of_bodies(name, body_rows):
    stepped = [r for r in body_rows if r.method != "exact"]
    assert [r.method for r in stepped] == [m for m in BODIES[name] if m != "exact" for _ in "12"]
    keeps_momentum = keeps_energy = name != "torqued"
    for row in body_rows:
        assert row.input == name
        assert (row.momentum_drift_max is not None) == keeps_momentum
        assert (row.energy_drift_max is not None) == keeps_energy
        assert row.status == ""
    for coarse, fine in zip(stepped[::2], stepped[1::2], strict=True):
        assert (coarse.dt, fine.dt) == (0.2, 0.1)
        assert fine.error_median < coarse.error_median / 10.0
        assert fine.rate_error_max < coarse.rate_error_max / 5.0
        if fine.order is not None:
            assert abs(fine.order - fa.METHODS[fine.method].order) < 0.7, fine


def test_the_closed_form_is_measured_against_another(body_rows):
    rows = [r for r in body_rows if r.method == "exact"]
    for row in rows:
        assert row.dt == 10.0
        assert 0.0 < row.error_max < 1e-13
        assert row.momentum_drift_max < 1e-13
    assert len(rows) == (body_rows[0].input == "free")


def test_measured_errors_are_those_of_the_library():
    """A problem whose answer is off by a known angle and rate is measured so."""
    start = np.array([[1.0, 0.0, 0.0, 0.0]])
    off = np.array([[np.cos(0.05), np.sin(0.05), 0.0, 0.0]])
    still = Problem(Ensemble(BODY_SCENES["free"], start, np.zeros((1, 3))), 1.0)
    end = State(off, np.array([[0.0, 3.0, 4.0]]))
    row = measure(still, end, Case("dmv10"), 2)
    assert row.error_max == pytest.approx(0.1)
    assert row.rate_error_max == pytest.approx(5.0)
    assert (row.norm_error_max, row.energy_drift_max, row.momentum_drift_max) == (0.0, 0.0, 0.0)
    assert row.status == ""


def ladder(case, *errors, refined=2, own=0.0):
    steps = [10 * refined**i for i in range(len(errors))]
    rows = [
        row_of("", case, 1.0, n, 1.0, np.array([e])) for n, e in zip(steps, errors, strict=True)
    ]
    return with_orders(rows, case, 4, own)


def test_orders_stop_at_round_off():
    rows = ladder(Case("rk4"), 1.6e-3, 1e-4, 1e-15, 2e-15, np.nan)
    assert [r.order for r in rows[2:4]] == [None, None]
    assert [r.plateau for r in rows[:4]] == ["", "", "round-off", "round-off"]
    assert rows[1].order == pytest.approx(4.0)
    single = ladder(Case("rk4", dtype="float32"), 1.6e-5, 1.2e-5, 2e-5)
    assert [r.plateau for r in single] == ["round-off"] * 3
    assert frontier(rows[4:]) == []


def test_a_plateau_of_the_reference_is_named():
    """It is good to 1e-11 rad: at smaller differences it says nothing of the method."""
    rows = ladder(Case("rk4"), 1.6e-3, 1e-4, 6e-6, 3e-11, 1e-12, refined=4, own=1e-11)
    assert [r.plateau for r in rows] == ["", "", "", "", "reference"]
    assert rows[-1].order is None


def test_a_low_order_is_no_plateau():
    """Of a broken method the error falls too slowly, far above what rounding makes."""
    rows = ladder(Case("rk4"), 1e-3, 5e-4, 2.5e-4)
    assert [r.plateau for r in rows] == ["", "", ""]
    assert rows[2].order == pytest.approx(1.0)


def point(method, seconds, error, **options):
    row = row_of("free", Case(method), 1.0, 10, seconds, np.array([error]), norm_error_max=1e-15)
    return replace(row, **options)


def test_rounding_and_flags_rank_nothing():
    rows = [
        point("rk4", 1.0, 2.15e-13, plateau="round-off"),
        point("rk8", 2.0, 2.11e-13, plateau="round-off"),
        point("rk9", 3.0, 2.0e-14, plateau="round-off"),
        point("gbs16", 0.5, 1e-15, status="NORM_LOST 1"),
        point("cf4", 4.0, 1.9e-14),
    ]
    assert [r.method for r in frontier(rows)] == ["rk4", "rk9"]
    plain = [point("rk4", 1.0, 2.15e-9), point("rk8", 2.0, 2.11e-9)]
    assert frontier(plain) == plain


def test_steppers_are_ranked_without_the_closed_form():
    rows = [
        point("exact", 0.1, 1e-14), point("rk4", 2.0, 5e-4), point("rk8", 1.0, 2e-4),
        point("rk8", 3.0, 1e-7), point("rk9", 0.2, 1e-5, status="STEP_TOO_LARGE 1"),
    ]  # fmt: skip
    assert summary.fastest(rows, 1e-3) is rows[2]
    assert summary.fastest(rows, 1e-6) is rows[3]
    assert summary.fastest(rows, 1e-9) is None
    assert summary.closed_form(rows) is rows[0]


def test_ladders_begin_where_a_method_allows_it_on_one_grid():
    problem = ensembles.problem("free", 4)
    one, other = (ensembles.steps(problem, Case(m), 2) for m in ("kahan_li8", "gbs16"))
    assert one[0] > other[0]
    assert set(one) < set(other)
    assert {50, 400} < set(one)  # steps of 0.2 and 0.025 s, for the tables
    limit = 0.9 * fa.METHODS["kahan_li8"].limit("quat")
    assert np.linalg.norm(problem.ensemble.w0, axis=1).max() * 10.0 / one[0] <= limit


@pytest.mark.parametrize(
    ("power", "law"), [(0.0, "bounded"), (0.5, "random walk"), (1.0, "linear"), (2.0, "faster")]
)
def test_growth_is_named(power, law):
    steps = np.unique(np.geomspace(128, 2**17, 41).astype(int))
    assert long_run.growth(steps, 1e-15 * steps**power) == law
    assert long_run.growth(steps, 0.0 * steps) == "bounded"


def test_drifts_of_long_runs_are_those_of_the_library():
    problem = ensembles.problem("free", 4)
    points = long_run.long_run("free", problem, Case("rk4", "dcm"), 4096)
    found = {x.quantity: x for x in long_run.ends(points)}
    assert list(found) == ["norm", "energy", "momentum"]
    e, dt = problem.ensemble, found["energy"].dt
    assert np.linalg.norm(e.w0, axis=1).max() * dt == pytest.approx(long_run.ANGLE)
    n = found["energy"].n_steps
    traj = fa.propagate(
        e.scene, e.q0, e.w0, dt=dt, n_steps=n, save_every=n, method="rk4", representation="dcm"
    )
    drift = fa.drift(traj, e.scene)
    for name, values in (("norm", drift.orthogonality), ("energy", drift.energy)):
        assert found[name].drift == pytest.approx(np.sqrt(np.mean(values[-1] ** 2)), rel=1e-6)
        assert found[name].growth == "linear"


def test_the_screen_is_one_screen():
    """With every scene, error and method: 40 lines of 100 columns, with the run's own two."""
    rows = [
        replace(point(m, 1e-6 * (k + 2), 1e-13), input=scene, representation=r, dtype="float64")
        for scene in SCENES
        for r in ("quat", "dcm")
        for k, m in enumerate(["exact", "lie_midpoint", "kahan_li8"])
    ]
    long = [
        Drifted(scene, method, "quat", quantity, 0.1, 2**18, 1e-12, "random walk", "")
        for scene in SCENES
        for quantity in ("norm", "energy", "momentum")
        for method in fa.METHODS
        if scene in ("free", "top", "coning") and len(method) < 11
    ]
    lines = summary.screen(rows, long).splitlines()
    assert max(map(len, lines)) <= 100
    table = [line for line in lines if " lie_midpoint " in line]
    assert len(table) == 4 * len(SCENES)


def test_table_leaves_out_what_no_row_has(samples, body_rows):
    head = table(samples).splitlines()[0]
    assert "order" in head
    for absent in ("energy", "momentum", "w, rad/s", "status"):
        assert absent not in head
    head, first, *_ = table(body_rows).splitlines()
    assert "w, rad/s" in head
    assert ("energy" in head) == (body_rows[0].energy_drift_max is not None)
    assert f"{body_rows[0].error_median:.2e}" in first


def test_exact_attitudes_obey_the_rates():
    """The closed form, differentiated, gives the rates that the scene is made of."""
    angle, frequency, t = np.array([0.3, 1.2]), np.array([0.7, 1.9]), np.linspace(0.0, 1.0, 401)
    q = coning_attitudes(angle, frequency, t)
    slope = interpolate.make_interp_spline(t, q, k=9).derivative()(t)
    w = 2.0 * fa.quat_multiply(q * [1.0, -1.0, -1.0, -1.0], slope)[..., 1:]
    assert np.abs(w - coning_rates(angle, frequency, t).swapaxes(0, 1)).max() < 1e-11


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


FILES = {"summary.md", "trade.csv", "drift.csv"}
METHODS = BODIES | {"coning": ("lie_midpoint", "magnus4"), "samples": ("previous",)}
COMMANDS = [("free",), ("coning", "samples"), ("top",), ("torqued",)]


@pytest.mark.parametrize("scenes", in_tiers([(("free",),)], [(x,) for x in COMMANDS]))
def test_command(tmp_path, capsys, scenes):
    verbose = scenes in (("top",), ("torqued",))
    methods = {(scene, method) for scene in scenes for method in METHODS[scene]}
    arguments = [f"--scene={scene}" for scene in scenes] + ["--verbose"] * verbose
    arguments += ["--quick", "--bodies=6", f"--methods={','.join(m for _, m in methods)}"]
    assert main(["trade", "--out", str(tmp_path), *arguments]) == 0
    stepped = set(scenes) - {"samples"}
    pictures = {f"error-{x}.png" for x in scenes} | {f"drift-{x}.png" for x in stepped}
    assert {p.name for p in tmp_path.iterdir()} == FILES | pictures
    assert all((tmp_path / name).stat().st_size > 10_000 for name in pictures)
    found = read(tmp_path / "trade.csv")
    assert {(r["input"], r["method"]) for r in found} == methods
    kinds = {(r["representation"], r["dtype"]) for r in found if r["input"] in stepped}
    assert kinds == {("quat", "float64"), ("dcm", "float64")}
    kept = {"norm", "energy", "momentum"} if stepped & {"free", "top"} else {"norm"}
    assert {r["quantity"] for r in read(tmp_path / "drift.csv")} == kept
    page = (tmp_path / "summary.md").read_text(encoding="utf-8")
    for part in (summary.COLUMNS, "The fastest way to each error", *(f"## {x}" for x in scenes)):
        assert part in page
    text = capsys.readouterr().out
    assert ("reference: " in text) == verbose
    if not verbose:
        assert len(text.splitlines()) <= 40
        assert max(map(len, text.replace(str(tmp_path), "").splitlines())) <= 100
        assert f"{tmp_path}: summary.md (how to read this)" in text


def test_the_page_says_how_to_read_the_results():
    page = Path(fa.__file__).parent / "docs" / "explanations" / "trade.md"
    assert summary.COLUMNS in page.read_text(encoding="utf-8")
