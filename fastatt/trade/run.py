"""The whole study: tables to the screen, rows and pictures to a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fastatt import checks
from fastatt.integrate import methods_for_samples
from fastatt.logs import Log, read_log
from fastatt.trade import recordings
from fastatt.trade.bodies import BODY_SCENES, body_cases, body_scene, body_trade
from fastatt.trade.bodies import T_END as BODY_T_END
from fastatt.trade.coning import RATE, SAMPLES, coning_cases, coning_trade
from fastatt.trade.coning import T_END as CONING_T_END
from fastatt.trade.measure import Case, Row, frontier, machine_line, panel, trade_table, write_csv
from fastatt.trade.motions import herpolhodes, nutations, polhodes

RECORDED, CONING = "recordings", "coning"
SCENES = (RECORDED, CONING, *BODY_SCENES)
DEFAULT_SCENES = (RECORDED, CONING)
_CONING_STEPS = (50, 100, 200, 400, 800, 1600)
_BODY_STEPS = (25, 50, 100, 200, 400, 800)
_QUICK_STEPS = (50, 100)
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
        import matplotlib as mpl  # noqa: F401
    except ImportError:
        raise ImportError("trade: needs matplotlib; pip install 'fastatt[plot]'") from None
    read = []
    if RECORDED in plan:
        paths = recordings.find_recordings() if logs is None else logs
        # the recordings' maker writes rad/s, and does not say so
        unit = "rad/s" if logs is None else None
        read = [read_log(path, unit=unit) for path in paths]
    out.mkdir(parents=True, exist_ok=True)
    repeats = 1 if quick else 3
    print(machine_line())
    files = []
    if RECORDED in plan:
        files += _run_recordings(out, read, plan[RECORDED], repeats)
    if CONING in plan:
        steps = _QUICK_STEPS if quick else _CONING_STEPS
        files += _run_coning(out, plan[CONING], n_bodies, steps, repeats, progress)
    bodies = {name: cases[name] for name, cases in plan.items() if name in BODY_SCENES}
    if bodies:
        steps = _QUICK_STEPS if quick else _BODY_STEPS
        files += _run_bodies(out, bodies, n_bodies, steps, repeats, progress)
    print(f"\n{out}: {', '.join(files)}")


def _plan(
    scenes: Sequence[str], methods: Sequence[str] | None, quick: bool
) -> dict[str, dict[str, list[Case]]]:
    """The cases of each scene that has any, in the order of ``SCENES``."""
    for name in scenes:
        checks.choice("--scene", name, SCENES)
    every: dict[str, _Cases] = {
        RECORDED: {RECORDED: [Case(name) for name in methods_for_samples()]},
        CONING: coning_cases(),
        **{name: {name: body_cases(scene)} for name, scene in BODY_SCENES.items()},
    }
    every = {name: cases for name, cases in every.items() if name in scenes}
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


def _run_recordings(out: Path, logs: Sequence[Log], cases: _Cases, repeats: int) -> list[str]:
    from fastatt import plots

    names = [case.name for case in cases[RECORDED]]
    rows = [row for log in logs for row in recordings.log_rows(log, repeats, methods=names)]
    print(f"\nRecordings\n{recordings.log_table(rows)}")
    write_csv(out / "recordings.csv", rows)
    departures = [recordings.departures(log, names) for log in logs]
    plots.recordings(departures, recordings.REFERENCE, out / "recordings.png")
    return ["recordings.csv", "recordings.png"]


def _run_coning(
    out: Path, cases: _Cases, n_bodies: int, steps: Sequence[int], repeats: int, progress: bool
) -> list[str]:
    over = f"over {CONING_T_END:g} s, against the exact attitude"
    print(f"\nEnsemble of {n_bodies} coning bodies {over}")
    rows = coning_trade(n_bodies, steps, repeats, progress, cases)
    print(trade_table(rows))
    by_input = {source: [r for r in rows if r.input == source] for source in cases}
    return _report(out / "trade", by_input, CONING_T_END, "Ensemble of coning bodies")


def _run_bodies(
    out: Path, cases: _Cases, n_bodies: int, steps: Sequence[int], repeats: int, progress: bool
) -> list[str]:
    from fastatt import plots

    by_input = {}
    for name, of_scene in cases.items():
        bodies = body_scene(name, n_bodies)
        print(f"\n{bodies.describe()}", flush=True)
        by_input[name] = body_trade(name, bodies, steps, repeats, progress, of_scene)
        print(trade_table(by_input[name]))
    files = _report(out / "bodies", by_input, BODY_T_END, "Ensembles of rigid bodies")
    if "free" in cases:
        plots.polhodes(polhodes(), herpolhodes(), out / "polhodes.png")
        files.append("polhodes.png")
    if "top" in cases:
        plots.axis_traces(nutations(), out / "tops.png")
        files.append("tops.png")
    return files


def _report(
    path: Path, by_input: Mapping[str, Sequence[Row]], t_end: float, bodies: str
) -> list[str]:
    """Frontiers to the screen, rows as CSV and a picture beside each other."""
    from fastatt import plots

    panels = []
    for source, rows in by_input.items():
        print(f"\nFrontier, {_TITLES[source]}: the cheapest way to each error")
        print(trade_table(frontier(rows)))
        panels.append(panel(_TITLES[source], t_end, rows, _DRAWN))
    table, picture = path.with_suffix(".csv"), path.with_suffix(".png")
    write_csv(table, [row for rows in by_input.values() for row in rows])
    plots.work_precision(panels, f"{bodies}: what accuracy costs", picture)
    return [table.name, picture.name]
