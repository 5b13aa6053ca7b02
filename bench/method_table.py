"""The README's method tables, from the CSV files that ``fastatt trade`` leaves: paths as arguments.

``trade.csv`` gives the table of prescribed rates, ``bodies.csv`` that of rigid bodies.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from fastatt import METHODS
from fastatt.trade.ensembles import BODY_SCENES
from fastatt.trade.measure import machine_line

# what the rows of an input are called
NAMES = {
    "free": "free bodies",
    "top": "heavy tops",
    "torqued": "any torque",
}
STEPS = (0.2, 0.025)


def ladders(path: Path) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Rows on quaternions in float64, by method and input."""
    found: dict[tuple[str, str], list[dict[str, str]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if (row["representation"], row["dtype"]) == ("quat", "float64"):
                found.setdefault((row["method"], row["input"]), []).append(row)
    return found


def at(ladder: list[dict[str, str]], dt: float) -> dict[str, str] | None:
    """The row of a step; that of the closed form, which has none, is its only one."""
    if len(ladder) == 1:
        return ladder[0]
    return next((r for r in ladder if abs(float(r["dt"]) - dt) < 1e-9), None)


def main(path: Path) -> None:
    """Print one line a method and input: error at two steps, speed at the smaller, summary once."""
    coarse, fine = STEPS
    print(
        f"| method | for | order | error, dt={coarse:g} s | error, dt={fine:g} s | M steps/s "
        "| operations a step | % of the peak | |"
    )
    print("| --- " * 9 + "|")
    summaries = {name: method.summary for name, method in METHODS.items()}
    for (name, source), ladder in ladders(path).items():
        method = METHODS[name]
        order = method.order_of(BODY_SCENES[source].kind) if source in BODY_SCENES else method.order
        first, last = at(ladder, coarse), at(ladder, fine)
        if first is None or last is None:
            raise SystemExit(f"{path}: {name} has no step of {coarse:g} or {fine:g} s: a full run?")
        speed = float(last["steps_per_second"]) / 1e6
        part = f"{100.0 * float(last['peak']):.0f}" if last["peak"] else ""
        print(
            f"| `{name}` | {NAMES.get(source, source)} | {order or 'exact'} "
            f"| {float(first['error_median']):.1e} | {float(last['error_median']):.1e} "
            f"| {speed:.0f} | {last['operations']} | {part} | {summaries.pop(name, '')} |"
        )


if __name__ == "__main__":
    print(f"{machine_line()}\n")
    for argument in sys.argv[1:]:
        main(Path(argument))
