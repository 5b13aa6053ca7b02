"""The whole study: tables on the screen, rows and pictures in a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile

from fastatt import checks
from fastatt.gyro.integrate import methods_for_samples
from fastatt.logs import GyroLog, read_gyro_log
from fastatt.threads import default_threads
from fastatt.trade import ensembles, recordings
from fastatt.trade.ensembles import BODY_SCENES, CONING
from fastatt.trade.measure import (
    Case,
    Row,
    frontier,
    machine_line,
    panel,
    processor_line,
    trade_table,
    write_csv,
)

RECORDED = "recordings"
SCENES = (RECORDED, CONING, *BODY_SCENES)
DEFAULT_SCENES = (RECORDED, CONING)
_QUICK_STEPS = (50, 100)
_COARSEST, _RUNGS = 2.5, 6  # steps per second of the coarsest run, and runs of a ladder
_DRAWN = ("quat", "dcm")


def run_trade(
    out: Path,
    *,
    scenes: Sequence[str] = DEFAULT_SCENES,
    methods: Sequence[str] | None = None,
    logs: Sequence[Path] | None = None,
    n_bodies: int = 4096,
    quick: bool = False,
    progress: bool = False,
) -> None:
    """Print the tables, and write the rows as CSV and the pictures to ``out``.

    ``scenes`` are names of ``SCENES``; ``methods`` are those to run, None for all. ``quick`` takes
    two step sizes, quaternions and float64 only.

    Raises ``ImportError`` if matplotlib or the recordings are missing, ``ValueError`` for a log
    that can't be read or a method that fits no scene.
    """
    checks.whole("--bodies", n_bodies, 1)
    plan = _plan(scenes, methods, quick)
    if logs is not None and RECORDED not in scenes:
        raise ValueError(
            f"--log: found with --scene {' '.join(scenes)}; accepted: with --scene {RECORDED}"
        )
    if find_spec("matplotlib") is None:
        raise ImportError("trade: needs matplotlib; pip install 'fastatt[plot]'")
    open_folder(out)
    read = []
    if RECORDED in plan:
        paths = recordings.find_recordings() if logs is None else logs
        # the recordings are in rad/s, which their files do not say
        unit = "rad/s" if logs is None else None
        read = [read_gyro_log(path, unit=unit) for path in paths]
    repeats = 1 if quick else 3
    print(machine_line())
    files = []
    if RECORDED in plan:
        files += _run_recordings(out, read, [c.name for c in plan[RECORDED]], repeats)
    for stem, title, names in (
        ("trade", "Ensemble of coning bodies", [CONING]),
        ("bodies", "Ensembles of rigid bodies", BODY_SCENES),
    ):
        own = {name: plan[name] for name in names if name in plan}
        if own:
            files += _run_ensembles(out / stem, title, own, n_bodies, quick, progress)
    print(f"\n{out}: {', '.join(files)}")


def open_folder(out: Path) -> None:
    """Make a folder for results before anything is measured.

    Raises ``OSError`` if it is a file, or cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=out):
        pass


def _plan(
    scenes: Sequence[str], methods: Sequence[str] | None, quick: bool
) -> dict[str, list[Case]]:
    """The cases of each scene, in the order of ``SCENES``."""
    for name in scenes:
        checks.choice("--scene", name, SCENES)
    every = {name: ensembles.cases(name) for name in SCENES if name in scenes and name != RECORDED}
    if RECORDED in scenes:
        every[RECORDED] = [Case(name) for name in methods_for_samples()]
    fitting = dict.fromkeys(case.name for cases in every.values() for case in cases)
    for method in methods or ():
        checks.choice("--methods", method, fitting)
    plan = {}
    for name, cases in every.items():
        plan[name] = [
            case
            for case in cases
            if (methods is None or case.name in methods)
            and (not quick or case == Case(case.method))
        ]
    return {name: cases for name, cases in plan.items() if cases}


def _run_recordings(
    out: Path, logs: Sequence[GyroLog], methods: Sequence[str], repeats: int
) -> list[str]:
    from fastatt import plots

    rows = [row for log in logs for row in recordings.log_rows(log, repeats, methods)]
    print(f"\nRecordings\n{recordings.log_table(rows)}")
    write_csv(out / "recordings.csv", rows)
    departures = [recordings.departures(log, methods) for log in logs]
    plots.recordings(departures, recordings.REFERENCE, out / "recordings.png")
    return ["recordings.csv", "recordings.png"]


def _run_ensembles(
    path: Path,
    title: str,
    plan: Mapping[str, Sequence[Case]],
    n_bodies: int,
    quick: bool,
    progress: bool,
) -> list[str]:
    """Print tables and frontiers; write rows as CSV and a picture with a panel for each input."""
    from fastatt import plots

    by_input: dict[str, list[Row]] = {}
    for name, cases in plan.items():
        study = ensembles.study(name, n_bodies)
        print(f"\n{study.heading}", flush=True)
        t_end = study.problem.t_end
        ladder = [round(_COARSEST * t_end) * 2**k for k in range(_RUNGS)]
        steps, repeats = (_QUICK_STEPS, 1) if quick else (ladder, 3)
        found = study.rows(cases, steps, repeats, progress=progress)
        print(trade_table(found))
        for row in found:
            by_input.setdefault(row.input, []).append(row)
    panels = []
    for source, rows in by_input.items():
        print(f"\nFrontier, {ensembles.TITLES[source]}: the cheapest way to each error")
        print(trade_table(frontier(rows)))
        panels.append(panel(ensembles.TITLES[source], t_end, rows, _DRAWN))
    table, picture = path.with_suffix(".csv"), path.with_suffix(".png")
    write_csv(table, [row for rows in by_input.values() for row in rows])
    where = f"{n_bodies} bodies, {processor_line(default_threads())}"
    plots.work_precision(panels, f"{title}: error against time\n{where}", picture)
    return [table.name, picture.name]
