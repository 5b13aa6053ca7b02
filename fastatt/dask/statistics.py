"""Drift and precision of all bodies, merged from chunks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from fastatt import checks, rounding
from fastatt.arrays import angle_between
from fastatt.attitudes import Attitude
from fastatt.dask.chunks import Bodies
from fastatt.dask.runs import sent
from fastatt.methods import Method
from fastatt.propagation.drift_statistics import Measure
from fastatt.propagation.drift_statistics import drift_statistics as chunk_statistics
from fastatt.propagation.ensemble import Ensemble
from fastatt.propagation.initial import INITIAL
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.measure import Case, Problem, Row, counted, last_state, row_of, with_orders
from fastatt.trade.reference import reference
from fastatt.trade.work_precision import WorkPrecision, duration

_OPTIONS = (
    *("dt", "n_steps", "method", "representation", "dtype"),
    *("t0", "compensated", "normalise", "invalid"),
)


@dataclass(frozen=True)
class Drifts:
    """The drift over all saves of all bodies, as :func:`fastatt.drift` defines it.

    Attributes
    ----------
    norm, orthogonality : Measure
        Norm and orthogonality errors, with ``maximum`` (1,) and ``percentile(p)`` (1,).
    energy, momentum : Measure or None
        Relative changes of energy and angular momentum; None if the scene does not conserve them.
    saves : int
        Number of saves of a body.
    bodies : int
        Number of bodies.
    flags : dict of str to int
        Number of bodies with each flag.
    """

    norm: Measure
    orthogonality: Measure
    energy: Measure | None
    momentum: Measure | None
    saves: int
    bodies: int
    flags: dict[str, int]


def drift_statistics(
    scene: Scene,
    q0: Any,
    w0: Any = None,
    *,
    save_every: int,
    v0: Any = None,
    r0: Any = None,
    s0: Any = None,
    chunks: int | Sequence[int] | None = None,
    **options: Any,
) -> Any:
    """Statistics of the drift over all bodies, lazily; no history is stored.

    A chunk returns 2 kB.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like or dask.array.Array of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`propagate`.
    w0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    save_every : int
        Number of steps between two saves at which the drift is measured.
    v0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like or dask.array.Array of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    chunks : int or sequence of int, optional
        Number of bodies in a chunk, or in each, as in :func:`propagate`.
    **options : dict
        Further arguments of :func:`fastatt.drift_statistics`, such as ``dt``, ``n_steps`` and
        ``method``.

    Returns
    -------
    dask.delayed.Delayed
        A lazy :class:`Drifts`.

    Raises
    ------
    ValueError, TypeError
        If the scene or initial states do not fit; for other arguments when it is computed.
    """
    if wrong := sorted(options.keys() - _OPTIONS):
        raise TypeError(f"{wrong[0]}: found; accepted: {', '.join(_OPTIONS)}")
    flag = options.get("invalid") == "flag"
    bodies = Bodies.of(scene, (q0, w0, v0, r0, s0), chunks, flag=flag)
    options["method"] = sent(scene, options.get("method"), options.get("representation", "quat"))[1]
    return bodies.merged(
        _joined, partial(_statistics, options={**options, "save_every": save_every})
    )


def work_precision(
    scene: Scene,
    q0: Any,
    w0: Any = None,
    *,
    t_end: float,
    runs: Sequence[tuple[str | Method, int]],
    v0: Any = None,
    r0: Any = None,
    s0: Any = None,
    t0: float = 0.0,
    chunks: int | Sequence[int] | None = None,
    representation: str | Attitude = "quat",
    dtype: str = "float64",
) -> Any:
    """Errors of methods and step sizes on all bodies, lazily.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like or dask.array.Array of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`propagate`.
    w0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    t_end : float
        Duration, s, above 0.
    runs : sequence of tuple
        (method, number of steps) of each row.
    v0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial velocities along body axes, m/s.
    r0 : array_like or dask.array.Array of shape (3,) or (N, 3), optional
        Initial positions along inertial axes, m.
    s0 : array_like or dask.array.Array of shape (n,) or (N, n), optional
        Initial values of the scene's states.
    t0 : float, default 0.0
        Time of the initial state, s.
    chunks : int or sequence of int, optional
        Number of bodies in a chunk, or in each, as in :func:`propagate`.
    representation : str or Attitude, default "quat"
        The representation of all runs.
    dtype : str, default "float64"
        The precision of all runs.

    Returns
    -------
    dask.delayed.Delayed
        A lazy :class:`fastatt.WorkPrecision`. Without a closed form, each chunk computes its own
        reference, so that errors depend on the chunks within the reference's error. Times are those
        of one run on one thread of a worker, which may have other work. One task collects all
        errors, 16 bytes for each run and body.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.
    """
    as_scene(scene)
    if not runs:
        raise ValueError("runs: found none; accepted: (method, number of steps), one or more")
    kind = checks.precision(dtype).name
    cases = []
    pairs: Sequence[Any] = runs
    for run in pairs:
        if not (isinstance(run, (tuple, list)) and len(run) == 2):
            raise TypeError(f"runs: found {checks.brief(run)}; accepted: (method, number of steps)")
        method = sent(scene, run[0], representation)[1]
        cases.append((Case(method, representation, kind), checks.whole("runs", run[1], 1)))
    bodies = Bodies.of(scene, (q0, w0, v0, r0, s0), chunks, flag=False)
    seconds, begin = duration(t_end), checks.real("t0", t0)
    work = partial(_measured, cases=cases, t_end=seconds, t0=begin)
    return bodies.merged(partial(_table, kind=scene.kind, cases=cases, t_end=seconds), work)


def _statistics(scene: Scene, states: Sequence[Any], options: dict[str, Any]) -> Drifts:
    """The drift of a chunk."""
    given = dict(zip(INITIAL, states, strict=True))
    seen = chunk_statistics(scene, **given, n_threads=1, **options)
    run = seen.trajectory
    return _of_parts([seen], seen.saves, run.status.size, run.status_counts())


def _joined(chunks: list[Drifts]) -> Drifts:
    """The drift of all chunks."""
    flags: Counter[str] = sum((Counter(chunk.flags) for chunk in chunks), Counter())
    return _of_parts(chunks, chunks[0].saves, sum(chunk.bodies for chunk in chunks), dict(flags))


def _of_parts(parts: Sequence[Any], saves: int, bodies: int, flags: dict[str, int]) -> Drifts:
    measures: dict[str, Any] = {}
    for name in ("norm", "orthogonality", "energy", "momentum"):
        each = [getattr(part, name) for part in parts]
        measures[name] = None if each[0] is None else Measure.joined(each)
    return Drifts(**measures, saves=saves, bodies=bodies, flags=flags)


def _measured(
    scene: Scene, states: Sequence[Any], cases: list[tuple[Case, int]], t_end: float, t0: float
) -> tuple[str, float, list[Any]]:
    """The reference of a chunk, its error, and for each case seconds, errors and flags."""
    rounding.heard.set([])  # without warnings of the large steps of a ladder
    ensemble = Ensemble.of(scene, *states)
    problem = Problem(ensemble.take(np.arange(ensemble.size)), t_end, t0, n_threads=1)
    against = reference(problem)
    end = against.end
    found = []
    for case, n in cases:
        replace(problem, t_end=t_end / n).run(case, 1)  # compiles
        begin = perf_counter()
        run = problem.run(case, n)
        seconds = perf_counter() - begin
        last = last_state(run)
        rate_error = None if end.w is None else np.linalg.norm(last.w - end.w, axis=-1)
        norm_error = float(np.abs(run.norm_error).max())
        error = angle_between(last.q, end.q)
        found.append((seconds, error, norm_error, rate_error, Counter(run.status_counts())))
    return against.source, float(np.max(against.own_error)), found


def _table(
    chunks: list[Any], kind: str, cases: list[tuple[Case, int]], t_end: float
) -> WorkPrecision:
    """The errors of all chunks in one table."""
    ladders: dict[Case, list[Row]] = {}
    for (case, n), *parts in zip(cases, *(found for *_, found in chunks), strict=True):
        seconds, errors, norm_errors, rates, flags = zip(*parts, strict=True)
        counts: Counter[str] = sum(flags, Counter())
        error = np.concatenate(errors)
        rate_error = None if rates[0] is None else np.concatenate(rates)
        measured = {"norm_error_max": max(norm_errors), "status": counted(counts)}
        row = row_of(kind, case, t_end, n, sum(seconds), error, rate_error, **measured)
        ladders.setdefault(case, []).append(row)
    rows = []
    for case, ladder in ladders.items():
        ladder.sort(key=lambda row: row.n_steps)
        rows += with_orders(ladder, case, case.record.order_of(kind))
    n_bodies = error.size
    return WorkPrecision(
        rows=rows, t_end=t_end, n_bodies=n_bodies, sampled=n_bodies, reference=chunks[0][0],
        reference_error=max(own for _, own, _ in chunks),
        confirmation="not confirmed by another method",
    )  # fmt: skip
