"""The README's method table, from the CSV that ``fastatt trade`` leaves: path as the argument."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from fastatt import METHODS


def rows(path: Path) -> list[dict[str, str]]:
    """Rows on quaternions in float64."""
    with path.open(newline="") as file:
        return [
            r
            for r in csv.DictReader(file)
            if r["representation"] == "quat" and r["dtype"] == "float64"
        ]


def main(path: Path) -> None:
    """Print one line a method: error at two steps, speed at the smaller."""
    table = rows(path)
    steps = sorted({float(r["dt"]) for r in table}, reverse=True)
    coarse, fine = steps[1], steps[4]
    print(f"| method | for | order | error, dt={coarse:g} s | error, dt={fine:g} s | M steps/s | |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for r in table:
        if float(r["dt"]) != coarse:
            continue
        other = next(
            o
            for o in table
            if (o["method"], o["input"], float(o["dt"])) == (r["method"], r["input"], fine)
        )
        method = METHODS[r["method"]]
        speed = float(other["steps_per_second"]) / 1e6
        print(
            f"| `{method.name}` | {r['input']} | {method.order} | {float(r['error_median']):.1e} "
            f"| {float(other['error_median']):.1e} | {speed:.0f} | {method.summary} |"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
