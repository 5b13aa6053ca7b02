"""Derivatives by Richardson-extrapolated central differences, for tests of derivatives."""

from __future__ import annotations

import numpy as np
from exact import conj, mul

# what four displaced values weigh: (8 (f(e) − f(−e)) − (f(2e) − f(−2e)))/12e, of order 4
STEPS = np.array([1.0, -1.0, 2.0, -2.0])


def displaced(n: int, step: float) -> np.ndarray:
    """(4n, n): ±step and ±2 step along each of n directions, one direction after the other."""
    return (step * STEPS[None, :, None] * np.eye(n)[:, None, :]).reshape(4 * n, n)


def derivative(values: np.ndarray, step: float) -> np.ndarray:
    """(m, n) from the values (4n, m) at ``displaced(n, step)``."""
    f = np.asarray(values).reshape(-1, 4, np.shape(values)[-1])
    return ((8.0 * (f[:, 0] - f[:, 1]) - (f[:, 2] - f[:, 3])) / (12.0 * step)).T


def attitude_errors(reference: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Rotation vectors from one attitude to others: log(reference*∘q), for angles of some 1e-2."""
    turned = mul(conj(reference), q)
    v = turned[:, 1:]
    size = np.linalg.norm(v, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(size, turned[:, :1])
    return v * angle / np.where(size > 0.0, size, 1.0)
