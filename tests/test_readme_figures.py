"""Figures of the README are those of the pages that commands write."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PROSE = " ".join(README.split())


def page(name: str) -> str:
    return (ROOT / "bench" / name).read_text(encoding="utf-8")


def cells(text: str) -> list[list[str]]:
    """The cells of every line of a table."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def of_leaderboard() -> dict[tuple[str, str], list[str]]:
    """Who is first, by problem and bodies, at 1e-3, 1e-6, 1e-9 and 1e-12 rad."""
    _, table = page("LEADERBOARD.md").split("## Who is first")
    rows = cells(table.split("\n![")[0])[2:]
    return {(row[0], row[1]): row[2:] for row in rows}


def test_published_figures():
    agree, of = re.search(r"(\d+) of (\d+) figures agree", page("CASES.md")).groups()
    assert f"{agree} of {of} published figures are reproduced" in PROSE


def test_speed():
    rows = cells(page("SCALE.md"))
    times = [float(x) for x in next(r for r in rows if r[:2] == ["1", "10000"])[2:] if x]
    assert len(times) == 5  # 1 to 10^4 bodies
    assert f"takes {times[-1]:.1f} ns on one core in an ensemble of 10⁴ bodies" in PROSE
    assert f"and {times[0]:.0f} ns for a single body" in PROSE


def test_ratios_of_time():
    board = of_leaderboard()
    rows = [row for row in cells(README) if tuple(row[:2]) in board]
    assert len(rows) == 5
    for problem, bodies, *found in rows:
        assert found == board[problem, bodies][2:], (problem, bodies)
        assert "float32" not in "".join(found)


def test_cells_that_are_first_or_lost():
    board = of_leaderboard()
    found = [cell for row in board.values() for cell in row]
    lost, tied = (
        [(key, k) for key, row in board.items() for k, x in enumerate(row) if x.startswith(mark)]
        for mark in ("**", "tie")
    )
    # single short logs at 1e-3 rad
    assert [(problem.split(", ")[-1], bodies, k) for (problem, bodies), k in tied + lost] == [
        ("sampled", "one", 0)
    ] * 2
    first = len(found) - 2
    assert f"fastatt is first in {first} of {len(found)} cells; it ties in one and loses" in PROSE
    problems = {problem for problem, _ in board}
    assert f"with nine libraries on {len(problems)} problems" in PROSE


def test_scope_of_the_cells_that_are_first():
    rows = of_leaderboard().values()
    won = [(k, cell) for row in rows for k, cell in enumerate(row) if cell.startswith("`")]
    closed = sum(cell.startswith("`exact") for _, cell in won)
    assert f"In {closed} of the {len(won)} its fastest method is a closed form" in PROSE
    single = [k for k, cell in won if " float32` " in cell]
    assert set(single) == {0, 1}
    assert f"In {len(single)}, at 1e-3 and 1e-6 rad, its fastest method runs in float32" in PROSE
    alone = sum(cell.endswith("alone") for _, cell in won)
    assert f"In {alone} no other library reaches the error" in PROSE
