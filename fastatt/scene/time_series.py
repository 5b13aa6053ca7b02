"""Tables sampled in time, such as orbit positions, fields, densities or commands.

A table lies in memory as a row of numbers: a head with its layout, an index if times are not
equally spaced, then the samples. Formulas find all of it by position, so that one compiled program
serves tables with other numbers.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.tracing import graph
from fastatt.tracing.graph import Double, Recorded
from fastatt.tracing.replacements import unknown_in

Numbers = NDArray[np.float64]

_BUCKETS = 2**22
# by which slopes from a polynomial may magnify the noise of values over the longer of two
# neighbouring intervals; at the ends of equal intervals n values magnify less than 2^n
_MAGNIFIED = 32.0
# rounding of a run's time, which may end just beyond a table
_SLACK = 16.0 * float(np.finfo(np.float64).eps)


class Head(NamedTuple):
    """What a table in memory begins with.

    First and last time of the samples; the width of an interval, or of a bucket of the index, and
    the number of the last one; first and last time that is accepted; the number of rows, and of
    numbers in a row; the number of the last interval; where the times and the samples begin. The
    index lies between the head and the times.
    """

    first: float
    end: float
    width: float
    last: float
    low: float
    high: float
    rows: float
    row: float
    interval: float
    times: float
    samples: float


_SIZE = len(Head._fields)


class TableLayout(NamedTuple):
    """What the formula of a look-up depends on: numbers per sample, and their interpolation."""

    size: int
    cubic: bool
    uniform: bool
    holds: bool
    by_row: bool
    steps: bool

    @property
    def stride(self) -> int:
        """Numbers of memory per sample: the values, and for a cubic its other coefficients."""
        return self.size * (4 if self.cubic else 1)


class TimeSeries:
    """A table of numbers sampled in time, for user-defined functions and for models.

    ``table(t)``, or ``table(t, row)`` for values (N, T, k), returns a tuple of k floats, or a float
    for values (T,). Both may be called within a user-defined function, with ``row`` a parameter of
    the body such as ``p[0]``. Tables with equal values are equal; ``table[rows]`` is a table of
    some of the rows.

    Parameters
    ----------
    t : array_like of shape (T,)
        Increasing times, s, at least two. Tables with equal intervals are evaluated fastest.
    values : array_like of shape (T,), (T, k) or (N, T, k)
        Samples for all bodies, or with one row for each of N bodies.
    kind : {"cubic", "linear", "previous"}, default "cubic"
        The interpolation. "cubic" has a continuous derivative. "previous" is a zero-order hold:
        each sample holds from its time to the next.
    slopes : array_like, optional
        Time derivatives of the values, in their shape, if they are known, such as the velocities of
        an ephemeris. The default is the derivatives of the quartics through five samples.
    outside : {"nan", "hold"}, default "nan"
        The result at times outside the table: NaN, which sets the status of the body, or the
        nearest sample. An index ``row`` out of range gives NaN.

    Raises
    ------
    TypeError, ValueError
        If the times do not increase, numbers are not finite or have the wrong shape, or intervals
        differ so much that the index of the table would be too large.

    Notes
    -----
    For samples h apart of a function whose derivatives are at most M2, M4 and M5, the error is at
    most h² M2/8 (linear) or h⁴ M4/384 + h⁵ M5/20 (cubic; without the second term if slopes are
    given). Where a quartic would magnify noise, since samples nearly coincide, the default slope is
    that between the samples before and after.

    Steps of a run end at the samples of a "linear" or "previous" table that a model uses, and of
    the tables of ``torques.Rotor`` and ``torques.QuaternionPD``, as at ``breakpoints`` of the
    scene. For a table that a user-defined function reads, declare ``breakpoints=table.t``.

    References
    ----------
    De Boor, *A Practical Guide to Splines* (2001), chapters II and IV.

    Examples
    --------
    >>> import fastatt as fa
    >>> density = fa.TimeSeries([0.0, 1.0, 2.0], [0.0, 1.0, 4.0])
    >>> density(1.5), density.slope(1.5)
    (2.25, 3.0)
    """

    def __init__(
        self,
        t: ArrayLike,
        values: ArrayLike,
        *,
        kind: str = "cubic",
        slopes: ArrayLike | None = None,
        outside: str = "nan",
    ) -> None:
        times = checks.array("t", t, "(T,)").astype(np.float64)
        if len(times) < 2:
            raise ValueError("t: found 1 time; accepted: at least 2")
        gaps = np.diff(times)
        if not (gaps > 0.0).all():
            k = int(np.argmin(gaps > 0.0)) + 1
            raise ValueError(
                f"t[{k}] is {times[k]} after {times[k - 1]}; accepted: ascending times"
            )
        cubic = checks.choice("kind", kind, ("cubic", "linear", "previous")) == "cubic"
        steps = kind == "previous"
        holds = checks.choice("outside", outside, ("nan", "hold")) == "hold"
        shape = checks.numbers("values", values, "numbers").shape
        samples = _samples("values", values, len(times))
        of = None if slopes is None else checks.numbers("slopes", slopes, "numbers").shape
        if slopes is not None and (not cubic or of != shape):
            raise ValueError(
                f"slopes: found of shape {of} for {kind} values {shape}; accepted: "
                "of the same shape, for cubic ones"
            )
        n, size = len(times), samples.shape[-1]
        slack = _SLACK * float(np.abs(times[[0, -1]]).max())
        width = (times[-1] - times[0]) / (n - 1)
        # a held sample begins at its time exactly
        even = np.abs(times[0] + width * np.arange(n) - times).max() <= slack
        uniform = bool(even) and not steps
        if cubic:
            if slopes is None:
                known = derivatives(times, samples.swapaxes(0, 1), min(5, n)).swapaxes(0, 1)
            else:
                known = _samples("slopes", slopes, n)
            widths = np.full(n - 1, width) if uniform else gaps
            samples = _polynomials(samples, known, widths[:, None])
        index = np.zeros(0) if uniform else _index(times)
        buckets = n - 1 if uniform else len(index) - n
        self.scalar = len(shape) == 1
        self.layout = TableLayout(size, cubic, uniform, holds, len(shape) == 3, steps)
        head = Head(
            first=times[0], end=times[-1], width=width if uniform else gaps.min(),
            last=buckets - 1.0, low=times[0] - slack, high=times[-1] + slack, rows=len(samples),
            row=samples[0].size, interval=n - 2.0, times=_SIZE + len(index) - n,
            samples=_SIZE + len(index),
        )  # fmt: skip
        self._keep(head, index, samples)

    def _keep(self, *parts: ArrayLike) -> None:
        #: the table in memory, as formulas find it
        self.data: Numbers = np.concatenate([np.ravel(x) for x in parts])
        self.data.setflags(write=False)

    @property
    def _head(self) -> Head:
        return Head(*self.data[:_SIZE].tolist())

    @cached_property
    def digest(self) -> str:
        """A hash that is equal for equal tables."""
        text = repr((self.layout, self.scalar)).encode()
        return hashlib.sha256(text + self.data.tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TimeSeries) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        rows = f"{self.rows} rows of " if self.layout.by_row else ""
        start, end = self.span
        return f"<TimeSeries: {rows}{self.layout.size} numbers, {start:g} s to {end:g} s>"

    @property
    def t(self) -> Numbers:
        """Times of the samples, s, of shape (T,)."""
        head = self._head
        n = int(head.interval) + 2
        if self.layout.uniform:
            return np.asarray(head.first + head.width * np.arange(n))
        return self.data[int(head.times) :][:n]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return self._head.first, self._head.end

    @property
    def rows(self) -> int:
        """Number of rows; 1 for a table that all bodies share."""
        return int(self._head.rows)

    @property
    def samples(self) -> Numbers:
        """The values: (rows, T, k)."""
        numbers = self.data[int(self._head.samples) :]
        return numbers.reshape(self.rows, -1, self.layout.stride)[..., : self.layout.size]

    def __getitem__(self, rows: Any) -> TimeSeries:
        if not self.layout.by_row:
            raise TypeError(f"table[rows]: found {self!r}; accepted: a table of values (N, T, k)")
        begin = int(self._head.samples)
        chosen = np.atleast_2d(self.data[begin:].reshape(self.rows, -1)[rows])
        table = object.__new__(TimeSeries)
        table.layout, table.scalar = self.layout, self.scalar
        head = self._head._replace(rows=len(chosen))
        table._keep(head, self.data[_SIZE:begin], chosen)
        return table

    __iter__ = None

    def __call__(self, t: Any, row: Any = None) -> Any:
        """The interpolated numbers at time t, s, in a row."""
        return self._read(t, row)[0]

    def slope(self, t: Any, row: Any = None) -> Any:
        """Time derivatives of the interpolated numbers.

        Parameters
        ----------
        t : float
            Time, s.
        row : int, optional
            Index of the row, for a table of values (N, T, k).

        Returns
        -------
        tuple of float, or float
            The derivatives of the k numbers, or of one.
        """
        return self._read(t, row)[1]

    def _read(self, t: Any, row: Any) -> Any:
        if (row is None) == self.layout.by_row:
            accepted = "table(t, row)" if self.layout.by_row else "table(t), one row is for all"
            raise TypeError(f"row: found {row!r}; accepted: {accepted}")
        row, size = 0.0 if row is None else row, self.layout.size
        numbers: tuple[Any, ...]
        like = unknown_in(t, row)
        if like is None:
            place = checks.real("t", t), checks.real("row", row)
            numbers = tuple(map(float, self.numbers_at(*map(np.float64, place))))
        else:  # in a function of users
            numbers = like.recorder.look_up(self, 2 * size, t, row)
        pair = numbers[:size], numbers[size:]
        return tuple(x[0] for x in pair) if self.scalar else pair

    def numbers_at(self, t: Any, row: Any) -> tuple[Any, ...]:
        """Values, then slopes, for arrays of times and rows.

        Parameters
        ----------
        t, row : ndarray
            Times, s, and indices of rows, which broadcast.

        Returns
        -------
        tuple of ndarray
            The k values, then the k slopes.
        """

        def take(place: Any, count: int) -> Any:
            first = np.asarray(place).astype(np.int64)
            return [self.data[first + k] for k in range(count)]

        with np.errstate(invalid="ignore", over="ignore"):
            return _look_up(self.layout, t, row, _Ways(take, np.floor, np.where))

    def traced_at(self, t: Any, row: Any) -> tuple[Any, ...]:
        """Values, then slopes, as operations of a compiled loop.

        Parameters
        ----------
        t, row : number of a graph
            Time, s, and index of the row.

        Returns
        -------
        tuple of numbers of the graph
            The k values, then the k slopes.
        """
        return recorded(self, self.layout, t, row)

    def at(self, times: ArrayLike) -> Numbers:
        """Interpolate at many times.

        Parameters
        ----------
        times : array_like of shape (S,)
            Times, s.

        Returns
        -------
        ndarray of shape (S, k) or (S, N, k)
            The interpolated numbers.

        Raises
        ------
        ValueError, TypeError
            If ``times`` are no numbers, or of another shape.
        """
        instants = checks.array("times", times, "(S,)", [(-1,), (0,)], flag=True).astype(np.float64)
        numbers = self.numbers_at(instants[:, None], np.arange(float(self.rows)))
        values = numbers[: self.layout.size]
        return np.stack(values, axis=-1) if self.layout.by_row else np.concatenate(values, axis=-1)


class _Ways(NamedTuple):
    """How a formula takes so many numbers from a position on, rounds down and chooses."""

    take: Callable[[Any, int], Any]
    floor: Callable[[Any], Any]
    choose: Callable[[Any, Any, Any], Any]


def recorded(name: Any, layout: TableLayout, t: Any, row: Any = None) -> tuple[Any, ...]:
    """Values, then slopes, of traced numbers, from the table that memory has under a name."""
    # the floor of a dual number is a node of its graph
    of = graph.apply("floor", t if isinstance(t, Recorded) else row).graph

    def double(x: Any) -> Any:
        return Double(x) if isinstance(x, Recorded) else graph.number(of, x, "double")

    def take(place: Any, count: int) -> Any:
        return graph.row(name, double(place), count)

    ways = _Ways(take, lambda x: graph.apply("floor", x), graph.choose)
    return _look_up(layout, double(t), double(0.0 if row is None else row), ways)


def _look_up(layout: TableLayout, t: Any, row: Any, ways: _Ways) -> tuple[Any, ...]:
    """Values, then slopes, at t in a row. Positions are within the table for any numbers."""
    take, floor, choose = ways
    head = Head(*take(0.0, _SIZE))
    inside = (t >= head.low) & (t <= head.high)
    if layout.holds:
        t = choose(t < head.first, head.first, t)
        t = choose(t > head.end, head.end, t)
    s = (t - head.first) / head.width
    k = floor(choose(s > 0.0, s, 0.0))
    k = choose(k < head.last, k, head.last)
    width = head.width
    if layout.uniform:
        f = s - k
    else:
        (k,) = take(_SIZE + k, 1)
        if layout.steps:
            (begin,) = take(head.times + k, 1)
            k = choose((t < begin) & (k > 0.0), k - 1.0, k)
        begin, middle, end = take(head.times + k, 3)
        is_next = (t >= middle) & (k < head.interval)
        k = choose(is_next, k + 1.0, k)
        begin, end = choose(is_next, middle, begin), choose(is_next, end, middle)
        width = end - begin
        f = (t - begin) / width
        if layout.steps:  # 1 at the last sample only; NaN stays
            f = choose(t >= end, 1.0, choose(t < end, 0.0, f))
    sample = head.samples + float(layout.stride) * k
    if layout.by_row:
        there = (row >= 0.0) & (row < head.rows) & (floor(row) == row)
        sample = sample + choose(there, row, 0.0) * head.row
    else:
        there = inside
    if layout.by_row or not layout.holds:
        known = there if layout.holds else inside & there
        f, width = choose(known, f, np.nan), choose(known, width, np.nan)
    numbers = take(sample, layout.stride if layout.cubic else 2 * layout.size)
    pairs = [
        _between(layout, numbers[c :: layout.size], f, width, choose) for c in range(layout.size)
    ]
    values, slopes = zip(*pairs, strict=True)
    return (*values, *(choose(inside, x, 0.0) if layout.holds else x for x in slopes))


def _between(layout: TableLayout, numbers: Sequence[Any], f: Any, width: Any, choose: Any) -> Any:
    """(value, slope) at a fraction f of an interval; NaN if f is.

    The numbers are the coefficients of a cubic, or the samples before and after.
    """
    if layout.cubic:
        a, b, c, d = numbers
        return a + f * (b + f * (c + f * d)), (b + f * (2.0 * c + f * (3.0 * d))) / width
    before, after = numbers
    if layout.steps:
        return choose(f < 1.0, before, choose(f >= 1.0, after, f)), choose(f < 2.0, 0.0, f)
    rise = after - before
    return before + f * rise, rise / width


def _polynomials(values: Numbers, slopes: Numbers, widths: Numbers) -> Numbers:
    """Coefficients of the cubic of each interval by powers of the fraction, (rows, T, 4 k).

    Of the last sample there is the value alone.
    """
    rise = np.diff(values, axis=1)
    begin, end = widths * slopes[:, :-1], widths * slopes[:, 1:]
    powers = [begin, 3.0 * rise - 2.0 * begin - end, begin + end - 2.0 * rise]
    others = np.pad(np.concatenate(powers, axis=-1), ((0, 0), (0, 1), (0, 0)))
    return np.concatenate([values, others], axis=-1)


def _samples(name: str, value: ArrayLike, n: int) -> Numbers:
    """Samples as (rows, T, k)."""
    samples = checks.array(name, value, f"({n},), ({n}, k) or (N, {n}, k)")
    samples = samples[:, None] if samples.ndim == 1 else samples
    return samples.reshape((-1, *samples.shape[-2:])).astype(np.float64)


def derivatives(t: Numbers, values: NDArray[Any], n: int) -> NDArray[Any]:
    """Derivatives (T, ...) of the polynomials through n values (T, ...) around each time.

    The n times are centred except near the ends (Berrut and Trefethen, *SIAM Review* 46 (2004),
    equation 9.4). A polynomial through times that nearly coincide would magnify the noise of the
    values: there the derivative is the slope between the two neighbours of the time.
    """
    itself = np.arange(len(t))
    first = np.clip(itself - (n - 1) // 2, 0, len(t) - n)
    places = first[:, None] + np.arange(n)
    node = itself - first
    gaps = t[places][:, :, None] - t[places][:, None, :]
    gaps[:, range(n), range(n)] = 1.0
    barycentric = 1.0 / gaps.prod(axis=2)
    weights = barycentric / barycentric[itself, node][:, None] / gaps[itself, node]
    weights[itself, node] = 0.0
    weights[itself, node] = -weights.sum(axis=1)
    slopes = np.einsum("tn,tn...->t...", weights, values[places])
    before, after = np.maximum(itself - 1, 0), np.minimum(itself + 1, len(t) - 1)
    reach = np.maximum(t - t[before], t[after] - t)
    poor = ~(reach * np.abs(weights).sum(axis=1) <= max(_MAGNIFIED, 2.0**n))
    a, b = before[poor], after[poor]
    slopes[poor] = ((values[b] - values[a]).T / (t[b] - t[a])).T
    return np.asarray(slopes)


def _index(t: Numbers) -> Numbers:
    """For buckets as wide as the shortest interval, the interval at their start; then the times."""
    gaps = np.diff(t)
    n = np.ceil((t[-1] - t[0]) / gaps.min())
    if n > _BUCKETS:
        raise ValueError(
            f"t: found intervals from {gaps.min():g} to {gaps.max():g} s; accepted: the shortest "
            f"at least the whole span through {_BUCKETS}"
        )
    starts = t[0] + gaps.min() * np.arange(n)
    intervals = np.searchsorted(t, starts, side="right") - 1.0
    return np.concatenate([np.minimum(intervals, len(t) - 2.0), t])


__all__ = ["TimeSeries"]
