"""Breakpoints of a run: where its steps end, and the time window in which each step evaluates."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.run import Parts
from fastatt.scene.models import Model, Sampling
from fastatt.scene.scene import Scene

_EPS = float(np.finfo(np.float64).eps)
# sample times of a run, and sample times since the start, which doubles tell apart
_MOST, _FARTHEST = 10**8, 1e15


class Breaks(NamedTuple):
    """The breakpoints that a run crosses, in its order, and the time windows between them.

    ``times`` are the times at which segments of the run begin, s, the first being that of the run;
    ``since`` are these times counted from the start of the run, with ``slack`` for their rounding.
    The rates, torques and forces of a segment are evaluated from ``low`` to ``high`` only, which
    lie next to its two breakpoints. Breakpoints that are equal to rounding are one, and the window
    lies outside of all of them.
    ``sampled`` says which of them begin at a sample time, at which states jump.
    """

    times: NDArray[np.float64]
    since: NDArray[np.float64]
    slack: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    sampled: NDArray[np.bool_]


def corners_of(scene: Scene) -> NDArray[np.float64]:
    """Times at which steps end, s: ``scene.breakpoints`` and those that models bring."""
    every = _times_of(scene)
    return every[_apart(every)]


def _times_of(scene: Scene) -> NDArray[np.float64]:
    """The times of ``corners_of`` before those that are equal to rounding are one."""
    known: NDArray[np.float64] | None = scene.memo.get("corners")
    if known is not None:
        return known
    acting = (scene.rate, scene.torque, scene.force)
    brought = [x.corners() for x in acting if isinstance(x, Model)]
    found = np.unique(np.concatenate([np.array(scene.breakpoints), *brought]))
    scene.memo["corners"] = found
    return found


def _apart(every: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Of sorted times, those that are not equal to the one before to rounding."""
    found: NDArray[np.bool_] = np.diff(every, prepend=-np.inf) > 16.0 * _EPS * np.abs(every)
    return found


def corners_within(scene: Scene, begin: float, duration: float) -> tuple[float, ...]:
    """The times at which steps of a run end, s, with at least one before and one after the run."""
    found = _times_of(scene)
    ends = np.sort([begin, begin + duration])
    # those that are equal to an end, to rounding, are inside
    low, high = np.searchsorted(found, ends + 32.0 * _EPS * np.abs(ends) * (-1.0, 1.0))
    return tuple(found[max(low - 2, 0) : high + 2].tolist())


@lru_cache(maxsize=64)
def breaks_of(
    breakpoints: tuple[float, ...],
    begin: float,
    duration: float,
    sampling: Sampling | None = None,
) -> Breaks:
    """Select the sorted ``breakpoints`` inside a run of a ``duration``, s, of either sign.

    A breakpoint that coincides with the start or the end, to rounding, does not divide the run, but
    limits the time window.
    Times of ``sampling`` are breakpoints too, and the start may be one.
    """
    every = np.array(breakpoints, dtype=np.float64)
    apart = _apart(every)
    # the first and the last of those that are equal to rounding
    every, last = every[apart], every[np.roll(apart, -1)]
    is_sample = np.zeros(every.size, dtype=bool)
    if sampling is not None:
        every, last, is_sample = _with_samples(every, last, begin, duration, sampling)
    low = np.nextafter(np.concatenate([[-np.inf], last]), np.inf)
    high = np.nextafter(np.concatenate([every, [np.inf]]), -np.inf)
    sign = math.copysign(1.0, duration)
    since = every - begin
    slack = 16.0 * _EPS * (np.abs(every) + abs(begin))
    inside = (sign * since > slack) & (sign * since < abs(duration) - slack)
    # the run begins in the segment between these two breakpoints
    first = int((since <= slack).sum() if sign > 0.0 else (since < -slack).sum())
    stretches = first + int(sign) * np.arange(inside.sum() + 1)
    order = np.flatnonzero(inside)[:: int(sign)]
    at_begin = is_sample[np.abs(since) <= slack].any()
    return Breaks(
        np.concatenate([[begin], every[order]]),
        np.concatenate([[0.0], since[order]]),
        np.concatenate([[0.0], slack[order]]),
        low[stretches],
        high[stretches],
        np.concatenate([[at_begin], is_sample[order]]),
    )


def _with_samples(
    breakpoints: NDArray[np.float64],
    lasts: NDArray[np.float64],
    begin: float,
    duration: float,
    sampling: Sampling,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Breakpoints and sample times in order, those that are equal to rounding once; which are.

    Next to the times are the last of those that are equal to each.
    """
    period, start = sampling
    first, last = sorted((begin, begin + duration))
    farthest = max(abs(first - start), abs(last - start))
    if last - first > _MOST * period or farthest > _FARTHEST * period:
        raise ValueError(
            f"torque: SampledControl.period is {period} and .start {start}, in a run from {first} "
            f"to {last} s; accepted: up to {_MOST} samples in it, and less than {_FARTHEST:.0e} "
            "periods between it and the start"
        )
    k = np.arange(math.floor((first - start) / period), math.ceil((last - start) / period) + 1)
    slack = 16.0 * _EPS * (np.abs(breakpoints) + abs(begin))
    nearest = start + np.rint((breakpoints - start) / period) * period
    apart, samples = np.abs(breakpoints - nearest) > slack, start + k * period
    every = np.concatenate([breakpoints[apart], samples])
    order = np.argsort(every)
    lasts = np.concatenate([lasts[apart], samples])
    return every[order], lasts[order], order >= apart.sum()


@lru_cache(maxsize=64)
def parts_of(
    breakpoints: tuple[float, ...],
    begin: float,
    h: float,
    n_steps: int,
    end: float | None,
    sampling: Sampling | None = None,
) -> Parts:
    """The parts of those steps that breakpoints or the end of the run divide.

    ``end`` is the time of the end since the start of the run, s, if it is not a whole step.
    """
    found = breaks_of(breakpoints, begin, n_steps * h if end is None else end, sampling)
    clocks: list[tuple[float, ...]] = [(h, 0, begin, found.low[0], found.high[0], 0, 0, 0)]
    steps = [-1]
    # the step that is divided, if any, and the time that its parts reached; the next whole step
    divided, reached, resumes = -1, 0.0, -1

    # of the segments that begin at a sample time: whether no part begins there yet
    jumps = found.sampled.copy()

    def add(step: int, stretch: int, *clock: float) -> None:
        window = found.low[stretch], found.high[stretch]
        clocks.append((*clock[:3], *window, *clock[3:], jumps[stretch]))
        steps.append(step)
        jumps[stretch] = False

    def whole_steps(step: int, stretch: int) -> None:
        add(step, stretch, h, 0, begin, 0, 0)

    def part(step: int, until: float, stretch: int, ends: bool) -> None:
        add(step, stretch, until - reached, -step, begin + reached, 1, ends)

    if jumps[0]:
        whole_steps(0, 0)
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
