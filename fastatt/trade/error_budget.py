"""Where the error of an integrated gyro log comes from, estimated from the log alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.gyro.integrate import integrate_rates, methods_for_samples
from fastatt.methods import METHODS
from fastatt.rounding import noted

_PIECE = 30_000  # intervals at a time
LEAST = 27  # samples: a piece of differences
# Orders of the differences that tell white noise from a smooth motion, and which part of the noise
# the quietest tenth of pieces of 16 holds: mean over 200 logs of 600 samples of Gaussian noise
_DIFFERENCES = {6: 0.78, 10: 0.76}
_QUIET = 16
_WHITE = 0.8
# part of a declared order below which an error is no more than guessed
_RESOLVED = 0.7
DEGREES = 180.0 / math.pi
_LIMITS = ("interpolation", "truncation", "round-off", "noise")


@dataclass(frozen=True)
class ErrorBudget:
    """Shares of the error of one method on one log, each the largest angle over the log, rad.

    ``interpolation``: what happens between samples that the polynomial through them does not know,
    estimated from the log with every second and every third sample.
    ``truncation``: what the method makes of that polynomial, against its exact integration.
    ``round_off``: of the precision. ``noise``: white noise of ``noise_density`` (rad/s/√Hz), the
    root mean square at the end. ``order`` is that by which interpolation and truncation fall with
    the interval, None where noise hides it. ``half_rate`` is what was measured when every second
    sample was left out, the largest change of the attitude, rad, by method: of this one and of
    rivals whose order the log resolves. Motion with jerks more often than every 16 samples cannot
    be distinguished from noise.
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

    @property
    def total(self) -> float:
        """All shares together, as independent ones add up, rad."""
        return math.hypot(self.interpolation, self.truncation, self.round_off, self.noise)

    @property
    def verdict(self) -> str:
        """What limits, and what was run that does better."""
        if not self.total:
            return "no error is seen: the log does not rotate"
        if self.limited_by == "noise":
            return "noise limits, or motion as rough as noise: another method will not help"
        if self.limited_by == "round-off":
            return "round-off limits: float64 is what helps, if anything"
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
    """Tell interpolation, truncation, round-off and noise of a gyro log apart.

    Interpolation and truncation together are extrapolated from the log with every second and every
    third sample; truncation is the difference of the method from the exact integration of the
    polynomial that it fits; noise is what is left of the samples after differences of order 10, if
    it is white.

    Parameters
    ----------
    rates, dt, q0, dtype, max_gap : as of :func:`fastatt.integrate_rates`
        Of one log of at least 27 samples, (n, 3) rad/s.
    method : str
        The method whose error it is.
    rivals : sequence of str
        Methods to compare with; None takes all.

    Returns
    -------
    ErrorBudget
        The shares, rad, ``limited_by`` and ``verdict``; ``str`` gives a table in degrees, of one
        digit, as shares are estimates.

    Raises
    ------
    ValueError, TypeError
        As ``integrate_rates``.
    """
    fitting = methods_for_samples()
    checks.choice("method", method, fitting)
    for name in rivals or ():
        checks.choice("rivals", name, fitting)
    data = checks.array("rates", rates, "(n, 3)")
    kind = checks.precision(dtype, rates)
    if len(data) < LEAST:
        raise ValueError(f"rates: found {len(data)} samples; accepted: at least {LEAST}")
    log = _Log(data.astype(np.float64), dt, checks.attitudes("q0", q0), max_gap)
    others = [m for m in (fitting if rivals is None else rivals) if m != method]
    with noted():  # samples are left out on purpose
        truncation = log.truncation(method)
        density = log.noise_density()
        sampling = log.extrapolated(log.exact, method, density)
        measured = {m: log.extrapolated(log.attitudes, m, density) for m in (method, *others)}
        round_off = log.round_off(method, kind)
    shares = (sampling.error, truncation, round_off, log.noise(density))
    return ErrorBudget(
        method,
        len(data),
        1.0 / float(np.mean(log.spans)),
        *shares,
        noise_density=density,
        order=sampling.order,
        limited_by=_LIMITS[int(np.argmax(shares))],
        # of a rival whose order does not show the error is no more than guessed
        half_rate={
            name: found.changed
            for name, found in measured.items()
            if name == method or (found.order or 0.0) > _RESOLVED * METHODS[name].order
        },
    )


class _Extrapolated(NamedTuple):
    """An error and its order, from what every second sample left out changed, rad."""

    error: float
    order: float | None
    changed: float


class _Log:
    """One log: its samples, its intervals, and what may be left out of it."""

    def __init__(
        self, rates: NDArray[np.float64], dt: ArrayLike, q0: NDArray[Any], max_gap: float | None
    ) -> None:
        self.rates, self.dt, self.q0, self.max_gap = rates, dt, q0, max_gap
        self.spans = np.broadcast_to(np.asarray(dt, dtype=np.float64), len(rates) - 1)

    def part(self, every: int) -> tuple[NDArray[np.float64], Any, float | None]:
        """Every so many samples, the intervals between them and the longest one allowed."""
        rows = np.arange(0, len(self.rates), every)
        dt: Any = every * float(self.spans[0])
        if np.ndim(self.dt):
            dt = np.diff(np.concatenate([[0.0], np.cumsum(self.spans)])[rows])
        return self.rates[rows], dt, None if self.max_gap is None else every * self.max_gap

    def attitudes(self, method: str, every: int = 1, dtype: Any = np.float64) -> NDArray[Any]:
        """By the method from every so many samples, at those instants."""
        rates, dt, gap = self.part(every)
        return integrate_rates(
            rates.astype(dtype), dt, self.q0, method=method, max_gap=gap, dtype=dtype
        )

    def exact(self, method: str, every: int = 1) -> NDArray[Any]:
        """By the exact integration of the polynomials that the method fits.

        Of a rate that is held the method itself is the exact exponential.
        """
        if METHODS[method].order < 2:
            return self.attitudes(method, every)
        rates, dt, _ = self.part(every)
        return _integrated(method, rates, dt, self.q0)

    def extrapolated(
        self, attitudes: Callable[[str, int], NDArray[Any]], method: str, density: float
    ) -> _Extrapolated:
        """Error for want of samples, from what leaving out some of them changes.

        Of order r, every second sample changes C hʳ (2ʳ − 1), every third C hʳ (3ʳ − 1). White
        noise changes both too, by as much as it adds itself and by √2 of that: where that may be
        all, there is no order, and the declared one is taken.
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
        # less than 1 is no order, but two samplings that miss different things
        orders = np.linspace(1.0, 2.0 * max(1, declared), 1000)
        ratios = (3.0**orders - 1.0) / (2.0**orders - 1.0)
        order = float(np.interp(three / two, ratios, orders))
        return _Extrapolated(two / (2.0**order - 1.0), order, two)

    def truncation(self, method: str) -> float:
        """The method against the exact integration of the polynomials that it fits."""
        found, exact = self.attitudes(method), self.exact(method)
        return float(angle_between(exact, found[: len(exact)]).max())

    def round_off(self, method: str, kind: np.dtype[Any]) -> float:
        """What single precision changes, scaled to the precision that is used."""
        single = self.attitudes(method, dtype=np.float32).astype(np.float64)
        apart = float(angle_between(single, self.attitudes(method)).max())
        return apart * float(np.finfo(kind).eps / np.finfo(np.float32).eps)

    def noise_density(self) -> float:
        """Of white noise, rad/s/√Hz and axis, root mean square over the axes; 0 if none is seen.

        The difference of order k of white noise has its variance times the binomial of 2k over k;
        of a smooth motion it falls with k. Noise is there all the time, jerks are not: the level is
        that of the quietest tenth of the log.
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
    """Attitudes at the samples from a window's polynomials, as far as whole windows go.

    Another method gets their values at times so close that it integrates them exactly.
    """
    # an error of order 4 is 20000 times less then; picard's may be less than that, but its own
    # polynomial it integrates exactly
    tight, fineness = ("picard", 6) if method == "picard" else ("coning3", 12)
    window = METHODS[method].window
    powers = np.arange(window.samples(False))
    spans = np.broadcast_to(dt, len(rates) - 1)
    t = np.concatenate([[0.0], np.cumsum(spans)])
    n = len(spans) // window.span * window.span
    inside = np.arange(fineness)[:, None] / fineness
    found = [q0[None]]
    for k in np.array_split(np.arange(n), -(-n // _PIECE)):
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
