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
from fastatt.gyro.log import GyroLogError, GyroLogWarning
from fastatt.rounding import warn

Cells = NDArray[Any]
# columns that tell kinds of rows, or sensors, apart
_TELLS = re.compile(
    r"(.*[./])?((sensor|device|message|msg|topic)?[ _]?(name|type|kind|id|mac|address)"
    r"|sensor|device|message|msg|topic|source|instance|imu|i)",
    re.IGNORECASE,
)
# those of devices, which do so if they change often
_DEVICE = re.compile(
    r"(.*[./ _\-]|[a-z]*(?=I[dD]))?(id|addr(ess)?|mac|serial|node|ch(annel|an)?|board|port|bus|body"
    r"|unit|side|leg|index|idx|dev(ice)?|sensor|imu|module|source|src|topic|tag|num(ber)?|no|nr)"
    r"([ _.\-]?(id|no|nr|num(ber)?|name|address|idx|index))?\d*",
    re.IGNORECASE,
)
_TIME_OF_DAY = re.compile(r"\d\d?:\d\d(:\d\d([.,]\d+)?)?|\d{1,4}([-/.])\d{1,2}\3\d{1,4}.*")
_KINDS = 64  # that one column tells apart at most
_FEW = 8  # of numbers without a name that says so
_OFTEN = 0.05  # share of rows at which values that change more often tell rows apart
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
    damage: dict[int, str] = field(default_factory=dict)  # of lines that are no rows
    unnamed: str = ""  # why names are not known
    keep: Any = ...  # which rows are read

    def read(
        self,
        wanted: Mapping[str, list[int]],
        clock: stamps.Clock,
        chosen: list[tuple[int, str]] | None,
        *,
        strict: bool,
    ) -> tuple[dict[str, NDArray[np.float64]], NDArray[Any] | None]:
        """Groups of columns, each (n, k), NaN for cells without a number, and the time stamps.

        ``chosen`` are columns, and the text that rows have there; None reads all rows if no column
        tells them apart, [] all. ``strict`` refuses a row without a stamp, or without a number in
        the group "gyro".
        """
        keep: Any = slice(None)
        if chosen:
            keep = np.all([_texts(self.arrays[i]) == text for i, text in chosen], axis=0)
        self.places = self.places[keep]
        if not self.places.size:
            row = f"rows: found no row with {chosen[0][1]!r}" if chosen else "found no sample"
            raise GyroLogError(f"{row}; accepted: one at least")
        self.keep = keep
        times = self._cells(clock)
        stamps_of_rows = stamps.joined(times)
        if chosen != []:
            used = {i for group in wanted.values() for i in group}
            self._refuse_kinds(used | {*clock.columns, *dict(chosen or ())}, keep, stamps_of_rows)
        values = {
            name: np.stack(
                [numbers(self.arrays[i][keep], "float") for i in group], 1, dtype=np.float64
            )
            for name, group in wanted.items()
            if group
        }
        bad = [np.isnan(values["gyro"]), *(~stamps.valid(x)[:, None] for x in times)]
        if strict and any(x.any() for x in bad):
            row, k = np.argwhere(np.hstack(bad))[0]
            i, how = [*wanted["gyro"], *clock.columns][k], [*["float"] * 3, *clock.formats][k]
            raise GyroLogError(self._wrong(self.places[row], i, how, self.arrays[i][keep][row]))
        return values, stamps_of_rows

    def stamps_in(self, clock: stamps.Clock) -> Cells:
        """The time stamps of the rows that were read."""
        return np.asarray(stamps.joined(self._cells(clock)))

    def _cells(self, clock: stamps.Clock) -> list[Cells]:
        cells = zip(clock.columns, clock.formats, strict=True)
        times = [numbers(self.arrays[i][self.keep], how) for i, how in cells]
        for i, part in enumerate(times[1:], 1):  # of nanoseconds
            times[i] = np.where((part < 0) | (part >= 10**9), stamps.NO_STAMP, part)
        return times

    def _wrong(self, place: int, i: int, how: str, cell: object) -> str:
        """What is wrong with a cell."""
        if place in self.damage:
            return f"{self.row} {place}: {self.damage[place]}"
        return (
            f"{self.row} {place}: {self.column(i)[:60]} is {str(cell).strip()!r:.60}; accepted: "
            f'{_MEANT[how]}, or on_bad_rows="drop"'
        )

    def _refuse_kinds(self, used: set[int], keep: Any, s: NDArray[Any] | None) -> None:
        """Refuse rows of several kinds or sensors, with the column that tells them apart.

        It is known by its name, has text that is no time, or its values have a clock each, ``s``
        being the time stamps of all rows. Of another column of few values that change often is
        warned.
        """
        for i in set(range(len(self.arrays))) - used - self._axes():
            name = names.bare(self.column(i))[0]
            cells = self.arrays[i][keep]
            if len(_few(cells[:10_000])) > _KINDS:
                continue
            cells = _texts(cells)
            rows = np.flatnonzero(cells != "")
            written = cells[rows]
            values = _few(written)
            changes = np.flatnonzero(written[1:] != written[:-1])
            often = len(changes) > _OFTEN * len(written)
            if not 1 < len(values) <= min(_KINDS, len(written) // 2):
                continue
            is_text = any(map(_is_word, values))
            tells = _TELLS.fullmatch(name) or (often and (is_text or _DEVICE.fullmatch(name)))
            if not tells and not often:
                continue
            label = self.column(i)[:60] if i < len(self.names) and self.names[i] else i + 1
            pair = f"rows=({label!r}, {values[0][:60]!r})"
            if tells or (s is not None and _has_clocks(s[rows], written, changes)):
                raise GyroLogError(
                    f"{self.column(i)[:60]} tells rows of several kinds or sensors apart: "
                    f"{names.listed(values)}; accepted: {pair}, for one of them, or rows=(), for "
                    "all"
                )
            if len(values) <= _FEW and all(value.isdecimal() for value in values):
                warn(
                    f"{self.name}: {self.column(i)[:60]} changes in {len(changes)} rows between "
                    f"{names.listed(values)}; if it tells sensors apart, pass {pair}; if not, "
                    "rows=()",
                    GyroLogWarning,
                )

    def _axes(self) -> set[int]:
        """Columns of sensors with three axes."""
        kinds = ("gyro", "accel", "mag", "like accel", "like mag")
        return {i for kind in kinds for axes in names.triples(self.names, kind) for i in axes}

    def place(self, row: int) -> str:
        """The position of a row, for a message."""
        return f"{self.row} {self.places[row]}"

    def shown(self) -> str:
        """The columns, for a message."""
        return (
            names.listed(self.names)
            or f"{len(self.arrays)} columns without a name each{self.unnamed}"
        )

    def column(self, i: int) -> str:
        """The name of a column, or its number from 1."""
        return (i < len(self.names) and self.names[i]) or f"column {i + 1}"

    def index(self, column: object, argument: str) -> int:
        """The index of a column from its name or its number from 1."""
        text = names.printable(column)
        for known in (self.names, [names.bare(name)[0].strip() for name in self.names]):
            if known.count(text) == 1:
                return known.index(text)
        if text in self.names:
            raise GyroLogError(f"{argument}: found {text[:60]!r} twice; {self.by_number()}")
        if text.isdecimal() and len(text) < 9 and 1 <= int(text) <= len(self.arrays):
            return int(text) - 1
        raise GyroLogError(
            f"{argument}: found {text[:60]!r}; accepted: {self.shown()}, or a number from 1 to "
            f"{len(self.arrays)}"
        )

    def by_number(self) -> str:
        """What is accepted of columns that a name does not tell apart."""
        most = len(self.arrays)
        return f"accepted: names that occur once, or columns= and time_column= from 1 to {most}"

    def chosen(self, columns: Sequence[str], n: int, argument: str) -> list[int]:
        """The indices of n columns."""
        several = columns if isinstance(columns, (list, tuple)) else []
        indices = [self.index(c, argument) for c in several]
        if len(set(indices)) != n or len(indices) != n:
            raise GyroLogError(
                f"{argument}: found {checks.brief(columns)}; accepted: {n} different columns"
            )
        return indices


def in_memory(source: Any) -> Table:
    """The table of a data frame, a data set of xarray, or a mapping of names to arrays."""
    name = type(source).__name__
    columns: list[tuple[str, Cells]] = []
    for key, column in _columns(source):
        label = ".".join(map(str, key)) if isinstance(key, tuple) else str(key)
        array = _array(column)
        unit = getattr(column, "attrs", {}).get("units")  # of xarray
        is_known = array.dtype.kind in "mM" or names.bare(label)[1]
        said = f" [{unit.split(' since ')[0]}]" if isinstance(unit, str) and not is_known else ""
        if array.ndim == 2 and array.shape[1] == 3:  # axes along the second dimension
            columns += [(f"{label}.{a}{said}", x) for a, x in zip("xyz", array.T, strict=True)]
        elif array.ndim == 1:
            columns.append((label + said, array))
    lengths = {len(x) for _, x in columns}
    if len(lengths) != 1 or 0 in lengths:
        raise GyroLogError(
            f"{name}: found columns of lengths {sorted(lengths)}; accepted: one length"
        )
    arrays = [x for _, x in columns]
    return Table(
        name=name,
        names=[names.printable(n) for n, _ in columns],
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
    if hasattr(source, "iloc"):  # names may occur twice
        yield from ((key, source.iloc[:, i]) for i, key in enumerate(source.columns))
        return
    keys = list(source.columns if hasattr(source, "columns") else source)
    for key in [*getattr(source, "coords", ()), *keys]:
        yield key, source[key]


def _array(column: Any) -> NDArray[Any]:
    """An array without a mask: masked values become NaN."""
    array = np.asarray(column)
    if np.ma.is_masked(column) and array.dtype.kind in "fiumM":
        array = array.astype(np.float64) if array.dtype.kind in "iu" else array.copy()
        array[np.ma.getmaskarray(column)] = "NaT" if array.dtype.kind in "mM" else np.nan
    return array


def numbers(array: Cells, how: stamps.Kind) -> Cells:
    """Numbers, NaN for what is not real or finite; whole ones, dates and durations as int64."""
    kind = array.dtype.kind
    if kind in "mM":
        return array.astype(f"{kind}8[ns]").view(np.int64)
    if kind == "i" or (kind == "u" and (not array.size or array.max() < 2**63)):
        return array.astype(np.int64, copy=False)
    if how != "float":
        return stamps.from_text(how, _texts(array).tolist())
    if kind in "OUST":
        array = np.fromiter(map(stamps.number, array.tolist()), np.float64)
    elif kind not in "uf":
        array = np.full(array.shape, np.nan)
    array = array.astype(np.float64, copy=False)
    return array if np.isfinite(array).all() else np.where(np.isfinite(array), array, np.nan)


def _texts(array: Cells) -> Cells:
    """Cells as text without blanks around it, empty for what is missing."""
    return np.array([_text(x) for x in array.tolist()], dtype=object)


def _few(cells: Cells) -> list[str]:
    """Different cells, sorted, as text."""
    return sorted({_text(cell) for cell in cells.tolist()} - {""})


def _is_word(text: str) -> bool:
    return np.isnan(stamps.number(text)) and not _TIME_OF_DAY.fullmatch(text)


def _has_clocks(s: Cells, cells: Cells, changes: NDArray[np.int64]) -> bool:
    """Whether the time stamps of each value are those of a clock, and all together are not.

    These repeat or go back where the value changes, or their intervals vary more.
    """
    s = np.where(stamps.valid(s), s - s[0], np.nan).astype(np.float64)
    steps = np.diff(s)
    if np.mean(steps[changes] <= 0.0) > 0.5:
        return True
    each = [np.diff(s[cells == value]) for value in set(cells.tolist())]
    spreads = [_spread(x, np.nanmedian(x)) for x in each if len(x) > 3]
    if not spreads:
        return False
    usual = min(np.nanmedian(x) for x in each if len(x) > 3)
    return bool(max(spreads) < 0.5 * _spread(steps, usual) and _spread(steps, usual) > 0.1)


def _spread(steps: Cells, usual: float) -> float:
    """The range of the middle 80 % of intervals, in usual ones."""
    low, high = np.nanquantile(steps, (0.1, 0.9))
    return float((high - low) / usual)


def _text(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell:g}" if cell == cell else ""  # noqa: PLR0124
    return str(cell).strip()
