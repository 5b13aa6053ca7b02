"""When a run steps and saves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.engine.tape import Breaks, Legs, Times, legs_of

#: saves that are in memory at a time in a run without a history
RING = 16
#: options that do not combine, and what is accepted
FORBIDDEN = (
    ("n_steps", "t_end", "one of them"),
    ("save_every", "save_at", "one of them"),
    ("save_every", "dt (N,)", "save_at"),
    ("on_save", "dt (N,)", "one step size"),
    ("checkpoint", "dt (N,)", "one step size"),
    ("compensated", "representation", '"quat"'),
)
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Schedule:
    """The steps and saves of a run that begins after ``done`` steps.

    Saves are made at the start and at every so many steps from step 0 on, or at the times
    ``save_at``, or at the end only.
    """

    #: the step size, s, of all bodies or of each
    dt: NDArray[np.float64]
    #: the number of further steps, of the body with the smallest
    n_steps: int
    #: the time of the end since step 0, s, with slack for its rounding
    duration: float
    rounding: float
    every: int | None = None
    #: the times of saves, s, and these as ``at``
    save_at: NDArray[np.float64] | None = None
    saves_at: tuple[Times, Times] | None = None
    done: int = 0
    #: the time of the end, s, if the last step is shorter
    t_end: float | None = None

    @cached_property
    def h(self) -> float:
        """The smallest step size, s."""
        return float(self.dt[np.abs(self.dt).argmin()])

    @property
    def is_per_body(self) -> bool:
        """Whether step sizes are per body."""
        return self.dt.size > 1

    @property
    def end(self) -> int:
        """Index of the last step."""
        return self.done + self.n_steps

    @property
    def saves(self) -> int:
        """The number of saves; memory may not hold a list of them."""
        if self.save_at is not None:
            return self.save_at.size
        if self.every is None or not self.n_steps:
            return 1
        return 2 + (self.end - 1) // self.every - self.done // self.every

    @cached_property
    def at(self) -> tuple[Times, Times]:
        """Times of the saves since step 0, s, and the slack for their rounding."""
        if self.saves_at is not None:
            return self.saves_at
        counts: list[int] = []
        if self.every is not None and self.n_steps:
            later = (self.done // self.every + 1) * self.every
            counts = [self.done, *range(later, self.end, self.every)]
        with np.errstate(over="ignore"):
            since = np.array(counts, dtype=np.float64) * self.h
            slack = np.append(16.0 * _EPS * np.abs(since), self.rounding)
            return np.append(since, self.duration), slack

    @cached_property
    def batches(self) -> list[tuple[int, int]]:
        """(first, end) of saves that are in memory at a time: ``RING``, and others of their step.

        The initial save is one more of the first batch.
        """
        since, slack = self.at
        steps = np.ceil((np.abs(since) - slack) / abs(self.h))
        ends = np.append(np.flatnonzero(np.diff(steps)) + 1, self.saves)
        cuts, least = [0], 1 + RING
        while cuts[-1] < self.saves:
            k = min(int(np.searchsorted(ends, least)), ends.size - 1)
            cuts.append(int(ends[k]))
            least = cuts[-1] + RING
        return list(pairwise(cuts))

    @property
    def slots(self) -> NDArray[np.int64]:
        """The place of each save in the memory of its batch."""
        return np.concatenate([np.arange(end - first) for first, end in self.batches])

    def times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s, if step 0 begins at ``t0``.

        Raises ``ValueError`` if they overflow.
        """
        if self.save_at is not None:
            return self.save_at
        if not math.isfinite(t0 + self.duration):
            raise ValueError(
                f"dt: {self.end} steps of {self.h} s from {t0} s overflow; accepted: shorter"
            )
        times = self.at[0] + t0
        if self.t_end is not None:
            times[-1] = self.t_end
        return times

    def groups(self, bodies: int, most: int) -> Iterator[tuple[Any, float]]:
        """Bodies that are run together, by their rows, and their step size."""
        if self.is_per_body:
            for h in sorted(np.unique(self.dt).tolist(), key=abs):
                yield np.flatnonzero(self.dt == h), h
            return
        for first in range(0, bodies, most):
            yield slice(first, min(first + most, bodies)), self.h

    def legs(self, h: float, breaks: Breaks) -> Legs:
        """The legs of the steps from step 0 on, of bodies with the step size h, s."""
        count, is_whole = self.end, self.t_end is None
        if self.is_per_body:
            count, is_whole = whole_steps(self.duration, h, self.rounding)
        return legs_of(h, int(count), breaks, None if is_whole else self.duration)


def refuse_pairs(is_given: Mapping[str, bool]) -> None:
    """Raise ``ValueError`` if two options of ``FORBIDDEN`` are given."""
    for first, second, accepted in FORBIDDEN:
        if is_given.get(first) and is_given.get(second):
            raise ValueError(f"{first}: found with {second}; accepted: {accepted}")


def schedule_of(
    dt: Any, n_steps: Any = None, t_end: Any = None, save_every: Any = None, save_at: Any = None,
    *, t0: float = 0.0, bodies: int = 1, done: int = 0,
) -> Schedule:  # fmt: skip
    """The schedule of a run of ``bodies``, of which ``done`` steps since time ``t0`` were taken.

    Raises ``ValueError`` and ``TypeError`` for arguments that do not fit.
    """
    sizes = _step_sizes(dt, bodies)
    arguments = {"n_steps": n_steps, "t_end": t_end, "save_every": save_every, "save_at": save_at}
    is_given = {name: value is not None for name, value in arguments.items()}
    refuse_pairs({**is_given, "dt (N,)": sizes.size > 1})
    if save_every is not None:
        save_every = checks.whole("save_every", save_every, 1)
    if save_at is not None:
        save_at = checks.array("save_at", save_at, "(S,) times, s").astype(np.float64)
    if n_steps is not None:
        end, counts = None, done + _counts(n_steps, sizes.size)
        duration, slack = _duration(counts, sizes)
    else:
        end = _end(t_end, save_at, t0, sizes[0])
        duration, slack = end - t0, 16.0 * _EPS * (abs(end) + abs(t0))
        counts, is_whole = whole_steps(duration, sizes, slack)
        if is_whole.all():
            end = None
            duration = duration if sizes.size > 1 else float(counts[0] * sizes[0])
    places = None
    if save_at is not None:
        if not math.isfinite(t0 + duration):
            raise ValueError(f"dt: the run overflows at {t0} + {duration} s; accepted: shorter")
        save_at = _times(save_at, t0 + done * float(sizes[0]), t0 + duration)
        places = save_at - t0, 16.0 * _EPS * (np.abs(save_at) + abs(t0))
    n_steps = int(counts.max()) - done
    return Schedule(sizes, n_steps, duration, slack, save_every, save_at, places, done, end)


def whole_steps(duration: Any, dt: Any, slack: float) -> tuple[Any, Any]:
    """(steps in a duration, the last of which may be shorter; whether it is not, to rounding)."""
    with np.errstate(over="ignore"):
        exact = np.abs(duration / dt)
    if not np.max(exact) < 2.0**63:
        raise ValueError(
            f"dt, t_end: found {np.max(exact):.3g} steps in {duration:g} s; accepted: fewer than "
            "2**63"
        )
    nearest = np.rint(exact)
    is_whole = np.abs(duration - nearest * dt) <= slack * (nearest > 0.0)
    return np.where(is_whole, nearest, np.ceil(exact)).astype(np.int64), is_whole


def after(t_end: Any, t0: float, dt: float = 1.0) -> float:
    """The time of the end of a run, s, after the start in the direction of the steps."""
    end = checks.real("t_end", t_end)
    if not (end > t0 if dt > 0.0 else end < t0):
        where = "after" if dt > 0.0 else "before"
        raise ValueError(f"t_end: found {end}; accepted: a time {where} t0, {t0}")
    return end


def _step_sizes(dt: Any, bodies: int) -> NDArray[np.float64]:
    """The step size (1,), or those of the bodies (N,), s."""
    if not isinstance(dt, (list, tuple)) and getattr(dt, "ndim", 0) == 0:
        return np.array([checks.real("dt", dt, zero=False)])
    sizes = checks.array("dt", dt, "a number or (N,)").astype(np.float64)
    sizes = np.ascontiguousarray(np.atleast_1d(sizes))
    if sizes.size not in (1, bodies):
        raise ValueError(f"dt: found {sizes.size} steps; accepted: one, or {bodies} of the bodies")
    if not ((sizes > 0.0).all() or (sizes < 0.0).all()):
        raise ValueError("dt: found steps of both signs or 0; accepted: all above 0, or all below")
    return sizes


def _duration(counts: NDArray[np.int64], sizes: NDArray[np.float64]) -> tuple[float, float]:
    """The duration of a run by its numbers of steps, s, and the slack for its rounding."""
    with np.errstate(over="ignore", invalid="ignore"):
        durations = counts * sizes
        apart = np.ptp(durations) if sizes.size > 1 else 0.0
    duration = float(durations[0])
    slack = 16.0 * _EPS * abs(duration)
    if not apart <= slack:
        b = int(np.abs(durations - duration).argmax())
        raise ValueError(
            f"n_steps: body {b} ends after {durations[b]:.17g} s, body 0 after {duration:.17g} s; "
            "accepted: dt * n_steps the same of all bodies, to rounding"
        )
    return duration, slack


def _end(t_end: Any, save_at: NDArray[np.float64] | None, t0: float, dt: float) -> float:
    """The time of the end, s: ``t_end``, or else the last save."""
    if t_end is not None:
        return after(t_end, t0, dt)
    if save_at is None:
        raise ValueError("n_steps, t_end: found neither; accepted: one of them")
    last = float(save_at[-1])
    return last if (last - t0) * dt > 0.0 else t0  # the save is refused, if it is not at t0


def _counts(n_steps: Any, n: int) -> NDArray[np.int64]:
    if not isinstance(n_steps, (list, tuple)) and getattr(n_steps, "ndim", 0) == 0:
        return np.full(n, checks.whole("n_steps", n_steps, 0), dtype=np.int64)
    counts = checks.numbers("n_steps", n_steps, f"a whole number, or ({n},) of them")
    if counts.shape != (n,) or not ((counts >= 0) & (counts == np.rint(counts))).all():
        raise ValueError(
            f"n_steps: found {checks.brief(n_steps)}; accepted: a whole number, or ({n},) of them, "
            "at least 0"
        )
    return counts.astype(np.int64)


def _times(times: NDArray[np.float64], begin: float, end: float) -> NDArray[np.float64]:
    way = 1.0 if end >= begin else -1.0
    slack = 16.0 * _EPS * (abs(begin) + abs(end))
    outside = (way * times < way * begin - slack) | (way * times > way * end + slack)
    if outside.any():
        k, (first, last) = int(outside.argmax()), sorted((begin, end))
        raise ValueError(
            f"save_at[{k}] is {times[k]:.17g}; accepted: from {first:.17g} to {last:.17g}"
        )
    if (way * np.diff(times) < 0.0).any():
        raise ValueError("save_at: found times out of order; accepted: in the order of the run")
    return np.ascontiguousarray(times)
