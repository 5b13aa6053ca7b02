"""Integration of sampled rates, or of angle increments, to attitudes."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.arrays import normalised
from fastatt.gyro.engine import NO_TURN, Samples, integrate
from fastatt.gyro.intervals import intervals, tell_of_stamps
from fastatt.gyro.log import GyroLog
from fastatt.methods import METHODS, Method
from fastatt.threads import number_of

_UNTURNED = (1.0, 0.0, 0.0, 0.0)
# rad; products of two larger angles of a window may overflow, also in single precision
_HUGE = 1e9


def integrate_rates(
    rates: ArrayLike | GyroLog | Sequence[Any],
    dt: ArrayLike | Sequence[Any] | None = None,
    q0: ArrayLike = _UNTURNED,
    *,
    method: str = "previous",
    increments: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    max_gap: float | None = None,
    out: NDArray[Any] | None = None,
) -> Any:
    """Integrate body rates sampled at given times, or angle increments, to attitudes.

    Parameters
    ----------
    rates : array_like of shape (n, 3) or (N, n, 3), GyroLog, or list of N of these
        Rates along body axes, rad/s, at n times; with n intervals, mean rates over these; with
        ``increments``, angle increments, rad. A log has its intervals and says what its numbers
        are. Logs of unequal lengths are a list.
    dt : float or array_like
        The interval, s, or the intervals: (n - 1,) for rates at n times, (n,) for mean rates and
        for increments; (N, n - 1) or (N, n) if N logs have different intervals; a number, or a
        list of the interval or intervals of each, for logs of unequal lengths. All are above 0.
        None for a log.
    q0 : array_like of shape (4,) or (N, 4), default (1, 0, 0, 0)
        Attitude at the first time, body to inertial, scalar first.
    method : str, default "previous"
        "hold", "trapezoid" (rates only), "previous", "coning2" or "picard".
    increments : bool, default False
        Whether ``rates`` are angle increments.
    dtype : {float64, float32}, optional
        Precision; the default is float32 if ``rates`` is a float32 array, and float64 otherwise.
    n_threads : int, optional
        Number of threads for many logs of the same intervals; the default is every processor.
        Results do not depend on it.
    max_gap : float, optional
        The longest interval that is accepted, s; the default is 10 times the median.
    out : ndarray, optional
        Array for the result. Writing to memory that was used before takes half the time.

    Returns
    -------
    ndarray of shape (n, 4) or (N, n, 4)
        Attitudes at the times of the samples; for n means or increments (n + 1, 4) or (N, n + 1,
        4). A list of N such arrays (n, 4) for logs of unequal lengths.

    Raises
    ------
    ValueError
        If a shape does not fit, a number is not finite, an interval is zero or negative (a repeated
        or decreasing time stamp) or a gap, or the method is unknown.
    TypeError
        If an argument has the wrong type.

    Warns
    -----
    StepWarning
        If the rotation angle over an interval exceeds the method's limit, or intervals only grow,
        as time stamps do.

    See Also
    --------
    GyroIntegrator : The same for samples that arrive one by one.
    read_gyro_log : Rates and intervals from a file.

    Notes
    -----
    An interval that is longer than three times the median of the eight before it, or shorter than a
    third ("picard": twice, half), is integrated as if the rate varied linearly between its ends, or
    from its increment, since a polynomial through the samples around it would magnify their noise.
    The windows of the method begin anew after it. The error across a gap is mainly that of linear
    interpolation.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> q = fa.integrate_rates(np.tile([0.0, 0.0, 0.5], (101, 1)), dt=0.01)
    >>> q.shape, q[-1].round(6).tolist()
    ((101, 4), [0.968912, 0.0, 0.0, 0.247404])
    """
    if _are_separate(rates, dt):
        options = {"method": method, "increments": increments, "dtype": dtype, "max_gap": max_gap}
        return _of_each(rates, dt, q0, out, n_threads=n_threads, **options)
    return _integrated(rates, dt, q0, out, method, increments, dtype, max_gap, n_threads)


def _integrated(
    rates: Any, dt: Any, q0: Any, out: Any, method: str, increments: bool, dtype: Any,
    max_gap: float | None, n_threads: int | None = 1, log: int = 0,
) -> NDArray[Any]:  # fmt: skip
    """Attitudes of logs with the same intervals; ``log`` is the number of the first."""
    values, dt = of_log(rates, dt, increments)
    means = not increments and are_means(values, dt)
    increments = increments or means
    record = method_of(method, increments)
    name = "rates (increments)" if increments and not means else "rates"
    data = checks.array(name, values, "(n, 3) or (N, n, 3)", flag=True)
    one = data.ndim == 2
    is_set = dtype is None and type(values) is np.ndarray
    precision = data.dtype if is_set else checks.precision(dtype, values)
    data = np.ascontiguousarray(data if not one else data[None], dtype=precision)
    n_logs, n = data.shape[:2]
    count = n if increments else n - 1
    spans = intervals(dt, count, max_gap, precision)
    tell_of_stamps(spans)
    data = data * spans[:, None] if means else data
    threads = None if n_threads is None else number_of(n_threads)
    start = NO_TURN if q0 is _UNTURNED else unit_quaternions("q0", q0)
    if start.ndim == 2 and start.shape[0] != n_logs:
        raise ValueError(f"q0: has shape {start.shape}; accepted: (4,) or ({n_logs}, 4), one a log")

    shape = (count + 1, 4) if one else (n_logs, count + 1, 4)
    result = np.empty(shape, dtype=precision) if out is None else _output(out, shape, precision)
    out = result[None] if one else result
    samples = Samples(record, increments, data, spans)
    seen = integrate(samples, out, start, threads)
    # a sample that is not finite affects every later attitude; the last one may be unused
    if not (checks.all_finite(out[:, -1], data[:, -1]) and is_finite(seen, out)):
        checks.finite(name, data[0] if one else data)
        raise overflow(name, precision)
    warn_of_turns(seen, samples, log=log)
    return result


def _are_separate(rates: Any, dt: Any) -> bool:
    """Whether logs have different intervals, or are a list, but for arrays of one length."""
    with suppress(ValueError, TypeError):  # of what is no array, which is refused later
        if isinstance(rates, (list, tuple)) and len(rates):
            if isinstance(rates[0], GyroLog):
                return True
            if np.ndim(rates[0]) == 2 and len({len(x) for x in rates}) > 1:
                return True
        if not (dt is None or isinstance(dt, float)) and np.ndim(dt) == 2:
            return np.ndim(rates) == 3
    return False


def _of_each(
    rates: Any, dt: Any, q0: Any, out: Any, **options: Any
) -> NDArray[Any] | list[NDArray[Any]]:
    """Attitudes of logs with different intervals or lengths, the same as of each alone."""
    start = checks.attitudes("q0", q0)
    starts = start if start.ndim > 1 else [start] * len(rates)
    spans = dt if isinstance(dt, (list, tuple)) or np.ndim(dt) else [dt] * len(rates)
    for name, values, one in (("q0", starts, "(4,)"), ("dt", spans, "a number")):
        if len(values) != (n := len(rates)):
            raise ValueError(
                f"{name}: found {len(values)} of them; accepted: {one}, or {n}, one a log"
            )
    attitudes = []
    for k, (log, h, q) in enumerate(zip(rates, spans, starts, strict=True)):
        try:
            attitudes.append(_integrated(log, h, q, None, log=k, **options))
        except (TypeError, ValueError) as error:
            raise type(error)(f"log {k}: {error}") from None
    if isinstance(rates[0], GyroLog) or len({q.shape for q in attitudes}) > 1:
        if out is not None:
            raise TypeError("out: found an array; accepted: None, for a list of logs")
        return attitudes
    stacked = np.stack(attitudes)
    result = stacked if out is None else _output(out, stacked.shape, stacked.dtype)
    result[:] = stacked
    return result


def of_log(rates: Any, dt: Any, increments: bool) -> tuple[Any, Any]:
    """Rates and intervals as given, or those of a log."""
    if not isinstance(rates, GyroLog):
        if dt is None:
            raise TypeError("dt: found None; accepted: a number or intervals, s")
        return rates, dt
    if dt is not None or increments:
        name, value = ("increments", increments) if dt is None else ("dt", dt)
        raise TypeError(
            f"{name}: found {checks.brief(value)} beside a log, which has its intervals and says "
            "that its numbers are " + rates.values + "; accepted: the log alone, or its arrays"
        )
    return rates.rates, rates.dt


def are_means(rates: Any, dt: Any) -> bool:
    """Whether there is an interval for each of the rates, which are then means over them."""
    if dt is None or isinstance(dt, float):
        return False
    spans = checks.numbers("dt", dt, "a number or (n,)")
    values = checks.numbers("rates", rates, "(n, 3) or (N, n, 3)")
    return spans.ndim == 1 and values.ndim > 1 and values.shape[-2] == len(spans)


def unit_quaternions(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Quaternions (4,) or (N, 4) of any norm above zero, normalised and without −0."""
    q = checks.attitudes(name, value)
    if q.ndim > 1:
        return normalised(q.astype(np.float64)) + 0.0
    # numbers take less time than short arrays
    a, b, c, d = q.tolist()
    largest = max(abs(a), abs(b), abs(c), abs(d))
    a, b, c, d = a / largest, b / largest, c / largest, d / largest
    length = math.sqrt(a * a + b * b + c * c + d * d)
    return np.array([a / length + 0.0, b / length + 0.0, c / length + 0.0, d / length + 0.0])


def is_finite(seen: float, out: NDArray[Any]) -> bool:
    """Whether attitudes are finite; only after huge angles some of a window's may not be."""
    return seen < _HUGE or checks.all_finite(out)


def overflow(name: str, precision: np.dtype[Any]) -> ValueError:
    """The error that is raised for angles that overflow."""
    return ValueError(f"{name}: the angles overflow {precision}; accepted: smaller rates")


def warn_of_turns(seen: float, samples: Samples, *, first: int = 0, log: int = 0) -> None:
    """Warn of an interval whose rotation angle exceeds the method's limit.

    ``seen`` is the largest component of an angle, over these samples or more; ``first`` is the
    index of the first interval in the message, ``log`` that of the first log.
    """
    method, increments, data, spans, _ = samples
    limit = method.limits["increments" if increments else "rates"]
    # |w| is at most √3 of its components
    if seen * math.sqrt(3.0) <= limit:
        return
    with np.errstate(over="ignore", invalid="ignore"):
        angle = np.sqrt((data * data) @ np.ones(3, dtype=data.dtype))
        if not increments:  # of an interval, with the faster rate at its ends
            angle = np.maximum(angle[:, :-1], angle[:, 1:]) * spans
    row, k = np.unravel_index(int(np.nanargmax(angle)), angle.shape)
    most = float(angle[row, k])
    if most > limit:
        rounding.warn(
            f"dt: interval {first + k} of log {log + row} rotates by {most:.3g} rad, "
            f"{method.name}'s limit is {limit:.3g} ({int((angle > limit).sum())} of {angle.size} "
            "are past it): "
            # with two digits, rounded up by what rounding may take off
            f"sample at least {max(1.1, 1.05 * most / limit):.2g} times as often"
        )


@functools.cache
def methods_for_samples(increments: bool = False) -> dict[str, Method]:
    """The methods for sampled rates, or for increments, by name."""
    scene = "increments" if increments else "sampled rates"
    return {m.name: m for m in METHODS.values() if scene in m.scenes}


def method_of(name: str, increments: bool, *, iterates: bool = True) -> Method:
    """The method for samples of a name; raises ``ValueError`` for any other.

    ``iterates`` is False if the method must have a formula for its windows.
    """
    named = methods_for_samples(checks.flag("increments", increments))
    if not iterates:
        named = {name: x for name, x in named.items() if x.window.iteration is None}
    return named[checks.choice("method", name, named)]


def _output(out: NDArray[Any], shape: tuple[int, ...], precision: np.dtype[Any]) -> NDArray[Any]:
    if not isinstance(out, np.ndarray):
        raise TypeError(f"out: found {checks.brief(out)}; accepted: an array, or None")
    if (out.shape, out.dtype) != (shape, precision) or not out.flags.carray:
        raise ValueError(
            f"out: found {out.dtype} {out.shape}; accepted: {precision} {shape}, contiguous and "
            "writable"
        )
    return out
