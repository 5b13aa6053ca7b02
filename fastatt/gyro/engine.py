"""Integration of logs: the arrays of the loops, and their calls from threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import normalised, quat_multiply
from fastatt.gyro import ends
from fastatt.gyro.gaps import part, stretches
from fastatt.gyro.loops import LANES, STRETCH, TILE, Logs, loop
from fastatt.gyro.program import program
from fastatt.methods.windows import CHUNK, Window
from fastatt.threads import each_in_threads, in_threads, number_of

NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_AT_REST: dict[Any, NDArray[Any]] = {
    np.dtype(kind): np.tile(NO_TURN, (1, 2)).astype(kind) for kind in (np.float64, np.float32)
}
# tiles of one log for which another thread saves time
_TILES = 64
_SHORT = (2 * _TILES - 1) * TILE
# tiles between two checks for Ctrl-C, some 0.05 s
_PIECE = 4096

_Done = Callable[[int], object] | None


class GyroRun:
    """A segment of logs and a method's window: ``n`` intervals to be integrated.

    ``data`` (N, lead + m, 3) are the samples, ``lead`` of them before the first interval of the
    segment. ``spans`` is the interval, s, or the intervals, (lead + n,). ``out`` (N, n + 1, 4)
    receives the attitudes. All arrays are C-contiguous and of one precision. Without ``lead`` the
    logs begin here. They end here if the last window is incomplete.
    """

    def __init__(
        self,
        window: Window,
        increments: bool,
        data: NDArray[Any],
        spans: Any,
        out: NDArray[Any],
        lead: int = 0,
    ) -> None:
        uneven = isinstance(spans, np.ndarray)
        self._program = program(window, increments, data.dtype, uneven)
        n, self._count = data.shape[1], out.shape[1] - 1
        missing = 0 if window.iteration else -self._count % window.span
        # samples after a complete last window are not used; the last one is repeated
        beyond = [data[:, :0], data[:, n - 1 :]]
        if window.history:
            head = ends.before(spans, n, window, increments)
            beyond[0] = head @ data[:, : head.shape[1]]
        if missing:
            tail = ends.after(spans, n, missing, window, increments)
            beyond[1] = tail @ data[:, n - tail.shape[1] :]
        gaps = spans if uneven else np.empty(0, data.dtype)
        before, after = (x.astype(data.dtype, "C") for x in beyond)
        logs = len(data)
        self._arrays = data.reshape(logs, -1), before, after, gaps, out.reshape(logs, -1)
        interval = 0.0 if uneven else float(spans)
        self._fields = {
            "history": window.history, "span": window.span, "lead": lead,
            "extra": not increments, "is_uneven": uneven,
            "by_interval": uneven and not increments,
            "interval": interval, "factor": 1.0 if increments else interval,
            # an iteration has the same form for all angles
            "near": 0.0 if window.iteration else window.near,
        }  # fmt: skip

    def carry(
        self, q: NDArray[Any], *, phase: int = 0, n_threads: int | None = 1, done: _Done = None
    ) -> float:
        """Write all attitudes; p and r at the start are q (N, 8), ``phase`` intervals into a chunk.

        q then has those at the end. Returns the largest component of an angle over an interval,
        rad.
        """
        n_logs, count = len(q), self._count
        head = min(-phase % CHUNK, count)
        chunks = -(-(count - head) // CHUNK)
        if n_logs >= LANES or n_logs * -(-chunks // LANES) > chunks:
            return self._side_by_side(q, (0, count, phase), n_threads, done)
        peak = self._side_by_side(q, (0, head, phase), 1, done) if head else 0.0
        if head < count:
            for log in range(n_logs):
                peak = max(peak, self._one_log(log, q[log], (head, count - head), n_threads, done))
        return peak

    def _side_by_side(
        self, q: NDArray[Any], at: tuple[int, int, int], n_threads: int | None, done: _Done
    ) -> float:
        """Integrate many logs, with a lane for each."""
        n_logs, count, stretch = len(q), at[1], (*at, 0)
        sweep = loop("sweep", self._program.kind)
        if n_logs <= LANES and not done:
            return self._through(sweep, q, stretch, (0, n_logs))
        n_threads = number_of(n_threads)
        tiles = -(-n_logs // LANES)
        size = LANES * max(1, min(-(-tiles // n_threads), 2_000_000 // (LANES * count)))
        peaks = []

        def task(first: int) -> None:
            last = min(first + size, n_logs)
            peaks.append(self._through(sweep, q, stretch, (first, last)))
            if done:
                done((last - first) * count)

        each_in_threads([partial(task, first) for first in range(0, n_logs, size)], n_threads)
        return max(peaks)

    def _one_log(
        self, log: int, q: NDArray[Any], at: tuple[int, int], n_threads: int | None, done: _Done
    ) -> float:
        """Integrate one log, with a lane for each chunk, and tiles of chunks on each thread."""
        stretch, tiles = (*at, 0, log), -(-at[1] // TILE)
        none = np.empty((0, 4), q.dtype)
        along = loop("along", self._program.kind)
        if at[1] <= _SHORT and not done:
            return self._through(along, q, stretch, (0, tiles), none)
        threads = max(1, min(number_of(n_threads), tiles // _TILES))
        bounds = [tiles * i // threads for i in range(threads + 1)]
        starts = [q, *(q.copy() for _ in bounds[2:])]
        totals = np.empty((bounds[-2] * LANES, 4), dtype=q.dtype)
        peaks = []

        def through(bounds: tuple[int, int], p: NDArray[Any], totals: NDArray[Any]) -> None:
            peaks.append(self._through(along, p, stretch, bounds, totals))

        if threads > 1:
            known = bounds[-2]
            size = min(_PIECE, -(-known // threads))
            pieces = ((a, min(a + size, known)) for a in range(0, known, size))
            each_in_threads([partial(through, piece, q, totals) for piece in pieces], threads)
            chain = loop("chain", self._program.kind)
            for i in range(1, threads):
                starts[i][:] = starts[i - 1]
                first, last = (LANES * k for k in bounds[i - 1 : i + 1])
                self._through(chain, starts[i], stretch, (first, last), totals)

        def task(p: NDArray[Any], first: int, last: int, stop: Event) -> None:
            for a in range(first, last, _PIECE):
                if stop.is_set():
                    return
                z = min(a + _PIECE, last)
                through((a, z), p, none)
                if done:
                    done(min(TILE * z, at[1]) - TILE * a)

        runs = zip(starts, pairwise(bounds), strict=True)
        in_threads([partial(task, p, a, z) for p, (a, z) in runs], threads)
        q[:] = starts[-1]
        return max(peaks)

    def _through(
        self, run: Callable[..., int], q: NDArray[Any], at: tuple[int, ...],
        bounds: tuple[int, int], *totals: NDArray[Any],
    ) -> float:  # fmt: skip
        """Call a loop until it has finished; returns the largest component of an angle, rad.

        ``at`` are the first interval, their number, how many of its chunk are done, and the log.
        """
        made, largest, (first, last) = self._program, np.zeros(1), bounds
        fields = self._fields | {"small_angle": made.entry, "any_angle": made.any_angle}
        fields |= zip(("first", "count", "phase", "log"), at, strict=True)
        stretch = np.array([tuple(fields[name] for name in STRETCH.names or ())], STRETCH)
        logs, memory = Logs(*self._arrays, np.atleast_2d(q)), made.memory()
        while (first := run(stretch, logs, memory, *totals, largest, first, last)) < last:
            made.compile_any_angle()
            stretch["any_angle"] = made.any_angle
        return float(largest[0])


def finish(
    window: Window, increments: bool, data: NDArray[Any], spans: Any, out: NDArray[Any]
) -> None:
    """Attitudes ``out[:, 1:]`` from ``out[:, 0]`` for the incomplete window at the end of logs."""
    count = out.shape[1] - 1
    samples, apart, places = ends.rest(data, spans, count, window, increments)
    turns = np.empty((len(out), window.span + 1, 4), dtype=out.dtype)
    run = GyroRun(window, increments, samples, apart, turns)
    run.carry(beginning(NO_TURN, len(out), out.dtype))
    out[:, 1:] = quat_multiply(out[:, :1], turns[:, places])


def integrate(
    window: Window,
    increments: bool,
    data: NDArray[Any],
    spans: Any,
    out: NDArray[Any],
    q: NDArray[Any],
    *,
    n_threads: int | None = 1,
    done: _Done = None,
) -> float:
    """Write the attitudes of whole logs, from q as in :meth:`GyroRun.carry`, into ``out``.

    The windows begin anew at cuts. Returns the largest component of an angle over an interval, rad.
    """
    count, seen = out.shape[1] - 1, 0.0
    for first, last in stretches(window, spans, count):
        samples, apart = part(data, spans, increments, first, last)
        own = np.ascontiguousarray(out[:, first : last + 1])
        if first:
            own = own.copy()  # the attitude before a cut is not normalised in the result
            q[:] = beginning(normalised(own[:, 0]), len(q), q.dtype)
        run = GyroRun(window, increments, samples, apart, own)
        seen = max(seen, run.carry(q, n_threads=n_threads, done=done))
        rest = (last - first) % window.span
        if window.iteration and rest:
            end = np.ascontiguousarray(own[:, -rest - 1 :])
            finish(window, increments, samples, apart, end)
            own[:, -rest:] = end[:, 1:]
        if not np.may_share_memory(own, out):
            out[:, first + bool(first) : last + 1] = own[:, bool(first) :]
    return seen


def beginning(unit: NDArray[Any], n_logs: int, precision: np.dtype[Any]) -> NDArray[Any]:
    """The initial state of logs: unit quaternions p, (4,) or (N, 4), and the identity r."""
    q = np.repeat(_AT_REST[precision], n_logs, axis=0) if n_logs > 1 else _AT_REST[precision].copy()
    if unit is not NO_TURN:
        q[:, :4] = unit
    return q
