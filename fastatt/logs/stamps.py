"""Time stamps: their formats and units."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from fastatt.logs import names
from fastatt.logs.names import TIME_UNITS, GyroLogWarning

if TYPE_CHECKING:
    from fastatt.logs.tables import Table

NO_STAMP = np.iinfo(np.int64).min  # missing, among whole numbers and dates
DATE = "1970-01-01T00:00"
Kind = Literal["float", "int", "date", "day"]
# formats of stamps that are not plain numbers; a double does not hold 16 digits
_KINDS: dict[Kind, re.Pattern[str]] = {
    "date": re.compile(r"(19|20)\d\d-\d\d-\d\d[T ]\d\d:\d\d.*", re.ASCII),
    "day": re.compile(r"(\d{1,2}):([0-5]\d):([0-5]\d)(?:\.(\d+))?", re.ASCII),
    "int": re.compile(r"\d{16,19}", re.ASCII),
}
# years that 64 bits of ns hold; NumPy would warn of time zones, so they are removed
_ZONE = re.compile(
    r"(?P<local>(19|20)\d\d-[\d:T .-]*?)(Z|(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d))?",
    re.ASCII,
)
_DAY = 86_400 * 10**9  # ns
# sample rates of gyros, Hz; another rate means a wrong unit
SLOWEST, FASTEST = 0.1, 1e6
PLAUSIBLE = "accepted: above 0.1 Hz and up to 1 MHz"
# usual sample rates of gyros, Hz, which distinguish units that are a factor 1000 apart
_USUAL = (9.5, 9500.0)
_SLOW = 0.475  # Hz; from here to the usual rates, s and ms are equally likely
_EPOCH = (6.3e8, 4.1e9)  # s from 1970 to 1990 and 2100
_SLOWEST_EPOCH = 1e-4  # Hz; slower stamps in the range of dates have another unit


def kind(cell: str) -> Kind:
    """The format of a column of time stamps, from its first cell."""
    return next((k for k, pattern in _KINDS.items() if pattern.fullmatch(cell)), "float")


def from_text(how: Kind, cells: Sequence[str]) -> NDArray[Any]:
    """Numbers; dates (ISO 8601) and times of day as ns; NaN or ``NO_STAMP`` for invalid text.

    Dates are counted from 1970, UTC; those without a zone are taken as UTC.
    """
    if how == "float":
        return np.array([_number(cell) for cell in cells], dtype=np.float64)
    if how == "int":
        whole = [int(c) if c.isascii() and c.isdigit() and len(c) < 20 else -1 for c in cells]
        return np.array([w if 0 <= w < 2**63 else NO_STAMP for w in whole], dtype=np.int64)
    one = _date if how == "date" else _time_of_day
    return np.array([one(cell.strip()) for cell in cells], dtype=np.int64)


def _number(cell: str) -> float:
    try:
        return float(cell) if cell.isascii() and "_" not in cell else math.nan
    except ValueError:
        return math.nan


def _date(cell: str) -> int:
    zone = _ZONE.fullmatch(cell)
    if zone is None:
        return NO_STAMP
    minutes = 60 * int(zone["hours"] or 0) + int(zone["minutes"] or 0)
    ahead = np.timedelta64(-minutes if zone["sign"] == "-" else minutes, "m")
    try:
        return int((np.datetime64(zone["local"], "ns") - ahead).astype(np.int64))
    except ValueError:
        return NO_STAMP


def _time_of_day(cell: str) -> int:
    match = _KINDS["day"].fullmatch(cell)
    if match is None:
        return NO_STAMP
    hours, minutes, seconds = map(int, match.group(1, 2, 3))
    part = int((match[4] or "").ljust(9, "0")[:9])
    return (3600 * hours + 60 * minutes + seconds) * 10**9 + part


def known(stamps: NDArray[Any]) -> NDArray[np.bool_]:
    """Which stamps, or numbers, are valid."""
    good: NDArray[np.bool_] = stamps != NO_STAMP
    return np.isfinite(stamps) if stamps.dtype.kind == "f" else good


def joined(columns: Sequence[NDArray[Any]]) -> NDArray[Any] | None:
    """The stamps of one column, or ns from two columns of s and ns; None for no column."""
    if len(columns) < 2:
        return columns[0] if columns else None
    whole, part = (np.where(known(x), x, -1).astype(np.float64) for x in columns)
    good = (whole >= 0.0) & (whole < 9e9) & (part >= 0.0) & (part < 9e9)
    total = np.where(good, whole, 0.0).astype(np.int64) * 10**9
    return np.where(good, total + np.where(good, part, 0.0).astype(np.int64), NO_STAMP)


def past_midnight(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Times of day, ns, continued after midnight."""
    good = known(stamps)
    days = np.round(np.diff(stamps[good], prepend=stamps[good][:1]) / _DAY).astype(np.int64)
    whole = stamps.copy()
    whole[good] -= _DAY * np.cumsum(days)
    return whole


def times(
    table: Table, clock: list[int], stamps: NDArray[Any], time_unit: str | None
) -> tuple[NDArray[np.float64], float]:
    """Times from the first stamp, s, NaN for an invalid stamp; and the clock there, s."""
    good = known(stamps)
    if not good.any():
        raise table.error(f"{table.column(clock[0])} has no time stamp")
    if len(clock) == 1 and kind(table.first_row[clock[0]]) == "day":
        stamps = past_midnight(stamps)
    unit = unit_of(table, clock, stamps, time_unit)
    first = stamps[np.argmax(good)]
    with np.errstate(over="ignore", invalid="ignore"):
        t = np.where(good, (stamps - first) / TIME_UNITS[unit], np.nan)
    return t, float(first) / TIME_UNITS[unit]


def unit_of(table: Table, clock: list[int], stamps: NDArray[Any], said: str | None) -> str:
    """The unit of time stamps: as given, as in the name of their column, or from their size.

    Raises ``GyroLogError`` if the size does not determine it, or the sample rate is not a gyro's.
    """
    if len(clock) > 1 or kind(table.first_row[clock[0]]) in ("date", "day"):
        return "ns"
    if said is not None:
        return said
    name = table.column(clock[0])[:60]
    numbers = stamps[known(stamps)].astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        gaps = np.diff(numbers - numbers[0])
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    usual = float(np.median(gaps)) if gaps.size else math.nan
    hertz = {u: scale / usual for u, scale in TIME_UNITS.items()}
    plain = [u for u in TIME_UNITS if u != "100us"]
    fitting = [f"{hertz[u]:.4g} Hz in {u}" for u in plain if SLOWEST < hertz[u] <= FASTEST]
    options = f"given as time_unit ({' or '.join(fitting) or 'none fits'})"
    found = names.time_unit(name)
    if found is not None:
        if found not in TIME_UNITS:
            raise table.error(
                f"{name}: found the unit {found!r}; accepted: s, ms, us, ns, or the unit of time, "
                f"{options}"
            )
        if gaps.size and not SLOWEST < hertz[found] <= FASTEST:
            raise table.error(
                f"{name} gives {hertz[found]:.4g} Hz in {found}; {PLAUSIBLE}, or the unit of "
                f"time, {options}"
            )
        return found
    if not gaps.size:
        return "s"
    possible = plain
    if "sampletimefine" in name.lower():  # Xsens: us for DOT, tenths of ms for others
        possible = ["100us", "us"]
        said_rate = [u for u in possible for x in table.rates if 0.8 < hertz[u] / x < 1.25]
        possible = said_rate[:1] or possible
    middle = float(np.median(numbers))
    dated = [u for u in possible if _EPOCH[0] < middle / TIME_UNITS[u] < _EPOCH[1]]
    dated = [u for u in dated if _SLOWEST_EPOCH < hertz[u] <= FASTEST]
    # stamps in the range of dates have the unit of dates, also at a low rate
    guessed = dated or [u for u in possible if _USUAL[0] <= hertz[u] < _USUAL[1]]
    doubtful = not dated and guessed == ["ms"] and hertz["s"] > _SLOW
    if len(guessed) != 1 or doubtful or (dated and hertz[dated[0]] <= SLOWEST):
        raise table.error(
            f"{name} has no unit, and its interval {usual:.6g} is that of no usual rate or of more "
            f"than one; accepted: the unit of time, {options}"
        )
    if guessed != ["s"]:
        warnings.warn(
            f"{table.name}: {name} has no unit: taken as {guessed[0]} ({hertz[guessed[0]]:.4g} "
            f"Hz); time_unit says another",
            GyroLogWarning,
            stacklevel=2,
        )
    return guessed[0]
