"""Time stamps: their unit, and what becomes of rows that are no samples."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.logs import names
from fastatt.logs.blocks import NO_STAMP, Block
from fastatt.logs.head import Layout
from fastatt.logs.names import TIME_UNITS, LogError, LogWarning

BAD = ("refuse", "drop", "split", "hold")
# of gyros, Hz: any other is a unit mistaken
SLOWEST, FASTEST = 0.1, 1e6
PLAUSIBLE = "accepted: above 0.1 Hz and up to 1 MHz"
# sample rates at which gyros are mostly logged, Hz: they tell units 1000 apart from each other
_USUAL = (9.5, 9500.0)
_SLOW = 0.475  # Hz; from here to the usual rates seconds are as likely as thousandths
_EPOCH = (6.3e8, 4.1e9)  # s from 1970 to 1990 and 2100
_GAP = 10.0  # an interval this many times the usual is a gap


class Chunk(NamedTuple):
    """Consecutive samples: s from the first stamp, numbers (n, k), rows where a piece begins."""

    t: NDArray[np.float64]
    values: NDArray[np.float64]
    cuts: list[int]


def seconds(stamps: NDArray[Any], first: Any, unit: str) -> NDArray[np.float64]:
    """s from the first stamp; NaN of a stamp that is none."""
    with np.errstate(over="ignore", invalid="ignore"):
        t = (stamps - first) / TIME_UNITS[unit]
    return np.where(stamps == NO_STAMP, np.nan, t) if stamps.dtype.kind == "i" else t


def unit_of(layout: Layout, clock: int, stamps: NDArray[Any], said: str | None) -> str:
    """The unit of time stamps: as said, as in the name of their column, or from their size.

    Raises ``LogError`` where the size does not tell or the rate is none of a gyro's.
    """
    if layout.stamps(clock) == "date":
        return "ns"
    if said is not None:
        return said
    name = layout.column(clock)[:60]
    with np.errstate(over="ignore", invalid="ignore"):
        gaps = np.diff(stamps.astype(np.float64) - float(stamps[0]))
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    usual = float(np.median(gaps)) if gaps.size else math.nan
    hertz = {u: scale / usual for u, scale in TIME_UNITS.items()}
    fitting = [f"{x:.4g} Hz in {u}" for u, x in hertz.items() if SLOWEST < x <= FASTEST]
    options = f"given as time_unit ({' or '.join(fitting) or 'none fits'})"
    found = names.time_unit(name)
    if found is not None:
        if found not in TIME_UNITS:
            raise layout.error(
                f"{name}: found the unit {found!r}; accepted: s, ms, us, ns, or the unit of time, "
                f"{options}"
            )
        if gaps.size and not SLOWEST < hertz[found] <= FASTEST:
            raise layout.error(
                f"{name} gives {hertz[found]:.4g} Hz in {found}; {PLAUSIBLE}, or the unit of "
                f"time, {options}"
            )
        return found
    if not gaps.size:
        return "s"
    since_1970 = [u for u, x in TIME_UNITS.items() if _EPOCH[0] < float(stamps[0]) / x < _EPOCH[1]]
    guessed = [u for u in since_1970 if SLOWEST < hertz[u] <= FASTEST] or [
        u for u, x in hertz.items() if _USUAL[0] <= x < _USUAL[1]
    ]
    if not guessed or (not since_1970 and guessed == ["ms"] and hertz["s"] > _SLOW):
        raise layout.error(
            f"{name} has no unit, and its interval {usual:.6g} is that of no usual rate or of more "
            f"than one; accepted: the unit of time, {options}"
        )
    if guessed != ["s"]:
        warnings.warn(
            f"{layout.name}: {name} has no unit: taken as {guessed[0]} ({hertz[guessed[0]]:.4g} "
            f"Hz); time_unit says another",
            LogWarning,
            stacklevel=2,
        )
    return guessed[0]


# of the first row: above 0, and no denormal, which another library may have switched off
_BEFORE_ALL = float(np.finfo(np.float64).tiny)


class Mending:
    """Rows with the time in order; others are refused, dropped, cut out or held over.

    ``bad`` is "refuse"; "drop" (intervals go across what was left out); "split" (a new piece
    begins after it); "hold" (the last rates stay: in rows that are no numbers, and over a gap up to
    one usual interval before its end).
    """

    def __init__(self, layout: Layout, bad: str, max_gap: float | None) -> None:
        self.layout, self.bad, self.max_gap = layout, bad, max_gap or math.inf
        self.usual, self._given = math.inf, max_gap is not None
        self.last: tuple[float, NDArray[np.float64]] | None = None
        self.cut = False  # a piece begins with the next row
        self.dropped = self.held = self.gaps = 0

    def set_usual(self, interval: float) -> None:
        """The usual interval, s, of which gaps are a multiple unless it was said."""
        self.usual = interval
        if not self._given:
            self.max_gap = _GAP * interval

    def mended(self, block: Block, t: NDArray[np.float64], clock: str) -> Chunk:
        """The rows of a block at times t that are samples.

        Raises ``LogError`` for the first that is none, where it is to be refused.
        """
        start = -math.inf if self.last is None else self.last[0]
        with np.errstate(invalid="ignore", over="ignore"):
            gaps = np.diff(t, prepend=t[:1] if self.last is None else start)
            if self.last is None:
                gaps[:1] += _BEFORE_ALL  # 0, or no number
            # a sum is quick to look at, and may overflow
            numbers = math.isfinite(block.values.sum()) or bool(np.isfinite(block.values).all())
            longest = gaps.max(initial=0.0)
        if numbers and (gaps > 0.0).all() and longest <= self.max_gap and longest < math.inf:
            began = self.cut and self.last is not None and len(t) > 0
            chunk = Chunk(t, block.values, [0] if began else [])
            self.cut = self.cut and not len(t)
        elif self.bad == "refuse":
            raise self._refusal(block, t, gaps, clock)
        else:
            chunk = self._sorted_out(t, block.values, start)
        if len(chunk.t):
            self.last = float(chunk.t[-1]), chunk.values[-1].copy()
        return chunk

    def told(self) -> Iterator[str]:
        """What was mended, in words."""
        counts = {"rows dropped": self.dropped, "rows held": self.held, "gaps": self.gaps}
        yield from (f"{n} {what}" for what, n in counts.items() if n)

    def _refusal(
        self, block: Block, t: NDArray[np.float64], gaps: NDArray[np.float64], clock: str
    ) -> LogError:
        finite = np.isfinite(t) & np.isfinite(block.values).all(axis=1)
        k = int(np.argmax(~(gaps > 0.0) | ~finite | (gaps > self.max_gap)))
        where = f"{clock[:60]} in line {block.lines[k]}"
        if not finite[k]:
            return self.layout.error(
                f"{where}, or a number beside it, overflows; accepted: finite numbers"
            )
        if gaps[k] > 0.0:
            return self.layout.error(
                f"{where}: a gap of {gaps[k]:.6g} s; accepted: at most {self.max_gap:.6g} s, "
                "max_gap, or bad, to say what becomes of gaps"
            )
        what = "repeated" if gaps[k] == 0.0 else "decreasing"
        return self.layout.error(
            f"{where} is {what} ({t[k]:.9g} s after the first); accepted: time stamps that grow, a "
            "rate in Hz, or bad, to say what becomes of such rows"
        )

    def _sorted_out(
        self, t: NDArray[np.float64], values: NDArray[np.float64], start: float
    ) -> Chunk:
        numbers = np.asarray(np.isfinite(values).all(axis=1))
        usable = np.isfinite(t) & (numbers | (self.bad == "hold"))
        if self.bad == "hold" and self.last is None:  # nothing to hold before the first
            usable &= np.logical_or.accumulate(usable & numbers)
        known = np.maximum.accumulate(np.concatenate([[start], np.where(usable, t, -math.inf)]))
        keep = usable & (t > known[:-1])
        self.dropped += int((~keep).sum())
        at = np.flatnonzero(keep)
        chunk = Chunk(t[at], values[at], [])
        if self.bad == "hold":
            return self._held(chunk, numbers[at])
        gaps = np.diff(chunk.t, prepend=start)
        long = np.isfinite(gaps) & (gaps > self.max_gap)
        self.gaps += int(long.sum())
        if self.bad == "split":
            left_out = np.diff(at, prepend=-1) > 1
            left_out[:1] = (left_out[:1] | self.cut) & (self.last is not None)
            self.cut = bool(at[-1] < len(t) - 1) if len(at) else True
            chunk.cuts.extend(np.flatnonzero(left_out | long).tolist())
        return chunk

    def _held(self, chunk: Chunk, numbers: NDArray[np.bool_]) -> Chunk:
        """The last row in the place of rows that are no numbers, and once more in each gap."""
        t, values, first = chunk.t, chunk.values, 0
        if self.last is not None:
            t, values, first = np.append(self.last[0], t), np.vstack([self.last[1], values]), 1
            numbers = np.append(True, numbers)
        self.held += int((~numbers).sum())
        values = values[np.maximum.accumulate(np.where(numbers, np.arange(len(t)), 0))]
        gaps = np.diff(t)
        ends = np.flatnonzero(gaps > self.max_gap) + 1
        self.gaps += len(ends)
        t = np.insert(t, ends, t[ends] - np.minimum(self.usual, 0.5 * gaps[ends - 1]))
        return Chunk(t[first:], np.insert(values, ends, values[ends - 1], axis=0)[first:], [])
