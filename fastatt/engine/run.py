"""A run of a job's program over a group of bodies: its arrays, and the calls of the machine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.memory import DTYPES, address_of
from fastatt.engine import events
from fastatt.engine.machine import Bodies, tile_machine
from fastatt.engine.pool import Pool
from fastatt.engine.program import Program
from fastatt.engine.search import Search
from fastatt.engine.tape import Action, Piece, Steps, Tape
from fastatt.scene.models import Packed

Array = NDArray[Any]


class Results(NamedTuple):
    """The arrays that a run writes to.

    Saved values with the norm error last (S, N, k + 1), flags (N,), and times of events (N, E).
    """

    saves: Array
    status: NDArray[np.uint8]
    event_times: NDArray[np.float64]

    def of_bodies(self, rows: Any) -> Results:
        """Those of some bodies: views for a slice, copies for an array of indices."""
        saves = self.saves[:, rows] if isinstance(rows, slice) else self.saves.take(rows, axis=1)
        return Results(saves, self.status[rows], self.event_times[rows])

    def put(self, rows: Any, other: Results) -> None:
        """Write the results of some bodies, unless they are views."""
        if isinstance(rows, slice):
            return
        self.saves[:, rows], self.status[rows] = other.saves, other.status
        self.event_times[rows] = other.event_times


class Setup:
    """What all runs of a plan share: program, tables, limits, and the bodies' numbers.

    ``limits`` are the bounds of the diagnostics; ``params`` (N, k) or (1, k), ``flags`` (N,) or
    (1,) are those that bodies have from the start.
    """

    def __init__(
        self, program: Program, packed: Packed, limits: Sequence[float],
        params: NDArray[np.float64], flags: NDArray[np.uint8],
    ) -> None:  # fmt: skip
        self.program, self.params, self.flags = program, params, flags
        self.tables = packed.tables
        job, formulas = program.job, program.formulas
        self._held = [
            x.address if kind == "function" else packed.resources[kind, x]
            for kind, x in formulas.resources
        ]
        addresses = (x if isinstance(x, int) else address_of(x) for x in self._held)
        stages = np.array(job.method.stages, dtype=np.float64)
        # the number of stages comes after the resources
        self._whole = np.array([*addresses, len(stages)], dtype=np.int64)
        self.record = program.record(address_of(self._whole))
        numbers = program.layout.numbers
        self.numbers = np.concatenate(
            [np.zeros(numbers.first["limit"]), limits, params[0], stages.ravel()]
        )
        self.numbers[numbers.first["share"]] = formulas.share


class Run:
    """A run of some bodies: of all ``rows`` of the ensemble, of a slice, or of an array of them.

    ``start`` are attitudes and the rest of the initial state, (1, k) or (N, k) of the ensemble.
    ``results`` are those of these bodies. ``states`` (n, k) are what each takes with it.
    """

    def __init__(
        self, setup: Setup, steps: Steps, start: tuple[Array, Array], rows: Any, results: Results,
        t0: float,
    ) -> None:  # fmt: skip
        program = setup.program

        def own(x: Array) -> Array:
            return x if len(x) == 1 else x[rows]

        params = setup.params if not program.job.shared else setup.params[:1, :0]
        self._setup, self.steps, self._t0 = setup, steps, t0
        self._inputs = tuple(own(x)[None] for x in (*start, params))
        self._flags, self.results = own(setup.flags), results
        n, kept = results.status.size, program.layout.kept
        self.states = np.empty((n, sum(kept.values())), DTYPES[program.job.kind])
        self._machine = tile_machine(
            program.job.kind, any_angle=program.job.has_any_angle_form, forks=steps.forks
        )
        self.search: Search | None = None
        if program.job.events:
            params = own(setup.params)
            self.search = Search(program, setup, params, steps.legs, t0, results)

    @property
    def squares(self) -> Array:
        """The largest squared angle of a step of each body, rad²."""
        return self.states[:, self._setup.program.layout.rows.first["angle"]]

    def begin(self) -> None:
        """The states from initial values, which a run with events keeps before its first tape."""
        if self.search is not None:
            self.perform(self.steps.begun(self._t0), slice(None), 0, self._tiles(len(self.states)))

    def resume(self, states: Array, kept: Sequence[Array]) -> None:
        """Go on from the states of another run; ``kept`` is what that has of its ``events``."""
        self.begin()
        self.states[:, self.without_events] = states
        if self.search is not None and len(kept):
            self.states[:, ~self.without_events] = kept[0]
            self.results.event_times[:] = kept[1]
            self.search.stopped[:], self.search.final[:] = kept[2:]

    def events(self) -> list[Array]:
        """Copies of the arrays of events: states, times, when bodies stopped, values since."""
        if self.search is None:
            return []
        kept = self.results.event_times, self.search.stopped, self.search.final
        return [self.states[:, ~self.without_events], *(x.copy() for x in kept)]

    @property
    def without_events(self) -> Array:
        """The columns of states but for those of events."""
        layout = self._setup.program.layout
        columns = np.ones(self.states.shape[1], bool)
        for group in events.sizes((), 0, 0):
            columns[layout.rows.columns(group)] = False
        return columns

    def advance(self, piece: Piece, pool: Pool | None) -> None:
        """Perform a piece of the run."""
        try:
            if pool is None:
                self.perform(piece.tape, slice(None), 0, self._tiles(len(self.states)))
            else:
                self._search(piece, pool)
        finally:  # of the bodies that finished it, after Ctrl-C
            with np.errstate(invalid="ignore"):
                self.results.status[:] = self.states[:, -1].astype(np.uint8) | self._flags

    def _search(self, piece: Piece, pool: Pool) -> None:
        """Perform a piece; with events again, until no body has a false alarm."""
        begun = None if self.search is None else self.states.copy()
        pool.perform(lambda first, last: self.perform(piece.tape, slice(None), first, last))
        if self.search is None or begun is None:
            return
        rounds = 0
        while (again := self.search.located(self.states, begun)).size:
            rounds += again.size
            self.states[again] = begun[again]
            self.perform(piece.tape, again, 0, self._tiles(again.size))
        if 2 * rounds > len(begun):
            pool.shorten()
        self.search.save(self.results.saves, piece.tape)

    def _tiles(self, bodies: int) -> int:
        return -(-bodies // self._setup.program.job.width)

    def perform(self, tape: Tape, rows: Any, first: int, last: int) -> None:
        """Perform a tape on tiles of some bodies; several threads may do so."""
        program, record, saves = self._setup.program, self._setup.record, self.results.saves
        states, inputs = self.states, self._inputs
        is_some = not isinstance(rows, slice)
        if is_some:
            states = states[rows]
            saves = np.empty((len(saves), rows.size, saves.shape[2]), saves.dtype)
            inputs = tuple(x if x.shape[1] == 1 else x[:, rows] for x in inputs)
        tile, numbers, *copies = program.memory()
        numbers[:] = self._setup.numbers
        wanted = program.job.has_any_angle_form, self.steps.forks
        before, fork = (x if there else None for x, there in zip(copies, wanted, strict=True))
        q0, y0, params = inputs
        bodies = Bodies(q0, y0, params, states[None], saves)
        while first < last:
            first = self._machine(tape, record, tile, before, fork, bodies, first, last)
            if first < last:
                program.compile_any_angle()
                record["any_angle"] = program.any_angle
        if is_some:
            self.states[rows] = states
            slots = np.unique(tape["slot"][tape["action"] == Action.SAVE])
            self.results.saves[slots[:, None], rows] = saves[slots]
