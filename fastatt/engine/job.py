"""What a run computes: method, representation, rates, torques and forces, and their formulas."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fastatt._cached import cached_property
from fastatt.attitudes import Attitude
from fastatt.codegen.memory import DTYPES
from fastatt.engine.marks import Event, counting, look, with_sides
from fastatt.engine.status import DIAGNOSTICS, Diagnostic, Save, Step, flags, larger
from fastatt.engine.tape import BLOCK, CALLING_LENGTH, SWITCHING_LENGTH
from fastatt.methods.method import Method
from fastatt.scene.equations import (
    Body,
    Coupled,
    RigidBody,
    Structure,
    motion_of,
)
from fastatt.tracing.finished import Constants, Flat, resources_of
from fastatt.tracing.formulas import Vector, dot, quat, scale
from fastatt.tracing.graph import CLASSES, Double, Graph, Number, both, choose, number

# below this |m|² products of rates lose digits
_LOST = {"double": 1e-305, "single": 1e-36}


@dataclass(frozen=True)
class Job:
    """What a run computes, without its numbers, and the formulas, each traced when it is used.

    ``precision`` is that of the state, "double" or "single". ``shared`` says that all bodies have
    the same parameters; otherwise ``alike`` are the indices of those that they share. ``raw`` says
    that the output is not projected, and ``projects`` that the state is projected at some steps.

    Inputs of formulas are named ("x", i) for the stepped variables, ("p", i) for parameters,
    ("e", i) for numbers that the method prepared, ("c", i) for constants of a body,
    ("invariants", i), ("y", i) for initial values, (name, 0) for each diagnostic and ("limit", i)
    for their bounds, ("t",), ("h",), ("k",), ("edge",) and ("since",); those of events are in
    ``engine.marks``.
    """

    method: Method
    attitude: Attitude
    structure: Structure
    precision: str = "double"
    shared: bool = True
    alike: tuple[int, ...] = ()
    raw: bool = False
    projects: bool = False
    #: events that are looked for after each step
    events: tuple[Event, ...] = ()
    #: rates, torques and forces are evaluated between two breakpoints only
    windowed: bool = False

    @property
    def has_any_angle_form(self) -> bool:
        """Whether a block has an any-angle form in addition to the small-angle one."""
        return self.method.exponentials > 0

    @cached_property
    def size(self) -> int:
        """How many stepped variables there are."""
        structure = self.structure
        low = structure.tail - structure.coupled if self.attitude.compensated else 0
        return self.attitude.size + low + structure.tail

    @cached_property
    def switches(self) -> tuple[int, ...]:
        """Where the sides of the scene's switches are among the stepped variables."""
        law = self.structure.rotation.law
        return tuple(self.size - law.states + k for k in law.switches.values())

    @cached_property
    def holds(self) -> tuple[bool, ...]:
        """For each event, and then each switch, whether a body stays before the marked step."""
        return (*(event.terminal for event in self.events), *(True for _ in self.switches))

    @property
    def watched(self) -> int:
        """The number of events and switches."""
        return len(self.holds)

    @property
    def initial(self) -> int:
        """How many initial values there are."""
        return self.attitude.coordinates + self.structure.tail

    @property
    def handed_out(self) -> int:
        """How many values a save has, without the norm error."""
        return self.attitude.stored + self.structure.tail

    @cached_property
    def prepared(self) -> int:
        """How many values the method prepares for a body."""
        scope = self.scope()
        return len(scope.prepare(scope.number("h"), scope.state()))

    @cached_property
    def invariants(self) -> int:
        """How many invariants there are."""
        scope = self.scope()
        return len(scope.motion.invariants(scope.state()))

    @cached_property
    def jumps(self) -> bool:
        """Whether the torque may jump within a step."""
        scope = self.scope()
        return len(scope.motion.sides(scope.time(), scope.state())) > 0

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """The diagnostics that it has."""
        return tuple(of for of in DIAGNOSTICS if of.applies(self))

    @property
    def of_steps(self) -> list[Diagnostic]:
        """Those that steps compute."""
        return [of for of in self.diagnostics if of.of_steps]

    def scope(self, *, small_angle: bool = False) -> Scope:
        """The numbers and the equations of motion of a formula."""
        graph = Graph()
        p = graph.inputs("double", "p", self.structure.n_params)
        like = graph.input(self.precision, "h")
        names = ("low", "high") if self.windowed else ()
        window = tuple(graph.input("double", name) for name in names)
        return Scope(self, like, p, window, small_angle=small_angle)

    def _form(self, small_angle: bool) -> Flat:
        scope = self.scope(small_angle=small_angle)
        times = scope.time(), scope.number("h"), scope.number("k")
        t, h, _ = times
        x, square = scope.step(*times, scope.state(), scope.prepared())
        step = Step(square, scope.motion.sides(t, scope.state()), scope.motion.sides(t + h, x))
        flat = scope.finished(x=x, **{of.name: (of.formula(step),) for of in self.of_steps})
        if self.shared:
            return flat
        return self._constants.without(flat, more=small_angle)

    @cached_property
    def _constants(self) -> Constants:
        return Constants("p", "c", self.alike)

    @cached_property
    def constants(self) -> Flat:
        """Values in steps that depend on a body's parameters only, computed once."""
        _ = self.small_angle  # determines the constants
        return self._constants.flat

    @cached_property
    def small_angle(self) -> Flat:
        """State and squared rotation angle after a step or a stage, for angles of at most π."""
        return self._form(True)

    @cached_property
    def any_angle(self) -> Flat | None:
        """State and angle after a step or a stage, for any angle, if it has another form."""
        return self._form(False) if self.has_any_angle_form else None

    @cached_property
    def begin(self) -> Flat:
        """From initial values: all that a body takes with it, but for its events."""
        scope = self.scope()
        y = scope.inputs("y", self.initial)
        t, h = scope.time(), scope.number("h")
        x = scope.defined(
            h, scope.motion.begin(y[: self.attitude.coordinates], y[self.attitude.coordinates :])
        )
        x = with_sides(scope, t, x) if self.switches else x
        e = scope.prepare(h, x)
        stepped = scope.entered(t, scope.number("edge"), x, e)
        return scope.finished(
            x=stepped, e=e, invariants=scope.monitored(h, x),
            **{of.name: (0.0,) for of in self.diagnostics}, status=(0.0,),
            slides=(0.0,) * len(self.switches),
        )  # fmt: skip

    @cached_property
    def save(self) -> Flat:
        """Values of a trajectory with the norm error; the largest diagnostics so far."""
        scope = self.scope()
        y, norm_error = scope.output(scope.left_now())
        begun = scope.inputs("invariants", self.invariants)
        save = Save(norm_error, begun, scope.motion.invariants(scope.left_now()))
        counts = counting(scope) if any(self.holds) else None
        largest = {}
        for of in filter(lambda of: not of.of_steps, self.diagnostics):
            (before,) = scope.inputs(of.name, 1)
            new = larger(before, of.formula(save))
            largest[of.name] = (new if counts is None else choose(counts, new, before),)
        return scope.finished(io=(*y, norm_error), **largest)

    @cached_property
    def status(self) -> Flat:
        """The flags of a body, from its state and its diagnostics."""
        scope = self.scope()
        names = [of.name for of in self.diagnostics]
        limits = scope.graph.inputs("double", "limit", len(names))
        values = {name: scope.inputs(name, 1)[0] for name in names}
        bounds = dict(zip(names, limits, strict=True))
        iterates = self.method.iterates
        status = flags(scope.state(), values, bounds, self.attitude, iterates=iterates)
        return scope.finished(status=(status,))

    @property
    def regrids(self) -> bool:
        """Whether the stepped variables depend on the step size."""
        steps = self.method.steps
        return steps is not None and bool(steps.prepare or steps.enter or steps.leave)

    @cached_property
    def leave(self) -> Flat:
        """The state from the stepped variables."""
        scope = self.scope()
        return scope.finished(x=scope.left_now())

    @cached_property
    def enter(self) -> Flat:
        """Stepped variables and prepared numbers from the state."""
        scope = self.scope()
        x = scope.state()
        e = scope.prepare(scope.number("h"), x)
        return scope.finished(x=scope.entered(scope.time(), scope.number("edge"), x, e), e=e)

    @cached_property
    def updates(self) -> list[Flat]:
        """The state after a sample time, by each of the law's jumps."""
        return [self._updated(*jump) for jump in self.structure.rotation.law.jumps]

    def _updated(self, term: int, sampling: Any) -> Flat:
        scope = self.scope()
        return scope.finished(x=scope.motion.updated(scope.time(), scope.state(), term, sampling))

    @cached_property
    def project(self) -> Flat | None:
        """The projected state, and the largest norm error; None if it is never projected.

        The errors that projections remove from a compensated state add up.
        """
        if not self.projects:
            return None
        scope = self.scope()
        x, n = scope.state(), self.attitude.size
        (largest,) = scope.inputs("norm", 1)
        restore = self.attitude.restore
        a, d = (x[:n], 0.0) if restore is None else restore(x[:n])
        removed = self.attitude.compensated
        lost = largest + abs(d) if removed else larger(largest, abs(d))
        lost = choose(counting(scope), lost, largest) if self.switches else lost
        return scope.finished(x=(*a, *x[n:]), norm=(lost,))

    @cached_property
    def look(self) -> Flat:
        """The state, and the values of the functions of the events."""
        return look(self.scope())

    @cached_property
    def resources(self) -> list[Any]:
        """Tables and functions that formulas call without tracing, in the order of their arrays."""
        flats = (self.small_angle, self.begin, self.save, self.look, *self.updates)
        return resources_of(*filter(None, flats))

    @cached_property
    def is_timed(self) -> bool:
        """Whether a step depends on the time."""
        return ("t",) in self.small_angle.inputs()

    @cached_property
    def calls(self) -> int:
        """Number of results of calls of functions that are not followed, in a step."""
        return sum(node.op == "item" for node in self.small_angle.nodes)

    @cached_property
    def digest(self) -> bytes:
        """A hash of the operations of a step."""
        flats = (self.small_angle, *self.updates, *([self.begin] if self.switches else []))
        spelled = "".join(flat.spelled(self.resources) for flat in flats)
        return hashlib.sha256(spelled.encode()).digest()

    @property
    def block(self) -> int:
        """The steps of a block, of which the pieces of a run consist."""
        if self.calls:
            return CALLING_LENGTH
        return SWITCHING_LENGTH if self.switches else BLOCK

    @cached_property
    def operations(self) -> int:
        """Floating-point operations of a step's small-angle form."""
        return self.small_angle.operations * max(1, len(self.method.stages))


class Scope:
    """A graph, the job's equations of motion on it, and the parts of a run as formulas.

    ``like`` is a number of the graph with the state's precision, and ``window`` are the least and
    the largest time at which rates, torques and forces are evaluated.
    """

    def __init__(
        self, job: Job, like: Number, p: Vector, window: Vector, *, small_angle: bool = False
    ) -> None:
        structure, self.job, self.p = job.structure, job, p
        self.graph, self.precision = like.graph, like.precision
        is_short = small_angle and job.has_any_angle_form
        self.attitude = job.attitude.short if is_short else job.attitude
        # time and parameters are of double precision, results of the state have its precision
        self.graph.narrow = self.precision == "single"
        self.motion: Any = motion_of(structure, self.attitude, p, like)
        if job.windowed:
            self.motion.evaluate_between(*map(self.graph.time, window))

    def inputs(self, group: str, n: int) -> tuple[Number, ...]:
        """Inputs of the state's precision."""
        return self.graph.inputs(self.precision, group, n)

    def number(self, name: str) -> Number:
        """A time interval in the state's precision, which all bodies share."""
        return self.graph.span(self.graph.input(self.precision, name))

    def state(self) -> Vector:
        """The stepped variables."""
        return self.inputs("x", self.job.size)

    def prepared(self) -> Vector:
        """The numbers that the method prepared."""
        return self.inputs("e", self.job.prepared)

    def time(self) -> Any:
        """The time, in double precision."""
        return self.graph.time(self.graph.input("double", "t"))

    def finished(self, **results: Sequence[Any]) -> Flat:
        """The graph for results by the groups of rows that they go to."""
        flat = Flat(self.graph, [x for group in results.values() for x in group], self.precision)
        flat.groups = {name: len(group) for name, group in results.items()}
        return flat

    def step(self, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> Any:
        """(state, squared rotation angle) after one step, or one stage."""
        steps: Any = self.job.method.steps
        rotation = self.job.structure.rotation
        if steps.stage is not None:
            return steps.stage(self.motion, t, h, k, x, e)
        if isinstance(rotation, RigidBody) or rotation.law.states:
            return steps.body(self.motion, t, h, x)
        constant = steps.constant if rotation.law.is_constant else None
        return (constant or steps.rate)(self.motion, t, h, x)

    def shown(self, t: Any, x: Vector, names: Sequence[str]) -> list[Vector]:
        """What terms of the torque show at a state, by their names, in doubles."""
        if not names:
            return []
        return [tuple(map(Double, numbers)) for numbers in self.motion.shown(t, x, names)]

    def crossed(self, t: Any, x: Vector) -> list[Any]:
        """The functions of the scene's switches at a state, in doubles."""
        if not self.job.switches:
            return []
        narrow, self.graph.narrow = self.graph.narrow, False
        try:
            return self.motion.crossed(t, x)  # type: ignore[no-any-return]
        finally:
            self.graph.narrow = narrow

    def called(self, function: Callable[..., Any], t: Any, x: Vector, *rest: Vector) -> Any:
        """A user-defined function of time, attitude, angular velocity and more, in doubles."""
        q, w = self.motion.pose(t, x)
        pose = tuple(map(Double, quat.renormalise(q))), tuple(map(Double, w))
        narrow, self.graph.narrow = self.graph.narrow, False
        try:
            return function(t, *pose, *rest)
        finally:
            self.graph.narrow = narrow

    def _by_method(self, name: str, default: Vector, *args: Any) -> Vector:
        """What a function of the method's record returns, or what holds without it."""
        function = getattr(self.job.method.steps, name, None)
        return default if function is None else tuple(function(self.motion, *args))

    def prepare(self, h: Any, x: Vector) -> Vector:
        """The numbers that the method prepares for a body."""
        return self._by_method("prepare", (), h, x)

    def entered(self, t: Any, edge: Any, x: Vector, e: Vector) -> Vector:
        """The stepped variables from the state."""
        return self._by_method("enter", x, t, 0.0, edge, x, e)

    def left(self, t: Any, since: Any, edge: Any, x: Vector, e: Vector) -> Vector:
        """The state from the stepped variables."""
        return self._by_method("leave", x, t, since, edge, x, e)

    def left_now(self) -> Vector:
        """The state from the stepped variables, after the given number of steps."""
        since, edge = self.number("since"), self.number("edge")
        return self.left(self.time(), since, edge, self.state(), self.prepared())

    def output(self, x: Vector) -> tuple[Vector, Any]:
        """(the values of a trajectory, norm error)."""
        attitude = self.attitude

        def finish(a: Vector) -> Any:
            y, d = attitude.finish(a)
            return (attitude.raw(a) if self.job.raw else y), d

        return self.motion.output(x, finish)  # type: ignore[no-any-return]

    def monitored(self, h: Any, x: Vector) -> Vector:
        """The initial invariants; NaN if products underflow on which a rotation angle depends."""
        return self._without_lost(h, x, self.motion.invariants(x))

    def defined(self, h: Any, x: Vector) -> Vector:
        """The state at the begin; NaN if such products underflow and there are no invariants."""
        return x if self.motion.invariants(x) else self._without_lost(h, x, x)

    def _without_lost(self, h: Any, x: Vector, values: Vector) -> Vector:
        """Values, or NaN if products underflow in the state x on which a rotation angle depends."""
        motion = self.motion.inner if isinstance(self.motion, Coupled) else self.motion
        if not isinstance(motion, Body) or self.job.method.measure != "angle":
            return values
        m = motion.momentum_of(x)[:3]
        angle = scale(h, motion.angular_velocity(m))
        seen = dot(angle, angle) > float(np.finfo(DTYPES[self.precision]).eps)
        lost = both(dot(m, m) < _LOST[self.precision], seen)
        return tuple(choose(lost, math.nan, each) for each in values)


class GivenScope(Scope):
    """A job's motion, with the numbers that a formula is called with, in the precision of x."""

    def __init__(
        self, job: Job, x: Vector, p: Vector, window: Vector = (), *, small_angle: bool = False
    ) -> None:
        if len(p) != job.structure.n_params:
            raise TypeError(f"p: found {len(p)} numbers; accepted: {job.structure.n_params}")
        super().__init__(job, x[0], tuple(map(Double, p)), window, small_angle=small_angle)

    def at(self, t: Any) -> Any:
        """A time in the precision of the engine's times."""
        return self.graph.time(Double(t))

    def span(self, h: Any) -> Any:
        """A time interval in the precision of x."""
        return self.graph.span(number(self.graph, CLASSES[self.precision](h), self.precision))
