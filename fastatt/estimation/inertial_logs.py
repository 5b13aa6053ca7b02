"""Preintegration of whole logs, one or many."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, quat_rotate, rotation_vector_to_quat
from fastatt.codegen.rows import LogFunction
from fastatt.estimation import preintegration as pre
from fastatt.estimation.amounts import at_least_zero, common_number, triples
from fastatt.gyro.intervals import intervals
from fastatt.threads import number_of
from fastatt.tracing.formulas import Vector, minus

_TRIPLE = (0.0, 0.0, 0.0)
# sizes of a state's parts, those of its rotation first
_WIDTHS = (1, 4, 9, 6, 3, 3, 9, 9, 9, 9, 9, 9, 6, 9, 6)
_SIZE, _ROTATION = sum(_WIDTHS), sum(_WIDTHS[:4])


def nested(x: Vector) -> pre.Preintegrated:
    """The state from its 101 numbers."""
    t, *parts = (x[end - n : end] for n, end in zip(_WIDTHS, accumulate(_WIDTHS), strict=True))
    return pre.Preintegrated(pre.PreintegratedRotation(*t, *parts[:3]), *parts[3:])


def _step(x: Vector, w: Vector, a: Vector, h: Vector, bg: Vector, ba: Vector, v: Vector) -> Any:
    return pre.add_sample(nested(x), minus(w, bg), minus(a, ba), *h, *v)


_INPUTS = {"state": _SIZE, "w": 3, "a": 3, "h": 1, "bg": 3, "ba": 3, "variances": 2}
_LOGS = LogFunction(_step, _INPUTS, (_SIZE,))


@dataclass(frozen=True, eq=False)
class Preintegration:
    """Preintegrated motion between two times i and j, from a gyro and an accelerometer.

    For N logs, arrays have a leading axis N. Without an accelerometer, everything but the rotation
    is NaN.

    Attributes
    ----------
    duration : ndarray of shape ()
        Time from i to j, s.
    rotation : ndarray of shape (4,)
        ΔR as a unit quaternion.
    velocity : ndarray of shape (3,)
        Δv along the body axes at i, m/s.
    position : ndarray of shape (3,)
        Δp along the body axes at i, m.
    rotation_gyro : ndarray of shape (3, 3)
        Jacobian of the rotation error (along the body axes at j) with respect to the gyro bias.
    velocity_gyro, velocity_accel : ndarray of shape (3, 3)
        Jacobians of Δv with respect to the gyro bias and to the accelerometer bias.
    position_gyro, position_accel : ndarray of shape (3, 3)
        Jacobians of Δp with respect to the same biases.
    covariance : ndarray of shape (9, 9)
        Covariance of the errors (δφ, δv, δp), in this order: δφ of ΔR, rad, along the body axes at
        j, with ΔR_true = ΔR∘exp(δφ); δv of Δv, m/s, and δp of Δp, m, along the body axes at i.
    rows : ndarray of shape (101,)
        The numbers from which the other attributes are made, without the redundant ones.
    """

    duration: NDArray[np.float64]
    rotation: NDArray[np.float64]
    velocity: NDArray[np.float64]
    position: NDArray[np.float64]
    rotation_gyro: NDArray[np.float64]
    velocity_gyro: NDArray[np.float64]
    velocity_accel: NDArray[np.float64]
    position_gyro: NDArray[np.float64]
    position_accel: NDArray[np.float64]
    covariance: NDArray[np.float64]
    #: all numbers, with a row of 101 for each log
    rows: NDArray[np.float64]

    def corrected(
        self, gyro_bias: ArrayLike = _TRIPLE, accel_bias: ArrayLike = _TRIPLE
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Correct the increments for changed biases, to first order.

        Parameters
        ----------
        gyro_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
            Increase of the gyro bias, rad/s.
        accel_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
            Increase of the accelerometer bias, m/s².

        Returns
        -------
        rotation, velocity, position : ndarray
            ΔR, Δv and Δp.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit.
        """
        gyro, accel = self._vectors(gyro_bias=gyro_bias, accel_bias=accel_bias)
        q = quat_multiply(self.rotation, rotation_vector_to_quat(_times(self.rotation_gyro, gyro)))
        v = self.velocity + _times(self.velocity_gyro, gyro) + _times(self.velocity_accel, accel)
        p = self.position + _times(self.position_gyro, gyro) + _times(self.position_accel, accel)
        return np.broadcast_to(q, (*v.shape[:-1], 4)), v, p

    def _vectors(self, **values: ArrayLike) -> list[NDArray[Any]]:
        """Vectors (3,) or (N, 3), for one log or each."""
        vectors = {name: checks.array(name, x, "(3,) or (N, 3)") for name, x in values.items()}
        rows = {name: np.atleast_2d(x) for name, x in vectors.items()}
        common_number("logs", preintegrated=self.rows, **rows)
        return list(vectors.values())

    def predict(
        self,
        q: ArrayLike,
        v: ArrayLike,
        p: ArrayLike,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.80665),
        gyro_bias: ArrayLike = _TRIPLE,
        accel_bias: ArrayLike = _TRIPLE,
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Predict the state at j from the state at i.

        Parameters
        ----------
        q : array_like of shape (4,) or (N, 4)
            Attitude at i, body to inertial.
        v : array_like of shape (3,) or (N, 3)
            Velocity at i along inertial axes, m/s.
        p : array_like of shape (3,) or (N, 3)
            Position at i along inertial axes, m.
        gravity : array_like of shape (3,), default (0, 0, -9.80665)
            Acceleration by gravity along inertial axes, m/s².
        gyro_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
            Increase of the gyro bias since the samples were added, rad/s.
        accel_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
            Increase of the accelerometer bias, m/s².

        Returns
        -------
        q, v, p : ndarray
            Attitude, velocity and position at j.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit, or there were no accelerometer samples.
        """
        if np.isnan(self.rows[:, _ROTATION:]).all():
            raise ValueError(
                "accel: found None where the samples were added; accepted: samples, without which "
                "only the attitude at j is known: fastatt.quat_multiply(q, rotation)"
            )
        dq, dv, dp = self.corrected(gyro_bias, accel_bias)
        g = checks.array("gravity", gravity, "(3,)")
        start = normalised(checks.attitudes("q", q).astype(np.float64))
        v0, p0 = self._vectors(v=v, p=p)
        common_number("logs", preintegrated=self.rows, q=np.atleast_2d(start))
        t = self.duration[..., None]
        position = p0 + t * v0 + 0.5 * t * t * g + quat_rotate(start, dp)
        velocity = np.broadcast_to(v0 + t * g + quat_rotate(start, dv), position.shape)
        attitude = np.broadcast_to(quat_multiply(start, dq), (*position.shape[:-1], 4))
        return attitude, velocity, position


_UPPER = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # indices of a symmetric block, as in ``sym3``


def _times(A: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    return np.asarray((A @ x[..., None])[..., 0])


def preintegrate(
    gyro: ArrayLike,
    accel: ArrayLike | None,
    dt: ArrayLike,
    *,
    gyro_noise: float = 0.0,
    accel_noise: float = 0.0,
    gyro_bias: ArrayLike = _TRIPLE,
    accel_bias: ArrayLike = _TRIPLE,
    n_threads: int | None = None,
) -> Preintegration:
    """Preintegrate the samples of a gyro and an accelerometer between two times.

    The result has the rotation, velocity and position increments, their covariance, and their
    Jacobians with respect to the biases.

    Parameters
    ----------
    gyro : array_like of shape (n, 3) or (N, n, 3)
        Gyro samples along body axes, rad/s, each held over its interval.
    accel : array_like of the same shape, or None
        Specific force along body axes, m/s². None preintegrates the rotation only.
    dt : float or array_like of shape (n,)
        The interval, or the n intervals, s.
    gyro_noise : float, default 0.0
        Noise density σ_g, rad/√s. For samples with a standard deviation of s rad/s at intervals of
        h seconds it is s √h.
    accel_noise : float, default 0.0
        Noise density σ_a, m/s^1.5, in the same way.
    gyro_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Bias that is subtracted from ``gyro``, rad/s.
    accel_bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Bias that is subtracted from ``accel``, m/s².
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.

    Returns
    -------
    Preintegration
        The increments.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is not finite, an interval is not above 0, or a density is
        negative.

    References
    ----------
    Forster, Carlone, Dellaert and Scaramuzza, *IEEE Transactions on Robotics* 33 (2017) 1.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> gyro, accel = np.zeros((10, 3)), np.tile([0.0, 0.0, 9.80665], (10, 1))
    >>> found = fa.estimation.preintegrate(gyro, accel, 0.1)
    >>> q, v, p = found.predict([1, 0, 0, 0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    >>> (p.round(9) + 0.0).tolist()
    [1.0, 0.0, 0.0]
    """
    w = checks.array("gyro", gyro, "(n, 3) or (N, n, 3)")
    one = w.ndim == 2
    w = np.ascontiguousarray(w[None] if one else w, dtype=np.float64)
    n_logs, n = w.shape[:2]
    bg, ba = triples("gyro_bias", gyro_bias, n_logs), triples("accel_bias", accel_bias, n_logs)
    spans = np.ascontiguousarray(
        np.broadcast_to(intervals(dt, n, np.inf, np.dtype(np.float64)), (n,))
    )
    densities = at_least_zero("gyro_noise", gyro_noise), at_least_zero("accel_noise", accel_noise)
    a: NDArray[np.float64] = np.zeros((1, 1, 3))
    if accel is not None:
        forces = checks.array("accel", accel, f"{np.shape(gyro)}, as gyro", [np.shape(gyro)])
        a = np.asarray(forces.reshape(w.shape), dtype=np.float64)
    h, threads = spans[None, :, None], number_of(n_threads)
    state = np.zeros((n_logs, _SIZE))
    state[:, 1] = 1.0  # of the quaternion
    state = _LOGS(state, (w, a, h), (bg, ba, np.square([densities])), threads)
    if accel is None:
        state[:, _ROTATION:] = np.nan
    return _unpacked(state, one)


def _unpacked(rows: NDArray[np.float64], one: bool) -> Preintegration:
    n = len(rows)
    t, q, slopes, rr, v, p, *parts = np.split(rows, np.cumsum(_WIDTHS[:-1]), axis=1)
    covariance = np.empty((n, 3, 3, 3, 3))
    blocks = zip(combinations_with_replacement(range(3), 2), (rr, *parts[4:]), strict=True)
    for (i, j), numbers in blocks:
        block = (numbers[:, _UPPER] if i == j else numbers).reshape(n, 3, 3)
        covariance[:, i, :, j] = block
        covariance[:, j, :, i] = np.swapaxes(block, 1, 2)
    matrices = [x.reshape(n, 3, 3) for x in (slopes, *parts[:4])]
    results = t[:, 0], q, v, p, *matrices, covariance.reshape(n, 9, 9)
    return Preintegration(*[*(x[0] if one else x for x in results), rows])
