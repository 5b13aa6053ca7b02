"""A run of which all that can be done beforehand is done: checked, laid out, compiled."""

from __future__ import annotations

import hashlib
import math
import threading
from dataclasses import dataclass
from functools import cached_property, partial, partialmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks, rounding
from fastatt.engine.ensemble import Run, prepare
from fastatt.engine.job import Job
from fastatt.engine.tiles import width_for
from fastatt.motion import carried
from fastatt.running import limits
from fastatt.running.asked import KINDS, RING, Choice, Clock, Handling, OwnClock
from fastatt.running.closed import ClosedForm
from fastatt.running.fixed import alike, fixed, flags_of, own_numbers
from fastatt.running.handed import Handed
from fastatt.running.initial import Given, initial
from fastatt.running.pieces import go, piecewise
from fastatt.running.resume import End, about
from fastatt.running.trajectory import Results, Trajectory
from fastatt.scene import Scene

# body-steps: of a longer run the first steps are looked at before it, and Ctrl-C is answered in it
LONG = 1_000_000
_ARRAY = np.ndarray
_NOTHING = np.zeros((1, 0))


def _apart(x: Any, memory: NDArray[np.uint8]) -> Any:
    """Initial values, a copy of those that a run writes over."""
    return np.array(x) if type(x) is _ARRAY and np.may_share_memory(x, memory) else x


@dataclass(eq=False)
class _Bench:
    """A run of the engine with the memory that it works in; a trajectory's end may keep that."""

    run: Run
    x: NDArray[Any]
    watch: NDArray[Any]
    is_kept: bool = False

    def renew(self) -> None:
        """Other memory in its place."""
        self.x, self.watch = np.empty_like(self.x), np.empty_like(self.watch)
        self.run.put(x=self.x, watch=self.watch)


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
        rows_each: int = 1,
        handling: Handling | None = None,
        asked: tuple[Any, ...] = (),
    ) -> None:
        self.scene, self.n_bodies, self.kind = scene, n_bodies, kind
        self.choice, self.clock, self.handling = choice, clock, handling or Handling()
        self._asked = asked
        method, attitude = choice.method, choice.attitude
        bodies, position = n_bodies // rows_each, position or scene.couples
        self.packed = scene.packed(bodies, sorted_axes=method.sorted_axes, position=position)
        if choice.reducer is not None:
            self.packed = choice.reducer.watching(self.packed)
        body = ["w"] if scene.kind != "rate" else []
        self.beside = [*body, *(["v"] if scene.moves else []), *(["r"] if position else [])]
        widths = [3] * len(self.beside)
        if choice.reducer is not None:
            self.beside.append("s")
            widths.append(choice.reducer.start.shape[-1])
        self._is_plain_body = self.beside == ["w"]
        self._usual = ((n_bodies, 4), (n_bodies, 3)) if self._is_plain_body else None
        self.limit = limits.turn_limit(scene, method, attitude.name, kind)
        self._h = clock.steps if isinstance(clock, OwnClock) else clock.h
        self.damped = limits.decay(scene, self._h)
        known = limits.known_turns(scene, choice, self.packed)
        self.job = Job(
            method,
            attitude,
            self.packed.structure,
            KINDS[kind],
            shared=self.packed.params.ndim == 1,
            alike=alike(self, asked=bool(asked)),
            known=known is not None,
            raw=choice.raw,
            mends=choice.restore > 0,
            looks=choice.looks,
            own_steps=isinstance(clock, OwnClock),
            width=n_bodies if choice.device else width_for(n_bodies, KINDS[kind]),
        )
        if not method.is_exact:
            self._program = (choice.device.program if choice.device else prepare)(self.job)
        self._fixed = fixed(self, known, self._h, rows_each)
        self.span = clock.span(choice.restore)
        self.is_short = n_bodies * clock.n_steps <= LONG
        self._shapes = tuple(((k,), (n_bodies, k)) for k in (4, 3))
        told = {
            "method": method.name,
            "representation": attitude.name,
            "dt": self._h,
            "packed": self.packed,
            "attitude": attitude,
            "record": method,
            "check": None,
        }
        self.handed = Handed(n_bodies, kind, attitude.stored, (self.beside, widths), told)
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

    def _bench(self) -> _Bench:
        """A run with memory of its own."""
        n, fixed, choice = self.n_bodies, self._fixed, self.choice
        size = carried(choice.attitude, self.packed.structure)
        x, watch = np.empty((n, size), dtype=self.kind), np.empty((3, n), dtype=self.kind)
        run = Run(self._program, self.packed.resources)
        run.put(**fixed, x=x, watch=watch)
        stages = fixed["stages"]
        share = 0.5 * float(stages[-1, 1]) if len(stages) else 0.0
        edge = share * self.clock.h
        if isinstance(self.clock, OwnClock):
            run.put(**self.clock.stops)
            run.set(rows_own=self.clock.steps.size)
            edge = share
        rows = {f"rows_{name}": len(fixed[name]) for name in ("p", "known", "flags")}
        run.set(
            bodies=n,
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
        return _Bench(run, x, watch)

    def _own_bench(self) -> _Bench:
        """The same of this thread, for any number of short runs."""
        found: _Bench | None = getattr(self._local, "bench", None)
        if found is None:
            found = self._local.bench = self._bench()
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
        begin = t0 if type(t0) is float else checks.real("t0", t0)
        raw = None
        if out is not None:
            raw = self._over(out)
            q0, w0, v0, r0 = (_apart(x, raw) for x in (q0, w0, v0, r0))
        given = self.given(q0, w0, v0, r0)
        if params is None and self._is_quick:
            made = self._quickly(given, begin, raw)
            flagged = made.__dict__["_flagged"]
        else:
            made = (self if params is None else self._with(params)).run(given, begin, raw=raw)
            flagged = made.has_flags
        if flagged and self.handling.invalid == "raise":
            initial(self.scene, (q0, w0, v0, r0), flag=False)
        return made

    def given(self, q0: Any, w0: Any, v0: Any = None, r0: Any = None) -> Given:
        """Initial states as they were given, checked in all but whether they are finite."""
        n, kind = self.n_bodies, self.kind
        if type(q0) is type(w0) is np.ndarray and q0.dtype is w0.dtype is kind:
            shaped = (q0.shape, w0.shape) == self._usual and v0 is None and r0 is None
            if shaped and q0.flags.c_contiguous and w0.flags.c_contiguous:
                return tuple.__new__(Given, (q0, w0, n, n, False))  # without names: a third
        if self._fits(q0, self._shapes[0]) and v0 is r0 is None:
            rows = 1 if q0.ndim == 1 else n
            one = n == 1 == q0.ndim
            if self._is_plain_body and self._fits(w0, self._shapes[1]):
                rows_w = 1 if w0.ndim == 1 else n
                return tuple.__new__(Given, (q0, w0, rows, rows_w, one and w0.ndim == 1))
            if w0 is None and not self.beside:
                return tuple.__new__(Given, (q0, _NOTHING, rows, 1, one))
        start, beside = initial(self.scene, (q0, w0, v0, r0), flag=True)
        found = Given.of(start, beside, kind)
        rows = max(found.rows_q, found.rows_y)
        if rows not in (1, n):
            raise ValueError(
                f"q0: found {rows} bodies; accepted: {n}, as many as the plan is for, or one"
            )
        if n > 1:
            found = found._replace(one_body=False)
        if ("r0" in beside) != ("r" in self.beside):
            raise ValueError("r0: accepted, and needed, in a plan that was made with position=True")
        return found

    def _fits(self, x: Any, shapes: tuple[tuple[int, ...], ...]) -> bool:
        """Whether an array can be used as it is."""
        return (
            type(x) is _ARRAY
            and x.dtype is self.kind
            and x.shape in shapes
            and x.flags.c_contiguous
        )

    def _with(self, params: Any) -> Plan:
        """The plan of other numbers of the scene's own function."""
        was = self.scene.params
        if was is None:
            raise ValueError("params: found, but the scene has none; accepted: of an own function")
        now = checks.array("params", params, f"{np.shape(was)}", [np.shape(was)])
        numbers = self.packed.params.copy()
        numbers[..., own_numbers(self)] = now
        other = object.__new__(Plan)
        other.__dict__.update(self.__dict__, _local=threading.local())
        other.packed = self.packed._replace(params=numbers)
        rows = np.ascontiguousarray(np.atleast_2d(numbers))
        other._fixed = {**self._fixed, "p": rows, "flags": flags_of(other, rows)}
        other.handed = self.handed.with_packed(other.packed)
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
        t0: float = 0.0,
        *,
        handling: Handling | None = None,
        raw: NDArray[np.uint8] | None = None,
        ends: bool = False,
        start: End | None = None,
    ) -> Trajectory:
        """The trajectory of initial states that were looked at.

        ``raw`` is memory to write to, ``ends`` says that the trajectory holds its end, ``start``
        where the run goes on.
        """
        if handling is None and self._is_quick and not ends and start is None:
            return self._quickly(given, t0, raw)
        handling = handling or self.handling
        self._refuse_overflow(t0)
        if self._closed is not None:
            return self._closed.run(given, t0, handling, raw)
        in_pieces = handling.sink is not None or handling.checkpoint is not None
        saves = self._saves if handling.sink is None else min(self._saves, 1 + RING)
        raw = self.memory(saves) if raw is None else raw
        bench = self._bench() if in_pieces else self._own_bench()
        run = bench.run
        if bench.is_kept:
            bench.renew()
        bench.is_kept = ends
        self._load(run, given, t0, (raw, saves))
        if start is not None:
            bench.x[...], bench.watch[...] = start.x, start.watch
        warned = not self.is_short and self._warn_of_first(given)
        if in_pieces:
            end = partial(self._end, given, bench, t0)
            begin = self.clock.done if start is None else start.done
            results = self.handed.views(raw, saves)
            made = piecewise(self, run, t0, results, given.one_body, (handling, begin, end))
        else:
            if self.is_short and handling.threads == 1 and handling.done is None:
                run(self._tiles)
            else:
                go(self, run, self.span, handling, partial(self._found, raw, t0, given.one_body))
            made = self.promised(raw, run.told[1] > 0.0, t0, given.one_body)
        if ends:
            made.__dict__["end"] = self._end(given, bench, t0, self.clock.end)
        if not warned:
            self._warn_after(run, given, bench.watch)
        return made

    def _refuse_overflow(self, t0: float) -> None:
        if not -math.inf < t0 + self._length < math.inf:
            checks.real("t0", t0)
            self.clock.times(t0)

    def _load(self, run: Run, given: Given, t0: float, memory: tuple[Any, int]) -> None:
        """Tell a run what it works on; memory is told with its number of saves."""
        raw, saves = memory
        offsets = self._offsets if saves == self._saves else self.handed.layout(saves)
        run.load(given, raw, offsets, t0)
        if run.is_plain:
            run.put(q0=given.q, y0=given.y, **self.handed.views(raw, saves)._asdict())
        self.warn_of_times(t0)

    def warn_of_times(self, t0: float) -> None:
        """Warn of times too late to tell steps apart, where the motion or the saves go by them."""
        by_time = self.job.own_steps or self.job.formulas.is_timed
        if by_time and self.clock.is_rounded(t0):
            rounding.warn(rounding.of_times(self.clock.longest(t0), self.clock.h))

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
        fields["raw"], fields["_flagged"] = raw, flagged
        fields["_later"] = (self._found, raw, t0, one_body)
        return made

    def _quickly(self, given: Given, t0: float, raw: NDArray[np.uint8] | None) -> Trajectory:
        """The same of a few steps in this thread, with memory that is there."""
        if not -math.inf < t0 + self._length < math.inf:
            self._refuse_overflow(t0)
        offsets, local = self._offsets, self._local
        if raw is None:
            raw = np.empty(offsets[2], np.uint8)
        bench: _Bench = local.bench if hasattr(local, "bench") else self._own_bench()
        run = bench.run
        if run.is_timed or run.is_plain:
            self._load(run, given, t0, (raw, self._saves))
        else:
            run.load(given, raw, offsets, t0)
        run(self._tiles)
        told = run.told
        if not self.calm[0] <= told[0] <= self.calm[1]:
            self._warn_after(run, given, bench.watch)
        return self.promised(raw, told[1] > 0.0, t0, given[4])

    def _warn_after(self, run: Run, given: Given, watch: NDArray[Any]) -> None:
        """Warn of steps as they were; of an iteration that failed the first tells how large."""
        least, limit = self.calm
        noted = not least <= run.told[0] <= limit and run.told[0] and self.clock.n_steps
        if noted and not self._warn_of_first(given):
            self.warn(np.sqrt(watch[0]), self.damped)

    def _end(self, given: Given, bench: _Bench, t0: float, done: int) -> End:
        """The end of a run, which keeps the bench's memory and a copy of what was given."""
        kept = given._replace(q=given.q.copy(), y=given.y.copy())
        return End(kept, bench.x, bench.watch, done, t0, self.about, self.packed.params, self)

    @cached_property
    def about(self) -> dict[str, Any]:
        """What must be the same in a run that goes on."""
        return about(self.choice, self.clock.h, self.kind, "r" in self.beside)

    @cached_property
    def equations(self) -> str:
        """A hash of what a step computes and of the tables that it reads."""
        read = hashlib.sha256(repr(self.job.formulas.quick.plain.nodes).encode())
        for table in self.packed.tables.values():
            read.update(table.tobytes())
        return read.hexdigest()

    def fill(self, given: Given, t0: float, handling: Handling, results: Results) -> NDArray[Any]:
        """Run into arrays of more bodies; the turns of each body's steps, rad, for a warning."""
        bench = self._own_bench()
        run, stride = bench.run, results.defect.strides[0] // results.defect.itemsize
        run.put(q0=given.q, y0=given.y, **results._asdict())
        run.set(rows_q=given.rows_q, rows_y=given.rows_y, stride=stride, t0=t0)
        go(self, run, self.span, handling, partial(self._fields, t0, results))
        return np.asarray(np.sqrt(bench.watch[0]))

    def _fields(self, t0: float, results: Results, one_body: bool = False) -> dict[str, Any]:
        return self.handed.fields(self.clock.times(t0), results, one_body)

    def _found(self, raw: NDArray[np.uint8], t0: float, one_body: bool) -> dict[str, Any]:
        """The fields of a trajectory."""
        return self._fields(t0, self.handed.views(raw, self._saves), one_body)

    def _warn_of_first(self, given: Given) -> bool:
        """Warn of a body's first step."""
        return self.warn(self.first_turns(given), self.damped)

    def first_turns(self, given: Given) -> NDArray[np.float64]:
        """What each body turns in its first step, rad; of rates that are given nothing is said."""
        if self.scene.kind == "rate":
            return np.zeros(1)
        w = np.atleast_2d(given.y)[:, :3]
        return limits.first_step(self.scene, self.choice.method, w, self._h)

    def warn(self, turns: NDArray[Any], damped: NDArray[np.float64], steps: Any = None) -> bool:
        """Warn of steps by what bodies turn in one, rad, and by what damping takes."""
        choice = self.choice
        return limits.warn(
            turns,
            damped,
            self.limit,
            choice.method,
            self._h if steps is None else steps,
            self.kind,
            compensated=choice.attitude.compensated,
        )
