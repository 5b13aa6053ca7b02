"""Numbers and rows that the arguments of estimators have to have."""

from __future__ import annotations

import math
from collections.abc import Sized
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks


def at_least_zero(name: str, value: float) -> float:
    """A noise density or a standard deviation."""
    # of a float the look takes a tenth of the time
    found = value if type(value) is float else checks.real(name, value)
    if not 0.0 <= found < math.inf:
        raise ValueError(f"{name}: found {found}; accepted: at least 0")
    return found


def interval(dt: float) -> float:
    """An interval, s, above 0."""
    found = dt if type(dt) is float else checks.real("dt", dt)
    if not 0.0 < found < math.inf:
        raise ValueError(f"dt: found {found}; accepted: an interval above 0")
    return found


def common_number(of: str, **arrays: Sized) -> int:
    """How many rows all arrays have, one row standing for any number of them."""
    rows = {name: len(value) for name, value in arrays.items()}
    if len(set(rows.values()) - {1}) > 1:
        found = ", ".join(f"{name} {n}" for name, n in rows.items())
        raise ValueError(f"{next(iter(rows))}: found rows {found}; accepted: one number of {of}")
    return max(rows.values(), default=1)


def covariances(name: str, value: ArrayLike, shapes: str) -> NDArray[Any]:
    """Covariances, symmetric and, but for rounding, without a negative variance in any direction.

    ``shapes`` are as of ``checks.array``.
    """
    found = checks.array(name, value, shapes)
    unit = np.eye(found.shape[-1])
    rounding = 1e3 * np.finfo(found.dtype).eps * np.abs(found).max(axis=(-2, -1))[..., None, None]
    bad = (np.abs(found - np.swapaxes(found, -1, -2)) > rounding).any(axis=(-2, -1))
    what = "is not symmetric"
    if not bad.any():
        bad = (np.diagonal(found, axis1=-2, axis2=-1) < 0.0).any(axis=-1)
        what = "has a negative variance"
    if not bad.any():
        try:
            np.linalg.cholesky(found + rounding * unit)  # in a third of the time
        except np.linalg.LinAlgError:
            bad = np.linalg.eigvalsh(found)[..., 0] < -rounding[..., 0, 0]
    if bad.any():
        where = f"[{int(np.argmax(bad))}]" if found.ndim == 3 else ""
        raise ValueError(f"{name}{where}: {what}; accepted: a covariance")
    return found


def triples(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Vectors (3,) or (N, 3) in rows."""
    return np.atleast_2d(checks.array(name, value, "(3,) or (N, 3)").astype(np.float64))


def of_logs(name: str, value: ArrayLike, n_logs: int) -> NDArray[np.float64]:
    """Vectors in rows, one for all logs or one a log."""
    accepted, tails = f"(3,) or ({n_logs}, 3), one a log", [(3,), (1, 3), (n_logs, 3)]
    return np.atleast_2d(checks.array(name, value, accepted, tails).astype(np.float64))
