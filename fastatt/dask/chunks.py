"""Propagation in chunks, with the results as Dask arrays."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any

import dask.array as da
import numpy as np
from dask.base import DaskMethodsMixin
from dask.delayed import Delayed, delayed
from dask.highlevelgraph import HighLevelGraph

from fastatt import checks, rounding
from fastatt.engine.marks import Event
from fastatt.engine.status import FLAGS
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import chosen
from fastatt.propagation.event import events_of
from fastatt.propagation.initial import INITIAL, initial
from fastatt.propagation.propagate import propagate as run_chunk
from fastatt.propagation.schedule import schedule_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene, as_scene

# bodies of a chunk, for 0.5 s of a thousand steps and 6 MB of states
_CHUNK = 100_000


@dataclass(frozen=True, eq=False)
class LazyTrajectory(DaskMethodsMixin):  # type: ignore[misc]
    """The trajectory of a lazy run, a Dask collection in chunks of bodies.

    ``compute()`` runs and returns the :class:`Trajectory` of the whole ensemble.

    Attributes
    ----------
    t : ndarray of shape (S,)
        Times of the saves, s.
    q : dask.array.Array of shape (S, N, 4)
        Unit quaternions, body to inertial, scalar first.
    w : dask.array.Array of shape (S, N, 3)
        Angular velocities along body axes, rad/s.
    v, r : dask.array.Array of shape (S, N, 3)
        Velocities along body axes, m/s, and, for a run with ``r0``, positions along inertial axes,
        m, for a scene with mass.
    s : dask.array.Array of shape (S, N, n)
        States, for a scene with n states.
    status : dask.array.Array of shape (N,)
        Status of each body.
    event_times : dask.array.Array of shape (N, E)
        Times of the events, s, for a run with events.
    method : str
        Name of the method.
    """

    t: Any
    method: str
    #: the trajectory of each chunk, with its number of bodies
    runs: list[tuple[Any, int]] = field(repr=False)
    #: the shape of each array before and after the axis of bodies, and its type
    arrays: dict[str, tuple[Any, ...]] = field(repr=False)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self.arrays:
            raise AttributeError(f"{name}: found none; accepted: t, {', '.join(self.arrays)}")
        saves, tail, precision = self.arrays[name]
        blocks = [
            da.from_delayed(getattr(x, name), (*saves, n, *tail), precision) for x, n in self.runs
        ]
        return da.concatenate(blocks, axis=len(saves))

    # Dask's protocol of collections: the trajectories of the chunks
    __dask_optimize__ = staticmethod(da.Array.__dask_optimize__)
    __dask_scheduler__ = staticmethod(da.Array.__dask_scheduler__)

    def __dask_graph__(self) -> Any:
        return HighLevelGraph.merge(*(run.dask for run, _ in self.runs))

    def __dask_keys__(self) -> list[Any]:
        return [run.key for run, _ in self.runs]

    def __dask_postcompute__(self) -> tuple[Callable[..., Trajectory], tuple[()]]:
        return _joined, ()

    def __dask_postpersist__(self) -> tuple[Callable[..., LazyTrajectory], tuple[()]]:
        return self._persisted, ()

    def _persisted(self, graph: Any) -> LazyTrajectory:
        return replace(self, runs=[(Delayed(run.key, graph), n) for run, n in self.runs])


def _joined(runs: Sequence[Trajectory]) -> Trajectory:
    """The trajectories of chunks, joined."""
    axes = {"state": 1, "norm_error": 1, "status": 0}
    if runs[0].first_crossings is not None:
        axes["first_crossings"] = 0
    joined: Any = {k: np.concatenate([getattr(run, k) for run in runs], axes[k]) for k in axes}
    carried = {k: np.concatenate([run.carried[k] for run in runs], 1) for k in runs[0].carried}
    firsts = accumulate((run.status.size for run in runs), initial=0)
    located = [
        (i, first + bodies, *rest)
        for run, first in zip(runs, firsts, strict=False)
        for i, bodies, *rest in run.located
    ]
    return replace(runs[0], carried=carried, located=tuple(located), **joined)


def propagate(
    scene: Scene,
    q0: Any,
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
    representation: str = "quat",
    save_every: int | None = None,
    dtype: Any = None,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    events: Event | Sequence[Event] = (),
) -> LazyTrajectory:
    """Propagate an ensemble in chunks of bodies, lazily.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces. A scene with per-body numbers is divided:
        each chunk is sent its part.
    q0 : array_like or dask.array.Array of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`. At least one of the initial values has a
        row for each body. NumPy arrays are sent with the graph; large arrays are better made by
        Dask.
    w0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    v0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like or dask.array.Array of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    dt : float
        Step size of all bodies, s.
    n_steps : int, optional
        Number of steps. Give either ``n_steps`` or ``t_end``.
    t_end : float, optional
        Time of the end, s, as in :func:`fastatt.propagate`.
    chunks : int or sequence of int, optional
        Number of bodies in a chunk, or in each. The default is the chunks of the first Dask array,
        or else 100 000.
    method : str or Method, optional
        The method, as in :func:`fastatt.propagate`.
    representation : str, default "quat"
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
        When the state is renormalised, as in :func:`fastatt.propagate`.
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
        If an argument does not fit. If it is a body's in a Dask array, its chunk fails, and the
        error has a note of the chunk's bodies.

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
    scene = as_scene(scene)
    checked_events = events_of(events, scene, position=r0 is not None)
    record = chosen(scene, method, representation, compensated, normalise, checked_events).method
    start = checks.real("t0", t0)
    t = schedule_of(dt, n_steps, t_end, save_every, t0=start).times(start)
    arguments = dict(zip(INITIAL, (q0, w0, v0, r0, s0), strict=True))
    lazy = {name: x for name, x in arguments.items() if isinstance(x, da.Array)}
    for name, x in lazy.items():
        if np.isnan(x.shape).any():
            raise ValueError(f"{name}: found unknown sizes; accepted: after compute_chunk_sizes()")
    like = [*map(_like, arguments.values())]
    attitudes, coupled = initial(scene, like)
    values = {"q0": attitudes, **coupled, **lazy}
    n = max((len(x) for x in values.values() if x.ndim == 2), default=0)
    if n == 0:
        raise ValueError("q0: found one body; accepted: (N, 4), or another with N rows")
    scene.packed(n)  # raises for another number of bodies
    precision = checks.precision(dtype, *like)
    options = {
        "dt": dt, "n_steps": n_steps, "t_end": t_end, "save_every": save_every, "dtype": precision,
        "method": record, "representation": representation, "compensated": compensated,
        "normalise": normalise, "t0": t0, "events": checked_events, "n_threads": 1,
    }  # fmt: skip
    sizes = _sizes(chunks, n, lazy.values())
    blocks = zip(*(_blocks(x, n, sizes) for x in values.values()), strict=True)
    rows = zip(accumulate(sizes, initial=0), accumulate(sizes), blocks, strict=False)
    is_divided = scene.packed(None).params.ndim == 2
    # sent once to each worker
    whole, shared = delayed(scene, traverse=False), delayed(options, traverse=False)
    runs = [
        delayed(_run)(scene[a:b] if is_divided else whole, shared, a, b, [*values], *block)
        for a, b, block in rows
    ]
    tails = {"q": 4, "w": 3, **scene.carried(position=r0 is not None)}
    arrays: Any = {name: ((t.size,), (k,), precision) for name, k in tails.items()}
    arrays["status"] = (), (), FLAGS
    if checked_events:
        arrays["event_times"] = (), (len(checked_events),), np.float64
    return LazyTrajectory(t, record.name, [*zip(runs, sizes, strict=True)], arrays)


def _like(x: Any) -> Any:
    """An array of ones in place of one that Dask computes; anything else is returned as it is."""
    return np.broadcast_to(np.ones((), x.dtype), x.shape) if isinstance(x, da.Array) else x


def _sizes(chunks: Any, n: int, lazy: Iterable[Any]) -> tuple[int, ...]:
    """The number of bodies of each chunk."""
    if chunks is None:
        chunks = next((x.chunks[0] for x in lazy if x.ndim == 2 and len(x) == n), _CHUNK)
    if not np.iterable(chunks):
        size = checks.whole("chunks", chunks, 1)
        return tuple(min(size, n - a) for a in range(0, n, size))
    sizes = tuple(checks.whole("chunks", size, 1) for size in chunks)
    if sum(sizes) != n:
        raise ValueError(f"chunks: found {sum(sizes)} bodies in all; accepted: {n}")
    return sizes


def _blocks(x: Any, n: int, sizes: tuple[int, ...]) -> list[Any]:
    """The initial values of each chunk, or the one row that all of them share."""
    x = x[0] if x.ndim == 2 and len(x) < n else x
    if isinstance(x, da.Array):
        blocks: list[Any] = x.rechunk((sizes, -1)[2 - x.ndim :]).to_delayed().ravel().tolist()
        return blocks * (len(sizes) // len(blocks))
    return np.split(x, [*accumulate(sizes[:-1])]) if x.ndim == 2 else [x] * len(sizes)


def _run(scene: Scene, options: Any, first: int, end: int, names: Any, *values: Any) -> Trajectory:
    """The trajectory of a chunk, with its rates as numbers, without the scene."""
    with rounding.noted() as texts:
        try:
            run = run_chunk(scene, **dict(zip(names, values, strict=True)), **options)
        except Exception as error:
            error.add_note(f"in the chunk of bodies {first} to {end - 1}")
            raise
        finally:
            # that of distributed, on a worker, warns in the client's process
            warn: Any = sys.modules.get("distributed", warnings).warn
            for text in texts:
                of_flags = text.startswith("status: ")
                category = RuntimeWarning if of_flags else rounding.StepWarning
                warn(f"bodies {first} to {end - 1}: {text}", category)
    return replace(run, carried={"w": run.w, **run.carried}, packed=None, end=None)
