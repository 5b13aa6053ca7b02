"""Attitudes beside a reference's: clocks and frames aligned, the angle left."""

from __future__ import annotations

import math
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
_LEAST = 10  # attitudes of the reference within the log
_FITTED = 2000  # of them, at most, the clocks and frames are fitted to
_TURN = 0.25  # s over which turns are compared
_SHIFT = 1.0  # s that clocks which say the same time may be apart
_ALIKE = 0.5  # correlation of the angular speeds from which on they tell the time
_EVEN = 0.01  # deviation of a speed, of its largest, that tells no time
_LINE = 0.1  # of the turning about other axes than one, from which on body axes are told by it


@dataclass(frozen=True)
class Reference:
    """Attitudes (n, 4) at times (n,), s from the first, whose clock says ``start``, s."""

    t: Floats
    q: Floats
    start: float = 0.0


@dataclass(frozen=True)
class Comparison:
    """How far attitudes are from a reference's.

    Attributes
    ----------
    t, angle : (m,), s of the log, and the angle left, rad, at the reference's instants.
    shift : s that the reference's clock is ahead of the log's.
    world, body : (4,): q_reference ≈ world∘q∘body, the other inertial frame and body axes.
    told : whether the motion told ``shift`` and ``body``; else the clocks, and equal axes, hold.
    """

    t: Floats
    angle: Floats
    shift: float
    world: Floats
    body: Floats
    told: tuple[bool, bool]

    def __str__(self) -> str:
        degrees = np.degrees(self.angle)
        turn = math.degrees(float(angle_between(self.body, [1.0, 0.0, 0.0, 0.0])))
        clocks = f"clocks {self.shift:.4g} s apart" if self.told[0] else "clocks as they are"
        axes = f"body axes turned by {turn:.3g} deg" if self.told[1] else "body axes as they are"
        return (
            f"{len(degrees)} reference attitudes ({clocks}, {axes}): angle rms "
            f"{math.sqrt(float(np.mean(degrees**2))):.3g}, median {np.median(degrees):.3g}, "
            f"largest {degrees.max():.3g}, at the end {degrees[-1]:.3g} deg"
        )


def read_attitudes(source: Any) -> Reference:
    """A table of time stamps and attitudes: of EuRoC, TUM, motion capture, or fastatt's own.

    Raises
    ------
    GyroLogError : columns, stamps or rows that are no attitudes.
    """
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
    return Reference(samples.t, normalised(q), start)


def against_reference(
    t: ArrayLike, q: ArrayLike, reference: Reference, start: float = 0.0
) -> Comparison:
    """The angle between attitudes and a reference's, whose clock and frames may be others.

    The clocks are shifted against each other such that the angular speeds correlate best, by at
    most 1 s where both say the same time. The body axes are those that turn the turns over 0.25 s
    into each other (Wahba), the inertial frame is the mean one.

    Parameters
    ----------
    t, q : (n,) and (n, 4), s from the first, attitudes body to inertial, scalar first.
    reference : attitudes of the same body, each in frames that do not change.
    start : s that the clock says at ``t`` = 0.

    Raises
    ------
    ValueError : clocks without a time in common, and speeds that do not tell the shift; fewer than
        10 attitudes of the reference within the log.
    """
    when, attitudes = np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64)
    own = reference.t + (reference.start - start)
    common = own[0] < when[-1] and when[0] < own[-1]
    step = max(float(np.median(np.diff(x))) for x in (when, own))
    ahead = (own[0] - when[0]) / step
    near = _SHIFT / step if common else math.inf
    delay, alike = _shift(
        _speeds(when, attitudes, step),
        _speeds(own, reference.q, step),
        (ahead - near, ahead + near),
    )
    told = alike > _ALIKE
    if not (told or common):
        raise GyroLogError(
            "reference: its clock has no time in common with the log's, and the angular speeds do "
            f"not tell the shift (correlation {alike:.2f}); accepted: times that overlap"
        )
    shift = 0.0
    if told:

        def apart(s: float) -> float:
            return _fitted(when, attitudes, own - s, reference.q)[0]

        shift = _nearest(apart, (ahead - delay) * step, step)
    _, world, body = _fitted(when, attitudes, own - shift, reference.q)
    inside = _inside(when, own - shift)
    at = (own - shift)[inside]
    moved = quat_multiply(world, quat_multiply(_at(when, attitudes, at), body))
    angle = np.asarray(angle_between(moved, reference.q[inside]))
    return Comparison(at, angle, float(shift), world, body, (told, bool(body[0] != 1.0)))


def _inside(t: Floats, own: Floats) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (own >= t[0]) & (own <= t[-1])
    if inside.sum() < _LEAST:
        raise GyroLogError(
            f"reference: {inside.sum()} attitudes within the log's time; accepted: at least "
            f"{_LEAST}"
        )
    return inside


def _at(t: Floats, q: Floats, at: Floats) -> Floats:
    """Attitudes at times within t, by a constant rate between neighbours."""
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    part = ((at - t[k]) / (t[k + 1] - t[k]))[:, None]
    turn = rotation_vector_to_quat(attitude_error(q[k], q[k + 1]) * part)
    return np.asarray(quat_multiply(q[k], turn))


def _speeds(t: Floats, q: Floats, step: float) -> Floats:
    """Angles turned over steps, which are the same in all frames."""
    n = min(int((t[-1] - t[0]) / step), 1_000_000)
    even = _at(t, q, t[0] + step * np.arange(n + 1))
    return np.asarray(angle_between(even[1:], even[:-1]))


def _shift(a: Floats, b: Floats, allowed: tuple[float, float]) -> tuple[int, float]:
    """Steps by which b has to be delayed to fit a best, and the correlation where they overlap."""
    if min(float(x.std() / max(x.max(), 1e-300)) for x in (a, b)) < _EVEN:
        return 0, 0.0
    a, b = a - a.mean(), b - b.mean()
    n = 1 << (len(a) + len(b)).bit_length()
    delays = np.arange(1 - len(b), len(a))
    products = np.fft.irfft(np.fft.rfft(a, n) * np.conj(np.fft.rfft(b, n)), n)[delays]
    first, last = np.maximum(delays, 0), np.minimum(delays + len(b), len(a))
    squares = [np.concatenate([[0.0], np.cumsum(x * x)]) for x in (a, b)]
    size = np.sqrt(
        (squares[0][last] - squares[0][first])
        * (squares[1][last - delays] - squares[1][first - delays])
    )
    usable = (last - first >= min(len(a), len(b)) // 2) & (size > 0.0)
    usable &= (delays >= allowed[0]) & (delays <= allowed[1])
    alike = np.where(usable, products / np.where(size > 0.0, size, 1.0), -1.0)
    k = int(np.argmax(alike))
    return int(delays[k]), float(alike[k])


def _fitted(t: Floats, q: Floats, own: Floats, reference: Floats) -> tuple[float, Floats, Floats]:
    """The mean square angle, the turns of the inertial frame and of the body axes."""
    where = np.flatnonzero(_inside(t, own))
    where = where[:: -(-len(where) // _FITTED)]
    a, b = _at(t, q, own[where]), reference[where]
    apart = max(1, round(_TURN / float(np.median(np.diff(own[where])))))
    body = np.array([1.0, 0.0, 0.0, 0.0])
    if apart < len(where):
        theirs, ours = (attitude_error(x[:-apart], x[apart:]) for x in (b, a))
        size = np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)
        moving = size > 0.0
        size = np.sqrt(size[moving])
        if moving.sum() > 1:
            sigma = _LINE * math.sqrt(float(size @ size)) / size
            with suppress(ValueError):  # turns about one axis only
                body, _ = attitude_from_vectors(theirs[moving], ours[moving], sigma)
    moved = quat_multiply(a, body)
    world = mean_attitude(quat_multiply(b, moved * [1, -1, -1, -1]))
    angle = np.asarray(angle_between(quat_multiply(world, moved), b))
    return float(np.mean(angle**2)), world, body


def _nearest(f: Any, x: float, width: float) -> float:
    """Where f is least, near x: golden section."""
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    low, high = x - 2.0 * width, x + 2.0 * width
    for _ in range(24):
        a, b = high - ratio * (high - low), low + ratio * (high - low)
        low, high = (low, b) if f(a) < f(b) else (a, high)
    return 0.5 * (low + high)
