"""Propagation in chunks, with attitudes as Dask arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import dask
import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.attitudes import Attitude
from fastatt.dask.chunks import Bodies, like
from fastatt.methods import METHODS, Method
from fastatt.propagation import closed_form
from fastatt.propagation.choice_of_method import chosen
from fastatt.propagation.event import Event, check_steps, events_of
from fastatt.propagation.initial import INITIAL
from fastatt.propagation.options import Clock
from fastatt.propagation.propagate import propagate as run_chunk
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene


@dataclass(frozen=True, eq=False)
class LazyTrajectory:
    """The trajectory of a lazy run, a Dask collection in chunks of bodies.

    Attributes
    ----------
    t : ndarray, shape (S,)
        Times of the saves, s.
    q : dask.array.Array, shape (S, N, 4)
        Unit quaternions, body to inertial, scalar first.
    w : dask.array.Array, shape (S, N, 3)
        Angular velocities along body axes, rad/s.
    v, r : dask.array.Array, shape (S, N, 3)
        Velocities along body axes, m/s, and, for a run with ``r0``, positions along inertial axes,
        m, for a scene with mass.
    s : dask.array.Array, shape (S, N, n)
        States, for a scene with n states.
    method : str
        Name of the method.
    """

    t: NDArray[np.float64]
    method: str
    #: the trajectory of each chunk
    runs: Any = field(repr=False)
    bodies: Bodies = field(repr=False)
    dtype: Any
    #: the number of events
    events: int = 0

    def __getattr__(self, name: str) -> Any:
        # Dask's protocol of collections: that of the array of chunks
        if name.startswith("__dask_"):
            return getattr(self.runs, name)
        tails = {"q": (4,), "w": (3,), "dcm": (3, 3)}
        if self.bodies.scene.moves:
            tails["v"] = (3,)
        if self.bodies.given[INITIAL.index("r0")] is not None:
            tails["r"] = (3,)
        if self.bodies.scene.states:
            tails["s"] = (self.bodies.scene.states,)
        if name not in tails:
            raise AttributeError(f"{name}: found none; accepted: {', '.join(tails)}, status, t")
        return self.bodies.array(self.runs, name, (self.t.size,), self.dtype, tails[name])

    @property
    def status(self) -> Any:
        """Status of each body: (N,)."""
        return self.bodies.array(self.runs, "status", (), np.uint8, ())

    @property
    def event_times(self) -> Any:
        """Times of the events, s: (N, E). For a run with events."""
        return self.bodies.array(self.runs, "event_times", (), np.float64, (self.events,))

    def compute(self, **options: Any) -> Trajectory:
        """Run and return the trajectory.

        Parameters
        ----------
        **options : dict
            Keyword arguments of ``dask.compute``.

        Returns
        -------
        Trajectory
            The trajectory of the whole ensemble.
        """
        (found,) = dask.compute(self, **options)
        return found  # type: ignore[no-any-return]

    def __dask_postcompute__(self) -> tuple[Callable[..., Trajectory], tuple[()]]:
        return _joined, ()

    def __dask_postpersist__(self) -> tuple[Callable[..., LazyTrajectory], tuple[Any, ...]]:
        return _persisted, (self, *self.runs.__dask_postpersist__())


def _joined(runs: Sequence[Trajectory]) -> Trajectory:
    """The trajectories of chunks, joined."""

    def all_of(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(run, name) for run in runs], axis=1)

    carried = {
        name: np.concatenate([run.carried[name] for run in runs], axis=1)
        for name in runs[0].carried
    }
    status = np.concatenate([run.status for run in runs])
    return replace(
        runs[0],
        state=all_of("state"),
        norm_error=all_of("norm_error"),
        status=status,
        carried=carried,
        found=None if runs[0].found is None else np.concatenate([run.found for run in runs]),
    )


def _persisted(
    graph: Any, lazy: LazyTrajectory, rebuild: Callable[..., Any], given: Any, **options: Any
) -> LazyTrajectory:
    return replace(lazy, runs=rebuild(graph, *given, **options))


def propagate(
    scene: Scene,
    q0: Any = None,
    w0: Any = None,
    *,
    v0: Any = None,
    r0: Any = None,
    s0: Any = None,
    dt: float,
    n_steps: int | None = None,
    t_end: float | None = None,
    chunks: int | Sequence[int] | None = None,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    save_every: int | None = None,
    dtype: Any = None,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    invalid: str = "raise",
    events: Event | Sequence[Event] = (),
) -> LazyTrajectory:
    """Propagate an ensemble in chunks of bodies, lazily.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces. A scene with per-body numbers is divided:
        each chunk is sent its part.
    q0 : array_like or dask.array.Array, shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`. At least one of the initial values has a
        row for each body. NumPy arrays are sent with the graph; large arrays are better made by
        Dask.
    w0 : array_like or dask.array.Array, shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    v0 : array_like or dask.array.Array, shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like or dask.array.Array, shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like or dask.array.Array, shape (n,) or (N, n), optional
        Initial values of the scene's states.
    dt : float
        Step size of all bodies, s.
    n_steps : int, optional
        Number of steps. Give either ``n_steps`` or ``t_end``.
    t_end : float, optional
        Duration of the run, s, as in :func:`fastatt.propagate`.
    chunks : int or sequence of int, optional
        Number of bodies in a chunk, or in each. The default is the chunks of the first Dask array,
        or else 100 000.
    method : str or Method, optional
        The method, as in :func:`fastatt.propagate`.
    representation : str or Attitude, default "quat"
        The representation, as in :func:`fastatt.propagate`.
    save_every : int, optional
        Number of steps between saves, as in :func:`fastatt.propagate`.
    dtype : {float64, float32}, optional
        Precision, as in :func:`fastatt.propagate`.
    t0 : float, default 0.0
        Time of the initial state, s.
    compensated : bool, default False
        Compensate rounding, as in :func:`fastatt.propagate`.
    normalise : {"output", "never"} or int, default "output"
        When the state is projected, as in :func:`fastatt.propagate`.
    invalid : {"raise", "flag"}, default "raise"
        As in :func:`fastatt.propagate`. With "raise", a bad body in a Dask array fails its chunk,
        and the error has a note of the chunk's bodies.
    events : Event or sequence of Event, optional
        Events, as in :func:`fastatt.propagate`.

    Returns
    -------
    LazyTrajectory
        The lazy results, with the same bits as those of :func:`fastatt.propagate`; ``compute()``
        returns a :class:`Trajectory`.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Examples
    --------
    >>> import fastatt as fa
    >>> from fastatt import dask as fd
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> lazy = fd.propagate(scene, [[1, 0, 0, 0]] * 5, [0.1, 0.2, 0.3], dt=0.1, n_steps=9, chunks=2)
    >>> lazy.q.chunks
    ((1,), (2, 2, 1), (4,))
    >>> lazy.compute().q.shape
    (1, 5, 4)
    """
    watched = events_of(events)
    record, named = sent(scene, method, representation, compensated, normalise, watched)
    clock = Clock.of(dt, n_steps, save_every, t_end=t_end)
    check_steps(watched, as_scene(scene), clock.ends)
    begin = checks.real("t0", t0)
    flag = checks.choice("invalid", invalid, closed_form.INVALID) == "flag"
    given = (q0, w0, v0, r0, s0)
    bodies = Bodies.of(scene, given, chunks, flag=flag)
    kind = checks.precision(dtype, *map(like, given))
    options = {
        "dt": dt, "n_steps": n_steps, "t_end": t_end, "save_every": save_every, "method": named,
        "dtype": kind, "representation": representation, "compensated": compensated,
        "normalise": normalise, "invalid": invalid, "t0": begin, "events": watched,
    }  # fmt: skip
    runs = bodies.mapped(partial(_propagated, options=options))
    return LazyTrajectory(clock.times(begin), record.name, runs, bodies, kind, len(watched))


def sent(
    scene: Scene,
    method: str | Method | None,
    representation: str | Attitude,
    compensated: bool = False,
    normalise: str | int = "output",
    events: tuple[Event, ...] = (),
) -> tuple[Method, str | Method]:
    """A method that fits the whole ensemble, and the form in which it is sent."""
    record = chosen(
        as_scene(scene), method, representation, compensated, normalise, events=events
    ).method
    return record, record.name if METHODS.get(record.name) is record else record


def _propagated(scene: Scene, states: Sequence[Any], options: dict[str, Any]) -> Trajectory:
    """The trajectory of a chunk, with its rates as numbers, without the scene."""
    run = run_chunk(scene, **dict(zip(INITIAL, states, strict=True)), n_threads=1, **options)
    return replace(run, carried={"w": run.w, **run.carried}, packed=None, end=None)
