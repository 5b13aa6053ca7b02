"""Location of events: parts of the loop over tiles that find zero crossings between steps.

The generated step marks each lane in which a function crossed zero, or may have crossed it twice
within one step. After a block of a few steps, marked lanes are copied, with the state at the begin
of the block, to a tile of one vector. When that is full its lanes take steps, each at its own time,
up to the step with the crossing, which shorter steps of the same method from there then bracket.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from fastatt._jit import loop_part
from fastatt.codegen.call import call_generated
from fastatt.engine.brackets import (
    AT_HIGH,
    AT_LOW,
    AT_POINT,
    BRACKET,
    EXTREMUM,
    FOUND,
    HIGH,
    LEAST,
    LOW,
    MARCH,
    MOST,
    NONE,
    PASS,
    POINT,
    RADIUS,
    ROTATED,
    find_extremum,
    is_crossed,
    is_turned,
    narrow_bracket,
    next_point,
)
from fastatt.engine.stops import (
    ADVANCE,
    BEFORE,
    BEGUN,
    DT,
    SAVE,
    STOP_SIZE,
    TIME,
    WATCH,
    copy_lane,
    copy_tile,
    leave_steps,
    shorter_step,
)

#: steps of a block in which events are looked for
SEARCH_BLOCK = 16
#: what a lane keeps of each event: the values after the last two steps, whether it is marked
EVENT_ROWS = 3

#: ``arrays`` after those of the loop: memory for the state at the begin of a block; numbers of the
#: search; rows of the events of the part, found times (N, E), when a body stopped, s, and what is
#: saved from then on; then the memory of the tile of the search
(
    BEGUN_AT, SEARCH, HISTORY, TIMES, STOPPED, FINAL, SEARCH_ROWS, SEARCH_WIDE, _, _, _, _, _,
    TRIAL_ROWS, TRIAL_WIDE, BRACKETS, QUEUE,
) = range(28, 45)  # fmt: skip

#: numbers of the search: its function; how many events; lanes of its tile; then of each event its
#: direction and whether it is terminal
FUNCTION, EVENTS, LANES, OF_EACH = range(4)

#: rows of the queue: lane, body, position, event, steps before the block and up to its end, what
#: is done with the lane, evaluations; its length comes after them
LANE, BODY, POSITION, EVENT, FIRST, END, DOING, TRIALS, LENGTH = range(9)
#: in place of the mark in a run without steps so far
NOT_BEGUN = -1.0
#: in place of the value before the first: a bend that calls for a search of the first step
UNKNOWN = 1e18


class Search(NamedTuple):
    """What the search works on.

    ``numbers`` of the search; the tile's ``shape``, and that of the search's ``narrow`` tiles:
    lanes that march, and a copy of them for trials; the ``queue`` and the ``brackets`` of these
    lanes; ``found`` are times, when bodies stopped, their final states, their diagnostics and the
    width that ends a bracket; ``history`` are rows of events from call to call, ``begun_at`` the
    state of the tile at the begin of a block; ``io`` the row of saves, and how many numbers.
    """

    numbers: Any
    shape: Any
    narrow: Any
    searched: Any
    trial: Any
    queue: Any
    brackets: Any
    found: Any
    history: Any
    begun_at: Any
    io: Any


@loop_part
def begin_events(function, tile, search, base, count, step):
    """Rows of the events of a tile after some steps: as they were kept, or from the state."""
    rows, _, _, _ = tile
    width, size, _, _, _, _ = search.shape
    n = search.numbers[EVENTS]
    for i in range(EVENT_ROWS * n):
        for j in range(count):
            rows[(size + i) * width + j] = search.history[(base + j) * EVENT_ROWS * n + i]
    if rows[(size + 2 * n) * width] != NOT_BEGUN:
        return
    call_generated(function, WATCH, tile, (step, 0))
    for j in range(n * width):
        value = rows[size * width + j]
        rows[(size + n) * width + j] = UNKNOWN if value >= 0.0 else -UNKNOWN
        rows[(size + 2 * n) * width + j] = 0.0


@loop_part
def keep_begin(rows, search):
    """Keep the state of a tile, which lanes that are searched or that stopped go back to."""
    width, _, _, _, angle_row, _ = search.shape
    for i in range(angle_row * width):
        search.begun_at[i] = rows[i]


@loop_part
def begin_stretch(rows, body_of, search, count):
    """Search the step that follows a breakpoint in any case: what is watched may bend there."""
    width, size, _, _, angle_row, _ = search.shape
    _, stopped, _, _, _ = search.found
    n = search.numbers[EVENTS]
    for j in range(n * width):
        value = rows[size * width + j]
        rows[(size + n) * width + j] = UNKNOWN if value >= 0.0 else -UNKNOWN
    for j in range(count):
        if stopped[body_of[j]] == stopped[body_of[j]]:
            for i in range(angle_row):
                rows[i * width + j] = search.begun_at[i * width + j]


@loop_part
def _join_queue(tile, search, entry):
    """Copy a lane at the begin of a block into the tile of the search."""
    rows, wide, _, _ = tile
    to, wide_to, _, _ = search.searched
    width, _, n_rows, n_wide, angle_row, clock = search.shape
    lanes, queue = search.numbers[LANES], search.queue
    k, lane = queue[LENGTH * lanes], entry[LANE]
    queue[LENGTH * lanes] = k + 1
    for i in range(DOING):
        queue[i * lanes + k] = entry[i]
    for i in range(n_rows):
        at = i * width + lane
        to[i * lanes + k] = search.begun_at[at] if i < angle_row else rows[at]
    for i in range(n_wide):
        wide_to[i * lanes + k] = wide[i * width + lane]
    before = (clock + BEFORE) * lanes + k
    queue[END * lanes + k] += int(wide_to[before])
    wide_to[before] += float(entry[FIRST])


@loop_part
def _march(search, k, is_stepped):
    """What to do with a lane after another of its steps."""
    rows, wide, _, _ = search.searched
    stepped, _, _, _ = search.trial
    _, size, _, _, angle_row, clock = search.narrow
    _, _, _, _, tolerance = search.found
    lanes, n = search.numbers[LANES], search.numbers[EVENTS]
    queue, brackets = search.queue, search.brackets
    event = queue[EVENT * lanes + k]
    last, before = (size + event) * lanes + k, (size + n + event) * lanes + k
    a, b, c = rows[before], rows[last], stepped[last]
    rotated = stepped[angle_row * lanes + k]
    brackets[ROTATED * lanes + k] = max(brackets[ROTATED * lanes + k], rotated)
    brackets[LOW * lanes + k], brackets[HIGH * lanes + k] = 0.0, 1.0
    brackets[AT_LOW * lanes + k], brackets[AT_HIGH * lanes + k] = b, c
    brackets[RADIUS * lanes + k] = 1.0
    # the accuracy of a time is limited by its rounding
    at_steps = (clock + BEFORE) * lanes + k
    step, begun = wide[(clock + DT) * lanes + k], wide[(clock + BEGUN) * lanes + k]
    latest = abs(begun / step + wide[at_steps])
    brackets[LEAST * lanes + k] = max(tolerance, latest * 2.0**-52)
    queue[TRIALS * lanes + k] = 0
    if not is_stepped:
        if is_crossed(b, c, search.numbers[OF_EACH + 2 * event]):
            return BRACKET
        if is_turned(a, b, c):
            return EXTREMUM
    for i in range(size):
        rows[i * lanes + k] = stepped[i * lanes + k]
    rows[last], rows[before] = c, b
    wide[at_steps] += 1.0
    return NONE if wide[at_steps] >= queue[END * lanes + k] else MARCH


@loop_part
def _choose_points(search):
    """The next point of each lane that is searched; returns whether there is one."""
    lanes, is_any = search.numbers[LANES], False
    queue, brackets = search.queue, search.brackets
    for k in range(queue[LENGTH * lanes]):
        point, doing = POINT * lanes + k, queue[DOING * lanes + k]
        if doing == BRACKET:
            at_low, at_high = brackets[AT_LOW * lanes + k], brackets[AT_HIGH * lanes + k]
            if at_low == 0.0 or at_high == 0.0 or queue[TRIALS * lanes + k] >= MOST:
                queue[DOING * lanes + k] = FOUND
                continue
            brackets[point] = next_point(brackets, lanes, k)
        elif doing == EXTREMUM and queue[TRIALS * lanes + k] == 0:
            brackets[point] = 0.5
        if doing in (BRACKET, EXTREMUM):
            queue[TRIALS * lanes + k] += 1
            is_any = True
    return is_any


@loop_part
def _step_to_points(search):
    """Take shorter steps of all lanes to their points."""
    searched, trial, shape, brackets = search.searched, search.trial, search.narrow, search.brackets
    _, wide, _, _ = searched
    _, wide_to, _, _ = trial
    lanes, _, _, _, _, clock = shape
    function = search.numbers[FUNCTION]
    copy_tile(searched, trial, shape)
    leave_steps(function, trial, shape)
    for k in range(lanes):
        step = (clock + DT) * lanes + k
        wide_to[step] = brackets[POINT * lanes + k] * wide[step]
    shorter_step(function, trial, shape)
    for k in range(lanes):
        if brackets[POINT * lanes + k] == 0.0:
            copy_lane(searched, trial, shape, k)


@loop_part
def _locate(search):
    """Locate the first crossing of each lane in the queue, within its block."""
    values, wide, _, _ = search.trial
    _, size, _, _, _, clock = search.narrow
    lanes, function = search.numbers[LANES], search.numbers[FUNCTION]
    queue, brackets = search.queue, search.brackets
    n = queue[LENGTH * lanes]
    for k in range(n):
        queue[DOING * lanes + k] = MARCH
        brackets[ROTATED * lanes + k] = 0.0
    while True:
        marching = False
        for k in range(n):
            marching = marching or queue[DOING * lanes + k] <= PASS
        if marching:
            copy_tile(search.searched, search.trial, search.narrow)
            call_generated(function, ADVANCE, search.trial, (0, 1))
            for k in range(lanes):
                wide[(clock + BEFORE) * lanes + k] += 1.0
        elif _choose_points(search):
            _step_to_points(search)
        else:
            break
        call_generated(function, WATCH, search.trial, (0, 0))
        for k in range(n):
            doing, event = queue[DOING * lanes + k], queue[EVENT * lanes + k]
            point = brackets[POINT * lanes + k]
            brackets[AT_POINT * lanes + k] = values[(size + event) * lanes + k]
            value = brackets[AT_POINT * lanes + k]
            if marching and doing <= PASS:
                doing = _march(search, k, doing == PASS)
            elif not marching and doing == BRACKET:
                doing = narrow_bracket(brackets, lanes, k, point, value)
            elif not marching and doing == EXTREMUM:
                direction, trials = search.numbers[OF_EACH + 2 * event], queue[TRIALS * lanes + k]
                doing = find_extremum(brackets, lanes, k, point, value, direction, trials)
            queue[DOING * lanes + k] = doing
    for k in range(n):
        # the end of the bracket that is nearer to zero
        nearer = abs(brackets[AT_LOW * lanes + k]) <= abs(brackets[AT_HIGH * lanes + k])
        brackets[POINT * lanes + k] = brackets[(LOW if nearer else HIGH) * lanes + k]


@loop_part
def _found_time(wide, clock, lanes, k, point):
    """The time of a point of a lane's step; at the end of a step it is that of the saves."""
    step, before = wide[(clock + DT) * lanes + k], wide[(clock + BEFORE) * lanes + k]
    begun = wide[(clock + BEGUN) * lanes + k]
    if point == 1.0:
        return begun + (before + 1.0) * step
    return begun + before * step + point * step


@loop_part
def _flush(search):
    """Locate the events in the queue: times, and the final states of bodies that stop."""
    _, wide, numbers, _ = search.searched
    rows, _, _, _ = search.trial
    times, stopped, final, diagnostics, _ = search.found
    lanes, _, _, _, _, clock = search.narrow
    events, queue, brackets = search.numbers[EVENTS], search.queue, search.brackets
    n = queue[LENGTH * lanes]
    _locate(search)
    queue[LENGTH * lanes] = 0
    stops = False
    for k in range(n):
        body, event = queue[BODY * lanes + k], queue[EVENT * lanes + k]
        if queue[DOING * lanes + k] == FOUND:
            point = brackets[POINT * lanes + k]
            times[body * events + event] = _found_time(wide, clock, lanes, k, point)
            stops = stops or search.numbers[OF_EACH + 2 * event + 1] != 0
    forward, (io_row, saved) = (1.0 if numbers[1] > 0.0 else -1.0), search.io
    if stops:
        _step_to_points(search)
        call_generated(search.numbers[FUNCTION], SAVE, search.trial, (0, 0))
    for k in range(n):
        body, event = queue[BODY * lanes + k], queue[EVENT * lanes + k]
        time = times[body * events + event]
        is_terminal = search.numbers[OF_EACH + 2 * event + 1] != 0
        is_final = queue[DOING * lanes + k] == FOUND and is_terminal
        if is_final and not (stopped[body] - time) * forward <= 0.0:
            stopped[body] = time
            for i in range(saved + 1):
                final[body * (saved + 1) + i] = rows[(io_row + i) * lanes + k]
            at = queue[POSITION * lanes + k]
            diagnostics[at] = max(diagnostics[at], brackets[ROTATED * lanes + k])
    for k in range(n):
        body = queue[BODY * lanes + k]
        for event in range(events):
            if (times[body * events + event] - stopped[body]) * forward > 0.0:
                times[body * events + event] = math.nan


@loop_part
def _is_waiting(queue, lanes, lane, event):
    """Whether a lane is in the queue for the same event already."""
    for k in range(queue[LENGTH * lanes]):
        if queue[LANE * lanes + k] == lane and queue[EVENT * lanes + k] == event:
            return True
    return False


@loop_part
def search_block(tile, body_of, left, search, block):
    """Search the lanes that are marked after a block; bodies that have stopped keep their state.

    Lanes of which fewer steps are ``left`` are waiting. Returns whether a body may have stopped.
    """
    rows, _, _, _ = tile
    width, size, _, _, angle_row, _ = search.shape
    times, stopped, _, _, _ = search.found
    base, count, first, last = block
    lanes, events, queue = search.numbers[LANES], search.numbers[EVENTS], search.queue
    may_stop = False
    for j in range(count):
        if left[j] < last:
            continue
        body = body_of[j]
        was_stopped = stopped[body] == stopped[body]
        for event in range(events):
            mark, at = (size + 2 * events + event) * width + j, body * events + event
            if rows[mark] == 0.0 or was_stopped:
                continue
            rows[mark] = 0.0
            if _is_waiting(queue, lanes, j, event) or queue[LENGTH * lanes] == lanes:
                _flush(search)
            if times[at] != times[at]:
                _join_queue(tile, search, (j, body, base + j, event, first, last))
                may_stop = may_stop or search.numbers[OF_EACH + 2 * event + 1] != 0
    if may_stop:
        _flush(search)
    for j in range(count):
        if left[j] >= last and stopped[body_of[j]] == stopped[body_of[j]]:
            for i in range(angle_row):
                rows[i * width + j] = search.begun_at[i * width + j]
    return may_stop


@loop_part
def end_search(rows, search, base, count):
    """Search the rest of the queue, and keep the rows of the events of a tile."""
    width, size, _, _, _, _ = search.shape
    n = EVENT_ROWS * search.numbers[EVENTS]
    if search.queue[LENGTH * search.numbers[LANES]] > 0:
        _flush(search)
    for i in range(n):
        for j in range(count):
            search.history[(base + j) * n + i] = rows[(size + i) * width + j]


@loop_part
def save_stopped(found, body_of, out, errors, first, count, saved):
    """Write the final states of bodies that have stopped into a save."""
    _, stopped, _, _, _ = found
    for j in range(count):
        if stopped[body_of[j]] == stopped[body_of[j]]:
            _save_final(found, out, errors, first, body_of[j], saved)


@loop_part
def _save_final(found, out, errors, first, body, saved):
    """Write the final state of a body into the save whose first row is ``first``."""
    _, _, final, _, _ = found
    for i in range(saved):
        out[(first + body) * saved + i] = final[body * (saved + 1) + i]
    errors[first + body] = final[body * (saved + 1) + saved]


@loop_part
def save_again(search, body_of, saves, stops, end, count):
    """Write the final states of bodies that have stopped into saves before the stop ``end``.

    A save within a step is made before that step is searched. ``saves`` are the saved values, the
    norm errors, the slots of the stops, and the number of bodies.
    """
    _, stopped, _, _, _ = search.found
    _, _, numbers, _ = search.searched
    _, saved = search.io
    out, errors, slots, ensemble = saves
    for j in range(count):
        body, at = body_of[j], end - 1
        while at >= 0:
            since = numbers[0] + stops[at * STOP_SIZE + TIME] - stopped[body]
            if not since * numbers[1] >= 0.0:
                break
            if slots[at] >= 0:
                _save_final(search.found, out, errors, slots[at] * ensemble, body, saved)
            at -= 1
