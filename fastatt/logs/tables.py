"""Tables as columns, and tables in memory: data frames, data sets, mappings."""

from __future__ import annotations

import math
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


@dataclass
class Table:
    """A table before its rows are read: its columns, and the information in its first lines."""

    name: str  # of the file, for messages
    names: list[str]  # of the columns; empty if they are not known
    n_columns: int
    about: str = ""  # the file's name and its comments
    rates: tuple[float, ...] = ()  # sample rates in lines before the numbers, Hz
    n_names: int = 0
    first_row: Sequence[str] = field(default_factory=list)

    def read(
        self, wanted: list[int], clock: list[int], *, numbers: int, strict: bool
    ) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
        """Wanted columns (n, k), NaN for cells without a number, and the time stamps.

        ``strict`` refuses a row without a stamp, or without one of the first ``numbers`` numbers.
        """
        raise NotImplementedError

    def place(self, row: int) -> str:
        """The position of a row, for a message."""
        return f"row {row}"

    def error(self, text: object) -> GyroLogError:
        """An error that names the table."""
        return GyroLogError(f"{self.name}: {text}")

    def shown(self) -> str:
        """The columns, for a message."""
        if self.names:
            return names.listed(self.names)
        if self.n_names:
            return f"{self.n_columns} columns under {self.n_names} names"
        return f"{self.n_columns} unnamed columns"

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
        columns: dict[str, NDArray[Any]] = {}
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

    def read(
        self, wanted: list[int], clock: list[int], *, numbers: int, strict: bool
    ) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
        """Implements ``Table.read``."""
        columns = {i: _plain(self.arrays[i]) for i in wanted}
        clocks = {i: _stamps(self.arrays[i]) for i in clock}
        for i, array in [*((i, columns[i]) for i in wanted[:numbers]), *clocks.items()]:
            bad = ~stamps.known(array)
            if bad.any() and strict:
                raise self.error(
                    f"row {int(np.argmax(bad))}: {self.column(i)[:60]} is no finite number; "
                    'accepted: numbers, or on_bad_rows="drop", "split" or "hold"'
                )
        values = np.stack([columns[i] for i in wanted], axis=1)
        return values, stamps.joined(list(clocks.values()))


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


def _plain(array: NDArray[Any]) -> NDArray[np.float64]:
    """float64; NaN for values that are not real, finite numbers."""
    if array.dtype.kind in "OUST":
        numbers = np.array([_number(x) for x in array.tolist()])
    elif array.dtype.kind in "iuf":
        numbers = array.astype(np.float64)
    else:
        numbers = np.full(array.shape, np.nan)
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _number(value: Any) -> float:
    try:
        return math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _stamps(array: NDArray[Any]) -> NDArray[Any]:
    """Time stamps: int64 for whole numbers, dates and durations in ns, else float64."""
    if array.dtype.kind in "mM":
        unit = "datetime64[ns]" if array.dtype.kind == "M" else "timedelta64[ns]"
        return array.astype(unit).view(np.int64)
    if array.dtype.kind in "iu" and (not array.size or int(np.abs(array).max()) < 2**63):
        return array.astype(np.int64)
    how = stamps.kind(str(array[0])) if array.dtype.kind in "OUST" else "float"
    return _plain(array) if how == "float" else stamps.from_text(how, [str(x) for x in array])
