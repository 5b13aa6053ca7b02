"""One method on an ensemble with a known solution: error, drift and time over a ladder of steps."""

from __future__ import annotations

import math
import os
import platform
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.codegen.processor import processor
from fastatt.engine.status import Status
from fastatt.files import write_csv
from fastatt.invariants.drift import drift
from fastatt.methods import METHODS, Method
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.propagate import propagate
from fastatt.propagation.trajectory import Trajectory
from fastatt.rounding import noted
from fastatt.scene.scene import Scene
from fastatt.threads import default_threads
from fastatt.trade.timing import Times, once

_SAVES = 8  # saves at which the drift is measured
PLATEAU, REFERENCE = "round-off", "reference"
# error of any attitude, in units of rounding
_ROUNDED = 20.0
# an error that rounding limits is better than another only by this factor
_CLEAR = 4.0


class Case(NamedTuple):
    """What is measured: a method on a representation in a precision.

    The method is a name or a user-defined method.
    """

    method: str | Method
    representation: str = "quat"
    dtype: str = "float64"

    @property
    def record(self) -> Method:
        """The method's record."""
        return self.method if isinstance(self.method, Method) else METHODS[self.method]

    @property
    def name(self) -> str:
        """The method's name."""
        return self.record.name

    def __str__(self) -> str:
        return f"{self.name} ({self.representation}, {self.dtype})"


class State(NamedTuple):
    """Attitudes (..., 4) and, if they are part of the state, angular velocities (..., 3), rad/s."""

    q: NDArray[Any]
    w: NDArray[Any] | None = None


#: rad/s; the square of a faster rate is no number
_FASTEST = 1e150


@dataclass(frozen=True)
class Problem:
    """An ensemble, with a row for each body, from t0 to t0 + duration, s."""

    ensemble: Ensemble
    duration: float
    t0: float = 0.0
    n_threads: int | None = None

    def __post_init__(self) -> None:
        if self.ensemble.w0 is not None:
            w0 = np.asarray(self.ensemble.w0, dtype=np.float64)
            checks.refuse("w0", w0, np.abs(w0) > _FASTEST, f"up to {_FASTEST:g} rad/s")

    def run(
        self, case: Case, n_steps: Any, save_every: int | None = None, save_at: Any = None
    ) -> Trajectory:
        """Propagate in ``n_steps`` equal steps, without warnings of large steps."""
        e = self.ensemble
        with noted():
            return propagate(
                e.scene, **e.initial, dt=self.duration / n_steps, n_steps=n_steps,
                method=case.method, representation=case.representation, dtype=case.dtype,
                save_every=save_every, save_at=save_at, n_threads=self.n_threads, t0=self.t0,
            )  # fmt: skip

    def take(self, rows: NDArray[np.intp]) -> Problem:
        """The problem of some of the bodies."""
        return replace(self, ensemble=self.ensemble.take(rows))


def top(values: NDArray[np.float64], quantile: float) -> float:
    """The largest of the values, or the smallest that so large a share does not exceed."""
    return float(np.sort(values)[math.ceil(quantile * values.size) - 1])


def last_state(run: Trajectory) -> State:
    """The final attitudes, and the angular velocities that are part of the state."""
    return State(run.q[-1], run.w[-1] if "w" in run.carried else None)


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method with one step size on an ensemble.

    Attributes
    ----------
    input : str
        The ensemble.
    method, representation, dtype : str
        The case.
    dt : float
        Step size, s.
    n_steps : int
        Number of steps.
    error_median, error_max : float
        Angles at the end, rad: median and largest of the bodies.
    rate_error_max : float or None
        Largest error of the angular velocity at the end, rad/s.
    norm_error_max : float
        Largest ``||q| − 1|`` or ‖C Cᵀ − 1‖ over the run.
    energy_drift_max, momentum_drift_max : float or None
        Largest relative drift, of the angular momentum or of its component along a uniform field;
        None if the scene does not conserve it.
    seconds_per_body : float
        CPU time of one thread for each body, s, the least of several.
    seconds_lower, seconds_upper : float or None
        The first and the third quartile of the times.
    call_share : float or None
        The share of a call in one step of one body in the time of the run.
    step_evaluations, evaluations : int
        Evaluations of the right-hand side in a step, and in the run of a body.
    order : float or None
        Order from the row before.
    plateau : str
        "round-off" if a smaller step does not reduce the error; "reference" if the error of the
        reference hides whether it does.
    status : str
        Number of bodies with each flag.
    """

    input: str
    method: str
    representation: str
    dtype: str
    dt: float
    n_steps: int
    error_median: float
    error_max: float
    rate_error_max: float | None
    norm_error_max: float = 0.0
    energy_drift_max: float | None = None
    momentum_drift_max: float | None = None
    seconds_per_body: float
    seconds_lower: float | None = None
    seconds_upper: float | None = None
    call_share: float | None = None
    step_evaluations: int = 0
    evaluations: int = 0
    order: float | None = None
    plateau: str = ""
    status: str = ""

    @property
    def drift(self) -> float:
        """The largest of the norm error and the drifts of energy and momentum."""
        every = self.norm_error_max, self.energy_drift_max, self.momentum_drift_max
        return max(x for x in every if x is not None)

    @property
    def is_sound(self) -> bool:
        """Whether no body has a flag."""
        return not self.status and math.isfinite(self.error_max)

    @property
    def is_exact(self) -> bool:
        """Whether the method is a closed form, which takes no steps."""
        return self.method in METHODS and METHODS[self.method].is_exact


def row_of(
    name: str,
    case: Case,
    duration: float,
    n_steps: int,
    seconds: float,
    error: NDArray[np.float64],
    rate_error: NDArray[np.float64] | None = None,
    scene: str = "rate",
    **measured: Any,
) -> Row:
    """The row of one run without its order, from errors (N,) and the time for all bodies.

    ``scene`` is its kind, on which evaluations depend.
    """
    return Row(
        input=name,
        method=case.name,
        representation=case.representation,
        dtype=case.dtype,
        dt=duration / n_steps,
        n_steps=n_steps,
        step_evaluations=case.record.evaluations(scene),
        evaluations=case.record.evaluations(scene) * n_steps,
        error_median=float(np.median(error)),
        error_max=float(np.max(error)),
        rate_error_max=None if rate_error is None else float(np.max(rate_error)),
        seconds_per_body=seconds / error.size,
        **measured,
    )


def measure(problem: Problem, end: State, case: Case, n_steps: int, name: str = "") -> Row:
    """Run a case for its drift, then for its error and one time with the final state alone."""
    saved = problem.run(case, n_steps, max(1, n_steps // _SAVES))
    lost = bool((saved.status & Status.NON_FINITE).any())
    drifts = {} if lost else drifts_of(saved, problem.ensemble.scene)
    seconds, result = once(partial(problem.run, case, n_steps))
    last = last_state(result)
    return row_of(
        name, case, problem.duration, n_steps, seconds,
        angle_between(last.q, end.q),
        None if end.w is None else np.linalg.norm(last.w - end.w, axis=-1),
        problem.ensemble.scene.kind,
        norm_error_max=float(np.abs(saved.norm_error).max()),
        status=counted(result.status_counts()),
        **{f"{name}_drift_max": float(values.max()) for name, values in drifts.items()},
    )  # fmt: skip


def drifts_of(run: Trajectory, scene: Scene) -> dict[str, NDArray[Any]]:
    """Drifts (S, N) of "energy" and "momentum", as far as the motion conserves them.

    The momentum is the angular momentum, or else its component along a uniform field.
    """
    measured = drift(run, scene)
    momentum = measured.momentum
    if momentum is None:
        momentum = measured.momentum_along_field
    every = {"energy": measured.energy, "momentum": momentum}
    return {name: values for name, values in every.items() if values is not None}


def counted(flags: Mapping[str, int]) -> str:
    """How many bodies carry each flag, as text."""
    return ", ".join(f"{name} {count}" for name, count in flags.items())


def is_flat(case: Case, order: float, coarse: tuple[int, float], fine: tuple[int, float]) -> bool:
    """Whether rounding keeps the error from falling; both arguments are (steps, error in rad)."""
    (n, before), (m, after) = coarse, fine
    eps = float(np.finfo(case.dtype).eps)
    steep = after < before * (n / m) ** (0.75 * order)
    # rad that rounding may sum up to; smaller errors may not be the method's
    summed = 100.0 * eps * (50.0 + m)
    return (not steep and after < summed) or after < _ROUNDED * eps


def with_times(row: Row, times: Times, alone: Times, size: int) -> Row:
    """A row with times of a run of so many bodies, and of a call in few steps of one body."""
    least, lower, upper = (x / size for x in times)
    return replace(
        row, seconds_per_body=least, seconds_lower=lower, seconds_upper=upper,
        call_share=min(1.0, alone.least / times.least),
    )  # fmt: skip


def with_orders(rows: Sequence[Row], case: Case, order: int, unresolved: float = 0.0) -> list[Row]:
    """Rows of falling steps with their observed orders; ``order`` is the declared one.

    ``unresolved`` is the error, rad, below which the reference cannot tell a method's error.
    """
    points = [(r.n_steps, r.error_median) for r in rows]
    flat = [False] * len(points)
    for i in range(1, len(points)):
        flat[i] = flat[i - 1] or is_flat(case, order, points[i - 1], points[i])
        flat[i] |= points[i][1] <= unresolved
    # a row with hardly a larger error than the next ones belongs to the plateau
    for i in range(len(points) - 1):
        level = max((e for _, e in points[i + 1 :]), default=0.0)
        flat[i] |= flat[i + 1] and points[i][1] <= 4.0 * level
    ordered = []
    for i, row in enumerate(rows):
        observed = None
        if i and row.error_median > 0.0 and not flat[i]:
            fall = math.log(points[i - 1][1] / row.error_median)
            observed = fall / math.log(row.n_steps / points[i - 1][0])
        limit = REFERENCE if row.error_median <= 4.0 * unresolved else PLATEAU
        ordered.append(replace(row, order=observed, plateau=limit if flat[i] else ""))
    return ordered


_POWER = "{:.1e}".format


def _microseconds(x: float) -> str:
    return f"{x * 1e6:.3g}"


#: heading and text of a value, by the field or property of a row
_COLUMNS: dict[str, tuple[str, Callable[[Any], str]]] = {
    "input": ("input", str),
    "method": ("method", str),
    "representation": ("rep", str),
    "dtype": ("dtype", str),
    "quantity": ("quantity", str),
    "dt": ("dt, s", "{:.4g}".format),
    "error_median": ("median, rad", "{:.2e}".format),
    "error_max": ("error, rad", _POWER),
    "rate_error_max": ("w, rad/s", _POWER),
    "norm_error_max": ("norm_error", _POWER),
    "energy_drift_max": ("energy", _POWER),
    "momentum_drift_max": ("momentum", _POWER),
    "drift": ("drift", _POWER),
    "growth": ("growth", str),
    "seconds_per_body": ("µs/body", _microseconds),
    "seconds_lower": ("25 %", _microseconds),
    "seconds_upper": ("75 %", _microseconds),
    "call_share": ("call", "{:.1%}".format),
    "step_evaluations": ("evals/step", lambda x: str(x or "")),
    "evaluations": ("evals", lambda x: str(x or "")),
    "order": ("order", "{:.2f}".format),
    "plateau": ("limit", str),
    "status": ("status", str),
}
#: the columns that tell methods apart
BRIEF = "method", "representation", "dtype", "dt", "error_max", "drift", "seconds_per_body"


def table(rows: Sequence[Any], names: Sequence[str] | None = None) -> str:
    """The rows of one dataclass as text, all fields or those of ``names``, no empty columns."""
    texts = []
    for name in names or [f.name for f in fields(rows[0]) if f.name in _COLUMNS]:
        head, text = _COLUMNS[name]
        values = [getattr(row, name) for row in rows]
        cells = ["" if value is None else text(value) for value in values]
        if any(cells):
            left = isinstance(values[0], str)
            width = max(map(len, (head, *cells)))
            texts.append([c.ljust(width) if left else c.rjust(width) for c in (head, *cells)])
    return "\n".join(" ".join(line).rstrip() for line in zip(*texts, strict=True))


def frontier(rows: Iterable[Row]) -> list[Row]:
    """The rows for which no row is better in both time and largest error, fastest first.

    Rows with a flag are left out. Where rounding limits one of two errors, only an error that is
    smaller by a factor of 4 is better.
    """
    best: list[Row] = []
    sound = [row for row in rows if row.is_sound]
    for row in sorted(sound, key=attrgetter("seconds_per_body", "error_max")):
        is_rounded = bool(best) and bool(row.plateau or best[-1].plateau)
        margin = _CLEAR if is_rounded else 1.0
        if not best or margin * row.error_max < best[-1].error_max:
            best.append(row)
    return best


def draw(rows: Sequence[Row], duration: float, heading: str, path: str | Path) -> None:
    """Draw error against time and against evaluations, with a curve for each method.

    A panel is for each representation. Curves leave out rows with a flag, and end where rounding
    limits the error. A method leads where it has a part of the frontier, of all methods or of those
    that take steps.
    """
    from fastatt.plots import study

    curves: dict[tuple[str, str], list[Row]] = {}
    for row in (row for row in rows if row.is_sound):
        method = row.method + " in float32" * (row.dtype == "float32")
        curve = curves.setdefault((row.representation, method), [])
        if not (curve and curve[-1].plateau and 2.0 * row.error_max > curve[-1].error_max):
            curve.append(row)
    drawn, label = [], "largest attitude error at the end, rad"
    of_time = f"time per body for {duration:g} s of motion, µs"
    of_calls = f"evaluations of the right-hand side for {duration:g} s of motion"
    for (name, method), curve in curves.items():
        beside = [row for row in rows if row.representation == name]
        best = [*frontier(beside), *frontier(row for row in beside if not row.is_exact)]
        times = [row.seconds_per_body * 1e6 for row in curve]
        errors, leads = [row.error_max for row in curve], any(row in best for row in curve)
        drawn.append(study.Curve(label, of_time, name, method, times, errors, leads))
        if calls := [row.evaluations for row in curve if row.evaluations]:
            drawn.append(study.Curve(label, of_calls, name, method, calls, errors, leads))
    study.draw(drawn, heading, path)


def to_csv(path: str | Path, rows: Sequence[Any]) -> None:
    """Write rows of one dataclass, with a line of names, as CSV."""
    write_csv("path", path, [f.name for f in fields(rows[0])] if rows else (), map(astuple, rows))


def machine_line(n_threads: int | None = None) -> str:
    """The machine, and so many of its threads or those that a run may use, in one line."""
    threads = "" if n_threads else f", {default_threads()} of {os.cpu_count() or 1} threads"
    return f"{processor_line(n_threads)}{threads}, Python {platform.python_version()}"


def processor_line(n_threads: int | None = None) -> str:
    """The processor's name, after the number of threads where it is given."""
    info = Path("/proc/cpuinfo")
    known = re.search(r"model name\s*: (.*)", info.read_text() if info.exists() else "")
    model = known[1] if known else platform.processor() or platform.machine()
    threads = "" if n_threads is None else f"{n_threads} thread{'s' * (n_threads > 1)} of "
    return f"{threads}{model} ({processor().name})"
