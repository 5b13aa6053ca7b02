"""Breakpoints of a run: where its steps end, and the time window in which each step evaluates."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.tape import Breaks
from fastatt.scene.models import Model, Sampling
from fastatt.scene.scene import Scene

_EPS = float(np.finfo(np.float64).eps)
# sample times of a run, and sample times since the start, which doubles tell apart
_MOST, _FARTHEST = 10**8, 1e15


def corners_of(scene: Scene) -> NDArray[np.float64]:
    """Times at which steps end, s: ``scene.breakpoints`` and those that models bring."""
    known: NDArray[np.float64] | None = scene.memo.get("corners")
    if known is not None:
        return known
    acting = (scene.rate, scene.torque, scene.force)
    brought = [x.corners() for x in acting if isinstance(x, Model)]
    times = np.unique(np.concatenate([np.array(scene.breakpoints), *brought]))
    scene.memo["corners"] = times
    return times


def breaks_within(scene: Scene, begin: float, duration: float) -> Breaks:
    """The times at which a run of a scene is divided."""
    times = corners_of(scene)
    ends = np.sort([begin, begin + duration])
    # those that are equal to an end, to rounding, are inside; one more before and after the run
    low, high = np.searchsorted(times, ends + 32.0 * _EPS * np.abs(ends) * (-1.0, 1.0))
    near = tuple(times[max(low - 2, 0) : high + 2].tolist())
    return breaks_of(near, begin, duration, scene.sampling)


@lru_cache(maxsize=64)
def breaks_of(
    breakpoints: tuple[float, ...],
    begin: float,
    duration: float,
    sampling: Sampling | None = None,
) -> Breaks:
    """Select the sorted ``breakpoints`` inside a run of a ``duration``, s, of either sign.

    A breakpoint that coincides with the start or the end, to rounding, does not divide the run, but
    limits the time window. Breakpoints that are equal to rounding are one, and the window, whose
    ends lie next to two of them, lies outside of all. Times of ``sampling`` are breakpoints
    too, and the start may be one.
    """
    every = np.array(breakpoints, dtype=np.float64)
    apart = np.diff(every, prepend=-np.inf) > 16.0 * _EPS * np.abs(every)
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
