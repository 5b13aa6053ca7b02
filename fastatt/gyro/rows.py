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

from fastatt.gyro.intervals import GAP, MISSING, REGULAR
from fastatt.gyro.tables import Table

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
ON_BAD_ROWS = ("refuse", "drop", "split")
_AHEAD = 8  # rows that distinguish outliers from a reset; as many successive rows can be outliers
_SHOWN = 3  # events of each kind that the summary lists
_SHARED = 0.05  # share of rows (at least 3) with a repeated stamp, beyond which stamps are shared


class Event(NamedTuple):
    """What became of a row, or of the interval before it, as in :class:`GyroLog`."""

    what: str
    row: int
    t: float


class Samples(NamedTuple):
    """Rows in order, as samples.

    ``t`` has the times from the first sample, s, and ``rows`` the indices in the table. ``cuts``
    are the first samples of pieces, ``events`` as in :class:`GyroLog`, and ``said`` the parts of
    the summary.
    """

    t: Floats
    rows: NDArray[np.int64]
    cuts: list[int]
    events: list[Event]
    said: list[str]


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
    numbers = np.asarray(np.isfinite(rates).all(axis=1))
    usable = np.isfinite(t) & numbers
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
    longest = GAP * usual if max_gap is None else max_gap
    dropped, resets = _misplaced(s, usual, longest)
    resets = [k - int(np.searchsorted(dropped, k)) for k in resets]
    s, rows = np.delete(s, dropped), np.delete(rows, dropped)
    if resets:  # the time that passed is unknown: one usual interval
        steps = np.diff(s)
        steps[np.array(resets) - 1] = usual
        s = np.append(0.0, np.cumsum(steps))
    s = s - s[:1]
    gaps = np.flatnonzero((np.diff(s) > longest) | (np.diff(np.cumsum(jumps)[rows]) > 0)) + 1
    kinds = {
        "rows dropped": np.delete(np.arange(len(t)), rows),
        "gaps": rows[gaps],
        "clock resets": rows[np.array(resets, dtype=int)],
    }
    since = np.append(0.0, s)[np.searchsorted(rows, np.arange(len(t)))]  # of the sample before
    events = [Event(what, int(k), float(since[k])) for what, at in kinds.items() for k in at]
    said = [
        _said(table, [e for e in events if e.what == what]) for what in kinds if kinds[what].size
    ]
    events.sort(key=lambda event: event.row)
    if on_bad_rows == "refuse" and events:
        k = events[0].row
        raise table.error(
            f"{clock[:60]} in {table.place(k)}{_what(events[0], t[: k + 1], longest)}"
            if usable[k]
            else f"{clock[:60]} in {table.place(k)}, or a number beside it, overflows; accepted: "
            "finite numbers"
        )
    samples = Samples(s, rows, [], events, said)
    if on_bad_rows == "split":
        left_out = np.flatnonzero(np.diff(rows) > 1) + 1
        # a repeated row takes the place of no sample
        empty = np.cumsum(~numbers)
        missing = s[left_out] - s[left_out - 1] > MISSING * usual
        missing |= empty[rows[left_out]] > empty[rows[left_out - 1]]
        samples.cuts.extend(sorted({*left_out[missing].tolist(), *gaps.tolist(), *resets}))
    return samples


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
    """Which rows share the stamp of the row before and do not repeat it, unless these are few."""
    differs = np.ones(len(s), dtype=bool)
    differs[1:] = (rates[1:] != rates[:-1]).any(axis=1)
    shared = differs & (np.diff(s, prepend=np.nan) == 0.0)
    return shared if shared.sum() >= max(3.0, _SHARED * len(s)) else np.zeros_like(shared)


def _misplaced(s: Floats, usual: float, longest: float) -> tuple[list[int], list[int]]:
    """Outliers, and the rows at which the clock was reset."""
    dropped: set[int] = set()
    resets: list[int] = []
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(s)
        follows = (steps > 0.0) & (steps <= longest)
        odd = np.flatnonzero(~follows) + 1
        if len(s) > 2 and steps[0] > max(longest, np.ptp(s[1:])) and follows[1]:
            dropped.add(0)  # the first stamp is of another clock
            odd = odd[odd > 1]
        for i in odd.tolist():
            if i in dropped:
                continue
            kept = [k for k in range(max(0, i - 2 * _AHEAD), i) if k not in dropped][-_AHEAD - 1 :]
            after = s[i : i + _AHEAD + 1]
            since = after - s[kept[-1]]
            if 0.0 < since[0] <= longest:
                continue
            going_on = np.flatnonzero((since > 0.0) & (since <= longest))
            further = np.diff(after)
            believed = len(further) > 0 and 0.0 < further[0] <= longest
            regular = believed and ((further > 0.0) & (further <= REGULAR * usual)).all()
            if since[0] == 0.0 or (going_on.size and not regular):
                dropped.update(range(i, i + (int(going_on[0]) if going_on.size else 1)))
            elif since[0] < 0.0 and not believed:
                dropped.add(i)
            elif since[0] < 0.0:
                before = [k for k in kept if 0.0 < s[i] - s[k] <= longest][-1:]
                dropped.update(range(before[0] + 1, i) if before else ())
                resets += [] if before else [i]
    if resets[:1] == [1]:  # only a stamp of another clock came before
        return sorted({0, *dropped}), resets[1:]
    return sorted(dropped), resets


def _what(event: Event, t: Floats, longest: float) -> str:
    """What is wrong with the last of some times, of which the others are right."""
    step, accepted = float(t[-1] - t[-2:][0]), 'on_bad_rows="drop" or "split"'
    if event.what == "gaps":
        found, most = "", f"at most {longest:.6g} s, or more with max_gap="
        if step <= longest:
            found, most = ", by the packet counter", "a counter without jumps"
        return f": a gap of {step:.6g} s{found}; accepted: {most}; {accepted} accepts any gap"
    what = "an outlier" if step > 0.0 or len(t) == 1 else "decreasing" if step else "repeated"
    if event.what == "clock resets":
        what = "decreasing, and the clock goes on from there"
    return (
        f" is {what} ({t[-1] - t[0]:.9g} s after the first); accepted: increasing time stamps, "
        f"rate= in their place, or {accepted}"
    )
