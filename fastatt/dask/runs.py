"""Runs in chunks: attitudes as Dask arrays."""

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
from fastatt.propagation.event import Event, events_of
from fastatt.propagation.initial import INITIAL
from fastatt.propagation.options import Clock
from fastatt.propagation.propagate import propagate as run_chunk
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene


@dataclass(frozen=True, eq=False)
class LazyTrajectory:
    """What a run will give, a Dask collection in chunks of bodies.

    ``compute()``, as ``dask.compute`` of it, gives the :class:`fastatt.Trajectory`;
    ``dask.persist`` leaves the chunks on the workers. Its attributes are Dask arrays, but ``t``.

    Attributes
    ----------
    t : ndarray
        (S,), s.
    q, dcm : dask.array.Array
        (S, N, 4), unit quaternions, and (S, N, 3, 3), matrices, body to inertial.
    w : dask.array.Array
        (S, N, 3), rad/s, body axes.
    v, r : dask.array.Array
        (S, N, 3), m/s along body axes and, of a run with r0, m along inertial axes; of a scene with
        mass.
    s : dask.array.Array
        (S, N, n), of a scene with n states.
    status : dask.array.Array
        (N,), a flag of each body.
    event_times : dask.array.Array
        (N, E), s, of a run with events.
    method : str
        The method's name.
    """

    t: NDArray[np.float64]
    method: str
    #: the trajectory of each chunk
    runs: Any = field(repr=False)
    bodies: Bodies = field(repr=False)
    dtype: Any
    #: how many events were looked for
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
        """A flag of each body, (N,)."""
        return self.bodies.array(self.runs, "status", (), np.uint8, ())

    @property
    def event_times(self) -> Any:
        """Times of events, s, (N, E), of a run with some."""
        return self.bodies.array(self.runs, "event_times", (), np.float64, (self.events,))

    def compute(self, **options: Any) -> Trajectory:
        """The run's trajectory; ``options`` are those of ``dask.compute``."""
        (found,) = dask.compute(self, **options)
        return found  # type: ignore[no-any-return]

    def __dask_postcompute__(self) -> tuple[Callable[..., Trajectory], tuple[()]]:
        return _joined, ()

    def __dask_postpersist__(self) -> tuple[Callable[..., LazyTrajectory], tuple[Any, ...]]:
        return _persisted, (self, *self.runs.__dask_postpersist__())


def _joined(runs: Sequence[Trajectory]) -> Trajectory:
    """Trajectories of chunks side by side."""

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
    """Propagate an ensemble in chunks of bodies, when it is computed.

    Parameters
    ----------
    scene : the scene; of one with numbers per body each chunk is sent its part.
    q0, w0, v0, r0, s0 : as of :func:`fastatt.propagate`, numpy or Dask arrays, one of them with a
        row for each body. Numpy arrays travel with the graph; what is large is better made by Dask.
    chunks : bodies of a chunk, or of each; None takes those of the first Dask array, else 100 000.
    dt, n_steps, t_end : numbers, the same for all bodies.
    method, representation, save_every, dtype, t0, compensated, normalise, invalid, events : as of
        :func:`fastatt.propagate`. With ``invalid`` "raise" a bad body in a Dask array
        fails its chunk, and the error has a note of which bodies those are.

    Returns
    -------
    LazyTrajectory
        With the bits that ``fastatt.propagate`` gives: ``compute()`` makes it a ``Trajectory``.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

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
    """A method that fits the whole ensemble, and how it is sent."""
    record = chosen(
        as_scene(scene), method, representation, compensated, normalise, events=events
    ).method
    return record, record.name if METHODS.get(record.name) is record else record


def _propagated(scene: Scene, states: Sequence[Any], options: dict[str, Any]) -> Trajectory:
    """The trajectory of a chunk, which says its rates without the scene."""
    run = run_chunk(scene, **dict(zip(INITIAL, states, strict=True)), n_threads=1, **options)
    return replace(run, carried={"w": run.w, **run.carried}, packed=None, end=None)
