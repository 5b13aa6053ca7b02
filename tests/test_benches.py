"""The scripts in bench/ that figures rest on, run small."""

from types import SimpleNamespace

import hostile
import method_table
import numpy as np
import page_figures
import polhodes
import pytest
import recordings
import wheels

import fastatt as fa
from fastatt.trade.ensembles import study
from fastatt.trade.measure import Case

pytestmark = pytest.mark.slow


def test_the_method_table(capsys):
    """A line a method and input: errors, speed, operations."""
    method_table.main("free", n_bodies=8, methods=("rk4", "exact"))
    head, _, *lines = capsys.readouterr().out.splitlines()
    assert "| operations a step |" in head
    assert len({line.count("|") for line in (head, *lines)}) == 1
    rk4, exact = (
        next(x for x in lines if x.startswith(f"| `{name}`")) for name in ("rk4", "exact")
    )
    rows = study("free", 8).rows(Case("rk4"), (50, 400))
    cells = [cell.strip() for cell in rk4.split("|")][1:]
    assert cells[:3] == ["`rk4`", "free bodies", "4"]
    assert cells[3:5] == [f"{row.error_median:.1e}" for row in rows]
    assert cells[6] == "223"
    assert [c.strip() for c in exact.split("|")][1:4] == ["`exact`", "free bodies", "exact"]


def test_the_drifts_that_are_kept_are_the_last(tmp_path, monkeypatch):
    monkeypatch.setattr(page_figures, "DRIFT", tmp_path / "kept.csv")
    head = "input,method,representation,quantity,n_steps,drift"
    lines = [head, "free,rk4,quat,energy,10,1e-9", "free,rk4,quat,energy,20,2e-9"]
    (tmp_path / "drift.csv").write_text("\n".join(lines), encoding="utf-8")
    page_figures.keep(tmp_path)
    assert page_figures.DRIFT.read_text(encoding="utf-8").split() == [lines[0], lines[2]]


def test_polhodes_are_of_one_momentum():
    """The third is the separatrix: the energy of rotating about the intermediate axis, nearly."""
    run, inertia = polhodes.motion(), np.array(polhodes.TRIAXIAL)
    m = inertia * run.w
    assert np.abs(np.linalg.norm(m, axis=-1) - 1.0).max() < 1e-13
    energy = fa.kinetic_energy(run.w, inertia)
    assert np.ptp(energy, axis=0).max() < 1e-13
    assert energy[0, 2] == pytest.approx(0.5 / inertia[1])
    assert np.abs(m[-1, 2, 1]) > 0.999


def test_wheels_beside_many_digits(capsys):
    """A controller at all times, or a sample late, is another: rows far from round-off."""
    wheels.differences(30)
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


def test_the_filter_follows_a_recording_in_absolute_axes():
    """The maker's filter has the same samples; what it corrects, this one does."""
    filtered, alone = recordings.errors(recordings.x_imu3())
    assert filtered < 0.7 * alone
