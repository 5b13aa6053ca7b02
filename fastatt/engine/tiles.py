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

Looking at every turn costs the cheapest steps 3 to 9 %. Bodies whose turns are known beforehand to
be within the method's limit are stepped without it (``quiet``). Of other rates that are given, one
step of six or seven is looked at, and the length of a quaternion at the end of the block: beyond π
the short exponential is not of unit length, and what it spoilt is run again.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types

from fastatt._jit import driver, helper, hook
from fastatt.columns import load, store, unpack
from fastatt.engine.memory import maximum
from fastatt.kernels.quat import dot
from fastatt.methods.method import enter, extras, is_staged, leave, prepare, seen_at_times
from fastatt.motion import carried, hand_out, handed_out, invariants, restored, start
from fastatt.representations import OPERATIONS
from fastatt.translation import full_step

WIDTH = 64
# what is done once a block took 3 % of the cheapest step with 64 steps, takes 1 % with 256
BLOCK = 256
# φ⁴ steps from one look to the next: pulses of any period meet one before long
PACE = 6.854101966249685
# ulps a step by which |q|² may change unsuspected: good exponentials bring 2.7 at most
ROUNDING = 4.0


class Run(NamedTuple):
    """What one call of the driver does: steps [first, last) of a run.

    Saves are every ``save_every`` steps and at the end, the first in slot ``slot`` of the output:
    1 where slot 0 holds the initial state, else 0. The state is brought back to its group every
    ``restore`` steps, or never if that is 0; ``raw`` hands it out as it is.
    """

    t0: float
    h: float
    first: int
    last: int
    n_steps: int
    save_every: int
    slot: int
    restore: int = 0
    raw: bool = False


class Watched(NamedTuple):
    """Tag of steps whose turns are looked at."""


class AtTimes(NamedTuple):
    """Tag of steps of which some are looked at, and the last; of few, all."""


class Unwatched(NamedTuple):
    """Tag of steps whose turns are known to be within the limit."""


def note(look: Any, rows: Any, top: Any, j: Any, z: Any) -> None:
    """Keep the largest squared turn of lane j."""
    raise NotImplementedError(look)


@hook(note)
def _note(
    look: types.BaseNamedTuple, rows: types.Type, top: types.Type, j: types.Type, z: types.Type
) -> Any:
    if look.instance_class is Unwatched:
        return lambda look, rows, top, j, z: None

    def impl(look, rows, top, j, z):
        rows[top, j] = maximum(rows[top, j], z)

    return impl


def short(rep: Any) -> Any:
    """Tag of the twin for turns of at most π, or the tag itself."""
    cls = OPERATIONS[type(rep)].short
    return rep if cls is None else cls()


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


def extras_of(method: Any, params: Any, shape: Any, rows: Any, top: Any, j: Any) -> Any:
    """What the method prepared for lane j, in the rows below the parameters."""
    raise NotImplementedError


@hook(extras_of)
def _extras_of(
    method: types.BaseNamedTuple,
    params: types.Array,
    shape: types.BaseTuple,
    rows: types.Type,
    top: types.Type,
    j: types.Type,
) -> Any:
    n = (0.0,) * extras(method.instance_class)
    below = 1 + (len(shape) if params.ndim == 2 else 0)
    return lambda method, params, shape, rows, top, j: load(rows, top + below, j, n)


def store_extras(method: Any, params: Any, shape: Any, rows: Any, top: Any, j: Any, e: Any) -> None:
    """Put what the method prepared for lane j in the rows below the parameters."""
    raise NotImplementedError


@hook(store_extras)
def _store_extras(
    method: types.Type,
    params: types.Array,
    shape: types.BaseTuple,
    rows: types.Type,
    top: types.Type,
    j: types.Type,
    e: types.Type,
) -> Any:
    below = 1 + (len(shape) if params.ndim == 2 else 0)
    return lambda method, params, shape, rows, top, j, e: store(rows, top + below, j, e)


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


def scratch(method: Any, rep: Any, model: Any, shape: Any, params: Any, x: Any) -> Any:
    """Empty tiles: the state with all that a step touches, a copy of it, what is handed out.

    Below the state lie the squared turns, the parameters, what the method prepared, and |q|² at the
    start of a block. One array for all that is touched: between two, LLVM would need an aliasing
    check a pair of rows, and gives up at 19 rows.
    """
    raise NotImplementedError


@hook(scratch)
def _scratch(
    method: types.BaseNamedTuple,
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    shape: types.BaseTuple,
    params: types.Array,
    x: types.Array,
) -> Any:
    size = carried(rep.instance_class, model)
    own = len(shape) if params.ndim == 2 else 0
    all_rows = size + 1 + own + extras(method.instance_class) + 1
    out = handed_out(rep.instance_class, model) + 2

    def impl(method, rep, model, shape, params, x):
        return (
            np.empty((all_rows, WIDTH), dtype=x.dtype),
            np.empty((size + 1, WIDTH), dtype=x.dtype),
            np.empty((out, WIDTH), dtype=x.dtype),
        )

    return impl


def state(rep: Any, model: Any, rows: Any, j: Any) -> Any:
    """The state of lane j as a tuple."""
    raise NotImplementedError


@hook(state)
def _state(
    rep: types.BaseNamedTuple, model: types.BaseNamedTuple, rows: types.Type, j: types.Type
) -> Any:
    n = (0.0,) * carried(rep.instance_class, model)
    return lambda rep, model, rows, j: load(rows, 0, j, n)


def height(rep: Any, model: Any) -> Any:
    """Number of rows of the state, known when compiling."""
    raise NotImplementedError


@hook(height)
def _height(rep: types.BaseNamedTuple, model: types.BaseNamedTuple) -> Any:
    n = carried(rep.instance_class, model)
    return lambda rep, model: n


@helper
def lanes(look, method, rep, model, rows, shape, params, shared, t, span, other):
    """One stage of every lane."""
    top = height(rep, model)
    for j in range(WIDTH):
        x = state(rep, model, rows, j)
        p = parameters(params, shape, shared, rows, top, j)
        e = extras_of(method, params, shape, rows, top, j)
        x, z = full_step(method, rep, model, t, span, other, x, p, e)
        store(rows, 0, j, x)
        note(look, rows, top, j, z)


@helper
def is_short(first, last):
    """Whether steps [first, last) are so few that all are looked at."""
    return last - first <= PACE


def steps(
    look: Any, method: Any, rep: Any, model: Any, rows: Any, shape: Any, params: Any, shared: Any,
    run: Any, stages: Any, h: Any, first: Any, last: Any,
) -> None:  # fmt: skip
    """Steps [first, last) of every lane; ``stages`` is empty for a method of one stage.

    A loop over one stage would cost the cheapest methods a third of their speed.
    """
    raise NotImplementedError


@hook(steps)
def _steps(
    look: types.BaseNamedTuple, method: types.BaseNamedTuple, rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple, rows: types.Type, shape: types.Type, params: types.Type,
    shared: types.Type, run: types.Type, stages: types.Type, h: types.Type, first: types.Type,
    last: types.Type,
) -> Any:  # fmt: skip
    every = Watched()
    none = Unwatched()

    def some(look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last):
        # counted from the run's start: a block is a multiple of many periods
        all_seen = is_short(first, last)
        begun = first
        while begun < last:
            seen = begun if all_seen else min(int(PACE * (int((begun + 1) / PACE) + 1)), last) - 1
            for n in range(begun, seen):
                t = clock(params, run.t0 + n * run.h, h)
                lanes(none, method, rep, model, rows, shape, params, shared, t, h, h)
            t = clock(params, run.t0 + seen * run.h, h)
            lanes(every, method, rep, model, rows, shape, params, shared, t, h, h)
            begun = seen + 1

    def whole(look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last):
        for n in range(first, last):
            t = clock(params, run.t0 + n * run.h, h)
            lanes(look, method, rep, model, rows, shape, params, shared, t, h, h)

    def staged(look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last):
        F = type(h)
        for n in range(first, last):
            for i in range(stages.shape[0]):
                t = clock(params, run.t0 + (n + stages[i, 2]) * run.h, h)
                span = F(stages[i, 0] * run.h)
                other = F(stages[i, 1] * run.h)
                lanes(look, method, rep, model, rows, shape, params, shared, t, span, other)

    if isinstance(stages, types.Array):
        return staged
    at_times = look.instance_class is AtTimes and seen_at_times(method.instance_class, rep, model)
    return some if at_times else whole


@helper
def advance(look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last):
    """Run steps [first, last) on one tile."""
    F = type(h)
    top = height(rep, model)
    for j in range(WIDTH):
        rows[top, j] = F(0.0)
    steps(look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last)


def remember(method: Any, rep: Any, model: Any, rows: Any) -> None:
    """|q|² of every lane, in the last row."""
    raise NotImplementedError(method)


@hook(remember)
def _remember(
    method: types.BaseNamedTuple, rep: types.BaseNamedTuple, model: types.BaseNamedTuple,
    rows: types.Array,
) -> Any:  # fmt: skip
    if not seen_at_times(method.instance_class, rep, model):
        return lambda method, rep, model, rows: None

    def impl(method, rep, model, rows):
        for j in range(WIDTH):
            q = state(rep, model, rows, j)
            rows[rows.shape[0] - 1, j] = dot(q, q)

    return impl


def doubt(method: Any, rep: Any, model: Any, rows: Any, n: Any) -> None:
    """Infinity in place of the squared turns of lanes whose |q|² n steps have changed.

    Not where it was no number before: another run would not mend it.
    """
    raise NotImplementedError(method)


@hook(doubt)
def _doubt(
    method: types.BaseNamedTuple, rep: types.BaseNamedTuple, model: types.BaseNamedTuple,
    rows: types.Array, n: types.Type,
) -> Any:  # fmt: skip
    if not seen_at_times(method.instance_class, rep, model):
        return lambda method, rep, model, rows, n: None
    rounding = ROUNDING * float(np.finfo(str(rows.dtype)).eps)

    def impl(method, rep, model, rows, n):
        F = type(rows[0, 0])
        top = height(rep, model)
        bound = F(rounding * n)
        for j in range(WIDTH):
            before = rows[rows.shape[0] - 1, j]
            q = state(rep, model, rows, j)
            after = dot(q, q)
            kept = abs(after - before) <= bound * before or before != before  # noqa: PLR0124
            rows[top, j] = maximum(rows[top, j], F(0.0) if kept else F(math.inf))

    return impl


@helper
def any_far(rows, top):
    """Whether any lane turned by more than π in a step."""
    F = type(rows[top, 0])
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


def all_quiet(quiet: Any, first: Any, last: Any) -> Any:
    """Whether the turns of all bodies from ``first`` on that a tile holds are known."""
    raise NotImplementedError


@hook(all_quiet)
def _all_quiet(quiet: types.Type, first: types.Type, last: types.Type) -> Any:
    if isinstance(quiet, types.BaseTuple):
        return lambda quiet, first, last: False

    def impl(quiet, first, last):
        every = True
        for j in range(WIDTH):
            every &= quiet[min(first + j, last)]
        return every

    return impl


@helper
def mark(rows, top, quiet, first, last):
    """0 in place of the squared turns that are known, infinity in place of the others."""
    F = type(rows[top, 0])
    for j in range(WIDTH):
        rows[top, j] = F(0.0) if quiet[min(first + j, last)] else F(math.inf)


def block(
    method: Any, rep: Any, near: Any, model: Any, rows: Any, kept: Any, shape: Any, params: Any,
    shared: Any, run: Any, stages: Any, h: Any, quiet: Any, calm: Any, body: Any, end: Any,
    first: Any, last: Any,
) -> None:  # fmt: skip
    """Run steps [first, last) on one tile, short and where it must be wide.

    The tile holds the bodies from ``body`` to at most ``end``; ``calm`` says that all are quiet.
    """
    raise NotImplementedError


@hook(block)
def _block(
    method: types.Type, rep: types.BaseNamedTuple, near: types.BaseNamedTuple, model: types.Type,
    rows: types.Type, kept: types.Type, shape: types.Type, params: types.Type, shared: types.Type,
    run: types.Type, stages: types.Type, h: types.Type, quiet: types.Type, calm: types.Type,
    body: types.Type, end: types.Type, first: types.Type, last: types.Type,
) -> Any:  # fmt: skip
    look = Watched()
    at_times = AtTimes()
    no_look = Unwatched()

    def plain(
        method, rep, near, model, rows, kept, shape, params, shared, run, stages, h, quiet, calm,
        body, end, first, last,
    ):  # fmt: skip
        advance(
            at_times, method, rep, model, rows, shape, params, shared, run, stages, h, first, last
        )

    def twice(
        method, rep, near, model, rows, kept, shape, params, shared, run, stages, h, quiet, calm,
        body, end, first, last,
    ):  # fmt: skip
        top = height(rep, model)
        copy(rows, kept)
        if not is_short(first, last):
            remember(method, near, model, rows)
        advance(
            at_times, method, near, model, rows, shape, params, shared, run, stages, h, first, last
        )
        if not is_short(first, last):
            doubt(method, near, model, rows, last - first)
        if any_far(rows, top):
            swap(rows, kept)
            advance(
                look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last
            )
            take_slow(kept, rows, top)

    def known(
        method, rep, near, model, rows, kept, shape, params, shared, run, stages, h, quiet, calm,
        body, end, first, last,
    ):  # fmt: skip
        top = height(rep, model)
        if not calm:
            copy(rows, kept)
        advance(
            no_look, method, near, model, rows, shape, params, shared, run, stages, h, first, last
        )
        if not calm:
            mark(rows, top, quiet, body, end)
            swap(rows, kept)
            advance(
                look, method, rep, model, rows, shape, params, shared, run, stages, h, first, last
            )
            take_slow(kept, rows, top)

    if isinstance(quiet, types.Array):
        return known
    return plain if near.instance_class is rep.instance_class else twice


@helper
def begin(model, rep, rows, shape, params, shared, q0, w0, first, last):
    """Load the initial states of a tile; the last body fills it up."""
    top = height(rep, model)
    for j in range(WIDTH):
        p = parameters(params, shape, shared, rows, top, j)
        store(rows, 0, j, start(rep, model, q0, w0, min(first + j, last), p))


def set_out(
    method: Any, rep: Any, model: Any, rows: Any, shape: Any, params: Any, shared: Any, run: Any,
    edge: Any, h: Any,
) -> None:  # fmt: skip
    """Prepare what the method needs of each lane, and take its state to the one that is stepped."""
    raise NotImplementedError(method)


@hook(set_out)
def _set_out(
    method: types.BaseNamedTuple, rep: types.Type, model: types.Type, rows: types.Type,
    shape: types.Type, params: types.Type, shared: types.Type, run: types.Type, edge: types.Type,
    h: types.Type,
) -> Any:  # fmt: skip
    def nothing(method, rep, model, rows, shape, params, shared, run, edge, h):
        pass

    def impl(method, rep, model, rows, shape, params, shared, run, edge, h):
        F = type(h)
        top = height(rep, model)
        t = clock(params, run.t0, h)
        for j in range(WIDTH):
            x = state(rep, model, rows, j)
            p = parameters(params, shape, shared, rows, top, j)
            e = prepare(method, rep, model, h, x, p)
            store_extras(method, params, shape, rows, top, j, e)
            store(rows, 0, j, enter(method, rep, model, t, F(0.0), F(edge), x, p, e))

    return impl if is_staged(method.instance_class) else nothing


@helper
def resume(rows, x, start):
    """Load the states that an earlier call left."""
    last = x.shape[0] - 1
    for j in range(WIDTH):
        for i in range(x.shape[1]):
            rows[i, j] = x[min(start + j, last), i]


@helper
def save(
    method, model, rep, rows, done, shape, params, shared, q0, w0, first, last, run, n, edge, h
):
    """What is handed out of the states after n steps, and how far they left what they keep."""
    F = type(h)
    top = height(rep, model)
    t = clock(params, run.t0 + n * run.h, h)
    since = F(n * run.h)
    for j in range(WIDTH):
        p = parameters(params, shape, shared, rows, top, j)
        e = extras_of(method, params, shape, rows, top, j)
        x = leave(method, rep, model, t, since, F(edge), state(rep, model, rows, j), p, e)
        y, d = hand_out(rep, model, x, p, run.raw)
        store(done, 0, j, y)
        done[done.shape[0] - 2, j] = d
        x0 = start(rep, model, q0, w0, min(first + j, last), p)
        done[done.shape[0] - 1, j] = departure(
            invariants(rep, model, x0, p), invariants(rep, model, x, p), h
        )


def departure(a: Any, b: Any, like: Any) -> Any:
    """Largest relative change from the invariants a to b, 0 where there are none."""
    raise NotImplementedError


@hook(departure)
def _departure(a: types.BaseTuple, b: types.BaseTuple, like: types.Type) -> Any:
    def none(a, b, like):
        return type(like)(0.0)

    def larger(a, b, like):
        F = type(like)
        one = F(1.0)
        tiny = F(1e-37)
        x = abs(b[0] / (a[0] if a[0] > tiny else one) - (one if a[0] > tiny else F(0.0)))
        y = abs(b[1] / (a[1] if a[1] > tiny else one) - (one if a[1] > tiny else F(0.0)))
        return x if x > y else y

    return larger if len(a) else none


@helper
def worse(a, b):
    """The larger of two numbers, or NaN."""
    return a if a >= b or a != a else b  # noqa: PLR0124


@helper
def put(done, out, defect, watch, first, width):
    """Copy what is handed out to the ensemble's arrays."""
    top = done.shape[0] - 2
    for j in range(width):
        for i in range(top):
            out[first + j, i] = done[i, j]
        defect[first + j] = done[top, j]
        watch[1, first + j] = worse(watch[1, first + j], abs(done[top, j]))
        watch[2, first + j] = worse(watch[2, first + j], done[top + 1, j])


@helper
def mend(rep, model, rows, watch, first, width):
    """Bring the states nearer to their group; how far they had left it is not forgotten."""
    top = height(rep, model)
    for j in range(WIDTH):
        x, d = restored(rep, model, state(rep, model, rows, j))
        store(rows, 0, j, x)
        rows[top, j] = abs(d)
    for j in range(width):
        watch[1, first + j] = worse(watch[1, first + j], rows[top, j])


def run_tiles(
    method, rep, near, model, shape, params, q0, w0, x, h, stages, edge, quiet, run, out, defect,
    watch, tile_first, tile_last,
):  # fmt: skip
    """Run steps [run.first, run.last) of the tiles [tile_first, tile_last).

    Starts from ``q0`` and ``w0`` or, where run.first > 0, from ``x (N, K)``, in which the states
    are left; saves to ``out (S, N, K')`` and ``defect (S, N)``. ``watch (3, N)`` grows to the
    largest squared angle of a step, departure from the group, relative change of an invariant.
    ``near`` is the twin of ``rep`` for turns of at most π; ``stages`` (M, 3) are those of the
    method, or () for one; ``edge`` the s that what is stepped lies ahead; ``quiet`` (N,) which
    bodies' turns are known to be within the limit, or () if nothing is known.
    """
    rows, kept, done = scratch(method, rep, model, shape, params, x)
    size = height(rep, model)
    end = x.shape[0] - 1
    shared = shared_parameters(params, shape)
    for tile in range(tile_first, tile_last):
        first = tile * WIDTH
        width = min(WIDTH, x.shape[0] - first)
        calm = all_quiet(quiet, first, end)
        load_parameters(params, rows, size, first)
        begin(model, rep, rows, shape, params, shared, q0, w0, first, end)
        set_out(method, rep, model, rows, shape, params, shared, run, edge, h)
        if run.first > 0:
            resume(rows, x, first)
        n = run.first
        due = n == 0 and (run.slot == 1 or run.n_steps == 0)
        while True:
            if due:
                slot = (n - 1) // run.save_every + run.slot if n > 0 else 0
                save(
                    method, model, rep, rows, done, shape, params, shared, q0, w0, first, end,
                    run, n, edge, h,
                )  # fmt: skip
                put(done, out[slot], defect[slot], watch, first, width)
            if n == run.last:
                break
            stop = min(n + BLOCK, run.last, (n // run.save_every + 1) * run.save_every)
            if run.restore > 0:
                stop = min(stop, (n // run.restore + 1) * run.restore)
            block(
                method, rep, near, model, rows, kept, shape, params, shared, run, stages, h,
                quiet, calm, first, end, n, stop,
            )  # fmt: skip
            for j in range(width):
                watch[0, first + j] = max(watch[0, first + j], rows[size, j])
            n = stop
            if run.restore > 0 and n % run.restore == 0:
                mend(rep, model, rows, watch, first, width)
            due = n % run.save_every == 0 or n == run.n_steps
        for j in range(width):
            for i in range(size):
                x[first + j, i] = rows[i, j]


cached_run_tiles = driver(run_tiles)
uncached_run_tiles = driver(run_tiles, cache=False)
