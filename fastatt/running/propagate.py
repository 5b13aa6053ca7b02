"""The library call: an ensemble through a scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, exact
from fastatt.attitudes import ATTITUDES, COMPENSATED, DIRECTION, QUATERNION, Attitude
from fastatt.methods import METHODS, Method
from fastatt.running import task
from fastatt.running.ensemble import Ensemble
from fastatt.running.self_check import SelfCheck, examine
from fastatt.running.trajectory import Trajectory
from fastatt.scene import Scene, as_scene
from fastatt.threads import number_of, progress_bar
from fastatt.torques import Dependence

# in this order, the first that fits the scene and the representation
_DEFAULTS = ("magnus4", "exact", "rk8", "rk4")
# steps between two looks at the norm of a compensated state
_RESTORE = 64
# body-steps, 2 ms of the slowest, that one thread takes no longer than several do
_SHORT = 65_536


def methods_for(scene: Scene, representation: str | Attitude | None = None) -> list[str]:
    """Names of the methods that fit a scene and a representation, by name or one's own.

    Raises ``TypeError`` for what is no scene, ``ValueError`` for what is no representation.
    """
    as_scene(scene)
    if representation is not None:
        representation = attitude_of(representation)
    return [m.name for m in METHODS.values() if fits(m, scene, representation)]


def default_method(scene: Scene, representation: str | Attitude) -> str:
    """The first of magnus4, exact, rk8 and rk4 that fits, else of all.

    Raises ``ValueError`` where none does.
    """
    fitting = methods_for(scene, representation)
    if not fitting:
        raise ValueError(
            f"representation: found {_name_of(representation)}, for which no method takes this "
            f"scene ({scene.kind}); accepted: {', '.join(ATTITUDES)}"
        )
    return next((name for name in _DEFAULTS if name in fitting), fitting[0])


def fits(method: Method, scene: Scene, representation: str | Attitude | None = None) -> bool:
    """Whether a method takes a scene, in a representation, by name or one's own."""
    if isinstance(representation, Attitude):
        representation = _known_as(representation)
    return (
        scene.kind in method.scenes
        and (representation is None or method.stores(representation))
        and (scene.kind != "torqued" or _takes(method, scene))
        and (method.translates or not scene.moves)
    )


def _takes(method: Method, scene: Scene) -> bool:
    if method.takes is Dependence.RATE:
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
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
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
    looks: bool = True,
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
    method : a name of ``fastatt.METHODS``, or a method of one's own (``fastatt.explicit``,
        ``fastatt.lie``); None takes the first of magnus4, exact, rk8 and rk4 that fits the scene
        and the representation; the trajectory names it.
    representation : "quat", "dcm", "dcm_rows", "euler313" or "rotation_vector", or an
        ``Attitude`` of one's own.
    save_every : None keeps the final attitudes only; k keeps the initial ones, every k-th step and
        the final ones.
    dtype : float64 or float32; None takes float32 when the arrays given are all float32, else
        float64.
    n_threads : None takes every processor that this process may use, for a short run one; results
        do not depend on it.
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
    sink : with ``save_every``, is handed each save once, 16 at a time (17 with the initial one), as
        a trajectory whose arrays are used again; the result then holds the final states only.
    check : bodies on which the order of the method and the largest error over the run are looked
        for besides, by halving the step as :func:`fastatt.self_check` does; the trajectory's
        ``check`` is what was found.
    looks : look at how far each step turns. Without, steps past a method's limit and turns beyond
        π go unseen: for measuring what the looks cost.

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
    attitude = attitude_of(representation)
    record = method_of(scene, method or default_method(scene, attitude), attitude)
    flag = checks.choice("invalid", invalid, exact.INVALID) == "flag"
    if compensated:
        attitude = _compensated(record, attitude)
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
    clock = task.Clock.of(dt, n_steps, save_every, t0)
    kind = checks.precision(dtype, *[x for x in (q0, w0, v0, r0) if x is not None])
    threads = threads_of(n_threads, max(rows.values(), default=1), clock.n_steps)
    # with a sink the engine's runs are many, the bar is one
    with progress_bar(progress and callable(sink), len(clock.saved), "save") as done:
        wanted = task.Task(
            scene,
            task.Choice(record, attitude, restore, normalise == "never", looks),
            clock,
            task.Handling(
                threads,
                progress and sink is None,
                _counted(sink, done) if callable(sink) else sink,
                invalid,
            ),
        )
        result = task.propagated(wanted, start, carried, kind)
    if not sample:
        return result
    seen = check_order(
        Ensemble.of(scene, q0, w0, v0, r0),
        dt,
        n_steps,
        sample,
        method=record,
        representation=representation,
        dtype=dtype,
        n_threads=n_threads,
        t0=t0,
        compensated=compensated,
        normalise=normalise,
    )
    return replace(result, check=seen)


def _counted(
    sink: Callable[[Trajectory], object], done: Callable[[int], object]
) -> Callable[[Trajectory], None]:
    """A sink that tells a bar how many saves it has had."""

    def deliver(piece: Trajectory) -> None:
        sink(piece)
        done(piece.t.size)

    return deliver


def threads_of(n_threads: int | None, n_bodies: int, n_steps: int) -> int:
    """Threads of a run: those asked for; else all, but one where starting more takes longer."""
    if n_threads is None and n_bodies * n_steps < _SHORT:
        return 1
    return number_of(n_threads)


def check_order(
    ensemble: Ensemble, dt: float, n_steps: int, sample: int, at: str = "run", **options: Any
) -> SelfCheck:
    """What the runs of a sample by ``propagate``, with its options, show of their order."""

    def run_with(some: Ensemble, h: float, n: int, every: int) -> Trajectory:
        return propagate(
            some.scene, some.q0, some.w0, v0=some.v0, r0=some.r0, dt=h, n_steps=n,
            save_every=every, **options,
        )  # fmt: skip

    kind = ensemble.scene.kind
    return examine(
        run_with,
        ensemble,
        checks.real("dt", dt, zero=False),
        checks.whole("n_steps", n_steps, 1),
        lambda found: found.order_of(kind),
        sample=sample,
        at=at,
    )


def attitude_of(representation: str | Attitude) -> Attitude:
    """The representation of a name, or one's own."""
    if isinstance(representation, Attitude):
        return representation
    return ATTITUDES[checks.choice("representation", representation, ATTITUDES)]


def _known_as(attitude: Attitude) -> str | Attitude:
    """The name of a representation of the library's; one's own itself."""
    return attitude.name if ATTITUDES.get(attitude.name) is attitude else attitude


def _name_of(representation: str | Attitude) -> str:
    return representation if isinstance(representation, str) else representation.name


def method_of(scene: Scene, method: str | Method, representation: str | Attitude) -> Method:
    """The method of a name, or one's own, that fits a scene in a representation.

    Raises ``ValueError`` for one that does not, with those that do.
    """
    if isinstance(method, Method):
        if fits(method, scene, representation):
            return method
        raise ValueError(
            f"method: found {method.name}, for {', '.join(method.scenes)} in "
            f"{', '.join(method.representations)}; accepted for this scene ({scene.kind}) in "
            f'"{_name_of(representation)}": {", ".join(methods_for(scene, representation))}'
        )
    # anything may come, and a list has no hash
    found = METHODS.get(method) if isinstance(method, str) else None  # type: ignore[redundant-expr]
    if found is not None and fits(found, scene, representation):
        return found
    checks.choice("method", method, methods_for(scene))
    checks.choice(
        f'method for representation "{_name_of(representation)}"',
        method,
        methods_for(scene, representation),
    )
    return METHODS[method]


def _compensated(method: Method, attitude: Attitude) -> Attitude:
    if attitude is not QUATERNION:
        raise ValueError(
            f'compensated: found with representation "{attitude.name}"; accepted with "quat"'
        )
    if not method.compensates:
        able = ", ".join(m.name for m in METHODS.values() if m.compensates)
        raise ValueError(f"compensated: found with method {method.name}; accepted with {able}")
    return COMPENSATED


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
    record = method_of(scene, method or _DEFAULTS[0], "quat")
    v = checks.array("v0", v0, "(3,), (M, 3) or (N, M, 3)", [(3,), (-1, 3), (-1, -1, 3)])
    wanted = task.Task(
        scene,
        task.Choice(record, DIRECTION),
        task.Clock.of(dt, n_steps, save_every, t0),
        task.Handling(number_of(n_threads)),
        rows_each=v.shape[1] if v.ndim == 3 else 1,
    )
    flat = task.propagated(wanted, v.reshape(-1, 3), {}, checks.precision(dtype, v0))
    return flat.t, flat.state.reshape((flat.t.size, *v.shape))
