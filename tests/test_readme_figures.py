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
    largest = [x for x in next(r for r in rows if r[:2] == ["1", "10000"]) if x][-1]
    assert f"`rk4` for a free body takes {float(largest):.1f} ns on one core" in PROSE


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
    assert not any(cell.startswith("tie") for cell in found)
    lost = [(key, k) for key, row in board.items() for k, x in enumerate(row) if "**" in x]
    # a single short log at 1e-3 rad
    assert [(problem.split(", ")[-1], bodies, k) for (problem, bodies), k in lost] == [
        ("sampled", "one", 0)
    ]
    first = len(found) - len(lost)
    assert f"fastatt is first in {first} of {len(found)} cells; it loses one" in PROSE
    problems = {problem for problem, _ in board}
    assert f"with nine libraries on {len(problems)} problems" in PROSE


def test_single_precision_is_named():
    cell = of_leaderboard()["free triaxial body, 10 s", "ensemble"][1]
    ratio = re.fullmatch(r"`exact float32` (.*)× heyoka", cell)[1]
    assert f"`exact float32` is {ratio} times as fast as heyoka" in PROSE
