"""Runs that are prepared once: everything that does not depend on initial values."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import kind_of
from fastatt.engine.job import Job
from fastatt.engine.pool import CALLING_LENGTH
from fastatt.engine.program import program, width_for
from fastatt.engine.run import Results, Run, Setup
from fastatt.engine.search import WatchedRun
from fastatt.engine.status import DIAGNOSTICS, Status
from fastatt.engine.tape import BLOCK, UNBROKEN, Saves, Steps
from fastatt.propagation import limits
from fastatt.propagation.breakpoints import breaks_within, corners_of
from fastatt.propagation.end import End
from fastatt.propagation.execute import execute
from fastatt.propagation.initial import Initial, initial
from fastatt.propagation.options import Choice, Clock, RunOptions
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.models import Packed
from fastatt.scene.scene import Scene

# for how many step sizes and starts the steps are kept
_KEPT = 16
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
    clock: Clock
    #: precision of the state
    kind: np.dtype[Any]
    #: structure and parameters of the scene and of the functions of events
    packed: Packed
    #: what is saved next to the attitude, with the sizes
    carried: Mapping[str, int]
    #: the largest rotation angle of a step for which the method is trustworthy, rad
    limit: float
    #: the largest share of the rate that damping takes in a step, of each body or of all
    damped: NDArray[np.float64]
    job: Job
    #: the ``Program`` of a method that takes steps, None of a closed form
    program: Any
    n_threads: int = 1
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
        t0 = self.clock.t0 if t0 is None else checks.real("t0", t0)
        if self.has_fixed_t0 and t0 != self.clock.t0:
            raise ValueError(
                f"t0: found {t0} in a plan with t_end or save_at; accepted: {self.clock.t0}"
            )
        attitudes, carried = initial(self.scene, (q0, w0, v0, r0, s0))
        start = Initial.of(attitudes, carried, self.kind)
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
        return execute(plan, start, t0, RunOptions(self.n_threads))

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
        """What all runs share: parameters, flags and bounds."""
        method = self.choice.method
        params = np.ascontiguousarray(np.atleast_2d(self.packed.params), dtype=np.float64)
        # parameters beyond the precision's range, and damping beyond the method's limit
        lost = (np.abs(params) > np.finfo(self.kind).max).any(axis=-1)
        fast = self.damped > method.damping_limit
        flags = lost * np.uint8(Status.NON_FINITE) | fast * np.uint8(Status.STEP_TOO_LARGE)
        limits = [x.bound(self) for x in DIAGNOSTICS]
        flags = np.ascontiguousarray(flags, dtype=np.uint8)
        return Setup(self.program, self.packed, limits, params, flags)

    @cached_property
    def usual_angles(self) -> tuple[float, float]:
        """Between which largest angles of a step, rad, there is nothing to warn of."""
        eps = float(np.finfo(self.kind).eps)
        if (self.damped > self.choice.method.damping_limit).any():
            return math.inf, 0.0
        most = min(self.limit, rounding.most_half_right(self.kind))
        return 0.0 if self.attitude.compensated else eps, most

    def steps(self, h: float, t0: float, resumed: End | None, *, ring: bool) -> Steps:
        """The steps of bodies with the step size h; saves go to a ``ring`` of slots."""
        is_plain, key = resumed is None and not ring, (h, t0 if self.job.windowed else 0.0)
        if is_plain and (known := self.kept_steps.get(key)):
            return known
        clock, formulas, breaks = self.clock, self.program.formulas, UNBROKEN
        if self.job.windowed:
            breaks = breaks_within(self.scene, t0, clock.duration)
        steps = Steps(
            clock.legs(h, breaks), Saves(clock.since, clock.slack),
            slots=clock.slots if ring else None,
            every=self.choice.projection, block=CALLING_LENGTH if formulas.calls else BLOCK,
            regrids=formulas.regrids, resumes=resumed is not None, done=clock.done,
            watched=bool(self.job.events),
            new=resumed is None or resumed.about["watched"] != self.watched,
        )  # fmt: skip
        if is_plain:
            while len(self.kept_steps) >= _KEPT:
                self.kept_steps.pop(next(iter(self.kept_steps)), None)
            self.kept_steps[key] = steps
        return steps

    def started(
        self, start: Initial, t0: float, results: Results, rows: Any, steps: Steps,
        resumed: End | None,
    ) -> Run:  # fmt: skip
        """A run of some bodies, whose results go to the given arrays of theirs.

        It continues from the end of the run that is ``resumed``.
        """
        kind = WatchedRun if self.job.events else Run
        run = kind(self.setup, steps, (start.q, start.y), rows, results, t0)
        run.begin()
        if resumed is not None:
            is_same = resumed.about["watched"] == self.watched
            run.resume(resumed.arrays, same_events=is_same)
        return run

    def times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s. Warns if rounding of the time is not small compared with a step.

        Raises ``ValueError`` if a time overflows.
        """
        clock, times = self.clock, self.clock.times(t0)
        if self.program and (self.job.windowed or self.program.formulas.is_timed):
            longest = max(abs(t0), abs(t0 + clock.duration))
            if text := rounding.of_times(longest, clock.h):
                rounding.warn(text)
        return times

    @property
    def width(self) -> int:
        """Number of values that are saved for each body."""
        return self.attitude.stored + sum(self.carried.values())

    def results(self, saves: int) -> Results:
        """Arrays for a number of saves, not initialised but for the times of events."""
        n, events = self.n_bodies, len(self.choice.events)
        return Results(
            np.empty((saves, n, self.width + 1), self.kind),
            np.empty(n, np.uint8),
            np.full((n, events), np.nan),
        )

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
            dt=self.clock.dt if self.clock.is_per_body else self.clock.h,
            one_body=one_body,
            packed=self.packed,
            attitude=self.attitude,
            record=self.choice.method,
            carried={name: saves[:, :, columns] for name, columns in self._columns.items()},
            end=end,
            crossings=results.event_times if self.choice.events else None,
            terminal=tuple(x.terminal for x in self.choice.events),
        )

    @cached_property
    def _columns(self) -> dict[str, slice]:
        """The columns in which velocity, position and states are saved."""
        ends = pairwise(accumulate(self.carried.values(), initial=self.attitude.stored))
        return {name: slice(a, b) for name, (a, b) in zip(self.carried, ends, strict=True)}

    def end(self, start: Initial, run: Run, t0: float, done: int) -> End:
        """The end of a run after ``done`` steps, with a copy of its initial values."""
        about = {**self._about, "t0": t0, "done": done, "one_body": start.one_body}
        initial = {"q": start.q.copy(), "y": start.y.copy(), "params": self.packed.params}
        return End(about, {**initial, **run.kept()})

    @cached_property
    def _about(self) -> dict[str, Any]:
        """What the end of a run says of its plan."""
        choice = self.choice
        return {
            "dt": self.clock.h,
            "method": choice.method.name,
            "representation": self.attitude.name,
            "compensated": self.attitude.compensated,
            "normalise": "never" if choice.raw else choice.projection or "output",
            "r0": "r" in self.carried,
            "equations": self.equations,
            "watched": self.watched,
        }

    @cached_property
    def equations(self) -> str:
        """A hash of the operations of a step, the tables that it reads, and when models jump."""
        read = hashlib.sha256(self.program.formulas.digest)
        read.update(repr((self.scene.breakpoints, self.scene.sampling)).encode())
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        read.update(_called(self.program.formulas.resources).encode())
        return read.hexdigest()

    @cached_property
    def watched(self) -> str:
        """A hash of the functions of the events and of what they do; empty without events."""
        if not self.job.events:
            return ""
        formulas = self.program.formulas
        each = [(watch.direction, watch.terminal) for watch in self.job.events]
        spelled = formulas.look.spelled(formulas.resources)
        called = _called(formulas.resources)
        return hashlib.sha256(f"{each}{spelled}{called}".encode()).hexdigest()


def prepared(
    scene: Scene,
    n_bodies: int,
    choice: Choice,
    clock: Clock,
    kind: np.dtype[Any],
    *,
    position: bool = False,
    remake: Callable[[], Plan] | None = None,
    **options: Any,
) -> Plan:
    """The plan of a run, with its program compiled; ``options`` are further fields of ``Plan``."""
    method, attitude = choice.method, choice.attitude
    if scene.sampling is not None and clock.h < 0.0:
        raise ValueError(
            f"dt: found {clock.h} with a sampled controller; accepted: above 0, since what it "
            "holds can't be found backwards"
        )
    position = position or scene.needs_position
    packed = scene.packed(n_bodies, sorted_axes=method.sorted_axes, position=position)
    for event in choice.events:
        packed = packed._replace(tables=packed.tables | event.function.tables)
    lanes = processor().lanes(kind_of(kind))
    groups = np.unique(clock.dt).size
    job = Job(
        method,
        attitude,
        packed.structure,
        kind_of(kind),
        shared=packed.params.ndim == 1,
        alike=_shared_parameters(packed, _user_parameters(scene, packed) if remake else range(0)),
        raw=choice.raw,
        projects=choice.projection > 0,
        events=choice.events,
        windowed=len(corners_of(scene)) > 0 or scene.sampling is not None,
        width=width_for(-(-n_bodies // groups), lanes),
    )
    carried = scene.carried(position=position)
    limit = limits.turn_limit(scene, method, attitude, kind)
    damped = limits.decay(scene, clock.dt)
    compiled = None if method.is_exact else program(job)
    return Plan(
        scene, n_bodies, choice, clock, kind, packed, carried, limit, damped, job, compiled,
        remake=remake, **options,
    )  # fmt: skip


def _user_parameters(scene: Scene, packed: Packed) -> range:
    """Indices of the user-defined function's parameters, which are the last of the rotation."""
    end = packed.structure.turning.n_params
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
    same = (bits == bits[0]).all(axis=0)
    return tuple(k for k in np.flatnonzero(same).tolist() if k not in without)


def _called(resources: Any) -> str:
    """Fingerprints of the functions that a formula calls."""
    return " ".join(x.fingerprint for kind, x in resources if kind == "function")
