"""The whole study: one screen, a page, tables and pictures in a folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from time import perf_counter

from fastatt import checks
from fastatt.files import writing
from fastatt.methods import METHODS
from fastatt.threads import progress_bar
from fastatt.trade import ensembles, long_run, measure, summary
from fastatt.trade.ensembles import SCENES
from fastatt.trade.long_run import Drifted
from fastatt.trade.measure import Case, Row, machine_line, processor_line, table, to_csv

# s for all that is measured, steps of long runs, their bodies, rungs of a ladder for each doubling
_WHOLE = (100.0, 2**18, 32, 2)
_QUICK = (12.0, 2**17, 8, 1)


def run_trade(
    out: Path,
    *,
    scenes: Sequence[str] = SCENES,
    methods: Sequence[str] | None = None,
    n_bodies: int = 512,
    quick: bool = False,
    progress: bool = False,
    verbose: bool = False,
) -> None:
    """Print one screen, and write a page, rows as CSV and pictures to ``out``.

    ``scenes`` are names of ``SCENES``; ``methods`` are those to run, None for all. ``quick`` runs
    those that are usual, with fewer step sizes. ``verbose`` prints all rows too.

    Raises ``ImportError`` if matplotlib is missing, ``ValueError`` for a method that fits no scene,
    ``OSError`` if ``out`` can't be written to.
    """
    checks.whole("--bodies", n_bodies, 1)
    plan = _plan(scenes, methods, quick)
    checks.optional("trade", "matplotlib", "fastatt[plot]")
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=out):  # a folder that can't be written to is refused before the runs
        pass
    seconds, n_steps, few, per_doubling = _QUICK if quick else _WHOLE
    until = perf_counter() + seconds
    rows: list[Row] = []
    long: list[Drifted] = []
    headings: dict[str, str] = {}
    left = sum(map(len, plan.values()))
    with progress_bar(progress, left, "method") as done:
        for name, cases in plan.items():
            study = ensembles.study(name, n_bodies)
            headings[name] = str(study)
            ladders: dict[Case, list[Row]] = {}
            drifts: list[Drifted] = []
            # a wide ensemble is for times, a few of its bodies for long runs
            small = ensembles.problem(name, few)
            for case in cases:
                share = max(0.1, 0.7 * (until - perf_counter()) / left)
                steps = ensembles.steps(study.problem, case, per_doubling)
                ladders[case] = study.rows(case, steps, share)
                if case.record.window is None:
                    drifts += long_run.long_run(name, small, case, n_steps)
                left -= 1
                done(1)
            measured = study.timed(ladders)
            heading = f"{study.title}: error against time\n{processor_line(1)}"
            measure.draw(measured, study.problem.duration, heading, out / f"error-{name}.png")
            if drifts:
                heading = f"{study.title.partition(' ')[2]}: drift against time"
                long_run.draw(drifts, heading, out / f"drift-{name}.png")
            rows += measured
            long += drifts
    where = f"{n_bodies} bodies, {machine_line(1)}"
    to_csv(out / "trade.csv", rows)
    to_csv(out / "drift.csv", long)
    with writing("--out", out / "summary.md", text="utf-8") as file:
        file.write(summary.page(where, headings, rows, long))
    print(where)
    if verbose:
        for name, heading in headings.items():
            print(f"\n{heading}\n{table([row for row in rows if row.input == name])}")
    print(summary.screen(rows, long))
    pictures = "error-SCENE.png, drift-SCENE.png"
    print(f"{out}: summary.md (how to read this), trade.csv, drift.csv, {pictures}")


def _plan(
    scenes: Sequence[str], methods: Sequence[str] | None, quick: bool
) -> dict[str, list[Case]]:
    """The cases of each scene, in the order of ``SCENES``."""
    every = {name: ensembles.cases(name) for name in SCENES if name in scenes}
    fitting = dict.fromkeys(case.name for cases in every.values() for case in cases)
    for method in methods or ():
        checks.choice("--methods", method, fitting)
    usual = [m.name for m in METHODS.values() if m.tried_on != ()]
    wanted = methods or (usual if quick else fitting)
    plan = {name: [c for c in cases if c.name in wanted] for name, cases in every.items()}
    return {name: cases for name, cases in plan.items() if cases}
