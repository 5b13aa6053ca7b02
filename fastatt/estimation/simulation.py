"""Gyro samples of a known motion, with noise and a walking bias."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval


class SimulatedGyro(NamedTuple):
    """What a gyro says, and its bias.

    ``samples`` (n, 3) or (N, n, 3), rad/s or rad, of n intervals; ``bias`` (n + 1, 3) or
    (N, n + 1, 3), rad/s, at the ends of the intervals.
    """

    samples: NDArray[np.float64]
    bias: NDArray[np.float64]


def simulate_gyro(
    true: ArrayLike,
    dt: float,
    *,
    angle_noise: float = 0.0,
    bias_noise: float = 0.0,
    bias: ArrayLike = (0.0, 0.0, 0.0),
    increments: bool = False,
    runs: int | None = None,
    rng: Any = None,
) -> SimulatedGyro:
    """A gyro's samples of a true motion: angle random walk and a bias that walks.

    Over an interval of h s from bias b to b', u₁ and u₂ standard normal, b' = b + σ_u √h u₁ and the
    increment is θ + ½(b + b') h + √(σ_v² h + σ_u² h³/12) u₂: the bias walk and its own integral
    together have the joint distribution of the continuous noise. Farrenkopf, J. Guidance 1 (1978)
    282; Crassidis, AIAA GNC (2005), eq. 19.

    Parameters
    ----------
    true : (n, 3) or (N, n, 3), the integrals of the true angular velocity over n intervals, rad,
        with ``increments``; else their means, rad/s.
    dt : the interval h, s, above 0.
    angle_noise : σ_v, rad/√s, at least 0.
    bias_noise : σ_u, rad/s^1.5, at least 0.
    bias : (3,) or (N, 3), rad/s, at the start.
    increments : samples are increments, rad, not mean rates, rad/s.
    runs : N runs with noise of their own on one motion (n, 3).
    rng : a ``numpy.random.Generator``, or a seed for one.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    motion = checks.array("true", true, "(n, 3) or (N, n, 3)")
    h = interval(dt)
    angle = at_least_zero("angle_noise", angle_noise)
    walk = at_least_zero("bias_noise", bias_noise)
    if runs is not None:
        if motion.ndim == 3:
            raise ValueError(f"runs: found {runs} beside {len(motion)} motions; accepted: None")
        motion = np.broadcast_to(motion, (checks.whole("runs", runs, 1), *motion.shape))
    first = checks.array("bias", bias, "(3,) or (N, 3)", [(3,), (*motion.shape[:-2], 3)])
    generator = np.random.default_rng(rng)
    steps = walk * math.sqrt(h) * generator.standard_normal(motion.shape)
    start = np.broadcast_to(first, (*motion.shape[:-2], 3))[..., None, :]
    biases = np.concatenate([start, start + np.cumsum(steps, axis=-2)], axis=-2)
    noise = math.sqrt(angle**2 * h + walk**2 * h**3 / 12.0)
    noise *= 1.0 if increments else 1.0 / h
    middle = 0.5 * (biases[..., 1:, :] + biases[..., :-1, :]) * (h if increments else 1.0)
    return SimulatedGyro(motion + middle + noise * generator.standard_normal(motion.shape), biases)
