"""Recorded gyro logs: the differences between methods, and the effect of the sample rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import angle_between
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.logs import GyroLog
from fastatt.rounding import noted
from fastatt.trade.error_budget import DEGREES, LEAST, error_budget
from fastatt.trade.measure import Column, best_time, trade_table

if TYPE_CHECKING:
    from fastatt import plots

# recordings in the package scikit-kinematics: Xsens at 50 and 120 Hz, x-io NGIMU at 50 Hz
RECORDINGS = (
    "data_xsens.txt",
    "walking_xsens_lowerLeg.txt",
    "walking_xsens_upperLeg.txt",
    "data_ngimu/sensors.csv",
)
REFERENCE = "coning3"
# the causal method and the others that correct for coning
_RIVALS = ("previous", "coning2")


@dataclass(frozen=True)
class LogRow:
    """One method on one recording, with angles in degrees, and its warning."""

    recording: str
    method: str
    samples: int
    rate: float
    nanoseconds_per_sample: float
    difference_max: float
    difference_end: float
    half_rate_difference_max: float
    maker_difference_max: float | None
    warning: str


def find_recordings() -> list[Path]:
    """The gyro recordings that scikit-kinematics installs.

    Raises ``ImportError`` if the package, or its recordings, are not installed.
    """
    try:
        files = metadata.files("scikit-kinematics") or []
    except metadata.PackageNotFoundError:
        files = []
    found = {
        name: Path(str(f.locate()))
        for name in RECORDINGS
        for f in files
        if str(f).endswith(f"tests/data/{name}")
    }
    if len(found) < len(RECORDINGS):
        raise ImportError(
            "trade: needs the recordings of scikit-kinematics; install them with "
            "pip install 'fastatt[trade]', or name logs with --log"
        )
    return [found[name] for name in RECORDINGS]


def _start(log: GyroLog) -> NDArray[np.float64]:
    if log.attitudes is None or not np.isfinite(log.attitudes[0]).all():
        return np.array([1.0, 0.0, 0.0, 0.0])
    return np.asarray(log.attitudes[0])


def _attitudes(log: GyroLog, method: str, every: int = 1) -> NDArray[Any]:
    """Attitudes of a method from every n-th sample; gaps were treated when the log was read."""
    dt = log.dt if every == 1 else np.diff(log.t[::every])
    return integrate_rates(log.rates[::every], dt, _start(log), method=method, max_gap=math.inf)


def _degrees(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(angle_between(a, b) * DEGREES)


def log_rows(log: GyroLog, repeats: int, methods: Sequence[str] | None = None) -> list[LogRow]:
    """The given methods, or every method, on one log.

    The rows have the difference of each from the reference, from itself at half the rate, and from
    the manufacturer's orientation if the log has it.
    """
    n, rows = len(log.rates), []
    with noted():
        reference = _attitudes(log, REFERENCE)
    for name in methods_for_samples() if methods is None else methods:
        with noted() as said:
            seconds, q = best_time(partial(_attitudes, log, name), repeats)
        with noted():
            half = _attitudes(log, name, 2)
        away = _degrees(q, reference)
        maker = None if log.attitudes is None else float(np.nanmax(_degrees(q, log.attitudes)))
        rows.append(
            LogRow(
                recording=log.path.name,
                method=name,
                samples=n,
                rate=log.rate,
                nanoseconds_per_sample=seconds / n * 1e9,
                difference_max=float(away.max()),
                difference_end=float(away[-1]),
                half_rate_difference_max=float(_degrees(half, q[::2]).max()),
                maker_difference_max=maker,
                warning=said[0] if said else "",
            )
        )
    return rows


def compare_on_log(log: GyroLog, method: str, methods: Sequence[str] | None = None) -> str:
    """Tables of the differences between methods on a log, and of the error sources of one method.

    ``methods`` are the others to compare with, None for all.
    """
    if methods is not None:
        methods = list(dict.fromkeys((*methods, method, *_RIVALS)))
    table = log_table(log_rows(log, repeats=1, methods=methods))
    if len(log.rates) < LEAST:
        return f"{table}\n{len(log.rates)} samples: too few to tell where the error comes from"
    budget = error_budget(
        log.rates, log.dt, _start(log), method=method, max_gap=math.inf, rivals=methods
    )
    return f"{table}\n{budget}"


_COLUMNS: tuple[Column, ...] = (
    ("recording", "recording", str),
    ("method", "method", str),
    ("ns/sample", "nanoseconds_per_sample", "{:.1f}".format),
    ("max diff", "difference_max", "{:.2g}".format),
    ("end diff", "difference_end", "{:.2g}".format),
    ("half rate", "half_rate_difference_max", "{:.2g}".format),
    ("maker", "maker_difference_max", "{:.2f}".format),
)


def log_table(rows: Sequence[LogRow]) -> str:
    """The rows of one or more recordings as text, followed by their warnings."""
    head, *lines = trade_table(rows, _COLUMNS).splitlines()
    lines += [f"{r.recording}: {r.warning}" for r in rows if r.warning]
    return "\n".join([f"{head}   (deg; diff from {REFERENCE})", *lines])


def departures(log: GyroLog, methods: Sequence[str]) -> plots.Departures:
    """Angles from the reference on a recording, of each method and of the manufacturer."""
    from fastatt import plots

    with noted():
        base = _attitudes(log, REFERENCE)
        angles = {
            name: _degrees(_attitudes(log, name), base)[1:] for name in methods if name != REFERENCE
        }
    maker = None if log.attitudes is None else _degrees(base, log.attitudes)[1:]
    return plots.Departures(f"{log.path.name}, {log.rate:.4g} Hz", log.t[1:], angles, maker)
