"""Text tables: their first lines, then their rows, which pandas parses."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import sys
import zlib
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.gyro import columns as names
from fastatt.gyro import stamps
from fastatt.gyro.log import GyroLogError
from fastatt.gyro.tables import Table

_HEAD = 1000  # lines within which the numbers must begin
_RATE = re.compile(
    r"((gyro\w*|imu)[ _])?((sample|update)[ _]?rate|sampling[ _]?(rate|frequency))"
    r"([ _]*[(\[]hz[)\]])?[\s:=,;\"']+(?P<rate>\d+(\.\d*)?(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
_COMMENTS = ("#", "//", "%")
# at the begin of a cell; a sign inside a number is damage
_COMMENT = re.compile(r"(?:(?<! ) +|(?<![^\s,;]))(#|//|%)[^\n]*")
_QUOTE = re.compile(r'(?<![^\s,;#"])"|"(?![^\s,;"])')  # at the begin or the end of a cell


def from_text(source: Any) -> Table:
    """The table of a text: its first lines, then its rows."""
    name, text = _content(source)
    head: list[str] = []
    comments: list[str] = []
    rates: list[float] = []
    for row in text.split("\n", _HEAD)[:_HEAD]:
        line, note = row.strip(" "), row.lstrip("#/% ")
        if match := _RATE.match(note):
            rates.append(float(match["rate"]))
        if not line.strip() or line.startswith(_COMMENTS):
            comments.append(note)
        else:
            layout = _layout(line)
            cells = [cell.strip() for cell in layout.clean(line).split(layout.delimiter)]
            if _numbers(cells):
                break
            head.append(line)
    else:
        raise GyroLogError(
            f"{name}: found no row of numbers; accepted: a table with three rate columns"
        )
    start = len(head) + len(comments)
    # names are in the line before the numbers, or else in a comment
    named = head[-1:] or [c for c in comments if names.triples(_names(c), "gyro")][-1:]
    header = _names(named[0]) if named else []
    # the line of names, those of numbers, or both may end with a separator
    fits = len(header) == len(cells) or (_used(header) == _used(cells) and bool(header))
    arrays, places, lengths = _rows(layout, text.split("\n", start)[-1], start + 1, cells)
    return Table(
        name=name, names=header if fits else [], arrays=arrays, first_row=cells, places=places,
        row="line", rates=tuple(dict.fromkeys(rates)), lengths=lengths,
    )  # fmt: skip


def _rows(
    layout: _Layout, text: str, first: int, cells: list[str]
) -> tuple[list[NDArray[Any]], NDArray[np.int64], dict[int, int]]:
    """Columns, the lines of rows, and the lengths of those of another length, left empty."""
    mark, n_columns, n_used = layout.delimiter, len(cells), _used(cells)
    rows: dict[int, str] = {}
    lengths: dict[int, int] = {}
    for place, line in enumerate(layout.clean(text).split("\n"), first):
        if not line.strip():
            continue
        rows[place] = line
        if line.count(mark) != n_columns - 1:
            found = line.split(mark)
            if _used([cell.strip() for cell in found]) != n_used:
                lengths[place], found = len(found), []
            rows[place] = mark.join([*found, *[""] * n_columns][:n_columns])
    pandas = stamps.pandas()
    is_exact = tuple(map(int, pandas.__version__.split(".")[:2])) >= (3, 1)
    exact = {} if is_exact else {"float_precision": "round_trip"}  # which is deprecated there
    table = pandas.read_csv(
        io.StringIO("\n".join(rows.values())), sep=mark, header=None, names=range(n_columns),
        quoting=csv.QUOTE_NONE, na_filter=False, skipinitialspace=True, low_memory=False, **exact,
    )  # fmt: skip
    return [table[i].to_numpy() for i in table], np.array([*rows]), lengths


class _Layout(NamedTuple):
    """The separator of columns (" ": any blanks), and the decimal sign."""

    delimiter: str
    decimal: str

    def clean(self, text: str) -> str:
        """Lines without comments, with decimal points and one kind of separator."""
        if "#" in text or "%" in text or "//" in text:
            text = _COMMENT.sub("", text)
        if self.decimal == ",":
            text = text.replace(",", ".")
        if self.delimiter == " ":
            text = "\n".join(" ".join(line.split()) for line in text.split("\n"))
        return text


def _layout(line: str) -> _Layout:
    row = _COMMENT.sub("", line)
    decimal = "." if re.search(r"\d\.\d", row) else ","
    if ";" in row:
        return _Layout(";", decimal)
    if "\t" in row and (re.search(r"\d,\d", row) or "," not in row):
        return _Layout("\t", decimal)
    return _Layout("," if "," in row else " ", ".")


def _content(source: Any) -> tuple[str, str]:
    """A name and the text of a path, of standard input, "-", or of an open file; from gzip too.

    Quotes around cells are left out; one inside a number stays, so that its row is not read.
    """
    name = str(getattr(source, "name", "the file"))
    if isinstance(source, str) and source == "-":
        name, source = "standard input", sys.stdin
    if hasattr(source, "read"):
        data = getattr(source, "buffer", source).read()
    elif isinstance(source, (str, PathLike)) and "\0" not in str(source):
        name, data = str(source), Path(source).read_bytes()
    else:
        raise TypeError(
            f'source: found {checks.brief(source)}; accepted: a file\'s name, "-", an open file, a '
            "data frame or a data set"
        )
    data = data.encode() if isinstance(data, str) else data
    try:
        data = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise GyroLogError(f"{name}: found damaged gzip data ({error}); accepted: whole") from None
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or data[:8].count(b"\0") > 2:
        raise GyroLogError(f"{name}: found UTF-16 text; accepted: text in UTF-8")
    text = _QUOTE.sub("", data.decode("utf-8-sig", "replace"))
    return name, text.replace("\r\n", "\n").replace("\r", "\n")


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a line consists of numbers, or has as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    words = sum(cell.lower() in ("nan", "-nan") for cell in used)
    count = words + sum(not math.isnan(stamps.number(cell)) for cell in used)
    return count >= 3 or 0 < count == len(used)


def _names(text: str) -> list[str]:
    separator = next((d for d in (";", "\t", ",") if d in text), None)
    # a unit in brackets after a blank belongs to the name before it
    if separator is None:
        parts = re.split(r"\s+(?![\[(])", text)
    else:
        parts = [part.strip() for part in text.split(separator)]
    return [names.printable(part) for part in parts] if text else []


def _used(cells: Sequence[str]) -> int:
    """The number of columns before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
