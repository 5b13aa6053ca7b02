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
from fastatt.trade import ensembles, motions, recordings, run
from fastatt.trade.ensembles import BODY_SCENES, coning_rates
from fastatt.trade.measure import (
    Case,
    Problem,
    Rung,
    State,
    frontier,
    ladder_rows,
    measure,
    trade_table,
)
from fastatt.trade.reference import coning_attitudes

# few, as compiling is what takes the time: a step that turns, one that does not, one for samples
CONING = {
    "rate function": [Case("lie_midpoint"), Case("rk4")],
    "samples": [Case("previous")],
}
# of two families, one of them the reference's
BODIES = {"free": ("dmv10", "exact"), "top": ("rk8", "suzuki4"), "torqued": ("rk8", "rkmk4")}


@pytest.fixture(scope="module")
def by_input():
    return ensembles.study("coning", 32).rows(CONING, (120, 240), repeats=1)


@pytest.fixture(scope="module")
def coning(by_input):
    return [row for rows in by_input.values() for row in rows]


@pytest.fixture(scope="module", params=BODIES)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def bodies(name):
    return ensembles.study(name, 6)


@pytest.fixture(scope="module")
def body_rows(name, bodies):
    cases = {name: [Case(method) for method in BODIES[name]]}
    return bodies.rows(cases, (50, 100), repeats=1)[name]


def test_all_of_coning_is_planned():
    cases = ensembles.cases("coning")
    found = [(c.method, c.representation) for c in cases["rate function"] if c.dtype == "float64"]
    scene = fa.Scene(rate=fa.rates.Coning(1.0, 1.0))
    fitting = [(m, r) for m in fa.methods_for(scene) for r in fa.METHODS[m].representations]
    assert found == fitting
    single = [c.method for c in cases["rate function"] if c.dtype == "float32"]
    assert single == fa.methods_for(scene)
    assert [c.method for c in cases["samples"]] == methods_for_samples()


@pytest.mark.parametrize("scene", BODY_SCENES)
def test_every_method_of_a_body_scene_is_planned(scene):
    cases = ensembles.cases(scene)[scene]
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
    assert [r.method for r in coning[::2]] == [c.method for own in CONING.values() for c in own]
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
    assert "6 bodies over 10 s" in text
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
    rung = measure(still, end, Case("dmv10"), 2, repeats=1)
    assert rung.error == pytest.approx([0.1])
    assert rung.rate_error == pytest.approx([5.0])
    assert (rung.norm_error, rung.energy, rung.momentum, rung.status) == (0.0, 0.0, 0.0, "")


def rungs(*errors):
    return [Rung(10 * 2**i, 1.0, np.array([e])) for i, e in enumerate(errors)]


def test_orders_stop_at_round_off():
    rows = ladder_rows("", Case("rk4"), 1.0, rungs(1.6e-3, 1e-4, 1e-15, 2e-15, np.nan))
    assert [r.order for r in rows[2:4]] == [None, None]
    assert [r.plateau for r in rows[:4]] == ["", "", "round-off", "round-off"]
    assert rows[1].order == pytest.approx(4.0)
    single = ladder_rows("", Case("rk4", dtype="float32"), 1.0, rungs(1.6e-5, 1.2e-5, 2e-5))
    assert [r.plateau for r in single] == ["round-off"] * 3
    assert frontier(rows[4:]) == []


def test_a_low_order_is_no_plateau():
    """Of a broken method the error falls too slowly, far above what rounding makes."""
    rows = ladder_rows("", Case("rk4"), 1.0, rungs(1e-3, 5e-4, 2.5e-4))
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


def test_polhodes_keep_energy_and_length():
    inertia = BODY_SCENES["free"].inertia
    found = motions.polhodes()
    energies = [p.energy for p in found]
    assert energies == sorted(energies)
    for polhode in found:
        curves = np.concatenate(polhode.curves)
        assert np.abs(np.linalg.norm(curves, axis=1) - 1.0).max() < 1e-13
        energy = fa.kinetic_energy(curves / inertia, inertia)
        assert np.abs(energy - polhode.energy).max() < 1e-13
    # the separatrix has the energy of turning about the intermediate axis, and comes near it
    (separatrix,) = [p for p in found if p.separatrix]
    assert separatrix.energy == pytest.approx(0.5 / inertia[1])
    assert abs(separatrix.curves[0][-1, 1]) > 0.999


def test_herpolhodes_keep_the_part_along_the_momentum():
    """|w|² less the part along the momentum, 2E/|m|, is the distance in the plane."""
    inertia = np.array(BODY_SCENES["free"].inertia)
    for energy, curve in motions.herpolhodes().items():
        distance = np.linalg.norm(curve[0])
        m = next(p.curves[0] for p in motions.polhodes() if p.energy == energy)[1000]
        across = np.sqrt(np.sum((m / inertia) ** 2) - (2.0 * energy) ** 2)
        assert distance == pytest.approx(across, rel=1e-12)


def test_nutation_of_tops():
    """Released at rest an axis comes back to its first height only; pushed back it goes higher."""
    loops, cusps, waves = motions.nutations().values()
    for axis in (loops, cusps, waves):
        assert np.abs(np.linalg.norm(axis, axis=1) - 1.0).max() < 1e-13
    assert cusps[:, 2].max() == pytest.approx(cusps[0, 2], abs=1e-9)
    turns = [np.diff(np.unwrap(np.arctan2(a[:, 1], a[:, 0]))) for a in (loops, cusps, waves)]
    assert turns[0].min() < -1e-3
    assert -1e-6 < turns[1].min() < 1e-5
    assert turns[2].min() > 1e-3


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_run_leaves_its_files(tmp_path, capsys, by_input, coning, monkeypatch):
    monkeypatch.setattr(ensembles.Study, "rows", lambda *a, **k: by_input)
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
    assert "\ndata_xsens.txt: dt: interval 577 of log 0 turns by 0.101 rad, hold's limit" in text


@pytest.mark.parametrize(
    ("scene", "pictures"), [("free", ["polhodes.png"]), ("top", ["tops.png"]), ("torqued", [])]
)
def test_command_runs_body_scenes(tmp_path, capsys, scene, pictures):
    methods = BODIES[scene]
    arguments = ["--scene", scene, "--quick", "--bodies", "6", "--methods", ",".join(methods)]
    assert main(["trade", "--out", str(tmp_path), *arguments]) == 0
    assert {p.name for p in tmp_path.iterdir()} == {"bodies.csv", "bodies.png", *pictures}
    found = table(tmp_path / "bodies.csv")
    assert {(r["input"], r["method"]) for r in found} == {(scene, m) for m in methods}
    assert {(r["representation"], r["dtype"]) for r in found} == {("quat", "float64")}
    for name in pictures:
        assert (tmp_path / name).stat().st_size > 10_000
    text = capsys.readouterr().out
    assert "reference: " in text
    assert "Frontier, " in text


def test_missing_recordings(monkeypatch):
    monkeypatch.setattr(recordings.metadata, "files", lambda name: [])
    with pytest.raises(ImportError, match=r"fastatt\[trade\]"):
        recordings.find_recordings()
