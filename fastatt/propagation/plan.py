"""A run of which all that can be done beforehand is done: checked, laid out, compiled."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.attitudes import Attitude
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import kind_of
from fastatt.engine.job import Job
from fastatt.engine.run import Run, Setup, prepare, width_for
from fastatt.engine.status import DIAGNOSTICS
from fastatt.propagation import limits
from fastatt.propagation.closed_form_runs import ClosedForm
from fastatt.propagation.initial import Given, initial
from fastatt.propagation.options import RING, Choice, Clock, Handling, OwnClock
from fastatt.propagation.output import Handed
from fastatt.propagation.plan_inputs import alike, fixed, fixed_with_other_numbers, own_numbers
from fastatt.propagation.resume import End
from fastatt.propagation.save_batches import go, piecewise
from fastatt.propagation.trajectory import Results, Trajectory
from fastatt.scene.scene import Scene

# body-steps: of a longer run the first steps are examined before it
LONG = 1_000_000


class Plan:
    """Runs of one scene, one step and one number of bodies, checked and laid out beforehand.

    Made by :func:`fastatt.plan`. A plan can be pickled and copied, and called by several threads
    at a time.
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
        handling: Handling | None = None,
        asked: tuple[Any, ...] = (),
    ) -> None:
        self.scene, self.n_bodies, self.kind = scene, n_bodies, kind
        self.choice, self.clock, self.handling = choice, clock, handling or Handling()
        self._asked = asked
        method, attitude = choice.method, choice.attitude
        position = position or scene.needs_position
        self.packed = scene.packed(n_bodies, sorted_axes=method.sorted_axes, position=position)
        carried = {"w": scene.kind != "rate", "v": scene.moves, "r": position}
        beside = {name: 3 for name, is_carried in carried.items() if is_carried}
        if choice.reducer is not None:
            self.packed = choice.reducer.watching(self.packed, kind)
            beside["s"] = choice.reducer.columns(kind)
        self.limit = limits.turn_limit(scene, method, attitude, kind)
        self.damped = limits.decay(scene, clock.steps)
        known = limits.known_turns(scene, choice, self.packed)
        lanes = processor().lanes(kind_of(kind))
        self.job = Job(
            method,
            attitude,
            self.packed.structure,
            kind_of(kind),
            shared=self.packed.params.ndim == 1,
            alike=alike(self, asked=bool(asked)),
            known=known is not None,
            raw=choice.raw,
            projects=choice.restore > 0,
            own_steps=isinstance(clock, OwnClock),
            width=n_bodies if choice.device else width_for(n_bodies, lanes),
        )
        if not method.is_exact:
            self._program = (choice.device.program if choice.device else prepare)(self.job)
        self._fixed = fixed(self, known)
        self.span = clock.span(choice.restore)
        self.is_short = n_bodies * clock.n_steps <= LONG
        common = {
            "method": method.name,
            "representation": attitude.name,
            "dt": clock.steps,
            "packed": self.packed,
            "attitude": attitude,
            "record": method,
        }
        self.handed = Handed(n_bodies, kind, attitude.stored, beside, common)
        self._closed = ClosedForm(self, clock.saves) if method.is_exact else None

    def __reduce__(self) -> Any:
        return self._asked

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
        t0: float = 0.0,
        params: Any = None,
    ) -> Trajectory:
        """Run from initial values as ``propagate`` takes them.

        ``params`` are other numbers of the scene's own function, of the shape that its ``params``
        have: nothing is compiled.

        Raises ``ValueError`` or ``TypeError`` as ``propagate`` does; initial values that are not
        finite are refused after the run.
        """
        begin = checks.real("t0", t0)
        given = self.given(q0, w0, v0, r0)
        plan = self if params is None else self._with(params)
        made = plan.run(given, begin, self.handling)
        if self.handling.invalid == "raise" and made.has_flags:
            initial(self.scene, (q0, w0, v0, r0), flag=False)
        return made

    def given(self, q0: Any, w0: Any, v0: Any = None, r0: Any = None) -> Given:
        """Initial states as they were given, checked in all but whether they are finite."""
        start, beside = initial(self.scene, (q0, w0, v0, r0), flag=True)
        found, n = Given.of(start, beside, self.kind), self.n_bodies
        bodies = found.bodies
        if bodies not in (1, n):
            raise ValueError(
                f"q0: found {bodies} bodies; accepted: {n}, as many as the plan is for, or one"
            )
        if n > 1:
            found = found._replace(one_body=False)
        if ("r0" in beside) != ("r" in self.handed.beside):
            raise ValueError("r0: accepted, and needed, in a plan that was made with position=True")
        return found

    def _with(self, params: Any) -> Plan:
        """The plan of other numbers of the scene's own function."""
        was = self.scene.params
        if was is None:
            raise ValueError("params: found, but the scene has none; accepted: of an own function")
        now = checks.array("params", params, f"{np.shape(was)}")
        numbers = self.packed.params.copy()
        numbers[..., own_numbers(self)] = now
        other = object.__new__(Plan)
        other.__dict__.update(self.__dict__)
        other.__dict__.pop("_setup", None)
        other.packed = self.packed._replace(params=numbers)
        other._fixed = fixed_with_other_numbers(other, self._fixed)
        other.handed = replace(self.handed, common={**self.handed.common, "packed": other.packed})
        return other

    def run(self, given: Given, t0: float, handling: Handling) -> Trajectory:
        """The trajectory of initial states that were checked."""
        times = self.times(t0)
        if self._closed is not None:
            return self._closed.run(given, times, handling)
        in_pieces = handling.sink is not None or handling.checkpoint is not None
        saves = self.clock.saves
        if handling.sink is not None:
            saves = min(saves, 1 + RING)
        results = Results.empty(saves, self.n_bodies, self.handed.width, self.kind)
        run = self.started(given, t0, results)
        start = handling.start
        if start is not None:
            run.states[...], run.diagnostics[...] = start.states, start.diagnostics
        warned = not self.is_short and self._warn_of_first(given)
        if in_pieces:
            end = partial(self._end, given, run, t0)
            begin = self.clock.done if start is None else start.done
            made = piecewise(self, run, times, given.one_body, (handling, begin, end))
        else:
            fields = partial(self.handed.fields, times, results, given.one_body)
            at_once = self.is_short and not self.calls
            if at_once and handling.threads == 1 and handling.done is None:
                run.part(self.span, 0, -(-self.n_bodies // self.job.width))
            else:
                go(self, run, self.span, handling, fields)
            made = Trajectory(**fields())
        if handling.ends:
            made = replace(made, end=self._end(given, run, t0, self.clock.end))
        if not warned:
            self._warn_after(run, given)
        return made

    def times(self, t0: float) -> NDArray[np.float64]:
        """Times of the saves, s; warns of times too late to distinguish steps.

        Raises ``ValueError`` where they overflow.
        """
        found = self.clock.times(t0)
        if self._closed is None and self.by_time:
            self.warn_of_times(t0)
        return found

    @property
    def attitude(self) -> Attitude:
        """How the attitude is represented."""
        return self.choice.attitude

    @cached_property
    def _setup(self) -> Setup:
        quiet = limits.quiet_up_to(self.scene, self.choice.method, self.limit)
        bounds = [quiet, *(x.bound(self) for x in DIAGNOSTICS)]
        return Setup(self._program, self.packed.resources, bounds, self._fixed)

    def started(
        self, given: Given, t0: float, results: Results, part: tuple[int, int] | None = None
    ) -> Run:
        """A run of (first body, how many) that writes into the arrays of the whole ensemble."""
        clock, stages = self.clock, self.choice.method.stages
        share = 0.5 * float(stages[-1][1]) if stages else 0.0
        per_body = clock.per_body(self.n_bodies) if isinstance(clock, OwnClock) else None
        edge = share if per_body else share * clock.h
        bodies = part or (0, self.n_bodies)
        return Run(self._setup, bodies, given.rows, (t0, clock.h, edge), results, per_body)

    @cached_property
    def by_time(self) -> bool:
        """Whether the motion or the saves go by the time."""
        return self.job.own_steps or self._program.formulas.is_timed

    @property
    def calls(self) -> bool:
        """Whether steps call a user's function that is not traced: nobody knows for how long."""
        return bool(self._program.formulas.calls)

    def warn_of_times(self, t0: float) -> None:
        """Warn of times too late to tell steps apart."""
        if text := rounding.of_times(self.clock.longest(t0), self.clock.h):
            rounding.warn(text)

    @cached_property
    def silent_range(self) -> tuple[float, float]:
        """Rotation angles of a step, rad, that need no warning."""
        eps = float(np.finfo(self.kind).eps)
        if (self.damped > self.choice.method.damping_limit).any():
            return math.inf, 0.0
        return 0.0 if self.choice.attitude.compensated else eps, min(self.limit, eps**-0.5)

    def _warn_after(self, run: Run, given: Given) -> None:
        """Warn of steps as they were; of an iteration that failed the first tells how large."""
        least, most = self.silent_range
        angle = run.largest_angle
        if not least <= angle <= most and angle and self.clock.n_steps:
            _ = self._warn_of_first(given) or self.warn(np.sqrt(run.diagnostics[0]), self.damped)

    def _end(self, given: Given, run: Run, t0: float, done: int) -> End:
        """The end of a run, which keeps its memory and a copy of what was given."""
        kept = given._replace(q=given.q.copy(), y=given.y.copy())
        return End(
            kept, run.states, run.diagnostics, done, t0, self.about, self.packed.params,
            self.equations,
        )  # fmt: skip

    @cached_property
    def about(self) -> dict[str, Any]:
        """What must be the same in a run that goes on, by the names of arguments."""
        choice = self.choice
        return {
            "dt": float(self.clock.h).hex(),
            "method": choice.method.name,
            "representation": choice.attitude.name,
            "compensated": choice.attitude.compensated,
            "normalise": "never" if choice.raw else choice.restore,
            "dtype": self.kind.name,
            "r0": "r" in self.handed.beside,
            "reduce": 0 if choice.reducer is None else choice.reducer.start.shape[-1],
        }

    @cached_property
    def equations(self) -> str:
        """A hash of what a step computes and of the tables that it reads."""
        read = hashlib.sha256(self._program.formulas.digest)
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        return read.hexdigest()

    def fill(
        self, given: Given, t0: float, handling: Handling, results: Results, part: tuple[int, int]
    ) -> NDArray[Any]:
        """Run (first body, how many); the largest rotation angle of a step of each, rad."""
        run = self.started(given, t0, results, part)
        go(self, run, self.span, handling)
        return np.asarray(np.sqrt(run.diagnostics[0]))

    def _warn_of_first(self, given: Given) -> bool:
        """Warn of a body's first step."""
        return self.warn(self.first_turns(given), self.damped)

    def first_turns(self, given: Given) -> NDArray[np.float64]:
        """What each body turns in its first step, rad; of rates that are given nothing is said."""
        if self.scene.kind == "rate":
            return np.zeros(1)
        w = np.atleast_2d(given.y)[:, :3]
        return limits.first_step(self.scene, self.choice.method, w, self.clock.steps)

    def warn(self, turns: NDArray[Any], damped: NDArray[np.float64], steps: Any = None) -> bool:
        """Warn of steps by what bodies turn in one, rad, and by what damping takes."""
        choice = self.choice
        return limits.warn(
            turns,
            damped,
            self.limit,
            choice.method,
            self.clock.steps if steps is None else steps,
            self.kind,
            compensated=choice.attitude.compensated,
        )
