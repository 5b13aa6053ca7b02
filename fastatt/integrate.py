"""Sampled rates, or angle increments, to attitudes."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised
from fastatt.gyro.engine import Run
from fastatt.gyro.windows import LANES, TILE, Window
from fastatt.methods import METHODS, Method
from fastatt.running.limits import StepWarning
from fastatt.threads import in_threads, number_of, progress_bar

_GAP = 10.0  # an interval this many times the median is a hole in the log


def integrate_rates(
    rates: ArrayLike,
    dt: ArrayLike,
    q0: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    *,
    method: str = "previous",
    increments: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    progress: bool = False,
    max_gap: float | None = None,
    out: NDArray[Any] | None = None,
) -> NDArray[Any]:
    """Attitudes from body rates sampled at instants, or from angle increments over intervals.

    Parameters
    ----------
    rates : (n, 3) or (N, n, 3), rad/s at n instants; with ``increments``, rad over n intervals.
    dt : the interval, s, or the intervals, (n − 1,) for rates, (n,) for increments; all above 0.
    q0 : (4,) or (N, 4), attitude at the first instant, body to inertial, scalar first.
    method : "hold", "trapezoid" (rates), "previous", "coning2", "coning3", "coning3_optimal"
        (equal increments), "picard".
    dtype : float64 or float32; None takes float32 when ``rates`` is a float32 array.
    n_threads : None takes every processor; results do not depend on it.
    max_gap : longest interval allowed, s; None: 10 times the median.
    out : array for the result; memory that was used before is written twice as fast as new.

    Returns
    -------
    (n, 4) or (N, n, 4) attitudes at the instants; of n increments (n + 1, 4) or (N, n + 1, 4).

    Raises
    ------
    ValueError : a shape that does not fit, a number that is not finite, an interval that is zero,
        negative (a repeated or decreasing time stamp) or a gap; an unknown method.

    Warns
    -----
    StepWarning : an interval in which the body turns further than the method can follow.
    """
    record = _method(method, increments)
    name = "rates (increments)" if increments else "rates"
    data = checks.array_any(name, rates, "(n, 3) or (N, n, 3)", [(-1, 3), (-1, -1, 3)])
    one = data.ndim == 2
    precision = checks.precision(dtype, rates)
    data = np.ascontiguousarray(data if not one else data[None], dtype=precision)
    n_logs, n = data.shape[:2]
    count = n if increments else n - 1
    spans = intervals(dt, count, max_gap, precision)
    if method == "coning3_optimal" and isinstance(spans, np.ndarray):
        raise ValueError(
            'dt: found intervals; accepted with "coning3_optimal": one number, its coefficients '
            'hold for equal intervals ("coning3" takes any)'
        )
    threads = number_of(n_threads)
    start = checks.attitudes("q0", q0)
    if start.ndim == 2 and start.shape[0] != n_logs:
        raise ValueError(f"q0: has shape {start.shape}; accepted: (4,) or ({n_logs}, 4), one a log")

    shape = (count + 1, 4) if one else (n_logs, count + 1, 4)
    result = _output(out, shape, precision)
    out = result.reshape(n_logs, count + 1, 4)
    unit = np.broadcast_to(normalised(start.astype(np.float64)), (n_logs, 4))
    unit = np.array(unit, dtype=precision, order="C")
    if count == 0:
        out[:, 0] = unit
        return result
    with np.errstate(over="ignore", invalid="ignore"):  # looked at in the result
        ends = beyond(data, spans, record.window, increments)
    run = Run(record.window, increments, data, ends, spans, out)
    with progress_bar(progress, n_logs * count, "sample") as done:
        if n_logs >= LANES:
            seen = _side_by_side(run, unit, count, threads, done)
        else:
            seen = max(_one_log(run, b, unit[b], count, threads, done) for b in range(n_logs))
    # a sample that is not finite stays in every later attitude; the last may not be used
    if not (np.isfinite(out[:, -1]).all() and np.isfinite(data[:, -1]).all()):
        checks.finite(name, data[0] if one else data)
        raise ValueError(f"{name}: the angles overflow {precision}; accepted: smaller rates")
    limit = record.limit("increments" if increments else "rates")
    # |w| is at most √3 of its components
    if float(seen) * math.sqrt(3.0) > limit:
        _warn(data, spans, limit, record.name, increments)
    return result


def _warn(data: NDArray[Any], spans: Any, limit: float, method: str, increments: bool) -> None:
    """Say where an interval turns further than the method can follow."""
    n = data.shape[1]
    longer: Any = 1.0
    if not increments:
        around = np.concatenate([[0.0], np.broadcast_to(spans, n - 1), [0.0]])
        longer = np.maximum(around[1:], around[:-1])
    with np.errstate(over="ignore", invalid="ignore"):
        angle = np.sqrt((data * data) @ np.ones(3, dtype=data.dtype)) * longer
    log, k = np.unravel_index(int(np.nanargmax(angle)), angle.shape)
    most = float(angle[log, k])
    if most > limit:
        warnings.warn(
            f"dt: interval {k} of log {log} turns by {most:.3g} rad, {method}'s limit is "
            f"{limit:.3g} ({int((angle > limit).sum())} of {angle.size} are past it): sample "
            f"more than {most / limit:.2g} times as often",
            StepWarning,
            stacklevel=3,
        )


def methods_for_samples(increments: bool = False) -> list[str]:
    """Names of the methods for sampled rates, or for increments."""
    scene = "increments" if increments else "sampled rates"
    return [m.name for m in METHODS.values() if scene in m.scenes]


def _method(name: str, increments: bool) -> Method:
    checks.choice("method", name, methods_for_samples(increments))
    return METHODS[name]


def _side_by_side(
    run: Run, q: NDArray[Any], count: int, threads: int, done: Callable[[int], object]
) -> float:
    """A lane for each log; the largest component of an angle over an interval, rad."""
    n_logs = len(q)
    lanes = np.arange(n_logs), np.zeros(n_logs, dtype=np.int64)
    peak = np.zeros(n_logs, dtype=q.dtype)
    tiles = -(-n_logs // LANES)
    size = LANES * max(1, min(-(-tiles // threads), 2_000_000 // (LANES * count)))

    def task(first: int, stop: Event) -> None:
        if not stop.is_set():
            last = min(first + size, n_logs)
            run.side_by_side(lanes, count, q, peak, (first, last))
            done((last - first) * count)

    in_threads([partial(task, first) for first in range(0, n_logs, size)], threads)
    return float(peak.max())


def _one_log(
    run: Run,
    log: int,
    q: NDArray[Any],
    count: int,
    threads: int,
    done: Callable[[int], object],
) -> float:
    """Runs of tiles on each thread, and what is left of the last tile in one lane.

    Gives the largest component of an angle over an interval, rad.
    """
    tiles = count // TILE
    threads = max(1, min(threads, tiles // 64))
    bounds = [tiles * i // threads for i in range(threads + 1)]
    peak = np.zeros(tiles + 1, dtype=q.dtype)
    totals = np.empty((tiles, 4), dtype=q.dtype)
    starts = [q.copy() for _ in range(threads)]
    if threads > 1:
        known = bounds[-2]
        parts = [known * i // threads for i in range(threads + 1)]

        def find(first: int, last: int, stop: Event) -> None:
            for piece in _pieces(first, last, stop):
                run.find_turns(log, totals, peak, piece)

        in_threads([partial(find, a, z) for a, z in pairwise(parts)], threads)
        for i in range(1, threads):
            starts[i][:] = starts[i - 1]
            run.chain(starts[i], totals[bounds[i - 1] : bounds[i]])

    def along(q: NDArray[Any], first: int, last: int, stop: Event) -> None:
        for piece in _pieces(first, last, stop):
            run.along(log, q, peak, piece)
            done((piece[1] - piece[0]) * TILE)

    runs = zip(starts, pairwise(bounds), strict=True)
    in_threads([partial(along, q, a, z) for q, (a, z) in runs], threads)
    rest = count - tiles * TILE
    if rest or not tiles:
        lane = np.array([log]), np.array([tiles * TILE])
        run.side_by_side(lane, rest, starts[-1][None], peak[-1:], (0, 1))
        done(rest)
    return float(peak.max())


def _pieces(first: int, last: int, stop: Event) -> Iterator[tuple[int, int]]:
    """Cuts between which a run may be stopped, some 0.05 s apart."""
    for a in range(first, last, 4096):
        if stop.is_set():
            return
        yield a, min(a + 4096, last)


def _output(
    out: NDArray[Any] | None, shape: tuple[int, ...], precision: np.dtype[Any]
) -> NDArray[Any]:
    if out is None:
        return np.empty(shape, dtype=precision)
    if not isinstance(out, np.ndarray):
        raise TypeError(f"out: found {checks.brief(out)}; accepted: an array, or None")
    if (out.shape, out.dtype) != (shape, precision) or not out.flags.carray:
        raise ValueError(
            f"out: found {out.dtype} {out.shape}; accepted: {precision} {shape}, contiguous and "
            "writable"
        )
    return out


def _allowed(max_gap: Any) -> float:
    allowed = checks.any_real("max_gap", max_gap, "a number above 0, or inf")
    if not allowed > 0.0:
        raise ValueError(f"max_gap: found {allowed}; accepted: a number above 0, or inf")
    return allowed


def intervals(dt: ArrayLike, count: int, max_gap: float | None, precision: np.dtype[Any]) -> Any:
    """One number of the precision, or an array of ``count`` intervals."""
    accepted = f"a number or ({count},)"
    spans = checks.array("dt", dt, accepted, [(), (count,)])
    if spans.ndim == 0:
        interval = checks.real("dt", spans)
        if interval <= 0.0:
            raise ValueError(f"dt: found {interval}; accepted: an interval above 0")
        return precision.type(interval)
    if not count:
        return spans.astype(precision)
    bad = spans <= 0.0
    if bad.any():
        k = int(np.argmax(bad))
        what = "a repeated" if spans[k] == 0.0 else "a decreasing"
        raise ValueError(f"dt[{k}] is {spans[k]}: {what} time stamp; accepted: intervals above 0")
    with np.errstate(over="ignore"):
        longest = _GAP * float(np.median(spans)) if max_gap is None else _allowed(max_gap)
    if spans.max() > longest:
        k = int(np.argmax(spans))
        raise ValueError(
            f"dt[{k}] is {spans[k]}: a gap; accepted: at most {longest:.6g} s; cut the log there, "
            "or pass max_gap to go across it"
        )
    return np.ascontiguousarray(spans, dtype=precision)


def beyond(
    data: NDArray[Any], spans: Any, window: Window, increments: bool
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Samples before and after the log, by the polynomial of the nearest whole window."""
    n_logs, n = data.shape[:2]
    count = n if increments else n - 1
    near = min(window.samples(increments), n)
    inside = near if increments else near - 1
    gaps = np.full(max(count, 1), spans) if np.ndim(spans) == 0 else spans
    gaps = gaps.astype(np.float64)
    missing = -count % window.span
    head = np.zeros((n_logs, 1, 3))
    tail = np.zeros((n_logs, 1, 3))
    if window.history:
        first = data[:, :near][:, ::-1]
        head = _extrapolate(first, gaps[:inside][::-1], gaps[0], window.history, increments)[
            :, ::-1
        ]
    if missing:
        tail = _extrapolate(
            data[:, n - near :], gaps[count - inside :], gaps[-1], missing, increments
        )
    return (
        np.ascontiguousarray(head, dtype=data.dtype),
        np.ascontiguousarray(tail, dtype=data.dtype),
    )


def _extrapolate(
    samples: NDArray[Any], gaps: NDArray[Any], gap: float, n: int, increments: bool
) -> NDArray[np.float64]:
    """``n`` further samples after those given, spaced by ``gap``."""
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    far = (nodes[-1] + gap * np.arange(1, n + 1))[:, None] - nodes
    apart = nodes[:, None] - nodes
    np.fill_diagonal(apart, 1.0)
    lagrange = far.prod(axis=1)[:, None] / far / apart.prod(axis=1)
    if not increments:
        return np.asarray(lagrange @ samples)
    # the polynomial is that of the running angle, from 0 at the first node
    running = lagrange[:, 1:] @ samples.cumsum(axis=1)
    total = samples.sum(axis=1, keepdims=True)
    return np.diff(np.concatenate([total, running], axis=1), axis=1)
