"""An attitude from directions seen at one instant: where a filter starts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, rotate_inverse, rotation_vector_to_quat
from fastatt.estimation.filters import Floats


def attitude_from_vectors(
    measured: ArrayLike, reference: ArrayLike, sigma: ArrayLike
) -> tuple[Any, Floats]:
    """The attitude that fits two or more directions best, and its covariance.

    It minimises Σ |b − Cᵀ r|²/σ² (Wahba), b and r at unit length: the eigenvector of Davenport's
    matrix (Markley and Crassidis (2014), §5.3), then two Gauss-Newton steps, which find the digits
    that it loses where the σ differ much. Of two directions, TRIAD would take one for exact.
    The covariance is (Σ (1 − e eᵀ)/σ²)⁻¹, e = Cᵀ r: Shuster and Oh, J. Guidance 4 (1981) 70.

    Parameters
    ----------
    measured : (m, 3) or (N, m, 3), vectors along body axes, m at least 2, of any length but zero.
    reference : (m, 3) or (N, m, 3), the same along inertial axes.
    sigma : standard deviation of the directions across, rad, a number or (m,), above 0.

    Returns
    -------
    q (4,) or (N, 4), body to inertial, and the covariance (3, 3) or (N, 3, 3) of δθ, rad²,
    q_true = q∘exp(δθ), as of the filters.

    Raises
    ------
    ValueError, TypeError : a shape that does not fit, a vector that is zero or not finite;
        directions so near one line that the turn about it has a deviation above 1 rad.
    """
    b, r = _directions("measured", measured), _directions("reference", reference)
    m = b.shape[-2]
    if m < 2 or m != r.shape[-2] or (b.ndim == r.ndim == 3 and len(b) != len(r)):
        raise ValueError(
            f"measured: has shape {b.shape}, reference {r.shape}; accepted: as many of each, at "
            "least two"
        )
    deviations = checks.array("sigma", sigma, f"a number or ({m},)")
    if not (deviations > 0.0).all():
        raise ValueError(f"sigma: found {deviations.min()}; accepted: above 0")
    s = np.broadcast_to(deviations.astype(np.float64), (m,))[:, None]
    weighted = r * (s.min() / s) ** 2
    B = np.swapaxes(weighted, -1, -2) @ b
    trace = np.trace(B, axis1=-2, axis2=-1)
    K = np.empty((*B.shape[:-2], 4, 4))
    K[..., 0, 0] = trace
    K[..., 1:, 1:] = B + np.swapaxes(B, -1, -2) - trace[..., None, None] * np.eye(3)
    K[..., 0, 1:] = K[..., 1:, 0] = np.cross(b, weighted).sum(axis=-2)
    q: Any = np.linalg.eigh(K)[1][..., -1]
    for _ in range(2):
        e = rotate_inverse(q[..., None, :], r)
        # a column is e × an axis: what b − e is made of by δθ
        slopes = np.swapaxes(np.cross(e[..., None, :], np.eye(3)), -1, -2) / s[..., None]
        u, values, v = np.linalg.svd(slopes.reshape(*q.shape[:-1], -1, 3), full_matrices=False)
        unknown = np.atleast_1d(values[..., -1]) < 1.0
        if unknown.any():
            where = f"[{int(np.argmax(unknown))}]" if q.ndim == 2 else ""
            raise ValueError(
                f"reference{where}: has directions near one line; accepted: such that the turn "
                "about it is known to 1 rad"
            )
        root = np.swapaxes(v, -1, -2) / values[..., None, :]
        left = ((b - e) / s).reshape(*q.shape[:-1], -1, 1)
        q = quat_multiply(
            q, rotation_vector_to_quat((root @ np.swapaxes(u, -1, -2) @ left)[..., 0])
        )
    return q, root @ np.swapaxes(root, -1, -2)


def _directions(name: str, value: ArrayLike) -> Floats:
    """Vectors at unit length."""
    rows = checks.array(name, value, "(m, 3) or (N, m, 3)")
    zero = ~rows.any(axis=-1)
    if zero.any():
        k = [int(i) for i in np.argwhere(zero)[0]]
        raise ValueError(f"{name}{k} is the zero vector; accepted: any other, unit or not")
    return normalised(rows.astype(np.float64))
