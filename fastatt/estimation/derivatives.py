"""Transitions and derivatives of the steps of methods, for arrays and for jitted code."""

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
from fastatt.gyro.integrate import method_of as sample_method_of
from fastatt.gyro.intervals import intervals
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import method_of
from fastatt.scene.equations import PrescribedRate
from fastatt.scene.inertia import axis_order
from fastatt.scene.models import Packed
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of

_TRIPLE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Transition:
    """Transition of an attitude error and a gyro bias over a step: δθ ← Φ11 δθ + Φ12 δb.

    Attributes
    ----------
    rotation : ndarray of shape (..., 4)
        Quaternion δq of the step, q_end = q∘δq.
    attitude : ndarray of shape (..., 3, 3)
        Φ11.
    bias : ndarray of shape (..., 3, 3)
        Φ12, s.
    """

    rotation: NDArray[Any]
    attitude: NDArray[Any]
    bias: NDArray[Any]

    @property
    def matrix(self) -> NDArray[Any]:
        """Φ (..., 6, 6) of (δθ, δb), for a constant bias."""
        out = np.zeros((*self.attitude.shape[:-2], 6, 6), dtype=self.attitude.dtype)
        out[..., :3, :3] = self.attitude
        out[..., :3, 3:] = self.bias
        out[..., 3:, 3:] = np.eye(3)
        return out


@dataclass(frozen=True, eq=False)
class BodyTangent:
    """A body's step and its derivatives, as :func:`body_tangent` computes them.

    Attributes
    ----------
    q : ndarray of shape (..., 4)
        Attitude after the step; NaN if an implicit step did not converge.
    w : ndarray of shape (..., 3)
        Angular velocity after the step, rad/s.
    matrix : ndarray of shape (..., 6, 6)
        Derivative of (δθ, δm) after the step by that before, δm = I δw, N·m·s along body axes.
    inertia : ndarray of shape (..., 6, 3), or None
        Derivatives of (θ, m) by the principal moments, at the same initial m.
    torque : ndarray of shape (..., 6, P), or None
        Derivatives of (θ, m) by the parameters of the torque's model, in the order of its fields.
    """

    q: NDArray[Any]
    w: NDArray[Any]
    matrix: NDArray[Any]
    inertia: NDArray[Any] | None = None
    torque: NDArray[Any] | None = None

    def adjoint(self, after: ArrayLike) -> NDArray[Any]:
        """Gradient with respect to the state before the step, Φᵀ λ.

        Parameters
        ----------
        after : array_like of shape (..., 6)
            Gradient λ with respect to (θ, m) after the step.

        Returns
        -------
        ndarray of shape (..., 6)
            Gradient with respect to (θ, m) before the step.
        """
        return np.asarray(np.einsum("...ji,...j->...i", self.matrix, np.asarray(after)))


@dataclass(frozen=True, eq=False)
class StepTangent:
    """The compiled derivative of one scene's step; :func:`step_tangent` makes it.

    Attributes
    ----------
    method : str
        Name of the method.
    params : tuple or ndarray of shape (N, P)
        Flat parameters for ``step``; an array has a row for each body.
    step : callable
        The function, for Python and jitted code.
    """

    method: str
    #: flat parameters: a tuple, or (N, P) with a row for each body
    params: Any
    step: Any


# prescribed rates


# samples


def sample_transitions(
    rates: ArrayLike,
    dt: ArrayLike,
    *,
    method: str = "previous",
    increments: bool = False,
    bias: ArrayLike = _TRIPLE,
    n_threads: int | None = None,
) -> Transition:
    """Transitions over each interval of a gyro log, for the steps of ``integrate_rates``.

    Parameters
    ----------
    rates : array_like of shape (n, 3) or (N, n, 3)
        Rates, rad/s, or with ``increments`` angle increments, rad, along body axes.
    dt : float or array_like
        The interval, or the intervals, s, as in :func:`fastatt.integrate_rates`.
    method : str, default "previous"
        A method for samples. "picard", which iterates, has no transitions.
    increments : bool, default False
        Whether ``rates`` are angle increments.
    bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Bias that is subtracted from the rates, rad/s.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.integrate_rates`.

    Returns
    -------
    Transition
        Arrays with an entry for each interval: (n - 1, ...) or (N, n - 1, ...), for increments n.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`fastatt.integrate_rates`.

    Notes
    -----
    Φ12 is exact to rounding, some 1e-15 dt. A method that works on several intervals at a time
    assumes one bias for all of them: Φ12 of each interval is such that the intervals of a window
    combine to the window's transition.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> found = fa.estimation.sample_transitions(np.zeros((5, 3)), 0.1)
    >>> found.matrix.shape
    (4, 6, 6)
    """
    record = sample_method_of(method, increments, iterates=False)
    data = checks.array("rates", rates, "(n, 3) or (N, n, 3)")
    one = data.ndim == 2
    data = np.array(data[None] if one else data, dtype=np.float64)
    n_logs, n = data.shape[:2]
    m = n if increments else n - 1
    if m == 0:
        raise ValueError("rates: found one rate; accepted: at least two, or increments")
    spans = np.broadcast_to(intervals(dt, m, None, np.dtype(np.float64)), (m,))
    b = triples("bias", bias, n_logs)
    data -= b[:, None] * (spans[:, None] if increments else 1.0)
    window = record.window
    # extrapolated samples complete the first and the last window
    missing = -m % window.span
    before, after = beyond(data, spans, window, increments, missing)
    padded = np.concatenate([before, data, after], axis=1)
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
    """The method's record and the scene's parameters for its derivatives; raises ``ValueError``."""
    as_scene(scene)
    if scene.kind == "rate" or scene.is_coupled:
        raise ValueError(
            "scene: found no inertia, or mass or states; accepted: a scene with inertia alone"
        )
    record = method_of(scene, method, "quat", stepped=True)
    return record, scene.packed(None, sorted_axes=record.sorted_axes)


def tangent_rows(
    record: Method,
    packed: Packed,
    times: tuple[Any, float],
    state: tuple[NDArray[Any], NDArray[Any]],
    n_threads: int | None,
    parameters: bool = False,
) -> tuple[NDArray[Any], ...]:
    """q, w and the rows (..., 7, D) after a step of h s from times and states that broadcast.

    The quaternions are not normalised before the step.
    """
    (t, h), (q, w) = times, state
    q1, w1, phi, z = _body_rows(record, packed.structure.rotation, parameters)(
        t, h, q, w, np.atleast_2d(packed.params), tables=packed.tables,
        n_threads=number_of(n_threads),
    )  # fmt: skip
    # an iteration that did not converge gives an infinite angle
    phi[~np.isfinite(z)] = np.nan
    rows = tangent.ANY_LENGTH
    return q1, w1, phi.reshape(*phi.shape[:-1], rows, phi.shape[-1] // rows)


@lru_cache(maxsize=64)
def _body_rows(record: Method, structure: Any, parameters: bool) -> RowFunction:
    formula = tangent.body_tangent(record, structure, parameters=parameters, of_rate=True)
    state = tangent.ANY_LENGTH
    size = tangent.directions(structure, state, parameters=parameters)
    inputs = {"t": None, "h": None, "q": 4, "w": 3, "p": structure.n_params}
    return RowFunction(formula, inputs, (4, 3, state * size, None))


def body_tangent(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike,
    dt: float,
    *,
    t0: float = 0.0,
    method: str | Method | None = None,
    parameters: bool = False,
    n_threads: int | None = None,
) -> BodyTangent:
    """One step of rigid bodies by a method, and its derivatives.

    Parameters
    ----------
    scene : Scene
        A scene with inertia, without mass and states.
    q0 : array_like of shape (4,) or (N, 4)
        Attitudes before the step, body to inertial, of any norm above zero.
    w0 : array_like of shape (3,) or (N, 3)
        Angular velocities before the step along body axes, rad/s.
    dt : float
        Step size, s.
    t0 : float, default 0.0
        Time at which the step begins, s.
    method : str or Method, optional
        The method; the default is rk8.
    parameters : bool, default False
        Also compute the derivatives by the principal moments and the torque's parameters.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.

    Returns
    -------
    BodyTangent
        The state after the step, and its derivatives.

    Raises
    ------
    ValueError, TypeError
        If the scene, the method or a shape does not fit.

    Notes
    -----
    The derivatives are those of the method's formulas, exact to rounding. For a user-defined torque
    that is not followed they are central differences with an error of some 1e-10. Φ of splitting
    methods and of ``dmv2`` is symplectic to 1e-14. That of ``dmv10``, whose moments depend on the
    state, is symplectic to its order: to 2e-13 at ``|w| h`` = 0.25.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 1.4))
    >>> step = fa.estimation.body_tangent(body, [1, 0, 0, 0], [0, 0, 1], 0.1, method="strang2")
    >>> step.matrix.shape
    (6, 6)
    """
    record, packed = of_body(scene, method)
    checks.flag("parameters", parameters)
    h, begin = checks.real("dt", dt), checks.real("t0", t0)
    attitudes = checks.attitudes("q0", q0)
    w = checks.array("w0", w0, "(3,) or (N, 3)")
    params = np.atleast_2d(packed.params)
    one = attitudes.ndim == 1 and w.ndim == 1 and packed.params.ndim == 1
    q_rows, w_rows = (np.atleast_2d(x).astype(np.float64) for x in (attitudes, w))
    common_number("bodies", q0=q_rows, w0=w_rows, scene=params)
    state = normalised(q_rows), w_rows
    *moved, full = tangent_rows(record, packed, (begin, h), state, n_threads, parameters)
    inertia, torque = None, None
    if parameters:
        inertia, torque = np.split(full[:, :6, tangent.ANY_LENGTH :], [3], axis=2)
        if record.sorted_axes:
            order = axis_order(np.atleast_2d(scene.principal.moments))
            places = np.broadcast_to(np.argsort(order, axis=-1)[:, None], inertia.shape)
            inertia = np.take_along_axis(inertia, places, axis=2)
    results: tuple[Any, ...] = (*moved, full[:, :6, :6], inertia, torque)
    return BodyTangent(*(x if x is None or not one else x[0] for x in results))


def step_tangent(scene: Scene, *, method: str | Method | None = None) -> StepTangent:
    """The derivative of one step as a function for jitted code, from tuples to tuples.

    Parameters
    ----------
    scene : Scene
        A scene with a rate along body axes, or with inertia.
    method : str or Method, optional
        The method; the default is magnus4 for a rate and rk8 for a body.

    Returns
    -------
    StepTangent
        The function and its parameters.

    Raises
    ------
    ValueError, TypeError
        If the scene or the method does not fit. ``step`` raises ``ValueError`` for an array p that
        is too short.

    Notes
    -----
    For a rate, ``step(t, h, b, p)`` returns (δq, Φ11, Φ12) at the rate less the gyro's bias b
    (3,), as in :class:`Transition`. For a body, ``step(t, h, q, m, p)`` returns (q, m, Φ) after the
    step from the unit quaternion q and the angular momentum m, N·m·s along body axes, with the 36
    numbers of Φ row by row, as in :class:`BodyTangent`. p is ``params``, or a row of it.
    Quaternions and matrices are flat tuples. For a user-defined torque that is not followed,
    derivatives are central differences with an error of some 1e-10.

    Examples
    --------
    >>> import fastatt as fa
    >>> tangent = fa.estimation.step_tangent(fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.5))))
    >>> tangent.method
    'magnus4'
    """
    of_rate = as_scene(scene).kind == "rate"
    named = "magnus4" if method is None else method
    record, packed = _of_rate(scene, named) if of_rate else of_body(scene, method)
    structure, tables = packed.structure.rotation, packed.tables
    # compiled once for all scenes that differ in their numbers only
    step = _step_function(record, structure, tables) if tables else _memoised(record, structure)
    params = packed.params[0] if packed.params.shape[:-1] == (1,) else packed.params
    return StepTangent(record.name, tuple(params.tolist()) if params.ndim == 1 else params, step)


def _of_rate(scene: Scene, method: str | Method) -> tuple[Method, Packed]:
    as_scene(scene)
    if scene.kind != "rate" or scene.frame != "body" or scene.is_coupled:
        raise ValueError(
            "scene: found one with inertia, mass, states or rates in inertial axes; accepted: a "
            "scene with a rate in body axes"
        )
    return method_of(scene, method, "quat", stepped=True), scene.packed(None)


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


_memoised = lru_cache(maxsize=128)(_step_function)
