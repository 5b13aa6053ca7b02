"""The trade study: its numbers are those of the library, its files are there."""

from __future__ import annotations

import csv
import warnings
from dataclasses import replace

import numpy as np
import pytest

import fastatt as fa
from fastatt.cli import main
from fastatt.gyro.integrate import methods_for_samples
from fastatt.propagation.ensemble import Ensemble
from fastatt.rounding import StepWarning
from fastatt.trade import ensembles, recordings, run
from fastatt.trade.ensembles import BODY_SCENES, coning_rates
from fastatt.trade.measure import (
    Case,
    Problem,
    State,
    frontier,
    measure,
    row_of,
    trade_table,
    with_orders,
)
from fastatt.trade.reference import coning_attitudes

# few, as compiling is what takes the time: a step that turns, one that does not, one for samples
CONING = [Case("lie_midpoint"), Case("rk4"), Case("previous")]
# of two families, one of them the reference's
BODIES = {"free": ("dmv10", "exact"), "top": ("rk8", "suzuki4"), "torqued": ("rk8", "rkmk4")}


@pytest.fixture(scope="module")
def coning():
    return ensembles.study("coning", 32).rows(CONING, (120, 240), repeats=1)


@pytest.fixture(scope="module", params=BODIES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def bodies(name):
    return ensembles.study(name, 6)


@pytest.fixture(scope="module")
def body_rows(name, bodies):
    return bodies.rows([Case(method) for method in BODIES[name]], (50, 100), repeats=1)


def test_all_of_coning_is_planned():
    sampled = [Case(method) for method in methods_for_samples()]
    cases = ensembles.cases("coning")
    given, last = cases[: -len(sampled)], cases[-len(sampled) :]
    assert last == sampled
    found = [(c.method, c.representation) for c in given if c.dtype == "float64"]
    scene = fa.Scene(rate=fa.rates.Coning(1.0, 1.0))
    fitting = [(m, r) for m in fa.methods_for(scene) for r in fa.METHODS[m].representations]
    assert found == fitting
    assert [c.method for c in given if c.dtype == "float32"] == fa.methods_for(scene)


@pytest.mark.parametrize("scene", BODY_SCENES)
def test_every_method_of_a_body_scene_is_planned(scene):
    cases = ensembles.cases(scene)
    plain = [c.method for c in cases if c == Case(c.method)]
    assert plain == fa.methods_for(BODY_SCENES[scene])
    for case in cases:
        assert case.representation in fa.METHODS[case.method].representations
    assert {(c.representation, c.dtype) for c in cases} == {
        ("quat", "float64"),
        ("dcm", "float64"),
        ("quat", "float32"),
    }


def test_only_general_methods_take_the_torqued_scene():
    assert {fa.METHODS[m].takes for m in fa.methods_for(BODY_SCENES["torqued"])} == {
        fa.torques.Dependence.RATE
    }


def test_rows_of_coning(coning):
    assert [r.method for r in coning[::2]] == [c.method for c in CONING]
    assert [r.input for r in coning[::2]] == ["rate function", "rate function", "samples"]
    for row in coning:
        assert row.rate_error_median is None
        assert row.energy_drift_max is None
        assert row.status == ""
        assert row.steps_per_second == pytest.approx(20.0 / row.dt / row.seconds_per_body)


def test_orders_of_coning_are_near_the_declared_ones(coning):
    """Coarsely: each step's median is another body's error. Exact orders: test_methods.py."""
    measured = [r for r in coning if r.order is not None]
    assert {r.method for r in measured} == {"lie_midpoint", "rk4", "previous"}
    for row in measured:
        assert abs(row.order - fa.METHODS[row.method].order) < 0.7, row


def test_reference_is_confirmed(bodies):
    assert bodies.check.apart.shape == (6,)
    assert bodies.check.apart.max() < 2e-12
    assert bodies.known.own_error.max() < 1e-12
    text = bodies.heading
    assert text.startswith("6 ")
    assert " over 10 s; reference: " in text
    assert f"{bodies.check.apart.max():.1e} rad (worst)" in text


def test_reference_solves_the_scene(name, bodies):
    """The reference's end, run backwards, is the start."""
    e, end, t = bodies.problem.ensemble, bodies.known.end, bodies.problem.t_end
    back = fa.propagate(e.scene, *end, dt=-0.05, n_steps=200, method=BODIES[name][0], t0=t)
    assert fa.angle_between(back.q[-1], e.q0).max() < 1e-10
    assert np.abs(back.w[-1] - e.w0).max() < 1e-10


def test_rows_of_bodies(name, body_rows):
    stepped = [r for r in body_rows if r.method != "exact"]
    assert [r.method for r in stepped] == [m for m in BODIES[name] if m != "exact" for _ in "12"]
    keeps_momentum, keeps_energy = name == "free", name != "torqued"
    for row in body_rows:
        assert row.input == name
        assert (row.momentum_drift_max is not None) == keeps_momentum
        assert (row.energy_drift_max is not None) == keeps_energy
        assert row.status == ""
    for coarse, fine in zip(stepped[::2], stepped[1::2], strict=True):
        assert (coarse.dt, fine.dt) == (0.2, 0.1)
        assert fine.error_median < coarse.error_median / 10.0
        assert fine.rate_error_median < coarse.rate_error_median / 10.0
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
    row = measure(still, end, Case("dmv10"), 2, repeats=1)
    assert row.error_max == pytest.approx(0.1)
    assert row.rate_error_max == pytest.approx(5.0)
    assert (row.norm_error_max, row.energy_drift_max, row.momentum_drift_max) == (0.0, 0.0, 0.0)
    assert row.status == ""


def ladder(case, *errors):
    rows = [row_of("", case, 1.0, 10 * 2**i, 1.0, np.array([e])) for i, e in enumerate(errors)]
    return with_orders(rows, case, 4)


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
    errors = 1.6e-3, 1e-4, 6e-6, 3e-11, 1e-12
    rows = [
        row_of("", Case("rk4"), 1.0, 10 * 4**i, 1.0, np.array([e])) for i, e in enumerate(errors)
    ]
    rows = with_orders(rows, Case("rk4"), 4, 1e-11)
    assert [r.plateau for r in rows] == ["", "", "", "", "reference"]
    assert rows[-1].order is None


def test_a_low_order_is_no_plateau():
    """Of a broken method the error falls too slowly, far above what rounding makes."""
    rows = ladder(Case("rk4"), 1e-3, 5e-4, 2.5e-4)
    assert [r.plateau for r in rows] == ["", "", ""]
    assert rows[2].order == pytest.approx(1.0)


def test_frontier_falls(coning):
    best = frontier(coning)
    times = [r.seconds_per_body for r in best]
    errors = [r.error_median for r in best]
    assert times == sorted(times)
    assert errors == sorted(errors, reverse=True)
    beaten = [r for r in coning if r not in best]
    for r in beaten:
        assert any(
            b.seconds_per_body <= r.seconds_per_body and b.error_median <= r.error_median
            for b in best
        )


def test_table_leaves_out_what_no_row_has(coning, body_rows):
    head = trade_table(coning).splitlines()[0]
    assert "order" in head
    for absent in ("energy", "momentum", "w, rad/s", "status"):
        assert absent not in head
    head, first, *_ = trade_table(body_rows).splitlines()
    assert "w, rad/s" in head
    assert ("energy" in head) == (body_rows[0].energy_drift_max is not None)
    assert f"{body_rows[0].error_median:.2e}" in first


def test_exact_attitudes_obey_the_rates():
    """The closed form, differentiated, gives the rates that the scene is made of."""
    angle, frequency, t = np.array([0.3, 1.2]), np.array([0.7, 1.9]), np.linspace(0.0, 1.0, 401)
    q = coning_attitudes(angle, frequency, t)
    w = fa.angular_velocity(q, t[1], order=8)
    assert np.abs(w - coning_rates(angle, frequency, t).swapaxes(0, 1)).max() < 1e-11


def test_recordings_are_found_and_agree_with_their_maker():
    paths = recordings.find_recordings()
    assert len(paths) == len(recordings.RECORDINGS)
    log = fa.read_gyro_log(paths[0], unit="rad/s")
    assert (len(log.rates), log.rate) == (953, 50.0)
    names = ("hold", "previous", "coning3")
    rows = {r.method: r for r in recordings.log_rows(log, repeats=1, methods=names)}
    # the maker's filter corrects the gyro's bias by gravity and north: some degrees in 19 s
    assert 0.5 < rows["coning3"].maker_difference_max < 10.0
    assert rows["coning3"].difference_max == 0.0
    assert 0.0 < rows["previous"].difference_max < rows["hold"].difference_max


def test_a_log_is_compared_with_every_method(monkeypatch):
    log = fa.read_gyro_log(recordings.find_recordings()[0], unit="rad/s")
    monkeypatch.setattr(recordings, "integrate_rates", still)
    assert [r.method for r in recordings.log_rows(log, 1)] == methods_for_samples()
    monkeypatch.setattr(recordings, "error_budget", lambda *a, **k: k["rivals"])
    table = recordings.compare_on_log(log, "hold", methods=["trapezoid"])
    _head, *lines, budget = table.splitlines()
    compared = ["trapezoid", "hold", "previous", "coning2"]
    assert [line.split()[1] for line in lines] == compared
    assert budget == str(compared)
    short = replace(log, rates=log.rates[:20], t=log.t[:20], attitudes=None)
    assert "20 samples: too few to tell" in recordings.compare_on_log(short, "hold")


def still(rates, dt, q0, **options):
    return np.tile(q0, (len(rates), 1))


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_run_leaves_its_files(tmp_path, capsys, coning, monkeypatch):
    monkeypatch.setattr(ensembles.Study, "rows", lambda *a, **k: coning)
    logs, methods = recordings.find_recordings()[:1], ["lie_midpoint", "rk4", "hold", "coning3"]
    with warnings.catch_warnings():
        warnings.simplefilter("error", StepWarning)
        warnings.simplefilter("ignore", fa.GyroLogWarning)  # the recording names no unit
        run.run_trade(tmp_path, n_bodies=32, quick=True, logs=logs, methods=methods)
    names = {"recordings.csv", "recordings.png", "trade.csv", "trade.png"}
    assert {p.name for p in tmp_path.iterdir()} == names
    found = table(tmp_path / "trade.csv")
    assert len(found) == len(coning)
    assert float(found[0]["error_median"]) == coning[0].error_median
    assert {r["method"] for r in table(tmp_path / "recordings.csv")} == {"hold", "coning3"}
    for name in ("recordings.png", "trade.png"):
        assert (tmp_path / name).stat().st_size > 10_000
    text = capsys.readouterr().out
    assert "Frontier, rate as samples" in text
    # a line of the report, no warning of Python's
    assert "\ndata_xsens.txt: dt: interval 576 of log 0 rotates by 0.101 rad, hold's limit" in text


@pytest.mark.parametrize("scene", BODY_SCENES)
def test_command_runs_body_scenes(tmp_path, capsys, scene):
    methods = BODIES[scene]
    arguments = ["--scene", scene, "--quick", "--bodies", "6", "--methods", ",".join(methods)]
    assert main(["trade", "--out", str(tmp_path), *arguments]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"bodies.csv", "bodies.png"}
    found = table(tmp_path / "bodies.csv")
    assert {(r["input"], r["method"]) for r in found} == {(scene, m) for m in methods}
    assert {(r["representation"], r["dtype"]) for r in found} == {("quat", "float64")}
    assert (tmp_path / "bodies.png").stat().st_size > 10_000
    text = capsys.readouterr().out
    assert "reference: " in text
    assert "Frontier, " in text


def test_missing_recordings(monkeypatch):
    monkeypatch.setattr(recordings.metadata, "files", lambda name: [])
    with pytest.raises(ImportError, match=r"fastatt\[trade\]"):
        recordings.find_recordings()
