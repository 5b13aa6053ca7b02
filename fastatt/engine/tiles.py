"""The tile loop: a block of bodies stays in the first-level cache for many steps.

The scratch array's shape is a constant, so every row's distance is known and LLVM needs no
aliasing check: with packed AVX-512 this ran 5 times as fast as the same loop over an ``(N, K)``
array. A tile always runs its full width (the last body fills it up), so that every body meets the
same compiled code whatever the size of the ensemble.

Exponentials by polynomial hold up to π; a root and a division more make them good at any angle
and the step a third slower. So a block of steps runs with the short form, and again from its
start with the wide one if any body of the tile turned further in one step; the others keep what the
short form gave them, since the compiler may fuse the two differently: a fast neighbour costs time,
never a bit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from fastatt._jit import driver, helper, hook
from fastatt.columns import load, store, unpack
from fastatt.methods.method import step
from fastatt.rates import InertialAxes
from fastatt.representations import OPERATIONS, finish, flip, initial

WIDTH = 64
BLOCK = 64


class Run(NamedTuple):
    """What one call of the driver does: steps [first, last) of a run.

    Saves are every ``save_every`` steps and at the end, the first in slot ``slot`` of the output:
    1 where slot 0 holds the initial state, else 0.
    """

    t0: float
    h: float
    first: int
    last: int
    n_steps: int
    save_every: int
    slot: int


def short(rep: Any) -> Any:
    """Tag of the twin for turns of at most π, or the tag itself."""
    cls = OPERATIONS[type(rep)].short
    return rep if cls is None else cls()


def oriented(model: Any, rep: Any, x: Any) -> Any:
    """The state or, for rates along inertial axes, that of the inverse attitude."""
    raise NotImplementedError


@hook(oriented)
def _oriented(model: types.BaseNamedTuple, rep: types.Type, x: types.Type) -> Any:
    if model.instance_class is InertialAxes:
        return lambda model, rep, x: flip(rep, x)
    return lambda model, rep, x: x


def clock(params: Any, t: Any, like: Any) -> Any:
    """Time for the rates: float64 where they are shared, the state's type where they are not."""
    raise NotImplementedError


@hook(clock)
def _clock(params: types.Array, t: types.Type, like: types.Type) -> Any:
    if params.ndim == 1:
        return lambda params, t, like: t
    return lambda params, t, like: type(like)(t)


def shared_parameters(params: Any, shape: Any) -> Any:
    """The parameters that all bodies share, or an empty tuple."""
    raise NotImplementedError


@hook(shared_parameters)
def _shared_parameters(params: types.Array, shape: types.BaseTuple) -> Any:
    if params.ndim == 1:
        return lambda params, shape: unpack(params, shape)
    return lambda params, shape: ()


def parameters(params: Any, shape: Any, shared: Any, rows: Any, top: Any, j: Any) -> Any:
    """The parameters of lane j: the shared ones, or those in the rows below the state."""
    raise NotImplementedError


@hook(parameters)
def _parameters(
    params: types.Array,
    shape: types.BaseTuple,
    shared: types.Type,
    rows: types.Type,
    top: types.Type,
    j: types.Type,
) -> Any:
    if params.ndim == 1:
        return lambda params, shape, shared, rows, top, j: shared
    return lambda params, shape, shared, rows, top, j: load(rows, top + 1, j, shape)


def load_parameters(params: Any, rows: Any, top: Any, start: Any) -> None:
    """Fill the rows below the state with the bodies' own parameters."""
    raise NotImplementedError


@hook(load_parameters)
def _load_parameters(
    params: types.Array, rows: types.Type, top: types.Type, start: types.Type
) -> Any:
    if params.ndim == 1:
        return lambda params, rows, top, start: None

    def impl(params, rows, top, start):
        last = params.shape[0] - 1
        for j in range(WIDTH):
            for i in range(params.shape[1]):
                rows[top + 1 + i, j] = params[min(start + j, last), i]

    return impl


def scratch(rep: Any, shape: Any, params: Any, x: Any) -> Any:
    """Empty tiles: the state with all that a step touches, a copy of it, what is handed out.

    Below the state lie the squared turns, below those the parameters. One array for all that a
    step touches: between two, LLVM would need an aliasing check a pair of rows, and gives up at 19
    rows.
    """
    raise NotImplementedError


@hook(scratch)
def _scratch(
    rep: types.BaseNamedTuple, shape: types.BaseTuple, params: types.Array, x: types.Array
) -> Any:
    size = OPERATIONS[rep.instance_class].size
    all_rows = size + 1 + (len(shape) if params.ndim == 2 else 0)
    stored = OPERATIONS[rep.instance_class].stored + 1

    def impl(rep, shape, params, x):
        return (
            np.empty((all_rows, WIDTH), dtype=x.dtype),
            np.empty((size + 1, WIDTH), dtype=x.dtype),
            np.empty((stored, WIDTH), dtype=x.dtype),
        )

    return impl


def state(rep: Any, rows: Any, j: Any) -> Any:
    """The state of lane j as a tuple."""
    raise NotImplementedError


@hook(state)
def _state(rep: types.BaseNamedTuple, rows: types.Type, j: types.Type) -> Any:
    n = (0.0,) * OPERATIONS[rep.instance_class].size
    return lambda rep, rows, j: load(rows, 0, j, n)


def height(rep: Any) -> Any:
    """Number of rows of the state, known when compiling."""
    raise NotImplementedError


@hook(height)
def _height(rep: types.BaseNamedTuple) -> Any:
    n = OPERATIONS[rep.instance_class].size
    return lambda rep: n


@helper
def advance(method, rep, model, rows, shape, params, shared, run, h, first, last):
    """Run steps [first, last) on one tile; true if any lane turned by more than π in a step."""
    F = type(h)
    top = height(rep)
    for j in range(WIDTH):
        rows[top, j] = F(0.0)
    for n in range(first, last):
        t = clock(params, run.t0 + n * run.h, h)
        for j in range(WIDTH):
            x = state(rep, rows, j)
            p = parameters(params, shape, shared, rows, top, j)
            x, z = step(method, rep, model, t, h, x, p)
            store(rows, 0, j, x)
            rows[top, j] = z if z > rows[top, j] else rows[top, j]
    far = False
    for j in range(WIDTH):
        far |= rows[top, j] > F(math.pi * math.pi)
    return far


@helper
def copy(source, target):
    """The rows of the state; a slice assignment would compile 2.7 s of shape messages."""
    for i in range(min(source.shape[0], target.shape[0])):
        for j in range(WIDTH):
            target[i, j] = source[i, j]


@helper
def swap(a, b):
    """Exchange the states of two tiles, and the squared turns below them."""
    for i in range(b.shape[0]):
        for j in range(WIDTH):
            a[i, j], b[i, j] = b[i, j], a[i, j]


@helper
def take_slow(source, target, top):
    """Take back the lanes that turned by no more than π a step."""
    for j in range(WIDTH):
        if not source[top, j] > math.pi * math.pi:
            for i in range(top + 1):
                target[i, j] = source[i, j]


@helper
def begin(model, rep, rows, q0, start):
    """Load the initial attitudes of a tile."""
    last = q0.shape[0] - 1
    for j in range(WIDTH):
        store(rows, 0, j, oriented(model, rep, initial(rep, q0, min(start + j, last))))


@helper
def resume(rows, x, start):
    """Load the states that an earlier call left."""
    last = x.shape[0] - 1
    for j in range(WIDTH):
        for i in range(x.shape[1]):
            rows[i, j] = x[min(start + j, last), i]


@helper
def save(model, rep, rows, done, out, defect, start, width):
    """Hand out the attitudes of a tile, brought back to the group."""
    top = done.shape[0] - 1
    for j in range(WIDTH):
        y, d = finish(rep, oriented(model, rep, state(rep, rows, j)))
        store(done, 0, j, y)
        done[top, j] = d
    for j in range(width):
        for i in range(top):
            out[start + j, i] = done[i, j]
        defect[start + j] = done[top, j]


def run_tiles(
    method, rep, near, model, shape, params, q0, x, h, run, out, defect, turn, tile_first, tile_last
):
    """Run steps [run.first, run.last) of the tiles [tile_first, tile_last).

    Starts from ``q0`` or, where run.first > 0, from ``x (N, K)``, in which the states are left;
    saves to ``out (S, N, K')`` and ``defect (S, N)``; ``turn (N,)`` grows to the largest squared
    angle of a step. ``near`` is ``short(rep)``.
    """
    rows, kept, done = scratch(rep, shape, params, x)
    size = height(rep)
    shared = shared_parameters(params, shape)
    for tile in range(tile_first, tile_last):
        start = tile * WIDTH
        width = min(WIDTH, x.shape[0] - start)
        load_parameters(params, rows, size, start)
        if run.first == 0:
            begin(model, rep, rows, q0, start)
            if run.slot == 1 or run.n_steps == 0:
                save(model, rep, rows, done, out[0], defect[0], start, width)
        else:
            resume(rows, x, start)
        n = run.first
        while n < run.last:
            stop = min(n + BLOCK, run.last, (n // run.save_every + 1) * run.save_every)
            copy(rows, kept)
            if advance(method, near, model, rows, shape, params, shared, run, h, n, stop):
                swap(rows, kept)
                advance(method, rep, model, rows, shape, params, shared, run, h, n, stop)
                take_slow(kept, rows, size)
            for j in range(width):
                turn[start + j] = max(turn[start + j], rows[size, j])
            n = stop
            if n % run.save_every == 0 or n == run.n_steps:
                slot = (n - 1) // run.save_every + run.slot
                save(model, rep, rows, done, out[slot], defect[slot], start, width)
        for j in range(width):
            for i in range(size):
                x[start + j, i] = rows[i, j]


cached_run_tiles = driver(run_tiles)
uncached_run_tiles = driver(run_tiles, cache=False)
