"""Transitions and tangents of the steps that methods take, of arrays and for ``@njit`` code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import around_formulas, enough
from fastatt.arrays import normalised
from fastatt.codegen.rows import RowFunction
from fastatt.codegen.scalar import scalar_function
from fastatt.estimation import tangent
from fastatt.estimation.amounts import common_number, triples
from fastatt.gyro.ends import beyond
from fastatt.gyro.integrate import intervals, methods_for_samples
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import method_of
from fastatt.scene.equations import PrescribedRate
from fastatt.scene.inertia import axis_order
from fastatt.scene.models import Packed
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of

_TRIPLE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Transition:
    """Transition of an attitude's error and a gyro's bias over a step: δθ ← Φ11 δθ + Φ12 δb.

    ``turn`` (..., 4) is the quaternion of the step, q_end = q∘δq; ``attitude`` (..., 3, 3) Φ11;
    ``bias`` (..., 3, 3) Φ12, s.
    """

    turn: NDArray[Any]
    attitude: NDArray[Any]
    bias: NDArray[Any]

    @property
    def matrix(self) -> NDArray[Any]:
        """Φ (..., 6, 6) of (δθ, δb), the bias constant."""
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
    """The compiled derivative of one scene's step; see :func:`step_tangent`.

    Of a body under a user's torque that can't be traced the derivatives of that torque are central
    differences, good to some 1e-10; all others are exact but for rounding.
    """

    method: str
    #: flat parameters: a tuple, or (N, P) with a row for each body
    params: Any
    step: Any


# given rates


def _of_rate(scene: Scene, method: str | Method) -> tuple[Method, Packed]:
    as_scene(scene)
    if scene.kind != "rate" or scene.frame != "body" or scene.is_coupled:
        raise ValueError(
            "scene: found one with inertia, mass, states or rates in inertial axes; accepted: a "
            "scene with a rate in body axes"
        )
    return method_of(scene, method, "quat", need="is_stepped"), scene.packed(None)


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

    Φ12 is exact but for rounding, some 1e-15 dt. "picard", which iterates, has no transitions here.

    Raises ``ValueError`` or ``TypeError`` as ``integrate_rates`` does.
    """
    names = methods_for_samples(increments)
    fitting = [name for name in names if METHODS[name].window.iteration is None]
    record = METHODS[checks.choice("method", method, fitting)]
    data = checks.array("samples", samples, "(n, 3) or (N, n, 3)")
    one = data.ndim == 2
    data = np.array(data[None] if one else data, dtype=np.float64)
    n_logs, n = data.shape[:2]
    m = n if increments else n - 1
    if m == 0:
        raise ValueError("samples: found one rate; accepted: at least two, or increments")
    spans = np.broadcast_to(intervals(dt, m, None, np.dtype(np.float64)), (m,))
    b = triples("bias", bias, n_logs)
    data -= b[:, None] * (spans[:, None] if increments else 1.0)
    window = record.window
    before, after = beyond(data, spans, window, increments)
    # samples beyond the ends of the log complete the first and the last window
    missing = -m % window.span
    history = before[:, before.shape[1] - window.history :]
    padded = np.concatenate([history, data, after[:, :missing]], axis=1)
    wide = np.pad(spans, (window.history, missing), mode="edge")
    v = sliding_window_view(padded, window.samples(increments), axis=1)[:, :: window.span]
    v = np.swapaxes(v, 2, 3).reshape(*v.shape[:2], -1)
    h = sliding_window_view(wide, window.intervals)[:: window.span]
    out = _window_rows(record, increments)(v, h, n_threads=number_of(n_threads))
    turn, attitude, coupling = (
        np.stack(out[k::3], axis=2).reshape(n_logs, -1, *shape)[:, :m]
        for k, shape in enumerate(((4,), (3, 3), (3, 3)))
    )
    log = 0 if one else slice(None)
    return Transition(turn[log], attitude[log], coupling[log])


@lru_cache(maxsize=64)
def _window_rows(record: Method, increments: bool) -> RowFunction:
    window = record.window
    formula = tangent.window_tangent(window, increments=increments)
    inputs = {"v": 3 * window.samples(increments), "h": window.intervals}
    return RowFunction(formula, inputs, (4, 9, 9) * window.span)


# bodies


def of_body(scene: Scene, method: str | Method | None) -> tuple[Method, Packed]:
    """The method's record and the scene ready for its tangent, else ``ValueError``."""
    as_scene(scene)
    if scene.kind == "rate" or scene.is_coupled:
        raise ValueError(
            "scene: found no inertia, or mass or states; accepted: a scene with inertia alone"
        )
    record = method_of(scene, method, "quat", need="is_stepped")
    return record, scene.packed(None, sorted_axes=record.sorted_axes)


@lru_cache(maxsize=64)
def _body_rows(record: Method, structure: Any, parameters: bool) -> RowFunction:
    formula = tangent.body_tangent(record, structure, parameters=parameters, of_rate=True)
    state = tangent.ANY_LENGTH
    size = tangent.directions(structure, state, parameters=parameters)
    inputs = {"t": None, "h": None, "q": 4, "w": 3, "p": structure.n_params}
    return RowFunction(formula, inputs, (4, 3, state * size, None))


def tangent_rows(
    record: Method,
    packed: Packed,
    times: tuple[Any, float],
    state: tuple[NDArray[Any], NDArray[Any]],
    n_threads: int | None,
    parameters: bool = False,
) -> tuple[NDArray[Any], ...]:
    """q, w and the rows (..., 7, D) after a step of h s from times and states that broadcast.

    The quaternions are stepped with the length that they have.
    """
    (t, h), (q, w) = times, state
    q1, w1, phi, z = _body_rows(record, packed.structure.turning, parameters)(
        t, h, q, w, np.atleast_2d(packed.params), tables=packed.tables,
        n_threads=number_of(n_threads),
    )  # fmt: skip
    # an iteration that did not converge says so by an infinite angle
    phi[~np.isfinite(z)] = np.nan
    rows = tangent.ANY_LENGTH
    return q1, w1, phi.reshape(*phi.shape[:-1], rows, phi.shape[-1] // rows)


def body_tangent(
    scene: Scene,
    q: ArrayLike,
    w: ArrayLike,
    dt: float,
    *,
    t: float = 0.0,
    method: str | Method | None = None,
    parameters: bool = False,
    n_threads: int | None = None,
) -> BodyTangent:
    """The step that a method takes of rigid bodies, and its derivatives.

    ``q`` (4,) or (N, 4), any length but zero; ``w`` (3,) or (N, 3), rad/s, body axes; the step of
    ``dt`` s starts at ``t``. ``parameters`` asks for the derivatives to principal moments and the
    torque's numbers too. Without ``method``, ``rk8``.

    The derivatives are those of the method's own formula, exact but for rounding; of a user's
    torque that can't be traced they are central differences, good to some 1e-10. Splittings and
    ``dmv2`` are symplectic, and Φ is so to 1e-14; ``dmv4`` to ``dmv10``, whose moments change with
    the state, to their order only: 1.4e-5, 5e-8, 1e-10, 2e-13 at |w| h = 0.25.

    Raises ``ValueError`` or ``TypeError`` for another scene, method or shape.
    """
    record, packed = of_body(scene, method)
    h, begin = checks.real("dt", dt), checks.real("t", t)
    attitudes = checks.attitudes("q", q)
    w = checks.array("w", w, "(3,) or (N, 3)")
    params = np.atleast_2d(packed.params)
    one = attitudes.ndim == 1 and w.ndim == 1 and packed.params.ndim == 1
    q_rows, w_rows = (np.atleast_2d(x).astype(np.float64) for x in (attitudes, w))
    common_number("bodies", q=q_rows, w=w_rows, scene=params)
    state = normalised(q_rows), w_rows
    *moved, full = tangent_rows(record, packed, (begin, h), state, n_threads, parameters)
    inertia, torque = None, None
    if parameters:
        inertia, torque = np.split(full[:, :6, tangent.ANY_LENGTH :], [3], axis=2)
        if record.sorted_axes:
            order = axis_order(np.atleast_2d(scene.principal.moments))
            places = np.broadcast_to(np.argsort(order, axis=-1)[:, None], inertia.shape)
            inertia = np.take_along_axis(inertia, places, axis=2)
    found: tuple[Any, ...] = (*moved, full[:, :6, :6], inertia, torque)
    return BodyTangent(*(x if x is None or not one else x[0] for x in found))


def step_tangent(scene: Scene, *, method: str | Method | None = None) -> StepTangent:
    """The derivative of one step as a function for ``@njit`` code, tuples in and tuples out.

    Of a scene with a rate along body axes, ``step(t, h, b, p)`` gives (turn, Φ11, Φ12) at the rate
    less the gyro's bias b (3,), as :class:`Transition`; without ``method``, magnus4. Of a rigid
    body ``step(t, h, q, m, p)`` gives (q, m, Φ) after the step from the unit quaternion q and the
    momentum m, N·m·s along body axes, Φ 36 numbers row by row, as :class:`BodyTangent`. p is
    ``params``, or a row of them; quaternions and matrices are flat tuples.

    Raises ``ValueError`` or ``TypeError`` for another scene or method, and ``step`` for an array p
    that is too short.
    """
    of_rate = as_scene(scene).kind == "rate"
    record, packed = _of_rate(scene, method or "magnus4") if of_rate else of_body(scene, method)
    structure, tables = packed.structure.turning, packed.tables
    # compiled once for all scenes that differ in numbers alone
    made = _step_function(record, structure, tables) if tables else _kept(record, structure)
    params = packed.params[0] if packed.params.shape[:-1] == (1,) else packed.params
    return StepTangent(record.name, tuple(params.tolist()) if params.ndim == 1 else params, made)


def _step_function(record: Method, structure: Any, tables: Mapping[int, Any] | None = None) -> Any:
    n, of_rate = structure.n_params, isinstance(structure, PrescribedRate)
    tangent_of: Any = tangent.rate_tangent if of_rate else tangent.body_tangent
    formula = scalar_function(tangent_of(record, structure), tables, arrays={"p": n})
    check_p = enough("p", n)

    def step_of_rate(t, h, b, p):
        check_p(p)
        return formula(t, h, b, p)

    def step_of_body(t, h, q, m, p):
        check_p(p)
        return formula(t, h, q, m, p)

    return around_formulas(step_of_rate if of_rate else step_of_body)


_kept = lru_cache(maxsize=128)(_step_function)
