"""Methods for gyro samples, which map a window of samples to the rotations within it.

A window covers ``span`` intervals and reads ``history`` intervals before it. It holds the rates at
the ends of all these intervals, or the angle increments over them. Beyond the ends of a log,
samples are extrapolated by the polynomial that the method fits, so that the first and the last
windows use the polynomial of the nearest whole window.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

from fastatt.kernels import quat
from fastatt.tracing.graph import both, choose, larger
from fastatt.tracing.trace import traceable

#: intervals between two renormalisations, a multiple of every window's span
CHUNK = 48
#: the largest ``history`` of a window
MOST_HISTORY = 8
# a state of size 1 that a pass changes by more does not converge
_FAR = 1e6


def products(q: Sequence[Any], d: Sequence[Any]) -> list[Any]:
    """q∘d for each of the flat quaternions d, flat."""
    mul = traceable(quat.mul)
    return [x for i in range(0, len(d), 4) for x in mul(q, d[i : i + 4])]


@dataclass(frozen=True, eq=False)
class Iteration:
    """A method that repeats passes over a state until it does not change.

    ``rates(v, h)`` and ``increments(v, h)`` return the first state, a flat tuple of numbers of size
    1, from the samples and intervals of the window. ``improve(state)`` returns the next state, at
    most ``passes`` times, and ``read(state)`` the flat unit quaternions from the start of the
    window to the end of each interval. They are called with traced numbers.
    """

    rates: Callable[..., Any]
    increments: Callable[..., Any]
    improve: Callable[..., Any]
    read: Callable[..., Any]
    passes: int

    def begin(self, increments: bool, v: Any, h: Any) -> Any:
        """The first state, and 1, which says that it changes."""
        return (*(self.increments if increments else self.rates)(v, h), 1.0)

    def again(self, state: Any) -> Any:
        """The next state, and whether it changed by more than 8 ulps of 1.

        Each window has as many passes as it needs, independently of the other windows.
        """
        *before, moving = state
        after = self.improve(tuple(before))
        pairs = [(a, b) for a, b in zip(after, before, strict=True) if a is not b]
        far = reduce(larger, (abs(a - b) for a, b in pairs))
        moves = moving > 0.5
        ends = (a if a is b else choose(moves, a, b) for a, b in zip(after, before, strict=True))
        on = both(moves, both(1.0 + 0.0625 * far > 1.0, far < _FAR))
        return (*ends, choose(on, 1.0, 0.0))


@dataclass(frozen=True, eq=False)
class Window:
    """The shape of a method's window, and its formulas by the kind of samples.

    ``rates(v, h)`` and ``increments(v, h)`` return rotation vectors (rad) from the window's start
    to the end of each interval, flat: v are its samples, flat (rad/s or rad), h its intervals (s),
    the oldest first. They are plain functions that are called with numbers, with traced ones and
    from jitted code. A method that iterates has an ``iteration`` instead. ``uneven`` is the largest
    ratio, to either side, of an interval to the usual one that its polynomial is used for.
    ``span`` divides ``CHUNK``, and ``history`` is at most ``MOST_HISTORY``.
    """

    history: int
    span: int
    rates: Callable[..., Any] | None = None
    increments: Callable[..., Any] | None = None
    iteration: Iteration | None = None
    uneven: float = 3.0

    @property
    def near(self) -> float:
        """Largest component (rad) over an interval below which no rotation passes π."""
        # a polynomial through samples stays below 4 times the largest where it is used
        return 3.0 / (8.0 * self.intervals)

    @property
    def intervals(self) -> int:
        """Number of intervals in the window."""
        return self.history + self.span

    def samples(self, increments: bool) -> int:
        """Number of samples in the window."""
        return self.intervals + (not increments)

    def takes(self, increments: bool) -> bool:
        """Whether it takes samples of a kind."""
        return self.iteration is not None or self.formula(increments) is not None

    def formula(self, increments: bool) -> Callable[..., Any] | None:
        """The rotation vectors' formula for a kind of samples; None if there is none."""
        return self.increments if increments else self.rates
