"""A run of a job's program over a group of bodies: its arrays, and the calls of the machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.memory import DTYPES, address_of
from fastatt.engine.machine import Bodies, tile_machine
from fastatt.engine.pool import Pool
from fastatt.engine.program import Program
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
            x.address if kind == "function" else packed.tables[x] for kind, x in formulas.resources
        ]
        addresses = (x if isinstance(x, int) else address_of(x) for x in self._held)
        stages = np.array(job.method.stages, dtype=np.float64)
        # the number of stages comes after the resources
        self._whole = np.array([*addresses, len(stages)], dtype=np.int64)
        self.record = program.record(address_of(self._whole))
        numbers = program.layout.numbers
        self.numbers = np.concatenate(
            [np.zeros(numbers["limit"]), limits, params[0], stages.ravel()]
        )
        self.numbers[numbers["share"]] = job.method.ahead


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

        self.setup, self.steps, self.results, self.t0 = setup, steps, results, t0
        self.params, self._flags = own(setup.params), own(setup.flags)
        params = self.params[:1, :0] if program.job.shared else self.params
        self._inputs: tuple[Array, ...] = (own(start[0])[None], own(start[1])[None], params[None])
        n, layout = results.status.size, program.layout
        self.states = np.empty((n, layout.is_watched.size), DTYPES[program.job.kind])
        self._machine = tile_machine(
            program.job.kind, any_angle=program.job.has_any_angle_form, forks=steps.forks
        )

    @property
    def squares(self) -> Array:
        """The largest squared angle of a step of each body, rad²."""
        return self.states[:, self.setup.program.layout.rows["angle"]]

    def begin(self) -> None:
        """Do what comes before the first tape."""

    def resume(self, kept: Mapping[str, Array], *, same_events: bool) -> None:
        """Go on from what another run kept, of the same events or others."""
        self.states[:, ~self.setup.program.layout.is_watched] = kept["states"]

    def kept(self) -> dict[str, Array]:
        """Copies of what another run needs to go on from here."""
        return {"states": self.states[:, ~self.setup.program.layout.is_watched]}

    def advance(self, piece: Piece, pool: Pool) -> None:
        """Perform a piece of the run."""
        self._perform_piece(piece, pool)
        self.results.status[:] = self.states[:, -1].astype(np.uint8) | self._flags

    def _perform_piece(self, piece: Piece, pool: Pool) -> None:
        pool.perform(lambda first, last: self.perform(piece.tape, slice(None), first, last))

    def perform(
        self, tape: Tape, rows: Any = slice(None), first: int = 0, last: int | None = None
    ) -> None:
        """Perform a tape on tiles of some bodies, by default all; several threads may do so."""
        program, record, saves = self.setup.program, self.setup.record, self.results.saves
        states, inputs = self.states, self._inputs
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
        last = -(-len(states) // program.job.width) if last is None else last
        while first < last:
            first = self._machine(tape, record, tile, before, fork, bodies, first, last)
            if first < last:
                program.compile_any_angle()
                record["any_angle"] = program.any_angle
        if is_some:
            self.states[rows] = states
            slots = np.unique(tape["slot"][tape["action"] == Action.SAVE])
            self.results.saves[slots[:, None], rows] = saves[slots]
