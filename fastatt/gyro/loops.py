"""The loop over logs that all methods share: a plain loop over NumPy arrays.

Attitudes of a log are q = p∘r, with p at the start of a chunk of 48 intervals and the rotation r
from there. A tile has a chunk in each lane: of the logs side by side, or the chunks of one log one
after the other. Its samples are loaded into rows, the windows of a method run across the lanes, the
chunks are chained through p, and the attitudes are stored. The bits of a log therefore do not
depend on other logs, on how it is divided, or on the number of threads.

The windows for any rotation angle are compiled when a tile first needs them. The loop then returns
the index of that tile, from which the next call continues.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import loop_part, machine
from fastatt.codegen.call import TYPES, call
from fastatt.kernels import quat
from fastatt.methods.windows import CHUNK

#: lanes of a tile
LANES = 16
#: the first row of an iteration in a tile's ``state``, after p at the start of each chunk
ITERATION = 4
#: the parts of a program's function (``fastatt.gyro.window_loops``)
WINDOWS, PLACE = 0, 1


class WindowShape(NamedTuple):
    """The shape of a method's windows.

    ``extra`` is 1 for rates, which have one sample more than intervals; ``is_uneven`` says whether
    intervals differ. ``near`` is the angle over an interval, rad, below which rotations are at most
    π. A function works on ``lanes`` at a time.
    """

    history: int
    span: int
    extra: int
    is_uneven: int
    near: float
    lanes: int


class Logs(NamedTuple):
    """Logs of samples (N, lead + n, 3), with others beyond them (N, k, 3), and intervals, s.

    ``lead`` samples come before the first interval. ``interval`` is the equal interval, s.
    ``attitudes`` (N, n + 1, 4) are written; ``q`` are p and r of each log (N, 8).
    """

    samples: Any
    before: Any
    after: Any
    intervals: Any
    attitudes: Any
    q: Any
    lead: int
    interval: float


class Part(NamedTuple):
    """The intervals of logs that a call integrates, ``done`` of whose first chunk are integrated.

    They are parts of ``n_chunks`` chunks. Each lane of a tile has a log, ``by_log`` 1, or the chunk
    after that of the lane before, 0. The windows are functions at two addresses: for small angles
    and for any, or 0.
    """

    n_intervals: int
    done: int
    n_chunks: int
    by_log: int
    small_angle: int
    any_angle: int


class Tile(NamedTuple):
    """The memory of a thread: rows of lanes for samples, intervals, attitudes, and a state."""

    samples: Any
    intervals: Any
    attitudes: Any
    state: Any


class Lane(NamedTuple):
    """The intervals [first, end) of a log, and whether they complete a chunk."""

    log: int
    first: int
    end: int
    is_whole: bool


@loop_part
def lane_of(part, log, chunk, j):
    """The lane number j of a tile that begins with a chunk of a log."""
    log, chunk = log + j * part.by_log, chunk + j * (1 - part.by_log)
    end = (chunk + 1) * CHUNK - part.done
    first, is_whole = max(end - CHUNK, 0), end <= part.n_intervals
    return Lane(log, first, min(end, part.n_intervals), is_whole)


@loop_part
def copied(source, to, j, largest):
    """Copy samples to a lane; returns the largest size of a component so far, NaN left out."""
    x = y = z = largest
    for i in range(source.shape[0]):
        a, b, c = source[i, 0], source[i, 1], source[i, 2]
        to[i, 0, j], to[i, 1, j], to[i, 2, j] = a, b, c
        x = abs(a) if abs(a) > x else x
        y = abs(b) if abs(b) > y else y
        z = abs(c) if abs(c) > z else z
    return max(x, y, z)


@loop_part
def load(shape, logs, tile, lane, j):
    """Copy what the windows of a lane need; returns their largest angle."""
    n, since = logs.samples.shape[1] - logs.lead, lane.first - shape.history
    n_windows = (lane.end - lane.first + shape.span - 1) // shape.span
    n_intervals = shape.history + n_windows * shape.span
    n_samples = n_intervals + shape.extra
    # samples [begin, end) are those of the log
    begin = min(max(-logs.lead - since, 0), n_samples)
    end = max(min(n - since, n_samples), begin)
    known = logs.samples[lane.log, logs.lead + since + begin : logs.lead + since + end]
    before = logs.before[lane.log, logs.lead + lane.first :]
    largest = copied(before[:begin], tile.samples, j, logs.samples.dtype.type(0.0))
    largest = copied(known, tile.samples[begin:], j, largest)
    after = logs.after[lane.log, : n_samples - end]
    largest = copied(after, tile.samples[end:], j, largest)
    tile.intervals[0, j] = longest = logs.interval
    if shape.is_uneven != 0:
        for i in range(n_intervals):
            nearest = min(max(logs.lead + since + i, 0), logs.intervals.shape[0] - 1)
            tile.intervals[i, j] = logs.intervals[nearest]
            longest = max(longest, float(logs.intervals[nearest]))
    return float(largest) * (longest if shape.extra != 0 else 1.0)


@loop_part
def run(function, action, tile, lanes, first, last):
    """Call a part of a program on the memory of a tile's first lanes."""
    samples, intervals = tile.samples.ctypes.data, tile.intervals.ctypes.data
    attitudes, state = tile.attitudes.ctypes.data, tile.state.ctypes.data
    call(function, action, (samples, intervals, attitudes, state), (lanes, first, last))


@loop_part
def chain(tile, lane, j, q):
    """Copy p at the start of a chunk from q, and write p and r at its end."""
    p, r = (q[0], q[1], q[2], q[3]), tile.attitudes[lane.end - lane.first]
    turned = (r[0, j], r[1, j], r[2, j], r[3, j])
    after = quat.renormalise(quat.mul(p, turned))
    for k in range(4):
        tile.state[k, j] = q[k]
        if lane.is_whole:
            q[k] = after[k]
            q[4 + k] = 1.0 if k == 0 else 0.0
        else:
            q[4 + k] = turned[k]


@loop_part
def store(logs, tile, lane, j):
    """Copy the attitudes after the intervals of a lane to its log, and that at the log's start."""
    first = min(lane.first, 1)
    attitudes = logs.attitudes[lane.log, lane.first + first : lane.end + 1]
    for i in range(attitudes.shape[0]):
        for k in range(4):
            attitudes[i, k] = tile.attitudes[first + i, k, j]


def integrate_tiles(shape, logs, part, tile, largest, first, last):
    """Integrate the tiles [first, last) from p and r, which are updated.

    Both functions give the same bits for a rotation of at most π, so that the lanes of a tile do
    not affect each other. Returns the first tile not run, since windows for any angle are not
    compiled; ``largest`` is the largest component of an angle so far.
    """
    n_logs = logs.q.shape[0]
    per_log = part.n_chunks if part.by_log != 0 else (part.n_chunks + LANES - 1) // LANES
    for number in range(first, last):
        log, chunk = number // per_log, number % per_log
        if part.by_log != 0:
            log *= LANES
            used = min(n_logs - log, LANES)
        else:
            chunk *= LANES
            used = min(part.n_chunks - chunk, LANES)
        # what other lanes, and rows beyond the end of a log, hold is computed and not stored
        lanes = (used + shape.lanes - 1) // shape.lanes * shape.lanes
        longest, angle = 0, 0.0
        for j in range(used):
            lane = lane_of(part, log, chunk, j)
            longest = max(longest, lane.end - lane.first)
            angle = max(angle, load(shape, logs, tile, lane, j))
            for k in range(4):
                unturned = 1.0 if k == 0 else 0.0
                tile.attitudes[0, k, j] = logs.q[lane.log, 4 + k] if lane.first == 0 else unturned
        largest[0] = max(largest[0], angle)
        function = part.small_angle if angle < shape.near else part.any_angle
        if function == 0:
            return number
        run(function, WINDOWS, tile, lanes, 0, (longest + shape.span - 1) // shape.span)
        for j in range(used):
            lane = lane_of(part, log, chunk, j)
            chain(tile, lane, j, logs.q[lane.log])
        run(part.small_angle, PLACE, tile, lanes, 0, longest + 1)
        for j in range(used):
            store(logs, tile, lane_of(part, log, chunk, j), j)
    return last


@functools.cache
def loop(precision: str) -> Callable[..., int]:
    """``integrate_tiles`` for a precision."""
    real, n, number = TYPES[precision], types.int64, types.float64

    def of(axes: int, ty: Any = real) -> Any:
        return types.Array(ty, axes, "C")

    samples = types.Array(real, 3, "C", readonly=True)
    arguments = (
        types.NamedTuple([n, n, n, n, number, n], WindowShape),
        types.NamedTuple([samples, of(3), of(3), of(1), of(3), of(2), n, number], Logs),
        types.NamedTuple([n] * len(Part._fields), Part),
        types.NamedTuple([of(3), of(2), of(3), of(2)], Tile),
        of(1, number),
    )
    return machine(integrate_tiles, n(*arguments, n, n))
