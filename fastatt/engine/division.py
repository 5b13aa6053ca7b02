"""Steps that are divided where switches cross, from crossing to crossing until their end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.location import TINY, MarkedSteps, locate
from fastatt.engine.tape import Action, Piece, times_of

if TYPE_CHECKING:
    from fastatt.engine.run_with_events import RunWithEvents

Array = NDArray[Any]

# crossings of a switch in a step, from which on a body slides
_MOST = 32


class Division:
    """The marked steps of bodies ``rows``, which go on from the ends of these steps in ``begun``.

    ``now`` are the values of events and switches where each body is, and ``slides`` says which
    switches slide.
    """

    def __init__(self, run: RunWithEvents, piece: Piece, rows: Array, begun: Array) -> None:
        self._run, self._tape, self._begun = run, piece.tape, begun
        job = run.setup.program.job
        self._events, self._sides = len(job.events), list(job.switches)
        marks = run.states[rows, run.group("mark")]
        of_switches = marks[:, self._events :]
        self._mark = np.fmin.reduce(of_switches, axis=1)
        places = self._events + np.nanargmin(of_switches, axis=1)
        self._steps = MarkedSteps(run, piece, rows, places)
        begun[rows] = run.states[rows]  # with the diagnostics before the step
        self._slides = begun[rows, run.group("slides")] != 0.0
        self._counts = np.zeros(self._slides.shape, np.int64)
        (self._now, *_) = self._steps.after(np.zeros(rows.size), np.arange(rows.size))
        # an event may have jumped before the step
        before = run.states[rows, run.group("before")].astype(np.float64)
        is_marked = (marks == self._mark[:, None])[:, : self._events]
        self._now[:, : self._events][is_marked] = before[:, : self._events][is_marked]

    def advance(self) -> None:
        """Take the bodies to the ends of their steps, where they sleep until the tape is there."""
        todo = np.arange(self._mark.size)
        while todo.size:
            todo = self._to_next_crossings(todo)
        self._sleep()

    def _to_next_crossings(self, todo: Array) -> Array:
        """Take bodies to their next crossings, or to the end; those that are not there yet."""
        run, steps, events = self._run, self._steps, self._events
        reached = steps.after(np.ones(todo.size), todo)
        shares = self._first_crossings(todo, reached[0])
        crosses = np.flatnonzero(np.isfinite(shares).any(axis=1))
        until = np.minimum(shares.min(axis=1), 1.0)
        for at_end, there in zip(reached, steps.after(until[crosses], todo[crosses]), strict=True):
            at_end[crosses] = there
        values, saved, x, of_steps = reached
        rows, columns = steps.rows[todo], self._begun[:, run.group("held")]
        columns[rows] = np.fmax(columns[rows], of_steps)
        for i in run.order:
            run.locate(i, steps, todo, (self._now[todo, i], values[:, i]), until)
        time, first = steps.time(until, todo), steps.first[todo]
        self._save(todo, time)
        crossed = shares == until[:, None]
        x[:, self._sides] *= np.where(crossed, -1.0, 1.0)
        for k, is_new in enumerate((crossed & ~((first > 0.0) & (until <= first))[:, None]).T):
            run.record(events + k, rows[is_new], time[is_new], saved[is_new])
        self._counts[todo] += crossed
        self._slides[todo] |= self._counts[todo] >= _MOST
        steps.go_on(todo, x, time, steps.end[todo] - time)
        self._now[todo], todo = values, todo[crosses]
        now = steps.after(np.zeros(todo.size), todo)[0][:, events:]
        # on the side to which it has crossed
        sides = x[crosses][:, self._sides] * np.maximum(np.abs(now), TINY)
        self._now[todo, events:] = np.where(crossed[crosses], sides, now)
        goes_on = (until[crosses] < 1.0) & np.isnan(run.stopped[steps.rows[todo]])
        return np.asarray(todo[goes_on])

    def _first_crossings(self, todo: Array, past: Array) -> Array:
        """The shares of what is left at which switches cross first, infinite where they do not.

        ``past`` are the values at the end; switches that slide do not cross.
        """
        steps, shares = self._steps, np.full((todo.size, len(self._sides)), np.inf)
        for k, column in enumerate(self._sides):
            which, sides = self._events + k, steps.x[todo, column]
            now, may_cross = sides * self._now[todo, which], ~self._slides[todo, k]
            is_other = now < 0.0
            shares[is_other & may_cross, k] = 0.0
            some = np.flatnonzero(~is_other & may_cross)
            bodies, side = todo[some], sides[some]

            def value(
                share: Array, j: Array, bodies: Array = bodies, side: Array = side,
                which: int = which,
            ) -> Array:  # fmt: skip
                return _on_side(side[j] * steps.after(share, bodies[j])[0][:, which])

            low = np.zeros(some.size), np.maximum(now[some], TINY)
            high, least = _on_side(side * past[some, which]), steps.least[bodies]
            crossings = locate(value, low, high, -1, least, beyond=True)
            shares[some, k] = np.where(np.isnan(crossings), np.inf, crossings)
        return shares

    def _save(self, todo: Array, until: Array) -> None:
        """Make the saves within what is left of steps, until some times."""
        run, steps, sign = self._run, self._steps, self._run.sign
        records = self._tape[self._tape["action"] == Action.SAVE]
        times, slots, begin = sign * times_of(records), records["slot"], steps.t[todo]
        first, past = (np.searchsorted(times, sign * x, "right") for x in (begin, until))
        # one at the end of a step is made by the tape
        before = np.searchsorted(times, sign * until)
        last = np.where(until == steps.end[todo], before, past)
        norm = self._begun[:, run.group("norm")]
        for j in range(int((last - first).max(initial=0))):
            k = np.flatnonzero(first + j < last)
            which, rows = (first + j)[k], steps.rows[todo[k]]
            share = (sign * times[which] - begin[k]) / steps.rest[todo[k]]
            saved = steps.after(share, todo[k])[1]
            run.results.saves[slots[which], rows] = saved
            norm[rows] = np.fmax(norm[rows], np.abs(saved[:, -1:]))

    def _sleep(self) -> None:
        """Let the bodies sleep, in ``begun``, until the step is over that has been divided."""
        run, steps, some = self._run, self._steps, np.arange(self._mark.size)
        rows, begun, now = steps.rows, self._begun, self._now
        steps.go_on(some, steps.x, steps.end, steps.dt)
        of_switches = now[:, self._events :]
        follows = self._slides & (of_switches != 0.0)
        sides = steps.x[:, self._sides]
        steps.x[:, self._sides] = np.where(follows, np.sign(of_switches), sides)
        half, whole = (steps.after(np.full(some.size, u), some)[0] for u in (0.5, 1.0))
        asleep = {
            "x": steps.x, "last": steps.x, "after": now,
            # of the parabola through the next values, one step before
            "before": 6.0 * now - 8.0 * half + 3.0 * whole,
            "mark": np.nan, "skip": self._mark[:, None], "release": self._mark[:, None],
            "slides": self._slides,
        }  # fmt: skip
        with np.errstate(over="ignore"):
            for name, numbers in asleep.items():
                begun[rows, run.group(name)] = numbers
        run.until[rows] = steps.end


def _on_side(values: Array) -> Array:
    """Values with a zero, which is not on the other side, as positive ones."""
    return np.where(values == 0.0, TINY, values)
