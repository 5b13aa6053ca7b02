"""Tables as columns, and those of data frames, data sets and mappings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.gyro import columns as names
from fastatt.gyro import stamps
from fastatt.gyro.log import GyroLogError

Cells = NDArray[Any]
# columns that tell kinds of rows, or sensors, apart
_TELLS = re.compile(
    r"(.*[./])?((sensor|device|message|msg|topic)?[ _]?(name|type|kind|id|mac|address)"
    r"|sensor|device|message|msg|topic|source|instance|imu|i)",
    re.IGNORECASE,
)
_WORD = re.compile(r"(?!(nan|inf|nat|none|null|true|false)$)[^\W\d].*", re.IGNORECASE)
_KINDS = 64  # that one column tells apart at most
_OFTEN = 0.05  # share of rows at which another text that changes more often tells rows apart
_MEANT = {"float": "a finite number", "int": "a whole number", "date": "a date"}


@dataclass
class Table:
    """A table, and the information in the lines before its numbers."""

    name: str  # of the file, for messages
    names: list[str]  # of the columns; empty if they are not known
    arrays: Sequence[Cells]  # columns
    first_row: Sequence[str]
    places: NDArray[np.int64]  # of the rows
    row: str = "row"  # what a place is called
    rates: tuple[float, ...] = ()  # sample rates in lines before the numbers, Hz
    lengths: dict[int, int] = field(default_factory=dict)  # of lines of another length
    keep: Any = ...  # which rows are read

    def read(
        self,
        wanted: Mapping[str, list[int]],
        clock: list[int],
        chosen: list[tuple[int, str]] | None,
        *,
        strict: bool,
    ) -> tuple[dict[str, NDArray[np.float64]], NDArray[Any] | None]:
        """Groups of columns, each (n, k), NaN for cells without a number, and the time stamps.

        ``chosen`` are columns, and the text that rows have there; None reads all rows if no column
        tells them apart, [] all. ``strict`` refuses a row without a stamp, or without a number in
        the group "gyro".
        """
        keep = np.ones(len(self.places), dtype=bool)
        for i, text in chosen or ():
            keep &= _texts(self.arrays[i]) == text
        self.places = self.places[keep]
        if not self.places.size:
            row = f"rows: found no row with {chosen[0][1]!r}" if chosen else "found no sample"
            raise self.error(f"{row}; accepted: one at least")
        if chosen != []:
            used = {i for group in wanted.values() for i in group} | {*clock, *dict(chosen or ())}
            self._refuse_kinds(used, keep)
        values = {
            name: np.column_stack([_numbers(self.arrays[i][keep], "float") for i in group])
            for name, group in wanted.items()
            if group
        }
        self.keep = keep
        hows = self._formats(clock)
        times = [_numbers(self.arrays[i][keep], how) for i, how in zip(clock, hows, strict=True)]
        bad = np.column_stack([np.isnan(values["gyro"]), *(~stamps.valid(x) for x in times)])
        if strict and bad.any():
            row, k = np.argwhere(bad)[0]
            i, how = [*wanted["gyro"], *clock][k], [*["float"] * 3, *hows][k]
            raise self.error(self._wrong(self.places[row], i, how, self.arrays[i][keep][row]))
        return {name: x.astype(np.float64) for name, x in values.items()}, stamps.joined(times)

    def stamps_in(self, clock: list[int]) -> NDArray[Any] | None:
        """The time stamps of the rows that were read; None for no column."""
        cells = zip(clock, self._formats(clock), strict=True)
        return stamps.joined([_numbers(self.arrays[i][self.keep], how) for i, how in cells])

    def _formats(self, clock: list[int]) -> list[stamps.Kind]:
        if len(clock) > 1:
            return ["int"] * len(clock)
        return [stamps.kind(self.first_row[i]) for i in clock]

    def _wrong(self, place: int, i: int, how: str, cell: object) -> str:
        """What is wrong with a cell."""
        if place in self.lengths:
            return (
                f"{self.row} {place}: found {self.lengths[place]} columns; accepted: "
                f"{len(self.arrays)}, as in the first row"
            )
        return (
            f"{self.row} {place}: {self.column(i)[:60]} is {str(cell)!r:.60}; accepted: "
            f'{_MEANT[how]}, or on_bad_rows="drop"'
        )

    def _refuse_kinds(self, used: set[int], keep: NDArray[np.bool_]) -> None:
        """Refuse rows of several kinds or sensors, with the column that tells them apart.

        It is known by its name, or has text that is no time.
        """
        for i in range(len(self.arrays)):
            name = self.column(i)
            tells = _TELLS.fullmatch(names.bare(name)[0]) is not None
            if i in used or not (tells or _WORD.fullmatch(self.first_row[i])):
                continue
            cells = _texts(self.arrays[i][keep])
            written = cells[cells != ""]
            kinds = sorted(set(written.tolist()))
            often = np.count_nonzero(written[1:] != written[:-1]) > _OFTEN * len(written)
            if 1 < len(kinds) <= min(_KINDS, len(written) // 2) and (often or tells):
                name = name[:60]
                raise self.error(
                    f"{name} tells rows of several kinds or sensors apart: {names.listed(kinds)}; "
                    f"accepted: rows=({name!r}, {kinds[0][:60]!r}), for one of them, or rows=(), "
                    "for all"
                )

    def place(self, row: int) -> str:
        """The position of a row, for a message."""
        return f"{self.row} {self.places[row]}"

    def error(self, text: object) -> GyroLogError:
        """An error that names the table."""
        return GyroLogError(f"{self.name}: {text}")

    def shown(self) -> str:
        """The columns, for a message."""
        return names.listed(self.names) or f"{len(self.arrays)} columns without a name each"

    def column(self, i: int) -> str:
        """The name of a column, or its number from 1."""
        return (i < len(self.names) and self.names[i]) or f"column {i + 1}"

    def index(self, column: object, argument: str) -> int:
        """The index of a column from its name or its number from 1."""
        text = names.printable(column)
        if self.names.count(text) == 1:
            return self.names.index(text)
        if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= len(self.arrays):
            return int(text) - 1
        raise GyroLogError(
            f"{argument}: found {text[:60]!r}; accepted: {self.shown()}, or a number from 1 to "
            f"{len(self.arrays)}"
        )

    def chosen(self, columns: Sequence[str], n: int, argument: str) -> list[int]:
        """The indices of n columns."""
        given = columns if isinstance(columns, (list, tuple)) else []
        found = [self.index(c, argument) for c in given]
        if len(set(found)) != n or len(found) != n:
            raise GyroLogError(
                f"{argument}: found {checks.brief(columns)}; accepted: {n} different columns"
            )
        return found


def in_memory(source: Any) -> Table:
    """The table of a data frame, a data set of xarray, or a mapping of names to arrays."""
    name = type(source).__name__
    columns: dict[str, Cells] = {}
    for key, found in _columns(source):
        label = ".".join(map(str, key)) if isinstance(key, tuple) else str(key)
        array = _array(found)
        if array.ndim == 2 and array.shape[1] == 3:  # axes along the second dimension
            columns |= {f"{label}.{a}": x for a, x in zip("xyz", array.T, strict=True)}
        elif array.ndim == 1:
            columns[label] = array
    lengths = {len(x) for x in columns.values()}
    if len(lengths) != 1 or 0 in lengths:
        raise GyroLogError(
            f"{name}: found columns of lengths {sorted(lengths)}; accepted: one length"
        )
    arrays = list(columns.values())
    return Table(
        name=name,
        names=[names.printable(n) for n in columns],
        arrays=arrays,
        # dates and durations of an array, in ns
        first_row=[stamps.DATE if x.dtype.kind in "mM" else str(x[0]) for x in arrays],
        places=np.arange(*lengths),
    )


def tabular(source: Any) -> bool:
    """Whether a source is a table in memory."""
    return isinstance(source, Mapping) or hasattr(source, "columns")


def _columns(source: Any) -> Iterator[tuple[Any, Any]]:
    index = getattr(source, "index", None)
    if hasattr(source, "columns") and index is not None and not callable(index):
        kind = getattr(getattr(index, "dtype", None), "kind", "")
        if index.name is not None or kind in "mM":
            yield index.name or "time", index
    keys = list(source.columns if hasattr(source, "columns") else source)
    for key in [*getattr(source, "coords", ()), *keys]:
        yield key, source[key]


def _array(found: Any) -> NDArray[Any]:
    """An array without a mask: masked values become NaN."""
    array = np.asarray(found)
    if np.ma.is_masked(found) and array.dtype.kind in "fiumM":
        array = array.astype(np.float64) if array.dtype.kind in "iu" else array.copy()
        array[np.ma.getmaskarray(found)] = "NaT" if array.dtype.kind in "mM" else np.nan
    return array


def _numbers(array: Cells, how: stamps.Kind) -> Cells:
    """Numbers, NaN for what is not real or finite; whole ones, dates and durations as int64."""
    kind = array.dtype.kind
    if kind in "mM":
        return array.astype(f"{kind}8[ns]").view(np.int64)
    if kind in "iu" and (not array.size or int(np.abs(array).max()) < 2**63):
        return array.astype(np.int64)
    if how != "float":
        return stamps.from_text(how, _texts(array).tolist())
    if kind in "OUST":
        array = np.fromiter(map(stamps.number, array.tolist()), np.float64)
    elif kind not in "uf":
        array = np.full(array.shape, np.nan)
    return np.where(np.isfinite(array), array, np.nan).astype(np.float64)


def _texts(array: Cells) -> Cells:
    """Cells as text without blanks around it, empty for what is missing."""
    return np.array([_text(x) for x in array.tolist()], dtype=object)


def _text(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell:g}" if cell == cell else ""  # noqa: PLR0124
    return str(cell).strip()
