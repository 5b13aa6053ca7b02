"""A job for the engine: method, representation, rates, torques and forces, and their formulas."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from fastatt._fork import cached_property
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

# below this |m|² products of rates lose digits
_LOST = {"double": 1e-305, "single": 1e-36}


@dataclass(frozen=True)
class Job:
    """Everything that the formulas of a run depend on, without its numbers.

    ``kind`` is the precision of the state, "double" or "single". ``shared`` says that all bodies
    have the same parameters; otherwise ``alike`` are the indices of those that they share.
    ``known`` says that rotation angles are known beforehand, so that some bodies need no
    monitoring. ``raw`` says that the output is not projected, and ``projects`` that the state is
    projected at some steps.
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
    #: step size and time differ between lanes: per-body step sizes, or a shorter step
    own_steps: bool = False
    #: events that are checked at the end of each step
    events: tuple[Watch, ...] = ()
    #: whether it takes the shorter steps by which events are located
    is_searched: bool = False
    #: rates, torques and forces are evaluated between two breakpoints only
    windowed: bool = False
    #: bodies in a tile; fewer for small ensembles, which is faster and gives the same bits
    width: int = WIDTH

    @cached_property
    def formulas(self) -> Formulas:
        """The formulas, traced when they are used; they do not depend on the width of a tile."""
        own = self.own_steps and not self.events
        return _formulas(replace(self, width=WIDTH, own_steps=own, is_searched=False))

    @property
    def has_any_angle_form(self) -> bool:
        """Whether a block has an any-angle form in addition to the small-angle one."""
        return self.known or self.method.exponentials > 0

    @property
    def bounds(self) -> bool:
        """Whether rotation angles follow from a body's initial state."""
        return self.known and not isinstance(self.structure.turning, PrescribedRate)

    @property
    def monitored(self) -> bool:
        """Whether rotation angles of steps are monitored in the small-angle form."""
        return not self.known


class Formulas:
    """The graphs of a job, each traced when it is used.

    Inputs are named ("x", i) for the stepped variables, ("p", i) for parameters, ("e", i) for
    numbers that the method prepared, ("c", i) for constants of a body, ("invariants", i), ("y", i)
    for initial values, and ("t",), ("h",), ("k",), ("edge",) and ("since",).
    """

    def __init__(self, job: Job) -> None:
        self.job = job
        self.size = carried(job.attitude, job.structure)
        self.parameters = job.structure.n_params
        self.coordinates = job.attitude.coordinates
        self.given = self.coordinates + job.structure.tail
        self.handed_out = job.attitude.stored + job.structure.tail

    def scope(self, *, small_angle: bool = False) -> Scope:
        """The numbers and the equations of motion of a formula."""
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
        """Values in steps that depend on a body's parameters only, computed once."""
        _ = self.small_angle  # determines the constants
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
        """A step or a stage for any rotation angle, if it has another form."""
        return self._any_angle if self.job.has_any_angle_form else None

    @cached_property
    def begin(self) -> Flat:
        """From initial values: the stepped variables, prepared numbers, and invariants."""
        scope = self.scope()
        y = scope.inputs("y", self.given)
        t, h = scope.time(), scope.number("h")
        x = scope.defined(h, scope.begin(y[: self.coordinates], y[self.coordinates :]))
        e = scope.prepared(h, x)
        stepped = scope.entered(t, scope.number("edge"), x, e)
        bound = (scope.bound(h, x),) if self.job.bounds else ()
        return scope.finished((*stepped, *e, *scope.monitored(h, x), *bound))

    @cached_property
    def extras(self) -> int:
        """Number of values that a method prepares for a body."""
        scope = self.scope()
        return len(scope.prepared(scope.number("h"), scope.inputs("x", self.size)))

    @cached_property
    def invariants(self) -> int:
        """Number of invariants."""
        scope = self.scope()
        return len(scope.invariants(scope.inputs("x", self.size)))

    @cached_property
    def save(self) -> Flat:
        """Values of a trajectory, and the measures of ``engine.status``, the norm error first."""
        scope = self.scope()
        t, since = scope.time(), scope.number("since")
        x = scope.left(t, since, scope.number("edge"), scope.state(), scope.extras())
        y, norm_error = scope.output(x)
        before = scope.inputs("invariants", self.invariants)
        measures = {"norm": norm_error, "invariant": relative_change(before, scope.invariants(x))}
        return scope.finished((*y, *(measures[name] for name in SAVED)))

    @property
    def _regrids(self) -> bool:
        """Whether the stepped variables depend on the step size."""
        steps = self.job.method.steps
        return steps is not None and bool(steps.prepare or steps.enter or steps.leave)

    @cached_property
    def leave(self) -> Flat | None:
        """The state from the stepped variables; None if they are equal."""
        if not self._regrids:
            return None
        scope = self.scope()
        t, since = scope.time(), scope.number("since")
        x = scope.left(t, since, scope.number("edge"), scope.state(), scope.extras())
        return scope.finished(x)

    @cached_property
    def enter(self) -> Flat | None:
        """Stepped variables and prepared numbers from the state; None if they are equal."""
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
        """The projected state and its norm error; None if it is never projected."""
        if not self.job.projects:
            return None
        scope = self.scope()
        x, n = scope.state(), self.job.attitude.size
        if self.job.attitude.restore is None:
            return scope.finished((*x, 0.0))
        a, d = self.job.attitude.restore(x[:n])
        return scope.finished((*a, *x[n:], abs(d)))

    @cached_property
    def events(self) -> Flat:
        """The values of the functions of the events."""
        scope = self.scope()
        return scope.finished(values(scope))

    @cached_property
    def watch(self) -> Flat:
        """The numbers that are kept of the functions of the events, after another step."""
        return after_step(self.scope())

    @cached_property
    def resources(self) -> list[Any]:
        """Tables and functions that formulas call without tracing, in the order of their arrays."""
        update = () if self.update is None else (self.update,)
        return resources_of(self.small_angle.monitored, self.begin, self.save, self.events, *update)

    @cached_property
    def is_timed(self) -> bool:
        """Whether a step depends on the time."""
        return ("t",) in self.small_angle.monitored.inputs()

    @cached_property
    def calls(self) -> int:
        """Number of results of calls of functions that are not traced, in a step."""
        return sum(node.op == "item" for node in self.small_angle.monitored.nodes)

    @cached_property
    def digest(self) -> bytes:
        """A hash of the operations of a step."""
        flats = [self.small_angle.plain, *([] if self.update is None else [self.update])]
        spelled = "".join(flat.spelled(self.resources) for flat in flats)
        return hashlib.sha256(spelled.encode()).digest()

    @property
    def operations(self) -> int:
        """Floating-point operations of a step's small-angle form."""
        return self.small_angle.plain.operations * max(1, len(self.job.method.stages))


class Scope:
    """A graph, the job's equations of motion on it, and the parts of a run as formulas."""

    def __init__(self, formulas: Formulas, attitude: Attitude, graph: Graph) -> None:
        job = formulas.job
        self.formulas, self.graph = formulas, graph
        self.kind, self.job, self.attitude = job.kind, job, attitude
        # time and parameters are of double precision, results of the state have its precision
        graph.narrow, graph.many = self.kind == "single", not job.shared
        graph.evaluations = job.method.rate_calls / max(1, len(job.method.stages))
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
        """Inputs of the state's precision."""
        return self.graph.inputs(self.kind, group, n)

    def number(self, name: str) -> Number:
        """A time interval in the state's precision, which all bodies share."""
        return self.graph.span(self.graph.input(self.kind, name))

    def state(self) -> Vector:
        """The stepped variables."""
        return self.inputs("x", self.formulas.size)

    def extras(self) -> Vector:
        """The numbers that the method prepared."""
        return self.inputs("e", self.formulas.extras)

    def time(self) -> Any:
        """The time, in double precision."""
        return self.graph.time(self.graph.input("double", "t"))

    def finished(self, results: Vector) -> Flat:
        """The graph for some results."""
        return Flat(self.graph, results, self.kind)

    def parts(self, x: Vector) -> tuple[Vector, Vector]:
        """What a method steps, and the state of the reducer."""
        n = len(x) - self.job.structure.reduced
        return x[:n], x[n:]

    def step(self, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> tuple[Vector, Any]:
        """(state, squared rotation angle) after one step, or one stage."""
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
        """The reducer's function of a state and of its previous state, in double precision."""
        reducer = self.job.structure.reducer
        if reducer is None:
            return ()
        is_single = self.kind == "single"
        state = double_states.joined(before) if is_single else before
        made = self.called(reducer.call, t, x, state)
        made = tuple(map(Double, made if isinstance(made, tuple) else (made,)))
        return double_states.split(made) if is_single else made

    def called(self, function: Callable[..., Any], t: Any, x: Vector, *rest: Vector) -> Any:
        """A user-defined function of time, attitude, angular velocity and more, in doubles."""
        q, w = self.motion.pose(t, x)
        pose = tuple(map(Double, quat.renormalise(q))), tuple(map(Double, w))
        narrow, self.graph.narrow = self.graph.narrow, False
        try:
            return function(t, *pose, *rest)
        finally:
            self.graph.narrow = narrow

    def begin(self, q: Vector, auxiliary: Vector) -> Vector:
        """The state from a given attitude and its auxiliary state."""
        n = self.job.structure.tail - self.job.structure.reduced
        return (*self.motion.begin(q, auxiliary[:n]), *auxiliary[n:])

    def prepared(self, h: Any, x: Vector) -> Vector:
        """The numbers that the method prepares for a body."""
        steps = self.job.method.steps
        if steps is None or steps.prepare is None:
            return ()
        return tuple(steps.prepare(self.motion, h, self.parts(x)[0]))

    def bound(self, h: Any, x: Vector) -> Any:
        """Square of an upper bound of what the method limits, rad², for a free body."""
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
        """The stepped variables from the state."""
        steps = self.job.method.steps
        if steps is None or steps.enter is None:
            return x
        return tuple(steps.enter(self.motion, t, 0.0, edge, x, e))

    def left(self, t: Any, since: Any, edge: Any, x: Vector, e: Vector) -> Vector:
        """The state from the stepped variables."""
        steps = self.job.method.steps
        if steps is None or steps.leave is None:
            return x
        return tuple(steps.leave(self.motion, t, since, edge, x, e))

    def output(self, x: Vector) -> tuple[Vector, Any]:
        """(the values of a trajectory, norm error)."""
        own, auxiliary = self.parts(x)
        attitude = self.attitude

        def finish(a: Vector) -> Any:
            y, d = attitude.finish(a)
            return (attitude.raw(a) if self.job.raw else y), d

        y, d = self.motion.output(own, finish)
        return (*y, *auxiliary), d

    def invariants(self, x: Vector) -> Vector:
        """The invariants of the motion."""
        return self.motion.invariants(self.parts(x)[0])

    def monitored(self, h: Any, x: Vector) -> Vector:
        """The initial invariants; NaN if products underflow on which a rotation angle depends."""
        return self._without_lost(h, x, self.invariants(x))

    def defined(self, h: Any, x: Vector) -> Vector:
        """The state at the begin; NaN if such products underflow and there are no invariants."""
        return x if self.invariants(x) else self._without_lost(h, x, x)

    def _without_lost(self, h: Any, x: Vector, values: Vector) -> Vector:
        """Values, or NaN if products underflow in the state x on which a rotation angle depends."""
        motion = self.motion.inner if isinstance(self.motion, Coupled) else self.motion
        if not isinstance(motion, Body) or self.job.method.measure != "angle":
            return values
        m = motion.momentum_of(self.parts(x)[0])[:3]
        angle = scale(h, motion.angular_velocity(m))
        seen = dot(angle, angle) > float(np.finfo(DTYPES[self.kind]).eps)
        lost = both(dot(m, m) < _LOST[self.kind], seen)
        return tuple(choose(lost, math.nan, each) for each in values)


@lru_cache(maxsize=64)
def _formulas(job: Job) -> Formulas:
    """The formulas of a job of any width, made once in a process."""
    return Formulas(job)
