"""Every method at the extremes: its error, or the status that says that there is no trusting it.

``make extremes`` writes a summary to ``bench/EXTREMES.md`` and all tables to
``results/extremes.md``; ``--quick`` runs a method of each sort on
quaternions in float64, ``--long`` takes the energy over 10^7 steps. References are closed forms.
The rule that every cell is held to: a body with status 0 is right, to what the order of its method,
the rounding of its precision and the conditioning of its motion allow.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from extremes.bodies import SHAPES, TORQUED_STEPS, V, closed, measured, spins, swing, takes_torques
from extremes.cases import (
    ANGLES,
    PROMISE,
    START,
    Array,
    Case,
    Outcome,
    Table,
    angle,
    mul,
    propagate,
    rounding,
    single,
)
from extremes.energy import ENSEMBLE, energy, keeps_energy
from extremes.rates import CONES, cone, rates
from extremes.samples import coning_log
from extremes.tables import TABLES
from numpy.typing import NDArray

import fastatt as fa
from fastatt.methods import Method

ROOT = Path(__file__).resolve().parents[1]
#: a method of each sort
SOME = ("rk4", "magnus4", "strang2", "dmv10", "exact", "coning2")
HEADER = """\
# Every method at the extremes

Made by `make extremes`, which writes all cells to `results/extremes.md`. A cell holds the largest
error of bodies with status 0, and the flags of all bodies. **wrong** would mark a body with status
0 whose error is larger than 0.1 rad for each rad of rotation, or larger than the following explain
together: the order of the method, rounding (16 ulps for each change of the state in a step), and
the conditioning of the motion (measured on the closed form). There are {wrong} in {total} cells.

No method can detect a rate that changes faster than a step resolves. The axes of cones rotate here
at up to twice the rate of the body.
"""


def cases(*, quick: bool = False, method: str = "") -> list[Case]:
    """All rows there are, or those of a method."""
    names = [method] if method else SOME if quick else fa.METHODS
    return [
        Case(m.name, r, d)
        for m in map(fa.METHODS.__getitem__, names)
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


# where each method stops


SHARES = np.concatenate([np.linspace(0.5, 0.999, 16), [2.0]])  # of a limit: up to it, and beyond
SMALLER = np.concatenate([np.geomspace(0.02, 0.5, 8), SHARES[:-1]])  # where an order can be seen


def steps_of_cones(case: Case, shares: Array = SHARES) -> tuple[Array, NDArray[np.uint16]]:
    """Error of a step, rad a rad turned, and status at shares of the limit, (K, M) each."""
    theta, a = np.meshgrid(shares * case.record.limit(case.representation), CONES, indexing="ij")
    frequency = (theta / (2.0 * np.sin(0.5 * a))).ravel()
    a = a.ravel()
    q0 = mul(START, cone(a, 0.0 * a))
    got = propagate(case, rates(a, frequency, np.zeros((len(a), 3))), q0, dt=1.0, n_steps=1)
    error = angle(got.q[-1], mul(START, cone(a, frequency))) / theta.ravel()
    return error.reshape(theta.shape), got.status.reshape(theta.shape)


def steps_of_bodies(case: Case, shares: Array = SHARES) -> tuple[Array, NDArray[np.uint16]]:
    """The same of free bodies that can exist, in many directions."""
    limits = shares * case.record.limit(case.representation, body=True)
    inertia, w0 = [], []
    for name in ("V", "rod 1e-3", "needle 1e3", "disc", "disc ±2 %", "1, 2, 2.9"):
        w = spins(np.array(SHAPES[name]))
        moments = np.tile(SHAPES[name], (len(w), 1))
        size = measured(case, moments, w, 1.0)
        some = size > 1e-3  # else exact at any step
        inertia.append(moments[some])
        w0.append(w[some] / size[some, None])
    moments, w = np.vstack(inertia), np.vstack(w0)
    error, status = [], []
    for limit in limits:
        q0 = np.tile(START, (len(w), 1))
        got = propagate(case, fa.Scene(inertia=moments), q0, limit * w, dt=1.0, n_steps=1)
        q, _ = closed(moments, q0, limit * w, 1.0)
        error.append(angle(got.q[-1], q) / (limit * np.linalg.norm(w, axis=1)))
        status.append(got.status)
    return np.array(error), np.array(status)


def coefficients(case: Case) -> Iterable[tuple[str, float]]:
    """Twice the largest error over measure^order of what the tables hold a method to."""
    record = case.record
    for scene, name, run in (
        ("rate", "OF_CONES", steps_of_cones),
        ("free", "OF_BODIES", steps_of_bodies),
    ):
        limit = record.limit(case.representation, body=scene == "free")
        if scene in record.scenes and math.isfinite(limit) and not record.sorted_axes:
            error, status = run(case, SMALLER)
            measure = np.minimum(limit * SMALLER, 10.0) ** record.order_of(scene)
            known = (status == 0) & (error > 1e-9)  # not rounding, of needles neither
            yield name, 2.0 * float(np.max((error / measure[:, None])[known], initial=0.0))
    if takes_torques(case):
        worst = 0.0
        for x in np.geomspace(0.05, 10.0, 60):
            of = swing(case, x)
            step = (
                of.error / of.along - rounding(case, TORQUED_STEPS, TORQUED_STEPS * of.turn)
            ) / (TORQUED_STEPS * np.minimum(of.turn, 10.0) ** record.order_of("torqued"))
            known = (of.status == 0) & (of.error < PROMISE)
            worst = max(worst, float(np.max(step[known], initial=0.0)))
        yield "OF_PENDULA", 2.0 * worst


def number(x: float) -> str:
    return "none" if math.isinf(x) else f"{x:.3g}"


def told_by(status: NDArray[np.uint16]) -> str:
    """The flags that all of the bodies carry one of."""
    names = [f.name or "" for f in fa.Status if f and (status & f).any()]
    return ", ".join(names) + ("" if status.all() else " (not all)")


def limits_table(methods: Iterable[Method]) -> Iterable[str]:
    """Each method's limits and what happens at and beyond them, on quaternions in float64."""
    yield from ("## Where each method stops", "")
    yield (
        "The limit is of |w|h, rad a step or an interval of a log; of strang2 and its compositions "
        "of |m|h √(|1/I1 − 1/I2| |1/I3 − 1/I2|), and under a torque of |w|h too, of dmv of "
        "|m|h/I_min, of cg3 of 24/17 |w|h. Errors are the worst of one step of status 0 on the "
        "cones and bodies below, from half the limit on; flags are those of steps of twice the "
        "limit."
    )
    yield from ("", "| method | for | limit | error at it, rad a rad | beyond | c h/I up to |")
    yield "| --- | --- | --- | --- | --- | --- |"
    for record in methods:
        case = Case(record.name)
        damped = number(record.damping_limit) if "torqued" in record.scenes else ""
        for scene, run in (("rate", steps_of_cones), ("free", steps_of_bodies)):
            if scene not in record.scenes:
                continue
            limit = record.limit("quat", body=scene == "free")
            cells = [number(limit), "", ""]
            if math.isfinite(limit):
                error, status = run(case)
                cells[1:] = f"{error[status == 0].max():.0e}", told_by(status[-1])
            kind, own = ("rates", "") if scene == "rate" else ("bodies", damped)
            yield f"| {record.name} | {kind} | {' | '.join(cells)} | {own} |"
        if "torqued" in record.limits:
            limit = record.limits["torqued"]
            yield f"| {record.name} | bodies under a torque | {number(limit)} | | | |"
        for scene, key in (("sampled rates", "rates"), ("increments", "increments")):
            if scene in record.scenes:
                limit = number(record.limits[key])
                yield f"| {record.name} | {scene} | {limit} | | StepWarning | |"
    yield ""


# the least error of each precision


SECONDS = 20.0
LADDER = [2**k for k in range(5, 16)]


def ends_of_cones(case: Case) -> Iterable[tuple[float, float]]:
    """(|w|h, largest error at the end) on the cones, 1 rad/s about their axes."""
    a, one = single(CONES), np.ones(3)
    q0 = mul(START, cone(a, 0.0 * a))
    truth = mul(START, cone(a, SECONDS * one))
    scene = rates(a, one, np.zeros((3, 3)))
    for n in LADDER:
        got = propagate(case, scene, q0, dt=SECONDS / n, n_steps=n)
        yield SECONDS / n * 2.0 * math.sin(0.5 * a.max()), float(angle(got.q[-1], truth).max())


def ends_of_bodies(case: Case) -> Iterable[tuple[float, float]]:
    """The same of body V turning at 1 rad/s in 11 directions."""
    w0 = single(spins(np.array(V)))
    q0 = np.tile(START, (len(w0), 1))
    inertia = single(np.tile(V, (len(w0), 1)))
    truth, _ = closed(inertia, q0, w0, SECONDS)
    for n in LADDER:
        got = propagate(case, fa.Scene(inertia=inertia), q0, w0, dt=SECONDS / n, n_steps=n)
        yield SECONDS / n, float(angle(got.q[-1], truth).max())


def ends_of_logs(case: Case) -> Iterable[tuple[float, float]]:
    """The same of a log of the cone of 1 rad."""
    increments = "sampled rates" not in case.record.scenes
    for n in LADDER:
        data, q0, truth, h = coning_log(1.0, 1.0, SECONDS / n, n, increments=increments)
        q = fa.integrate_rates(
            data, h, q0, method=case.method, increments=increments, dtype=case.dtype, n_threads=1
        )
        yield h * 2.0 * math.sin(0.5), float(angle(q[-1], truth[-1]))


def floors_table(methods: Iterable[Method]) -> Iterable[str]:
    """Where rounding takes over, for each method and both precisions, on quaternions."""
    yield from ("## The least error of each precision", "")
    yield (
        f"Largest error after {SECONDS:g} s on the cones (1 rad/s about their axes), of body V "
        "(1 rad/s, 11 directions) and of logs of the cone of 1 rad, at the best of steps from "
        "20/32 to 20/32768 s, and its |w|h: a smaller step gains nothing."
    )
    yield from ("", "| method | for | float64, rad | at | float32, rad | at |")
    yield "| --- | --- | --- | --- | --- | --- |"
    kinds = {
        "rate": ("rates", ends_of_cones),
        "free": ("bodies", ends_of_bodies),
        "sampled rates": ("sampled rates", ends_of_logs),
        "increments": ("increments", ends_of_logs),
    }
    for record in methods:
        logs = "sampled rates" in record.scenes  # which say as much as increments
        scenes = [s for s in kinds if s in record.scenes and (s != "increments" or not logs)]
        for scene in scenes:
            name, run = kinds[scene]
            cells = []
            for dtype in ("float64", "float32"):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    at, least = min(run(Case(record.name, dtype=dtype)), key=lambda x: x[1])
                cells += [f"{least:.0e}", f"{at:.0e}" if record.order else "any"]
            yield f"| {record.name} | {name} | {' | '.join(cells)} |"
    yield ""


def count_table(rows: Mapping[Case, Mapping[tuple[str, str], Outcome]]) -> Iterable[str]:
    """How many cells each of the tables has."""
    yield from ("## What was run", "", "| table | cells | with a flag | **wrong** |")
    yield "| --- | --- | --- | --- |"
    for table in TABLES:
        cells = [
            x for row in rows.values() for (title, _), x in row.items() if title == table.title
        ]
        flagged = sum(bool(cell.status.any()) for cell in cells)
        wrong = sum(bool(cell.wrong.any()) for cell in cells)
        yield f"| {table.title} | {len(cells)} | {flagged} | {wrong} |"
    yield ""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a method of each sort, in float64")
    parser.add_argument("--long", action="store_true", help="energy over 10^7 steps too")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at once")
    parser.add_argument("--page", type=Path, default=ROOT / "bench", help="folder of the summary")
    parser.add_argument("--out", type=Path, default=ROOT / "results", help="folder of all tables")
    parser.add_argument(
        "--method", default="", help="only its rows, which are printed, not written"
    )
    parser.add_argument("--coefficients", metavar="METHOD", help="print what its tables need")
    options = parser.parse_args(arguments)
    if options.coefficients:
        for representation in fa.METHODS[options.coefficients].representations:
            if representation in ANGLES:  # they have a promise of their own
                continue
            case = Case(options.coefficients, representation)
            print(*case[:2], *(f"{name} {x:.2g}" for name, x in coefficients(case)))
        return 0
    every = cases(quick=options.quick, method=options.method)
    # a process ends after some rows: what was compiled stays in its memory
    with multiprocessing.get_context("spawn").Pool(options.jobs, maxtasksperchild=8) as pool:
        rows = {}
        for case, cells in zip(every, pool.imap(row, every), strict=True):
            rows[case] = cells
            print(len(rows), "of", len(every), *case, file=sys.stderr)
    outcomes = [cell for cells in rows.values() for cell in cells.values()]
    wrong = sum(bool(cell.wrong.any()) for cell in outcomes)
    methods = dict.fromkeys(case.record for case in every)
    summary = [HEADER.format(wrong=wrong, total=len(outcomes)), *limits_table(methods)]
    summary += [*floors_table(methods), *count_table(rows)]
    summary += energy_table(10_000_000 if options.long else 100_000, methods)
    titles = {title for cells in rows.values() for title, _ in cells}
    tables = [line for table in TABLES if table.title in titles for line in lines(table, rows)]
    if not options.method:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "extremes.md").write_text("\n".join(tables), encoding="utf-8")
        (options.page / "EXTREMES.md").write_text("\n".join(summary), encoding="utf-8")
    print("\n".join([*summary, *(tables if options.method else ())]))
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
