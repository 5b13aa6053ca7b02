"""Checks of the arguments of estimators."""

from __future__ import annotations

import sys
from collections.abc import Sized
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks

# bounds of numbers whose squares are neither infinite nor 0
_SMALLEST, _LARGEST = 1e-150, 1e150
# s; bounds of intervals whose powers are numbers
_SHORTEST, _LONGEST = 1e-100, 1e100


def at_least_zero(name: str, value: float) -> float:
    """A number of at least 0, such as a noise density."""
    # for a float this check takes a tenth of the time
    number = value if type(value) is float else checks.real(name, value)
    if not 0.0 <= number <= _LARGEST:
        raise ValueError(f"{name}: found {number}; accepted: at least 0, up to {_LARGEST:g}")
    return number


def variance(name: str, deviation: float) -> float:
    """The square of a standard deviation above 0."""
    sigma = checks.above_zero(name, deviation)
    if not _SMALLEST <= sigma <= _LARGEST:
        raise ValueError(f"{name}: found {sigma}; accepted: {_SMALLEST:g} to {_LARGEST:g}")
    return sigma**2


def interval(dt: float) -> float:
    """An interval, s, above 0."""
    seconds = dt if type(dt) is float else checks.real("dt", dt)
    if not _SHORTEST <= seconds <= _LONGEST:
        raise ValueError(
            f"dt: found {seconds}; accepted: an interval above 0, {_SHORTEST:g} to {_LONGEST:g}"
        )
    return seconds


def common_number(of: str, **arrays: Sized) -> int:
    """The number of rows of all arrays, one row counting for any number of them."""
    rows = {name: len(value) for name, value in arrays.items()}
    if len(set(rows.values()) - {1}) > 1:
        counts = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {counts}; accepted: one number of {of}")
    return max(rows.values(), default=1)


# tolerance of asymmetry, relative to √(P_ii P_jj), and of negative variances, in units of rounding
_ASYMMETRY, _ROUNDING = 1e-9, 1e3
# the same as a share of a variance, where elements of the matrix almost determine each other
NEGATIVE = -1e-6


def covariances(name: str, value: ArrayLike, shapes: str) -> NDArray[Any]:
    """Symmetric covariances without a negative variance in any direction, to rounding.

    ``shapes`` are those of ``checks.array``. Correlations are compared, so that units do not
    matter.
    """
    matrices = checks.array(name, value, shapes)
    least = _ROUNDING * np.finfo(matrices.dtype).eps
    variances = np.diagonal(matrices, axis1=-2, axis2=-1)
    deviations = np.sqrt(np.maximum(variances, 0.0))
    scale = deviations[..., :, None] * deviations[..., None, :]
    even = 0.5 * (matrices + np.swapaxes(matrices, -1, -2))
    bad = (np.abs(matrices - even) > max(_ASYMMETRY, least) * scale).any(axis=(-2, -1))
    what = "is not symmetric"
    if not bad.any():
        bad = (variances < 0.0).any(axis=-1) | (np.abs(even) > (1.0 + least) * scale).any((-2, -1))
        what = "has a negative variance"
    if not bad.any():
        there = np.where(scale > 0.0, scale, 1.0)
        correlations = even / there + least * np.eye(matrices.shape[-1])
        bad = np.linalg.eigvalsh(correlations)[..., 0] < 0.0
    if bad.any():
        where = f"[{int(np.argmax(bad))}]" if matrices.ndim == 3 else ""
        raise ValueError(f"{name}{where}: {what}; accepted: a covariance")
    return even


def root(P: NDArray[Any]) -> NDArray[np.float64]:
    """L of P = L Lᵀ, (..., D, D), lower triangular; without variance a column is 0.

    NaN if P is not a covariance.
    """
    size = P.shape[-1]
    lower = np.zeros(P.shape)
    for k in range(size):
        column = P[..., k:, k] - (lower[..., k:, :k] @ lower[..., k, :k, None])[..., 0]
        share = column[..., :1] / np.where(P[..., k, k, None] > 0.0, P[..., k, k, None], 1.0)
        none = (share >= NEGATIVE) & (share <= 16.0 * size * np.finfo(np.float64).eps)
        with np.errstate(invalid="ignore"):
            lower[..., k:, k] = column / np.sqrt(np.where(none, np.inf, column[..., :1]))
    return lower


def triples(name: str, value: ArrayLike, n: int) -> NDArray[np.float64]:
    """Vectors in rows, one for all n logs or one for each."""
    accepted, tails = f"(3,) or ({n}, 3), one a log", [(3,), (1, 3), (n, 3)]
    return np.atleast_2d(checks.array(name, value, accepted, tails).astype(np.float64))


def attitude_covariance(sigma: ArrayLike) -> NDArray[np.float64]:
    """(3, 3), rad², from a standard deviation or three about body axes, or a covariance."""
    deviations = checks.array("sigma", sigma, "a number, (3,) or (3, 3)")
    if deviations.ndim < 2:
        return np.diag(
            np.broadcast_to([variance("sigma", float(x)) for x in deviations.flat], (3,))
        )
    return definite("sigma", deviations, "(3, 3)")


def definite(name: str, value: ArrayLike, shapes: str) -> NDArray[np.float64]:
    """Covariances with some variance in every direction, float64."""
    matrices = np.ascontiguousarray(covariances(name, value, shapes), dtype=np.float64)
    if (np.diagonal(root(matrices), axis1=-2, axis2=-1) == 0.0).any():
        raise ValueError(f"{name}: has no variance in some direction; accepted: some in all")
    return matrices


def largest_square(gate: float | None) -> float:
    """The largest normalised innovation squared that is used; None accepts any finite one."""
    if gate is None:
        return sys.float_info.max
    square = checks.above_zero("gate", gate, "a number above 0, or None", finite=False)
    return min(square, sys.float_info.max)
