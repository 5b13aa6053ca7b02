"""Integration of sampled rates, or of angle increments, to attitudes."""

from __future__ import annotations

import functools
import math
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
    rates: ArrayLike | GyroLog,
    dt: ArrayLike | None = None,
    q0: ArrayLike = _UNTURNED,
    *,
    method: str = "previous",
    increments: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    max_gap: float | None = None,
    out: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """Integrate body rates sampled at given times, or angle increments, to attitudes.

    Parameters
    ----------
    rates : array_like of shape (n, 3) or (N, n, 3), or GyroLog
        Rates along body axes, rad/s, at n times; with n intervals, mean rates over these; with
        ``increments``, angle increments, rad. A log has its intervals and says what its numbers
        are.
    dt : float or array_like
        The interval, s, or the intervals: (n - 1,) for rates at n times, (n,) for mean rates and
        for increments. All are above 0. None for a log.
    q0 : array_like of shape (4,) or (N, 4), default (1, 0, 0, 0)
        Attitude at the first time, body to inertial, scalar first.
    method : str, default "previous"
        "hold", "trapezoid" (rates only), "previous", "coning2" or "picard".
    increments : bool, default False
        Whether ``rates`` are angle increments.
    dtype : {float64, float32}, optional
        Precision; the default is float32 if ``rates`` is a float32 array, and float64 otherwise.
    n_threads : int, optional
        Number of threads for many logs; the default is every processor. Results do not depend on
        it.
    max_gap : float, optional
        The longest interval that is accepted, s; the default is 10 times the median.
    out : ndarray, optional
        Array for the result. Writing to memory that was used before takes half the time.

    Returns
    -------
    ndarray of shape (n, 4) or (N, n, 4)
        Attitudes at the times of the samples; for n means or increments (n + 1, 4) or (N, n + 1,
        4).

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
    values, dt = of_log(rates, dt, increments)
    means = not increments and are_means(values, dt)
    increments = increments or means
    record = method_of(method, increments)
    name = "rates (increments)" if increments and not means else "rates"
    data = checks.array(name, values, "(n, 3) or (N, n, 3)", flag=True)
    one = data.ndim == 2
    precision = checks.precision(dtype, values)
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
    warn_of_turns(seen, samples)
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
    if dt is None:
        return False
    spans = checks.numbers("dt", dt, "a number or (n,)")
    values = checks.numbers("rates", rates, "(n, 3) or (N, n, 3)")
    return spans.ndim == 1 and values.ndim > 1 and values.shape[-2] == len(spans)


def unit_quaternions(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Quaternions (4,) or (N, 4) of any norm above zero, normalised and without −0."""
    q = checks.attitudes(name, value).astype(np.float64)
    if q.ndim > 1:
        return normalised(q) + 0.0
    # numbers take less time than short arrays
    largest = max(map(abs, q.tolist()))
    a, b, c, d = (x / largest for x in q.tolist())
    length = math.sqrt(a * a + b * b + c * c + d * d)
    return np.array([x / length + 0.0 for x in (a, b, c, d)])


def is_finite(seen: float, out: NDArray[Any]) -> bool:
    """Whether attitudes are finite; only after huge angles some of a window's may not be."""
    return seen < _HUGE or checks.all_finite(out)


def overflow(name: str, precision: np.dtype[Any]) -> ValueError:
    """The error that is raised for angles that overflow."""
    return ValueError(f"{name}: the angles overflow {precision}; accepted: smaller rates")


def warn_of_turns(seen: float, samples: Samples, *, first: int = 0) -> None:
    """Warn of an interval whose rotation angle exceeds the method's limit.

    ``seen`` is the largest component of an angle, over these samples or more; ``first`` is the
    index of the first interval in the message.
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
    log, k = np.unravel_index(int(np.nanargmax(angle)), angle.shape)
    most = float(angle[log, k])
    if most > limit:
        rounding.warn(
            f"dt: interval {first + k} of log {log} rotates by {most:.3g} rad, {method.name}'s "
            f"limit is {limit:.3g} ({int((angle > limit).sum())} of {angle.size} are past it): "
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
