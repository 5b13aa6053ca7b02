"""Free motion in closed form, at any times: no steps, and no error that grows but that of |w| t."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from threading import Event
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt._jit import driver, helper, hook
from fastatt.columns import load, store
from fastatt.engine import pool
from fastatt.engine.tiles import WIDTH
from fastatt.inertia import EQUAL, is_symmetric, principal
from fastatt.kernels import free_body as kernels
from fastatt.kernels import quat

#: what is done with numbers of a body that are not finite
INVALID = ("raise", "flag")
_PIECE = 1 << 20  # attitudes between two looks at Ctrl-C
_STEPS = 1 << 12  # times that share one preparation of their bodies
_SMALL = 1 << 14  # attitudes that are not worth a thread


class FreeBody(NamedTuple):
    """Tag: any three moments."""


class SymmetricTop(NamedTuple):
    """Tag: two equal moments."""


# lengths for ``load``
_THREE = (0.0,) * 3
_FOUR = (0.0,) * 4

# tag: how many constants a body has
_CONSTANTS: dict[type, int] = {FreeBody: 36, SymmetricTop: 14}


def prepare(solution: Any, q: Any, w: Any, inertia: Any) -> Any:
    """The constants of one body's motion."""
    raise NotImplementedError(solution)


@hook(prepare)
def _prepare(solution: types.BaseNamedTuple, q: Any, w: Any, inertia: Any) -> Any:
    if solution.instance_class is SymmetricTop:
        return lambda solution, q, w, inertia: kernels.symmetric_setup(q, w, inertia)
    return lambda solution, q, w, inertia: kernels.setup_rate(q, w, inertia)


def state(solution: Any, constants: Any, inertia: Any, t: Any) -> Any:
    """Attitude and angular velocity at the time t, seven numbers."""
    raise NotImplementedError(solution)


@hook(state)
def _state(solution: types.BaseNamedTuple, constants: Any, inertia: Any, t: Any) -> Any:
    def top(solution: Any, constants: Any, inertia: Any, t: Any) -> Any:
        q, w = kernels.symmetric_evaluate(constants, t)
        return (*q, *w)

    def body(solution: Any, constants: Any, inertia: Any, t: Any) -> Any:
        q, m = kernels.evaluate(constants, t)
        return (*q, m[0] / inertia[0], m[1] / inertia[1], m[2] / inertia[2])

    return top if solution.instance_class is SymmetricTop else body


def scratch(solution: Any, like: Any) -> Any:
    """An empty tile of the precision of ``like``."""
    raise NotImplementedError(solution)


@hook(scratch)
def _scratch(solution: types.BaseNamedTuple, like: types.Array) -> Any:
    rows = _CONSTANTS[solution.instance_class] + 15
    return lambda solution, like: np.empty((rows, WIDTH), dtype=like.dtype)


def constants(solution: Any, rows: Any, j: Any) -> Any:
    """The constants of lane j as a tuple."""
    raise NotImplementedError(solution)


@hook(constants)
def _constants(solution: types.BaseNamedTuple, rows: types.Type, j: types.Type) -> Any:
    n = (0.0,) * _CONSTANTS[solution.instance_class]
    return lambda solution, rows, j: load(rows, 15, j, n)


@helper
def _fill(rows, place, q0, w0, moments, axes):
    """Load the initial states, the moments and the principal axes of a tile."""
    for j in range(WIDTH):
        b = place[0, j]
        for i in range(4):
            rows[i, j] = q0[b, i]
        for i in range(3):
            rows[4 + i, j] = w0[b, i]
            rows[7 + i, j] = moments[min(b, moments.shape[0] - 1), i]
    if axes.shape[0] > 0:
        for j in range(WIDTH):
            b = place[0, j]
            for i in range(4):
                rows[11 + i, j] = axes[min(b, axes.shape[0] - 1), i]
        for j in range(WIDTH):
            p = load(rows, 11, j, _FOUR)
            store(rows, 0, j, quat.mul(load(rows, 0, j, _FOUR), p))
            store(rows, 4, j, quat.rotate_inverse(p, load(rows, 4, j, _THREE)))


@helper
def _hand_out(rows, place, axes, at, width, q, w):
    """Turn the states of a tile to body axes and write those that are asked for."""
    if axes.shape[0] > 0:
        for j in range(WIDTH):
            p = load(rows, 11, j, _FOUR)
            store(rows, 0, j, quat.mul(load(rows, 0, j, _FOUR), quat.conj(p)))
            store(rows, 4, j, quat.rotate(p, load(rows, 4, j, _THREE)))
    for j in range(width):
        b = place[0, j]
        k = place[1, j] + at
        if k < q.shape[0]:
            for i in range(4):
                q[k, b, i] = rows[i, j]
            for i in range(3):
                w[k, b, i] = rows[4 + i, j]


@driver
def _run(
    solution, q0, w0, moments, axes, t, span, q, w, tile_first, tile_last, step_first, step_last
):
    """Fill q (T, N, 4) and w (T, N, 3) for some lanes, at times [step_first, step_last) of each.

    Lane l is body l mod N at the times from number (l div N) span on: a few bodies at many times
    fill a tile as well as many bodies do. ``axes`` (0 or more, 4) are those of ``Principal``. The
    rows of a tile: state (7), moments (3), time, principal axes (4), constants.
    """
    n = q.shape[1]
    lanes = n * -(-t.size // span)
    rows = scratch(solution, q)
    place = np.empty((2, WIDTH), dtype=np.int64)  # body and number of the first time
    for tile in range(tile_first, tile_last):
        first = tile * WIDTH
        for j in range(WIDTH):
            lane = min(first + j, lanes - 1)
            place[0, j] = lane % n
            place[1, j] = lane // n * span
        _fill(rows, place, q0, w0, moments, axes)
        for j in range(WIDTH):
            x = quat.normalise(load(rows, 0, j, _FOUR))
            g = prepare(solution, x, load(rows, 4, j, _THREE), load(rows, 7, j, _THREE))
            store(rows, 15, j, g)
        for at in range(step_first, step_last):
            for j in range(WIDTH):
                rows[10, j] = t[min(place[1, j] + at, t.size - 1)]
            for j in range(WIDTH):
                g = constants(solution, rows, j)
                store(rows, 0, j, state(solution, g, load(rows, 7, j, _THREE), rows[10, j]))
            _hand_out(rows, place, axes, at, min(WIDTH, lanes - first), q, w)


def free_body(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitude and angular velocity of bodies without torque, at any times, in closed form.

    Errors are at most 1e-15 (1 + |w| t) rad and as much in relation to |w| for principal moments;
    near the separatrix too, where the given numbers are taken as exact.

    Parameters
    ----------
    q0 : (4,) or (N, 4), attitudes at t = 0, body to inertial, scalar first, of any length but zero.
    w0 : (3,) or (N, 3), angular velocities at t = 0, body axes, rad/s.
    inertia : principal moments (3,) or (N, 3) in any order, or tensors (3, 3) or (N, 3, 3), kg·m².
    t : time or times (T,), s, in any order and of either sign.
    allow_unphysical : admit inertia that no body has, of moments above 0.
    dtype : float64 or float32 (errors 1e9 times as large, half the time); None takes float32 when
        ``q0`` and ``w0`` are float32 arrays, else float64.
    n_threads : None takes every processor that this process may use; results do not depend on it.
    invalid : "raise" refuses ``q0`` and ``w0`` that are not finite, and a zero quaternion; "flag"
        gives NaN for such bodies alone.

    Returns
    -------
    q, w : (4,), (3,) of one body at one time, (N, 4), (N, 3) of an ensemble; times come first:
        (T, 4), (T, 3) and (T, N, 4), (T, N, 3).

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    return _at_times(FreeBody(), q0, w0, inertia, t, allow_unphysical, dtype, n_threads, invalid)


def symmetric_top(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Regular precession of bodies with two equal moments: ``free_body`` with two exponentials.

    q(t) = exp(L t/A)∘q0∘exp(e (1/C − 1/A) m·e t) with L in inertial axes, e the axis of symmetry,
    C the moment about it and A the other two, equal to 1e-12 of the largest (their mean counts).
    Arguments and results are those of :func:`free_body`.

    Raises ``ValueError`` where no two moments are equal, and as ``free_body`` does.
    """
    return _at_times(
        SymmetricTop(), q0, w0, inertia, t, allow_unphysical, dtype, n_threads, invalid
    )


def _at_times(
    solution: Any,
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    allow_unphysical: bool,
    dtype: DTypeLike | None,
    n_threads: int | None,
    invalid: str,
) -> tuple[NDArray[Any], NDArray[Any]]:
    kind = checks.precision(dtype, q0, w0)
    flag = checks.choice("invalid", invalid, INVALID) == "flag"
    start = checks.attitudes("q0", q0, flag=flag)
    rates = (checks.array_any if flag else checks.array)(
        "w0", w0, "(3,) or (N, 3)", [(3,), (-1, 3)]
    )
    times = checks.array("t", t, "a number or (T,)", [(), (-1,)])
    threads = (
        pool.default_threads() if n_threads is None else checks.whole("n_threads", n_threads, 1)
    )
    if start.ndim == rates.ndim == 2 and len(start) != len(rates):
        raise ValueError(f"w0: has {len(rates)} rows; accepted: one, or {len(start)} as of q0")
    one_body = start.ndim == rates.ndim == 1
    n = 1 if one_body else max(len(x) for x in (start, rates) if x.ndim == 2)
    body = principal(inertia, None if one_body else n, allow_unphysical=allow_unphysical)
    if one_body and body.moments.ndim == 2:
        one_body, n = False, len(body.moments)
    if (body.moments < 0.0).any():
        raise ValueError(
            f"inertia: found the principal moment {body.moments.min():.6g}; accepted by the closed "
            "form: above 0, though allow_unphysical lets it pass elsewhere"
        )
    if isinstance(solution, SymmetricTop):
        _check_symmetric(body.moments)

    flat = np.require(times.reshape(-1), kind, ["C", "W"])
    q, w = np.empty((flat.size, n, 4), dtype=kind), np.empty((flat.size, n, 3), dtype=kind)
    rows = (
        np.broadcast_to(start, (n, 4)),
        np.broadcast_to(rates, (n, 3)),
        np.atleast_2d(body.moments),
        np.empty((0, 4)) if body.axes is None else np.atleast_2d(body.axes),
    )
    # writable, though only read: a read-only array would be compiled for anew
    given = [np.require(x, kind, ["C", "W"]) for x in rows]
    span = -(-flat.size // max(1, min(flat.size, WIDTH // n)))

    def task(tiles: tuple[int, int], steps: tuple[int, int]) -> Callable[[Event], None]:
        def work(stop: Event) -> None:
            if not stop.is_set():
                _run(solution, *given, flat, span, q, w, *tiles, *steps)

        return work

    n_tiles = -(-(n * -(-flat.size // span)) // WIDTH)
    together = max(1, _PIECE // (WIDTH * min(span, _STEPS)))
    together = max(1, min(together, n_tiles // threads))
    tasks = [
        task((i, min(i + together, n_tiles)), (k, min(k + _STEPS, span)))
        for i, k in product(range(0, n_tiles, together), range(0, span, _STEPS))
    ]
    pool.in_threads(tasks, threads if flat.size * n > _SMALL else 1)
    shape = times.shape if one_body else (*times.shape, n)
    return q.reshape((*shape, 4)), w.reshape((*shape, 3))


def _check_symmetric(moments: NDArray[np.float64]) -> None:
    symmetric = is_symmetric(moments)
    if not symmetric.all():
        b = int(np.argmin(symmetric))
        where = f"[{b}]" if moments.ndim == 2 else ""
        found = ", ".join(f"{x:.6g}" for x in np.atleast_2d(moments)[b])
        raise ValueError(
            f"inertia{where} is ({found}): no two moments are equal to {EQUAL:g} of the largest; "
            "accepted: a symmetric body, or free_body for any other"
        )
