"""A run: what was asked for, checked and laid out, through the engine to a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, exact, rounding
from fastatt.arrays import quat_to_dcm
from fastatt.attitudes import Attitude
from fastatt.engine import pool
from fastatt.engine.ensemble import Arrays, Span
from fastatt.engine.job import Job
from fastatt.engine.tiles import width_for
from fastatt.methods.method import Method
from fastatt.motion import carried
from fastatt.running import limits
from fastatt.running.trajectory import Status, Trajectory
from fastatt.scene import Packed, Scene

# saves that are kept at a time where all of them are not
_RING = 16
KINDS = {np.dtype(np.float64): "double", np.dtype(np.float32): "single"}


@dataclass(frozen=True)
class Choice:
    """How a scene is propagated: by which method, in which representation, mended when."""

    method: Method
    attitude: Attitude
    restore: int = 0
    raw: bool = False
    looks: bool = True


@dataclass(frozen=True)
class Clock:
    """Steps and saves of a run."""

    h: float
    n_steps: int
    every: int | None
    begin: float

    @classmethod
    def of(cls, dt: Any, n_steps: Any, save_every: Any, t0: Any) -> Clock:
        """The same from what a user gives.

        Raises ``ValueError`` or ``TypeError`` for what is no step and no number of steps.
        """
        return cls(
            checks.real("dt", dt, zero=False),
            checks.whole("n_steps", n_steps, 0),
            None if save_every is None else checks.whole("save_every", save_every, 1),
            checks.real("t0", t0),
        )

    @property
    def saved(self) -> list[int]:
        """Numbers of the steps after which states are saved."""
        n = self.n_steps
        return [n] if self.every is None else [*range(0, n, self.every), n]

    def times(self) -> NDArray[np.float64]:
        """Times of the saves, s.

        Raises ``ValueError`` where they overflow.
        """
        saved = self.saved
        with np.errstate(over="ignore"):
            t = self.begin + np.array(saved, dtype=np.float64) * self.h
        if not np.isfinite(t[-1]):
            raise ValueError(
                f"dt: {saved[-1]} steps of {self.h} s from {self.begin} s overflow; accepted: "
                "shorter"
            )
        return t

    @property
    def longest(self) -> float:
        """Largest |t| of the run, s."""
        return max(abs(self.begin), abs(self.begin + self.n_steps * self.h))

    def span(self, restore: int) -> Span:
        """All of it, for the engine."""
        n = self.n_steps
        return Span(0, n, n, self.every or max(n, 1), int(self.every is not None), restore)


@dataclass(frozen=True)
class Handling:
    """What has no effect on results: threads, a bar, where saves go; and what invalid bodies do."""

    threads: int
    progress: bool = False
    sink: Callable[[Trajectory], object] | None = None
    invalid: str = "raise"


@dataclass(frozen=True)
class Task:
    """All of a run but its initial states; ``rows_each`` rows share a body's numbers."""

    scene: Scene
    choice: Choice
    clock: Clock
    handling: Handling
    rows_each: int = 1


@dataclass(frozen=True)
class _Memory:
    """The arrays of a run: states, what is handed out, how far states had left their groups."""

    x: NDArray[Any]
    out: NDArray[Any]
    defect: NDArray[Any]
    watch: NDArray[Any]
    #: which bodies' turns are known to need no look
    quiet: NDArray[np.bool_] | None = None
    #: flags of bodies that the precision does not hold
    lost: Any = field(default=0)


def propagated(
    task: Task, start: NDArray[Any], beside: dict[str, NDArray[Any]], kind: np.dtype[Any]
) -> Trajectory:
    """The trajectory of initial attitudes and of what is carried beside them."""
    clock, handling = task.clock, task.handling
    _check_sink(handling.sink, clock.every)
    t = clock.times()
    if task.choice.method.is_exact:
        at = partial(_closed_form, task, start, beside["w0"], kind)
        if handling.sink is None:
            return at(t)
        for slots in few(len(t)):
            handling.sink(at(t[slots[1:] if slots[1:2] > [1] else slots]))
        return at(t[-1:])
    return _Run(task, start, beside, kind, t).trajectory()


class _Run:
    """One run through the engine."""

    def __init__(
        self,
        task: Task,
        start: NDArray[Any],
        beside: dict[str, NDArray[Any]],
        kind: np.dtype[Any],
        t: NDArray[np.float64],
    ) -> None:
        self.task, self.kind, self.t = task, kind, t
        self.scene, self.method = task.scene, task.choice.method
        self.clock, self.attitude = task.clock, task.choice.attitude
        self.beside = beside
        self.one_body = start.ndim == 1 and all(value.ndim == 1 for value in beside.values())
        q_rows, y_rows = _rows(start, beside, kind)
        self.bodies = max(len(q_rows), len(y_rows))
        self.packed = self.scene.packed(
            self.bodies // task.rows_each,
            sorted_axes=self.method.sorted_axes,
            position="r0" in beside,
        )
        self.limit = limits.turn_limit(self.scene, self.method, self.attitude.name, self.kind)
        self.first = None
        if "w0" in beside:
            self.first = limits.first_step(self.scene, self.method, beside["w0"], self.clock.h)
        self.memory = self._memory()
        self.arrays = self._arrays(q_rows, y_rows)

    def _memory(self) -> _Memory:
        n, task = self.bodies, self.task
        structure = self.packed.structure
        saves = len(self.clock.saved)
        kept = saves if task.handling.sink is None else min(saves, 1 + _RING)
        out = np.empty((kept, n, self.attitude.stored + structure.tail), dtype=self.kind)
        watch = np.zeros((3, n), dtype=self.kind)
        known = None
        if task.choice.looks:
            known = limits.known_turns(
                self.scene, task.choice, self.packed, self.beside.get("w0"), self.first, self.clock
            )
        quiet = None
        if known is not None:
            most = limits.quiet_up_to(self.scene, self.method, self.limit)
            quiet = _quiet(known, most, watch, task.rows_each)
        return _Memory(
            np.empty((n, carried(self.attitude, structure)), dtype=self.kind),
            out,
            np.empty(out.shape[:2], dtype=self.kind),
            watch,
            quiet,
            _not_held(self.packed.params, self.kind, task.rows_each),
        )

    def _arrays(self, q_rows: NDArray[Any], y_rows: NDArray[Any]) -> Arrays:
        choice, memory = self.task.choice, self.memory
        params = self.packed.params
        shared = params.ndim == 1
        job = Job(
            self.method,
            self.attitude,
            self.packed.structure,
            KINDS[self.kind],
            shared=shared,
            known=memory.quiet is not None,
            raw=choice.raw,
            mends=choice.restore > 0,
            looks=choice.looks,
            width=width_for(self.bodies, KINDS[self.kind]),
        )
        params = np.ascontiguousarray(np.atleast_2d(params))
        each = self.task.rows_each
        given = {
            "q0": q_rows,
            "y0": y_rows,
            "p": np.repeat(params, each, axis=0) if each > 1 and not shared else params,
            "x": memory.x,
            "out": memory.out,
            "defect": memory.defect,
            "watch": memory.watch,
            "quiet": memory.quiet,
        }
        return Arrays(
            job, given, t0=self.clock.begin, h=self.clock.h, resources=self.packed.resources
        )

    def trajectory(self) -> Trajectory:
        """Run, and hand out."""
        handling, clock = self.task.handling, self.clock
        compensated = self.attitude.compensated
        damped = limits.decay(self.scene, clock.h)
        about = (damped, self.limit, self.method, clock.h, self.kind)
        if self.arrays.is_timed and (text := rounding.of_times(clock.longest, clock.h)):
            rounding.warn(text)
        warned = self.first is not None and limits.warn(self.first, *about, compensated=compensated)
        span = clock.span(self.task.choice.restore)
        run = partial(pool.run_ensemble, self.arrays.run)
        how = ((self.bodies, self.arrays.job.width), handling.threads, handling.progress)
        if handling.sink is None:
            run(span, *how)
            result = self._handed_out(self.t, slice(None), damped)
        else:
            saved = clock.saved
            for slots in few(len(saved)):
                before = (slots[1] if len(slots) > 1 else 1) - 1
                piece = Span(
                    saved[before], saved[slots[-1]], span.n_steps, span.save_every, 1 - before,
                    span.restore,
                )  # fmt: skip
                run(piece, *how)
                # the initial save, with which all pieces begin, is handed out with the first
                new = slice(min(before, 1), len(slots))
                handling.sink(self._handed_out(self.t[slots[new]], new, damped))
            last = slice(len(slots) - 1, len(slots))
            result = self._handed_out(self.t[-1:], last, damped)
        if clock.n_steps and not warned:
            turns = np.sqrt(self.memory.watch[0])
            limits.warn(turns, *about, compensated=compensated)
        return result

    def _handed_out(
        self, t: NDArray[np.float64], slots: slice, damped: NDArray[np.float64]
    ) -> Trajectory:
        memory = self.memory
        rows = memory.out[slots]
        ends = np.cumsum([self.attitude.stored, *[3 for _ in self.beside]])
        columns = {
            name[0]: rows[..., k : k + 3] for name, k in zip(self.beside, ends, strict=False)
        }
        about = (damped, self.limit, self.method, self.attitude)
        return Trajectory(
            t=t,
            state=rows[..., : ends[0]],
            defect=memory.defect[slots],
            status=limits.status(memory.x, memory.watch, *about) | memory.lost,
            method=self.method.name,
            representation=self.attitude.name,
            dt=self.clock.h,
            one_body=self.one_body,
            packed=self.packed,
            attitude=self.attitude,
            record=self.method,
            carried=columns,
        )


def _check_sink(sink: Any, every: int | None) -> None:
    if sink is not None and not callable(sink):
        raise TypeError(f"sink: found {checks.brief(sink)}; accepted: a function")
    if sink is not None and every is None:
        raise ValueError("sink: found without save_every; accepted: with it")


def _not_held(params: NDArray[np.float64], kind: np.dtype[Any], rows_each: int) -> NDArray[Any]:
    """Flags of the bodies with parameters beyond the precision's range: one for all, or (N,)."""
    beyond = (np.abs(params) > np.finfo(kind).max).any(axis=-1)
    flags = np.where(beyond, np.uint8(Status.NON_FINITE), np.uint8(0))
    return np.repeat(flags, rows_each) if flags.ndim else flags


def _quiet(
    turns: NDArray[np.float64], most: float, watch: NDArray[Any], rows_each: int
) -> NDArray[np.bool_]:
    """Which bodies' turns are known to need no look, (N,), and these into ``watch``."""
    each = np.repeat(turns, rows_each) if turns.size > 1 and rows_each > 1 else turns
    quiet = np.broadcast_to(each <= most, watch.shape[1])
    np.square(each, where=quiet, out=watch[0], casting="same_kind")
    return np.array(quiet)


def _rows(
    start: NDArray[Any], beside: dict[str, NDArray[Any]], kind: np.dtype[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitudes (N or 1, 4), and what is carried beside them side by side (N or 1, 0 or more)."""
    values = [np.atleast_2d(value) for value in beside.values()]
    most = max(map(len, values), default=1)
    columns = [np.zeros((most, 0)), *(np.broadcast_to(value, (most, 3)) for value in values)]
    with np.errstate(over="ignore"):
        return (
            np.ascontiguousarray(np.atleast_2d(start), dtype=kind),
            np.ascontiguousarray(np.hstack(columns), dtype=kind),
        )


def few(saves: int) -> list[list[int]]:
    """The initial save with each few that follow it."""
    return [
        [0, *range(first, min(first + _RING, saves))] for first in range(1, max(saves, 2), _RING)
    ]


def _closed_form(
    task: Task,
    start: NDArray[Any],
    w0: NDArray[Any],
    kind: np.dtype[Any],
    t: NDArray[np.float64],
) -> Trajectory:
    scene = task.scene
    n = max(len(x) if x.ndim == 2 else 1 for x in (start, w0))
    packed: Packed = scene.packed(n)
    q, w = exact.free_body(
        start,
        w0,
        np.asarray(scene.inertia),
        t - task.clock.begin,
        allow_unphysical=scene.allow_unphysical,
        dtype=kind,
        n_threads=task.handling.threads,
        invalid=task.handling.invalid,
    )
    one_body = q.ndim == 2
    q, w = (x[:, None] if one_body else x for x in (q, w))
    attitude = task.choice.attitude
    state = q if attitude.stored == 4 else quat_to_dcm(q).reshape(*q.shape[:2], 9)
    with np.errstate(invalid="ignore"):
        far = exact.turned(w0, t - task.clock.begin) > rounding.most_turned(kind)
        bad = np.isnan((q @ np.zeros(4, dtype=kind) + w @ np.zeros(3, dtype=kind)).sum(axis=0))
    return Trajectory(
        t=t,
        state=state,
        defect=np.zeros(q.shape[:2], dtype=kind),
        status=bad * np.uint8(Status.NON_FINITE) | far * np.uint8(Status.STEP_TOO_LARGE),
        method=task.choice.method.name,
        representation=attitude.name,
        dt=task.clock.h,
        one_body=one_body,
        packed=packed,
        attitude=attitude,
        record=task.choice.method,
        carried={"w": w},
    )
