"""The whole study: tables to the screen, rows and pictures to a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile

from fastatt import checks
from fastatt.gyro.integrate import methods_for_samples
from fastatt.logs import GyroLog, read_gyro_log
from fastatt.trade import ensembles, recordings
from fastatt.trade.ensembles import BODY_SCENES, CONING, RATE, SAMPLES
from fastatt.trade.measure import Case, Row, frontier, machine_line, panel, trade_table, write_csv
from fastatt.trade.motions import herpolhodes, nutations, polhodes

RECORDED = "recordings"
SCENES = (RECORDED, CONING, *BODY_SCENES)
DEFAULT_SCENES = (RECORDED, CONING)
_QUICK_STEPS = (50, 100)
_COARSEST, _RUNGS = 2.5, 6  # steps a second, and how many ladders of halved steps have
_DRAWN = ("quat", "dcm")
_TITLES = {
    RATE: "rate as a function of time",
    SAMPLES: "rate as samples",
    "free": "free bodies",
    "top": "heavy symmetric tops",
    "torqued": "gravity gradient, damping, wheel",
}

# cases to run, by the input that the rows name
_Cases = Mapping[str, Sequence[Case]]


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
    """Print the tables; leave the rows as CSV and the pictures in ``out``.

    ``scenes`` are names of ``SCENES``; ``methods`` those to run, None for all. ``quick`` takes two
    steps, quaternions and float64 only.

    Raises ``ImportError`` when matplotlib or the recordings are missing, ``ValueError`` for a log
    that can't be read or a method that no scene takes.
    """
    checks.whole("--bodies", n_bodies, 1)
    plan = _plan(scenes, methods, quick)
    if logs is not None and RECORDED not in scenes:
        raise ValueError(
            f"--log: found with --scene {' '.join(scenes)}; accepted: with --scene {RECORDED}"
        )
    try:
        from fastatt import plots
    except ImportError:
        raise ImportError("trade: needs matplotlib; pip install 'fastatt[plot]'") from None
    open_folder(out)
    read = []
    if RECORDED in plan:
        paths = recordings.find_recordings() if logs is None else logs
        # the recordings' maker writes rad/s, and does not say so
        unit = "rad/s" if logs is None else None
        read = [read_gyro_log(path, unit=unit) for path in paths]
    repeats = 1 if quick else 3
    print(machine_line())
    files = []
    if RECORDED in plan:
        files += _run_recordings(out, read, plan[RECORDED], repeats)
    for stem, title, names in (
        ("trade", "Ensemble of coning bodies", [CONING]),
        ("bodies", "Ensembles of rigid bodies", BODY_SCENES),
    ):
        own = {name: plan[name] for name in names if name in plan}
        if own:
            files += _run_ensembles(out / stem, title, own, n_bodies, quick, progress)
    if "free" in plan:
        plots.polhodes(polhodes(), herpolhodes(), out / "polhodes.png")
        files.append("polhodes.png")
    if "top" in plan:
        plots.axis_traces(nutations(), out / "tops.png")
        files.append("tops.png")
    print(f"\n{out}: {', '.join(files)}")


def open_folder(out: Path) -> None:
    """Make a folder for results, before anything is measured.

    Raises ``OSError`` where it is a file, or cannot be written to.
    """
    out.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=out):
        pass


def _plan(
    scenes: Sequence[str], methods: Sequence[str] | None, quick: bool
) -> dict[str, dict[str, list[Case]]]:
    """The cases of each scene that has any, in the order of ``SCENES``."""
    for name in scenes:
        checks.choice("--scene", name, SCENES)
    recorded = {RECORDED: [Case(name) for name in methods_for_samples()]}
    every = {
        name: recorded if name == RECORDED else ensembles.cases(name)
        for name in SCENES
        if name in scenes
    }
    fitting = dict.fromkeys(
        case.name for of_scene in every.values() for cases in of_scene.values() for case in cases
    )
    for method in methods or ():
        checks.choice("--methods", method, fitting)

    def kept(case: Case) -> bool:
        chosen = methods is None or case.name in methods
        return chosen and (not quick or case == Case(case.method))

    plan = {}
    for name, of_scene in every.items():
        left = {source: [c for c in cases if kept(c)] for source, cases in of_scene.items()}
        if any(left.values()):
            plan[name] = {source: cases for source, cases in left.items() if cases}
    return plan


def _run_recordings(out: Path, logs: Sequence[GyroLog], cases: _Cases, repeats: int) -> list[str]:
    from fastatt import plots

    names = [case.name for case in cases[RECORDED]]
    rows = [row for log in logs for row in recordings.log_rows(log, repeats, methods=names)]
    print(f"\nRecordings\n{recordings.log_table(rows)}")
    write_csv(out / "recordings.csv", rows)
    departures = [recordings.departures(log, names) for log in logs]
    plots.recordings(departures, recordings.REFERENCE, out / "recordings.png")
    return ["recordings.csv", "recordings.png"]


def _run_ensembles(
    path: Path, title: str, plan: Mapping[str, _Cases], n_bodies: int, quick: bool, progress: bool
) -> list[str]:
    """Tables and frontiers to the screen, rows as CSV and a picture beside each other."""
    from fastatt import plots

    by_input: dict[str, list[Row]] = {}
    for name, cases in plan.items():
        study = ensembles.study(name, n_bodies)
        print(f"\n{study.heading}", flush=True)
        t_end = study.problem.t_end
        ladder = [round(_COARSEST * t_end) * 2**k for k in range(_RUNGS)]
        steps, repeats = (_QUICK_STEPS, 1) if quick else (ladder, 3)
        found = study.rows(cases, steps, repeats, progress=progress)
        print(trade_table([row for rows in found.values() for row in rows]))
        by_input |= found
    panels = []
    for source, rows in by_input.items():
        print(f"\nFrontier, {_TITLES[source]}: the cheapest way to each error")
        print(trade_table(frontier(rows)))
        panels.append(panel(_TITLES[source], t_end, rows, _DRAWN))
    table, picture = path.with_suffix(".csv"), path.with_suffix(".png")
    write_csv(table, [row for rows in by_input.values() for row in rows])
    plots.work_precision(panels, f"{title}: what accuracy costs", picture)
    return [table.name, picture.name]
