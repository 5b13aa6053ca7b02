"""A run of a program over some bodies: their arrays, the threads, and the pieces of the tape."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from sys import getsizeof
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen import memory
from fastatt.codegen.memory import DTYPES, address_of
from fastatt.engine.machine import Bodies, tile_machine
from fastatt.engine.program import Program
from fastatt.engine.status import FLAGS, Status
from fastatt.engine.tape import Action, Piece, Steps, Tape, times_of
from fastatt.scene.models import Packed
from fastatt.threads import in_threads

Array = NDArray[Any]

_OPERATIONS = 2_000_000_000  # of the first piece of a group of tiles
_SECONDS = 0.1  # of a piece of a group, after which Ctrl-C is answered
_LONGEST = 1 << 40  # steps of a piece; saves may end all pieces sooner
# tiles of a group, and of one whose bodies call a function, which may take any time
_TILES, _CALLING = 64, 1
# steps of the first piece in which events are looked for
_EVENTS = 1024


class Crossings(list[tuple[int, Array, Array, Array]]):
    """The crossings so far, in parts.

    A part is what is crossed (the number of an event or, after these, of a switch), bodies, times,
    and values as those of a save.
    """

    _bytes, _checked = 0, memory.LITTLE

    def keep(self, which: int, bodies: Array, times: Array, saved: Array) -> None:
        """Keep a part; raises ``MemoryError``, with the size, before they fill the memory."""
        self.append((which, bodies, times, saved))
        self._bytes += sum(map(getsizeof, (bodies, times, saved)))
        if self._bytes > self._checked:
            # as many may follow before the next check, and all are sorted at the end
            free, self._checked = memory.available(), 2 * self._bytes
            if free is not None and free < self._checked:
                raise MemoryError(
                    f"crossings: those so far take {self._bytes / 1e9:.3g} GB, with "
                    f"{free / 1e9:.3g} GB of memory left; accepted: fewer bodies, a shorter run, "
                    "which resume continues, or events without every=True"
                )


class Results(NamedTuple):
    """The arrays that a run writes to.

    Saved values with the norm error last (S, N, k + 1), flags (N,), times of events (N, E), and
    the crossings so far.
    """

    saves: Array
    status: NDArray[FLAGS]
    event_times: NDArray[np.float64]
    crossings: Crossings

    @classmethod
    def empty(cls, shape: tuple[int, int], dtype: Any, events: int, saves: int) -> Results:
        """Arrays for (bodies, values), not initialised but for the times of events."""
        bodies, values = shape
        saved = np.empty((saves, bodies, values + 1), dtype)
        event_times = np.empty((bodies, events))
        event_times.fill(np.nan)
        return cls(saved, np.empty(bodies, FLAGS), event_times, Crossings())

    def of_bodies(self, rows: Any) -> Results:
        """Those of some bodies: views for a slice, copies for an array of indices."""
        saves = self.saves[:, rows] if isinstance(rows, slice) else self.saves.take(rows, axis=1)
        return Results(saves, self.status[rows], self.event_times[rows], self.crossings)

    def put(self, rows: Any, other: Results) -> None:
        """Write the results of some bodies, unless they are views."""
        if isinstance(rows, slice):
            return
        self.saves[:, rows], self.status[rows] = other.saves, other.status
        self.event_times[rows] = other.event_times

    def leave(self, rows: Any = slice(None), first: int = 0) -> None:
        """Mark bodies that did not reach the end, whose saves are missing from one on."""
        self.saves[first:, rows], self.status[rows] = np.nan, Status.UNFINISHED


class Setup:
    """A program with the numbers of its bodies: what all runs of a plan share.

    ``limits`` are the bounds of the diagnostics; ``params`` (N, k) or (1, k), ``flags`` (N,) or
    (1,) are those that bodies have from the start.
    """

    def __init__(
        self, program: Program, packed: Packed, limits: Sequence[float],
        params: NDArray[np.float64], flags: NDArray[FLAGS],
    ) -> None:  # fmt: skip
        self.program, self.params, self.flags = program, params, flags
        self.tables = packed.tables
        job = program.job
        self._held = [
            x.address if what == "function" else packed.tables[x] for what, x in job.resources
        ]
        addresses = (x if isinstance(x, int) else address_of(x) for x in self._held)
        stages = np.array(job.method.stages, dtype=np.float64)
        # the number of stages comes after the resources
        self._whole = np.array([*addresses, len(stages)], dtype=np.int64)
        self.record = program.record(address_of(self._whole))
        numbers = program.numbers
        self.numbers = np.concatenate(
            [np.zeros(numbers["limit"]), limits, params[0], stages.ravel()]
        )
        self.numbers[numbers["share"]] = job.method.ahead


class Run:
    """A run of some bodies: of all ``rows`` of the ensemble, of a slice, or of an array of them.

    ``start`` are attitudes and the rest of the initial state, (1, k) or (N, k) of the ensemble.
    ``results`` are those of these bodies. ``states`` (n, k) are what each takes with it; the run
    goes on from those that another ``kept``.
    """

    def __init__(
        self, setup: Setup, steps: Steps, start: tuple[Array, Array], rows: Any, results: Results,
        t0: float, n_threads: int = 1, kept: Mapping[str, Array] | None = None,
    ) -> None:  # fmt: skip
        program = setup.program

        def of_rows(x: Array) -> Array:
            return x if len(x) == 1 else x[rows]

        self.setup, self.steps, self.results, self.t0 = setup, steps, results, t0
        #: the numbers of the bodies
        self.bodies = np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows
        self.params, self._flags = of_rows(setup.params), of_rows(setup.flags)
        params = self.params[:1, :0] if program.job.shared else self.params
        q0, y0 = map(of_rows, start)
        self._inputs: tuple[Array, ...] = (q0[None], y0[None], params[None])
        n = results.status.size
        self.states = np.empty((n, program.is_of_events.size), DTYPES[program.job.precision])
        self._machine = tile_machine(
            program.job.precision, any_angle=program.job.has_any_angle_form, forks=steps.forks
        )
        # groups of tiles, and the steps of the next piece, by the time that they take
        width, calls = program.width, program.job.calls > 0
        tiles = -(-n // width)
        least, each = 8 * n_threads if n_threads > 1 else 1, _CALLING if calls else _TILES
        groups = min(tiles, max(least, tiles // each))
        self._bounds, self.n_threads = [tiles * i // groups for i in range(groups + 1)], n_threads
        self._grain = self._pace = program.job.block
        if not (calls or program.job.switches):
            most = min(n, width * -(-tiles // groups))
            self._pace = _OPERATIONS // max(1, program.job.operations) // most
            self._pace = min(self._pace, _EVENTS) if program.job.watched else self._pace
        self._begin()
        if kept is not None:
            self._resume(kept)

    def _begin(self) -> None:
        """Do what comes before the first tape."""

    def _resume(self, kept: Mapping[str, Array]) -> None:
        """Go on from what another run kept."""
        self.states[:, self.setup.program.of_steps] = kept["states"]

    def kept(self) -> dict[str, Array]:
        """Copies of what another run needs to go on from here."""
        return {"states": self.states.take(self.setup.program.of_steps, axis=1)}

    @property
    def squares(self) -> Array:
        """The largest squared angle of a step of each body, rad²."""
        return self.states[:, self.setup.program.rows["angle"]]

    def pieces(self, stops: Sequence[int] = ()) -> Iterator[Piece]:
        """The pieces to ``advance`` by, one after the other, of 0.1 s if they are not too few.

        A piece ends after each of the saves whose numbers are in ``stops``.
        """
        return self.steps.pieces(self.t0, lambda: max(self._pace, self._grain), stops)

    def advance(self, piece: Piece) -> None:
        """Perform a piece of the run."""
        tiles = pairwise(self._bounds)
        calls = [partial(self.perform, piece.tape, slice(None), *ends) for ends in tiles]
        seconds = in_threads(calls, self.n_threads)
        share = _SECONDS / max(1e-9, *seconds)
        if not 1.0 <= share <= 2.0:
            self._pace = int(min(self._pace * min(2.0, share), _LONGEST))
        self._read_flags()

    def _read_flags(self) -> None:
        self.results.status[:] = self.states[:, -1].astype(FLAGS) | self._flags

    def perform(
        self, tape: Tape, rows: Any = slice(None), first: int = 0, last: int | None = None,
        since: Array | None = None,
    ) -> float:  # fmt: skip
        """Perform a tape on tiles of some bodies, by default all; several threads may do so.

        Of some bodies the saves are kept, or those from the times ``since`` on. Returns the time
        that it took, s.
        """
        begin, program, record = perf_counter(), self.setup.program, self.setup.record
        states, inputs, saves = self.states, self._inputs, self.results.saves
        is_some = not isinstance(rows, slice)
        if is_some:
            states = states[rows]
            saves = np.empty((len(saves), rows.size, saves.shape[2]), saves.dtype)
            inputs = tuple(x if x.shape[1] == 1 else x[:, rows] for x in inputs)
        tile, numbers, *copies = program.memory()
        numbers[:] = self.setup.numbers
        wanted = program.job.has_any_angle_form, self.steps.forks
        before, fork = (x if there else None for x, there in zip(copies, wanted, strict=True))
        q0, y0, params = inputs
        bodies = Bodies(q0, y0, params, states[None], saves)
        last = -(-len(states) // program.width) if last is None else last
        while first < last:
            first = self._machine(tape, record, tile, before, fork, bodies, first, last)
            if first < last:
                program.compile_any_angle()
                record["any_angle"] = program.any_angle
        if is_some:
            self.states[rows] = states
            records = tape[tape["action"] == Action.SAVE]
            slots, where = records["slot"], np.ix_(records["slot"], rows)
            new = saves[slots]
            if since is not None and slots.size:
                sign, times = np.sign(self.steps.legs["dt"][0]), times_of(records)
                earlier = sign * times[:, None] < sign * since
                new[earlier] = self.results.saves[where][earlier]
            self.results.saves[where] = new
        return perf_counter() - begin
