"""Intervals between samples: which are accepted, and which do not fit into windows.

An interval is compared with the usual one, the median:

| times the usual one, more than | meaning |
| --- | --- |
| ``REGULAR`` | is left out of a file's mean sample rate |
| ``Window.uneven``, or less than its inverse | the windows of a method begin anew |
| ``GAP`` | a gap: refused by default; a stream warns of it |

A polynomial through samples on both sides of a long interval magnifies their noise, and so does one
through samples that nearly coincide. Such an interval is therefore integrated as a separate log: of
the two rates at its ends, or of its one increment.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from fastatt import checks, rounding

REGULAR, GAP = 2.5, 10.0
#: intervals before one, whose median is the usual interval there
RECENT = 8


def cuts(uneven: float, spans: Any, before: Any = ()) -> list[tuple[int, float]]:
    """The intervals, s, that do not fit into a window, and the usual interval at each.

    These are longer or shorter than the usual one by a factor of more than ``uneven``. ``before``
    are up to ``RECENT`` intervals that came before these; the first of all intervals is never one
    of them. Equal intervals, as one number, have none.
    """
    if not isinstance(spans, np.ndarray) or not len(spans):
        return []
    known = np.concatenate((before, spans), dtype=spans.dtype)
    if known.max() / uneven <= known.min():
        return []
    padded = np.concatenate((np.repeat(known[:1], RECENT - len(before)), known))
    least = most = padded  # of the intervals before, which spares many of the medians
    for step in (1, 2, 4):
        least = np.minimum(least[:-step], least[step:])
        most = np.maximum(most[:-step], most[step:])
    n = len(spans)
    unlike = np.flatnonzero((spans > uneven * least[:n]) | (uneven * spans < most[:n]))
    usual = np.median(sliding_window_view(padded, RECENT)[unlike], axis=1)
    candidates = spans[unlike]
    is_cut = (candidates > uneven * usual) | (uneven * candidates < usual)
    return list(zip(unlike[is_cut].tolist(), usual[is_cut].tolist(), strict=True))


def stretches(places: Iterable[int], count: int) -> list[tuple[int, int]]:
    """The first interval and the last + 1 of the parts of a log between cuts, and of its cuts."""
    return list(pairwise(sorted({0, count, *places, *(k + 1 for k in places)})))


def apart(a: float, b: float) -> tuple[str, str]:
    """Two different numbers with so many digits that they differ as text."""
    digits = next(n for n in (6, 9, 12, 17) if f"{a:.{n}g}" != f"{b:.{n}g}" or n == 17)
    return f"{a:.{digits}g}", f"{b:.{digits}g}"


def largest_gap(max_gap: float | None) -> float:
    """The longest interval that is accepted, s; None accepts any."""
    if max_gap is None:
        return math.inf
    return checks.above_zero("max_gap", max_gap, "a number above 0, or inf", finite=False)


def tell_of_stamps(spans: Any) -> None:
    """Warn of intervals that only grow, as time stamps do."""
    if isinstance(spans, np.ndarray) and len(spans) > 3 and bool((np.diff(spans) > 0.0).all()):
        rounding.warn(
            f"dt: {len(spans)} intervals only grow, from {spans[0]:.6g} to {spans[-1]:.6g} s, as "
            "time stamps do; accepted: intervals, such as np.diff(t)"
        )


def intervals(dt: ArrayLike, count: int, max_gap: float | None, precision: np.dtype[Any]) -> Any:
    """The interval as a number of the precision, or an array of ``count`` intervals."""
    interval: Any = dt
    longest = largest_gap(max_gap)
    if isinstance(interval, float) and 0.0 < interval <= longest and interval < math.inf:
        return precision.type(interval)
    spans = checks.array("dt", dt, f"a number or ({count},)")
    if spans.ndim == 0:
        interval = checks.above_zero("dt", spans, "an interval above 0")
        if interval > longest:
            length, most = apart(interval, longest)
            raise ValueError(f"dt: found {length}; accepted: at most {most} s, max_gap")
        return precision.type(interval)
    if not count:
        return spans.astype(precision)
    bad = spans <= 0.0
    if bad.any():
        k = int(np.argmax(bad))
        what = "a repeated" if spans[k] == 0.0 else "a decreasing"
        raise ValueError(f"dt[{k}] is {spans[k]}: {what} time stamp; accepted: intervals above 0")
    if max_gap is None:
        with np.errstate(over="ignore"):
            longest = GAP * float(np.median(spans))
    if spans.max() > longest:
        k = int(np.argmax(spans))
        length, most = apart(float(spans[k]), longest)
        raise ValueError(
            f"dt[{k}] is {length}: a gap; accepted: at most {most} s; cut the log there, "
            "or pass max_gap to go across it"
        )
    return np.ascontiguousarray(spans, dtype=precision)
