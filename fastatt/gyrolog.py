"""Gyroscope logs: text tables with three rate columns, in and out."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from fastatt import checks

_ROWS = 200_000  # rows between two looks at the progress bar
_COMMENTS = ("#", "//", "%")
_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0}
_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# of gyros, Hz: any other is a unit mistaken
_SLOWEST, _FASTEST = 0.1, 1e6
_PLAUSIBLE = "accepted: above 0.1 Hz and up to 1 MHz"


class LogError(ValueError):
    """A log that can't be read, and why, in one line."""


@dataclass(frozen=True)
class GyroLog:
    """Rates (n, 3) in rad/s, the interval or the n − 1 intervals in s, and how they were found."""

    path: Path
    rates: NDArray[np.float64]
    dt: float | NDArray[np.float64]
    t: NDArray[np.float64]
    columns: tuple[str, ...]
    unit: str
    timing: str
    attitudes: NDArray[np.float64] | None

    @property
    def rate(self) -> float:
        """Mean sample rate, Hz."""
        return 1.0 / float(np.mean(self.dt))


@dataclass(frozen=True)
class _Layout:
    """What the lines up to the first row of numbers say."""

    path: Path
    names: list[str]  # of the columns; none where they are not known
    n_names: int
    delimiter: str | None
    first_line: int
    rate: float | None
    n_columns: int
    n_used: int

    def error(self, text: str) -> LogError:
        return LogError(f"{self.path}: {text}")

    def shown(self) -> str:
        """The columns, for a message."""
        if self.names:
            some = ", ".join(repr(n[:60]) for n in self.names[:20])
            return some if len(self.names) <= 20 else f"{some} and {len(self.names) - 20} more"
        if self.n_names:
            return f"{self.n_columns} columns under {self.n_names} names"
        return f"{self.n_columns} unnamed columns"

    def name(self, i: int) -> str:
        return (i < len(self.names) and self.names[i]) or f"column {i + 1}"

    def index(self, column: str, argument: str) -> int:
        text = _printable(str(column))
        if self.names.count(text) == 1:
            return self.names.index(text)
        if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= self.n_columns:
            return int(text) - 1
        raise self.error(
            f"{argument}: found {text[:60]!r}; accepted: {self.shown()}, or a number from 1 to "
            f"{self.n_columns}"
        )

    def chosen(self, columns: Sequence[str] | None, n: int, argument: str) -> list[int] | None:
        if columns is None:
            return None
        given = columns if isinstance(columns, (list, tuple)) else []
        found = [self.index(c, argument) for c in given]
        if len(set(found)) != n or len(found) != n:
            raise LogError(
                f"{argument}: found {checks.brief(columns)}; accepted: {n} different columns"
            )
        return found

    def even(self, row: str) -> bool:
        """Whether a row has the columns of the first: else a number has been lost or added."""
        if self.delimiter is None:
            return len(row.split()) == self.n_columns
        return (
            row.count(self.delimiter) + 1 == self.n_columns
            or _used(_split(row, self.delimiter)) == self.n_used
        )


def read_log(
    path: str | Path,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | None = None,
    time_unit: str | None = None,
    attitude_columns: Sequence[str] | None = None,
    progress: Callable[[int], object] | None = None,
) -> GyroLog:
    """Read a gyro log: separated by commas, semicolons, tabs or blanks, with or without names.

    ``columns``, ``time_column``, ``attitude_columns`` are names or numbers from 1; left out,
    columns named like gyro x, y, z, time, and quat w, x, y, z are taken, names that stand in a
    comment too. ``unit`` is "rad/s" or "deg/s", ``time_unit`` "s", "ms", "us" or "ns"; left out,
    they are read from the names, else rad/s and s. ``rate``, Hz, replaces a time column.
    A rate that the file gives has to lie between 0.1 Hz and 1 MHz, unless ``time_unit`` is given.
    ``progress`` is called with the bytes read.

    Raises ``LogError`` (a ``ValueError``) that names the file, the line and what is accepted;
    ``TypeError`` for arguments that are something else; ``FileNotFoundError`` and other ``OSError``
    of the file itself.
    """
    for name, word, known in (("unit", unit, _UNITS), ("time_unit", time_unit, _TIME_UNITS)):
        if word is not None:
            checks.choice(name, word, known)
    if rate is not None:
        rate = checks.real("rate", rate)
        if not (rate > 0.0 and math.isfinite(1.0 / rate)):
            raise LogError(f"rate: found {rate}; accepted: a sample rate above 0, Hz")
    given: Any = path
    if not isinstance(given, (str, PathLike)) or "\0" in str(path):
        raise TypeError(f"path: found {checks.brief(path)}; accepted: a file's name")
    path = Path(path)
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        layout = _layout(path, file)
        gyro = layout.chosen(columns, 3, "columns") or _axes(layout.names, _GYRO, "xyz")
        if gyro is None:
            raise layout.error(
                f"found no three columns named like gyro x, y, z among {layout.shown()}; name them "
                "with columns (names or numbers from 1)"
            )
        clock = None
        if rate is None and time_column is not None:
            clock = layout.index(time_column, "time column")
        elif rate is None:
            clock = next((i for i, n in enumerate(layout.names) if _TIME.fullmatch(n)), None)
        if rate is None and clock is None and layout.rate is None:
            raise layout.error(
                f"found no time column and no sample rate among {layout.shown()}; give a rate in "
                "Hz or a time column"
            )
        quat = layout.chosen(attitude_columns, 4, "attitude columns")
        quat = quat or _axes(layout.names, _QUAT, "wxyz")
        wanted = [*gyro, *([] if clock is None else [clock]), *(quat or [])]
        table = _table(file, layout, wanted, progress)
    names = tuple(layout.name(i) for i in gyro)
    found = unit or _unit_of(layout, names)
    dt: float | NDArray[np.float64]
    if clock is None:
        dt, t, timing = _at_a_rate(layout, len(table), rate)
    else:
        dt, t, timing = _stamped(layout, table[:, 3], layout.name(clock), time_unit)
    return GyroLog(
        path=path,
        rates=np.ascontiguousarray(table[:, :3] * _UNITS[found or "rad/s"]),
        dt=dt,
        t=t,
        columns=names,
        unit=found or "rad/s (assumed)",
        timing=timing,
        attitudes=None if quat is None else np.ascontiguousarray(table[:, -4:]),
    )


def write_attitudes(
    path: str | Path,
    t: NDArray[Any],
    q: NDArray[Any],
    progress: Callable[[int], object] | None = None,
) -> None:
    """Write t (s) and q0 … q3 as ``.npy``, an (n, 5) array, or as CSV with a line of names."""
    path = Path(path)
    table = np.concatenate([t[:, None], q], axis=1)
    if path.suffix == ".npy":
        np.save(path, table)
        return
    if path.suffix != ".csv":
        raise LogError(f"{path}: found the ending {path.suffix!r}; accepted: .csv and .npy")
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "q0", "q1", "q2", "q3"])
        for first in range(0, len(table), _ROWS):
            rows = table[first : first + _ROWS].tolist()
            writer.writerows(rows)
            if progress is not None:
                progress(len(rows))


_GYRO = re.compile(
    r"(gyr\w*|omega|angular[ _]?(velocity|rate)\w*|ang[ _]?vel\w*|rate|w(_rs_s)?)"
    r"[ _.\[(-]*(?P<axis>[xyz])\b.*",
    re.IGNORECASE,
)
_QUAT = re.compile(
    r"((quat\w*?|quaternion|orientation|q)[ _.\[(-]*)?(?P<axis>[wxyz])\b\)?]?", re.IGNORECASE
)
_TIME = re.compile(
    r"(time|timestamp|time[ _]?stamp|t)[ _]*(\(?\[?(?P<unit>s|sec|ms|us|ns)?\]?\)?)", re.IGNORECASE
)
_RATE = re.compile(
    r"(sample[ _]?rate|sampling[ _]?(rate|frequency)|frequency)([ _]*[(\[]hz[)\]])?[\s:=,;\"']+"
    r"(?P<rate>\d+\.?\d*(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
_UNIT = re.compile(
    r"(?<![a-z])(?P<scale>milli|micro|[mkuµμ])?(?P<angle>deg(rees?|s)?|°|dps|rad(ians?|s)?|rp[ms])"
    r"([ _]*(/|per|p)[ _]*(?P<per>[a-z]*)|[ _.*·]*(?P<time>s|sec|min|h|hr|hours?)(?![a-z]))?"
    r"(?![a-z])"
)
_SECOND = ("s", "sec", "secs", "second", "seconds")


def _text(line: str) -> str:
    """A line without quotes and byte order mark."""
    if '"' in line or "\ufeff" in line:
        line = line.replace('"', "").lstrip("\ufeff")
    return line.strip("\r\n ")


def _row(line: str) -> str:
    """The same without a comment."""
    text = _text(line)
    for mark in _COMMENTS:
        if mark in text:
            text = text[: text.index(mark)].rstrip(" ")
    return text if text.strip() else ""


def _split(text: str, delimiter: str | None) -> list[str]:
    return [part.strip() for part in text.split(delimiter)]


def _printable(name: str) -> str:
    """A name of a column as it can stand in a message."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(name.split()))


def _layout(path: Path, file: TextIO) -> _Layout:
    """Look at the lines up to the first row of numbers."""
    names: str | None = None
    comment = ""
    rate = None
    for number, line in enumerate(iter(file.readline, ""), start=1):
        text = _text(line)
        if not text.strip() or text.startswith(_COMMENTS):
            match = _RATE.search(text)
            rate = float(match["rate"]) if match else rate
            comment = text.lstrip("#/% ") or comment
            continue
        delimiter = _delimiter(_row(text))
        parts = _split(_row(text), delimiter)
        try:
            is_names = not [float(part) for part in parts if part]
        except ValueError:
            is_names = True
        if is_names:
            if names is not None:
                raise LogError(f"{path} line {number}: found {text[:60]!r}; accepted: numbers")
            names = text
            continue
        header = _names(names or "")
        if names is None and _axes(_names(comment), _GYRO, "xyz"):
            header = _names(comment)
        # a separator may end the line of names or those of numbers, or both
        fits = len(header) == len(parts) or _used(header) == _used(parts)
        return _Layout(
            path=path,
            names=header if fits else [],
            n_names=len(header),
            delimiter=delimiter,
            first_line=number,
            rate=rate,
            n_columns=len(parts),
            n_used=_used(parts),
        )
    raise LogError(f"{path}: found no row of numbers; accepted: a table with three rate columns")


def _names(text: str) -> list[str]:
    separator = _delimiter(text)
    # between blanks a unit in brackets belongs to the name before it
    parts = re.split(r"\s+(?![\[(])", text) if separator is None else _split(text, separator)
    return [_printable(part) for part in parts] if text else []


def _delimiter(text: str) -> str | None:
    return next((d for d in (",", ";", "\t") if d in text), None)


def _used(parts: list[str]) -> int:
    """How many columns there are before empty ones at the end."""
    return max((i for i, part in enumerate(parts, start=1) if part), default=0)


def _axes(names: list[str], pattern: re.Pattern[str], axes: str) -> list[int] | None:
    """Columns whose names fit the pattern, one an axis and only one."""
    matches = enumerate(map(pattern.fullmatch, names))
    found = [(match["axis"].lower(), i) for i, match in matches if match]
    one_each = sorted(axis for axis, _ in found) == sorted(axes)
    return [dict(found)[axis] for axis in axes] if one_each else None


def _unit_of(layout: _Layout, names: tuple[str, ...]) -> str | None:
    """The unit that the names of columns carry, None where they carry none."""
    found = {m[0]: m for name in names for m in _UNIT.finditer(name.lower())}
    units = set()
    for m in found.values():
        time = m["per"] or m["time"] or "s"
        known = not m["scale"] and not m["angle"].startswith("rp") and time in _SECOND
        units.add(("rad/s" if m["angle"].startswith("rad") else "deg/s") if known else None)
    if None in units or len(units) > 1:
        raise layout.error(
            f"found the unit {', '.join(found)[:60]} in the names of columns; accepted: rad/s or "
            "deg/s, one for all, or unit, to say which it is"
        )
    return units.pop() if units else None


def _table(
    file: TextIO,
    layout: _Layout,
    wanted: list[int],
    progress: Callable[[int], object] | None,
) -> NDArray[np.float64]:
    """The wanted columns, read a block of rows at a time."""
    file.seek(0)
    number = layout.first_line
    for _ in range(number - 1):
        file.readline()
    blocks: list[NDArray[np.float64]] = []
    at = file.tell()
    while lines := list(islice(iter(file.readline, ""), _ROWS)):
        rows = [row for line in lines if (row := _row(line))]
        block, reason = None, "found no numbers"
        if rows and all(map(layout.even, rows)):
            try:
                block = np.loadtxt(
                    rows, delimiter=layout.delimiter, usecols=wanted, comments=None, ndmin=2
                )
            except (ValueError, IndexError) as error:
                reason = str(error)
        if block is not None and np.isfinite(block).all():
            blocks.append(block)
        elif rows:
            raise _bad_row(layout, wanted, lines, number) or layout.error(reason)
        number += len(lines)
        if progress is not None:
            progress(file.tell() - at)
            at = file.tell()
    return np.concatenate(blocks)


def _bad_row(layout: _Layout, wanted: list[int], lines: list[str], first: int) -> LogError | None:
    """The first of some lines that is no row of finite numbers."""
    for number, line in enumerate(lines, start=first):
        row = _row(line)
        if not row:
            continue
        where = f"{layout.path} line {number}:"
        parts = _split(row, layout.delimiter)
        if not layout.even(row):
            return LogError(
                f"{where} found {len(parts)} columns; accepted: {layout.n_columns}, as in line "
                f"{layout.first_line}"
            )
        for i in wanted:
            try:
                good = math.isfinite(float(parts[i]))
            except ValueError:
                good = False
            if not good:
                return LogError(
                    f"{where} {layout.name(i)[:60]} is {parts[i][:60]!r}; accepted: a finite number"
                )
    return None


def _at_a_rate(
    layout: _Layout, n: int, rate: float | None
) -> tuple[float, NDArray[np.float64], str]:
    """Interval, times and what to call them of n samples at a rate, Hz, or at that of the file."""
    if rate is None:
        rate = layout.rate or 0.0
        if not _SLOWEST < rate <= _FASTEST:
            raise layout.error(
                f"the sample rate: found {rate:g} Hz; {_PLAUSIBLE}, or any, given as rate"
            )
    with np.errstate(over="ignore"):
        t = np.arange(n) / rate
    if not math.isfinite(t[-1]):
        raise layout.error(f"found {n} samples at the rate {rate:g} Hz; accepted: more")
    return 1.0 / rate, t, f"{rate:g} Hz"


def _stamped(
    layout: _Layout, stamps: NDArray[np.float64], name: str, unit: str | None
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """The same of time stamps in a column of some name, in a unit if it is said."""
    match, short = _TIME.fullmatch(name), name[:60]
    found = unit or ((match["unit"] if match else None) or "s").lower().replace("sec", "s")
    with np.errstate(over="ignore", invalid="ignore"):
        t = (stamps - stamps[0]) * _TIME_UNITS[found]
        gaps = np.diff(t)
    if not np.isfinite(t).all():
        k = int(np.argmin(np.isfinite(t)))
        raise layout.error(
            f"{short} overflows in row {k + 1} of numbers ({stamps[k]:.9g}); accepted: time stamps "
            "whose differences are numbers"
        )
    if (gaps <= 0.0).any():
        k = int(np.argmax(gaps <= 0.0))
        what = "repeated" if gaps[k] == 0.0 else "decreasing"
        raise layout.error(
            f"{short} is {what} after row {k + 1} of numbers ({stamps[k]:.9g}, then "
            f"{stamps[k + 1]:.9g}); accepted: time stamps that grow, or a rate in Hz"
        )
    if len(t) == 1:
        raise layout.error("found one row; accepted with time stamps: at least two")
    usual = float(np.median(gaps)) / _TIME_UNITS[found]
    hertz = {u: 1.0 / usual / scale for u, scale in _TIME_UNITS.items()}
    fitting = [f"{x:.4g} Hz in {u}" for u, x in hertz.items() if _SLOWEST < x <= _FASTEST]
    if unit is None and not _SLOWEST < hertz[found] <= _FASTEST:
        raise layout.error(
            f"{short} gives {hertz[found]:.4g} Hz in {found}; {_PLAUSIBLE}, or the unit of time, "
            f"given as time_unit ({' or '.join(fitting) or 'none fits'})"
        )
    return gaps, t, f"time stamps in {name}"
