"""What is asked of a run: by which method, which steps and saves, on how many threads."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.attitudes import Attitude
from fastatt.device import Device
from fastatt.engine.ensemble import Span
from fastatt.methods.method import Method
from fastatt.running.reducer import Reducer
from fastatt.running.trajectory import Trajectory

KINDS = {np.dtype(np.float64): "double", np.dtype(np.float32): "single"}
#: saves that are kept at a time where all of them are not
RING = 16
# steps of the fastest body between two times at which bodies wait for each other
_LEG = 4096


@dataclass(frozen=True)
class Choice:
    """How a scene is propagated: by which method, in which representation, mended when."""

    method: Method
    attitude: Attitude
    restore: int = 0
    raw: bool = False
    looks: bool = True
    reducer: Reducer | None = None
    #: where it runs, if not on the processor
    device: Device | None = None


@dataclass(frozen=True)
class Clock:
    """Steps and saves of a run, which goes on after ``done`` steps."""

    h: float
    n_steps: int
    every: int | None
    done: int = 0

    @classmethod
    def of(cls, dt: Any, n_steps: Any, save_every: Any, done: int = 0) -> Clock:
        """The same from what a user gives.

        Raises ``ValueError`` or ``TypeError`` for what is no step and no number of steps.
        """
        return cls(
            checks.real("dt", dt, zero=False),
            checks.whole("n_steps", n_steps, 0),
            None if save_every is None else checks.whole("save_every", save_every, 1),
            done,
        )

    @property
    def end(self) -> int:
        """Number of the last step."""
        return self.done + self.n_steps

    @property
    def saves(self) -> int:
        """How many saves there are: all their numbers may be more than memory holds."""
        return 1 if self.every is None else -(-self.n_steps // self.every) + 1

    @cached_property
    def saved(self) -> list[int]:
        """Numbers of the steps after which states are saved."""
        return (
            [self.end]
            if self.every is None
            else [*range(self.done, self.end, self.every), self.end]
        )

    @cached_property
    def since(self) -> NDArray[np.float64]:
        """Times of the saves from step 0 on, s."""
        with np.errstate(over="ignore"):
            return np.array(self.saved, dtype=np.float64) * self.h

    def times(self, begin: float) -> NDArray[np.float64]:
        """Times of the saves, s, where step 0 begins at ``begin``.

        Raises ``ValueError`` where they overflow.
        """
        if not math.isfinite(begin + self.end * self.h):
            raise ValueError(
                f"dt: {self.end} steps of {self.h} s from {begin} s overflow; accepted: shorter"
            )
        return self.since + begin

    def is_rounded(self, begin: float) -> bool:
        """Whether the clock does not tell the run's steps apart well."""
        return math.ulp(self.longest(begin)) > rounding.SHARE * abs(self.h)

    def longest(self, begin: float) -> float:
        """Largest |t| of the run, s."""
        return max(abs(begin), abs(begin + self.end * self.h))

    def span(self, restore: int) -> Span:
        """All of it, for the engine."""
        every = self.every or max(self.n_steps, 1)
        slot = int(self.every is not None)
        return Span(self.done, self.end, self.end, every, slot, restore, self.done)


@dataclass(frozen=True, eq=False)
class OwnClock(Clock):
    """Steps of each body's own, and saves at any times; it begins at ``begin``.

    ``h`` and ``n_steps`` of the base are those of the body with most steps.
    """

    steps: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    at: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    begin: float = 0.0

    @classmethod
    def made(
        cls, steps: NDArray[np.float64], n_steps: int, at: NDArray[np.float64], begin: float
    ) -> OwnClock:
        """Of steps (N,) or (1,), the number of the smallest, and the times of saves."""
        smallest = float(steps[np.abs(steps).argmin()])
        return cls(smallest, n_steps, None, 0, steps, at, begin)

    def part(self, rows: NDArray[np.intp]) -> OwnClock:
        """That of some bodies."""
        steps = self.steps[rows]
        most = self.n_steps * abs(self.h) / float(np.abs(steps).min())
        return OwnClock.made(steps, math.ceil(most), self.at, self.begin)

    @cached_property
    def _stops(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Times at which bodies wait for each other, and which of them are saves, else −1."""
        legs = np.diff(self.at, prepend=self.begin)
        most = np.abs(legs / self.h)
        parts = np.maximum(1, np.ceil(most / _LEG)).astype(np.int64)
        last = np.repeat(self.at, parts)
        ends = np.cumsum(parts) - 1
        left = np.repeat(ends, parts) - np.arange(parts.sum())
        times = last - np.repeat(legs / parts, parts) * left
        slots = np.full(times.size, -1)
        slots[ends] = np.arange(self.at.size)
        return times, slots

    @property
    def stops(self) -> dict[str, NDArray[Any]]:
        """The same for the engine."""
        times, slots = self._stops
        return {"times": times, "slots": slots, "dt": self.steps}

    @property
    def saves(self) -> int:
        """How many saves there are."""
        return self.at.size

    @cached_property
    def saved(self) -> list[int]:
        """Numbers of the saves."""
        return list(range(self.at.size))

    @cached_property
    def since(self) -> NDArray[np.float64]:
        """Times of the saves from the begin on, s."""
        return self.at - self.begin

    def times(self, begin: float) -> NDArray[np.float64]:
        """Times of the saves, s."""
        return self.at

    def span(self, restore: int) -> Span:
        """All of it, for the engine."""
        n = self._stops[0].size
        return Span(0, n, n, 1, 0, restore)


class Handling(NamedTuple):
    """What has no effect on results: threads, a bar, where saves go; and what invalid bodies do."""

    threads: int = 1
    #: is told of body-steps
    done: Callable[[int], object] | None = None
    sink: Callable[[Trajectory], object] | None = None
    invalid: str = "raise"
    #: where the run's end is written, again and again
    checkpoint: Path | None = None


def few(saves: int) -> list[list[int]]:
    """The initial save with each few that follow it."""
    return [[0, *range(first, min(first + RING, saves))] for first in range(1, max(saves, 2), RING)]
