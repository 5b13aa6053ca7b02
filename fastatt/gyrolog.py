"""Gyroscope logs: text tables with three rate columns, in and out."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from fastatt.checks import choice

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
    ``FileNotFoundError`` and other ``OSError`` of the file itself.
    """
    if unit is not None:
        choice("unit", unit, _UNITS)
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise LogError(f"rate: found {rate}; accepted: a sample rate above 0, Hz")
    path = Path(path)
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
    found = unit or _unit_of(names)
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
    r"(sample[ _]?rate|sampling[ _]?(rate|frequency)|frequency)\W+([\d.]+)", re.IGNORECASE
)


def _split(line: str, delimiter: str | None) -> list[str]:
    parts = line.strip("\r\n").split(delimiter)
    return [part.strip().strip('"') for part in parts]


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
        text = line.strip().lstrip("\ufeff")
        if not text:
            continue
        if text.startswith(_COMMENTS):
            match = _RATE.search(text)
            rate = float(match[3]) if match else rate
            continue
        delimiter = next((d for d in (",", ";", "\t") if d in text), None)
        parts = _split(text, delimiter)
        if not _numbers(parts):
            if names is not None:
                raise LogError(f"{path} line {number}: found {text[:60]!r}; accepted: numbers")
            names = text
            continue
        header = None
        if names is not None:
            of_names = next((d for d in (",", ";", "\t") if d in names), None)
            header = [n for n in _split(names, of_names) if n]
        return _Layout(header, delimiter, number, rate, len(parts))
    raise LogError(f"{path}: found no row of numbers; accepted: a table with three rate columns")


def _shown(layout: _Layout) -> str:
    if layout.names is None:
        return f"{layout.n_columns} unnamed columns"
    return ", ".join(repr(n) for n in layout.names)


def _name(layout: _Layout, i: int) -> str:
    return layout.names[i] if layout.names else f"column {i + 1}"


def _index(path: Path, layout: _Layout, column: str, argument: str) -> int:
    text = str(column).strip()
    if layout.names and text in layout.names:
        return layout.names.index(text)
    if text.isdecimal() and 1 <= int(text) <= layout.n_columns:
        return int(text) - 1
    raise LogError(
        f"{path}: {argument}: found {text!r}; accepted: {_shown(layout)}, or a number from 1 to "
        f"{layout.n_columns}"
    )


def _chosen(
    path: Path, layout: _Layout, columns: Sequence[str] | None, n: int, argument: str
) -> list[int] | None:
    if columns is None:
        return None
    if len(columns) != n or len(set(columns)) != n:
        raise LogError(f"{argument}: found {','.join(columns)}; accepted: {n} different columns")
    return [_index(path, layout, c, argument) for c in columns]


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


def _unit_of(names: tuple[str, ...]) -> str | None:
    text = " ".join(names).lower()
    if re.search(r"deg|°|dps", text):
        return "deg/s"
    return "rad/s" if "rad" in text else None


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
    rows = 0
    at = file.tell()
    while True:
        try:
            block = _block(file, layout, wanted)
        except (ValueError, IndexError) as error:
            raise _bad_row(path, layout, wanted) or LogError(f"{path}: {error}") from None
        if not len(block):
            break
        blocks.append(block)
        rows += len(block)
        if progress is not None:
            progress(file.tell() - at)
            at = file.tell()
        if len(block) < _ROWS:
            break
    table = np.concatenate(blocks)
    if not np.isfinite(table).all():
        raise _bad_row(path, layout, wanted) or LogError(
            f"{path}: found a number that is not finite"
        )
    return table


def _block(file: TextIO, layout: _Layout, wanted: list[int]) -> NDArray[np.float64]:
    lines = [line for _ in range(_ROWS) if (line := file.readline())]
    if not any(line.strip() for line in lines):
        return np.empty((0, len(wanted)))
    return np.loadtxt(
        lines, delimiter=layout.delimiter, usecols=wanted, comments=_COMMENTS, ndmin=2
    )


def _bad_row(path: Path, layout: _Layout, wanted: list[int]) -> LogError | None:
    """The first row that is no row of finite numbers; looked for only when there is one."""
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            text = line.strip()
            if number < layout.first_line or not text or text.startswith(_COMMENTS):
                continue
            parts = _split(text, layout.delimiter)
            for i in wanted:
                name = _name(layout, i)
                if i >= len(parts):
                    return LogError(
                        f"{path} line {number}: found {len(parts)} columns; accepted: at least "
                        f"{i + 1}, for {name}"
                    )
                try:
                    good = math.isfinite(float(parts[i]))
                except ValueError:
                    good = False
                if not good:
                    return LogError(
                        f"{path} line {number}: {name} is {parts[i]!r}; accepted: a finite number"
                    )
    return None


def _timing(
    path: Path,
    layout: _Layout,
    table: NDArray[np.float64],
    clock: int | None,
    rate: float | None,
) -> tuple[float | NDArray[np.float64], NDArray[np.float64], str]:
    n = len(table)
    if clock is None:
        rate = rate or layout.rate
        if not rate:
            raise LogError(f"{path}: found the sample rate {rate}; accepted: above 0, Hz")
        return 1.0 / rate, np.arange(n) / rate, f"{rate:g} Hz"
    name = _name(layout, clock)
    match = _TIME.fullmatch(name)
    unit = ((match["unit"] if match else None) or "s").lower().replace("sec", "s")
    t = (table[:, 3] - table[0, 3]) * _TIME_UNITS[unit]
    gaps = np.diff(t)
    if (gaps <= 0.0).any():
        k = int(np.argmax(gaps <= 0.0))
        what = "repeated" if gaps[k] == 0.0 else "decreasing"
        raise LogError(
            f"{path}: {name} is {what} after row {k + 1} of numbers ({table[k, 3]:.9g}, then "
            f"{table[k + 1, 3]:.9g}); accepted: time stamps that grow, or a rate in Hz"
        )
    if n == 1:
        raise LogError(f"{path}: found one row; accepted with time stamps: at least two")
    return gaps, t, f"time stamps in {name}"
