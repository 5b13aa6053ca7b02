"""Reading of gyro logs: columns and units recognised, samples in order and in SI units."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.gyro import columns as names
from fastatt.gyro import stamps
from fastatt.gyro.columns import ANGLES, UNITS
from fastatt.gyro.intervals import REGULAR
from fastatt.gyro.invalid_rows import ON_BAD_ROWS, in_order
from fastatt.gyro.log import VALUES, GyroLog, GyroLogError, GyroLogWarning
from fastatt.gyro.tables import Table, in_memory, tabular
from fastatt.gyro.text import from_text

Floats = NDArray[np.float64]
_WRAPS = 1 << 16
_MANY = 0.01  # share of rows; leaving out more is warned of


def read_gyro_log(
    source: Any,
    time_unit: str | None = None,
    *,
    columns: Sequence[str] | None = None,
    unit: str | None = None,
    rate: float | None = None,
    time_column: str | Sequence[str] | None = None,
    rows: tuple[str, object] | Sequence[tuple[str, object]] | None = None,
    on_bad_rows: str = "refuse",
    max_gap: float | None = None,
    values: str | None = None,
    accel_columns: Sequence[str] | None = None,
    mag_columns: Sequence[str] | None = None,
    accel_unit: str | None = None,
) -> GyroLog:
    """Read a gyro log.

    The columns of a text table are separated by commas, semicolons, tabs or blanks, and its numbers
    may have decimal commas, unless commas separate the columns. The table may be compressed with
    gzip. The names of the columns are in the line before the numbers or in a comment. Text
    tables need pandas, which ``pip install 'fastatt[logs]'`` installs.

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
        "s", "ms", "100us", "us", "100ns" or "ns", if neither the name of the column nor a format
        has the unit. Dates (ISO 8601) and durations have none.
    columns : sequence of str or int, optional
        Names of the gyro's columns x, y and z, or their numbers from 1.
    unit : str, optional
        Unit of the rates: "rad/s", "deg/s", "mrad/s", "mdeg/s", "deg/min", "deg/h", "arcsec/s",
        "rev/s", "rpm" or "Hz" (revolutions per second), if neither the names of the columns nor a
        format have the unit. Of increments: "rad", "deg", "mrad", "mdeg", "arcsec" or "rev".
    rate : float, optional
        Sample rate, Hz, in place of time stamps. Where a column PacketCounter jumps, samples are
        missing.
    time_column : str or int, or two of them, optional
        Name or number of the column of time stamps; or of those of its seconds and nanoseconds.
    rows : (str, str), or sequence of these, optional
        A column and the text that a row has there, such as ``("name", "IMU")``, to read only such
        rows of a table with several kinds of rows or several sensors. By default such a table is
        refused; () reads all rows.
    on_bad_rows : {"refuse", "drop"}, default "refuse"
        Treatment of bad rows, which have no rate, no time stamp or a stamp that does not increase,
        and of gaps. "refuse" raises an error. "drop" leaves bad rows out, so that the next interval
        is longer, and keeps a gap as one long interval. Stamps that many rows share, as in packets,
        and those of a clock that was reset are always refused: pass ``rate`` in their place.
    max_gap : float, optional
        Longest interval that is not a gap, s; the default is 10 times the median interval.
    values : {"samples", "means", "increments"}, optional
        What the numbers are: rates at the times of their stamps, mean rates over the intervals that
        end there, or angle increments over these. By default what a format defines, else samples.
        Of means and increments the first is left out, since its interval begins before the first
        stamp, unless the log has a sample rate in place of stamps.

    accel_columns, mag_columns : sequence of str or int, optional
        Names of the columns x, y and z of an accelerometer's specific force and of a magnetometer,
        or their numbers from 1, where their names do not say it.
    accel_unit : str, optional
        Unit of ``accel_columns``: "m/s²", "cm/s²", "mm/s²", "g" or "mg", if their names and the
        format have none; "-g" for specific force of the opposite sign.

    Returns
    -------
    GyroLog
        The samples, and a ``summary`` of what was recognised.

    Raises
    ------
    GyroLogError
        If a unit is unknown, or is no angle per time, there is more than one gyro or time column,
        rows are of several kinds, the stamps fit no gyro, a row is bad or an argument contradicts
        the log. It is a ``ValueError``,
        whose message names what was found, its line, and the argument that helps.
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
    _check_words(on_bad_rows, unit, values, time_unit, accel_unit)
    if max_gap is not None:
        max_gap = checks.above_zero("max_gap", max_gap, "a number above 0, s", finite=False)
    pairs = _pairs(rows)
    table = in_memory(source) if tabular(source) else from_text(source, pairs or [])
    try:
        gyro = _gyro(table, columns)
        axes = tuple(table.column(i) for i in gyro)
        defined = names.format_of(table.names, axes, table.name)
        others = _others(table, defined, accel_columns, accel_unit, mag_columns)
        clock = [] if rate is not None else _clock(table, time_column, defined)
        values = _values(axes, values, defined)
        unit = names.rate_unit(axes, unit, values, defined)
        chosen = None if pairs is None else [(table.index(c, "rows"), text) for c, text in pairs]
        hertz = math.nan if clock else _rate(table, rate)
        counter = _counter(table, stamped=bool(clock))
        wanted = {"gyro": gyro, "counter": counter}
        wanted |= {sensor: columns_of for sensor, (columns_of, *_) in others.items()}
        numbers, raw = table.read(wanted, clock, chosen, strict=on_bad_rows == "refuse")
        scales = ANGLES if values == "increments" else UNITS
        if unit is None:
            raise GyroLogError(
                f"{axes[0][:60]} has no unit; accepted: unit, one of {', '.join(scales)}"
            )
        count, jumps = _counted(numbers.pop("counter", None), len(numbers["gyro"]))
        with np.errstate(over="ignore"):
            numbers["gyro"] *= scales[unit]
            t, start = count / hertz, 0.0
        if raw is not None:
            name, parts, named = _clock_of(table, clock, defined)
            t, start = stamps.times(raw, name, parts, time_unit, named)
        elif rate is not None:
            _check_rate(table, time_column, time_unit, defined, hertz)
        clock_name = " and ".join(table.column(i) for i in clock or counter)
        timing = f"time stamps in {clock_name}" if clock else f"{hertz:g} Hz"
        times, kept, bad = in_order(
            table, clock_name, t, numbers["gyro"], on_bad_rows, max_gap, jumps
        )
        _check(table, len(kept), bad, len(t))
        dt = np.diff(times)
        if not (clock or bad):
            dt[:] = 1.0 / hertz
        mean_rate = 1.0 / float(np.mean(dt[dt <= REGULAR * np.median(dt)]))
        said = [
            f"{table.name}: {len(kept)} samples at {mean_rate:.6g} Hz ({timing})",
            f"{', '.join(axes)} in {unit}"
            + (f", {values} over the intervals before" if values != "samples" else ""),
            *(text for *_, text in others.values() if text),
            *bad,
        ]
        start += float(t[kept[0]])
        if values != "samples":
            times, dt, kept = _over_intervals(times, dt, kept, 0.0 if clock or bad else 1.0 / hertz)
        measured = {s: x if len(kept) == len(t) else x[kept] for s, x in numbers.items()}
        for sensor in measured.keys() & others.keys():
            measured[sensor] *= others[sensor][1]
        if values == "increments":
            measured["gyro"] /= dt[:, None]
        return GyroLog(
            t=times, dt=dt, rate=mean_rate, start=start, summary="; ".join(said), values=values,
            rates=measured.pop("gyro"), **measured,
        )  # fmt: skip
    except GyroLogError as error:
        raise GyroLogError(f"{table.name}: {error}") from None


def _check_words(
    on_bad_rows: str,
    unit: str | None,
    values: str | None,
    time_unit: str | None,
    accel_unit: str | None,
) -> None:
    """Refuse words that are not accepted."""
    checks.choice("on_bad_rows", on_bad_rows, ON_BAD_ROWS)
    for name, word, accepted in (
        ("unit", unit, UNITS | ANGLES), ("values", values, VALUES),
        ("time_unit", time_unit, names.TIME_UNITS),
        ("accel_unit", accel_unit, names.ACCEL_UNITS),
    ):  # fmt: skip
        if word is not None:
            checks.choice(name, word, accepted)


def _others(
    table: Table,
    defined: names.Format | None,
    accel_columns: Sequence[str] | None,
    accel_unit: str | None,
    mag_columns: Sequence[str] | None,
) -> dict[str, tuple[list[int], float, str]]:
    """Columns of the other sensors, as given or known by their names; units, and what is said."""
    others = {x: names.other_sensor(table.names, x, defined) for x in ("accel", "mag")}
    if mag_columns is not None:
        axes = table.chosen(mag_columns, 3, "mag_columns")
        others["mag"] = axes, 1.0, f"magnetometer: {table.column(axes[0])[:60]} ..."
    if accel_columns is not None:
        axes = table.chosen(accel_columns, 3, "accel_columns")
        name = table.column(axes[0])[:60]
        said = names.unit_of_other("accel", name, defined)
        if accel_unit not in (names.ACCEL_UNITS if said is None else (None, said)):
            accepted = ", ".join(names.ACCEL_UNITS) if said is None else f"{said}, or none"
            raise GyroLogError(f"accel_unit: found {accel_unit!r} for {name}; accepted: {accepted}")
        unit = said or str(accel_unit)
        others["accel"] = axes, names.ACCEL_UNITS[unit], f"accelerometer in {unit}: {name} ..."
    elif accel_unit is not None:
        raise GyroLogError(f"accel_unit: found {accel_unit!r}; accepted: with accel_columns alone")
    return others


def _values(axes: Sequence[str], values: str | None, defined: names.Format | None) -> str:
    """What the numbers are: as given, or as a format defines, or else samples."""
    if values and defined and values != defined.values:
        raise GyroLogError(
            f"values: found {values!r}; accepted: {defined.values!r}, which the format of "
            f"{axes[0][:60]} defines, or none"
        )
    return values or (defined.values if defined else "samples")


def _check_rate(
    table: Table, time_column: Any, time_unit: str | None, defined: names.Format | None, rate: float
) -> None:
    """Refuse a rate that contradicts time stamps, if the table has a column of these."""
    try:
        clock = _clock(table, time_column, defined)
        stamps_beside = table.stamps_in(clock)
    except GyroLogError:  # none, or one of several: nothing contradicts the rate
        return
    if stamps_beside is not None:
        name, parts, named = _clock_of(table, clock, defined)
        stamps.check_rate(stamps_beside, name, ("ns" if parts else named, time_unit), rate)


def _clock_of(
    table: Table, clock: list[int], defined: names.Format | None
) -> tuple[str, str, str | None]:
    """The name of a clock, what it has in place of numbers, and the unit in its name."""
    is_date = stamps.kind(table.first_row[clock[0]]) == "date"
    parts = "parts in s and ns" if len(clock) > 1 else "dates" if is_date else ""
    name = table.column(clock[0])
    return name[:60], parts, names.time_unit(name, defined)


def _over_intervals(
    times: Floats, dt: Floats, rows: NDArray[np.int64], step: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """The ends of intervals that end at times, the intervals, and the rows of their numbers.

    ``step`` is the interval of the first row; where it is 0, which is unknown, the row is left out.
    """
    if not step:
        return times, dt, rows[1:]
    return np.append(0.0, times + step), np.append(step, dt), rows


def _gyro(table: Table, columns: Sequence[str] | None) -> list[int]:
    """The gyro's columns, as given or recognised by their names."""
    if columns is not None:
        return table.chosen(columns, 3, "columns")
    table.refuse_twice(names.repeated(table.names))
    gyro = names.gyro(table.names, table.name)
    if gyro is None:
        raise GyroLogError(
            f"found no three columns named like gyro x, y, z among {table.shown()}; name them with "
            "columns (names or numbers from 1)"
        )
    return gyro


def _clock(table: Table, time_column: Any, defined: names.Format | None) -> list[int]:
    """The columns of the time stamps; none if the file states its sample rate."""
    if time_column is not None:
        # a name or number, or two: of seconds and of nanoseconds
        pair = isinstance(time_column, (list, tuple)) and len(time_column) > 1
        parts = time_column if isinstance(time_column, (list, tuple)) else [time_column]
        clock = table.chosen(parts, 1 + pair, "time column")
    else:
        clock = names.clock(table.names, defined)
    if clock and table.rates and not table.first_row[clock[0]]:
        clock = []  # an empty column
    if not clock and not table.rates:
        raise GyroLogError(
            f"found no time column and no sample rate among {table.shown()}; give a rate in Hz or "
            "a time column"
        )
    return clock


def _pairs(rows: Any) -> list[tuple[str | int, str]] | None:
    """Columns, and the text that rows have there."""
    if rows is None:
        return None
    single = isinstance(rows, tuple) and rows and isinstance(rows[0], (str, int))
    pairs = [rows] if single else rows
    try:
        return [(column, str(text)) for column, text in pairs]
    except (TypeError, ValueError):
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
    steps = np.diff(counter[:, 0])
    usual = max(float(np.median(steps % _WRAPS)), 1.0)
    # half the range back is a reset
    steps = np.where(steps % _WRAPS < _WRAPS // 2, steps % _WRAPS, steps)
    jumps[1:] = steps > usual
    return np.append(0.0, np.cumsum(steps / usual)), jumps


def _rate(table: Table, rate: float | None) -> float:
    """The given sample rate, or the file's."""
    if rate is not None:
        return checks.above_zero("rate", rate, "a sample rate above 0, Hz")
    if len(table.rates) > 1:
        found = " and ".join(f"{x:g}" for x in table.rates)
        raise GyroLogError(f"found the sample rates {found} Hz; accepted: one, or rate, to say it")
    return table.rates[0]


def _check(table: Table, kept: int, bad: list[str], n: int) -> None:
    """Refuse a log of too few samples; warn if many rows are left out."""
    if kept < 2:
        raise GyroLogError(f"found {kept} of {n} rows that are samples; accepted: at least two")
    if n - kept > _MANY * n:
        counts = "; ".join(bad)
        warnings.warn(
            f"{table.name}: {n - kept} of {n} rows are left out ({counts})",
            GyroLogWarning,
            stacklevel=3,
        )
