"""Comparison of attitudes with a reference, after alignment of clocks and frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between, normalised, quat_multiply, rotation_vector_to_quat
from fastatt.estimation import attitude_error, attitude_from_vectors, mean_attitude
from fastatt.logs import names
from fastatt.logs.gaps import in_order
from fastatt.logs.names import GyroLogError
from fastatt.logs.stamps import times
from fastatt.logs.text import Text, opened

Floats = NDArray[np.float64]
_LEAST = 10  # the smallest number of reference attitudes within the log
_FITTED = 2000  # the largest number to which clocks and frames are fitted
_SPAN = 0.25  # s; rotations over it align the body axes
_SHIFT = 1.0  # s; the largest difference of clocks that have times in common
_ALIKE = 0.5  # smallest correlation of angular speeds that aligns the clocks
_EVEN = 0.01  # relative deviation of a speed, below which it does not align the clocks
_LINE = 0.1  # smallest share of rotation about a second axis that aligns the body axes


@dataclass(frozen=True)
class RecordedAttitudes:
    """Attitudes (n, 4) at times (n,), s from the first, when the clock shows ``start``, s."""

    t: Floats
    q: Floats
    start: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """The angle between attitudes and those of a reference.

    Attributes
    ----------
    t : ndarray, shape (m,)
        Times of the reference, s of the log.
    angle : ndarray, shape (m,)
        The remaining angle, rad.
    shift : float
        By how much the reference's clock is ahead of the log's, s.
    body : ndarray, shape (4,)
        The rotation of the body axes: q_reference ≈ world∘q∘body with a constant world.
    aligned : tuple of bool
        Whether the motion determined ``shift``, and ``body``; otherwise clocks and axes are taken
        as equal.
    """

    t: Floats
    angle: Floats
    shift: float
    body: Floats
    aligned: tuple[bool, bool]

    def __str__(self) -> str:
        degrees = np.degrees(self.angle)
        between = math.degrees(float(angle_between(self.body, [1.0, 0.0, 0.0, 0.0])))
        clocks = f"clocks {self.shift:.4g} s apart" if self.aligned[0] else "clocks as they are"
        axes = f"body axes {between:.3g} deg apart" if self.aligned[1] else "body axes as they are"
        return (
            f"{len(degrees)} reference attitudes ({clocks}, {axes}): angle rms "
            f"{math.sqrt(float(np.mean(degrees**2))):.3g}, median {np.median(degrees):.3g}, "
            f"largest {degrees.max():.3g}, at the end {degrees[-1]:.3g} deg"
        )


def read_attitudes(source: Any) -> RecordedAttitudes:
    """Read a table of time stamps and attitudes: of EuRoC, TUM, motion capture, or fastatt."""
    with opened(source) as (name, stream):
        table = Text(name, stream, None)
        quat = names.quaternion(table.names)
        try:
            clock = names.clock(table.names)
        except GyroLogError as error:
            raise table.error(error) from None
        if quat is None or not clock:
            raise table.error(
                f"found no time and one attitude among {table.shown()}; accepted: columns named "
                "like time, qw, qx, qy, qz"
            )
        q, raw = table.read(quat, clock, numbers=4, strict=True)
    assert raw is not None
    t, start = times(table, clock, raw, None)
    samples = in_order(table, table.column(clock[0]), t, q, "refuse", math.inf)
    checks.attitudes(name, q)
    return RecordedAttitudes(samples.t, normalised(q), start)


def against_reference(
    t: ArrayLike, q: ArrayLike, reference: RecordedAttitudes, start: float = 0.0
) -> Comparison:
    """The angle between attitudes and a reference, whose clock and frames may differ.

    The clocks are shifted so that the angular speeds correlate best, by at most 1 s if they have
    times in common. The body axes are those that map the rotations over 0.25 s onto each other
    (Wahba's problem), and the inertial frame is the mean one. ``t`` (n,), s, is 0 where the log's
    clock shows ``start``.

    Raises ``GyroLogError`` if the clocks have no time in common and the speeds do not align them,
    or if fewer than 10 attitudes of the reference lie within the log.
    """
    when, attitudes = np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64)
    theirs = reference.t + (reference.start - start)
    in_common = theirs[0] < when[-1] and when[0] < theirs[-1]
    step = max(float(np.median(np.diff(x))) for x in (when, theirs))
    speeds = _speeds(when, attitudes, step), _speeds(theirs, reference.q, step)
    ahead = (theirs[0] - when[0]) / step
    delay, alike = _delay(*speeds, ahead, _SHIFT / step if in_common else math.inf)
    aligned = alike > _ALIKE
    if not (aligned or in_common):
        raise GyroLogError(
            "reference: its clock has no time in common with the log's, and the angular speeds do "
            f"not give the shift (correlation {alike:.2f}); accepted: times that overlap"
        )
    shift = 0.0
    if aligned:

        def apart(shift: float) -> float:
            angle, _ = _angles(when, attitudes, theirs - shift, reference.q, _FITTED)
            return float(np.mean(angle**2))

        shift = _least(apart, (ahead - delay) * step, 2.0 * step)
    theirs = theirs - shift
    angle, body = _angles(when, attitudes, theirs, reference.q, len(theirs))
    at = theirs[(theirs >= when[0]) & (theirs <= when[-1])]
    return Comparison(at, angle, float(shift), body, (aligned, bool(body[0] != 1.0)))


def _at(t: Floats, q: Floats, at: Floats) -> Floats:
    """Attitudes at times within t, with a constant rate between neighbours."""
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    part = ((at - t[k]) / (t[k + 1] - t[k]))[:, None]
    return np.asarray(
        quat_multiply(q[k], rotation_vector_to_quat(attitude_error(q[k], q[k + 1]) * part))
    )


def _speeds(t: Floats, q: Floats, step: float) -> Floats:
    """Rotation angles over steps, which are the same in all frames."""
    n = min(int((t[-1] - t[0]) / step), 1_000_000)
    even = _at(t, q, t[0] + step * np.arange(n + 1))
    return np.asarray(angle_between(even[1:], even[:-1]))


def _delay(a: Floats, b: Floats, ahead: float, near: float) -> tuple[int, float]:
    """The steps by which b fits a best, at most ``near`` from ``ahead``; the correlation."""
    if min(float(x.std() / max(x.max(), 1e-300)) for x in (a, b)) < _EVEN:
        return 0, 0.0
    a, b = a - a.mean(), b - b.mean()
    n = 1 << (len(a) + len(b)).bit_length()
    delays = np.arange(1 - len(b), len(a))
    products = np.fft.irfft(np.fft.rfft(a, n) * np.conj(np.fft.rfft(b, n)), n)[delays]
    first, last = np.maximum(delays, 0), np.minimum(delays + len(b), len(a))
    of_a, of_b = (np.append(0.0, np.cumsum(x * x)) for x in (a, b))
    size = np.sqrt((of_a[last] - of_a[first]) * (of_b[last - delays] - of_b[first - delays]))
    usable = (last - first >= min(len(a), len(b)) // 2) & (np.abs(delays - ahead) <= near)
    alike = np.divide(products, size, out=-np.ones(len(delays)), where=usable & (size > 0.0))
    k = int(np.argmax(alike))
    return int(delays[k]), float(alike[k])


def _angles(
    t: Floats, q: Floats, theirs: Floats, reference: Floats, most: int
) -> tuple[Floats, Floats]:
    """Angles at up to ``most`` of the reference's times, and its body axes."""
    where = np.flatnonzero((theirs >= t[0]) & (theirs <= t[-1]))
    if len(where) < _LEAST:
        raise GyroLogError(
            f"reference: {len(where)} attitudes within the log's time; accepted: at least {_LEAST}"
        )
    where = where[:: -(-len(where) // most)]
    a, b = _at(t, q, theirs[where]), reference[where]
    body = np.array([1.0, 0.0, 0.0, 0.0])
    apart = max(1, round(_SPAN / float(np.median(np.diff(theirs[where])))))
    if apart < len(where):
        of_a, of_b = (attitude_error(x[:-apart], x[apart:]) for x in (a, b))
        size = np.sqrt(np.linalg.norm(of_a, axis=1) * np.linalg.norm(of_b, axis=1))
        moving = size > 0.0
        sigma = _LINE * np.linalg.norm(size) / size[moving]
        with suppress(ValueError):  # without rotation about two axes
            body, _ = attitude_from_vectors(of_b[moving], of_a[moving], sigma)
    a = quat_multiply(a, body)
    world = mean_attitude(quat_multiply(b, a * [1, -1, -1, -1]))
    return np.asarray(angle_between(quat_multiply(world, a), b)), body


def _least(f: Callable[[float], float], x: float, width: float) -> float:
    """The minimum of f near x, by golden-section search."""
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    low, high = x - width, x + width
    for _ in range(24):
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, b) if f(a) < f(b) else (a, high)
    return 0.5 * (low + high)
