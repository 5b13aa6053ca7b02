"""The machine beside an interpreter of its tapes, which is written from the page of its design."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import carray, cfunc, njit, types

from fastatt.engine.machine import PROGRAM, TIME, Tile, tile_machine
from fastatt.engine.tape import RECORD, Action

WIDTH, ROWS, KEPT, IO = 8, 9, 5, 5
#: rows: two of the state, one that is put back too, the largest squared angle, the status
FORKED, ANGLE = 2, 3
BODIES = 19


@njit
def formula(part, rows, wide, numbers, first, last, is_any):
    """Some numbers that depend on all that a formula may read."""
    begin, dt, low, high = numbers[0], numbers[1], numbers[3], numbers[4]
    for j in range(WIDTH):
        x, y = rows[0, j], rows[1, j]
        if part == Action.START:
            rows[0, j], rows[1, j] = rows[IO, j] + wide[0, j], rows[IO + 1, j] - rows[IO + 2, j]
            rows[2, j] = rows[3, j] = rows[4, j] = 0.0
        elif part == Action.STEPS:
            for n in range(first, last):
                t = begin + n * dt
                turned = 2.0 * math.sin(x + t) ** 2 * (1.0 + wide[0, j]) ** 2
                rows[0, j] = 0.7 * x + dt * y + (0.01 if is_any else 0.02) * low
                rows[1, j] = 0.9 * y - dt * x + 0.1 * (numbers[2] + numbers[5] + high)
                rows[2, j] += 1.0
                rows[3, j] = max(rows[3, j], turned)
                x, y = rows[0, j], rows[1, j]
        elif part == Action.SAVE:
            rows[IO, j], rows[IO + 1, j], rows[IO + 2, j] = x + first, y, rows[3, j] + rows[2, j]
        elif part == Action.STATUS:
            rows[4, j] = 1.0 if rows[3, j] > 3.0 else 0.0
        else:
            rows[0, j] = 0.5 * x + 0.125 * part + 0.01 * first + dt
            rows[1, j] = y + begin


def compiled(is_any):
    """The formula as a generated function is called."""
    real, n = types.CPointer(types.float64), types.int64

    @cfunc(types.void(n, real, real, real, types.CPointer(n), n, n))
    def run(part, rows, wide, numbers, whole, first, last):
        shared = carray(numbers, (8,))
        formula(
            part, carray(rows, (ROWS, WIDTH)), carray(wide, (1, WIDTH)), shared, first, last, is_any
        )

    return run


SMALL, ANY = compiled(False), compiled(True)


def random_tape(rng, slots, forks):
    """Actions in any order that has a meaning: copies are put back before the next one."""
    rows, is_copied = [], False
    actions = [*Action, Action.STEPS, Action.STEPS]
    for drop in (Action.START, Action.STATUS, Action.RESTORE):
        actions.remove(drop)
    for action in [Action.START, *rng.choice(actions, 40).tolist(), Action.STATUS]:
        may_copy = forks and not is_copied
        if (action == Action.FORK and not may_copy) or (action == Action.JOIN and not is_copied):
            continue
        is_copied = action == Action.FORK or (is_copied and action != Action.JOIN)
        first = int(rng.integers(0, 4))
        numbers = first, first + int(rng.integers(0, 3)), int(rng.integers(0, slots))
        action += int(rng.integers(0, 3)) if action == Action.JUMP else 0  # of each controller
        rows.append((action, *numbers, *rng.uniform(0.1, 0.5, 5)))
    return np.array(rows, RECORD)


def arrays(rng, slots):
    shapes = ((1, 1, 2), (1, BODIES, 1), (1, BODIES, 1), (1, BODIES, KEPT), (slots, BODIES, 3))
    return [rng.uniform(0.1, 0.9, shape) for shape in shapes]


def interpreted(tape, bodies):
    """What a tape does to each body, one after the other, with the numbers that all share."""
    q0, y0, params, states, saves = bodies
    for body in range(BODIES):
        rows, wide, numbers = np.zeros((ROWS, WIDTH)), np.zeros((1, WIDTH)), np.zeros(8)
        for s in tape:
            action = int(s["action"])
            numbers[[0, 1, 3, 4, 5]] = [s[x] for x in ("begin", "dt", "low", "high", "count")]
            if action == Action.START:
                rows[IO : IO + 2], rows[IO + 2] = q0[0, 0][:, None], y0[0, body]
                wide[0] = params[0, body]
            elif action == Action.RESTORE:
                rows[:KEPT] = states[0, body][:, None]
            elif action == Action.FORK:
                copied = rows[:FORKED].copy()
            elif action == Action.JOIN:
                rows[:FORKED] = copied
            if Action.FORK <= action < Action.JUMP:
                continue
            before = rows.copy()
            formula(action, rows, wide, numbers, s["first"], s["end"], False)
            if action == Action.STEPS and rows[ANGLE, 0] > math.pi**2:
                rows[:] = before
                formula(action, rows, wide, numbers, s["first"], s["end"], True)
            if action == Action.SAVE:
                saves[s["slot"], body] = rows[IO : IO + 3, 0]
        states[0, body] = rows[:KEPT, 0]


@pytest.mark.parametrize("forks", [False, True])
@pytest.mark.parametrize("any_angle", [False, True])
@pytest.mark.parametrize("seed", range(8))
def test_the_machine_does_what_the_tape_says(seed, any_angle, forks):
    """On random tapes, of two pieces, with a tile that is not full."""
    rng = np.random.default_rng(seed)
    slots, tapes = 3, []
    restored = np.array([(Action.RESTORE, *[0] * 8)], RECORD)
    for k in range(2):
        tape = random_tape(rng, slots, forks)
        tapes.append(np.insert(tape, 1, restored) if k else tape)
    bodies = arrays(rng, slots)
    bodies[2] *= 2.0 if any_angle else 0.5  # angles above π in some lanes, or in none
    wanted = [x.copy() for x in bodies]
    program, time = np.zeros(1, PROGRAM), np.zeros(8)
    program["small_angle"], program["any_angle"] = SMALL.address, ANY.address if any_angle else 0
    program["fork"], program["angle"], program["io"], program["coordinates"] = FORKED, ANGLE, IO, 2
    tile = Tile(np.zeros((ROWS, WIDTH)), np.zeros((1, WIDTH)), time[: len(TIME)].view(TIME))
    copies = [np.zeros((KEPT, WIDTH)) if there else None for there in (any_angle, forks)]
    machine, tiles = tile_machine("double", any_angle=any_angle, forks=forks), -(-BODIES // WIDTH)
    for tape in tapes:
        assert machine(tape, program, tile, *copies, tuple(bodies), 0, tiles) == tiles
        interpreted(tape, wanted)
    for found, x in zip(bodies[3:], wanted[3:], strict=True):
        np.testing.assert_array_equal(found, x)
    assert any_angle == (bodies[3][0, :, ANGLE].max() > math.pi**2)
