"""The tables from which the advice on methods follows, in the pages that give it.

    python bench/choose.py              # rewrites the tables of the pages
    python bench/choose.py results      # first takes the drifts that ``fastatt trade`` left there

The method that is first comes from the leaderboard's table "Who is first", the drift after many
steps from ``bench/drift.csv``.
"""

from __future__ import annotations

import argparse
import csv
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BOARD, DRIFT = ROOT / "bench" / "LEADERBOARD.md", ROOT / "bench" / "drift.csv"
DOCS = ROOT / "fastatt" / "docs"
PAGES = (ROOT / "README.md", DOCS / "guides" / "choose-method.md", DOCS / "tutorial.md")
TARGETS = ("1e-3", "1e-6", "1e-9", "1e-12")
#: groups of the leaderboard's problems, by words of their titles that others lack
GROUPS = {
    "prescribed rate": r"coning.*(?<!sampled)$",
    "free body, heavy symmetric top": r"free|flip|separatrix|symmetric top",
    "any torque": r"triaxial top|rigid body",
    "wheels, torques held between samples": r"wheels",
    "sampled rates": r"sampled$",
}
SHOWN = ("rk4", "cf4", "magnus4", "strang2", "kahan_li8", "dmv10", "rk8", "rk9", "gbs16", "exact")
DRIFTS = {
    ("coning", "norm"): "coning, norm",
    ("free", "norm"): "free body, norm",
    ("free", "energy"): "free body, energy",
    ("free", "momentum"): "free body, momentum",
    ("top", "energy"): "heavy top, energy",
}


def first() -> dict[str, list[Counter[str]]]:
    """How often each of our methods is first, by group and error, over one body and ensembles."""
    _, table = BOARD.read_text(encoding="utf-8").split("## Who is first")
    found = {group: [Counter[str]() for _ in TARGETS] for group in GROUPS}
    for line in table.split("\n![")[0].splitlines():
        title, *cells = [cell.strip() for cell in line.split("|")[1:-1]] or [""]
        group = next((name for name, words in GROUPS.items() if re.search(words, title)), None)
        for count, cell in zip(found[group] if group else [], cells[1:], strict=False):
            # where another library is first, ours follows
            count[re.search(r"`(\w+)", cell)[1]] += 1
    return found


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


TABLES = {"methods": of_methods, "drifts": of_drifts}


def rewritten(text: str) -> str:
    """A page with the tables that follow its marks ``<!-- python bench/choose.py: NAME -->``."""
    for name, table in TABLES.items():
        mark = f"<!-- python bench/choose.py: {name} -->"
        if mark in text:
            before, after = text.split(f"{mark}\n")
            rest = after.lstrip("\n").partition("\n\n")
            kept = rest[2] if rest[0].startswith("|") else after
            text = f"{before}{mark}\n{table()}\n\n{kept.lstrip(chr(10))}"
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
