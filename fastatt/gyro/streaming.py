"""Attitudes from samples that arrive one by one, equal to those of the whole log."""

from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.arrays import normalised
from fastatt.gyro.engine import GyroRun, beginning, finish
from fastatt.gyro.gaps import RECENT, cuts
from fastatt.gyro.integrate import (
    LONGEST,
    intervals,
    is_finite,
    largest_gap,
    method_of,
    overflow,
    unit_quaternions,
    warn_of_turns,
)
from fastatt.methods import METHODS
from fastatt.methods.windows import CHUNK
from fastatt.threads import number_of


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
        record = method_of(method, increments)
        self._method = record.name
        self._increments = increments
        start = unit_quaternions("q0", q0)
        self._one = start.ndim == 1
        self._start = np.atleast_2d(start)
        self._max_gap, self._warns = largest_gap(max_gap), max_gap is None
        self._dt = dt
        if dt is not None:
            self._dt = intervals(checks.real("dt", dt), 0, max_gap, np.dtype("f8"))
        self._precision = None if dtype is None else checks.precision(dtype)
        self._threads = None if n_threads is None else number_of(n_threads)
        self._begun = self._closed = False
        # intervals given; done since the last cut, and before it; of those done, how many the kept
        # samples and intervals cover
        self._given = self._done = self._before = self._lead = 0
        self._samples: NDArray[Any] = np.empty((0, 0, 3))
        self._spans = self._q = self._last = self._recent = np.empty(0)

    def __getstate__(self) -> dict[str, Any]:
        with self._lock:
            return {name: value for name, value in self.__dict__.items() if name != "_lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.Lock())

    @property
    def q(self) -> NDArray[Any]:
        """Last attitude that was returned, (4,) or (N, 4); q0 before the first push.

        To correct it, for example with the update of a filter, assign an attitude of any norm above
        zero. Later attitudes follow from the assigned one.
        """
        with self._lock:
            last = self._last if self._begun else self._start
        return np.array(last[0] if self._one else last)

    @q.setter
    def q(self, value: ArrayLike) -> None:
        accepted = "(4,)" if self._one else f"(4,) or ({len(self._start)}, 4)"
        with self._lock:
            self._check_open()
            given = unit_quaternions("q", checks.attitudes("q", value, accepted))
            self._start = np.tile(given, (len(self._start), 1)) if given.ndim == 1 else given
            if self._begun:
                self._last = self._start.astype(self._last.dtype)
                self._q = beginning(self._start, len(self._start), self._last.dtype)

    def push(self, rates: ArrayLike, dt: ArrayLike | None = None) -> NDArray[Any]:
        """Add samples, and return the attitudes that they complete.

        Parameters
        ----------
        rates : array_like of shape (3,) or (n, 3); (N, 3) or (N, n, 3) for N bodies
            Rates, rad/s, or increments, rad.
        dt : float or array_like of shape (n,), optional
            Intervals that end at the samples, s, or one number for all; for an integrator without
            ``dt``. No interval ends at the very first rate, so that the first push takes (n - 1,).

        Returns
        -------
        ndarray of shape (m, 4) or (N, m, 4)
            The next m attitudes; m is 0 if the method needs further samples.

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
            return self._pushed(rates, dt)

    def _pushed(self, rates: ArrayLike, dt: ArrayLike | None) -> NDArray[Any]:
        self._check_open()
        n_logs, increments = len(self._start), self._increments
        accepted = "(3,) or (n, 3)" if self._one else f"({n_logs}, 3) or ({n_logs}, n, 3)"
        given = checks.array("rates", rates, accepted)
        precision = self._precision or checks.precision(None, rates)
        samples = given.astype(precision).reshape(n_logs, -1, 3)
        n = samples.shape[1]
        spans = self._intervals(dt, n if self._begun or increments else n - 1, precision)
        kept = self.__dict__.copy()
        try:
            found = self._through_cuts(samples, spans)
        except BaseException:
            self.__dict__.update(kept)
            raise
        return found[0] if self._one else found

    def close(self) -> NDArray[Any]:
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
            found = self._rest() if self._begun else np.empty((len(self._start), 0, 4))
        return found[0] if self._one else found

    def _through_cuts(self, samples: NDArray[Any], spans: Any) -> NDArray[Any]:
        """The attitudes that are final after further samples; windows begin anew at cuts."""
        late = not (self._begun or self._increments)  # the very first rate ends no interval
        parts, done = [], 0
        window = METHODS[self._method].window
        for k, usual in cuts(window.uneven, spans, self._recent):
            if self._warns and spans[k] > LONGEST * usual:
                rounding.warn(
                    f"dt: interval {self._given + k} of {spans[k]:.3g} s is a gap, "
                    f"{spans[k] / usual:.2g} times the median of the {RECENT} before: correct the "
                    "attitude after it, or pass max_gap to accept it"
                )
            if window.intervals > 1:
                parts += [(done, k), (k, k + 1)]
                done = k + 1
        parts.append((done, len(spans) if np.ndim(spans) else samples.shape[1] - late))
        found, at = [], 0
        for i, (first, last) in enumerate(parts):
            if i:
                found.append(self._rest())
                self._begin_anew()
            if last > first or not i:
                own = samples[:, at : last + late]
                found.append(self._take(own, spans[first:last] if np.ndim(spans) else spans))
                at = last + late
        if np.ndim(spans):
            self._recent = np.concatenate((self._recent, spans))[-RECENT:]
            self._given += len(spans)
        return np.concatenate(found, axis=1)

    def _take(self, samples: NDArray[Any], spans: Any) -> NDArray[Any]:
        """The attitudes that are final after further samples, without a cut."""
        q = self._q
        if self._begun:
            samples = np.concatenate((self._samples, samples), axis=1)
        else:
            q = beginning(self._start, len(samples), samples.dtype)
        if np.ndim(spans):
            spans = np.concatenate((self._spans, spans), dtype=samples.dtype)
        window = METHODS[self._method].window
        known = samples.shape[1] - self._lead - (not self._increments)
        count = known - known % window.span
        # samples before the first window are extrapolated from the first ones
        least = window.samples(self._increments)
        if not self._done and window.history and samples.shape[1] < least:
            count = 0
        return self._advanced(samples, spans, q, count)

    def _rest(self) -> NDArray[Any]:
        """The attitudes at all samples so far, at the end of a log or before a cut."""
        count = self._samples.shape[1] - self._lead - (not self._increments)
        return self._advanced(self._samples, self._spans, self._q, count, end=True)

    def _begin_anew(self) -> None:
        """Begin the windows at the last sample, unless they just began there."""
        if not self._done:
            return
        self._before += self._done
        self._done = self._lead = 0
        last = self._samples.shape[1]
        self._samples = self._samples[:, last - (not self._increments) :]
        self._spans = self._spans if self._dt is not None else self._spans[:0]
        self._last = normalised(self._last)
        self._q = beginning(self._last, len(self._last), self._last.dtype)

    def _check_open(self) -> None:
        if self._closed:
            raise ValueError("found an integrator that is closed; accepted: one that is open")

    def _intervals(self, dt: ArrayLike | None, count: int, precision: np.dtype[Any]) -> Any:
        """The interval, or ``count`` intervals."""
        if self._dt is not None:
            if dt is not None:
                raise ValueError(
                    f"dt: found {checks.brief(dt)}; accepted: None, all intervals are {self._dt} s"
                )
            return precision.type(self._dt)
        if dt is None and count:
            raise ValueError(
                f"dt: found None; accepted: a number or ({count},), the intervals that end at "
                "these samples"
            )
        if dt is None:
            return np.empty(0, dtype=precision)
        return np.broadcast_to(intervals(dt, count, self._max_gap, precision), count)

    def _advanced(
        self, samples: NDArray[Any], spans: Any, q: NDArray[Any], count: int, *, end: bool = False
    ) -> NDArray[Any]:
        """The next ``count`` attitudes; the samples that later ones need are kept.

        ``end`` says that no sample follows.
        """
        record, increments = METHODS[self._method], self._increments
        window, lead, n_logs = record.window, self._lead, len(samples)
        out = np.empty((n_logs, count + 1, 4), dtype=samples.dtype)
        q, seen = q.copy(), 0.0
        if not count or (window.iteration and end):
            out[:, 0] = self._last if self._begun else q[:, :4]
            if count:
                seen = math.inf
                finish(window, increments, samples, spans, out)
        else:
            run = GyroRun(window, increments, samples, spans, out, lead)
            seen = run.carry(q, phase=self._done % CHUNK, n_threads=self._threads)
        if not (checks.all_finite(out[:, -1]) and is_finite(seen, out)):
            raise overflow("rates", samples.dtype)
        own = samples[:, lead : lead + count + (not increments)]
        apart = spans if self._dt is not None else spans[lead : lead + count]
        before = self._before + self._done
        warn_of_turns(seen, own, apart, record, increments, first=before)
        found = out[:, self._begun :]
        self._done += count
        # those of a window, which the end of a log needs
        self._lead = min(self._done, window.intervals)
        first = lead + count - self._lead
        self._samples, self._precision = samples[:, first:].copy(), samples.dtype
        self._spans = spans if self._dt is not None else spans[first:]
        self._q, self._last, self._begun = q, out[:, -1].copy(), True
        return found
