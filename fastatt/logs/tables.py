"""Tables as columns, and tables in memory: data frames, data sets, mappings."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.logs import names, stamps
from fastatt.logs.names import GyroLogError

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
_MEANT = {
    "float": "a finite number", "int": "a whole number", "date": "a date", "day": "a time of day",
}  # fmt: skip


@dataclass
class Table:
    """A table before its rows are read: its columns, and the information in its first lines."""

    name: str  # of the file, for messages
    names: list[str]  # of the columns; empty if they are not known
    n_columns: int
    rates: tuple[float, ...] = ()  # sample rates in lines before the numbers, Hz
    n_names: int = 0
    first_row: Sequence[str] = field(default_factory=list)
    row: str = "row"  # what a place is called
    places: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def blocks(self) -> Iterator[tuple[NDArray[np.int64], Sequence[Cells]]]:
        """Rows of the table in order: their places, and the cells of each column."""
        raise NotImplementedError

    def read(
        self,
        wanted: list[int],
        clock: list[int],
        chosen: list[tuple[int, str]] | None,
        *,
        strict: bool,
    ) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
        """Wanted columns (n, k), NaN for cells without a number, and the time stamps.

        ``chosen`` are columns, and the text that rows have there; None reads all rows if no column
        tells them apart, [] all. ``strict`` refuses a row without a stamp, or without one of the
        first three numbers, which are rates.
        """
        used = [*wanted, *clock]
        hows: list[stamps.Kind] = ["float"] * len(wanted)
        hows += ["int" if len(clock) > 1 else stamps.kind(self.first_row[i]) for i in clock]
        needed = [*range(3), *range(len(wanted), len(used))]
        apart = [] if chosen == [] else self._apart({*used, *dict(chosen or ())})
        parts: list[list[Any]] = []
        kinds: list[list[Cells]] = []
        wrong = None
        for places, cells in self.blocks():
            keep = np.ones(len(places), dtype=bool)
            for i, text in chosen or ():
                keep &= _texts(cells[i]) == text
            columns = [_numbers(cells[i][keep], how) for i, how in zip(used, hows, strict=True)]
            parts.append([places[keep], *columns])
            kinds.append([_texts(cells[i][keep]) for i in apart])
            for k in needed if wrong is None else ():
                bad = np.flatnonzero(~stamps.valid(columns[k]))[:1]
                for row in bad:
                    cell = cells[used[k]][keep][row]
                    wrong = wrong or self._wrong(places[keep][row], used[k], hows[k], cell)
        self._refuse_kinds(apart, [np.concatenate(x) for x in zip(*kinds, strict=True)])
        if strict and wrong:
            raise self.error(wrong)
        self.places, *columns = (np.concatenate(x) for x in zip(*parts, strict=True))
        if not self.places.size:
            row = f"rows: found no row with {chosen[0][1]!r}" if chosen else "found no sample"
            raise self.error(f"{row}; accepted: one at least")
        return np.stack(columns[: len(wanted)], axis=1), stamps.joined(columns[len(wanted) :])

    def _wrong(self, place: int, i: int, how: str, cell: object) -> str:
        """What is wrong with a cell."""
        return (
            f"{self.row} {place}: {self.column(i)[:60]} is {str(cell)!r:.60}; accepted: "
            f'{_MEANT[how]}, or on_bad_rows="drop", "split" or "hold"'
        )

    def _apart(self, used: set[int]) -> list[int]:
        """Columns that may tell kinds of rows apart: by their name, or of text that is no time."""
        others = [i for i in range(self.n_columns) if i not in used]
        return [i for i in others if self._tells(i) or _WORD.fullmatch(self.first_row[i])]

    def _tells(self, i: int) -> bool:
        return _TELLS.fullmatch(names.bare(self.column(i))[0]) is not None

    def _refuse_kinds(self, columns: list[int], texts: list[Cells]) -> None:
        """Refuse rows of several kinds or sensors, with the column that tells them apart."""
        for i, cells in zip(columns, texts, strict=True):
            written = cells[cells != ""]
            kinds = sorted(set(written.tolist()))
            often = np.count_nonzero(written[1:] != written[:-1]) > _OFTEN * len(written)
            if 1 < len(kinds) <= min(_KINDS, len(written) // 2) and (often or self._tells(i)):
                name = self.column(i)[:60]
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
        columns = f"{self.n_columns} columns under {self.n_names} names"
        return names.listed(self.names) if self.names else columns

    def column(self, i: int) -> str:
        """The name of a column, or its number from 1."""
        return (i < len(self.names) and self.names[i]) or f"column {i + 1}"

    def index(self, column: object, argument: str) -> int:
        """The index of a column from its name or its number from 1."""
        text = names.printable(column)
        if self.names.count(text) == 1:
            return self.names.index(text)
        if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= self.n_columns:
            return int(text) - 1
        raise GyroLogError(
            f"{argument}: found {text[:60]!r}; accepted: {self.shown()}, or a number from 1 to "
            f"{self.n_columns}"
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


class Frame(Table):
    """A data frame of pandas or polars, a data set of xarray, or a mapping of names to arrays."""

    def __init__(self, source: Any) -> None:
        name = type(source).__name__
        columns: dict[str, Cells] = {}
        for key, found in _columns(source):
            label = ".".join(map(str, key)) if isinstance(key, tuple) else str(key)
            array = _array(found)
            if array.ndim == 2 and array.shape[1] in (3, 4):  # axes along the second dimension
                axes = "xyz" if array.shape[1] == 3 else "wxyz"
                columns |= {f"{label}.{a}": x for a, x in zip(axes, array.T, strict=True)}
            elif array.ndim == 1:
                columns[label] = array
        sizes = {len(x) for x in columns.values()}
        if len(sizes) != 1 or 0 in sizes:
            raise GyroLogError(
                f"{name}: found columns of lengths {sorted(sizes)}; accepted: one length"
            )
        self.arrays = list(columns.values())
        super().__init__(
            name=name,
            names=[names.printable(n) for n in columns],
            n_columns=len(columns),
            # dates and durations of an array, in ns
            first_row=[stamps.DATE if x.dtype.kind in "mM" else str(x[0]) for x in self.arrays],
        )

    def blocks(self) -> Iterator[tuple[NDArray[np.int64], Sequence[Cells]]]:
        """Implements ``Table.blocks``."""
        yield np.arange(len(self.arrays[0])), self.arrays


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
    """An array without masks and time zones: masked values become NaN, times are in UTC."""
    array = np.asarray(found)
    if np.ma.is_masked(found) and array.dtype.kind in "fiumM":
        array = array.astype(np.float64) if array.dtype.kind in "iu" else array.copy()
        array[np.ma.getmaskarray(found)] = "NaT" if array.dtype.kind in "mM" else np.nan
    if array.dtype.kind == "O" and array.size and isinstance(array.flat[0], (datetime, timedelta)):
        kind = "datetime" if isinstance(array.flat[0], datetime) else "timedelta"
        with warnings.catch_warnings():  # NumPy warns that zones are dropped
            warnings.simplefilter("ignore", UserWarning)
            return np.asarray(found, dtype=f"{kind}64[ns]")
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
        cells = array.tolist()
        try:  # Python reads more than plain numbers: digits of other scripts, and underscores
            text = "".join(cells)
            plain = text.isascii() and "_" not in text
            array = np.fromiter(map(float if plain else stamps.number, cells), np.float64)
        except (TypeError, ValueError):
            array = np.fromiter(map(stamps.number, cells), np.float64)
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
