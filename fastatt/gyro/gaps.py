"""Intervals between samples at which the windows of a method begin anew: gaps and short ones.

A polynomial through samples on both sides of a gap magnifies their noise, and so does one through
samples that nearly coincide. Such an interval is therefore integrated as a separate log: of the two
rates at its ends, or of its one increment.
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


def cuts(uneven: float, spans: Any, before: Any = ()) -> list[tuple[int, float]]:
    """The intervals, s, that do not fit into a window, and the usual interval at each.

    These are longer or shorter than the usual one by a factor of more than ``uneven``. ``before``
    are up to ``RECENT`` intervals that came before these; the first of all intervals is never one
    of them. Equal intervals, as one number, have none.
    """
    if not np.ndim(spans) or not len(spans):
        return []
    known = np.concatenate((before, spans), dtype=spans.dtype)
    if known.max() <= uneven * known.min():
        return []
    padded = np.concatenate((np.repeat(known[:1], RECENT - len(before)), known))
    least = most = padded  # of the intervals before, which spares many of the medians
    for step in (1, 2, 4):
        least = np.minimum(least[:-step], least[step:])
        most = np.maximum(most[:-step], most[step:])
    n = len(spans)
    unlike = np.flatnonzero((spans > uneven * least[:n]) | (uneven * spans < most[:n]))
    usual = np.median(sliding_window_view(padded, RECENT)[unlike], axis=1)
    own = spans[unlike]
    found = (own > uneven * usual) | (uneven * own < usual)
    return list(zip(unlike[found].tolist(), usual[found].tolist(), strict=True))


def stretches(window: Window, spans: Any, count: int) -> list[tuple[int, int]]:
    """The first interval and the last + 1 of the parts of a log between cuts, and of its cuts."""
    at = [k for k, _ in cuts(window.uneven, spans)] if window.intervals > 1 else []
    bounds = sorted({0, count, *at, *(k + 1 for k in at)})
    return list(pairwise(bounds))


def part(
    data: NDArray[Any], spans: Any, increments: bool, first: int, last: int
) -> tuple[NDArray[Any], Any]:
    """Samples (N, k, 3), contiguous, and intervals of a part of logs."""
    samples = np.ascontiguousarray(data[:, first : last + (not increments)])
    return samples, spans[first:last] if np.ndim(spans) else spans
