"""A run as it was asked for: planned, in one go, over parts of a large ensemble, or to files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fastatt.running import limits
from fastatt.running.asked import Choice, Clock, Handling
from fastatt.running.histories import History, check_memory
from fastatt.running.initial import Given
from fastatt.running.plan import Plan
from fastatt.running.resume import MOST, End, about, check, check_begin, loaded
from fastatt.running.trajectory import Results, Trajectory
from fastatt.scene import Scene
from fastatt.threads import progress_bar

# bodies of an ensemble that are run at a time: what a run needs besides is small beside the whole
PART = 1 << 18
# plans that are kept with a scene, and of how many bodies
_KEPT, _FEW = 16, 1024


@dataclass(frozen=True)
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

    @property
    def bodies(self) -> int:
        """How many there are."""
        return max(self.given.rows_q, self.given.rows_y)

    @property
    def plan(self) -> Plan:
        """Its plan, kept with the scene where it is small."""
        n, kind = self.bodies, self.given.q.dtype
        if n > _FEW or self.clock.done:
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
        return self.bodies > PART and not (to_files or self.ends or self.choice.method.is_exact)


def carry_out(wanted: Wanted) -> Trajectory:
    """The trajectory of a run.

    Raises ``MemoryError`` for one whose saves will not fit, ``ValueError`` for one that does not
    fit the end from which it goes on.
    """
    if wanted.is_in_parts:
        return _in_parts(wanted)
    plan, clock, handling = wanted.plan, wanted.clock, wanted.handling
    end = wanted.end
    to_saves = handling.sink is not None or wanted.out is not None
    shape = (len(plan.clock.saved), wanted.bodies, plan.width)
    if not to_saves:
        check_memory(shape, plan.kind)
    mine = about(wanted.choice, clock.h, plan.kind, wanted.position)
    file = handling.checkpoint
    goes_on = end is None and file is not None and file.exists()
    if goes_on and file is not None:
        end = loaded(file)
        check_begin(end, wanted.given, wanted.t0)
    if end is not None:
        check(end, mine, plan.packed)
    history = None
    if wanted.out is not None:
        first = 0
        if goes_on and end is not None:
            first = int(np.searchsorted(plan.clock.saved, end.done, side="right"))
        history = History(wanted.out, shape, plan.kind, first)
    total, unit = (shape[0], "save") if to_saves else (wanted.bodies * clock.n_steps, "step")
    with progress_bar(wanted.progress, total, unit) as done:
        sinks = [x for x in (handling.sink, history) if x is not None]
        handling = replace(
            handling,
            done=done if wanted.progress and not to_saves else None,
            sink=partial(_deliver, sinks, done) if sinks else None,
        )
        ends = wanted.bodies <= MOST if wanted.ends is None else wanted.ends
        made = plan.run(wanted.given, wanted.t0, handling=handling, ends=ends, start=end)
    if history is None or history.array is None:
        return made
    return replace(made, t=plan.clock.times(wanted.t0), **plan.parts(history.array))


def _deliver(
    sinks: list[Callable[[Trajectory], object]], done: Callable[[int], object], piece: Trajectory
) -> None:
    for sink in sinks:
        sink(piece)
    done(piece.t.size)


def _in_parts(wanted: Wanted) -> Trajectory:
    """The run of a large ensemble, of a part of its bodies at a time."""
    n, clock = wanted.bodies, wanted.clock
    scene, handling, given = wanted.scene, wanted.handling, wanted.given
    own = scene.packed(None).params.ndim == 2
    plan = wanted.planned(scene[:PART] if own else scene, PART)
    saves = len(clock.saved)
    check_memory((saves, n, plan.width), plan.kind)
    memory = Results(
        np.empty((saves, n, plan.width), plan.kind),
        np.empty((saves, n), plan.kind),
        np.empty(n, np.uint8),
    )
    turns = np.empty(n, plan.kind)
    with progress_bar(wanted.progress, n * clock.n_steps, "step") as done:
        handling = replace(handling, done=done if wanted.progress else None)
        for a in range(0, n, PART):
            b = min(a + PART, n)
            if a and (own or b - a < PART):
                plan = wanted.planned(scene[a:b] if own else scene, b - a)
            turns[a:b] = plan.fill(given.part(a, b), wanted.t0, handling, memory.bodies(a, b))
    plan.warn(turns, limits.decay(scene, clock.h))
    fields = plan.fields(clock.times(wanted.t0), memory, one_body=False)
    return Trajectory(**{**fields, "packed": scene})
