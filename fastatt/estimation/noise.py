"""Samples of a gyro with simulated noise."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval
from fastatt.estimation.filters import Floats


class SimulatedGyro(NamedTuple):
    """Samples of a simulated gyro, and its true bias.

    Attributes
    ----------
    samples : ndarray of shape (n, 3) or (N, n, 3)
        Rates, rad/s, or increments, rad, of n intervals.
    bias : ndarray of shape (n + 1, 3) or (N, n + 1, 3)
        Bias at the ends of the intervals, rad/s.
    """

    samples: Floats
    bias: Floats


def simulate_gyro(
    rates: ArrayLike,
    dt: float,
    *,
    angle_noise: float = 0.0,
    bias_noise: float = 0.0,
    bias: ArrayLike = (0.0, 0.0, 0.0),
    increments: bool = False,
    rng: Any = None,
) -> SimulatedGyro:
    """Simulate the samples of a gyro with angle random walk, rate random walk and a bias.

    Parameters
    ----------
    rates : array_like of shape (n, 3) or (N, n, 3)
        Means of the true angular velocity over n intervals, rad/s; with ``increments=True`` its
        integrals over them, rad. Each of N motions, which may be equal, has its own noise.
    dt : float
        Interval h, s, above 0.
    angle_noise : float, default 0.0
        σ_v, rad/√s, at least 0.
    bias_noise : float, default 0.0
        σ_u, rad/s^1.5, at least 0.
    bias : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Bias at the start, rad/s.
    increments : bool, default False
        Whether ``rates`` and the samples are increments, rad, in place of mean rates.
    rng : numpy.random.Generator or int, optional
        Random generator, or a seed for one.

    Returns
    -------
    SimulatedGyro
        The samples, and the true bias.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    Notes
    -----
    Over an interval from bias b to b', with standard normal u₁ and u₂, b' = b + σ_u √h u₁ and the
    increment is θ + ½ (b + b') h + √(σ_v² h + σ_u² h³/12) u₂. The walk of the bias and its integral
    have the joint distribution of the continuous noise.

    References
    ----------
    Farrenkopf, *Journal of Guidance and Control* 1 (1978) 282; Crassidis, AIAA GNC (2005), equation
    19.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> gyro = fa.estimation.simulate_gyro(np.zeros((100, 3)), 0.01, angle_noise=1e-4, rng=0)
    >>> gyro.samples.shape, gyro.bias.shape
    ((100, 3), (101, 3))
    """
    motion = checks.array("rates", rates, "(n, 3) or (N, n, 3)")
    h = interval(dt)
    angle = at_least_zero("angle_noise", angle_noise)
    walk = at_least_zero("bias_noise", bias_noise)
    checks.flag("increments", increments)
    first = checks.array("bias", bias, "(3,) or (N, 3)", [(3,), (*motion.shape[:-2], 3)])
    if not isinstance(rng, np.random.Generator):
        rng = np.random.default_rng(rng if rng is None else checks.whole("rng", rng, 0))
    steps = walk * math.sqrt(h) * rng.standard_normal(motion.shape)
    start = np.broadcast_to(first, (*motion.shape[:-2], 3))[..., None, :]
    biases = np.concatenate([start, start + np.cumsum(steps, axis=-2)], axis=-2)
    noise = math.sqrt(angle**2 * h + walk**2 * h**3 / 12.0)
    noise *= 1.0 if increments else 1.0 / h
    middle = 0.5 * (biases[..., 1:, :] + biases[..., :-1, :]) * (h if increments else 1.0)
    return SimulatedGyro(motion + middle + noise * rng.standard_normal(motion.shape), biases)
