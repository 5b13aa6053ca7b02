"""A gyro log, and why one cannot be read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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
    path : Path
        The file.
    t : ndarray of shape (n,)
        Times from the first sample, s. Across a reset of the clock, the interval is the median one.
    rates : ndarray of shape (n, 3)
        Rates along body axes, rad/s.
    dt : ndarray of shape (n - 1,)
        Intervals, s.
    accel : ndarray of shape (n, 3), or None
        Specific force, m/s². NaN where the log has no number.
    mag : ndarray of shape (n, 3), or None
        Magnetic field, in the log's unit. NaN where the log has no number.
    columns : tuple of str
        The gyro's columns.
    unit : str
        The unit of the gyro's columns.
    timing : str
        The source of the times.
    rate : float
        Sample rate, Hz: the inverse of the mean interval, without intervals longer than 2.5 times
        the median.
    start : float
        The first time stamp, s (0 if there is none).
    pieces : tuple of slice
        Ranges of samples without a break: one, unless ``on_bad_rows="split"``. The intervals of a
        piece are ``dt[piece.start : piece.stop - 1]``.
    events : tuple of (str, int, float)
        Bad rows and gaps in the order of the log, each with its kind ("rows dropped", "gaps" or
        "clock resets"), the index of its row among those read, from 0, and the time of the last
        sample before that row, s. The row of a gap is the first one after the gap.
    summary : str
        A line that describes what was recognised.
    """

    path: Path
    rates: NDArray[np.float64]
    dt: NDArray[np.float64]
    t: NDArray[np.float64]
    columns: tuple[str, ...]
    unit: str
    timing: str
    rate: float
    accel: NDArray[np.float64] | None = None
    mag: NDArray[np.float64] | None = None
    start: float = 0.0
    pieces: tuple[slice, ...] = ()
    events: tuple[tuple[str, int, float], ...] = ()
    summary: str = ""

    def __str__(self) -> str:
        return self.summary
