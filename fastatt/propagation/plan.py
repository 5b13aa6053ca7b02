"""Runs that are prepared once: everything that does not depend on initial values."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt._fork import cached_property
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import kind_of
from fastatt.engine.crossings import SEARCH_BLOCK
from fastatt.engine.job import Job
from fastatt.engine.run import CALLING_LENGTH, Fixed, Results, Run, Setup, prepare, width_for
from fastatt.engine.status import DIAGNOSTICS, Status
from fastatt.propagation import limits
from fastatt.propagation.breakpoints import corners_of
from fastatt.propagation.closed_forms import Evaluation
from fastatt.propagation.event import watching
from fastatt.propagation.execute import execute
from fastatt.propagation.initial import Given, initial
from fastatt.propagation.options import Choice, Clock, PerBodyClock, RunOptions
from fastatt.propagation.resume import End
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene

# body-steps; before a longer run the first step of each body is checked
_LONG = 1_000_000
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
        if choice.reducer is not None:
            self.packed = choice.reducer.watching(self.packed, kind)
            self.carried["reduced"] = choice.reducer.columns(kind)
        watches = tuple(x.watch(scene, position) for x in choice.events)
        self.packed = watching(self.packed, watches)
        self.limit = limits.turn_limit(scene, method, self.attitude, kind)
        self.damped = limits.decay(scene, clock.steps)
        self._rates = limits.known_turns(scene, choice, self.packed)
        lanes = processor().lanes(kind_of(kind))
        if scene.sampling is not None and clock.h < 0.0:
            raise ValueError(
                f"dt: found {clock.h} with a sampled controller; accepted: above 0, since what it "
                "holds can't be found backwards"
            )
        # a device takes whole steps: it refuses declared breakpoints, and crosses those of models
        corners = len(scene.breakpoints if choice.device else corners_of(scene)) > 0
        corners = corners or scene.sampling is not None
        divides = corners or clock.ends is not None
        self.job = Job(
            method,
            self.attitude,
            self.packed.structure,
            kind_of(kind),
            shared=self.packed.params.ndim == 1,
            alike=self._shared_parameters(),
            known=self._rates is not None,
            raw=choice.raw,
            projects=choice.projection > 0,
            own_steps=isinstance(clock, PerBodyClock) or divides,
            events=watches,
            windowed=corners,
            width=n_bodies if choice.device else width_for(n_bodies, lanes),
        )
        if not method.is_exact:
            self._program = (choice.device.program if choice.device else prepare)(self.job)
            if self.calls and isinstance(clock, PerBodyClock):
                self.clock = clock = clock.for_calls()
        self.span = clock.span(choice.projection)
        if watches:
            self.span = replace(self.span, block=SEARCH_BLOCK)
        if not method.is_exact and self.calls:
            self.span = replace(self.span, block=CALLING_LENGTH)
        #: prepared closed forms, by the number of saves
        self.evaluations: dict[int, Evaluation] = {}

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
        if params.ndim == 1 or len(params) < _MANY or self.choice.device:
            return ()
        can_change = (
            self._user_parameters() if self._remake and self.scene.params is not None else ()
        )
        bits = params.view(np.int64)
        same = (bits == bits[0]).all(axis=0)
        return tuple(k for k in np.flatnonzero(same).tolist() if k not in can_change)

    @cached_property
    def _setup(self) -> Setup:
        """What all runs share: parameters, known rotation angles, flags and bounds."""
        method = self.choice.method
        params = np.ascontiguousarray(np.atleast_2d(self.packed.params), dtype=np.float64)
        rates = 0.0 if self._rates is None else self._rates
        with np.errstate(over="ignore", invalid="ignore"):
            angles = np.atleast_1d(np.multiply(rates, np.abs(self.clock.steps)))
        # parameters beyond the precision's range, and damping beyond the method's limit
        lost = (np.abs(params) > np.finfo(self.kind).max).any(axis=-1)
        fast = self.damped > method.damping_limit
        flags = lost * np.uint8(Status.NON_FINITE) | fast * np.uint8(Status.STEP_TOO_LARGE)
        quiet = limits.quiet_up_to(self.scene, method, self.limit)
        return Setup(
            self._program,
            self.packed.resources,
            [quiet, *(x.bound(self) for x in DIAGNOSTICS)],
            Fixed(
                params,
                np.ascontiguousarray(angles, dtype=np.float64),
                np.ascontiguousarray(flags, dtype=np.uint8),
            ),
        )

    def started(
        self,
        given: Given,
        t0: float,
        results: Results,
        bodies: tuple[int, int],
        start: End | None = None,
    ) -> Run:
        """A run of the bodies (first, number), which writes into the arrays of the whole ensemble.

        With ``start`` it continues from the end of another run.
        """
        clock, stages = self.clock, self.choice.method.stages
        share = 0.5 * float(stages[-1][1]) if stages else 0.0
        per_body, parts = None, None
        if isinstance(clock, PerBodyClock):
            per_body = clock.per_body(self.n_bodies)
        elif self.job.own_steps or self.job.events:
            parts = clock.parts(t0, self.scene)
        times, state = (t0, clock.h, share), (given.q, given.y)
        run = Run(self._setup, bodies, state, times, results, per_body, parts)
        if start is not None:
            run.states[...], run.diagnostics[...] = start.states, start.diagnostics
            if start.watched == self.watched:
                for to, kept in zip(run.events, start.events, strict=True):
                    to[...] = kept
        return run

    def times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s. Warns if rounding of the time is not small compared with a step.

        Raises ``ValueError`` if a time overflows.
        """
        found = self.clock.times(t0)
        by_time = not self.choice.method.is_exact and (
            self.job.own_steps or self._program.formulas.is_timed
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
        out = results.out
        return Trajectory(
            t=t,
            state=out[:, :, : self.attitude.stored],
            norm_error=results.norm_error,
            status=results.status,
            dt=self.clock.steps,
            one_body=one_body,
            packed=self.packed,
            attitude=self.attitude,
            record=self.choice.method,
            carried={name: out[:, :, columns] for name, columns in self._columns.items()},
            end=end,
            found=results.event_times,
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

    def warn_after(self, given: Given, largest: float, squares: Sequence[NDArray[Any]]) -> None:
        """Warn of the steps that were taken, or of the first step if that one is the reason.

        ``squares`` of the largest rotation angle of a step, rad², are in the order in which the
        bodies were run.
        """
        least, most = self._silent_range
        if largest and self.clock.n_steps and not least <= largest <= most:
            seen, order = np.sqrt(np.concatenate(squares)), self.clock.order
            seen = seen if order is None else seen[np.argsort(order)]
            _ = self.warn_of_first(given) or limits.warn(self, seen)

    def end(self, given: Given, run: Run, t0: float, done: int) -> End:
        """The end of a run after ``done`` steps, with a copy of its initial values."""
        kept = given._replace(q=given.q.copy(), y=given.y.copy())
        return End(
            kept, run.states, run.diagnostics, done, t0, self.about, self.packed.params,
            self.equations, self.watched, [x.copy() for x in run.events],
        )  # fmt: skip

    @cached_property
    def about(self) -> dict[str, Any]:
        """The options that a resumed run must share, by the names of arguments."""
        choice = self.choice
        return {
            "dt": float(self.clock.h).hex(),
            "method": choice.method.name,
            "representation": self.attitude.name,
            "compensated": self.attitude.compensated,
            "normalise": "never" if choice.raw else choice.projection or "output",
            "dtype": self.kind.name,
            "t_end": self.clock.ends,
            "breakpoints": list(self.scene.breakpoints),
            "sampling": None if self.scene.sampling is None else list(self.scene.sampling),
            "r0": "r" in self.carried,
            "reduce": 0 if choice.reducer is None else choice.reducer.start.shape[-1],
        }

    @cached_property
    def equations(self) -> str:
        """A hash of the operations of a step and of the tables that it reads."""
        read = hashlib.sha256(self._program.formulas.digest)
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
        spelled = formulas.events.spelled(formulas.resources)
        return hashlib.sha256(f"{each}{spelled}".encode()).hexdigest()
