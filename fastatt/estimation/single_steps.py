"""Single steps: the ensemble engine's formulas, one body and one step at a time.

The functions are called from Python, from a user's ``@njit`` functions and from parallel loops:
tuples in, tuples out, nothing allocated; ``step_into`` works on an array in place.
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

    ``@njit`` code uses a function as a global or a closure (``step = stepper.step``); Numba knows
    no attributes of a Stepper. t and h are floats, s; p is ``params``, or a row of it for a scene
    with per-body parameters. The state x is the engine's, a flat tuple: the attitude's numbers,
    then a body's angular momentum along principal axes, velocity, position and states. The type
    of x is that of the arithmetic; Numba returns float32 to Python as Python's floats, so that
    float32 states are kept in arrays there, by ``step_into``.

    ``start(q, y, p)`` gives x; q of any length but zero; y is w, v, r and s, flat, as far as the
        scene carries them.
    ``step(t, h, x, p)`` gives x at t + h.
    ``step_and_turn(t, h, x, p)`` gives (x, angle): the largest rotation angle (rad) of a stage,
        which must not pass the ``limits`` of the method's record; infinite where an iteration did
        not converge.
    ``read(x, p)`` gives (q, y), q a unit quaternion, body to inertial.
    ``step_into(t, h, x, p)`` is ``step`` in place, on an array x.
    Arrays with fewer numbers than the state or the parameters have are refused, by ``ValueError``.

    Methods that step another state than x (splittings, ``dmv``) convert to it and back in every
    ``step``, and prepare anew what depends on h. With one h for a whole run, ``y, e = enter(t0, h,
    x, p)`` does so once, ``advance(t, h, y, p, e)`` gives the next y, and ``leave(t, t − t0, h, y,
    p, e)`` a state x; y remains valid. For other methods y is x, and e is (). To change h, leave
    and enter again.
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
    #: what y holds, with the numbers of each
    _carried: Mapping[str, int]
    _kind: np.dtype[Any]

    def __call__(self, t: float, h: float, x: Any) -> Any:
        """``step`` with ``params``, where all bodies share them."""
        return self.step(t, h, x, self.params)

    def state(self, q: ArrayLike, *more: ArrayLike, body: int = 0) -> tuple[Any, ...]:
        """State x of checked numbers: ``state(q)``, ``state(q, w)``, ``state(q, w, v)`` ….

        ``body`` is the row of ``params``.

        Raises ``ValueError`` or ``TypeError`` for another number of arguments or shape.
        """
        if len(more) != len(self._carried):
            accepted = ", ".join(("q", *self._carried))
            raise TypeError(f"state: found {1 + len(more)} arguments; accepted: {accepted}")
        given = zip(self._carried.items(), more, strict=True)
        y = [self._flat(checks.array(name, value, f"({n},)")) for (name, n), value in given]
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

    Functions are compiled when they are first called, once a process for all scenes that differ in
    numbers alone. A step from Python takes 0.4 to 0.7 µs, one in ``@njit`` code 4 to 25 ns by an
    exponential method.

    Results are those of :func:`fastatt.propagate` bit for bit, with two exceptions. After a
    rotation angle above π the engine repeats a whole block of steps with the exponential for any
    angle, a single step itself alone. And methods that step another state than x convert to it and
    back in every ``step``, and split the time of a stage otherwise: a few ulps a step, none by
    ``enter``, ``advance`` and ``leave`` where the torque does not depend on time.

    Parameters
    ----------
    scene : a ``fastatt.Scene``.
    method : a name of ``fastatt.METHODS`` that fits, or a custom method; None takes the first
        of magnus4, rk8 and rk4. The closed form takes no steps: see ``fastatt.closed_form`` and
        ``fastatt.kernels.free_body`` and ``heavy_top``.
    representation : a name of ``fastatt.attitudes.ATTITUDES``, such as "quat" or "dcm", or a custom
        ``Attitude``.
    position : carry the position too, of a scene with mass.
    dtype : float64 or float32, of ``params`` and of what ``Stepper.state`` gives.

    Returns
    -------
    Stepper : the functions ``start``, ``step``, ``read`` and others.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    as_scene(scene)
    attitude = attitude_of(representation)
    record = method_of(scene, method, attitude, need="is_stepped")
    if position and not scene.moves:
        raise ValueError("position: found True, but the scene has no mass; accepted: False")
    if scene.sampling is not None:
        raise ValueError(
            "scene: found a sampled controller; accepted: a scene without, with the torque that "
            "your loop computes at sample times among its params"
        )
    kind = checks.precision(dtype)
    position = position or scene.needs_position
    packed = scene.packed(None, sorted_axes=record.sorted_axes, position=position)
    shared = packed.params.ndim == 1
    job = Job(record, attitude, packed.structure, kind_of(kind), shared=shared)
    # functions take either precision; they hold the tables
    key = replace(job, kind="double")
    functions = _functions(key, packed.tables) if packed.tables else _kept(key)
    start, read = _ends(replace(key, method=METHODS["rk4"]))
    return Stepper(
        method=record.name, representation=attitude.name,
        params=_floats(packed.params) if shared else packed.params, start=start, read=read,
        **functions, _carried=scene.carried(position=position), _kind=kind,
    )  # fmt: skip


def _floats(values: NDArray[Any]) -> tuple[Any, ...]:
    """Python's floats, which Numba unboxes faster than NumPy's; float32 stays NumPy's."""
    return tuple(values) if values.dtype == np.float32 else tuple(values.tolist())


class _Given(Scope):
    """A job's motion on the numbers that a formula was called with, in the precision of x."""

    def __init__(
        self, formulas: Formulas, x: Vector, p: Vector, *, small_angle: bool = False
    ) -> None:
        job = formulas.job
        if len(p) != formulas.parameters:
            raise TypeError(f"p: found {len(p)} numbers; accepted: {formulas.parameters}")
        short = small_angle and job.method.exponentials > 0
        super().__init__(formulas, job.attitude.short if short else job.attitude, x[0].graph)
        self.kind = x[0].kind
        self.graph.narrow = self.kind == "single"
        self._bind(tuple(map(Double, p)), x[0])

    def at(self, t: Any) -> Any:
        """A time in the engine's precision of times."""
        return self.graph.time(Double(t))

    def narrow(self, h: Any) -> Any:
        """A span in the precision of x."""
        return self.graph.span(CLASSES[self.kind](h))

    def made(self, values: Any) -> Vector:
        """Results in the precision of x, constants included."""
        return tuple(number(self.graph, value, self.kind) for value in values)


class _Parts:
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

    def to_stepped(self, t: Any, h: Any, edge: Any, x: Vector, p: Vector) -> tuple[Vector, Vector]:
        """(y, e): the state as the method steps it, what a run with step h needs."""
        size = self._formulas.size
        if len(x) != size:
            raise TypeError(f"x: found {len(x)} numbers; accepted: {size}")
        scope = _Given(self._formulas, x, p)
        e = scope.prepared(scope.narrow(h), x)
        y = scope.entered(scope.at(t), scope.narrow(edge), x, e)
        return scope.made(y), scope.made(e)

    def small_angle(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, z: Any) -> Any:
        """(y, the larger of z and the squared angle) after a stage with an angle up to π."""
        return self._stage(_Given(self._formulas, y, p, small_angle=True), t, spans, y, e, z)

    def any_angle(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, z: Any) -> Any:
        """``small_angle`` for rotations of any angle."""
        return self._stage(_Given(self._formulas, y, p), t, spans, y, e, z)

    def _stage(self, scope: _Given, t: Any, spans: Vector, y: Vector, e: Vector, z: Any) -> Any:
        h, k = map(scope.narrow, spans)
        y, angle = scope.step(scope.at(t), h, k, y, e)
        return scope.made(y), scope.made((larger(z, angle),))[0]

    def to_state(self, t: Any, since: Any, edge: Any, y: Vector, p: Vector, e: Vector) -> Vector:
        """x of the state that the method steps."""
        scope = _Given(self._formulas, y, p)
        return scope.made(scope.left(scope.at(t), scope.narrow(since), scope.narrow(edge), y, e))

    def output(self, x: Vector, p: Vector) -> Vector:
        """The numbers that a trajectory holds."""
        scope = _Given(self._formulas, x, p)
        return scope.made(scope.output(x)[0])

    def quaternion(self, y: Vector) -> Vector:
        """The attitude of ``output``, a quaternion."""
        attitude = self._formulas.job.attitude
        return tuple(attitude.quaternion(y[: attitude.size]))


def _functions(job: Job, tables: Mapping[int, NDArray[np.float64]]) -> dict[str, Any]:
    """The functions of a method's steps, each compiled when it is first called."""
    parts, size = _Parts(job), job.formulas.size
    check_x, check_p = enough("x", size), enough("p", job.structure.n_params)
    stages = np.array(job.method.stages or _ONE_STAGE)
    # the stepped state lies this share of h ahead
    half_stage = 0.5 * stages[-1, 1] if job.method.stages else 0.0
    constants = repr((job.method.stages, job.has_any_angle_form))

    def scalar(formula: Any, **arrays: int) -> ScalarFunction:
        arrays["p"] = job.structure.n_params
        return scalar_function(formula, tables, arrays=arrays, constants=constants)

    to_stepped, to_state = scalar(parts.to_stepped, x=size), scalar(parts.to_state)
    through = _through(scalar(parts.small_angle), scalar(parts.any_angle), stages, job)

    def step_and_turn(t, h, x, p):
        check_x(x)
        check_p(p)
        y, e = to_stepped(t, h, half_stage * h, x, p)
        y, z = through(t, h, y, p, e)
        return to_state(t + h, h, half_stage * h, y, p, e), math.sqrt(z)

    whole_step = around_formulas(step_and_turn, spliced=True)

    def step(t, h, x, p):
        return whole_step(t, h, x, p)[0]

    def step_into(t, h, x, p):
        y, _ = whole_step(t, h, x, p)
        for i in range(size):
            x[i] = y[i]

    def enter(t, h, x, p):
        check_x(x)
        check_p(p)
        return to_stepped(t, h, half_stage * h, x, p)

    def advance(t, h, y, p, e):
        check_p(p)
        y, _ = through(t, h, y, p, e)
        return y

    def leave(t, s, h, y, p, e):
        check_p(p)
        return to_state(t, s, half_stage * h, y, p, e)

    made = (step, step_and_turn, step_into, enter, advance, leave)
    return {function.__name__: around_formulas(function) for function in made}


def _through(small_angle: Any, any_angle: Any, stages: NDArray[np.float64], job: Job) -> Any:
    """``through(t, h, y, p, e)``: (y one step later, the largest squared angle of a stage)."""
    n = len(stages)

    def once(t, h, y, p, e):
        return small_angle(t, (h, h), y, p, e, type(y[0])(0.0))

    def twice(t, h, y, p, e):
        x, z = small_angle(t, (h, h), y, p, e, type(y[0])(0.0))
        if z > _HALF_TURN:
            x, z = any_angle(t, (h, h), y, p, e, type(y[0])(0.0))
        return x, z

    def staged(t, h, y, p, e):
        z = type(y[0])(0.0)
        for i in range(n):
            share, other, at = stages[i, 0], stages[i, 1], stages[i, 2]
            y, z = small_angle(t + at * h, (share * h, other * h), y, p, e, z)
        return y, z

    one_stage = twice if job.has_any_angle_form else once
    return around_formulas(staged if job.method.stages else one_stage, spliced=True)


@lru_cache(maxsize=128)
def _kept(job: Job) -> dict[str, Any]:
    """The functions of a job without tables, made once a process."""
    return _functions(job, {})


@lru_cache(maxsize=128)
def _ends(job: Job) -> tuple[Any, Any]:
    """``start`` and ``read``, which do not depend on the method."""
    parts, stored, size = _Parts(job), job.attitude.stored, job.formulas.size
    check_x, check_p = enough("x", size), enough("p", job.structure.n_params)
    arrays = {"p": job.structure.n_params}
    begun = scalar_function(parts.begun, arrays=arrays)
    output = scalar_function(parts.output, arrays={**arrays, "x": size})
    quaternion = scalar_function(parts.quaternion)

    def start(q, y, p):
        check_p(p)
        return begun(q, y, p)

    def read(x, p):
        check_x(x)
        check_p(p)
        y = output(x, p)
        return quaternion(y[:stored]), y[stored:]

    return around_formulas(start), around_formulas(read)
