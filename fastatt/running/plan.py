"""A run of which all that can be done beforehand is done: checked, laid out, compiled."""

from __future__ import annotations

import hashlib
import math
import threading
from dataclasses import replace
from functools import cached_property, partial, partialmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.engine.ensemble import Run, prepare
from fastatt.engine.job import Job
from fastatt.engine.tiles import width_for
from fastatt.flat.rows import kind_of
from fastatt.running import limits
from fastatt.running.asked import RING, Choice, Clock, Handling, OwnClock
from fastatt.running.closed import ClosedForm
from fastatt.running.fixed import alike, fixed, flags_of, own_numbers
from fastatt.running.handed import Handed
from fastatt.running.initial import Given, initial
from fastatt.running.pieces import go, piecewise
from fastatt.running.resume import End
from fastatt.running.trajectory import Results, Trajectory
from fastatt.scene import Scene

# body-steps: of a longer run the first steps are looked at before it, and Ctrl-C is answered in it
LONG = 1_000_000
_ARRAY = np.ndarray


def _apart(x: Any, memory: NDArray[np.uint8]) -> Any:
    """Initial values, a copy of those that a run writes over."""
    return np.array(x) if type(x) is _ARRAY and np.may_share_memory(x, memory) else x


def _rows(n: int, *, has_w: bool) -> dict[Any, tuple[int, int, bool]]:
    """(rows of q0, rows of w0, whether it is one body) by the shapes of both."""
    w = {(3,): 1, (n, 3): n} if has_w else {(1, 0): 1}
    return {
        (a, b): (rows_a, rows_b, n == 1 and b != (n, 3) and a != (n, 4))
        for a, rows_a in {(4,): 1, (n, 4): n}.items()
        for b, rows_b in w.items()
    }


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
        position = position or scene.couples
        self.packed = scene.packed(n_bodies, sorted_axes=method.sorted_axes, position=position)
        there = {"w": scene.kind != "rate", "v": scene.moves, "r": position}
        beside = {name: 3 for name, is_there in there.items() if is_there}
        self._rows = {} if scene.moves else _rows(n_bodies, has_w=there["w"])
        if choice.reducer is not None:
            self.packed = choice.reducer.watching(self.packed)
            beside["s"] = choice.reducer.start.shape[-1]
            self._rows = {}
        self.limit = limits.turn_limit(scene, method, attitude.name, kind)
        self.damped = limits.decay(scene, clock.steps)
        known = limits.known_turns(scene, choice, self.packed)
        self.job = Job(
            method,
            attitude,
            self.packed.structure,
            kind_of(kind),
            shared=self.packed.params.ndim == 1,
            alike=alike(self, asked=bool(asked)),
            known=known is not None,
            raw=choice.raw,
            mends=choice.restore > 0,
            looks=choice.looks,
            own_steps=isinstance(clock, OwnClock),
            width=n_bodies if choice.device else width_for(n_bodies, kind_of(kind)),
        )
        if not method.is_exact:
            self._program = (choice.device.program if choice.device else prepare)(self.job)
        self._fixed = fixed(self, known, clock.steps)
        self.span = clock.span(choice.restore)
        self.is_short = n_bodies * clock.n_steps <= LONG
        told = {
            "method": method.name,
            "representation": attitude.name,
            "dt": clock.steps,
            "packed": self.packed,
            "attitude": attitude,
            "record": method,
            "check": None,
        }
        self.handed = Handed(n_bodies, kind, attitude.stored, beside, told)
        self._nothing = np.zeros((1, 0), kind)
        self._saves = clock.saves
        self._offsets = self.handed.layout(self._saves)
        self._closed = ClosedForm(self, self._saves) if method.is_exact else None
        own = self.handling
        alone = own.threads == 1 and own.done is None and own.sink is None
        self._is_quick = self.is_short and alone and not method.is_exact
        self._tiles = -(-n_bodies // self.job.width)
        self._length = clock.end * clock.h
        eps = float(np.finfo(kind).eps)
        #: turns of a step, rad, of which there is nothing to say
        self.calm = (0.0 if attitude.compensated else eps, min(self.limit, eps**-0.5))
        if (self.damped > method.damping_limit).any():
            self.calm = (math.inf, 0.0)
        self._local = threading.local()

    def __reduce__(self) -> Any:
        if not self._asked:
            raise TypeError("plan: this one is propagate's own; accepted: one of fastatt.plan")
        return self._asked

    def __deepcopy__(self, memo: Any) -> Plan:
        return self  # nothing of it changes

    __copy__ = partialmethod(__deepcopy__, None)

    def _prepared(self) -> Run:
        """A run with memory of its own."""
        n, fixed, choice = self.n_bodies, self._fixed, self.choice
        run = Run(self._program, self.packed.resources, n)
        run.put(**fixed)
        stages = fixed["stages"]
        share = 0.5 * float(stages[-1, 1]) if len(stages) else 0.0
        edge = share * self.clock.h
        if isinstance(self.clock, OwnClock):
            run.put(**self.clock.stops)
            run.set(rows_own=self.clock.steps.size)
            edge = share
        rows = {f"rows_{name}": len(fixed[name]) for name in ("p", "known", "flags")}
        run.set(
            stage_count=len(stages),
            stride=n,
            **rows,
            **self.span.__dict__,
            h=self.clock.h,
            edge=edge,
            quiet=limits.quiet_up_to(self.scene, choice.method, self.limit),
            limit=self.limit,
            norm=math.inf if choice.attitude.restore is None else limits.NORM_BOUND[self.kind],
            invariant=limits.INVARIANT_BOUND,
        )
        return run

    def _own_run(self) -> Run:
        """The same of this thread, for any number of short runs."""
        found: Run | None = getattr(self._local, "run", None)
        if found is None:
            found = self._local.run = self._prepared()
        return found

    def __call__(
        self,
        q0: Any,
        w0: Any = None,
        *,
        v0: Any = None,
        r0: Any = None,
        t0: float = 0.0,
        params: Any = None,
        out: Trajectory | None = None,
    ) -> Trajectory:
        """Run from initial values as ``propagate`` takes them.

        ``params`` are other numbers of the scene's own function, of the shape that its ``params``
        have: nothing is compiled. ``out`` is an earlier trajectory of the plan, whose arrays are
        written over: nothing is allocated for them.

        Raises ``ValueError`` or ``TypeError`` as ``propagate`` does; initial values that are not
        finite are refused after the run.
        """
        begin = checks.real("t0", t0)
        raw = None
        if out is not None:
            raw = self._over(out)
            q0, w0, v0, r0 = (_apart(x, raw) for x in (q0, w0, v0, r0))
        given = self.given(q0, w0, v0, r0)
        if params is not None:
            made = self._with(params).run(given, begin, self.handling, raw)
        elif self._is_quick:
            made = self._quickly(given, begin, raw)
        else:
            made = self.run(given, begin, self.handling, raw)
        if made.__dict__["_flagged"] and self.handling.invalid == "raise":
            initial(self.scene, (q0, w0, v0, r0), flag=False)
        return made

    def given(self, q0: Any, w0: Any, v0: Any = None, r0: Any = None) -> Given:
        """Initial states as they were given, checked in all but whether they are finite."""
        y, kind = self._nothing if w0 is None else w0, self.kind
        usual = type(q0) is type(y) is _ARRAY and q0.dtype is y.dtype is kind
        if usual and v0 is None and r0 is None:
            rows = self._rows.get((q0.shape, y.shape))
            if rows and q0.flags.c_contiguous and y.flags.c_contiguous:
                return tuple.__new__(Given, (q0, y, *rows))  # without names: a third
        start, beside = initial(self.scene, (q0, w0, v0, r0), flag=True)
        found, n = Given.of(start, beside, kind), self.n_bodies
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
        other.__dict__.update(self.__dict__, _local=threading.local())
        other.packed = self.packed._replace(params=numbers)
        rows = np.ascontiguousarray(np.atleast_2d(numbers))
        other._fixed = {**self._fixed, "p": rows, "flags": flags_of(other, rows)}
        told = {**self.handed.told, "packed": other.packed}
        other.handed = replace(self.handed, told=told)
        return other

    def _over(self, out: Trajectory) -> NDArray[np.uint8]:
        """The memory of an earlier trajectory."""
        if getattr(out, "record", None) is self.choice.method and isinstance(out, Trajectory):
            raw = out.raw
            if raw is not None and raw.size == self.handed.layout(self._saves)[-1]:
                return raw
        raise ValueError(
            f"out: found {checks.brief(out)}; accepted: an earlier trajectory of this plan"
        )

    def run(
        self,
        given: Given,
        t0: float,
        handling: Handling,
        raw: NDArray[np.uint8] | None = None,
    ) -> Trajectory:
        """The trajectory of initial states that were looked at; ``raw`` is memory to write to."""
        if self._closed is not None:
            return self._closed.run(given, t0, handling, raw)
        in_pieces = handling.sink is not None or handling.checkpoint is not None
        saves = self._saves if handling.sink is None else min(self._saves, 1 + RING)
        raw = self.memory(saves) if raw is None else raw
        run = self._prepared() if in_pieces else self._own_run()
        if run.is_kept:
            run.renew()
        run.is_kept = handling.ends
        self._load(run, given, t0, raw, saves)
        start = handling.start
        if start is not None:
            run.x[...], run.watch[...] = start.x, start.watch
        warned = not self.is_short and self._warn_of_first(given)
        if in_pieces:
            end = partial(self._end, given, run, t0)
            begin = self.clock.done if start is None else start.done
            results = self.handed.views(raw, saves)
            made = piecewise(self, run, t0, results, given.one_body, (handling, begin, end))
        else:
            if self.is_short and handling.threads == 1 and handling.done is None:
                run(self._tiles)
            else:
                go(self, run, self.span, handling, partial(self._found, raw, t0, given.one_body))
            made = self.promised(raw, run.told[1] > 0.0, t0, given.one_body)
        if handling.ends:
            made.__dict__["end"] = self._end(given, run, t0, self.clock.end)
        if not warned:
            self._warn_after(run, given)
        return made

    def _quickly(self, given: Given, t0: float, raw: NDArray[np.uint8] | None) -> Trajectory:
        """The same of a few steps in this thread, with memory that is there."""
        if raw is None:
            raw = np.empty(self._offsets[2], np.uint8)
        try:
            run: Run = self._local.run
        except AttributeError:
            run = self._own_run()
        told, (least, most) = run.told, self.calm
        if run.is_timed or run.is_plain or not -math.inf < t0 + self._length < math.inf:
            self._load(run, given, t0, raw, self._saves)
        else:
            run.load(given, raw, self._offsets, t0)
        run(self._tiles)
        if not least <= told[0] <= most:
            self._warn_after(run, given)
        return self.promised(raw, told[1] > 0.0, t0, given[4])

    def _load(self, run: Run, given: Given, t0: float, raw: NDArray[np.uint8], saves: int) -> None:
        """Tell a run what it works on, and where its saves go."""
        if not -math.inf < t0 + self._length < math.inf:
            self.clock.times(t0)  # which refuses it
        offsets = self._offsets if saves == self._saves else self.handed.layout(saves)
        run.load(given, raw, offsets, t0)
        if run.is_plain:
            run.put(q0=given.q, y0=given.y, **self.handed.views(raw, saves)._asdict())
        if self.by_time:
            self.warn_of_times(t0)

    @cached_property
    def by_time(self) -> bool:
        """Whether the motion or the saves go by the time."""
        return self.job.own_steps or self._program.formulas.is_timed

    def warn_of_times(self, t0: float) -> None:
        """Warn of times too late to tell steps apart."""
        if text := rounding.of_times(self.clock.longest(t0), self.clock.h):
            rounding.warn(text)

    def memory(self, saves: int) -> NDArray[np.uint8]:
        """Memory that a run writes to."""
        return np.empty(self.handed.layout(saves)[2], np.uint8)

    def promised(
        self, raw: NDArray[np.uint8], flagged: bool, t0: float, one_body: bool
    ) -> Trajectory:
        """A trajectory whose fields are found when they are asked for.

        To find them takes longer than a run of a few steps.
        """
        made = object.__new__(Trajectory)
        fields = made.__dict__
        fields["raw"], fields["_flagged"], fields["one_body"] = raw, flagged, one_body
        fields["_later"] = (self._found, raw, t0, one_body)
        return made

    def _warn_after(self, run: Run, given: Given) -> None:
        """Warn of steps as they were; of an iteration that failed the first tells how large."""
        least, limit = self.calm
        noted = not least <= run.told[0] <= limit and run.told[0] and self.clock.n_steps
        if noted and not self._warn_of_first(given):
            self.warn(np.sqrt(run.watch[0]), self.damped)

    def _end(self, given: Given, run: Run, t0: float, done: int) -> End:
        """The end of a run, which keeps its memory and a copy of what was given."""
        kept = given._replace(q=given.q.copy(), y=given.y.copy())
        return End(kept, run.x, run.watch, done, t0, self.about, self.packed.params, self)

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
            "reduce": self.handed.beside.get("s", 0),
        }

    @cached_property
    def equations(self) -> str:
        """A hash of what a step computes and of the tables that it reads."""
        read = hashlib.sha256(repr(self._program.formulas.quick.plain.nodes).encode())
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        return read.hexdigest()

    def fill(self, given: Given, t0: float, handling: Handling, results: Results) -> NDArray[Any]:
        """Run into arrays of more bodies; the turns of each body's steps, rad, for a warning."""
        run, stride = self._own_run(), results.defect.strides[0] // results.defect.itemsize
        run.put(q0=given.q, y0=given.y, **results._asdict())
        run.set(rows_q=given.rows_q, rows_y=given.rows_y, stride=stride, t0=t0)
        go(self, run, self.span, handling, partial(self._fields, t0, results))
        return np.asarray(np.sqrt(run.watch[0]))

    def _fields(self, t0: float, results: Results, one_body: bool = False) -> dict[str, Any]:
        return self.handed.fields(self.clock.times(t0), results, one_body)

    def _found(self, raw: Any, t0: float, one_body: bool, name: str = "") -> dict[str, Any]:
        """The fields of a trajectory, or those that are found along with one of them."""
        handed, saves = self.handed, self._saves
        some = handed.some(name, raw, saves)
        return some or self._fields(t0, handed.views(raw, saves), one_body)

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
