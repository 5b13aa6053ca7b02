"""The options of a run: its method, its steps and saves, its threads."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.engine.tape import Breaks, Legs, legs_of, on_grid
from fastatt.methods.method import Method
from fastatt.propagation.event import Event
from fastatt.propagation.trajectory import Trajectory

if TYPE_CHECKING:
    from fastatt.propagation.end import End

#: saves that are in memory at a time in a run without a history
RING = 16
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Choice:
    """How a scene is propagated: its method, representation, and projection.

    The state is projected every ``projection`` steps (never if that is 0), and for output unless
    ``raw``.
    """

    method: Method
    attitude: Attitude
    projection: int = 0
    raw: bool = False
    events: tuple[Event, ...] = ()


@dataclass(frozen=True)
class Clock:
    """The steps and saves of a run that begins after ``done`` steps.

    ``ends`` is the time of the end since step 0, s, if the last step is shorter.
    """

    h: float
    n_steps: int
    every: int | None
    done: int = 0
    ends: float | None = None
    #: whether bodies have step sizes of their own
    is_per_body: ClassVar[bool] = False

    @classmethod
    def of(
        cls, dt: Any, n_steps: Any, save_every: Any, done: int = 0, *, t_end: Any = None
    ) -> Clock:
        """A clock from the arguments of ``propagate``.

        Raises ``ValueError`` or ``TypeError`` for an invalid step size or number of steps.
        """
        step, ends = checks.real("dt", dt, zero=False), None
        if t_end is not None:
            duration = _duration(t_end, n_steps, np.array([step]))
            n_steps = int(_steps_within(duration, step))
            is_whole = abs(duration - n_steps * step) <= 16.0 * _EPS * abs(duration)
            ends = None if is_whole else duration
        return cls(
            step,
            checks.whole("n_steps", _given(n_steps), 0),
            None if save_every is None else checks.whole("save_every", save_every, 1),
            done,
            ends,
        )

    @property
    def end(self) -> int:
        """Index of the last step."""
        return self.done + self.n_steps

    @property
    def saves(self) -> int:
        """The number of saves; memory may not hold a list of them."""
        return 1 if self.every is None else -(-self.n_steps // self.every) + 1

    @cached_property
    def saved(self) -> list[int]:
        """Indices of the steps after which states are saved."""
        if self.every is None:
            return [self.end]
        return [*range(self.done, self.end, self.every), self.end]

    @cached_property
    def since(self) -> NDArray[np.float64]:
        """Times of the saves since step 0, s."""
        with np.errstate(over="ignore"):
            found = np.array(self.saved, dtype=np.float64) * self.h
        if self.ends is not None:
            found[-1] = self.ends
        return found

    def times(self, begin: float) -> NDArray[np.float64]:
        """Times of the saves, s, if step 0 begins at ``begin``.

        Raises ``ValueError`` if they overflow.
        """
        if not math.isfinite(begin + self.end * self.h):
            raise ValueError(
                f"dt: {self.end} steps of {self.h} s from {begin} s overflow; accepted: shorter"
            )
        return self.since + begin

    @property
    def steps(self) -> Any:
        """The step size, s, or per-body step sizes (N,)."""
        return self.h

    @property
    def duration(self) -> float:
        """The time from step 0 to the end of the run, s."""
        return self.end * self.h if self.ends is None else self.ends

    @cached_property
    def slack(self) -> NDArray[np.float64]:
        """The slack for the rounding of ``since``."""
        return 16.0 * _EPS * np.abs(self.since)

    def legs(self, h: float, breaks: Breaks) -> Legs:
        """The legs of the steps from step 0 on, of bodies with the step size h, s."""
        return legs_of(h, self.end, breaks, self.ends)

    def longest(self, begin: float) -> float:
        """The largest ``|t|`` of the run, s."""
        return max(abs(begin), abs(begin + self.end * self.h))


@dataclass(frozen=True, eq=False, kw_only=True)
class TimedClock(Clock):
    """Saves at any times, and per-body step sizes.

    ``h`` and ``n_steps`` of the base class are those of the body with most steps.
    """

    #: one step size, s, or one for each body
    sizes: NDArray[np.float64]
    #: times of the saves, s; times since the start of the run, and the slack for their rounding
    at: NDArray[np.float64]
    since: NDArray[np.float64]
    slack: NDArray[np.float64]
    #: the duration of the run, s, which ends with its last save unless it ``goes_on``
    lasts: float
    goes_on: bool = False

    @property
    def is_per_body(self) -> bool:  # type: ignore[override]
        """Whether bodies have step sizes of their own."""
        return self.sizes.size > 1

    @property
    def steps(self) -> NDArray[np.float64]:
        """Per-body step sizes, s."""
        return self.sizes

    @property
    def duration(self) -> float:
        """The time from the start to the end of the run, s."""
        return self.lasts if self.goes_on else float(self.since[-1]) if self.since.size else 0.0

    def legs(self, h: float, breaks: Breaks) -> Legs:
        """The legs of bodies with the step size h, s."""
        end, slack = self.duration, float(self.slack.max(initial=16.0 * _EPS * abs(self.duration)))
        count, rest = on_grid(end, h, slack)
        n = int(count)
        return legs_of(h, n + 1, breaks, end) if rest else legs_of(h, n, breaks)

    @property
    def saves(self) -> int:
        """The number of saves."""
        return self.at.size

    @cached_property
    def saved(self) -> list[int]:
        """Indices of the saves."""
        return list(range(self.at.size))

    def times(self, begin: float) -> NDArray[np.float64]:
        """Times of the saves, s."""
        return self.at


class RunOptions(NamedTuple):
    """Options without an effect on the results: threads, progress, saving, resuming."""

    n_threads: int = 1
    progress: bool = False
    #: a function that is called with a few saves at a time
    on_save: Callable[[Trajectory], object] | None = None
    #: the file that saves are written to
    file: Path | None = None
    #: the file that checkpoints are written to
    checkpoint: Path | None = None
    #: the end of the run that is resumed
    start: End | None = None
    #: whether the trajectory holds its end, for ``resume``, if it is small
    keep_end: bool = False


def save_batches(saves: int) -> list[tuple[int, int]]:
    """(first, end) of each batch of saves; the initial save is in the first batch."""
    return list(pairwise([0, *range(1 + RING, saves, RING), saves]))


def ring_slots(saves: int) -> NDArray[np.int64]:
    """The slot of each save in memory for a batch; the first is for the initial save."""
    k = np.arange(saves)
    return np.where(k == 0, 0, 1 + (k - 1) % RING)


def clock_of(
    dt: Any,
    n_steps: Any,
    t_end: Any,
    save_every: Any,
    save_at: Any,
    begin: float,
    bodies: int,
) -> Clock:
    """The clock of a run of ``bodies`` from time ``begin``.

    Raises ``ValueError`` and ``TypeError`` for arguments that do not fit.
    """
    if save_at is None and not isinstance(dt, (list, tuple)) and np.ndim(dt) == 0:
        return Clock.of(dt, n_steps, save_every, t_end=t_end)
    if save_every is not None:
        other = "save_at" if save_at is not None else "per-body step sizes"
        raise ValueError(f"save_every: found with {other}; accepted: save_at alone")
    steps = checks.array("dt", dt, "a number or (N,)").astype(np.float64)
    steps = np.ascontiguousarray(np.atleast_1d(steps))
    if steps.size not in (1, bodies):
        raise ValueError(f"dt: found {steps.size} steps; accepted: one, or {bodies} of the bodies")
    if not ((steps > 0.0).all() or (steps < 0.0).all()):
        raise ValueError("dt: found steps of both signs or 0; accepted: all above 0, or all below")
    if save_at is not None:
        save_at = checks.array("save_at", save_at, "(S,) times, s").astype(np.float64)
        if n_steps is None and t_end is None and np.size(save_at):
            last = float(save_at[-1]) - begin
            t_end = last if last * steps[0] > 0.0 else 0.0  # refused below, if it is not the begin
    if t_end is not None:
        end = _duration(t_end, n_steps, steps)
        counts = _steps_within(end, steps)
        ends = np.array([end])
    else:
        counts = _counts(_given(n_steps), steps.size)
        ends = counts * steps
        end = float(ends[0])
    if np.ptp(ends) > 16.0 * _EPS * abs(end):
        b = int(np.abs(ends - end).argmax())
        raise ValueError(
            f"n_steps: body {b} ends after {ends[b]:.17g} s, body 0 after {end:.17g} s; accepted: "
            "dt * n_steps the same of all bodies, to rounding"
        )
    if not np.isfinite(begin + end):
        raise ValueError(f"dt: the run overflows at {begin} + {end} s; accepted: shorter")
    if save_at is None:
        at, since = np.array([begin + end]), np.array([end])
        slack = 16.0 * _EPS * np.abs(since)
    else:
        at = _times(save_at, begin, begin + end)
        since, slack = at - begin, 16.0 * _EPS * (np.abs(at) + abs(begin))
    smallest = float(steps[np.abs(steps).argmin()])
    return TimedClock(
        h=smallest,
        n_steps=int(counts.max()),
        every=None,
        sizes=steps,
        at=at,
        since=since,
        slack=slack,
        lasts=end,
    )


def _duration(t_end: Any, n_steps: Any, dt: NDArray[np.float64]) -> float:
    """The duration of a run, s, which must have the sign of its steps."""
    if n_steps is not None:
        raise ValueError("n_steps, t_end: found both; accepted: one of them")
    duration = checks.real("t_end", t_end)
    if duration * dt[0] < 0.0:
        raise ValueError(f"t_end: found {t_end} with dt {dt[0]}; accepted: of the sign of dt")
    return duration


def _given(n_steps: Any) -> Any:
    """The number of steps, which must be given."""
    if n_steps is None:
        raise ValueError("n_steps, t_end: found neither; accepted: one of them")
    return n_steps


def _steps_within(duration: float, dt: Any) -> Any:
    """The number of steps until the end of a run, the last of which may be shorter."""
    with np.errstate(over="ignore"):
        found = np.ceil(np.abs(duration / dt) * (1.0 - 16.0 * _EPS))
    if not np.max(found) < 2.0**63:
        raise ValueError(
            f"dt: found {np.max(found):.3g} steps in {duration:g} s; accepted: fewer than 2**63"
        )
    return found.astype(np.int64)


def _counts(n_steps: Any, n: int) -> NDArray[np.int64]:
    if np.ndim(n_steps) == 0:
        return np.full(n, checks.whole("n_steps", n_steps, 0), dtype=np.int64)
    found = np.asarray(n_steps)
    if found.dtype.kind not in "iu" or found.shape != (n,) or (found < 0).any():
        raise ValueError(
            f"n_steps: found {checks.brief(n_steps)}; accepted: a whole number, or ({n},) of them, "
            "at least 0"
        )
    return found.astype(np.int64)


def _times(at: NDArray[np.float64], begin: float, end: float) -> NDArray[np.float64]:
    forward = end >= begin
    slack = 16.0 * _EPS * (abs(begin) + abs(end))
    first, last = (begin, end) if forward else (end, begin)
    outside = (at < first - slack) | (at > last + slack)
    if outside.any():
        k = int(outside.argmax())
        raise ValueError(
            f"save_at[{k}] is {at[k]:.17g}; accepted: from {first:.17g} to {last:.17g}"
        )
    steps = np.diff(at)
    if ((steps < 0.0) if forward else (steps > 0.0)).any():
        raise ValueError("save_at: found times out of order; accepted: in the order of the run")
    return np.ascontiguousarray(at)
