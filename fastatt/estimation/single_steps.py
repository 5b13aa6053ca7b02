"""Single steps: the ensemble engine's own formulas, one body and one step at a time.

``single_step`` makes the functions of a scene and a method; ``hold`` to ``coning3_increments`` are
the methods for gyro samples, and ``sample_step`` gives them by name. All are called from Python,
from a user's own ``@njit`` functions and from her parallel loops: tuples in, tuples out, nothing
allocated; those named ``…_into`` work on arrays in place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt._jit import around_formulas, enough
from fastatt.attitudes import Attitude
from fastatt.codegen.rows import kind_of
from fastatt.codegen.scalar import ScalarFunction, scalar_function
from fastatt.engine.job import Formulas, Job, Scope
from fastatt.gyro.gyro_steps import (
    SampleStepper,
    coning2,
    coning2_increments,
    coning3,
    coning3_increments,
    coning3_optimal_increments,
    hold,
    hold_increments,
    previous,
    previous_increments,
    sample_step,
    trapezoid,
)
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import attitude_of, method_of
from fastatt.scene.scene import Scene, as_scene
from fastatt.tracing.formulas import Vector, as_like
from fastatt.tracing.functions import larger
from fastatt.tracing.graph import CLASSES, Double, number

_HALF_TURN = math.pi * math.pi
_ONE_STAGE = ((1.0, 1.0, 0.0),)


@dataclass(frozen=True, eq=False)
class Stepper:
    """The compiled functions of one scene and one method, made by :func:`single_step`.

    In ``@njit`` code a function is used by a name of its own (``step = stepper.step``), as a global
    or a closure; Numba knows no attributes of a Stepper. t and h are floats, s; p is ``params``, or
    of a scene whose numbers differ from body to body a row of it. The state x is a flat tuple, what
    the engine keeps of a body: the attitude's numbers, then a body's angular momentum along
    principal axes, velocity and position. The type of x is that of the arithmetic; to Python Numba
    hands float32 out as Python's floats, so that float32 is kept in arrays there, by ``step_into``.

    ``start(q, y, p)`` gives x; q of any length but zero; y is (), w, w + v or w + v + r, flat.
    ``step(t, h, x, p)`` gives x at t + h.
    ``step_and_turn(t, h, x, p)`` gives (x, angle): the largest angle (rad) that the step turned at
        a time, which must not pass the ``limits`` of the method's record; infinite where an
        iteration did not converge.
    ``read(x, p)`` gives (q, y), q a unit quaternion, body to inertial.
    ``step_into(t, h, x, p)`` is ``step`` in place, on an array x.
    Arrays with fewer numbers than the state or the parameters have are refused, by ``ValueError``.

    Methods that work on another state than x (splittings, ``dmv``) go into it and back in
    every ``step``, and prepare again what depends on h. With one h for a whole run, ``y, e =
    enter(t0, h, x, p)`` does so once, ``advance(t, h, y, p, e)`` gives the next y, and ``leave(t,
    t − t0, h, y, p, e)`` a state x, y going on unchanged; of other methods y is x, and e is ().
    To change h, leave and enter again.
    """

    method: str
    representation: str
    #: flat parameters: a tuple, or (N, P) with a row for each body
    params: Any
    start: Any
    step: Any
    step_and_turn: Any
    read: Any
    step_into: Any
    enter: Any
    advance: Any
    leave: Any
    _names: tuple[str, ...]
    _kind: np.dtype[Any]

    def __call__(self, t: float, h: float, x: Any) -> Any:
        """``step`` with ``params``, where all bodies share them."""
        return self.step(t, h, x, self.params)

    def state(self, q: ArrayLike, *beside: ArrayLike, body: int = 0) -> tuple[Any, ...]:
        """State x of numbers that are looked at: ``state(q)``, ``(q, w)``, ``(q, w, v)`` ….

        ``body`` says which row of ``params`` holds.

        Raises ``ValueError`` or ``TypeError`` for another number of arguments or shape.
        """
        if len(beside) != len(self._names):
            accepted = ", ".join(("q", *self._names))
            raise TypeError(f"state: found {1 + len(beside)} arguments; accepted: {accepted}")
        given = zip(self._names, beside, strict=True)
        y = [self._flat(checks.array(name, value, "(3,)")) for name, value in given]
        attitude_0 = self._flat(checks.attitudes("q", q, "(4,)"))
        x = self.start(attitude_0, sum(y, ()), self._of(body))
        return _floats(np.array(x, dtype=self._kind))

    def attitude(self, x: Any, *, body: int = 0) -> NDArray[Any]:
        """Unit quaternion (4,) of a state, body to inertial."""
        return np.array(self.read(x, self._of(body))[0])

    def _flat(self, value: NDArray[Any]) -> tuple[Any, ...]:
        return _floats(value.astype(self._kind))

    def _of(self, body: int) -> Any:
        return self.params if isinstance(self.params, tuple) else self.params[body]


def single_step(
    scene: Scene,
    *,
    method: str | Method | None = None,
    representation: str | Attitude = "quat",
    position: bool = False,
    dtype: DTypeLike = np.float64,
) -> Stepper:
    """Single steps of a scene by one method: the formulas of the ensemble engine.

    A step from Python takes 0.4 to 0.7 µs, inside ``@njit`` code the arithmetic alone: 4 to 25 ns
    by an exponential method. Functions are compiled when they are first called, once a process for
    all scenes that differ in numbers alone.

    Results are those of :func:`fastatt.propagate` bit for bit, with two exceptions. There, having
    found a turn past π, the engine repeats a whole block of steps with the exponential that is good
    at any angle, here a step. And methods that work on another state than x go out of it and back
    in every ``step``, and split the time of a stage otherwise: a few ulps a step, none by
    ``enter``, ``advance`` and ``leave`` where the torque does not depend on time.

    Parameters
    ----------
    scene : what acts.
    method : a name of ``fastatt.METHODS`` that fits, or a custom method; None takes the first
        of magnus4, rk8 and rk4. The closed form takes no steps: see ``fastatt.closed_form`` and
        ``fastatt.kernels.free_body`` and ``heavy_top``.
    representation : a name of ``fastatt.attitudes.ATTITUDES``, such as "quat" or "dcm", or a custom
        ``Attitude``.
    position : carry the position too, of a scene with mass.
    dtype : float64 or float32, of ``params`` and of what ``Stepper.state`` gives.

    Returns
    -------
    Stepper : ``step(t, h, x, p)`` and its company.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    as_scene(scene)
    attitude = attitude_of(representation)
    record = method_of(scene, method, attitude, need="is_stepped")
    if position and not scene.moves:
        raise ValueError("position: found True, but the scene has no mass; accepted: False")
    kind = checks.precision(dtype)
    position = position or scene.needs_position
    packed = scene.packed(None, sorted_axes=record.sorted_axes, position=position)
    shared = packed.params.ndim == 1
    job = Job(record, attitude, packed.structure, kind_of(kind), shared=shared)
    # functions take either precision; tables are what they hold besides their job
    key = replace(job, kind="double")
    functions = _functions(key, packed.tables) if packed.tables else _kept(key)
    start, read = _ends(replace(key, method=METHODS["rk4"]))
    carried = {"w": scene.kind != "rate", "v": scene.moves, "r": position}
    return Stepper(
        method=record.name, representation=attitude.name,
        params=_floats(packed.params) if shared else packed.params, start=start, read=read,
        **functions, _names=tuple(name for name, is_there in carried.items() if is_there),
        _kind=kind,
    )  # fmt: skip


def _floats(values: NDArray[Any]) -> tuple[Any, ...]:
    """Python's floats, which go faster into compiled code than NumPy's; of float32 the latter."""
    return tuple(values) if values.dtype == np.float32 else tuple(values.tolist())


class _Given(Scope):
    """A job's motion on the numbers that a formula was called with, in the precision of x."""

    def __init__(self, formulas: Formulas, x: Vector, p: Vector, *, quick: bool = False) -> None:
        job = formulas.job
        if len(p) != formulas.parameters:
            raise TypeError(f"p: found {len(p)} numbers; accepted: {formulas.parameters}")
        short = quick and job.method.exponentials > 0
        super().__init__(formulas, job.attitude.short if short else job.attitude, x[0].graph)
        self.kind = x[0].kind
        self.graph.narrow = self.kind == "single"
        self._bind(tuple(map(Double, p)), x[0])

    def at(self, t: Any) -> Any:
        """A time as the engine takes it."""
        return self.graph.time(Double(t))

    def narrow(self, h: Any) -> Any:
        """A span in the precision of x."""
        return self.graph.span(CLASSES[self.kind](h))

    def made(self, values: Any) -> Vector:
        """Results in the precision of x, those too that are known beforehand."""
        return tuple(number(self.graph, value, self.kind) for value in values)


class _Pieces:
    """A job's formulas for ``scalar_function``: of a state x or y, parameters p, prepared e."""

    def __init__(self, job: Job) -> None:
        self._formulas = job.formulas

    def begun(self, q: Vector, y: Vector, p: Vector) -> Vector:
        """x of an attitude and its auxiliary state."""
        scope = _Given(self._formulas, q, p)
        tail = self._formulas.job.structure.tail
        if len(y) != tail:
            raise TypeError(f"y: found {len(y)} numbers; accepted: {tail}")
        return scope.made(scope.begin(q, as_like(tuple(y), q[0])))

    def entered(self, t: Any, h: Any, edge: Any, x: Vector, p: Vector) -> tuple[Vector, Vector]:
        """(y, e): the state as the method steps it, what a run with step h needs."""
        size = self._formulas.size
        if len(x) != size:
            raise TypeError(f"x: found {len(x)} numbers; accepted: {size}")
        scope = _Given(self._formulas, x, p)
        e = scope.prepared(scope.narrow(h), x)
        y = scope.entered(scope.at(t), scope.narrow(edge), x, e)
        return scope.made(y), scope.made(e)

    def quick(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, most: Any) -> Any:
        """(y, the larger of ``most`` and the squared turn) after a stage of turns up to π."""
        return self._stage(_Given(self._formulas, y, p, quick=True), t, spans, y, e, most)

    def careful(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, most: Any) -> Any:
        """The same for turns of any size."""
        return self._stage(_Given(self._formulas, y, p), t, spans, y, e, most)

    def _stage(
        self, scope: _Given, t: Any, spans: Vector, y: Vector, e: Vector, most: Any
    ) -> tuple[Vector, Any]:
        h, k = map(scope.narrow, spans)
        y, z = scope.step(scope.at(t), h, k, y, e)
        return scope.made(y), scope.made((larger(most, z),))[0]

    def left(self, t: Any, since: Any, edge: Any, y: Vector, p: Vector, e: Vector) -> Vector:
        """x of the state as the method steps it."""
        scope = _Given(self._formulas, y, p)
        return scope.made(scope.left(scope.at(t), scope.narrow(since), scope.narrow(edge), y, e))

    def handed_out(self, x: Vector, p: Vector) -> Vector:
        """What a trajectory holds."""
        scope = _Given(self._formulas, x, p)
        return scope.made(scope.output(x)[0])

    def quaternion(self, y: Vector) -> Vector:
        """The attitude of what a trajectory holds."""
        attitude = self._formulas.job.attitude
        return tuple(attitude.quaternion(y[: attitude.size]))


def _functions(job: Job, tables: Mapping[int, NDArray[np.float64]]) -> dict[str, Any]:
    """What a stepper does of a method, each function compiled when it is first called."""
    pieces, size = _Pieces(job), job.formulas.size
    check_x, check_p = enough("x", size), enough("p", job.structure.n_params)
    stages = np.array(job.method.stages or _ONE_STAGE)
    # what is stepped lies this share of h ahead
    edge = 0.5 * stages[-1, 1] if job.method.stages else 0.0

    def scalar(formula: Any, **arrays: int) -> ScalarFunction:
        return scalar_function(formula, tables, arrays={"p": job.structure.n_params, **arrays})

    entered, left = scalar(pieces.entered, x=size), scalar(pieces.left)
    through = _through(scalar(pieces.quick), scalar(pieces.careful), stages, job)

    def step(t, h, x, p):
        check_x(x)
        check_p(p)
        y, e = entered(t, h, edge * h, x, p)
        y, _ = through(t, h, y, p, e)
        return left(t + h, h, edge * h, y, p, e)

    def step_and_turn(t, h, x, p):
        check_x(x)
        check_p(p)
        y, e = entered(t, h, edge * h, x, p)
        y, z = through(t, h, y, p, e)
        return left(t + h, h, edge * h, y, p, e), math.sqrt(z)

    def step_into(t, h, x, p):
        check_x(x)
        check_p(p)
        y, e = entered(t, h, edge * h, x, p)
        y, _ = through(t, h, y, p, e)
        y = left(t + h, h, edge * h, y, p, e)
        for i in range(size):
            x[i] = y[i]

    def enter(t, h, x, p):
        check_x(x)
        check_p(p)
        return entered(t, h, edge * h, x, p)

    def advance(t, h, y, p, e):
        check_p(p)
        y, _ = through(t, h, y, p, e)
        return y

    def leave(t, s, h, y, p, e):
        check_p(p)
        return left(t, s, edge * h, y, p, e)

    made = (step, step_and_turn, step_into, enter, advance, leave)
    return {function.__name__: around_formulas(function) for function in made}


def _through(quick: Any, careful: Any, stages: NDArray[np.float64], job: Job) -> Any:
    """``through(t, h, y, p, e)``: (y one step later, the largest squared angle of a stage)."""
    n = len(stages)

    def once(t, h, y, p, e):
        return quick(t, (h, h), y, p, e, type(y[0])(0.0))

    def twice(t, h, y, p, e):
        x, z = quick(t, (h, h), y, p, e, type(y[0])(0.0))
        if z > _HALF_TURN:
            x, z = careful(t, (h, h), y, p, e, type(y[0])(0.0))
        return x, z

    def staged(t, h, y, p, e):
        z = type(y[0])(0.0)
        for i in range(n):
            share, other, at = stages[i, 0], stages[i, 1], stages[i, 2]
            y, z = quick(t + at * h, (share * h, other * h), y, p, e, z)
        return y, z

    one_stage = twice if job.has_any_angle_form else once
    return around_formulas(staged if job.method.stages else one_stage, spliced=True)


@lru_cache(maxsize=128)
def _kept(job: Job) -> dict[str, Any]:
    """The functions of a job without tables, made once a process."""
    return _functions(job, {})


@lru_cache(maxsize=128)
def _ends(job: Job) -> tuple[Any, Any]:
    """``start`` and ``read``, which no method has a say in."""
    pieces, stored, size = _Pieces(job), job.attitude.stored, job.formulas.size
    check_x, check_p = enough("x", size), enough("p", job.structure.n_params)
    arrays = {"p": job.structure.n_params}
    begun = scalar_function(pieces.begun, arrays=arrays)
    handed_out = scalar_function(pieces.handed_out, arrays={**arrays, "x": size})
    quaternion = scalar_function(pieces.quaternion)

    def start(q, y, p):
        check_p(p)
        return begun(q, y, p)

    def read(x, p):
        check_x(x)
        check_p(p)
        y = handed_out(x, p)
        return quaternion(y[:stored]), y[stored:]

    return around_formulas(start), around_formulas(read)


__all__ = [
    "SampleStepper", "Stepper", "coning2", "coning2_increments", "coning3", "coning3_increments",
    "coning3_optimal_increments", "hold", "hold_increments", "previous", "previous_increments",
    "sample_step", "single_step", "trapezoid",
]  # fmt: skip
