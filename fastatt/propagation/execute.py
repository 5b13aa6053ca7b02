"""Execution of a planned run: all steps at once, or a few saves at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine import pool
from fastatt.engine.run import Results, Run, Span
from fastatt.engine.status import Status
from fastatt.propagation import closed_forms
from fastatt.propagation.histories import History, check_memory
from fastatt.propagation.initial import Given
from fastatt.propagation.options import RING, PerBodyClock, RunOptions, save_batches
from fastatt.propagation.resume import MOST, check, check_begin, loaded
from fastatt.propagation.trajectory import Trajectory
from fastatt.threads import progress_bar

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

#: bodies of an ensemble that are run at a time, so that working memory is a small share
PART = 1 << 19
# s between two checkpoints, and body-steps after which one may be due
_WRITTEN, _CHECKED = 10.0, 200_000_000

Times = NDArray[np.float64]
Done = Callable[[int], object]
Deliver = Callable[[Trajectory], None]


def execute(plan: Plan, given: Given, t0: float, options: RunOptions) -> Trajectory:
    """The trajectory of a plan from initial values that were checked.

    Raises ``MemoryError`` if the saves do not fit, ``ValueError`` for a checkpoint of another run.
    """
    clock, shape = plan.clock, (plan.clock.saves, plan.n_bodies, plan.width)
    takers: list[Callable[[Trajectory], object]] = []
    if options.on_save is not None:
        takers.append(options.on_save)
    elif options.file is None:
        check_memory(shape, plan.kind)
    times, start, first = plan.times(t0), options.start, 0
    if options.checkpoint is not None and options.checkpoint.exists():
        start = loaded(options.checkpoint)
        check_begin(start, given, t0, clock.end)
        first = int(np.searchsorted(clock.saved, start.done, side="right"))
    if start is not None:
        check(start, plan, is_same_run=options.checkpoint is not None)
        options = options._replace(start=start)
    history = None
    if options.file is not None:
        history = History(options.file, shape, plan.kind, first)
        takers.append(history)
    total, unit = plan.n_bodies * (plan.span.last - plan.span.first), "step"
    if takers:
        total, unit = clock.saves, "save"
    with progress_bar(options.progress, total, unit) as done:

        def deliver(batch: Trajectory) -> None:
            for take in takers:
                take(batch)
            done(batch.t.size)

        try:
            if plan.choice.method.is_exact:
                run = _closed_form(plan, given, times, options, deliver if takers else None)
            elif takers:
                run = _in_batches(plan, given, t0, times, options, deliver, None)
            elif options.checkpoint is not None:
                run = _in_batches(plan, given, t0, times, options, None, done)
            else:
                run = _at_once(plan, given, t0, times, options, done)
        except pool.InterruptedRun as stopped:
            if history is not None and history.array is not None:
                saves, status = history.saves, np.full(shape[1], Status.UNFINISHED, np.uint8)
                results = history.results(saves, status)
                stopped.trajectory = plan.trajectory(times[:saves], results, given.one_body)
            raise
    if history is None or history.array is None:
        return run
    results = history.results(len(times), run.status)._replace(event_times=run.found)
    return plan.trajectory(times, results, given.one_body, run.end)


def _closed_form(
    plan: Plan, given: Given, times: Times, options: RunOptions, deliver: Deliver | None
) -> Trajectory:
    """Evaluate the closed form at all saves, or at a few at a time, and return the last."""

    def at(saves: slice) -> Trajectory:
        results = closed_forms.results_at(plan, given, saves, options.n_threads)
        return plan.trajectory(times[saves], results, given.one_body)

    if deliver is None:
        return at(slice(None))
    for batch in save_batches(len(times)):
        deliver(at(slice(*batch)))
    return at(slice(len(times) - 1, None))


def _at_once(
    plan: Plan,
    given: Given,
    t0: float,
    times: Times,
    options: RunOptions,
    done: Done,
) -> Trajectory:
    """Take all steps; a large ensemble is run in groups of bodies, one group after the other."""
    n, device = plan.n_bodies, plan.choice.device
    results = plan.results(plan.clock.saves)
    squares: list[NDArray[Any]] = []
    size, largest = n if device or options.start else PART, 0.0
    warned = not plan.is_short and plan.warn_of_first(given)
    for a in range(0, n, size):
        part = slice(a, min(a + size, n))
        run = plan.started(given, t0, results, (a, part.stop - a), options.start)
        try:
            _advance(plan, run, plan.span, options.n_threads, done)
        except pool.InterruptedRun as stopped:
            _leave_unfinished(plan, results, part, stopped.reached)
            stopped.trajectory = plan.trajectory(times, results, given.one_body)
            raise
        squares.append(run.diagnostics[0])
        largest = max(largest, run.largest_angle)
    end = plan.end(given, run, t0, plan.clock.end) if _keeps_end(plan, options) else None
    if not warned:
        plan.warn_after(given, largest, squares)
    if device is not None and device.saves is not None:
        results = results._replace(out=device.saves)
    return plan.trajectory(times, results, given.one_body, end)


def _in_batches(
    plan: Plan,
    given: Given,
    t0: float,
    times: Times,
    options: RunOptions,
    deliver: Deliver | None,
    done: Done | None,
) -> Trajectory:
    """Run a few saves, or steps, at a time; deliver the saves and return the final states."""
    clock, span, start = plan.clock, plan.span, options.start
    results = plan.results(min(clock.saves, 1 + RING))
    run = plan.started(given, t0, results, (0, plan.n_bodies), start)
    warned = not plan.is_short and plan.warn_of_first(given)
    begin, written = clock.done if start is None else start.done, perf_counter()
    batches = [(last, (0, 1)) for last in _checkpoints(plan)]
    if deliver is not None:
        batches = [(clock.saved[b - 1], (a, b)) for a, b in save_batches(clock.saves)]
        if begin not in {span.origin, *(last for last, _ in batches)}:
            raise ValueError(
                f"resume: the checkpoint is of a run that saved after step {begin}, where this one "
                "does not; accepted: the same call again, or no file"
            )
    is_over = span.origin < begin == span.n_steps
    for last, (a, b) in batches:
        if last <= begin and last < span.n_steps:
            continue
        # slot 0 keeps the initial save; of a run that is over it takes the last states
        slot = span.slot if deliver is None else 2 - max(a, 1)
        origin = last if is_over else span.origin
        steps = replace(span, first=max(begin, span.origin), last=last, slot=slot, origin=origin)
        _advance(plan, run, steps, options.n_threads, done)
        begin, new = last, slice(min(a, 1), min(a, 1) + b - a)
        if deliver is not None and not is_over:
            batch = results.saves(new)._replace(status=results.status.copy())
            if results.event_times is not None:
                batch = batch._replace(event_times=results.event_times.copy())
            deliver(plan.trajectory(times[a:b], batch, given.one_body))
        due = last == span.n_steps or perf_counter() - written > _WRITTEN
        if options.checkpoint is not None and due:
            plan.end(given, run, t0, last).save(options.checkpoint)
            written = perf_counter()
    final = 0 if is_over else new.stop - 1
    end = plan.end(given, run, t0, clock.end) if _keeps_end(plan, options) else None
    if not warned:
        plan.warn_after(given, run.largest_angle, [run.diagnostics[0]])
    last_save = results.saves(slice(final, final + 1))
    return plan.trajectory(times[-1:], last_save, given.one_body, end)


def _checkpoints(plan: Plan) -> list[int]:
    """Steps after which a checkpoint may be written, in a run without saves before its end."""
    span = plan.span
    each = span.end_of_piece(0, _CHECKED // plan.n_bodies)
    return [*range(span.end_of_piece(span.origin, each), span.n_steps, each), span.n_steps]


def _keeps_end(plan: Plan, options: RunOptions) -> bool:
    is_small = plan.n_bodies <= min(MOST, PART)
    clock = plan.clock
    ends_on_step = clock.ends is None and not isinstance(clock, PerBodyClock)
    return options.keep_end and is_small and ends_on_step


def _advance(plan: Plan, run: Run, span: Span, n_threads: int, done: Done | None) -> None:
    """Take the steps of a span; ``done`` is called with the number of body-steps."""
    n, width = run.bodies[1], plan.job.width
    # a short run is over before Ctrl-C could be answered
    is_whole = span is plan.span and n == plan.n_bodies
    is_brief = is_whole and n_threads == 1 and plan.is_short and not plan.calls
    if plan.choice.device is None and not is_brief:
        pool.run_ensemble(run.part, span, (n, width), n_threads, done, calls=plan.calls)
        return
    run.part(span, 0, -(-n // width))
    if done is not None:
        done(n * (span.last - span.first))


def _leave_unfinished(
    plan: Plan,
    results: Results,
    part: slice,
    reached: list[tuple[int, int, int]],
) -> None:
    """Flag the bodies that did not reach the end; their later saves are NaN."""
    clock, span, width = plan.clock, plan.span, plan.job.width
    saved, n = np.array(clock.saved), plan.n_bodies
    order = np.arange(n) if clock.order is None else clock.order
    ends = [(part.start + a * width, part.start + b * width, done) for a, b, done in reached]
    for a, b, done in [*ends, (part.stop, n, span.first)]:
        if done < span.n_steps:
            rows = order[a : min(b, part.stop) if a < part.stop else b]
            has_saves = done > span.first and clock.order is None
            late = np.flatnonzero(saved > done) if has_saves else np.arange(len(saved))
            results.status[rows] = Status.UNFINISHED
            results.out[late[:, None], rows] = results.norm_error[late[:, None], rows] = np.nan
