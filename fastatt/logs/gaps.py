"""Rows that are not samples: without numbers, with stamps that do not increase, and at gaps.

A stamp that does not increase, or jumps ahead, is an outlier if the rows after it continue from the
row before it; otherwise the clock was reset, or there is a gap. Many equal stamps are those of
packets, or too coarse for the rate: they are no times of samples, and are refused.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.logs.tables import Table

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
ON_BAD_ROWS = ("refuse", "drop", "split", "hold")
_GAP = 10.0  # an interval this many times the usual one is a gap
_AHEAD = 8  # rows that distinguish outliers from a reset; as many successive rows can be outliers
#: the longest step between successive rows, in usual intervals
REGULAR = 2.5
_MISSING = 1.5  # usual intervals across rows left out, beyond which a sample is missing there
_SHOWN = 3  # events of each kind that the summary lists
_SHARED = 0.05  # share of rows (at least 3) with a repeated stamp, beyond which stamps are shared


class Event(NamedTuple):
    """What became of a row, or of the interval before it, as in :class:`GyroLog`."""

    what: str
    row: int
    t: float


class Samples(NamedTuple):
    """Rows in order, as samples.

    ``t`` has the times from the first sample, s, and ``rows`` the indices in the table. ``held``
    are samples that repeat the rates of the sample before; ``added`` are samples without a row,
    which hold the rates up to the end of a gap. ``cuts`` are the first samples of pieces,
    ``events`` as in :class:`GyroLog`, and ``said`` the parts of the summary.
    """

    t: Floats
    rows: NDArray[np.int64]
    held: Flags
    added: Flags
    cuts: list[int]
    events: list[Event]
    said: list[str]

    def of(self, values: Floats) -> Floats:
        """The values of the samples, the first three of which are rates."""
        values = values[self.rows]
        values[self.added, 3:] = np.nan
        last = np.maximum.accumulate(np.where(self.held, 0, np.arange(len(values))))
        values[:, :3] = values[last, :3]
        return values


def in_order(
    table: Table,
    clock: str,
    t: Floats,
    rates: Floats,
    on_bad_rows: str,
    max_gap: float | None,
    jumps: Flags,
    usual: float | None,
) -> Samples:
    """The rows of a table that are samples; ``on_bad_rows`` as in :func:`read_gyro_log`.

    ``t`` (n,) is NaN without a time stamp, ``rates`` (n, 3) in rows without numbers. ``usual`` is
    the usual interval; None takes the median. ``jumps`` (n,) are rows before which packets are
    missing.
    """
    stamped, numbers = np.isfinite(t), np.asarray(np.isfinite(rates).all(axis=1))
    usable = stamped & numbers
    if on_bad_rows == "hold":
        usable = stamped & np.logical_or.accumulate(usable)  # no rates to hold before the first
    rows = np.flatnonzero(usable)
    s = t[rows]
    shared = _shared(s, rates[rows])
    if shared.any():
        raise table.error(
            f"{clock[:60]}: {shared.sum()} rows share the stamp of the row before, the first in "
            f"{table.place(int(np.argmax(shared)))}: packets, or stamps too coarse for the rate; "
            "accepted: increasing time stamps, or rate= in their place"
        )
    if usual is None:
        usual = _usual(s)
    longest = _GAP * usual if max_gap is None else max_gap
    dropped, resets = _misplaced(s, usual, longest)
    resets = [k - int(np.searchsorted(dropped, k)) for k in resets]
    s, rows = np.delete(s, dropped), np.delete(rows, dropped)
    if resets:  # the time that passed is unknown: one usual interval
        steps = np.diff(s)
        steps[np.array(resets) - 1] = usual
        s = np.append(0.0, np.cumsum(steps))
    s = s - s[:1]
    gaps = np.flatnonzero((np.diff(s) > longest) | (np.diff(np.cumsum(jumps)[rows]) > 0)) + 1
    held = ~numbers[rows]
    kinds = {
        "rows dropped": np.delete(np.arange(len(t)), rows),
        "rows held": rows[held],
        "gaps": rows[gaps],
        "clock resets": rows[np.array(resets, dtype=int)],
    }
    since = np.append(0.0, s)[np.searchsorted(rows, np.arange(len(t)))]  # of the sample before
    events = [Event(what, int(k), float(since[k])) for what, at in kinds.items() for k in at]
    said = [
        _said(table, [e for e in events if e.what == what]) for what in kinds if kinds[what].size
    ]
    plain = np.zeros(len(rows), dtype=bool)
    events.sort(key=lambda event: event.row)
    if on_bad_rows == "refuse" and events:
        k = events[0].row
        raise table.error(
            f"{clock[:60]} in {table.place(k)}{_what(events[0], t[: k + 1], longest)}"
            if usable[k]
            else f"{clock[:60]} in {table.place(k)}, or a number beside it, overflows; accepted: "
            "finite numbers"
        )
    samples = Samples(s, rows, plain, plain, [], events, said)
    if on_bad_rows == "split":
        left_out = np.flatnonzero(np.diff(rows) > 1) + 1
        # a repeated row takes the place of no sample
        empty = np.cumsum(~numbers)
        missing = s[left_out] - s[left_out - 1] > _MISSING * usual
        missing |= empty[rows[left_out]] > empty[rows[left_out - 1]]
        samples.cuts.extend(sorted({*left_out[missing].tolist(), *gaps.tolist(), *resets}))
    return _held(samples, held, gaps, usual) if on_bad_rows == "hold" else samples


def _said(table: Table, events: list[Event]) -> str:
    """The number of events of a kind, and where the first ones are."""
    some = [f"{table.place(e.row)} at {e.t:.6g} s" for e in events[:_SHOWN]]
    kind = events[0].what if len(events) > 1 else re.sub(r"s\b", "", events[0].what)
    return f"{len(events)} {kind}: {', '.join([*some, '...'][: len(events)])}"


def _usual(s: Floats) -> float:
    """The median of the intervals above 0; infinite without one."""
    steps = np.diff(s)
    return float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else np.inf


def _shared(s: Floats, rates: Floats) -> Flags:
    """Which rows share the stamp of the row before, unless these are single repetitions."""
    equal: Flags = np.asarray(np.diff(s, prepend=np.nan) == 0.0)
    none = np.zeros(len(s), dtype=bool)
    if equal.sum() < max(3.0, _SHARED * len(s)):
        return none
    same = np.zeros(len(s), dtype=bool)
    same[1:] = (rates[1:] == rates[:-1]).all(axis=1)
    repeated = same[equal].mean() > 0.5 and not same[~equal].mean() > 0.5
    return none if repeated else equal


def _misplaced(s: Floats, usual: float, longest: float) -> tuple[list[int], list[int]]:
    """Outliers, and the rows at which the clock was reset."""
    n = len(s)
    dropped: set[int] = set()
    resets: list[int] = []

    def follows(step: float) -> bool:
        return 0.0 < step <= longest

    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(s)
        odd = np.flatnonzero(~((steps > 0.0) & (steps <= longest))) + 1
        if n > 2 and steps[0] > max(longest, np.ptp(s[1:])) and follows(steps[1]):
            dropped.add(0)  # the first stamp is of another clock
            odd = odd[odd > 1]
        done = 0
        for first in odd.tolist():
            if first < done:
                continue
            i, last = first, first - 1
            while i < n and not follows(s[i] - s[last]):
                after = s[i : i + _AHEAD + 1]
                following = np.diff(after)
                regular = len(following) > 0 and bool(
                    ((following > 0.0) & (following <= REGULAR * usual)).all()
                )
                goes_on = bool(((after > s[last]) & (after - s[last] <= longest)).any())
                ahead = s[i] > s[last]
                believed = ahead if len(following) == 0 else follows(following[0])
                if s[i] != s[last] and (regular or (believed and not goes_on)):
                    if not ahead:
                        before = _before(s, i, dropped)
                        if before is not None and follows(s[i] - s[before]):
                            dropped.update(range(before + 1, i))
                        else:
                            resets.append(i)
                    break
                dropped.add(i)
                i += 1
            done = i + 1
    if resets[:1] == [1]:  # only a stamp of another clock came before
        return sorted({0, *dropped}), resets[1:]
    return sorted(dropped), resets


def _before(s: Floats, i: int, dropped: set[int]) -> int | None:
    """The last earlier row, at most ``_AHEAD`` rows before row i; None if there is none."""
    kept = [k for k in range(max(0, i - 2 * _AHEAD), i) if k not in dropped][-_AHEAD - 1 :]
    earlier = [k for k in kept if s[k] < s[i]]
    return earlier[-1] if earlier else None


def _what(event: Event, t: Floats, longest: float) -> str:
    """What is wrong with the last of some times, of which the others are right."""
    step, accepted = float(t[-1] - t[-2:][0]), 'on_bad_rows="drop", "split" or "hold"'
    if event.what == "gaps":
        of_packets = "" if step > longest else ", by the packet counter"
        return (
            f": a gap of {step:.6g} s{of_packets}; accepted: at most {longest:.6g} s, or more with "
            f"max_gap=; {accepted} accepts any gap"
        )
    what = "an outlier" if step > 0.0 or len(t) == 1 else "decreasing" if step else "repeated"
    if event.what == "clock resets":
        what = "decreasing, and the clock goes on from there"
    return (
        f" is {what} ({t[-1] - t[0]:.9g} s after the first); accepted: increasing time stamps, "
        f"rate= in their place, or {accepted}"
    )


def _held(samples: Samples, held: Flags, gaps: NDArray[np.int64], usual: float) -> Samples:
    """Repeat the last rates in rows without numbers, and once more before the end of a gap."""
    t, rows = samples.t, samples.rows
    ends = t[gaps] - np.minimum(usual, 0.5 * (t[gaps] - t[gaps - 1]))
    return samples._replace(
        t=np.insert(t, gaps, ends),
        rows=np.insert(rows, gaps, rows[gaps - 1]),
        held=np.insert(held, gaps, True),
        added=np.insert(np.zeros(len(t), dtype=bool), gaps, True),
    )
