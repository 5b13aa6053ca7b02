"""Multiplicative extended Kalman filter: attitude and gyro bias, for one filter or an ensemble.

The formulas are those of ``fastatt.estimation.updates``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval
from fastatt.estimation.filters import Estimates, Floats


class MEKF(Estimates):
    """Multiplicative extended Kalman filter of attitude and gyro bias, for one body or N.

    Every call changes the estimates in place.

    Parameters
    ----------
    q : array_like of shape (4,) or (N, 4)
        Attitudes, body to inertial, of any norm above zero.
    covariance : array_like of shape (6, 6) or (N, 6, 6)
        Covariance of (δθ, δb), in rad and rad/s.
    bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Gyro biases, rad/s.
    angle_noise : float
        Angle random walk σ_v, rad/√s, which is the noise density of the rate in rad/s/√Hz. For
        samples with a standard deviation of s rad/s at intervals of h seconds it is s √h.
    bias_noise : float
        Rate random walk σ_u of the bias, rad/s^1.5.
    invalid : {"raise", "skip"}, default "raise"
        Treatment of gyro samples and measurements that are not finite, and of zero vectors. "raise"
        raises an error. "skip" ignores such a measurement, and replaces such a gyro sample by the
        last finite one; before the first one the body does not rotate.

    Warns
    -----
    UserWarning
        If a filter has refused 10 measurements in a row because of their ``gate``; measurements
        that are ignored do not count. If the iteration of an update has not converged, because the
        attitude was much less certain than the vector.

    Notes
    -----
    A call of ``predict`` takes some µs for one filter, and 0.06 µs for each of many filters.

    Updates return the normalised innovation squared (NIS), a number or (N,). For a consistent
    filter it has a χ² distribution with three degrees of freedom, whether the attitude is known
    well or to 0.5 rad, or with two for a direction, whose length has no information. It is
    computed at the result of the iteration: the least sum of the normalised squares of correction
    and residual. The filter does not use a measurement whose NIS is above ``gate``. Of good
    measurements, 1 in 1000 has an NIS above 16.27, and of good directions above 13.82
    (``scipy.stats.chi2.ppf(0.999, 3)``, and with 2).

    References
    ----------
    Lefferts, Markley and Shuster, *Journal of Guidance and Control* 5 (1982) 417.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> mekf = fa.estimation.MEKF([1, 0, 0, 0], 0.01 * np.eye(6), angle_noise=1e-3, bias_noise=1e-5)
    >>> mekf.predict((0.0, 0.0, 0.1), 0.01)
    >>> nis = mekf.update_vector((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), sigma=0.01)
    >>> mekf.q.shape, mekf.covariance.shape
    ((4,), (6, 6))
    """

    def __init__(
        self,
        q: ArrayLike,
        covariance: ArrayLike,
        *,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        angle_noise: float,
        bias_noise: float,
        invalid: str = "raise",
    ) -> None:
        rates = checks.array("bias", bias, "(3,) or (N, 3)")
        super().__init__(q, "bias", rates, covariance, invalid)
        self._variances = (
            at_least_zero("angle_noise", angle_noise) ** 2,
            at_least_zero("bias_noise", bias_noise) ** 2,
        )
        # the last finite sample of each filter
        self._gyro = self._y.copy()

    @property
    def bias(self) -> Floats:
        """Gyro biases, rad/s: (3,) or (N, 3)."""
        return self._each(self._y)

    def predict(self, gyro: ArrayLike, dt: float) -> None:
        """Propagate the estimates over an interval with a gyro sample.

        Parameters
        ----------
        gyro : array_like of shape (3,) or (N, 3)
            Mean rate over the interval along body axes, rad/s. From an angle increment, pass the
            increment divided by ``dt``; from rates at instants, the mean of those at the ends.
        dt : float
            Interval, s, above 0.

        Raises
        ------
        ValueError
            If a shape does not fit, the interval is not above 0, or a sample is not finite and
            ``invalid`` is "raise".
        """
        rates, h = self._vectors("gyro", gyro), interval(dt)
        good = np.isfinite(rates).all(axis=-1, keepdims=True) if self._skips else True
        np.copyto(self._gyro, rates, where=good)
        call = self._operation("predict", self._gyro)
        (shared,) = call.inputs
        shared[:] = h, *self._variances
        call.run()
