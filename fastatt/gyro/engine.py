"""Integration of logs: the arrays of the loops, and their calls from threads."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import normalised, quat_multiply
from fastatt.gyro import ends
from fastatt.gyro.intervals import cuts, stretches
from fastatt.gyro.loops import LANES, TILE, Logs, Part, loop
from fastatt.gyro.program import GyroProgram, program
from fastatt.methods import Method
from fastatt.methods.windows import CHUNK, Window
from fastatt.threads import each_in_threads, number_of

Array = NDArray[Any]
NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
# tiles of one log, and intervals of logs side by side, between two checks for Ctrl-C: some 0.05 s
_PIECE_OF_ONE, _PIECE_OF_MANY = 4096, 2_000_000


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
    def window(self) -> Window:
        """The method's window."""
        window: Window = self.method.window
        return window

    @property
    def n_intervals(self) -> int:
        """Number of intervals."""
        return len(self.data[0]) - self.lead - (not self.increments)

    def between(self, first: int, last: int) -> Samples:
        """The samples of the intervals [first, last), those of the lead included."""
        data = np.ascontiguousarray(self.data[:, first : last + (not self.increments)])
        spans = self.spans[first:last] if np.ndim(self.spans) else self.spans
        return self._replace(data=data, spans=spans, lead=0)


class _Run(NamedTuple):
    program: GyroProgram
    logs: Logs

    def perform(
        self, name: str, first: int, count: int, done: int, log: int, tiles: tuple[int, int]
    ) -> float:
        """Call a loop until it has finished; returns the largest component of an angle, rad.

        ``first`` to ``log`` as in :class:`fastatt.gyro.loops.Part`.
        """
        windows, largest, (tile, last) = self.program, np.zeros(1), tiles
        run, memory = loop(name, windows.kind), windows.memory()
        while True:
            part = Part(first, count, done, log, windows.entry, windows.any_angle)
            tile = run(windows.shape, self.logs, part, memory, largest, tile, last)
            if tile >= last:
                return float(largest[0])
            windows.compile_any_angle()


def advance(
    samples: Samples, out: Array, q: Array, *, phase: int = 0, n_threads: int | None = 1
) -> float:
    """Write the attitudes after the first one, ``out`` (N, n + 1, 4), of n intervals.

    p and r at the start are q (N, 8), ``phase`` intervals into a chunk; q then has those at the
    end. The logs end here if the last window is incomplete. Returns the largest component of an
    angle over an interval, rad; infinity if it is unknown.
    """
    window, count = samples.window, out.shape[1] - 1
    rest = count % window.span if window.iteration else 0
    whole, seen = count - rest, 0.0
    if whole:
        attitudes = out if not rest else np.ascontiguousarray(out[:, : whole + 1])
        seen = _through_windows(samples, attitudes, q, phase, n_threads)
        if rest:
            out[:, : whole + 1] = attitudes
    if rest:
        _finish(samples, out[:, whole:])
        seen = np.inf
    return seen


def _through_windows(
    samples: Samples, out: Array, q: Array, phase: int, n_threads: int | None
) -> float:
    run = _Run(*_prepared(samples, out, q))
    n_logs, count = len(q), out.shape[1] - 1
    head = min(-phase % CHUNK, count)
    chunks = -(-(count - head) // CHUNK)
    if n_logs >= LANES or n_logs * -(-chunks // LANES) > chunks:
        return _side_by_side(run, count, phase, n_threads)
    seen = run.perform("sweep", 0, head, phase, 0, (0, n_logs)) if head else 0.0
    tiles = -(-(count - head) // TILE)
    for log in range(n_logs):
        for first in range(0, tiles, _PIECE_OF_ONE):
            piece = first, min(first + _PIECE_OF_ONE, tiles)
            seen = max(seen, run.perform("along", head, count - head, 0, log, piece))
    return seen


def _prepared(samples: Samples, out: Array, q: Array) -> tuple[GyroProgram, Logs]:
    """The program of a window, and the arrays that it works on."""
    window = samples.window
    _, increments, data, spans, lead = samples
    uneven = isinstance(spans, np.ndarray)
    n_logs, n = data.shape[:2]
    missing = 0 if window.iteration else -(out.shape[1] - 1) % window.span
    before, after = ends.beyond(data, spans, window, increments, missing)
    if not missing:  # samples after a complete last window are not used; the last one is repeated
        after = data[:, n - 1 :]
    interval = 0.0 if uneven else float(spans)
    logs = Logs(
        samples=data.reshape(n_logs, -1),
        before=before.astype(data.dtype, "C"),
        after=after.astype(data.dtype, "C"),
        intervals=spans if uneven else np.empty(0, data.dtype),
        attitudes=out.reshape(n_logs, -1),
        q=q,
        lead=lead,
        interval=interval,
        factor=1.0 if increments else interval,
    )
    return program(window, increments, data.dtype, uneven), logs


def _side_by_side(run: _Run, count: int, phase: int, n_threads: int | None) -> float:
    """Integrate many logs, with a lane for each."""
    n_logs, peaks = len(run.logs.q), []
    n_threads = 1 if n_logs <= LANES else number_of(n_threads)
    tiles = -(-n_logs // LANES)
    size = LANES * max(1, min(-(-tiles // n_threads), _PIECE_OF_MANY // (LANES * count)))

    def task(first: int) -> None:
        logs = first, min(first + size, n_logs)
        peaks.append(run.perform("sweep", 0, count, phase, 0, logs))

    each_in_threads([partial(task, first) for first in range(0, n_logs, size)], n_threads)
    return max(peaks)


def _finish(samples: Samples, out: Array) -> None:
    """Attitudes ``out[:, 1:]`` from ``out[:, 0]`` for the incomplete window at the end of logs."""
    window = samples.window
    method, increments, data, spans, _ = samples
    fine, apart, places = ends.rest(data, spans, out.shape[1] - 1, window, increments)
    turns = np.empty((len(out), window.span + 1, 4), dtype=out.dtype)
    start = beginning(NO_TURN, len(out), out.dtype)
    _through_windows(Samples(method, increments, fine, apart), turns, start, 0, 1)
    out[:, 1:] = quat_multiply(out[:, :1], turns[:, places])


def integrate(samples: Samples, out: Array, start: Array, n_threads: int | None) -> float:
    """Write the attitudes of whole logs, which begin at ``start``, into ``out``.

    The windows begin anew at cuts. Returns the largest component of an angle over an interval, rad;
    infinity if it is unknown.
    """
    n_logs, count, seen = len(out), out.shape[1] - 1, 0.0
    out[:, 0] = start
    window = samples.window
    places = [k for k, _ in cuts(window.uneven, samples.spans)] if window.intervals > 1 else []
    for first, last in stretches(places, count):
        if last - first == count:
            return advance(samples, out, beginning(start, n_logs, out.dtype), n_threads=n_threads)
        attitudes = out[:, first : last + 1].copy()
        # the attitude before a cut is not normalised in the result
        unit = normalised(attitudes[:, 0]) if first else start
        attitudes[:, 0] = unit
        q = beginning(unit, n_logs, out.dtype)
        seen = max(seen, advance(samples.between(first, last), attitudes, q, n_threads=n_threads))
        out[:, first + 1 : last + 1] = attitudes[:, 1:]
    return seen


def beginning(unit: Array, n_logs: int, precision: np.dtype[Any]) -> Array:
    """The initial state of logs: unit quaternions p, (4,) or (N, 4), and the identity r."""
    q = np.zeros((n_logs, 8), precision)
    q[:, :4] = unit
    q[:, 4] = 1.0
    return q
