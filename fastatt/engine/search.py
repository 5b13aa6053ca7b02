"""The search for events: which bodies are marked, where they cross, and what is saved then."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.rows import RowFunction
from fastatt.engine.events import EVENT, locate, values
from fastatt.engine.job import WIDTH, GivenScope, Job
from fastatt.engine.program import Program
from fastatt.engine.tape import Action, Legs, Tape
from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import choose

if TYPE_CHECKING:
    from fastatt.engine.run import Results, Setup

Array = NDArray[Any]

# points in a step that rounding tells apart, in either precision of the state
_LEAST = {"double": 2.0**-50, "single": 2.0**-22}


class Search:
    """The search for the events of a run of some bodies.

    ``stopped`` are the times at which they stopped, NaN of others, and ``final`` their values from
    then on.
    """

    def __init__(
        self, program: Program, setup: Setup, params: Array, legs: Legs, t0: float,
        results: Results,
    ) -> None:  # fmt: skip
        self._program, self._tables, self._params = program, setup.tables, params
        self._legs, self._t0 = legs, t0
        self.times, self._watches = results.event_times, program.job.events
        n, width = len(self.times), results.saves.shape[2]
        self.stopped = np.full(n, np.nan)
        self.final = np.zeros((n, width), results.saves.dtype)
        self._sign = float(np.sign(legs["dt"][0]))

    def located(self, states: Array, begun: Array) -> NDArray[np.int64]:
        """Locate what is marked in ``states``; the bodies that have to go on from ``begun`` again.

        These were marked without a crossing, and ignore their marks up to then.
        """
        was_stopped = ~np.isnan(self.stopped)
        ends = np.full(self.times.shape, np.nan)
        for i in range(len(self._watches)):
            event = self._program.layout.rows.columns("event").start + i * len(EVENT)
            mark, skip, end = (event + EVENT.index(name) for name in ("mark", "skip", "end"))
            is_new = (states[:, mark] > 0.5) & np.isnan(self.times[:, i]) & ~was_stopped
            rows = np.flatnonzero(is_new)
            if not rows.size:
                continue
            step = self._steps(states[rows, end : end + 2].sum(axis=1, dtype=np.float64))
            self.times[rows, i], final = self._crossings(i, event, rows, step, states)
            missed = rows[np.isnan(self.times[rows, i])]
            begun[missed, skip : skip + 2] = states[missed, end : end + 2]
            ends[missed, i] = states[missed, end]
            if final is not None:
                first = ~(self._sign * (self.stopped[rows] - self.times[rows, i]) <= 0.0)
                first &= ~np.isnan(self.times[rows, i])
                self.stopped[rows[first]] = self.times[rows[first], i]
                self.final[rows[first]] = final[first]
        self.times[self._sign * (self.times - self.stopped[:, None]) > 0.0] = np.nan
        # what follows the time at which a body stopped does not matter
        matters = ~(self._sign * (ends - self.stopped[:, None]) >= 0.0) & ~np.isnan(ends)
        return np.flatnonzero(matters.any(axis=1))

    def _steps(self, ends: Array) -> dict[str, Array]:
        """The clocks of steps that end at times: how many were taken, their size, the window."""
        legs = self._legs
        begins = self._t0 + legs["begin"]
        slack = 0.0 if self._program.job.kind == "double" else 2.0**-46
        leg = np.searchsorted(
            self._sign * (begins + legs["end"] * legs["dt"]),
            self._sign * ends - slack * np.abs(ends),
        )
        leg = np.minimum(leg, len(legs) - 1)
        dt = legs["dt"][leg]
        taken = np.rint((ends - begins[leg]) / dt) - 1.0
        return {
            "begin": begins[leg], "taken": taken, "dt": dt,
            "low": legs["low"][leg], "high": legs["high"][leg],
        }  # fmt: skip

    def _crossings(
        self, i: int, event: int, rows: Array, step: dict[str, Array], states: Array
    ) -> tuple[Array, Array | None]:
        """The times at which the event i of bodies crosses zero in a step; NaN where it does not.

        Next come the values that are saved then, if it is terminal.
        """
        layout, job = self._program.layout, self._program.job
        forms = self._program.formulas
        size = forms.size + forms.extras
        first = layout.rows.first["marked"] + i * size
        x, e = np.split(states[rows, first : first + size].astype(np.float64), [forms.size], axis=1)
        p = self._params if len(self._params) == 1 else self._params[rows]
        after = _after(replace(job, kind="double", width=WIDTH))
        since = step["taken"] * step["dt"]
        t = step["begin"] + since
        clock = np.stack([t, since, *(step[name] for name in ("dt", "low", "high", "dt"))], axis=1)

        def stepped(share: Array, some: Any = slice(None)) -> tuple[Array, ...]:
            clock[some, -1] = share * step["dt"][some]
            inputs = (y if len(y) == 1 else y[some] for y in (x, p, e, clock))
            with np.errstate(all="ignore"):
                return after(*inputs, tables=self._tables)

        before, past = states[rows, event : event + 2].astype(np.float64).T
        latest = np.abs(step["begin"] / step["dt"] + step["taken"])
        least = np.maximum(_LEAST[job.kind], latest * 2.0**-52)
        with np.errstate(all="ignore"):
            share = locate(
                lambda *of: stepped(*of)[0][:, i], before, past, self._watches[i].direction, least
            )
        ends = step["begin"] + (step["taken"] + 1.0) * step["dt"]
        times = np.where(share == 1.0, ends, t + share * step["dt"])
        if not self._watches[i].terminal:
            return times, None
        return times, stepped(np.where(np.isnan(share), 1.0, share))[1]

    def save(self, saves: Array, tape: Tape) -> None:
        """Replace the saves of bodies that have stopped by their final values."""
        if np.isnan(self.stopped).all():
            return
        past = self._sign * self.stopped
        for record in tape[tape["action"] == Action.SAVE]:
            time = record["begin"] + record["first"] * record["dt"]
            late = np.flatnonzero(self._sign * time >= past)
            saves[record["slot"], late] = self.final[late]


@lru_cache(maxsize=64)
def _after(job: Job) -> RowFunction:
    """The values of the events after a step of any size, and what an event that stops saves.

    A row is a body with its stepped variables after some steps of its clock: the time, that since
    the clock began, the step size, the window, and the size of the step.
    """
    forms, stops = job.formulas, any(watch.terminal for watch in job.events)
    stages = job.method.stages or ((1.0, 1.0, 0.0),)

    def after(x: Vector, p: Vector, e: Vector, clock: Vector) -> Any:
        t, since, dt, low, high, h = clock
        scope = GivenScope(forms, x, p, (low, high))
        t = scope.at(t)
        begun = scope.left(t, scope.span(since), scope.span(forms.share * dt), x, e)
        extras = scope.prepared(scope.span(h), begun)
        y = scope.entered(t, scope.span(forms.share * h), begun, extras)
        for first, other, node in stages:
            y, _ = scope.step(t + node * h, scope.span(first * h), scope.span(other * h), y, extras)
        ended = scope.left(t + h, scope.span(h), scope.span(forms.share * h), y, extras)
        reached = tuple(values(scope, t + h, ended))
        if not stops:
            return reached
        saved = [(*out, error) for out, error in (scope.output(begun), scope.output(ended))]
        return reached, tuple(choose(h == 0.0, y, z) for y, z in zip(*saved, strict=True))

    results = (len(job.events), *[forms.handed_out + 1] * stops)
    inputs = {"x": forms.size, "p": forms.parameters, "e": forms.extras, "clock": 6}
    return RowFunction(after, inputs, results)
