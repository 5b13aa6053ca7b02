"""Reading of gyro logs: columns and units recognised, samples in order and in SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.gyro import columns as names
from fastatt.gyro import stamps
from fastatt.gyro.columns import ACCEL_UNITS, ANGLES, UNITS
from fastatt.gyro.intervals import REGULAR
from fastatt.gyro.invalid_rows import ON_BAD_ROWS, in_order
from fastatt.gyro.log import VALUES, GyroLog, GyroLogError, GyroLogWarning
from fastatt.gyro.tables import Table, in_memory, tabular
from fastatt.gyro.text import from_text

Floats = NDArray[np.float64]
_WRAPS = 1 << 16
_MANY = 0.01  # share of rows; leaving out more is warned of
_ACCEPTED = {
    "unit": UNITS | ANGLES, "values": VALUES, "time_unit": names.TIME_UNITS,
    "accel_unit": ACCEL_UNITS,
}  # fmt: skip


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
        the log. It is a ``ValueError``, whose message names what was found, its line, and the
        argument that helps.
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
    checks.choice("on_bad_rows", on_bad_rows, ON_BAD_ROWS)
    words = {"unit": unit, "values": values, "time_unit": time_unit, "accel_unit": accel_unit}
    for argument, word in words.items():
        if word is not None:
            checks.choice(argument, word, _ACCEPTED[argument])
    if max_gap is not None:
        max_gap = checks.above_zero("max_gap", max_gap, "a number above 0, s", finite=False)
    pairs = _pairs(rows)
    table = in_memory(source) if tabular(source) else from_text(source, pairs or [])
    try:
        gyro, defined, values = _gyro(table, columns, unit, values)
        others = _others(table, defined, accel_columns, accel_unit, mag_columns)
        clock = _clock(table, time_column, defined) if rate is None else stamps.Clock()
        hertz = math.nan if clock.columns else _rate(table, rate)
        counter = _counter(table, stamped=bool(clock.columns))
        chosen = None if pairs is None else [(table.index(c, "rows"), text) for c, text in pairs]
        sensors = {"gyro": gyro, **others, "counter": names.Sensor(counter)}
        wanted = {name: sensor.columns for name, sensor in sensors.items()}
        numbers, raw = table.read(wanted, clock, chosen, strict=on_bad_rows == "refuse")
        with np.errstate(over="ignore"):
            for name in numbers:
                numbers[name] *= sensors[name].scale
            count, jumps = _counted(numbers.pop("counter", None), len(numbers["gyro"]))
            t, start = count / hertz, 0.0
        if raw is not None:
            t, start = clock.times(raw, time_unit)
        elif rate is not None:
            _check_rate(table, time_column, time_unit, defined, hertz)
        clock_name = " and ".join(table.column(i) for i in clock.columns or counter)
        times, kept, bad = in_order(
            table, clock_name, t, numbers["gyro"], on_bad_rows, max_gap, jumps
        )
        _check(table, len(kept), bad, len(t))
    except GyroLogError as error:
        raise GyroLogError(f"{table.name}: {error}") from None
    timing = f"time stamps in {clock_name}" if clock.columns else f"{hertz:g} Hz"
    said = [gyro.said, *(sensor.said for sensor in others.values() if sensor.said), *bad]
    step = 0.0 if clock.columns or bad else 1.0 / hertz
    log = _log(numbers, times, kept, step, values)
    first = f"{table.name}: {len(kept)} samples at {log.rate:.6g} Hz ({timing})"
    start += float(t[kept[0]])
    return replace(log, start=start, summary="; ".join([first, *said]))


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


def _gyro(
    table: Table, columns: Sequence[str] | None, unit: str | None, values: str | None
) -> tuple[names.Sensor, names.Format | None, str]:
    """The gyro, as given or recognised, the format that defines it, and what its numbers are."""
    triple = _gyro_columns(table, columns)
    axes = [table.column(i) for i in triple]
    defined = names.format_of(table.names, axes, table.name)
    usual = defined.values if defined else "samples"
    values = values or usual
    if defined and values != usual:
        raise GyroLogError(
            f"values: found {values!r}; accepted: {usual!r}, which the format of {axes[0][:60]} "
            "defines, or none"
        )
    unit = names.rate_unit(axes, unit, values, defined)
    scales = ANGLES if values == "increments" else UNITS
    if unit is None:
        raise GyroLogError(
            f"{axes[0][:60]} has no unit; accepted: unit, one of {', '.join(scales)}"
        )
    over = f", {values} over the intervals before" if values != "samples" else ""
    gyro = names.Sensor(triple, scales[unit], f"{', '.join(axes)} in {unit}{over}")
    return gyro, defined, values


def _gyro_columns(table: Table, columns: Sequence[str] | None) -> list[int]:
    if columns is not None:
        return table.chosen(columns, 3, "columns")
    for i in names.repeated(table.names):
        raise GyroLogError(f"found the column {table.names[i][:60]!r} twice; {table.by_number()}")
    gyros = names.gyros(table.names, table.name)
    if len(gyros) > 1:
        several = names.listed(table.names[i] for axes in gyros for i in axes)
        raise GyroLogError(f"found more than one gyro ({several}); say which with columns")
    if not gyros:
        raise GyroLogError(
            f"found no three columns named like gyro x, y, z among {table.shown()}; name them with "
            "columns (names or numbers from 1)"
        )
    return gyros[0]


def _others(
    table: Table,
    defined: names.Format | None,
    accel_columns: Sequence[str] | None,
    accel_unit: str | None,
    mag_columns: Sequence[str] | None,
) -> dict[str, names.Sensor]:
    """The other sensors, as given or known by their names."""
    others = {x: names.other_sensor(table.names, x, defined) for x in ("accel", "mag")}
    if mag_columns is not None:
        triple = table.chosen(mag_columns, 3, "mag_columns")
        said = f"magnetometer: {table.column(triple[0])[:60]} ..."
        others["mag"] = names.Sensor(triple, said=said)
    if accel_columns is not None:
        triple = table.chosen(accel_columns, 3, "accel_columns")
        name = table.column(triple[0])[:60]
        known = names.unit_of_other("accel", name, defined)
        if accel_unit not in (ACCEL_UNITS if known is None else (None, known)):
            accepted = ", ".join(ACCEL_UNITS) if known is None else f"{known}, or none"
            raise GyroLogError(f"accel_unit: found {accel_unit!r} for {name}; accepted: {accepted}")
        unit = known or str(accel_unit)
        said = f"accelerometer in {unit}: {name} ..."
        others["accel"] = names.Sensor(triple, ACCEL_UNITS[unit], said)
    elif accel_unit is not None:
        raise GyroLogError(f"accel_unit: found {accel_unit!r}; accepted: with accel_columns alone")
    return others


def _clock(table: Table, time_column: Any, defined: names.Format | None) -> stamps.Clock:
    """The columns of the time stamps; none if the file states its sample rate."""
    if time_column is not None:
        # a name or number, or two: of seconds and of nanoseconds
        parts = time_column if isinstance(time_column, (list, tuple)) else [time_column]
        columns = table.chosen(parts, 2 if len(parts) > 1 else 1, "time column")
    else:
        columns = names.clock(table.names, defined)
    cells = [table.first_row[i] for i in columns]
    if table.rates and cells[:1] in ([], [""]):  # an empty column
        return stamps.Clock()
    if not columns:
        raise GyroLogError(
            f"found no time column and no sample rate among {table.shown()}; give a rate in Hz or "
            "a time column"
        )
    name = table.column(columns[0])
    if len(columns) > 1:
        return stamps.Clock(columns, ["int", "int"], name[:60], "ns", "parts in s and ns")
    if (how := stamps.kind(cells[0])) == "date":
        return stamps.Clock(columns, [how], name[:60], "ns", "dates")
    return stamps.Clock(columns, [how], name[:60], names.time_unit(name, defined))


def _rate(table: Table, rate: float | None) -> float:
    """The given sample rate, or the file's."""
    if rate is not None:
        return checks.above_zero("rate", rate, "a sample rate above 0, Hz")
    if len(table.rates) > 1:
        rates = " and ".join(f"{x:g}" for x in table.rates)
        raise GyroLogError(f"found the sample rates {rates} Hz; accepted: one, or rate, to say it")
    return table.rates[0]


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


def _check_rate(
    table: Table, time_column: Any, time_unit: str | None, defined: names.Format | None, rate: float
) -> None:
    """Refuse a rate that contradicts time stamps, if the table has a column of these."""
    try:
        clock = _clock(table, time_column, defined)
    except GyroLogError:  # none, or one of several: nothing contradicts the rate
        return
    if clock.columns:
        clock.check_rate(table.stamps_in(clock), time_unit, rate)


def _check(table: Table, kept: int, bad: list[str], n: int) -> None:
    """Refuse a log of too few samples; warn if many rows are left out."""
    if kept < 2:
        raise GyroLogError(f"found {kept} of {n} rows that are samples; accepted: at least two")
    if n - kept > _MANY * n:
        text = f"{table.name}: {n - kept} of {n} rows are left out ({'; '.join(bad)})"
        rounding.warn(text, GyroLogWarning)


def _log(
    numbers: dict[str, Floats], times: Floats, rows: NDArray[np.int64], step: float, values: str
) -> GyroLog:
    """The log of some rows, at ``times``; ``step`` is their interval, 0 where it is unknown.

    Means and increments belong to the intervals that end at the times. The row whose interval is
    unknown is left out.
    """
    dt = np.diff(times)
    if step:
        dt[:] = step
    rate = 1.0 / float(np.mean(dt[dt <= REGULAR * np.median(dt)]))
    if values != "samples" and step:
        times, dt = np.append(0.0, times + step), np.append(step, dt)
    elif values != "samples":
        rows = rows[1:]
    measured = {name: x if len(rows) == len(x) else x[rows] for name, x in numbers.items()}
    if values == "increments":
        measured["gyro"] /= dt[:, None]
    accel, mag = measured.get("accel"), measured.get("mag")
    return GyroLog(measured["gyro"], dt, times, rate, accel, mag, values=values)
