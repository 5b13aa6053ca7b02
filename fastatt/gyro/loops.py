"""The loops over logs that all methods share: plain Python on flat arrays, compiled by Numba.

Attitudes of a log are q = p∘r, with p at the begin of a chunk of 48 intervals and the rotation r
from there. The samples of each lane's chunk are gathered into rows, the windows of a method run
across the lanes, and the attitudes are written. Rotations of chunks are computed in parallel lanes,
for many logs or for one, and then chained through p. The bits of a log therefore do not depend on
other logs, on how it is divided, or on the number of threads.

The windows for any rotation angle are compiled when a chunk first needs them. A loop then returns
the index of that tile, from which the next call continues.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from fastatt._jit import address_loop, loop_part
from fastatt.codegen.call import call_generated, doubles, reals, wholes
from fastatt.methods.windows import CHUNK

#: lanes of a tile
LANES = 16
TILE = LANES * CHUNK

#: parts of a program's function (``fastatt.gyro.program``)
WINDOWS, PLACE, JOIN = range(3)
#: rows of its ``state``: p at the begin of a chunk, the rotation of the chunk, p at its end; the
#: largest sample and interval of each lane; then the rows of an iteration
START, TURNED, NEXT, PEAK, LONGEST, ITERATION = 0, 4, 8, 12, 13, 14

#: ``arrays``: samples (N, lead + n, 3); tables that extrapolate from a log's first samples to those
#: before it, and from its last ones to those after it; intervals, s; attitudes (N, n_out, 4); p and
#: r of each log (N, 8); the rotation of each chunk (., 4); the largest component of a rotation over
#: an interval, rad; then the memory of a chunk
(
    DATA, HEAD, TAIL, GAPS, OUT, Q, TOTALS, LARGEST, SAMPLES, SPANS, ATTITUDES, STATE,
) = range(12)  # fmt: skip

#: ``settings``: addresses of the windows for small angles and for any, or 0; samples of a log, and
#: those known before them; sizes of the tables; number of intervals, 0 for equal ones; attitudes of
#: a log; the shape of a window; 1 if samples are rates, and if intervals are uneven; the first
#: interval, their number, how many of its chunk are done; for one log its index, and 1 to write
#: attitudes
(
    SMALL, ANY, N_SAMPLES, LEAD, N_HEAD, N_TAIL, N_AFTER, N_GAPS, N_OUT, HISTORY, SPAN, EXTRA,
    BY_INTERVAL, FIRST, COUNT, PHASE, LOG, WRITE,
) = range(18)  # fmt: skip

#: ``limits``: the equal interval, s; the factor from a sample to its angle over an interval; the
#: angle below which rotations are at most π
INTERVAL, FACTOR, NEAR = range(3)


@loop_part
def _extrapolated(table, row, size, data, at):
    """A component of a sample beyond a log, from ``size`` samples beginning with ``at``."""
    total = 0.0
    for k in range(size):
        total += table[row * size + k] * float(data[at + 3 * k])
    return total


@loop_part
def _gather(data, samples, arrays, settings, log, first, count, lane):
    """Copy ``count`` samples of a log, from ``first`` on, into a lane."""
    n, lead, near = settings[N_SAMPLES], settings[LEAD], settings[N_TAIL]
    head, tail = doubles(arrays[HEAD]), doubles(arrays[TAIL])
    origin = (log * (lead + n) + lead) * 3
    begin = min(max(-lead - first, 0), count)
    end = max(min(n - first, count), begin)
    for i in range(begin):
        for axis in range(3):
            samples[(3 * i + axis) * LANES + lane] = _extrapolated(
                head, -1 - first - i, settings[N_HEAD], data, origin + axis
            )
    shift = origin + 3 * first
    for i in range(3 * begin, 3 * end):
        samples[i * LANES + lane] = data[shift + i]
    for i in range(end, count):
        row = min(first + i - n, settings[N_AFTER] - 1)
        for axis in range(3):
            samples[(3 * i + axis) * LANES + lane] = _extrapolated(
                tail, row, near, data, origin + 3 * (n - near) + axis
            )


@loop_part
def _gather_intervals(gaps, spans, settings, limits, first, count, lane):
    """Copy intervals from ``first`` on into a lane; the last one is repeated beyond the end."""
    if settings[N_GAPS] == 0:
        spans[lane] = limits[INTERVAL]
    else:
        lead = settings[LEAD]
        for i in range(count):
            at = min(max(first + i, -lead), settings[N_GAPS] - 1)
            spans[i * LANES + lane] = gaps[at + lead]


@loop_part
def _keep_largest(rows, count, state, row):
    """The largest absolute value of each lane, in a row of the state; NaN is ignored."""
    for j in range(LANES):
        state[row * LANES + j] = 0.0
    for i in range(count):
        for j in range(LANES):
            value = abs(rows[i * LANES + j])
            before = state[row * LANES + j]
            state[row * LANES + j] = value if value > before else before


@loop_part
def _run_windows(memory, arrays, settings, limits, windows):
    """Run the windows of a chunk; returns False if the form for any angle is not compiled.

    Both forms give the same bits for a rotation of at most π, so that the lanes of a tile do not
    affect each other.
    """
    samples, spans, _, state = memory
    intervals = settings[HISTORY] + windows * settings[SPAN]
    _keep_largest(samples, 3 * (intervals + settings[EXTRA]), state, PEAK)
    if settings[BY_INTERVAL] != 0:
        _keep_largest(spans, intervals, state, LONGEST)
    largest, small = doubles(arrays[LARGEST]), True
    for j in range(LANES):
        angle = float(state[PEAK * LANES + j])
        if settings[BY_INTERVAL] != 0:
            angle *= float(state[LONGEST * LANES + j])
        else:
            angle *= limits[FACTOR]
        small = small and angle < limits[NEAR]
        largest[0] = max(largest[0], angle)
    form = settings[SMALL] if small else settings[ANY]
    if form == 0:
        return False
    call_generated(form, WINDOWS, memory, (0, windows))
    return True


@loop_part
def _write(attitudes, out, at, first, last, lane):
    """Copy the attitudes [first, last) of a lane to their place."""
    for i in range(4 * first, 4 * last):
        out[at + i] = attitudes[i * LANES + lane]


def _sweep(kind):
    """The loop over many logs."""

    def sweep(arrays, settings, limits, first, last):
        """Integrate the logs [first, last), a lane each; returns the first tile not run."""
        arrays, settings, limits = wholes(arrays), wholes(settings), doubles(limits)
        samples, spans = reals(arrays[SAMPLES], kind), reals(arrays[SPANS], kind)
        attitudes, state = reals(arrays[ATTITUDES], kind), reals(arrays[STATE], kind)
        memory = samples, spans, attitudes, state
        data, gaps = reals(arrays[DATA], kind), reals(arrays[GAPS], kind)
        q, out = reals(arrays[Q], kind), reals(arrays[OUT], kind)
        history, span = settings[HISTORY], settings[SPAN]
        for tile in range(first, last, LANES):
            width = min(last - tile, LANES)
            for j in range(LANES):
                log = tile + min(j, width - 1)
                for k in range(4):
                    state[(START + k) * LANES + j] = q[log * 8 + k]
                    attitudes[k * LANES + j] = q[log * 8 + 4 + k]
            done, phase = 0, settings[PHASE]
            while done < settings[COUNT]:
                left = min(settings[COUNT] - done, CHUNK - phase)
                windows = (left + span - 1) // span
                begin, need = settings[FIRST] + done, history + windows * span
                for j in range(LANES):
                    log = tile + min(j, width - 1)
                    _gather(
                        data, samples, arrays, settings, log, begin - history,
                        need + settings[EXTRA], j,
                    )  # fmt: skip
                    _gather_intervals(gaps, spans, settings, limits, begin - history, need, j)
                if not _run_windows(memory, arrays, settings, limits, windows):
                    return tile
                for i in range(4 * LANES):
                    state[TURNED * LANES + i] = attitudes[4 * left * LANES + i]
                call_generated(settings[SMALL], PLACE, memory, (0, left + 1))
                for j in range(width):
                    place = (tile + j) * settings[N_OUT] + begin
                    _write(attitudes, out, 4 * place, min(begin, 1), left + 1, j)
                if phase + left == CHUNK:
                    call_generated(settings[SMALL], JOIN, memory, (0, LANES))
                    for i in range(4 * LANES):
                        state[START * LANES + i] = state[NEXT * LANES + i]
                        attitudes[i] = 1.0 if i < LANES else 0.0
                else:
                    for i in range(4 * LANES):
                        attitudes[i] = state[TURNED * LANES + i]
                done += left
                phase = 0
            for j in range(width):
                for k in range(4):
                    q[(tile + j) * 8 + k] = state[(START + k) * LANES + j]
                    q[(tile + j) * 8 + 4 + k] = attitudes[k * LANES + j]
        return last

    return sweep


def _along(kind):
    """The loop over the chunks of one log."""

    def along(arrays, settings, limits, first, last):
        """Integrate tiles of one log from p and r, which are updated; returns the tile not run.

        Each lane has a chunk; the last one may be shorter. Without ``WRITE`` only the rotations are
        computed.
        """
        arrays, settings, limits = wholes(arrays), wholes(settings), doubles(limits)
        samples, spans = reals(arrays[SAMPLES], kind), reals(arrays[SPANS], kind)
        attitudes, state = reals(arrays[ATTITUDES], kind), reals(arrays[STATE], kind)
        memory = samples, spans, attitudes, state
        data, gaps = reals(arrays[DATA], kind), reals(arrays[GAPS], kind)
        q, out = reals(arrays[Q], kind), reals(arrays[OUT], kind)
        totals = reals(arrays[TOTALS], kind)
        history, span, log = settings[HISTORY], settings[SPAN], settings[LOG]
        for tile in range(first, last):
            left = settings[COUNT] - tile * TILE
            width = min((left + CHUNK - 1) // CHUNK, LANES)
            windows = (min(left, CHUNK) + span - 1) // span
            begin, need = settings[FIRST] + tile * TILE, history + windows * span
            for j in range(LANES):
                at = begin + min(j, width - 1) * CHUNK - history
                _gather(data, samples, arrays, settings, log, at, need + settings[EXTRA], j)
                _gather_intervals(gaps, spans, settings, limits, at, need, j)
                for k in range(4):
                    attitudes[k * LANES + j] = 1.0 if k == 0 else 0.0
            if not _run_windows(memory, arrays, settings, limits, windows):
                return tile
            for j in range(width):
                own = min(left - j * CHUNK, CHUNK)
                for k in range(4):
                    turned = attitudes[(4 * own + k) * LANES + j]
                    state[(TURNED + k) * LANES + j] = turned
                    state[(START + k) * LANES + j] = q[k]
                    if settings[WRITE] == 0:
                        totals[((tile * LANES) + j) * 4 + k] = turned
                if settings[WRITE] != 0:
                    call_generated(settings[SMALL], JOIN, memory, (j, j + 1))
                    for k in range(4):
                        if own == CHUNK:
                            q[k] = state[(NEXT + k) * LANES + j]
                        else:
                            q[4 + k] = state[(TURNED + k) * LANES + j]
            if settings[WRITE] != 0:
                call_generated(settings[SMALL], PLACE, memory, (0, min(left, CHUNK) + 1))
                for j in range(width):
                    at = begin + j * CHUNK
                    place = log * settings[N_OUT] + at
                    own = min(left - j * CHUNK, CHUNK)
                    _write(attitudes, out, 4 * place, min(at, 1), own + 1, j)
        return last

    return along


def _chain(kind):
    """The loop that updates p over chunks."""

    def chain(arrays, settings, limits, first, last):
        """p after the chunks [first, last), from their rotations."""
        arrays, settings, limits = wholes(arrays), wholes(settings), doubles(limits)
        samples, spans = reals(arrays[SAMPLES], kind), reals(arrays[SPANS], kind)
        attitudes, state = reals(arrays[ATTITUDES], kind), reals(arrays[STATE], kind)
        memory = samples, spans, attitudes, state
        q, totals = reals(arrays[Q], kind), reals(arrays[TOTALS], kind)
        for i in range(first, last):
            for k in range(4):
                state[(START + k) * LANES] = q[k]
                state[(TURNED + k) * LANES] = totals[4 * i + k]
            call_generated(settings[SMALL], JOIN, memory, (0, 1))
            for k in range(4):
                q[k] = state[(NEXT + k) * LANES]
        return last

    return chain


_LOOPS: dict[str, Callable[[str], Callable[..., Any]]] = {
    "sweep": _sweep,
    "along": _along,
    "chain": _chain,
}


@functools.cache
def loop(name: str, kind: str) -> Callable[..., int]:
    """``sweep``, ``along`` or ``chain`` for a precision.

    They take (arrays, settings, limits, first, last), and return ``last``, or the index at which
    they stopped.
    """
    return address_loop(_LOOPS[name](kind), CHUNK)
