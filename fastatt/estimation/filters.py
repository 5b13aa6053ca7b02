"""What the filters share: motions of sigma points and particles, errors, means, measures.

A motion takes an ensemble, attitudes (M, 4) and what is estimated beside them (M, K), a few steps
on: ``motion(q, y) -> (q, y)``. ``gyro_motion`` and ``scene_motion`` make them of the tile engine; a
function of a user's own will do as well.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rates
from fastatt.arrays import normalised, quat_multiply, quat_to_rotation_vector
from fastatt.estimation.amounts import common_number, covariances
from fastatt.running.propagate import propagate
from fastatt.scene import Scene

Floats = NDArray[np.float64]
Motion = Callable[[Floats, Floats], tuple[Floats, Floats]]


def gyro_motion(gyro: ArrayLike, dt: float, *, n_threads: int | None = None) -> Motion:
    """Attitudes turn by a gyro's rate less their bias, the first three numbers beside them.

    ``gyro`` (3,), rad/s, is held for dt s; (N, 3) are the rates of N filters, whose points follow
    each other in equal numbers.
    """
    sample = checks.array("gyro", gyro, "(3,) or (N, 3)")

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        if y.shape[1] < 3:
            raise ValueError(
                f"y: has shape {y.shape}; accepted: a bias of three numbers in each row"
            )
        each = np.repeat(sample, len(q) // len(sample), axis=0) if sample.ndim == 2 else sample
        scene = Scene(rate=rates.Constant(each - y[:, :3]))
        moved = propagate(scene, q, dt=dt, n_steps=1, method="lie_euler", n_threads=n_threads)
        return moved.q[-1], y

    return motion


def scene_motion(
    scene: Scene,
    dt: float,
    n_steps: int,
    *,
    method: str | None = None,
    t0: float = 0.0,
    n_threads: int | None = None,
) -> Motion:
    """The motion of a scene with inertia, or of one at a given rate, for n_steps of dt s.

    Of a body the first three numbers beside the attitude are its angular velocity, rad/s, along
    body axes.
    """
    carries = scene.kind != "rate"

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        moved = propagate(
            scene, q, y[:, :3] if carries else None, dt=dt, n_steps=n_steps, method=method, t0=t0,
            n_threads=n_threads,
        )  # fmt: skip
        return moved.q[-1], np.hstack([moved.w[-1], y[:, 3:]]) if carries else y

    return motion


def attitude_error(q: ArrayLike, q_true: ArrayLike) -> Floats:
    """δθ (..., 3), rad, of q_true = q∘exp(δθ)."""
    inverse = np.asarray(q, dtype=np.float64) * (1.0, -1.0, -1.0, -1.0)
    return np.asarray(quat_to_rotation_vector(quat_multiply(inverse, q_true)))


def normalised_square(d: Floats, P: Floats) -> Floats:
    """dᵀ P⁻¹ d of rows d (..., D) and covariances (..., D, D)."""
    return np.asarray(np.einsum("...i,...i->...", d, np.linalg.solve(P, d[..., None])[..., 0]))


def attitude_covariance(sigma: ArrayLike) -> Floats:
    """(3, 3), rad², of a standard deviation, of three about body axes, or itself."""
    found = checks.array("sigma", sigma, "a number, (3,) or (3, 3)")
    if found.ndim == 2:
        return np.ascontiguousarray(covariances("sigma", found, "(3, 3)"), dtype=np.float64)
    if not (found >= 0.0).all():
        raise ValueError(f"sigma: found {found.min()}; accepted: at least 0")
    return np.diag(np.broadcast_to(np.square(found, dtype=np.float64), (3,)))


def largest_square(gate: float | None) -> float:
    """The largest normalised innovation squared that is used; None: any that is finite."""
    if gate is None:
        return sys.float_info.max
    found = checks.above_zero("gate", gate, "a number above 0, or None", finite=False)
    return min(found, sys.float_info.max)


def measured_attitudes(value: ArrayLike, n: int, *, skips: bool) -> Floats:
    """Attitudes (4,) or (n, 4); what is none is refused, or NaN where it is skipped."""
    rows = checks.attitudes("measured", value, f"(4,) or ({n}, 4)", flag=skips)
    none = (rows == 0.0).all(axis=-1, keepdims=True)
    return np.where(none, np.nan, rows).astype(np.float64)


def mean_attitude(q: ArrayLike, weights: ArrayLike | None = None) -> Floats:
    """Mean of attitudes (..., M, 4), weighted (..., M): the eigenvector of Σ w q qᵀ, (..., 4).

    It minimises the weighted sum of squares of the matrices' distances; q and −q count the same,
    quaternions of any length as of unit length, and of the two means the one with scalar ≥ 0 is
    given. Markley, Cheng, Crassidis and Oshman, J. Guidance 30 (2007) 1193, eq. 12.

    Raises ``ValueError`` for attitudes that are no quaternions or have no one mean, such as two
    that are half a turn apart, and for weights that do not fit, are negative or all 0.

    >>> import fastatt as fa
    >>> fa.mean_attitude([[1, 0, 0, 0], [0, 0, 0, 1]], weights=[1, 0])
    array([1., 0., 0., 0.])
    """
    rows = np.asarray(q, dtype=np.float64)
    if rows.ndim < 2 or rows.shape[-1] != 4 or rows.shape[-2] == 0:
        raise ValueError(f"q: has shape {rows.shape}; accepted: (..., M, 4)")
    checks.finite("q", rows)
    if not rows.any(axis=-1).all():
        raise ValueError("q: found a zero quaternion; accepted: of any other length")
    weighted = rows = normalised(rows)
    if weights is not None:
        w = np.asarray(weights, dtype=np.float64)
        if w.shape[-1:] != rows.shape[-2:-1]:
            raise ValueError(f"weights: has shape {w.shape}; accepted: (..., {rows.shape[-2]})")
        checks.finite("weights", w)
        if (w < 0.0).any() or not w.any(axis=-1).all():
            raise ValueError(
                f"weights: found {w.min():g} to {w.max():g}; accepted: at least 0, and some above"
            )
        weighted = rows * (w / w.max(axis=-1, keepdims=True))[..., None]
    values, vectors = np.linalg.eigh(np.swapaxes(weighted, -1, -2) @ rows)
    if (values[..., -1] - values[..., -2] <= 1e-14 * values[..., -1]).any():
        raise ValueError("q: has no one mean; accepted: attitudes that do not weigh each other out")
    found = vectors[..., -1]
    return np.asarray(np.where(found[..., :1] < 0.0, -found, found))


def unit_rows(value: NDArray[Any], n: int) -> Floats:
    """n rows of unit quaternions, of one or n of any length but zero."""
    return rows_of(normalised(value), (n, 4))


def rows_of(value: NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """An array of its own, of one row or as many as the shape has."""
    return np.array(np.broadcast_to(value, shape), dtype=np.float64, order="C")


class Estimates:
    """Attitudes, numbers beside them and covariances (δθ, δy), of one filter or of N."""

    def __init__(
        self, q: ArrayLike, name: str, y: NDArray[Any], covariance: ArrayLike, invalid: str
    ) -> None:
        """``name`` is what the numbers y, (K,) or (N, K), are called."""
        start, size = checks.attitudes("q", q), 3 + y.shape[-1]
        shapes = f"({size}, {size}) or (N, {size}, {size})"
        P = covariances("covariance", covariance, shapes)
        given = {"q": (start, 1), name: (y, 1), "covariance": (P, 2)}
        many = {name: x for name, (x, one) in given.items() if x.ndim > one}
        n = common_number("filters", **many) if many else 1
        self._one = not many
        self._q, self._y = unit_rows(start, n), rows_of(y, (n, size - 3))
        self._P = rows_of(P, (n, size, size))
        self._skips = checks.choice("invalid", invalid, ("raise", "skip")) == "skip"

    def _each(self, rows: Floats) -> Floats:
        """The rows or, of one filter, its own."""
        return np.asarray(rows[0]) if self._one else rows

    def _figures(self, found: Floats) -> Any:
        return float(found[0]) if self._one else found

    @property
    def q(self) -> Floats:
        """Attitudes, (4,) or (N, 4)."""
        return self._each(self._q)

    @property
    def covariance(self) -> Floats:
        """Covariances of the errors, (D, D) or (N, D, D)."""
        return self._each(self._P)

    def nees(self, q: ArrayLike, y: ArrayLike) -> Any:
        """Normalised estimation error squared against the truth, χ² with D degrees of freedom."""
        beside = np.broadcast_to(y, self._y.shape) - self._y
        d = np.concatenate([attitude_error(self._q, q), beside], axis=-1)
        return self._figures(normalised_square(d, self._P))
