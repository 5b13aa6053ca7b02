"""Text tables: their first lines, then their rows, which pandas parses."""

from __future__ import annotations

import csv
import gzip
import io
import math
import re
import sys
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice, zip_longest
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.gyro import columns as names
from fastatt.gyro import stamps
from fastatt.gyro.log import GyroLogError
from fastatt.gyro.tables import Table, numbers

_HEAD = 1000  # lines within which the numbers must begin
_LONGEST = 10_000_000  # letters of a line
# the first bytes of files that are no text
_OTHER_FILES = {
    b"PK\3\4": "a ZIP archive; accepted: the table in it, unpacked",
    b"ULog": "PX4's ULog; accepted: its tables, which ulog2csv writes",
    b"\xa3\x95": "ArduPilot's DataFlash; accepted: its tables, which mavlogdump.py writes",
    b"\xff\xfe": "UTF-16 text; accepted: text in UTF-8",
    b"\xfe\xff": "UTF-16 text; accepted: text in UTF-8",
}
_RATE = re.compile(
    r"((gyro\w*|imu)[ _])?((sample|update)[ _]?rate|sampling[ _]?(rate|frequency))"
    r"([ _]*[(\[]hz[)\]])?[\s:=,;\"']+(?P<rate>\d+(\.\d*)?(e[+-]?\d+)?)\s*(hz)?(?!\s*[\w.,])",
    re.IGNORECASE,
)
# of Gyroflow: factors of its columns, and the units that these give
_SCALES = {"tscale": "s", "gscale": "rad/s", "ascale": "g"}
_COMMENTS = ("#", "//", "%")
# at the begin of a cell; a sign inside a number is damage
_COMMENT = re.compile(r"(?:(?<! ) +|(?<![^\s,;]))(#|//|%)[^\n]*")
_QUOTED = re.compile(r'"[^"]*"')
_QUOTE = re.compile(r'(?<![^\s,;#])"|"(?![^\s,;"])')  # at the begin or the end of a cell


def from_text(source: Any, rows: Iterable[tuple[str | int, str]] = ()) -> Table:
    """The table of a path, of standard input, "-", or of an open file; from gzip too.

    ``rows`` are columns, and the text that rows have there.
    """
    name, file = _opened(source)
    chosen = {int(column) - 1: text for column, text in rows if str(column).isdecimal()}
    with file:
        try:
            return _table(name, file, chosen)
        except GyroLogError as error:
            raise GyroLogError(f"{name}: {error}") from None


def _opened(source: Any) -> tuple[str, BinaryIO]:
    """A name, and a file in which one can go back."""
    if isinstance(source, (str, PathLike)) and source != "-" and "\0" not in str(source):
        if Path(source).is_dir():
            raise GyroLogError(f"source: found the directory {source}; accepted: a file")
        file: BinaryIO = Path(source).open("rb")  # noqa: SIM115
        return str(source), file if file.seekable() else io.BytesIO(file.read())
    name = str(getattr(source, "name", "the file"))
    if isinstance(source, str) and source == "-":
        name, source = "standard input", sys.stdin
    if not hasattr(source, "read"):
        raise TypeError(
            f'source: found {checks.brief(source)}; accepted: a file\'s name, "-", an open file, a '
            "data frame or a data set"
        )
    data = getattr(source, "buffer", source).read()
    return name, io.BytesIO(data.encode() if isinstance(data, str) else data)


def _table(name: str, file: BinaryIO, chosen: Mapping[int, str]) -> Table:
    """The table of a text: its first lines, then its rows, which have the chosen texts."""
    file = _text_of(file)
    head: dict[int, list[str]] = {}
    comments: list[str] = []
    rates: list[float] = []
    # before the chosen rows there may be many others
    for first, row in enumerate(islice(_lines(file), None if chosen else _HEAD), 1):
        if damage := _damage(row):
            raise GyroLogError(f"line {first}: {damage}")
        note = row.lstrip("#/% ")
        if match := _RATE.match(note.lstrip('"')):
            rates.append(float(match["rate"]))
        if not row.strip() or row.lstrip('" ').startswith(_COMMENTS):
            comments.append(note)
            continue
        layout = _layout(row)
        cells = [cell.strip() for cell in layout.clean(row).split(layout.delimiter)]
        if _fits(cells, chosen) and _numbers(cells):
            break
        head[first] = _names(row)
    else:
        what = "found no row of numbers" + "".join(f" with {text!r}" for text in chosen.values())
        raise GyroLogError(f"{what}; accepted: a table with three rate columns")
    header = _header([*head.values()], comments, chosen)
    why = f"line {first} is the first row"
    if head:
        why = f"line {max(head)} has {len(header)} names, the rows have {len(cells)}"
    # the line of names, those of numbers, or both may end with a separator
    if len(header) != len(cells) and (_used(header) != _used(cells) or not header):
        header = []
    arrays, places, wrong = _rows(layout, file, first, cells, chosen)
    scales = {c[0][0]: stamps.number(c[1]) for c in head.values() if c[0] in _SCALES and c[1:]}
    for i, column in enumerate(header):
        if column[:1] in scales and re.fullmatch("t|[ga][xyz]", column):
            header[i] = f"{column} [{_SCALES[f'{column[0]}scale']}]"
            arrays[i] = scales[column[0]] * numbers(arrays[i], "float")
            cells[i] = "0"  # no whole number
    return Table(
        name=name, names=header, arrays=arrays, first_row=cells, places=places, row="line",
        rates=tuple(dict.fromkeys(rates)), damage=wrong, unnamed=f" ({why})",
    )  # fmt: skip


def _header(head: list[list[str]], comments: list[str], chosen: Mapping[int, str]) -> list[str]:
    """Names of columns: in the line before the numbers, over units there, or else in a comment."""
    for cells in head:
        if cells[0] == "FMT" and chosen.get(0) in cells[3:4]:  # of DataFlash, for a kind of rows
            return ["kind", *cells[5:]]
    over, last = [[], [], *head][-2:]
    if names.triples(over, "gyro") and any(map(names.is_unit, last)):
        units = [unit and f" [{unit.strip('[()]')}]" for unit in last]
        return ["".join(parts) for parts in zip_longest(over, units, fillvalue="")]
    of_comments = [cells for c in comments if names.triples(cells := _names(c), "gyro")]
    return last or [[], *of_comments][-1]


def _fits(cells: Sequence[str], chosen: Mapping[int, str]) -> bool:
    """Whether a row has the chosen texts."""
    return all(cells[i : i + 1] == [text] for i, text in chosen.items())


def _text_of(file: BinaryIO) -> BinaryIO:
    """The file, or what it has in gzip."""
    begin = file.read(8)
    file.seek(0)
    if begin[:2] == b"\x1f\x8b":
        try:
            return _text_of(io.BytesIO(gzip.decompress(file.read())))
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise GyroLogError(f"found damaged gzip data ({error}); accepted: whole") from None
    if len(begin) == 8 and any(begin[::2]) != any(begin[1::2]):
        begin = b"\xff\xfe"  # every other byte is 0
    for mark, kind in _OTHER_FILES.items():
        if begin.startswith(mark):
            raise GyroLogError(f"found {kind}")
    return file


def _lines(file: BinaryIO) -> Iterator[str]:
    """The lines of a text."""
    file.seek(0)
    text = io.TextIOWrapper(file, "utf-8-sig", "replace")
    try:
        for line in text:
            yield line.rstrip("\n")
    finally:
        text.detach()


def _damage(line: str) -> str:
    """What makes a line none of a table; "" for nothing."""
    if len(line) > _LONGEST:
        return f"found {len(line)} letters; accepted: {_LONGEST} at most"
    if "\0" in line or "\ufffd" in line:
        return "found bytes that are no text in UTF-8 (it may be Latin-1, or damaged)"
    return ""


def _rows(
    layout: _Layout, file: BinaryIO, first: int, cells: list[str], chosen: Mapping[int, str]
) -> tuple[list[NDArray[Any]], NDArray[np.int64], dict[int, str]]:
    """Columns, the lines of rows, and what is wrong with those that are left empty."""
    if columns := _plain(layout, file, first, cells):
        return columns, np.arange(first, first + len(columns[0])), {}
    mark, n_columns, n_used = layout.delimiter, len(cells), _used(cells)
    rows: dict[int, str] = {}
    wrong: dict[int, str] = {}
    for place, text in islice(enumerate(_lines(file), 1), first - 1, None):
        line = layout.clean(text)
        if not line.strip():
            continue
        if chosen and not _fits([cell.strip() for cell in line.split(mark)], chosen):
            continue
        damage, row = _damage(line), line
        if damage or line.count(mark) != n_columns - 1:
            parts = line.split(mark)
            if not damage and _used([cell.strip() for cell in parts]) != n_used:
                damage = f"found {len(parts)} columns; accepted: {n_columns}, as in the first row"
            if damage:
                wrong[place], parts = damage, []
            row = mark.join([*parts, *[""] * n_columns][:n_columns])
        rows[place] = row
    cleaned = io.BytesIO("\n".join(rows.values()).encode())
    return _parsed(cleaned, mark, n_columns, low_memory=False), np.array([*rows]), wrong


def _plain(layout: _Layout, file: BinaryIO, first: int, cells: list[str]) -> list[NDArray[Any]]:
    """Columns as pandas parses the lines from the first row on; [] if it would misread some."""
    file.seek(0)
    for block in iter(lambda: file.read(1 << 18) + file.readline(), b""):
        # some releases of pandas read numbers up to a NUL, and skip another number of lines
        if b"\0" in block or (b"\r" in block and b"\r" in block.replace(b"\r\n", b"")):
            return []
    file.seek(0)
    # pandas parses a file that it opens itself in less time
    source = file if isinstance(file, io.BytesIO) else Path(file.name).absolute()
    separator = r"\s+" if layout.delimiter == " " else layout.delimiter
    warning = stamps.pandas().errors.DtypeWarning
    try:
        with warnings.catch_warnings(action="error", category=warning):
            columns = _parsed(
                source, separator, len(cells), first - 1, decimal=layout.decimal, low_memory=True
            )
    except (ValueError, warning):  # also of rows that are longer than the first
        return []
    texts = {i: x.tolist() for i, x in enumerate(columns) if x.dtype.kind not in "iuf"}
    marks = '\0"#%/\ufffd' + ",." * (layout.decimal == ",")
    if any(
        mark in text for x in texts.values() for text in [" ".join(map(str, x))] for mark in marks
    ):
        return []
    # shorter rows end with empty text
    ends = [set(texts.get(i, ())) for i in range(_used(cells) - 1, len(cells))]
    return columns if "" not in ends[0] and all(end == {""} for end in ends[1:]) else []


def _parsed(
    source: BinaryIO | Path, separator: str, n: int, skipped: int = 0, **more: Any
) -> list[NDArray[Any]]:
    """Columns as pandas parses them, exactly."""
    pandas = stamps.pandas()
    is_exact = tuple(map(int, pandas.__version__.split(".")[:2])) >= (3, 1)
    exact = {} if is_exact else {"float_precision": "round_trip"}  # which is deprecated there
    table = pandas.read_csv(
        source, sep=separator, header=None, names=range(n), skiprows=skipped, na_filter=False,
        quoting=csv.QUOTE_NONE, skip_blank_lines=False, compression=None, **more, **exact,
    )  # fmt: skip
    return [table[i].to_numpy() for i in table]


class _Layout(NamedTuple):
    """The separator of columns (" ": any blanks), and the decimal sign."""

    delimiter: str
    decimal: str

    def clean(self, text: str) -> str:
        """A line without comments and quotes, with decimal points and one kind of separator.

        A quotation mark inside a number stays, so that its row is not read.
        """
        if '"' in text:
            text = _QUOTE.sub("", text)
        if "#" in text or "%" in text or "//" in text:
            text = _COMMENT.sub("", text)
        if self.decimal == ",":
            text = text.replace(",", ".")
        return " ".join(text.split()) if self.delimiter == " " else text


def _layout(line: str) -> _Layout:
    row = _COMMENT.sub("", line)
    decimal = "." if re.search(r"\d\.\d", row) else ","
    if ";" in row:
        return _Layout(";", decimal)
    if "\t" in row and (re.search(r"\d,\d", row) or "," not in row):
        return _Layout("\t", decimal)
    return _Layout("," if "," in row else " ", ".")


def _numbers(cells: Iterable[str]) -> bool:
    """Whether a line consists of numbers, or has as many of them as a gyro has."""
    used = [cell for cell in cells if cell]
    words = sum(cell.lower() in ("nan", "-nan") for cell in used)
    count = words + sum(not math.isnan(stamps.number(cell)) for cell in used)
    return count >= 3 or 0 < count == len(used)


def _names(text: str) -> list[str]:
    separator = next((d for d in (";", "\t", ",") if d in _QUOTED.sub("", text)), None)
    if separator:  # one in quotes is part of a name
        text = _QUOTED.sub(lambda match: match[0].replace(str(separator), "\0"), text)
    text = _QUOTE.sub("", text)
    # a unit in brackets after a blank belongs to the name before it
    if separator is None:
        parts = re.split(r"\s+(?![\[(])", text)
    else:
        parts = [part.strip().replace("\0", separator) for part in text.split(separator)]
    return [names.printable(part) for part in parts] if text else []


def _used(cells: Sequence[str]) -> int:
    """The number of columns before empty ones at the end."""
    return max((i for i, cell in enumerate(cells, start=1) if cell), default=0)
