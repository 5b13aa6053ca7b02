"""Every method at the extremes: its error, or the status that says that there is no trusting it.

``python -m extremes`` (with ``tests`` on the path) writes the tables to ``bench/EXTREMES.md``;
``--quick`` runs quaternions in float64 alone, ``--long`` takes the energy over 10^7 steps.
References are closed forms. The rule that every cell is held to: a body with status 0 is right, to
what the order of its method, the rounding of its precision and the conditioning of its motion
allow.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from extremes.energy import energy_table
from extremes.limits import floors_table, limits_table
from extremes.tables import TABLES, cases, lines, row

OUT = Path(__file__).resolve().parents[2] / "bench" / "EXTREMES.md"


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


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="quaternions in float64 alone")
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
    page = [HEADER.format(wrong=wrong, total=len(cells)), *limits_table()]
    page += floors_table()
    for table in TABLES:
        page += lines(table, rows)
    page += energy_table(10_000_000 if options.long else 100_000)
    text = "\n".join(page)
    options.out.write_text(text, encoding="utf-8")
    print(text)
    return int(wrong > 0)
