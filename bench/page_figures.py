"""Tables and paragraphs of pages whose figures stand in files that other commands write.

    python bench/page_figures.py              # rewrites them in the pages
    python bench/page_figures.py results      # first takes the drifts that ``fastatt trade`` left

Methods that are first, and the paragraph on them, come from the leaderboard's table "Who is first",
drifts after many steps from ``bench/drift.csv``, others from ``bench/CASES.md`` and ``SCALE.md``.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

ROOT = Path(__file__).resolve().parents[1]
BENCH = ROOT / "bench"
DRIFT = BENCH / "drift.csv"
DOCS = ROOT / "fastatt" / "docs"
PAGES = (ROOT / "README.md", DOCS / "guides" / "choose-method.md", DOCS / "tutorial.md")
TARGETS = ("1e-3", "1e-6", "1e-9", "1e-12")
#: groups of the leaderboard's problems, by words of their titles that others lack
GROUPS = {
    "prescribed rate": r"coning.*(?<!sampled)$",
    "free body, heavy symmetric top": r"free|flip|separatrix|symmetric top",
    "any torque": r"triaxial top|rigid body|debris",
    "wheels, torques held between samples": r"wheels",
    "sampled rates": r"sampled$",
}
SHOWN = ("rk4", "cf4", "magnus4", "strang2", "kahan_li8", "dmv10", "rk8", "rk9", "gbs16", "exact")
#: what the README shows of the leaderboard
COMPARED = {
    ("coning, 1 rad, 1 rad/s, 10 s", "one"),
    ("coning, 1 rad, 1 rad/s, 10 s", "ensemble"),
    ("free triaxial body, 100 s", "ensemble"),
    ("tumbling debris, gravity gradient, an orbit of 5712 s", "one"),
    ("tumbling debris, gravity gradient, an orbit of 5712 s", "ensemble"),
}
NUMBERS = (
    "none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven",
)  # fmt: skip
CELLS = """\
[The leaderboard](bench/LEADERBOARD.md) compares fastatt with {libraries} libraries on {problems} \
problems, for one body and for ensembles, at four errors each. There fastatt is first in {won} of \
{cells} cells; it ties in {tied} and loses {lost}. In {closed} of the {won} its fastest method is \
a closed form (`exact`), which takes no steps while the other libraries integrate. In {single}, at \
1e-3 and 1e-6 rad, its fastest method runs in float32 and the others in float64. In {alone} no \
other library reaches the error. For a single body a call of `propagate` takes longer than its \
steps; `fa.plan` and `fa.single_step` avoid that ([where fastatt is \
slower](fastatt/docs/benchmarks/index.md))."""
PUBLISHED = """\
{agree} published figures are reproduced (NASA's NESC check cases, Basilisk, GTSAM, the radar \
observations of Toutatis and others: [all of them](bench/CASES.md)). A step of `rk4` for a free \
body takes {many} ns on one core in an ensemble of 10⁴ bodies, and {one} ns for a single body \
([cost against ensemble size](bench/SCALE.md)). The compiled loop of an ensemble is nearly as fast \
as the same loop in C ([measured](fastatt/docs/benchmarks/index.md#compared-with-c))."""
DRIFTS = {
    ("coning", "norm"): "coning, norm",
    ("free", "norm"): "free body, norm",
    ("free", "energy"): "free body, energy",
    ("free", "momentum"): "free body, momentum",
    ("top", "energy"): "heavy top, energy",
}


def cells(text: str) -> list[list[str]]:
    """The cells of every line of a table."""
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def board(title: str = "Who is first") -> list[list[str]]:
    """A table of the leaderboard: a problem, its bodies, and a cell for each of ``TARGETS``."""
    _, table = (BENCH / "LEADERBOARD.md").read_text(encoding="utf-8").split(f"## {title}")
    return cells(table.split("\n![")[0].split("\n## ")[0])[2:]


def first() -> dict[str, list[Counter[str]]]:
    """How often each of our methods is first, by group and error, over one body and ensembles."""
    counts = {group: [Counter[str]() for _ in TARGETS] for group in GROUPS}
    for title, _, *row in board():
        group = next(name for name, words in GROUPS.items() if re.search(words, title))
        for count, cell in zip(counts[group], row, strict=True):
            # where another library is first, ours follows
            count[re.search(r"`(\w+)", cell)[1]] += 1
    return counts


def of_methods() -> str:
    """The method that is first most often, with the number of the cells; more than one of a tie."""
    lines = [f"| problem | {' | '.join(f'{x} rad' for x in TARGETS)} |"]
    lines.append("| --- " * (1 + len(TARGETS)) + "|")
    for group, counts in first().items():
        cells = []
        for count in counts:
            most = max(count.values())
            names = [f"`{name}`" for name, times in count.items() if times == most]
            cells.append(f"{', '.join(names)} ({most} of {count.total()})")
        lines.append(f"| {group} | {' | '.join(cells)} |")
    return "\n".join(lines)


def default(group: str) -> str:
    """The method that is first most often at 1e-3 and 1e-6 rad."""
    coarse, fine, *_ = first()[group]
    return (coarse + fine).most_common(1)[0][0]


def of_drifts() -> str:
    """Drifts of quaternions after many steps, and how they grew."""
    with DRIFT.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["representation"] == "quat"]
    found = {(row["input"], row["quantity"], row["method"]): row for row in rows}
    steps = rows[0]["n_steps"]
    lines = [f"| after {int(steps):,} steps | {' | '.join(DRIFTS.values())} |"]
    lines.append("| --- " * (1 + len(DRIFTS)) + "|")
    for method in SHOWN:
        own = [found.get((*key, method)) for key in DRIFTS]
        cells = [f"{float(x['drift']):.0e}, {x['growth']}" if x else "" for x in own]
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def keep(results: Path) -> None:
    """Keep the last line of each drift that ``fastatt trade`` measured."""
    with (results / "drift.csv").open(encoding="utf-8", newline="") as file:
        last = {
            (row["input"], row["method"], row["representation"], row["quantity"]): row
            for row in csv.DictReader(file)
        }
    with DRIFT.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(next(iter(last.values()))))
        writer.writeheader()
        writer.writerows(last.values())


def of_ratios() -> str:
    """How many times as long others take, of some problems at the smallest errors."""
    lines = ["| problem | bodies | 1e-09 rad | 1e-12 rad |", "| --- " * 4 + "|"]
    rows = [row for row in board() if (row[0], row[1]) in COMPARED]
    return "\n".join(lines + [f"| {' | '.join((*row[:2], *row[4:]))} |" for row in rows])


def of_cells() -> str:
    """In how many cells of the leaderboard what is first."""
    every = [cell for row in board() for cell in row[2:]]
    won = [cell for cell in every if cell.startswith("`")]
    tied, lost = (sum(cell.startswith(mark) for cell in every) for mark in ("tie", "**"))
    return CELLS.format(
        libraries=NUMBERS[len(board("Libraries")) - 1],
        problems=len({row[0] for row in board()}),
        cells=len(every),
        won=len(won),
        tied=NUMBERS[tied],
        lost=NUMBERS[lost],
        closed=sum(cell.startswith("`exact") for cell in won),
        single=sum(" float32` " in cell for cell in won),
        alone=sum(cell.endswith("alone") for cell in won),
    )


def of_published() -> str:
    """How many published figures agree, and what a step costs."""
    agree = re.search(r"(\d+ of \d+) figures agree", (BENCH / "CASES.md").read_text("utf-8"))[1]
    rows = cells((BENCH / "SCALE.md").read_text(encoding="utf-8"))
    one, *_, many = next(row for row in rows if row[:2] == ["1", "10000"])[2:7]  # 1 to 10⁴ bodies
    return PUBLISHED.format(agree=agree, many=f"{float(many):.1f}", one=f"{float(one):.0f}")


BLOCKS = {
    "methods": of_methods,
    "drifts": of_drifts,
    "ratios": of_ratios,
    "cells": of_cells,
    "published": of_published,
}


def rewritten(text: str) -> str:
    """A page with what follows its marks ``<!-- python bench/page_figures.py: NAME -->``."""
    for name, block in BLOCKS.items():
        mark = f"<!-- python bench/page_figures.py: {name} -->\n"
        if mark in text:
            before, after = text.split(mark)
            lines = "\n".join(
                line if line.startswith("|") else fill(line, 108, break_on_hyphens=False)
                for line in block().splitlines()
            )
            text = f"{before}{mark}{lines}\n\n{after.partition(chr(10) * 2)[2]}"
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="?", type=Path, help="a folder of fastatt trade")
    options = parser.parse_args(arguments)
    if options.results:
        keep(options.results)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        page.write_text(rewritten(text), encoding="utf-8")


if __name__ == "__main__":
    main()
