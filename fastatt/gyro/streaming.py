"""Attitudes from samples that arrive one by one, equal to those of the whole log."""

from __future__ import annotations

import threading
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.arrays import normalised
from fastatt.gyro.engine import Samples, advance, beginning
from fastatt.gyro.integrate import (
    are_means,
    is_finite,
    method_of,
    of_log,
    overflow,
    unit_quaternions,
    warn_of_turns,
)
from fastatt.gyro.intervals import GAP, RECENT, cuts, intervals, largest_gap, stretches
from fastatt.gyro.log import GyroLog
from fastatt.methods.windows import CHUNK
from fastatt.threads import number_of

Array = NDArray[Any]


class GyroIntegrator:
    """Integrate gyro samples that arrive one by one or in batches.

    The attitudes are those of :func:`fastatt.integrate_rates` over the whole log, bit for bit,
    however it is divided, unless ``q`` is assigned. An integrator can be pickled and copied, and
    continues from there. Calls from several threads run one after another, in no set order: the
    order of samples is certain only if one thread pushes them.

    Parameters
    ----------
    q0 : array_like of shape (4,) or (N, 4)
        Attitude at the first time, body to inertial, scalar first.
    dt : float, optional
        The interval, s; None if ``push`` is given the intervals.
    method : str, default "previous"
        The method, as in :func:`fastatt.integrate_rates`.
    increments : bool, default False
        Whether samples are angle increments.
    dtype : {float64, float32}, optional
        Precision; by default that of the first samples.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.integrate_rates`.
    max_gap : float, optional
        The longest interval that is accepted, s; the default accepts any, with a warning if it is
        longer than 10 times the median of the eight before it.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`fastatt.integrate_rates`.

    Examples
    --------
    >>> import fastatt as fa
    >>> flow = fa.GyroIntegrator((1.0, 0.0, 0.0, 0.0), 0.01, method="coning2")
    >>> [len(flow.push((0.0, 0.0, 1.0))) for _ in range(4)], len(flow.close())
    ([1, 0, 2, 0], 1)

    Notes
    -----
    With "coning2" and "picard", ``push`` returns the attitudes of a window when the last sample of
    the window arrives. With "previous" it returns an attitude for every sample, with one
    exception: since the rate before the first one is extrapolated from three rates, the second rate
    returns none, and the third returns two. (Of increments, the first returns the initial attitude,
    and the second two more.) The same holds where the windows begin anew.
    """

    def __init__(
        self,
        q0: ArrayLike,
        dt: float | None = None,
        *,
        method: str = "previous",
        increments: bool = False,
        dtype: DTypeLike | None = None,
        n_threads: int | None = None,
        max_gap: float | None = None,
    ) -> None:
        self._lock = threading.Lock()
        self._method = method_of(method, increments)
        self._increments = increments
        start = unit_quaternions("q0", q0)
        self._one = start.ndim == 1
        self._last = np.atleast_2d(start)  # attitude
        self._max_gap, self._warns = largest_gap(max_gap), max_gap is None
        self._dt = dt
        if dt is not None:
            self._dt = intervals(checks.real("dt", dt), 0, max_gap, np.dtype("f8"))
        self._precision = None if dtype is None else checks.precision(dtype)
        self._threads = None if n_threads is None else number_of(n_threads)
        self._closed = self._means = False
        # those of the window before, and those that were not integrated; p and r before these
        self._pending: Samples | None = None
        self._q = self._recent = np.empty(0)
        self._done = self._before = 0  # intervals integrated since the last cut, and before it

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.Lock())

    @property
    def q(self) -> Array:
        """Last attitude that was returned, (4,) or (N, 4); q0 before the first push.

        To correct it, for example with the update of a filter, assign an attitude of any norm above
        zero. Later attitudes follow from the assigned one.
        """
        with self._lock:
            return np.array(self._last[0] if self._one else self._last)

    @q.setter
    def q(self, value: ArrayLike) -> None:
        accepted = "(4,)" if self._one else f"(4,) or ({len(self._last)}, 4)"
        with self._lock:
            self._check_open()
            unit = unit_quaternions("q", checks.attitudes("q", value, accepted))
            self._last = np.broadcast_to(unit, self._last.shape).astype(self._last.dtype)
            self._q = beginning(unit, len(self._last), self._last.dtype)

    def push(self, rates: ArrayLike | GyroLog, dt: ArrayLike | None = None) -> Array:
        """Add samples, and return the attitudes that they complete.

        Parameters
        ----------
        rates : array_like of shape (3,) or (n, 3); (N, 3) or (N, n, 3) for N bodies; or GyroLog
            Rates, rad/s, or increments, rad; or a log, with its intervals.
        dt : float or array_like of shape (n,), optional
            Intervals that end at the samples, s, or one number for all; for an integrator without
            ``dt``. No interval ends at the very first rate, so that the first push takes (n - 1,).
            If it takes (n,), these rates and all later ones are means over their intervals.

        Returns
        -------
        ndarray of shape (m, 4) or (N, m, 4)
            The next m attitudes; m is 0 if there are no rows or the method needs further samples.

        Raises
        ------
        ValueError, TypeError
            If an argument does not fit or is not finite, or after ``close``. The integrator is then
            as before the call.

        Warns
        -----
        StepWarning
            If the rotation angle over an interval exceeds the method's limit, or an interval is a
            gap in which many samples are missing, unless ``max_gap`` is given.
        """
        with self._lock:
            self._check_open()
            n_logs = len(self._last)
            is_log, values = isinstance(rates, GyroLog), cast("Any", rates)
            if is_log:
                values, dt = of_log(rates, dt, self._increments and not self._means)
            accepted = "(3,) or (n, 3)" if self._one else f"({n_logs}, 3) or ({n_logs}, n, 3)"
            none = (n_logs, 0, 4)[self._one :]
            if np.shape(values) in {(0,), (*none[:-1], 3)}:
                return np.empty(none, self._precision or self._last.dtype)
            numbers = checks.array("rates", values, accepted)
            precision = self._precision or checks.precision(None, values)
            samples = numbers.astype(precision).reshape(n_logs, -1, 3)
            is_mean = are_means(values, dt)
            if is_log and self._pending and is_mean != self._means:
                raise ValueError(
                    "rates: found a log of other values than those before; accepted: means after "
                    "means, samples after samples"
                )
            is_first = not (self._pending or self._increments)
            extra = is_first and not is_mean  # the very first rate ends no interval
            spans = self._intervals(dt, samples.shape[1] - extra, precision)
            before = self.__dict__.copy()
            try:
                if is_first and is_mean:
                    self._method = method_of(self._method.name, increments=True)
                    self._increments = self._means = True
                if self._means:
                    samples = samples * spans[:, None]
                attitudes = self._through_cuts(samples, spans, extra)
            except BaseException:
                self.__dict__.update(before)
                raise
        return attitudes[0] if self._one else attitudes

    def close(self) -> Array:
        """End the log and return the remaining attitudes.

        Returns
        -------
        ndarray of shape (m, 4) or (N, m, 4)
            The last m attitudes.

        Raises
        ------
        ValueError
            If the integrator was closed before.
        """
        with self._lock:
            self._check_open()
            self._closed = True
            attitudes = self._rest()
        return attitudes[0] if self._one else attitudes

    def _through_cuts(self, data: Array, spans: Any, extra: bool) -> Array:
        """The attitudes that are final after further samples; windows begin anew at cuts."""
        window, places = self._method.window, []
        for k, usual in cuts(window.uneven, spans, self._recent):
            if self._warns and spans[k] > GAP * usual:
                waiting = self._pending.n_intervals if self._pending else 0
                index = self._before + self._done + waiting + k
                rounding.warn(
                    f"dt: interval {index} of {spans[k]:.3g} s is a gap, "
                    f"{spans[k] / usual:.2g} times the median of the {RECENT} before: correct the "
                    "attitude after it, or pass max_gap to accept it"
                )
            places += [k] if window.intervals > 1 else []
        attitudes = []
        for first, last in stretches(places, data.shape[1] - extra) or [(0, 0)]:
            if first in places:
                attitudes.append(self._begun_anew())
            part = data[:, first + (extra and first > 0) : last + extra]
            attitudes.append(self._taken(part, spans[first:last] if self._dt is None else spans))
            if first in places:
                attitudes.append(self._begun_anew())
        if self._dt is None:
            self._recent = np.concatenate((self._recent, spans))[-RECENT:]
        return np.concatenate(attitudes, axis=1)

    def _taken(self, data: Array, spans: Any) -> Array:
        """The attitudes that are final after further samples, without a cut."""
        pending, lead = self._pending, 0
        if pending is None:
            self._q = beginning(self._last, len(data), data.dtype)
        else:
            data, lead = np.concatenate((pending.data, data), axis=1), pending.lead
            if self._dt is None:
                spans = np.concatenate((pending.spans, spans), dtype=data.dtype)
        samples = Samples(self._method, self._increments, data, spans, lead)
        window = self._method.window
        count = samples.n_intervals // window.span * window.span
        # samples before the first window are extrapolated from the first ones
        if not self._done and window.history and data.shape[1] < window.samples(self._increments):
            count = 0
        return self._advanced(samples, count)

    def _rest(self) -> Array:
        """The attitudes at all samples so far, at the end of a log or before a cut."""
        if self._pending is None:
            return np.empty((len(self._last), 0, 4))
        return self._advanced(self._pending, self._pending.n_intervals)

    def _begun_anew(self) -> Array:
        """The attitudes at all samples so far; the windows begin at the last one."""
        attitudes, pending = self._rest(), self._pending
        if self._done and pending:
            self._pending = pending.between(pending.lead, pending.lead)
            self._before, self._done = self._before + self._done, 0
            self._last = normalised(self._last)
            self._q = beginning(self._last, len(self._last), self._last.dtype)
        return attitudes

    def _check_open(self) -> None:
        if self._closed:
            raise ValueError("found an integrator that is closed; accepted: one that is open")

    def _intervals(self, dt: ArrayLike | None, count: int, precision: np.dtype[Any]) -> Any:
        """The interval, or ``count`` intervals."""
        if self._dt is not None and dt is None:
            return precision.type(self._dt)
        if self._dt is not None or (dt is None and count):
            accepted = f"a number or ({count},), the intervals that end at these samples"
            if self._dt is not None:
                accepted = f"None, all intervals are {self._dt} s"
            raise ValueError(f"dt: found {checks.brief(dt)}; accepted: {accepted}")
        if dt is None:
            return np.empty(0, dtype=precision)
        return np.full(count, intervals(dt, count, self._max_gap, precision), dtype=precision)

    def _advanced(self, samples: Samples, count: int) -> Array:
        """The next ``count`` attitudes; the samples that later ones need are kept."""
        lead, precision = samples.lead, samples.data.dtype
        out = np.empty((len(self._last), count + 1, 4), precision)
        out[:, 0] = self._last
        q, phase = self._q.copy(), self._done % CHUNK
        seen = advance(samples, out, q, phase=phase, n_threads=self._threads)
        if not (checks.all_finite(out[:, -1]) and is_finite(seen, out)):
            raise overflow("rates", precision)
        warn_of_turns(seen, samples.between(lead, lead + count), first=self._before + self._done)
        attitudes = out[:, self._pending is not None :]
        self._done += count
        # those of a window, which the end of a log needs
        needed = min(self._done, self._method.window.intervals)
        left = samples.between(lead + count - needed, lead + samples.n_intervals)
        self._pending = left._replace(data=left.data.copy(), lead=needed)
        self._q, self._last, self._precision = q, out[:, -1].copy(), precision
        return attitudes
