"""The loops over logs that all methods share: plain loops over NumPy arrays.

Attitudes of a log are q = p∘r, with p at the start of a chunk of 48 intervals and the rotation r
from there. The samples of each lane's chunk are loaded into rows, the windows of a method run
across the lanes, and the attitudes are stored. Rotations of chunks are computed in parallel lanes,
for many logs or for one, and then chained through p. The bits of a log therefore do not depend on
other logs, on how it is divided, or on the number of threads.

The windows for any rotation angle are compiled when a chunk first needs them. A loop then returns
the index of that tile, from which the next call continues.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import from_dtype, types

from fastatt._jit import loop_part, machine
from fastatt.codegen.call import TYPES, call
from fastatt.methods.windows import CHUNK

#: lanes of a tile
LANES = 16
TILE = LANES * CHUNK

#: parts of a program's function (``fastatt.gyro.program``)
SAMPLES, INTERVALS, WINDOWS, PLACE, JOIN = range(5)


class State(NamedTuple):
    """The rows of a chunk's ``state``.

    p at the start of a chunk, the rotation of the chunk, p at its end; the largest sample and
    interval of each lane; then the rows of an iteration.
    """

    start: int = 0
    turned: int = 4
    next: int = 8
    sample: int = 12
    interval: int = 13
    iteration: int = 14


ROWS = State()

#: a method's windows on a part of logs: addresses of the functions for small angles and for any, or
#: 0; the shape of a window; whether intervals are uneven, and the angle depends on each; how many
#: samples come before the first interval; the first interval, their number, how many of its chunk
#: are done; the log, if it is one; the equal interval, s; the factor from a sample to its angle
#: over an interval; the angle below which rotations are at most π
STRETCH = np.dtype(
    [
        (name, np.int64)
        for name in (
            "small_angle", "any_angle", "history", "span", "extra", "is_uneven", "by_interval",
            "lead", "first", "count", "phase", "log",
        )
    ]
    + [(name, np.float64) for name in ("interval", "factor", "near")]
)  # fmt: skip


class Logs(NamedTuple):
    """The arrays of logs: samples (N, 3 (lead + n)), those beyond them (N, k, 3), and intervals, s.

    ``attitudes`` (N, 4 n_out) are written; ``q`` are p and r of each log (N, 8).
    """

    samples: Any
    before: Any
    after: Any
    intervals: Any
    attitudes: Any
    q: Any


class Chunk(NamedTuple):
    """The memory of a thread: rows of lanes for samples, intervals, attitudes, and a state."""

    samples: Any
    intervals: Any
    attitudes: Any
    state: Any


@loop_part
def load(s, logs, chunk, log, first, windows, width, by_log):
    """Copy what the windows of chunks from an interval on need to lanes; the last one fills up.

    Each lane has a log, ``by_log`` 1, or the chunk after that of the lane before, 0.
    """
    n, intervals = logs.samples.shape[1] // 3 - s.lead, s.history + windows * s.span
    count = intervals + s.extra
    for lane in range(LANES):
        k = min(lane, width - 1)
        row, since = log + k * by_log, first - s.history + k * CHUNK * (1 - by_log)
        # samples [begin, end) are those of the log
        begin = min(max(-s.lead - since, 0), count)
        end = max(min(n - since, count), begin)
        at = 3 * (s.lead + since)
        own, lanes = logs.samples[row, at + 3 * begin : at + 3 * end], chunk.samples[3 * begin :]
        for i in range(own.size):
            lanes[i, lane] = own[i]
        for i in range(begin):
            for axis in range(3):
                chunk.samples[3 * i + axis, lane] = logs.before[row, -1 - s.lead - since - i, axis]
        for i in range(end, count):
            beyond = min(since + i - n, logs.after.shape[1] - 1)
            for axis in range(3):
                chunk.samples[3 * i + axis, lane] = logs.after[row, beyond, axis]
        if s.is_uneven == 0:
            chunk.intervals[0, lane] = s.interval
        else:
            for i in range(intervals):
                at = min(max(since + i, -s.lead), logs.intervals.shape[0] - s.lead - 1)
                chunk.intervals[i, lane] = logs.intervals[at + s.lead]


@loop_part
def run_windows(s, chunk, windows, largest):
    """Run the windows of a chunk; returns False if those for any angle are not compiled.

    Both give the same bits for a rotation of at most π, so that the lanes of a tile do not affect
    each other.
    """
    state, is_small, intervals = chunk.state, True, s.history + windows * s.span
    for j in range(LANES):
        state[ROWS.sample, j], state[ROWS.interval, j] = 0.0, 0.0
    run(s.small_angle, SAMPLES, chunk, 0, intervals + s.extra)
    if s.by_interval != 0:
        run(s.small_angle, INTERVALS, chunk, 0, intervals)
    for j in range(LANES):
        angle = float(state[ROWS.sample, j])
        angle *= float(state[ROWS.interval, j]) if s.by_interval != 0 else s.factor
        is_small = is_small and angle < s.near
        largest[0] = max(largest[0], angle)
    function = s.small_angle if is_small else s.any_angle
    if function != 0:
        run(function, WINDOWS, chunk, 0, windows)
    return function != 0


@loop_part
def run(function, part, chunk, first, last):
    """Call a part of a program on the memory of a chunk."""
    arrays = chunk.samples, chunk.intervals, chunk.attitudes, chunk.state
    call(function, part, arrays, (first, last))


@loop_part
def copy(source, first, to, row):
    """Copy a quaternion in all lanes."""
    for i in range(4):
        for j in range(LANES):
            to[row + i, j] = source[first + i, j]


@loop_part
def store(chunk, logs, log, at, count, width, by_log):
    """Copy ``count`` attitudes after an interval to logs, and that at its start if it is 0."""
    for lane in range(width):
        shift = lane * CHUNK * (1 - by_log)
        first, last = min(at + shift, 1), min(count - shift, CHUNK) + 1
        own = logs.attitudes[
            log + lane * by_log, 4 * (at + shift + first) : 4 * (at + shift + last)
        ]
        lanes = chunk.attitudes[4 * first :]
        for i in range(own.size):
            own[i] = lanes[i, lane]


def sweep(stretch, logs, chunk, largest, first, last):
    """Integrate the logs [first, last), a lane each; returns the first tile not run."""
    s, state, attitudes = stretch[0], chunk.state, chunk.attitudes
    for tile in range(first, last, LANES):
        width = min(last - tile, LANES)
        for j in range(LANES):
            for k in range(4):
                state[ROWS.start + k, j] = logs.q[tile + min(j, width - 1), k]
                attitudes[k, j] = logs.q[tile + min(j, width - 1), 4 + k]
        done, phase = 0, s.phase
        while done < s.count:
            left = min(s.count - done, CHUNK - phase)
            windows, begin = (left + s.span - 1) // s.span, s.first + done
            load(s, logs, chunk, tile, begin, windows, width, 1)
            if not run_windows(s, chunk, windows, largest):
                return tile
            copy(attitudes, 4 * left, state, ROWS.turned)
            run(s.small_angle, PLACE, chunk, 0, left + 1)
            store(chunk, logs, tile, begin, left, width, 1)
            copy(state, ROWS.turned, attitudes, 0)
            if phase + left == CHUNK:
                run(s.small_angle, JOIN, chunk, 0, LANES)
                copy(state, ROWS.next, state, ROWS.start)
                for j in range(LANES):
                    for k in range(4):
                        attitudes[k, j] = 1.0 if k == 0 else 0.0
            done, phase = done + left, 0
        for j in range(width):
            for k in range(4):
                logs.q[tile + j, k] = state[ROWS.start + k, j]
                logs.q[tile + j, 4 + k] = attitudes[k, j]
    return last


def along(stretch, logs, chunk, totals, largest, first, last):
    """Integrate tiles of one log from p and r, which are updated; returns the tile not run.

    Each lane has a chunk; the last one may be shorter. If there are ``totals``, only the rotations
    of chunks are computed.
    """
    s, state, attitudes, q = stretch[0], chunk.state, chunk.attitudes, logs.q[0]
    for tile in range(first, last):
        left, begin = s.count - tile * TILE, s.first + tile * TILE
        width = min((left + CHUNK - 1) // CHUNK, LANES)
        windows = (min(left, CHUNK) + s.span - 1) // s.span
        load(s, logs, chunk, s.log, begin, windows, width, 0)
        for k in range(4):
            for j in range(LANES):
                attitudes[k, j] = 1.0 if k == 0 else 0.0
        if not run_windows(s, chunk, windows, largest):
            return tile
        for j in range(width):
            own = min(left - j * CHUNK, CHUNK)
            for k in range(4):
                state[ROWS.turned + k, j] = attitudes[4 * own + k, j]
                state[ROWS.start + k, j] = q[k]
            if totals.shape[0] > 0:
                for k in range(4):
                    totals[tile * LANES + j, k] = state[ROWS.turned + k, j]
            else:
                run(s.small_angle, JOIN, chunk, j, j + 1)
                for k in range(4):
                    if own == CHUNK:
                        q[k] = state[ROWS.next + k, j]
                    else:
                        q[4 + k] = state[ROWS.turned + k, j]
        if totals.shape[0] == 0:
            run(s.small_angle, PLACE, chunk, 0, min(left, CHUNK) + 1)
            store(chunk, logs, s.log, begin, left, width, 0)
    return last


def chain(stretch, logs, chunk, totals, largest, first, last):
    """p after the chunks [first, last) of a log, from their rotations."""
    s, state, q = stretch[0], chunk.state, logs.q[0]
    for i in range(first, last):
        for k in range(4):
            state[ROWS.start + k, 0] = q[k]
            state[ROWS.turned + k, 0] = totals[i, k]
        run(s.small_angle, JOIN, chunk, 0, 1)
        for k in range(4):
            q[k] = state[ROWS.next + k, 0]
    return last


@functools.cache
def loop(name: str, kind: str) -> Callable[..., int]:
    """``sweep``, ``along`` or ``chain`` for a precision."""
    real, n = TYPES[kind], types.int64

    def of(axes: int, kind: Any = real) -> Any:
        return types.Array(kind, axes, "C")

    samples = types.Array(real, 2, "C", readonly=True)
    logs = types.NamedTuple([samples, of(3), of(3), of(1), of(2), of(2)], Logs)
    chunk = types.NamedTuple([of(2)] * 4, Chunk)
    totals = [] if name == "sweep" else [of(2)]
    stretch = types.Array(from_dtype(STRETCH), 1, "C")
    loops: dict[str, Callable[..., int]] = {"sweep": sweep, "along": along, "chain": chain}
    arguments = stretch, logs, chunk, *totals, of(1, types.float64), n, n
    return machine(loops[name], n(*arguments))
