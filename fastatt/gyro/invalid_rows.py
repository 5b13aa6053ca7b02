"""Rows that are not samples: without numbers, with stamps that do not increase, and at gaps.

Where a stamp does not increase, a few rows before or after it are outliers. If more are, the clock
was reset, after an unknown time. Many equal stamps are those of packets, or too coarse for the
rate: they are no times of samples, nor are those of rows that arrive in bursts. All these are
refused. Samples that a logger lost are counted by the intervals.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from fastatt.gyro.intervals import GAP, apart
from fastatt.gyro.log import GyroLogError, GyroLogWarning
from fastatt.gyro.tables import Table
from fastatt.rounding import warn

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
ON_BAD_ROWS = ("refuse", "drop")
_MOST = 8  # successive outliers; more are of another clock
_SHOWN = 3  # rows of each kind that the summary lists
_MISSING = 0.01  # share of samples; more that are missing are warned of
_SHARED = 0.05  # share of rows (at least 3) with a repeated stamp, beyond which stamps are shared


def in_order(
    table: Table,
    clock: str,
    t: Floats,
    rates: Floats,
    on_bad_rows: str,
    max_gap: float | None,
    jumps: Flags,
) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Times of samples from the first one, s, their rows, and what is said of the other rows.

    ``on_bad_rows`` is as in :func:`read_gyro_log`. ``t`` (n,) is NaN without a time stamp,
    ``rates`` (n, 3) in rows without numbers. ``jumps`` (n,) are rows before which packets are
    missing.
    """
    usable = np.logical_and.reduce([np.isfinite(x) for x in (t, *rates.T)])
    rows = np.flatnonzero(usable)
    s = t[rows]
    shared = _shared(s, rates, rows)
    if len(shared):
        raise GyroLogError(
            f"{clock[:60]}: {len(shared)} rows share the stamp of the row before, the first in "
            f"{table.place(shared[0])}: packets, or stamps too coarse for the rate; "
            "accepted: increasing time stamps, or rate= in their place"
        )
    kept = _without_outliers(s)
    s, rows = s[kept], rows[kept]
    s = s - s[:1]
    steps = np.diff(s)
    usual = float(np.median(steps)) if steps.size else np.inf
    longest = GAP * usual if max_gap is None else max_gap
    resets = rows[1:][steps <= 0.0]
    if resets.size:
        raise GyroLogError(
            f"{clock[:60]} in {table.place(resets[0])} is decreasing, and the clock goes on "
            "from there; accepted: a log of one clock, or rate= in place of time stamps"
        )
    _refuse_bursts(clock, steps)
    gaps = steps > longest
    if jumps.any():
        gaps |= np.diff(np.cumsum(jumps)[rows]) > 0
    dropped = np.delete(np.arange(len(t)), rows) if len(rows) < len(t) else rows[:0]
    kinds = [("rows dropped", dropped), ("gaps", rows[1:][gaps])]
    kinds = [(kind, bad) for kind, bad in kinds if bad.size]
    if kinds and on_bad_rows == "refuse":
        k, kind = min((int(bad[0]), kind) for kind, bad in kinds)
        what = ", or a number beside it, overflows; accepted: finite numbers"
        if usable[k]:
            what = _what(kind, t[: k + 1], longest)
        raise GyroLogError(f"{clock[:60]} in {table.place(k)}{what}")
    before = np.append(0.0, s)
    said = [_said(table, kind, x, before[np.searchsorted(rows, x)]) for kind, x in kinds]
    return s, rows, _lost(table, s, steps, usual, rows) + said


def _refuse_bursts(clock: str, steps: Floats) -> None:
    """Refuse stamps of which several follow each other closely, again and again."""
    if not len(steps) or np.mean(steps) <= 2.0 * np.min(steps):
        return
    usual, mean = float(np.quantile(steps, 0.25)), float(np.mean(steps))
    pauses = steps[steps > 3.0 * usual]
    if len(pauses) > max(_MOST, _SHARED * len(steps)) and mean > 2.0 * usual:
        short, long = apart(usual, float(np.median(pauses)))
        raise GyroLogError(
            f"{clock[:60]}: {len(pauses)} intervals of about {long} s among others of {short} s: "
            "stamps of arrival, of packets; accepted: the stamps of samples, or rate= in their "
            f"place ({1.0 / mean:.6g} Hz on average)"
        )


def _lost(
    table: Table, s: Floats, steps: Floats, usual: float, rows: NDArray[np.int64]
) -> list[str]:
    """What is said of samples that are missing between successive rows; warns of many in holes.

    Of gaps, which are accepted by an argument, is not warned.
    """
    holes = np.flatnonzero(steps > 1.5 * usual)
    holes = holes[rows[holes + 1] - rows[holes] == 1]
    if not holes.size:
        return []
    missing = np.round(steps[holes] / usual) - 1.0
    # late stamps are followed by short intervals; coarse ones stay near even times
    count = min(missing.sum(), np.round(s[-1] / usual) - len(steps))
    even = np.linspace(s[0], s[-1], len(s))
    if count < 1.0 or (len(holes) > 0.1 * len(s) and np.abs(s - even).max() < 2.0 * usual):
        return []
    k = holes[np.argmax(steps[holes])]
    text = (
        f"{count:.0f} {'samples' if count > 1 else 'sample'} missing, the longest interval "
        f"{steps[k]:.6g} s, before {table.place(rows[k + 1])}"
    )
    if missing[steps[holes] <= GAP * usual].sum() >= _MISSING * (count + len(s)):
        warn(
            f"{table.name}: {text}; the attitudes after them rest on rates between "
            "the others: correct them with a reference, or record again",
            GyroLogWarning,
        )
    return [text]


def _said(table: Table, kind: str, rows: NDArray[np.int64], since: Floats) -> str:
    """The number of rows of a kind, and where the first ones are, by the times before them."""
    shown = zip(rows[:_SHOWN].tolist(), since, strict=False)
    some = [f"{table.place(k)} at {before:.6g} s" for k, before in shown]
    kind = kind if len(rows) > 1 else re.sub(r"s\b", "", kind)
    return f"{len(rows)} {kind}: {', '.join([*some, '...'][: len(rows)])}"


def _shared(s: Floats, rates: Floats, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows that share the stamp of the row before and do not repeat it, unless these are few.

    ``s`` are the stamps of ``rows``, ``rates`` are those of all rows.
    """
    equal = np.flatnonzero(np.diff(s) == 0.0)
    shared: NDArray[np.int64] = rows[equal + 1]
    shared = shared[(rates[shared] != rates[rows[equal]]).any(axis=1)]
    return shared if len(shared) >= max(3.0, _SHARED * len(s)) else shared[:0]


def _without_outliers(s: Floats) -> Flags:
    """Which stamps are no outliers; where the others decrease, the clock was reset.

    Outliers are those before a stamp that are not below it, or those from it on that are not above
    the one before it, whichever are fewer.
    """
    kept, begin = np.ones(len(s), dtype=bool), 0
    for i in (np.flatnonzero(np.diff(s) <= 0.0) + 1).tolist():
        before = np.arange(max(begin, i - 2 * _MOST), i)
        before = before[kept[before]]
        if not kept[i] or not before.size:
            continue
        last = s[before[-1]]
        ahead, follows = before[s[before] >= s[i]], s[i : i + _MOST + 1] > last
        behind = int(np.argmax(follows)) if follows.any() else len(follows) + 1
        if s[i] >= last:
            kept[i] = s[i] > last
        elif behind <= min(len(ahead), _MOST):
            kept[i : i + behind] = False
        elif len(ahead) <= _MOST:
            kept[ahead] = False
        else:
            begin = i
    return kept


def _what(kind: str, t: Floats, longest: float) -> str:
    """What is wrong with the last of some times, of which the others are right."""
    step, accepted = float(t[-1] - t[-2:][0]), 'on_bad_rows="drop"'
    if kind == "rows dropped":
        return (
            f" is an outlier, {step:.6g} s after the row before; accepted: increasing time stamps, "
            f"rate= in their place, or {accepted}"
        )
    length, bound = apart(step, longest)
    most = f"at most {bound} s, or more with max_gap="
    if step <= longest:
        most = "a packet counter without jumps"
    return f": a gap of {length} s; accepted: {most}; {accepted} accepts any gap"
