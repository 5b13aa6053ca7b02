"""Time tags of the CCSDS (ASCII time codes A and B) and the seconds between them, to the last bit.

CCSDS 301.0-B-4 (2010), §3.5: YYYY-MM-DDThh:mm:ss.d or YYYY-DDDThh:mm:ss.d, a Z may follow.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Sequence
from datetime import date, timedelta
from decimal import Decimal, localcontext

import numpy as np
from numpy.typing import NDArray

_TAG = re.compile(
    r"(\d{4})-(?:(\d{2})-(\d{2})|(\d{3}))T(\d{2}):(\d{2}):(\d{2}(?:\.\d*)?)Z?", re.ASCII
)
_DAY = 86400
_DIGITS = 60
# UTC days that ended with a leap second; IERS, Bulletin C, none announced since
_LEAPS = [
    date(year, month, 30 if month == 6 else 31).toordinal()
    for year, month in (
        (1972, 6), (1972, 12), (1973, 12), (1974, 12), (1975, 12), (1976, 12), (1977, 12),
        (1978, 12), (1979, 12), (1981, 6), (1982, 6), (1983, 6), (1985, 6), (1987, 12), (1989, 12),
        (1990, 12), (1992, 6), (1993, 6), (1994, 6), (1995, 12), (1997, 6), (1998, 12), (2005, 12),
        (2008, 12), (2012, 6), (2015, 6), (2016, 12),
    )
]  # fmt: skip


def seconds_since(epoch: str, tags: Sequence[str], *, leaps: bool) -> NDArray[np.float64]:
    """Seconds from an epoch to time tags, (S,); ``leaps`` counts UTC's leap seconds.

    Raises ``ValueError`` for what is no time tag.
    """
    with localcontext(prec=_DIGITS):
        begin = _count(epoch, leaps=leaps)
        return np.array([float(_count(tag, leaps=leaps) - begin) for tag in tags])


def tags(epoch: str, t: NDArray[np.float64], *, leaps: bool) -> list[str]:
    """Time tags of seconds after an epoch, with the digits that give the same numbers again.

    Raises ``ValueError`` for an epoch that is no time tag and times beyond the years 1 to 9999.
    """
    with localcontext(prec=_DIGITS):
        begin = _count(epoch, leaps=leaps)
        try:
            return [_tag(begin + Decimal(repr(x)), leaps=leaps) for x in t.tolist()]
        except (OverflowError, ValueError):
            raise ValueError(f"t: passes the years 1 to 9999 from {epoch}") from None


def _before(day: int) -> int:
    """Leap seconds before a day begins."""
    return bisect_left(_LEAPS, day)


def _length(day: int, *, leaps: bool) -> int:
    return _DAY + (leaps and day in _LEAPS)


def _count(tag: str, *, leaps: bool) -> Decimal:
    """Seconds since the calendar's beginning."""
    found = _TAG.fullmatch(tag)
    try:
        if found is None:
            raise ValueError
        year, month, of_month, of_year, hour, minute, second = found.groups()
        if of_year is None:
            day = date(int(year), int(month), int(of_month)).toordinal()
        else:
            day = date(int(year), 1, 1).toordinal() + int(of_year) - 1
            if date.fromordinal(day).year != int(year):
                raise ValueError
        within = 3600 * int(hour) + 60 * int(minute) + Decimal(second)
        last = hour == "23" and minute == "59"
        if int(hour) > 23 or int(minute) > 59 or (Decimal(second) >= 60 and not last):
            raise ValueError
        if within >= _length(day, leaps=leaps):
            raise ValueError
    except ValueError:
        raise ValueError(
            f"time: found {tag}; accepted: YYYY-MM-DDThh:mm:ss.d or YYYY-DDDThh:mm:ss.d"
        ) from None
    return day * _DAY + within + (_before(day) if leaps else 0)


def _tag(count: Decimal, *, leaps: bool) -> str:
    day = int(count // _DAY)
    if leaps:
        while day * _DAY + _before(day) > count:
            day -= 1
    within = count - day * _DAY - (_before(day) if leaps else 0)
    # the second 60 belongs to the last minute
    minutes = min(int(within // 60), 1439)
    seconds = within - 60 * minutes
    text = f"{seconds.normalize():f}"
    whole, _, fraction = text.partition(".")
    day_text = (date(1, 1, 1) + timedelta(days=day - 1)).isoformat()
    clock = f"{minutes // 60:02d}:{minutes % 60:02d}:{int(whole):02d}"
    return f"{day_text}T{clock}{'.' * bool(fraction)}{fraction}"
