"""A run as a tape: all decisions about its steps, made by NumPy alone, as an array of records.

``engine.machine`` performs a tape on each tile of bodies. A record is an action, its clock, and the
number of steps of this clock after which the action happens (``first``). It calls a part of the
program (``START`` to ``MIDDLE``, and from ``JUMP`` on), or copies a tile. A *clock* is a step size,
a time of origin and a window: after n steps of it the time is ``begin + n dt``, and rates, torques
and forces are evaluated from ``low`` to ``high`` only. All bodies of a tape share it.

A *leg* is a stretch of steps with one clock. Breakpoints divide a run into legs. One on a whole
step changes only the window. One within a step divides that step into two legs of one shorter step
each, and m breakpoints divide it into m + 1 of them; whole steps then go on where they would be
without breakpoints, at multiples of the step size from the start of the run. Where two legs meet,
the order is

1. ``SAVE`` at this time, with the old clock;
2. ``LEAVE`` with the old clock, ``JUMP`` and ``ENTER`` with the new one. ``LEAVE`` and ``ENTER``
   are there only for methods whose stepped variables depend on the clock, and ``JUMP`` only where a
   sampled controller updates its states, one for each that is due, in the order of the terms;
3. saves within the next step, each on a copy of the tile: ``FORK, [LEAVE, ENTER], STEPS, SAVE,
   JOIN``, with another clock from ``ENTER`` or ``STEPS`` on;
4. with events, ``LOOK``, and ``MIDDLE`` on a copy after half of the step: a parabola through three
   values tells whether an event may cross zero twice, and the values before belong to other steps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray


class Action(IntEnum):
    """What a record does: it calls a part of the program; ``FORK`` to ``RESTORE`` copy a tile."""

    START = 0  #: the state from initial values
    STEPS = 1  #: steps [first, end), at most a block
    SAVE = 2  #: the values of a save, which go to a slot
    PROJECT = 3  #: the projection of the state
    LEAVE = 4  #: the state from the stepped variables
    ENTER = 5  #: the stepped variables from the state
    STATUS = 6  #: the flags of each body
    LOOK = 7  #: the values of events where a leg begins
    MIDDLE = 8  #: the values of events half a step later
    FORK = 9  #: copies the tile
    JOIN = 10  #: takes the copy back, but for diagnostics and the values of ``MIDDLE``
    RESTORE = 11  #: the tile as an earlier tape left it
    JUMP = 12  #: the states of the first sampled controller after a sample time; 13: of the second


#: the fields of a clock
CLOCK = ("dt", "begin", "low", "high")
#: ``count`` is how many steps after the end of a piece this clock begins, as a negative number
RECORD = np.dtype(
    [(name, np.int64) for name in ("action", "first", "end", "slot")]
    + [(name, np.float64) for name in (*CLOCK, "count")]
)
_BYTES = np.dtype((np.void, RECORD.itemsize))
#: a leg: its clock, with times since the start of the run; its steps [first, end), counted from
#: ``begin``; how many whole steps the run has taken when it ends, -1 within a step; as bits, which
#: controllers are due before it
LEG = np.dtype(
    [(name, np.float64) for name in CLOCK]
    + [(name, np.int64) for name in ("first", "end", "whole", "jumps")]
)
#: steps of a block, after which rotation angles are checked, and of one whose steps call a function
BLOCK, CALLING_LENGTH = 256, 2
#: and of one of a scene with switches, whose bodies perform a piece again
SWITCHING_LENGTH = 64
#: legs and saves of a piece of a tape, at most
_LEGS, _SAVES = 1 << 13, 1 << 12
# records of the tapes of a run that are kept for the next run, at most
_KEPT = 1 << 16

Tape = NDArray[Any]
Legs = NDArray[Any]
Times = NDArray[np.float64]
Whole = NDArray[np.int64]


class Breaks(NamedTuple):
    """The times, s, at which a run is divided, in its order, the first being its start.

    ``since`` are counted from the start, with ``slack`` for their rounding; ``low`` and ``high``
    are the window of what follows each; bit k of ``jumps`` says that the k-th controller is due.
    """

    times: Times
    since: Times
    slack: Times
    low: Times
    high: Times
    jumps: NDArray[np.int64]


#: a run that nothing divides
UNBROKEN = Breaks(
    np.zeros(1), np.zeros(1), np.zeros(1), np.full(1, -np.inf), np.full(1, np.inf),
    np.zeros(1, np.int64),
)  # fmt: skip


def on_grid(since: Any, dt: Any, slack: Any) -> tuple[Any, Any]:
    """(whole steps to times, the rest in s), where rounding leaves no rest."""
    nearest = np.rint(since / dt)
    is_on = np.abs(since - nearest * dt) <= slack
    count = np.where(is_on, nearest, np.floor(since / dt))
    return count.astype(np.int64), np.where(is_on, 0.0, since - count * dt)


def legs_of(dt: float, n_steps: int, breaks: Breaks = UNBROKEN, end: float | None = None) -> Legs:
    """The legs of a run of ``n_steps``; ``end`` is its duration, s, if its last step is shorter.

    An example: steps of 0.5 s and a breakpoint at 0.7 s give legs with the step sizes 0.5, 0.2, 0.3
    and 0.5 s.
    """
    counts, rests = on_grid(breaks.since[1:], dt, breaks.slack[1:])
    last = (n_steps, 0.0) if end is None else (n_steps - 1, end - (n_steps - 1) * dt)
    ends = [*zip(counts.tolist(), rests.tolist(), strict=True), last]
    times = [*breaks.since[1:].tolist(), n_steps * dt if end is None else end]
    windows = zip(breaks.low.tolist(), breaks.high.tolist(), breaks.jumps.tolist(), strict=True)
    legs: list[tuple[float, ...]] = []
    n, reached = 0, None  # whole steps so far; the time reached within the next one, if any
    for (count, rest), time, (*window, jumps) in zip(ends, times, windows, strict=True):
        if reached is not None and count > n:  # the rest of the divided step
            n += 1
            legs.append((n * dt - reached, reached, *window, 0, 1, n, jumps))
            reached, jumps = None, 0  # noqa: PLW2901  # they jump once
        if count > n or n_steps == 0:  # whole steps
            legs.append((dt, 0.0, *window, n, count, count, jumps))
            n, jumps = count, 0  # noqa: PLW2901
        if rest:  # from the last whole step or breakpoint to this one
            begin = n * dt if reached is None else reached
            legs.append((time - begin, begin, *window, 0, 1, -1, jumps))
            reached = time
    if reached is not None:  # a shorter last step counts as a whole one
        legs[-1] = (*legs[-1][:6], n + 1, legs[-1][7])
    return np.array(legs, LEG)


class Piece(NamedTuple):
    """A part of a run: its tape, its share of the steps, and what is done when it ends.

    ``position`` counts all steps, shorter ones too; ``whole`` the whole ones, -1 within a step;
    ``saved`` the saves.
    """

    tape: Tape
    share: tuple[float, float]
    position: int
    whole: int
    saved: int


class Steps:
    """The steps and saves of a run; a position is a number of steps, shorter ones included.

    ``saves`` are the times of saves since the start, s, in order, and the slack for their rounding.
    ``every`` counts the steps between two projections, 0 for none; ``slots`` are the places of the
    saves in the output. ``regrids`` says that the stepped variables depend on the clock. The run
    goes on from an earlier one, if it ``resumes``, after ``done`` whole steps. If events are
    looked for, each leg begins with ``LOOK`` and ``MIDDLE``, and so does the run, if it is ``new``
    to its events.
    """

    def __init__(
        self, legs: Legs, saves: tuple[Times, Times], *, slots: Whole | None = None, every: int = 0,
        block: int = BLOCK, regrids: bool = True, resumes: bool = False, done: int = 0,
        has_events: bool = False, new: bool = True,
    ) -> None:  # fmt: skip
        self.legs, self._every, self._block, self._regrids = legs, every, block, regrids
        self._resumes, self._has_events, self.is_new = resumes, has_events, new
        lengths, (saved, slack) = legs["end"] - legs["first"], saves
        self._stops = np.cumsum(lengths)
        self._starts = self._stops - lengths
        # whole steps until the end of each leg
        self._whole = np.maximum.accumulate(legs["whole"])
        self.length = int(self._stops[-1])
        reached = int(np.searchsorted(self._whole, done))
        self.first = int(self._stops[reached] - self._whole[reached]) + done if done else 0
        self._slots = np.arange(saved.size) if slots is None else slots
        until = np.abs(legs["begin"] + legs["end"] * legs["dt"])
        leg = np.minimum(np.searchsorted(until, np.abs(saved) - slack), len(legs) - 1)
        since = saved - legs["begin"][leg]
        counts, rests = on_grid(since, legs["dt"][leg], slack)
        # a leg may be shorter than rounding
        is_past = counts >= legs["end"][leg]
        self._rests = np.where(is_past, 0.0, rests)
        counts = np.clip(counts, legs["first"][leg], legs["end"][leg])
        positions = self._starts[leg] + counts - legs["first"][leg]
        #: twice the position of a save, and one more within the next step
        self._keys = 2 * np.maximum(positions, self.first) + (self._rests != 0.0)
        # pieces by their first position and length, in times since the start
        self._pieces: dict[tuple[int, int, int], Piece] = {}
        #: whether a tape copies tiles
        self.forks = has_events or bool(self._rests.any())

    def step_before(self, positions: Whole) -> tuple[Legs, Whole]:
        """The legs of the steps that end at some positions, and the steps of a leg before each."""
        leg = np.searchsorted(self._stops, positions)
        return self.legs.take(leg), positions - 1 - self._stops[leg] + self.legs["end"][leg]

    def _whole_until(self, position: int) -> tuple[int, bool]:
        """The whole steps until a position, and whether it is within one."""
        leg = int(np.searchsorted(self._stops, position))
        whole = int(self._whole[leg] - self._stops[leg]) + position
        return max(whole, 0), int(self.legs["whole"][leg]) < 0

    def _saves_until(self, position: int) -> int:
        """How many saves are made until a position."""
        return int(np.searchsorted(self._keys, 2 * position, "right"))

    def begun(self, t0: float) -> Tape:
        """A tape that begins a run from time ``t0`` and does nothing else."""
        return _from(t0, self._records((Action.START,), np.zeros(1, np.int64))[:, 0])

    def pieces(
        self, t0: float, pace: Callable[[], int], stops: Sequence[int] = ()
    ) -> Iterator[Piece]:
        """The tapes of the run from time ``t0``, in pieces of about ``pace()`` steps.

        A piece ends after each of the saves whose numbers are in ``stops``.
        """
        ends = [(int(self._keys[i]) + 1) // 2 for i in reversed(stops)]
        position = self.first
        while True:
            while ends and ends[-1] <= position:
                ends.pop()
            piece = self._piece(position, pace(), ends[-1] if ends else self.length)
            yield piece._replace(tape=_from(t0, piece.tape)) if t0 else piece
            if piece.position == self.length:
                return
            position = piece.position

    def _end(self, position: int, steps: int) -> int:
        """The end of a piece, at a multiple of a block, or between two legs or saves."""
        ends = [self.length]
        leg = int(np.searchsorted(self._stops, position, "right")) + _LEGS
        save = self._saves_until(position) + _SAVES
        if leg < len(self.legs):
            ends.append(int(self._starts[leg]))
        if save < self._keys.size:
            ends.append(max(int(self._keys[save]) // 2, position + 1))
        end = position + max(steps, self._block)
        return end // self._block * self._block if end < min(ends) else min(ends)

    def _piece(self, position: int, steps: int, stop: int) -> Piece:
        """A piece of about so many steps from a position, made once if the run's tape is not long.

        It ends at ``stop``, a position, or before.
        """
        key = position, steps, stop
        piece = self._pieces.get(key)
        if piece is None:
            end = min(self._end(position, steps), stop)
            whole, is_within = self._whole_until(end)
            tape = self._tape(position, end)
            steps = max(1, self.length - self.first)
            share = (position - self.first) / steps, (end - self.first) / steps
            piece = Piece(tape, share, end, -1 if is_within else whole, self._saves_until(end))
            if tape.size + sum(x.tape.size for x in self._pieces.values()) <= _KEPT:
                self._pieces[key] = piece
        return piece

    def _tape(self, position: int, end: int) -> Tape:
        """The records of the steps between two positions, in times since the start."""
        is_first = position == self.first
        saves = slice(0 if is_first else self._saves_until(position), self._saves_until(end))
        saved, rests, slots = self._keys[saves] // 2, self._rests[saves], self._slots[saves]
        on_step = rests == 0.0
        legs = slice(*np.searchsorted(self._starts, (position, end)))
        starts, jumps = self._starts[legs], self.legs["jumps"][legs] != 0
        changes = starts[((starts > 0) | jumps) & self._regrids]
        blocks = np.arange(position // self._block + 1, -(-end // self._block)) * self._block
        first, last = (x // self._every if self._every else 0 for x in (position, end))
        projected = np.arange(first + 1, last + 1) * self._every
        stops = np.sort(np.concatenate([[position], blocks, projected, saved, starts, [end]]))
        taken = np.diff(stops)
        stops, taken = stops[1:][taken > 0], taken[taken > 0]
        looks = starts if self._has_events else starts[:0]
        if self._has_events and self.is_new and is_first and position < end:
            looks = np.union1d(looks, position)
        groups: list[tuple[Whole, Tape]] = []

        def add(records: Callable[..., Tape], what: Any, positions: Whole, **about: Any) -> None:
            if positions.size:
                groups.append((positions, records(what, positions, **about)))

        # what happens at the same position is in this order
        goes_on = self._resumes or self._has_events or not is_first
        start = (Action.START, Action.RESTORE) if goes_on else (Action.START,)
        add(self._records, start, np.array([position]))
        add(self._records, (Action.STEPS,), stops, taken=taken[:, None])
        add(self._records, (Action.PROJECT,), projected)
        add(self._records, (Action.SAVE,), saved[on_step], slots=slots[on_step, None])
        add(self._records, (Action.LEAVE,), changes)
        for k in range(int(self.legs["jumps"].max()).bit_length()):
            due = starts[(self.legs["jumps"][legs] >> k) & 1 != 0]
            add(self._records, (Action.JUMP + k,), due, side="right")
        add(self._records, (Action.ENTER,), changes, side="right")
        about = {"rests": rests[~on_step, None], "slots": slots[~on_step, None]}
        add(self._copied, Action.SAVE, saved[~on_step], **about)
        add(self._records, (Action.LOOK,), looks, side="right")
        add(self._copied, Action.MIDDLE, looks)
        add(self._records, (Action.STATUS,), np.array([end]))
        tape = _in_order(groups)
        tape["count"] -= end
        return tape

    def _records(
        self, actions: Sequence[int], positions: Whole, *,
        side: Literal["left", "right"] = "left", taken: Any = 0, slots: Any = 0,
    ) -> Tape:  # fmt: skip
        """A row of records for each position.

        Where two legs meet, they have the clock of the leg before, and with the ``side`` "right"
        that of the leg after; ``taken`` counts the steps to the position.
        """
        records = np.zeros((positions.size, len(actions)), RECORD)
        positions = positions[:, None]
        leg = np.searchsorted(self._stops, positions, side)
        counts = positions - self._stops[leg] + self.legs["end"][leg]
        columns = {"first": counts - taken, "end": counts, "slot": slots}
        columns["count"] = positions - counts
        columns |= {name: self.legs[name][leg] for name in CLOCK}
        records["action"] = actions
        for name, column in columns.items():
            records[name] = column
        return records

    def _copied(
        self, action: Action, positions: Whole, *, rests: Times | None = None, slots: Any = 0
    ) -> Tape:
        """A shorter step from each position on, on a copy of the tile, and what follows it.

        It takes the ``rests``, s, or half of the step.
        """
        change = (Action.LEAVE, Action.ENTER) if self._regrids else ()
        actions = Action.FORK, *change, Action.STEPS, action, Action.JOIN
        records = self._records(actions, positions, side="right", slots=slots)
        # from ENTER on, another clock, whose only step ends at the action
        step = records[:, actions.index(change[-1] if change else Action.STEPS) : -1]
        step["begin"] += step["first"] * step["dt"]
        step["count"] += step["first"] - 0.5  # within a step, no number is whole
        step["dt"] = 0.5 * step["dt"] if rests is None else rests
        step["first"], step["end"] = step["action"] == action, 1
        return records


def times_of(records: Tape) -> Times:
    """The times at which records happen, s."""
    return np.asarray(records["begin"] + records["first"] * records["dt"])


def _in_order(groups: list[tuple[Whole, Tape]]) -> Tape:
    """Rows of records in the order of their positions, then of the groups."""
    keys = [
        np.repeat(positions * len(groups) + place, records.shape[1])
        for place, (positions, records) in enumerate(groups)
    ]
    order = np.concatenate(keys).argsort(kind="stable")
    # as bytes, since NumPy copies records field by field
    tape = np.concatenate([x.reshape(-1).view(_BYTES) for _, x in groups])
    return tape.take(order).view(RECORD)


def _from(t0: float, tape: Tape) -> Tape:
    """A tape whose clocks begin since the start of the run, from time ``t0``."""
    tape = tape.copy()
    tape["begin"] += t0
    return tape
