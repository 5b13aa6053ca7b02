"""Transitions and tangents of the steps that methods take, of arrays and for ``@njit`` code."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rates
from fastatt._jit import driver, kernel
from fastatt.arrays import quat_multiply, quat_to_dcm, quat_to_rotation_vector
from fastatt.columns import store, unpack
from fastatt.engine.samples import window_of
from fastatt.estimation import tangent
from fastatt.estimation.threads import spread
from fastatt.inertia import is_sorted
from fastatt.integrate import beyond, integrate_rates, intervals, methods_for_samples
from fastatt.kernels import quat
from fastatt.methods import METHODS, Method
from fastatt.methods.sampled import WINDOWS, Increments, Rates
from fastatt.propagate import methods_for
from fastatt.scene import Scene
from fastatt.steps import values as flat

_TRIPLE = (0.0, 0.0, 0.0)
_QUATERNION = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Transition:
    """How an attitude's error and a gyro's bias go through a step: δθ ← Φ11 δθ + Φ12 δb.

    ``turn`` (..., 4) is the rotation of the step, q ← q∘turn; ``attitude`` (..., 3, 3) Φ11;
    ``bias`` (..., 3, 3) Φ12, s.
    """

    turn: NDArray[Any]
    attitude: NDArray[Any]
    bias: NDArray[Any]

    @property
    def matrix(self) -> NDArray[Any]:
        """(..., 6, 6) of (δθ, δb), the bias constant."""
        out = np.zeros((*self.attitude.shape[:-2], 6, 6), dtype=self.attitude.dtype)
        out[..., :3, :3] = self.attitude
        out[..., :3, 3:] = self.bias
        out[..., 3:, 3:] = np.eye(3)
        return out


@dataclass(frozen=True, eq=False)
class BodyTangent:
    """A body's step and its derivatives.

    ``q`` (..., 4) and ``w`` (..., 3) are the state after it; ``matrix`` (..., 6, 6) takes (δθ, δm)
    before to (δθ, δm) after, δm = I δw in N·m·s along body axes; ``inertia`` (..., 6, 3) and
    ``torque`` (..., 6, P) are the derivatives of (θ, m) to the principal moments, m before held,
    and to the numbers of the torque's model, in the order of its fields; None if not asked for.
    NaN where an implicit step did not converge.
    """

    q: NDArray[Any]
    w: NDArray[Any]
    matrix: NDArray[Any]
    inertia: NDArray[Any] | None = None
    torque: NDArray[Any] | None = None

    def adjoint(self, after: ArrayLike) -> NDArray[Any]:
        """Φᵀ λ: the gradient (..., 6) to the state before from that to the state after."""
        return np.asarray(np.einsum("...ji,...j->...i", self.matrix, np.asarray(after)))


@dataclass(frozen=True, eq=False)
class StepTangent:
    """The compiled derivative of one scene's step; see :func:`step_tangent`."""

    method: str
    #: flat parameters: a tuple, or (N, P) with a row for each body
    params: Any
    step: Any


# drivers


@driver
def _rates(method, model, t, h, shape, params, b, turn, attitude, bias, first, last):
    for i in range(first, last):
        p = unpack(params[min(i, params.shape[0] - 1)], shape)
        c = unpack(b[min(i, b.shape[0] - 1)], _TRIPLE)
        q, f, g = tangent.rate_tangent(method, model, t, h, c, p)
        store(turn.T, 0, i, q)
        store(attitude.T, 0, i, f)
        store(bias.T, 0, i, g)


@driver
def _windows(method, kind, data, spans, turn, attitude, bias, samples, gaps, first, last):
    count = turn.shape[1]
    _, span, _ = window_of(method, kind)
    for log in range(first, last):
        flat = data[log].reshape(-1)
        for start in range(0, count, span):
            v = unpack(flat[3 * start :], samples)
            found = tangent.window_tangent(method, kind, v, unpack(spans[start:], gaps))
            for i in range(min(span, count - start)):
                q, f, g = found[i]
                store(turn[log].T, 0, start + i, q)
                store(attitude[log].T, 0, start + i, f)
                store(bias[log].T, 0, start + i, g)


@driver
def _bodies(
    wanted, method, model, stages, edge, t, h, shape, params, q0, w0, q1, w1, phi, first, last
):
    for i in range(first, last):
        p = unpack(params[min(i, params.shape[0] - 1)], shape)
        w = unpack(w0[min(i, w0.shape[0] - 1)], _TRIPLE)
        q = quat.normalise(unpack(q0[min(i, q0.shape[0] - 1)], _QUATERNION))
        m = tangent.momentum_of_rate(model, w, p)
        q, m, f, z = tangent.body_tangent(wanted, method, model, stages, edge, t, h, q, m, p)
        w = tangent.rate_of_momentum(model, m, p)
        # an iteration that did not converge says so by an infinite turn
        poison = z - z
        store(q1.T, 0, i, q)
        store(w1.T, 0, i, w)
        store(phi.T, 0, i, f)
        for k in range(phi.shape[1]):
            phi[i, k] += poison


def _uncached(loop: Any) -> Any:
    return driver(loop.py_func, cache=False)


_LOOPS = {True: (_rates, _bodies), False: (_uncached(_rates), _uncached(_bodies))}


@contextmanager
def _differentiable(what: str) -> Iterator[None]:
    """A user's function that dual numbers can't go through, in one line."""
    try:
        yield
    except NumbaError as error:
        first = next((ln for ln in str(error).splitlines() if "Dual(" in ln), str(error))
        raise TypeError(
            f"{what}: has no derivative that compiles: {first.strip()}; accepted are arithmetic, "
            "comparisons, abs, min, max and sqrt, sin, cos, tan, atan, atan2, exp, log, tanh"
        ) from error


# given rates


def _scene(scene: Any) -> Scene:
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    return scene


def _of_rate(scene: Scene, method: str) -> tuple[Method, Any]:
    _scene(scene)
    if scene.kind != "rate" or scene.frame != "body" or scene.moves:
        raise ValueError(
            "scene: found one with inertia, mass or rates in inertial axes; accepted: a scene "
            "with a rate in body axes"
        )
    checks.choice("method", method, methods_for(scene, "quat"))
    packed = scene.packed(None)
    return METHODS[method], packed._replace(
        tag=rates.Sum((rates.Constant(_TRIPLE), packed.tag)), params=np.atleast_2d(packed.params)
    )


def rate_transition(
    scene: Scene,
    dt: float,
    *,
    t: float = 0.0,
    method: str = "magnus4",
    bias: ArrayLike = _TRIPLE,
    n_threads: int | None = None,
) -> Transition:
    """Transition over the step that a method takes at the rate of a scene less a gyro's bias.

    ``scene`` has a rate, along body axes, for one or N bodies; ``bias`` is (3,) or (N, 3), rad/s;
    ``t`` and ``dt`` are the start and the length of the step, s. The turn and Φ11 are those of the
    step; Φ12 is its derivative, by the method's own formula. Error of Φ12 at most 1e-15 dt.

    Raises ``ValueError`` or ``TypeError`` for another scene, method or shape, and for a user's
    rate that has no derivative that compiles.
    """
    record, packed = _of_rate(scene, method)
    h, begin = checks.real("dt", dt), checks.real("t", t)
    b = checks.array("bias", bias, "(3,) or (N, 3)", [(3,), (-1, 3)]).astype(np.float64)
    one = packed.params.shape[0] == 1 and b.ndim == 1
    n = _rows(params=packed.params, bias=np.atleast_2d(b))
    turn, attitude, coupling = np.empty((n, 4)), np.empty((n, 9)), np.empty((n, 9))
    shape = (0.0,) * packed.params.shape[1]
    given = (record.tag, packed.tag, begin, h, shape, packed.params, np.atleast_2d(b))
    loop, _ = _LOOPS[packed.cacheable]
    with _differentiable("scene: rate"):
        spread(n, n_threads, partial(loop, *given, turn, attitude, coupling))
    found = Transition(turn, attitude.reshape(n, 3, 3), coupling.reshape(n, 3, 3))
    return Transition(found.turn[0], found.attitude[0], found.bias[0]) if one else found


def _rows(**arrays: NDArray[Any]) -> int:
    """The one number of rows, 1 standing for any."""
    found = {name: len(value) for name, value in arrays.items()}
    if len(set(found.values()) - {1}) > 1:
        text = ", ".join(f"{name} {n}" for name, n in found.items())
        raise ValueError(f"{next(iter(found))}: found rows {text}; accepted: one number of bodies")
    return max(found.values())


# samples


def sample_transitions(
    samples: ArrayLike,
    dt: ArrayLike,
    *,
    method: str = "previous",
    increments: bool = False,
    bias: ArrayLike = _TRIPLE,
    n_threads: int | None = None,
) -> Transition:
    """Transitions over each interval of a gyro log, of the steps that ``integrate_rates`` takes.

    ``samples`` are rates (n, 3) or (N, n, 3), rad/s, or with ``increments`` angles, rad; ``bias``
    (3,) or (N, 3), rad/s, is taken off them; ``dt`` is as for ``integrate_rates``. Gives arrays of
    one entry an interval, (n − 1, ...) or (N, n − 1, ...), of increments n. A method that works on
    several intervals at a time moves the attitude within by a bias that is one for all of them:
    Φ12 of each interval is such that those of a window combine to the window's own.

    Φ12 is exact but for rounding, some 1e-15 dt; of "picard", whose iteration is differentiated by
    differences of fourth order, 1e-12 dt.

    Raises ``ValueError`` or ``TypeError`` as ``integrate_rates`` does.
    """
    name = "samples"
    checks.choice("method", method, methods_for_samples(increments))
    record = METHODS[method]
    data = checks.array(name, samples, "(n, 3) or (N, n, 3)", [(-1, 3), (-1, -1, 3)])
    one = data.ndim == 2
    data = np.array(data[None] if one else data, dtype=np.float64)
    n_logs, n = data.shape[:2]
    m = n if increments else n - 1
    if m == 0:
        raise ValueError("samples: found one rate; accepted: at least two, or increments")
    spans = np.broadcast_to(intervals(dt, m, None, np.dtype(np.float64)), (m,))
    b = checks.array("bias", bias, "(3,) or (N, 3)", [(3,), (-1, 3)])
    if b.ndim == 2 and len(b) != n_logs:
        raise ValueError(f"bias: has shape {b.shape}; accepted: (3,) or ({n_logs}, 3), one a log")
    data -= np.atleast_2d(b)[:, None] * (spans[:, None] if increments else 1.0)
    window = WINDOWS[type(record.tag)]
    if window.tile is not None:
        found = _by_differences(data, dt, spans, method, increments)
    else:
        kind = Increments() if increments else Rates()
        before, after = beyond(data, spans, window, type(kind))
        missing = -m % window.span
        padded = np.concatenate([before[:, : window.history], data, after[:, :missing]], axis=1)
        wide = np.pad(spans, (window.history, missing), mode="edge")
        out = np.empty((n_logs, m, 4)), np.empty((n_logs, m, 9)), np.empty((n_logs, m, 9))
        shape = (0.0,) * (3 * window.samples(type(kind)))
        gaps = (0.0,) * (window.history + window.span)
        given = (record.tag, kind, padded, wide, *out, shape, gaps)
        spread(n_logs, n_threads, partial(_windows, *given))
        found = Transition(out[0], *(x.reshape(n_logs, m, 3, 3) for x in out[1:]))
    return Transition(found.turn[0], found.attitude[0], found.bias[0]) if one else found


def _by_differences(
    data: NDArray[Any], dt: ArrayLike, spans: NDArray[Any], method: str, increments: bool
) -> Transition:
    """Central differences of fourth order of what the method gives."""
    step = 2e-3 / spans.max()
    steps = step * np.array([1.0, -1.0, 2.0, -2.0])
    moved = [np.zeros(3), *(k * axis for axis in np.eye(3) for k in steps)]
    weights = spans[:, None] if increments else 1.0
    logs = np.concatenate([data - b * weights for b in moved])
    q = integrate_rates(logs, dt, method=method, increments=increments, max_gap=np.inf)
    turns = quat_multiply(q[:, :-1] * (1.0, -1.0, -1.0, -1.0), q[:, 1:])
    turns = turns.reshape(13, *data.shape[:1], *turns.shape[1:])
    turn = turns[0]
    errors = quat_to_rotation_vector(quat_multiply(turn * (1.0, -1.0, -1.0, -1.0), turns[1:]))
    e = errors.reshape(3, 4, *errors.shape[1:])
    columns = (8.0 * (e[:, 0] - e[:, 1]) - (e[:, 2] - e[:, 3])) / (12.0 * step)
    attitude = np.swapaxes(quat_to_dcm(turn), -1, -2)
    return Transition(turn, attitude, np.moveaxis(columns, 0, -1))


# bodies


def _of_body(scene: Scene, method: str | None) -> tuple[Method, Any, Any, float]:
    _scene(scene)
    if scene.kind == "rate" or scene.moves:
        raise ValueError("scene: found no inertia, or mass; accepted: a scene with inertia alone")
    fitting = [name for name in methods_for(scene, "quat") if METHODS[name].tag is not None]
    record = METHODS[checks.choice("method", "rk8" if method is None else method, fitting)]
    packed = scene.packed(None, sorted_axes=record.sorted_axes)
    edge = 0.5 * record.stages[-1][1] if record.stages else 0.0
    return record, packed, record.stages, edge


def body_tangent(
    scene: Scene,
    q: ArrayLike,
    w: ArrayLike,
    dt: float,
    *,
    t: float = 0.0,
    method: str | None = None,
    parameters: bool = False,
    n_threads: int | None = None,
) -> BodyTangent:
    """The step that a method takes of rigid bodies, and its derivatives.

    ``q`` (4,) or (N, 4), any length but zero; ``w`` (3,) or (N, 3), rad/s, body axes; the step of
    ``dt`` s starts at ``t``. ``parameters`` asks for the derivatives to principal moments and the
    torque's numbers too. Without ``method``, ``rk8``.

    The derivatives are those of the method's own formula, exact but for rounding. Splittings and
    ``dmv2`` are symplectic, and Φ is so to 1e-14; ``dmv4`` to ``dmv10``, whose moments change with
    the state, to their order only: 1.4e-5, 5e-8, 1e-10, 2e-13 at |w| h = 0.25.

    Raises ``ValueError`` or ``TypeError`` for another scene, method or shape, and for a user's
    torque that has no derivative that compiles.
    """
    record, packed, stages, edge = _of_body(scene, method)
    h, begin = checks.real("dt", dt), checks.real("t", t)
    attitudes = checks.attitudes("q", q)
    w = checks.array("w", w, "(3,) or (N, 3)", [(3,), (-1, 3)])
    params = np.atleast_2d(packed.params)
    one = attitudes.ndim == 1 and w.ndim == 1 and packed.params.ndim == 1
    q_rows, w_rows = (np.atleast_2d(x).astype(np.float64) for x in (attitudes, w))
    n = _rows(q=q_rows, w=w_rows, scene=params)
    own = tangent.own_numbers(packed.tag.torque)
    size = 9 + sum(own) if parameters else 6
    q1, w1, phi = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 6 * size))
    wanted = tangent.WithParameters() if parameters else tangent.StateOnly()
    shape = (0.0,) * params.shape[1]
    given = (wanted, record.tag, packed.tag, stages, edge, begin, h, shape, params, q_rows, w_rows)
    _, loop = _LOOPS[packed.cacheable]
    with _differentiable("scene: torque"):
        spread(n, n_threads, partial(loop, *given, q1, w1, phi))
    full = phi.reshape(n, 6, size)
    matrix, inertia, torque = full[:, :, :6], None, None
    if parameters:
        inertia, torque = full[:, :, 6:9], full[:, :, 9:]
        if record.sorted_axes and not is_sorted(scene.principal.moments):
            order = np.argsort(np.argsort(np.atleast_2d(scene.principal.moments), axis=-1), axis=-1)
            inertia = np.take_along_axis(inertia, np.broadcast_to(order[:, None], inertia.shape), 2)
    found: tuple[Any, ...] = (q1, w1, matrix, inertia, torque)
    return BodyTangent(*(x if x is None or not one else x[0] for x in found))


def step_tangent(scene: Scene, *, method: str | None = None) -> StepTangent:
    """The derivative of one step as a function for ``@njit`` code, tuples in and tuples out.

    Of a scene with a rate along body axes, ``step(t, h, b, p)`` gives (turn, Φ11, Φ12) at the rate
    less the gyro's bias b (3,), as :class:`Transition`; without ``method``, magnus4. Of a rigid
    body ``step(t, h, q, m, p)`` gives (q, m, Φ) after the step from the unit quaternion q and the
    momentum m, N·m·s along body axes, Φ 36 numbers row by row, as :class:`BodyTangent`. p is
    ``params``, or a row of them; quaternions and matrices are flat tuples.

    Raises ``ValueError`` or ``TypeError`` for another scene or method.
    """
    if _scene(scene).kind == "rate":
        record, packed = _of_rate(scene, method or "magnus4")
        made = _rate_function(record.tag, packed.tag, (0.0,) * packed.params.shape[1])
        params = packed.params[0] if len(packed.params) == 1 else packed.params
    else:
        record, packed, stages, edge = _of_body(scene, method)
        params = packed.params
        made = _body_function(record.tag, packed.tag, stages, edge, (0.0,) * params.shape[-1])
    return StepTangent(
        method=record.name,
        params=tuple(params) if params.ndim == 1 else params,
        step=kernel(made, cache=packed.cacheable),
    )


# closures over tags and numbers alone, which Numba's disk cache knows again


def _rate_function(tag: Any, model: Any, shape: Any) -> Any:
    def step(t, h, b, p):
        return tangent.rate_tangent(tag, model, t, h, b, flat(p, shape))

    return step


def _body_function(tag: Any, model: Any, stages: Any, edge: float, shape: Any) -> Any:
    wanted = tangent.StateOnly()

    def step(t, h, q, m, p):
        numbers = flat(p, shape)
        q, m, phi, _ = tangent.body_tangent(wanted, tag, model, stages, edge, t, h, q, m, numbers)
        return q, m, phi

    return step


def sample_tangent(method: str = "previous", *, increments: bool = False) -> Any:
    """The same of a method for gyro samples, ``f(v, h)``, a function for ``@njit`` code.

    v are the window's samples less the bias, flat, and h its intervals (s), as the functions of
    ``fastatt.steps`` take them in this order. Gives (turn, Φ11, Φ12) of each interval that the
    method steps over, one after the other.

    Raises ``ValueError`` for another method, or one that has no such function ("picard").
    """
    fitting = [
        name
        for name in methods_for_samples(increments)
        if WINDOWS[type(METHODS[name].tag)].tile is None
    ]
    tag = METHODS[checks.choice("method", method, fitting)].tag
    kind = Increments() if increments else Rates()

    def window(v, h):
        return tangent.window_tangent(tag, kind, v, h)

    return kernel(window)
