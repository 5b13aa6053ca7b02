"""The function ``resume``."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fastatt import checks
from fastatt.files import target
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import chosen
from fastatt.propagation.end import End, check, end_of
from fastatt.propagation.event import Event, events_of
from fastatt.propagation.execute import execute
from fastatt.propagation.histories import saving
from fastatt.propagation.options import Choice, Clock, RunOptions
from fastatt.propagation.plan import Plan
from fastatt.propagation.propagate import OnSave, threads_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene

_EPS = float(np.finfo(np.float64).eps)


def resume(
    scene: Scene,
    run: Trajectory | str | os.PathLike[str],
    *,
    n_steps: int | None = None,
    t_end: float | None = None,
    method: Method | None = None,
    save_every: int | None = None,
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
        Save the state at the end of the run, the state after every ``save_every`` further steps,
        and the final state. The default saves the final state only.
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
        The further saves; its times are counted on.

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
    watched = events_of(events)
    function, file = saving(on_save)
    end = end_of(run)
    choice = _choice_of(scene, end.about, method, watched)
    clock = _clock_of(end, n_steps, t_end, save_every)
    if on_save is not None and clock.every is None:
        raise ValueError("on_save: found without save_every; accepted: with it")
    options = RunOptions(
        threads_of(n_threads, end.given.bodies, clock.n_steps),
        progress=progress,
        on_save=function,
        file=file,
        checkpoint=None if checkpoint is None else target("checkpoint", checkpoint),
        start=end,
        keep_end=True,
    )
    position = end.about["r0"] and scene.moves
    plan = Plan(scene, end.given.bodies, choice, clock, end.given.q.dtype, position=position)
    check(end, plan)
    return execute(plan, end.given, end.t0, options)


def _choice_of(
    scene: Scene, about: dict[str, Any], method: Method | None, events: tuple[Event, ...]
) -> Choice:
    """The method and the representation of the run that is resumed."""
    name = about["method"]
    found = method.name if isinstance(method, Method) else method
    if found not in (None, name):
        raise ValueError(f"method: found {checks.brief(found)}; accepted: {name}, as in the run")
    if method is None and name not in METHODS:
        raise ValueError(f"method: is missing; accepted: the Method {name} of the run")
    options = about["representation"], about["compensated"], about["normalise"]
    try:
        return chosen(scene, method or name, *options, events)
    except ValueError as error:
        raise ValueError(
            f"scene: found one that does not fit the run ({error}); accepted: that of the run"
        ) from None


def _clock_of(end: End, n_steps: Any, t_end: Any, save_every: Any) -> Clock:
    """The further steps, until the time ``t_end`` if it is given."""
    step = float.fromhex(end.about["dt"])
    if t_end is None:
        return Clock.of(step, n_steps, save_every, end.done)
    if n_steps is not None:
        raise ValueError("n_steps, t_end: found both; accepted: one of them")
    last = checks.real("t_end", t_end)
    duration = last - end.t0
    steps = duration / step
    if not abs(steps) < 2.0**63:
        raise ValueError(f"t_end: found {last}; accepted: less than 2**63 steps of {step} s away")
    # times differ by their rounding
    slack = 16.0 * _EPS * (abs(last) + abs(end.t0))
    is_whole = abs(duration - round(steps) * step) <= slack
    total = round(steps) if is_whole else math.ceil(steps)
    if total < end.done:
        reached, order = end.t0 + end.done * step, "after" if step > 0.0 else "before"
        raise ValueError(
            f"t_end: found {last}; accepted: {reached}, the end of the run, or {order} it"
        )
    clock = Clock.of(step, total - end.done, save_every, end.done)
    return clock if is_whole else replace(clock, ends=duration)
