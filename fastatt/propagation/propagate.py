"""The functions ``propagate`` and ``plan``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from numpy.typing import ArrayLike, DTypeLike

from fastatt import checks
from fastatt.engine.marks import Event
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import Choice, chosen
from fastatt.propagation.event import events_of
from fastatt.propagation.initial import Initial, initial
from fastatt.propagation.output import OnSave, options_of
from fastatt.propagation.plan import Plan, prepared
from fastatt.propagation.schedule import schedule_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of

# how many plans are kept with a scene, and the most bodies of such a plan
_KEPT, _FEW = 16, 1024


def propagate(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    v0: ArrayLike | None = None,
    r0: ArrayLike | None = None,
    s0: ArrayLike | None = None,
    dt: float | ArrayLike,
    n_steps: int | ArrayLike | None = None,
    t_end: float | None = None,
    method: str | Method | None = None,
    representation: str = "quat",
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    progress: bool = False,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    on_save: OnSave | Sequence[OnSave] | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    save_at: ArrayLike | None = None,
    events: Event | Sequence[Event] = (),
) -> Trajectory:
    """Propagate the attitude of one body or of an ensemble with a fixed step size.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes: quaternions from body axes to inertial axes, scalar first. Their norm may
        be any number above zero. SciPy's ``Rotation`` is accepted too.
    w0 : array_like of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s. Required for a scene with inertia, and
        refused for a scene with a rate.
    v0 : array_like of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s. Required for a scene with mass.
    r0 : array_like of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m, for a scene with mass. The position is propagated
        only if ``r0`` is given.
    s0 : array_like of shape (n,) or (N, n), optional
        Initial values of the states of a scene with n states.
    dt : float or array_like of shape (N,)
        Step size, s. A negative step size propagates backwards in time. An array gives per-body
        step sizes.
    n_steps : int or array_like of shape (N,), optional
        Number of steps, at least 0. With per-body step sizes it is an array too, and all bodies
        must end at the same time, to rounding. Give either ``n_steps`` or ``t_end``; with
        ``save_at`` both may be left out, and the run ends at the last of these times.
    t_end : float, optional
        Time of the end, s, after ``t0`` in the direction of ``dt``. If it is not a whole number of
        steps away, the last step is shorter.
    method : str or Method, optional
        A name in :data:`fastatt.METHODS`, or a method made with :func:`fastatt.runge_kutta` or
        :func:`fastatt.lie_group`. The default is the first of magnus6, exact, rk8 and rk4 that fits
        the scene and the representation; ``Trajectory.method`` names it.
    representation : str, default "quat"
        The numbers that represent the attitude during the run: "quat", "dcm", "mrp", "dcm_rows"
        (two rows of the matrix) or "euler313".
    save_every : int, optional
        Save the initial state, the state after every ``save_every`` steps, and the final state. The
        default saves the final state only.
    dtype : {float64, float32}, optional
        Precision of the state. The default is float32 if all arrays of initial values are float32,
        and float64 otherwise.
    n_threads : int, optional
        Number of threads. The default is every processor that this process may use, or one for a
        short run. Results do not depend on it.
    progress : bool, default False
        Show a progress bar, which needs tqdm.
    t0 : float, default 0.0
        Time of the initial state, s.
    compensated : bool, default False
        Also carry the rounding errors of the quaternion and of the angular momentum. The error
        of an attitude due to rounding then grows with the number of steps n as n^0.5 at prescribed
        rates, and about as n for bodies (n^1.8 with "rk8"), not as n^1.5. A run has 0.5 to 0.9 of
        the speed. Accepted with the representation "quat" and with methods for which
        ``Method.compensates`` is True.
    normalise : {"output", "never"} or int, default "output"
        When the state is renormalised (a quaternion to unit norm, a matrix to an orthogonal one).
        "output" renormalises the saved values only, "never" none, and a number k also the
        propagated state every k steps. The status depends on the norm error before that. With
        "output", a compensated state is renormalised every 64 steps.
    on_save : callable or ToFile, or a list of one of each, optional
        Receives the saves of a run with ``save_every`` or ``save_at``, so that no history is held
        in memory and the returned trajectory has the last save only. A function is called with a
        trajectory of 16 saves at a time (17 with the first one, more if one step has more), whose
        arrays are reused afterwards. :func:`fastatt.to_file` writes the saves to a file.
    checkpoint : str or os.PathLike, optional
        A file to which the run writes its state every ten seconds and at the end, unless the last
        step is shorter. After a crash :func:`resume` continues from it.
    save_at : array_like of shape (S,), optional
        Times at which states are saved, s, within the run and in its order. Each is reached from
        the last step before it with one shorter step of the same method.
    events : Event or sequence of Event, optional
        Events made by :func:`fastatt.event`. ``Trajectory.event_times`` holds the time at which
        each body first crosses each event. Accepted with methods that take steps.

    Returns
    -------
    Trajectory
        The saved times, attitudes and angular velocities, and a status for each body.

    Raises
    ------
    ValueError
        If an argument does not fit the scene or the other arguments. The message names the
        argument, what was found and what is accepted.
    TypeError
        If an argument has the wrong type.
    MemoryError
        If the saves do not fit into memory.
    KeyboardInterrupt
        On Ctrl-C. Its attribute ``trajectory`` holds what was propagated until then.

    Warns
    -----
    StepWarning
        If a step is beyond the method's limit, or too small for the precision.
    RuntimeWarning
        If the status of a body is not 0, with the flags and the number of bodies, unless a
        StepWarning reports steps that are too large.

    See Also
    --------
    plan : A prepared run, for many calls with the same arguments.
    resume : Continue a run from its end, or from a file.
    recommend : The method and step size for a given tolerance.
    fastatt.dask.propagate : Ensembles that are larger than the memory of one machine.

    Examples
    --------
    A free body for 10 s, of which only the final state is kept:

    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.1, n_steps=100)
    >>> run.method, run.q.round(6)
    ('exact', array([[-0.144152,  0.611716,  0.777667,  0.016067]]))

    Two bodies, saved every second:

    >>> run = fa.propagate(
    ...     body, [1, 0, 0, 0], [[0.1, 0.3, -0.2], [0.0, 0.2, 0.0]], dt=0.1, n_steps=100,
    ...     save_every=10,
    ... )
    >>> run.t.shape, run.q.shape
    ((11,), (11, 2, 4))
    """
    as_scene(scene)
    checked_events = events_of(events, scene, position=r0 is not None)
    how = (method, representation, compensated, normalise, checked_events)
    # a choice for events may warn each time
    choice = chosen(scene, *how) if checked_events else _memoised(scene, chosen, *how)
    t0 = checks.real("t0", t0)
    values = (q0, w0, v0, r0, s0)
    start = Initial.of(*initial(scene, values), checks.precision(dtype, *values))
    # the steps of a number of steps do not depend on the time at which they begin
    begin = 0.0 if save_at is None and n_steps is not None else t0
    n = start.bodies
    when = (dt, n_steps, t_end, save_every, save_at)
    planning = (n, start.q.dtype, choice, r0 is not None, begin, *when)
    planned = _memoised(scene, _planned, *planning) if n <= _FEW else _planned(scene, *planning)
    options = options_of(planned.schedule, n_threads, progress, on_save, checkpoint)
    return planned.run(start, t0, **options)


def plan(
    scene: Scene,
    n_bodies: int,
    *,
    dt: float | ArrayLike,
    n_steps: int | ArrayLike | None = None,
    t_end: float | None = None,
    method: str | Method | None = None,
    representation: str = "quat",
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    save_at: ArrayLike | None = None,
    position: bool = False,
    events: Event | Sequence[Event] = (),
) -> Plan:
    """Check and compile a run once, to call it many times.

    ``plan(q0, w0, t0=...)`` returns what :func:`propagate` returns, bit for bit. A call takes some
    tens of microseconds more than its steps. A plan can be pickled and copied, and several threads
    may call it at the same time.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    n_bodies : int
        Number of bodies of each call.
    dt : float or array_like of shape (N,)
        Step size or per-body step sizes, s; negative propagates backwards.
    n_steps : int or array_like of shape (N,), optional
        Number of steps, at least 0. Give either ``n_steps`` or ``t_end``.
    t_end : float, optional
        Time of the end of each run, s, as in :func:`propagate`.
    method : str or Method, optional
        The method, as in :func:`propagate`.
    representation : str, default "quat"
        The representation of the attitude, as in :func:`propagate`.
    save_every : int, optional
        Number of steps between saves, as in :func:`propagate`.
    dtype : {float64, float32}, optional
        Precision of the state; the default is float64.
    n_threads : int, optional
        Number of threads, as in :func:`propagate`.
    t0 : float, default 0.0
        Time of the initial state, s. A call may give another one, unless the plan has a ``t_end``
        or ``save_at``.
    compensated : bool, default False
        Also carry rounding errors, as in :func:`propagate`.
    normalise : {"output", "never"} or int, default "output"
        When the state is renormalised, as in :func:`propagate`.
    save_at : array_like of shape (S,), optional
        Times of saves, s, as in :func:`propagate`.
    position : bool, default False
        Whether calls give initial positions ``r0``, for a scene with mass.
    events : Event or sequence of Event, optional
        Events, as in :func:`propagate`.

    Returns
    -------
    Plan
        The prepared run, a callable.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`propagate`.

    Examples
    --------
    >>> import fastatt as fa
    >>> step = fa.plan(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), 1, dt=0.01, n_steps=1, method="rk4")
    >>> run = step([1, 0, 0, 0], [0.1, 0.2, 0.3])
    >>> run = step(run.q[-1], run.w[-1], t0=0.01)
    >>> run.t
    array([0.02])
    """
    arguments = dict(locals())  # a pickled plan is recreated with these
    as_scene(scene)
    bodies = checks.whole("n_bodies", n_bodies, 1)
    if position and not scene.moves:
        raise ValueError("position: found True, but this scene has no mass; accepted: with mass")
    arguments["events"] = checked_events = events_of(events, scene, position=position)
    choice = chosen(scene, method, representation, compensated, normalise, checked_events)
    t0 = checks.real("t0", t0)
    schedule = schedule_of(dt, n_steps, t_end, save_every, save_at, t0=t0, bodies=bodies)
    if METHODS.get(choice.method.name) is choice.method:
        arguments["method"] = choice.method.name
    return prepared(
        scene,
        bodies,
        choice,
        schedule,
        checks.precision(dtype),
        position=position,
        n_threads=None if n_threads is None else number_of(n_threads),
        t0=t0,
        has_fixed_t0=n_steps is None or save_at is not None,
        remake=partial(plan, **arguments),
    )


def _planned(
    scene: Scene,
    n_bodies: int,
    dtype: Any,
    choice: Choice,
    position: bool,
    begin: float,
    *when: Any,
) -> Plan:
    """The plan of a run; ``when`` are the arguments of ``schedule_of``."""
    schedule = schedule_of(*when, t0=begin, bodies=n_bodies)
    return prepared(scene, n_bodies, choice, schedule, dtype, position=position)


def _memoised(scene: Scene, make: Callable[..., Any], *arguments: Any) -> Any:
    """What a function makes of a scene and arguments, which the scene remembers."""
    # equal arguments of other types may be refused
    key = (make, *((type(x), x) for x in arguments))
    try:
        value = scene.memo.get(key)
    except TypeError:  # an argument without a hash
        return make(scene, *arguments)
    if value is None:
        value = make(scene, *arguments)
        while len(scene.memo) >= _KEPT:
            scene.memo.pop(next(iter(scene.memo)), None)
        scene.memo[key] = value
    return value
