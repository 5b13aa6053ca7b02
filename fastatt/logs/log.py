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
from fastatt.logs.text import Text, opened

# largest bias, rad/s, and rotation about it, rad, of a body at rest
_LARGEST_BIAS, _LARGEST_ROTATION = 0.2, 0.05
_LEAST_RATE = 1e-290  # Hz, below which times overflow
_OF_LOG = "the unit of the log"
_OTHERS = {"accel": "accelerometer", "mag": "magnetometer"}
_WRAPS = 1 << 16
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
        Specific force, m/s². NaN where the log has no number.
    mag : ndarray of shape (n, 3), or None
        Magnetic field, in the log's unit. NaN where the log has no number.
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
        "gaps" or "clock resets"), the index of its row among those read, from 0, and the time of
        the last sample before that row, s. The row of a gap is the first one after the gap.
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
    accel: NDArray[np.float64] | None = None
    mag: NDArray[np.float64] | None = None
    start: float = 0.0
    pieces: tuple[slice, ...] = ()
    events: tuple[tuple[str, int, float], ...] = ()
    summary: str = ""

    def __str__(self) -> str:
        return f"{self.path}: {self.summary}"


def read_gyro_log(
    source: Any,
    time_unit: str | None = None,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | None = None,
    accel_columns: Sequence[str] | None = None,
    mag_columns: Sequence[str] | None = None,
    rows: tuple[str, object] | Sequence[tuple[str, object]] | None = None,
    on_bad_rows: str = "refuse",
    max_gap: float | None = None,
    bias_seconds: float | None = None,
) -> GyroLog:
    """Read a gyro log.

    The columns of a text table are separated by commas, semicolons, tabs or blanks, and its numbers
    may have decimal commas (in quotes, if commas separate the columns). The table may be compressed
    with gzip. The names of the columns are in its first lines or in a comment, and a line of units
    may follow. Text tables need pandas, which ``pip install 'fastatt[logs]'`` installs.

    Nothing is guessed. The columns are known by the names that loggers write. Units are those in
    the names, or those that a format defines: PX4's ``gyro_rad``, ROS's ``angular_velocity`` with
    its header stamps, ``rostopic``'s ``%time`` or PlotJuggler's ``__time``, and Sensor Logger's
    ``Gyroscope.csv``. What neither says, the arguments have to say.

    Parameters
    ----------
    source : path, file, data frame, data set or mapping
        The name of a file, "-" for standard input, an open file, a pandas or polars data frame, an
        xarray data set, or a mapping of names to arrays.
    time_unit : str, optional
        "s", "ms", "100us", "us" or "ns", if neither the name of the column nor a format has the
        unit. Dates (ISO 8601), times of day (hh:mm:ss) and durations have none.
    columns : sequence of str or int, optional
        Names of the gyro's columns x, y and z, or their numbers from 1.
    unit : str, optional
        Unit of the rates: "rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/min", "deg/h", "arcsec/s",
        "rev/s", "rpm" or "Hz" (revolutions per second), if neither the names of the columns nor a
        format have the unit.
    rate : float, optional
        Sample rate, Hz, in place of time stamps. Where a column PacketCounter jumps, samples are
        missing.
    time_column : str or int, optional
        Name or number of the column of time stamps.
    accel_columns, mag_columns : sequence of str or int, optional
        Names or numbers of the columns x, y and z of the accelerometer and of the magnetometer. By
        default they are read if their names say that they are specific force or magnetic field, and
        their unit. An accelerometer that is named here without a unit is left in the log's unit.
    rows : (str, str), or sequence of these, optional
        A column and the text that a row has there, such as ``("name", "IMU")``, to read only such
        rows of a table with several kinds of rows or several sensors. By default such a table is
        refused; () reads all rows.
    on_bad_rows : {"refuse", "drop", "split", "hold"}, default "refuse"
        Treatment of bad rows, which have no rate, no time stamp or a stamp that does not increase,
        and of gaps. "refuse" raises an error. "drop" leaves bad rows out, so that the next interval
        is longer, and keeps a gap as one long interval. "split" leaves bad rows out too, and starts
        a new piece (``log.pieces``) where samples are missing. "hold" gives a row without a rate
        those of the row before, leaves out rows with a bad time stamp, and inserts a sample with
        the last rates before the end of a gap. Stamps that many rows share, as in packets, are
        always refused: pass ``rate`` in their place.
    max_gap : float, optional
        Longest interval that is not a gap, s; the default is 10 times the median interval, or
        10/``rate``.
    bias_seconds : float, optional
        Duration, s, from the first sample, during which the sensor is at rest. The mean rate over
        it is subtracted as the bias.

    Returns
    -------
    GyroLog
        The samples, and a ``summary`` of what was recognised.

    Raises
    ------
    GyroLogError
        If a unit is unknown, or is no angle per time, there is more than one gyro or time column,
        rows are of several kinds, the stamps fit no gyro, a row is bad or the sensor moves during
        ``bias_seconds``. It is a ``ValueError``, whose message names what was found, its line, and
        the argument that helps.
    TypeError
        If an argument has the wrong type.
    ImportError
        If a text table is read without pandas.
    OSError
        If the file can't be read.

    Warns
    -----
    GyroLogWarning
        If more than 1 % of the rows were left out.

    Examples
    --------
    >>> import fastatt as fa
    >>> gyro = {f"gyro_{a} (rad/s)": [0.1, 0.1] for a in "xyz"}
    >>> log = fa.read_gyro_log({"t (s)": [0.0, 0.01], **gyro})
    >>> log.rates.shape, log.dt
    ((2, 3), array([0.01]))
    """
    _check_words(unit=unit, time_unit=time_unit, on_bad_rows=on_bad_rows)
    max_gap, bias_seconds = _span("max_gap", max_gap), _span("bias_seconds", bias_seconds)
    asked = {"accel": accel_columns, "mag": mag_columns}
    with _table(source) as table:
        try:
            gyro = _gyro(table, columns)
            axes = tuple(table.column(i) for i in gyro)
            defined = names.format_of(table.names, axes, table.name)
            others, said = _others(table, asked, defined)
            clock = [] if rate is not None else _clock(table, time_column, defined)
            unit = unit or ("rad/s" if defined else names.rate_unit(axes))
            chosen = _chosen(table, rows)
        except GyroLogError as error:
            raise table.error(error) from None
        hertz = math.nan if clock else _rate(table, rate)
        counter = _counter(table, stamped=bool(clock))
        parts = [gyro, others["accel"], others["mag"], counter]
        wanted = [i for part in parts for i in part]
        values, raw = table.read(wanted, clock, chosen, strict=on_bad_rows == "refuse")
    if unit is None:
        raise table.error(f"{axes[0][:60]} has no unit; accepted: unit, one of {', '.join(UNITS)}")
    with np.errstate(over="ignore"):
        values[:, :3] *= UNITS[unit]
    count, jumps = _counted(values[:, -1] if counter else None, len(values))
    t, start = count / hertz, 0.0
    if raw is not None:
        t, start = stamps.times(table, clock, raw, time_unit, defined)
    clock_name = " and ".join(table.column(i) for i in clock or counter)
    timing = f"time stamps in {clock_name}" if clock else f"{hertz:g} Hz"
    samples = in_order(
        table, clock_name, t, values[:, :3], on_bad_rows, max_gap, jumps,
        usual=None if clock else 1.0 / hertz,
    )  # fmt: skip
    _check(table, samples, len(t), least=2 if clock else 1)
    split = np.split(samples.of(values), np.cumsum([len(part) for part in parts[:-1]]), axis=1)
    rates, accel, mag = (np.ascontiguousarray(x) for x in split[:3])
    for sensor, numbers in (("accel", accel), ("mag", mag)):
        if numbers.size:
            name = table.column(others[sensor][0])
            its_unit = names.unit_of_other(sensor, name, defined) or _OF_LOG
            if sensor == "accel":
                np.multiply(numbers, names.ACCEL_UNITS.get(its_unit, 1.0), out=numbers)
            said.append(f"{_OTHERS[sensor]} in {its_unit}: {name} ...")
    if bias_seconds is not None:
        bias = _bias(table, samples.t, rates, bias_seconds)
        said.append(f"bias {', '.join(f'{b:.3g}' for b in bias)} rad/s taken off")
        rates -= bias
    dt = np.diff(samples.t)
    if not (clock or samples.said):
        dt[:] = 1.0 / hertz
    usual = float(np.median(dt)) if len(dt) else 1.0 / hertz
    mean_rate = 1.0 / float(np.mean(dt[dt <= REGULAR * usual])) if len(dt) else hertz
    said[:0] = [
        f"{table.name}: {len(rates)} samples at {mean_rate:.6g} Hz ({timing})",
        f"{', '.join(axes)} in {unit}",
    ]
    return GyroLog(
        path=Path(table.name), columns=axes, unit=unit, timing=timing, rate=mean_rate,
        t=samples.t, dt=dt, start=start + float(t[samples.rows[0]]), rates=rates,
        accel=accel if accel.size else None, mag=mag if mag.size else None,
        pieces=tuple(slice(a, b) for a, b in pairwise([0, *samples.cuts, len(rates)])),
        events=tuple((*event,) for event in samples.events),
        summary="; ".join([*said, *samples.said]),
    )  # fmt: skip


@contextmanager
def _table(source: Any) -> Iterator[Table]:
    """The table of a source, which can be read within the context."""
    if tabular(source):
        yield Frame(source)
        return
    with opened(source) as (name, stream):
        yield Text(name, stream)


def _check_words(**given: str | None) -> None:
    accepted = {"unit": UNITS, "time_unit": names.TIME_UNITS, "on_bad_rows": ON_BAD_ROWS}
    for name, word in given.items():
        if word is not None:
            checks.choice(name, word, accepted[name])


def _span(name: str, seconds: float | None) -> float | None:
    if seconds is None:
        return None
    return checks.above_zero(name, seconds, "a number above 0, s", finite=False)


def _gyro(table: Table, columns: Sequence[str] | None) -> list[int]:
    """The gyro's columns, as given or recognised by their names."""
    if columns is not None:
        return table.chosen(columns, 3, "columns")
    gyro = names.gyro(table.names, table.name)
    if gyro is None:
        raise GyroLogError(
            f"found no three columns named like gyro x, y, z among {table.shown()}; name them with "
            "columns (names or numbers from 1)"
        )
    return gyro


def _others(
    table: Table, asked: Mapping[str, Sequence[str] | None], defined: names.Format | None
) -> tuple[dict[str, list[int]], list[str]]:
    """Columns of the other sensors, [] for none; and what is said of those left out."""
    found, said = {}, []
    for sensor, word in _OTHERS.items():
        columns = asked[sensor]
        if columns is not None:
            found[sensor] = table.chosen(columns, 3, f"{sensor}_columns")
            continue
        found[sensor], why = names.other_sensor(table.names, sensor, defined)
        said += [f"no {word}: {why}"] if why else []
    return found, said


def _clock(table: Table, time_column: str | None, defined: names.Format | None) -> list[int]:
    """The columns of the time stamps; none if the file states its sample rate."""
    if time_column is not None:
        clock = [table.index(time_column, "time column")]
    else:
        clock = names.clock(table.names, defined)
    if clock and table.rates and not table.first_row[clock[0]]:
        clock = []  # an empty column
    if not clock and not table.rates:
        raise GyroLogError(
            f"found no time column and no sample rate among {table.shown()}; give a rate in Hz or "
            "a time column"
        )
    for i in clock:
        stamps.kind(table.first_row[i])
    return clock


def _chosen(table: Table, rows: Any) -> list[tuple[int, str]] | None:
    """Columns by index, and the text that rows have there."""
    if rows is None:
        return None
    pairs = [rows] if isinstance(rows, tuple) and rows[:1] and isinstance(rows[0], str) else rows
    try:
        return [(table.index(column, "rows"), str(text)) for column, text in pairs]
    except (TypeError, ValueError) as error:
        if isinstance(error, GyroLogError):
            raise
        accepted = 'a column and its text, as ("name", "IMU"), or a list of these'
        raise TypeError(f"rows: found {checks.brief(rows)}; accepted: {accepted}") from None


def _counter(table: Table, *, stamped: bool) -> list[int]:
    """The column of a packet counter, [] for none; without time stamps any counter is one."""
    words = ["packetcounter", "packet counter", "packet_counter", *["counter"] * (not stamped)]
    return [i for i, name in enumerate(table.names) if name.lower() in words][:1]


def _counted(
    counter: NDArray[np.float64] | None, n: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The number of each of n rows, and whether a packet counter jumps there."""
    jumps = np.zeros(n, dtype=bool)
    if counter is None or n < 2 or not np.isfinite(counter).all():
        return np.arange(n, dtype=np.float64), jumps
    steps = np.diff(counter)
    usual = max(float(np.median(steps % _WRAPS)), 1.0)
    # half the range back is a reset
    steps = np.where(steps % _WRAPS < _WRAPS // 2, steps % _WRAPS, steps)
    jumps[1:] = steps > usual
    return np.append(0.0, np.cumsum(steps / usual)), jumps


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
    """Refuse a log of too few samples; warn if many rows are left out."""
    kept = int((~samples.added).sum())
    if kept < least:
        found = f"{kept} of {n} rows that are samples"
        raise table.error(f"found {found}; accepted: at least {('one', 'two')[least - 1]}")
    if n - kept > _MANY * n:
        counts = "; ".join(samples.said)
        warnings.warn(
            f"{table.name}: {n - kept} of {n} rows are left out ({counts})",
            GyroLogWarning,
            stacklevel=3,
        )


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


def _largest(x: NDArray[np.float64]) -> float:
    """The largest finite absolute value, 0 if there is none."""
    return float(np.max(np.abs(x), initial=0.0, where=np.isfinite(x)))
