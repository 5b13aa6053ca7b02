"""Text tables: their first lines, then their rows, which pandas parses."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import sys
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.logs import names, stamps
from fastatt.logs.names import GyroLogError
from fastatt.logs.tables import Table

BYTES = 1 << 23  # read at a time
_HEAD = 1000  # lines within which the numbers must begin
_RATE = re.compile(
    r"((sample|update)[ _]?rate|sampling[ _]?(rate|frequency)|frequency)([ _]*[(\[]hz[)\]])?"
    r"[\s:=,;\"']+(?P<rate>\d+\.?\d*(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
# words of other rates in such a line
_OTHER_RATE = re.compile(
    r"(?!.*(gyr|imu|ang))(?=.*(mag|acc|baro|gps|gnss|cut|filter|corner))", re.IGNORECASE
)
_COMMENTS = ("#", "//", "%")
_COMMENT = re.compile(rb" *(#|//|%)[^\n]*")
_QUOTED_COMMA = re.compile(rb'"\s*([+-]?\d*),(\d+(?:e[+-]?\d+)?)\s*"', re.IGNORECASE)
_BLANKS = re.compile(rb"[ \t]+")


class Text(Table):
    """A text table, whose first lines are read when it is made."""

    def __init__(self, name: str, stream: Any) -> None:
        self._blocks = _whole_lines(stream)
        content = next(self._blocks, b"")
        if content[:2] in (b"\xff\xfe", b"\xfe\xff") or content[:8].count(b"\0") > 2:
            raise GyroLogError(f"{name}: found UTF-16 text; accepted: text in UTF-8")
        while content.count(b"\n") < _HEAD and (more := next(self._blocks, b"")):
            content += more
        head: list[tuple[int, str]] = []
        comments: list[str] = []
        rates: list[float] = []
        start = 0
        for number, line in enumerate(content.split(b"\n", _HEAD)[:_HEAD], start=1):
            text = _plain(line)
            match = _RATE.search(text)
            if match and not _OTHER_RATE.match(text[: match.start()]):
                rates.append(float(match["rate"]))
            if not text.strip() or text.startswith(_COMMENTS):
                comments.append(text.lstrip("#/% "))
            else:
                self.delimiter, self.decimal = _separators(line)
                cells = self._cells(line)
                if _numbers(cells):
                    break
                head.append((number, text))
            start += len(line) + 1
        else:
            raise GyroLogError(
                f"{name}: found no row of numbers; accepted: a table with three rate columns"
            )
        self._first, self._first_line = content[start:], number
        self._n_used = _used(cells)
        self._counts: dict[int, int] = {}  # of columns, in lines where it is another
        header = _header(name, head, comments, cells)
        super().__init__(
            name=name,
            names=header if _fits(header, cells) else [],
            n_columns=len(cells),
            rates=tuple(dict.fromkeys(rates)),
            n_names=len(header),
            first_row=cells,
            row="line",
        )

    def blocks(self) -> Iterator[tuple[NDArray[np.int64], Sequence[NDArray[Any]]]]:
        """Implements ``Table.blocks``."""
        try:
            import pandas as pd
        except ImportError:
            raise ImportError(
                "read_gyro_log: text tables need pandas; pip install 'fastatt[logs]'"
            ) from None
        first = self._first_line
        for block in chain([self._first], self._blocks):
            lines = enumerate(self._clean(block).split(b"\n"), first)
            rows = {place: self._row(place, line) for place, line in lines if line.strip()}
            first += block.count(b"\n")
            content = io.BytesIO(b"\n".join(rows.values()))
            if rows:
                table = pd.read_csv(
                    content, sep=self.delimiter, header=None, names=range(self.n_columns),
                    dtype=object, quoting=csv.QUOTE_NONE, na_filter=False,
                    encoding_errors="replace",
                )  # fmt: skip
                yield np.array([*rows]), [table[i].to_numpy() for i in table]

    def _row(self, place: int, line: bytes) -> bytes:
        """A line with all columns; without any cell if it has others."""
        mark = self.delimiter.encode()
        if line.count(mark) == self.n_columns - 1:
            return line
        cells = line.split(mark)
        if _used([cell.strip() for cell in cells]) != self._n_used:
            self._counts[place] = len(cells)
            cells = []
        cells = cells[: self.n_columns]
        return mark.join(cells + [b""] * (self.n_columns - len(cells)))

    def _wrong(self, place: int, i: int, how: str, cell: object) -> str:
        """Adds ``Table._wrong`` lines of too few or too many columns."""
        if place not in self._counts:
            return super()._wrong(place, i, how, cell)
        return (
            f"line {place}: found {self._counts[place]} columns; accepted: {self.n_columns}, as in "
            f"line {self._first_line}"
        )

    def _clean(self, content: bytes) -> bytes:
        """Lines without quotes and comments, with decimal points and one kind of separator."""
        if b'"' in content:
            if self.decimal == "," and self.delimiter == ",":
                content = _QUOTED_COMMA.sub(rb"\1.\2", content)
            content = content.replace(b'"', b"")
        if b"#" in content or b"%" in content or b"//" in content:
            content = _COMMENT.sub(b"", content)
        if self.decimal == "," and self.delimiter != ",":
            content = content.replace(b",", b".")
        if self.delimiter == " ":
            content = b"\n".join(x.strip(b" \t") for x in _BLANKS.sub(b" ", content).split(b"\n"))
        return content

    def _cells(self, line: bytes) -> list[str]:
        return self._cut(self._clean(line).decode("utf-8", "replace"))

    def _cut(self, text: str) -> list[str]:
        return [cell.strip() for cell in text.lstrip("\ufeff").split(self.delimiter)]


@contextmanager
def opened(source: Any) -> Iterator[tuple[str, Any]]:
    """A name and a stream of bytes; from gzip too.

    The source is a path, "-" for standard input, or an open file.
    """
    with ExitStack() as stack:
        name = getattr(source, "name", "the file")
        if isinstance(source, str) and source == "-":
            name, source = "standard input", sys.stdin
        if hasattr(source, "read"):
            stream = getattr(source, "buffer", source)
        elif isinstance(source, (str, PathLike)) and "\0" not in str(source):
            name, stream = str(source), stack.enter_context(Path(source).open("rb"))
        else:
            raise TypeError(
                f'source: found {checks.brief(source)}; accepted: a file\'s name, "-", an open '
                "file, a data frame or a data set"
            )
        if not hasattr(stream, "peek"):
            data = stream.read()
            data = data.encode() if isinstance(data, str) else data
            stream = io.BufferedReader(io.BytesIO(data))
        zipped = stream.peek(2)[:2] == b"\x1f\x8b"
        try:
            yield str(name), gzip.GzipFile(fileobj=stream) if zipped else stream
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise GyroLogError(
                f"{name}: found damaged gzip data ({error}); accepted: whole"
            ) from None


def _whole_lines(stream: Any) -> Iterator[bytes]:
    """The bytes of a stream in blocks of whole lines, with one kind of line ends."""
    while data := stream.read(BYTES):
        data += stream.readline()
        yield data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


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


def _separators(line: bytes) -> tuple[str, str]:
    """The separator of columns (" ": any blanks), and the decimal sign."""
    quoted = _QUOTED_COMMA.search(line)
    row = _COMMENT.sub(b"", line).decode("utf-8", "replace")
    for delimiter in (";", "\t"):
        if delimiter in row and (delimiter == ";" or re.search(r"\d,\d", row) or "," not in row):
            return delimiter, "." if re.search(r"\d\.\d", row) else ","
    if "," not in row:
        return " ", "."
    return ",", "," if quoted and not re.search(r"\d\.\d", row) else "."


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
