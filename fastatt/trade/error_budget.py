"""The sources of the error of an integrated gyro log, estimated from the log alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.gyro.gaps import part, stretches
from fastatt.gyro.integrate import integrate_rates, intervals, methods_for_samples
from fastatt.methods import METHODS
from fastatt.rounding import noted

_PIECE = 30_000  # intervals that are processed at a time
LEAST = 27  # samples that the differences need
# Orders of the differences that distinguish white noise from a smooth motion, and the share of the
# noise in the quietest tenth of pieces of 16: mean over 200 logs of 600 samples of Gaussian noise
_DIFFERENCES = {6: 0.78, 10: 0.76}
_QUIET = 16
_WHITE = 0.8
# share of a declared order below which an error is a mere guess
_RESOLVED = 0.7
# samples per cycle, below which every third sample, at 4 a cycle or less, shows no order of the
# error
_CYCLE = 12.0
# the power of a strong oscillation, in the noise's and in that of the strongest
_STANDS_OUT, _STRONG = 100.0, 0.2**2
DEGREES = 180.0 / math.pi
_LIMITS = ("interpolation", "truncation", "round-off", "noise")
_UNDERSAMPLED = "undersampled"
_BEYOND_METHODS = {
    "noise": "noise limits, or motion as rough as noise: another method will not help",
    "round-off": "round-off limits: float64 is what helps, if anything",
}


@dataclass(frozen=True)
class ErrorBudget:
    """The contributions to the error of one method on one log.

    :func:`error_budget` estimates them. Contributions are the largest angle over the log, rad.

    Attributes
    ----------
    method : str
        Name of the method.
    samples : int
        Number of samples.
    rate : float
        Sample rate, Hz.
    interpolation : float
        Error due to motion between the samples that the polynomial through them misses, rad.
    truncation : float
        Difference of the method from the exact integration of that polynomial, rad.
    round_off : float
        Error due to rounding, rad.
    noise : float
        Error due to white noise of the samples: root mean square at the end of the log, rad.
    noise_density : float
        Density of the white noise, rad/s/√Hz.
    order : float or None
        Order with which interpolation and truncation fall with the interval; None if noise hides
        it.
    limited_by : str
        The largest contribution, or "undersampled": with fewer than 12 samples per cycle the
        contributions of interpolation and noise are unknown (NaN).
    half_rate : dict of str to float
        Largest change of the attitudes, rad, if every second sample is left out, for this method
        and for those rivals whose order can be observed on the log.
    samples_per_cycle : float
        Samples per cycle of the fastest strong oscillation of the rates; inf if there is none.

    Notes
    -----
    Motion with jerks more often than every 16 samples cannot be distinguished from noise.
    """

    method: str
    samples: int
    rate: float
    interpolation: float
    truncation: float
    round_off: float
    noise: float
    noise_density: float
    order: float | None
    limited_by: str
    half_rate: dict[str, float]
    samples_per_cycle: float = math.inf

    @property
    def total(self) -> float:
        """The root sum of squares of all contributions, rad."""
        return math.hypot(self.interpolation, self.truncation, self.round_off, self.noise)

    @property
    def verdict(self) -> str:
        """A sentence that says what limits the accuracy, and which measured method is better."""
        if not self.total:
            return "no error is seen: the log does not rotate"
        if self.limited_by == _UNDERSAMPLED:
            needed = self.rate * _CYCLE / self.samples_per_cycle
            return (
                f"undersampled: {self.samples_per_cycle:.2g} samples per cycle of the motion, an "
                f"estimate needs {_CYCLE:g} or more (at least {needed:.3g} Hz)"
            )
        if self.limited_by in _BEYOND_METHODS:
            return _BEYOND_METHODS[self.limited_by]
        own = self.half_rate[self.method]
        halved = f"with every second sample the attitude changes by {own * DEGREES:.0e} deg"
        best = min(self.half_rate, key=lambda name: self.half_rate[name])
        least = self.half_rate[best]
        if least < 0.5 * own:
            return f"{halved}, by {best} {least * DEGREES:.0e} deg: it is more accurate"
        if self.limited_by == "truncation":
            return f"the method limits, and no other here does much better; {halved}"
        return f"the sample rate limits: a better integrator will not help; {halved}"

    def __str__(self) -> str:
        order = "" if self.order is None else f" (order {self.order:.1f} in the interval)"
        density = f" ({self.noise_density * DEGREES:.2g} deg/s/√Hz)"
        shares = (self.interpolation, self.truncation, self.round_off, self.noise)
        lines = [
            f"  {name:14} {value * DEGREES:9.0e}{note}"
            for name, value, note in zip(_LIMITS, shares, (order, "", "", density), strict=True)
        ]
        head = f"error of {self.method} on {self.samples} samples at {self.rate:.6g} Hz, deg:"
        if self.limited_by == _UNDERSAMPLED:
            lines = []
        return "\n".join([head, *lines, f"  {self.verdict}"])


def error_budget(
    rates: ArrayLike,
    dt: ArrayLike,
    q0: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    *,
    method: str = "previous",
    dtype: Any = None,
    max_gap: float | None = None,
    rivals: Sequence[str] | None = None,
) -> ErrorBudget:
    """Separate interpolation, truncation, round-off and noise in the error of a gyro log.

    Parameters
    ----------
    rates : array_like of shape (n, 3)
        One log of at least 27 samples along body axes, rad/s.
    dt : float or array_like of shape (n - 1,)
        The interval, or the intervals, s.
    q0 : array_like of shape (4,), default (1, 0, 0, 0)
        Attitude at the first sample.
    method : str, default "previous"
        The method whose error is estimated.
    dtype : {float64, float32}, optional
        Precision, as in :func:`fastatt.integrate_rates`.
    max_gap : float, optional
        The longest interval that is accepted, s, as in :func:`fastatt.integrate_rates`.
    rivals : sequence of str, optional
        Methods to compare with; the default is all.

    Returns
    -------
    ErrorBudget
        The contributions, rad. Its text is a table in degrees with one digit, since the
        contributions are estimates.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`fastatt.integrate_rates`.

    Notes
    -----
    Interpolation and truncation together are extrapolated from the log without every second and
    with every third sample. Truncation is the difference of the method from the exact integration
    of the polynomial that it fits. Noise is estimated from differences of order 10, assuming that
    it is white.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> t = 0.01 * np.arange(400)
    >>> rates = np.stack([0.2 * np.sin(3 * t), 0.2 * np.cos(3 * t), 0 * t], axis=1)
    >>> budget = fa.error_budget(rates, 0.01, rivals=["coning2"])
    >>> budget.method, budget.total < 1e-4
    ('previous', True)
    """
    fitting = methods_for_samples()
    checks.choice("method", method, fitting)
    others = fitting if rivals is None else checks.several("rivals", rivals, "methods")
    for name in others:
        checks.choice("rivals", name, fitting)
    data = checks.array("rates", rates, "(n, 3)")
    kind = checks.precision(dtype, rates)
    if len(data) < LEAST:
        raise ValueError(f"rates: found {len(data)} samples; accepted: at least {LEAST}")
    spans = intervals(dt, len(data) - 1, max_gap, np.dtype(np.float64))
    log = _Log(data.astype(np.float64), spans, checks.attitudes("q0", q0, "(4,)"), max_gap)
    others = [name for name in others if name != method]
    with noted():  # leaving out samples makes intervals long
        truncation = log.truncation(method)
        density = log.noise_density()
        sampling = log.extrapolated(log.exact, method, density)
        measured = {m: log.extrapolated(log.attitudes, m, density) for m in (method, *others)}
        round_off = log.round_off(method, kind)
    cycle = _samples_per_cycle(log.rates)
    noise = log.noise(density)
    if cycle < _CYCLE:
        sampling, density, noise = _Extrapolated(math.nan, None, math.nan), math.nan, math.nan
    shares = (sampling.error, truncation, round_off, noise)
    limited_by = _LIMITS[int(np.argmax(shares))]
    return ErrorBudget(
        method,
        len(data),
        1.0 / float(np.mean(log.spans)),
        *shares,
        noise_density=density,
        order=sampling.order,
        limited_by=_UNDERSAMPLED if cycle < _CYCLE else limited_by,
        samples_per_cycle=cycle,
        # the error of a rival without an observed order is a mere guess
        half_rate={
            name: found.changed
            for name, found in measured.items()
            if name == method or (found.order or 0.0) > _RESOLVED * METHODS[name].order
        },
    )


def _samples_per_cycle(rates: NDArray[np.float64]) -> float:
    """Samples per cycle of the fastest strong oscillation that is no white noise, or inf."""
    about_mean = rates - rates.mean(axis=0)
    tapered = about_mean / (np.abs(about_mean).max() or 1.0) * np.hanning(len(rates))[:, None]
    power = (np.abs(np.fft.rfft(tapered, axis=0)) ** 2).sum(axis=1)
    noise = np.median(power[len(power) // 2 :])
    strong = (power > _STANDS_OUT * noise) & (power >= _STRONG * power.max())
    return len(rates) / int(np.flatnonzero(strong)[-1]) if strong[1:].any() else math.inf


class _Extrapolated(NamedTuple):
    """An error and its order, from the change without every second sample, rad."""

    error: float
    order: float | None
    changed: float


class _Log:
    """One log: its samples and intervals, also with samples left out."""

    def __init__(
        self, rates: NDArray[np.float64], dt: ArrayLike, q0: NDArray[Any], max_gap: float | None
    ) -> None:
        self.rates, self.dt, self.q0, self.max_gap = rates, dt, q0, max_gap
        self.spans = np.broadcast_to(np.asarray(dt, dtype=np.float64), len(rates) - 1)

    def part(self, every: int) -> tuple[NDArray[np.float64], Any, float | None]:
        """Every n-th sample, the intervals between them and the longest accepted one."""
        rows = np.arange(0, len(self.rates), every)
        dt: Any = every * float(self.spans[0])
        if np.ndim(self.dt):
            dt = np.diff(np.concatenate([[0.0], np.cumsum(self.spans)])[rows])
        return self.rates[rows], dt, None if self.max_gap is None else every * self.max_gap

    def attitudes(self, method: str, every: int = 1, dtype: Any = np.float64) -> NDArray[Any]:
        """Attitudes of a method from every n-th sample, at their times."""
        rates, dt, gap = self.part(every)
        return integrate_rates(
            rates.astype(dtype), dt, self.q0, method=method, max_gap=gap, dtype=dtype
        )

    def exact(self, method: str, every: int = 1) -> NDArray[Any]:
        """Attitudes by exact integration of the polynomials that the method fits.

        For a constant rate the method itself is the exact exponential.
        """
        if METHODS[method].order < 2:
            return self.attitudes(method, every)
        rates, dt, _ = self.part(every)
        return _integrated(method, rates, dt, self.q0)

    def extrapolated(
        self, attitudes: Callable[[str, int], NDArray[Any]], method: str, density: float
    ) -> _Extrapolated:
        """The error of sampling, from the changes without some of the samples.

        With order r, every second sample changes C hʳ (2ʳ − 1), every third C hʳ (3ʳ − 1). White
        noise changes both too, by its own contribution and √2 of that. If noise may explain the
        changes, the order is unknown, and the declared one is used.
        """
        full = attitudes(method, 1)[::6]
        changed = []
        for every in (2, 3):
            common = attitudes(method, every)[:: 6 // every]
            both = min(len(common), len(full))
            changed.append(float(angle_between(common[:both], full[:both]).max()))
        two, three = changed
        declared = METHODS[method].order
        if two <= 2.0 * self.noise(density) or three <= two:
            return _Extrapolated(two / (2.0**declared - 1.0), None, two)
        # less than 1 is not an order: the two samplings miss different parts of the motion
        orders = np.linspace(1.0, 2.0 * max(1, declared), 1000)
        ratios = (3.0**orders - 1.0) / (2.0**orders - 1.0)
        order = float(np.interp(three / two, ratios, orders))
        return _Extrapolated(two / (2.0**order - 1.0), order, two)

    def truncation(self, method: str) -> float:
        """The difference of the method from the exact integration of its polynomials."""
        found, exact = self.attitudes(method), self.exact(method)
        return float(angle_between(exact, found[: len(exact)]).max())

    def round_off(self, method: str, kind: np.dtype[Any]) -> float:
        """The change by single precision, scaled to the precision in use."""
        single = self.attitudes(method, dtype=np.float32).astype(np.float64)
        apart = float(angle_between(single, self.attitudes(method)).max())
        return apart * float(np.finfo(kind).eps / np.finfo(np.float32).eps)

    def noise_density(self) -> float:
        """Density of white noise, rad/s/√Hz, root mean square over the axes; 0 if none is found.

        The difference of order k of white noise has its variance times the binomial of 2k over k,
        while that of a smooth motion falls with k. Noise is present all the time, jerks are not:
        the level is that of the quietest tenth of the log.
        """
        low, high = (self._level(k) / part for k, part in _DIFFERENCES.items())
        if high < _WHITE * low:
            return 0.0
        return high * math.sqrt(float(np.mean(self.spans)))

    def _level(self, order: int) -> float:
        """Root of the tenth percentile of mean squares over short pieces."""
        squares = np.mean(np.diff(self.rates, order, axis=0) ** 2, axis=1)
        whole = len(squares) // _QUIET * _QUIET
        means = squares[:whole].reshape(-1, _QUIET).mean(axis=1) if whole else squares
        return math.sqrt(float(np.quantile(means, 0.1)) / math.comb(2 * order, order))

    def noise(self, density: float) -> float:
        """Root mean square of the angle at the end: three axes of a random walk, rad."""
        return density * math.sqrt(3.0 * float(self.spans.sum()))


def _integrated(method: str, rates: NDArray[np.float64], dt: Any, q0: NDArray[Any]) -> NDArray[Any]:
    """Attitudes at the samples from a window's polynomials, which begin anew at gaps."""
    window, found = METHODS[method].window, [q0[None]]
    for first, last in stretches(window, dt, len(rates) - 1):
        own, apart = part(rates[None], dt, False, first, last)
        found.append(_without_gap(method, own[0], apart, found[-1][-1])[1:])
    return np.concatenate(found)


def _without_gap(
    method: str, rates: NDArray[np.float64], dt: Any, q0: NDArray[Any]
) -> NDArray[Any]:
    """Attitudes from a window's polynomials through samples without a gap.

    Another method gets their values at times so close that it integrates them exactly.
    """
    # an error of order 4 is 20000 times less then; picard's may be less than that, but its own
    # polynomial it integrates exactly
    tight, fineness = ("picard", 6) if method == "picard" else ("coning3", 12)
    window = METHODS[method].window
    powers = np.arange(min(window.samples(False), len(rates)))
    spans = np.broadcast_to(dt, len(rates) - 1)
    t = np.concatenate([[0.0], np.cumsum(spans)])
    inside = np.arange(fineness)[:, None] / fineness
    found = [q0[None]]
    for k in np.array_split(np.arange(len(spans)), -(-len(spans) // _PIECE)):
        start = k // window.span * window.span - window.history
        nodes = np.clip(start, 0, len(rates) - powers.size)[:, None] + powers
        # in intervals from the beginning of each
        x = (t[nodes] - t[k][:, None]) / spans[k][:, None]
        polynomials = np.linalg.solve(x[..., None] ** powers, rates[nodes])
        fine = (inside**powers @ polynomials).reshape(-1, 3)
        fine = np.concatenate([fine, rates[k[-1] + 1 : k[-1] + 2]])
        steps = dt / fineness if np.ndim(dt) == 0 else np.repeat(spans[k] / fineness, fineness)
        q = integrate_rates(fine, steps, found[-1][-1], method=tight, max_gap=math.inf)
        found.append(q[fineness::fineness])
    return np.concatenate(found)
