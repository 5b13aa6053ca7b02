"""Events: marks in the generated step, and the location of crossings between two steps.

A formula after each step keeps the state before the first step in which a function may cross zero.
When a tape has been performed, all marked bodies are located at once, by shorter steps from there.
A body whose mark was a false alarm performs the tape again, with later marks alone.

At the begin of a run and after breakpoints there are no values of earlier steps, so that one in the
middle of the step takes their place.

The functions of a scene's switches are watched like those of events, after these. A body whose
switch has a mark stays before the marked step; when that has been divided, the body performs the
tape again, and sleeps in the state after the step until the tape is there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.status import is_number
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import CLASSES, Double, apply, both, choose, either, negated

if TYPE_CHECKING:
    from fastatt.engine.job import Job, Scope

# evaluations of an extremum, and of a bracket, at most
_FEW, _MOST = 10, 80
_SMALLEST = float(np.finfo(np.float64).tiny)

Times = NDArray[np.float64]
#: shares of steps, and values there
Points = tuple[Times, Times]


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
    """

    #: a ``UserFunction`` in a run
    function: Any
    direction: int = 0
    terminal: bool = False
    reads: tuple[str, ...] = ()
    every: bool = False


def groups(job: Job) -> dict[str, int]:
    """The rows that a body needs for its events: how many of each group.

    The state before the last step, and before the marked step of each event, with what the method
    prepared; of each event the values after the last two steps, or at both ends of the marked step;
    the step up to which marks are ignored and the marked step, both counted from the end of the
    piece, NaN if there are none; 1 if a value was not finite; the largest diagnostics before the
    last step; the step until which a body sleeps; values in the middle.
    """
    n = job.watched
    return {
        "last": job.size * (n > 0), "marked": (job.size + job.prepared) * n, "before": n,
        "after": n, "skip": n, "mark": n, "lost": n, "held": len(job.of_steps) * (n > 0),
        "release": int(len(job.switches) > 0), "middle": n,
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
    pairs = zip(_each(scope, "after"), _now(scope), strict=True)
    values = [choose(is_number(after), after, now) for after, now in pairs]
    last, events = scope.state(), len(scope.job.events)
    if scope.job.switches:
        sleeps, before = sleeping(scope), scope.inputs("last", scope.job.size)
        last = tuple(choose(sleeps, x, y) for x, y in zip(before, last, strict=True))
        switched = list(zip(_each(scope, "after"), _now(scope), strict=True))[events:]
        values[events:] = [choose(sleeps, after, now) for after, now in switched]
    return scope.finished(last=last, after=values)


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
    step = CLASSES[scope.precision](scope.graph.input("double", "step"))
    (release,) = scope.inputs("release", 1)
    return step <= release if through else step < release


def counting(scope: Scope) -> Any:
    """Whether the diagnostics of a body count."""
    goes_on = going_on(scope)
    return both(goes_on, negated(sleeping(scope))) if scope.job.switches else goes_on


def after_step(scope: Scope) -> Flat:
    """Marks after a step, which record the first one in which each function may cross zero.

    A body stays where it was before the step that is marked by a terminal event or a switch.
    """
    job, n, of_steps = scope.job, scope.job.size, scope.job.of_steps
    x, last, e = scope.state(), scope.inputs("last", n), scope.prepared()
    held, slides = scope.inputs("held", len(of_steps)), scope.inputs("slides", len(job.switches))
    step = CLASSES[scope.precision](scope.graph.input("double", "step"))
    marked = scope.inputs("marked", (n + len(e)) * job.watched)
    goes_on, stays, sleeps = going_on(scope), [*x], None
    divided: list[Any] = []
    if job.switches:
        sleeps = sleeping(scope, through=True)
        goes_on = both(goes_on, negated(sleeps))
    new: dict[str, list[Any]] = {name: [] for name in ("marked", "before", "after", "mark", "lost")}
    names = ("before", "after", "skip", "mark", "lost", "middle")
    kept = zip(*(_each(scope, name) for name in names), _now(scope), strict=True)
    for i, (before, after, skip, mark, lost, middle, now) in enumerate(kept):
        k = i - len(job.events)
        direction = 0 if k >= 0 else job.events[i].direction
        # of the parabola through the last values; after a breakpoint of that through the middle
        first = choose(is_number(middle), 6.0 * after - 8.0 * middle + 3.0 * now, before)
        may_cross = crosses(after, now, direction)
        if k >= 0:
            side = x[job.switches[k]]
            # it may have jumped before the step
            may_cross = either(side * after < 0.0, side * now < 0.0)
            # of a body that slides, the side follows the sign
            follows = both(both(slides[k] != 0.0, goes_on), now != 0.0)
            stays[job.switches[k]] = choose(follows, choose(now < 0.0, -1.0, 1.0), side)
        may_cross = either(may_cross, turns(first, after, now))
        has_mark = is_number(mark)
        is_new = both(both(may_cross, negated(either(has_mark, step <= skip))), goes_on)
        if job.switches:  # none on a copy of the tile, within a step
            is_new = both(is_new, apply("floor", step) == step)
        if k >= 0:
            is_new = both(is_new, slides[k] == 0.0)
            divided.append(is_new)
        known = marked[(n + len(e)) * i : (n + len(e)) * (i + 1)]
        place = [choose(is_new, y, z) for y, z in zip((*last, *e), known, strict=True)]
        new["marked"] += place
        stay = has_mark if sleeps is None else either(has_mark, sleeps)
        new["before"].append(choose(stay, before, after))
        new["after"].append(choose(stay, after, now))
        new["mark"].append(choose(is_new, step, mark))
        is_seen = either(abs(now) < math.inf, negated(goes_on))
        new["lost"].append(choose(is_seen, lost, 1.0))
        if job.holds[i]:
            is_marked = either(has_mark, is_new)
            stays = [choose(is_marked, y, z) for y, z in zip(place[:n], stays, strict=True)]
    if sleeps is not None:
        stays = [choose(sleeps, y, z) for y, z in zip(last, stays, strict=True)]
    largest = {of.name: scope.inputs(of.name, 1)[0] for of in of_steps}
    # those of a step that is divided are computed where it is divided
    counts = both(goes_on, negated(reduce(either, divided))) if divided else goes_on
    most = [choose(counts, x, y) for x, y in zip(largest.values(), held, strict=True)]
    each = {name: (x,) for name, x in zip(largest, most, strict=True)}
    new["middle"] = [math.nan] * job.watched
    return scope.finished(x=stays, last=stays, **new, held=most, **each)


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


# the location


def locate(
    value: Callable[[Times, Any], Times], low: Points, at_high: Times, direction: int, least: Times,
    *, beyond: bool = False,
) -> Times:  # fmt: skip
    """The shares of steps at which a function crosses zero, NaN where it does not.

    ``value`` evaluates it at shares of some of the steps. It is known at the shares ``low``, from
    which on it is looked for, and at the end; ``least`` is the width that ends a bracket. The share
    is the end of the bracket that is nearer to zero, or that ``beyond`` zero.
    """
    high = np.ones(at_high.size), at_high
    crossed = crosses(low[1], at_high, direction)
    if not crossed.all():
        rows = np.flatnonzero(~crossed)
        first, last = ((share[rows], values[rows]) for share, values in (low, high))
        *ends, crossed[rows] = _between(lambda x: value(x, rows), first, last, direction)
        for bracket, new in zip((low, high), ends, strict=True):
            bracket[0][rows], bracket[1][rows] = new
    brackets = np.stack([*low, *high, high[0] - low[0], least])
    return _bracketed(value, brackets, np.flatnonzero(crossed), beyond)


def _between(
    value: Callable[[Times], Times], low: Points, high: Points, direction: int
) -> tuple[Points, Points, Any]:
    """Brackets of crossings within steps at whose ends a function has the same sign.

    The extremum is searched until the function has the other sign, or bends away from zero. Where
    it is exactly zero in between, it has crossed, and crosses back after that point.
    """
    side, point = np.copysign(1.0, low[1] + high[1]), 0.5 * (low[0] + high[0])
    inner, inside, todo = (point, value(point)), np.zeros(point.size, bool), low[0] < high[0]
    todo &= (low[1] != 0.0) | (high[1] != 0.0)
    for trial in range(_FEW):
        touches = (inner[1] == 0.0) & (low[1] != 0.0) & (high[1] != 0.0)
        inner = inner[0], np.where(touches, -_SMALLEST * side, inner[1])
        first = todo & crosses(low[1], inner[1], direction)
        second = todo & ~first & crosses(inner[1], high[1], direction)
        low, high = _chosen(second, inner, low), _chosen(first, inner, high)
        inside, todo = inside | first | second, todo & ~(first | second)
        # the vertex of the parabola through the three, or nearer to the end beyond which that lies
        p, q = inner[0] - low[0], inner[0] - high[0]
        u, v = p * (inner[1] - high[1]), q * (inner[1] - low[1])
        point = inner[0] - 0.5 * (p * u - q * v) / (u - v)
        beyond = 0.5 * (inner[0] + np.where(point <= low[0], low[0], high[0]))
        point = np.where((low[0] < point) & (point < high[0]), point, beyond)
        todo = todo & ((u - v) * (p * q) * inner[1] > 0.0) & (np.abs(point - inner[0]) > 1e-7)
        if trial == _FEW - 1 or not todo.any():
            break
        new = point, value(point)
        is_nearer, is_left = side * new[1] <= side * inner[1], point < inner[0]
        outer = _chosen(is_nearer, inner, new)
        low = _chosen(todo & (is_nearer != is_left), outer, low)
        high = _chosen(todo & (is_nearer == is_left), outer, high)
        inner = _chosen(todo & is_nearer, new, inner)
    return low, high, inside


def _chosen(test: Any, a: Points, b: Points) -> Points:
    return np.where(test, a[0], b[0]), np.where(test, a[1], b[1])


def _bracketed(
    value: Callable[[Times, Any], Times], brackets: Times, rows: Any, beyond: bool
) -> Times:
    """Where in brackets a function is zero (Oliveira and Takahashi, *ACM TOMS* 47 (2020)).

    NaN but in the given ``rows``, and where the function is NaN. Of a function that is zero at one
    end this is where it reaches or leaves zero, by the step function that is 1 on the other side.
    """
    share, brackets = np.full(brackets.shape[1], np.nan), brackets[:, rows]
    leaves, reaches = brackets[1] == 0.0, brackets[3] == 0.0
    flat = 1.0 * reaches - leaves
    brackets[1], brackets[3] = np.where(flat, -1.0, brackets[1]), np.where(flat, 1.0, brackets[3])
    brackets = np.vstack([brackets, flat])
    for _ in range(_MOST):
        low, at_low, high, at_high, radius, least, flat = brackets
        is_nearer = (np.abs(at_low) <= np.abs(at_high)) & (not beyond)
        is_low = np.where(flat != 0.0, flat < 0.0, is_nearer)
        share[rows] = np.where(is_low, low, high)
        share[rows[np.isnan(at_low + at_high)]] = np.nan
        todo = (high - low > 4.0 * least) & (at_low * at_high < 0.0)
        rows, brackets = rows[todo], brackets[:, todo]
        if not rows.size:
            break
        low, at_low, high, at_high, radius, least, flat = brackets
        width, middle = high - low, 0.5 * (low + high)
        slack = np.maximum(radius - 0.5 * width, 0.0)
        point = low - at_low * (width / (at_high - at_low))
        side = np.where(middle >= point, 1.0, -1.0)
        away = np.maximum(0.2 * width**2, least)
        point = np.where(away <= np.abs(middle - point), point + side * away, middle)
        point = np.where(np.abs(point - middle) <= slack, point, middle - side * slack)
        there = value(point, rows)
        stepped = np.where((there == 0.0) == (flat > 0.0), 1.0, -1.0)
        new = point, np.where((flat != 0.0) & ~np.isnan(there), stepped, there)
        is_low = ((new[1] > 0.0) == (at_low > 0.0)) & (new[1] != 0.0)
        brackets[:2] = np.where(is_low, new, brackets[:2])
        brackets[2:4] = np.where(is_low, brackets[2:4], new)
        radius *= 0.5
    return share
