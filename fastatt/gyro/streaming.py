"""Samples as they come to attitudes: those of a whole log, whatever the pieces."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.gyro.engine import GyroRun, beginning, finish
from fastatt.gyro.integrate import (
    check_intervals,
    intervals,
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
    """Attitudes from samples that arrive one by one or in pieces: ``fastatt.GyroIntegrator``.

    Those of :func:`fastatt.integrate_rates` over the whole log, bit for bit, however it is cut. It
    can be pickled and copied, and goes on from there.

    Parameters
    ----------
    q0 : (4,) or of N bodies (N, 4), attitude at the first instant, body to inertial, scalar first.
    dt : the interval, s; None where ``push`` is given the intervals.
    method, increments, dtype, n_threads : as for ``integrate_rates``; with ``dtype`` None the first
        samples decide.
    max_gap : longest interval allowed, s; None: any, since the median is not known yet.

    Raises
    ------
    ValueError, TypeError : an argument that ``integrate_rates`` refuses.

    Examples
    --------
    >>> flow = fa.GyroIntegrator((1.0, 0.0, 0.0, 0.0), 0.01, method="coning2")
    >>> [len(flow.push((0.0, 0.0, 1.0))) for _ in range(4)], len(flow.close())
    ([1, 0, 2, 0], 1)
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
        record = method_of(method, increments)
        self._method = record.name
        check_intervals(record, uneven=dt is None)
        self._increments = increments
        start = unit_quaternions("q0", q0)
        self._one = start.ndim == 1
        self._start = np.atleast_2d(start)
        self._max_gap = largest_gap(max_gap)
        self._dt = dt
        if dt is not None:
            self._dt = intervals(checks.real("dt", dt), 0, max_gap, np.dtype("f8"))
        self._precision = None if dtype is None else checks.precision(dtype)
        self._threads = None if n_threads is None else number_of(n_threads)
        self._begun = self._closed = False
        # intervals done, and how many of them the samples and intervals that are kept go back
        self._done = self._lead = 0
        self._samples: NDArray[Any] = np.empty((0, 0, 3))
        self._spans = self._q = self._last = np.empty(0)

    def push(self, rates: ArrayLike, dt: ArrayLike | None = None) -> NDArray[Any]:
        """The attitudes that are final with some more samples.

        Parameters
        ----------
        rates : (3,) or (n, 3), of N bodies (N, 3) or (N, n, 3): rad/s, or increments, rad.
        dt : of an integrator without ``dt``: the interval that ends at each sample, s, (n,), or a
            number for all. The first rate of all ends none: (n - 1,) in the first push.

        Returns
        -------
        (m, 4), or (N, m, 4): the next m attitudes, none where the method waits for more samples.

        Raises
        ------
        ValueError, TypeError : what does not fit or is not finite, or a push after ``close``;
            nothing is done then.

        Warns
        -----
        StepWarning : an interval in which the body turns further than the method can follow.
        """
        self._check_open()
        n_logs, increments = len(self._start), self._increments
        accepted = "(3,) or (n, 3)" if self._one else f"({n_logs}, 3) or ({n_logs}, n, 3)"
        given = checks.array("rates", rates, accepted)
        precision = self._precision or checks.precision(None, rates)
        samples = given.astype(precision).reshape(n_logs, -1, 3)
        n = samples.shape[1]
        spans = self._intervals(dt, n if self._begun or increments else n - 1, precision)
        q = self._q
        if self._begun:
            samples = np.concatenate((self._samples, samples), axis=1)
        else:
            q = beginning(self._start, n_logs, precision)
        window = METHODS[self._method].window
        known = samples.shape[1] - self._lead - (not increments)
        count = known - known % window.span
        # the first window looks back on what the first samples say
        if not self._done and window.history and samples.shape[1] < window.samples(increments):
            count = 0
        return self._advanced(samples, spans, q, count)

    def close(self) -> NDArray[Any]:
        """The attitudes left, (m, 4) or (N, m, 4): the log ends here.

        Raises
        ------
        ValueError : closed before.
        """
        self._check_open()
        self._closed = True
        n_logs = len(self._start)
        if not self._begun:
            return np.empty((0, 4) if self._one else (n_logs, 0, 4))
        count = self._samples.shape[1] - self._lead - (not self._increments)
        return self._advanced(self._samples, self._spans, self._q, count)

    def _check_open(self) -> None:
        if self._closed:
            raise ValueError("found an integrator that is closed; accepted: one that is open")

    def _intervals(self, dt: ArrayLike | None, count: int, precision: np.dtype[Any]) -> Any:
        """The interval, or all that are kept and ``count`` more."""
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
        spans = intervals(dt, count, self._max_gap, precision)
        return np.concatenate((self._spans, np.broadcast_to(spans, count)), dtype=precision)

    def _advanced(
        self, samples: NDArray[Any], spans: Any, q: NDArray[Any], count: int
    ) -> NDArray[Any]:
        """The next ``count`` attitudes; what they need is kept for those after them."""
        record, increments = METHODS[self._method], self._increments
        window, lead, n_logs = record.window, self._lead, len(samples)
        out = np.empty((n_logs, count + 1, 4), dtype=samples.dtype)
        q, seen = q.copy(), 0.0
        if not count or (window.iteration and self._closed):
            out[:, 0] = self._last if self._begun else q[:, :4]
            if count:
                seen = math.inf
                finish(window, increments, samples, spans, out)
        else:
            run = GyroRun(window, increments, samples, spans, out, lead)
            seen = run.carry(q, phase=self._done % CHUNK, n_threads=self._threads)
        if not checks.all_finite(out[:, -1]):
            raise overflow("rates", samples.dtype)
        own = samples[:, lead : lead + count + (not increments)]
        gaps = spans if self._dt is not None else spans[lead : lead + count]
        warn_of_turns(seen, own, gaps, record, increments, first=self._done)
        found = out[:, self._begun :]
        self._done += count
        # a window's, which the end of a log goes back to
        self._lead = min(self._done, window.intervals)
        first = lead + count - self._lead
        self._samples, self._precision = samples[:, first:].copy(), samples.dtype
        self._spans = spans if self._dt is not None else spans[first:]
        self._q, self._last, self._begun = q, out[:, -1].copy(), True
        return found[0] if self._one else found
