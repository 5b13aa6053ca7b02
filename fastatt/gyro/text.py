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
    r"([ _]*[(\[]hz[)\]])?[\s:=,;\"']+(?P<rate>\d+\.?\d*(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
_COMMENTS = ("#", "//", "%")
_COMMENT = re.compile(rb" *(#|//|%)[^\n]*")
_BLANKS = re.compile(rb"[ \t]+")


def from_text(source: Any) -> Table:
    """The table of a text: its first lines, then its rows."""
    name, content = _content(source)
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if content[:2] in (b"\xff\xfe", b"\xfe\xff") or content[:8].count(b"\0") > 2:
        raise GyroLogError(f"{name}: found UTF-16 text; accepted: text in UTF-8")
    head: list[tuple[int, str]] = []
    comments: list[str] = []
    rates: list[float] = []
    start = 0
    for number, line in enumerate(content.split(b"\n", _HEAD)[:_HEAD], start=1):
        text = _plain(line)
        if match := _RATE.match(text.lstrip("#/% ")):
            rates.append(float(match["rate"]))
        if not text.strip() or text.startswith(_COMMENTS):
            comments.append(text.lstrip("#/% "))
        else:
            layout = _layout(line)
            cells = layout.cells(line)
            if _numbers(cells):
                break
            head.append((number, text))
        start += len(line) + 1
    else:
        raise GyroLogError(
            f"{name}: found no row of numbers; accepted: a table with three rate columns"
        )
    header = _header(name, head, comments, cells)
    arrays, places, lengths = _rows(layout, content[start:], number, cells)
    return Table(
        name=name, names=header if _fits(header, cells) else [], arrays=arrays, first_row=cells,
        places=places, row="line", rates=tuple(dict.fromkeys(rates)), n_names=len(header),
        lengths=lengths,
    )  # fmt: skip


def _rows(
    layout: _Layout, content: bytes, first: int, cells: list[str]
) -> tuple[list[NDArray[Any]], NDArray[np.int64], dict[int, int]]:
    """Columns, the lines of rows, and the lengths of those of another length, left empty."""
    mark, n_columns, n_used = layout.delimiter.encode(), len(cells), _used(cells)
    rows: dict[int, bytes] = {}
    lengths: dict[int, int] = {}
    for place, line in enumerate(layout.clean(content).split(b"\n"), first):
        if not line.strip():
            continue
        rows[place] = line
        if line.count(mark) != n_columns - 1:
            found = line.split(mark)
            if _used([cell.strip() for cell in found]) != n_used:
                lengths[place], found = len(found), []
            rows[place] = mark.join([*found, *[b""] * n_columns][:n_columns])
    pandas = stamps.pandas()
    is_exact = tuple(map(int, pandas.__version__.split(".")[:2])) >= (3, 1)
    exact = {} if is_exact else {"float_precision": "round_trip"}  # which is deprecated there
    table = pandas.read_csv(
        io.BytesIO(b"\n".join(rows.values())), sep=layout.delimiter, header=None,
        names=range(n_columns), quoting=csv.QUOTE_NONE, na_filter=False, skipinitialspace=True,
        encoding_errors="replace", low_memory=False, **exact,
    )  # fmt: skip
    return [table[i].to_numpy() for i in table], np.array([*rows]), lengths


class _Layout(NamedTuple):
    """The separator of columns (" ": any blanks), and the decimal sign."""

    delimiter: str
    decimal: str

    def clean(self, content: bytes) -> bytes:
        """Lines without quotes and comments, with decimal points and one kind of separator."""
        content = content.replace(b'"', b"")
        if b"#" in content or b"%" in content or b"//" in content:
            content = _COMMENT.sub(b"", content)
        if self.decimal == ",":
            content = content.replace(b",", b".")
        if self.delimiter == " ":
            content = b"\n".join(x.strip(b" \t") for x in _BLANKS.sub(b" ", content).split(b"\n"))
        return content

    def cells(self, line: bytes) -> list[str]:
        """The cells of a line."""
        text = self.clean(line).decode("utf-8", "replace").lstrip("\ufeff")
        return [cell.strip() for cell in text.split(self.delimiter)]


def _content(source: Any) -> tuple[str, bytes]:
    """A name and the bytes of a path, of standard input, "-", or of an open file; from gzip too."""
    name = getattr(source, "name", "the file")
    if isinstance(source, str) and source == "-":
        name, source = "standard input", sys.stdin
    if hasattr(source, "read"):
        data = getattr(source, "buffer", source).read()
    elif isinstance(source, (str, PathLike)) and "\0" not in str(source):
        name, data = source, Path(source).read_bytes()
    else:
        raise TypeError(
            f'source: found {checks.brief(source)}; accepted: a file\'s name, "-", an open file, a '
            "data frame or a data set"
        )
    data = data.encode() if isinstance(data, str) else data
    try:
        return str(name), gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise GyroLogError(f"{name}: found damaged gzip data ({error}); accepted: whole") from None


def _header(
    name: str, head: list[tuple[int, str]], comments: list[str], cells: list[str]
) -> list[str]:
    """Names of columns, from a line, with the units in a line below it, or from a comment."""
    known = [c for c in comments if names.triples(_names(c), "gyro")]
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
        raise GyroLogError(f"{name} line {number}: found {text[:60]!r}; accepted: numbers")
    return header


def _fits(header: list[str], cells: list[str]) -> bool:
    # the line of names, those of numbers, or both may end with a separator
    return len(header) == len(cells) or (_used(header) == _used(cells) and bool(header))


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a line consists of numbers, or has as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    words = sum(cell.lower() in ("nan", "-nan") for cell in used)
    count = words + sum(not math.isnan(stamps.number(cell)) for cell in used)
    return count >= 3 or 0 < count == len(used)


def _plain(line: bytes) -> str:
    """A line without quotes and byte order mark."""
    return line.decode("utf-8", "replace").replace('"', "").lstrip("\ufeff").strip("\r\n ")


def _layout(line: bytes) -> _Layout:
    row = _COMMENT.sub(b"", line).decode("utf-8", "replace")
    for delimiter in (";", "\t"):
        if delimiter in row and (delimiter == ";" or re.search(r"\d,\d", row) or "," not in row):
            return _Layout(delimiter, "." if re.search(r"\d\.\d", row) else ",")
    if "," not in row:
        return _Layout(" ", ".")
    return _Layout(",", ".")


def _names(text: str) -> list[str]:
    separator = next((d for d in (";", "\t", ",") if d in text), None)
    # a unit in brackets after a blank belongs to the name before it
    if separator is None:
        parts = re.split(r"\s+(?![\[(])", text)
    else:
        parts = [part.strip() for part in text.split(separator)]
    return [names.printable(part) for part in parts] if text else []


def _used(cells: Sequence[str] | Sequence[bytes]) -> int:
    """The number of columns before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
