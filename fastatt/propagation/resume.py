"""The function ``resume``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.engine.marks import Event
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import Choice, chosen
from fastatt.propagation.end import end_of
from fastatt.propagation.event import events_of
from fastatt.propagation.output import OnSave, options_of
from fastatt.propagation.plan import prepared
from fastatt.propagation.schedule import schedule_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene


def resume(
    scene: Scene,
    run: Trajectory | str | os.PathLike[str],
    *,
    n_steps: int | None = None,
    t_end: float | None = None,
    method: Method | None = None,
    save_every: int | None = None,
    save_at: ArrayLike | None = None,
    n_threads: int | None = None,
    progress: bool = False,
    on_save: OnSave | Sequence[OnSave] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    events: Event | Sequence[Event] = (),
) -> Trajectory:
    """Continue a run from its end, with the same bits as a run without the interruption.

    Step size, method, representation, precision, ``normalise`` and ``compensated`` are those of the
    run. (A new run from ``run.q[-1]`` differs by rounding, because saved attitudes are
    renormalised.)

    Parameters
    ----------
    scene : Scene
        The scene of the run.
    run : Trajectory, str or os.PathLike
        The run: a trajectory of at most 262144 bodies, or a file that :meth:`Trajectory.save_end`
        or ``checkpoint`` wrote.
    n_steps : int, optional
        Number of further steps, at least 0. Give either ``n_steps`` or ``t_end``.
    t_end : float, optional
        Time of the end, s, not before that of the run. If it is not a whole number of steps away,
        the last step is shorter.
    method : Method, optional
        The method of the run, if it was made with :func:`fastatt.runge_kutta` or
        :func:`fastatt.lie_group`.
    save_every : int, optional
        Save the state at the end of the run, the state after every ``save_every`` steps, counted
        from the initial values as in the run, and the final state. The default saves the final
        state only.
    save_at : array_like of shape (S,), optional
        Times of the saves, s, from the end of the run on, as in :func:`propagate`.
    n_threads : int, optional
        Number of threads, as in :func:`propagate`.
    progress : bool, default False
        Show a progress bar, which needs tqdm.
    on_save : callable or ToFile, or a list of one of each, optional
        Receives the saves, as in :func:`propagate`.
    checkpoint : str or os.PathLike, optional
        A file to which the state is written every ten seconds, as in :func:`propagate`. It may be
        the file from which the run is resumed.
    events : Event or sequence of Event, optional
        Events, as in :func:`propagate`. If they are those of the run, their search continues, and
        bodies that have stopped stay as they are. Others are refused if the run had a terminal one.

    Returns
    -------
    Trajectory
        The further saves, whose times continue those of the run.

    Raises
    ------
    ValueError
        If the scene, the method or the events differ from those of the run, if the trajectory or
        the file does not hold the end of a run, or if another argument does not fit.
    TypeError
        If an argument has the wrong type.
    OSError
        If the file cannot be read.
    KeyboardInterrupt
        On Ctrl-C, as in :func:`propagate`.

    Warns
    -----
    StepWarning
        As :func:`propagate` does.

    See Also
    --------
    propagate : Runs from initial values.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> start = [1, 0, 0, 0], [0.1, 0.3, -0.2]
    >>> whole = fa.propagate(body, *start, dt=0.1, n_steps=100, method="rk8")
    >>> half = fa.propagate(body, *start, dt=0.1, n_steps=40, method="rk8")
    >>> rest = fa.resume(body, half, t_end=10.0)
    >>> rest.t, np.array_equal(rest.q, whole.q)
    (array([10.]), True)
    """
    as_scene(scene)
    end = end_of(run)
    position = end.options["r0"] and scene.moves
    checked_events = events_of(events, scene, position=position)
    choice = _choice_of(scene, end.options, method, checked_events)
    dt, t0, done = (end.options[name] for name in ("dt", "t0", "done"))
    schedule = schedule_of(dt, n_steps, t_end, save_every, save_at, t0=t0, done=done)
    if schedule.n_steps < 0:
        reached, order = t0 + done * dt, "after" if dt > 0.0 else "before"
        raise ValueError(
            f"t_end: found {t_end}; accepted: {reached}, the end of the run, or {order} it"
        )
    bodies = end.start.bodies
    options = options_of(schedule, n_threads, progress, on_save, checkpoint)
    plan = prepared(scene, bodies, choice, schedule, end.start.q.dtype, position=position)
    end.check(plan.equations, plan.packed.params, plan.events_key, plan.kept_shapes)
    return plan.run(end.start, t0, resumed=end, **options)


def _choice_of(
    scene: Scene, options: dict[str, Any], method: Method | None, events: tuple[Event, ...]
) -> Choice:
    """The method and the representation of the run that is resumed."""
    name = options["method"]
    asked = method.name if isinstance(method, Method) else method
    if asked not in (None, name):
        raise ValueError(f"method: found {checks.brief(asked)}; accepted: {name}, as in the run")
    if method is None and name not in METHODS:
        raise ValueError(f"method: is missing; accepted: the Method {name} of the run")
    try:
        return chosen(
            scene, method or name, options["representation"], options["compensated"],
            options["normalise"], events,
        )  # fmt: skip
    except ValueError as error:
        raise ValueError(
            f"scene: found one that does not fit the run ({error}); accepted: that of the run"
        ) from None
