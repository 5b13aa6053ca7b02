"""Double-precision states in a run of single precision, each as the sum of three numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import Double, Single

#: numbers with 24 bits that hold the 53 bits of a double
PARTS = 3


def split(x: Vector) -> Vector:
    """Traced doubles as numbers of single precision, with all leading parts first."""
    parts: list[Any] = []
    for _ in range(PARTS):
        leading = [Single(a) for a in x]
        x = tuple(a - Double(b) for a, b in zip(x, leading, strict=True))
        parts += leading
    return tuple(parts)


def joined(x: Vector) -> Vector:
    """The inverse of :func:`split`."""
    n = len(x) // PARTS
    parts = [tuple(map(Double, x[i * n : (i + 1) * n])) for i in range(PARTS)]
    return tuple(a + b + c for a, b, c in zip(*parts, strict=True))


def split_array(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Arrays (..., k) as (..., 3 k) numbers of single precision."""
    parts, rest = [], x
    for _ in range(PARTS):
        with np.errstate(over="ignore", invalid="ignore"):
            parts.append(rest.astype(np.float32).astype(np.float64))
            rest = rest - parts[-1]
    return np.concatenate(parts, axis=-1)


def joined_array(x: NDArray[Any]) -> NDArray[np.float64]:
    """The inverse of :func:`split_array`."""
    with np.errstate(invalid="ignore"):
        a, b, c = np.split(x.astype(np.float64), PARTS, axis=-1)
        return np.asarray(a + b + c)
