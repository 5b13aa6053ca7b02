"""What a method for gyro samples is: a window of them in, its turns out.

A window covers ``span`` intervals and looks ``history`` intervals back. Of rates it holds the
samples at the ends of all these intervals, of increments the angles over them. Beyond the ends of a
log it holds samples extrapolated by the polynomial that the method fits, which makes the first and
last fit that of the nearest whole window.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: intervals of a lane that are worked through at a time, a whole number of every window's span
CHUNK = 48
#: stretches of logs that run side by side
LANES = 16
#: intervals of one log that run side by side
TILE = CHUNK * LANES
#: most intervals that a window may look back
MOST_HISTORY = 8


@dataclass(frozen=True)
class Iteration:
    """A method whose attitudes come of several passes over a state.

    ``rates(v, h)`` and ``increments(v, h)`` give the first state, a flat tuple, from the window's
    samples and intervals, ``improve(state)`` the next, ``passes`` times, and ``read(state)`` the
    flat unit quaternions from the window's start to the end of each interval. They are called with
    recorded numbers.
    """

    rates: Callable[..., Any]
    increments: Callable[..., Any]
    improve: Callable[..., Any]
    read: Callable[..., Any]
    passes: int

    def begin(self, increments: bool, v: Any, h: Any) -> Any:
        """The first state."""
        return (self.increments if increments else self.rates)(v, h)

    def attitudes(self, increments: bool, v: Any, h: Any) -> Any:
        """All of it, in one straight line."""
        state = self.begin(increments, v, h)
        for _ in range(self.passes):
            state = self.improve(state)
        return self.read(state)


@dataclass(frozen=True)
class Window:
    """Shape of a method's window, and its formulas by kind of samples.

    ``rates(v, h)`` and ``increments(v, h)`` give the rotation vectors (rad) from the window's start
    to the end of each interval, flat: v are its samples, flat (rad/s or rad), h its intervals (s),
    the oldest first. They are plain functions, called with numbers, with recorded ones and from
    ``@njit`` code. A method that is no such formula has an ``iteration``.

    Raises ``ValueError`` for a shape that the engine's chunks do not hold.
    """

    history: int
    span: int
    rates: Callable[..., Any] | None = None
    increments: Callable[..., Any] | None = None
    iteration: Iteration | None = None

    def __post_init__(self) -> None:
        if self.span < 1 or CHUNK % self.span:
            raise ValueError(f"span: found {self.span}; accepted: a divisor of {CHUNK}")
        if not 0 <= self.history <= MOST_HISTORY:
            raise ValueError(f"history: found {self.history}; accepted: 0 to {MOST_HISTORY}")

    @property
    def near(self) -> float:
        """Angle (rad) of the largest component over an interval below which no turn passes π."""
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
