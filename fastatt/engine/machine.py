"""The machine: performs a tape on tiles of bodies; plain loops over NumPy arrays.

A tile is a few vectors of bodies that stay in the first-level cache for a whole tape. ``rows`` has
a row of lanes for each number of the state, and more (``fastatt.engine.program``). A tile
always runs its full width (the last body fills it up), so that a body meets the same instructions
whatever the size of the ensemble.

The machine moves numbers and calls formulas; it computes nothing itself. The first rows are all
that a body takes with it from one tape to the next: state, prepared numbers, invariants, events,
the largest squared angle of a step, diagnostics, status.

The polynomials of the small-angle step hold up to a rotation of π in one step. A block of steps
runs with them; lanes with a larger angle repeat it with the any-angle step, which is compiled when
a lane first needs it: the machine then returns the number of that tile, where the next call begins.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import from_dtype, types

from fastatt._jit import loop_part, machine
from fastatt.codegen.call import TYPES, call
from fastatt.codegen.row_loops import load, store
from fastatt.engine.tape import RECORD, Action

PI_SQUARED = math.pi**2

#: the numbers that all lanes share begin with these: the clock, the share of dt by which the
#: stepped variables of a method are ahead, and where in the piece the clock begins
TIME = np.dtype([(name, np.float64) for name in ("begin", "dt", "share", "low", "high", "count")])

#: what the machine has to know of a program: addresses of its functions with small-angle and with
#: any-angle steps (0: not compiled yet), and of its tables; the rows of a tile
PROGRAM = np.dtype(
    [
        (name, np.int64)
        for name in (
            "small_angle", "any_angle", "tables",
            "fork",  # how many rows are put back after a fork
            "angle",  # the row of the largest squared angle
            "io",  # the first of the rows of initial and of saved values
            "coordinates",  # how many of the initial values are the attitude
        )
    ]
)  # fmt: skip


class Tile(NamedTuple):
    """The memory of a thread: rows, rows of double precision, numbers that all lanes share.

    ``time`` is a record of the type ``TIME`` at the begin of these numbers.
    """

    rows: Any
    wide: Any
    time: Any


class Bodies(NamedTuple):
    """The arrays of an ensemble, (S, N, k) with any strides.

    Initial attitudes, the rest of the initial state, parameters; what bodies take with them; values
    of saves, with the norm error last. S is 1 but for the last.
    """

    q0: Any
    y0: Any
    params: Any
    states: Any
    saves: Any


@loop_part
def copy(rows, to, count):
    """Copy the first rows."""
    for i in range(count):
        for j in range(rows.shape[1]):
            to[i, j] = rows[i, j]


@loop_part
def addresses(p, tile):
    """The memory of a program."""
    return tile.rows.ctypes.data, tile.wide.ctypes.data, tile.time.ctypes.data, p.tables


@loop_part
def repeat(p, s, tile, before):
    """Repeat a block with any-angle steps, for lanes that rotated by more than π in one step.

    ``before`` are the rows before the block. Returns False if a lane needs those steps and they are
    not compiled.
    """
    rows, is_large = tile.rows, False
    for j in range(rows.shape[1]):
        is_large = is_large or rows[p.angle, j] > PI_SQUARED
    if not is_large:
        return True
    if p.any_angle == 0:
        return False
    for i in range(p.angle + 1):
        for j in range(rows.shape[1]):
            rows[i, j], before[i, j] = before[i, j], rows[i, j]
    call(p.any_angle, Action.STEPS, addresses(p, tile), (s.first, s.end))
    for j in range(rows.shape[1]):
        if not before[p.angle, j] > PI_SQUARED:
            for i in range(p.angle + 1):
                rows[i, j] = before[i, j]
    return True


def perform(tape, program, tile, before, fork, bodies, first_tile, last_tile):
    """Perform a tape on tiles; returns the tile that lacked any-angle steps, or the last.

    ``before`` and ``fork`` are copies of rows, or None if the program has no any-angle steps, or
    the tape no forks: then less is compiled.
    """
    p, time, rows = program[0], tile.time[0], tile.rows
    n = bodies.states.shape[1]
    for number in range(first_tile, last_tile):
        body = number * rows.shape[1]
        count = min(n - body, rows.shape[1])
        for k in range(tape.shape[0]):
            s = tape[k]
            time.begin, time.dt, time.low, time.high = s.begin, s.dt, s.low, s.high
            time.count = s.count
            if s.action == Action.START:
                load(bodies.q0, 0, body, rows, p.io)
                load(bodies.y0, 0, body, rows, p.io + p.coordinates)
                load(bodies.params, 0, body, tile.wide, 0)
            elif s.action == Action.RESTORE:
                load(bodies.states, 0, body, rows, 0)
            if fork is not None:
                if s.action == Action.FORK:
                    copy(rows, fork, p.fork)
                elif s.action == Action.JOIN:
                    copy(fork, rows, p.fork)
            if before is not None:
                if s.action == Action.STEPS:
                    copy(rows, before, p.angle + 1)
            if s.action < Action.FORK or s.action >= Action.JUMP:
                call(p.small_angle, s.action, addresses(p, tile), (s.first, s.end))
            if before is not None:
                if s.action == Action.STEPS and not repeat(p, s, tile, before):
                    return number
            if s.action == Action.SAVE:
                store(rows, p.io, bodies.saves, s.slot, body, count)
        store(rows, 0, bodies.states, 0, body, count)
    return last_tile


@functools.cache
def tile_machine(precision: str, *, any_angle: bool, forks: bool) -> Callable[..., int]:
    """``perform`` for a precision; with any-angle steps, and with forks."""
    real, n = TYPES[precision], types.int64
    rows, wide = types.Array(real, 2, "C"), types.Array(types.float64, 2, "C")
    read, to = (types.Array(real, 3, "A", readonly=x) for x in (True, False))
    params = types.Array(types.float64, 3, "A", readonly=True)
    tape, program, time = (types.Array(from_dtype(x), 1, "C") for x in (RECORD, PROGRAM, TIME))
    tile = types.NamedTuple([rows, wide, time], Tile)
    bodies = types.NamedTuple([read, read, params, to, to], Bodies)
    copies = [rows if there else types.none for there in (any_angle, forks)]
    return machine(perform, n(tape, program, tile, *copies, bodies, n, n))
