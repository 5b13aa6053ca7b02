"""Integration of logs: the arrays of the loops, and their calls from threads."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import normalised, quat_multiply
from fastatt.gyro import ends
from fastatt.gyro.intervals import cuts, stretches
from fastatt.gyro.loops import LANES, Logs, Part, loop
from fastatt.gyro.window_loops import GyroProgram, program
from fastatt.methods import Method
from fastatt.methods.windows import CHUNK
from fastatt.threads import in_threads, number_of

Array = NDArray[Any]
NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
# tiles between two checks for Ctrl-C: some 0.05 s
_PIECE = 4096


class Samples(NamedTuple):
    """Samples of logs, and the method that integrates them.

    ``data`` (N, lead + m, 3) are rates, or angle increments, ``lead`` of them before the first
    interval. ``spans`` is the interval, s, or the intervals, (lead + n,). Arrays are C-contiguous
    and of one precision. Without ``lead`` the logs begin here.
    """

    method: Method
    increments: bool
    data: Array
    spans: Any
    lead: int = 0

    @property
    def n_intervals(self) -> int:
        """Number of intervals."""
        return len(self.data[0]) - self.lead - (not self.increments)

    def between(self, first: int, last: int) -> Samples:
        """The samples of the intervals [first, last), those of the lead included."""
        data = np.ascontiguousarray(self.data[:, first : last + (not self.increments)])
        spans = self.spans[first:last] if np.ndim(self.spans) else self.spans
        return self._replace(data=data, spans=spans, lead=0)


def integrate(samples: Samples, out: Array, start: Array, n_threads: int | None) -> float:
    """Write the attitudes of whole logs, which begin at ``start``, into ``out``.

    The windows begin anew at cuts. Returns the largest component of an angle over an interval, rad;
    infinity if it is unknown.
    """
    n_logs, count, seen = len(out), out.shape[1] - 1, 0.0
    out[:, 0] = start
    window = samples.method.window
    places = [k for k, _ in cuts(window.uneven, samples.spans)] if window.intervals > 1 else []
    if not places:
        return advance(samples, out, beginning(start, n_logs, out.dtype), n_threads=n_threads)
    for first, last in stretches(places, count):
        attitudes, before = out[:, first : last + 1], out[:, first].copy()
        attitudes[:, 0] = unit = normalised(before) if first else start
        part, q = samples.between(first, last), beginning(unit, n_logs, out.dtype)
        seen = max(seen, advance(part, attitudes, q, n_threads=n_threads))
        attitudes[:, 0] = before  # which is not normalised in the result
    return seen


def beginning(unit: Array, n_logs: int, precision: np.dtype[Any]) -> Array:
    """The initial state of logs: unit quaternions p, (4,) or (N, 4), and the identity r."""
    q = np.zeros((n_logs, 8), precision)
    q[:, :4] = unit
    q[:, 4] = 1.0
    return q


def advance(
    samples: Samples, out: Array, q: Array, *, phase: int = 0, n_threads: int | None = 1
) -> float:
    """Write the attitudes after the first one, ``out`` (N, n + 1, 4), of n intervals.

    p and r at the start are q (N, 8), ``phase`` intervals into a chunk; q then has those at the
    end. The logs end here if the last window is incomplete. Returns the largest component of an
    angle over an interval, rad; infinity if it is unknown.
    """
    window, count = samples.method.window, out.shape[1] - 1
    rest = count % window.span if window.iteration else 0
    whole = count - rest
    seen = _through_windows(samples, out[:, : whole + 1], q, phase, n_threads) if whole else 0.0
    if not rest:
        return seen
    _finish(samples, out[:, whole:])
    return np.inf


def _through_windows(
    samples: Samples, out: Array, q: Array, phase: int, n_threads: int | None
) -> float:
    attitudes = np.ascontiguousarray(out)  # out itself, but for a part of several logs
    windows, logs = _prepared(samples, attitudes, q)
    n_logs, count = len(q), out.shape[1] - 1
    n_chunks = -(-(phase + count) // CHUNK)
    n_tiles = -(-n_chunks // LANES)
    by_log = n_logs >= LANES or n_logs * n_tiles > n_chunks
    # groups of logs, and the tiles of each
    groups, n_tiles = (-(-n_logs // LANES), n_chunks) if by_log else (n_logs, n_tiles)
    threads = 1 if n_logs <= LANES else number_of(n_threads)
    size = n_tiles * max(1, min(-(-groups // threads), _PIECE // n_tiles))
    run, total = loop(windows.precision), groups * n_tiles

    def task(tile: int) -> float:
        last, largest = min(tile + size, total), np.zeros(1)
        while tile < last:
            part = Part(count, phase, n_chunks, by_log, windows.entry, windows.any_angle)
            end = min(tile + _PIECE, last)
            tile = run(windows.shape, logs, part, windows.memory(), largest, tile, end)
            if tile < end:
                windows.compile_any_angle()
        return float(largest[0])

    if size >= total:  # threads take time
        seen = task(0)
    else:
        seen = max(in_threads([partial(task, first) for first in range(0, total, size)], threads))
    if attitudes is not out:
        out[:] = attitudes
    return seen


def _prepared(samples: Samples, out: Array, q: Array) -> tuple[GyroProgram, Logs]:
    """The program of a window, and the arrays that it works on."""
    method, increments, data, spans, lead = samples
    window, uneven = method.window, isinstance(spans, np.ndarray)
    missing = 0 if window.iteration else -(out.shape[1] - 1) % window.span
    before, after = ends.beyond(data, spans, window, increments, missing)
    known, interval = (spans, 0.0) if uneven else (np.empty(0, data.dtype), float(spans))
    logs = Logs(data, before, after, known, attitudes=out, q=q, lead=lead, interval=interval)
    return program(window, increments, data.dtype, uneven), logs


def _finish(samples: Samples, out: Array) -> None:
    """Attitudes ``out[:, 1:]`` from ``out[:, 0]`` for the incomplete window at the end of logs."""
    window = samples.method.window
    method, increments, data, spans, _ = samples
    fine, apart, places = ends.rest(data, spans, out.shape[1] - 1, window, increments)
    turns = np.empty((len(out), window.span + 1, 4), dtype=out.dtype)
    start = beginning(NO_TURN, len(out), out.dtype)
    _through_windows(Samples(method, increments, fine, apart), turns, start, 0, 1)
    out[:, 1:] = quat_multiply(out[:, :1], turns[:, places])
