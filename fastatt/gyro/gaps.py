"""Gaps between samples, at which the windows of a method begin anew.

A polynomial through samples on both sides of a gap magnifies their noise. The interval of a gap is
therefore integrated as a separate log: of the two rates at its ends, or of its one increment.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fastatt.methods.windows import Window

#: intervals before one, whose median is the usual interval there
RECENT = 8
_LONG = 3.0  # times the usual interval: a gap


def gaps(spans: Any, before: Any = ()) -> list[tuple[int, float]]:
    """The gaps among intervals, s, and the usual interval at each.

    ``before`` are up to ``RECENT`` intervals that came before these; the first of all intervals is
    never a gap. Equal intervals, as one number, have no gap.
    """
    if not np.ndim(spans) or not len(spans):
        return []
    known = np.concatenate((before, spans), dtype=spans.dtype)
    if spans.max() <= _LONG * known.min():
        return []
    padded = np.concatenate((np.repeat(known[:1], RECENT - len(before)), known))
    least = padded  # of the intervals before, which spares most of the medians
    for step in (1, 2, 4):
        least = np.minimum(least[:-step], least[step:])
    longer = np.flatnonzero(spans > _LONG * least[: len(spans)])
    usual = np.median(sliding_window_view(padded, RECENT)[longer], axis=1)
    found = spans[longer] > _LONG * usual
    return list(zip(longer[found].tolist(), usual[found].tolist(), strict=True))


def stretches(window: Window, spans: Any, count: int) -> list[tuple[int, int]]:
    """The first interval and the last + 1 of the parts of a log without a gap, and of its gaps."""
    at = [k for k, _ in gaps(spans)] if window.intervals > 1 else []
    bounds = sorted({0, count, *at, *(k + 1 for k in at)})
    return list(pairwise(bounds))


def part(
    data: NDArray[Any], spans: Any, increments: bool, first: int, last: int
) -> tuple[NDArray[Any], Any]:
    """Samples (N, k, 3), contiguous, and intervals of a part of logs."""
    samples = np.ascontiguousarray(data[:, first : last + (not increments)])
    return samples, spans[first:last] if np.ndim(spans) else spans
