"""The noise of a sensor: units of data sheets, simulated samples, Allan deviation and its fit."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval, random_generator
from fastatt.estimation.filters import Floats

# share of the largest variance; smaller ones have the same weight in a fit's first guess
_LEAST = 1e-6
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


# Allan deviation


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """The parts of a sensor's noise, σ²(τ) = N²/τ + (2 ln 2/π) B² + K² τ/3.

    Numbers are for one column, or arrays (K,) for K columns. A part is 0 if the record does not
    show it. For an accelerometer m replaces rad.

    Attributes
    ----------
    angle_noise : float or ndarray
        N, rad/√s (angle random walk).
    bias_instability : float or ndarray
        B, rad/s.
    bias_noise : float or ndarray
        K, rad/s^1.5 (rate random walk).
    deviations : ndarray of shape (3,) or (3, K)
        Standard deviations of the three towards 0. A part below its deviation can't be
        distinguished from 0.
    """

    angle_noise: Any
    bias_instability: Any
    bias_noise: Any
    deviations: Floats

    def deviation(self, tau: ArrayLike) -> Floats:
        """The Allan deviation of these parts.

        Parameters
        ----------
        tau : array_like of shape (T,)
            Averaging times, s.

        Returns
        -------
        ndarray of shape (T,) or (T, K)
            The Allan deviation.
        """
        times = checks.array("tau", tau, "(T,)").astype(np.float64)
        checks.refuse("tau", times, times <= 0.0, "above 0")
        parts = np.stack([self.angle_noise, self.bias_instability, self.bias_noise])
        return np.asarray(np.sqrt(_basis(times) @ parts**2))


@dataclass(frozen=True, eq=False)
class AllanDeviation:
    """The Allan deviation over averaging times, as :func:`allan_deviation` computes it.

    Attributes
    ----------
    tau : ndarray of shape (T,)
        Averaging times, s.
    deviation : ndarray of shape (T,) or (T, K)
        Allan deviation, in the unit of the samples' rate.
    freedom : ndarray of shape (T,)
        Number of disjoint averages minus one; the relative deviation of a variance is √(2/freedom).
    """

    tau: Floats
    deviation: Floats
    freedom: Floats

    def fit(self) -> NoiseFit:
        """Separate angle random walk, bias instability and rate random walk by their slopes.

        Returns
        -------
        NoiseFit
            The three parts.

        Raises
        ------
        ValueError
            If there are fewer than 4 averaging times.

        Notes
        -----
        The variances are fitted by least squares, with no negative parts, each weighted by the
        deviation that the fit itself predicts. Quantisation and ramp are not fitted.

        References
        ----------
        IEEE Std 952 (1997), annex C.
        """
        if len(self.tau) < 4:
            raise ValueError(f"tau: found {len(self.tau)} times; accepted: at least 4 for a fit")
        columns = self.deviation.reshape(len(self.tau), -1).T
        found = [_parts(self.tau, column**2, self.freedom) for column in columns]
        parts, deviations = (np.stack(x, axis=-1) for x in zip(*found, strict=True))
        if self.deviation.ndim == 1:
            parts, deviations = parts[:, 0], deviations[:, 0]
        angle, instability, walk = parts
        return NoiseFit(angle, instability, walk, deviations)


def _basis(tau: Floats) -> Floats:
    return np.stack([1.0 / tau, np.full_like(tau, 2.0 * math.log(2.0) / math.pi), tau / 3.0], -1)


def _parts(tau: Floats, variance: Floats, freedom: Floats) -> tuple[Floats, Floats]:
    """Coefficients of one column and their deviations."""
    basis, largest = _basis(tau), variance.max()
    if largest == 0.0:
        return np.zeros(3), np.zeros(3)
    # longer averages consist of shorter ones: together they have the information of the record
    freedom = freedom * (freedom.max() / freedom.sum())
    model = np.maximum(variance, _LEAST * largest)
    for _ in range(8):
        weight = np.sqrt(0.5 * freedom) / model
        A = basis * weight[:, None]
        size = np.linalg.norm(A, axis=0)
        A /= size
        squares = _not_negative(A, variance * weight) / size
        # weights from the fit, since weights from the measured variances would favour low ones
        model = basis @ squares
    known = np.sqrt(np.diag(np.linalg.inv(A.T @ A))) / size
    # the lower deviation, which is the larger one; near 0, the root of the deviation of its square
    return np.sqrt(squares), np.where(
        squares > known, np.sqrt(squares) - np.sqrt(np.abs(squares - known)), np.sqrt(known)
    )


def _not_negative(A: Floats, b: Floats) -> Floats:
    """The x ≥ 0 with the least ``|A x − b|``, for few columns: the best of all subsets of them."""
    best, least = np.zeros(A.shape[1]), math.inf
    for size in range(1, A.shape[1] + 1):
        for chosen in combinations(range(A.shape[1]), size):
            x = np.linalg.lstsq(A[:, chosen], b)[0]
            left = float(np.linalg.norm(A[:, chosen] @ x - b))
            if (x >= 0.0).all() and left < least:
                best, least = np.zeros(A.shape[1]), left
                best[list(chosen)] = x
    return best


def allan_deviation(
    samples: ArrayLike, dt: float, *, increments: bool = False, counts: ArrayLike | None = None
) -> AllanDeviation:
    """Allan deviation of a sensor at rest, from overlapping averages.

    σ²(τ) = ⟨(ȳ(t + τ) − ȳ(t))²⟩/2 over all t of the record, with means ȳ over τ.

    Parameters
    ----------
    samples : array_like of shape (n,) or (n, K)
        Rates, rad/s, or accelerations, m/s², of K axes or sensors; n is at least 9.
    dt : float
        Interval, s.
    increments : bool, default False
        Whether samples are angles, rad, or velocities, m/s, over the intervals.
    counts : array_like of int, optional
        Numbers of samples in an average, at most n/2; the default is powers of two up to n/4.

    Returns
    -------
    AllanDeviation
        The Allan deviation; ``fit()`` separates its parts.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit.

    References
    ----------
    IEEE Std 952 (1997), annex C; Riley, NIST SP 1065 (2008), §5.2.4.

    Examples
    --------
    >>> import numpy as np
    >>> from fastatt import estimation as es
    >>> rng = np.random.default_rng(0)
    >>> white = rng.normal(0.0, 1e-3, 100_000)  # rad/s, at 100 Hz: 1e-4 rad/√s
    >>> print(f"{es.allan_deviation(white, 0.01).fit().angle_noise:.1e} rad/√s")
    1.0e-04 rad/√s
    """
    checks.flag("increments", increments)
    given = checks.array("samples", samples, "(n,) or (n, K)")
    rates = given.astype(np.float64)
    n, h = len(rates), interval(dt)
    if n < 9:
        raise ValueError(f"samples: found {n}; accepted: at least 9")
    most = n // 2
    asked: Any = 2 ** np.arange(int(math.log2(n // 4)) + 1) if counts is None else counts
    m = checks.array("counts", asked, "(T,)")
    if (m != np.rint(m)).any() or m.min() < 1 or m.max() > most:
        raise ValueError(
            f"counts: found {m.min():g} to {m.max():g}; accepted: whole numbers from 1 to {most}, "
            "half of the samples"
        )
    # without the mean, which cancels in the differences, sums stay small
    angles = np.zeros((n + 1, *rates.shape[1:]))
    np.cumsum(rates - rates.mean(axis=0), axis=0, out=angles[1:])
    if not increments:
        angles *= h
    variances = [
        (np.square(angles[2 * k :] - 2.0 * angles[k:-k] + angles[: -2 * k])).mean(axis=0)
        / (2.0 * (k * h) ** 2)
        for k in map(int, m)
    ]
    deviation: Floats = np.sqrt(np.stack(variances))
    return AllanDeviation(np.asarray(m * h), deviation, np.maximum(n / m - 1.0, 1.0))
