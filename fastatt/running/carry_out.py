"""A run as it was asked for: planned, in one go, over parts of a large ensemble, or to files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from fastatt.engine.pool import InterruptedRun
from fastatt.engine.status import Status
from fastatt.running import limits
from fastatt.running.asked import Choice, Clock, Handling, OwnClock
from fastatt.running.histories import History, check_memory
from fastatt.running.initial import Given
from fastatt.running.plan import Plan
from fastatt.running.resume import MOST, End, check, check_begin, loaded
from fastatt.running.trajectory import Results, Trajectory
from fastatt.scene import Scene
from fastatt.threads import progress_bar

# bodies of an ensemble that are run at a time: what a run needs besides is small beside the whole
PART = 1 << 19
# plans that are kept with a scene, and of how many bodies
_KEPT, _FEW = 16, 1024


@dataclass(eq=False)  # not frozen: to make one takes a third of the time
class Wanted:
    """All of a run."""

    scene: Scene
    choice: Choice
    clock: Clock
    given: Given
    t0: float
    handling: Handling
    position: bool = False
    progress: bool = False
    out: Any = None
    end: End | None = None
    #: whether the trajectory holds its end
    ends: bool | None = None

    @cached_property
    def bodies(self) -> int:
        """How many there are."""
        return max(self.given.rows_q, self.given.rows_y)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Saves, bodies, and numbers that are handed out of each."""
        width = self.choice.attitude.stored + self.given.y.shape[-1]
        return self.clock.saves, self.bodies, width

    @property
    def plan(self) -> Plan:
        """Its plan, kept with the scene where it is small."""
        n, kind = self.bodies, self.given.q.dtype
        fresh = self.clock.done or isinstance(self.clock, OwnClock) or self.choice.device
        if n > _FEW or fresh:
            return self.planned(self.scene, n)
        memo, key = self.scene.memo, (n, self.choice, self.clock, kind, self.position)
        found: Plan | None = memo.get(key)
        if found is None:
            if len(memo) >= _KEPT:
                memo.pop(next(iter(memo)), None)
            found = memo[key] = self.planned(self.scene, n)
        return found

    def planned(self, scene: Scene, n: int) -> Plan:
        """A plan for n bodies of a scene."""
        kind = self.given.q.dtype
        return Plan(scene, n, self.choice, self.clock, kind, position=self.position)

    @property
    def is_in_parts(self) -> bool:
        """Whether the ensemble is run a part at a time."""
        handling = self.handling
        to_files = handling.sink or handling.checkpoint or self.out or self.end
        if to_files or self.choice.method.is_exact or self.choice.device:
            return False
        if isinstance(self.clock, OwnClock):
            return self.clock.steps.size > 1 or self.bodies > PART
        return self.bodies > PART and not self.ends


def carry_out(wanted: Wanted) -> Trajectory:
    """The trajectory of a run.

    Raises ``MemoryError`` for one whose saves will not fit, ``ValueError`` for one that does not
    fit the end from which it goes on.
    """
    if wanted.is_in_parts:
        return _in_parts(wanted)
    clock, handling, shape, end = wanted.clock, wanted.handling, wanted.shape, wanted.end
    to_saves = handling.sink is not None or wanted.out is not None
    if not to_saves:
        check_memory(shape, wanted.given.q.dtype)
    plan = wanted.plan
    ends = wanted.bodies <= MOST if wanted.ends is None else wanted.ends
    ends = ends and not isinstance(clock, OwnClock)
    device, file = wanted.choice.device, handling.checkpoint
    if not (to_saves or end or file or device or wanted.progress):
        return plan.run(wanted.given, wanted.t0, handling=handling, ends=ends)
    goes_on = end is None and file is not None and file.exists()
    if goes_on and file is not None:
        end = loaded(file)
        check_begin(end, wanted.given, wanted.t0, clock.end)
    if end is not None:
        check(end, plan)
    history = None
    if wanted.out is not None:
        first = 0
        if goes_on and end is not None:
            first = int(np.searchsorted(plan.clock.saved, end.done, side="right"))
        history = History(wanted.out, shape, plan.kind, first)
    total, unit = (shape[0], "save") if to_saves else (shape[1] * clock.n_steps, "step")
    with progress_bar(wanted.progress, total, unit) as done:
        sinks = [x for x in (handling.sink, history) if x is not None]
        handling = handling._replace(
            done=done if wanted.progress and not to_saves else None,
            sink=partial(_deliver, sinks, done) if sinks else None,
        )
        try:
            made = plan.run(wanted.given, wanted.t0, handling=handling, ends=ends, start=end)
        except InterruptedRun as stopped:
            if history is not None and history.array is not None:
                fields = {**plan.handed.told, **plan.handed.parts(history.array[: history.saves])}
                fields["t"] = clock.times(wanted.t0)[: history.saves]
                fields["status"] = np.full(shape[1], Status.UNFINISHED, np.uint8)
                stopped.trajectory = Trajectory(**fields, one_body=wanted.given.one_body)
            raise
    if device is not None and device.saves is not None:
        return replace(made, **plan.handed.parts(device.saves))
    if history is None or history.array is None:
        return made
    return replace(made, t=clock.times(wanted.t0), **plan.handed.parts(history.array))


def _deliver(
    sinks: list[Callable[[Trajectory], object]], done: Callable[[int], object], piece: Trajectory
) -> None:
    for sink in sinks:
        sink(piece)
    done(piece.t.size)


def _in_parts(wanted: Wanted) -> Trajectory:
    """The run of a large ensemble, of a part of its bodies at a time; those of like cost together.

    A part lies in its place in the arrays; of bodies in another order it is copied there.
    """
    n, clock, scene, given = wanted.bodies, wanted.clock, wanted.scene, wanted.given
    own = scene.rows is not None
    kind, (saves, _, width) = given.q.dtype, wanted.shape
    check_memory(wanted.shape, kind)
    # those with most steps first: no thread is left with them at the end
    order = np.argsort(np.abs(clock.steps)) if isinstance(clock, OwnClock) else None
    steps = clock.steps if isinstance(clock, OwnClock) else clock.h
    plan: Plan | None = None

    def whole() -> Trajectory:
        assert plan is not None
        fields = plan.handed.fields(clock.times(wanted.t0), memory, one_body=False)
        return Trajectory(**{**fields, "packed": scene, "dt": steps})

    with progress_bar(wanted.progress, n * clock.span(0).last, "step") as done:
        handling = wanted.handling._replace(done=done if wanted.progress else None)
        for a in range(0, n, PART):
            m = min(PART, n - a)
            rows: Any = slice(a, a + m) if order is None else order[a : a + m]
            if plan is None or own or m < PART or isinstance(clock, OwnClock):
                part = clock.part(rows) if isinstance(clock, OwnClock) else clock
                plan = replace(wanted, clock=part).planned(scene[rows] if own else scene, m)
            if a == 0:
                plan.warn_of_times(wanted.t0)
                memory, turns = Results.empty(saves, n, width, kind), np.empty(n, kind)
                begun = np.zeros(n)  # what bodies turn in their first step, of parts that tell
            chosen = given.part(rows, m)
            in_place = order is None
            made = memory.bodies(rows) if in_place else Results.empty(saves, m, width, kind)
            try:
                turns[rows] = found = plan.fill(chosen, wanted.t0, handling, made)
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
                    memory.out[:, rows], memory.defect[:, rows] = made.out, made.defect
                    memory.status[rows] = made.status
    assert plan is not None
    damped = limits.decay(scene, steps)
    _ = plan.warn(begun, damped, steps) or plan.warn(turns, damped, steps)
    return whole()
