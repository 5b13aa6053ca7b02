"""Breakpoints of a run: where its steps end, and the time window in which each step evaluates."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.tape import Breaks
from fastatt.scene.law import Sampling
from fastatt.scene.models import Model
from fastatt.scene.scene import Scene

_EPS = float(np.finfo(np.float64).eps)
# sample times of a run, and sample times since the start, which doubles tell apart
_MOST, _FARTHEST = 10**8, 1e15


class Divisions(NamedTuple):
    """What divides the steps of a run: breakpoints, s, and when each of its states changes.

    That is None for a state that changes at all times.
    """

    corners: NDArray[np.float64] = np.zeros(0)
    clocks: tuple[Sampling | None, ...] = ()

    def samples(self, clock: Sampling, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sample times around the times of saves."""
        return _samples(clock, times.min(), times.max())

    def every(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Breakpoints and sample times around the times of saves, in order."""
        each = [self.samples(x, times) for x in {*self.clocks} - {None} if x is not None]
        return np.unique(np.concatenate([self.corners, *each]))


def divisions_of(scene: Scene) -> Divisions:
    """What divides the steps of runs of a scene."""
    return Divisions(corners_of(scene), scene.clocks)


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
    """The times at which a run of a ``duration``, s, of either sign, of a scene is divided.

    A breakpoint that coincides with the start or the end, to rounding, does not divide the run, but
    limits the time window. Those that are equal to rounding are one, and the window, whose ends lie
    next to two of them, lies outside of all. Times of a sampled controller are breakpoints too, and
    the start may be one.
    """
    sign, ends = math.copysign(1.0, duration), np.sort([begin, begin + duration])
    corners, each = corners_of(scene), [_samples(x, *ends) for x in scene.samplings]
    samples = np.concatenate([np.zeros(0), *each])
    of_clock = [sum(1 << k for k, y in enumerate(scene.jumps) if y == x) for x in scene.samplings]
    bits = np.repeat(np.array(of_clock, np.int64), [x.size for x in each])
    # those that are equal to an end, to rounding, are inside; one more before and after the run
    low, high = np.searchsorted(corners, ends + 32.0 * _EPS * np.abs(ends) * (-1.0, 1.0))
    every = np.concatenate([samples, corners[max(low - 2, 0) : high + 2]])
    order = np.argsort(every)
    clocks = np.concatenate([bits, np.zeros(every.size - bits.size, np.int64)])
    every, clocks = every[order], clocks[order]
    slack = 16.0 * _EPS * (np.abs(every) + abs(begin))
    apart = np.diff(every, prepend=-np.inf) > slack
    # the first and the last of those that are equal
    last, first = every[np.roll(apart, -1)], np.flatnonzero(apart)
    clocks = np.bitwise_or.reduceat(clocks, first) if first.size else clocks
    every, slack = every[first], slack[first]
    since = every - begin
    inside = (sign * since > slack) & (sign * since < abs(duration) - slack)
    # the run begins in the segment between these two breakpoints
    segment = int((since <= slack).sum() if sign > 0.0 else (since < -slack).sum())
    segments = segment + int(sign) * np.arange(inside.sum() + 1)
    divides = np.flatnonzero(inside)[:: int(sign)]
    at_begin = np.bitwise_or.reduce(clocks[np.abs(since) <= slack], initial=0)
    return Breaks(
        np.concatenate([[begin], every[divides]]),
        np.concatenate([[0.0], since[divides]]),
        np.concatenate([[0.0], slack[divides]]),
        np.nextafter(np.concatenate([[-np.inf], last]), np.inf)[segments],
        np.nextafter(np.concatenate([every, [np.inf]]), -np.inf)[segments],
        np.concatenate([[at_begin], clocks[divides]]),
    )


def _samples(sampling: Sampling, first: float, last: float) -> NDArray[np.float64]:
    """The sample times of a run between two times, and one more before and after it."""
    period, start = sampling
    farthest = max(abs(first - start), abs(last - start))
    if last - first > _MOST * period or farthest > _FARTHEST * period:
        raise ValueError(
            f"torque: SampledControl.period is {period} and .start {start}, in a run from {first} "
            f"to {last} s; accepted: up to {_MOST} samples in it, and less than {_FARTHEST:.0e} "
            "periods between it and the start"
        )
    k = np.arange(math.floor((first - start) / period), math.ceil((last - start) / period) + 1.0)
    return start + k * period
