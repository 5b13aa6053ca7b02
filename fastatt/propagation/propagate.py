"""The library call: an ensemble through a scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.attitudes import DIRECTION, Attitude
from fastatt.methods import METHODS, Method
from fastatt.propagation import closed_form
from fastatt.propagation.choice_of_method import chosen, method_of
from fastatt.propagation.event import Event, events_of
from fastatt.propagation.execute import execute
from fastatt.propagation.histories import ToFile, saving
from fastatt.propagation.initial import Given, initial, same_number
from fastatt.propagation.options import Choice, Clock, PerBodyClock, RunOptions, clock_of
from fastatt.propagation.plan import Plan
from fastatt.propagation.reducer import Reducer
from fastatt.propagation.resume import Checkpoint, end_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of

#: what takes the saves of a run
OnSave = Callable[[Trajectory], object] | ToFile
# body-steps, 2 ms of the slowest, that one thread takes no longer than several do
_SHORT = 65_536
# plans that are kept with a scene, and of how many bodies
_KEPT, _FEW = 16, 1024


def propagate(
    scene: Scene,
    q0: ArrayLike | None = None,
    w0: ArrayLike | None = None,
    *,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    dt: float | ArrayLike,
    n_steps: int | ArrayLike | None = None,
    t_end: float | None = None,
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
    on_save: OnSave | Sequence[OnSave] | None = None,
    reduce: Reducer | None = None,
    resume: Trajectory | str | os.PathLike[str] | Checkpoint | None = None,
    save_at: ArrayLike | None = None,
    device: str | None = None,
    events: Event | Sequence[Event] = (),
) -> Trajectory:
    """Propagate one attitude or an ensemble with a fixed step.

    Parameters
    ----------
    scene : the bodies, with their rates, torques and forces.
    q0 : (4,) or (N, 4), initial attitudes, body to inertial, scalar first, of any length but zero.
    w0 : (3,) or (N, 3), initial angular velocities along body axes, rad/s; a rate scene takes none.
    v0, r0 : (3,) or (N, 3), of a scene with mass: initial velocities along body axes, m/s, and
        positions along inertial axes, m, which are carried if given.
    s0 : (n,) or (N, n), of a scene with n states: their initial values.
    dt : step, s; negative runs backwards. Each body may have its own, (N,).
    n_steps : number of steps, at least 0; with per-body step sizes (N,), so that all end at
        one time, to rounding.
    t_end : duration of the run, s, from ``t0`` on and of the sign of ``dt``, in place of
        ``n_steps``. Where it is no whole number of steps, the last step is shorter.
    method : a name of ``fastatt.METHODS``, or a custom method (``fastatt.runge_kutta``,
        ``fastatt.lie_group``); None takes the first of magnus4, exact, rk8 and rk4 that fits the
        scene and the representation; the trajectory names it.
    representation : a name of ``fastatt.attitudes.ATTITUDES``, such as "quat" or "dcm", or a custom
        ``Attitude``.
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
    normalise : when the state is projected onto its group: "output" (saved values alone), "never",
        or also every so many steps. The status is set by the norm error before a projection. A
        compensated state is projected every 64 steps with "output".
    invalid : "raise" refuses initial values that are not finite, and zero quaternions; "flag" runs
        the ensemble and flags those bodies; the results of others do not depend on them.
    on_save : with ``save_every``, what takes the saves, so that the result holds the final states
        only: a function, which is called with 16 saves at a time (17 with the initial one) as a
        trajectory whose arrays are used again; a file, ``fa.to_file(path)``; or one of each.
    reduce : a user-defined function that sees every step of every body (:func:`fastatt.reducer`);
        the trajectory's ``reduced`` is what it made. With methods whose record says ``reduces``.
    resume : a trajectory of at most 262144 bodies, or a file of ``Trajectory.save_end``, where this
        run goes on, to the bits of one run; initial values, ``t0``, method and
        scene are its own, and saves are counted from there. Or ``fa.checkpoint(path)``: the run
        writes its end so far there every ten seconds, and the same call goes on from it.
    save_at : times within the run, s, in its order, at which states are kept instead: from the last
        step before by one shorter step of the same method.
    device : "cuda" runs on an NVIDIA GPU, through Numba (``pip install 'fastatt[cuda]'``): the same
        steps, without the closed form ``exact``. Initial values may be CuPy's arrays or Numba's
        device arrays; ``q`` of quaternions, ``w``, ``v``, ``r`` and ``s`` then stay there, but of a
        run with ``on_save`` or a checkpoint.
    events : what :func:`fastatt.event` made, a list: the trajectory's ``event_times`` holds the
        first crossing of each body. With methods that step; without per-body step sizes,
        ``save_at``, ``resume`` and ``device``.

    Returns
    -------
    Trajectory : times, attitudes and a status for each body.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

    Warns
    -----
    StepWarning : steps beyond the method's limits, or too small for the precision.

    On Ctrl-C the exception, a ``KeyboardInterrupt``, holds what was done as its ``trajectory``.
    """
    as_scene(scene)
    watched = events_of(events)
    if watched:
        _check_alone("events; accepted: without", resume=resume, device=device, save_at=save_at)
    function, file = saving(on_save)
    checkpoint = resume.path if isinstance(resume, Checkpoint) else None
    gpu = None
    if device is not None:
        from fastatt.device.program import taken

        stays = on_save is None and checkpoint is None
        gpu, (q0, w0, v0, r0, s0) = taken(device, (q0, w0, v0, r0, s0), stays=stays)
    end = None if resume is None or checkpoint is not None else end_of(resume)
    if end is not None:
        method, compensated = method or end.about["method"], end.about["compensated"]
    choice = chosen(scene, method, representation, compensated, normalise, reduce, gpu, watched)
    flag = checks.choice("invalid", invalid, closed_form.INVALID) == "flag"
    begin = checks.real("t0", t0)
    if end is None:
        values = (q0, w0, v0, r0, s0)
        start, carried = initial(scene, values, flag=flag)
        kind = checks.precision(dtype, *values)
        if reduce is not None:
            carried["reduced"] = reduce.begin(kind)
            same_number({**carried, "q0": start})
        given = Given.of(start, carried, kind)
        clock = clock_of(dt, n_steps, t_end, save_every, save_at, begin, given.bodies, scene)
        position = r0 is not None
    else:
        # initial values come from there, and saves are counted from its end
        found = {"q0": q0, "w0": w0, "v0": v0, "r0": r0, "s0": s0, "t0": begin or None}
        _check_alone("resume; accepted: one of them", **found, save_at=save_at)
        _check_alone("resume; accepted: n_steps", t_end=t_end)
        if dtype is not None and checks.precision(dtype) != end.given.q.dtype:
            raise ValueError(
                f"dtype: found {checks.brief(dtype)} with resume; accepted: {end.given.q.dtype}, "
                "with which the run began, or None"
            )
        given, begin, position = end.given, end.t0, bool(end.about["r0"])
        clock = Clock.of(dt, n_steps, save_every, end.done)
    if isinstance(clock, PerBodyClock):
        # these go with one step size for all bodies, counted from the begin, alone
        _check_alone(
            "save_at or per-body step sizes; accepted: without", events=watched or None,
            on_save=on_save,
            resume=checkpoint, compensated=compensated, normalise=choice.projection or None,
        )  # fmt: skip
    if on_save is not None and clock.every is None:
        raise ValueError("on_save: found without save_every; accepted: with it")
    if checkpoint is not None and clock.every is not None and on_save is None:
        raise ValueError(
            "resume: found a checkpoint and save_every; accepted: with on_save too, which has the "
            "saves so far, or without save_every"
        )
    options = RunOptions(
        threads_of(n_threads, given.bodies, clock.n_steps),
        progress=progress,
        on_save=function,
        file=file,
        checkpoint=checkpoint,
        start=end,
        keep_end=True,
    )
    return execute(_plan_of(scene, choice, clock, given, position), given, begin, options)


def _plan_of(scene: Scene, choice: Choice, clock: Clock, given: Given, position: bool) -> Plan:
    """A plan, kept with the scene where it is small."""
    n, kind = given.bodies, given.q.dtype
    key = (n, choice, clock, kind, position)
    plain = not (clock.done or isinstance(clock, PerBodyClock) or choice.device)
    is_small = n <= _FEW and plain
    found: Plan | None = scene.memo.get(key) if is_small else None
    if found is None:
        found = Plan(scene, n, choice, clock, kind, position=position)
        if is_small:
            while len(scene.memo) >= _KEPT:
                scene.memo.pop(next(iter(scene.memo)), None)
            scene.memo[key] = found
    return found


def plan(
    scene: Scene,
    n_bodies: int,
    *,
    dt: float,
    n_steps: int | None = None,
    t_end: float | None = None,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    compensated: bool = False,
    normalise: str | int = "output",
    invalid: str = "raise",
    position: bool = False,
    events: Event | Sequence[Event] = (),
) -> Plan:
    """A run to be made many times: all is checked and compiled now, once.

    ``plan(q0, w0, t0=...)`` gives what :func:`propagate` does, bit for bit, in some tens of
    microseconds more than the steps take. ``position`` says that positions r0 will be given, of a
    scene with mass; the other arguments are those of ``propagate``, ``dtype`` None being float64.
    A plan can be pickled and copied, and called by several threads at a time.

    Raises ``ValueError`` or ``TypeError`` as ``propagate`` does.

    Examples
    --------
    >>> import fastatt as fa
    >>> step = fa.plan(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), 1, dt=0.01, n_steps=1, method="rk4")
    >>> run = step([1, 0, 0, 0], [0.1, 0.2, 0.3])
    >>> run = step(run.q[-1], run.w[-1], t0=0.01)
    >>> run.t
    array([0.02])
    """
    arguments = dict(locals())  # to make it again where it was pickled
    as_scene(scene)
    bodies = checks.whole("n_bodies", n_bodies, 1)
    if position and not scene.moves:
        raise ValueError("position: found True, but this scene has no mass; accepted: with mass")
    choice = chosen(scene, method, representation, compensated, normalise, events=events_of(events))
    clock = Clock.of(dt, n_steps, save_every, t_end=t_end)
    checks.choice("invalid", invalid, closed_form.INVALID)
    if METHODS.get(choice.method.name) is choice.method:
        arguments["method"] = choice.method.name
    return Plan(
        scene,
        bodies,
        choice,
        clock,
        checks.precision(dtype),
        position=position,
        n_threads=threads_of(n_threads, bodies, clock.n_steps),
        invalid=invalid,
        remake=partial(plan, **arguments),
    )


def threads_of(n_threads: int | None, n_bodies: int, n_steps: int) -> int:
    """Threads of a run: the given number; else all, but one where starting more takes longer."""
    if n_threads is None and n_bodies * n_steps < _SHORT:
        return 1
    return number_of(n_threads)


def _check_alone(why: str, **arguments: Any) -> None:
    """Refuse arguments that do not go with something else."""
    for name, value in arguments.items():
        if value is not None and value is not False:
            raise ValueError(f"{name}: found with {why}")


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
    if as_scene(scene).kind != "rate" or scene.is_coupled:
        raise ValueError(
            "scene: found inertia, mass or states; accepted: a scene with a rate alone"
        )
    record = method_of(scene, method, "quat")
    v = checks.array("v0", v0, "(3,), (M, 3) or (N, M, 3)")
    if v.ndim == 3 and scene.rows is not None:
        scene.packed(len(v))  # refuses another number of bodies
        scene = scene[np.repeat(np.arange(len(v)), v.shape[1])]
    given = Given.of(v.reshape(-1, 3), {}, checks.precision(dtype, v0))
    clock = Clock.of(dt, checks.whole("n_steps", n_steps, 0), save_every)
    plan = Plan(scene, given.bodies, Choice(record, DIRECTION), clock, given.q.dtype)
    flat = execute(plan, given, checks.real("t0", t0), RunOptions(number_of(n_threads)))
    return flat.t, flat.state.reshape((flat.t.size, *v.shape))
