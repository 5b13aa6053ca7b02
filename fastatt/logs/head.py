"""How a text table is laid out, from its lines up to the first row of numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from fastatt import checks
from fastatt.logs import names
from fastatt.logs.names import LogError

COMMENTS = ("#", "//", "%")
_RATE = re.compile(
    r"(sample[ _]?rate|sampling[ _]?(rate|frequency)|frequency)([ _]*[(\[]hz[)\]])?[\s:=,;\"']+"
    r"(?P<rate>\d+\.?\d*(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
# what else a line may say the rate of
_OTHER_RATE = re.compile(
    r"(?!.*(gyr|imu|ang))(?=.*(mag|acc|baro|gps|gnss|cut|filter|corner))", re.IGNORECASE
)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(e[+-]?\d+)?", re.IGNORECASE)
_WHOLE = re.compile(r"\d{16,19}")  # that a double does not hold
_DATE = re.compile(r"(19|20)\d\d-\d\d-\d\d[T ]\d\d:\d\d")
Stamps = Literal["float", "int", "date"]


@dataclass(frozen=True)
class Layout:
    """What is known of a table before its rows are read."""

    name: str  # of the file, for messages
    names: list[str]  # of the columns; none where they are not known
    n_columns: int
    about: str = ""  # the file's name and its comments: what the table holds
    rates: tuple[float, ...] = ()  # Hz, that lines before the numbers say
    n_names: int = 0
    delimiter: str | None = None
    decimal: str = "."
    first_line: int = 1
    n_used: int = 0
    first_row: list[str] = field(default_factory=list)

    def error(self, text: object) -> LogError:
        """What is wrong with the table."""
        return LogError(f"{self.name}: {text}")

    def shown(self) -> str:
        """The columns, for a message."""
        if self.names:
            return names.listed(self.names)
        if self.n_names:
            return f"{self.n_columns} columns under {self.n_names} names"
        return f"{self.n_columns} unnamed columns"

    def column(self, i: int) -> str:
        """The name of a column, or its number from 1."""
        return (i < len(self.names) and self.names[i]) or f"column {i + 1}"

    def index(self, column: object, argument: str) -> int:
        """The place of a column by its name or number from 1."""
        text = names.printable(column)
        if self.names.count(text) == 1:
            return self.names.index(text)
        if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= self.n_columns:
            return int(text) - 1
        raise self.error(
            f"{argument}: found {text[:60]!r}; accepted: {self.shown()}, or a number from 1 to "
            f"{self.n_columns}"
        )

    def chosen(self, columns: Sequence[str] | None, n: int, argument: str) -> list[int] | None:
        """The places of n columns, None where none are said."""
        if columns is None:
            return None
        given = columns if isinstance(columns, (list, tuple)) else []
        found = [self.index(c, argument) for c in given]
        if len(set(found)) != n or len(found) != n:
            raise LogError(
                f"{argument}: found {checks.brief(columns)}; accepted: {n} different columns"
            )
        return found

    def split(self, row: str) -> list[str]:
        """Cells of a row, its decimal commas as points."""
        cells = _split(row, self.delimiter)
        return cells if self.decimal == "." else [cell.replace(",", ".") for cell in cells]

    def even(self, row: str) -> bool:
        """Whether a row has the columns of the first: else a number has been lost or added."""
        if self.delimiter is None:
            return len(row.split()) == self.n_columns
        return (
            row.count(self.delimiter) + 1 == self.n_columns
            or _used(_split(row, self.delimiter)) == self.n_used
        )

    def stamps(self, i: int) -> Stamps:
        """How the time stamps of a column are written."""
        cell = self.first_row[i] if i < len(self.first_row) else ""
        if _DATE.match(cell):
            return "date"
        return "int" if _WHOLE.fullmatch(cell) else "float"


def layout(name: str, lines: Iterable[str]) -> Layout:
    """Look at the lines up to the first row of numbers.

    Raises ``LogError`` where there is none, or text between the names and the numbers.
    """
    head: list[tuple[int, str]] = []
    comments: list[str] = []
    rates: list[float] = []
    for number, line in enumerate(lines, start=1):
        text = _text(line)
        match = _RATE.search(text)
        if match and not _OTHER_RATE.match(text[: match.start()]):
            rates.append(float(match["rate"]))
        if not text.strip() or text.startswith(COMMENTS):
            comments.append(text.lstrip("#/% "))
            continue
        row = without_comment(text)
        delimiter, decimal = _separators(row)
        cells = _split(row, delimiter)
        found = [c.replace(",", ".") for c in cells] if decimal == "," else cells
        if not _numbers(found):
            head.append((number, text))
            continue
        header = _header(name, head, comments, cells)
        return Layout(
            name=name,
            names=header if _fits(header, cells) else [],
            n_columns=len(cells),
            about=" ".join([name, *comments]),
            rates=tuple(dict.fromkeys(rates)),
            n_names=len(header),
            delimiter=delimiter,
            decimal=decimal,
            first_line=number,
            n_used=_used(cells),
            first_row=found,
        )
    raise LogError(f"{name}: found no row of numbers; accepted: a table with three rate columns")


def without_comment(line: str) -> str:
    """A line without quotes, byte order mark and comment."""
    text = _text(line)
    for mark in COMMENTS:
        if mark in text:
            text = text[: text.index(mark)].rstrip(" ")
    return text if text.strip() else ""


def number(cell: str) -> float:
    """A cell's number; NaN where it is none."""
    try:
        return float(cell) if cell.isascii() and "_" not in cell else math.nan
    except ValueError:
        return math.nan


def _header(
    name: str, head: list[tuple[int, str]], comments: list[str], cells: list[str]
) -> list[str]:
    """Names of columns: of a line, with the units of a line below it, or of a comment."""
    known = [c for c in comments if names.triples(_names(c), "gyro") or names.quaternion(_names(c))]
    if not head:
        return _names(known[-1]) if known else []
    lines = [(number, text, _names(text)) for number, text in head]
    fitting = [k for k, (_, _, found) in enumerate(lines) if _fits(found, cells)]
    at = fitting[-1] if fitting else len(lines) - 1
    header = lines[at][2]
    above = lines[at - 1][2] if at and at - 1 in fitting else []
    named = names.triples(header, "gyro") or not above
    if not named and len(above) == len(header) and all(map(names.is_unit, header)):
        return [f"{n} [{unit}]" if unit else n for n, unit in zip(above, header, strict=True)]
    if at + 1 < len(lines) or not named:
        number, text, _ = lines[min(at + 1, len(lines) - 1)]
        raise LogError(f"{name} line {number}: found {text[:60]!r}; accepted: numbers")
    return header


def _fits(header: list[str], cells: list[str]) -> bool:
    # a separator may end the line of names or those of numbers, or both
    return len(header) == len(cells) or (_used(header) == _used(cells) and bool(header))


def _numbers(cells: list[str]) -> bool:
    """Whether a line is one of numbers, or of as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    count = sum(not math.isnan(number(c)) or c.lower() in ("nan", "-nan") for c in used)
    return count >= 3 or 0 < count == len(used)


def _text(line: str) -> str:
    """A line without quotes and byte order mark."""
    if '"' in line or "\ufeff" in line:
        line = line.replace('"', "").lstrip("\ufeff")
    return line.strip("\r\n ")


def _split(text: str, delimiter: str | None) -> list[str]:
    return [part.strip() for part in text.split(delimiter)]


def _separators(row: str) -> tuple[str | None, str]:
    """The sign between a row's columns, None for blanks, and the decimal sign."""
    for delimiter in (";", "\t"):
        if delimiter in row:
            cells = _split(row, delimiter)
            if any(map(_DECIMAL_COMMA.fullmatch, cells)):
                return delimiter, ","
            if delimiter == ";" or "," not in row:
                return delimiter, "."
    return ("," if "," in row else None), "."


def _names(text: str) -> list[str]:
    separator = next((d for d in (";", "\t", ",") if d in text), None)
    # between blanks a unit in brackets belongs to the name before it
    parts = re.split(r"\s+(?![\[(])", text) if separator is None else _split(text, separator)
    return [names.printable(part) for part in parts] if text else []


def _used(cells: list[str]) -> int:
    """How many columns there are before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
