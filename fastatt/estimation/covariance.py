"""Attitude and gyro bias: transitions, noise, covariances and Jacobians of arrays.

The formulas and conventions are those of ``fastatt.kernels.error_state`` and ``so3``: the error is
C_true = C exp [δθ] in body axes, and matrices (..., 6, 6) are for (δθ, δb).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_to_dcm
from fastatt.codegen.rows import precision_of, rows
from fastatt.estimation.amounts import at_least_zero, common_number, covariances, interval
from fastatt.tracing.formulas import Vector, kernels, scale, so3

Formula = Callable[..., Any]

error_state = kernels("error_state")


def right_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Right Jacobian Jr of rotation vectors: exp(u + δ) ≈ exp(u) exp(Jr δ).

    Parameters
    ----------
    u : array_like of shape (3,) or (N, 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray of shape (3, 3) or (N, 3, 3)
        Jr.

    Raises
    ------
    ValueError
        If the shape is another one.

    Notes
    -----
    The error is at most 1e-15 for ``|u|`` ≤ π, and 3e-16 ``|u|`` beyond.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.estimation.right_jacobian([0.0, 0.0, 0.0]).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    return _apply(so3.right_jacobian, 3, u=_vectors("u", u))


def _apply(formula: Formula, side: int, **arrays: NDArray[Any]) -> NDArray[Any]:
    """Apply a formula to arrays (..., width), or numbers (), by name: (..., side, side)."""
    inputs = {name: x.shape[-1] if x.ndim else None for name, x in arrays.items()}
    precision = precision_of(np.result_type(*arrays.values()))
    (flat,) = rows(formula, inputs, (side * side,), precision)(*arrays.values())
    return flat.reshape(*flat.shape[:-1], side, side)


def _vectors(name: str, value: ArrayLike) -> NDArray[Any]:
    return checks.array(name, value, "(3,) or (N, 3)")


def left_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Left Jacobian Jl = Jrᵀ of rotation vectors: exp(u + δ) ≈ exp(Jl δ) exp(u).

    Parameters
    ----------
    u : array_like of shape (3,) or (N, 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray of shape (3, 3) or (N, 3, 3)
        Jl.

    Raises
    ------
    ValueError
        If the shape is another one.

    Notes
    -----
    The error is that of :func:`right_jacobian`.
    """
    return _apply(so3.left_jacobian, 3, u=_vectors("u", u))


def right_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Inverse of the right Jacobian of rotation vectors, which is singular at ``|u|`` = 2π.

    Parameters
    ----------
    u : array_like of shape (3,) or (N, 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray of shape (3, 3) or (N, 3, 3)
        Jr⁻¹.

    Raises
    ------
    ValueError
        If the shape is another one.

    See Also
    --------
    right_jacobian : The Jacobian.
    """
    return _apply(so3.right_jacobian_inverse, 3, u=_vectors("u", u))


def left_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Inverse of the left Jacobian of rotation vectors, which is singular at ``|u|`` = 2π.

    Parameters
    ----------
    u : array_like of shape (3,) or (N, 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray of shape (3, 3) or (N, 3, 3)
        Jl⁻¹.

    Raises
    ------
    ValueError
        If the shape is another one.

    See Also
    --------
    left_jacobian : The Jacobian.
    """
    return _apply(so3.left_jacobian_inverse, 3, u=_vectors("u", u))


def transition_matrix(w: ArrayLike, dt: float) -> NDArray[Any]:
    """Transition matrix Φ of (δθ, δb) at constant rates.

    Parameters
    ----------
    w : array_like of shape (3,) or (N, 3)
        Rates along body axes, less the bias, rad/s.
    dt : float
        Interval, s.

    Returns
    -------
    ndarray of shape (6, 6) or (N, 6, 6)
        Φ.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Notes
    -----
    This is also the transition of the methods "lie_euler" and "hold". Φ12 of a method with more
    nodes contains commutators, which are 3.6 % of it for coning of 0.3 rad at ``|w| h`` = 0.37; see
    :func:`step_tangent`.

    Examples
    --------
    >>> import fastatt as fa
    >>> phi = fa.estimation.transition_matrix([0.0, 0.0, 0.0], 0.1)
    >>> phi.shape, float(phi[0, 3])
    ((6, 6), -0.1)
    """
    return _over(_transition, w, dt)


def _over(
    formula: Formula,
    w: ArrayLike,
    dt: float,
    covariance: NDArray[Any] | None = None,
    **densities: float,
) -> NDArray[Any]:
    """Apply a formula to rates over ``dt`` s, with noise densities and covariances, if any."""
    rates = _vectors("w", w)
    inputs = {"w": rates, "h": np.array(interval(dt), dtype=rates.dtype)}
    if densities:
        variances = [at_least_zero(*density) ** 2 for density in densities.items()]
        inputs["v"] = np.array(variances, dtype=rates.dtype)
    if covariance is not None:
        inputs["p"] = covariance
        _same_rows(covariance=covariance, w=rates)
    return _apply(formula, 6, **inputs)


def _same_rows(**arrays: NDArray[Any]) -> None:
    common_number("rows", **{name: x for name, x in arrays.items() if x.ndim == 2})


def _transition(w: Vector, h: Any) -> Any:
    return error_state.transition_matrix(error_state.transition(scale(h, w), h))


def process_noise(
    w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float
) -> NDArray[Any]:
    """Covariance Q of (δθ, δb) by white noise of a gyro at constant rates.

    Parameters
    ----------
    w : array_like of shape (3,) or (N, 3)
        Rates along body axes, rad/s.
    dt : float
        Interval, s, above 0.
    angle_noise : float
        σ_v, rad/√s (angle random walk).
    bias_noise : float
        σ_u, rad/s^1.5 (rate random walk).

    Returns
    -------
    ndarray of shape (6, 6) or (N, 6, 6)
        Q, exact for rotating bodies; for w = 0 it is Farrenkopf's matrix.

    Raises
    ------
    ValueError, TypeError
        If a shape is another one, an interval is not above 0, or a density is negative.

    References
    ----------
    Farrenkopf, *Journal of Guidance and Control* 1 (1978) 282.

    Examples
    --------
    >>> import fastatt as fa
    >>> Q = fa.estimation.process_noise([0.0, 0.0, 0.1], 0.1, angle_noise=1e-3, bias_noise=0.0)
    >>> f"{Q[0, 0]:.1e}"
    '1.0e-07'
    """
    return _over(_noise, w, dt, angle_noise=angle_noise, bias_noise=bias_noise)


def _noise(w: Vector, h: Any, v: Vector) -> Any:
    return error_state.matrix(error_state.noise(scale(h, w), h, *v))


def predict_covariance(
    covariance: ArrayLike, w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float
) -> NDArray[Any]:
    """Propagate a covariance of (δθ, δb) over an interval: Φ P Φᵀ + Q.

    Parameters
    ----------
    covariance : array_like of shape (6, 6) or (N, 6, 6)
        P, in rad and rad/s.
    w : array_like of shape (3,) or (N, 3)
        Rates along body axes, less the bias, rad/s.
    dt : float
        Interval, s.
    angle_noise : float
        σ_v, rad/√s, as in :func:`process_noise`.
    bias_noise : float
        σ_u, rad/s^1.5, as in :func:`process_noise`.

    Returns
    -------
    ndarray of shape (6, 6) or (N, 6, 6)
        The covariance after the interval, with Φ of :func:`transition_matrix`.

    Raises
    ------
    ValueError, TypeError
        If ``covariance`` is not a covariance, or another argument does not fit.
    """
    P = _covariances(covariance)
    return _over(_predict, w, dt, P, angle_noise=angle_noise, bias_noise=bias_noise)


def _covariances(covariance: ArrayLike) -> NDArray[Any]:
    matrices = covariances("covariance", covariance, "(6, 6) or (N, 6, 6)")
    return matrices.reshape(*matrices.shape[:-2], 36)


def _predict(w: Vector, h: Any, v: Vector, p: Vector) -> Any:
    u = scale(h, w)
    phi, noise = error_state.transition(u, h), error_state.noise(u, h, *v)
    return error_state.matrix(error_state.predict(error_state.blocks(p), phi, noise))


def covariance_to_inertial(covariance: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """Convert a covariance of (δθ, δb) to errors along inertial axes, C_true = exp [δθ] C.

    Parameters
    ----------
    covariance : array_like of shape (6, 6) or (N, 6, 6)
        Covariance of errors along body axes.
    q : array_like of shape (4,) or (N, 4)
        Attitudes, body to inertial, of any norm above zero.

    Returns
    -------
    ndarray of shape (6, 6) or (N, 6, 6)
        Covariance of errors along inertial axes.

    Raises
    ------
    ValueError, TypeError
        If ``covariance`` is not a covariance, or a shape does not fit.
    """
    return _turned(_to_inertial, covariance, q)


def _to_inertial(c: Vector, p: Vector) -> Any:
    return error_state.matrix(error_state.to_inertial(c, error_state.blocks(p)))


def covariance_to_body(covariance: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """Convert a covariance of (δθ, δb) from errors along inertial axes to errors along body axes.

    Parameters
    ----------
    covariance : array_like of shape (6, 6) or (N, 6, 6)
        Covariance of errors along inertial axes, C_true = exp [δθ] C.
    q : array_like of shape (4,) or (N, 4)
        Attitudes, body to inertial, of any norm above zero.

    Returns
    -------
    ndarray of shape (6, 6) or (N, 6, 6)
        Covariance of errors along body axes.

    Raises
    ------
    ValueError, TypeError
        If ``covariance`` is not a covariance, or a shape does not fit.
    """
    return _turned(_to_body, covariance, q)


def _to_body(c: Vector, p: Vector) -> Any:
    return error_state.matrix(error_state.to_body(c, error_state.blocks(p)))


def _turned(formula: Formula, covariance: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    p, attitudes = _covariances(covariance), checks.attitudes("q", q)
    _same_rows(covariance=p, q=attitudes)
    c = quat_to_dcm(normalised(attitudes))
    return _apply(formula, 6, c=c.reshape(*c.shape[:-2], 9), p=p)
