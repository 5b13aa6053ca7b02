"""The noise of a sensor: units of data sheets and simulated samples."""

from __future__ import annotations

import math
import re
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval, random_generator
from fastatt.estimation.filters import Floats

_DEGREE, _HOUR, _G = math.pi / 180.0, 3600.0, 9.80665
#: units in terms of rad, m and s
_UNITS: dict[str, float] = {
    # angle random walk, rad/√s, which equals a rate's density in rad/s/√Hz
    "rad/sqrt(s)": 1.0, "rad/s/sqrt(Hz)": 1.0, "deg/sqrt(h)": _DEGREE / math.sqrt(_HOUR),
    "deg/sqrt(s)": _DEGREE, "deg/s/sqrt(Hz)": _DEGREE, "mdeg/s/sqrt(Hz)": 1e-3 * _DEGREE,
    "deg/h/sqrt(Hz)": _DEGREE / _HOUR,
    # a gyro's bias and its instability, rad/s
    "rad/s": 1.0, "deg/s": _DEGREE, "mdeg/s": 1e-3 * _DEGREE, "deg/h": _DEGREE / _HOUR,
    # rate random walk, rad/s^1.5
    "rad/s/sqrt(s)": 1.0, "deg/s/sqrt(s)": _DEGREE, "deg/s/sqrt(h)": _DEGREE / math.sqrt(_HOUR),
    "deg/h/sqrt(h)": _DEGREE / _HOUR**1.5,
    # velocity random walk, m/s^1.5
    "m/s/sqrt(s)": 1.0, "m/s^2/sqrt(Hz)": 1.0, "m/s/sqrt(h)": 1.0 / math.sqrt(_HOUR),
    "mg/sqrt(Hz)": 1e-3 * _G, "ug/sqrt(Hz)": 1e-6 * _G,
    # an accelerometer's bias and its instability, m/s²
    "m/s^2": 1.0, "g": _G, "mg": 1e-3 * _G, "ug": 1e-6 * _G,
}  # fmt: skip


def from_data_sheet(value: ArrayLike, unit: str) -> Any:
    """Convert a number from a data sheet to units of rad, m and s.

    Parameters
    ----------
    value : float or array_like
        The number.
    unit : str
        "deg/sqrt(h)", "deg/h", "deg/h/sqrt(h)", "mdeg/s/sqrt(Hz)", "m/s/sqrt(h)", "ug/sqrt(Hz)",
        "mg" or a similar unit; "°", "√h", "dps" and "µ" are accepted too.

    Returns
    -------
    float or ndarray
        The number in the units of the filters and simulations of this module.

    Raises
    ------
    ValueError
        If the unit is unknown; the message lists the known ones.
    TypeError
        If ``value`` is not a number.

    Notes
    -----
    A density is interpreted as the coefficient of the random walk, σ² = N²/τ. If a data sheet means
    a one-sided spectrum, the result is √2 too large.

    Examples
    --------
    >>> from fastatt import estimation as es
    >>> print(f"{es.from_data_sheet(0.15, 'deg/sqrt(h)'):.4e} rad/√s")
    4.3633e-05 rad/√s
    """
    return _figure(value) * _one_of(unit)


def to_data_sheet(value: ArrayLike, unit: str) -> Any:
    """Convert a number in units of rad, m and s to the unit of a data sheet.

    Parameters
    ----------
    value : float or array_like
        The number.
    unit : str
        A unit, as in :func:`from_data_sheet`.

    Returns
    -------
    float or ndarray
        The number in this unit.

    Raises
    ------
    ValueError
        If the unit is unknown.
    TypeError
        If ``value`` is not a number.

    Examples
    --------
    >>> from fastatt import estimation as es
    >>> print(f"{es.to_data_sheet(4.3633e-05, 'deg/sqrt(h)'):.2f} deg/√h")
    0.15 deg/√h
    """
    return _figure(value) / _one_of(unit)


def _figure(value: ArrayLike) -> Any:
    found = checks.numbers("value", value, "a number or an array of them")
    checks.finite("value", found)
    return found.astype(np.float64)[()]


def _one_of(unit: str) -> float:
    plain = unit
    if isinstance(unit, str):
        plain = re.sub(r"√\(?(\w+)\)?", r"sqrt(\1)", unit.replace(" ", ""))
        for sign, name in (("°", "deg"), ("dps", "deg/s"), ("µ", "u"), ("μ", "u"), ("²", "^2")):
            plain = plain.replace(sign, name)
    return _UNITS[checks.choice("unit", plain, _UNITS)]


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
    runs: int | None = None,
    rng: Any = None,
) -> SimulatedGyro:
    """Simulate the samples of a gyro with angle random walk, rate random walk and a bias.

    Parameters
    ----------
    rates : array_like of shape (n, 3) or (N, n, 3)
        Means of the true angular velocity over n intervals, rad/s; with ``increments=True`` its
        integrals over them, rad.
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
    runs : int, optional
        Number N of simulations of one motion (n, 3), each with its own noise.
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
    if runs is not None:
        if motion.ndim == 3:
            raise ValueError(f"runs: found {runs} with {len(motion)} motions; accepted: None")
        motion = np.broadcast_to(motion, (checks.whole("runs", runs, 1), *motion.shape))
    first = checks.array("bias", bias, "(3,) or (N, 3)", [(3,), (*motion.shape[:-2], 3)])
    generator = random_generator(rng)
    steps = walk * math.sqrt(h) * generator.standard_normal(motion.shape)
    start = np.broadcast_to(first, (*motion.shape[:-2], 3))[..., None, :]
    biases = np.concatenate([start, start + np.cumsum(steps, axis=-2)], axis=-2)
    noise = math.sqrt(angle**2 * h + walk**2 * h**3 / 12.0)
    noise *= 1.0 if increments else 1.0 / h
    middle = 0.5 * (biases[..., 1:, :] + biases[..., :-1, :]) * (h if increments else 1.0)
    return SimulatedGyro(motion + middle + noise * generator.standard_normal(motion.shape), biases)
