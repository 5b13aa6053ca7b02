"""A run as it was asked for: planned, in one go, over parts of a large ensemble, or to files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fastatt.engine.pool import InterruptedRun
from fastatt.engine.status import Status
from fastatt.propagation.histories import History, check_memory
from fastatt.propagation.initial import Given
from fastatt.propagation.options import Choice, Clock, Handling, OwnClock
from fastatt.propagation.plan import Plan
from fastatt.propagation.resume import MOST, check, check_begin, loaded
from fastatt.propagation.trajectory import Results, Trajectory
from fastatt.scene.scene import Scene
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
        plan = Plan(scene, given.bodies, choice, clock, kind, position=position)
        return _in_parts(plan, given, t0, handling, shape)
    to_saves = handling.sink is not None or handling.file is not None
    if not to_saves:
        check_memory(shape, kind)
    plan = _kept(scene, given.bodies, choice, clock, kind, position)
    end, kept, device = handling.start, handling.checkpoint, choice.device
    if not (to_saves or end or kept or device or handling.progress):
        return plan.run(given, t0, handling)
    goes_on = end is None and kept is not None and kept.exists()
    if goes_on and kept is not None:
        end = loaded(kept)
        check_begin(end, given, t0, clock.end)
    if end is not None:
        check(end, plan)
    history = None
    if handling.file is not None:
        first = 0
        if goes_on and end is not None:
            first = int(np.searchsorted(clock.saved, end.done, side="right"))
        history = History(handling.file, shape, plan.kind, first)
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
                fields = {**plan.handed.common, **plan.handed.parts(history.array[: history.saves])}
                fields["t"] = clock.times(t0)[: history.saves]
                fields["status"] = np.full(shape[1], Status.UNFINISHED, np.uint8)
                stopped.trajectory = Trajectory(**fields, one_body=given.one_body)
            raise
    if device is not None and device.saves is not None:
        return replace(run, **plan.handed.parts(device.saves))
    if history is None or history.array is None:
        return run
    return replace(run, t=clock.times(t0), **plan.handed.parts(history.array))


def holds_end(n: int, clock: Clock) -> bool:
    """Whether the trajectory of n bodies holds its end: where that is small."""
    return n <= min(MOST, PART) and not isinstance(clock, OwnClock)


def _is_in_parts(choice: Choice, clock: Clock, n: int, handling: Handling) -> bool:
    """Whether the ensemble is run a part at a time."""
    to_files = handling.sink or handling.checkpoint or handling.file or handling.start
    if to_files or choice.method.is_exact or choice.device:
        return False
    return n > PART or isinstance(clock, OwnClock)


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
    plan: Plan, given: Given, t0: float, handling: Handling, shape: tuple[int, int, int]
) -> Trajectory:
    """A large ensemble, or one with per-body steps, some of its bodies at a time."""
    check_memory(shape, plan.kind)
    clock, n = plan.clock, shape[1]
    times = plan.times(t0)
    order = clock.order if isinstance(clock, OwnClock) else None
    results, angles = Results.empty(*shape, plan.kind), np.empty(n, plan.kind)

    def whole() -> Trajectory:
        return Trajectory(**plan.handed.fields(times, results, given.one_body))

    with progress_bar(handling.progress, n * plan.span.last, "step") as done:
        handling = handling._replace(done=done if handling.progress else None)
        for a in range(0, n, PART):
            m = min(PART, n - a)
            try:
                found = plan.fill(given, t0, handling, results, (a, m))
            except InterruptedRun as stopped:
                rest = slice(a, n) if order is None else order[a:]
                results.out[:, rest] = results.norm_error[:, rest] = np.nan
                results.status[rest] = Status.UNFINISHED
                stopped.trajectory = whole()
                raise
            angles[slice(a, a + m) if order is None else order[a : a + m]] = found
    least, most = plan.silent_range
    if not (least <= angles.max() <= most and angles.min() >= least):
        _ = plan.warn(plan.first_turns(given), plan.damped) or plan.warn(angles, plan.damped)
    return whole()
