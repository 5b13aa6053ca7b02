"""Attitude and gyro bias: transitions, noise, covariances and Jacobians of arrays.

The formulas and conventions are those of ``fastatt.kernels.error_state`` and ``so3``: the error is
C_true = C exp [δθ], in body axes; matrices (..., 6, 6) are of (δθ, δb).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, kernels
from fastatt.arrays import normalised, quat_to_dcm
from fastatt.codegen.rows import kind_of, rows
from fastatt.estimation.amounts import at_least_zero, common_number, covariances, interval
from fastatt.tracing.formulas import Vector, scale
from fastatt.tracing.trace import stand_in

Formula = Callable[..., Any]

so3: Any = stand_in(kernels.so3)
error_state: Any = stand_in(kernels.error_state)


# formulas on the numbers of a row


def _transition(w: Vector, h: Any) -> Any:
    return error_state.transition_matrix(error_state.transition(scale(h, w), h))


def _noise(w: Vector, h: Any, v: Vector) -> Any:
    return error_state.matrix(error_state.noise(scale(h, w), h, *v))


def _noise_at_rest(w: Vector, h: Any, v: Vector) -> Any:
    return error_state.matrix(error_state.noise_at_rest(h, *v))


def _predict(w: Vector, h: Any, v: Vector, p: Vector) -> Any:
    u = scale(h, w)
    phi, noise = error_state.transition(u, h), error_state.noise(u, h, *v)
    return error_state.matrix(error_state.predict(error_state.blocks(p), phi, noise))


def _to_inertial(c: Vector, p: Vector) -> Any:
    return error_state.matrix(error_state.to_inertial(c, error_state.blocks(p)))


def _to_body(c: Vector, p: Vector) -> Any:
    return error_state.matrix(error_state.to_body(c, error_state.blocks(p)))


def _apply(formula: Formula, side: int, **arrays: NDArray[Any]) -> NDArray[Any]:
    """A formula of arrays (..., width), or numbers (), by its arguments: (..., side, side)."""
    inputs = {name: x.shape[-1] if x.ndim else None for name, x in arrays.items()}
    kind = kind_of(np.result_type(*arrays.values()))
    (found,) = rows(formula, inputs, (side * side,), kind)(*arrays.values())
    return found.reshape(*found.shape[:-1], side, side)


def _vectors(name: str, value: ArrayLike) -> NDArray[Any]:
    return checks.array(name, value, "(3,) or (N, 3)")


def _covariances(P: ArrayLike) -> NDArray[Any]:
    found = covariances("P", P, "(6, 6) or (N, 6, 6)")
    return found.reshape(*found.shape[:-2], 36)


def _over(
    formula: Formula, w: ArrayLike, dt: float, P: ArrayLike | None = None, **densities: float
) -> NDArray[Any]:
    """A formula of rates over ``dt`` s, of noise densities and covariances where there are any."""
    rates = _vectors("w", w)
    given = {"w": rates, "h": np.array(interval(dt), dtype=rates.dtype)}
    if densities:
        variances = [at_least_zero(*found) ** 2 for found in densities.items()]
        given["v"] = np.array(variances, dtype=rates.dtype)
    if P is not None:
        given["p"] = _covariances(P)
        _same_rows(P=given["p"], w=rates)
    return _apply(formula, 6, **given)


def _same_rows(**arrays: NDArray[Any]) -> None:
    common_number("rows", **{name: x for name, x in arrays.items() if x.ndim == 2})


def right_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Jr (3, 3) or (N, 3, 3) of rotation vectors u (3,) or (N, 3), rad.

    exp(u + δ) ≈ exp(u) exp(Jr δ). Error at most 1e-15 for |u| ≤ π, 3e-16 |u| beyond. Raises
    ``ValueError`` for other shapes.
    """
    return _apply(so3.right_jacobian, 3, u=_vectors("u", u))


def left_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Jl = Jrᵀ: exp(u + δ) ≈ exp(Jl δ) exp(u); see :func:`right_jacobian`."""
    return _apply(so3.left_jacobian, 3, u=_vectors("u", u))


def right_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Jr⁻¹, singular at |u| = 2π; see :func:`right_jacobian`."""
    return _apply(so3.right_jacobian_inverse, 3, u=_vectors("u", u))


def left_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Jl⁻¹, singular at |u| = 2π; see :func:`right_jacobian`."""
    return _apply(so3.left_jacobian_inverse, 3, u=_vectors("u", u))


def transition_matrix(w: ArrayLike, dt: float) -> NDArray[Any]:
    """Φ (6, 6) or (N, 6, 6) of (δθ, δb) over ``dt`` s at constant rates w less bias, rad/s.

    Also that of the methods "lie_euler" and "hold". Φ12 of a method with more nodes has commutators
    too, 3.6 % of it for coning of 0.3 rad at |w| h = 0.37: see :func:`step_tangent`. Raises
    ``ValueError`` or ``TypeError`` for other shapes.
    """
    return _over(_transition, w, dt)


def process_noise(
    w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float, at_rest: bool = False
) -> NDArray[Any]:
    """Covariance Q (6, 6) or (N, 6, 6) of white noise over ``dt`` s at constant rates w, rad/s.

    ``angle_noise`` σ_v, rad/√s (angle random walk), ``bias_noise`` σ_u, rad/s^1.5 (rate random
    walk). Exact for a turning body; ``at_rest`` gives Farrenkopf's, that for w = 0. Raises
    ``ValueError`` or ``TypeError`` for other shapes, an interval not above 0, a negative density.
    """
    formula = _noise_at_rest if at_rest else _noise
    return _over(formula, w, dt, angle_noise=angle_noise, bias_noise=bias_noise)


def predict_covariance(
    P: ArrayLike, w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float
) -> NDArray[Any]:
    """Φ P Φᵀ + Q, (6, 6) or (N, 6, 6), with Φ and Q of the two functions above.

    Raises ``ValueError`` for a P that is no covariance, and as they do.
    """
    return _over(_predict, w, dt, P, angle_noise=angle_noise, bias_noise=bias_noise)


def covariance_to_inertial(P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """P (6, 6) or (N, 6, 6) of the error in inertial axes, C_true = exp [δθ] C, from body axes.

    ``q`` (4,) or (N, 4) are attitudes, body to inertial, of any length but zero. Raises
    ``ValueError`` or ``TypeError`` for other shapes, ``ValueError`` for a P that is no covariance.
    """
    return _turned(_to_inertial, P, q)


def covariance_to_body(P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """The inverse of :func:`covariance_to_inertial`."""
    return _turned(_to_body, P, q)


def _turned(formula: Formula, P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    p, attitudes = _covariances(P), checks.attitudes("q", q)
    _same_rows(P=p, q=attitudes)
    c = quat_to_dcm(normalised(attitudes))
    return _apply(formula, 6, c=c.reshape(*c.shape[:-2], 9), p=p)
