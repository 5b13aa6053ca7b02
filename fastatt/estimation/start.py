"""The initial state of a filter: attitude from directions, gyro bias from samples at rest."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import (
    normalised,
    quat_multiply,
    quat_rotate,
    quat_rotate_inverse,
    rotation_vector_to_quat,
)
from fastatt.estimation.amounts import variance
from fastatt.estimation.filters import Floats

_PIECES = 4
# largest ratio of deviations; beyond it rounding hides the least precise direction
_LARGEST_RATIO = 1e7
# smallest gap of eigenvalues in Davenport's matrix, which limits the accuracy of its eigenvector
_LEAST_WEIGHT = 1e-12
# smallest share of the directions' information about an axis that residuals may leave
_LEAST_SHARE = 0.1


def attitude_from_vectors(
    measured: ArrayLike, reference: ArrayLike, sigma: ArrayLike
) -> tuple[Any, Floats]:
    """Find the attitude that fits two or more directions best, with its covariance.

    Parameters
    ----------
    measured : array_like of shape (m, 3) or (N, m, 3)
        At least two vectors along body axes, of any length above zero.
    reference : array_like of shape (m, 3) or (N, m, 3)
        The same vectors along inertial axes.
    sigma : float or array_like of shape (m,)
        Standard deviations of the directions, rad, above 0; the largest is at most 1e7 times the
        smallest.

    Returns
    -------
    q : ndarray of shape (4,) or (N, 4)
        Attitude, body to inertial.
    covariance : ndarray of shape (3, 3) or (N, 3, 3)
        Covariance of δθ, rad², q_true = q∘exp(δθ).

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, or a vector is zero or not finite; if directions are so close to
        one line that the rotation about it has a deviation above 1 rad; if the angles between
        measured directions differ from those between the references so much that the rotation about
        some axis is undetermined, such as for two equal directions, or left-handed ones of
        right-handed references.

    Notes
    -----
    The attitude minimises Σ ``|b − Cᵀ r|²``/σ² (Wahba's problem) for unit vectors b and r. It is
    the eigenvector of Davenport's matrix, corrected by three Gauss-Newton steps, since the
    eigenvector loses digits if the σ differ much. TRIAD would take one of two directions as exact.
    The covariance is (Σ (1 − e eᵀ)/σ²)⁻¹ with e = Cᵀ r.

    References
    ----------
    Markley and Crassidis, *Fundamentals of Spacecraft Attitude Determination and Control* (2014),
    §5.3; Shuster and Oh, *Journal of Guidance and Control* 4 (1981) 70.

    Examples
    --------
    >>> from fastatt import estimation as es
    >>> axes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    >>> q, covariance = es.attitude_from_vectors(axes, axes, 0.01)
    >>> (q.round(9) + 0.0).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    b, r = _directions("measured", measured), _directions("reference", reference)
    m = b.shape[-2]
    if m < 2 or m != r.shape[-2] or (b.ndim == r.ndim == 3 and len(b) != len(r)):
        raise ValueError(
            f"measured: has shape {b.shape}, reference {r.shape}; accepted: as many of each, at "
            "least two"
        )
    s = _deviations(sigma, m)[:, None]
    if s.max() > _LARGEST_RATIO * s.min():
        raise ValueError(
            f"sigma: found {s.min():.3g} to {s.max():.3g}; accepted: the largest up to "
            f"{_LARGEST_RATIO:g} times the smallest; a larger smallest one gives the same attitude"
        )
    weighted = r * np.maximum((s.min() / s) ** 2, _LEAST_WEIGHT)
    B = np.swapaxes(weighted, -1, -2) @ b
    trace = np.trace(B, axis1=-2, axis2=-1)
    K = np.empty((*B.shape[:-2], 4, 4))
    K[..., 0, 0] = trace
    K[..., 1:, 1:] = B + np.swapaxes(B, -1, -2) - trace[..., None, None] * np.eye(3)
    K[..., 0, 1:] = K[..., 1:, 0] = np.cross(b, weighted).sum(axis=-2)
    q: Any = np.linalg.eigh(K)[1][..., -1]
    for _ in range(3):
        e = quat_rotate_inverse(q[..., None, :], r)
        # a column is e × an axis, the derivative of b − e by δθ
        slopes = np.swapaxes(np.cross(e[..., None, :], np.eye(3)), -1, -2) / s[..., None]
        u, values, v = np.linalg.svd(slopes.reshape(*q.shape[:-1], -1, 3), full_matrices=False)
        _refuse(
            values[..., -1] < 1.0,
            "reference",
            "has directions near one line; accepted: such that the rotation about it is known to "
            "1 rad",
        )
        root = np.swapaxes(v, -1, -2) / values[..., None, :]
        left = ((b - e) / s).reshape(*q.shape[:-1], -1, 1)
        q = quat_multiply(
            q, rotation_vector_to_quat((root @ np.swapaxes(u, -1, -2) @ left)[..., 0])
        )
    # half the second derivative of the sum by δθ along the root's columns, 1 without residuals
    d = (b - e) / s**2
    outer = np.swapaxes(d, -1, -2) @ e
    curved = np.trace(outer, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - outer
    left_over = np.linalg.eigvalsh(np.eye(3) + np.swapaxes(root, -1, -2) @ _even(curved) @ root)
    _refuse(
        left_over[..., 0] < _LEAST_SHARE,
        "measured",
        "its directions lie otherwise to each other than those of reference, so that the rotation "
        "about some axis is free; accepted: the same ones, but for noise",
    )
    return q, root @ np.swapaxes(root, -1, -2)


def _even(A: Floats) -> Floats:
    return 0.5 * (A + np.swapaxes(A, -1, -2))


def _refuse(bad: Any, name: str, message: str) -> None:
    """Refuse the first bad set of directions, by its index if there are several."""
    if np.any(bad):
        raise ValueError(f"{name}{[int(np.argmax(bad))] if np.ndim(bad) else ''}: {message}")


def _directions(name: str, value: ArrayLike) -> Floats:
    """Vectors, normalised."""
    rows = checks.array(name, value, "(m, 3) or (N, m, 3)")
    zero = ~rows.any(axis=-1)
    if zero.any():
        k = [int(i) for i in np.argwhere(zero)[0]]
        raise ValueError(f"{name}{k} is the zero vector; accepted: any other, unit or not")
    return normalised(rows.astype(np.float64))


def _deviations(sigma: ArrayLike, n: int) -> Floats:
    found = checks.array("sigma", sigma, f"a number or ({n},)")
    if not (found > 0.0).all():
        raise ValueError(f"sigma: found {found.min()}; accepted: above 0")
    for deviation in found.flat:
        variance("sigma", float(deviation))
    return np.broadcast_to(found.astype(np.float64), (n,))


class StaticStart(NamedTuple):
    """Attitude, gyro bias and their covariance after a rest, as :func:`static_start` finds them.

    Attributes
    ----------
    q : ndarray of shape (4,)
        Attitude, body to inertial.
    bias : ndarray of shape (3,)
        Gyro bias, rad/s, which includes the Earth's rotation.
    covariance : ndarray of shape (6, 6)
        Covariance of (δθ, δb), rad and rad/s, in the form that the filters expect.
    gravity : float
        Mean specific force, m/s².
    """

    q: Floats
    bias: Floats
    covariance: Floats
    gravity: float


def static_start(
    gyro: ArrayLike,
    accel: ArrayLike,
    mag: ArrayLike | None = None,
    *,
    sigma: ArrayLike,
    up: ArrayLike = (0.0, 0.0, 1.0),
    field: ArrayLike | None = None,
    largest_bias: float = 0.05,
    largest_change: float = 0.01,
) -> StaticStart:
    """Find the attitude and the gyro bias from samples at rest.

    Parameters
    ----------
    gyro : array_like of shape (n, 3)
        Gyro samples along body axes, rad/s; n is at least 8.
    accel : array_like of shape (n, 3)
        Specific force along body axes, which points up at rest, in any unit.
    mag : array_like of shape (n, 3), optional
        Magnetic field along body axes, in any unit.
    sigma : float or array_like of shape (2,)
        Standard deviations of the systematic errors of the two mean directions, rad: for the
        accelerometer its bias divided by gravity, such as 5e-3 for 5 mg, and for the magnetometer
        that of its calibration. The function estimates the noise from the samples, and adds it.
    up : array_like of shape (3,), default (0, 0, 1)
        The direction up along inertial axes, of any length above zero.
    field : array_like of shape (3,), optional
        The magnetic field along inertial axes, of any length above zero; required with ``mag``.
    largest_bias : float, default 0.05
        Largest accepted mean of the gyro, rad/s.
    largest_change : float, default 0.01
        Largest accepted difference of the means over quarters of the samples, rad/s, and rad for
        the directions.

    Returns
    -------
    StaticStart
        Attitude, bias and covariance.

    Raises
    ------
    ValueError, TypeError
        If the samples were not taken at rest, if the angle between field and gravity differs from
        that between ``field`` and ``up`` by more than 5 deviations, or if an argument does not fit.

    Notes
    -----
    The bias is the mean of the gyro. The accelerometer's mean is the direction up; with the
    magnetometer's the attitude is that of :func:`attitude_from_vectors`. Without a magnetometer,
    the attitude is the smallest rotation from the inertial axes, with a deviation of π for its
    heading.

    Examples
    --------
    >>> import numpy as np
    >>> from fastatt import estimation as es
    >>> gyro, accel = np.tile([0.01, 0.0, 0.0], (100, 1)), np.tile([0.0, 0.0, 9.81], (100, 1))
    >>> found = es.static_start(gyro, accel, sigma=5e-3)
    >>> print(found.q, found.bias)
    [1. 0. 0. 0.] [0.01 0.   0.  ]
    """
    for name, limit in (("largest_bias", largest_bias), ("largest_change", largest_change)):
        checks.above_zero(name, limit, finite=False)
    rates = _samples("gyro", gyro)
    bias = rates.mean(axis=0)
    size = float(np.linalg.norm(bias))
    if size > largest_bias:
        raise ValueError(
            f"gyro: has a mean of {size:.3g} rad/s; accepted: at rest, a bias of at most "
            f"{largest_bias:g} (largest_bias)"
        )
    _same("gyro", np.linalg.norm(_quarters(rates) - bias, axis=1), "rad/s", largest_change)
    seen = {"accel": _samples("accel", accel)}
    known = {"up": up}
    if (mag is None) != (field is None):
        raise ValueError("field: found without mag, or mag without it; accepted: both or none")
    if mag is not None and field is not None:
        seen["mag"], known["field"] = _samples("mag", mag), field
    extra = _deviations(sigma, 2)
    means, deviations = [], []
    for (name, data), further in zip(seen.items(), extra, strict=False):
        if len(data) != len(rates):
            raise ValueError(f"{name}: found {len(data)} samples; accepted: {len(rates)}, as gyro")
        mean = data.mean(axis=0)
        long = float(np.linalg.norm(mean))
        noise = float(np.sqrt(data.var(axis=0, ddof=1).sum() / 3.0 / len(data)))
        if not long > 10.0 * noise:
            raise ValueError(f"{name}: has no mean above its noise; accepted: a steady direction")
        _same(name, _angles(_quarters(data), mean), "rad", largest_change)
        means.append(mean)
        deviations.append(math.hypot(float(further), noise / long))
    references = [
        checks.array(name, value, "(3,)").astype(np.float64) for name, value in known.items()
    ]
    P = np.diag(np.tile(rates.var(axis=0, ddof=1) / len(rates), 2))
    if mag is None:
        q, P[:3, :3] = _least_turn(means[0], references[0], deviations[0])
    else:
        apart = abs(_angles(means[0], means[1]) - _angles(*references))
        if apart > 5.0 * math.hypot(*deviations):
            raise ValueError(
                f"mag: lies {apart:.3g} rad otherwise to accel than field to up; accepted: up to 5 "
                f"deviations, {5.0 * math.hypot(*deviations):.3g} (sigma)"
            )
        q, P[:3, :3] = attitude_from_vectors(means, references, deviations)
    return StaticStart(q, bias, P, float(np.linalg.norm(means[0])))


def _samples(name: str, value: ArrayLike) -> Floats:
    found = checks.array(name, value, "(n, 3)").astype(np.float64)
    if len(found) < 2 * _PIECES:
        raise ValueError(f"{name}: found {len(found)} samples; accepted: at least {2 * _PIECES}")
    return found


def _quarters(data: Floats) -> Floats:
    return np.stack([piece.mean(axis=0) for piece in np.array_split(data, _PIECES)])


def _same(name: str, changes: Floats, unit: str, limit: float) -> None:
    if changes.max() > limit:
        raise ValueError(
            f"{name}: quarters of the samples differ by {changes.max():.3g} {unit} from the mean; "
            f"accepted: at rest, at most {limit:g} (largest_change)"
        )


def _angles(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), a @ b))


def _least_turn(mean: Floats, up: Floats, deviation: float) -> tuple[Floats, Floats]:
    """The smallest rotation that brings a direction up, and the covariance about body axes."""
    if not up.any():
        raise ValueError("up: found the zero vector; accepted: any other")
    f, u = normalised(mean), normalised(up)
    q = np.array([1.0, 0.0, 0.0, 0.0])
    if f @ u < 1e-9 - 1.0:  # upside down: rotate about any orthogonal axis
        q = np.array([0.0, *normalised(np.cross(f, np.eye(3)[np.argmin(np.abs(f))]))])
    for _ in range(2):  # the second pass corrects the rounding of the first
        seen = quat_rotate(q, f)
        q = normalised(quat_multiply([1.0 + seen @ u, *np.cross(seen, u)], q))
    along = np.outer(f, f)
    return q, deviation**2 * (np.eye(3) - along) + math.pi**2 * along
