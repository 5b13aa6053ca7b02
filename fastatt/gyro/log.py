"""A gyro log, and why one cannot be read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: what the numbers in a log can be
VALUES = ("samples", "means", "increments")


class GyroLogError(ValueError):
    """A log can't be read; the message says why in one line."""


class GyroLogWarning(UserWarning):
    """Warns of many rows that were left out."""


@dataclass(frozen=True)
class GyroLog:
    """A gyro log in SI units, as :func:`fastatt.read_gyro_log` returns it.

    Attributes
    ----------
    t : ndarray of shape (n,)
        Times from the first one, s.
    rates : ndarray of shape (n, 3) or (n - 1, 3)
        Rates along body axes, rad/s: at the n times, or, where ``values`` is not "samples", the
        means over the n - 1 intervals between them.
    dt : ndarray of shape (n - 1,)
        Intervals, s.
    values : {"samples", "means", "increments"}
        What the numbers in the log are: rates at the times of their stamps, mean rates over the
        intervals that end there, or angle increments over these. :func:`fastatt.integrate_rates`
        follows it, for the log itself and for its ``rates`` and ``dt``.
    accel : ndarray, or None
        Specific force at the time of each rate, m/s². NaN where the log has no number.
    mag : ndarray, or None
        Magnetic field at the time of each rate, in the log's unit. NaN where the log has no number.
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
    values: str = "samples"

    def __str__(self) -> str:
        return self.summary
