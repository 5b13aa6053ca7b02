"""Unscented Kalman filter on the rotation group: all sigma points are moved as one ensemble."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import quat_multiply, rotate_inverse, rotation_vector_to_quat
from fastatt.estimation.amounts import covariances
from fastatt.estimation.filters import (
    Estimates,
    Floats,
    Motion,
    attitude_covariance,
    attitude_error,
    largest_square,
    measured_attitudes,
    normalised_square,
)


class UKF(Estimates):
    """Attitude and K numbers beside it, of one body or of N at once.

    The error is (δθ, δy), q_true = q∘exp(δθ), y_true = y + δy; its 2D + 1 sigma points (D = 3 + K)
    lie at the columns of ±√((D + κ) P) about the estimate, with weights ½/(D + κ), and κ/(D + κ)
    at the centre. All points of all filters are moved in one ensemble. After a motion the mean
    attitude is where the weighted errors cancel, by two Gauss-Newton steps. Julier and Uhlmann,
    Proc. IEEE 92 (2004) 401; Crassidis and Markley, J. Guidance 26 (2003) 536; Kraft, Int. Conf.
    Information Fusion (2003).

    Parameters
    ----------
    q : (4,) or (N, 4), attitudes, body to inertial, of any length but zero.
    y : (K,) or (N, K), what is estimated beside them: a gyro's bias, an angular velocity.
    covariance : (D, D) or (N, D, D), of (δθ, δy).
    kappa : κ, above −D; below 0 the covariance may lose its sign.
    invalid : "raise" refuses measurements that are not finite; "skip" leaves them out, for the
        filters that they are for.

    Attributes
    ----------
    q, y, covariance : the estimates, with the shapes above.

    Updates give the normalised innovation squared, do not use what is beyond ``gate``, and give NaN
    for what was left out: see :class:`MEKF`. Raises ``numpy.linalg.LinAlgError`` in a call that
    meets a covariance that is not positive.
    """

    def __init__(
        self,
        q: ArrayLike,
        y: ArrayLike,
        covariance: ArrayLike,
        *,
        kappa: float = 1.0,
        invalid: str = "raise",
    ) -> None:
        super().__init__(q, "y", checks.array("y", y, "(K,) or (N, K)"), covariance, invalid)
        size = self._P.shape[-1]
        self._kappa = checks.real("kappa", kappa)
        if self._kappa <= -size:
            raise ValueError(f"kappa: found {kappa}; accepted: above {-size}")
        self._weights = np.full(2 * size + 1, 0.5 / (size + self._kappa))
        self._weights[0] = self._kappa / (size + self._kappa)

    @property
    def y(self) -> Floats:
        """What is estimated beside them, (K,) or (N, K)."""
        return self._each(self._y)

    def sigma_points(self) -> tuple[Floats, Floats]:
        """Attitudes (N, 2D + 1, 4) and numbers (N, 2D + 1, K), the estimate first."""
        n, size = self._P.shape[:2]
        root = np.swapaxes(np.linalg.cholesky(self._P), 1, 2) * math.sqrt(size + self._kappa)
        d = np.concatenate([np.zeros((n, 1, size)), root, -root], axis=1)
        q = quat_multiply(self._q[:, None], rotation_vector_to_quat(d[..., :3]))
        return q, self._y[:, None] + d[..., 3:]

    def predict(self, motion: Motion, noise: ArrayLike) -> None:
        """Move the sigma points and add the noise's covariance, (D, D) or (N, D, D).

        ``motion(q, y)`` takes and gives the M = N (2D + 1) points, (M, 4) and (M, K), those of one
        filter in a row: :func:`gyro_motion`, :func:`scene_motion` or a function of your own.
        """
        q, y = self.sigma_points()
        shape = q.shape[:2]
        q, y = motion(q.reshape(-1, 4), y.reshape(-1, y.shape[-1]))
        q, y = q.reshape(*shape, 4), y.reshape(*shape, -1)
        mean = q[:, 0]
        for _ in range(2):
            step = self._weights @ attitude_error(mean[:, None], q)
            mean = quat_multiply(mean, rotation_vector_to_quat(step))
        centre = self._weights @ y
        d = np.concatenate([attitude_error(mean[:, None], q), y - centre[:, None]], axis=-1)
        self._q, self._y = np.asarray(mean), centre
        spread = np.swapaxes(d, 1, 2) @ (self._weights[:, None] * d)
        self._P = spread + self._noise(noise, d.shape[-1])

    def update(
        self,
        observe: Callable[[Floats, Floats], Floats],
        measured: ArrayLike,
        noise: ArrayLike,
        *,
        gate: float | None = None,
    ) -> Any:
        """Use a measurement (m,) or (N, m) with a noise of covariance (m, m) or (N, m, m).

        ``observe(q, y)`` gives what the points, (M, 4) and (M, K), would measure, (M, m). Gives the
        normalised innovation squared, χ² with m degrees of freedom, a number or (N,).
        """
        q, y = self.sigma_points()
        n, points, size = *q.shape[:2], self._P.shape[1]
        z = observe(q.reshape(-1, 4), y.reshape(-1, size - 3)).reshape(n, points, -1)
        m = z.shape[-1]
        seen = checks.array("measured", measured, f"({m},) or ({n}, {m})", flag=True)
        if not self._skips:
            checks.finite("measured", seen)
        expected = self._weights @ z
        away = z - expected[:, None]
        d = np.concatenate([attitude_error(self._q[:, None], q), y - self._y[:, None]], axis=-1)
        weighted = self._weights[:, None] * away
        return self._correct(
            seen - expected,
            np.swapaxes(d, 1, 2) @ weighted,
            np.swapaxes(away, 1, 2) @ weighted + self._noise(noise, m),
            gate,
        )

    def update_vector(
        self, measured: ArrayLike, reference: ArrayLike, sigma: float, *, gate: float | None = None
    ) -> Any:
        """Use a vector: measured in body axes, its reference along inertial ones; (3,) or (N, 3).

        ``sigma`` is the standard deviation of each component, in the vectors' unit, above 0.
        """
        fixed = checks.array("reference", reference, f"(3,) or ({len(self._q)}, 3)")
        points = len(self._weights)
        each = np.repeat(fixed, points, axis=0) if fixed.ndim == 2 else fixed

        def observe(q: Floats, y: Floats) -> Floats:
            return np.asarray(rotate_inverse(q, each))

        return self.update(
            observe, measured, checks.above_zero("sigma", sigma) ** 2 * np.eye(3), gate=gate
        )

    def update_attitude(
        self, measured: ArrayLike, sigma: ArrayLike, *, gate: float | None = None
    ) -> Any:
        """Use attitudes, (4,) or (N, 4), unit; ``sigma`` as for :meth:`MEKF.update_attitude`."""
        rows = measured_attitudes(measured, len(self._q), skips=self._skips)
        error = attitude_error(self._q, rows)
        P = self._P[:, :, :3]
        return self._correct(error, P, P[:, :3] + attitude_covariance(sigma), gate)

    def _noise(self, noise: ArrayLike, size: int) -> Floats:
        return covariances("noise", noise, f"({size}, {size}) or ({len(self._q)}, {size}, {size})")

    def _correct(
        self, innovation: Floats, cross: Floats, spread: Floats, gate: float | None
    ) -> Any:
        found = normalised_square(innovation, spread)
        used = found <= largest_square(gate)
        innovation = np.where(used[:, None], innovation, 0.0)
        gain = np.swapaxes(np.linalg.solve(spread, np.swapaxes(cross, 1, 2)), 1, 2)
        gain = np.where(used[:, None, None], gain, 0.0)
        d = (gain @ innovation[..., None])[..., 0]
        self._q = np.asarray(quat_multiply(self._q, rotation_vector_to_quat(d[:, :3])))
        self._y = self._y + d[:, 3:]
        P = self._P - gain @ np.swapaxes(cross, 1, 2)
        self._P = 0.5 * (P + np.swapaxes(P, 1, 2))
        return self._figures(found)
