"""Files of attitudes with rows t (s), q0 ... q3, and what other sensors measured."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.files import write_csv, writing
from fastatt.gyro.integrate import integrate_rates
from fastatt.gyro.log import GyroLog, GyroLogError

_NAMES = ("t", "q0", "q1", "q2", "q3")
_AXES = {"accel": ("ax", "ay", "az"), "mag": ("mx", "my", "mz")}
_CHUNK = 1 << 17  # rows
_UNIX = 1e8, 1e10  # s (1973 to 2286); time stamps between these are Unix time


def attitude_rows(
    log: GyroLog, q0: ArrayLike, method: str, sensors: Sequence[str] = ()
) -> NDArray[np.float64]:
    """Times and attitudes of a log from ``q0``, and what k sensors measured, (n, 5 + 3k).

    Times are Unix time, s, if the log's stamps are, else s from the first sample. ``sensors`` are
    "accel" and "mag"; without a sample at the first time they have NaN there.
    """
    rows = np.full((len(log.t), 5 + 3 * len(sensors)), math.nan)
    rows[:, 0] = log.t + (log.start if _UNIX[0] < log.start < _UNIX[1] else 0.0)
    rows[:, 1:5] = integrate_rates(log, None, q0, method=method, max_gap=math.inf)
    for first, sensor in zip(range(5, rows.shape[1], 3), sensors, strict=True):
        rows[-len(log.rates) :, first : first + 3] = getattr(log, sensor)
    return rows


def check_ending(path: Path) -> None:
    """Refuse the name of a file of another kind than ``.csv`` and ``.npy``."""
    if path.suffix not in (".csv", ".npy"):
        raise GyroLogError(f"--out: found the ending {path.suffix!r}; accepted: .csv and .npy")


def write_attitudes(path: Path, rows: NDArray[np.float64], sensors: Sequence[str] = ()) -> None:
    """Write rows to a file, whole or not at all: an array, or text with a line of names."""
    if path.suffix == ".csv":
        parts = (rows[k : k + _CHUNK].tolist() for k in range(0, len(rows), _CHUNK))
        names = chain(_NAMES, *(_AXES[sensor] for sensor in sensors))
        write_csv("--out", path, names, chain.from_iterable(parts))
        return
    with writing("--out", path) as file:  # by its buffer, since a pipe has no position
        header = np.lib.format.header_data_from_array_1_0(rows)
        np.lib.format.write_array_header_1_0(file, header)
        file.write(np.ascontiguousarray(rows).data)
