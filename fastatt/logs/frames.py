"""Data frames and data sets by their columns: pandas, polars, xarray, mappings of arrays."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.logs import names
from fastatt.logs.blocks import NO_STAMP, Block
from fastatt.logs.head import Layout
from fastatt.logs.names import LogError


class Frame:
    """A table in memory, with what a text table has: a layout, then rows."""

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
                kind = array.dtype.kind
                columns[f"{names.bare(label)[0]} [ns]" if kind == "m" else label] = array
        sizes = {len(x) for x in columns.values()}
        if len(sizes) != 1 or 0 in sizes:
            raise LogError(
                f"{name}: found columns of lengths {sorted(sizes)}; accepted: one length"
            )
        self.arrays = [_plain(x) for x in columns.values()]
        self.layout = Layout(
            name=name,
            names=[names.printable(n) for n in columns],
            n_columns=len(columns),
            first_row=[str(x[0]) for x in columns.values()],
        )

    def rows(self, clock: int | None, wanted: list[int], *, mend: bool) -> Iterator[Block]:
        """Wanted columns, all at once."""
        for i in [*wanted, *([] if clock is None else [clock])]:
            bad = self.arrays[i] == NO_STAMP
            if self.arrays[i].dtype.kind == "f":
                bad = ~np.isfinite(self.arrays[i])
            if bad.any() and not mend:
                k = int(np.argmax(bad))
                raise self.layout.error(
                    f"row {k}: {self.layout.column(i)[:60]} is no finite number; accepted: "
                    "numbers, or bad, to say what becomes of such rows"
                )
        values = np.stack([self.arrays[i].astype(np.float64) for i in wanted], axis=1)
        stamps = None if clock is None else self.arrays[clock]
        yield Block(range(len(values)), stamps, values)


def _array(found: Any) -> NDArray[Any]:
    """An array without masks and time zones: what is masked is no number, times are in UTC."""
    array = np.asarray(found)
    if np.ma.is_masked(found) and array.dtype.kind in "fiumM":
        array = array.astype(np.float64) if array.dtype.kind in "iu" else array.copy()
        array[np.ma.getmaskarray(found)] = "NaT" if array.dtype.kind in "mM" else np.nan
    if array.dtype.kind == "O" and array.size and isinstance(array.flat[0], datetime):
        with warnings.catch_warnings():  # NumPy says that zones are gone
            warnings.simplefilter("ignore", UserWarning)
            return np.asarray(found, dtype="datetime64[ns]")
    return array


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


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """float64, or int64 of whole numbers, dates and durations in ns; NaN of what is neither."""
    if array.dtype.kind in "mM":
        unit = "datetime64[ns]" if array.dtype.kind == "M" else "timedelta64[ns]"
        return array.astype(unit).view(np.int64)
    if array.dtype.kind in "iu" and (not array.size or int(np.abs(array).max()) < 2**63):
        return array.astype(np.int64)
    if array.dtype.kind in "bc":
        return np.full(array.shape, np.nan)
    try:
        return array.astype(np.float64)
    except (TypeError, ValueError):
        return np.full(array.shape, np.nan)
