"""A sensor's noise: data sheets' units, simulated samples, Allan deviation and a fit of it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.estimation.amounts import at_least_zero, interval
from fastatt.estimation.filters import Floats

# of the largest variance: a smaller one weighs no more in a fit's first guess
_LEAST = 1e-6
_DEGREE, _HOUR, _G = math.pi / 180.0, 3600.0, 9.80665
#: what one of a unit is in rad, m and s
_UNITS: dict[str, float] = {
    # angle random walk, rad/√s: what a rate's density in rad/s/√Hz is called
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
    """A data sheet's figure in rad, m and s: what the filters and simulations here take.

    ``unit`` is one of "deg/sqrt(h)", "deg/h", "deg/h/sqrt(h)", "mdeg/s/sqrt(Hz)", "m/s/sqrt(h)",
    "ug/sqrt(Hz)", "mg" and their like; "°", "√h", "dps" and "µ" are read too. A density is taken
    for the random walk's coefficient, σ² = N²/τ: of a sheet that means one side of the spectrum
    the figure is √2 too large.

    Raises ``ValueError`` for another unit, with those known, ``TypeError`` for no number.

    >>> from fastatt import estimation as es
    >>> print(f"{es.from_data_sheet(0.15, 'deg/sqrt(h)'):.4e} rad/√s")
    4.3633e-05 rad/√s
    """
    return _figure(value) * _one_of(unit)


def to_data_sheet(value: ArrayLike, unit: str) -> Any:
    """The inverse of :func:`from_data_sheet`."""
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
    """What a gyro says, and its bias.

    ``samples`` (n, 3) or (N, n, 3), rad/s or rad, of n intervals; ``bias`` (n + 1, 3) or
    (N, n + 1, 3), rad/s, at the ends of the intervals.
    """

    samples: Floats
    bias: Floats


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
    runs : N runs of one motion (n, 3), each with its noise.
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


# Allan deviation


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """The parts of a sensor's noise: σ²(τ) = N²/τ + (2 ln 2/π) B² + K² τ/3.

    ``angle_noise`` N, rad/√s (angle random walk), ``bias_instability`` B, rad/s, ``bias_noise`` K,
    rad/s^1.5 (rate random walk), of an accelerometer m for rad; each of one column or (K,), and 0
    where the record shows none. ``deviations`` (3,) or (3, K) are their standard deviations, in
    this order, towards 0: a part below its deviation cannot be distinguished from 0.
    """

    angle_noise: Any
    bias_instability: Any
    bias_noise: Any
    deviations: Floats

    def deviation(self, tau: ArrayLike) -> Floats:
        """The Allan deviation of these parts at ``tau`` s: (T,) or (T, K)."""
        parts = np.stack([self.angle_noise, self.bias_instability, self.bias_noise])
        return np.asarray(np.sqrt(_basis(np.asarray(tau, dtype=np.float64)) @ parts**2))


@dataclass(frozen=True, eq=False)
class AllanDeviation:
    """Allan deviation over averaging times: ``tau`` (T,), s; ``deviation`` (T,) or (T, K).

    The deviation is in the unit of the samples' rate. ``freedom`` (T,) is the number of disjoint
    averages less one: the relative deviation of a variance is √(2/freedom).
    """

    tau: Floats
    deviation: Floats
    freedom: Floats

    def fit(self) -> NoiseFit:
        """Angle random walk, bias instability and rate random walk, separated by their slopes.

        Least squares of the variances, none of the parts negative, each weighted by the deviation
        that the fit itself gives it. IEEE Std 952 (1997), annex C, of which quantisation and a
        ramp are left out. Raises ``ValueError`` for fewer than 4 averaging times.
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
    """Coefficients and their deviations of one column."""
    basis, largest = _basis(tau), variance.max()
    if largest == 0.0:
        return np.zeros(3), np.zeros(3)
    # averages of some samples are made of those of fewer: together they have what the record has
    freedom = freedom * (freedom.max() / freedom.sum())
    model = np.maximum(variance, _LEAST * largest)
    for _ in range(8):
        weight = np.sqrt(0.5 * freedom) / model
        A = basis * weight[:, None]
        size = np.linalg.norm(A, axis=0)
        A /= size
        squares = _not_negative(A, variance * weight) / size
        # the weights of what fits, not of what was seen, which would favour the low
        model = basis @ squares
    known = np.sqrt(np.diag(np.linalg.inv(A.T @ A))) / size
    # the lower side, which is the farther; of a part near 0, the root of what its square may be
    return np.sqrt(squares), np.where(
        squares > known, np.sqrt(squares) - np.sqrt(np.abs(squares - known)), np.sqrt(known)
    )


def _not_negative(A: Floats, b: Floats) -> Floats:
    """The x ≥ 0 of least |A x − b|, of few columns: the best of all choices of them."""
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
    """Allan deviation of a sensor at rest, of overlapping averages.

    σ²(τ) = ⟨(ȳ(t + τ) − ȳ(t))²⟩/2 over all t of the record, ȳ means over τ: IEEE Std 952 (1997),
    annex C; Riley, NIST SP 1065 (2008), §5.2.4.

    Parameters
    ----------
    samples : (n,) or (n, K), rates, rad/s, or accelerations, m/s², of K axes or sensors; n at
        least 9.
    dt : the interval, s.
    increments : samples are angles, rad, or velocities, m/s, over the intervals.
    counts : numbers of samples averaged, at most n/2; None takes powers of two up to n/4.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

    >>> from fastatt import estimation as es
    >>> rng = np.random.default_rng(0)
    >>> white = rng.normal(0.0, 1e-3, 100_000)  # rad/s, at 100 Hz: 1e-4 rad/√s
    >>> print(f"{es.allan_deviation(white, 0.01).fit().angle_noise:.1e} rad/√s")
    1.0e-04 rad/√s
    """
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
    # less the mean, of which the differences know nothing: sums stay short
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
