"""The library call: an ensemble through a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, exact
from fastatt.arrays import quat_to_dcm
from fastatt.engine import pool, tiles
from fastatt.methods import METHODS, Method
from fastatt.motion import carried, handed_out
from fastatt.representations import OPERATIONS, REPRESENTATIONS, Direction
from fastatt.scene import Scene
from fastatt.torques import RATE
from fastatt.trajectory import INVARIANT_BOUND, Status, Trajectory

# in this order, the first that fits the scene and the representation
_DEFAULTS = ("magnus4", "exact", "rk8", "rk4")
# coordinates with singularities
_COORDINATES = ("euler313", "rotation_vector")


def methods_for(scene: Scene, representation: str | None = None) -> list[str]:
    """Names of the methods that fit a scene and a representation."""
    return [
        m.name
        for m in METHODS.values()
        if scene.kind in m.scenes
        and representation in (None, *m.representations)
        and (scene.kind != "torqued" or _takes(m, scene))
        and (m.translates or not scene.moves)
    ]


def _takes(method: Method, scene: Scene) -> bool:
    if method.takes == RATE:
        return True
    return scene.dependence(sorted_axes=method.sorted_axes) <= method.takes


def propagate(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
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
    scene : what acts.
    q0 : (4,) or (N, 4), initial attitudes, body to inertial, scalar first, of any length but zero.
    w0 : (3,) or (N, 3), initial angular velocities along body axes, rad/s; a rate scene takes none.
    v0, r0 : (3,) or (N, 3), of a scene with mass: initial velocities along body axes, m/s, and
        positions along inertial axes, m, which are carried if given.
    dt : step, s; negative runs backwards.
    n_steps : number of steps, at least 0.
    method : a name of ``fastatt.METHODS``; None takes the first of magnus4, exact, rk8 and rk4 that
        fits the scene and the representation; the trajectory names it.
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
        fitting = methods_for(scene, representation)
        method = next(name for name in _DEFAULTS if name in fitting)
    record = _method(scene, method, representation)
    start = checks.attitudes("q0", q0)
    carried = _initial(scene, w0, v0, r0)
    rows = {name: len(value) for name, value in carried.items() if value.ndim == 2}
    if start.ndim == 2:
        rows["q0"] = len(start)
    if len(set(rows.values()) - {1}) > 1:
        found = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {found}; accepted: one number of bodies")
    return _run(
        scene,
        start,
        carried,
        record,
        representation,
        REPRESENTATIONS[representation](),
        dt=dt,
        n_steps=n_steps,
        save_every=save_every,
        kind=checks.precision(dtype, *[x for x in (q0, w0, v0, r0) if x is not None]),
        n_threads=n_threads,
        progress=progress,
        t0=t0,
    )


def _initial(
    scene: Scene, w0: ArrayLike | None, v0: ArrayLike | None, r0: ArrayLike | None
) -> dict[str, NDArray[Any]]:
    """What is carried beside the attitude, in the order of the state."""
    has_inertia = scene.kind != "rate"
    found = {}
    for name, value, wanted, needed, unit in (
        ("w0", w0, has_inertia, True, "with inertia needs (3,) or (N, 3), rad/s"),
        ("v0", v0, scene.moves, True, "with mass needs (3,) or (N, 3), m/s"),
        ("r0", r0, scene.moves, False, "with mass takes (3,) or (N, 3), m"),
    ):
        if value is not None and not wanted:
            raise ValueError(f"{name}: found, but this scene has none; a scene {unit}")
        if value is None and wanted and needed:
            raise ValueError(f"{name}: is missing; a scene {unit}")
        if value is not None:
            found[name] = checks.array(name, value, "(3,) or (N, 3)", [(3,), (-1, 3)])
    return found


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
    if scene.kind != "rate" or scene.moves:
        raise ValueError("scene: found inertia or mass; accepted: a scene with a rate alone")
    record = _method(scene, method or _DEFAULTS[0], "quat")
    v = checks.array("v0", v0, "(3,), (M, 3) or (N, M, 3)", [(3,), (-1, 3), (-1, -1, 3)])
    each = v.shape[1] if v.ndim == 3 else 1
    flat = _run(
        scene,
        v.reshape(-1, 3),
        {},
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
    carried_0: dict[str, NDArray[Any]],
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

    saved = [steps] if every is None else [*range(0, steps, every), steps]
    t = begin + np.array(saved, dtype=np.float64) * h
    if method.tag is None:
        return _closed_form(
            scene, start, carried_0["w0"], representation, kind, threads, t, begin, h
        )

    one_body = start.ndim == 1 and all(value.ndim == 1 for value in carried_0.values())
    q_rows = np.ascontiguousarray(np.atleast_2d(start), dtype=kind)
    beside = [np.atleast_2d(value) for value in carried_0.values()]
    n = max(len(q_rows), *map(len, beside), 1)
    w_rows = np.zeros((1, 0))
    if beside:
        most = max(map(len, beside))
        w_rows = np.hstack([np.broadcast_to(value, (most, 3)) for value in beside])
    w_rows = np.ascontiguousarray(w_rows, dtype=kind)
    packed = scene.packed(
        n // rows_each, sorted_axes=method.sorted_axes, position="r0" in carried_0
    )
    params = packed.params
    if params.ndim == 2:
        params = np.repeat(params.astype(kind), rows_each, axis=0)
    elif beside:  # a rate is the same for all bodies, a torque is not
        params = params.astype(kind)

    slot = 0 if every is None else 1
    x = np.empty((n, carried(type(rep), packed.tag)), dtype=kind)
    out = np.empty((len(saved), n, handed_out(type(rep), packed.tag)), dtype=kind)
    defect = np.empty(out.shape[:2], dtype=kind)
    turn = np.zeros(n, dtype=kind)
    run = tiles.Run(begin, h, 0, steps, steps, every or max(steps, 1), slot)
    driver = tiles.cached_run_tiles if packed.cacheable else tiles.uncached_run_tiles
    shape = (0.0,) * params.shape[-1]
    stages = np.array(method.stages) if method.stages else ()
    edge = 0.5 * method.stages[-1][1] * h if method.stages else 0.0

    near = tiles.short(rep) if method.exponentials else rep

    def call(piece: tiles.Run, first: int, last: int) -> None:
        driver(
            method.tag, rep, near, packed.tag, shape, params, q_rows, w_rows, x,
            kind.type(h), stages, edge, piece, out, defect, turn, first, last,
        )  # fmt: skip

    pool.run_ensemble(call, run, n, threads, progress)
    unlimited = scene.is_constant and method.exact_for_constant
    # Euler's equations turn the momentum at up to |w|, as a matrix turns
    frame = "dcm" if scene.kind != "rate" and representation == "quat" else representation
    limit = np.inf if unlimited else method.limit(frame)
    ends = np.cumsum([OPERATIONS[type(rep)].stored, *[3 for _ in carried_0]])
    columns = {name: out[..., k : k + 3] for name, k in zip(carried_0, ends, strict=False)}
    return Trajectory(
        t=t,
        state=out[..., : ends[0]],
        defect=defect,
        status=_status(x, defect, turn, limit, representation),
        method=method.name,
        representation=representation,
        dt=h,
        one_body=one_body,
        packed=packed,
        carried={name[0]: value for name, value in columns.items()},
    )


def _closed_form(
    scene: Scene,
    start: NDArray[Any],
    w0: NDArray[Any],
    representation: str,
    kind: np.dtype[Any],
    threads: int,
    t: NDArray[np.float64],
    begin: float,
    h: float,
) -> Trajectory:
    n = max(len(x) if x.ndim == 2 else 1 for x in (start, w0))
    packed = scene.packed(n)
    q, w = exact.free_body(
        start,
        w0,
        np.asarray(scene.inertia),
        t - begin,
        allow_unphysical=scene.allow_unphysical,
        dtype=kind,
        n_threads=threads,
    )
    one_body = q.ndim == 2
    q, w = (x[:, None] if one_body else x for x in (q, w))
    state = q if representation == "quat" else quat_to_dcm(q).reshape(*q.shape[:2], 9)
    with np.errstate(invalid="ignore"):
        bad = np.isnan((q @ np.zeros(4, dtype=kind)).sum(axis=0))
    return Trajectory(
        t=t,
        state=state,
        defect=np.zeros(q.shape[:2], dtype=kind),
        status=np.where(bad, np.uint8(Status.NON_FINITE), np.uint8(0)),
        method="exact",
        representation=representation,
        dt=h,
        one_body=one_body,
        packed=packed,
        carried={"w": w},
    )


def _status(
    x: NDArray[Any], defect: NDArray[Any], turn: NDArray[Any], limit: float, representation: str
) -> NDArray[np.uint8]:
    # 0 times infinity is NaN; a matrix product is 8 times as fast as a reduction of short rows
    with np.errstate(invalid="ignore"):
        bad = np.isnan(x @ np.zeros(x.shape[1], dtype=x.dtype))
    flags = [(bad, Status.NON_FINITE)]
    far = (np.sqrt(turn) > limit) & np.isfinite(turn)
    flags.append((np.isinf(turn) & ~bad, Status.NOT_CONVERGED))
    flags.append(
        (far, Status.SINGULAR if representation in _COORDINATES else Status.STEP_TOO_LARGE)
    )
    if representation != "direction":
        flags.append((np.abs(defect).max(axis=0) > INVARIANT_BOUND[x.dtype], Status.INVARIANT))
    status = np.zeros(turn.shape, dtype=np.uint8)
    for found, flag in flags:
        status[found] |= np.uint8(flag)
    return status
