"""A run as a tape: all decisions about its steps, made by NumPy alone, as an array of records.

``engine.machine`` performs a tape on each tile of bodies. A record calls a part of the program
(``START`` to ``MIDDLE``) after ``first`` steps of the clock, or changes the clock, or copies the
tile. A *clock* is a step size and a time of origin: after n steps of it the time is
``begin + n dt``, and rates, torques and forces are evaluated from ``low`` to ``high`` only. All
bodies of a tape share it.

A breakpoint within a step is ``LEAVE, CLOCK, [JUMP], ENTER``, twice: the step is taken in two
shorter ones. A save within a step is made on a copy: ``FORK, LEAVE, CLOCK, ENTER, STEPS, SAVE,
JOIN``. Whole steps begin at multiples of the step size from the start of the run, whatever the
breakpoints and the times of saves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: parts of a program: the state from initial values; steps [first, end), at most a block; values of
#: a save, which go to a slot; the projection; the state from the stepped variables, and back; the
#: status; the jump of states at a sample time; the values of events, and those within a step
START, STEPS, SAVE, PROJECT, LEAVE, ENTER, STATUS, JUMP, LOOK, MIDDLE = range(10)
#: another clock; a copy of the tile; back to that copy, with its clock; what an earlier tape left
CLOCK, FORK, JOIN, RESTORE = range(10, 14)
_NOTHING = -1
_NONE = np.zeros(0, np.int64)

TIMES = ("dt", "begin", "low", "high")
RECORD = np.dtype(
    [(name, np.int64) for name in ("action", "first", "end", "slot")]
    + [(name, np.float64) for name in TIMES]
)
#: steps [first, end) with one clock, which begins ``begin`` s after the start of the run; how many
#: whole steps have been taken when they end, -1 within a step; whether states jump before them
LEG = np.dtype(
    [(name, np.float64) for name in TIMES]
    + [(name, np.int64) for name in ("first", "end", "whole", "jumps")]
)
#: steps of a block, after which rotation angles are checked
BLOCK = 256
#: legs and saves of a piece of a tape, at most
_LEGS, _SAVES = 1 << 11, 1 << 10
# stops of a run of one leg, which a loop in Python finds faster than NumPy
_FEW = 32
# records of the tape of a run in one piece that is kept for the next run, at most
_KEPT = 1 << 15

Tape = NDArray[Any]
Legs = NDArray[Any]
Times = NDArray[np.float64]
Whole = NDArray[np.int64]


class Breaks(NamedTuple):
    """The times, s, at which a run is divided, in its order, the first being its start.

    ``since`` are counted from the start, with ``slack`` for their rounding; ``low`` and ``high``
    are the window of what follows each; ``jumps`` says where states jump.
    """

    times: Times
    since: Times
    slack: Times
    low: Times
    high: Times
    jumps: NDArray[np.bool_]


#: a run that nothing divides
UNBROKEN = Breaks(
    np.zeros(1), np.zeros(1), np.zeros(1), np.full(1, -np.inf), np.full(1, np.inf),
    np.zeros(1, np.bool_),
)  # fmt: skip


class Saves(NamedTuple):
    """Times of saves since the start of a run, s, in its order, with slack for their rounding."""

    since: Times
    slack: Times


def on_grid(since: Any, dt: Any, slack: Any) -> tuple[Any, Any]:
    """(whole steps to times, the rest in s), where rounding leaves no rest."""
    count = np.floor((since + np.copysign(slack, dt)) / dt)
    rest = since - count * dt
    return count.astype(np.int64), np.where(np.abs(rest) <= slack, 0.0, rest)


def legs_of(dt: float, n_steps: int, breaks: Breaks = UNBROKEN, end: float | None = None) -> Legs:
    """The legs of a run of ``n_steps``; ``end`` is its duration, s, if its last step is shorter."""
    counts, rests = on_grid(breaks.since[1:], dt, breaks.slack[1:])
    last = (n_steps, 0.0) if end is None else (n_steps - 1, end - (n_steps - 1) * dt)
    ends = [*zip(counts.tolist(), rests.tolist(), strict=True), last]
    until = [*breaks.since[1:].tolist(), n_steps * dt if end is None else end]
    windows = zip(breaks.low.tolist(), breaks.high.tolist(), breaks.jumps.tolist(), strict=True)
    legs: list[tuple[float, ...]] = []
    n, reached = 0, None  # whole steps so far; the time reached within the next one, if any
    for (count, rest), to, (*window, jumps) in zip(ends, until, windows, strict=True):
        if reached is not None and count > n:
            n += 1
            legs.append((n * dt - reached, reached, *window, 0, 1, n, jumps))
            reached, jumps = None, False  # noqa: PLW2901  # they jump once
        if count > n or n_steps == 0:
            legs.append((dt, 0.0, *window, n, count, count, jumps))
            n, jumps = count, False  # noqa: PLW2901
        if rest:
            since = n * dt if reached is None else reached
            legs.append((to - since, since, *window, 0, 1, -1, jumps))
            reached = to
    if reached is not None:
        legs[-1] = (*legs[-1][:6], n + 1, legs[-1][7])
    return np.array(legs, LEG)


class Piece(NamedTuple):
    """A part of a run: its tape, and what is done when it ends.

    ``position`` counts all steps, shorter ones too; ``whole`` the whole ones, -1 within a step;
    ``saved`` the saves.
    """

    tape: Tape
    position: int
    whole: int
    saved: int


class Steps:
    """The steps of a run, with its saves, as positions: numbers of steps, shorter ones included.

    ``every`` counts the steps between two projections, 0 for none; ``slots`` are the places of the
    saves in the output. The run goes on from an earlier one, if it ``resumes``, after ``done``
    whole steps. If events are ``watched``, the steps after each breakpoint are looked at first, and
    those where the run begins, if it is ``new`` to its events.
    """

    def __init__(
        self, legs: Legs, saves: Saves, *, slots: Whole | None = None, every: int = 0,
        block: int = BLOCK, resumes: bool = False, done: int = 0, watched: bool = False,
        new: bool = True,
    ) -> None:  # fmt: skip
        self.legs, self._every, self._block = legs, every, block
        self._resumes, self._watched, self._new = resumes, watched, new
        lengths = legs["end"] - legs["first"]
        self._ends = np.cumsum(lengths)
        self._starts = self._ends - lengths
        self.length = int(self._ends[-1])
        self.first = self._position(done)
        self._slots = np.arange(saves.since.size) if slots is None else slots
        until = np.abs(legs["begin"] + legs["end"] * legs["dt"])
        leg = np.searchsorted(until, np.abs(saves.since) - saves.slack)
        leg = self._leg_of_save = np.minimum(leg, len(legs) - 1)
        since = saves.since - legs["begin"][leg]
        self._counts, self._rests = on_grid(since, legs["dt"][leg], saves.slack)
        positions = self._starts[leg] + self._counts - legs["first"][leg]
        #: twice the position of a save, and one more within the next step
        self._keys = 2 * np.maximum(positions, self.first) + (self._rests != 0.0)
        # the piece of a run that is one, in times since the start
        self._only: Piece | None = None
        #: whether a tape copies tiles
        self.forks = watched or bool(self._rests.any())

    def _position(self, whole: int) -> int:
        """The position after a number of whole steps."""
        if whole == 0:
            return 0
        leg = int(np.flatnonzero(self.legs["whole"] >= whole)[0])
        return int(self._ends[leg] - self.legs["whole"][leg] + whole)

    def _whole_at(self, position: int) -> int:
        """The number of whole steps at a position, -1 within one."""
        leg = int(np.searchsorted(self._ends, position))
        whole = int(self.legs["whole"][leg])
        return whole if whole < 0 else whole - int(self._ends[leg]) + position

    def begun(self, t0: float) -> Tape:
        """A tape that begins a run from time ``t0`` and does nothing else."""
        return _from(t0, _joined([_clock(self.legs[:1]), _records(START)]))

    def pieces(
        self, t0: float, pace: Callable[[], int], stops: Sequence[int] = ()
    ) -> Iterator[Piece]:
        """The tapes of the run from time ``t0``, in pieces of about ``pace()`` steps.

        A piece ends after each of the saves whose numbers are in ``stops``.
        """
        left = [(int(self._keys[i]) + 1) // 2 for i in reversed(stops)]
        at = self.first
        if self._only is not None and not left and at + pace() >= self.length:
            yield self._only._replace(tape=_from(t0, self._only.tape))
            return
        while True:
            while left and left[-1] <= at:
                left.pop()
            end = min([self._end(at, pace()), *left[-1:]])
            piece = Piece(self._tape(at, end), end, self._whole_at(end), self._saves_until(end))
            if at == self.first and end == self.length and piece.tape.size <= _KEPT:
                self._only = piece
            yield piece._replace(tape=_from(t0, piece.tape))
            if end == self.length:
                return
            at = end

    def _end(self, at: int, steps: int) -> int:
        """The end of a piece, at a multiple of a block, or between two legs or saves."""
        ends = [self.length]
        leg, save = self._leg_at(at) + _LEGS, self._saves_until(at) + _SAVES
        if leg < len(self.legs):
            ends.append(int(self._starts[leg]))
        if save < self._keys.size:
            ends.append(max(int(self._keys[save]) // 2, at + 1))
        if at + steps < min(ends):
            leg = self._leg_at(at + steps)
            start, first = int(self._starts[leg]), int(self.legs["first"][leg])
            count = first + at + steps - start
            cut = max(count // self._block * self._block, first)
            if start + cut - first <= at:
                cut += self._block
            ends.append(start + cut - first)
        return min(ends)

    def _leg_at(self, position: int) -> int:
        """The leg that goes on from a position, or the last."""
        return min(int(np.searchsorted(self._ends, position, "right")), len(self.legs) - 1)

    def _saves_until(self, position: int) -> int:
        """How many saves are made until a position."""
        return int(np.searchsorted(self._keys, 2 * position, "right"))

    def _tape(self, at: int, end: int) -> Tape:
        """The records of the steps between two positions, in times since the start."""
        leg = self._leg_at(at)
        shift = at - int(self._starts[leg])
        # the clock with which the steps before ended, and their number
        before = self.legs[leg : leg + 1] if shift or leg == 0 else self.legs[leg - 1 : leg]
        count = int(self.legs["first"][leg]) + shift if shift or leg == 0 else int(before["end"][0])
        saves = slice(self._saves_until(at), self._saves_until(end))
        tape = [_clock(before), _records(START)]
        if self._resumes or self._watched or at > self.first:
            tape.append(_records(RESTORE))
        if at == self.first and saves.start:
            tape.append(_records(SAVE, first=count, slot=self._slots[: saves.start]))
        if end > at:
            tape.append(self._body(at, end, leg, (before, count), saves))
        return _joined([*tape, _records(STATUS)])

    def _body(self, at: int, end: int, leg: int, before: tuple[Legs, int], saves: slice) -> Tape:
        """What happens from the leg on that goes on at a position.

        ``before`` is the clock of the steps before, and their number.
        """
        if len(self.legs) == 1 and not (self._watched or self.forks or self.legs["jumps"][0]):
            few = self._few(at, end, saves)
            if few is not None:
                return few
        last = int(np.searchsorted(self._ends, end)) + 1
        legs, starts = self.legs[leg:last].copy(), self._starts[leg:last].copy()
        is_clipped = int(at > starts[0])
        legs["first"][0] += at - starts[0]
        cut = self._ends[last - 1] - end
        legs["end"][-1] -= cut
        legs["whole"][-1] -= cut * (legs["whole"][-1] >= 0)
        starts[0] = at
        ends = starts + legs["end"] - legs["first"]
        projected = _multiples(legs, starts, legs["whole"] - legs["end"], self._every)
        blocks = _multiples(legs, starts, 0, self._block)
        saved = self._keys[saves] // 2
        stops = np.unique(np.concatenate([blocks, projected, saved, ends]))
        stops = stops[stops > at]
        begins = np.concatenate([[at], stops[:-1]])
        of = np.searchsorted(ends, stops)
        shift = legs["first"][of] - starts[of]
        # what happens at the same position is in the order of the groups
        groups = [(stops, _records(STEPS, first=begins + shift, end=stops + shift))]
        if projected.size:
            groups.append((projected, _records(PROJECT, first=projected)))
        if saved.size:
            groups.append(self._saved(saved, saves))
        if len(legs) > 1 or not is_clipped:
            groups.append((starts[is_clipped:], _changes(legs, *before)[is_clipped:]))
        if self.forks and saved.size:
            groups.append(self._saved_within(saved, saves))
        if self._watched:
            new = is_clipped * (not (self._new and at == self.first))
            groups.append((starts[new:], _looks(legs[new:])))
        return _in_order(groups)

    def _few(self, at: int, end: int, saves: slice) -> Tape | None:
        """The records of a run of one leg, if they are few: Python takes a third of the time."""
        grains = [self._block] + [self._every] * (self._every > 0)
        if saves.stop - saves.start + sum((end - at) // grain for grain in grains) > _FEW:
            return None
        saved = dict(zip(self._counts[saves].tolist(), self._slots[saves].tolist(), strict=True))
        if len(saved) < saves.stop - saves.start:  # two saves at one time
            return None
        stops = {end, *saved}
        for grain in grains:
            stops.update(range((at // grain + 1) * grain, end, grain))
        rows: list[tuple[float, ...]] = []
        for stop in sorted(stops):
            rows.append((STEPS, at, stop, 0))
            if self._every and stop % self._every == 0:
                rows.append((PROJECT, stop, 0, 0))
            if stop in saved:
                rows.append((SAVE, stop, 0, saved[stop]))
            at = stop
        tape = np.zeros(len(rows), RECORD)
        for name, column in zip(
            ("action", "first", "end", "slot"), zip(*rows, strict=True), strict=True
        ):
            tape[name] = column
        return tape

    def _saved(self, positions: Whole, saves: slice) -> tuple[Whole, Tape]:
        """The records of saves after whole steps."""
        there = self._rests[saves] == 0.0
        counts, slots = self._counts[saves][there], self._slots[saves][there]
        return positions[there], _records(SAVE, first=counts, slot=slots)

    def _saved_within(self, positions: Whole, saves: slice) -> tuple[Whole, Tape]:
        """The records of saves within a step, in rows."""
        there = self._rests[saves] != 0.0
        legs = self.legs[self._leg_of_save[saves][there]]
        columns = (x[saves][there] for x in (self._counts, self._rests, self._slots))
        return positions[there], _copied(SAVE, legs, *columns)


def _in_order(groups: list[tuple[Whole, Tape]]) -> Tape:
    """Records, or rows of them, in the order of their positions, then of the groups."""
    records, keys = [], []
    for kind, (positions, made) in enumerate(groups):
        if made.size:
            records.append(made.reshape(-1))
            key = positions * len(groups) + kind
            keys.append(key if made.ndim == 1 else np.repeat(key, made.shape[1]))
    if len(records) == 1:
        return records[0]
    order = np.concatenate(keys).argsort(kind="stable")
    is_there = np.concatenate([x["action"] for x in records]) != _NOTHING
    return _joined(records, order[is_there[order]])


def _joined(records: Sequence[Tape], order: Whole | None = None) -> Tape:
    """Records of some arrays, in an order; as whole numbers, since NumPy copies field by field."""
    rows = np.concatenate([x.view(np.int64).reshape(x.size, -1) for x in records])
    tape: Tape = (rows if order is None else rows.take(order, axis=0)).view(RECORD)[:, 0]
    return tape


def _from(t0: float, tape: Tape) -> Tape:
    """A tape whose clocks begin since the start of the run, from time ``t0``."""
    if t0:
        tape = tape.copy()
        tape["begin"] += t0
    return tape


def _records(action: int, **columns: Any) -> Tape:
    made = np.zeros(max((np.size(x) for x in columns.values()), default=1), RECORD)
    made["action"] = action
    for name, x in columns.items():
        made[name] = x
    return made


def _clock(legs: Legs) -> Tape:
    return _records(CLOCK, **{name: legs[name] for name in TIMES})


def _multiples(legs: Legs, starts: Whole, shift: Any, every: int) -> Whole:
    """Positions in legs at which the count with a shift is a multiple of a number of steps."""
    if not every:
        return _NONE
    low = (legs["first"] + shift) // every
    n = ((legs["end"] + shift) // every - low) * (legs["whole"] >= 0)
    if not n.any():
        return _NONE
    leg = np.repeat(np.arange(len(legs)), n)
    k = np.arange(leg.size) - np.repeat(np.cumsum(n) - n, n)
    counts = (low[leg] + 1 + k) * every - np.broadcast_to(shift, low.shape)[leg]
    positions: Whole = starts[leg] + counts - legs["first"][leg]
    return positions


def _changes(legs: Legs, before: Legs, count: int) -> Tape:
    """From the clock of the leg before to that of each leg, where it is another one.

    ``count`` steps were taken with the clock ``before``.
    """
    last = np.concatenate([before, legs[:-1]])
    moves = legs["jumps"] != 0
    for name in TIMES:
        moves |= last[name] != legs[name]
    if not moves.any():
        return np.zeros((0, 4), RECORD)
    made = np.zeros((len(legs), 4), RECORD)
    made["action"] = np.where(moves[:, None], (LEAVE, CLOCK, JUMP, ENTER), _NOTHING)
    made["action"][legs["jumps"] == 0, 2] = _NOTHING
    made["first"] = legs["first"][:, None]
    made["first"][:, 0] = last["end"]
    made["first"][0, 0] = count
    for name in TIMES:
        made[name] = legs[name][:, None]
    return made


def _copied(action: int, legs: Legs, counts: Any, rests: Any, slots: Any = 0) -> Tape:
    """A shorter step after some of a leg's, on a copy of the tile, and what is done after it."""
    order = FORK, LEAVE, CLOCK, ENTER, STEPS, action, JOIN
    made = np.zeros((len(legs), len(order)), RECORD)
    made["action"] = order
    made["first"][:, 1], made["end"][:, 4], made["first"][:, 5] = counts, 1, 1
    made["slot"][:, 5] = slots
    for name in TIMES:
        made[name] = legs[name][:, None]
    made["dt"][:, 2], made["begin"][:, 2] = rests, legs["begin"] + counts * legs["dt"]
    return made


def _looks(legs: Legs) -> Tape:
    """The values of events where legs begin, and in the middle of their first step."""
    look = _records(LOOK, first=legs["first"])[:, None]
    middle = _copied(MIDDLE, legs, legs["first"], 0.5 * legs["dt"])
    return np.concatenate([look, middle], axis=1)
