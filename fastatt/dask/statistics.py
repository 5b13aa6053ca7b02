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
from fastatt.scene.scene import Scene, as_scene
from fastatt.trade.measure import Case, Problem, Row, counted, last_state, row_of, with_orders
from fastatt.trade.reference import reference as found_reference
from fastatt.trade.work_precision import WorkPrecision, duration

_OPTIONS = (
    *("dt", "n_steps", "method", "representation", "dtype"),
    *("t0", "compensated", "normalise", "invalid"),
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


def drift_statistics(
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
    :func:`fastatt.drift_statistics`; the rest is as of :func:`propagate`. A chunk hands on 2 kB.

    Raises ``ValueError`` or ``TypeError`` for a scene or initial states that do not fit; for the
    rest when it is computed.
    """
    if wrong := sorted(options.keys() - _OPTIONS):
        raise TypeError(f"{wrong[0]}: found; accepted: {', '.join(_OPTIONS)}")
    flag = options.get("invalid") == "flag"
    bodies = Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=flag)
    options["method"] = sent(scene, options.get("method"), options.get("representation", "quat"))[1]
    return bodies.merged(_joined, partial(_statistics, options={**options, "every": every}))


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
    bodies = Bodies.of(scene, (q0, w0, v0, r0), chunks, flag=False)
    seconds, begin = duration(t_end), checks.real("t0", t0)
    work = partial(_measured, cases=cases, known=known, t_end=seconds, t0=begin)
    return bodies.merged(partial(_table, kind=scene.kind, cases=cases, t_end=seconds), work)


def _case(
    scene: Scene, name: str, run: Any, representation: str | Attitude, dtype: str
) -> tuple[Case, int]:
    if not (isinstance(run, (tuple, list)) and len(run) == 2):
        raise TypeError(f"{name}: found {checks.brief(run)}; accepted: (method, number of steps)")
    method = sent(scene, run[0], representation)[1]
    kind = checks.precision(dtype).name
    return Case(method, representation, kind), checks.whole(name, run[1], 1)


def _statistics(scene: Scene, states: Sequence[Any], options: dict[str, Any]) -> Drifts:
    """Drifts of a chunk."""
    q0, w0, v0, r0 = states
    seen = chunk_statistics(scene, q0, w0, v0=v0, r0=r0, n_threads=1, **options)
    run = seen.trajectory
    return _of_parts([seen], seen.saves, run.status.size, run.status_counts())


def _joined(chunks: list[Drifts]) -> Drifts:
    """Drifts of all chunks."""
    flags: Counter[str] = sum((Counter(chunk.flags) for chunk in chunks), Counter())
    return _of_parts(chunks, chunks[0].saves, sum(chunk.bodies for chunk in chunks), dict(flags))


def _of_parts(parts: Sequence[Any], saves: int, bodies: int, flags: dict[str, int]) -> Drifts:
    measures: dict[str, Any] = {}
    for name in ("norm", "orthogonality", "energy", "momentum"):
        each = [getattr(part, name) for part in parts]
        measures[name] = None if each[0] is None else Measure.joined(each)
    return Drifts(**measures, saves=saves, bodies=bodies, flags=flags)


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
        norm_error = float(np.abs(run.norm_error).max())
        error = angle_between(last.q, end.q)
        found.append((seconds, error, norm_error, rate, Counter(run.status_counts())))
    return found, source, own


def _table(
    chunks: list[Any], kind: str, cases: list[tuple[Case, int]], t_end: float
) -> WorkPrecision:
    """All chunks' errors in one table."""
    ladders: dict[Case, list[Row]] = {}
    for (case, n), parts in zip(
        cases, zip(*(found for found, *_ in chunks), strict=True), strict=True
    ):
        seconds, errors, norm_errors, rates, flags = zip(*parts, strict=True)
        counts: Counter[str] = sum(flags, Counter())
        error = np.concatenate(errors)
        rate_error = None if rates[0] is None else np.concatenate(rates)
        measured = {"defect_max": max(norm_errors), "status": counted(counts)}
        row = row_of(kind, case, t_end, n, sum(seconds), error, rate_error, **measured)
        ladders.setdefault(case, []).append(row)
    rows = []
    for case, ladder in ladders.items():
        ladder.sort(key=lambda row: row.n_steps)
        rows += with_orders(ladder, case, case.record.order_of(kind))
    n_bodies = error.size
    _, source, _ = chunks[0]
    own = max(own for *_, own in chunks)
    return WorkPrecision(
        rows=rows, t_end=t_end, n_bodies=n_bodies, sampled=n_bodies, reference=source,
        reference_error=own, confirmation="not confirmed by another method",
    )  # fmt: skip
