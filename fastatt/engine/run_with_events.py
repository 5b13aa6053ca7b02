"""A run with events: which bodies are marked, where they cross, and what is saved then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.rows import RowFunction
from fastatt.engine.job import GivenScope, Job
from fastatt.engine.marks import locate, values
from fastatt.engine.run import Run
from fastatt.engine.tape import Action, Legs, Piece, Tape
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import choose

Array = NDArray[Any]

# steps of the shortest piece
_LEAST = 64
# points in a step that rounding tells apart, in either precision of the state
_POINTS = {"double": 2.0**-50, "single": 2.0**-22}


class RunWithEvents(Run):
    """A run with events.

    ``stopped`` are the times at which bodies stopped, NaN of others, and ``final`` their values
    from then on.
    """

    def _begin(self) -> None:
        """Make the states from initial values, before the first tape."""
        self._program, self._job = self.setup.program, self.setup.program.job
        self._sign, saves = float(np.sign(self.steps.legs["dt"][0])), self.results.saves
        self.stopped, self.final = np.full(saves.shape[1], np.nan), np.zeros_like(saves[0])
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
            marks = self.states[:, self._event("mark")]
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
        """Perform a piece, again until no body has a false alarm."""
        begun, rounds = self.states.copy(), 0
        super().advance(piece)
        while (again := self._located(piece, begun)).size:
            rounds += again.size
            self.states[again] = begun[again]
            self.perform(piece.tape, again)
        if 2 * rounds > len(begun):
            self._pace = max(self._pace // 4, _LEAST)  # fewer are performed again
        self._save(piece.tape)
        # the next piece counts its steps anew
        self.states[:, self._event("skip")] = np.nan
        self._read_flags()

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which events (N, E) were not located, and had a value that is not finite."""
        is_lost = self.states[:, self._event("lost")] == 1.0
        is_fine = self.results.status == 0
        return np.asarray(is_lost & np.isnan(self.results.event_times) & is_fine[:, None])

    def _event(self, name: str) -> slice:
        """The columns of what bodies keep of each event."""
        first = self._program.rows[name]
        return slice(first, first + len(self._job.events))

    def _located(self, piece: Piece, begun: Array) -> NDArray[np.int64]:
        """Locate what is marked in a piece; the bodies that have to go on from ``begun`` again.

        These were marked without a crossing, and ignore their marks up to then.
        """
        times, was_stopped = self.results.event_times, ~np.isnan(self.stopped)
        marks, ends = self.states[:, self._event("mark")], np.full(times.shape, np.nan)
        for i in range(times.shape[1]):
            rows = np.flatnonzero(~np.isnan(marks[:, i]) & np.isnan(times[:, i]) & ~was_stopped)
            if not rows.size:
                continue
            legs, taken = self.steps.step_before(piece.position + marks[rows, i].astype(np.int64))
            is_first = (piece.position + marks[rows, i] - 1 == self.steps.first) & self.steps.is_new
            times[rows, i], final = self._crossings(i, rows, legs, taken, is_first)
            missed = np.isnan(times[rows, i])
            begun[rows[missed], self._event("skip").start + i] = marks[rows[missed], i]
            ends[rows[missed], i] = (self.t0 + legs["begin"] + (taken + 1) * legs["dt"])[missed]
            if final is not None:
                first = ~(self._sign * (self.stopped[rows] - times[rows, i]) <= 0.0) & ~missed
                self.stopped[rows[first]] = times[rows[first], i]
                self.final[rows[first]] = final[first]
        times[self._sign * (times - self.stopped[:, None]) > 0.0] = np.nan
        # what follows the time at which a body stopped does not matter
        matters = ~(self._sign * (ends - self.stopped[:, None]) >= 0.0) & ~np.isnan(ends)
        return np.flatnonzero(matters.any(axis=1))

    def _crossings(
        self, i: int, rows: Array, legs: Legs, taken: Array, is_first: Array
    ) -> tuple[Array, Array | None]:
        """The times at which the event i of bodies crosses zero in a step; NaN where it does not.

        A zero at the start of the first step, to rounding, is no crossing. Next come the values
        that are saved then, if the event is terminal.
        """
        job, states = self._job, self.states[rows]
        size, event = job.size + job.prepared, job.events[i]
        first = self._program.rows["marked"] + i * size
        x, e = np.split(states[:, first : first + size].astype(np.float64), [job.size], axis=1)
        p = self.params if len(self.params) == 1 else self.params[rows]
        after = _after(replace(job, precision="double"))
        begin, dt = self.t0 + legs["begin"], legs["dt"]
        since = taken * dt
        t = begin + since
        clock = np.stack([t, since, dt, legs["low"], legs["high"], dt], axis=1)

        def stepped(share: Array, some: Any = slice(None)) -> tuple[Array, ...]:
            clock[some, -1] = share * dt[some]
            inputs = (y if len(y) == 1 else y[some] for y in (x, p, e, clock))
            with np.errstate(all="ignore"):
                return after(*inputs, tables=self.setup.tables)

        before, past = (
            states[:, self._event(name)][:, i].astype(np.float64) for name in ("before", "after")
        )
        least = np.maximum(_POINTS[job.precision], np.abs(begin / dt + taken) * 2.0**-52)
        # where a zero at the start is over, to rounding
        slack = 16.0 * np.finfo(np.float64).eps * (np.abs(t) + np.abs(self.t0)) / np.abs(dt)
        low = np.where(is_first, np.minimum(slack + 16.0 * least, 1.0), 0.0)
        with np.errstate(all="ignore"):
            if is_first.any():
                some = np.flatnonzero(is_first)
                before[some] = stepped(low[some], some)[0][:, i]
            share = locate(
                lambda *of: stepped(*of)[0][:, i], (low, before), past, event.direction, least
            )
        times = np.where(share == 1.0, begin + (taken + 1) * dt, t + share * dt)
        if not event.terminal:
            return times, None
        return times, stepped(np.where(np.isnan(share), 1.0, share))[1]

    def _save(self, tape: Tape) -> None:
        """Replace the saves of bodies that have stopped by their final values."""
        if np.isnan(self.stopped).all():
            return
        past = self._sign * self.stopped
        for record in tape[tape["action"] == Action.SAVE]:
            time = record["begin"] + record["first"] * record["dt"]
            late = np.flatnonzero(self._sign * time >= past)
            self.results.saves[record["slot"], late] = self.final[late]


@lru_cache(maxsize=64)
def _after(job: Job) -> RowFunction:
    """The values of the events after a step of any size, and what an event that stops saves.

    A row is a body with its stepped variables after some steps of its clock: the time, that since
    the clock began, the step size, the window, and the size of the step.
    """
    stops = any(event.terminal for event in job.events)
    stages, ahead = job.method.stages or ((1.0, 1.0, 0.0),), job.method.ahead

    def after(x: Vector, p: Vector, e: Vector, clock: Vector) -> Any:
        t, since, dt, low, high, h = clock
        scope = GivenScope(job, x, p, (low, high))
        t = scope.at(t)
        begun = scope.left(t, scope.span(since), scope.span(ahead * dt), x, e)
        prepared = scope.prepare(scope.span(h), begun)
        y = scope.entered(t, scope.span(ahead * h), begun, prepared)
        for first, other, node in stages:
            y, _ = scope.step(
                t + node * h, scope.span(first * h), scope.span(other * h), y, prepared
            )
        ended = scope.left(t + h, scope.span(h), scope.span(ahead * h), y, prepared)
        reached = tuple(values(scope, t + h, ended))
        if not stops:
            return reached
        saved = [(*out, error) for out, error in (scope.output(begun), scope.output(ended))]
        return reached, tuple(choose(h == 0.0, y, z) for y, z in zip(*saved, strict=True))

    results = (len(job.events), *[job.handed_out + 1] * stops)
    inputs = {"x": job.size, "p": job.structure.n_params, "e": job.prepared, "clock": 6}
    return RowFunction(after, inputs, results)
