"""Single steps: the ensemble engine's own kernels, one body and one step at a time.

``single_step`` makes the functions of a scene and a method; ``hold`` to ``coning3_increments`` are
the methods for gyro samples, and ``sample_step`` gives them by name. All are called from Python,
from a user's own ``@njit`` functions and from her parallel loops: tuples in, tuples out, nothing
allocated; those named ``…_into`` work on arrays in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt._jit import helper, hook, kernel
from fastatt.columns import unpack
from fastatt.engine.tiles import short
from fastatt.methods import METHODS
from fastatt.methods.coning2 import Coning2
from fastatt.methods.coning3 import Coning3, Coning3Optimal
from fastatt.methods.hold import Hold
from fastatt.methods.method import enter, leave, prepare
from fastatt.methods.previous import Previous
from fastatt.methods.sampled import WINDOWS, Increments, Rates, products
from fastatt.methods.trapezoid import Trapezoid
from fastatt.motion import begin, carried, hand_out
from fastatt.propagate import methods_for
from fastatt.representations import OPERATIONS, REPRESENTATIONS, Quat, QuatShort, attitude
from fastatt.scene import Scene
from fastatt.translation import full_step

# in this order, the first that fits the scene and the representation
_DEFAULTS = ("magnus4", "rk8", "rk4")
_HALF_TURN = math.pi * math.pi


def place(rep: Any, q: Any) -> Any:
    """The attitude's part of a state, of a quaternion of any length but zero."""
    raise NotImplementedError(rep)


@hook(place)
def _place(rep: types.BaseNamedTuple, q: types.BaseTuple) -> Any:
    operation = OPERATIONS[rep.instance_class].start
    return lambda rep, q: operation(q)


def values(p: Any, shape: Any) -> Any:
    """A tuple as it is, or the numbers of an array as a tuple of the length of ``shape``."""
    raise NotImplementedError


@hook(values)
def _values(p: types.Type, shape: types.BaseTuple) -> Any:
    if isinstance(p, types.Array):
        return lambda p, shape: unpack(p, shape)
    return lambda p, shape: p


def through(
    method: Any, rep: Any, near: Any, model: Any, stages: Any, t: Any, h: Any, y: Any, p: Any,
    e: Any,
) -> Any:  # fmt: skip
    """(y one step of h s later, the largest squared angle of a stage).

    ``near`` is the twin of ``rep`` for turns of at most π, which is run first; ``stages`` are those
    of the method, or () for one.
    """
    raise NotImplementedError(method)


@hook(through)
def _through(
    method: types.Type, rep: types.BaseNamedTuple, near: types.BaseNamedTuple, model: types.Type,
    stages: types.BaseTuple, t: types.Type, h: types.Type, y: types.BaseTuple, p: types.Type,
    e: types.Type,
) -> Any:  # fmt: skip
    n = len(stages)

    def whole(method, rep, near, model, stages, t, h, y, p, e):
        k = type(y[0])(h)
        x, z = full_step(method, rep, model, t, k, k, y, p, e)
        return x, z

    def twice(method, rep, near, model, stages, t, h, y, p, e):
        F = type(y[0])
        k = F(h)
        x, z = full_step(method, near, model, t, k, k, y, p, e)
        if z > F(_HALF_TURN):
            x, z = full_step(method, rep, model, t, k, k, y, p, e)
        return x, z

    def staged(method, rep, near, model, stages, t, h, y, p, e):
        F = type(y[0])
        most = F(0.0)
        for i in range(n):
            share, other, at = stages[i]
            y, z = full_step(method, rep, model, t + at * h, F(share * h), F(other * h), y, p, e)
            most = z if z > most else most
        return y, most

    if n:
        return staged
    return whole if near.instance_class is rep.instance_class else twice


@helper
def whole_step(method, rep, near, model, stages, edge, t, h, x, p):
    """(x(t + h), the largest squared angle): into the method's own state, through, and back."""
    F = type(x[0])
    e = prepare(method, rep, model, F(h), x, p)
    y = enter(method, rep, model, t, F(0.0), F(edge * h), x, p, e)
    y, z = through(method, rep, near, model, stages, t, h, y, p, e)
    return leave(method, rep, model, t + h, F(h), F(edge * h), y, p, e), z


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

    Methods that work on another state than x (splittings, ``dmv``, ``srkn``) go into it and back in
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
        y = [
            self._flat(checks.array(name, value, "(3,)", [(3,)]))
            for name, value in zip(self._names, beside, strict=True)
        ]
        attitude_0 = self._flat(checks.attitudes("q", q, "(4,)", [(4,)]))
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
    method: str | None = None,
    representation: str = "quat",
    position: bool = False,
    dtype: DTypeLike = np.float64,
) -> Stepper:
    """Single steps of a scene by one method: the kernels of the ensemble engine.

    A step from Python takes 0.4 to 0.7 µs, inside ``@njit`` code the arithmetic alone: 4 to 25 ns
    by an exponential method. Functions are compiled when they are first called, and kept on disk
    but for a user's own rate or torque.

    Results are those of :func:`fastatt.propagate` bit for bit as far as the compiler fuses the same
    multiplications and additions in both; where it does not they differ by a few ulps a step. So
    they do where the engine, having found a turn past π, repeats a whole block of steps with the
    exponential that is good at any angle, and in float32 where each body has its own parameters,
    for there the engine rounds the time.

    Parameters
    ----------
    scene : what acts.
    method : a name of ``fastatt.METHODS`` that fits; None takes the first of magnus4, rk8 and rk4.
        The closed form takes no steps: see ``fastatt.exact`` and ``fastatt.kernels.free_body``.
    representation : "quat", "dcm", "dcm_rows", "euler313" or "rotation_vector".
    position : carry the position too, of a scene with mass.
    dtype : float64 or float32, of ``params`` and of what ``Stepper.state`` gives.

    Returns
    -------
    Stepper : ``step(t, h, x, p)`` and its company.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    checks.choice("representation", representation, REPRESENTATIONS)
    fitting = [n for n in methods_for(scene, representation) if METHODS[n].tag is not None]
    name = next((n for n in _DEFAULTS if n in fitting), "") if method is None else method
    record = METHODS[checks.choice("method", name, fitting)]
    if position and not scene.moves:
        raise ValueError("position: found True, but the scene has no mass; accepted: False")
    kind = checks.precision(dtype)
    packed = scene.packed(None, sorted_axes=record.sorted_axes, position=position)
    params: Any = packed.params
    shared = params.ndim == 1
    # as in the engine: a rate that all share is evaluated in double precision
    if not shared or scene.kind != "rate" or scene.moves:
        params = params.astype(kind)
    names = (
        *(() if scene.kind == "rate" else ("w",)),
        *(("v",) if scene.moves else ()),
        *(("r",) if position else ()),
    )
    rep = REPRESENTATIONS[representation]()
    return _stepper(
        *(record.tag, rep, short(rep) if record.exponentials else rep, packed.tag, record.stages),
        n_params=params.shape[-1],
        compile_one=kernel if packed.cacheable else _compile_for_now,
        method=name,
        representation=representation,
        params=_floats(params) if shared else params,
        _names=names,
        _kind=kind,
    )


def _floats(values: NDArray[Any]) -> tuple[Any, ...]:
    """Python's floats, which go faster into compiled code than NumPy's; of float32 the latter."""
    return tuple(values) if values.dtype == np.float32 else tuple(values.tolist())


def _compile_for_now(function: Callable[..., Any]) -> Any:
    return kernel(function, cache=False)


def _stepper(
    tag: Any,
    rep: Any,
    near: Any,
    model: Any,
    stages: Any,
    *,
    n_params: int,
    compile_one: Callable[..., Any],
    **described: Any,
) -> Stepper:
    """The functions close over tags and numbers alone, which Numba's disk cache knows again."""
    size, stored = OPERATIONS[type(rep)].size, OPERATIONS[type(rep)].stored
    edge = 0.5 * stages[-1][1] if stages else 0.0  # what is stepped lies this share of h ahead
    shape, like = (0.0,) * n_params, (0.0,) * carried(type(rep), model)

    def start(q, y, p):
        return begin(rep, model, place(rep, q), y, values(p, shape))

    def read(x, p):
        y, _ = hand_out(rep, model, x, values(p, shape), False)
        return attitude(rep, y[:size]), y[stored:]

    def step(t, h, x, p):
        x, _ = whole_step(tag, rep, near, model, stages, edge, t, h, x, values(p, shape))
        return x

    def step_and_turn(t, h, x, p):
        x, z = whole_step(tag, rep, near, model, stages, edge, t, h, x, values(p, shape))
        return x, math.sqrt(z)

    def step_into(t, h, x, p):
        y = values(x, like)
        y, _ = whole_step(tag, rep, near, model, stages, edge, t, h, y, values(p, shape))
        for i in range(len(y)):
            x[i] = y[i]

    def enter_run(t, h, x, p):
        F = type(x[0])
        e = prepare(tag, rep, model, F(h), x, values(p, shape))
        return enter(tag, rep, model, t, F(0.0), F(edge * h), x, values(p, shape), e), e

    def advance(t, h, y, p, e):
        y, _ = through(tag, rep, near, model, stages, t, h, y, values(p, shape), e)
        return y

    def leave_run(t, s, h, y, p, e):
        F = type(y[0])
        return leave(tag, rep, model, t, F(s), F(edge * h), y, values(p, shape), e)

    return Stepper(
        start=compile_one(start),
        step=compile_one(step),
        step_and_turn=compile_one(step_and_turn),
        read=compile_one(read),
        step_into=compile_one(step_into),
        enter=compile_one(enter_run),
        advance=compile_one(advance),
        leave=compile_one(leave_run),
        **described,
    )


# samples


def carried_by(method: Any, kind: Any, q: Any, v: Any, h: Any) -> Any:
    """Flat attitudes at the end of each interval, from q at the window's start.

    v are the window's samples, flat, h its intervals.
    """
    raise NotImplementedError(method)


@hook(carried_by)
def _carried_by(
    method: types.BaseNamedTuple,
    kind: types.BaseNamedTuple,
    q: types.BaseTuple,
    v: types.BaseTuple,
    h: types.BaseTuple,
) -> Any:
    window = WINDOWS[method.instance_class]
    of_rates = kind.instance_class is Rates
    turns: Any = window.rates if of_rates else window.increments
    limit = window.near

    def impl(method, kind, q, v, h):
        F = type(q[0])
        most = largest(v)
        most = most * largest(h) if of_rates else most
        d = turns(QuatShort(), v, h)
        if not most < F(limit):
            d = turns(Quat(), v, h)
        return products(q, d)

    return impl


@helper
def largest(v):
    """Largest absolute value."""
    most = abs(v[0])
    for x in v:
        most = abs(x) if abs(x) > most else most
    return most


@kernel
def hold(q, w, h):
    """Attitude h s later at the rate w (rad/s, body axes), held: q∘exp(h w)."""
    return carried_by(Hold(), Rates(), q, w, (h,))


@kernel
def hold_increments(q, u):
    """Attitude after the angle increment u (rad), taken for a rotation vector: q∘exp(u)."""
    return carried_by(Hold(), Increments(), q, u, (type(u[0])(1.0),))


@kernel
def trapezoid(q, w0, w1, h):
    """Attitude h s later by the mean of the rates w0 before and w1 after (rad/s)."""
    return carried_by(Trapezoid(), Rates(), q, w0 + w1, (h,))


@kernel
def previous(q, w0, w1, w2, h0, h1):
    """Attitude at the newest sample from q at w1's instant: a parabola through three rates.

    w0, w1, w2 (rad/s) were sampled h0 and h1 s apart, w2 the newest: causal, order 3.
    """
    return carried_by(Previous(), Rates(), q, w0 + w1 + w2, (h0, h1))


@kernel
def previous_increments(q, u0, u1, h0, h1):
    """Attitude after the newest increment u1 (rad) over h1 s, u0 the one over the h0 s before."""
    return carried_by(Previous(), Increments(), q, u0 + u1, (h0, h1))


@kernel
def coning2(q, w0, w1, w2, h0, h1):
    """(q1, q2): attitudes h0 and h0 + h1 s after q, from rates at all three instants; order 4."""
    f = carried_by(Coning2(), Rates(), q, w0 + w1 + w2, (h0, h1))
    return f[:4], f[4:]


@kernel
def coning2_increments(q, u0, u1, h0, h1):
    """(q1, q2): attitudes after each of two increments (rad) over h0 and h1 s."""
    f = carried_by(Coning2(), Increments(), q, u0 + u1, (h0, h1))
    return f[:4], f[4:]


@kernel
def coning3(q, w0, w1, w2, w3, h0, h1, h2):
    """(q1, q2, q3): attitudes at the ends of three intervals, from rates at all four instants."""
    f = carried_by(Coning3(), Rates(), q, w0 + w1 + w2 + w3, (h0, h1, h2))
    return f[:4], f[4:8], f[8:]


@kernel
def coning3_increments(q, u0, u1, u2, h0, h1, h2):
    """(q1, q2, q3): attitudes after each of three increments (rad) over h0, h1 and h2 s."""
    f = carried_by(Coning3(), Increments(), q, u0 + u1 + u2, (h0, h1, h2))
    return f[:4], f[4:8], f[8:]


@kernel
def coning3_optimal_increments(q, u0, u1, u2):
    """(q1, q2, q3) of increments (rad) over equal intervals, the last optimal for pure coning."""
    F = type(u0[0])
    f = carried_by(Coning3Optimal(), Increments(), q, u0 + u1 + u2, (F(1.0), F(1.0), F(1.0)))
    return f[:4], f[4:8], f[8:]


@dataclass(frozen=True)
class SampleStepper:
    """One window of gyro samples, made by :func:`sample_step`.

    The window covers ``span`` intervals and looks ``history`` intervals back; it holds ``samples``
    rates at the ends of all these intervals, rad/s, or increments over them, rad.

    ``step(q, v, h)`` gives the ``span`` attitudes after q, flat: v are the samples and h the
    intervals (s), flat tuples, the oldest first; None for ``picard``, whose work does not fit one.
    ``step_into(samples, intervals, out, work)`` fills out[1:]: samples (``samples``, 3), intervals
    (``history + span``,), out (``span`` + 1, 4) whose first row is the attitude at the window's
    start, work (``work``,), whose numbers do not matter; arrays of one float type, contiguous.
    """

    method: str
    history: int
    span: int
    samples: int
    work: int
    step: Any
    step_into: Any


def sample_step(method: str, *, increments: bool = False) -> SampleStepper:
    """One window of a method for sampled rates or angle increments, by its name.

    The kernels are those of :func:`fastatt.integrate_rates`, which gives the same attitudes bit for
    bit as far as the compiler fuses the same operations, but for the first and last ones of a log,
    where it has to extrapolate, and near the angle at which it goes over to the exponential for any
    angle: for 48 intervals at a time, here for a window.

    Raises ``ValueError`` for a method that does not take such samples.
    """
    scene = "increments" if increments else "sampled rates"
    known = [m.name for m in METHODS.values() if scene in m.scenes]
    tag = METHODS[checks.choice("method", method, known)].tag
    window = WINDOWS[type(tag)]
    kind = Increments() if increments else Rates()
    is_rates, n, span = not increments, window.samples(type(kind)), window.span
    shape, gaps = (0.0,) * (3 * n), (0.0,) * (window.history + span)

    def step(q, v, h):
        return carried_by(tag, kind, q, v, h)

    def step_into(samples, intervals, out, work):
        q = (out[0, 0], out[0, 1], out[0, 2], out[0, 3])
        d = carried_by(tag, kind, q, unpack(samples.reshape(-1), shape), unpack(intervals, gaps))
        flat = out.reshape(-1)
        for i in range(4 * span):
            flat[4 + i] = d[i]

    tile: Any = window.tile

    def tile_into(samples, intervals, out, work):
        v, h = samples.reshape((-1, 1)), intervals.reshape((-1, 1))
        tile(is_rates, v, 0, h, 0, out.reshape((-1, 1)), 0, work.reshape((-1, 1)), 1)

    return SampleStepper(
        method=method,
        history=window.history,
        span=span,
        samples=n,
        work=window.work_rows,
        step=None if tile else kernel(step),
        step_into=kernel(tile_into if tile else step_into),
    )
