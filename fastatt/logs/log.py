"""Gyro logs as they are found, read whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.logs.reader import Options, Reader, reading
from fastatt.logs.stamps import Chunk


@dataclass(frozen=True)
class Log:
    """A gyro log of n samples, in SI units.

    Attributes
    ----------
    path : where it came from.
    t : (n,), s from the first sample.
    rates : (n, 3), rad/s, body axes.
    dt : the interval, s, or the n − 1 intervals: what ``integrate_rates`` takes.
    accel : (n, 3), or None; m/s² where names, or gravity's size at rest, tell the log's unit.
    mag : (n, 3) in the log's own unit, or None.
    attitudes : (n, 4), those that the log carries, as they stand there, or None.
    columns, unit, timing : the gyro's columns, the unit they were in, where times come from.
    start : the first time stamp in s as the log counts it (0 where it has none).
    pieces : slices of samples without a break between them: one, unless ``bad="split"``.
    summary : what was understood, one line.
    """

    path: Path
    rates: NDArray[np.float64]
    dt: float | NDArray[np.float64]
    t: NDArray[np.float64]
    columns: tuple[str, ...]
    unit: str
    timing: str
    attitudes: NDArray[np.float64] | None
    accel: NDArray[np.float64] | None = None
    mag: NDArray[np.float64] | None = None
    start: float = 0.0
    pieces: tuple[slice, ...] = ()
    summary: str = ""

    @property
    def rate(self) -> float:
        """Mean sample rate, Hz."""
        return 1.0 / float(np.mean(self.dt))


def read_log(
    source: Any,
    time_unit: str | None = None,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | None = None,
    attitude_columns: Sequence[str] | None = None,
    bad: str = "refuse",
    max_gap: float | None = None,
    bias_seconds: float | None = None,
    progress: Callable[[int], object] | None = None,
) -> Log:
    """Read a gyro log and say what was understood (``log.summary``).

    A text table, gzipped or not, is separated by commas, semicolons, tabs or blanks; with
    semicolons and tabs its numbers may have decimal commas. Names stand in its first lines, in a
    comment too, a line of units may follow. The gyro's columns, and those of time,
    accelerometer, magnetometer and attitude beside it, are found by the names that loggers write.

    Parameters
    ----------
    source : a file's name, "-" for standard input, an open file, a pandas or polars data frame, an
        xarray data set, or a mapping of names to arrays.
    time_unit : "s", "ms", "us" or "ns"; None: from the column's name, else from the size of the
        stamps, with a warning. Dates (ISO 8601) have none.
    columns, time_column, attitude_columns : names, or numbers from 1, of the gyro's x, y, z, of
        the time stamps and of an attitude's w, x, y, z.
    unit : "rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/min", "deg/h", "arcsec/s", "rev/s" or "rpm";
        None: from the columns' names, else from the size of the rates, with a warning.
    rate : sample rate, Hz, in place of time stamps.
    bad : what becomes of rows that are no numbers, of stamps that do not grow, and of gaps:
        "refuse"; "drop" (the next interval goes across); "split" (``log.pieces``); "hold" (the
        last rates stay).
    max_gap : longest interval that is no gap, s; None: 10 times the usual one.
    bias_seconds : the mean rate of that many seconds from the start, at rest, is taken off.
    progress : called with the bytes read.

    Raises
    ------
    LogError : (a ``ValueError``) what was found, where, and what to say: more than one gyro or
        time column, units or stamps that fit no gyro, a bad row, a start that is not at rest.
    TypeError : arguments of another type.
    OSError : of the file itself.

    Warns
    -----
    LogWarning : a unit was taken from the size of numbers.

    Examples
    --------
    >>> import fastatt as fa
    >>> log = fa.read_log({"t": [0.0, 0.01], **{f"gyro_{a} (rad/s)": [0.1, 0.1] for a in "xyz"}})
    >>> log.rates.shape, log.dt
    ((2, 3), array([0.01]))
    """
    options = Options(
        columns, unit, rate, time_column, time_unit, attitude_columns, bad, max_gap, bias_seconds
    )
    with reading(source, options, progress) as reader:
        return in_one(reader, list(reader.chunks()))


def in_one(reader: Reader, chunks: list[Chunk]) -> Log:
    """All chunks of a reader as one log."""
    t = np.concatenate([c.t for c in chunks])
    values = np.concatenate([c.values for c in chunks])
    firsts = np.cumsum([0, *(len(c.t) for c in chunks)])
    cuts = [int(a) + k for a, c in zip(firsts, chunks, strict=False) for k in c.cuts]
    columns = reader.columns
    widths = [len(place or ()) for place in (columns.accel, columns.mag, columns.quat)]
    beside = np.split(values[:, 3:], np.cumsum(widths)[:-1], axis=1)
    accel, mag, quat = (np.ascontiguousarray(x) if x.shape[1] else None for x in beside)
    return Log(
        path=Path(reader.layout.name), columns=reader.names, unit=reader.unit_said,
        timing=reader.timing, t=t, start=reader.start,
        dt=1.0 / reader.rate if reader.rate and len(t) == 1 else reader.dt(t),
        rates=np.ascontiguousarray(values[:, :3]), accel=accel, mag=mag, attitudes=quat,
        pieces=tuple(slice(a, b) for a, b in pairwise([0, *cuts, len(t)])),
        summary=reader.summary(),
    )  # fmt: skip
