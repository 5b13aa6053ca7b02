"""Runs that are prepared once: everything that does not depend on initial values."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt._cached import cached_property
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import kind_of
from fastatt.engine.job import Job
from fastatt.engine.pool import CALLING_LENGTH, Pool
from fastatt.engine.program import program, width_for
from fastatt.engine.run import Results, Run, Setup
from fastatt.engine.status import DIAGNOSTICS, Status
from fastatt.engine.tape import BLOCK, UNBROKEN, Saves, Steps
from fastatt.propagation import limits
from fastatt.propagation.breakpoints import breaks_within, corners_of
from fastatt.propagation.end import End
from fastatt.propagation.event import watching
from fastatt.propagation.execute import execute
from fastatt.propagation.initial import Given, initial
from fastatt.propagation.options import Choice, Clock, RunOptions, ring_slots
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene

# body-steps; before a longer run the first step of each body is checked
_LONG = 1_000_000
# for how many step sizes and starts the steps are kept
_KEPT = 16
# bodies from which on searching for parameters that all of them share saves time
_MANY = 64


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

    def __init__(
        self,
        scene: Scene,
        n_bodies: int,
        choice: Choice,
        clock: Clock,
        kind: np.dtype[Any],
        *,
        position: bool = False,
        n_threads: int = 1,
        invalid: str = "raise",
        remake: Callable[[], Plan] | None = None,
    ) -> None:
        """Prepare a run; ``remake`` makes the plan again after pickling."""
        self.scene, self.n_bodies, self.kind = scene, n_bodies, kind
        self.choice, self.clock, self.attitude = choice, clock, choice.attitude
        self._n_threads, self._invalid, self._remake = n_threads, invalid, remake
        method = choice.method
        position = position or scene.needs_position
        self.packed = scene.packed(n_bodies, sorted_axes=method.sorted_axes, position=position)
        #: what is saved next to the attitude, with the sizes
        self.carried = scene.carried(position=position)
        watches = tuple(x.watch(scene, position) for x in choice.events)
        self.packed = watching(self.packed, watches)
        self.limit = limits.turn_limit(scene, method, self.attitude, kind)
        self.damped = limits.decay(scene, clock.steps)
        lanes = processor().lanes(kind_of(kind))
        if scene.sampling is not None and clock.h < 0.0:
            raise ValueError(
                f"dt: found {clock.h} with a sampled controller; accepted: above 0, since what it "
                "holds can't be found backwards"
            )
        groups = np.unique(clock.steps).size
        self.job = Job(
            method,
            self.attitude,
            self.packed.structure,
            kind_of(kind),
            shared=self.packed.params.ndim == 1,
            alike=self._shared_parameters(),
            raw=choice.raw,
            projects=choice.projection > 0,
            events=watches,
            windowed=len(corners_of(scene)) > 0 or scene.sampling is not None,
            width=width_for(-(-n_bodies // groups), lanes),
        )
        if not method.is_exact:
            self._program = program(self.job)
        #: the steps of the last runs, by the step size and the time of the start, if it matters
        self._steps: dict[tuple[float, float], Steps] = {}

    def __reduce__(self) -> Any:
        return self._remake, ()

    def __deepcopy__(self, memo: Any) -> Plan:
        return self  # nothing of it changes

    def __copy__(self) -> Plan:
        return self

    def __call__(
        self,
        q0: Any,
        w0: Any = None,
        *,
        v0: Any = None,
        r0: Any = None,
        s0: Any = None,
        t0: float = 0.0,
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
        t0 : float, default 0.0
            Time of the initial state, s.
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
        begin = checks.real("t0", t0)
        values = (q0, w0, v0, r0, s0)
        start, carried = initial(self.scene, values, flag=self._invalid == "flag")
        given = Given.of(start, carried, self.kind)
        if given.bodies not in (1, self.n_bodies):
            raise ValueError(
                f"q0: found {given.bodies} bodies; accepted: {self.n_bodies}, as many as the plan "
                "is for, or one"
            )
        if self.n_bodies > 1:
            given = given._replace(one_body=False)
        if ("r0" in carried) != ("r" in self.carried):
            raise ValueError("r0: accepted, and needed, in a plan that was made with position=True")
        plan = self if params is None else self._with(params)
        return execute(plan, given, begin, RunOptions(self._n_threads))

    def _with(self, params: Any) -> Plan:
        """The plan with other parameters of the user-defined function."""
        was = self.scene.params
        if was is None:
            raise ValueError("params: found, but the scene has none; accepted: of an own function")
        now = checks.array("params", params, f"{np.shape(was)}")
        numbers = self.packed.params.copy()
        numbers[..., self._user_parameters()] = now
        other = object.__new__(Plan)
        other.__dict__.update(self.__dict__)
        other.__dict__.pop("_setup", None)
        other.packed = self.packed._replace(params=numbers)
        return other

    def _user_parameters(self) -> range:
        """Indices of the user-defined function's parameters, which are the last."""
        end = self.packed.structure.turning.n_params
        return range(end - np.atleast_1d(np.asarray(self.scene.params)).shape[-1], end)

    def _shared_parameters(self) -> tuple[int, ...]:
        """Indices of the parameters that all bodies share, without those that a call may replace.

        Results do not depend on it.
        """
        params = self.packed.params
        if params.ndim == 1 or len(params) < _MANY:
            return ()
        can_change = (
            self._user_parameters() if self._remake and self.scene.params is not None else ()
        )
        bits = params.view(np.int64)
        same = (bits == bits[0]).all(axis=0)
        return tuple(k for k in np.flatnonzero(same).tolist() if k not in can_change)

    @cached_property
    def _setup(self) -> Setup:
        """What all runs share: parameters, flags and bounds."""
        method = self.choice.method
        params = np.ascontiguousarray(np.atleast_2d(self.packed.params), dtype=np.float64)
        # parameters beyond the precision's range, and damping beyond the method's limit
        lost = (np.abs(params) > np.finfo(self.kind).max).any(axis=-1)
        fast = self.damped > method.damping_limit
        flags = lost * np.uint8(Status.NON_FINITE) | fast * np.uint8(Status.STEP_TOO_LARGE)
        limits = [x.bound(self) for x in DIAGNOSTICS]
        flags = np.ascontiguousarray(flags, dtype=np.uint8)
        return Setup(self._program, self.packed.resources, limits, params, flags)

    def pool(self, bodies: int, n_threads: int) -> Pool:
        """The threads of a run of a number of bodies."""
        formulas = self._program.formulas
        return Pool(
            bodies, self.job.width, formulas.operations, n_threads,
            calls=self.calls, watched=bool(self.job.events),
        )  # fmt: skip

    def steps(self, h: float, t0: float, start: End | None = None, *, ring: bool = False) -> Steps:
        """The steps of bodies with the step size h; saves go to a ``ring`` of slots."""
        is_plain, key = start is None and not ring, (h, t0 if self.job.windowed else 0.0)
        if is_plain and (known := self._steps.get(key)):
            return known
        clock, breaks = self.clock, UNBROKEN
        if self.job.windowed:
            breaks = breaks_within(self.scene, t0, clock.duration)
        made = Steps(
            clock.legs(h, breaks), Saves(clock.since, clock.slack),
            slots=ring_slots(clock.saves) if ring else None,
            every=self.choice.projection, block=CALLING_LENGTH if self.calls else BLOCK,
            resumes=start is not None, done=clock.done, watched=bool(self.job.events),
            new=start is None or start.watched != self.watched,
        )  # fmt: skip
        if is_plain:
            while len(self._steps) >= _KEPT:
                self._steps.pop(next(iter(self._steps)), None)
            self._steps[key] = made
        return made

    def started(
        self, given: Given, t0: float, results: Results, rows: Any, steps: Steps,
        start: End | None = None,
    ) -> Run:  # fmt: skip
        """A run of some bodies, whose results go to the given arrays of theirs.

        With ``start`` it continues from the end of another run.
        """
        run = Run(self._setup, steps, (given.q, given.y), rows, results, t0)
        if start is None:
            run.begin()
        else:
            run.resume(start.states, start.events if start.watched == self.watched else [])
        return run

    def times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s. Warns if rounding of the time is not small compared with a step.

        Raises ``ValueError`` if a time overflows.
        """
        found = self.clock.times(t0)
        by_time = not self.choice.method.is_exact and (
            self.job.windowed or self._program.formulas.is_timed
        )
        if by_time and (text := rounding.of_times(self.clock.longest(t0), self.clock.h)):
            rounding.warn(text)
        return found

    @property
    def width(self) -> int:
        """Number of values that are saved for each body."""
        return self.attitude.stored + sum(self.carried.values())

    @property
    def is_short(self) -> bool:
        """Whether warnings may wait until the run is over."""
        return self.n_bodies * self.clock.n_steps <= _LONG

    @property
    def calls(self) -> bool:
        """Whether steps call a user-defined function that is not traced."""
        return bool(self._program.formulas.calls)

    def results(self, saves: int) -> Results:
        """Arrays for a number of saves."""
        events = len(self.choice.events)
        return Results.empty(saves, self.n_bodies, self.width, self.kind, events)

    def trajectory(
        self, t: NDArray[np.float64], results: Results, one_body: bool, end: End | None = None
    ) -> Trajectory:
        """The trajectory of the given saves."""
        saves = results.saves
        return Trajectory(
            t=t,
            state=saves[:, :, : self.attitude.stored],
            norm_error=saves[:, :, -1],
            status=results.status,
            dt=self.clock.steps,
            one_body=one_body,
            packed=self.packed,
            attitude=self.attitude,
            record=self.choice.method,
            carried={name: saves[:, :, columns] for name, columns in self._columns.items()},
            end=end,
            found=results.event_times if self.choice.events else None,
            terminal=tuple(x.terminal for x in self.choice.events),
        )

    @cached_property
    def _columns(self) -> dict[str, slice]:
        """The columns in which velocity, position and states are saved."""
        ends = pairwise(accumulate(self.carried.values(), initial=self.attitude.stored))
        return {name: slice(a, b) for name, (a, b) in zip(self.carried, ends, strict=True)}

    @cached_property
    def _silent_range(self) -> tuple[float, float]:
        """Range of rotation angles per step, rad, without a warning."""
        eps = float(np.finfo(self.kind).eps)
        if (self.damped > self.choice.method.damping_limit).any():
            return math.inf, 0.0
        return 0.0 if self.attitude.compensated else eps, min(self.limit, eps**-0.5)

    def warn_of_first(self, given: Given) -> bool:
        """Warn of each body's first step, unless the rate is prescribed."""
        angles = np.zeros(1)
        if self.scene.kind != "rate":
            w, steps = given.y[:, :3], self.clock.steps
            angles = limits.first_step(self.scene, self.choice.method, w, steps)
        return limits.warn(self, angles)

    def warn_after(self, given: Given, angles: NDArray[Any]) -> None:
        """Warn of the largest steps of bodies, rad, or of the first step if that is the reason."""
        least, most = self._silent_range
        largest = float(angles.max())
        if math.isnan(largest):
            largest = float(np.nanmax(angles, initial=0.0))
        if largest and self.clock.n_steps and not least <= largest <= most:
            _ = self.warn_of_first(given) or limits.warn(self, angles)

    def end(self, given: Given, run: Run, t0: float, done: int) -> End:
        """The end of a run after ``done`` steps, with a copy of its initial values."""
        kept = given._replace(q=given.q.copy(), y=given.y.copy())
        return End(
            kept, run.states[:, run.without_events], done, t0, self.about, self.packed.params,
            self.equations, self.watched, run.events(),
        )  # fmt: skip

    @cached_property
    def about(self) -> dict[str, Any]:
        """The options that a resumed run has in common, by the names of arguments."""
        choice = self.choice
        return {
            "dt": float(self.clock.h).hex(),
            "method": choice.method.name,
            "representation": self.attitude.name,
            "compensated": self.attitude.compensated,
            "normalise": "never" if choice.raw else choice.projection or "output",
            "r0": "r" in self.carried,
        }

    @cached_property
    def equations(self) -> str:
        """A hash of the operations of a step, the tables that it reads, and when models jump."""
        read = hashlib.sha256(self._program.formulas.digest)
        read.update(repr((self.scene.breakpoints, self.scene.sampling)).encode())
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        return read.hexdigest()

    @cached_property
    def watched(self) -> str:
        """A hash of the functions of the events and of what they do; empty without events."""
        if not self.job.events:
            return ""
        formulas = self._program.formulas
        each = [(watch.direction, watch.terminal) for watch in self.job.events]
        spelled = formulas.look.spelled(formulas.resources)
        return hashlib.sha256(f"{each}{spelled}".encode()).hexdigest()
