"""The README's picture: error against time, this library and three others, of two ensembles.

    python bench/work_precision.py           # 3 minutes: bench/work_precision.csv and its picture
    python bench/work_precision.py --draw    # only draw what the file holds

Problems, contestants, clocks and references are those of the leaderboard: 1024 bodies in one call
on one core, in double precision; errors are root mean squares over the bodies whose end is known,
times the shortest of interleaved rounds. A library that is not installed is left out
(``pip install .[leaderboard]``).
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from leaderboard import climb, one_core, take_turns
from leaderboard_contestants import OURS, contestants, missing
from leaderboard_problems import MANY, PROBLEMS
from leaderboard_report import envelope
from matplotlib.figure import Figure

from fastatt.files import write_csv
from fastatt.plots.drawing import save, styles_of
from fastatt.trade.measure import processor_line
from fastatt.trade.timing import ROUNDS

HERE = Path(__file__).resolve().parent
PICTURES = HERE.parent / "fastatt" / "docs" / "pictures"
#: of each problem the methods shown; of libraries in the order of the colours
METHODS = {
    "coning-large": ("rk4", "magnus4", "magnus8", "gauss12"),
    "top-triaxial": ("rk4", "kahan_li8", "rk8", "gbs16"),
}
PEERS = {"heyoka": "Taylor", "CyRK": "DOP853", "scipy": "solve_ivp DOP853"}
TITLES = {"coning-large": "prescribed rate", "top-triaxial": "torque"}
_BUDGET = 25.0  # s of rounds, for each problem
Row = dict[str, Any]


def measure(name: str, quick: bool) -> list[Row]:
    """Rows of every method of a problem, its settings from coarse to fine."""
    problem = PROBLEMS[name](quick)
    wanted = {(OURS, method) for method in METHODS[name]} | set(PEERS.items())
    found = []
    for package in (OURS, *(peer for peer in PEERS if peer not in missing())):
        for contestant in contestants(problem, package, quick):
            if (package, contestant.method) in wanted:
                found += climb(problem, contestant, MANY, [])
    take_turns(found, _BUDGET, 1 if quick else ROUNDS)
    return [
        {
            "problem": name, "title": problem.title, "library": timed.contestant.package,
            "method": timed.contestant.method, "setting": timed.run.setting,
            "error_rad": f"{timed.error:.3e}",
            "microseconds": f"{timed.seconds / problem.units(MANY) * 1e6:.4g}",
            "where": processor_line(1),
        }
        for timed in found
    ]  # fmt: skip


def picture(rows: Sequence[Row], path: Path) -> None:
    """A panel for each problem, a curve for each method, other libraries in grey."""
    problems = {name: list(own) for name, own in groupby(rows, key=lambda row: row["problem"])}
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    figure.suptitle(f"Error against time: 1024 bodies in one call, float64, {rows[0]['where']}")
    drawn = figure.subplots(1, len(problems), sharey=True, squeeze=False)[0]
    drawn[0].set_ylabel("attitude error at the end, rms, rad")
    for axes, (name, own) in zip(drawn, problems.items(), strict=True):
        curves: dict[str, list[tuple[float, float]]] = {}
        for row in own:
            ours = row["library"] == OURS
            label = row["method"] if ours else f"{row['library']} {row['method']}"
            point = float(row["error_rad"]), float(row["microseconds"])
            curves.setdefault(label, []).append(point)
        others = {label for label in curves if label not in METHODS[name]}
        styles = styles_of(list(curves))
        for label in others:
            styles[label] |= {"color": "0.6", "ms": 3.5, "lw": 0.9}
        axes.set(xscale="log", yscale="log", ylim=(3e-15, 3.0))
        axes.set_title(f"{TITLES[name]}: {own[0]['title']}")
        axes.set_xlabel("time per body, µs")
        axes.grid(visible=True, alpha=0.3)
        axes.margins(x=0.08)
        for label, points in curves.items():
            errors, times = zip(*envelope(points), strict=True)
            axes.plot(times, errors, **styles[label], label=label)
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.13)}
        axes.legend(**below, fontsize=8, ncols=3, frameon=False)
    save(figure, path)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draw", action="store_true", help="only draw the file that is there")
    parser.add_argument("--out", type=Path, help="folder; default: those of file and picture")
    options = parser.parse_args(arguments)
    path = (options.out or HERE) / "work_precision.csv"
    if not options.draw:
        quick = bool(os.environ.get("FASTATT_SMOKE"))
        with one_core():
            rows = [row for name in METHODS for row in measure(name, quick)]
        write_csv("path", path, list(rows[0]), [list(row.values()) for row in rows])
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    picture(rows, (options.out or PICTURES) / "work_precision.png")


if __name__ == "__main__":
    main()
