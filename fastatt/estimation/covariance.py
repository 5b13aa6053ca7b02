"""Attitude and gyro bias: transitions, noise, covariances and Jacobians of arrays.

The formulas and conventions are those of ``fastatt.kernels.error_state`` and ``so3``: the error is
C_true = C exp [δθ], in body axes; matrices (..., 6, 6) are of (δθ, δb).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import driver, helper, hook
from fastatt.arrays import quat_to_dcm
from fastatt.columns import store, unpack
from fastatt.kernels import error_state, so3

_COVARIANCE = "(6, 6) or (N, 6, 6)"


class RightJacobian(NamedTuple):
    """Tag."""


class LeftJacobian(NamedTuple):
    """Tag."""


class RightJacobianInverse(NamedTuple):
    """Tag."""


class LeftJacobianInverse(NamedTuple):
    """Tag."""


class TransitionOf(NamedTuple):
    """Tag: w, h."""


class NoiseOf(NamedTuple):
    """Tag: w, h, σ_v², σ_u²."""


class NoiseAtRest(NamedTuple):
    """Tag: the same."""


class Predict(NamedTuple):
    """Tag: the same, P."""


class ToInertial(NamedTuple):
    """Tag: C, P."""


class ToBody(NamedTuple):
    """Tag: C, P."""


@helper
def _turn(x):
    return x[3] * x[0], x[3] * x[1], x[3] * x[2]


def _transition(x):
    return error_state.transition_matrix(error_state.transition(_turn(x), x[3]))


def _noise(x):
    return error_state.matrix(error_state.noise(_turn(x), x[3], x[4], x[5]))


def _noise_at_rest(x):
    return error_state.matrix(error_state.noise_at_rest(x[3], x[4], x[5]))


def _predict(x):
    u = _turn(x)
    phi = error_state.transition(u, x[3])
    q = error_state.noise(u, x[3], x[4], x[5])
    return error_state.matrix(error_state.predict(error_state.blocks(x[6:]), phi, q))


def _to_inertial(x):
    return error_state.matrix(error_state.to_inertial(x[:9], error_state.blocks(x[9:])))


def _to_body(x):
    return error_state.matrix(error_state.to_body(x[:9], error_state.blocks(x[9:])))


# tag: its formula on a row of numbers, their number and that of the results
_FORMULAS: dict[type, tuple[Any, int, int]] = {
    RightJacobian: (so3.right_jacobian, 3, 9),
    LeftJacobian: (so3.left_jacobian, 3, 9),
    RightJacobianInverse: (so3.right_jacobian_inverse, 3, 9),
    LeftJacobianInverse: (so3.left_jacobian_inverse, 3, 9),
    TransitionOf: (helper(_transition), 4, 36),
    NoiseOf: (helper(_noise), 6, 36),
    NoiseAtRest: (helper(_noise_at_rest), 6, 36),
    Predict: (helper(_predict), 42, 36),
    ToInertial: (helper(_to_inertial), 45, 36),
    ToBody: (helper(_to_body), 45, 36),
}


def formula(which: Any, row: Any) -> Any:
    """A formula on a row of an array."""
    raise NotImplementedError(which)


@hook(formula)
def _formula(which: types.BaseNamedTuple, row: types.Array) -> Any:
    function, before, _ = _FORMULAS[which.instance_class]
    shape = (0.0,) * before
    return lambda which, row: function(unpack(row, shape))


@driver
def _over_rows(which, rows, out):
    for i in range(rows.shape[0]):
        store(out.T, 0, i, formula(which, rows[i]))


def _apply(which: Any, *columns: NDArray[Any]) -> NDArray[Any]:
    """Columns (n,) or (N, n) side by side, through a formula: (k, k) or (N, k, k)."""
    _, before, after = _FORMULAS[type(which)]
    n = max([len(c) for c in columns if c.ndim == 2], default=1)
    kind = np.result_type(*columns)
    wide = [np.broadcast_to(c, (n, c.shape[-1])) for c in columns]
    rows = np.ascontiguousarray(np.concatenate(wide, axis=1), dtype=kind)
    out = np.empty((n, after), dtype=kind)
    _over_rows(which, rows[:, :before], out)
    side = math.isqrt(after)
    found = out.reshape(n, side, side)
    return np.asarray(found[0] if all(c.ndim == 1 for c in columns) else found)


def _vectors(name: str, value: ArrayLike) -> NDArray[Any]:
    return checks.array(name, value, "(3,) or (N, 3)", [(3,), (-1, 3)])


def _covariances(P: ArrayLike) -> NDArray[Any]:
    found = checks.array("P", P, _COVARIANCE, [(6, 6), (-1, 6, 6)])
    gap = np.abs(found - np.swapaxes(found, -1, -2)).max(axis=(-2, -1))
    scale = np.abs(found).max(axis=(-2, -1))
    bad = np.atleast_1d(gap > 1e3 * np.finfo(found.dtype).eps * scale)
    if bad.any():
        where = f"[{int(np.argmax(bad))}]" if found.ndim == 3 else ""
        raise ValueError(f"P{where}: is not symmetric; accepted: a covariance")
    return found.reshape(*found.shape[:-2], 36)


def _same_rows(**arrays: NDArray[Any]) -> None:
    rows = {name: len(value) for name, value in arrays.items() if value.ndim == 2}
    if len(set(rows.values())) > 1:
        found = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {found}; accepted: one number of rows")


def _step(dt: float, kind: np.dtype[Any]) -> NDArray[Any]:
    h = checks.real("dt", dt)
    if h <= 0.0:
        raise ValueError(f"dt: found {h}; accepted: above 0")
    return np.array([h], dtype=kind)


def _variances(kind: np.dtype[Any], **densities: float) -> NDArray[Any]:
    found = {name: checks.real(name, value) for name, value in densities.items()}
    for name, value in found.items():
        if value < 0.0:
            raise ValueError(f"{name}: found {value}; accepted: at least 0")
    return np.array([value * value for value in found.values()], dtype=kind)


def right_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Jr (3, 3) or (N, 3, 3) of rotation vectors u (3,) or (N, 3), rad.

    exp(u + δ) ≈ exp(u) exp(Jr δ). Error at most 1e-15 for |u| ≤ π, 3e-16 |u| beyond. Raises
    ``ValueError`` for other shapes.
    """
    return _apply(RightJacobian(), _vectors("u", u))


def left_jacobian(u: ArrayLike) -> NDArray[Any]:
    """Jl = Jrᵀ: exp(u + δ) ≈ exp(Jl δ) exp(u); see :func:`right_jacobian`."""
    return _apply(LeftJacobian(), _vectors("u", u))


def right_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Jr⁻¹, singular at |u| = 2π; see :func:`right_jacobian`."""
    return _apply(RightJacobianInverse(), _vectors("u", u))


def left_jacobian_inverse(u: ArrayLike) -> NDArray[Any]:
    """Jl⁻¹, singular at |u| = 2π; see :func:`right_jacobian`."""
    return _apply(LeftJacobianInverse(), _vectors("u", u))


def transition_matrix(w: ArrayLike, dt: float) -> NDArray[Any]:
    """Φ (6, 6) or (N, 6, 6) of (δθ, δb) over ``dt`` s at constant rates w less bias, rad/s.

    That of the methods "lie_euler" and "hold" too. A method with more nodes has commutators in Φ12
    besides, in coning of 0.3 rad at |w| h = 0.37 3.6 % of it:
    :func:`fastatt.estimation.rate_transition` gives them. Raises ``ValueError`` or ``TypeError``
    for other shapes.
    """
    rates = _vectors("w", w)
    return _apply(TransitionOf(), rates, _step(dt, rates.dtype))


def process_noise(
    w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float, at_rest: bool = False
) -> NDArray[Any]:
    """Covariance Q (6, 6) or (N, 6, 6) of white noise over ``dt`` s at constant rates w, rad/s.

    ``angle_noise`` σ_v, rad/√s (angle random walk), ``bias_noise`` σ_u, rad/s^1.5 (rate random
    walk). Exact for a turning body; ``at_rest`` gives Farrenkopf's, that for w = 0. Raises
    ``ValueError`` or ``TypeError`` for other shapes, an interval not above 0, a negative density.
    """
    rates = _vectors("w", w)
    v = _variances(rates.dtype, angle_noise=angle_noise, bias_noise=bias_noise)
    which = NoiseAtRest() if at_rest else NoiseOf()
    return _apply(which, rates, _step(dt, rates.dtype), v)


def predict_covariance(
    P: ArrayLike, w: ArrayLike, dt: float, *, angle_noise: float, bias_noise: float
) -> NDArray[Any]:
    """Φ P Φᵀ + Q, (6, 6) or (N, 6, 6), with Φ and Q of the two functions above.

    Raises ``ValueError`` for a P that is not symmetric, and as they do.
    """
    rates, p = _vectors("w", w), _covariances(P)
    _same_rows(P=p, w=rates)
    v = _variances(rates.dtype, angle_noise=angle_noise, bias_noise=bias_noise)
    return _apply(Predict(), rates, _step(dt, rates.dtype), v, p)


def covariance_to_inertial(P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """P (6, 6) or (N, 6, 6) of the error in inertial axes, C_true = exp [δθ] C, from body axes.

    ``q`` (4,) or (N, 4) are unit attitudes, body to inertial. Raises ``ValueError`` or
    ``TypeError`` for other shapes.
    """
    return _turned(ToInertial(), P, q)


def covariance_to_body(P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    """The inverse of :func:`covariance_to_inertial`."""
    return _turned(ToBody(), P, q)


def _turned(which: Any, P: ArrayLike, q: ArrayLike) -> NDArray[Any]:
    p, attitudes = _covariances(P), checks.attitudes("q", q)
    _same_rows(P=p, q=attitudes)
    c = quat_to_dcm(attitudes)
    return _apply(which, c.reshape(*c.shape[:-2], 9), p)
