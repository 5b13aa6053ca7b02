"""Time stamps: their formats and units."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.gyro.columns import TIME_UNITS
from fastatt.gyro.intervals import GAP
from fastatt.gyro.log import GyroLogError

NO_STAMP = np.iinfo(np.int64).min  # missing, among whole numbers and dates: NaT
DATE = "1970-01-01T00:00"
Kind = Literal["float", "int", "date"]
# formats of stamps that are not plain numbers; a double does not hold 16 digits
_KINDS: dict[Kind, re.Pattern[str]] = {
    "date": re.compile(r"(19|20)\d\d-\d\d-\d\d[T ]\d\d:\d\d.*", re.ASCII),
    "int": re.compile(r"\d{16,19}", re.ASCII),
}
# dates that are not read
_OTHER_DATES = {
    "a date of which day and month can be mistaken": re.compile(r"\d{1,4}([/.])\d{1,2}\1\d{1,4}.*"),
    "a date by the day of the year": re.compile(r"\d{4}-\d{3}(?!\d).*"),
}
# sample rates of gyros, Hz; another rate means a wrong unit
SLOWEST, FASTEST = 0.1, 1e6


def pandas() -> Any:
    """pandas, which reads text."""
    return checks.optional("read_gyro_log of a text", "pandas", "fastatt[logs]")


class Clock(NamedTuple):
    """Columns of time stamps, none by default, and the format of each.

    ``parts`` is what they have in place of numbers in the unit that the name says, or "".
    """

    columns: Sequence[int] = ()
    formats: Sequence[Kind] = ()
    name: str = ""
    unit: str | None = None
    parts: str = ""

    def times(
        self, stamps: NDArray[Any], time_unit: str | None
    ) -> tuple[NDArray[np.float64], float]:
        """Times from the first stamp, s, NaN for an invalid stamp; and the clock there, s.

        Raises ``GyroLogError`` without a unit, or for one of which the sample rate is no gyro's.
        """
        good, unit = valid(stamps), "ns"
        if not good.any():
            raise GyroLogError(f"{self.name} has no time stamp")
        if not self.parts:
            unit = _unit_of(self.name, stamps[good], time_unit, self.unit)
        elif time_unit is not None:
            raise GyroLogError(
                f"time_unit: found {time_unit!r} for {self.name}, {self.parts}; accepted: none"
            )
        first = stamps[np.argmax(good)]
        with np.errstate(over="ignore", invalid="ignore"):
            t = np.where(good, (stamps - first) / TIME_UNITS[unit], np.nan)
        return t, float(first) / TIME_UNITS[unit]

    def check_rate(self, stamps: NDArray[Any], time_unit: str | None, rate: float) -> None:
        """Refuse a rate, Hz, that differs from that of the stamps, in any unit if none is known."""
        good = valid(stamps)
        if good.sum() < 2:
            return
        t = np.where(good, stamps - stamps[np.argmax(good)], np.nan).astype(np.float64)
        known = [u for u in (self.unit, time_unit) if u in TIME_UNITS]
        scales = [TIME_UNITS[unit] for unit in known[:1]] or [*TIME_UNITS.values()]
        if not any(_agrees(t / scale, rate) for scale in scales):
            mean = scales[0] * (good.sum() - 1) / np.nanmax(t)
            stamped = f"{mean:.6g} Hz on average" if known else "another rate in every unit"
            raise GyroLogError(
                f"rate: found {rate:g} Hz, but the stamps in {self.name} give {stamped}, or gaps; "
                "accepted: no rate, which reads the stamps"
            )


def kind(cell: str) -> Kind:
    """The format of a column of time stamps, from its first cell.

    Raises ``GyroLogError`` for dates in another format.
    """
    for what, pattern in _OTHER_DATES.items():
        if pattern.fullmatch(cell):
            raise GyroLogError(
                f"time stamps: found {cell[:40]!r}, {what}; accepted: dates of ISO 8601 "
                "(YYYY-MM-DDThh:mm:ss) and numbers"
            )
    return next((k for k, pattern in _KINDS.items() if pattern.fullmatch(cell)), "float")


def from_text(how: Kind, cells: list[str]) -> NDArray[Any]:
    """Whole numbers; dates (ISO 8601) as ns; ``NO_STAMP`` for invalid text.

    Dates are counted from 1970, UTC; those without a zone are taken as UTC.
    """
    if how == "int":
        whole = [int(c) if c.isascii() and c.isdigit() and len(c) < 20 else -1 for c in cells]
        return np.array([w if 0 <= w < 2**63 else NO_STAMP for w in whole], dtype=np.int64)
    moments = pandas().to_datetime(cells, format="ISO8601", errors="coerce", utc=True)
    return np.asarray(moments.tz_localize(None), "M8[ns]").view(np.int64)


def number(value: Any) -> float:
    """A number, NaN for what is none, also for underscores and digits of other scripts."""
    try:
        if isinstance(value, bool) or (isinstance(value, str) and "_" in value):
            return math.nan
        return float(value) if not isinstance(value, str) or value.isascii() else math.nan
    except (TypeError, ValueError, OverflowError):
        return math.nan


def valid(stamps: NDArray[Any]) -> NDArray[np.bool_]:
    """Which stamps, or numbers, are valid."""
    good: NDArray[np.bool_] = stamps != NO_STAMP
    return np.isfinite(stamps) if stamps.dtype.kind == "f" else good


def joined(columns: Sequence[NDArray[Any]]) -> NDArray[Any] | None:
    """The stamps of one column, or ns from two columns of s and ns; None for no column."""
    if len(columns) < 2:
        return columns[0] if columns else None
    whole, part = (np.where(valid(x), x, -1).astype(np.float64) for x in columns)
    good = (whole >= 0.0) & (whole < 9e9) & (part >= 0.0) & (part < 9e9)
    total = np.where(good, whole, 0.0).astype(np.int64) * 10**9
    return np.where(good, total + np.where(good, part, 0.0).astype(np.int64), NO_STAMP)


def _unit_of(name: str, stamps: NDArray[Any], time_unit: str | None, named: str | None) -> str:
    """The unit as given, or that of a column's name or format, which must be a gyro's."""
    with np.errstate(over="ignore", invalid="ignore"):
        gaps = np.diff((stamps - stamps[0]).astype(np.float64))
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    usual = float(np.median(gaps)) if gaps.size else math.nan
    hertz = {u: scale / usual for u, scale in TIME_UNITS.items()}
    fitting = [u for u in TIME_UNITS if SLOWEST < hertz[u] <= FASTEST]
    if named in fitting or (named in TIME_UNITS and not gaps.size):
        if time_unit not in (None, named):
            raise GyroLogError(
                f"time_unit: found {time_unit!r}, but {name} is in {named}; accepted: {named}, or "
                "none"
            )
        return str(named)
    if time_unit is not None:
        return time_unit
    said = f"gives {hertz[named]:.4g} Hz" if named in TIME_UNITS else f"is in {named!r}"
    rates = " or ".join(f"{hertz[u]:.4g} Hz in {u}" for u in fitting) or "none fits"
    raise GyroLogError(
        f"{name} {said if named else 'has no unit'}; accepted: the unit of time, given as "
        f"time_unit ({rates}), or a sample rate, as rate"
    )


def _agrees(t: NDArray[np.float64], rate: float) -> bool:
    """Whether times, s, are those of samples at a rate, Hz, or no times of samples at all.

    These repeat, as those of packets do, or go back.
    """
    t = t[np.isfinite(t)]
    steps = np.diff(t)
    ahead = steps[steps > 0.0]
    if not ahead.size or (steps < 0.0).any():
        return True
    usual = max(1.0 / rate, float(np.quantile(ahead, 0.95)))
    few = (len(ahead) < 0.95 * len(steps)) * 0.04  # packets of unequal sizes, at the ends
    return bool(abs(rate * np.mean(steps) - 1.0) < 0.01 + few and ahead.max() <= GAP * usual)
