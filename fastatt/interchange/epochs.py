"""Time tags of the CCSDS (ASCII time codes A and B) and the seconds between them, without rounding.

CCSDS 301.0-B-4 (2010), §3.5: YYYY-MM-DDThh:mm:ss.d or YYYY-DDDThh:mm:ss.d, with an optional Z.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from datetime import UTC, date, datetime
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks

_TAG = re.compile(
    r"(\d{4})-(?:(\d{2}-\d{2})|(\d{3}))T([01]\d|2[0-3]):([0-5]\d):(\d{2}(?:\.\d*)?)Z?", re.ASCII
)
_ACCEPTED = "YYYY-MM-DDThh:mm:ss.d or YYYY-DDDThh:mm:ss.d"
_DAY = 86400
_DIGITS = 60
# s; longer than any run, and Unix time was past it in 1973
_LONG = 1e8
# before that day UTC had no leap seconds; local times of the Unix epoch are in 1969 or 1970
_FIRST_LEAPS = "1972"
# UTC days that ended with a leap second (IERS, Bulletin C)
_JUNE = (1972, 1981, 1982, 1983, 1985, 1992, 1993, 1994, 1997, 2012, 2015)
_DECEMBER = (*range(1972, 1980), 1987, 1989, 1990, 1995, 1998, 2005, 2008, 2016)
_LEAPS = sorted(
    [date(year, 6, 30).toordinal() for year in _JUNE]
    + [date(year, 12, 31).toordinal() for year in _DECEMBER]
)


def has_leaps(metadata: Mapping[str, str]) -> bool:
    """Whether a block's time system has leap seconds."""
    return metadata.get("TIME_SYSTEM", "").upper() == "UTC"


def seconds_since(epoch: str, tags: Sequence[str], *, leaps: bool) -> NDArray[np.float64]:
    """Seconds from an epoch to time tags, (S,); ``leaps`` counts UTC's leap seconds.

    Raises ``ValueError`` for text that is not a time tag.
    """
    with localcontext(prec=_DIGITS):
        begin = _count(epoch, leaps=leaps)
        return np.array([float(_count(tag, leaps=leaps) - begin) for tag in tags])


def tags(epoch: str, t: NDArray[np.float64], *, leaps: bool) -> list[str]:
    """Time tags of seconds after an epoch, with as many digits as reading the same numbers needs.

    Raises ``ValueError`` for an invalid epoch, and for times outside the years 1 to 9999.
    """
    with localcontext(prec=_DIGITS):
        begin = _count(epoch, leaps=leaps)
        try:
            return [_tag(begin + Decimal(repr(x)), leaps=leaps) for x in t.tolist()]
        except (ArithmeticError, ValueError):
            raise ValueError(f"t: passes the years 1 to 9999 from {epoch}") from None


def tag_of(epoch: Any, system: str) -> str:
    """The time tag of an epoch, a ``datetime`` or text, in a time system such as "UTC".

    Raises ``ValueError`` for other text, and for a time with a UTC offset in another time system;
    ``TypeError`` for anything else.
    """
    accepted = f'a datetime, "unix", or text such as {_ACCEPTED}'
    if isinstance(epoch, str):
        if _TAG.fullmatch(epoch):
            return epoch
        try:
            epoch = datetime.fromisoformat(epoch)
        except ValueError:
            raise ValueError(f"epoch: found {checks.brief(epoch)}; accepted: {accepted}") from None
    # NaT of pandas is a datetime
    if not isinstance(epoch, datetime) or not _TAG.fullmatch(epoch.isoformat()[:19]):
        raise TypeError(f"epoch: found {checks.brief(epoch)}; accepted: {accepted}")
    if epoch.tzinfo is not None:
        if system.upper() != "UTC":
            raise ValueError(
                f"epoch: found {epoch.isoformat()}, with an offset from UTC, and TIME_SYSTEM "
                f"{system}; accepted: a time in {system}, without an offset"
            )
        epoch = epoch.astimezone(UTC).replace(tzinfo=None)
    return str(epoch.isoformat())


def of_run(epoch: Any, t: NDArray[np.float64], system: str) -> tuple[str, NDArray[np.float64]]:
    """The time tag of a run's epoch, and the seconds since then, leap seconds counted.

    Raises ``ValueError`` for Unix time in another system than UTC, and for times since an early
    epoch that Unix time and elapsed seconds interpret differently.
    """
    if isinstance(epoch, str) and epoch == "unix":
        if system.upper() != "UTC":
            raise ValueError(
                f'epoch: found "unix" with TIME_SYSTEM {system}; accepted: with UTC, or a time'
            )
        unix = tags("1970-01-01T00:00:00", t, leaps=False)
        return unix[0], seconds_since(unix[0], unix, leaps=True)
    tag = tag_of(epoch, system)
    if tag < _FIRST_LEAPS and np.abs(t).max() > _LONG:
        raise ValueError(
            f"epoch: found {tag} with t up to {t[-1]:.10g} s, in which leap seconds count; "
            'accepted: "unix" where t is Unix time, or a time near the run, t counted from it'
        )
    return tag, t


def _count(tag: str, *, leaps: bool) -> Decimal:
    """Seconds since the start of the calendar."""
    match = _TAG.fullmatch(tag)
    try:
        if match is None:
            raise ValueError
        year, of_month, of_year, hour, minute, second = match.groups()
        begin = date.fromisoformat(f"{year}-{of_month or '01-01'}")
        day = begin.toordinal() + int(of_year or 1) - 1
        within = 3600 * int(hour) + 60 * int(minute) + Decimal(second)
        length = _DAY + (leaps and day in _LEAPS)
        if date.fromordinal(day).year != begin.year or within >= length:
            raise ValueError
        # a second 60 occurs only in the last minute of such a day
        if Decimal(second) >= 60 and (hour, minute) != ("23", "59"):
            raise ValueError
    except ValueError:
        raise ValueError(f"time: found {tag}; accepted: {_ACCEPTED}") from None
    return day * _DAY + within + (_leaps_before(day) if leaps else 0)


def _leaps_before(day: int) -> int:
    """The number of leap seconds before the start of a day."""
    return bisect_left(_LEAPS, day)


def _tag(count: Decimal, *, leaps: bool) -> str:
    day = int(count // _DAY)
    if leaps:
        while day * _DAY + _leaps_before(day) > count:
            day -= 1
    within = count - day * _DAY - (_leaps_before(day) if leaps else 0)
    # second 60 is part of the last minute
    minutes = min(int(within // 60), 1439)
    whole, point, fraction = f"{(within - 60 * minutes).normalize():f}".partition(".")
    clock = f"{minutes // 60:02d}:{minutes % 60:02d}:{int(whole):02d}{point}{fraction}"
    return f"{date.fromordinal(day)}T{clock}"
