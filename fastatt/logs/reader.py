"""A gyro log a chunk at a time: columns and units found, samples in order and in SI units."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.logs import names, stamps
from fastatt.logs.blocks import NO_STAMP, Block, Table, opened
from fastatt.logs.frames import Frame, tabular
from fastatt.logs.head import Layout
from fastatt.logs.names import STANDARD_GRAVITY, TIME_UNITS, UNITS, Columns, LogError, LogWarning
from fastatt.logs.stamps import BAD, Chunk, Mending

_LOOK = 10_000  # rows that tell what units there are
# rad/s, the range of most gyros (2000 deg/s); deg/s, and of any
_MOST_RAD, _MOST_DEG = 35.0, 4500.0
# rad/s of a bias, rad of a turn about it: above, a body is not at rest
_LARGEST_BIAS, _LARGEST_TURN = 0.2, 0.05


@dataclass(frozen=True)
class Options:
    """How a log is to be read, as ``read_log`` describes it; what is None is found."""

    columns: Sequence[str] | None = None
    unit: str | None = None
    rate: float | None = None
    time_column: str | None = None
    time_unit: str | None = None
    attitude_columns: Sequence[str] | None = None
    bad: str = "refuse"
    max_gap: float | None = None
    bias_seconds: float | None = None
    beside: tuple[str, ...] = ("accel", "mag", "quat")  # what is read beside the rates

    def __post_init__(self) -> None:
        for name, known in (("unit", UNITS), ("time_unit", TIME_UNITS), ("bad", BAD)):
            if (word := getattr(self, name)) is not None:
                checks.choice(name, word, known)
        if self.rate is not None:
            rate = checks.real("rate", self.rate)
            if not (rate > 0.0 and math.isfinite(1.0 / rate)):
                raise LogError(f"rate: found {rate}; accepted: a sample rate above 0, Hz")
        for name in ("max_gap", "bias_seconds"):
            if (value := getattr(self, name)) is not None:
                number = checks.any_real(name, value, "a number above 0")
                if not number > 0.0:
                    raise LogError(f"{name}: found {number}; accepted: a number above 0, s")
                object.__setattr__(self, name, number)


@contextmanager
def reading(
    source: Any, options: Options, progress: Callable[[int], object] | None = None
) -> Iterator[Reader]:
    """A log whose head was read, and whose samples are to come."""
    if tabular(source):
        yield Reader(Frame(source), options)
        return
    with opened(source) as (name, stream):
        yield Reader(Table(name, stream, progress), options)


class Reader:
    """A log's columns and units, then its samples in chunks; all is known after the last."""

    def __init__(self, table: Table | Frame, options: Options) -> None:
        self.table, self.options = table, options
        self.layout: Layout = table.layout
        self.columns = _columns(self.layout, options)
        self.names = tuple(self.layout.column(i) for i in self.columns.gyro)
        self.rate = None if self.columns.clock is not None else _rate(self.layout, options)
        try:
            said = options.unit or names.rate_unit(self.names)
        except LogError as error:
            raise self.layout.error(error) from None
        self.unit, self.assumed = said or "rad/s", said is None
        self.samples, self.end, self.start = 0, 0.0, 0.0
        self.bias, self.accel_unit = np.zeros(3), "a unit not known"
        self.mending = Mending(self.layout, options.bad, options.max_gap)

    @property
    def unit_said(self) -> str:
        """The unit of the rates, and whether it was assumed."""
        return f"{self.unit} (assumed)" if self.assumed else self.unit

    @property
    def timing(self) -> str:
        """Where times come from."""
        return f"{self.rate:g} Hz" if self.rate is not None else f"time stamps in {self._clock}"

    @property
    def _clock(self) -> str:
        return "" if self.columns.clock is None else self.layout.column(self.columns.clock)

    def dt(self, t: NDArray[np.float64]) -> float | NDArray[np.float64]:
        """The interval, or those between times."""
        if self.rate is None or self.options.bad in ("drop", "split"):
            return np.diff(t)
        return 1.0 / self.rate

    def chunks(self) -> Iterator[Chunk]:
        """The samples in SI units, without bias."""
        chunks = self._in_order()
        if self.options.bias_seconds is not None:
            chunks = self._without_bias(chunks, self.options.bias_seconds)
        for chunk in chunks:
            if len(chunk.t):
                self.samples += len(chunk.t)
                self.end = float(chunk.t[-1])
                yield chunk
        if not self.samples:
            raise self.layout.error("found no sample; accepted: one at least")
        if self.rate is None and self.samples == 1:
            raise self.layout.error("found one row; accepted with time stamps: at least two")

    def summary(self) -> str:
        """What was understood and done, in one line."""
        hertz = (self.samples - 1) / self.end if self.end else self.rate or math.nan
        said = [
            f"{self.layout.name}: {self.samples} samples at {hertz:.6g} Hz ({self.timing})",
            f"{', '.join(self.names)} in {self.unit_said}",
        ]
        beside = {
            f"accelerometer in {self.accel_unit}": self.columns.accel,
            "magnetometer": self.columns.mag,
        }
        said += [f"{name}: {self.layout.column(x[0])} ..." for name, x in beside.items() if x]
        if self.options.bias_seconds is not None:
            said.append(f"bias {', '.join(f'{b:.3g}' for b in self.bias)} rad/s taken off")
        return "; ".join([*said, *self.mending.told()])

    def _in_order(self) -> Iterator[Chunk]:
        """Samples in SI units, in order."""
        wanted, clock = self.columns.values, self.columns.clock
        blocks = self.table.rows(clock, wanted, mend=self.options.bad != "refuse")
        first: list[Block] = []
        while sum(len(b.values) for b in first) < _LOOK and (block := next(blocks, None)):
            first.append(block)
        values = np.concatenate([b.values for b in first])[:_LOOK]
        if self.assumed:
            self._choose_unit(_largest(values[:, :3]))
        scales = np.ones(len(wanted))
        scales[:3] = UNITS[self.unit]
        if self.columns.accel:
            scales[3:6] = self._accel_scale(values[:, 3:6])
        times = self._times(first)
        for block in chain(first, blocks):
            most = _largest(block.values[:, :3]) if self.assumed and self.unit == "rad/s" else 0.0
            if most > _MOST_RAD:
                raise self.layout.error(
                    f"the rates have no unit, were at most {_MOST_RAD:g} in the first rows and "
                    f"reach {most:.4g} later; accepted: unit, rad/s or deg/s"
                )
            if (scales != 1.0).any():
                np.multiply(block.values, scales, out=block.values)
            yield self.mending.mended(block, times(block), self._clock)

    def _times(self, first: list[Block]) -> Callable[[Block], NDArray[np.float64]]:
        """Times of blocks, s from the first sample."""
        rate, row = self.rate, 0
        if rate is None:
            assert self.columns.clock is not None
            clock = self.columns.clock
            of, self.start, usual = times(self.layout, clock, first, self.options.time_unit)
            self.mending.set_usual(usual)
            return of
        self.mending.set_usual(1.0 / rate)

        def at_a_rate(block: Block) -> NDArray[np.float64]:
            nonlocal row
            first, row = row, row + len(block.values)
            with np.errstate(over="ignore"):
                t = np.arange(first, row) / rate
            if not np.isfinite(t[-1:]).all():
                raise self.layout.error(
                    f"found {row} samples at the rate {rate:g} Hz; accepted: more"
                )
            return t

        return at_a_rate

    def _choose_unit(self, most: float) -> None:
        """Take a unit that nothing says from the largest of the first rates."""
        if most > _MOST_DEG:
            raise self.layout.error(
                f"the rates have no unit and reach {most:.4g}; accepted: unit, rad/s or deg/s; the "
                "counts of a sensor have to be scaled first"
            )
        self.unit = "rad/s" if most <= _MOST_RAD else "deg/s"
        warnings.warn(
            f"{self.layout.name}: {self.names[0][:60]} has no unit: taken as {self.unit} (at most "
            f"{most:.3g} in the first rows); unit says another",
            LogWarning,
            stacklevel=2,
        )

    def _accel_scale(self, accel: NDArray[np.float64]) -> float:
        """m/s² in the accelerometer's unit: by its name, else where it shows gravity in g."""
        place = self.columns.accel
        assert place is not None
        scale = names.accel_unit(self.layout.column(place[0]))
        usual = float(np.median(np.sqrt((accel * accel).sum(axis=1))))
        scale = scale or (STANDARD_GRAVITY if 0.8 < usual < 1.25 else None)
        if scale is not None or 0.8 < usual / STANDARD_GRAVITY < 1.25:
            self.accel_unit = "m/s²" if scale in (1.0, None) else "g"
        return scale or 1.0

    def _without_bias(self, chunks: Iterator[Chunk], wanted: float) -> Iterator[Chunk]:
        """Take off the mean rate of a start at rest.

        Raises ``LogError`` where the log is shorter, or the body moves.
        """
        first: list[Chunk] = []
        for chunk in chunks:
            first.append(chunk)
            if len(chunk.t) and chunk.t[-1] >= wanted:
                break
        t = np.concatenate([c.t for c in first])
        rest = t < wanted
        if not len(t) or rest.all():
            raise self.layout.error(f"bias_seconds: found {wanted:g}; accepted: less than the log")
        rates = np.concatenate([c.values for c in first])[rest, :3]
        if len(rates) == 1:
            raise self.layout.error(
                f"bias_seconds: found one sample in the first {wanted:g} s, which tells no rest; "
                "accepted: at least two"
            )
        bias = rates.mean(axis=0)
        turn = np.cumsum((rates[:-1] - bias) * np.diff(t[rest])[:, None], axis=0)
        if _largest(bias) > _LARGEST_BIAS or (len(turn) and _largest(turn) > _LARGEST_TURN):
            raise self.layout.error(
                f"bias_seconds: the body is not at rest in the first {wanted:g} s (mean rate "
                f"{_largest(bias):.3g} rad/s, turn about it {_largest(turn):.3g} rad); accepted: "
                f"at most {_LARGEST_BIAS:g} rad/s and {_LARGEST_TURN:g} rad"
            )
        self.bias = bias
        for chunk in chain(first, chunks):
            chunk.values[:, :3] -= bias
            yield chunk


def times(
    layout: Layout, clock: int, first: list[Block], time_unit: str | None
) -> tuple[Callable[[Block], NDArray[np.float64]], float, float]:
    """Times of blocks, s from the first stamp; what its clock says, s; the usual interval, s.

    The first blocks tell the unit, where it is not said.
    """
    column = np.concatenate([b.stamps for b in first if b.stamps is not None])[:_LOOK]
    column = column[np.isfinite(column) if column.dtype.kind == "f" else column != NO_STAMP]
    if not len(column):
        raise layout.error(f"{layout.column(clock)[:60]} has no time stamp in its first rows")
    zero = column[0]
    unit = stamps.unit_of(layout, clock, column, time_unit)
    gaps = np.diff(stamps.seconds(column, zero, unit))
    gaps = gaps[np.isfinite(gaps) & (gaps > 0.0)]
    usual = float(np.median(gaps)) if len(gaps) else math.inf
    start = float(zero) / TIME_UNITS[unit]
    return lambda block: stamps.seconds(np.asarray(block.stamps), zero, unit), start, usual


def _largest(x: NDArray[np.float64]) -> float:
    """The largest finite absolute value, 0 where there is none."""
    return float(np.max(np.abs(x), initial=0.0, where=np.isfinite(x)))


def _columns(layout: Layout, options: Options) -> Columns:
    """Columns as said or as their names are understood."""
    try:
        gyro = layout.chosen(options.columns, 3, "columns")
        gyro = gyro or names.gyro(layout.names, layout.about)
        if gyro is None:
            raise LogError(
                f"found no three columns named like gyro x, y, z among {layout.shown()}; name them "
                "with columns (names or numbers from 1)"
            )
        clock = None
        if options.rate is None:
            said = options.time_column
            clock = names.clock(layout.names) if said is None else layout.index(said, "time column")
            if clock is None and not layout.rates:
                raise LogError(
                    f"found no time column and no sample rate among {layout.shown()}; give a rate "
                    "in Hz or a time column"
                )
    except LogError as error:
        text = str(error)
        raise LogError(text) if text.startswith(layout.name) else layout.error(text) from None
    found: dict[str, list[Any]] = {
        "accel": names.triples(layout.names, "accel"),
        "mag": names.triples(layout.names, "mag"),
        "quat": [names.quaternion(layout.names)],
    }
    beside = {k: x[0] if len(x) == 1 else None for k, x in found.items() if k in options.beside}
    if options.attitude_columns is not None:
        beside["quat"] = layout.chosen(options.attitude_columns, 4, "attitude columns")
    return Columns(gyro, clock, **beside)


def _rate(layout: Layout, options: Options) -> float:
    """The sample rate that is said, or the file's."""
    if options.rate is not None:
        return float(options.rate)
    if len(layout.rates) > 1:
        found = " and ".join(f"{x:g}" for x in layout.rates)
        raise layout.error(f"found the sample rates {found} Hz; accepted: one, or rate, to say it")
    (rate,) = layout.rates
    if not stamps.SLOWEST < rate <= stamps.FASTEST:
        raise layout.error(
            f"the sample rate: found {rate:g} Hz; {stamps.PLAUSIBLE}, or any, given as rate"
        )
    return rate
