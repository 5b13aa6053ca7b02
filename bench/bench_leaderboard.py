"""The leaderboard in small, without optional libraries, and that it notices mistakes."""

from __future__ import annotations

from dataclasses import replace

import leaderboard
import numpy as np
import pytest
from leaderboard_contestants import SAMPLED
from leaderboard_problems import MANY, ONE, coning_large
from leaderboard_report import Row, envelope, ranking, read_rows, table, time_at, verdict

PACKAGES = ("fastatt", "scipy", *SAMPLED)
# the others have the equations of these
PROBLEMS = ("coning-large", "coning-large-sampled", "free", "wheels", "log")


def test_time_at_equal_error():
    points = [(1e-2, 1.0), (1e-4, 100.0), (1e-3, 500.0)]
    assert envelope(points) == [(1e-2, 1.0), (1e-4, 100.0)]
    assert time_at(points, 1e-3) == pytest.approx(10.0)
    assert time_at(points, 1e-1) == 1.0
    assert time_at(points, 1e-5) is None


def test_winners():
    def row(package: str, error: float, seconds: float) -> Row:
        return Row("p", "P", "R", ONE, package, "m", "s", "why", error, error, error, seconds, 0.0)

    rows = [row("fastatt", 1e-7, 3.0), row("scipy", 1e-4, 6.0), row("scipy", 1e-10, 600.0)]
    assert verdict(ranking(rows, 1e-3)) == "`m` 2.0× scipy"
    assert verdict(ranking(rows, 1e-9)) == "**scipy alone**"
    assert verdict(ranking(rows, 1e-12)) == "none"
    rows.append(row("heyoka", 1e-10, 2.0))
    assert verdict(ranking(rows, 1e-6)) == "**heyoka 1.50×** `m`"
    rows.append(row("CyRK", 1e-7, 1.85))
    rows.append(row("fastatt", 1e-8, 1.7))
    assert verdict(ranking(rows, 1e-7)) == "tie: `m`, CyRK"
    assert verdict(ranking([rows[0], row("scipy", 1e-7, 3001.0)], 1e-7)) == "`m` >1000× scipy (why)"


def test_quick_run(tmp_path):
    chosen = [f"--package={name}" for name in PACKAGES] + [f"--problem={p}" for p in PROBLEMS]
    leaderboard.main(["--quick", f"--out={tmp_path}", *chosen])
    rows = read_rows(tmp_path / "leaderboard.csv")
    assert {row.problem for row in rows} == set(PROBLEMS)
    assert {row.package for row in rows} == set(PACKAGES)
    assert all(row.seconds > 0.0 and np.isfinite(row.error) for row in rows)
    # the reference is nobody's: each comes near it by itself
    for problem in ("coning-large", "free", "wheels"):
        packages = ("fastatt", "scipy", "numpy-quaternion")
        for package in packages[: None if problem == "coning-large" else 2]:
            own = [r.error for r in rows if (r.problem, r.package) == (problem, package)]
            assert min(own) < 1e-9, (problem, package)
    assert all(row.p50 <= row.p95 for row in rows)
    assert table(rows) in (tmp_path / "LEADERBOARD.md").read_text(encoding="utf-8")
    assert (tmp_path / "leaderboard.png").stat().st_size > 10_000


@pytest.mark.parametrize("mode", [ONE, MANY])
def test_mistaken_adapter_is_found(mode):
    """Equations with a rate that is off by 1e-9 of its size, at a tolerance of 1e-12."""
    problem = coning_large(quick=True)
    wrong = replace(problem, parameters=problem.parameters * (1.0 + 1e-9))
    for equations, passes in ((problem, True), (wrong, False)):
        found = [
            timed
            for contestant in leaderboard.contestants(equations, "scipy", quick=True)
            for timed in leaderboard.climb(equations, contestant, mode, [])
        ]
        if passes:
            leaderboard.check_claims(equations, found)
        else:
            with pytest.raises(AssertionError, match="scipy solve_ivp DOP853"):
                leaderboard.check_claims(equations, found)


def test_wrong_order_is_found():
    """A peer of order 2, as if it were of order 1."""
    problem = leaderboard.PROBLEMS["coning-large-sampled"](True)
    (contestant,) = leaderboard.contestants(problem, "scikit-kinematics", quick=True)
    found = leaderboard.climb(problem, contestant, ONE, [])
    leaderboard.check_claims(problem, found)
    for timed in found:
        timed.angles = np.sqrt(timed.angles)
    with pytest.raises(AssertionError, match="order"):
        leaderboard.check_claims(problem, found)
