"""The search of events: parts of the loop over tiles that locate crossings between steps.

The generated step marks each lane in which a function crossed zero, or may have crossed it twice
within one step. After a block of few steps, marked lanes go with the state at its begin to a tile
of one vector. When that is full they march on together, each at its own time, to the step of the
crossing, and shorter steps of the same method from there bracket it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from fastatt._jit import loop_part
from fastatt.codegen.call import call_generated
from fastatt.engine.stops import (
    ADVANCE,
    DT,
    SAVE,
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

#: rows of brackets: ends and the values there, a point between them and its value, the next point
#: and its value, the radius of the bisection, the width that ends it, the largest squared rotation
#: angle of a step
LOW, HIGH, AT_LOW, AT_HIGH, INNER, AT_INNER, POINT, AT_POINT, RADIUS, LEAST, ROTATED = range(11)
#: rows of the queue: lane, body, position, event, steps before the block and up to its end, what
#: is done with the lane, evaluations; its length comes after them
LANE, BODY, POSITION, EVENT, FIRST, END, DOING, TRIALS, LENGTH = range(9)
#: what is done: a step; a step known to have no crossing; the extremum within a step is searched; a
#: crossing is bracketed; nothing was found; a crossing was
MARCH, PASS, EXTREMUM, BRACKET, NONE, FOUND = range(6)
#: evaluations of an extremum, and of a bracket, at most
_FEW, _MOST = 10, 80
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


def crosses(a: Any, b: Any, direction: int) -> Any:
    """Whether a function that goes from a to b reaches or leaves zero, rising, falling or both."""
    rises, falls = (a <= 0.0) & (b >= 0.0), (a >= 0.0) & (b <= 0.0)
    if direction == 0:
        return rises | falls
    return rises if direction > 0 else falls


def turns(a: Any, b: Any, c: Any) -> Any:
    """Whether a parabola of twice the curvature of a, b and c crosses zero between b and c.

    It does wherever the function does, unless the function's curvature doubles within a step.
    """
    bend, slope = 2.0 * (a - 2.0 * b + c), c - b
    square, steep = bend * bend, 4.0 * slope * slope
    product = bend * (b + c)
    return (product > 0.0) & (steep < square) & (4.0 * product < steep + square)


_crosses, _turns = loop_part(crosses), loop_part(turns)


@loop_part
def begin_events(function, tile, search, base, count, step):
    """Rows of the events of a tile: of the initial state, or as they were after so many steps."""
    rows, _, _, _ = tile
    width, size, _, _, _, _ = search.shape
    n = search.numbers[EVENTS]
    if step == 0:
        call_generated(function, WATCH, tile, (step, 0))
        for j in range(n * width):
            value = rows[size * width + j]
            rows[(size + n) * width + j] = UNKNOWN if value >= 0.0 else -UNKNOWN
            rows[(size + 2 * n) * width + j] = 0.0
        return
    for i in range(EVENT_ROWS * n):
        for j in range(count):
            rows[(size + i) * width + j] = search.history[(base + j) * EVENT_ROWS * n + i]


@loop_part
def _join_queue(tile, search, entry):
    """Put a lane at the begin of a block into the tile of the search."""
    rows, wide, numbers, _ = tile
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
    wide_to[clock * lanes + k] = numbers[1]
    wide_to[(clock + 1) * lanes + k] = float(entry[FIRST])
    wide_to[(clock + 2) * lanes + k] = numbers[0]


@loop_part
def _march(search, k, is_stepped):
    """What to do with a lane after another step of it."""
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
    # a time is not known better
    step, steps = wide[clock * lanes + k], wide[(clock + 1) * lanes + k]
    latest = abs(wide[(clock + 2) * lanes + k] / step + steps)
    brackets[LEAST * lanes + k] = max(tolerance, latest * 2.0**-52)
    queue[TRIALS * lanes + k] = 0
    if not is_stepped:
        if _crosses(b, c, search.numbers[OF_EACH + 2 * event]):
            return BRACKET
        if _turns(a, b, c):
            return EXTREMUM
    for i in range(size):
        rows[i * lanes + k] = stepped[i * lanes + k]
    rows[last], rows[before] = c, b
    wide[(clock + 1) * lanes + k] += 1.0
    return NONE if wide[(clock + 1) * lanes + k] >= queue[END * lanes + k] else MARCH


@loop_part
def _next_point(brackets, lanes, k):
    """Where a bracket is halved: Oliveira and Takahashi, ACM Trans. Math. Softw. 47 (2020) 5."""
    low, high = brackets[LOW * lanes + k], brackets[HIGH * lanes + k]
    a, b = brackets[AT_LOW * lanes + k], brackets[AT_HIGH * lanes + k]
    middle, radius = 0.5 * (low + high), brackets[RADIUS * lanes + k]
    brackets[RADIUS * lanes + k] = 0.5 * radius
    slack = max(radius - 0.5 * (high - low), 0.0)
    point = low - a * ((high - low) / (b - a))
    side = 1.0 if middle >= point else -1.0
    away = max(0.2 * (high - low) ** 2, brackets[LEAST * lanes + k])
    point = point + side * away if away <= abs(middle - point) else middle
    return point if abs(point - middle) <= slack else middle - side * slack


@loop_part
def _narrow(brackets, lanes, k, x, value):
    """Take the value at a point into a bracket; what to do next."""
    low, high = LOW * lanes + k, HIGH * lanes + k
    if math.isnan(value):
        return NONE
    if (value > 0.0) == (brackets[AT_LOW * lanes + k] > 0.0) and value != 0.0:
        brackets[low], brackets[AT_LOW * lanes + k] = x, value
    else:
        brackets[high], brackets[AT_HIGH * lanes + k] = x, value
    is_wide = brackets[high] - brackets[low] > 4.0 * brackets[LEAST * lanes + k]
    return BRACKET if value != 0.0 and is_wide else FOUND


@loop_part
def _extremum(brackets, lanes, k, x, value, direction, trials):
    """Take the value at a point on the way to an extremum; what to do next."""
    low, high, inner = LOW * lanes + k, HIGH * lanes + k, INNER * lanes + k
    at_low, at_high, at_inner = AT_LOW * lanes + k, AT_HIGH * lanes + k, AT_INNER * lanes + k
    # the two parts of the bracket that meet at the point, from the nearest points with a value
    left = brackets[low], brackets[at_low]
    right = brackets[high], brackets[at_high]
    if trials > 1:
        if x < brackets[inner]:
            right = brackets[inner], brackets[at_inner]
        else:
            left = brackets[inner], brackets[at_inner]
    for a, b, c, d in ((left[0], left[1], x, value), (x, value, right[0], right[1])):
        if _crosses(b, d, direction):
            brackets[low], brackets[at_low] = a, b
            brackets[high], brackets[at_high] = c, d
            brackets[RADIUS * lanes + k] = c - a
            return BRACKET
    if trials > 1 and abs(brackets[at_inner]) < abs(value):
        if x < brackets[inner]:
            brackets[low], brackets[at_low] = x, value
        else:
            brackets[high], brackets[at_high] = x, value
    else:
        brackets[low], brackets[at_low] = left
        brackets[high], brackets[at_high] = right
        brackets[inner], brackets[at_inner] = x, value
    # the vertex of the parabola through the three
    p, q = brackets[inner] - brackets[low], brackets[inner] - brackets[high]
    u = p * (brackets[at_inner] - brackets[at_high])
    v = q * (brackets[at_inner] - brackets[at_low])
    point = brackets[inner] - 0.5 * (p * u - q * v) / (u - v)
    brackets[POINT * lanes + k] = point
    bends = (u - v) * (p * q) * brackets[at_inner] > 0.0
    inside = brackets[low] < point < brackets[high] and abs(point - brackets[inner]) > 1e-7
    return EXTREMUM if bends and inside and trials < _FEW else PASS


@loop_part
def _choose_points(search):
    """The next point of each lane in which something is searched; whether there is one."""
    lanes, is_any = search.numbers[LANES], False
    queue, brackets = search.queue, search.brackets
    for k in range(queue[LENGTH * lanes]):
        point, doing = POINT * lanes + k, queue[DOING * lanes + k]
        if doing == BRACKET:
            at_low, at_high = brackets[AT_LOW * lanes + k], brackets[AT_HIGH * lanes + k]
            if at_low == 0.0 or at_high == 0.0 or queue[TRIALS * lanes + k] >= _MOST:
                queue[DOING * lanes + k] = FOUND
                continue
            brackets[point] = _next_point(brackets, lanes, k)
        elif doing == EXTREMUM and queue[TRIALS * lanes + k] == 0:
            brackets[point] = 0.5
        if doing in (BRACKET, EXTREMUM):
            queue[TRIALS * lanes + k] += 1
            is_any = True
    return is_any


@loop_part
def _step_to_points(search):
    """Shorter steps of all lanes to their points."""
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
    shorter_step(function, function, trial, shape)
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
                wide[(clock + 1) * lanes + k] += 1.0
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
                doing = _narrow(brackets, lanes, k, point, value)
            elif not marching and doing == EXTREMUM:
                direction, trials = search.numbers[OF_EACH + 2 * event], queue[TRIALS * lanes + k]
                doing = _extremum(brackets, lanes, k, point, value, direction, trials)
            queue[DOING * lanes + k] = doing
    for k in range(n):
        # the end of the bracket that is nearer to zero
        nearer = abs(brackets[AT_LOW * lanes + k]) <= abs(brackets[AT_HIGH * lanes + k])
        brackets[POINT * lanes + k] = brackets[(LOW if nearer else HIGH) * lanes + k]


@loop_part
def _found_time(wide, numbers, clock, lanes, k, point):
    """The time of a point of a lane's step; of the step's end as saves have it."""
    before, step = wide[(clock + 1) * lanes + k], numbers[1]
    if point == 1.0:
        return numbers[0] + (before + 1.0) * step
    return numbers[0] + before * step + point * step


@loop_part
def _flush(search):
    """Locate what is in the queue: times, and the final states of bodies that stop."""
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
            times[body * events + event] = _found_time(wide, numbers, clock, lanes, k, point)
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
    """Whether a lane waits for the same event already."""
    for k in range(queue[LENGTH * lanes]):
        if queue[LANE * lanes + k] == lane and queue[EVENT * lanes + k] == event:
            return True
    return False


@loop_part
def search_block(tile, body_of, search, block):
    """Search the lanes that are marked after a block; bodies that stopped stay where they were."""
    rows, _, _, _ = tile
    width, size, _, _, angle_row, _ = search.shape
    times, stopped, _, _, _ = search.found
    base, count, first, last = block
    lanes, events, queue = search.numbers[LANES], search.numbers[EVENTS], search.queue
    for j in range(count):
        body = body_of[j]
        was_stopped = stopped[body] == stopped[body]
        stops = False
        for event in range(events):
            mark, at = (size + 2 * events + event) * width + j, body * events + event
            if rows[mark] == 0.0 or was_stopped:
                continue
            rows[mark] = 0.0
            if _is_waiting(queue, lanes, j, event) or queue[LENGTH * lanes] == lanes:
                _flush(search)
            if times[at] != times[at]:
                _join_queue(tile, search, (j, body, base + j, event, first, last))
                stops = stops or search.numbers[OF_EACH + 2 * event + 1] != 0
        if stops:
            _flush(search)
        if stopped[body] == stopped[body]:
            for i in range(angle_row):
                rows[i * width + j] = search.begun_at[i * width + j]


@loop_part
def end_search(rows, search, base, count):
    """Search what is left in the queue, and keep the rows of the events of a tile."""
    width, size, _, _, _, _ = search.shape
    n = EVENT_ROWS * search.numbers[EVENTS]
    if search.queue[LENGTH * search.numbers[LANES]] > 0:
        _flush(search)
    for i in range(n):
        for j in range(count):
            search.history[(base + j) * n + i] = rows[(size + i) * width + j]


@loop_part
def save_stopped(found, body_of, out, errors, first, count, saved):
    """Write the final states of bodies that stopped, as saves after that hold them."""
    _, stopped, final, _, _ = found
    for j in range(count):
        body = body_of[j]
        if stopped[body] == stopped[body]:
            for i in range(saved):
                out[(first + body) * saved + i] = final[body * (saved + 1) + i]
            errors[first + body] = final[body * (saved + 1) + saved]
