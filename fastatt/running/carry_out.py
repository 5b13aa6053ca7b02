"""A run as it was asked for: planned, in one go, over parts of a large ensemble, or to files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fastatt.engine.pool import InterruptedRun
from fastatt.engine.status import Status
from fastatt.running import limits
from fastatt.running.asked import Choice, Clock, Handling, OwnClock
from fastatt.running.histories import History, check_memory
from fastatt.running.initial import Given
from fastatt.running.plan import Plan
from fastatt.running.resume import MOST, check, check_begin, loaded
from fastatt.running.trajectory import Results, Trajectory
from fastatt.scene import Scene
from fastatt.threads import progress_bar

# bodies of an ensemble that are run at a time: what a run needs besides is small beside the whole
PART = 1 << 19
# plans that are kept with a scene, and of how many bodies
_KEPT, _FEW = 16, 1024


def carry_out(
    scene: Scene,
    choice: Choice,
    clock: Clock,
    given: Given,
    t0: float,
    handling: Handling,
    *,
    position: bool = False,
) -> Trajectory:
    """The trajectory of a run.

    Raises ``MemoryError`` for one whose saves will not fit, ``ValueError`` for one that does not
    fit the end from which it goes on.
    """
    kind = given.q.dtype
    shape = (clock.saves, given.bodies, choice.attitude.stored + given.y.shape[-1])
    if _is_in_parts(choice, clock, given.bodies, handling):
        made = partial(Plan, choice=choice, kind=kind, position=position)
        return _in_parts(made, scene, clock, given, t0, handling, shape)
    to_saves = handling.sink is not None or handling.out is not None
    if not to_saves:
        check_memory(shape, kind)
    plan = _kept(scene, given.bodies, choice, clock, kind, position)
    end, file, device = handling.start, handling.checkpoint, choice.device
    if not (to_saves or end or file or device or handling.progress):
        return plan.run(given, t0, handling)
    goes_on = end is None and file is not None and file.exists()
    if goes_on and file is not None:
        end = loaded(file)
        check_begin(end, given, t0, clock.end)
    if end is not None:
        check(end, plan)
    history = None
    if handling.out is not None:
        first = 0
        if goes_on and end is not None:
            first = int(np.searchsorted(clock.saved, end.done, side="right"))
        history = History(handling.out, shape, plan.kind, first)
    total, unit = (shape[0], "save") if to_saves else (shape[1] * clock.n_steps, "step")
    with progress_bar(handling.progress, total, unit) as done:
        sinks = [x for x in (handling.sink, history) if x is not None]
        handling = handling._replace(
            done=done if handling.progress and not to_saves else None,
            sink=partial(_deliver, sinks, done) if sinks else None,
            start=end,
        )
        try:
            run = plan.run(given, t0, handling)
        except InterruptedRun as stopped:
            if history is not None and history.array is not None:
                fields = {**plan.handed.told, **plan.handed.parts(history.array[: history.saves])}
                fields["t"] = clock.times(t0)[: history.saves]
                fields["status"] = np.full(shape[1], Status.UNFINISHED, np.uint8)
                stopped.trajectory = Trajectory(**fields, one_body=given.one_body)
            raise
    if device is not None and device.saves is not None:
        return replace(run, **plan.handed.parts(device.saves))
    if history is None or history.array is None:
        return run
    return replace(run, t=clock.times(t0), **plan.handed.parts(history.array))


def holds_end(resumable: bool | None, n: int, clock: Clock) -> bool:
    """Whether the trajectory of n bodies holds its end: as asked, else where that is small."""
    if isinstance(clock, OwnClock):
        return False
    return n <= min(MOST, PART) if resumable is None else resumable


def _is_in_parts(choice: Choice, clock: Clock, n: int, handling: Handling) -> bool:
    """Whether the ensemble is run a part at a time."""
    to_files = handling.sink or handling.checkpoint or handling.out or handling.start
    if to_files or choice.method.is_exact or choice.device:
        return False
    if isinstance(clock, OwnClock):
        return clock.steps.size > 1 or n > PART
    return n > PART and not handling.ends


def _kept(
    scene: Scene, n: int, choice: Choice, clock: Clock, kind: np.dtype[Any], position: bool
) -> Plan:
    """A plan, kept with the scene where it is small."""
    memo, key = scene.memo, (n, choice, clock, kind, position)
    is_small = n <= _FEW and not (clock.done or isinstance(clock, OwnClock) or choice.device)
    found: Plan | None = memo.get(key) if is_small else None
    if found is None:
        found = Plan(scene, n, choice, clock, kind, position=position)
        if is_small:
            while len(memo) >= _KEPT:
                memo.pop(next(iter(memo)), None)
            memo[key] = found
    return found


def _deliver(
    sinks: list[Callable[[Trajectory], object]], done: Callable[[int], object], piece: Trajectory
) -> None:
    for sink in sinks:
        sink(piece)
    done(piece.t.size)


def _in_parts(
    made: partial[Plan],
    scene: Scene,
    clock: Clock,
    given: Given,
    t0: float,
    handling: Handling,
    shape: tuple[int, int, int],
) -> Trajectory:
    """The run of a large ensemble, of a part of its bodies at a time; those of like cost together.

    A part lies in its place in the arrays; of bodies in another order it is copied there.
    """
    n, own = given.bodies, scene.rows is not None
    kind, steps, (saves, _, width) = given.q.dtype, clock.steps, shape
    check_memory(shape, kind)
    own_steps = isinstance(clock, OwnClock) and steps.size > 1
    # those with most steps first: no thread is left with them at the end
    order = np.argsort(np.abs(steps)) if own_steps else None
    plan: Plan | None = None

    def whole() -> Trajectory:
        assert plan is not None
        fields = plan.handed.fields(clock.times(t0), memory, one_body=False)
        return Trajectory(**{**fields, "packed": scene, "dt": steps})

    with progress_bar(handling.progress, n * clock.span(0).last, "step") as done:
        handling = handling._replace(done=done if handling.progress else None)
        for a in range(0, n, PART):
            m = min(PART, n - a)
            rows: Any = slice(a, a + m) if order is None else order[a : a + m]
            if plan is None or own or m < PART or own_steps:
                part = clock.part(rows) if isinstance(clock, OwnClock) and own_steps else clock
                plan = made(scene[rows] if own else scene, m, clock=part)
            if a == 0:
                if plan.by_time:
                    plan.warn_of_times(t0)
                memory, turns = Results.empty(saves, n, width, kind), np.empty(n, kind)
                begun = np.zeros(n)  # what bodies turn in their first step, of parts that tell
            chosen = given.part(rows, m)
            in_place = order is None
            into = memory.bodies(rows) if in_place else Results.empty(saves, m, width, kind)
            try:
                turns[rows] = found = plan.fill(chosen, t0, handling, into)
                if not plan.calm[0] <= found.max() <= plan.calm[1]:
                    begun[rows] = plan.first_turns(chosen)
            except InterruptedRun as stopped:
                rest = slice(a + m, n) if order is None else order[a + m :]
                memory.out[:, rest] = memory.defect[:, rest] = np.nan
                memory.status[rest] = Status.UNFINISHED
                stopped.trajectory = whole()
                raise
            finally:
                if not in_place:
                    memory.out[:, rows], memory.defect[:, rows] = into.out, into.defect
                    memory.status[rows] = into.status
    assert plan is not None
    damped = limits.decay(scene, steps)
    _ = plan.warn(begun, damped, steps) or plan.warn(turns, damped, steps)
    return whole()
