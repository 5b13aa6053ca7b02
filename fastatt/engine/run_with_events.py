"""A run with events: which bodies are marked, where they cross, and what is saved then.

When a piece has been performed, the marked bodies are located. A body whose mark was a false alarm
performs the piece again, with later marks alone, and so does one whose step has been divided.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.division import Division
from fastatt.engine.location import MarkedSteps, Points, crossings_within
from fastatt.engine.marks import MOST_CROSSINGS
from fastatt.engine.run import Run
from fastatt.engine.status import FLAGS, Status
from fastatt.engine.tape import Action, Piece, Tape, times_of
from fastatt.threads import in_threads

Array = NDArray[Any]

# bodies that a thread performs again, at least
_SOME = 1024
# s for locating what is marked, however few bodies are
_ROUND = 2e-3
# steps of the shortest piece
_LEAST = 64


class RunWithEvents(Run):
    """A run with events, or of a scene with switches.

    ``stopped`` are the times at which bodies stopped, NaN of others, and ``final`` their values
    from then on. ``until`` are the times until which divided steps took them in this piece;
    ``sign`` is that of the steps, and ``order`` the events, terminal ones first.
    """

    def _begin(self) -> None:
        """Make the states from initial values, before the first tape."""
        self._program, self._job = self.setup.program, self.setup.program.job
        self.sign, saves = float(np.sign(self.steps.legs["dt"][0])), self.results.saves
        self._events, n = len(self._job.events), saves.shape[1]
        self.stopped, self.final = np.full(n, np.nan), np.zeros_like(saves[0])
        self.order = sorted(range(self._events), key=lambda i: not self._job.holds[i])
        # of each event its last crossing
        self._last = np.full((n, self._events), np.nan)
        self._crossed = np.zeros((n, self._job.watched), np.int64)
        self.until = np.full(n, -self.sign * np.inf)
        self.perform(self.steps.begun(self.t0))
        self.states[:, self._program.is_of_events] = np.nan

    def _resume(self, kept: Mapping[str, Array]) -> None:
        """Go on from what another run kept, of the same events or others."""
        super()._resume(kept)
        if "of_events" in kept:
            self.states[:, self._program.is_of_events] = kept["of_events"]
            for name, values in self._kept_of_events().items():
                values[:] = kept[name]
            # only what was located has a mark between two pieces
            marks = self.states[:, self.group("mark")][:, : self._events]
            marks[np.isnan(self.results.event_times)] = np.nan

    def kept(self) -> dict[str, Array]:
        """Copies of what another run needs to go on from here."""
        kept = {name: values.copy() for name, values in self._kept_of_events().items()}
        of_events = self.states[:, self._program.is_of_events]
        return {**super().kept(), "of_events": of_events, **kept}

    def _kept_of_events(self) -> dict[str, Array]:
        times = self.results.event_times
        return {"event_times": times, "stopped": self.stopped, "final": self.final}

    def advance(self, piece: Piece) -> None:
        """Perform a piece, again until no body has a false alarm, or a step to divide."""
        begun, rounds, seconds = self.states.copy(), 0, 0.0
        is_over = ~np.isnan(self.stopped)
        super().advance(piece)
        while (again := self._again(piece, begun, is_over)).size:
            self.states[again] = begun[again]
            parts = np.array_split(again, min(self.n_threads, -(-again.size // _SOME)))
            calls = [partial(self.perform, piece.tape, x, since=self.until[x]) for x in parts]
            rounds, seconds = rounds + 1, seconds + sum(in_threads(calls, self.n_threads))
        if seconds > _ROUND * rounds:
            self._pace = max(self._pace // 4, _LEAST)  # fewer are performed again
        self._save(piece.tape)
        # the next piece counts its steps anew
        self.states[:, self.group("skip")] = np.nan
        self.states[:, self.group("release")] = np.nan
        self.until[:] = -self.sign * np.inf
        self._read_flags()

    def _read_flags(self) -> None:
        super()._read_flags()
        slides = self.states[:, self.group("slides")] != 0.0
        self.results.status[:] |= slides.any(axis=1) * FLAGS(Status.SLIDING)

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which events were not located, and switches (N, E), had a value that is not finite."""
        is_lost = self.states[:, self.group("lost")] == 1.0
        is_lost[:, : self._events] &= np.isnan(self.results.event_times)
        return np.asarray(is_lost & (self.results.status == 0)[:, None])

    @property
    def overfull(self) -> NDArray[np.bool_]:
        """Of which events and switches (N, E) not all crossings are kept."""
        return np.asarray(self._crossed > MOST_CROSSINGS)

    def group(self, name: str) -> slice:
        """The columns of a group of what bodies keep."""
        first = self._program.rows[name]
        return slice(first, first + self._program.kept[name])

    def _again(self, piece: Piece, begun: Array, is_over: Array) -> NDArray[np.int64]:
        """Locate what is marked in a piece; the bodies that have to go on from ``begun`` again.

        These were marked without a crossing, or at one of several, and ignore their marks up to
        then; or a switch was marked, and they sleep until the step is over that was divided.
        """
        of_switches = self.states[:, self.group("mark")][:, self._events :]
        divided_at = np.fmin.reduce(of_switches, axis=1, initial=np.inf)
        again = self._locate_marked(piece, begun, divided_at, is_over)
        divided = np.flatnonzero(np.isfinite(divided_at) & ~again & np.isnan(self.stopped))
        if divided.size:
            Division(self, piece, divided, begun).advance()
            again[divided] = np.isnan(self.stopped[divided])
        return np.flatnonzero(again)

    def _locate_marked(
        self, piece: Piece, begun: Array, before: Array, is_over: Array
    ) -> NDArray[np.bool_]:
        """Locate events in steps ``before`` others; which bodies ignore their marks from now on."""
        times, marks = self.results.event_times, self.states[:, self.group("mark")]
        ends, skip = np.full(times.shape, np.nan), begun[:, self.group("skip")]
        for i in self.order:
            wanted = np.isnan(times[:, i]) | self._job.events[i].every
            rows = np.flatnonzero((marks[:, i] < before) & ~is_over & wanted)
            if not rows.size:
                continue
            steps = MarkedSteps(self, piece, rows, np.full(rows.size, i))
            values = (self.states[rows, self._program.rows[x] + i] for x in ("before", "after"))
            is_missed = self.locate(i, steps, np.arange(rows.size), (*values,), np.ones(rows.size))
            again = is_missed | self._job.events[i].every
            skip[rows[again], i] = marks[rows[again], i]
            ends[rows[again], i] = steps.end[again]
        times[self.sign * (times - self.stopped[:, None]) > 0.0] = np.nan
        # what follows the time at which a body stopped does not matter
        matters = ~(self.sign * (ends - self.stopped[:, None]) >= 0.0) & ~np.isnan(ends)
        return np.asarray(matters.any(axis=1))

    def locate(
        self, i: int, steps: MarkedSteps, some: Array, ends: Points, until: Array
    ) -> NDArray[np.bool_]:
        """Record where an event crosses zero in what is left of some steps; where it does not.

        ``ends`` are its values now and at the shares ``until``.
        """
        event, times = self._job.events[i], self.results.event_times
        is_missed = np.ones(some.size, np.bool_)
        for k, share in crossings_within(steps, some, i, event, ends, until):
            is_missed[k] = False
            rows, time = steps.rows[some[k]], steps.time(share, some[k])
            is_known = self.sign * (times[rows, i] - time) <= 0.0
            times[rows, i] = np.where(is_known, times[rows, i], time)
            if not (event.terminal or event.every):
                continue
            saved = steps.after(share, some[k])[1]
            if event.every:
                # a zero at the end of a step is one at the start of the next
                is_new = ~(np.abs(time - self._last[rows, i]) <= 32.0 * steps.least_time[some[k]])
                self.record(i, rows[is_new], time[is_new], saved[is_new])
                self._last[rows, i] = time
            if event.terminal:
                is_first = ~(self.sign * (self.stopped[rows] - time) <= 0.0)
                rows = rows[is_first]
                self.stopped[rows], self.final[rows] = time[is_first], saved[is_first]
        return is_missed

    def record(self, which: int, rows: Array, times: Array, saved: Array) -> None:
        """Keep crossings with the values that are saved then, but for those of stopped bodies.

        Of each body the first ones are kept.
        """
        is_on = ~(self.sign * (times - self.stopped[rows]) > 0.0)
        self._crossed[rows, which] += 1
        is_on &= self._crossed[rows, which] <= MOST_CROSSINGS
        self.results.crossings.keep(which, self.bodies[rows][is_on], times[is_on], saved[is_on])

    def _save(self, tape: Tape) -> None:
        """Replace the saves of bodies that have stopped by their final values."""
        if np.isnan(self.stopped).all():
            return
        past = self.sign * self.stopped
        for record in tape[tape["action"] == Action.SAVE]:
            late = np.flatnonzero(self.sign * times_of(record) >= past)
            self.results.saves[record["slot"], late] = self.final[late]
