"""Multiplicative extended Kalman filter: attitude and gyro bias, one filter or an ensemble of them.

The formulas are those of ``fastatt.estimation.updates``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval
from fastatt.estimation.filters import Estimates, Floats


class MEKF(Estimates):
    """Attitude and gyro bias of one body, or of N at once, each with its own covariance.

    Parameters
    ----------
    q : (4,) or (N, 4), attitudes, body to inertial, of any length but zero.
    covariance : (6, 6) or (N, 6, 6), of (δθ, δb) in rad and rad/s.
    bias : (3,) or (N, 3), rad/s.
    angle_noise : σ_v, rad/√s (a noise density of the rate, rad/s/√Hz, is the same number).
    bias_noise : σ_u, rad/s^1.5.
    invalid : "raise" refuses samples and measurements that are not finite; "skip" leaves out such
        a measurement for its filters, and holds the last good sample of a gyro in its place
        (before the first: no rotation).

    Attributes
    ----------
    q, bias, covariance : the estimates, with the shapes above.

    Every call changes them in place. A ``predict`` of one filter takes some µs from Python, of many
    0.06 µs a filter.

    Updates give the normalised innovation squared (NIS), a number or (N,): χ² with three degrees of
    freedom where the filter is right, of a direction, whose length says nothing, with about two.
    One beyond ``gate`` is not used: of good measurements 1 in 1000 is beyond 16.27, of directions
    13.82 (``scipy.stats.chi2.ppf(0.999, 3)`` or 2). NIS is NaN where a measurement was left out.
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
        # the last good sample
        self._gyro = self._y.copy()

    @property
    def bias(self) -> Floats:
        """Biases, (3,) or (N, 3), rad/s."""
        return self._each(self._y)

    def predict(self, gyro: ArrayLike, dt: float) -> None:
        """Go dt s on by a gyro sample, (3,) or (N, 3), rad/s; an increment over dt divided by dt.

        Raises ``ValueError`` for another shape, an interval not above 0, and as ``invalid`` says.
        """
        rates, h = self._vectors("gyro", gyro), interval(dt)
        good = np.isfinite(rates).all(axis=-1, keepdims=True) if self._skips else True
        np.copyto(self._gyro, rates, where=good)
        call = self._call("predict", self._gyro)
        call.shared[:] = h, *self._variances
        call.run()

    def nees(self, q: ArrayLike, bias: ArrayLike) -> Any:
        """Normalised estimation error squared against the truth, χ² with 6 degrees of freedom."""
        return super().nees(q, bias)
