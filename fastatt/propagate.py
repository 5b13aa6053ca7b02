"""The library call: an ensemble through a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.engine import pool, tiles
from fastatt.methods import METHODS, Method
from fastatt.representations import OPERATIONS, REPRESENTATIONS, Direction
from fastatt.scene import Scene
from fastatt.trajectory import INVARIANT_BOUND, Status, Trajectory

_DEFAULT_METHOD = {"rate": "magnus4"}
# these take any coordinates, so they carry the default where no exponential turns the state
_COORDINATES = ("euler313", "rotation_vector")


def methods_for(scene: Scene, representation: str | None = None) -> list[str]:
    """Names of the methods that fit a scene and a representation."""
    return [
        m.name
        for m in METHODS.values()
        if scene.kind in m.scenes and representation in (None, *m.representations)
    ]


def propagate(
    scene: Scene,
    q0: ArrayLike,
    *,
    dt: float,
    n_steps: int,
    method: str | None = None,
    representation: str = "quat",
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    progress: bool = False,
    t0: float = 0.0,
) -> Trajectory:
    """Propagate one attitude or an ensemble with a fixed step.

    Parameters
    ----------
    scene : what acts; a rate scene needs no initial rate.
    q0 : (4,) or (N, 4), initial attitudes, body to inertial, scalar first, of any length but zero.
    dt : step, s; negative runs backwards.
    n_steps : number of steps, at least 0.
    method : a name of ``fastatt.METHODS``; None takes "magnus4" ("rk4" on coordinates).
    representation : "quat", "dcm", "dcm_rows", "euler313" or "rotation_vector".
    save_every : None keeps the final attitudes only; k keeps the initial ones, every k-th step and
        the final ones.
    dtype : float64 or float32; None takes float32 when ``q0`` is a float32 array, else float64.
    n_threads : None takes every processor that this process may use; results do not depend on it.
    progress : show a bar (needs tqdm).
    t0 : time of ``q0``, s.

    Returns
    -------
    Trajectory : times, attitudes and a status for each body.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    checks.choice("representation", representation, REPRESENTATIONS)
    if method is None:
        method = "rk4" if representation in _COORDINATES else _DEFAULT_METHOD[scene.kind]
    record = _method(scene, method, representation)
    start = checks.attitudes("q0", q0)
    return _run(
        scene,
        start,
        record,
        representation,
        REPRESENTATIONS[representation](),
        dt=dt,
        n_steps=n_steps,
        save_every=save_every,
        kind=checks.precision(dtype, q0),
        n_threads=n_threads,
        progress=progress,
        t0=t0,
    )


def propagate_directions(
    scene: Scene,
    v0: ArrayLike,
    *,
    dt: float,
    n_steps: int,
    method: str | None = None,
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Poisson's equation v̇ = v×w: fixed inertial directions seen from the turning body.

    A star, the field of gravity: three numbers a direction instead of a whole attitude. ``v0`` is
    (3,), (M, 3) for M directions from one body, or (N, M, 3) for M from each of N bodies; any
    length. With ``frame="inertial"`` the vectors are fixed in the body and seen from inertial axes.
    The other arguments are those of :func:`propagate`. Gives the times (S,) and the vectors
    (S, *v0.shape).

    Raises ``ValueError`` or ``TypeError`` as :func:`propagate` does.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    record = _method(scene, method or _DEFAULT_METHOD[scene.kind], "quat")
    v = checks.array("v0", v0, "(3,), (M, 3) or (N, M, 3)", [(3,), (-1, 3), (-1, -1, 3)])
    each = v.shape[1] if v.ndim == 3 else 1
    flat = _run(
        scene,
        v.reshape(-1, 3),
        record,
        "direction",
        Direction(),
        dt=dt,
        n_steps=n_steps,
        save_every=save_every,
        kind=checks.precision(dtype, v0),
        n_threads=n_threads,
        progress=False,
        t0=t0,
        rows_each=each,
    )
    return flat.t, flat.state.reshape((flat.t.size, *v.shape))


def _method(scene: Scene, name: str, representation: str) -> Method:
    checks.choice("method", name, methods_for(scene))
    checks.choice(
        f'method for representation "{representation}"', name, methods_for(scene, representation)
    )
    return METHODS[name]


def _run(
    scene: Scene,
    start: NDArray[Any],
    method: Method,
    representation: str,
    rep: Any,
    *,
    dt: float,
    n_steps: int,
    save_every: int | None,
    kind: np.dtype[Any],
    n_threads: int | None,
    progress: bool,
    t0: float,
    rows_each: int = 1,
) -> Trajectory:
    h = checks.real("dt", dt, zero=False)
    begin = checks.real("t0", t0)
    steps = checks.whole("n_steps", n_steps, 0)
    every = None if save_every is None else checks.whole("save_every", save_every, 1)
    threads = (
        pool.default_threads() if n_threads is None else checks.whole("n_threads", n_threads, 1)
    )

    x0 = np.ascontiguousarray(np.atleast_2d(start), dtype=kind)
    n = x0.shape[0]
    packed = scene.packed(n // rows_each if start.ndim > 1 or rows_each > 1 else 1)
    shared = packed.params.ndim == 1
    params = packed.params if shared else np.repeat(packed.params.astype(kind), rows_each, axis=0)

    saved = [steps] if every is None else [*range(0, steps, every), steps]
    slot = 0 if every is None else 1
    operations = OPERATIONS[type(rep)]
    x = np.empty((n, operations.size), dtype=kind)
    out = np.empty((len(saved), n, operations.stored), dtype=kind)
    defect = np.empty(out.shape[:2], dtype=kind)
    turn = np.zeros(n, dtype=kind)
    run = tiles.Run(begin, h, 0, steps, steps, every or max(steps, 1), slot)
    driver = tiles.cached_run_tiles if packed.cacheable else tiles.uncached_run_tiles
    shape = (0.0,) * params.shape[-1]

    def call(piece: tiles.Run, first: int, last: int) -> None:
        driver(
            method.tag, rep, tiles.short(rep), packed.tag, shape, params, x0, x, kind.type(h),
            piece, out, defect, turn, first, last,
        )  # fmt: skip

    pool.run_ensemble(call, run, n, threads, progress)
    exact = scene.is_constant and method.exact_for_constant
    limit = np.inf if exact else method.limit(representation)
    return Trajectory(
        t=begin + np.array(saved, dtype=np.float64) * h,
        state=out,
        defect=defect,
        status=_status(x, defect, turn, limit, representation),
        method=method.name,
        representation=representation,
        dt=h,
        one_body=start.ndim == 1,
        packed=packed,
    )


def _status(
    x: NDArray[Any], defect: NDArray[Any], turn: NDArray[Any], limit: float, representation: str
) -> NDArray[np.uint8]:
    flags = [(~np.isfinite(x).all(axis=1), Status.NON_FINITE)]
    far = np.sqrt(turn) > limit
    flags.append(
        (far, Status.SINGULAR if representation in _COORDINATES else Status.STEP_TOO_LARGE)
    )
    if representation != "direction":
        flags.append((np.abs(defect).max(axis=0) > INVARIANT_BOUND[x.dtype], Status.INVARIANT))
    status = np.zeros(turn.shape, dtype=np.uint8)
    for found, flag in flags:
        status[found] |= np.uint8(flag)
    return status
