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

from numba import types

from fastatt._jit import loop_part, machine
from fastatt.codegen.call import TYPES, call
from fastatt.methods.windows import CHUNK

#: lanes of a tile
LANES = 16
TILE = LANES * CHUNK


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


class Actions(NamedTuple):
    """The parts of a program's function (``fastatt.gyro.program``)."""

    samples: int = 0
    intervals: int = 1
    windows: int = 2
    place: int = 3
    join: int = 4


ACTIONS = Actions()


class WindowShape(NamedTuple):
    """The shape of a method's windows.

    ``extra`` is 1 for rates, which have one sample more than intervals; ``is_uneven`` says whether
    intervals differ, and ``by_interval`` whether angles depend on each. ``near`` is the angle over
    an interval, rad, below which rotations are at most π.
    """

    history: int
    span: int
    extra: int
    is_uneven: int
    by_interval: int
    near: float


class Logs(NamedTuple):
    """Logs of samples (N, 3 (lead + n)), with others beyond them (N, k, 3), and intervals, s.

    ``lead`` samples come before the first interval. ``interval`` is the equal interval, s, and
    ``factor`` times a sample is its angle over one. ``attitudes`` (N, 4 n_out) are written; ``q``
    are p and r of each log (N, 8).
    """

    samples: Any
    before: Any
    after: Any
    intervals: Any
    attitudes: Any
    q: Any
    lead: int
    interval: float
    factor: float


class Part(NamedTuple):
    """The intervals that a call integrates, ``done`` of whose first chunk are integrated already.

    ``log`` is the index of the log, if it is one. The windows are functions at two addresses: for
    small angles and for any, or 0.
    """

    first: int
    n_intervals: int
    done: int
    log: int
    small_angle: int
    any_angle: int


class Chunk(NamedTuple):
    """The memory of a thread: rows of lanes for samples, intervals, attitudes, and a state."""

    samples: Any
    intervals: Any
    attitudes: Any
    state: Any


@loop_part
def load(shape, logs, chunk, log, first, windows, width, by_log):
    """Copy what the windows of chunks from an interval on need to lanes; the last one fills up.

    Each lane has a log, ``by_log`` 1, or the chunk after that of the lane before, 0.
    """
    n, intervals = logs.samples.shape[1] // 3 - logs.lead, shape.history + windows * shape.span
    count = intervals + shape.extra
    for lane in range(LANES):
        k = min(lane, width - 1)
        row, since = log + k * by_log, first - shape.history + k * CHUNK * (1 - by_log)
        # samples [begin, end) are those of the log
        begin = min(max(-logs.lead - since, 0), count)
        end = max(min(n - since, count), begin)
        at = 3 * (logs.lead + since)
        known, lanes = logs.samples[row, at + 3 * begin : at + 3 * end], chunk.samples[3 * begin :]
        for i in range(known.size):
            lanes[i, lane] = known[i]
        skipped = shape.history + logs.lead + since
        for i in range(begin):
            for axis in range(3):
                chunk.samples[3 * i + axis, lane] = logs.before[row, skipped + i, axis]
        for i in range(end, count):
            beyond = min(since + i - n, logs.after.shape[1] - 1)
            for axis in range(3):
                chunk.samples[3 * i + axis, lane] = logs.after[row, beyond, axis]
        if shape.is_uneven == 0:
            chunk.intervals[0, lane] = logs.interval
        else:
            for i in range(intervals):
                at = min(max(since + i, -logs.lead), logs.intervals.shape[0] - logs.lead - 1)
                chunk.intervals[i, lane] = logs.intervals[at + logs.lead]


@loop_part
def run_windows(shape, factor, part, chunk, windows, largest):
    """Run the windows of a chunk; returns False if those for any angle are not compiled.

    Both give the same bits for a rotation of at most π, so that the lanes of a tile do not affect
    each other.
    """
    state, is_small, intervals = chunk.state, True, shape.history + windows * shape.span
    for j in range(LANES):
        state[ROWS.sample, j], state[ROWS.interval, j] = 0.0, 0.0
    run(part.small_angle, ACTIONS.samples, chunk, 0, intervals + shape.extra)
    if shape.by_interval != 0:
        run(part.small_angle, ACTIONS.intervals, chunk, 0, intervals)
    for j in range(LANES):
        angle = float(state[ROWS.sample, j])
        angle *= float(state[ROWS.interval, j]) if shape.by_interval != 0 else factor
        is_small = is_small and angle < shape.near
        largest[0] = max(largest[0], angle)
    function = part.small_angle if is_small else part.any_angle
    if function != 0:
        run(function, ACTIONS.windows, chunk, 0, windows)
    return function != 0


@loop_part
def run(function, action, chunk, first, last):
    """Call a part of a program on the memory of a chunk."""
    arrays = chunk.samples, chunk.intervals, chunk.attitudes, chunk.state
    call(function, action, arrays, (first, last))


@loop_part
def copy(source, first, to, row):
    """Copy a quaternion in all lanes."""
    for i in range(4):
        for j in range(LANES):
            to[row + i, j] = source[first + i, j]


@loop_part
def unturn(attitudes):
    """Begin a chunk with the identity in all lanes."""
    for j in range(LANES):
        for k in range(4):
            attitudes[k, j] = 1.0 if k == 0 else 0.0


@loop_part
def store(chunk, logs, log, at, count, width, by_log):
    """Copy ``count`` attitudes after an interval to logs, and that at its start if it is 0."""
    for lane in range(width):
        shift = lane * CHUNK * (1 - by_log)
        first, last = min(at + shift, 1), min(count - shift, CHUNK) + 1
        attitudes = logs.attitudes[
            log + lane * by_log, 4 * (at + shift + first) : 4 * (at + shift + last)
        ]
        lanes = chunk.attitudes[4 * first :]
        for i in range(attitudes.size):
            attitudes[i] = lanes[i, lane]


def sweep(shape, logs, part, chunk, largest, first, last):
    """Integrate the logs [first, last), a lane each; returns the first tile not run."""
    state, attitudes = chunk.state, chunk.attitudes
    for tile in range(first, last, LANES):
        width = min(last - tile, LANES)
        for j in range(LANES):
            for k in range(4):
                state[ROWS.start + k, j] = logs.q[tile + min(j, width - 1), k]
                attitudes[k, j] = logs.q[tile + min(j, width - 1), 4 + k]
        integrated, done = 0, part.done
        while integrated < part.n_intervals:
            left = min(part.n_intervals - integrated, CHUNK - done)
            windows, begin = (left + shape.span - 1) // shape.span, part.first + integrated
            load(shape, logs, chunk, tile, begin, windows, width, 1)
            if not run_windows(shape, logs.factor, part, chunk, windows, largest):
                return tile
            copy(attitudes, 4 * left, state, ROWS.turned)
            run(part.small_angle, ACTIONS.place, chunk, 0, left + 1)
            store(chunk, logs, tile, begin, left, width, 1)
            copy(state, ROWS.turned, attitudes, 0)
            if done + left == CHUNK:
                run(part.small_angle, ACTIONS.join, chunk, 0, LANES)
                copy(state, ROWS.next, state, ROWS.start)
                unturn(attitudes)
            integrated, done = integrated + left, 0
        for j in range(width):
            for k in range(4):
                logs.q[tile + j, k] = state[ROWS.start + k, j]
                logs.q[tile + j, 4 + k] = attitudes[k, j]
    return last


def along(shape, logs, part, chunk, largest, first, last):
    """Integrate tiles of one log from p and r, which are updated; returns the tile not run.

    Each lane has a chunk; the last one may be shorter.
    """
    state, attitudes, q = chunk.state, chunk.attitudes, logs.q[part.log]
    for tile in range(first, last):
        left, begin = part.n_intervals - tile * TILE, part.first + tile * TILE
        width = min((left + CHUNK - 1) // CHUNK, LANES)
        windows = (min(left, CHUNK) + shape.span - 1) // shape.span
        load(shape, logs, chunk, part.log, begin, windows, width, 0)
        unturn(attitudes)
        if not run_windows(shape, logs.factor, part, chunk, windows, largest):
            return tile
        for j in range(width):
            length = min(left - j * CHUNK, CHUNK)
            for k in range(4):
                state[ROWS.turned + k, j] = attitudes[4 * length + k, j]
                state[ROWS.start + k, j] = q[k]
            run(part.small_angle, ACTIONS.join, chunk, j, j + 1)
            for k in range(4):
                if length == CHUNK:
                    q[k] = state[ROWS.next + k, j]
                else:
                    q[4 + k] = state[ROWS.turned + k, j]
        run(part.small_angle, ACTIONS.place, chunk, 0, min(left, CHUNK) + 1)
        store(chunk, logs, part.log, begin, left, width, 0)
    return last


@functools.cache
def loop(name: str, kind: str) -> Callable[..., int]:
    """``sweep`` or ``along`` for a precision."""
    real, n, number = TYPES[kind], types.int64, types.float64

    def of(axes: int, kind: Any = real) -> Any:
        return types.Array(kind, axes, "C")

    samples = types.Array(real, 2, "C", readonly=True)
    arguments = (
        types.NamedTuple([n, n, n, n, n, number], WindowShape),
        types.NamedTuple([samples, of(3), of(3), of(1), of(2), of(2), n, number, number], Logs),
        types.NamedTuple([n] * len(Part._fields), Part),
        types.NamedTuple([of(2)] * 4, Chunk),
        of(1, number),
    )
    return machine({"sweep": sweep, "along": along}[name], n(*arguments, n, n))
