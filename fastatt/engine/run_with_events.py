"""A run with events: which bodies are marked, where they cross, and what is saved then."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.rows import RowFunction
from fastatt.engine.job import GivenScope, Job
from fastatt.engine.marks import locate, values
from fastatt.engine.run import Run
from fastatt.engine.status import FLAGS, Status, Step
from fastatt.engine.tape import Action, Piece, Tape, times_of
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import choose

Array = NDArray[Any]

# steps of the shortest piece
_LEAST = 64
# crossings of a switch in a step, from which on a body slides
_MOST = 32
_TINY = float(np.finfo(np.float64).tiny)
# points in a step that rounding tells apart, in either precision of the state
_POINTS = {"double": 2.0**-50, "single": 2.0**-22}


class _Step:
    """What is left of the marked steps of some bodies.

    ``places`` are the numbers of the events, or of the switches after them, that are marked. The
    bodies are in the states ``x`` at the times ``t``; a step of a size ``dt`` ends at ``end``.
    """

    def __init__(self, run: RunWithEvents, piece: Piece, rows: Array, places: Array) -> None:
        job, states = run.setup.program.job, run.states[rows]
        first, size = run.setup.program.rows, job.size + job.prepared
        some = np.arange(rows.size)
        marks = states[some, first["mark"] + places].astype(np.int64)
        columns = (first["marked"] + places * size)[:, None] + np.arange(size)
        marked = states[some[:, None], columns].astype(np.float64)
        legs, taken = run.steps.step_before(piece.position + marks)
        begin, self.dt = run.t0 + legs["begin"], legs["dt"]
        since = taken * self.dt
        self.rows, (self.x, self._e) = rows, np.split(marked, [job.size], axis=1)
        self.t, self.end, self.rest = begin + since, begin + (taken + 1) * self.dt, self.dt.copy()
        self._p = run.params if len(run.params) == 1 else run.params[rows]
        clock = [self.t, since, self.dt, legs["low"], legs["high"], self.dt]
        self._clock, self._tables = np.stack(clock, axis=1), run.setup.tables
        self._after = _after(replace(job, precision="double"))
        least = np.maximum(_POINTS[job.precision], np.abs(begin / self.dt + taken) * 2.0**-52)
        self._least = least * np.abs(self.dt)
        # where a zero at the start of the run is over, to rounding
        is_first = (piece.position + marks - 1 == run.steps.first) & run.steps.is_new
        slack = 16.0 * np.finfo(np.float64).eps * (np.abs(self.t) + np.abs(run.t0))
        over = np.minimum(slack / np.abs(self.dt) + 16.0 * least, 1.0)
        self.first = np.where(is_first, over, 0.0)

    @property
    def least(self) -> Array:
        """The shares of what is left that rounding tells apart."""
        return np.asarray(self._least / np.maximum(np.abs(self.rest), _TINY))

    def after(self, share: Array, some: Array) -> tuple[Array, ...]:
        """What ``_after`` gives for some of the bodies at shares of what is left."""
        self._clock[some, -1] = share * self.rest[some]
        inputs = (y if len(y) == 1 else y[some] for y in (self.x, self._p, self._e, self._clock))
        with np.errstate(all="ignore"):
            results: tuple[Array, ...] = self._after(*inputs, tables=self._tables)
        return results

    def time(self, share: Array, some: Array) -> Array:
        """The times at shares of what is left."""
        within = self.t[some] + share * self.rest[some]
        return np.asarray(np.where(share == 1.0, self.end[some], within))

    def go_on(self, some: Array, x: Array, t: Array, rest: Array) -> None:
        """Begin at other states and times; what is left of the step, or of the next one."""
        self.x[some], self.t[some], self.rest[some] = x, t, rest
        self._clock[some, 0], self._clock[some, 1] = t, 0.0


class RunWithEvents(Run):
    """A run with events, or of a scene with switches.

    ``stopped`` are the times at which bodies stopped, NaN of others, and ``final`` their values
    from then on.
    """

    def _begin(self) -> None:
        """Make the states from initial values, before the first tape."""
        self._program, self._job = self.setup.program, self.setup.program.job
        self._sign, saves = float(np.sign(self.steps.legs["dt"][0])), self.results.saves
        self._events, n = len(self._job.events), saves.shape[1]
        self.stopped, self.final = np.full(n, np.nan), np.zeros_like(saves[0])
        # terminal events come first
        self._order = sorted(range(self._events), key=lambda i: not self._job.holds[i])
        # of each event its last crossing, and the time until which a body is run, in a piece
        self._last = np.full((n, self._events), np.nan)
        self._until = np.full(n, -self._sign * np.inf)
        self.perform(self.steps.begun(self.t0))
        self.states[:, self._program.is_of_events] = np.nan

    def _resume(self, kept: Mapping[str, Array]) -> None:
        """Go on from what another run kept, of the same events or others."""
        super()._resume(kept)
        if "of_events" in kept:
            self.states[:, self._program.is_of_events] = kept["of_events"]
            for name, values in self._found().items():
                values[:] = kept[name]
            # only what was located has a mark between two pieces
            marks = self.states[:, self._each("mark")][:, : self._events]
            marks[np.isnan(self.results.event_times)] = np.nan

    def kept(self) -> dict[str, Array]:
        """Copies of what another run needs to go on from here."""
        found = {name: values.copy() for name, values in self._found().items()}
        of_events = self.states[:, self._program.is_of_events]
        return {**super().kept(), "of_events": of_events, **found}

    def _found(self) -> dict[str, Array]:
        times = self.results.event_times
        return {"event_times": times, "stopped": self.stopped, "final": self.final}

    def advance(self, piece: Piece) -> None:
        """Perform a piece, again until no body has a false alarm, or a step to divide."""
        begun, rounds = self.states.copy(), 0
        is_over = ~np.isnan(self.stopped)
        super().advance(piece)
        while (again := self._located(piece, begun, is_over)).size:
            rounds += again.size
            self.states[again] = begun[again]
            self.perform(piece.tape, again, since=self._until[again])
        if 2 * rounds > len(begun):
            self._pace = max(self._pace // 4, _LEAST)  # fewer are performed again
        self._save(piece.tape)
        # the next piece counts its steps anew
        self.states[:, self._each("skip")] = np.nan
        self.states[:, self._group("release", min(1, len(self._job.switches)))] = np.nan
        self._until[:] = -self._sign * np.inf
        self._read_flags()

    def _read_flags(self) -> None:
        super()._read_flags()
        slides = self.states[:, self._group("slides", len(self._job.switches))] != 0.0
        self.results.status[:] |= slides.any(axis=1) * FLAGS(Status.SLIDING)

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which events were not located, and switches (N, E), had a value that is not finite."""
        is_lost = self.states[:, self._each("lost")] == 1.0
        is_lost[:, : self._events] &= np.isnan(self.results.event_times)
        return np.asarray(is_lost & (self.results.status == 0)[:, None])

    def _group(self, name: str, size: int) -> slice:
        first = self._program.rows[name]
        return slice(first, first + size)

    def _columns(self, name: str, size: int) -> Array:
        return self._program.rows[name] + np.arange(size)

    def _each(self, name: str) -> slice:
        """The columns of what bodies keep of each event and switch."""
        return self._group(name, self._job.watched)

    def _located(self, piece: Piece, begun: Array, is_over: Array) -> NDArray[np.int64]:
        """Locate what is marked in a piece; the bodies that have to go on from ``begun`` again.

        These were marked without a crossing, or at one of several, and ignore their marks up to
        then; or a switch was marked, and they sleep until the step is over that was divided.
        """
        times, marks = self.results.event_times, self.states[:, self._each("mark")]
        ends = np.full(times.shape, np.nan)
        of_switch = np.fmin.reduce(marks[:, self._events :], axis=1, initial=np.inf)
        for i in self._order:
            event = self._job.events[i]
            is_due = (marks[:, i] < of_switch) & ~is_over
            rows = np.flatnonzero(is_due & (event.every | np.isnan(times[:, i])))
            if not rows.size:
                continue
            step = _Step(self, piece, rows, np.full(rows.size, i))
            before, past = (
                self.states[rows, self._each(name)][:, i] for name in ("before", "after")
            )
            whole = np.ones(rows.size)
            missed = self._cross(i, step, np.arange(rows.size), before, past, whole)
            again = missed | event.every
            begun[rows[again], self._each("skip").start + i] = marks[rows[again], i]
            ends[rows[again], i] = step.end[again]
        times[self._sign * (times - self.stopped[:, None]) > 0.0] = np.nan
        # what follows the time at which a body stopped does not matter
        matters = ~(self._sign * (ends - self.stopped[:, None]) >= 0.0) & ~np.isnan(ends)
        again = matters.any(axis=1)
        divided = np.flatnonzero(np.isfinite(of_switch) & ~again & np.isnan(self.stopped))
        if divided.size:
            self._divide(piece, divided, begun)
            again[divided] = np.isnan(self.stopped[divided])
        return np.flatnonzero(again)

    def _cross(
        self, i: int, step: _Step, some: Array, before: Array, past: Array, until: Array
    ) -> Array:
        """Record where an event crosses zero in what is left of some steps; where it does not.

        ``before`` and ``past`` are its values now and at the shares ``until``.
        """
        event, times = self._job.events[i], self.results.event_times
        at_low, past = before.astype(np.float64), past.astype(np.float64)
        least, low = (x[some] / np.maximum(until, _TINY) for x in (step.least, step.first))
        low = np.minimum(low, 1.0)
        missed, todo = np.ones(some.size, np.bool_), np.arange(some.size)

        def at(u: Array, k: Array) -> tuple[Array, ...]:
            return step.after(u * until[k], some[k])

        def value(u: Array, k: Array) -> Array:
            return at(u, todo[k])[0][:, i]

        while todo.size:
            k = todo[low[todo] > 0.0]
            if k.size:
                at_low[k] = at(low[k], k)[0][:, i]
            with np.errstate(all="ignore"):
                points = low[todo], at_low[todo]
                share = locate(value, points, past[todo], event.direction, least[todo])
            there = ~np.isnan(share)
            k, share = todo[there], share[there]
            missed[k] = False
            rows, time = step.rows[some[k]], step.time(share * until[k], some[k])
            is_known = self._sign * (times[rows, i] - time) <= 0.0
            times[rows, i] = np.where(is_known, times[rows, i], time)
            saved = at(share, k)[1] if event.terminal or event.every else share
            if event.every:
                # a zero at the end of a step is one at the start of the next
                slack = 32.0 * least[k] * until[k] * np.abs(step.rest[some[k]])
                new = ~(np.abs(time - self._last[rows, i]) <= slack)
                self._record(i, rows[new], time[new], saved[new])
                self._last[rows, i] = time
            if event.terminal:
                is_first = ~(self._sign * (self.stopped[rows] - time) <= 0.0)
                rows = rows[is_first]
                self.stopped[rows], self.final[rows] = time[is_first], saved[is_first]
            low[k] = share + 16.0 * least[k]
            todo = k[low[k] < 1.0] if event.every and not event.terminal else k[:0]
        return missed

    def _record(self, i: int, rows: Array, times: Array, saved: Array) -> None:
        """Keep crossings with the values that are saved then, but for those of stopped bodies."""
        is_on = ~(self._sign * (times - self.stopped[rows]) > 0.0)
        kept = self.bodies[rows][is_on], times[is_on], saved[is_on]
        self.results.crossings.append((i, *kept))

    def _divide(self, piece: Piece, rows: Array, begun: Array) -> None:
        """Divide the marked steps of bodies where switches cross, and take them to the end.

        Bodies go on from there in ``begun``.
        """
        job, events, n = self._job, self._events, rows.size
        marks = self.states[rows, self._each("mark")]
        step = _Step(self, piece, rows, events + np.nanargmin(marks[:, events:], axis=1))
        mark = np.fmin.reduce(marks[:, events:], axis=1)
        begun[rows] = self.states[rows]  # with the diagnostics before the step
        slides = begun[rows, self._group("slides", len(job.switches))] != 0.0
        counts = np.zeros(slides.shape, np.int64)
        todo, nothing = np.arange(n), np.zeros(n)
        low = step.after(nothing, todo)[0]
        before = self.states[rows, self._each("before")].astype(np.float64)
        # an event may have jumped before the step
        low[:, :events] = np.where(
            marks[:, :events] == mark[:, None], before[:, :events], low[:, :events]
        )
        while todo.size:
            share = self._first_crossing(step, todo, low[todo, events:], slides[todo])
            crosses = ~(np.fmin.reduce(share, axis=1) == np.inf)
            until = np.where(crosses, np.fmin.reduce(share, axis=1), 1.0)
            reached, saved, x, found = step.after(until, todo)
            held = np.ix_(rows[todo], self._columns("held", len(job.of_steps)))
            begun[held] = np.fmax(begun[held], found)
            for i in self._order:
                self._cross(i, step, todo, low[todo, i], reached[:, i], until)
            time = step.time(until, todo)
            self._save_within(piece.tape, step, todo, time, begun)
            low[todo, :events] = reached[:, :events]
            for k, column in enumerate(job.switches):
                each = share[:, k] == until
                x[each, column] *= -1.0
                first = step.first[todo]
                some = each & ~((first > 0.0) & (until <= first))
                self._record(events + k, rows[todo[some]], time[some], saved[some])
                counts[todo, k] += each
            slides[todo] |= counts[todo] >= _MOST
            step.go_on(todo, x, time, step.end[todo] - time)
            step.first[todo] = 0.0
            # on the side to which it has crossed
            now = step.after(nothing[: todo.size], todo)[0][:, events:]
            size = np.maximum(np.abs(now), _TINY)
            sides = x[:, list(job.switches)]
            low[todo, events:] = np.where(share == until[:, None], sides * size, now)
            todo = todo[crosses & (until < 1.0) & np.isnan(self.stopped[rows[todo]])]
        self._release(step, begun, mark, low, slides)

    def _first_crossing(self, step: _Step, rows: Array, now: Array, slides: Array) -> Array:
        """The shares of what is left at which switches cross first, infinite where they do not.

        ``now`` are the values of their functions at the begin; those that slide do not cross.
        """
        events, past = self._events, step.after(np.ones(rows.size), rows)[0]
        shares = np.full(now.shape, np.inf)
        for k, column in enumerate(self._job.switches):
            side = step.x[rows, column]

            def on_side(g: Array, some: Array, k: int = k, side: Array = side) -> Array:
                # a zero is not on the other side
                g = side[some] * g[:, events + k]
                return np.where(g == 0.0, _TINY, g)

            is_other = side * now[:, k] < 0.0
            shares[is_other & ~slides[:, k], k] = 0.0
            some = np.flatnonzero(~is_other & ~slides[:, k])
            at_low = np.maximum(side[some] * now[some, k], _TINY)
            points, least = (np.zeros(some.size), at_low), step.least[rows[some]]

            def value(
                u: Array, j: Array, some: Array = some, on_side: Callable[..., Array] = on_side
            ) -> Array:
                return on_side(step.after(u, rows[some[j]])[0], some[j])

            with np.errstate(all="ignore"):
                found = locate(value, points, on_side(past[some], some), -1, least, beyond=True)
            shares[some, k] = np.where(np.isnan(found), np.inf, found)
        return shares

    def _save_within(
        self, tape: Tape, step: _Step, some: Array, until: Array, begun: Array
    ) -> None:
        """Make the saves within what is left of steps, until some times."""
        records = tape[tape["action"] == Action.SAVE]
        times, slots = self._sign * times_of(records), records["slot"]
        t, largest = step.t[some], self._program.rows["norm"]
        # one at the end of a step is made by the tape
        is_end = until == step.end[some]
        first, past = (np.searchsorted(times, self._sign * x, "right") for x in (t, until))
        last = np.where(is_end, np.searchsorted(times, self._sign * until), past)
        for j in range(int((last - first).max(initial=0))):
            k = np.flatnonzero(first + j < last)
            which, rows = (first + j)[k], step.rows[some[k]]
            share = (self._sign * times[which] - t[k]) / step.rest[some[k]]
            saved = step.after(share, some[k])[1]
            self.results.saves[slots[which], rows] = saved
            begun[rows, largest] = np.fmax(begun[rows, largest], np.abs(saved[:, -1]))

    def _release(self, step: _Step, begun: Array, mark: Array, now: Array, slides: Array) -> None:
        """Let bodies sleep, in ``begun``, until the step is over that has been divided."""
        rows, some, size = step.rows, np.arange(step.rows.size), self._job.size
        step.go_on(some, step.x, step.end, step.dt)
        for k, column in enumerate(self._job.switches):
            follows = slides[:, k] & (now[:, self._events + k] != 0.0)
            side = np.sign(now[:, self._events + k])
            step.x[:, column] = np.where(follows, side, step.x[:, column])
        half, whole = (step.after(np.full(some.size, u), some)[0] for u in (0.5, 1.0))
        group = self._program.rows
        with np.errstate(over="ignore"):
            begun[rows, :size] = step.x
            begun[rows, group["last"] : group["last"] + size] = step.x
            # of the parabola through the next values, one step before
            begun[rows, self._each("before")] = 6.0 * now - 8.0 * half + 3.0 * whole
            begun[rows, self._each("after")] = now
        begun[rows, self._each("mark")] = np.nan
        begun[rows, self._each("skip")] = mark[:, None]
        begun[rows, group["release"]] = mark
        begun[rows, self._group("slides", len(self._job.switches))] = slides
        self._until[rows] = step.end

    def _save(self, tape: Tape) -> None:
        """Replace the saves of bodies that have stopped by their final values."""
        if np.isnan(self.stopped).all():
            return
        past = self._sign * self.stopped
        for record in tape[tape["action"] == Action.SAVE]:
            late = np.flatnonzero(self._sign * times_of(record) >= past)
            self.results.saves[record["slot"], late] = self.final[late]


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
