"""Runs that are prepared once: everything that does not depend on initial values."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import precision_of
from fastatt.engine.job import Job
from fastatt.engine.marks import Event
from fastatt.engine.program import Program, program, width_for
from fastatt.engine.run import Results, Run, Setup
from fastatt.engine.status import FLAGS, Bounded, Status
from fastatt.engine.tape import UNBROKEN, Piece, Steps
from fastatt.propagation import closed_run, limits
from fastatt.propagation.breakpoints import breaks_within, corners_of, divisions_of
from fastatt.propagation.choice_of_method import Choice
from fastatt.propagation.end import MOST, Checkpoints, End
from fastatt.propagation.event import warn_of_events
from fastatt.propagation.initial import Initial, initial
from fastatt.propagation.limits import StepLimits
from fastatt.propagation.output import History, InterruptedRun, Output, check_room
from fastatt.propagation.schedule import Schedule
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.models import Packed
from fastatt.scene.scene import Scene
from fastatt.threads import default_threads, progress_bar

#: bodies of an ensemble that are run at a time, so that working memory is a small share
PART = 1 << 19
# body-steps; before a longer run the first step of each body is checked
_LONG = 1_000_000
# for how many step sizes and starts the steps are kept
_KEPT = 16
# operations of a run that several threads end sooner, of the closed form, and of a function's call
_WORTH, _CLOSED, _CALLED = 1.5e7, 500, 1000
# bodies from which on searching for parameters that all of them share saves time
_MANY = 64


@dataclass(frozen=True, eq=False, repr=False)
class Plan:
    """A prepared run of one scene, with a fixed step size and number of bodies.

    :func:`fastatt.plan` makes plans, and calling a plan runs it. A plan can be pickled and copied,
    and several threads may call it at the same time.

    Attributes
    ----------
    scene : Scene
        The scene.
    n_bodies : int
        Number of bodies of each call.

    Examples
    --------
    >>> import fastatt as fa
    >>> run = fa.plan(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), 1, dt=0.01, n_steps=1, method="rk4")
    >>> run([1, 0, 0, 0], [0.1, 0.2, 0.3]).q.shape
    (1, 4)
    """

    scene: Scene
    n_bodies: int
    choice: Choice
    schedule: Schedule
    #: precision of the state
    dtype: np.dtype[Any]
    #: structure and parameters of the scene and of the functions of events
    packed: Packed
    #: what is saved next to the attitude, with the sizes
    carried: Mapping[str, int]
    limits: StepLimits
    #: of a method that takes steps, None of a closed form
    program: Program | None
    n_threads: int | None = 1
    #: the time, s, at which a call begins that gives none, and whether it may give one
    t0: float = 0.0
    has_fixed_t0: bool = False
    #: makes the plan again after pickling
    remake: Callable[[], Plan] | None = None
    #: the steps of the last runs, by the step size and the time of the start, if it matters
    kept_steps: dict[tuple[float, float], Steps] = field(default_factory=dict)

    @property
    def attitude(self) -> Attitude:
        """How the attitude is represented."""
        return self.choice.attitude

    def __reduce__(self) -> Any:
        return self.remake, ()

    def __call__(
        self,
        q0: Any,
        w0: Any = None,
        *,
        v0: Any = None,
        r0: Any = None,
        s0: Any = None,
        t0: float | None = None,
        params: Any = None,
    ) -> Trajectory:
        """Run from given initial values.

        Parameters
        ----------
        q0 : array_like of shape (4,) or (N, 4)
            Initial attitudes, as in :func:`fastatt.propagate`.
        w0 : array_like of shape (3,) or (N, 3), optional
            Initial angular velocities along body axes, rad/s.
        v0 : array_like of shape (3,) or (N, 3), optional
            Initial velocities along body axes, m/s.
        r0 : array_like of shape (3,) or (N, 3), optional
            Initial positions along inertial axes, m; required if the plan was made with
            ``position=True``.
        s0 : array_like of shape (n,) or (N, n), optional
            Initial values of the scene's states.
        t0 : float, optional
            Time of the initial state, s. The default is that of the plan, which a plan with
            ``t_end`` or ``save_at`` has fixed.
        params : array_like, optional
            Replaces the parameters of the scene's user-defined function, in the shape of the
            scene's ``params``. Nothing is compiled again.

        Returns
        -------
        Trajectory
            The results, with the same bits as those of :func:`fastatt.propagate`.

        Raises
        ------
        ValueError, TypeError
            If an argument does not fit, as in :func:`fastatt.propagate`.
        """
        t0 = self.t0 if t0 is None else checks.real("t0", t0)
        if self.has_fixed_t0 and t0 != self.t0:
            raise ValueError(f"t0: found {t0} in a plan with t_end or save_at; accepted: {self.t0}")
        attitudes, carried = initial(self.scene, (q0, w0, v0, r0, s0))
        start = Initial.of(attitudes, carried, self.dtype)
        if start.bodies not in (1, self.n_bodies):
            raise ValueError(
                f"q0: found {start.bodies} bodies; accepted: {self.n_bodies}, as many as the plan "
                "is for, or one"
            )
        if self.n_bodies > 1:
            start = start._replace(one_body=False)
        if ("r0" in carried) != ("r" in self.carried):
            raise ValueError("r0: accepted, and needed, in a plan that was made with position=True")
        plan = self if params is None else self._with(params)
        return plan.run(start, t0, n_threads=self.n_threads)

    def _with(self, params: Any) -> Plan:
        """The plan with other parameters of the user-defined function."""
        was = self.scene.params
        if was is None:
            raise ValueError("params: found, but the scene has none; accepted: of an own function")
        now = checks.array("params", params, f"{np.shape(was)}")
        numbers = self.packed.params.copy()
        numbers[..., _user_parameters(self.scene, self.packed)] = now
        return replace(self, packed=self.packed._replace(params=numbers))

    @cached_property
    def setup(self) -> Setup:
        """The program with the numbers of its bodies, their first flags, and bounds."""
        assert self.program is not None
        params = np.ascontiguousarray(np.atleast_2d(self.packed.params), dtype=np.float64)
        # parameters beyond the precision's range, and damping beyond the method's limit
        largest = np.finfo(self.dtype).max
        lost: Any = np.zeros(len(params), np.bool_)
        if not -largest <= params.min(initial=0.0) <= params.max(initial=0.0) <= largest:
            lost = (np.abs(params) > largest).any(axis=-1)
        flags = lost * FLAGS(Status.NON_FINITE)
        flags = flags | self.limits.too_damped * FLAGS(Status.STEP_TOO_LARGE)
        bounded = Bounded(self.limits.turn, self.attitude, self.dtype)
        limits = [of.bound(bounded) for of in self.program.job.diagnostics]
        flags = np.ascontiguousarray(flags, dtype=FLAGS)
        return Setup(self.program, self.packed, limits, params, flags)

    @cached_property
    def _operations(self) -> float:
        """About how many operations a run takes."""
        if self.program is None:
            return _CLOSED * self.schedule.saves * self.n_bodies
        job = self.program.job
        of_step = job.operations + _CALLED * job.calls
        return of_step * self.schedule.n_steps * self.n_bodies

    def run(
        self, start: Initial, t0: float, *, n_threads: int | None = 1, progress: bool = False,
        on_save: Callable[[Trajectory], object] | None = None, file: Path | None = None,
        checkpoint: Path | None = None, resumed: End | None = None, keeps_end: bool = False,
    ) -> Trajectory:  # fmt: skip
        """Run from initial values that were checked.

        Saves are held in memory, or go to the function ``on_save`` and to a ``file``. The run goes
        on from the end of the one that is ``resumed``. If it ``keeps_end``, the trajectory holds
        its end, if that is small.

        Raises ``MemoryError`` if the saves do not fit, ``InterruptedRun`` on Ctrl-C.
        """
        schedule, shape = self.schedule, (self.schedule.saves, self.n_bodies, self.width)
        if n_threads is None:
            n_threads = default_threads() if self._operations > _WORTH else 1
        if on_save is None and file is None:
            check_room(shape, self.dtype)
        times = self._times(t0)
        history = None if file is None else History(file, shape, self.dtype, times)
        arrays = partial(Results.empty, shape[1:], self.dtype, len(self.choice.events))
        trajectory = partial(self._trajectory, one_body=start.one_body)
        output, end = Output(schedule, times, arrays, trajectory, (on_save, history)), None
        is_warned = False
        with closing(output), progress_bar(progress, *output.length) as output.done:
            if self.program is None:
                is_warned = self._evaluate(start, output, n_threads)
            else:
                write, takers = partial(self._end, start, t0), [output.take]
                ends_on_step = schedule.t_end is None and not schedule.is_per_body
                if checkpoint is not None:
                    takers.append(Checkpoints(checkpoint, write, whole=ends_on_step).take)
                kept = None if resumed is None else resumed.kept(self.events_key)
                run, is_warned = self._step(start, t0, output, takers, n_threads, kept)
                if keeps_end and ends_on_step and self.n_bodies <= min(MOST, PART):
                    end = write(run, schedule.end)
            limits.warn_of_status(output.results.status, is_warned=is_warned)
            return output.trajectory(end)

    def _evaluate(self, start: Initial, output: Output, n_threads: int) -> bool:
        """Evaluate the closed form at the saves, a batch after the other; whether it warned."""
        is_warned = False
        for first, end in output.batches:
            results = output.results._replace(saves=output.results.saves[: end - first])
            since = self.schedule.at[0][first:end]
            try:
                is_warned |= closed_run.evaluate(
                    self.scene, self.attitude, start, since, n_threads, results
                )
                output.hand_out(first, end)
            except KeyboardInterrupt:
                output.results.leave()
                raise InterruptedRun(output.so_far()) from None
        return is_warned

    def _step(
        self, start: Initial, t0: float, output: Output,
        takers: Sequence[Callable[[Run, Piece], None]], n_threads: int,
        kept: Mapping[str, Any] | None,
    ) -> tuple[Run, bool]:  # fmt: skip
        """Take all steps, in pieces; returns the last run, and whether a warning was given.

        Bodies of each step size are run together, and a large ensemble in groups, one after the
        other.
        """
        n, results, is_ring = self.n_bodies, output.results, output.is_ring
        squares, told = np.zeros(n, self.dtype), np.zeros((2, n, self._watched), np.bool_)
        warned = n * self.schedule.n_steps > _LONG and self.limits.warn(start)
        if self.scene.states and self.schedule.n_steps and kept is None:
            self.limits.warn_of_states(self.packed, start, t0)
        is_one = is_ring or len(takers) > 1 or kept is not None
        groups = self.schedule.groups(n, n if is_one else PART)
        kind: Any = Run
        if self._watched:  # else this module is not loaded
            from fastatt.engine.run_with_events import RunWithEvents

            kind = RunWithEvents
        for rows, h in groups:
            group, saved = results.of_bodies(rows), 0
            try:
                run = kind(
                    self.setup, self._steps(h, t0, kept, is_ring=is_ring), (start.q, start.y),
                    rows, group, t0, n_threads, kept,
                )  # fmt: skip
                for piece in run.pieces(output.stops):
                    run.advance(piece)
                    for take in takers:
                        take(run, piece)
                    saved = piece.saved
            except KeyboardInterrupt:
                group.leave(first=saved)
                results.put(rows, group)
                for others, _ in groups:
                    results.leave(others)
                raise InterruptedRun(output.so_far()) from None
            squares[rows] = run.squares
            if self._watched:
                told[:, rows] = run.lost, run.overfull
            results.put(rows, group)
        if self.schedule.n_steps and not warned:
            warned = self.limits.warn(start, np.sqrt(squares), results.status)
        if self._watched:
            warn_of_events(told, len(self.choice.events), self._switches)
        return run, warned

    def _steps(
        self, h: float, t0: float, kept: Mapping[str, Any] | None, *, is_ring: bool
    ) -> Steps:
        """The steps of bodies with the step size h, that may go on from what another run kept.

        Saves may go to a ring of slots.
        """
        assert self.program is not None
        schedule, job, breaks = self.schedule, self.program.job, UNBROKEN
        is_plain, key = kept is None and not is_ring, (h, t0 if job.windowed else 0.0)
        if is_plain and (known := self.kept_steps.get(key)):
            return known
        if job.windowed:
            breaks = breaks_within(self.scene, t0, schedule.duration)
        steps = Steps(
            schedule.legs(h, breaks), schedule.at, slots=schedule.slots if is_ring else None,
            every=self.choice.projection, block=job.block,
            regrids=job.regrids, resumes=kept is not None, done=schedule.done,
            has_events=self._watched > 0, new=kept is None or "of_events" not in kept,
        )  # fmt: skip
        if is_plain:
            while len(self.kept_steps) >= _KEPT:
                self.kept_steps.pop(next(iter(self.kept_steps)), None)
            self.kept_steps[key] = steps
        return steps

    def _times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s. Warns if rounding of the time is not small compared with a step.

        Raises ``ValueError`` if a time overflows.
        """
        schedule, times = self.schedule, self.schedule.times(t0)
        if self.program and (self.program.job.windowed or self.program.job.is_timed):
            longest = max(abs(t0), abs(t0 + schedule.duration))
            if text := rounding.of_times(longest, schedule.h):
                rounding.warn(text)
        return times

    @property
    def _watched(self) -> int:
        """The number of events and switches."""
        return 0 if self.program is None else self.program.job.watched

    @property
    def _switches(self) -> tuple[str, ...]:
        """The names of the scene's switches."""
        return tuple(self.scene.switches)

    @cached_property
    def width(self) -> int:
        """Number of values that are saved for each body."""
        return self.attitude.stored + sum(self.carried.values())

    @cached_property
    def _columns(self) -> dict[str, slice]:
        """The columns in which velocity, position and states are saved."""
        ends = pairwise(accumulate(self.carried.values(), initial=self.attitude.stored))
        return {name: slice(a, b) for name, (a, b) in zip(self.carried, ends, strict=True)}

    def _trajectory(
        self, t: NDArray[np.float64], results: Results, *, one_body: bool, end: End | None = None,
        q_before: NDArray[Any] | None = None,
    ) -> Trajectory:  # fmt: skip
        """The trajectory of the given saves."""
        saves, stored = results.saves, self.attitude.stored
        return Trajectory(
            t=t,
            state=saves[:, :, :stored],
            norm_error=saves[:, :, -1],
            status=results.status,
            one_body=one_body,
            carried={name: saves[:, :, columns] for name, columns in self._columns.items()},
            end=end,
            q_before=q_before,
            first_crossings=results.event_times if self.choice.events else None,
            located=tuple(results.crossings),
            **self._described,
        )

    @cached_property
    def _described(self) -> dict[str, Any]:
        """What is the same in all trajectories of the plan."""
        schedule, events = self.schedule, self.choice.events
        return {
            "dt": schedule.dt if schedule.is_per_body else schedule.h,
            "packed": self.packed,
            "attitude": self.attitude,
            "record": self.choice.method,
            "events": tuple(replace(x, function=None) for x in events),
            "crossing_numbers": {
                **{i: i for i, x in enumerate(events) if x.every},
                **{name: len(events) + k for k, name in enumerate(self._switches)},
            },
            "columns": self._columns,
            "divisions": divisions_of(self.scene),
            "parts": self.scene.parts,
        }

    def _end(self, start: Initial, t0: float, run: Run, done: int) -> End:
        """The end of a run after ``done`` steps, with a copy of its initial values."""
        options = {**self._options, "t0": t0, "done": done, "one_body": start.one_body}
        initial = {"q": start.q.copy(), "y": start.y.copy(), "params": self.packed.params}
        return End(options, {**initial, **run.kept()})

    @property
    def kept_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of the arrays from which another run goes on."""
        assert self.program is not None
        n, of_events = self.n_bodies, self.program.is_of_events
        shapes: dict[str, tuple[int, ...]] = {"states": (n, self.program.of_steps.size)}
        if self._watched:
            shapes |= {
                "of_events": (n, int(of_events.sum())), "stopped": (n,),
                "event_times": (n, len(self.choice.events)), "final": (n, self.width + 1),
            }  # fmt: skip
        return shapes

    @cached_property
    def _options(self) -> dict[str, Any]:
        """What the end of a run says of its plan."""
        choice = self.choice
        return {
            "dt": self.schedule.h,
            "method": choice.method.name,
            "representation": self.attitude.name,
            "compensated": self.attitude.compensated,
            "normalise": "never" if choice.raw else choice.projection or "output",
            "r0": "r" in self.carried,
            "equations": self.equations,
            "events": self.events_key,
        }

    @cached_property
    def equations(self) -> str:
        """A hash of the operations of a step, the tables that it reads, and when models jump."""
        assert self.program is not None
        job = self.program.job
        read = hashlib.sha256(job.digest)
        read.update(repr((self.scene.breakpoints, self.scene.samplings)).encode())
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        read.update(_called(job.resources).encode())
        return read.hexdigest()

    @cached_property
    def events_key(self) -> str:
        """A hash of the functions of the events and of what they do; empty without events."""
        if self.program is None or not self._watched:
            return ""
        job = self.program.job
        each = [(x.direction, x.terminal) for x in self.choice.events]
        spelled = job.look.spelled(job.resources)
        called = _called(job.resources)
        return hashlib.sha256(f"{each}{spelled}{called}".encode()).hexdigest()


def prepared(
    scene: Scene,
    n_bodies: int,
    choice: Choice,
    schedule: Schedule,
    dtype: np.dtype[Any],
    *,
    position: bool = False,
    remake: Callable[[], Plan] | None = None,
    **options: Any,
) -> Plan:
    """The plan of a run, with its program compiled; ``options`` are further fields of ``Plan``."""
    method, attitude = choice.method, choice.attitude
    if scene.samplings and schedule.h < 0.0:
        raise ValueError(
            f"dt: found {schedule.h} with a sampled controller; accepted: above 0, since what it "
            "holds can't be found backwards"
        )
    position = position or scene.needs_position
    packed = scene.packed(n_bodies, sorted_axes=method.sorted_axes, position=position)
    for event in choice.events:
        packed = packed._replace(tables=packed.tables | event.function.tables)
    _warn_of_params(scene, n_bodies, choice.events)
    precision = precision_of(dtype)
    groups = np.unique(schedule.dt).size
    job = Job(
        method,
        attitude,
        packed.structure,
        precision,
        shared=packed.params.ndim == 1,
        alike=_shared_parameters(packed, _user_parameters(scene, packed) if remake else range(0)),
        raw=choice.raw,
        projects=choice.projection > 0,
        events=choice.events,
        windowed=len(corners_of(scene)) > 0 or bool(scene.samplings),
    )
    width = width_for(-(-n_bodies // groups), processor().lanes(precision))
    return Plan(
        scene, n_bodies, choice, schedule, dtype, packed, scene.carried(position=position),
        StepLimits(scene, method, attitude, dtype, schedule.dt),
        None if method.is_exact else program(job, width), remake=remake, **options,
    )  # fmt: skip


def _warn_of_params(scene: Scene, n_bodies: int, events: Sequence[Event]) -> None:
    """Warn of parameters that look like one of each body, and are shared by all."""
    params = scene.params
    if n_bodies == 1 or params is None or np.shape(params) != (n_bodies,):
        return
    functions = [*scene.functions, *(event.function for event in events)]
    if frozenset().union(*(f.read_params for f in functions)) == {0}:
        rounding.warn(
            f"params: found ({n_bodies},) with {n_bodies} bodies, of which "
            f"{functions[0].described} reads p[0] alone; all bodies share them: give each its own "
            f"as ({n_bodies}, 1)",
            RuntimeWarning,
        )


def _user_parameters(scene: Scene, packed: Packed) -> range:
    """Indices of the user-defined function's parameters, which are the last of the rotation."""
    end = packed.structure.rotation.n_params
    params = () if scene.params is None else np.atleast_1d(np.asarray(scene.params))
    return range(end - np.shape(params)[-1], end)


def _shared_parameters(packed: Packed, without: range) -> tuple[int, ...]:
    """Indices of the parameters that all bodies share, without those that a call may replace.

    Results do not depend on it.
    """
    params = packed.params
    if params.ndim == 1 or len(params) < _MANY:
        return ()
    bits = params.view(np.int64)
    # most of those that differ do so among the first
    same = np.flatnonzero((bits[:_MANY] == bits[0]).all(axis=0)).tolist()
    return tuple(k for k in same if k not in without and (bits[:, k] == bits[0, k]).all())


def _called(resources: Any) -> str:
    """Fingerprints of the functions that a formula calls."""
    return " ".join(x.fingerprint for what, x in resources if what == "function")
