"""A gyro log, and why one cannot be read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


class GyroLogError(ValueError):
    """A log can't be read; the message says why in one line."""


class GyroLogWarning(UserWarning):
    """Warns of many rows that were left out."""


@dataclass(frozen=True)
class GyroLog:
    """A gyro log of n samples in SI units, as :func:`fastatt.read_gyro_log` returns it.

    Attributes
    ----------
    t : ndarray of shape (n,)
        Times from the first sample, s.
    rates : ndarray of shape (n, 3)
        Rates along body axes, rad/s.
    dt : ndarray of shape (n - 1,)
        Intervals, s.
    accel : ndarray of shape (n, 3), or None
        Specific force, m/s². NaN where the log has no number.
    mag : ndarray of shape (n, 3), or None
        Magnetic field, in the log's unit. NaN where the log has no number.
    rate : float
        Sample rate, Hz: the inverse of the mean interval, without intervals longer than 2.5 times
        the median.
    start : float
        The first time stamp, s (0 if there is none).
    summary : str
        A line that describes what was recognised.
    """

    rates: NDArray[np.float64]
    dt: NDArray[np.float64]
    t: NDArray[np.float64]
    rate: float
    accel: NDArray[np.float64] | None = None
    mag: NDArray[np.float64] | None = None
    start: float = 0.0
    summary: str = ""

    def __str__(self) -> str:
        return self.summary
