"""Every method at the extremes: its error, or the status that says that there is no trusting it.

``make extremes`` writes the tables to ``bench/EXTREMES.md`` (``tests`` has to be on the path);
``--quick`` runs a method of each sort on quaternions in float64, ``--long`` takes the energy over
10^7 steps. References are closed forms. The rule that every cell is held to: a body with status 0
is right, to what the order of its method, the rounding of its precision and the conditioning of its
motion allow.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from extremes.cases import Case, Outcome, Table
from extremes.energy import ENSEMBLE, energy, keeps_energy
from extremes.tables import TABLES
from extremes_limits import floors_table, limits_table

import fastatt as fa
from fastatt.methods import Method

OUT = Path(__file__).resolve().parent / "EXTREMES.md"
#: a method of each sort
SOME = ("rk4", "magnus4", "strang2", "dmv10", "exact", "coning2")
HEADER = """\
# Every method at the extremes

Made by `make extremes`. A cell holds the largest error of bodies with status 0, and the flags of
all bodies. **wrong** would mark a body with status 0 whose error is larger than 0.1 rad for each
rad of rotation, or larger than the following explain together: the order of the method, rounding
(16 ulps for each change of the state in a step), and the conditioning of the motion (measured on
the closed form). There are {wrong} in {total} cells.

No method can detect a rate that changes faster than a step resolves. The axes of cones rotate here
at up to twice the rate of the body.
"""


def cases(*, quick: bool = False) -> list[Case]:
    """All rows there are."""
    return [
        Case(m.name, r, d)
        for m in fa.METHODS.values()
        if not quick or m.name in SOME
        for r in (m.representations[:1] if quick else m.representations)
        for d in (("float64",) if quick else ("float64", "float32"))
    ]


def row(case: Case) -> dict[tuple[str, str], Outcome]:
    """All cells of a row, by table and column."""
    return {
        (table.title, column.name): column.run(case)
        for table in TABLES
        if table.scene in case.record.scenes
        for column in table.columns
        if column.fits(case)
    }


def lines(table: Table, rows: Mapping[Case, Mapping[tuple[str, str], Outcome]]) -> Iterable[str]:
    """A table in Markdown."""
    names = [column.name for column in table.columns]
    yield from (f"## {table.title}", "", table.text, "")
    yield f"| method | on | {' | '.join(names)} |"
    yield f"| --- | --- |{' --- |' * len(names)}"
    for case, cells in rows.items():
        found = [cells.get((table.title, name)) for name in names]
        if any(found):
            on = case.representation + (" f32" if case.dtype == "float32" else "")
            text = " | ".join(cell.text if cell else "" for cell in found)
            yield f"| {case.method} | {on} | {text} |"
    yield ""


def energy_table(n_steps: int, methods: Iterable[Method]) -> Iterable[str]:
    yield from (f"## Energy over {n_steps:.0e} steps".replace("e+0", "e"), "")
    yield (
        f"{ENSEMBLE} bodies of moments about (0.6, 0.8, 1), 1 rad/s, steps of 0.1 s. Relative "
        "to the energy: slope a step with its standard error over the bodies, the largest change, "
        "and the slope in standard errors."
    )
    yield from ("", "| method | slope | ± | largest | slope/± |", "| --- | --- | --- | --- | --- |")
    for record in methods:
        if keeps_energy(record) or record.name == "rk4":
            d = energy(Case(record.name), n_steps)
            ratio = d.slope / d.uncertainty
            yield (
                f"| {record.name} | {d.slope:.1e} | {d.uncertainty:.1e} | {d.largest:.1e} "
                f"| {ratio:.1f} |"
            )
    yield ""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a method of each sort, in float64")
    parser.add_argument("--long", action="store_true", help="energy over 10^7 steps too")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at once")
    parser.add_argument("--out", type=Path, default=OUT, help="the page, Markdown")
    options = parser.parse_args(arguments)
    every = cases(quick=options.quick)
    # a process ends after some rows: what was compiled stays in its memory
    with multiprocessing.get_context("spawn").Pool(options.jobs, maxtasksperchild=8) as pool:
        rows = {}
        for case, found in zip(every, pool.imap(row, every), strict=True):
            rows[case] = found
            print(len(rows), "of", len(every), *case, file=sys.stderr)
    cells = [cell for found in rows.values() for cell in found.values()]
    wrong = sum(bool(cell.wrong.any()) for cell in cells)
    methods = dict.fromkeys(case.record for case in every)
    page = [HEADER.format(wrong=wrong, total=len(cells)), *limits_table(methods)]
    page += floors_table(methods)
    for table in TABLES:
        page += lines(table, rows)
    page += energy_table(10_000_000 if options.long else 100_000, methods)
    text = "\n".join(page)
    options.out.write_text(text, encoding="utf-8")
    print(text)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
