"""Execution of a planned run: all steps at once, or a few saves at a time."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt.engine.pool import InterruptedRun, Pool
from fastatt.engine.run import Results
from fastatt.engine.status import Status
from fastatt.propagation import limits
from fastatt.propagation.end import MOST
from fastatt.propagation.histories import History, check_room
from fastatt.propagation.initial import Initial
from fastatt.propagation.options import RunOptions
from fastatt.propagation.trajectory import Trajectory
from fastatt.threads import progress_bar

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

#: bodies of an ensemble that are run at a time, so that working memory is a small share
PART = 1 << 19
# body-steps; before a longer run the first step of each body is checked
_LONG = 1_000_000
# s between two checkpoints
_WRITTEN = 10.0

Times = NDArray[np.float64]
Done = Callable[[int], object]
Deliver = Callable[[Trajectory], None]


def execute(plan: Plan, start: Initial, t0: float, options: RunOptions) -> Trajectory:
    """The trajectory of a plan from initial values that were checked.

    Raises ``MemoryError`` if the saves do not fit.
    """
    clock, shape = plan.clock, (plan.clock.saves, plan.n_bodies, plan.width)
    takers: list[Callable[[Trajectory], object]] = []
    if options.on_save is not None:
        takers.append(options.on_save)
    elif options.file is None:
        check_room(shape, plan.kind)
    times = plan.times(t0)
    history = None
    if options.file is not None:
        history = History(options.file, shape, plan.kind)
        takers.append(history)
    total, unit = plan.n_bodies * clock.n_steps, "step"
    if takers:
        total, unit = clock.saves, "save"
    with progress_bar(options.progress, total, unit) as done:

        def deliver(batch: Trajectory) -> None:
            for take in takers:
                take(batch)
            done(batch.t.size)

        try:
            if plan.choice.method.is_exact:
                run = _closed_form(plan, start, times, options, deliver if takers else None)
            else:
                run = _run(plan, start, t0, times, options, deliver if takers else None, done)
        except InterruptedRun as stopped:
            if history is not None:
                saves, status = history.saves, np.full(shape[1], Status.UNFINISHED, np.uint8)
                results = history.results(saves, status)
                stopped.trajectory = plan.trajectory(times[:saves], results, start.one_body)
            raise
    limits.warn_of_status(run.status)
    if history is None:
        return run
    results = history.results(len(times), run.status)
    if run.crossings is not None:
        results = results._replace(event_times=run.crossings)
    return plan.trajectory(times, results, start.one_body, run.end)


def _closed_form(
    plan: Plan, start: Initial, times: Times, options: RunOptions, deliver: Deliver | None
) -> Trajectory:
    """Evaluate the closed form at all saves, or at a few at a time, and return the last."""

    def of(saves: slice) -> Trajectory:
        results = _closed_form_at(plan, start, saves, options.n_threads)
        return plan.trajectory(times[saves], results, start.one_body)

    if deliver is None:
        return of(slice(None))
    for batch in plan.clock.batches:
        deliver(of(slice(*batch)))
    return of(slice(len(times) - 1, None))


def _closed_form_at(plan: Plan, start: Initial, saves: slice, threads: int) -> Results:
    """A plan's states at some of its saves; warns if rounding leaves few digits of the angles."""
    from fastatt.closed_form import evaluate, form_of, turned

    kind, stored, form = plan.kind, plan.attitude.stored, form_of(plan.scene)
    since = plan.clock.since[saves]
    results = plan.results(len(since))
    results.saves[..., -1] = results.status[...] = 0
    out = results.saves[..., :-1]
    with np.errstate(over="ignore", invalid="ignore"):
        evaluate(
            form, (start.q, start.y), since.astype(kind), threads,
            (out[..., :stored], out[..., stored:]), plan.attitude,
        )  # fmt: skip
        # a phase that overflows does so at all later times too
        total = results.saves[-1].sum()
        # |w| and what it gains are below twice their largest component
        largest = max(start.y.max(), -start.y.min()) + float(form.gain.max())
        most = 2.0 * largest * max(abs(since[0]), abs(since[-1]))
    if not most <= rounding.most_turned(kind) ** 0.5:
        angles = turned(start.y, since, form.gain)
        if text := rounding.of_angles(angles, kind):
            rounding.warn(f"t: found rotations by {text}")
        far = angles > rounding.most_turned(kind)
        results.status[...] = far * np.uint8(Status.STEP_TOO_LARGE)
    if not np.isfinite(total):
        bad = ~np.isfinite(results.saves).all(axis=(0, 2))
        results.status[...] |= bad * np.uint8(Status.NON_FINITE)
    return results


def _run(
    plan: Plan, start: Initial, t0: float, times: Times, options: RunOptions,
    deliver: Deliver | None, done: Done,
) -> Trajectory:  # fmt: skip
    """Take all steps, in pieces; return all saves, or deliver a few at a time and return the last.

    Bodies of each step size are run together, and a large ensemble in groups, one after the other.
    """
    clock, resumed = plan.clock, options.resumed
    batches = [] if deliver is None else clock.batches
    results = plan.results(max((b - a for a, b in batches), default=clock.saves))
    squares = np.zeros(plan.n_bodies, plan.kind)
    warned = plan.n_bodies * clock.n_steps > _LONG and limits.warn(plan, start)
    is_one = deliver is not None or options.checkpoint is not None or resumed is not None
    groups = _groups(plan, plan.n_bodies if is_one else PART)
    for k, (rows, h) in enumerate(groups):
        group = results.of_bodies(rows)
        steps = plan.steps(h, t0, resumed, ring=deliver is not None)
        run, left = plan.started(start, t0, group, rows, steps, resumed), batches[::-1]
        pool = Pool(plan.program, group.status.size, options.n_threads)
        counted, saved, written = 0, 0, perf_counter()
        for piece in steps.pieces(t0, pool.pace, [end - 1 for _, end in batches[:-1]]):
            is_last = piece.position == steps.length
            try:
                run.advance(piece, pool)
            except InterruptedRun as stopped:
                if deliver is None:
                    group.saves[saved:], group.status[:] = np.nan, Status.UNFINISHED
                    results.put(rows, group)
                    for others, _ in groups[k + 1 :]:
                        results.saves[:, others] = np.nan
                        results.status[others] = Status.UNFINISHED
                    stopped.trajectory = plan.trajectory(times, results, start.one_body)
                raise
            saved = piece.saved
            if deliver is None:
                share = (piece.position - steps.first) / max(1, steps.length - steps.first)
                taken = round(clock.n_steps * share)
                done(group.status.size * (taken - counted))
                counted = taken
            elif left and saved >= left[-1][1]:
                first, last = left.pop()
                # flags and times of events change later
                flags, crossings = results.status.copy(), results.event_times.copy()
                batch = Results(results.saves[: last - first], flags, crossings)
                deliver(plan.trajectory(times[first:last], batch, start.one_body))
            is_due = clock.t_end is None if is_last else perf_counter() - written > _WRITTEN
            if options.checkpoint is not None and is_due and piece.whole >= 0:
                plan.end(start, run, t0, piece.whole).save(options.checkpoint)
                written = perf_counter()
        squares[rows] = run.squares
        results.put(rows, group)
    ends_on_step = clock.t_end is None and not clock.is_per_body
    keeps_end = options.keep_end and ends_on_step and plan.n_bodies <= min(MOST, PART)
    end = plan.end(start, run, t0, clock.end) if keeps_end else None
    if clock.n_steps and not warned:
        limits.warn(plan, start, np.sqrt(squares), results.status)
    if deliver is not None:
        times, final = times[-1:], clock.slots[-1]
        results = results._replace(saves=results.saves[final : final + 1])
    return plan.trajectory(times, results, start.one_body, end)


def _groups(plan: Plan, most: int) -> list[tuple[Any, float]]:
    """Bodies that are run together, by their rows, and their step size."""
    clock, n = plan.clock, plan.n_bodies
    if not clock.is_per_body:
        return [(slice(a, min(a + most, n)), clock.h) for a in range(0, n, most)]
    sizes = clock.dt
    each = sorted(np.unique(sizes).tolist(), key=abs)
    return [(np.flatnonzero(sizes == h), h) for h in each]
