"""Unscented Kalman filter on the rotation group, with all sigma points as one ensemble."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import normalised, quat_to_dcm, rotation_vector_to_quat
from fastatt.codegen.rows import rows
from fastatt.estimation.amounts import covariances, definite, largest_square
from fastatt.estimation.filters import Estimates, Floats, normalised_square, turned
from fastatt.estimation.motions import Motion, moved_rows
from fastatt.estimation.updates import spreading
from fastatt.tracing.formulas import Vector, quat

# largest angle of a sigma point from the mean after a motion, rad, since errors of π are ambiguous
_FAR = 0.75 * math.pi


class UKF(Estimates):
    """Unscented Kalman filter of attitude and an auxiliary state of K numbers, for one body or N.

    Every call changes the estimates in place.

    Parameters
    ----------
    q : array_like of shape (4,) or (N, 4)
        Attitudes, body to inertial, of any norm above zero.
    y : array_like of shape (K,) or (N, K)
        Auxiliary states, such as a gyro bias or an angular velocity.
    covariance : array_like of shape (D, D) or (N, D, D)
        Covariance of (δθ, δy), D = 3 + K.
    kappa : float, default 1.0
        κ, above −D. With a negative κ the covariance may become indefinite.
    invalid : {"raise", "skip"}, default "raise"
        Treatment of measurements that are not finite, and of zero vectors: "raise" raises an error,
        and "skip" ignores them.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit. A method raises ``ValueError`` if a covariance has become
        indefinite; the estimates are then as before the call.

    Warns
    -----
    UserWarning
        If a motion moves points farther than 3π/4 rad from their mean, where errors are ambiguous;
        for vectors with attitude deviations above 0.7 rad; if a filter has refused 10 measurements
        in a row because of their ``gate``.

    Notes
    -----
    The error is (δθ, δy), q_true = q∘exp(δθ), y_true = y + δy. The 2D + 1 sigma points lie at ±√(D
    + κ) L about the estimate, P = L Lᵀ, with the columns of L along the principal axes of the
    attitude's covariance. Their weights are ½/(D + κ), and κ/(D + κ) at the centre. All points of
    all filters are propagated in one ensemble. After a motion, the mean attitude is where the
    weighted errors cancel, found by two Gauss-Newton steps. An update expresses the covariance
    along the axes of the corrected attitude.

    Errors beyond π are ambiguous, so that the filter places no point farther than π/2 rad from the
    estimate. If a standard deviation would place them farther (with D = 6 and κ = 1, one above 0.59
    rad), it moves the points closer and scales their moments (Julier 2002). The standard deviation
    of an unobservable heading may thus be of any size. Points whose rates differ by δw during a
    motion of T s, by :func:`gyro_motion` or by the :func:`scene_motion` of a body, lie closer by
    ``|δw|`` T.

    Updates return the normalised innovation squared, or NaN for measurements that were ignored, and
    do not use measurements above ``gate``; see :class:`MEKF`.

    References
    ----------
    Julier and Uhlmann, *Proceedings of the IEEE* 92 (2004) 401; Crassidis and Markley, *Journal of
    Guidance, Control, and Dynamics* 26 (2003) 536; Kraft, *International Conference on Information
    Fusion* (2003); Julier, *American Control Conference* (2002) 4555.

    Examples
    --------
    >>> import numpy as np
    >>> from fastatt import estimation as es
    >>> ukf = es.UKF([1, 0, 0, 0], [0, 0, 0], 0.01 * np.eye(6))
    >>> ukf.predict(es.gyro_motion((0.0, 0.0, 0.1), 0.01), 1e-8 * np.eye(6))
    >>> ukf.q.shape, ukf.covariance.shape
    ((4,), (6, 6))
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

    @property
    def y(self) -> Floats:
        """Auxiliary states: (K,) or (N, K)."""
        return self._each(self._y)

    def sigma_points(self) -> tuple[Floats, Floats]:
        """The sigma points, with the estimate first.

        Returns
        -------
        q : ndarray of shape (N, 2D + 1, 4)
            Attitudes.
        y : ndarray of shape (N, 2D + 1, K)
            Auxiliary states.
        """
        return self._points(0.0)[:2]

    def _points(self, seconds: float) -> tuple[Floats, Floats, Floats, Floats]:
        """The sigma points, L, and their distances in columns of it, (N, D).

        The points are to move for some seconds at rates in the first auxiliary numbers.
        """
        n, size = self._P.shape[:2]
        state = [self._q, self._y, self._P.reshape(n, -1)]
        call = self._bounds.get("points") or self._bound("points", spreading(size - 3), state)
        axes, shared = call.inputs
        axes[:] = np.linalg.eigh(self._P[:, :3, :3])[1].reshape(n, 9)
        shared[:] = math.sqrt(size + self._kappa), seconds
        call.run()
        q, y, L, columns = (x.copy() for x in call.outputs)
        if not checks.all_finite(L):
            k = int(np.argmin(np.isfinite(L).all(axis=1)))
            raise ValueError(
                f"covariance{'' if self._one else [k]}: has a negative variance; accepted: a "
                "covariance, which kappa from 0 on keeps"
            )
        points = (n, 2 * size + 1, -1)
        return q.reshape(points), y.reshape(points), L.reshape(n, size, size), columns

    def _moments(self, x: Floats, columns: Floats) -> tuple[Floats, Floats, Floats]:
        """Moments of (N, 2D + 1, m) at the points.

        The mean (N, m), the change along a column of L (N, D, m), and the covariance (N, m, m) that
        these changes do not explain.
        """
        size = columns.shape[1]
        centre, above, below = x[:, 0], x[:, 1 : size + 1], x[:, size + 1 :]
        distance = columns[..., None]
        slopes = (above - below) / (2.0 * distance)
        curves = (above + below - 2.0 * centre[:, None]) / (2.0 * distance**2)
        shift = curves.sum(axis=1)
        spread = (size + self._kappa) * np.swapaxes(curves, 1, 2) @ curves
        return centre + shift, slopes, spread - shift[:, :, None] * shift[:, None]

    def predict(self, motion: Motion, noise: ArrayLike) -> None:
        """Propagate the sigma points and add the covariance of the noise.

        Parameters
        ----------
        motion : callable
            ``motion(q, y) -> (q, y)`` for the M = N (2D + 1) points, (M, 4) and (M, K), with those
            of one filter in a row: :func:`gyro_motion`, :func:`scene_motion` or a user-defined
            function.
        noise : array_like of shape (D, D) or (N, D, D)
            Covariance of the noise.
        """
        n, size = self._P.shape[:2]
        added = covariances("noise", noise, f"({size}, {size}) or ({n}, {size}, {size})")
        q, y, _, columns = self._points(getattr(motion, "seconds", 0.0))
        m = q.shape[0] * q.shape[1]
        moved = moved_rows(motion, q.reshape(m, 4), y.reshape(m, size - 3))
        q, y = moved[0].reshape(q.shape), moved[1].reshape(y.shape)
        formula = rows(_about, {"q": 4, "mean": 4, "shift": 3}, (4, 3))
        call = self._bounds.get("mean") or self._bound("mean", formula, [], n=m)
        of_points = [x.reshape(n, -1, x.shape[-1]) for x in (*call.inputs, *call.outputs)]
        moved_q, means, shifts, shifted, errors = of_points
        moved_q[:], means[:], shifts[:] = q, q[:, :1], 0.0
        for _ in range(3):
            call.run()
            centre, slopes, spread = self._moments(np.concatenate([errors, y], axis=-1), columns)
            means[:], shifts[:] = shifted, centre[:, None, :3]
        farthest = float(np.linalg.norm(errors, axis=-1).max())
        if farthest > _FAR:
            warnings.warn(
                f"motion: put sigma points {farthest:.3g} rad from their mean, where errors beyond "
                "π would be taken for others; shorter motions between updates keep them nearer",
                stacklevel=2,
            )
        P = np.swapaxes(slopes, 1, 2) @ slopes + spread + added
        self._set(slice(None), shifted[:, 0], centre[:, 3:], P)

    def update(
        self,
        observe: Callable[[Floats, Floats], Floats],
        measured: ArrayLike,
        noise: ArrayLike,
        *,
        gate: float | None = None,
        period: ArrayLike | None = None,
    ) -> Any:
        """Update with a measurement.

        Parameters
        ----------
        observe : callable
            ``observe(q, y)`` returns the expected measurements (M, m) at the points, (M, 4) and (M,
            K).
        measured : array_like of shape (m,) or (N, m)
            The measurement.
        noise : array_like of shape (m, m) or (N, m, m)
            Covariance of its noise.
        gate : float, optional
            Measurements whose normalised innovation squared is larger are not used.
        period : float or array_like of shape (m,), optional
            Periods of measurements that are angles, such as 2π of a heading in rad, infinite for
            others. Differences between points, and from the measurement, are then the shortest
            ones. Without it a heading near ±π is wrong by up to a full rotation.

        Returns
        -------
        float or ndarray of shape (N,)
            Normalised innovation squared, χ² with m degrees of freedom if the filter is consistent.
        """
        q, y, L, columns = self._points(0.0)
        (n, points), size = q.shape[:2], self._P.shape[1]
        total = n * points
        checks.function("observe", observe, "a function observe(q, y)")
        values = observe(q.reshape(total, 4), y.reshape(total, size - 3))
        values = checks.array("observe", values, f"({total}, m)", [(total, -1)]).astype(np.float64)
        z = values.reshape(n, points, -1)
        m = z.shape[-1]
        added = definite("noise", noise, f"({m}, {m}) or ({n}, {m}, {m})")
        seen = checks.array("measured", measured, f"({m},) or ({n}, {m})", flag=True)
        if not self._skips:
            checks.finite("measured", seen)
        wrapped = _wrapping(period, m)
        z = z[:, :1] + wrapped(z - z[:, :1])
        expected, slopes, spread = self._moments(z, columns)
        across = np.swapaxes(slopes, 1, 2)
        S = across @ slopes + spread + added
        gain = np.swapaxes(np.linalg.solve(S, across), 1, 2)
        innovation = wrapped(seen - expected)
        nis = normalised_square(innovation, S)
        d = (L @ gain @ innovation[..., None])[..., 0]
        left = np.eye(size) - gain @ across
        before = attitude_variance(self._P)
        # along the axes of the corrected attitude
        back = quat_to_dcm(rotation_vector_to_quat(-d[:, :3]))
        seen_from = np.concatenate([back @ L[:, :3], L[:, 3:]], axis=1)
        q = turned(self._q, d[:, :3])
        used = nis <= largest_square(gate)
        self._set(used, q, self._y + d[:, 3:], seen_from @ left @ np.swapaxes(seen_from, 1, 2))
        return self._checked_nis(nis, gate, before - attitude_variance(self._P))

    def _set(self, used: Any, q: Floats, y: Floats, P: Floats) -> None:
        """Store the estimates of those filters that are used."""
        self._q[used], self._y[used] = normalised(q)[used], y[used]
        self._P[used] = 0.5 * (P + np.swapaxes(P, 1, 2))[used]


def _wrapping(period: Any, m: int) -> Callable[[Any], Any]:
    """Differences of m measurements, the shortest ones of those that have a period."""
    if period is None:
        return lambda difference: difference
    periods = np.asarray(period, dtype=np.float64)
    if periods.shape not in ((), (m,)) or not (periods > 0.0).all():
        raise ValueError(
            f"period: found {checks.brief(period)}; accepted: a number above 0, or ({m},), "
            "infinite for what is no angle"
        )
    finite = np.where(np.isinf(periods), 0.0, periods)
    return lambda difference: difference - finite * np.rint(difference / periods)


def _about(q: Vector, mean: Vector, shift: Vector) -> Any:
    """The mean after a shift, and the error δθ of the attitude q from it."""
    shifted = quat.renormalise(quat.mul(mean, quat.exp(shift)))
    return shifted, quat.log(quat.mul(quat.conj(shifted), q))


def attitude_variance(P: Floats) -> Any:
    """The sum of the variances of the attitude, rad²."""
    return np.trace(P[:, :3, :3], axis1=1, axis2=2)
