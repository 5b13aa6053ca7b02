"""The library call: an ensemble through a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, exact, limits
from fastatt.arrays import quat_to_dcm
from fastatt.engine import pool, tiles
from fastatt.ensemble import Ensemble
from fastatt.methods import METHODS, Method
from fastatt.models import Packed
from fastatt.motion import carried, handed_out
from fastatt.representations import OPERATIONS, REPRESENTATIONS, Direction, QuatCompensated
from fastatt.scene import Scene, as_scene
from fastatt.self_check import SelfCheck, examine
from fastatt.torques import RATE
from fastatt.trajectory import Status, Trajectory

# in this order, the first that fits the scene and the representation
_DEFAULTS = ("magnus4", "exact", "rk8", "rk4")
# steps between two looks at the norm of a compensated state
_RESTORE = 64
# saves that are kept at a time where all of them are not
_RING = 16


def methods_for(scene: Scene, representation: str | None = None) -> list[str]:
    """Names of the methods that fit a scene and a representation."""
    as_scene(scene)
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
    compensated: bool = False,
    normalise: str | int = "output",
    invalid: str = "raise",
    sink: Callable[[Trajectory], object] | None = None,
    check: int = 0,
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
    compensated : carry what rounding loses of the quaternion and the momentum, so that round-off
        grows with the square root of the number of steps; at 0.5 to 0.9 of the speed. Of
        quaternions, and of methods whose record says ``compensates``.
    normalise : when the state is brought back to its group: "output" (in what is handed out only),
        "never", or every so many steps, besides. The status looks at the departure from the group
        before it is mended. A compensated state is mended every 64 steps unless said otherwise.
    invalid : "raise" refuses initial values that are not finite, and zero quaternions; "flag" runs
        the ensemble and flags those bodies, the others' results being what they are without them.
    sink : with ``save_every``, is handed each 16 saves after the initial ones as a trajectory,
        whose arrays are used again; the result then holds the final states only.
    check : bodies on which the order of the method is looked for besides, by halving the step as
        :func:`fastatt.self_check` does; the trajectory's ``check`` is what was found.

    Returns
    -------
    Trajectory : times, attitudes and a status for each body.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

    Warns
    -----
    StepWarning : steps beyond the method's limits, or too small for the precision.
    OrderWarning : with ``check``, an order below the declared one by more than 0.5.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    checks.choice("representation", representation, REPRESENTATIONS)
    if method is None:
        fitting = methods_for(scene, representation)
        method = next(name for name in _DEFAULTS if name in fitting)
    record = _method(scene, method, representation)
    flag = checks.choice("invalid", invalid, exact.INVALID) == "flag"
    rep = REPRESENTATIONS[representation]()
    if compensated:
        rep = _compensated(record, representation)
    restore = _RESTORE if compensated and normalise == "output" else _restore(normalise)
    start = checks.attitudes("q0", q0, flag=flag)
    carried = _initial(scene, w0, v0, r0, flag)
    rows = {name: len(value) for name, value in carried.items() if value.ndim == 2}
    if start.ndim == 2:
        rows["q0"] = len(start)
    if len(set(rows.values()) - {1}) > 1:
        found = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {found}; accepted: one number of bodies")
    sample = checks.whole("check", check, 0)
    if sample and flag:
        raise ValueError('check: found with invalid "flag"; accepted with "raise"')
    result = _run(
        scene,
        start,
        carried,
        record,
        representation,
        rep,
        dt=dt,
        n_steps=n_steps,
        save_every=save_every,
        kind=checks.precision(dtype, *[x for x in (q0, w0, v0, r0) if x is not None]),
        n_threads=n_threads,
        progress=progress,
        t0=t0,
        restore=restore,
        raw=normalise == "never",
        invalid=invalid,
        sink=sink,
    )
    if not sample:
        return result
    seen = check_order(
        Ensemble.of(scene, q0, w0, v0, r0),
        dt,
        n_steps,
        sample,
        method=method,
        representation=representation,
        dtype=dtype,
        n_threads=n_threads,
        t0=t0,
        compensated=compensated,
        normalise=normalise,
    )
    return replace(result, check=seen)


def check_order(
    ensemble: Ensemble, dt: float, n_steps: int, sample: int, **options: Any
) -> SelfCheck:
    """What the runs of a sample by ``propagate``, with its options, show of their order."""

    def run(some: Ensemble, h: float, n: int) -> Trajectory:
        return propagate(
            some.scene, some.q0, some.w0, v0=some.v0, r0=some.r0, dt=h, n_steps=n, **options
        )

    kind = ensemble.scene.kind
    return examine(
        run,
        ensemble,
        checks.real("dt", dt, zero=False),
        checks.whole("n_steps", n_steps, 1),
        lambda name: METHODS[name].order_of(kind),
        sample=sample,
    )


def _compensated(method: Method, representation: str) -> QuatCompensated:
    if representation != "quat":
        raise ValueError(
            f'compensated: found with representation "{representation}"; accepted with "quat"'
        )
    if not method.compensates:
        able = ", ".join(m.name for m in METHODS.values() if m.compensates)
        raise ValueError(f"compensated: found with method {method.name}; accepted with {able}")
    return QuatCompensated()


def _restore(normalise: str | int) -> int:
    """Steps between two returns to the group, 0 for none."""
    if isinstance(normalise, str):
        checks.choice("normalise", normalise, ("output", "never"))
        return 0
    return checks.whole("normalise", normalise, 1)


def _initial(
    scene: Scene,
    w0: ArrayLike | None,
    v0: ArrayLike | None,
    r0: ArrayLike | None,
    flag: bool,
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
            look = checks.array_any if flag else checks.array
            found[name] = look(name, value, "(3,) or (N, 3)", [(3,), (-1, 3)])
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
    restore: int = 0,
    raw: bool = False,
    invalid: str = "raise",
    sink: Callable[[Trajectory], object] | None = None,
) -> Trajectory:
    h = checks.real("dt", dt, zero=False)
    begin = checks.real("t0", t0)
    steps = checks.whole("n_steps", n_steps, 0)
    every = None if save_every is None else checks.whole("save_every", save_every, 1)
    threads = (
        pool.default_threads() if n_threads is None else checks.whole("n_threads", n_threads, 1)
    )

    _check_sink(sink, every)

    saved = [steps] if every is None else [*range(0, steps, every), steps]
    t = _times(saved, h, begin)
    if method.tag is None:
        at = partial(
            _closed_form, scene, start, carried_0["w0"], representation, kind, threads, begin, h,
            invalid,
        )  # fmt: skip
        if sink is None:
            return at(t)
        for slots in _few(len(saved)):
            sink(at(t[slots]))
        return at(t[-1:])

    one_body = start.ndim == 1 and all(value.ndim == 1 for value in carried_0.values())
    q_rows, w_rows = _rows(start, carried_0, kind)
    n = max(len(q_rows), len(w_rows))
    packed = scene.packed(
        n // rows_each, sorted_axes=method.sorted_axes, position="r0" in carried_0
    )
    params = packed.params
    if params.ndim == 2 or carried_0:  # a rate is the same for all bodies, a torque is not
        with np.errstate(over="ignore"):  # a body whose numbers float32 does not hold is flagged
            params = np.repeat(params.astype(kind), rows_each if params.ndim == 2 else 1, axis=0)

    lost = _not_held(packed.params, kind, rows_each)
    x = np.empty((n, carried(type(rep), packed.tag)), dtype=kind)
    kept = len(saved) if sink is None else min(len(saved), 1 + _RING)
    out = np.empty((kept, n, handed_out(type(rep), packed.tag)), dtype=kind)
    defect = np.empty(out.shape[:2], dtype=kind)
    watch = np.zeros((3, n), dtype=kind)
    limit = limits.turn_limit(scene, method, representation)
    first = limits.first_step(scene, method, carried_0["w0"], h) if "w0" in carried_0 else None
    quiet = _quiet(
        limits.known_turns(
            scene, method, representation, packed, carried_0.get("w0"), first, h,
            max(abs(begin), abs(begin + steps * h)),
        ),
        limits.quiet_up_to(scene, method, limit), watch, rows_each,
    )  # fmt: skip
    run = tiles.Run(
        begin, h, 0, steps, steps, every or max(steps, 1), int(every is not None), restore, raw
    )
    call = _driver_call(
        method, rep, packed, params, q_rows, w_rows, x, h, quiet, out, defect, watch
    )
    damped = limits.decay(scene, h)
    about = (damped, limit, method, h, kind)
    compensated = type(rep) is QuatCompensated
    warned = first is not None and limits.warn(first, *about, compensated=compensated, level=4)
    ends = np.cumsum([OPERATIONS[type(rep)].stored, *[3 for _ in carried_0]])

    def trajectory(t: NDArray[np.float64], slots: slice) -> Trajectory:
        rows = out[slots]
        columns = {name: rows[..., k : k + 3] for name, k in zip(carried_0, ends, strict=False)}
        return Trajectory(
            t=t,
            state=rows[..., : ends[0]],
            defect=defect[slots],
            status=limits.status(x, watch, damped, limit, method, representation) | lost,
            method=method.name,
            representation=representation,
            dt=h,
            one_body=one_body,
            packed=packed,
            carried={name[0]: value for name, value in columns.items()},
        )

    if sink is None:
        pool.run_ensemble(call, run, n, threads, progress)
        result = trajectory(t, slice(None))
    else:
        for slots in _few(len(saved)):
            before = (slots[1] if len(slots) > 1 else 1) - 1
            piece = run._replace(first=saved[before], last=saved[slots[-1]], slot=1 - before)
            pool.run_ensemble(call, piece, n, threads, progress)
            sink(trajectory(t[slots], slice(len(slots))))
        result = trajectory(t[-1:], slice(len(slots) - 1, len(slots)))
    if steps and not warned:
        limits.warn(np.sqrt(watch[0]), *about, compensated=compensated, level=4)
    return result


def _check_sink(sink: Any, every: int | None) -> None:
    if sink is not None and not callable(sink):
        raise TypeError(f"sink: found {checks.brief(sink)}; accepted: a function")
    if sink is not None and every is None:
        raise ValueError("sink: found without save_every; accepted: with it")


def _times(saved: list[int], h: float, begin: float) -> NDArray[np.float64]:
    with np.errstate(over="ignore"):
        t = begin + np.array(saved, dtype=np.float64) * h
    if not np.isfinite(t[-1]):
        raise ValueError(
            f"dt: {saved[-1]} steps of {h} s from {begin} s overflow; accepted: shorter"
        )
    return t


def _driver_call(
    method: Method,
    rep: Any,
    packed: Packed,
    params: NDArray[Any],
    q_rows: NDArray[Any],
    w_rows: NDArray[Any],
    x: NDArray[Any],
    h: float,
    quiet: Any,
    *results: NDArray[Any],
) -> Callable[[tiles.Run, int, int], None]:
    """The compiled loop with all that does not change during a run."""
    driver = tiles.cached_run_tiles if packed.cacheable else tiles.uncached_run_tiles
    shape = (0.0,) * params.shape[-1]
    stages = np.array(method.stages) if method.stages else ()
    edge = 0.5 * method.stages[-1][1] * h if method.stages else 0.0
    near = tiles.short(rep) if method.exponentials else rep
    with np.errstate(over="ignore"):
        step = x.dtype.type(h)

    def call(piece: tiles.Run, first: int, last: int) -> None:
        driver(
            method.tag, rep, near, packed.tag, shape, params, q_rows, w_rows, x,
            step, stages, edge, quiet, piece, *results, first, last,
        )  # fmt: skip

    return call


def _not_held(params: NDArray[np.float64], kind: np.dtype[Any], rows_each: int) -> NDArray[Any]:
    """Flags of the bodies with parameters beyond the precision's range: one for all, or (N,)."""
    beyond = (np.abs(params) > np.finfo(kind).max).any(axis=-1)
    flags = np.where(beyond, np.uint8(Status.NON_FINITE), np.uint8(0))
    return np.repeat(flags, rows_each) if flags.ndim else flags


def _quiet(
    turns: NDArray[np.float64] | None, most: float, watch: NDArray[Any], rows_each: int
) -> Any:
    """Which bodies' turns are known to need no look, (N,), and these into ``watch``; () if none."""
    if turns is None:
        return ()
    each = np.repeat(turns, rows_each) if turns.size > 1 and rows_each > 1 else turns
    quiet = np.broadcast_to(each <= most, watch.shape[1])
    np.square(each, where=quiet, out=watch[0], casting="same_kind")
    return np.array(quiet)


def _rows(
    start: NDArray[Any], carried_0: dict[str, NDArray[Any]], kind: np.dtype[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitudes (N or 1, 4), and what is carried beside them side by side (N or 1, 0 or more)."""
    beside = [np.atleast_2d(value) for value in carried_0.values()]
    most = max(map(len, beside), default=1)
    columns = [np.zeros((most, 0)), *(np.broadcast_to(value, (most, 3)) for value in beside)]
    with np.errstate(over="ignore"):
        return (
            # writable, though only read: a read-only array would be compiled for anew
            np.require(np.atleast_2d(start), kind, ["C", "W"]),
            np.ascontiguousarray(np.hstack(columns), dtype=kind),
        )


def _few(saves: int) -> list[list[int]]:
    """The initial save with each few that follow it."""
    return [
        [0, *range(first, min(first + _RING, saves))] for first in range(1, max(saves, 2), _RING)
    ]


def _closed_form(
    scene: Scene,
    start: NDArray[Any],
    w0: NDArray[Any],
    representation: str,
    kind: np.dtype[Any],
    threads: int,
    begin: float,
    h: float,
    invalid: str,
    t: NDArray[np.float64],
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
        invalid=invalid,
    )
    one_body = q.ndim == 2
    q, w = (x[:, None] if one_body else x for x in (q, w))
    state = q if representation == "quat" else quat_to_dcm(q).reshape(*q.shape[:2], 9)
    with np.errstate(invalid="ignore"):
        bad = np.isnan((q @ np.zeros(4, dtype=kind) + w @ np.zeros(3, dtype=kind)).sum(axis=0))
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
