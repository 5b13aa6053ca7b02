"""Sampled rates to attitudes: many logs side by side, or one log cut into lanes.

Every lane carries one stretch of one log. A chunk of each lane's samples is turned into rows, the
windows run across the lanes, and the attitudes are turned back: in and out memory is touched once
and in order. A single log is a chain of products, and products are associative: the lanes of a
tile take stretches that follow each other, and all are turned to where the one before ended.
Threads take runs of tiles, and start from the turns of those before, found first. The cuts are the
same for every number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types

from fastatt._jit import driver, helper, hook, part
from fastatt.engine.memory import prefetch, stream
from fastatt.kernels import quat
from fastatt.methods.sampled import LANES, WINDOWS, Rates, advance
from fastatt.representations import Quat, QuatShort

CHUNK = 48  # intervals; a multiple of every method's span
TILE = CHUNK * LANES  # intervals of one log that run side by side


def scratch(method: Any, kind: Any, data: Any) -> Any:
    """Rows for a chunk of samples, of intervals, of attitudes twice, far lanes, a method's work."""
    raise NotImplementedError


@hook(scratch)
def _scratch(method: types.BaseNamedTuple, kind: types.BaseNamedTuple, data: types.Array) -> Any:
    window = WINDOWS[method.instance_class]
    n = CHUNK + window.history
    rows = 3 * (n + 1)
    work = max(1, window.work_rows)

    def impl(method, kind, data):
        return (
            np.empty((rows, LANES), dtype=data.dtype),
            np.empty((n, LANES), dtype=data.dtype),
            np.empty((4 * CHUNK + 4, LANES), dtype=data.dtype),
            np.empty((4 * CHUNK + 4, LANES), dtype=data.dtype),
            np.empty(LANES, dtype=data.dtype),
            np.empty((work, LANES), dtype=data.dtype),
            np.zeros(LANES, dtype=data.dtype),
        )

    return impl


def window_of(method: Any, kind: Any) -> Any:
    """(history, span, samples more than intervals), known when compiling."""
    raise NotImplementedError


@hook(window_of)
def _window_of(method: types.BaseNamedTuple, kind: types.BaseNamedTuple) -> Any:
    window = WINDOWS[method.instance_class]
    history, span, extra = window.history, window.span, int(kind.instance_class is Rates)
    return lambda method, kind: (history, span, extra)


def fill_intervals(spans: Any, h: Any, lane: Any, first: Any, n: Any) -> None:
    """A column of intervals: those of the log from the given one on, the last repeated."""
    raise NotImplementedError


@hook(fill_intervals)
def _fill_intervals(
    spans: types.Type, h: types.Type, lane: types.Type, first: types.Type, n: types.Type
) -> Any:
    if not isinstance(spans, types.Array):
        return lambda spans, h, lane, first, n: None

    def each(spans, h, lane, first, n):
        last = spans.size - 1
        for i in range(n):
            h[i, lane] = spans[min(max(first + i, 0), last)]

    return each


def fill_equal_intervals(spans: Any, h: Any) -> None:
    """All rows of intervals, once, where one number holds for all."""
    raise NotImplementedError


@hook(fill_equal_intervals)
def _fill_equal_intervals(spans: types.Type, h: types.Type) -> Any:
    if isinstance(spans, types.Array):
        return lambda spans, h: None

    def uniform(spans, h):
        for i in range(h.shape[0]):
            for j in range(LANES):
                h[i, j] = spans

    return uniform


@helper
def fill(v, lane, flat, offset, n):
    """A column from 3n numbers of a log; flat, so that the copy is one loop."""
    for k in range(3 * n):
        v[k, lane] = flat[offset + k]
    for k in range(0, 3 * n, 8):
        prefetch(flat, offset + 3 * n + k)


@helper
def fill_at_ends(v, lane, log, before, after, first, n):
    """Samples first … first + n of a log into a column; beyond its ends, those extrapolated."""
    for i in range(n):
        k = first + i
        for c in range(3):
            if k < 0:
                v[3 * i + c, lane] = before[before.shape[0] + k, c]
            elif k < log.shape[0]:
                v[3 * i + c, lane] = log[k, c]
            else:
                v[3 * i + c, lane] = after[min(k - log.shape[0], after.shape[0] - 1), c]


@helper
def peaks(v, n, work, row):
    """The largest absolute value of the first n samples, lane by lane, into a row of ``work``."""
    F = type(v[0, 0])
    for j in range(LANES):
        work[row, j] = F(0.0)
    for i in range(0, 3 * n, 3):
        for j in range(LANES):
            a = abs(v[i, j])
            b = abs(v[i + 1, j])
            c = abs(v[i + 2, j])
            a = b if b > a else a
            a = c if c > a else a
            work[row, j] = a if a > work[row, j] else work[row, j]


def mark_far(
    method: Any, kind: Any, v: Any, n: Any, spans: Any, h: Any, m: Any, work: Any, most: Any
) -> Any:
    """Whether any lane has a window that may turn by π; which, as 1 in a row of ``work``.

    ``most`` grows to the largest component of each lane's angles over an interval, rad.
    """
    raise NotImplementedError


@hook(mark_far)
def _mark_far(
    method: types.BaseNamedTuple,
    kind: types.BaseNamedTuple,
    v: types.Type,
    n: types.Type,
    spans: types.Type,
    h: types.Type,
    m: types.Type,
    work: types.Type,
    most: types.Type,
) -> Any:
    window = WINDOWS[method.instance_class]
    limit = window.near
    of_rates = kind.instance_class is Rates
    uneven = of_rates and isinstance(spans, types.Array)
    always = window.tile is not None

    def impl(method, kind, v, n, spans, h, m, work, most):
        F = type(work[0, 0])
        peaks(v, n, work, 0)
        longest = h[0, 0]
        for i in range(1, m if uneven else 1):
            for j in range(LANES):
                longest = max(longest, h[i, j])
        found = False
        for j in range(LANES):
            angle = work[0, j] * abs(longest) if of_rates else work[0, j]
            most[j] = angle if angle > most[j] else most[j]
            far = always or not angle < F(limit)
            work[0, j] = F(1.0) if far else F(0.0)
            found |= far
        return found

    return impl


@part
def carry(method, kind, v, spans, h, rows, wide, far, work, most, windows, need):
    """All windows of a chunk: with the short exponential, and with the wide one where it is needed.

    A lane's own samples decide: its neighbours change none of its bits.
    """
    _, span, extra = window_of(method, kind)
    for c in range(4):
        for j in range(LANES):
            wide[c, j] = rows[c, j]
    for k in range(windows):
        i = k * span
        advance(method, kind, QuatShort(), v, 3 * i, spans, h, i, rows, 4 * i, work)
    if mark_far(method, kind, v, need + extra, spans, h, need, work, most):
        for j in range(LANES):
            far[j] = work[0, j]
        for k in range(windows):
            i = k * span
            advance(method, kind, Quat(), v, 3 * i, spans, h, i, wide, 4 * i, work)
        for j in range(LANES):
            if far[j] != 0.0:
                for i in range(4 * windows * span + 4):
                    rows[i, j] = wide[i, j]


@helper
def gather(method, kind, flat, data, before, after, spans, body, start, n, need, tile, last, v, h):
    """A chunk of every lane's samples and intervals, from interval n of its stretch on."""
    history, _, extra = window_of(method, kind)
    for j in range(LANES):
        lane = min(tile + j, last - 1)
        b = body[lane]
        s = start[lane] + n - history
        if s >= 0 and s + need + extra <= data.shape[1]:
            fill(v, j, flat, 3 * (b * data.shape[1] + s), need + extra)
        else:
            fill_at_ends(v, j, data[b], before[b], after[b], s, need + extra)
        fill_intervals(spans, h, j, s, need)


@helper
def scatter(rows, flat, n_out, body, start, n, left, tile, width):
    """The attitudes of a chunk to their places."""
    for j in range(width):
        offset = 4 * (body[tile + j] * n_out + start[tile + j] + n)
        # the first attitude of a log too: whoever touches a page first pays for it, on its thread
        for k in range(0 if start[tile + j] + n == 0 else 4, 4 * left + 4):
            stream(flat, offset + k, rows[k, j])


@helper
def go_on(rows, left):
    """The last attitude of a chunk, at unit length, is the first of the next."""
    for j in range(LANES):
        a, b, c, d = rows[4 * left, j], rows[4 * left + 1, j], rows[4 * left + 2, j], 4 * left + 3
        p = quat.renormalise((a, b, c, rows[d, j]))
        for i in range(4):
            rows[i, j] = p[i]


@driver
def sweep(
    method, kind, data, before, after, spans, peak, body, start, count, q, out, write, first, last
):
    """Carry lanes [first, last) of attitudes ``q (L, 4)`` over ``count`` intervals each.

    Lane ℓ begins at interval ``start[ℓ]`` of log ``body[ℓ]`` of ``data (N, n, 3)``; ``write`` puts
    the attitudes at its instants into ``out (N, m, 4)``; ``peak (L,)`` gets the largest component
    of a lane's angles over an interval, rad.
    """
    v, h, rows, wide, far, work, most = scratch(method, kind, data)
    history, span, _ = window_of(method, kind)
    fill_equal_intervals(spans, h)
    flat = data.reshape(-1)
    flat_out = out.reshape(-1)
    for tile in range(first, last, LANES):
        width = min(LANES, last - tile)
        for j in range(LANES):
            most[j] = 0.0
            for c in range(4):
                rows[c, j] = q[min(tile + j, last - 1), c]
        n = 0
        while n < count:
            left = min(CHUNK, count - n)
            windows = (left + span - 1) // span
            need = windows * span + history
            gather(
                method,
                kind,
                flat,
                data,
                before,
                after,
                spans,
                body,
                start,
                n,
                need,
                tile,
                last,
                v,
                h,
            )
            carry(method, kind, v, spans, h, rows, wide, far, work, most, windows, need)
            if write:
                scatter(rows, flat_out, out.shape[1], body, start, n, left, tile, width)
            go_on(rows, left)
            n += left
        for j in range(width):
            peak[tile + j] = most[j]
            for c in range(4):
                q[tile + j, c] = rows[c, j]


@helper
def connect(rows, left, starts):
    """Attitudes at the start of each lane, as if the lanes were one stretch, and at its end."""
    F = type(rows[0, 0])
    q = (F(1.0), F(0.0), F(0.0), F(0.0))
    for j in range(LANES):
        for c in range(4):
            starts[c, j] = q[c]
        p = (rows[4 * left, j], rows[4 * left + 1, j], rows[4 * left + 2, j], rows[4 * left + 3, j])
        q = quat.renormalise(quat.mul(q, p))
    return q


@helper
def turn_all(q, rows, left, starts):
    """All attitudes of the lanes, from those relative to their starts and q, the tile's."""
    for j in range(LANES):
        p = quat.mul(q, (starts[0, j], starts[1, j], starts[2, j], starts[3, j]))
        for c in range(4):
            starts[c, j] = p[c]
    for k in range(0, 4 * left + 4, 4):
        for j in range(LANES):
            p = (starts[0, j], starts[1, j], starts[2, j], starts[3, j])
            r = quat.mul(p, (rows[k, j], rows[k + 1, j], rows[k + 2, j], rows[k + 3, j]))
            rows[k, j] = r[0]
            rows[k + 1, j] = r[1]
            rows[k + 2, j] = r[2]
            rows[k + 3, j] = r[3]


@driver
def sweep_one(
    method, kind, data, before, after, spans, peak, log, q, totals, out, write, first, last
):
    """Tiles [first, last) of one log: LANES stretches of CHUNK intervals in a row are one tile.

    Without ``write`` only the turn of each tile is found, ``totals (tiles, 4)``; with it the
    attitudes go to ``out (N, m, 4)``, from q (4,), the attitude at the first tile's start, which is
    left at the last tile's end. ``peak (tiles,)`` gets the largest component of a tile's angles
    over an interval, rad.
    """
    F = type(q[0])
    v, h, rows, wide, far, work, most = scratch(method, kind, data)
    starts = np.empty((4, LANES), dtype=data.dtype)
    history, span, _ = window_of(method, kind)
    fill_equal_intervals(spans, h)
    flat = data.reshape(-1)
    flat_out = out.reshape(-1)
    body = np.full(LANES, log)
    start = np.empty(LANES, dtype=np.int64)
    need = CHUNK + history
    a = (q[0], q[1], q[2], q[3])
    for tile in range(first, last):
        for j in range(LANES):
            start[j] = (tile * LANES + j) * CHUNK
            most[j] = F(0.0)
            rows[0, j] = F(1.0)
            rows[1, j] = F(0.0)
            rows[2, j] = F(0.0)
            rows[3, j] = F(0.0)
        gather(method, kind, flat, data, before, after, spans, body, start, 0, need, 0, LANES, v, h)
        carry(method, kind, v, spans, h, rows, wide, far, work, most, CHUNK // span, need)
        peak[tile] = F(0.0)
        for j in range(LANES):
            peak[tile] = max(peak[tile], most[j])
        total = connect(rows, CHUNK, starts)
        if write:
            turn_all(a, rows, CHUNK, starts)
            scatter(rows, flat_out, out.shape[1], body, start, 0, CHUNK, 0, LANES)
            a = quat.renormalise(quat.mul(a, total))
        else:
            for c in range(4):
                totals[tile, c] = total[c]
    for c in range(4):
        q[c] = a[c]


@driver
def chain(q, totals):
    """q after further turns, one after the other."""
    a = (q[0], q[1], q[2], q[3])
    for i in range(totals.shape[0]):
        p = (totals[i, 0], totals[i, 1], totals[i, 2], totals[i, 3])
        a = quat.renormalise(quat.mul(a, p))
    for c in range(4):
        q[c] = a[c]
