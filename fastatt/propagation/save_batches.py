"""How a run of steps goes: in one go, or in pieces for a sink or a file."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine import pool
from fastatt.engine.run import Run, Span
from fastatt.engine.status import Status
from fastatt.propagation.options import Handling, few
from fastatt.propagation.trajectory import Results, Trajectory

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

# s from one writing of a run's end to the next, and body-steps between two looks at the clock
_WRITTEN, _CHECKED = 10.0, 200_000_000


def go(plan: Plan, run: Run, span: Span, handling: Handling, found: Any = None) -> None:
    """Steps of a span, of a run's bodies; ``found()`` gives the fields of their trajectory."""
    run.reset()
    width, (_, n) = plan.job.width, run.bodies
    if plan.choice.device:
        run.part(span, 0, 1)
        if handling.done is not None:
            handling.done(n * (span.last - span.first))
        return
    try:
        pool.run_ensemble(
            run.part, span, (n, width), handling.threads, handling.done, calls=plan.calls
        )
    except pool.InterruptedRun as stopped:
        if found is None:
            raise
        fields = found()
        saved = np.array(plan.clock.saved)
        for first, last, done in stopped.reached:
            bodies = slice(first * width, last * width)
            if done < span.n_steps:
                fields["status"][bodies] = Status.UNFINISHED
                for array in (fields["state"], fields["norm_error"], *fields["carried"].values()):
                    array[(saved > done) | (done == span.first), bodies] = np.nan
        stopped.trajectory = Trajectory(**fields)
        raise


def piecewise(plan: Plan, run: Run, t: NDArray[np.float64], one_body: bool, how: Any) -> Trajectory:
    """A few saves at a time, each handed out once, or a few steps; the final states."""
    handling, begin, end = how
    span, results = plan.span, Results(*run.results)
    written = perf_counter()
    pieces = _pieces(plan, handling.sink is not None)
    if handling.sink is not None and begin not in {span.origin, *(last for last, _ in pieces)}:
        raise ValueError(
            f"resume: the checkpoint is of a run that saved after step {begin}, where this one "
            "does not; accepted: the same call again, or no file"
        )
    is_over = span.origin < begin == span.n_steps
    for last, slots in pieces:
        if last <= begin and last < span.n_steps:
            continue
        before = (slots[1] if len(slots) > 1 else 1) - 1
        slot = 1 - before if handling.sink is not None else span.slot
        piece = replace(span, first=max(begin, span.origin), last=last, slot=slot)
        if is_over:  # its last states are handed out again, as the first
            piece, slots = replace(piece, origin=last), slots[:1]  # noqa: PLW2901
        go(plan, run, piece, handling)
        begin = last
        if handling.sink is not None and not is_over:
            # the initial save, with which all pieces begin, is handed out with the first
            new = slice(min(before, 1), len(slots))
            part = results.saves(new)._replace(status=results.status.copy())
            handling.sink(Trajectory(**plan.handed.fields(t[slots[new]], part, one_body)))
        due = last == span.n_steps or perf_counter() - written > _WRITTEN
        if handling.checkpoint is not None and due:
            end(last).save(handling.checkpoint)
            written = perf_counter()
    if handling.sink is None:
        return Trajectory(**plan.handed.fields(t, results, one_body))
    final = results.saves(slice(len(slots) - 1, len(slots)))
    return Trajectory(**plan.handed.fields(t[-1:], final, one_body))


def _pieces(plan: Plan, saves: bool) -> list[tuple[int, list[int]]]:
    """(last step, slots of the saves on the way) of each piece of a run."""
    saved, span = plan.clock.saved, plan.span
    if saves:
        return [(saved[slots[-1]], slots) for slots in few(len(saved))]
    each = span.end_of_piece(0, _CHECKED // plan.n_bodies)
    ends = [*range(span.end_of_piece(span.origin, each), span.n_steps, each), span.n_steps]
    return [(last, [0]) for last in ends]
