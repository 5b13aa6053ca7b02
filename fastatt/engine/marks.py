"""What marks a step: formulas after each step that find where a function may cross zero.

They keep the state before the first such step of each body, from which ``engine.location`` finds
the crossing when the tape has been performed.

At the begin of a run and after breakpoints there are no values of earlier steps, so that one in the
middle of the step takes their place.

The functions of a scene's switches are watched like those of events, after these. A body whose
switch has a mark stays before the marked step. When that has been divided, the body performs the
tape again, and sleeps in the state after the step until the tape is there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import TYPE_CHECKING, Any

from fastatt.engine.status import is_number
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import CLASSES, Double, apply, both, choose, either, negated

if TYPE_CHECKING:
    from fastatt.engine.job import Job, Scope

#: crossings of a body that are kept of each event or switch, at most
MOST_CROSSINGS = 1_000_000


@dataclass(frozen=True)
class Event:
    """A function of the motion whose first zero crossing is located; :func:`event` makes it.

    Attributes
    ----------
    function : callable
        The function.
    direction : {-1, 0, 1}
        The direction of the crossing.
    terminal : bool
        Whether the body stops there.
    reads : tuple of str
        The names of the terms whose numbers the function takes.
    every : bool
        Whether all its crossings are located.
    source : Event or None
        The event that users made, of one in a run.
    """

    #: a ``UserFunction`` in a run
    function: Any
    direction: int = 0
    terminal: bool = False
    reads: tuple[str, ...] = ()
    every: bool = False
    source: Event | None = field(default=None, compare=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """All but what users made, whose function may not be pickled."""
        return {**self.__dict__, "source": None}


def groups(job: Job) -> dict[str, int]:
    """The rows that a body needs for its events: how many of each group.

    The state before the last step, and before the marked step of each event, with what the method
    prepared; of each event and switch the values after the last two steps, or at both ends of the
    marked step; the step up to which marks are ignored and the marked step, both counted from the
    end of the piece, NaN if there are none; 1 if a value was not finite; the largest diagnostics
    before the last step; the step until which a body sleeps; values in the middle.
    """
    n = job.watched
    return {
        "last": job.size * (n > 0), "marked": (job.size + job.prepared) * len(job.events),
        "before": n, "after": n, "skip": n, "mark": n, "lost": n,
        "held": len(job.of_steps) * (n > 0), "release": int(len(job.switches) > 0), "middle": n,
    }  # fmt: skip


# the formulas


def values(scope: Scope, t: Any, x: Vector) -> list[Any]:
    """The functions of the events at a state."""
    structure, p = scope.job.structure, scope.p
    # velocity and position come before the states of the scene
    states = structure.rotation.law.states
    coupled = tuple(map(Double, x[len(x) - structure.coupled :]))
    moved, s = coupled[: len(coupled) - states], coupled[len(coupled) - states :]
    of_rotation, results = p[: structure.rotation.n_params], []
    for event in scope.job.events:
        # the scene's ``params`` are the last parameters of the rotation
        params = of_rotation[len(of_rotation) - event.function.signature.n_params :]
        # whether it takes velocity and position, not only time, attitude and rate
        is_placed = len(event.function.signature.before) - len(event.reads) > 4
        placed = (moved[:3], moved[3:]) if is_placed else ()
        read = scope.shown(t, x, event.reads)
        results.append(scope.called(event.function.call, t, x, *placed, *read, s, params))
    return [*results, *scope.crossed(t, x)]


def with_sides(scope: Scope, t: Any, x: Vector) -> Vector:
    """A state with those sides set that are 0."""
    new = list(x)
    for k, g in zip(scope.job.switches, scope.crossed(t, x), strict=True):
        new[k] = choose(x[k] == 0.0, choose(g < 0.0, -1.0, 1.0), x[k])
    return tuple(new)


def _now(scope: Scope) -> list[Any]:
    precision = CLASSES[scope.precision]
    return [precision(g) for g in values(scope, scope.time(), scope.left_now())]


def look(scope: Scope) -> Flat:
    """The stepped variables, and the values of events, from which steps go on.

    Values of events after an earlier step stay, so that a function that jumps across zero crosses
    there. That of a switch is compared with its side.
    """
    values, last, now = _each(scope, "after"), scope.state(), _now(scope)
    looked = [choose(is_number(after), after, g) for after, g in zip(values, now, strict=True)]
    if scope.job.switches:
        events, stays = len(scope.job.events), negated(counting(scope))
        last = tuple(_chosen(stays, scope.inputs("last", scope.job.size), last))
        looked[events:] = _chosen(sleeping(scope), values[events:], now[events:])
    return scope.finished(last=last, after=looked)


def _each(scope: Scope, name: str) -> Vector:
    """The numbers of a group that has one for each event."""
    return scope.inputs(name, scope.job.watched)


def middle(scope: Scope) -> Flat:
    """The values in the middle of a step."""
    return scope.finished(middle=_now(scope))


def going_on(scope: Scope) -> Any:
    """Whether a body goes on: no terminal event and no switch has a mark."""
    goes_on = is_number(scope.graph.input("double", "dt"))  # true
    for mark, holds in zip(_each(scope, "mark"), scope.job.holds, strict=True):
        goes_on = both(goes_on, negated(is_number(mark))) if holds else goes_on
    return goes_on


def sleeping(scope: Scope, *, through: bool = False) -> Any:
    """Whether a body is not yet where its tape is, or was not in the last step."""
    (release,), step = scope.inputs("release", 1), _step(scope)
    return step <= release if through else step < release


def counting(scope: Scope, *, through: bool = False) -> Any:
    """Whether the diagnostics of a body count, or, ``through`` it, those of its last step."""
    goes_on = going_on(scope)
    if not scope.job.switches:
        return goes_on
    return both(goes_on, negated(sleeping(scope, through=through)))


def after_step(scope: Scope) -> Flat:
    """Marks after a step, which record the first one in which each function may cross zero.

    A body stays where it was before the step that is marked by a terminal event or a switch.
    """
    job, last, now = scope.job, scope.inputs("last", scope.job.size), _now(scope)
    counts, events = counting(scope, through=True), len(job.events)
    is_new = _new_marks(scope, now, counts)
    has_mark = [is_number(mark) for mark in _each(scope, "mark")]
    x, stays = _followed(scope, now[events:], counts), list(has_mark)
    new: dict[str, list[Any]] = {"marked": []}
    place = (*last, *scope.prepared())
    marked = scope.inputs("marked", len(place) * events)
    for i, event in enumerate(job.events):
        known = marked[len(place) * i : len(place) * (i + 1)]
        new_place = _chosen(is_new[i], place, known)
        new["marked"] += new_place
        if event.terminal:
            x = _chosen(either(has_mark[i], is_new[i]), new_place[: job.size], x)
    if job.switches:
        sleeps = sleeping(scope, through=True)
        stays = [either(mark, sleeps) for mark in has_mark]
        x = _chosen(reduce(either, [*is_new[events:], *has_mark[events:], sleeps]), last, x)
    before, after, mark, lost = (_each(scope, x) for x in ("before", "after", "mark", "lost"))
    step, unseen = _step(scope), negated(counts)
    is_seen = [either(abs(g) < math.inf, unseen) for g in now]
    new["before"] = [*map(choose, stays, before, after)]
    new["after"] = [*map(choose, stays, after, now)]
    new["mark"] = [choose(starts, step, y) for starts, y in zip(is_new, mark, strict=True)]
    new["lost"] = [choose(seen, y, 1.0) for seen, y in zip(is_seen, lost, strict=True)]
    new["middle"] = [math.nan] * job.watched
    return scope.finished(x=x, last=x, **new, **_largest(scope, counts, is_new[events:]))


def _step(scope: Scope) -> Any:
    """The step, counted from the end of the piece."""
    return CLASSES[scope.precision](scope.graph.input("double", "step"))


def _chosen(test: Any, a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [choose(test, y, z) for y, z in zip(a, b, strict=True)]


def _new_marks(scope: Scope, now: Sequence[Any], counts: Any) -> list[Any]:
    """Whether each function may cross zero in the last step, and is not marked yet."""
    job, x, step = scope.job, scope.state(), _step(scope)
    events, slides = len(job.events), scope.inputs("slides", len(job.switches))
    names = ("before", "after", "skip", "mark", "middle")
    is_new = []
    for i, known in enumerate(zip(*(_each(scope, name) for name in names), now, strict=True)):
        before, after, skip, mark, middle, g = known
        # of the parabola through the last values; after a breakpoint of that through the middle
        first = choose(is_number(middle), 6.0 * after - 8.0 * middle + 3.0 * g, before)
        if i < events:
            may_cross = crosses(after, g, job.events[i].direction)
        else:  # its side may have changed before the step
            side = x[job.switches[i - events]]
            may_cross = either(side * after < 0.0, side * g < 0.0)
        may_cross = both(either(may_cross, turns(first, after, g)), counts)
        may_cross = both(may_cross, negated(either(is_number(mark), step <= skip)))
        if job.switches:  # none on a copy of the tile, within a step
            may_cross = both(may_cross, apply("floor", step) == step)
        is_new.append(may_cross if i < events else both(may_cross, slides[i - events] == 0.0))
    return is_new


def _followed(scope: Scope, now: Sequence[Any], counts: Any) -> list[Any]:
    """The state after a step, with sides of bodies that slide, which follow the sign."""
    x = [*scope.state()]
    slides = scope.inputs("slides", len(scope.job.switches))
    for k, g, sliding in zip(scope.job.switches, now, slides, strict=True):
        follows = both(both(sliding != 0.0, counts), g != 0.0)
        x[k] = choose(follows, choose(g < 0.0, -1.0, 1.0), x[k])
    return x


def _largest(scope: Scope, counts: Any, divided: Sequence[Any]) -> dict[str, list[Any]]:
    """The largest diagnostics of steps; those of a step that is divided are computed there."""
    of_steps = scope.job.of_steps
    counts = both(counts, negated(reduce(either, divided))) if divided else counts
    largest = [scope.inputs(of.name, 1)[0] for of in of_steps]
    held = _chosen(counts, largest, scope.inputs("held", len(of_steps)))
    return {"held": held, **{of.name: [x] for of, x in zip(of_steps, held, strict=True)}}


def crosses(a: Any, b: Any, direction: int) -> Any:
    """Whether a function that goes from a to b reaches or leaves zero, rising, falling or both."""
    rises, falls = (a <= 0.0) & (b >= 0.0) & (a < b), (a >= 0.0) & (b <= 0.0) & (a > b)
    if direction == 0:
        return rises | falls
    return rises if direction > 0 else falls


def turns(a: Any, b: Any, c: Any) -> Any:
    """Whether a parabola of twice the curvature of a, b and c crosses zero between b and c.

    If the function crosses zero twice, the parabola does, unless the function's curvature doubles
    within a step.
    """
    bend, slope = 2.0 * (a - 2.0 * b + c), c - b
    square, steep = bend * bend, 4.0 * slope * slope
    product = bend * (b + c)
    return (product > 0.0) & (steep < square) & (4.0 * product < steep + square)
