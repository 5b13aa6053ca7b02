"""One method on an ensemble with a known answer: error, drift and time over a ladder of steps."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between
from fastatt.drift import drift
from fastatt.propagate import propagate
from fastatt.scene import Scene

if TYPE_CHECKING:
    from fastatt import plots

_SAVES = 8  # at which the drift is looked at
# medians below so many units of round-off say nothing of the order
_ROUND_OFF = 5000.0
_DRAWN = ("quat", "dcm")


class Case(NamedTuple):
    """What is measured: a method on a representation in a precision."""

    method: str
    representation: str = "quat"
    dtype: str = "float64"


@dataclass(frozen=True)
class Problem:
    """An ensemble and where it is at ``t_end``; rate scenes have no angular velocities."""

    name: str
    scene: Scene
    q0: NDArray[np.float64]
    w0: NDArray[np.float64] | None
    t_end: float
    q_end: NDArray[np.float64]
    w_end: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Rung:
    """What one case did at one step; errors are (N,)."""

    n_steps: int
    seconds: float
    error: NDArray[np.float64]
    defect: float = 0.0
    rate_error: NDArray[np.float64] | None = None
    energy: float | None = None
    momentum: float | None = None
    flagged: int = 0


@dataclass(frozen=True)
class Row:
    """One method at one step on an ensemble.

    Errors are those at the end: angles in rad, angular velocities in rad/s. ``defect`` is the
    largest | |q| − 1 | or ‖C Cᵀ − 1‖ on the way; the drifts of energy and momentum, relative, are
    empty where the scene keeps neither. ``flagged`` counts the bodies whose status is not 0.
    """

    input: str
    method: str
    representation: str
    dtype: str
    dt: float
    error_median: float
    error_max: float
    rate_error_median: float | None
    defect_max: float
    energy_drift_max: float | None
    momentum_drift_max: float | None
    seconds_per_body: float
    steps_per_second: float
    order: float | None
    flagged: int


def best_time(call: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Shortest of a few runs after a warm-up, and the result."""
    result = call()
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        result = call()
        times.append(perf_counter() - begin)
    return min(times), result


def measure(problem: Problem, case: Case, n_steps: int, repeats: int) -> Rung:
    """Run a case for its drift, then for its time and error with the final state alone."""

    def run(save_every: int | None = None) -> Any:
        return propagate(
            problem.scene,
            problem.q0,
            problem.w0,
            dt=problem.t_end / n_steps,
            n_steps=n_steps,
            method=case.method,
            representation=case.representation,
            dtype=case.dtype,
            save_every=save_every,
        )

    watched = run(max(1, n_steps // _SAVES))
    kept = drift(watched, problem.scene)
    seconds, result = best_time(run, repeats)
    rate_error = None
    if problem.w_end is not None:
        rate_error = np.linalg.norm(result.w[-1] - problem.w_end, axis=-1)
    return Rung(
        n_steps=n_steps,
        seconds=seconds,
        error=angle_between(result.q[-1], problem.q_end),
        defect=float(np.abs(watched.defect).max()),
        rate_error=rate_error,
        energy=None if kept.energy is None else float(kept.energy.max()),
        momentum=None if kept.momentum is None else float(kept.momentum.max()),
        flagged=int(np.count_nonzero(result.status)),
    )


def ladder_rows(name: str, case: Case, t_end: float, ladder: Sequence[Rung]) -> list[Row]:
    """Rows of a ladder of falling steps, with the order from each rung to the next."""
    rows = []
    floor = _ROUND_OFF * float(np.finfo(case.dtype).eps)
    for i, rung in enumerate(ladder):
        median = float(np.median(rung.error))
        order = None
        if i and median > floor:
            before = ladder[i - 1]
            fall = math.log(float(np.median(before.error)) / median)
            order = fall / math.log(rung.n_steps / before.n_steps)
        rate = rung.rate_error
        rows.append(
            Row(
                input=name,
                method=case.method,
                representation=case.representation,
                dtype=case.dtype,
                dt=t_end / rung.n_steps,
                error_median=median,
                error_max=float(np.max(rung.error)),
                rate_error_median=None if rate is None else float(np.median(rate)),
                defect_max=rung.defect,
                energy_drift_max=rung.energy,
                momentum_drift_max=rung.momentum,
                seconds_per_body=rung.seconds / rung.error.size,
                steps_per_second=rung.error.size * rung.n_steps / rung.seconds,
                order=order,
                flagged=rung.flagged,
            )
        )
    return rows


_COLUMNS: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("input", "input", str),
    ("method", "method", str),
    ("rep", "representation", str),
    ("dtype", "dtype", str),
    ("dt, s", "dt", lambda x: f"{x:.4f}"),
    ("median, rad", "error_median", lambda x: f"{x:.2e}"),
    ("max, rad", "error_max", lambda x: f"{x:.1e}"),
    ("w, rad/s", "rate_error_median", lambda x: f"{x:.1e}"),
    ("defect", "defect_max", lambda x: f"{x:.1e}"),
    ("energy", "energy_drift_max", lambda x: f"{x:.1e}"),
    ("momentum", "momentum_drift_max", lambda x: f"{x:.1e}"),
    ("order", "order", lambda x: f"{x:.2f}"),
    ("M steps/s", "steps_per_second", lambda x: f"{x / 1e6:.3g}"),
    ("flagged", "flagged", lambda x: str(x) if x else ""),
)


def trade_table(rows: Sequence[Row]) -> str:
    """The rows as text, without the columns that none of them fills."""
    columns = []
    for head, name, text in _COLUMNS:
        values = [getattr(row, name) for row in rows]
        cells = ["" if value is None else text(value) for value in values]
        if any(cells):
            left = isinstance(values[0], str)
            width = max(map(len, (head, *cells)))
            columns.append([c.ljust(width) if left else c.rjust(width) for c in (head, *cells)])
    return "\n".join(" ".join(line).rstrip() for line in zip(*columns, strict=True))


def frontier(rows: Iterable[Row]) -> list[Row]:
    """The rows that no other beats in both error and time, fastest first."""
    best: list[Row] = []
    finite = [r for r in rows if math.isfinite(r.error_median)]
    for row in sorted(finite, key=lambda r: (r.seconds_per_body, r.error_median)):
        if not best or row.error_median < best[-1].error_median:
            best.append(row)
    return best


def panel(title: str, t_end: float, rows: Sequence[Row]) -> plots.Panel:
    """A curve for each method on quaternions and on matrices in float64, and their frontier."""
    from fastatt import plots

    drawn = [r for r in rows if r.representation in _DRAWN and r.dtype == "float64"]
    groups: dict[tuple[str, str], list[Row]] = {}
    for r in drawn:
        groups.setdefault((r.method, r.representation), []).append(r)
    ladders = [_ladder(*key, own) for key, own in groups.items()]
    return plots.Panel(title, t_end, ladders, _ladder("", "", frontier(drawn)))


def _ladder(method: str, rep: str, rows: Sequence[Row]) -> plots.Ladder:
    from fastatt import plots

    return plots.Ladder(
        method, rep, [r.seconds_per_body for r in rows], [r.error_median for r in rows]
    )


def write_csv(path: Path, rows: Sequence[Any]) -> None:
    """Rows of one dataclass with a line of names."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(rows[0])])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
