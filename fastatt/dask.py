"""Ensembles in chunks, lazily, on Dask: several processes of one machine, or many machines.

Each chunk runs on one thread of a worker, so a worker with k threads runs k chunks at a time. The
first chunk in a process loads the compiled loop, or compiles it. Results are those of the library's
own calls, bit for bit, whatever the chunks. Warnings reach the process that asked.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

try:
    import dask.array as da
    from dask import delayed
    from dask.highlevelgraph import HighLevelGraph
except ImportError:
    raise ImportError(
        "fastatt.dask: needs dask; install it with pip install 'fastatt[dask]'"
    ) from None

from fastatt import arrays, checks, exact, rounding
from fastatt import propagate as run_chunk
from fastatt import watch_drift as watch_chunk
from fastatt.arrays import angle_between
from fastatt.attitudes import Attitude
from fastatt.methods import METHODS, Method
from fastatt.running.asked import Clock
from fastatt.running.choosing import chosen
from fastatt.running.ensemble import Ensemble
from fastatt.running.initial import initial
from fastatt.running.watch import Measure
from fastatt.scene import Scene, as_scene
from fastatt.trade.measure import Case, Problem, Rung, ladder_rows, last_state
from fastatt.trade.reference import reference as found_reference
from fastatt.trade.work_precision import WorkPrecision, duration

# bodies of a chunk: 0.2 s of a thousand steps, 6 MB of states
_CHUNK = 100_000
_OPTIONS = (
    *("dt", "n_steps", "method", "representation", "dtype"),
    *("t0", "compensated", "normalise", "invalid", "looks"),
)
#: stands for states that Dask computes
_LATER = "later"
_MEASURES = ("norm", "orthogonality", "energy", "momentum")


@dataclass(frozen=True, eq=False)
class LazyTrajectory:
    """What a run will give, as Dask arrays in chunks of bodies.

    ``t`` (S,) s is known. ``q`` (S, N, 4), ``w`` (S, N, 3) rad/s in body axes, ``status`` (N,), of
    a scene with mass ``v`` (S, N, 3) m/s and, given r0, ``r`` (S, N, 3) m, else None.
    ``dask.compute`` takes all of it at once, and gives the same with numpy arrays.
    """

    t: NDArray[np.float64]
    q: Any
    w: Any
    status: Any
    method: str
    v: Any = None
    r: Any = None
    #: the matrices, where they are what is propagated
    matrix: Any = None

    @property
    def C(self) -> Any:
        """Direction cosine matrices (S, N, 3, 3), body to inertial."""
        if self.matrix is not None:
            return self.matrix
        if isinstance(self.q, np.ndarray):
            return arrays.quat_to_dcm(self.q)
        chunks = (*self.q.chunks[:2], (3,), (3,))
        return self.q.map_blocks(
            arrays.quat_to_dcm, chunks=chunks, new_axis=3, meta=_nothing(4, self.q.dtype)
        )


@dataclass(frozen=True)
class Drifts:
    """Drifts over all saves of all bodies, as ``fastatt.drift`` defines them.

    Each is a ``Measure`` of one row, with ``maximum`` (1,) and ``percentile(p)`` (1,), or None
    where the scene does not keep it. ``saves`` are those of a body, ``flags`` counts flagged ones.
    """

    norm: Measure
    orthogonality: Measure
    energy: Measure | None
    momentum: Measure | None
    saves: int
    bodies: int
    flags: dict[str, int]


def propagate(
    scene: Scene,
    q0: Any = None,
    w0: Any = None,
    *,
    v0: Any = None,
    r0: Any = None,
    dt: float,
    n_steps: int,
    chunks: int | Sequence[int] | None = None,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    save_every: int | None = None,
    dtype: Any = None,
    t0: float = 0.0,
    compensated: bool = False,
    normalise: str | int = "output",
    invalid: str = "raise",
    looks: bool = True,
) -> LazyTrajectory:
    """Propagate an ensemble in chunks of bodies, when it is computed.

    Parameters
    ----------
    scene : what acts; where bodies have their own numbers, each chunk is sent its own.
    q0, w0, v0, r0 : as of :func:`fastatt.propagate`, numpy or Dask arrays, one of them with a row
        for each body. Numpy arrays travel with the graph; what is large is better made by Dask.
    chunks : bodies of a chunk, or of each; None takes those of the first Dask array, else 100 000.
    dt, n_steps : numbers, the same for all bodies.
    method, representation, save_every, dtype, t0, compensated, normalise, invalid, looks : as of
        :func:`fastatt.propagate`. With ``invalid`` "raise" a bad body in a Dask array
        fails its chunk, and the error has a note of which bodies those are.

    Returns
    -------
    LazyTrajectory : Dask arrays with the bits that ``fastatt.propagate`` gives.

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
    >>> lazy.q.compute().shape
    (1, 5, 4)
    """
    record, named = _method(scene, method, representation, compensated, normalise)
    clock = Clock.of(dt, n_steps, save_every)
    begin = checks.real("t0", t0)
    flag = checks.choice("invalid", invalid, exact.INVALID) == "flag"
    bodies = _Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=flag)
    kind = checks.precision(dtype, *(x for x in bodies.given if x is not None))
    options = {
        "dt": dt, "n_steps": n_steps, "save_every": save_every, "method": named, "dtype": kind,
        "representation": representation, "compensated": compensated, "normalise": normalise,
        "invalid": invalid, "looks": looks, "t0": begin,
    }  # fmt: skip
    is_matrix = chosen(scene, record, representation, False, normalise).attitude.to_dcm_array
    shapes: dict[str, tuple[int, ...]] = {"q": (4,), "w": (3,)}
    shapes |= {"C": (3, 3)} if is_matrix is not None else {}
    shapes |= {"v": (3,)} if scene.moves else {}
    shapes |= {"r": (3,)} if r0 is not None else {}
    t = clock.times(begin)
    runs = bodies.mapped(partial(_propagated, names=(*shapes, "status"), options=options))
    found = {name: bodies.array(runs, name, (t.size,), kind, shapes[name]) for name in shapes}
    status = bodies.array(runs, "status", (), np.uint8, ())
    matrix = found.pop("C", None)
    return LazyTrajectory(t, status=status, method=record.name, matrix=matrix, **found)


def watch_drift(
    scene: Scene,
    q0: Any,
    w0: Any = None,
    *,
    every: int,
    v0: Any = None,
    r0: Any = None,
    chunks: int | Sequence[int] | None = None,
    **options: Any,
) -> Any:
    """Drift statistics over all bodies: a ``dask.delayed`` :class:`Drifts`; no history is kept.

    ``every``, and ``options`` such as ``dt``, ``n_steps`` and ``method``, are those of
    :func:`fastatt.watch_drift`; the rest is as of :func:`propagate`. A chunk hands on 2 kB.

    Raises ``ValueError`` or ``TypeError`` for a scene or initial states that do not fit; for the
    rest when it is computed.
    """
    if wrong := sorted(options.keys() - _OPTIONS):
        raise TypeError(f"{wrong[0]}: found; accepted: {', '.join(_OPTIONS)}")
    flag = options.get("invalid") == "flag"
    bodies = _Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=flag)
    options["method"] = _method(
        scene, options.get("method"), options.get("representation", "quat")
    )[1]
    return bodies.merged(_joined, partial(_watched, options={**options, "every": every}))


def work_precision(
    scene: Scene,
    q0: Any,
    w0: Any = None,
    *,
    t_end: float,
    runs: Sequence[tuple[str | Method, int]],
    reference: tuple[str | Method, int] | None = None,
    v0: Any = None,
    r0: Any = None,
    t0: float = 0.0,
    chunks: int | Sequence[int] | None = None,
    representation: str | Attitude = "quat",
    dtype: str = "float64",
) -> Any:
    """Errors of methods and steps on all bodies: a ``dask.delayed`` ``WorkPrecision``.

    Parameters
    ----------
    scene, q0, w0, v0, r0, t0, chunks : as of :func:`propagate`.
    t_end : duration, s, above 0.
    runs : (method, number of steps) of each row.
    reference : the same of what errors are taken against; its own error is taken to be what it
        differs by from half as many steps. None: the closed form or, where there is none, what
        :func:`fastatt.work_precision` takes, found for each chunk anew and so only the same within
        its own error whatever the chunks.
    representation, dtype : in which the runs are made.

    Returns
    -------
    ``dask.delayed`` : when computed, ``rows``, ``frontier``, ``table()`` and so on of
        :func:`fastatt.work_precision`; seconds are those of one thread of a worker, of one run,
        with whatever else ran there. One task holds the errors of all, 16 bytes a run and body.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    as_scene(scene)
    if not runs:
        raise ValueError("runs: found none; accepted: (method, number of steps), one or more")
    cases = [_case(scene, "runs", run, representation, dtype) for run in runs]
    known = None if reference is None else _case(scene, "reference", reference, "quat", "float64")
    if known is not None and known[1] < 2:
        raise ValueError("reference: found 1 step; accepted: 2 or more, or None")
    bodies = _Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=False)
    seconds, begin = duration(t_end), checks.real("t0", t0)
    work = partial(_measured, cases=cases, known=known, t_end=seconds, t0=begin)
    return bodies.merged(partial(_table, kind=scene.kind, cases=cases, t_end=seconds), work)


class _Part:
    """Which bodies a chunk has, their scene if it is their own, their states."""

    def __init__(self, first: int, last: int, scene: Scene | None, states: list[Any]) -> None:
        self.first, self.last, self.scene, self.states = first, last, scene, states


class _Work:
    """What is done with each chunk: sent to a worker once, with a scene that all bodies share."""

    def __init__(self, function: Callable[..., Any], scene: Scene | None) -> None:
        self.function, self.scene = function, scene

    def __call__(self, part: _Part, *lazy: Any) -> Any:
        scene = self.scene if part.scene is None else part.scene
        computed = iter(lazy)
        states = [next(computed) if isinstance(x, str) else x for x in part.states]
        told: list[str] = []
        before = rounding.heard.set(told)
        try:
            return self.function(scene, states)
        except Exception as error:
            error.add_note(f"in the chunk of bodies {part.first} to {part.last - 1}")
            raise
        finally:
            rounding.heard.reset(before)
            for text in told:
                _warn(f"bodies {part.first} to {part.last - 1}: {text}")


def _warn(text: str) -> None:
    """Warn here and, of a worker, where its work was asked for."""
    tell: Callable[..., Any] = warnings.warn
    if "distributed" in sys.modules:
        from distributed import warn as tell
    tell(text, rounding.StepWarning)


@dataclass(frozen=True, eq=False)
class _Bodies:
    """Initial states in chunks: Dask arrays, or what all bodies share."""

    scene: Scene
    given: tuple[Any, ...]
    sizes: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, values: Sequence[Any], chunks: Any, *, flag: bool) -> _Bodies:
        """The same from whatever a user gives: what is not lazy is checked, of the rest the shape.

        Raises ``ValueError`` or ``TypeError`` as ``propagate`` does.
        """
        as_scene(scene)
        names = ("q0", "w0", "v0", "r0")
        lazy = {k: x for k, x in zip(names, values, strict=True) if isinstance(x, da.Array)}
        for name, x in lazy.items():
            if any(math.isnan(size) for size in x.shape):
                raise ValueError(
                    f"{name}: found chunks of unknown size; accepted: compute_chunk_sizes()"
                )
        like = [
            np.broadcast_to(np.ones((), x.dtype), x.shape) if isinstance(x, da.Array) else x
            for x in values
        ]
        start, beside = initial(scene, like, flag=flag)
        known: dict[str, Any] = {**beside, "q0": start, **lazy}
        rows = [len(x) for x in known.values() if x.ndim == 2]
        if not rows:
            raise ValueError("q0: found one body; accepted: (N, 4), or another with N rows")
        n = max(rows)
        scene.packed(n)  # which refuses other numbers of bodies
        sizes = _sizes(chunks, n, [x for x in lazy.values() if x.ndim == 2 and len(x) == n])
        given = tuple(_chunked(known[k], n, sizes) if k in known else None for k in names)
        return cls(scene, given, sizes)

    def mapped(self, function: Callable[..., Any]) -> Any:
        """``function(scene, states)`` of each chunk, as a Dask array of a block each."""
        ends = np.cumsum(self.sizes).tolist()
        own = self.scene.packed(None).params.ndim == 2
        lazy = [x for x in self.given if isinstance(x, da.Array)]
        work = delayed(_Work(function, None if own else self.scene), traverse=False)
        name = f"bodies-{uuid4().hex}"
        graph: dict[Any, Any] = {}
        # what comes with the graph is part of each task: a task of its own takes milliseconds
        for i, (a, b) in enumerate(zip([0, *ends[:-1]], ends, strict=True)):
            part = _Part(
                a, b, self.scene[a:b] if own else None, [_rows(x, a, b) for x in self.given]
            )
            keys = [(x.name, i, 0) if x.ndim == 2 else (x.name, 0) for x in lazy]
            graph[name, i] = (_worked, work.key, part, *keys)
        needed = HighLevelGraph.from_collections(name, graph, dependencies=[*lazy, work])
        return da.Array(needed, name, ((1,) * len(self.sizes),), meta=_nothing(1, object))

    def array(
        self, runs: Any, name: str, saves: tuple[int, ...], kind: Any, tail: tuple[int, ...]
    ) -> Any:
        """One of the arrays that chunks give."""
        chunks = (*((s,) for s in saves), self.sizes, *((k,) for k in tail))
        new = [k for k in range(len(chunks)) if k != len(saves)]
        return runs.map_blocks(
            _named, name, chunks=chunks, new_axis=new, meta=_nothing(len(chunks), kind)
        )

    def merged(self, merge: Callable[..., Any], function: Callable[..., Any]) -> Any:
        """``merge(results)`` of what all chunks give, to be computed."""
        blocks = self.mapped(function).to_delayed().tolist()
        return delayed(merge, pure=False)(blocks)


def _sizes(chunks: Any, n: int, lazy: list[Any]) -> tuple[int, ...]:
    """Bodies of each chunk."""
    if chunks is None and lazy:
        return tuple(map(int, lazy[0].chunks[0]))
    if chunks is None or isinstance(chunks, (int, np.integer)):
        size = _CHUNK if chunks is None else checks.whole("chunks", chunks, 1)
        return tuple(min(size, n - a) for a in range(0, n, size))
    found = tuple(checks.whole("chunks", size, 1) for size in chunks)
    if sum(found) != n:
        raise ValueError(f"chunks: found {sum(found)} bodies in all; accepted: {n}")
    return found


def _chunked(x: Any, n: int, sizes: tuple[int, ...]) -> Any:
    """An array whose chunks, if it has any, are those of bodies; or one row, which all share."""
    if x.ndim == 2 and len(x) < n:
        x = x[0]
    return x.rechunk((sizes, -1)[2 - x.ndim :]) if isinstance(x, da.Array) else x


def _rows(x: Any, first: int, last: int) -> Any:
    """The bodies of a chunk."""
    if isinstance(x, da.Array):
        return _LATER
    return x if x is None or x.ndim == 1 else x[first:last]


def _nothing(ndim: int, kind: Any) -> NDArray[Any]:
    return np.empty((0,) * ndim, dtype=kind)


def _method(
    scene: Scene,
    method: str | Method | None,
    representation: str | Attitude,
    compensated: bool = False,
    normalise: str | int = "output",
) -> tuple[Method, str | Method]:
    """A method that fits the whole ensemble, and how it is sent."""
    record = chosen(as_scene(scene), method, representation, compensated, normalise).method
    return record, record.name if METHODS.get(record.name) is record else record


def _case(
    scene: Scene, name: str, run: Any, representation: str | Attitude, dtype: str
) -> tuple[Case, int]:
    if not (isinstance(run, (tuple, list)) and len(run) == 2):
        raise TypeError(f"{name}: found {checks.brief(run)}; accepted: (method, number of steps)")
    sent = _method(scene, run[0], representation)[1]
    kind = checks.precision(dtype).name
    return Case(sent, representation, kind), checks.whole(name, run[1], 1)


# on a worker


def _worked(work: _Work, part: _Part, *lazy: Any) -> Any:
    return work(part, *lazy)


def _named(found: dict[str, Any], name: str) -> Any:
    return found[name]


def _propagated(
    scene: Scene, states: Sequence[Any], names: Sequence[str], options: dict[str, Any]
) -> dict[str, Any]:
    q0, w0, v0, r0 = states
    run = run_chunk(scene, q0, w0, v0=v0, r0=r0, n_threads=1, resumable=False, **options)
    return {name: getattr(run, name) for name in names}


def _watched(scene: Scene, states: Sequence[Any], options: dict[str, Any]) -> dict[str, Any]:
    q0, w0, v0, r0 = states
    seen = watch_chunk(scene, q0, w0, v0=v0, r0=r0, n_threads=1, resumable=False, **options)
    measures = {name: getattr(seen, name) for name in _MEASURES}
    return {
        **{name: None if x is None else Measure.joined([x]) for name, x in measures.items()},
        "saves": seen.saves,
        "bodies": seen.trajectory.status.size,
        "flags": Counter(seen.trajectory.status_counts()),
    }


def _joined(chunks: list[dict[str, Any]]) -> Drifts:
    def joined(name: str) -> Any:
        each = [chunk[name] for chunk in chunks]
        return None if each[0] is None else Measure.joined(each)

    return Drifts(
        **{name: joined(name) for name in _MEASURES},
        saves=chunks[0]["saves"],
        bodies=sum(chunk["bodies"] for chunk in chunks),
        flags=dict(sum((chunk["flags"] for chunk in chunks), Counter())),
    )


def _measured(
    scene: Scene,
    states: Sequence[Any],
    cases: list[tuple[Case, int]],
    known: tuple[Case, int] | None,
    t_end: float,
    t0: float,
) -> Any:
    """Errors of each case and what they are against."""
    rounding.heard.set([])  # steps are too large on purpose
    ensemble = Ensemble.of(scene, *states)
    problem = Problem(ensemble.take(np.arange(ensemble.size)), t_end, t0, n_threads=1)
    if known is None:
        against = found_reference(problem)
        end, source, own = against.end, against.source, float(np.max(against.own_error))
    else:
        case, n = known
        end, coarse = problem.end(case, n), problem.end(case, n // 2)
        source = f"{case.name} at {t_end / n:.4g} s"
        own = float(angle_between(end.q, coarse.q).max())
    found = []
    for case, n in cases:
        replace(problem, t_end=t_end / n).run(case, 1)  # which compiles
        begin = perf_counter()
        run = problem.run(case, n)
        seconds = perf_counter() - begin
        last = last_state(run)
        rate = None if end.w is None else np.linalg.norm(last.w - end.w, axis=-1)
        defect = float(np.abs(run.defect).max())
        error = angle_between(last.q, end.q)
        found.append((seconds, error, defect, rate, Counter(run.status_counts())))
    return found, source, own


def _table(
    chunks: list[Any], kind: str, cases: list[tuple[Case, int]], t_end: float
) -> WorkPrecision:
    """All chunks' errors in one table."""
    ladders: dict[Case, list[Rung]] = {}
    for (case, n), parts in zip(
        cases, zip(*(found for found, *_ in chunks), strict=True), strict=True
    ):
        seconds, errors, defects, rates, flags = zip(*parts, strict=True)
        counts: Counter[str] = sum(flags, Counter())
        rung = Rung(
            n_steps=n,
            seconds=sum(seconds),
            error=np.concatenate(errors),
            defect=max(defects),
            rate_error=None if rates[0] is None else np.concatenate(rates),
            status=", ".join(f"{name} {count}" for name, count in counts.items()),
        )
        ladders.setdefault(case, []).append(rung)
    rows = []
    for case, rungs in ladders.items():
        rungs.sort(key=lambda rung: rung.n_steps)
        rows += ladder_rows(kind, case, t_end, rungs, case.record.order_of(kind))
    n_bodies = rungs[0].error.size
    _, source, _ = chunks[0]
    own = max(own for *_, own in chunks)
    return WorkPrecision(
        rows=rows,
        t_end=t_end,
        n_bodies=n_bodies,
        sampled=n_bodies,
        reference=source,
        reference_error=own,
        confirmation="not confirmed by another method",
    )
