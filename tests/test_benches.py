"""The scripts in bench/ that figures rest on, run small."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import fastatt as fa
from fastatt.codegen import modules
from fastatt.codegen.processor import processor
from fastatt.propagation.choice_of_method import DEFAULTS
from fastatt.trade.ensembles import study
from fastatt.trade.measure import Case, write_csv

sys.path.append(str(Path(__file__).resolve().parents[1] / "bench"))

import advice
import choices
import choose
import consistency
import hostile
import long_runs
import method_table
import mutations
import peak
import per_body_steps
import polhodes
import recordings
import wheel_feedback

pytestmark = pytest.mark.slow


def test_the_method_table(tmp_path, capsys):
    """A line a method and input: errors, speed, operations, share of the peak."""
    steps = (50, 400)
    cases = [Case("rk4"), Case("exact"), Case("rk4", "dcm")]
    bodies = study("free", 8)
    rows = [row for case in cases for row in bodies.rows(case, steps, 1)]
    write_csv(tmp_path / "trade.csv", rows)
    method_table.main(tmp_path / "trade.csv")
    head, _, rk4, exact = capsys.readouterr().out.splitlines()
    assert "| operations a step | % of the peak |" in head
    assert len({line.count("|") for line in (head, rk4, exact)}) == 1
    by_step = {r.dt: r for r in rows if (r.method, r.representation) == ("rk4", "quat")}
    cells = [cell.strip() for cell in rk4.split("|")][1:]
    assert cells[:3] == ["`rk4`", "free bodies", "4"]
    assert cells[3:5] == [f"{by_step[dt].error_median:.1e}" for dt in (0.2, 0.025)]
    assert cells[6] == str(by_step[0.025].operations)
    assert [c.strip() for c in exact.split("|")][1:4] == ["`exact`", "free bodies", "exact"]


def test_the_method_table_of_given_rates(tmp_path, capsys):
    cones = study("coning", 8)
    rows = [
        row for name in ("magnus4", "previous") for row in cones.rows(Case(name), (100, 800), 1)
    ]
    write_csv(tmp_path / "trade.csv", rows)
    method_table.main(tmp_path / "trade.csv")
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split("|")[1].strip() for line in lines] == ["`magnus4`", "`previous`"]
    write_csv(tmp_path / "quick.csv", cones.rows(Case("previous"), (10, 20), 1))
    method_table.main(tmp_path / "quick.csv")
    *_, line = capsys.readouterr().out.splitlines()
    assert [cell.strip() for cell in line.split("|")][4:6] == ["", ""]


def test_advice_on_methods_is_what_the_tables_say():
    for page in choose.PAGES:
        text = page.read_text(encoding="utf-8")
        assert "<!-- python bench/choose.py: methods -->" in text
        assert choose.rewritten(text) == text
    guide = choose.PAGES[-1].read_text(encoding="utf-8")
    assert choose.of_drifts() in guide


def test_defaults_are_first_most_often():
    groups = "prescribed rate", "free body, heavy symmetric top", "any torque"
    found = [choose.default(group) for group in groups]
    assert tuple(found) == DEFAULTS[:3]
    for page in choose.PAGES:
        prose = " ".join(page.read_text(encoding="utf-8").split())
        assert f"first most often at 1e-3 and 1e-6 rad: `{found[0]}`" in prose


def test_the_drifts_that_are_kept_are_the_last(tmp_path, monkeypatch):
    monkeypatch.setattr(choose, "DRIFT", tmp_path / "kept.csv")
    head = "input,method,representation,quantity,n_steps,drift"
    lines = [head, "free,rk4,quat,energy,10,1e-9", "free,rk4,quat,energy,20,2e-9"]
    (tmp_path / "drift.csv").write_text("\n".join(lines), encoding="utf-8")
    choose.keep(tmp_path)
    assert choose.DRIFT.read_text(encoding="utf-8").split() == [lines[0], lines[2]]


def test_polhodes_are_of_one_momentum():
    """The third is the separatrix: the energy of rotating about the intermediate axis, nearly."""
    run, inertia = polhodes.motion(), np.array(polhodes.TRIAXIAL)
    m = inertia * run.w
    assert np.abs(np.linalg.norm(m, axis=-1) - 1.0).max() < 1e-13
    energy = fa.kinetic_energy(run.w, inertia)
    assert np.ptp(energy, axis=0).max() < 1e-13
    assert energy[0, 2] == pytest.approx(0.5 / inertia[1])
    assert np.abs(m[-1, 2, 1]) > 0.999


@pytest.mark.skipif(not processor().fuses, reason="a processor without fused operations")
@pytest.mark.parametrize("kind", ["double", "single"])
def test_the_peak_is_of_fused_operations_in_registers(kind, monkeypatch):
    """At least what a chain in each lane gives, and no more than 8 fma units of 512 bits do."""
    lanes = processor().lanes(kind)
    assert 0.1e9 * lanes < peak.peak(kind) < 8 * 2 * lanes * 7e9
    monkeypatch.setattr(modules, "folder", lambda: None)  # Numba does not inspect cached code
    code = peak.chains.__wrapped__(kind)[0].inspect_llvm()
    fused = f"llvm.fma.v{lanes}f{64 if kind == 'double' else 32}("
    calls = re.findall(rf"call <{lanes} x \w+> @{re.escape(fused)}", code)
    assert len(calls) == peak.CHAINS * peak.UNROLLED


def test_long_runs_tell_how_errors_grow():
    rows, _ = long_runs.grow("magnus4", "compensated", 2000, 8, "float64")
    steps, errors, lengths = np.array(rows).T
    assert steps[-1] == 2000
    assert errors.max() < 1e-14
    assert lengths.max() < 1e-15
    assert long_runs.exponent(np.array([1.0, 10.0]), np.array([1.0, 100.0])) == pytest.approx(2.0)


def test_advice_is_compared_with_a_sweep():
    """Of few methods: the sweep compiles each in two precisions."""
    number = list(advice.KINDS).index("free")
    found = advice.trial(1, number, 64, 0.01, methods=["rk4", "exact"])
    assert found.kind == "free"
    assert found.met
    assert found.best_steps >= 1
    assert found.advice_seconds > 0.0


def test_wheels_beside_many_digits(capsys):
    """A controller at all times, or a sample late, is another: rows far from round-off."""
    wheel_feedback.differences(30)
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    errors = {tuple(x.strip() for x in row[:2]): float(row[2]) for row in rows}
    assert errors["`rk8`", "mpmath"] < 1e-15
    assert errors["`rk4`, MRPs", "mpmath"] < 1e-14
    assert min(errors["`rk8`", "a sample late"], errors["`rk8`", "at all times"]) > 1e-6


def test_promises_are_compared_where_what_acts_jumps():
    """Pulses, jumps and ramps, refused but with breakpoints; a promise too small is found out."""
    lines = hostile.report(3, 2, seed=1)[2:]
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    three, two = ["pulse", "jump", "ramp"], ["pulse", "jump"]
    assert [c[1] for c in cells] == [*three, *three, *two, *two]
    assert [c[6] for c in cells] == ["0"] * 10
    assert [c[3] for c in cells if c[1] in two] == ["1", "1", "0", "0", "1", "1", "0", "0"]
    assert [c[2] for c in cells if "breakpoints" in c[0]] == ["1"] * 5
    case = hostile.draw(1, 2, 3)
    arguments = {"dt": case.t_end / 40, "n_steps": 40, "method": "rk4", "t0": case.t0}
    for promise, found in ((1e-9, "broken"), (1.0, "kept")):
        chosen = SimpleNamespace(arguments=arguments, expected_error=promise)
        assert hostile.outcome(case._replace(tol=2.0), chosen)[0] == found


def test_the_tables_of_choices(monkeypatch):
    """Of smooth clean samples picard is below coning2."""
    monkeypatch.setattr(choices, "LENGTHS", (200,))
    head, _, *rows = [line.split("|")[1:-1] for line in choices.samples()]
    names = [cell.strip() for cell in head]
    for row in rows:
        errors = dict(zip(names[1:], map(float, row[1:]), strict=True))
        if "clean" in row[0]:
            assert errors["picard"] < errors["coning2"]
    flagged = {
        row[0].strip(): int(row[1]) for row in map(cells_of, list(choices.large_steps())[2:])
    }
    assert flagged["`rk8`"] == flagged["`gbs16`"] == 0
    assert min(flagged["`dmv10`"], flagged["`strang2`"]) > 0


def cells_of(line):
    return line.split("|")[1:-1]


def test_per_body_steps_are_compared_at_an_equal_error(monkeypatch, capsys):
    """The same largest error within some percent, and fewer steps."""
    monkeypatch.setattr(per_body_steps, "BODIES", 150)
    monkeypatch.setattr(per_body_steps, "REFERENCE", 150)
    monkeypatch.setattr(per_body_steps, "shortest", lambda run: (1.0, run()))
    first = dict([next(iter(per_body_steps.problems().items()))])
    monkeypatch.setattr(per_body_steps, "problems", lambda: first)
    per_body_steps.main()
    cells = capsys.readouterr().out.splitlines()[-1].split("|")[1:-1]
    assert cells[0].strip() == "free bodies"
    assert float(cells[3]) < 1e-5
    assert float(cells[3]) == pytest.approx(float(cells[5]), rel=0.15)


# attitude and heading


def test_the_filter_follows_a_recording_in_absolute_axes():
    """The maker's filter has the same samples; what it corrects, this one does."""
    filtered, alone = recordings.errors(recordings.x_imu3())
    assert filtered < 0.7 * alone


@pytest.mark.filterwarnings("ignore:gate. the filter")
@pytest.mark.parametrize(
    ("name", "factors"),
    [
        ("rates", np.diag([-1.0, -1.0, -1.0])),
        ("accel", np.diag([-1.0, -1.0, -1.0])),
        ("mag", np.diag([-1.0, -1.0, -1.0])),
        ("mag", np.diag([1.0, -1.0, 1.0])),
        ("reference", np.diag([1.0, -1.0, -1.0, -1.0])),
        ("north", np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
    ],
    ids=["rates", "gravity", "field", "left-handed", "conjugate", "east"],
)
def test_a_wrong_sign_or_frame_is_a_right_angle_and_more(name, factors):
    recording = recordings.x_imu3()
    filtered, _ = recordings.errors(
        recording._replace(**{name: getattr(recording, name) @ factors})
    )
    assert filtered > 89.0


def test_consistency_of_filters(capsys, monkeypatch):
    """Small: from 0.1 rad on 6 to the sampling, of vectors far more precise than the start not."""
    monkeypatch.setattr(sys, "argv", ["consistency.py", "--filters", "300"])
    consistency.main()
    rows = [line.split("|")[2:-1] for line in capsys.readouterr().out.splitlines()[2:]]
    assert len(rows) == len(consistency.CASES)
    found = np.array([[float(x.replace(",", "")) for x in row] for row in rows])
    assert np.abs(found[:, 0] - 6.0).max() < 1.5
    assert (found[2, 2:] > 50.0).all()


# mutations


def test_mutations_are_small_changes_of_what_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(mutations, "ROOT", tmp_path)
    file = tmp_path / "code.py"
    file.write_text(
        """def f(x: int = 3) -> list[1]:
    '''Not 4.'''
    if x < y and not z:
        raise ValueError(f"{x + 1}")
    return g(x, -y, sorted=True, strict=True)
"""
    )
    found = {(m.lines[0], m.old, m.new) for m in mutations.mutations(file)}
    call = "g(x, -y, sorted=True, strict=True)"
    assert found == {
        (1, "3", "(4)"), (1, "3", "(2)"),
        (3, "x < y and not z", "(not (x < y and (not z)))"),
        (3, "x < y and not z", "(x < y or not z)"),
        (3, "x < y", "(x <= y)"), (3, "not z", "(z)"),
        (4, 'raise ValueError(f"{x + 1}")', "pass"),
        (5, call, "(g(-y, x, sorted=True, strict=True))"), (5, call, "(g(x, -y, strict=True))"),
        (5, "-y", "(y)"), (5, "True", "(False)"),
    }  # fmt: skip


def test_mutations_are_noticed_or_survive(tmp_path, monkeypatch, capsys):
    """Of a package with two numbers, one of which no test looks at."""
    root = tmp_path / "checkout"
    (root / "fastatt").mkdir(parents=True)
    (root / "tests").mkdir()
    (root / "fastatt/__init__.py").touch()
    (root / "fastatt/code.py").write_text("seen = 1\nunseen = 5\n")
    test = "from fastatt.code import seen\n\ndef test_seen():\n    assert seen == 1\n"
    (root / "tests/test_code.py").write_text(test)
    monkeypatch.setattr(mutations, "ROOT", root)
    monkeypatch.setattr(
        sys, "argv", ["mutations.py", "--count", "4", "--folder", f"{tmp_path}/run"]
    )
    mutations.main()
    lines = capsys.readouterr().out.splitlines()
    outcomes = dict(zip(lines[:-1:2], lines[1:-1:2], strict=True))
    assert len(outcomes) == 4
    for mutation, outcome in outcomes.items():
        noticed = outcome.strip().startswith("noticed: FAILED tests/test_code.py::test_seen")
        assert noticed == (":1 (byte 7): '1'" in mutation)
        assert noticed or outcome.strip() == "survived"
    assert lines[-1] == "Counter({'noticed': 2, 'survived': 2})"


# pictures
