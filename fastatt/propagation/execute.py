"""Execution of a planned run: all steps at once, or a few saves at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt import rounding
from fastatt.closed_form import evaluate, form_of, turned
from fastatt.engine.pool import InterruptedRun
from fastatt.engine.run import Results
from fastatt.engine.status import Status
from fastatt.engine.tape import Piece, Steps
from fastatt.propagation import limits
from fastatt.propagation.end import MOST
from fastatt.propagation.histories import History, check_memory
from fastatt.propagation.initial import Given
from fastatt.propagation.options import RING, RunOptions, TimedClock, ring_slots, save_batches
from fastatt.propagation.trajectory import Trajectory
from fastatt.threads import progress_bar

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

#: bodies of an ensemble that are run at a time, so that working memory is a small share
PART = 1 << 19
# s between two checkpoints
_WRITTEN = 10.0

Times = NDArray[np.float64]
Done = Callable[[int], object]
Deliver = Callable[[Trajectory], None]


def execute(plan: Plan, given: Given, t0: float, options: RunOptions) -> Trajectory:
    """The trajectory of a plan from initial values that were checked.

    Raises ``MemoryError`` if the saves do not fit.
    """
    clock, shape = plan.clock, (plan.clock.saves, plan.n_bodies, plan.width)
    takers: list[Callable[[Trajectory], object]] = []
    if options.on_save is not None:
        takers.append(options.on_save)
    elif options.file is None:
        check_memory(shape, plan.kind)
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
                run = _closed_form(plan, given, times, options, deliver if takers else None)
            else:
                run = _run(plan, given, t0, times, options, deliver if takers else None, done)
        except InterruptedRun as stopped:
            if history is not None:
                saves, status = history.saves, np.full(shape[1], Status.UNFINISHED, np.uint8)
                results = history.results(saves, status)
                stopped.trajectory = plan.trajectory(times[:saves], results, given.one_body)
            raise
    limits.warn_of_status(run.status)
    if history is None:
        return run
    results = history.results(len(times), run.status)
    if run.found is not None:
        results = results._replace(event_times=run.found)
    return plan.trajectory(times, results, given.one_body, run.end)


def _closed_form(
    plan: Plan, given: Given, times: Times, options: RunOptions, deliver: Deliver | None
) -> Trajectory:
    """Evaluate the closed form at all saves, or at a few at a time, and return the last."""

    def at(saves: slice) -> Trajectory:
        results = _closed_form_at(plan, given, saves, options.n_threads)
        return plan.trajectory(times[saves], results, given.one_body)

    if deliver is None:
        return at(slice(None))
    for batch in save_batches(len(times)):
        deliver(at(slice(*batch)))
    return at(slice(len(times) - 1, None))


def _closed_form_at(plan: Plan, given: Given, saves: slice, threads: int) -> Results:
    """A plan's states at some of its saves; warns if rounding leaves few digits of the angles."""
    kind, stored, form = plan.kind, plan.attitude.stored, form_of(plan.scene)
    since = plan.clock.since[saves]
    results = plan.results(len(since))
    results.saves[..., -1] = results.status[...] = 0
    out = results.saves[..., :-1]
    with np.errstate(over="ignore", invalid="ignore"):
        evaluate(
            form, (given.q, given.y), since.astype(kind), threads,
            (out[..., :stored], out[..., stored:]), plan.attitude,
        )  # fmt: skip
        total = results.saves.sum()
        # |w| and what it gains are below twice their largest component
        largest = max(given.y.max(), -given.y.min()) + float(form.gain.max())
        most = 2.0 * largest * max(abs(since[0]), abs(since[-1]))
    if not most <= rounding.most_turned(kind) ** 0.5:
        angles = turned(given.y, since, form.gain)
        if text := rounding.of_angles(angles, kind):
            rounding.warn(f"t: found rotations by {text}")
        far = angles > rounding.most_turned(kind)
        results.status[...] = far * np.uint8(Status.STEP_TOO_LARGE)
    if not np.isfinite(total):  # else every save is finite
        bad = ~np.isfinite(results.saves).all(axis=(0, 2))
        results.status[...] |= bad * np.uint8(Status.NON_FINITE)
    return results


def _run(
    plan: Plan, given: Given, t0: float, times: Times, options: RunOptions,
    deliver: Deliver | None, done: Done,
) -> Trajectory:  # fmt: skip
    """Take all steps, in pieces; return all saves, or deliver a few at a time and return the last.

    Bodies of each step size are run together, and a large ensemble in groups, one after the other.
    """
    clock, start = plan.clock, options.start
    batches = [] if deliver is None else save_batches(clock.saves)
    results = plan.results(clock.saves if deliver is None else min(clock.saves, 1 + RING))
    squares = np.zeros(plan.n_bodies, plan.kind)
    warned = not plan.is_short and plan.warn_of_first(given)
    is_one = deliver is not None or options.checkpoint is not None or start is not None
    groups = _groups(plan, plan.n_bodies if is_one else PART)
    for k, (rows, h) in enumerate(groups):
        own = results.of_bodies(rows)
        steps = plan.steps(h, t0, start, ring=deliver is not None)
        run, left = plan.started(given, t0, own, rows, steps, start), batches[::-1]
        # a short run is over before Ctrl-C could be answered
        is_brief = plan.is_short and options.n_threads == 1 and not plan.calls
        is_brief = is_brief and run.search is None and not is_one and len(groups) == 1
        pool = None if is_brief else plan.pool(own.status.size, options.n_threads)
        pace = pool.pace if pool else partial(int, steps.length)
        saved, position, written = 0, steps.first, perf_counter()
        stops = [b - 1 for _, b in batches[:-1]]
        for piece in steps.pieces(t0, pace, stops):
            try:
                run.advance(piece, pool)
            except InterruptedRun as stopped:
                if deliver is None:
                    reached = saved, piece, steps, stopped.finished
                    _leave_unfinished(plan, results, own, groups[: k + 1], reached)
                    stopped.trajectory = plan.trajectory(times, results, given.one_body)
                raise
            if deliver is None:
                done(own.status.size * _share(steps, position, piece.position, clock.n_steps))
            elif left and piece.saved >= left[-1][1]:
                _deliver(plan, results, times, left.pop(), given.one_body, deliver)
            is_over = piece.position == steps.length
            is_due = clock.ends is None if is_over else perf_counter() - written > _WRITTEN
            if options.checkpoint is not None and is_due and piece.whole >= 0:
                plan.end(given, run, t0, piece.whole).save(options.checkpoint)
                written = perf_counter()
            saved, position = piece.saved, piece.position
        squares[rows] = run.squares
        if not isinstance(rows, slice):
            results.put(rows, own)
    end = plan.end(given, run, t0, clock.end) if _keeps_end(plan, options) else None
    if not warned:
        plan.warn_after(given, np.sqrt(squares))
    if deliver is None:
        return plan.trajectory(times, results, given.one_body, end)
    final = int(ring_slots(clock.saves)[-1])
    last = results._replace(saves=results.saves[final : final + 1])
    return plan.trajectory(times[-1:], last, given.one_body, end)


def _groups(plan: Plan, most: int) -> list[tuple[Any, float]]:
    """Bodies that are run together, by their rows, and their step size."""
    clock, n = plan.clock, plan.n_bodies
    if not clock.is_per_body:
        return [(slice(a, min(a + most, n)), clock.h) for a in range(0, n, most)]
    sizes = clock.steps
    each = sorted(np.unique(sizes).tolist(), key=abs)
    return [(np.flatnonzero(sizes == h), h) for h in each]


def _share(steps: Steps, first: int, last: int, n_steps: int) -> int:
    """The part of a number of steps that two positions are apart."""
    until = [
        n_steps * (x - steps.first) // max(1, steps.length - steps.first) for x in (first, last)
    ]
    return until[1] - until[0]


def _deliver(
    plan: Plan, results: Results, times: Times, batch: tuple[int, int], one_body: bool,
    deliver: Deliver,
) -> None:  # fmt: skip
    """Deliver a batch of saves; slot 0 is the initial one's."""
    a, b = batch
    first = min(a, 1)
    new = Results(
        results.saves[first : first + b - a], results.status.copy(), results.event_times.copy()
    )
    deliver(plan.trajectory(times[a:b], new, one_body))


def _keeps_end(plan: Plan, options: RunOptions) -> bool:
    is_small = plan.n_bodies <= min(MOST, PART)
    clock = plan.clock
    ends_on_step = clock.ends is None and not isinstance(clock, TimedClock)
    return options.keep_end and is_small and ends_on_step


def _leave_unfinished(
    plan: Plan, results: Results, own: Results, groups: list[tuple[Any, float]],
    reached: tuple[int, Piece, Steps, list[tuple[int, int]]],
) -> None:  # fmt: skip
    """Flag the bodies that did not reach the end; their later saves are NaN.

    The last of the ``groups`` has ``own`` results; ``reached`` are its saves before the piece that
    was interrupted, and the tiles that finished it.
    """
    n, width, (saved, piece, steps, finished) = plan.n_bodies, plan.job.width, reached
    saves, is_over = np.zeros(n, np.int64), np.zeros(n, bool)
    for rows, _ in groups:
        saves[rows], is_over[rows] = plan.clock.saves, True
    rows = groups[-1][0]
    if not isinstance(rows, slice):
        results.put(rows, own)
    bodies = np.arange(n)[rows]
    saves[bodies], is_over[bodies] = saved, False
    for a, b in finished:
        some = bodies[a * width : b * width]
        saves[some], is_over[some] = piece.saved, piece.position == steps.length
    results.status[~is_over] = Status.UNFINISHED
    results.saves[np.arange(plan.clock.saves)[:, None] >= saves] = np.nan
