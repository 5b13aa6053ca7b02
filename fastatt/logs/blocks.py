"""Rows of a text table in blocks, by pyarrow where it is installed, else by NumPy.

Both round to nearest: their numbers are the same to the bit.
"""

from __future__ import annotations

import gzip
import io
import math
import re
import sys
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.logs.head import Layout, Stamps, layout, number, without_comment
from fastatt.logs.names import LogError
from fastatt.threads import default_threads

BYTES = 1 << 21  # read at a time
_HEAD = 1000  # lines within which the numbers have to begin
# years that 64 bits of ns hold; what is left to NumPy has no zone, of which it would warn
_ZONE = re.compile(
    r"(?P<local>(19|20)\d\d-[\d:T .-]*?)(Z|(?P<sign>[+-])(?P<hours>\d\d):?(?P<minutes>\d\d))?",
    re.ASCII,
)
NO_STAMP = np.iinfo(np.int64).min  # of whole numbers and dates


class Block(NamedTuple):
    """Some rows: the lines that they stand in, time stamps, numbers (n, k)."""

    lines: Sequence[int]
    stamps: NDArray[Any] | None
    values: NDArray[np.float64]


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
            raise LogError(f"{name}: found damaged gzip data ({error}); accepted: whole") from None


class Table:
    """A text table: its layout, then its rows."""

    def __init__(self, name: str, stream: Any, progress: Callable[[int], object] | None) -> None:
        self.progress = progress or (lambda n: None)
        self.blocks = _whole_lines(stream)
        self.first = next(self.blocks, b"")
        while self.first.count(b"\n") < _HEAD and (more := next(self.blocks, b"")):
            self.first += more
        lines = self.first.split(b"\n", _HEAD)[:_HEAD]
        self.layout = layout(name, (line.decode("utf-8", "replace") for line in lines))
        before = lines[: self.layout.first_line - 1]
        self.start = sum(map(len, before)) + len(before)

    def rows(self, clock: int | None, wanted: list[int], *, mend: bool) -> Iterator[Block]:
        """Wanted columns of the rows; with ``mend`` what is no number is NaN, else refused."""
        read = _Reading(self.layout, clock, wanted, mend=mend)
        first, self.first = self.first[self.start :], b""
        contents, line = chain([first] if first else [], self.blocks), self.layout.first_line
        threads = default_threads()
        pending: deque[Any] = deque()
        with ThreadPoolExecutor(threads) as pool:
            try:
                while True:
                    while len(pending) <= 2 * threads and (content := next(contents, b"")):
                        pending.append((content, pool.submit(read.fast, content)))
                    if not pending:
                        return
                    block, line = self._done(read, line, *pending.popleft())
                    yield block
            finally:
                for _, future in pending:
                    future.cancel()

    def _done(self, read: _Reading, line: int, content: bytes, future: Any) -> tuple[Block, int]:
        """A block's rows, and the line after it."""
        found = future.result()
        self.progress(len(content))
        if found is not None:
            stamps, values = found
            return Block(range(line, line + len(values)), stamps, values), line + len(values)
        lines = content.decode("utf-8", "replace").removesuffix("\n").split("\n")
        return read.slow(lines, line), line + len(lines)


def _whole_lines(stream: Any) -> Iterator[bytes]:
    """The bytes of a stream, cut after ends of lines, which are all made alike."""
    while data := stream.read(BYTES):
        data += stream.readline()
        yield data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


class _Reading:
    """Wanted columns of a table with some layout."""

    def __init__(self, known: Layout, clock: int | None, wanted: list[int], *, mend: bool) -> None:
        self.layout, self.clock, self.wanted, self.mend = known, clock, wanted, mend
        self.stamps: Stamps = "float" if clock is None else known.stamps(clock)
        # those of floats; time stamps that are such stand last
        self.floats = wanted if clock is None or self.stamps != "float" else [*wanted, clock]

    def fast(self, content: bytes) -> tuple[NDArray[Any] | None, NDArray[np.float64]] | None:
        """Stamps and values by pyarrow; None where it isn't installed or met anything odd."""
        try:
            import pyarrow as pa
            from pyarrow import csv
        except ImportError:
            return None
        known = self.layout
        marked = b"#" in content or b"%" in content or (b"/" in content and b"//" in content)
        if known.delimiter is None or marked:  # one byte is found much faster than two
            return None
        kinds = {str(i): pa.float64() for i in self.wanted}
        if self.clock is not None:
            clock = {"float": pa.float64(), "int": pa.int64(), "date": pa.string()}
            kinds[str(self.clock)] = clock[self.stamps]
        try:
            table = csv.read_csv(
                pa.BufferReader(content),
                csv.ReadOptions(
                    use_threads=False,
                    column_names=[str(i) for i in range(known.n_columns)],
                    block_size=len(content),
                ),
                csv.ParseOptions(delimiter=known.delimiter, ignore_empty_lines=False),
                csv.ConvertOptions(
                    include_columns=list(kinds),
                    column_types=kinds,
                    decimal_point=known.decimal,
                    null_values=[],
                ),
            )
        except pa.ArrowInvalid:
            return None
        values = np.empty((table.num_rows, len(self.wanted)))
        for k, i in enumerate(self.wanted):
            values[:, k] = table[str(i)].to_numpy()
        if not np.isfinite(values).all():
            return None
        if self.clock is None:
            return None, values
        column = table[str(self.clock)]
        stamps = dates(column.to_pylist()) if self.stamps == "date" else column.to_numpy()
        good = np.isfinite(stamps) if self.stamps == "float" else stamps != NO_STAMP
        return (stamps, values) if good.all() else None

    def slow(self, lines: list[str], first: int) -> Block:
        """The same by NumPy and, of odd rows, cell by cell.

        Raises ``LogError`` for the first odd row, unless rows are to be mended.
        """
        known = self.layout
        found = [(n, row) for n, x in enumerate(lines, first) if (row := without_comment(x))]
        numbers, rows = [n for n, _ in found], [row for _, row in found]
        values = None
        if rows and all(map(known.even, rows)):
            text = rows if known.decimal == "." else [x.replace(",", ".") for x in rows]
            with suppress(ValueError, IndexError):
                values = np.loadtxt(
                    text, delimiter=known.delimiter, usecols=self.floats, comments=None, ndmin=2
                )
        if values is None or not np.isfinite(values).all():
            values = np.array([self._cells(n, row) for n, row in found], dtype=np.float64)
            values = values.reshape(len(rows), len(self.floats))
        k = len(self.wanted)
        if self.clock is None:
            return Block(numbers, None, values)
        stamps = values[:, k] if self.stamps == "float" else self._exact(found, self.clock)
        return Block(numbers, stamps, values[:, :k])

    def _cells(self, line: int, row: str) -> list[float]:
        """Numbers of a row; those of a row with a column lost or added are all NaN."""
        known = self.layout
        cells = known.split(row)
        where = f"{known.name} line {line}:"
        if not known.even(row):
            if not self.mend:
                raise LogError(
                    f"{where} found {len(cells)} columns; accepted: {known.n_columns}, as in line "
                    f"{known.first_line}"
                )
            return [math.nan] * len(self.floats)
        # empty ones at the end need not be there
        cells += [""] * (known.n_columns - len(cells))
        values = [number(cells[i]) for i in self.floats]
        for i, value in zip(self.floats, values, strict=True):
            if not self.mend and not math.isfinite(value):
                raise LogError(
                    f"{where} {known.column(i)[:60]} is {cells[i][:60]!r}; accepted: a finite "
                    "number, or bad, to say what becomes of such rows"
                )
        return [value if math.isfinite(value) else math.nan for value in values]

    def _exact(self, found: list[tuple[int, str]], clock: int) -> NDArray[np.int64]:
        """Time stamps that are whole numbers or dates."""
        rows = [self.layout.split(row) if self.layout.even(row) else [] for _, row in found]
        cells = [row[clock] if clock < len(row) else "" for row in rows]
        if self.stamps == "date":
            stamps = dates(cells)
        else:
            whole = [int(c) if c.isascii() and c.isdigit() and len(c) < 20 else -1 for c in cells]
            stamps = np.array([w if 0 <= w < 2**63 else NO_STAMP for w in whole], dtype=np.int64)
        bad = stamps == NO_STAMP
        if bad.any() and not self.mend:
            k = int(np.argmax(bad))
            kind = "a date" if self.stamps == "date" else "a whole number"
            raise LogError(
                f"{self.layout.name} line {found[k][0]}: {self.layout.column(clock)[:60]} is "
                f"{cells[k][:60]!r}; accepted: {kind}, as in the first row, or bad, to say what "
                "becomes of such rows"
            )
        return stamps


def dates(cells: Sequence[str]) -> NDArray[np.int64]:
    """ISO 8601 dates and times as ns from 1970, UTC; what is none is NO_STAMP.

    Times without a zone are taken as they stand.
    """
    found = np.array([_date(cell) for cell in cells], dtype="datetime64[ns]")
    return found.view(np.int64)


def _date(cell: str) -> np.datetime64:
    zone = _ZONE.fullmatch(cell.strip())
    if zone is None:
        return np.datetime64("NaT", "ns")
    minutes = 60 * int(zone["hours"] or 0) + int(zone["minutes"] or 0)
    ahead = np.timedelta64(-minutes if zone["sign"] == "-" else minutes, "m")
    try:
        return np.datetime64(zone["local"], "ns") - ahead
    except ValueError:
        return np.datetime64("NaT", "ns")
