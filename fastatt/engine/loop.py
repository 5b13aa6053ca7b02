"""The loop over tiles: plain Python on flat arrays, compiled by Numba.

A tile is a few vectors of bodies that stay in the first-level cache for many steps. It always runs
its full width (the last body fills it up), so that every body meets the same instructions whatever
the size of the ensemble. ``rows`` and ``wide`` hold all numbers that a step uses, with a row of
lanes for each (``fastatt.engine.program.Layout``).

The polynomials of the small-angle form of an exponential hold up to a rotation of π in one step;
the any-angle form takes a root and a division more. A block of steps runs in the small-angle form,
and lanes with larger angles repeat the block in the any-angle form. That form is compiled when a
lane first needs it: the loop then returns the number of that tile, where the next call begins.
Other lanes keep their results, so that the bits of a body do not depend on the other bodies of its
tile. Bodies whose rotation angles are known beforehand are not monitored.

With per-body step sizes each body takes its steps up to the last one before a save, and then waits.
The saved state is one shorter step of the same method from there, on a copy: the steps of a body
depend neither on other bodies nor on the saves. At a breakpoint this shorter step is kept, and the
steps of all bodies are counted from there. With one step size for all, a step with breakpoints is
divided there.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fastatt._jit import address_loop, loop_part
from fastatt.codegen.call import call_generated, doubles, octets, reals, wholes
from fastatt.engine import crossings
from fastatt.engine.stops import (
    ADVANCE,
    BEFORE,
    BEGIN,
    BREAKS,
    COUNTED_FROM,
    DT,
    ENDS,
    PART_SIZE,
    PROJECT,
    SAVE,
    SLACK,
    STOP_SIZE,
    TAKEN,
    TIME,
    begin_clock,
    begin_part,
    change_clock,
    count_from_stop,
    count_steps,
    end_part,
    set_clock,
)

#: the most bodies in a tile; few bodies take one vector
WIDTH = 64

#: ``arrays``: the program's numbers; initial attitudes and the rest of the state, parameters, known
#: rotation angles of a step, flags; saved values (S, N, k), norm errors (S, N), status (N,); states
#: and diagnostics of the part, largest angle of a step, rad; with per-body step sizes the order of
#: bodies, step sizes, stops, their slots or −1; parts of steps and their steps; memory of a tile
(
    NUMBERS, WHOLE, Q0, Y0, PARAMS, KNOWN_ANGLES, FLAGS, OUT, ERRORS, STATUS, STATES,
    DIAGNOSTIC_ROWS, LARGEST, ORDER, STEP_SIZES, STOPS, SLOTS, PARTS, PART_STEPS, ROWS, WIDE, KEPT,
    MARKS, BODY_OF, WAITING, LEFT, COPY, WIDE_COPY,
) = range(28)  # fmt: skip

#: ``settings``: the functions for small angles and for any, or 0; the steps (per body: the stops)
#: [first, last) of a run of ``n_steps``; the steps between saves, counted from ``origin``, the
#: first in slot ``slot``; steps between two projections, 0 for none; steps of a block; the first
#: of the parts of steps and their number; bodies of the part, the first of them, and of the
#: ensemble; the lengths of the initial values; the layout of a tile
(
    SMALL, ANY, FIRST, LAST, N_STEPS, EVERY, SLOT, PROJECTION, ORIGIN, BLOCK, PART, N_PARTS, BODIES,
    BODY, ENSEMBLE, Q0_LENGTH, Y0_LENGTH, PARAMS_LENGTH, KNOWN_LENGTH, FLAGS_LENGTH,
    TILE_WIDTH, N_ROWS, N_WIDE, SIZE, SAVED, COORDINATES, CARRIED, N_PARAMS, ANGLE_ROW, BOUND_ROW,
    IO_ROW, CLOCK_ROW, MONITOR, DIAGNOSTICS, FLAG_CODES,
) = range(35)  # fmt: skip

#: how rotation angles are monitored: not, without an any-angle form; in every step; or known
#: beforehand, from an array or from a row of the tile
NEVER, ALWAYS, KNOWN, BOUNDED = range(4)
#: the first rows of the diagnostics (``fastatt.engine.status.DIAGNOSTICS``)
ANGLE, NORM = range(2)
#: ``limits``: the known angle up to which steps are not monitored; then bounds of the diagnostics
QUIET, BOUNDS = range(2)
NON_FINITE = 1

PI_SQUARED = math.pi * math.pi


@loop_part
def _load(source, length, size, body_of, rows, first, width):
    """Copy columns of an array into rows; its last row serves all bodies after it."""
    # the loop over lanes is the inner one, since there are few columns
    for i in range(size):
        for j in range(width):
            rows[(first + i) * width + j] = source[min(body_of[j], length - 1) * size + i]


@loop_part
def _raise(values, at, value):
    """Store the larger of two numbers, or NaN."""
    if not (values[at] >= value or values[at] != values[at]):
        values[at] = value


@loop_part
def _begin(settings, limits, tile, body_of, marks, known, watched):
    """Begin a tile with its states and known rotation angles; returns whether one may be too large.

    ``watched`` are the states and the diagnostics of the part, and the tile's first position.
    """
    rows, _, _, _ = tile
    states, diagnostics, base = watched
    width, size, n = settings[TILE_WIDTH], settings[SIZE], settings[BODIES]
    call_generated(settings[SMALL], BEGIN, tile, (0, 0))
    unbounded = False
    for j in range(width):
        position, angle = min(base + j, n - 1), 0.0
        if settings[MONITOR] >= KNOWN:
            angle = known[min(body_of[j], settings[KNOWN_LENGTH] - 1)] ** 2
            if settings[MONITOR] == BOUNDED:
                angle = float(rows[settings[BOUND_ROW] * width + j])
            marks[j] = 0 if angle <= limits[QUIET] ** 2 else 1
            if marks[j] != 0:
                unbounded, angle = True, 0.0
        if settings[FIRST] > 0:
            for i in range(size):
                rows[i * width + j] = states[position * size + i]
        elif base + j < n:
            for k in range(settings[DIAGNOSTICS]):
                diagnostics[k * n + position] = angle if k == ANGLE else 0.0
    return unbounded


@loop_part
def _steps(settings, function, tile, first, last):
    """Take steps in a form; stores the largest squared rotation angle of each lane."""
    rows, _, _, _ = tile
    width, angle_row = settings[TILE_WIDTH], settings[ANGLE_ROW]
    for j in range(width):
        rows[angle_row * width + j] = 0.0
    call_generated(function, ADVANCE, tile, (first, last))


@loop_part
def _advance(settings, tile, kept, marks, unbounded, first, last):
    """Take a block of steps; returns False if a lane needs the any-angle form and it is missing."""
    rows, _, _, _ = tile
    width, angle_row = settings[TILE_WIDTH], settings[ANGLE_ROW]
    carried, monitored = (angle_row + 1) * width, settings[MONITOR] == ALWAYS
    if monitored or unbounded:
        for i in range(carried):
            kept[i] = rows[i]
    _steps(settings, settings[SMALL], tile, first, last)
    repeats = unbounded
    if monitored:
        for j in range(width):
            marks[j] = 1 if rows[angle_row * width + j] > PI_SQUARED else 0
            repeats = repeats or marks[j] != 0
    if not repeats:
        return True
    if settings[ANY] == 0:
        return False
    for i in range(carried):
        before = kept[i]
        kept[i] = rows[i]
        rows[i] = before
    _steps(settings, settings[ANY], tile, first, last)
    for i in range(carried):
        if marks[i % width] == 0:
            rows[i] = kept[i]
    return True


@loop_part
def _save(settings, tile, body_of, saved, slot, steps, search):
    """Write a tile's values to the trajectory; ``saved`` are (out, errors, diagnostics, base)."""
    rows, _, _, _ = tile
    out, errors, diagnostics, base = saved
    width, size, n = settings[TILE_WIDTH], settings[SAVED], settings[BODIES]
    io_row = settings[IO_ROW]
    call_generated(settings[SMALL], SAVE, tile, (steps, 0))
    count, first = min(n - base, width), slot * settings[ENSEMBLE]
    for i in range(size):
        for j in range(count):
            out[(first + body_of[j]) * size + i] = rows[(io_row + i) * width + j]
    for j in range(count):
        errors[first + body_of[j]] = rows[(io_row + size) * width + j]
    for k in range(NORM, settings[DIAGNOSTICS]):
        for j in range(count):
            value = abs(rows[(io_row + size + k - NORM) * width + j])
            _raise(diagnostics, k * n + base + j, value)
    if search is not None:
        crossings.save_stopped(search.found, body_of, out, errors, first, count, size)


@loop_part
def _set_status(states, diagnostics, arrays, settings, limits, first, count):
    """Set the flags of the bodies at positions from ``first`` on, from states and diagnostics."""
    status, flags = octets(arrays[STATUS]), octets(arrays[FLAGS])
    largest, body_of = doubles(arrays[LARGEST]), wholes(arrays[BODY_OF])
    size, n = settings[SIZE], settings[BODIES]
    for j in range(count):
        position, body = first + j, body_of[j]
        spoilt = 0.0
        for i in range(size):
            spoilt += states[position * size + i] * 0.0
        finite = spoilt == 0.0
        found = int(flags[min(body, settings[FLAGS_LENGTH] - 1)])
        if not finite:
            found |= NON_FINITE
        for k in range(settings[DIAGNOSTICS]):
            value = float(diagnostics[k * n + position])
            if k == ANGLE:
                value = math.sqrt(value)
                largest[0] = max(largest[0], value)
            exceeded = settings[FLAG_CODES + k]
            infinite = settings[FLAG_CODES + settings[DIAGNOSTICS] + k]
            if value == math.inf and infinite != exceeded:
                found |= infinite if finite else 0
            elif (finite or k == ANGLE) and not value <= limits[BOUNDS + k]:
                found |= exceeded
        status[body] = found


def _run_tiles(kind: str, per_body: bool, events: bool) -> Callable[..., Any]:
    """The loop for a precision, for one step size for all or per-body ones, and with events."""
    # relative tolerance of a point in a step, by the rounding of the time and of the state
    tolerance = 2.0**-50 if kind == "double" else 2.0**-22

    def run_tiles(arrays, settings, limits, first_tile, last_tile):
        """Take the steps of a span on tiles; returns the tile that lacked the any-angle form."""
        arrays, settings, limits = wholes(arrays), wholes(settings), doubles(limits)
        width, size, n = settings[TILE_WIDTH], settings[SIZE], settings[BODIES]
        angle_row, io_row, clock = settings[ANGLE_ROW], settings[IO_ROW], settings[CLOCK_ROW]
        shape = width, size, settings[N_ROWS], settings[N_WIDE], angle_row, clock
        small = settings[SMALL]
        numbers, whole = doubles(arrays[NUMBERS]), wholes(arrays[WHOLE])
        rows, wide = reals(arrays[ROWS], kind), doubles(arrays[WIDE])
        kept, waiting = reals(arrays[KEPT], kind), reals(arrays[WAITING], kind)
        marks, body_of, left = wholes(arrays[MARKS]), wholes(arrays[BODY_OF]), wholes(arrays[LEFT])
        states, diagnostics = reals(arrays[STATES], kind), reals(arrays[DIAGNOSTIC_ROWS], kind)
        out, errors = reals(arrays[OUT], kind), reals(arrays[ERRORS], kind)
        q0, y0 = reals(arrays[Q0], kind), reals(arrays[Y0], kind)
        params, known = doubles(arrays[PARAMS]), doubles(arrays[KNOWN_ANGLES])
        step_sizes, stops = doubles(arrays[STEP_SIZES]), doubles(arrays[STOPS])
        order, slots = wholes(arrays[ORDER]), wholes(arrays[SLOTS])
        parts, part_steps = doubles(arrays[PARTS]), wholes(arrays[PART_STEPS])
        tile = rows, wide, numbers, whole
        copied = reals(arrays[COPY], kind), doubles(arrays[WIDE_COPY]), numbers, whole
        if events:
            times, stopped = doubles(arrays[crossings.TIMES]), doubles(arrays[crossings.STOPPED])
            final = reals(arrays[crossings.FINAL], kind)
            searched_rows, trial_rows = arrays[crossings.SEARCH_ROWS], arrays[crossings.TRIAL_ROWS]
            searched_wide, trial_wide = arrays[crossings.SEARCH_WIDE], arrays[crossings.TRIAL_WIDE]
            found = times, stopped, final, diagnostics, tolerance
            of_search = wholes(arrays[crossings.SEARCH])
            search = crossings.Search(
                of_search,
                shape,
                (of_search[crossings.LANES], *shape[1:]),
                (reals(searched_rows, kind), doubles(searched_wide), numbers, whole),
                (reals(trial_rows, kind), doubles(trial_wide), numbers, whole),
                wholes(arrays[crossings.QUEUE]),
                doubles(arrays[crossings.BRACKETS]),
                found,
                reals(arrays[crossings.HISTORY], kind),
                reals(arrays[crossings.BEGUN_AT], kind),
                (io_row, settings[SAVED]),
            )
        else:
            search = None
        for number in range(first_tile, last_tile):
            base = number * width
            count = min(n - base, width)
            for j in range(width):
                body = min(base + j, n - 1) + settings[BODY]
                body_of[j] = order[body] if per_body else body
                left[j] = settings[N_STEPS]
            attitude, carried = settings[COORDINATES], settings[CARRIED]
            _load(q0, settings[Q0_LENGTH], attitude, body_of, rows, io_row, width)
            _load(y0, settings[Y0_LENGTH], carried, body_of, rows, io_row + attitude, width)
            _load(params, settings[PARAMS_LENGTH], settings[N_PARAMS], body_of, wide, 0, width)
            part, ahead = settings[PART], 0
            if per_body:
                _load(step_sizes, settings[ENSEMBLE], 1, body_of, wide, clock, width)
                begin_clock(shape, wide, stops, settings[FIRST])
            elif part > 0:
                set_clock(shape, wide, DT, parts, (part - 1) * PART_SIZE)
            watched, saved = (states, diagnostics, base), (out, errors, diagnostics, base)
            saves = out, errors, slots, settings[ENSEMBLE]
            unbounded = _begin(settings, limits, tile, body_of, marks, known, watched)
            if events:
                crossings.begin_events(small, tile, search, base, count, settings[FIRST])
            at, slot = settings[FIRST], -1
            is_bent = at == settings[ORIGIN]
            if not per_body and at == settings[ORIGIN]:
                slot = 0 if settings[SLOT] == 1 or settings[N_STEPS] == at else -1
            while True:
                if slot >= 0:
                    _save(settings, tile, body_of, saved, slot, at, search)
                if at >= settings[LAST]:
                    break
                # up to the next save or projection, or each lane up to the next stop
                stays, slot = False, -1
                if per_body:
                    row = at * STOP_SIZE
                    time, slack = stops[row + TIME] - stops[row + COUNTED_FROM], stops[row + SLACK]
                    begin, end = 0, count_steps(shape, tile, waiting, left, time, slack)
                elif part < settings[N_PARTS] and part_steps[part] == at:
                    if events:
                        crossings.keep_begin(rows, search)
                    row = part * PART_SIZE
                    change_clock(small, shape, tile, parts, row, (at + ahead, at))
                    if events:
                        crossings.begin_stretch(rows, body_of, search, count)
                        is_bent = True
                    begin, end = at, at + int(parts[row + TAKEN])
                    stays = parts[row + ENDS] == 0.0
                    ahead = end - at if stays else 0
                    part += 1
                else:
                    begin, every = at, settings[EVERY]
                    end = ((at - settings[ORIGIN]) // every + 1) * every + settings[ORIGIN]
                    end = min(end, settings[LAST])
                    if settings[PROJECTION] > 0:
                        end = min(end, (at // settings[PROJECTION] + 1) * settings[PROJECTION])
                    if part < settings[N_PARTS]:
                        end = min(end, part_steps[part])
                while begin < end:
                    # blocks end at multiples, so that bits do not depend on where a call begins
                    stop = min((begin // settings[BLOCK] + 1) * settings[BLOCK], end)
                    if per_body:
                        for j in range(width):
                            stop = min(stop, left[j]) if left[j] > begin else stop
                    if events:
                        # a parabola needs three values: such a step is always searched
                        stop, is_bent = begin + 1 if is_bent else stop, False
                        crossings.keep_begin(rows, search)
                    if not _advance(settings, tile, kept, marks, unbounded, begin, stop):
                        return number
                    if events:
                        block = base, count, begin, stop
                        may_stop = crossings.search_block(tile, body_of, left, search, block)
                        if per_body and may_stop:
                            crossings.save_again(search, body_of, saves, stops, at, count)
                    for j in range(count):
                        angle, reached = float(rows[angle_row * width + j]), left[j] >= stop
                        if events:
                            reached = reached and stopped[body_of[j]] != stopped[body_of[j]]
                        if reached and angle > diagnostics[ANGLE * n + base + j]:
                            diagnostics[ANGLE * n + base + j] = angle
                    if per_body:
                        for j in range(width):
                            if left[j] == stop:
                                for i in range(angle_row):
                                    waiting[i * width + j] = rows[i * width + j]
                    begin = stop
                if per_body:
                    for i in range(angle_row * width):
                        rows[i] = waiting[i]
                    for j in range(width):
                        wide[(clock + BEFORE) * width + j] += max(left[j], 0)
                    is_break = stops[row + BREAKS] != 0.0
                    # the saves between two steps are made on a copy, and steps go on from before
                    is_kept = is_break or at + 1 == settings[N_STEPS]
                    if is_kept or slots[at] >= 0:
                        form = small if settings[MONITOR] == NEVER else settings[ANY]
                        if begin_part(small, shape, tile, copied, left, time, slack):
                            if form == 0:
                                return number
                            if events and is_kept:
                                crossings.keep_begin(copied[0], search)
                                crossings.begin_stretch(copied[0], body_of, search, count)
                            call_generated(form, ADVANCE, copied, (0, 1))
                            if events and is_kept:
                                block = base, count, 0, 1
                                if crossings.search_block(copied, body_of, left, search, block):
                                    crossings.save_again(search, body_of, saves, stops, at, count)
                            end_part(shape, tile, copied, left)
                    if slots[at] >= 0:
                        _save(settings, copied, body_of, saved, slots[at], 0, search)
                    if is_break:
                        for j in range(count):
                            angle = copied[0][angle_row * width + j] if left[j] != 0 else 0.0
                            _raise(diagnostics, ANGLE * n + base + j, angle)
                        if events:
                            crossings.keep_begin(rows, search)
                        count_from_stop(small, shape, tile, copied, stops, row + STOP_SIZE)
                        if events:
                            crossings.begin_stretch(rows, body_of, search, count)
                            is_bent = True
                    at += 1
                elif not stays:
                    at = end
                    if settings[PROJECTION] > 0 and at % settings[PROJECTION] == 0:
                        call_generated(small, PROJECT, tile, (0, 0))
                        for j in range(count):
                            _raise(diagnostics, NORM * n + base + j, rows[io_row * width + j])
                    since = at - settings[ORIGIN]
                    if since % settings[EVERY] == 0 or at == settings[N_STEPS]:
                        slot = (since - 1) // settings[EVERY] + settings[SLOT]
            if events:
                crossings.end_search(rows, search, base, count)
            for i in range(size):
                for j in range(count):
                    states[(base + j) * size + i] = rows[i * width + j]
            _set_status(states, diagnostics, arrays, settings, limits, base, count)
        return last_tile

    return run_tiles


def _set_all_status(kind: str) -> Callable[..., Any]:
    """The loop that sets the flags of bodies whose states were computed elsewhere."""

    def set_all_status(arrays, settings, limits, first, count):
        arrays, settings, limits = wholes(arrays), wholes(settings), doubles(limits)
        states, diagnostics = reals(arrays[STATES], kind), reals(arrays[DIAGNOSTIC_ROWS], kind)
        _set_status(states, diagnostics, arrays, settings, limits, first, count)
        return count

    return set_all_status


#: the loop is compiled again if its parts in other files change
_PARTS = ("brackets.py", "crossings.py", "stops.py")
_OTHERS = [Path(__file__).with_name(x).read_bytes() for x in _PARTS]


@functools.cache
def tile_loop(kind: str, *, per_body: bool, events: bool = False) -> Callable[..., int]:
    """``run_tiles(arrays, settings, limits, first_tile, last_tile)`` for a precision."""
    return address_loop(_run_tiles(kind, per_body, events), _OTHERS)


@functools.cache
def status_loop(kind: str) -> Callable[..., int]:
    """``set_all_status(arrays, settings, limits, first, count)`` for a precision."""
    return address_loop(_set_all_status(kind))
