"""Tables sampled in time, such as orbit positions, fields, densities or commands.

A table lies in memory as a row of numbers: a head with its layout, an index if times are not
equally spaced, then the samples. Formulas find all of it by position, so that one compiled program
serves tables with other numbers.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.tracing import functions, graph
from fastatt.tracing.graph import Double
from fastatt.tracing.nodes import Recorded

Numbers = NDArray[np.float64]

# the head: first and last time of the samples, the width of an interval (or of a bucket of the
# index) and the number of the last one, first and last time that is accepted, the number of rows
# and of numbers in a row, the number of the last interval, where the times (the index) and the
# samples begin
_FIRST, _END, _WIDTH, _LAST, _LOW, _HIGH, _ROWS, _ROW, _INTERVAL, _TIMES, _SAMPLES = range(11)
_HEAD = 11
_BUCKETS = 2**22
# by which slopes from a polynomial may magnify the noise of values over the longer interval beside;
# at the ends of equal intervals n values magnify less than 2^n
_MAGNIFIED = 32.0
# rounding of a run's time, which may end just beyond a table
_SLACK = 16.0 * float(np.finfo(np.float64).eps)


class TableLayout(NamedTuple):
    """What the formula of a look-up depends on: numbers per sample, and their interpolation."""

    size: int
    cubic: bool
    uniform: bool
    holds: bool
    own: bool
    steps: bool


class TimeSeries:
    """A table of numbers sampled in time, for user-defined functions and for models.

    ``table(t)``, or ``table(t, row)`` for values (N, T, k), returns a tuple of k floats, or a float
    for values (T,). Both may be called within a traced function, with ``row`` a parameter of the
    body such as ``p[0]``. Tables with equal values are equal; ``table[rows]`` is a table of some of
    the rows.

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
        if cubic:
            if slopes is None:
                known = derivatives(times, samples.swapaxes(0, 1), min(5, len(times)))
                known = known.swapaxes(0, 1)
            else:
                known = _samples("slopes", slopes, len(times))
            samples = np.concatenate([samples, known], axis=-1)
        n = len(times)
        slack = _SLACK * float(np.abs(times[[0, -1]]).max())
        width = (times[-1] - times[0]) / (n - 1)
        # a held sample begins at its time exactly
        even = np.abs(times[0] + width * np.arange(n) - times).max() <= slack
        uniform = bool(even) and not steps
        index = np.zeros(0) if uniform else _index(times)
        buckets = n - 1 if uniform else len(index) - n
        self.scalar = len(shape) == 1
        size = samples.shape[-1] // (2 if cubic else 1)
        self.form = TableLayout(size, cubic, uniform, holds, len(shape) == 3, steps)
        head = (
            times[0], times[-1], width if uniform else gaps.min(), buckets - 1.0, times[0] - slack,
            times[-1] + slack, len(samples), samples[0].size, n - 2.0, _HEAD + len(index) - n,
            _HEAD + len(index),
        )  # fmt: skip
        self._keep(head, index, samples)

    def _keep(self, *parts: ArrayLike) -> None:
        #: the table in memory, as formulas find it
        self.data: Numbers = np.concatenate([np.ravel(x) for x in parts])
        self.data.setflags(write=False)

    @cached_property
    def digest(self) -> str:
        """A hash that is equal for equal tables."""
        form = repr((self.form, self.scalar)).encode()
        return hashlib.sha256(form + self.data.tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TimeSeries) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        rows = f"{self.rows} rows of " if self.form.own else ""
        start, end = self.span
        return f"<TimeSeries: {rows}{self.form.size} numbers, {start:g} s to {end:g} s>"

    @property
    def t(self) -> Numbers:
        """Times of the samples, s, of shape (T,)."""
        n = int(self.data[_INTERVAL]) + 2
        if self.form.uniform:
            return np.asarray(self.data[_FIRST] + self.data[_WIDTH] * np.arange(n))
        return self.data[int(self.data[_TIMES]) :][:n]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time, s."""
        return float(self.data[_FIRST]), float(self.data[_END])

    @property
    def rows(self) -> int:
        """Number of rows; 1 for a table that all bodies share."""
        return int(self.data[_ROWS])

    @property
    def samples(self) -> Numbers:
        """The values: (rows, T, k)."""
        numbers = self.data[int(self.data[_SAMPLES]) :]
        return numbers.reshape(self.rows, -1, 1 + self.form.cubic, self.form.size)[:, :, 0]

    def __getitem__(self, rows: Any) -> TimeSeries:
        if not self.form.own:
            raise TypeError(f"table[rows]: found {self!r}; accepted: a table of values (N, T, k)")
        begin = int(self.data[_SAMPLES])
        chosen = np.atleast_2d(self.data[begin:].reshape(self.rows, -1)[rows])
        made = object.__new__(TimeSeries)
        made.form, made.scalar = self.form, self.scalar
        head = self.data[:_HEAD].copy()
        head[_ROWS] = len(chosen)
        made._keep(head, self.data[_HEAD:begin], chosen)
        return made

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
        if (row is None) == self.form.own:
            accepted = "table(t, row)" if self.form.own else "table(t), one row is for all"
            raise TypeError(f"row: found {row!r}; accepted: {accepted}")
        if any(isinstance(x, Recorded) for x in (t, row)):
            found = recorded(self, self.form, t, row)
        else:
            numbers = checks.real("t", t), 0.0 if row is None else checks.real("row", row)
            found = tuple(tuple(map(float, x)) for x in self._of_arrays(*map(np.float64, numbers)))
        return tuple(x[0] for x in found) if self.scalar else found

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
        given = checks.array("times", times, "(S,)", [(-1,), (0,)], flag=True).astype(np.float64)
        found = self._of_arrays(given[:, None], np.arange(float(self.rows)))[0]
        return np.stack(found, axis=-1) if self.form.own else np.concatenate(found, axis=-1)

    def _of_arrays(self, t: Any, row: Any) -> Any:
        def take(place: Any) -> Any:
            return self.data[np.asarray(place).astype(np.int64)]

        with np.errstate(invalid="ignore", over="ignore"):
            return _look_up(self.form, t, row, _Ways(take, np.floor, np.where))


class _Ways(NamedTuple):
    """How a formula takes the number at a position, rounds down and chooses."""

    take: Callable[[Any], Any]
    floor: Callable[[Any], Any]
    choose: Callable[[Any, Any, Any], Any]


def recorded(name: Any, form: TableLayout, t: Any, row: Any = None) -> Any:
    """(values, slopes) of traced numbers, from the table that memory has under a name."""
    # the floor of a dual number is a node of its graph
    of = graph.apply("floor", t if isinstance(t, Recorded) else row).graph

    def double(x: Any) -> Any:
        return Double(x) if isinstance(x, Recorded) else graph.number(of, x, "double")

    def take(place: Any) -> Any:
        return functions.gather(name, double(place), "double")

    ways = _Ways(take, lambda x: graph.apply("floor", x), graph.choose)
    return _look_up(form, double(t), double(0.0 if row is None else row), ways)


def _look_up(form: TableLayout, t: Any, row: Any, ways: _Ways) -> Any:
    """(values, slopes) at t in a row. No position is outside the table, whatever the numbers."""
    take, floor, choose = ways
    inside = (t >= take(_LOW)) & (t <= take(_HIGH))
    if form.holds:
        t = choose(t < take(_FIRST), take(_FIRST), t)
        t = choose(t > take(_END), take(_END), t)
    s = (t - take(_FIRST)) / take(_WIDTH)
    k = floor(choose(s > 0.0, s, 0.0))
    k = choose(k < take(_LAST), k, take(_LAST))
    width = take(_WIDTH)
    if form.uniform:
        f = s - k
    else:
        begin = take(_TIMES)
        k = take(_HEAD + k)
        if form.steps:
            k = choose((t < take(begin + k)) & (k > 0.0), k - 1.0, k)
        k = choose(t >= take(begin + k + 1.0), k + 1.0, k)
        k = choose(k < take(_INTERVAL), k, take(_INTERVAL))
        width = take(begin + k + 1.0) - take(begin + k)
        f = (t - take(begin + k)) / width
        if form.steps:  # 1 at the last sample only; NaN stays
            end = take(begin + k + 1.0)
            f = choose(t >= end, 1.0, choose(t < end, 0.0, f))
    at = take(_SAMPLES) + (1.0 + form.cubic) * form.size * k
    if form.own:
        there = (row >= 0.0) & (row < take(_ROWS)) & (floor(row) == row)
        at = at + choose(there, row, 0.0) * take(_ROW)
    else:
        there = inside
    if form.own or not form.holds:
        known = there if form.holds else inside & there
        f, width = choose(known, f, np.nan), choose(known, width, np.nan)
    found = [_between(form, at + float(c), f, width, ways) for c in range(form.size)]
    values, slopes = zip(*found, strict=True)
    return values, tuple(choose(inside, x, 0.0) for x in slopes) if form.holds else slopes


def _between(form: TableLayout, at: Any, f: Any, width: Any, ways: _Ways) -> Any:
    """(value, slope) at a fraction f of an interval between two samples; NaN if f is."""
    size, take, choose = float(form.size), ways.take, ways.choose
    a, b = take(at), take(at + (1.0 + form.cubic) * size)
    if form.steps:
        return choose(f < 1.0, a, choose(f >= 1.0, b, f)), choose(f < 2.0, 0.0, f)
    rise = b - a
    if not form.cubic:
        return a + f * rise, rise / width
    da, db = width * take(at + size), width * take(at + 3.0 * size)
    two, three = 3.0 * rise - 2.0 * da - db, da + db - 2.0 * rise
    value = a + f * (da + f * (two + f * three))
    return value, (da + f * (2.0 * two + f * (3.0 * three))) / width


def _samples(name: str, value: ArrayLike, n: int) -> Numbers:
    """Samples as (rows, T, k)."""
    found = checks.array(name, value, f"({n},), ({n}, k) or (N, {n}, k)")
    found = found[:, None] if found.ndim == 1 else found
    return found.reshape((-1, *found.shape[-2:])).astype(np.float64)


def derivatives(t: Numbers, values: NDArray[Any], n: int) -> NDArray[Any]:
    """Derivatives (T, ...) of the polynomials through n values (T, ...) around each time.

    The n times are centred except near the ends (Berrut and Trefethen, *SIAM Review* 46 (2004),
    equation 9.4). A polynomial through times that nearly coincide would magnify the noise of the
    values: there the derivative is the slope between the two neighbours of the time.
    """
    itself = np.arange(len(t))
    first = np.clip(itself - (n - 1) // 2, 0, len(t) - n)
    places = first[:, None] + np.arange(n)
    own = itself - first
    gaps = t[places][:, :, None] - t[places][:, None, :]
    gaps[:, range(n), range(n)] = 1.0
    barycentric = 1.0 / gaps.prod(axis=2)
    weights = barycentric / barycentric[itself, own][:, None] / gaps[itself, own]
    weights[itself, own] = 0.0
    weights[itself, own] = -weights.sum(axis=1)
    found = np.einsum("tn,tn...->t...", weights, values[places])
    before, after = np.maximum(itself - 1, 0), np.minimum(itself + 1, len(t) - 1)
    reach = np.maximum(t - t[before], t[after] - t)
    poor = ~(reach * np.abs(weights).sum(axis=1) <= max(_MAGNIFIED, 2.0**n))
    a, b = before[poor], after[poor]
    found[poor] = ((values[b] - values[a]).T / (t[b] - t[a])).T
    return np.asarray(found)


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
    return np.concatenate([np.searchsorted(t, starts, side="right") - 1.0, t])


__all__ = ["TimeSeries"]
