"""What locates a crossing afterwards: shorter steps from the state before a marked step.

``MarkedSteps`` steps all marked bodies at once; ``locate`` finds where a function crosses zero, and
``crossings_within`` does so for an event, once or for all its crossings.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.rows import RowFunction
from fastatt.engine.job import GivenScope, Job
from fastatt.engine.marks import Event, crosses, values
from fastatt.engine.status import Step
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import choose

if TYPE_CHECKING:
    from fastatt.engine.run import Run
    from fastatt.engine.tape import Piece

Array = NDArray[Any]
Times = NDArray[np.float64]
#: shares of steps, and values there
Points = tuple[Times, Times]

#: the smallest number with all its digits
TINY = float(np.finfo(np.float64).tiny)
# evaluations of an extremum, and of a bracket, at most
_FEW, _MOST = 10, 80
# points in a step that rounding tells apart, in either precision of the state
_POINTS = {"double": 2.0**-50, "single": 2.0**-22}


class MarkedSteps:
    """What is left of the marked steps of some bodies.

    ``places`` are the numbers of the events, or of the switches after them, that are marked. The
    bodies are in the states ``x`` at the times ``t``; a step of a size ``dt`` ends at ``end``.
    """

    def __init__(self, run: Run, piece: Piece, rows: Array, places: Array) -> None:
        program, states = run.setup.program, run.states[rows]
        job, some = program.job, np.arange(rows.size)
        marks = states[some, program.rows["mark"] + places].astype(np.int64)
        size, events = job.size + job.prepared, len(job.events)
        # a body whose switch is marked stays before that step
        first = np.where(
            places < events, program.rows["marked"] + places * size, program.rows["last"]
        )
        marked = states[some[:, None], first[:, None] + np.arange(size)].astype(np.float64)
        legs, taken = run.steps.step_before(piece.position + marks)
        begin, self.dt = run.t0 + legs["begin"], legs["dt"]
        since = taken * self.dt
        self.rows, (self.x, self._e) = rows, np.split(marked, [job.size], axis=1)
        self.t, self.end, self.rest = begin + since, begin + (taken + 1) * self.dt, self.dt.copy()
        self._p = run.params if len(run.params) == 1 else run.params[rows]
        clock = [self.t, since, self.dt, legs["low"], legs["high"], self.dt]
        self._clock, self._n_threads = np.stack(clock, axis=1), run.n_threads
        self._tables = run.setup.tables
        self._after = _after(replace(job, precision="double"))
        least = np.maximum(_POINTS[job.precision], np.abs(begin / self.dt + taken) * 2.0**-52)
        #: the times, s, that rounding tells apart
        self.least_time = least * np.abs(self.dt)
        # where a zero at the start of the run is over, to rounding
        is_first = (piece.position + marks - 1 == run.steps.first) & run.steps.is_new
        slack = 16.0 * np.finfo(np.float64).eps * (np.abs(self.t) + np.abs(run.t0))
        over = np.minimum(slack / np.abs(self.dt) + 16.0 * least, 1.0)
        self.first = np.where(is_first, over, 0.0)

    @property
    def least(self) -> Array:
        """The shares of what is left that rounding tells apart."""
        return np.asarray(self.least_time / np.maximum(np.abs(self.rest), TINY))

    def after(self, share: Array, some: Array) -> tuple[Array, ...]:
        """What ``_after`` gives for some of the bodies at shares of what is left."""
        self._clock[some, -1] = share * self.rest[some]
        inputs = (y if len(y) == 1 else y[some] for y in (self.x, self._p, self._e, self._clock))
        with np.errstate(all="ignore"):
            results: tuple[Array, ...] = self._after(
                *inputs, tables=self._tables, n_threads=self._n_threads
            )
        return results

    def time(self, share: Array, some: Array) -> Array:
        """The times at shares of what is left."""
        within = self.t[some] + share * self.rest[some]
        return np.asarray(np.where(share == 1.0, self.end[some], within))

    def go_on(self, some: Array, x: Array, t: Array, rest: Array) -> None:
        """Begin at other states and times; what is left of the step, or of the next one."""
        self.x[some], self.t[some], self.rest[some] = x, t, rest
        self._clock[some, 0], self._clock[some, 1] = t, 0.0
        self.first[some] = 0.0


@lru_cache(maxsize=64)
def _after(job: Job) -> RowFunction:
    """The results of a step of any size: values of events and switches, and a save.

    These are results for an event that stops or is located each time, and for switches, then the
    state too and the diagnostics of the step. A row is a body with its stepped variables after some
    steps of its clock: the time, that since the clock began, the step size, the window, and the
    size of the step.
    """
    saves = any(job.holds) or any(event.every for event in job.events)
    stages, ahead = job.method.stages or ((1.0, 1.0, 0.0),), job.method.ahead

    def after(x: Vector, p: Vector, e: Vector, clock: Vector) -> Any:
        t, since, dt, low, high, h = clock
        scope = GivenScope(job, x, p, (low, high))
        t = scope.at(t)
        begun = scope.left(t, scope.span(since), scope.span(ahead * dt), x, e)
        prepared = scope.prepare(scope.span(h), begun)
        y = scope.entered(t, scope.span(ahead * h), begun, prepared)
        for first, other, node in stages:
            y, square = scope.step(
                t + node * h, scope.span(first * h), scope.span(other * h), y, prepared
            )
        ended = scope.left(t + h, scope.span(h), scope.span(ahead * h), y, prepared)
        reached = tuple(values(scope, t + h, ended))
        if not saves:
            return reached
        saved = [(*out, error) for out, error in (scope.output(begun), scope.output(ended))]
        out = tuple(choose(h == 0.0, y, z) for y, z in zip(*saved, strict=True))
        if not job.switches:
            return reached, out
        stays = tuple(choose(h == 0.0, y, z) for y, z in zip(x, ended, strict=True))
        sides = scope.motion.sides
        stepped = Step(square, sides(t, begun), sides(t + h, ended))
        return reached, out, stays, tuple(of.formula(stepped) for of in job.of_steps)

    of_switches = [job.size, len(job.of_steps)] * bool(job.switches)
    results = (job.watched, *[job.handed_out + 1] * saves, *of_switches)
    inputs = {"x": job.size, "p": job.structure.n_params, "e": job.prepared, "clock": 6}
    return RowFunction(after, inputs, results)


def crossings_within(
    steps: MarkedSteps, some: Array, which: int, event: Event, ends: Points, until: Times
) -> Iterator[tuple[Array, Times]]:
    """Where an event crosses zero in what is left of ``some`` steps, until shares of that.

    (which of them, shares of what is left); if all crossings of the event are located, one after
    the other. ``which`` is the number of the event, and ``ends`` are its values now and there.
    """
    at_low, past = (x.astype(np.float64) for x in ends)
    least, low = (x[some] / np.maximum(until, TINY) for x in (steps.least, steps.first))
    low, todo = np.minimum(low, 1.0), np.arange(some.size)

    def value(share: Array, k: Array) -> Array:
        return steps.after(share * until[k], some[k])[0][:, which]

    while todo.size:
        k = todo[low[todo] > 0.0]
        if k.size:
            at_low[k] = value(low[k], k)
        of_todo = partial(_of_some, value, todo)
        points = low[todo], at_low[todo]
        share = locate(of_todo, points, past[todo], event.direction, least[todo])
        is_there = ~np.isnan(share)
        k, share = todo[is_there], share[is_there]
        yield k, share * until[k]
        low[k] = share + 16.0 * least[k]
        todo = k[low[k] < 1.0] if event.every and not event.terminal else k[:0]


def _of_some(value: Callable[[Times, Any], Times], which: Array, share: Times, k: Any) -> Times:
    """A function of some of the steps, at shares of some of these."""
    return value(share, which[k])


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
    with np.errstate(all="ignore"):
        crossed = crosses(low[1], at_high, direction)
        if not crossed.all():
            rows = np.flatnonzero(~crossed)
            first, last = ((share[rows], values[rows]) for share, values in (low, high))
            *ends, crossed[rows] = _between(lambda x: value(x, rows), first, last, direction)
            for bracket, new in zip((low, high), ends, strict=True):
                bracket[0][rows], bracket[1][rows] = new
        return _bracketed(value, low, high, least, np.flatnonzero(crossed), beyond=beyond)


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
        inner = inner[0], np.where(touches, -TINY * side, inner[1])
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
    value: Callable[[Times, Any], Times], low: Points, high: Points, least: Times, rows: Any, *,
    beyond: bool,
) -> Times:  # fmt: skip
    """Where in brackets a function is zero (Chandrupatla, *Adv. Eng. Softw.* 28 (1997) 145-149).

    NaN but in the given ``rows``, and where the function is NaN. Of a function that is zero at one
    end this is where it reaches or leaves zero, by the step function that is 1 on the other side.
    """
    result = np.full(least.size, np.nan)
    a, at_a, b, at_b = np.stack([*low, *high])[:, rows]
    flat = 1.0 * (at_b == 0.0) - (at_a == 0.0)
    at_a, at_b = np.where(flat, -1.0, at_a), np.where(flat, 1.0, at_b)
    # a is the newest end, and c the end that it took the place of
    brackets = np.stack([a, at_a, b, at_b, a, at_a, least[rows], flat, at_a / (at_a - at_b)])
    for _ in range(_MOST):
        a, at_a, b, at_b, _, _, least, flat, _ = brackets
        ends = np.minimum(a, b), np.maximum(a, b)
        is_nearer = (a < b) == (np.abs(at_a) <= np.abs(at_b))
        is_low = np.where(flat != 0.0, flat < 0.0, is_nearer & (not beyond))
        result[rows] = np.where(is_low, *ends)
        result[rows[np.isnan(at_a + at_b)]] = np.nan
        todo = (ends[1] - ends[0] > 4.0 * least) & (at_a * at_b < 0.0)
        rows, brackets = rows[todo], brackets[:, todo]
        if not rows.size:
            break
        a, at_a, b, at_b, c, at_c, least, flat, share = brackets
        share = np.clip(share, edge := 2.0 * least / np.abs(b - a), 1.0 - edge)
        new = a + share * (b - a)
        at_new = value(new, rows)
        stepped = np.where((at_new == 0.0) == (flat > 0.0), 1.0, -1.0)
        at_new = np.where((flat != 0.0) & ~np.isnan(at_new), stepped, at_new)
        is_like_a = ((at_new > 0.0) == (at_a > 0.0)) & (at_new != 0.0)
        b, at_b, c, at_c = np.where(is_like_a, (b, at_b, a, at_a), (a, at_a, b, at_b))
        # the inverse parabola through the three, where it is monotonic
        x, y = (new - b) / (c - b), (at_new - at_b) / (at_c - at_b)
        share = at_new / (at_b - at_new) * at_c / (at_b - at_c) + (c - new) / (b - new) * (
            at_new / (at_c - at_new) * at_b / (at_c - at_b)
        )
        share = np.where((y * y < x) & ((1.0 - y) ** 2 < 1.0 - x), share, 0.5)
        brackets = np.stack([new, at_new, b, at_b, c, at_c, least, flat, share])
    return result
