"""A job for the engine: a method, a representation, what acts, and the formulas of it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from fastatt.attitudes import Attitude
from fastatt.codegen.memory import DTYPES
from fastatt.engine import double_states
from fastatt.engine.events import Watch, after_step, values
from fastatt.engine.loop import WIDTH
from fastatt.engine.status import SAVED, relative_change
from fastatt.methods.method import Method
from fastatt.scene.coupled import Coupled
from fastatt.scene.equations import (
    Body,
    EquationsOfMotion,
    PrescribedRate,
    RigidBody,
    Structure,
    carried,
    motion_of,
)
from fastatt.scene.rates import is_constant
from fastatt.tracing.finished import Constants, Flat, Forms, resources_of
from fastatt.tracing.formulas import Vector, dot, quat, scale
from fastatt.tracing.graph import Double, Graph, Number, both, choose

# |m|² below which products of rates lose digits
_LOST = {"double": 1e-305, "single": 1e-36}


@dataclass(frozen=True)
class Job:
    """All that the formulas of a run depend on, none of its numbers.

    ``kind`` is the precision of the state, "double" or "single"; ``shared`` says that all bodies
    have the same parameters, ``alike`` numbers those that they have in common if not all, ``known``
    says that rotation angles are known beforehand, so that those of some bodies are not monitored;
    ``raw`` that the output is not projected onto its group, ``projects`` that the state is, now and
    then.
    """

    method: Method
    attitude: Attitude
    structure: Structure
    kind: str = "double"
    shared: bool = True
    alike: tuple[int, ...] = ()
    known: bool = False
    raw: bool = False
    projects: bool = False
    #: step size and time are numbers of a tile's lanes: per-body ones, or those of a shorter step
    own_steps: bool = False
    #: what is watched at the end of each step
    events: tuple[Watch, ...] = ()
    #: whether it takes the shorter steps by which events are located
    is_searched: bool = False
    #: rates, torques and forces are evaluated between two breakpoints, which lanes know
    windowed: bool = False
    #: bodies side by side in a tile: narrower of few, which is faster and gives the same bits
    width: int = WIDTH

    @cached_property
    def formulas(self) -> Formulas:
        """Its formulas, traced when they are asked for; a tile's width is no matter of theirs."""
        own = self.own_steps and not self.events
        return _formulas(replace(self, width=WIDTH, own_steps=own, is_searched=False))

    @property
    def has_any_angle_form(self) -> bool:
        """Whether a block has another form, for lanes that the small-angle one does not do for."""
        return self.known or self.method.exponentials > 0

    @property
    def bounds(self) -> bool:
        """Whether rotation angles are known from a body's own initial state."""
        return self.known and not isinstance(self.structure.turning, PrescribedRate)

    @property
    def monitored(self) -> bool:
        """Whether the rotation angles of steps are monitored in the small-angle form."""
        return not self.known


class Formulas:
    """The graphs of a job, each traced when it is asked for.

    Inputs are named ("x", i) for the state that is stepped, ("p", i) parameters, ("e", i) what the
    method prepared, ("c", i) constants of a body, ("invariants", i), ("y", i) initial values, and
    ("t",), ("h",), ("k",), ("edge",) and ("since",).
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.size = carried(job.attitude, job.structure)
        self.parameters = job.structure.n_params
        self.coordinates = job.attitude.coordinates
        self.given = self.coordinates + job.structure.tail
        self.handed_out = job.attitude.stored + job.structure.tail

    def scope(self, *, small_angle: bool = False) -> Scope:
        """Numbers and the motion that a formula works on."""
        job = self.job
        attitude = job.attitude.short if small_angle and job.method.exponentials else job.attitude
        return Scope(self, attitude, Graph())

    def _form(self, small_angle: bool) -> Forms:
        scope = self.scope(small_angle=small_angle)
        times = scope.time(), scope.number("h"), scope.number("k")
        x, z = scope.step(*times, scope.state(), scope.extras())
        flat = scope.finished((*x, z))
        if small_angle and not self.job.monitored:
            flat = flat.first(len(x))
        if not self.job.shared:
            flat = self._constants.without(flat, more=small_angle)
        return Forms(flat.in_few_registers(), len(x))

    @cached_property
    def _constants(self) -> Constants:
        return Constants("p", "c", self.job.alike)

    @cached_property
    def constants(self) -> Flat:
        """What steps need of a body's own parameters and nothing else, computed once."""
        _ = self.small_angle  # which finds them
        return self._constants.flat

    @cached_property
    def constant_kinds(self) -> list[str]:
        """Precision of each of the constants."""
        flat = self.constants
        return [flat.nodes[i].kind for i in flat.results]

    @cached_property
    def small_angle(self) -> Forms:
        """A step or a stage, for rotation angles of at most π."""
        return self._form(True)

    @cached_property
    def _any_angle(self) -> Forms:
        return self._form(False)

    @property
    def any_angle(self) -> Forms | None:
        """The same for any rotation angle, where that is another form."""
        return self._any_angle if self.job.has_any_angle_form else None

    @cached_property
    def begin(self) -> Flat:
        """From initial values: the state that is stepped, what is prepared, the invariants."""
        scope = self.scope()
        y = scope.inputs("y", self.given)
        x = scope.begin(y[: self.coordinates], y[self.coordinates :])
        t, h = scope.time(), scope.number("h")
        e = scope.prepared(h, x)
        stepped = scope.entered(t, scope.number("edge"), x, e)
        bound = (scope.bound(h, x),) if self.job.bounds else ()
        return scope.finished((*stepped, *e, *scope.monitored(h, x), *bound))

    @cached_property
    def extras(self) -> int:
        """How many numbers a method prepares for a body."""
        scope = self.scope()
        return len(scope.prepared(scope.number("h"), scope.inputs("x", self.size)))

    @cached_property
    def invariants(self) -> int:
        """How many numbers the motion keeps."""
        scope = self.scope()
        return len(scope.invariants(scope.inputs("x", self.size)))

    @cached_property
    def save(self) -> Flat:
        """What a trajectory holds, and the measures of ``engine.status``, the norm error first."""
        scope = self.scope()
        t, since = scope.time(), scope.number("since")
        x = scope.left(t, since, scope.number("edge"), scope.state(), scope.extras())
        y, norm_error = scope.output(x)
        before = scope.inputs("invariants", self.invariants)
        measures = {"norm": norm_error, "invariant": relative_change(before, scope.invariants(x))}
        return scope.finished((*y, *(measures[name] for name in SAVED)))

    @property
    def _regrids(self) -> bool:
        """Whether what is stepped depends on the step size."""
        steps = self.job.method.steps
        return steps is not None and bool(steps.prepare or steps.enter or steps.leave)

    @cached_property
    def leave(self) -> Flat | None:
        """The state from the one that is stepped; None if they are the same."""
        if not self._regrids:
            return None
        scope = self.scope()
        t, since = scope.time(), scope.number("since")
        x = scope.left(t, since, scope.number("edge"), scope.state(), scope.extras())
        return scope.finished(x)

    @cached_property
    def enter(self) -> Flat | None:
        """What is stepped, and what is prepared, from the state; None if they are the same."""
        if not self._regrids:
            return None
        scope = self.scope()
        x = scope.state()
        e = scope.prepared(scope.number("h"), x)
        return scope.finished((*scope.entered(scope.time(), scope.number("edge"), x, e), *e))

    @cached_property
    def update(self) -> Flat | None:
        """The state after a sample time; None of a job without any."""
        if self.job.structure.turning.law.sampling is None:
            return None
        scope = self.scope()
        own, auxiliary = scope.parts(scope.state())
        assert isinstance(scope.motion, Coupled)
        return scope.finished((*scope.motion.updated(scope.time(), own), *auxiliary))

    @cached_property
    def project(self) -> Flat | None:
        """The state nearer to its group, and how far it had left it; None where it never is."""
        if not self.job.projects:
            return None
        scope = self.scope()
        x = scope.state()
        n = self.job.attitude.size
        if self.job.attitude.restore is None:
            return scope.finished((*x, 0.0))
        a, d = self.job.attitude.restore(x[:n])
        return scope.finished((*a, *x[n:], abs(d)))

    @cached_property
    def events(self) -> Flat:
        """The values of the functions that are watched."""
        scope = self.scope()
        return scope.finished(values(scope))

    @cached_property
    def watch(self) -> Flat:
        """What is kept of the functions that are watched, after another step."""
        return after_step(self.scope())

    @cached_property
    def resources(self) -> list[Any]:
        """Tables and opaque functions that the formulas call, in the order of their arrays."""
        update = () if self.update is None else (self.update,)
        return resources_of(self.small_angle.monitored, self.begin, self.save, self.events, *update)

    @cached_property
    def is_timed(self) -> bool:
        """Whether a step depends on the time."""
        return ("t",) in self.small_angle.monitored.inputs()

    @cached_property
    def calls(self) -> int:
        """How many numbers opaque functions give in a step."""
        return sum(node.op == "item" for node in self.small_angle.monitored.nodes)

    @cached_property
    def digest(self) -> bytes:
        """A hash of what a step computes."""
        flats = [self.small_angle.plain, *([] if self.update is None else [self.update])]
        spelled = "".join(flat.spelled(self.resources) for flat in flats)
        return hashlib.sha256(spelled.encode()).digest()

    @property
    def operations(self) -> int:
        """Floating-point operations of a step's small-angle form."""
        return self.small_angle.plain.operations * max(1, len(self.job.method.stages))


class Scope:
    """A graph, a job's motion on it, and the pieces of a run as formulas."""

    def __init__(self, formulas: Formulas, attitude: Attitude, graph: Graph) -> None:
        job = formulas.job
        self.formulas, self.graph = formulas, graph
        self.kind = job.kind
        self.job, self.attitude = job, attitude
        # time and parameters are of double precision, what is made of the state is of its own
        graph.narrow, graph.many = self.kind == "single", not job.shared
        p = graph.inputs("double", "p", formulas.parameters)
        self._bind(p, graph.input(self.kind, "h"))

    def _bind(self, p: Vector, like: Any) -> None:
        structure = self.job.structure
        self.motion: EquationsOfMotion
        if not structure.beside:
            self.motion = motion_of(structure.turning, self.attitude, p, like)
        else:
            self.motion = Coupled(self.attitude, structure, p, like)
        if self.job.windowed:
            low, high = (self.graph.time(self.graph.input("double", x)) for x in ("low", "high"))
            self.motion.evaluate_between(low, high)

    def inputs(self, group: str, n: int) -> tuple[Number, ...]:
        """Numbers of the state's precision."""
        return self.graph.inputs(self.kind, group, n)

    def number(self, name: str) -> Number:
        """A span of time in the state's precision, that all bodies share."""
        return self.graph.span(self.graph.input(self.kind, name))

    def state(self) -> Vector:
        """The state that is stepped."""
        return self.inputs("x", self.formulas.size)

    def extras(self) -> Vector:
        """What the method prepared."""
        return self.inputs("e", self.formulas.extras)

    def time(self) -> Any:
        """The time, of double precision."""
        return self.graph.time(self.graph.input("double", "t"))

    def finished(self, results: Vector) -> Flat:
        """The graph for some results."""
        return Flat(self.graph, results, self.kind)

    def parts(self, x: Vector) -> tuple[Vector, Vector]:
        """What a method steps, and what a user's function made of its states."""
        n = len(x) - self.job.structure.reduced
        return x[:n], x[n:]

    def step(self, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> tuple[Vector, Any]:
        """(state, squared turn) after one step, or one stage."""
        steps = self.job.method.steps
        assert steps is not None
        own, auxiliary = self.parts(x)
        if steps.stage is not None:
            y, z = steps.stage(self.motion, t, h, k, own, e)
        elif isinstance(turning := self.job.structure.turning, RigidBody) or turning.law.states:
            assert steps.body is not None
            y, z = steps.body(self.motion, t, h, own)
        else:
            constant = is_constant(turning.law)
            chosen = steps.constant if constant and steps.constant else steps.rate
            assert chosen is not None
            y, z = chosen(self.motion, t, h, own)
        return (*y, *self._watched(t + h, y, auxiliary)), z

    def _watched(self, t: Any, x: Vector, before: Vector) -> Vector:
        """What the user's function makes of a state and of what it made before.

        It computes in double precision, whatever that of the run.
        """
        reducer = self.job.structure.reducer
        if reducer is None:
            return ()
        is_single = self.kind == "single"
        state = double_states.joined(before) if is_single else before
        made = self.called(reducer.call, t, x, state)
        made = tuple(map(Double, made if isinstance(made, tuple) else (made,)))
        return double_states.split(made) if is_single else made

    def called(self, function: Callable[..., Any], t: Any, x: Vector, *rest: Vector) -> Any:
        """A user's function of time, attitude, angular velocity, and more, in double precision."""
        q, w = self.motion.pose(t, x)
        pose = tuple(map(Double, quat.renormalise(q))), tuple(map(Double, w))
        narrow, self.graph.narrow = self.graph.narrow, False
        try:
            return function(t, *pose, *rest)
        finally:
            self.graph.narrow = narrow

    def begin(self, q: Vector, auxiliary: Vector) -> Vector:
        """The state from an attitude as given and its auxiliary state."""
        n = self.job.structure.tail - self.job.structure.reduced
        return (*self.motion.begin(q, auxiliary[:n]), *auxiliary[n:])

    def prepared(self, h: Any, x: Vector) -> Vector:
        """What the method prepares for a body."""
        steps = self.job.method.steps
        if steps is None or steps.prepare is None:
            return ()
        return tuple(steps.prepare(self.motion, h, self.parts(x)[0]))

    def bound(self, h: Any, x: Vector) -> Any:
        """Square of no less than what the method's limit holds for, rad² a step, of a free body."""
        motion = self.motion.inner if isinstance(self.motion, Coupled) else self.motion
        assert isinstance(motion, Body)
        m = scale(h, motion.momentum_of(self.parts(x)[0])[:3])
        a, b, c = (k + k for k in motion.half_inverse)
        if self.job.method.measure == "asymmetry":
            assert self.job.method.sorted_axes
            return dot(m, m) * abs((a - b) * (c - b))
        most = a * a
        for k in (b, c):
            most = choose(k * k > most, k * k, most)
        return dot(m, m) * most

    def entered(self, t: Any, edge: Any, x: Vector, e: Vector) -> Vector:
        """The state as the method steps it."""
        steps = self.job.method.steps
        if steps is None or steps.enter is None:
            return x
        return tuple(steps.enter(self.motion, t, 0.0, edge, x, e))

    def left(self, t: Any, since: Any, edge: Any, x: Vector, e: Vector) -> Vector:
        """The state from what the method steps."""
        steps = self.job.method.steps
        if steps is None or steps.leave is None:
            return x
        return tuple(steps.leave(self.motion, t, since, edge, x, e))

    def output(self, x: Vector) -> tuple[Vector, Any]:
        """(what the trajectory holds, norm error)."""
        own, auxiliary = self.parts(x)
        attitude = self.attitude

        def finish(a: Vector) -> Any:
            y, d = attitude.finish(a)
            return (attitude.raw(a) if self.job.raw else y), d

        y, d = self.motion.output(own, finish)
        return (*y, *auxiliary), d

    def invariants(self, x: Vector) -> Vector:
        """What the motion keeps."""
        return self.motion.invariants(self.parts(x)[0])

    def monitored(self, h: Any, x: Vector) -> Vector:
        """The invariants to begin with; NaN where products underflow on which a turn depends."""
        kept = self.invariants(x)
        if not kept or self.job.method.measure != "turn":
            return kept
        motion = self.motion.inner if isinstance(self.motion, Coupled) else self.motion
        assert isinstance(motion, Body)
        m = motion.momentum_of(self.parts(x)[0])[:3]
        turn = scale(h, motion.angular_velocity(m))
        seen = dot(turn, turn) > float(np.finfo(DTYPES[self.kind]).eps)
        lost = both(dot(m, m) < _LOST[self.kind], seen)
        return tuple(choose(lost, math.nan, each) for each in kept)


@lru_cache(maxsize=64)
def _formulas(job: Job) -> Formulas:
    """Those of a job of any width, made once a process."""
    return Formulas(job)
