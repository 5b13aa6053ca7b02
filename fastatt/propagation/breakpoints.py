"""Breakpoints of a run: where its steps end, and the time window in which each step evaluates."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.run import Parts

_EPS = float(np.finfo(np.float64).eps)


class Breaks(NamedTuple):
    """The breakpoints that a run crosses, in its order, and the time windows between them.

    ``times`` are the times at which stretches of the run begin, s, the first being that of the run;
    ``since`` are these times counted from the begin of the run, with ``slack`` for their rounding.
    The rates, torques and forces of a stretch are evaluated from ``low`` to ``high`` only, which
    lie next to its two breakpoints.
    """

    times: NDArray[np.float64]
    since: NDArray[np.float64]
    slack: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@lru_cache(maxsize=64)
def breaks_of(breakpoints: tuple[float, ...], begin: float, duration: float) -> Breaks:
    """Select the sorted ``breakpoints`` inside a run of a ``duration``, s, of either sign.

    A breakpoint that coincides with the begin or the end, to rounding, does not divide the run, but
    limits the time window.
    """
    every = np.array(breakpoints, dtype=np.float64)
    edges = np.concatenate([[-np.inf], every, [np.inf]])
    low, high = np.nextafter(edges[:-1], np.inf), np.nextafter(edges[1:], -np.inf)
    sign = math.copysign(1.0, duration)
    since = every - begin
    slack = 16.0 * _EPS * (np.abs(every) + abs(begin))
    inside = (sign * since > slack) & (sign * since < abs(duration) - slack)
    # the run begins in the stretch between these two breakpoints
    first = int((since <= slack).sum() if sign > 0.0 else (since < -slack).sum())
    stretches = first + int(sign) * np.arange(inside.sum() + 1)
    order = np.flatnonzero(inside)[:: int(sign)]
    return Breaks(
        np.concatenate([[begin], every[order]]),
        np.concatenate([[0.0], since[order]]),
        np.concatenate([[0.0], slack[order]]),
        low[stretches],
        high[stretches],
    )


@lru_cache(maxsize=64)
def parts_of(
    breakpoints: tuple[float, ...], begin: float, h: float, n_steps: int, end: float | None
) -> Parts:
    """The parts of those steps that breakpoints or the end of the run divide.

    ``end`` is the time of the end since the begin of the run, s, if it is not a whole step.
    """
    found = breaks_of(breakpoints, begin, n_steps * h if end is None else end)
    clocks: list[tuple[float, ...]] = [(h, 0, begin, found.low[0], found.high[0], 0, 0)]
    steps = [-1]
    # the step that is divided, if any, and the time that its parts reached; the next whole step
    divided, reached, resumes = -1, 0.0, -1

    def add(step: int, *clock: float) -> None:
        clocks.append(clock)
        steps.append(step)

    def whole_steps(step: int, stretch: int) -> None:
        add(step, h, 0, begin, found.low[stretch], found.high[stretch], 0, 0)

    def part(step: int, until: float, stretch: int, ends: bool) -> None:
        window = found.low[stretch], found.high[stretch]
        add(step, until - reached, -step, begin + reached, *window, 1, ends)

    for k in range(1, found.since.size):
        since = float(found.since[k])
        slack = float(found.slack[k])
        n = math.floor((since + math.copysign(slack, h)) / h)
        on_grid = abs(since - n * h) <= slack
        if divided >= 0 and (n > divided or on_grid):
            part(divided, (divided + 1) * h, k - 1, True)
            resumes, divided = divided + 1, -1
        if 0 <= resumes < n:
            whole_steps(resumes, k - 1)
        if on_grid:
            whole_steps(n, k)
            resumes = -1
            continue
        if divided < 0:
            divided, reached, resumes = n, n * h, -1
        part(n, since, k - 1, False)
        reached = since
    last = found.since.size - 1
    if end is not None and divided < n_steps - 1:
        if divided >= 0:
            part(divided, (divided + 1) * h, last, True)
            resumes = divided + 1
        if 0 <= resumes < n_steps - 1:
            whole_steps(resumes, last)
        divided, reached, resumes = n_steps - 1, (n_steps - 1) * h, -1
    if divided >= 0:
        part(divided, (divided + 1) * h if end is None else end, last, True)
        resumes = divided + 1
    if 0 <= resumes < n_steps:
        whole_steps(resumes, last)
    return Parts(np.array(clocks, dtype=np.float64), np.array(steps, dtype=np.int64))
