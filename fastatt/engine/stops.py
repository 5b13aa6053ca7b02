"""Stops of a run between its steps: parts of the loop over tiles.

Each lane of a tile has a clock: its step size, the steps taken before, and the time at which they
began. To reach a time between two steps, a lane takes one shorter step of the same method from the
last of its steps before that time.
"""

from __future__ import annotations

import math

from fastatt._jit import loop_part
from fastatt.codegen.call import call_generated

#: parts of a program's function
BEGIN, ADVANCE, SAVE, PROJECT, LEAVE, ENTER, WATCH, UPDATE = range(8)

#: clocks of lanes, in ``wide`` from this row on
DT, BEFORE, BEGUN, LOW, HIGH = range(5)
#: a part of a step is a clock, the number of steps with it, whether it ends a whole step, and
#: whether it begins at a sample time, at which states jump
TAKEN, ENDS, UPDATES, PART_SIZE = range(5, 9)
#: a stop: its time since the start, s, and the slack of its rounding; whether it is a breakpoint,
#: or one that is a sample time; the time since the start from which steps to it are counted; then
#: the clock of these, from BEFORE
TIME, SLACK, BREAKS, COUNTED_FROM, COUNT, _, _, _, STOP_SIZE = range(9)
BREAK, SAMPLE = 1, 2

EPS = 2.0**-52


@loop_part
def on_grid(time, slack, step):
    """(whole steps to a time since the start, the rest), where rounding leaves no rest."""
    count = math.floor(time / step * (1.0 + 4.0 * EPS))
    rest = time - count * step
    return count, rest if abs(rest) > slack else 0.0


@loop_part
def set_clock(shape, wide, first, values, at):
    """Set the clocks of all lanes, from the row ``first`` on, to the values from ``at`` on."""
    width, _, _, _, _, clock = shape
    for i in range(first, HIGH + 1):
        for j in range(width):
            wide[(clock + i) * width + j] = values[at + i - first]


@loop_part
def begin_clock(shape, wide, stops, first):
    """Set the clocks of lanes with per-body step sizes after the stops before ``first``."""
    width, _, _, _, _, clock = shape
    row = first * STOP_SIZE
    set_clock(shape, wide, BEFORE, stops, row + COUNT)
    if first > 0:
        slack = stops[row - STOP_SIZE + SLACK]
        time = stops[row - STOP_SIZE + TIME] - stops[row + COUNTED_FROM]
        for j in range(width):
            before, _ = on_grid(time, slack, wide[(clock + DT) * width + j])
            wide[(clock + BEFORE) * width + j] = before


@loop_part
def change_clock(function, shape, tile, parts, row, steps):
    """Continue with the clock of a part of a step; ``steps`` are those by the last clock, and all.

    At a sample time states jump.
    """
    _, wide, _, _ = tile
    last, now = steps
    call_generated(function, LEAVE, tile, (last, 0))
    set_clock(shape, wide, DT, parts, row)
    if parts[row + UPDATES] != 0.0:
        call_generated(function, UPDATE, tile, (now, 0))
    call_generated(function, ENTER, tile, (now, 0))


@loop_part
def count_steps(shape, tile, waiting, left, time, slack):
    """Count the steps of each lane to its last before a stop; returns the largest number."""
    rows, wide, _, _ = tile
    width, _, _, _, angle_row, clock = shape
    most = 0
    for j in range(width):
        count, _ = on_grid(time, slack, wide[(clock + DT) * width + j])
        left[j] = int(count - wide[(clock + BEFORE) * width + j])
        most = max(most, left[j])
        if left[j] <= 0:
            for i in range(angle_row):
                waiting[i * width + j] = rows[i * width + j]
    return most


@loop_part
def copy_tile(tile, copied, shape):
    """Copy all numbers of a tile's lanes."""
    rows, wide, _, _ = tile
    to, wide_to, _, _ = copied
    width, _, n_rows, n_wide, _, _ = shape
    for i in range(n_rows * width):
        to[i] = rows[i]
    for i in range(n_wide * width):
        wide_to[i] = wide[i]


@loop_part
def copy_lane(tile, copied, shape, lane):
    """Copy all numbers of a lane."""
    rows, wide, _, _ = tile
    to, wide_to, _, _ = copied
    width, _, n_rows, n_wide, _, _ = shape
    for i in range(n_rows):
        to[i * width + lane] = rows[i * width + lane]
    for i in range(n_wide):
        wide_to[i * width + lane] = wide[i * width + lane]


@loop_part
def leave_steps(function, tile, shape):
    """Prepare lanes for a shorter step; its size has to be set before ``shorter_step``."""
    _, wide, _, _ = tile
    width, _, _, _, _, clock = shape
    call_generated(function, LEAVE, tile, (0, 0))
    for j in range(width):
        before = (clock + BEFORE) * width + j
        # the time at which the shorter step begins, from the steps before it
        wide[(clock + BEGUN) * width + j] += wide[before] * wide[(clock + DT) * width + j]
        wide[before] = 0.0


@loop_part
def shorter_step(function, tile, shape):
    """A step of the size in each lane's clock."""
    _, wide, _, _ = tile
    width, _, _, _, _, clock = shape
    call_generated(function, ENTER, tile, (0, 0))
    call_generated(function, ADVANCE, tile, (0, 1))
    for j in range(width):
        wide[(clock + BEFORE) * width + j] = 1.0


@loop_part
def begin_part(function, shape, tile, copied, left, time, slack):
    """Prepare a shorter step to a stop on a copy of a tile; returns whether a lane takes one.

    ``left`` is 1 for these lanes, and 0 for those that have reached the stop.
    """
    _, wide, _, _ = tile
    _, wide_copy, _, _ = copied
    width, _, _, _, _, clock = shape
    copy_tile(tile, copied, shape)
    is_any = False
    for j in range(width):
        _, rest = on_grid(time, slack, wide[(clock + DT) * width + j])
        left[j] = 1 if rest != 0.0 else 0
        is_any = is_any or rest != 0.0
    if not is_any:
        return False
    leave_steps(function, copied, shape)
    for j in range(width):
        step = (clock + DT) * width + j
        _, wide_copy[step] = on_grid(time, slack, wide[step])
    call_generated(function, ENTER, copied, (0, 0))
    return True


@loop_part
def end_part(shape, tile, copied, left):
    """End a shorter step; lanes that had reached the stop before it stay there."""
    _, wide, _, _ = copied
    width, _, _, _, _, clock = shape
    for j in range(width):
        wide[(clock + BEFORE) * width + j] = 1.0
        if left[j] == 0:
            copy_lane(tile, copied, shape, j)


@loop_part
def count_from_stop(function, shape, tile, copied, stops, row):
    """Continue from the copy of a tile at a breakpoint, from which steps are counted."""
    rows, wide, _, _ = tile
    copy, _, _, _ = copied
    width, _, _, _, angle_row, _ = shape
    call_generated(function, LEAVE, copied, (0, 0))
    for i in range(angle_row * width):
        rows[i] = copy[i]
    set_clock(shape, wide, BEFORE, stops, row + COUNT)
    if stops[row - STOP_SIZE + BREAKS] == SAMPLE:
        call_generated(function, UPDATE, tile, (0, 0))
    call_generated(function, ENTER, tile, (0, 0))
