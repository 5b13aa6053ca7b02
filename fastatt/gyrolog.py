"""Gyroscope logs: text tables with three rate columns, in and out."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from fastatt import checks

_ROWS = 200_000  # rows between two looks at the progress bar
_COMMENTS = ("#", "//", "%")
_UNITS = {"rad/s": 1.0, "deg/s": math.pi / 180.0}
_TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


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
    names: list[str] | None
    delimiter: str | None
    first_line: int
    rate: float | None
    n_columns: int
    n_used: int
    n_names: int


def read_log(
    path: str | Path,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | None = None,
    attitude_columns: Sequence[str] | None = None,
    progress: Callable[[int], object] | None = None,
) -> GyroLog:
    """Read a gyro log: separated by commas, semicolons, tabs or blanks, with or without names.

    ``columns``, ``time_column``, ``attitude_columns`` are names or numbers from 1; left out,
    columns named like gyro x, y, z, time, and quat w, x, y, z are taken. ``unit`` is "rad/s" or
    "deg/s"; left out, it is read from the names, else rad/s. ``rate``, Hz, replaces a time column.
    ``progress`` is called with the bytes read.

    Raises ``LogError`` (a ``ValueError``) that names the file, the line and what is accepted;
    ``TypeError`` for arguments that are something else; ``FileNotFoundError`` and other ``OSError``
    of the file itself.
    """
    if unit is not None:
        checks.choice("unit", unit, _UNITS)
    if rate is not None:
        rate = _hertz("rate", checks.real("rate", rate))
    path = _path(path)
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        layout = _layout(path, file)
        gyro = _chosen(path, layout, columns, 3, "columns") or _axes(layout, _GYRO, "xyz")
        if gyro is None:
            raise LogError(
                f"{path}: found no three columns named like gyro x, y, z among "
                f"{_shown(layout)}; name them with columns (names or numbers from 1)"
            )
        clock = _time_column(path, layout, time_column) if rate is None else None
        if rate is None and clock is None and layout.rate is None:
            raise LogError(
                f"{path}: found no time column and no sample rate among {_shown(layout)}; "
                "give a rate in Hz or a time column"
            )
        quat = _chosen(path, layout, attitude_columns, 4, "attitude columns")
        quat = quat or _axes(layout, _QUAT, "wxyz")
        wanted = [*gyro, *([] if clock is None else [clock]), *(quat or [])]
        table = _table(path, file, layout, wanted, progress)
    names = tuple(_name(layout, i) for i in gyro)
    found = unit or _unit_of(path, names)
    dt, t, timing = _timing(path, layout, table, clock, rate)
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
    r"(gyr\w*|gyroscope|omega|angular[ _]?(velocity|rate)\w*|ang[ _]?vel\w*|rate|w)"
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


def _path(path: Any) -> Path:
    try:
        if "\0" in str(path):
            raise TypeError
        return Path(path)
    except TypeError:
        raise TypeError(f"path: found {checks.brief(path)}; accepted: a file's name") from None


def _hertz(name: str, rate: float) -> float:
    """A sample rate whose interval is a number too."""
    if not (math.isfinite(rate) and rate > 0.0 and math.isfinite(1.0 / rate)):
        raise LogError(f"{name}: found {rate}; accepted: a sample rate above 0, Hz")
    return rate


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


def _numbers(parts: list[str]) -> bool:
    try:
        [float(p) for p in parts if p]
    except ValueError:
        return False
    return any(parts)


def _layout(path: Path, file: TextIO) -> _Layout:
    """Look at the lines up to the first row of numbers."""
    names: str | None = None
    rate = None
    for number, line in enumerate(iter(file.readline, ""), start=1):
        text = _text(line)
        if not text.strip() or text.startswith(_COMMENTS):
            match = _RATE.search(text)
            rate = float(match["rate"]) if match else rate
            continue
        row = _row(text)
        delimiter = _delimiter(row)
        parts = _split(row, delimiter)
        if not _numbers(parts):
            if names is not None:
                raise LogError(f"{path} line {number}: found {text[:60]!r}; accepted: numbers")
            names = text
            continue
        header = [] if names is None else _names(names)
        # a separator may end the line of names or those of numbers, or both
        fits = len(header) == len(parts) or _used(header) == _used(parts)
        header = [_printable(n) for n in header]
        return _Layout(
            names=header if fits else None,
            delimiter=delimiter,
            first_line=number,
            rate=rate,
            n_columns=len(parts),
            n_used=_used(parts),
            n_names=len(header),
        )
    raise LogError(f"{path}: found no row of numbers; accepted: a table with three rate columns")


def _names(text: str) -> list[str]:
    separator = _delimiter(text)
    # between blanks a unit in brackets belongs to the name before it
    return re.split(r"\s+(?![\[(])", text) if separator is None else _split(text, separator)


def _delimiter(text: str) -> str | None:
    return next((d for d in (",", ";", "\t") if d in text), None)


def _used(parts: list[str]) -> int:
    """How many columns there are before empty ones at the end."""
    return max((i for i, part in enumerate(parts, start=1) if part), default=0)


def _shown(layout: _Layout) -> str:
    if layout.names:
        some = ", ".join(repr(n[:60]) for n in layout.names[:20])
        return some if len(layout.names) <= 20 else f"{some} and {len(layout.names) - 20} more"
    if layout.n_names:
        return f"{layout.n_columns} columns under {layout.n_names} names"
    return f"{layout.n_columns} unnamed columns"


def _name(layout: _Layout, i: int) -> str:
    named = layout.names and i < len(layout.names) and layout.names[i]
    return named or f"column {i + 1}"


def _index(path: Path, layout: _Layout, column: str, argument: str) -> int:
    text = _printable(str(column))
    if layout.names and layout.names.count(text) == 1:
        return layout.names.index(text)
    if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= layout.n_columns:
        return int(text) - 1
    raise LogError(
        f"{path}: {argument}: found {text[:60]!r}; accepted: {_shown(layout)}, or a number from 1 "
        f"to {layout.n_columns}"
    )


def _chosen(
    path: Path, layout: _Layout, columns: Sequence[str] | None, n: int, argument: str
) -> list[int] | None:
    if columns is None:
        return None
    given = columns if isinstance(columns, (list, tuple)) else []
    found = [_index(path, layout, c, argument) for c in given]
    if len(set(found)) != n or len(found) != n:
        raise LogError(
            f"{argument}: found {checks.brief(columns)}; accepted: {n} different columns"
        )
    return found


def _axes(layout: _Layout, pattern: re.Pattern[str], axes: str) -> list[int] | None:
    """Columns whose names fit the pattern, one an axis and only one."""
    found: dict[str, list[int]] = {}
    for i, name in enumerate(layout.names or []):
        match = pattern.fullmatch(name)
        if match:
            found.setdefault(match["axis"].lower(), []).append(i)
    if any(len(found.get(axis, [])) != 1 for axis in axes):
        return None
    return [found[axis][0] for axis in axes]


def _time_column(path: Path, layout: _Layout, column: str | None) -> int | None:
    if column is not None:
        return _index(path, layout, column, "time column")
    for i, name in enumerate(layout.names or []):
        if _TIME.fullmatch(name):
            return i
    return None


def _unit_of(path: Path, names: tuple[str, ...]) -> str | None:
    """The unit that the names of columns carry, None where they carry none."""
    found = {m[0]: m for name in names for m in _UNIT.finditer(name.lower())}
    units = {_known(m) for m in found.values()}
    if None in units or len(units) > 1:
        raise LogError(
            f"{path}: found the unit {', '.join(found)[:60]} in the names of columns; accepted: "
            "rad/s or deg/s, one for all, or unit, to say which it is"
        )
    return units.pop() if units else None


def _known(match: re.Match[str]) -> str | None:
    time = match["per"] or match["time"] or "s"
    if match["scale"] or match["angle"].startswith("rp") or time not in _SECOND:
        return None
    return "rad/s" if match["angle"].startswith("rad") else "deg/s"


def _table(
    path: Path,
    file: TextIO,
    layout: _Layout,
    wanted: list[int],
    progress: Callable[[int], object] | None,
) -> NDArray[np.float64]:
    """The wanted columns, read a block of rows at a time."""
    file.seek(0)
    for _ in range(layout.first_line - 1):
        file.readline()
    blocks: list[NDArray[np.float64]] = []
    at = file.tell()
    while lines := list(islice(iter(file.readline, ""), _ROWS)):
        rows = [row for line in lines if (row := _row(line))]
        if any(not _even(row, layout) for row in rows):
            raise _bad_row(path, layout, wanted)
        if rows:
            try:
                block = np.loadtxt(
                    rows, delimiter=layout.delimiter, usecols=wanted, comments=None, ndmin=2
                )
            except (ValueError, IndexError) as error:
                raise _bad_row(path, layout, wanted, str(error)) from None
            blocks.append(block)
        if progress is not None:
            progress(file.tell() - at)
            at = file.tell()
    table = np.concatenate(blocks)
    if not np.isfinite(table).all():
        raise _bad_row(path, layout, wanted)
    return table


def _even(text: str, layout: _Layout) -> bool:
    """Whether a row has the columns of the first: else a number has been lost or added."""
    if layout.delimiter is None:
        return len(text.split()) == layout.n_columns
    return (
        text.count(layout.delimiter) + 1 == layout.n_columns
        or _used(_split(text, layout.delimiter)) == layout.n_used
    )


def _bad_row(
    path: Path, layout: _Layout, wanted: list[int], reason: str = "found no numbers"
) -> LogError:
    """The first row that is no row of finite numbers; looked for only when there is one."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            text = _row(line)
            if number < layout.first_line or not text:
                continue
            parts = _split(text, layout.delimiter)
            if not _even(text, layout):
                return LogError(
                    f"{path} line {number}: found {len(parts)} columns; accepted: "
                    f"{layout.n_columns}, as in line {layout.first_line}"
                )
            for i in wanted:
                try:
                    good = math.isfinite(float(parts[i]))
                except ValueError:
                    good = False
                if not good:
                    return LogError(
                        f"{path} line {number}: {_name(layout, i)[:60]} is {parts[i][:60]!r}; "
                        "accepted: a finite number"
                    )
    return LogError(f"{path}: {reason}")


def _timing(
    path: Path,
    layout: _Layout,
    table: NDArray[np.float64],
    clock: int | None,
    rate: float | None,
) -> tuple[float | NDArray[np.float64], NDArray[np.float64], str]:
    n = len(table)
    if clock is None:
        hertz = _hertz(f"{path}: the sample rate", rate or layout.rate or 0.0)
        with np.errstate(over="ignore"):
            t = np.arange(n) / hertz
        if not math.isfinite(t[-1]):
            raise LogError(f"{path}: found {n} samples at the rate {hertz:g} Hz; accepted: more")
        return 1.0 / hertz, t, f"{hertz:g} Hz"
    name = _name(layout, clock)
    match = _TIME.fullmatch(name)
    unit = ((match["unit"] if match else None) or "s").lower().replace("sec", "s")
    with np.errstate(over="ignore", invalid="ignore"):
        t = (table[:, 3] - table[0, 3]) * _TIME_UNITS[unit]
        gaps = np.diff(t)
    if not np.isfinite(t).all():
        k = int(np.argmin(np.isfinite(t)))
        raise LogError(
            f"{path}: {name[:60]} overflows in row {k + 1} of numbers ({table[k, 3]:.9g}); "
            "accepted: time stamps whose differences are numbers"
        )
    if (gaps <= 0.0).any():
        k = int(np.argmax(gaps <= 0.0))
        what = "repeated" if gaps[k] == 0.0 else "decreasing"
        raise LogError(
            f"{path}: {name[:60]} is {what} after row {k + 1} of numbers ({table[k, 3]:.9g}, then "
            f"{table[k + 1, 3]:.9g}); accepted: time stamps that grow, or a rate in Hz"
        )
    if n == 1:
        raise LogError(f"{path}: found one row; accepted with time stamps: at least two")
    return gaps, t, f"time stamps in {name}"
