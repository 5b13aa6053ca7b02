"""Text tables: their head, then their rows, by pyarrow where it is installed and meets nothing odd.

What is odd is read row by row; both round to nearest, and their numbers are the same to the bit.
"""

from __future__ import annotations

import gzip
import io
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import chain, islice
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
_HEAD = 1000  # lines within which the numbers have to begin
_RATE = re.compile(
    r"((sample|update)[ _]?rate|sampling[ _]?(rate|frequency)|frequency)([ _]*[(\[]hz[)\]])?"
    r"[\s:=,;\"']+(?P<rate>\d+\.?\d*(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
# what else a line may say the rate of
_OTHER_RATE = re.compile(
    r"(?!.*(gyr|imu|ang))(?=.*(mag|acc|baro|gps|gnss|cut|filter|corner))", re.IGNORECASE
)
_COMMENTS = ("#", "//", "%")
_COMMENT = re.compile(rb" *(#|//|%)[^\n]*")
_QUOTED_COMMA = re.compile(rb'"\s*([+-]?\d*),(\d+(?:e[+-]?\d+)?)\s*"', re.IGNORECASE)
_MEANT = {
    "float": "a finite number", "int": "a whole number", "date": "a date", "day": "a time of day",
}  # fmt: skip
_BLANKS = re.compile(rb"[ \t]+")


class Text(Table):
    """A text table: its head is read when it is made."""

    def __init__(self, name: str, stream: Any, progress: Callable[[int], object] | None) -> None:
        self._blocks, self._progress = _whole_lines(stream), progress or (lambda n: None)
        self._lines: list[Sequence[int]] = []  # in which the rows stand
        content = next(self._blocks, b"")
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
        header = _header(name, head, comments, cells)
        super().__init__(
            name=name,
            names=header if _fits(header, cells) else [],
            n_columns=len(cells),
            about=" ".join([Path(name).name, *comments]),
            rates=tuple(dict.fromkeys(rates)),
            n_names=len(header),
            first_row=cells,
        )

    def read(
        self, wanted: list[int], clock: list[int], *, numbers: int, strict: bool
    ) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
        """As ``Table.read`` says."""
        needed = [*wanted[:numbers], *clock]
        kinds: list[tuple[int, stamps.Kind]] = [(i, "float") for i in wanted]
        kinds += [(i, self._kind(i, clock)) for i in clock]
        parts, line = [], self._first_line
        for block in chain([self._first], self._blocks):
            content = self._clean(block)
            found = self._fast(content, line, kinds)
            if found is None or (strict and not _complete(found[1], kinds, needed)):
                found = self._by_rows(content, line, kinds, needed if strict else [])
            self._lines.append(found[0])
            parts.append(found[1])
            line += content.count(b"\n")
            self._progress(len(block))
        self._first = b""
        joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
        values = np.stack(joined[: len(wanted)], axis=1)
        values[~np.isfinite(values)] = np.nan
        return values, stamps.joined(joined[len(wanted) :])

    def place(self, row: int) -> str:
        """The line of a row."""
        return f"line {next(islice(chain.from_iterable(self._lines), row, None))}"

    def _kind(self, i: int, clock: list[int]) -> stamps.Kind:
        return "int" if len(clock) > 1 else stamps.kind(self.first_row[i])

    def _clean(self, content: bytes) -> bytes:
        """Lines without quotes and comments, with decimal points and one sign between columns."""
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

    def _fast(
        self, content: bytes, line: int, kinds: list[tuple[int, stamps.Kind]]
    ) -> tuple[Sequence[int], list[NDArray[Any]]] | None:
        """Lines and columns by pyarrow; None where it isn't installed or met anything odd."""
        try:
            import pyarrow as pa
            from pyarrow import csv
        except ImportError:
            return None
        if len(dict(kinds)) < len(kinds):  # a column of numbers and of stamps
            return None
        types = {"float": pa.float64(), "int": pa.int64()}
        try:
            table = csv.read_csv(
                pa.BufferReader(content),
                csv.ReadOptions(column_names=[str(i) for i in range(self.n_columns)]),
                csv.ParseOptions(delimiter=self.delimiter, quote_char=False),
                csv.ConvertOptions(
                    include_columns=[str(i) for i, _ in kinds],
                    column_types={str(i): types.get(kind, pa.string()) for i, kind in kinds},
                    null_values=[""],
                ),
            )
        except pa.ArrowInvalid:
            return None
        n = content.count(b"\n") + (not content.endswith(b"\n"))
        lines: Sequence[int] = range(line, line + n)
        if table.num_rows != n:  # blank lines
            lines = [k for k, x in enumerate(content.split(b"\n"), line) if x]
        columns = []
        for i, kind in kinds:
            column = table[str(i)]
            if kind == "int" and column.null_count:
                return None
            if kind in ("float", "int"):
                columns.append(column.to_numpy())
            else:
                columns.append(stamps.from_text(kind, [x or "" for x in column.to_pylist()]))
        return lines, columns

    def _by_rows(
        self, content: bytes, first: int, kinds: list[tuple[int, stamps.Kind]], needed: list[int]
    ) -> tuple[Sequence[int], list[NDArray[Any]]]:
        """The same, row by row; a row with a column lost or added holds no number.

        Raises ``GyroLogError`` for the first row where a column that is needed holds none.
        """
        texts = enumerate(content.decode("utf-8", "replace").split("\n"), first)
        found = [(k, self._cut(text)) for k, text in texts if text.strip()]
        lines, rows = [k for k, _ in found], [row for _, row in found]
        for k, row in enumerate(rows):
            even = len(row) == self.n_columns or _used(row) == self._n_used
            if needed and not even:
                raise self.error(
                    f"line {lines[k]}: found {len(row)} columns; accepted: {self.n_columns}, as in "
                    f"line {self._first_line}"
                )
            # empty cells at the end need not be there
            rows[k] = (row if even else []) + [""] * (self.n_columns - even * len(row))
        columns = [stamps.from_text(kind, [row[i] for row in rows]) for i, kind in kinds]
        for (i, kind), column in zip(kinds, columns, strict=True):
            good = stamps.known(column)
            if i in needed and not good.all():
                k = int(np.argmin(good))
                raise self.error(
                    f"line {lines[k]}: {self.column(i)[:60]} is {rows[k][i][:60]!r}; accepted: "
                    f"{_MEANT[kind]}, or on_bad_rows, to say what becomes of such rows"
                )
        return lines, columns


@contextmanager
def opened(source: Any) -> Iterator[tuple[str, Any]]:
    """A name and a stream of bytes of a path, "-" (standard input) or an open file; gzip too."""
    with ExitStack() as stack:
        if hasattr(source, "read"):
            stream, name = getattr(source, "buffer", source), getattr(source, "name", "the file")
        elif isinstance(source, str) and source == "-":
            stream, name = sys.stdin.buffer, "standard input"
        elif isinstance(source, (str, PathLike)) and "\0" not in str(source):
            stream, name = stack.enter_context(Path(source).open("rb")), source
        else:
            raise TypeError(
                f'source: found {checks.brief(source)}; accepted: a file\'s name, "-", an open '
                "file, a data frame or a data set"
            )
        if not hasattr(stream, "peek"):
            if not hasattr(stream, "readinto"):
                data = stream.read()
                stream = io.BytesIO(data.encode() if isinstance(data, str) else data)
            stream = io.BufferedReader(stream)
            stack.callback(stream.detach)  # it is the caller's to close
        zipped = stream.peek(2)[:2] == b"\x1f\x8b"
        try:
            yield str(name), gzip.GzipFile(fileobj=stream) if zipped else stream
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise GyroLogError(
                f"{name}: found damaged gzip data ({error}); accepted: whole"
            ) from None


def _whole_lines(stream: Any) -> Iterator[bytes]:
    """The bytes of a stream, cut after ends of lines, which are all made alike."""
    while data := stream.read(BYTES):
        data += stream.readline()
        yield data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _complete(
    columns: list[NDArray[Any]], kinds: list[tuple[int, stamps.Kind]], needed: list[int]
) -> bool:
    pairs = zip(kinds, columns, strict=True)
    return all(bool(stamps.known(column).all()) for (i, _), column in pairs if i in needed)


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
        raise GyroLogError(f"{name} line {number}: found {text[:60]!r}; accepted: numbers")
    return header


def _fits(header: list[str], cells: list[str]) -> bool:
    # a separator may end the line of names or those of numbers, or both
    return len(header) == len(cells) or (_used(header) == _used(cells) and bool(header))


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a line is one of numbers, or of as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    words = sum(cell.lower() in ("nan", "-nan") for cell in used)
    count = words + int((~np.isnan(stamps.from_text("float", used))).sum())
    return count >= 3 or 0 < count == len(used)


def _plain(line: bytes) -> str:
    """A line without quotes and byte order mark."""
    return line.decode("utf-8", "replace").replace('"', "").lstrip("\ufeff").strip("\r\n ")


def _separators(line: bytes) -> tuple[str, str]:
    """The sign between a row's columns (" ": any blanks), and the decimal sign."""
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
    # between blanks a unit in brackets belongs to the name before it
    if separator is None:
        parts = re.split(r"\s+(?![\[(])", text)
    else:
        parts = [part.strip() for part in text.split(separator)]
    return [names.printable(part) for part in parts] if text else []


def _used(cells: Sequence[str]) -> int:
    """How many columns there are before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
