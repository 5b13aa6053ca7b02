"""Gyro logs: columns and units recognised, samples in order and in SI units."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.logs import names, stamps
from fastatt.logs.gaps import ON_BAD_ROWS, REGULAR, Samples, in_order
from fastatt.logs.names import UNITS, GyroLogError, GyroLogWarning
from fastatt.logs.tables import Frame, Table, tabular
from fastatt.logs.text import Text, opened, size_of
from fastatt.threads import progress_bar

# the range of most gyros (2000 deg/s), rad/s, and of any gyro, deg/s
_MOST_RAD, _MOST_DEG = 35.0, 4500.0
# largest bias, rad/s, and rotation about it, rad, of a body at rest
_LARGEST_BIAS, _LARGEST_ROTATION = 0.2, 0.05
_LEAST_RATE = 1e-290  # Hz, below which times overflow
_OTHERS = {"accel": "accel_columns", "mag": "mag_columns", "quat": "attitude_columns"}
_MANY = 0.01  # share of rows; leaving out more is warned of


@dataclass(frozen=True)
class GyroLog:
    """A gyro log of n samples in SI units, as :func:`read_gyro_log` returns it.

    Attributes
    ----------
    path : Path
        The file.
    t : ndarray of shape (n,)
        Times from the first sample, s. Across a reset of the clock, the interval is the median one.
    rates : ndarray of shape (n, 3)
        Rates along body axes, rad/s.
    dt : ndarray of shape (n - 1,)
        Intervals, s.
    accel : ndarray of shape (n, 3), or None
        Accelerometer, m/s² if its unit is known from names or from gravity at rest. NaN where the
        log has no number.
    mag : ndarray of shape (n, 3), or None
        Magnetometer, in the log's unit. NaN where the log has no number.
    attitudes : ndarray of shape (n, 4), or None
        Attitudes in the log, unchanged.
    columns : tuple of str
        The gyro's columns.
    unit : str
        The unit of the gyro's columns.
    timing : str
        The source of the times.
    rate : float
        Sample rate, Hz: the inverse of the mean interval, without intervals longer than 2.5 times
        the median.
    start : float
        The first time stamp, s (0 if there is none).
    pieces : tuple of slice
        Ranges of samples without a break: one, unless ``on_bad_rows="split"``. The intervals of a
        piece are ``dt[piece.start : piece.stop - 1]``.
    events : tuple of (str, int, float)
        Bad rows and gaps in the order of the log, each with its kind ("rows dropped", "rows held",
        "gaps" or "clock resets"), the index of its row in the table, from 0, and the time of the
        last sample before that row, s. The row of a gap is the first one after the gap.
    summary : str
        A line that describes what was recognised.
    """

    path: Path
    rates: NDArray[np.float64]
    dt: NDArray[np.float64]
    t: NDArray[np.float64]
    columns: tuple[str, ...]
    unit: str
    timing: str
    rate: float
    attitudes: NDArray[np.float64] | None
    accel: NDArray[np.float64] | None = None
    mag: NDArray[np.float64] | None = None
    start: float = 0.0
    pieces: tuple[slice, ...] = ()
    events: tuple[tuple[str, int, float], ...] = ()
    summary: str = ""


def read_gyro_log(
    source: Any,
    time_unit: str | None = None,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | None = None,
    attitude_columns: Sequence[str] | None = None,
    accel_columns: Sequence[str] | None = None,
    mag_columns: Sequence[str] | None = None,
    on_bad_rows: str = "refuse",
    max_gap: float | None = None,
    bias_seconds: float | None = None,
    progress: bool = False,
) -> GyroLog:
    """Read a gyro log.

    The columns of a text table are separated by commas, semicolons, tabs or blanks, and its numbers
    may have decimal commas (in quotes, if commas separate the columns). The table may be compressed
    with gzip. The names of the columns are in its first lines or in a comment, and a line of units
    may follow. The function finds the columns of time, gyro, accelerometer, magnetometer and
    attitude by the names that loggers write. If the columns are only named x, y and z, the name of
    the file must show that they are those of a gyro.

    Parameters
    ----------
    source : path, file, data frame, data set or mapping
        The name of a file, "-" for standard input, an open file, a pandas or polars data frame, an
        xarray data set, or a mapping of names to arrays.
    time_unit : str, optional
        "s", "ms", "100us", "us" or "ns". The default is the unit in the name of the column, or else
        one that fits the size of the stamps, with a warning. Dates (ISO 8601), times of day
        (hh:mm:ss) and durations have no unit.
    columns : sequence of str or int, optional
        Names of the gyro's columns x, y and z, or their numbers from 1.
    unit : str, optional
        Unit of the rates: "rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/min", "deg/h", "arcsec/s",
        "rev/s", "rpm" or "Hz" (revolutions per second). The default is the unit in the names of the
        columns, or else one that fits the size of the rates, with a warning.
    rate : float, optional
        Sample rate, Hz, in place of time stamps.
    time_column : str or int, optional
        Name or number of the column of time stamps.
    attitude_columns : sequence of str or int, optional
        Names or numbers of an attitude's columns w, x, y and z.
    accel_columns, mag_columns : sequence of str or int, optional
        Names or numbers of the columns x, y and z of the accelerometer and of the magnetometer.
    on_bad_rows : {"refuse", "drop", "split", "hold"}, default "refuse"
        Treatment of bad rows, which have no rate, no time stamp or a stamp that does not increase,
        and of gaps. "refuse" raises an error. "drop" leaves bad rows out, so that the next interval
        is longer, and keeps a gap as one long interval. "split" leaves bad rows out too, and starts
        a new piece (``log.pieces``) where samples are missing. "hold" gives a row without a rate
        those of the row before, leaves out rows with a bad time stamp, and inserts a sample with
        the last rates before the end of a gap. Except with "refuse", many rows that share time
        stamps are spread evenly in time.
    max_gap : float, optional
        Longest interval that is not a gap, s; the default is 10 times the median interval, or
        10/``rate``.
    bias_seconds : float, optional
        Duration, s, from the first sample, during which the sensor is at rest. The mean rate over
        it is subtracted as the bias.
    progress : bool, default False
        Show a progress bar of the bytes read, which needs tqdm.

    Returns
    -------
    GyroLog
        The samples, and a ``summary`` of what was recognised.

    Raises
    ------
    GyroLogError
        If there is more than one gyro or time column, the units or stamps fit no gyro, a row is bad
        or the sensor moves during ``bias_seconds``. It is a ``ValueError``, whose message names
        what was found, its line, and the argument that helps.
    TypeError
        If an argument has the wrong type.
    OSError
        If the file can't be read.

    Warns
    -----
    GyroLogWarning
        If a unit was inferred from the size of numbers, more than 1 % of the rows were left out, or
        rows that share stamps were spread.

    Examples
    --------
    >>> import fastatt as fa
    >>> gyro = {f"gyro_{a} (rad/s)": [0.1, 0.1] for a in "xyz"}
    >>> log = fa.read_gyro_log({"t": [0.0, 0.01], **gyro})
    >>> log.rates.shape, log.dt
    ((2, 3), array([0.01]))
    """
    _check_words(unit=unit, time_unit=time_unit, on_bad_rows=on_bad_rows)
    max_gap, bias_seconds = _span("max_gap", max_gap), _span("bias_seconds", bias_seconds)
    with _table(source, progress) as table:
        try:
            given = {"accel": accel_columns, "mag": mag_columns, "quat": attitude_columns}
            places = _columns(table, columns, given)
            clock = [] if rate is not None else _clock(table, time_column)
            axes = tuple(table.column(i) for i in places["gyro"])
            unit = unit or names.rate_unit(axes)
        except GyroLogError as error:
            raise table.error(error) from None
        hertz = math.nan if clock else _rate(table, rate)
        wanted = [i for part in places.values() for i in part]
        values, raw = table.read(wanted, clock, numbers=3, strict=on_bad_rows == "refuse")
    if not len(values):
        raise table.error("found no sample; accepted: one at least")
    shown = unit or _assumed_unit(table, axes[0], values[:, :3])
    with np.errstate(over="ignore"):
        values[:, :3] *= UNITS[shown]
    if raw is None:
        t, start = np.arange(len(values)) / hertz, 0.0
        timing, clock_name = f"{hertz:g} Hz", ""
    else:
        t, start = stamps.times(table, clock, raw, time_unit)
        clock_name = " and ".join(table.column(i) for i in clock)
        timing = f"time stamps in {clock_name}"
    usual = None if clock else 1.0 / hertz
    samples = in_order(table, clock_name, t, values[:, :3], on_bad_rows, max_gap, usual)
    _check(table, samples, len(t), least=2 if clock else 1)
    values = samples.of(values)
    bias = np.zeros(3)
    if bias_seconds is not None:
        bias = _bias(table, samples.t, values[:, :3], bias_seconds)
    widths = [len(found) for found in places.values()]
    parts = np.split(values, np.cumsum(widths[:-1]), axis=1)
    rates, accel, mag, attitudes = (np.ascontiguousarray(x) if x.size else None for x in parts)
    assert rates is not None
    rates -= bias
    dt = np.diff(samples.t)
    if not (clock or samples.said):
        dt = np.full(len(dt), 1.0 / hertz)
    usual = float(np.median(dt)) if len(dt) else 1.0 / hertz
    found_rate = 1.0 / float(np.mean(dt[dt <= REGULAR * usual])) if len(dt) else hertz
    said = [
        f"{table.name}: {len(rates)} samples at {found_rate:.6g} Hz ({timing})",
        f"{', '.join(axes)} in {shown}{'' if unit else ' (assumed)'}",
    ]
    if columns is None and places["gyro"] in names.triples(table.names, "unnamed"):
        said.append("a gyro's, as the file's name or its comments say")
    said += _other_sensors(table, places, accel)
    if bias_seconds is not None:
        said.append(f"bias {', '.join(f'{b:.3g}' for b in bias)} rad/s taken off")
    return GyroLog(
        path=Path(table.name), columns=axes, unit=shown if unit else f"{shown} (assumed)",
        timing=timing, rate=found_rate, t=samples.t, dt=dt, start=start + float(t[samples.rows[0]]),
        rates=rates, accel=accel, mag=mag, attitudes=attitudes,
        pieces=tuple(slice(a, b) for a, b in pairwise([0, *samples.cuts, len(rates)])),
        events=tuple((*event,) for event in samples.events),
        summary="; ".join([*said, *samples.said]),
    )  # fmt: skip


@contextmanager
def _table(source: Any, progress: bool) -> Iterator[Table]:
    """The table of a source, which can be read within the context."""
    if tabular(source):
        yield Frame(source)
        return
    with opened(source) as (name, stream), progress_bar(progress, size_of(source), "B") as done:
        yield Text(name, stream, done)


def _check_words(**given: str | None) -> None:
    accepted = {"unit": UNITS, "time_unit": names.TIME_UNITS, "on_bad_rows": ON_BAD_ROWS}
    for name, word in given.items():
        if word is not None:
            checks.choice(name, word, accepted[name])


def _span(name: str, seconds: float | None) -> float | None:
    if seconds is None:
        return None
    return checks.above_zero(name, seconds, "a number above 0, s", finite=False)


def _columns(
    table: Table, columns: Sequence[str] | None, given: Mapping[str, Sequence[str] | None]
) -> dict[str, list[int]]:
    """Indices of columns, as given or recognised by their names; [] for none."""
    if columns is None:
        gyro = names.gyro(table.names, table.about)
    else:
        gyro = table.chosen(columns, 3, "columns")
    if gyro is None:
        raise GyroLogError(
            f"found no three columns named like gyro x, y, z among {table.shown()}; name them with "
            "columns (names or numbers from 1)"
        )
    accel, mag = (names.triples(table.names, sensor) for sensor in ("accel", "mag"))
    found = {k: x[0] if len(x) == 1 else [] for k, x in (("accel", accel), ("mag", mag))}
    found["quat"] = names.quaternion(table.names) or []
    for sensor, argument in _OTHERS.items():
        wanted = given[sensor]
        if wanted is not None:
            found[sensor] = table.chosen(wanted, 4 if sensor == "quat" else 3, argument)
    return {"gyro": gyro, **found}


def _clock(table: Table, time_column: str | None) -> list[int]:
    """The columns of the time stamps; none if the file states its sample rate."""
    if time_column is not None:
        return [table.index(time_column, "time column")]
    clock = names.clock(table.names)
    if not clock and not table.rates:
        raise GyroLogError(
            f"found no time column and no sample rate among {table.shown()}; give a rate in Hz or "
            "a time column"
        )
    return clock


def _rate(table: Table, rate: float | None) -> float:
    """The given sample rate, or the file's."""
    if rate is not None:
        number = checks.real("rate", rate)
        if not number > _LEAST_RATE:
            raise GyroLogError(f"rate: found {number}; accepted: a sample rate above 0, Hz")
        return number
    if len(table.rates) > 1:
        found = " and ".join(f"{x:g}" for x in table.rates)
        raise table.error(f"found the sample rates {found} Hz; accepted: one, or rate, to say it")
    if not stamps.SLOWEST < table.rates[0] <= stamps.FASTEST:
        raise table.error(
            f"the sample rate: found {table.rates[0]:g} Hz; {stamps.PLAUSIBLE}, or any, given as "
            "rate"
        )
    return table.rates[0]


def _check(table: Table, samples: Samples, n: int, least: int) -> None:
    """Refuse a log of too few samples; warn if many rows are left out or moved."""
    kept = int((~samples.added).sum())
    if kept < least:
        found = f"{kept} of {n} rows that are samples"
        raise table.error(f"found {found}; accepted: at least {('one', 'two')[least - 1]}")
    if n - kept > _MANY * n:
        counts = "; ".join(samples.said)
        _warn(f"{table.name}: {n - kept} of {n} rows are left out ({counts})")
    if samples.spread:
        _warn(f"{table.name}: rows that share time stamps are spread evenly, unless rate says")


def _bias(
    table: Table, t: NDArray[np.float64], rates: NDArray[np.float64], wanted: float
) -> NDArray[np.float64]:
    """The mean rate of a start at rest; refuses a shorter log, and a body that moves."""
    rest = t < wanted
    if rest.all() or rest.sum() < 2:
        found = "one sample in the first" if rest.sum() == 1 else "all of the log in the first"
        raise table.error(
            f"bias_seconds: found {found} {wanted:g} s; accepted: less than the log, and at least "
            "two samples"
        )
    bias: NDArray[np.float64] = rates[rest].mean(axis=0)
    angles = np.cumsum((rates[rest][:-1] - bias) * np.diff(t[rest])[:, None], axis=0)
    if _largest(bias) > _LARGEST_BIAS or _largest(angles) > _LARGEST_ROTATION:
        raise table.error(
            f"bias_seconds: the body is not at rest in the first {wanted:g} s (mean rate "
            f"{_largest(bias):.3g} rad/s, rotation about it {_largest(angles):.3g} rad); accepted: "
            f"at most {_LARGEST_BIAS:g} rad/s and {_LARGEST_ROTATION:g} rad"
        )
    return bias


def _assumed_unit(table: Table, name: str, rates: NDArray[np.float64]) -> str:
    """The unit that fits the largest of the rates, if the log states none."""
    most = _largest(rates)
    if most > _MOST_DEG:
        raise table.error(
            f"the rates have no unit and reach {most:.4g}; accepted: unit, rad/s or deg/s; the "
            "counts of a sensor have to be scaled first"
        )
    unit = "rad/s" if most <= _MOST_RAD else "deg/s"
    _warn(
        f"{table.name}: {name[:60]} has no unit: taken as {unit} (at most {most:.3g}); unit says "
        "another"
    )
    return unit


def _other_sensors(table: Table, places: dict[str, list[int]], accel: Any) -> Iterator[str]:
    """Scale the accelerometer to m/s²; yields descriptions of the other sensors."""
    if places["accel"]:
        name = table.column(places["accel"][0])
        yield f"accelerometer in {_accel_in_si(name, accel)}: {name} ..."
    if places["mag"]:
        yield f"magnetometer: {table.column(places['mag'][0])} ..."


def _accel_in_si(name: str, accel: NDArray[np.float64]) -> str:
    """Scale an accelerometer to m/s², by its name or by gravity in g; returns its unit."""
    scale = names.accel_unit(name)
    size = np.sqrt((accel * accel).sum(axis=1))
    size = size[np.isfinite(size)]
    usual = float(np.median(size)) if size.size else math.nan
    if scale is None and 0.8 < usual < 1.25:
        scale = names.STANDARD_GRAVITY
    if scale is None:
        return "m/s²" if 0.8 < usual / names.STANDARD_GRAVITY < 1.25 else "a unit not known"
    accel *= scale
    return "m/s²" if scale == 1.0 else "g"


def _largest(x: NDArray[np.float64]) -> float:
    """The largest finite absolute value, 0 if there is none."""
    return float(np.max(np.abs(x), initial=0.0, where=np.isfinite(x)))


def _warn(text: str) -> None:
    warnings.warn(text, GyroLogWarning, stacklevel=2)
