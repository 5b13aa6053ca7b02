"""A run of a job's program over an ensemble: its arrays, its numbers, and the calls of the loop."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import config
from numpy.typing import NDArray

from fastatt.codegen.call import call_loop
from fastatt.codegen.memory import DTYPES, address_of
from fastatt.codegen.processor import processor
from fastatt.engine import loop
from fastatt.engine.crossings import EVENT_ROWS, NOT_BEGUN
from fastatt.engine.job import Job
from fastatt.engine.program import Program
from fastatt.engine.status import DIAGNOSTICS

Array = NDArray[Any]

#: steps of a block, so many that work once in a block takes negligible time; and of one whose steps
#: call a function, which may take any time
BLOCK_LENGTH, CALLING_LENGTH = 256, 2


@dataclass(frozen=True)
class Span:
    """Steps [first, last) of a run of ``n_steps``, or stops with per-body step sizes.

    Saves are every ``save_every`` steps, counted from ``origin``, with which the run began, and at
    the end. The first is in slot ``slot`` of the output: 1 if slot 0 holds the initial state, else
    0. The state is projected every ``projection`` steps, or never if that is 0. Rotation angles are
    checked once in a ``block`` of steps.
    """

    first: int
    last: int
    n_steps: int
    save_every: int
    slot: int
    projection: int = 0
    origin: int = 0
    block: int = BLOCK_LENGTH

    @property
    def grain(self) -> int:
        """The number of which the ends of pieces are multiples."""
        return self.block

    def end_of_piece(self, first: int, steps: int) -> int:
        """The end of a piece of about ``steps`` steps from ``first`` on."""
        return (first // self.grain + max(1, steps // self.grain)) * self.grain

    def part(self, first: int, last: int) -> Span:
        """The span of some of its steps."""
        return replace(self, first=first, last=last)


class StopSpan(Span):
    """The stops [first, last) of a run with per-body step sizes."""

    @property
    def grain(self) -> int:
        """The number of which the ends of pieces are multiples."""
        return 1


class Fixed(NamedTuple):
    """Numbers that bodies have in all runs of a plan, each (1, ...) or (N, ...).

    Parameters (N, k), known rotation angles of a step, rad, and initial flags.
    """

    params: NDArray[np.float64]
    known: NDArray[np.float64]
    flags: NDArray[np.uint8]


class PerBody(NamedTuple):
    """The order in which bodies are run, their step sizes, s, and their stops.

    ``stops`` are rows of ``stops.STOP_SIZE`` numbers; ``slots`` are the saves, or −1.
    """

    order: Array
    dt: Array
    stops: Array
    slots: Array


class Parts(NamedTuple):
    """The parts of divided steps, with one step size for all bodies.

    ``clocks`` are rows of ``stops.PART_SIZE`` numbers, the first of which is the clock at the start
    of the run; ``steps`` is the number of whole steps before each, −1 for the first.
    """

    clocks: Array
    steps: Array


@lru_cache(maxsize=256)
def program(job: Job, *, plain: bool) -> Program:
    """The program of a job, made once in a process; ``plain`` is without machine code."""
    return Program(job, plain=plain)


def prepare(job: Job) -> Program:
    """The program of a job, compiled if it was not."""
    return program(job, plain=bool(config.DISABLE_JIT))


def width_for(bodies: int, lanes: int) -> int:
    """Width of a tile for a number of bodies: a power of two of vectors, at most ``loop.WIDTH``."""
    width = lanes
    while width < min(bodies, loop.WIDTH):
        width *= 2
    return width


class Setup:
    """What all runs of a plan share: program, tables, bounds, and the bodies' numbers.

    ``bounds`` are the known rotation angle of a step, rad, up to which steps are not monitored, and
    the bounds of the diagnostics.
    """

    def __init__(
        self, made: Any, resources: Mapping[Any, Any], bounds: Sequence[float], numbers: Fixed
    ) -> None:
        #: a ``Program``, or that of a device
        self.program = made
        self.bodies, self.bounds = numbers, tuple(bounds)
        formulas, layout, job = made.formulas, made.layout, made.job
        monitor = loop.ALWAYS if job.has_any_angle_form else loop.NEVER
        if job.known:
            monitor = loop.BOUNDED if job.bounds else loop.KNOWN
        rows, flags = layout.rows.first, [x.flag(job.attitude) for x in DIAGNOSTICS]
        self.settings = [
            job.width,
            layout.rows.count,
            layout.wide.count,
            formulas.size,
            formulas.handed_out,
            formulas.coordinates,
            formulas.given - formulas.coordinates,
            0 if job.shared else formulas.parameters,
            rows["angle"],
            rows["bound"],
            rows["io"],
            layout.wide.first["dt"],
            monitor,
            len(DIAGNOSTICS),
            *flags,
            *((x.infinite for x in DIAGNOSTICS) if job.method.iterates else flags),
        ]
        self.tables = [
            ((kind, x), x.address if kind == "function" else resources[kind, x])
            for kind, x in formulas.resources
        ]
        n_stages = len(job.method.stages)
        at = (x if isinstance(x, int) else address_of(x) for _, x in self.tables)
        self._whole = np.array([*at, n_stages], dtype=np.int64)
        stages = np.ravel(np.array(job.method.stages, dtype=np.float64))
        #: t0, h and the share of h come first
        self.numbers = np.concatenate([np.zeros(3), numbers.params[0], stages])
        #: the program that locates events, the numbers of the search, and whether bodies stop
        self.search: Program | None = None
        self.search_numbers: Any = None
        self.stops = any(x.terminal for x in job.events)
        if job.events:
            if job.has_any_angle_form:
                # a search can't be restarted
                made.compile_any_angle()
            lanes = processor().lanes(job.kind)
            self.search = prepare(replace(job, own_steps=True, is_searched=True, width=lanes))
            each = [int(x) for watch in job.events for x in watch[1:]]
            self.search_numbers = [self.search.entry, len(job.events), lanes, *each]
            if not config.DISABLE_JIT:
                self.search_numbers = np.array(self.search_numbers, dtype=np.int64)
        #: tables, parameters, known angles and flags as the loop takes them; no array
        self.fixed: list[Any] = [[*(x for _, x in self.tables), n_stages], *numbers]
        self.unused: Any = np.zeros(0)
        if not config.DISABLE_JIT:
            self.unused = 0
            self.fixed = [address_of(x) for x in (self._whole, *numbers)]


class Results(NamedTuple):
    """The arrays that a run writes to.

    Saved values (S, N, k), norm errors (S, N), flags (N,), and times of events (N, E).
    """

    out: NDArray[Any]
    norm_error: NDArray[Any]
    status: NDArray[np.uint8]
    #: None for a run without events
    event_times: NDArray[np.float64] | None = None

    @classmethod
    def empty(cls, saves: int, bodies: int, width: int, kind: Any, events: int = 0) -> Results:
        """Arrays for a number of saves and bodies, allocated but not initialised."""
        return cls(
            np.empty((saves, bodies, width), kind),
            np.empty((saves, bodies), kind),
            np.empty(bodies, np.uint8),
            np.full((bodies, events), np.nan) if events else None,
        )

    def saves(self, slots: slice) -> Results:
        """Views of a range of saves."""
        return self._replace(out=self.out[slots], norm_error=self.norm_error[slots])


class Run:
    """A run over the bodies (first, number) of an ensemble.

    ``q`` and ``y``, attitudes and the rest of the state, are (1, k) or (N, k). ``times`` are (t0,
    h, share of h by which the stepped variables are ahead). ``results`` are saved values (S, N, k),
    norm errors (S, N) and status (N,). ``states`` (n, k) and ``diagnostics`` (3, n) are those of
    these bodies. ``largest_angle`` of a step, rad, is that of all calls since ``reset``.
    """

    def __init__(
        self,
        setup: Setup,
        bodies: tuple[int, int],
        start: tuple[Array, Array],
        times: tuple[float, float, float],
        results: Results,
        per_body: PerBody | None = None,
        parts: Parts | None = None,
    ) -> None:
        self.setup, self.bodies, self.start, self.times = setup, bodies, start, times
        self.results, self.per_body, self.parts = results, per_body, parts
        made = setup.program
        kind = DTYPES[made.job.kind]
        self.states = np.empty((bodies[1], made.formulas.size), kind)
        self.diagnostics = np.empty((len(DIAGNOSTICS), bodies[1]), kind)
        self._numbers = setup.numbers.copy()
        self._numbers[:3] = times
        whole, params, known, flags = setup.fixed
        self._arrays = [
            self._numbers, whole, *start, params, known, flags, *results[:3], self.states,
            self.diagnostics,
        ]  # fmt: skip
        lengths = [len(x) for x in (*start, *setup.bodies)]
        self._settings = [*bodies[::-1], results.status.size, *lengths, *setup.settings]
        #: of events: rows of each body, found times, when bodies stop, their values from then on
        self.events: list[Array] = []
        if results.event_times is not None:
            n = results.status.size
            self.events = [
                np.full((bodies[1], EVENT_ROWS * len(made.job.events)), NOT_BEGUN, kind),
                results.event_times,
                np.full(n, np.nan),
                np.empty((n if setup.stops else 0, made.formulas.handed_out + 1), kind),
            ]
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Forget the largest angle of earlier calls."""
        self.largest_angle = 0.0

    def part(self, span: Span, first: int, last: int) -> None:
        """Take the steps of a span on the tiles [first, last); several threads may do so."""
        made, bounds, largest = self.setup.program, self.setup.bounds, np.zeros(1)
        per_body, parts = self.per_body, self.parts
        numbers = [0, 0]
        if parts is not None:
            numbers = [int(np.searchsorted(parts.steps, span.first)), parts.steps.size]
        settings = [made.entry, made.any_angle, *span.__dict__.values(), *numbers, *self._settings]
        unused = self.setup.unused
        arrays = [*self._arrays, largest, *(per_body or [unused] * 4), *(parts or [unused] * 2)]
        if not isinstance(made, Program):
            made.run(self, span)
            status = loop.status_loop(made.job.kind)
            arrays += _unused(len(self.states))
            call_loop(status, arrays, settings, bounds, 0, len(self.states))
        else:
            arrays += made.memory()
            search, job = self.setup.search, made.job
            if search is not None:
                arrays += [self.setup.search_numbers, *self.events, *search.memory()]
            run_tiles = loop.tile_loop(
                job.kind, per_body=per_body is not None, events=search is not None
            )
            while first < last:
                first = call_loop(run_tiles, arrays, settings, bounds, first, last)
                if first < last:
                    made.compile_any_angle()
                    settings[loop.ANY] = made.any_angle
        with self._lock:
            self.largest_angle = max(self.largest_angle, float(largest[0]))


def _unused(n: int) -> list[Array]:
    """Memory of a tile for setting the status of n bodies only."""
    nothing = np.zeros(0, np.int64)
    return [*(nothing for _ in range(4)), np.arange(n), *(nothing for _ in range(4))]
