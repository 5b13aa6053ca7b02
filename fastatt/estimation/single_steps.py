"""Single steps: the formulas of the ensemble engine for one body and one step.

The functions are called from Python, from jitted functions and from parallel loops. They take and
return tuples and allocate nothing; ``step_into`` changes an array in place.
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
from fastatt.codegen.rows import precision_of
from fastatt.codegen.scalar import ScalarFunction, scalar_function
from fastatt.engine.job import GivenScope, Job
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import attitude_of, method_of
from fastatt.scene.scene import Scene, as_scene
from fastatt.tracing.formulas import Vector, as_like
from fastatt.tracing.graph import larger, number

_HALF_TURN = math.pi * math.pi
_ONE_STAGE = ((1.0, 1.0, 0.0),)


@dataclass(frozen=True, eq=False)
class Stepper:
    """The compiled functions of one scene and one method; :func:`single_step` makes them.

    Jitted code uses a function as a global or a closure (``step = stepper.step``), since Numba does
    not know the attributes of a Stepper. t and h are floats, s. p is ``params``, or a row of it for
    a scene with per-body parameters. The state x is that of the engine, a flat tuple: the numbers
    of the attitude, then angular momentum along principal axes, velocity, position and states.
    Arithmetic has the type of x. Numba returns float32 to Python as Python floats, so that float32
    states should be kept in arrays there, with ``step_into``.

    Attributes
    ----------
    method : str
        Name of the method.
    representation : str
        Name of the representation.
    params : tuple or ndarray of shape (N, P)
        Flat parameters p; an array has a row for each body.
    start : callable
        ``start(q, y, p)`` returns x from a quaternion of any norm above zero and the flat tuple y
        of w, v, r and s, as far as the scene has them.
    step : callable
        ``step(t, h, x, p)`` returns x at t + h.
    step_and_angle : callable
        ``step_and_angle(t, h, x, p)`` returns (x, angle): the largest rotation angle of a stage,
        rad, which must not exceed ``Method.limits``; it is infinite if an iteration did not
        converge.
    read : callable
        ``read(x, p)`` returns (q, y) with a unit quaternion, body to inertial.
    step_into : callable
        ``step_into(t, h, x, p)`` is ``step`` in place, for an array x.
    enter : callable
        ``y, e = enter(t0, h, x, p)`` converts x to the stepped variables y, and prepares e for a
        run with one h. For methods that step x itself, y is x and e is ().
    advance : callable
        ``advance(t, h, y, p, e)`` returns the next y.
    leave : callable
        ``leave(t, t - t0, h, y, p, e)`` returns x; y remains valid. To change h, leave and enter
        again.

    Notes
    -----
    Methods that step other variables than x (splitting methods, ``dmv``) convert to them and back
    in every ``step``, and prepare anew what depends on h. ``enter``, ``advance`` and ``leave`` do
    so once. Arguments are floats, tuples of floats and, for x and p, arrays of floats; for others
    Numba raises its ``TypingError``. Arrays that are too short for the state or the parameters
    raise ``ValueError``.
    """

    method: str
    representation: str
    #: flat parameters: a tuple, or (N, P) with a row for each body
    params: Any
    start: Any
    step: Any
    step_and_angle: Any
    read: Any
    step_into: Any
    enter: Any
    advance: Any
    leave: Any
    #: the parts of y with their sizes
    _carried: Mapping[str, int]
    _dtype: np.dtype[Any]

    def __call__(self, t: float, h: float, x: Any) -> Any:
        """``step`` with ``params``, if all bodies share them."""
        return self.step(t, h, x, self.params)

    def state(self, q: ArrayLike, *more: ArrayLike, body: int = 0) -> tuple[Any, ...]:
        """The state x from checked numbers: ``state(q)``, ``state(q, w)``, ``state(q, w, v)`` ….

        Parameters
        ----------
        q : array_like of shape (4,)
            Attitude, body to inertial, of any norm above zero.
        *more : array_like
            w (rad/s), v (m/s), r (m) and s, as far as the scene has them.
        body : int, default 0
            Row of ``params``.

        Returns
        -------
        tuple
            The state.

        Raises
        ------
        ValueError, TypeError
            If the number of arguments or a shape does not fit, or ``params`` has no such row.
        """
        if len(more) != len(self._carried):
            accepted = ", ".join(("q", *self._carried))
            raise TypeError(f"state: found {1 + len(more)} arguments; accepted: {accepted}")
        carried = zip(self._carried.items(), more, strict=True)
        y = [self._flat(checks.array(name, value, f"({n},)")) for (name, n), value in carried]
        attitude_0 = self._flat(checks.attitudes("q", q, "(4,)"))
        x = self.start(attitude_0, sum(y, ()), self._of(body))
        return _floats(np.array(x, dtype=self._dtype))

    def attitude(self, x: Any, *, body: int = 0) -> NDArray[Any]:
        """Unit quaternion of a state.

        Parameters
        ----------
        x : tuple or ndarray
            A state.
        body : int, default 0
            Row of ``params``.

        Returns
        -------
        ndarray of shape (4,)
            Attitude, body to inertial.
        """
        return np.array(self.read(x, self._of(body))[0])

    def _flat(self, value: NDArray[Any]) -> tuple[Any, ...]:
        return _floats(value.astype(self._dtype))

    def _of(self, body: int) -> Any:
        if isinstance(self.params, tuple):
            return self.params
        n = len(self.params)
        if checks.whole("body", body, 0) >= n:
            raise ValueError(f"body: found {body}; accepted: 0 to {n - 1}, the rows of params")
        return self.params[body]


def single_step(
    scene: Scene,
    *,
    method: str | Method | None = None,
    representation: str = "quat",
    position: bool = False,
    dtype: DTypeLike = np.float64,
) -> Stepper:
    """Compile single steps of a scene by one method, with the formulas of the ensemble engine.

    Parameters
    ----------
    scene : Scene
        The body with its rates, torques and forces.
    method : str or Method, optional
        A name in :data:`fastatt.METHODS`, or a user-defined method. The default is the first of
        magnus6, rk8 and rk4 that fits. The closed form takes no steps: see
        ``fastatt.closed_form``.
    representation : str, default "quat"
        The representation, as in :func:`fastatt.propagate`.
    position : bool, default False
        Also propagate the position, for a scene with mass.
    dtype : {float64, float32}, default float64
        Precision of ``params`` and of the results of ``Stepper.state``.

    Returns
    -------
    Stepper
        The functions ``start``, ``step``, ``read`` and others.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Notes
    -----
    Functions are compiled when they are first called, once in a process for all scenes that differ
    only in the values of their numbers. A step takes 0.6 to 1.2 µs from Python; with an exponential
    method it takes 4 to 25 ns in jitted code.

    Results are those of :func:`fastatt.propagate` bit for bit, with two exceptions. After a
    rotation angle above π, ``propagate`` repeats a whole block of steps with a form of the
    exponential for all angles, whereas a single step repeats only itself. The splittings, ``dmv2``,
    ``dmv10`` and ``gbs16`` differ by a few ulps in each step: their steps convert x to other
    variables and back, or round the times of stages differently. With ``enter``, ``advance`` and
    ``leave`` they do not differ if the torque does not depend on time.

    Examples
    --------
    >>> import fastatt as fa
    >>> stepper = fa.single_step(fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.5))), method="rk4")
    >>> x = stepper.state([1, 0, 0, 0])
    >>> x = stepper(0.0, 0.1, x)
    >>> stepper.attitude(x).round(6).tolist()
    [0.999688, 0.0, 0.0, 0.024997]
    """
    as_scene(scene)
    attitude = attitude_of(representation)
    record = method_of(scene, method, representation, stepped=True)
    if checks.flag("position", position) and not scene.moves:
        raise ValueError("position: found True, but the scene has no mass; accepted: False")
    if scene.samplings or scene.switches:
        held = "a sampled controller" if scene.samplings else "a Switch"
        raise ValueError(
            f"scene: found {held}; accepted: a scene without, with the numbers that your loop "
            "computes at such times among its params"
        )
    scalar = checks.precision(dtype)
    position = position or scene.needs_position
    packed = scene.packed(None, sorted_axes=record.sorted_axes, position=position)
    shared = packed.params.ndim == 1
    job = Job(record, attitude, packed.structure, precision_of(scalar), shared=shared)
    # functions accept either precision; they contain the tables
    key = replace(job, precision="double")
    functions = _functions(key, packed.tables) if packed.tables else _memoised(key)
    start, read = _ends(replace(key, method=METHODS["rk4"]))
    return Stepper(
        method=record.name, representation=attitude.name,
        params=_floats(packed.params) if shared else packed.params, start=start, read=read,
        **functions, _carried=scene.carried(position=position), _dtype=scalar,
    )  # fmt: skip


def _floats(values: NDArray[Any]) -> tuple[Any, ...]:
    """Python floats, which Numba unboxes faster than NumPy's; float32 stays NumPy's."""
    return tuple(values) if values.dtype == np.float32 else tuple(values.tolist())


class _Given(GivenScope):
    """A job's motion, with the numbers that a formula is called with."""

    def made(self, values: Any) -> Vector:
        """Results in the precision of x, constants included."""
        return tuple(number(self.graph, value, self.precision) for value in values)


class _Parts:
    """A job's formulas for ``scalar_function``: of a state x or y, parameters p, prepared e."""

    def __init__(self, job: Job) -> None:
        self._job = job

    def begun(self, q: Vector, y: Vector, p: Vector) -> Vector:
        """x from an attitude and its auxiliary state."""
        scope = _Given(self._job, q, p)
        tail = self._job.structure.tail
        if len(y) != tail:
            raise TypeError(f"y: found {len(y)} numbers; accepted: {tail}")
        return scope.made(scope.motion.begin(q, as_like(tuple(y), q[0])))

    def to_stepped(self, t: Any, h: Any, edge: Any, x: Vector, p: Vector) -> tuple[Vector, Vector]:
        """(y, e): the stepped variables, and what a run with step size h needs."""
        size = self._job.size
        if len(x) != size:
            raise TypeError(f"x: found {len(x)} numbers; accepted: {size}")
        scope = _Given(self._job, x, p)
        e = scope.prepare(scope.span(h), x)
        y = scope.entered(scope.at(t), scope.span(edge), x, e)
        return scope.made(y), scope.made(e)

    def small_angle(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, z: Any) -> Any:
        """(y, the larger of z and the squared angle) after a stage with an angle up to π."""
        return self._stage(_Given(self._job, y, p, small_angle=True), t, spans, y, e, z)

    def any_angle(self, t: Any, spans: Vector, y: Vector, p: Vector, e: Vector, z: Any) -> Any:
        """``small_angle`` for rotations of any angle."""
        return self._stage(_Given(self._job, y, p), t, spans, y, e, z)

    def _stage(self, scope: _Given, t: Any, spans: Vector, y: Vector, e: Vector, z: Any) -> Any:
        h, k = map(scope.span, spans)
        y, angle = scope.step(scope.at(t), h, k, y, e)
        return scope.made(y), scope.made((larger(z, angle),))[0]

    def to_state(self, t: Any, since: Any, edge: Any, y: Vector, p: Vector, e: Vector) -> Vector:
        """x from the stepped variables."""
        scope = _Given(self._job, y, p)
        return scope.made(scope.left(scope.at(t), scope.span(since), scope.span(edge), y, e))

    def output(self, x: Vector, p: Vector) -> Vector:
        """The numbers that a trajectory holds."""
        scope = _Given(self._job, x, p)
        return scope.made(scope.output(x)[0])

    def quaternion(self, y: Vector) -> Vector:
        """The attitude in ``output``, as a quaternion."""
        attitude = self._job.attitude
        return tuple(attitude.quaternion(y[: attitude.size]))


def _functions(job: Job, tables: Mapping[int, NDArray[np.float64]]) -> dict[str, Any]:
    """The functions of a method's steps, each compiled when it is first called."""
    parts, size = _Parts(job), job.size
    check_x, check_p = enough("x", size), enough("p", job.structure.n_params)
    stages = np.array(job.method.stages or _ONE_STAGE)
    # the stepped variables are this share of h ahead
    half_stage = 0.5 * stages[-1, 1] if job.method.stages else 0.0

    def scalar(formula: Any, **arrays: int) -> ScalarFunction:
        arrays["p"] = job.structure.n_params
        return scalar_function(formula, tables, arrays=arrays)

    to_stepped, to_state = scalar(parts.to_stepped, x=size), scalar(parts.to_state)
    through = _through(scalar(parts.small_angle), scalar(parts.any_angle), stages, job)

    def step_and_angle(t, h, x, p):
        check_x(x)
        check_p(p)
        y, e = to_stepped(t, h, half_stage * h, x, p)
        y, z = through(t, h, y, p, e)
        return to_state(t + h, h, half_stage * h, y, p, e), math.sqrt(z)

    whole_step = around_formulas(step_and_angle, spliced=True)

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

    functions = (step, step_and_angle, enter, advance, leave)
    return {f.__name__: around_formulas(f) for f in (*functions, step_into)}


def _through(small_angle: Any, any_angle: Any, stages: NDArray[np.float64], job: Job) -> Any:
    """``through(t, h, y, p, e)``: (y after a step, the largest squared angle of a stage)."""
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
            share, other, place = stages[i, 0], stages[i, 1], stages[i, 2]
            y, z = small_angle(t + place * h, (share * h, other * h), y, p, e, z)
        return y, z

    one_stage = twice if job.has_any_angle_form else once
    return around_formulas(staged if job.method.stages else one_stage, spliced=True)


@lru_cache(maxsize=128)
def _memoised(job: Job) -> dict[str, Any]:
    """The functions of a job without tables, made once in a process."""
    return _functions(job, {})


@lru_cache(maxsize=128)
def _ends(job: Job) -> tuple[Any, Any]:
    """``start`` and ``read``, which do not depend on the method."""
    parts, stored, size = _Parts(job), job.attitude.stored, job.size
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
