"""Text tables: their first lines, then their rows, by pyarrow if it is installed and can read them.

Other files are read row by row. Both round to nearest and give the same bits.
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
_MEANT = {
    "float": "a finite number", "int": "a whole number", "date": "a date", "day": "a time of day",
}  # fmt: skip
_BLANKS = re.compile(rb"[ \t]+")


class Text(Table):
    """A text table, whose first lines are read when it is made."""

    def __init__(self, name: str, stream: Any, progress: Callable[[int], object] | None) -> None:
        self._blocks, self._progress = _whole_lines(stream), progress or (lambda n: None)
        self._lines: list[Sequence[int]] = []  # line numbers of the rows
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
        """Implements ``Table.read``."""
        kinds: list[tuple[int, stamps.Kind]] = [(i, "float") for i in wanted]
        kinds += [(i, self._kind(i, clock)) for i in clock]
        needed = [*range(numbers), *range(len(wanted), len(kinds))] if strict else []
        parts, line = [], self._first_line
        for block in chain([self._first], self._blocks):
            content = self._clean(block)
            end = line + content.count(b"\n")
            lines: Sequence[int] = range(line, end + (not content.endswith(b"\n")))
            columns = self._by_pyarrow(content, kinds)
            if columns is None:
                texts = content.decode("utf-8", "replace").split("\n")
                lines = [k for k, text in enumerate(texts, line) if text.strip()]
                rows = [self._row(texts[k - line]) for k in lines]
                columns = [stamps.from_text(kind, [row[i] for row in rows]) for i, kind in kinds]
            bad = [~stamps.known(columns[k]) for k in needed]
            if np.any(bad):
                row = int(np.argmax(np.logical_or.reduce(bad)))
                i, kind = next(kinds[k] for k, x in zip(needed, bad, strict=True) if x[row])
                text = content.split(b"\n")[lines[row] - line].decode("utf-8", "replace")
                raise self._refusal(text, lines[row], i, kind)
            self._lines.append(lines)
            parts.append(columns)
            line = end
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

    def _row(self, text: str) -> list[str]:
        """Cells of a line; empty ones if a column is missing or added."""
        cells = self._cut(text)
        if not self._complete(cells):
            cells = []
        return cells + [""] * (self.n_columns - len(cells))

    def _complete(self, cells: list[str]) -> bool:
        # empty cells at the end of a line may be missing
        return len(cells) == self.n_columns or _used(cells) == self._n_used

    def _refusal(self, text: str, line: int, i: int, kind: stamps.Kind) -> GyroLogError:
        """The error for a line whose column i has no number or time stamp."""
        cells = self._cut(text)
        if not self._complete(cells):
            return self.error(
                f"line {line}: found {len(cells)} columns; accepted: {self.n_columns}, as in line "
                f"{self._first_line}"
            )
        return self.error(
            f"line {line}: {self.column(i)[:60]} is {self._row(text)[i][:60]!r}; accepted: "
            f'{_MEANT[kind]}, or on_bad_rows="drop", "split" or "hold"'
        )

    def _by_pyarrow(
        self, content: bytes, kinds: list[tuple[int, stamps.Kind]]
    ) -> list[NDArray[Any]] | None:
        """Columns; None if pyarrow is not installed or would skip or refuse a line."""
        try:
            import pyarrow as pa
            from pyarrow import csv
        except ImportError:
            return None
        numbers = {"float": pa.float64(), "int": pa.int64()}
        types = {str(i): numbers.get(kind, pa.string()) for i, kind in kinds}
        if len(types) < len(kinds):  # one column has both numbers and stamps
            return None
        if content.startswith(b"\n") or b"\n\n" in content:  # pyarrow skips blank lines
            return None
        try:
            table = csv.read_csv(
                pa.BufferReader(content),
                csv.ReadOptions(column_names=[str(i) for i in range(self.n_columns)]),
                csv.ParseOptions(delimiter=self.delimiter, quote_char=False),
                csv.ConvertOptions(
                    include_columns=list(types), column_types=types, null_values=[""]
                ),
            )
        except pa.ArrowInvalid:
            return None
        columns = []
        for column, (_, kind) in zip(table.columns, kinds, strict=True):
            if kind == "int" and column.null_count:
                return None
            if kind in numbers:
                columns.append(column.to_numpy())
            else:
                columns.append(stamps.from_text(kind, [x or "" for x in column.to_pylist()]))
        return columns


@contextmanager
def opened(source: Any) -> Iterator[tuple[str, Any]]:
    """A name and a stream of bytes for a path, "-" (standard input) or an open file; gzip too."""
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


def size_of(source: Any) -> int:
    """Size of a file, bytes; 0 where it is unknown."""
    by_name = isinstance(source, (str, PathLike)) and source != "-"
    return Path(source).stat().st_size if by_name else 0


def _whole_lines(stream: Any) -> Iterator[bytes]:
    """The bytes of a stream in blocks of whole lines, with one kind of line ends."""
    while data := stream.read(BYTES):
        data += stream.readline()
        yield data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _header(
    name: str, head: list[tuple[int, str]], comments: list[str], cells: list[str]
) -> list[str]:
    """Names of columns, from a line, with the units in a line below it, or from a comment."""
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
    # the line of names, those of numbers, or both may end with a separator
    return len(header) == len(cells) or (_used(header) == _used(cells) and bool(header))


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a line consists of numbers, or has as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    words = sum(cell.lower() in ("nan", "-nan") for cell in used)
    count = words + int((~np.isnan(stamps.from_text("float", used))).sum())
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


def _used(cells: Sequence[str]) -> int:
    """The number of columns before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
