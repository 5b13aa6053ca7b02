"""Angular velocity as a function of time: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Rates are in rad/s,
along body axes unless the scene says ``frame="inertial"``; times in s, angles in rad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.scene.models import SUM, Field, Law, Record, Sum
from fastatt.tracing.formulas import axpy, scale, trig
from fastatt.tracing.graph import choose

_VECTOR = Field((3,))


class Constant(NamedTuple):
    """w(t) = w. ``w``: (3,) or (N, 3)."""

    w: ArrayLike


class Polynomial(NamedTuple):
    """w(t) = Σ c_k t^k. ``coefficients``: (K, 3) or (N, K, 3), the constant term first."""

    coefficients: ArrayLike


class Sinusoidal(NamedTuple):
    """w(t) = bias + amplitude sin(frequency t + phase), axis by axis; each (3,) or (N, 3)."""

    bias: ArrayLike
    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = (0.0, 0.0, 0.0)


class Coning(NamedTuple):
    """The z axis sweeps a cone of half ``angle`` a at ``frequency`` Ω without turning round it.

    w = (−Ω sin a sin Ωt, Ω sin a cos Ωt, −2Ω sin²(a/2)), exact attitude
    q = (cos a/2, sin(a/2) cos Ωt, sin(a/2) sin Ωt, 0): Goodman and Robinson, ASME J. Appl. Mech.
    25 (1958) 210. Numbers or (N,).
    """

    angle: ArrayLike
    frequency: ArrayLike


class Precession(NamedTuple):
    """Rate of constant size whose transverse part turns in the body, as in a free symmetric top.

    w = (A cos(kt + φ0), A sin(kt + φ0), s). Numbers or (N,): ``transverse`` A, ``axial`` s,
    ``frequency`` k, ``phase`` φ0.
    """

    transverse: ArrayLike
    axial: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0


class Slew(NamedTuple):
    """Rest-to-rest turn by ``rotation`` (rad, (3,) or (N, 3)) in ``duration`` s from ``start`` on.

    w = rotation/T (1 − cos(2πs/T)) within the slew, 0 outside: rate and acceleration continuous.
    """

    rotation: ArrayLike
    duration: ArrayLike
    start: ArrayLike = 0.0


Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RateRecord(Record):
    """A class of rates: ``formula(t, model)``, and what |w| of a model is not above.

    ``bound(model)`` is that, rad/s, at any time, of a model of arrays (..., N); None where there is
    none.
    """

    bound: Callable[[Any], Any] | None = None


def _sinusoidal(t: Any, m: Any) -> Any:
    s = [trig.sincos(f * t + phase)[0] for f, phase in zip(m.frequency, m.phase, strict=True)]
    return tuple(b + a * x for b, a, x in zip(m.bias, m.amplitude, s, strict=True))


def _coning(t: Any, m: Any) -> Any:
    s, c = trig.sincos(m.frequency * t)
    a, b = trig.sincos(0.5 * m.angle)
    k = 2.0 * m.frequency * a
    return -k * b * s, k * b * c, -k * a


def _precession(t: Any, m: Any) -> Any:
    s, c = trig.sincos(m.frequency * t + m.phase)
    return m.transverse * c, m.transverse * s, m.axial


def _slew(t: Any, m: Any) -> Any:
    x = (t - m.start) / m.duration
    x = choose(x < 0.0, 0.0, x)
    x = choose(x > 1.0, 1.0, x)
    s, _ = trig.sincos(3.141592653589793 * x)
    return scale(2.0 * s * s / m.duration, m.rotation)


def _polynomial(t: Any, m: Any) -> Any:
    *before, w = m.coefficients
    for c in reversed(before):
        w = axpy(t, w, c)
    return w


def lengths(v: NDArray[Any]) -> Numbers:
    """Of rows (N, 3); a matrix product, since numpy reduces short rows slowly."""
    return np.asarray(np.sqrt((v * v) @ np.ones(3)))


_ALL = (
    RateRecord(Constant, (_VECTOR,), lambda t, m: m.w, bound=lambda m: lengths(m.w.T)),
    RateRecord(Polynomial, (Field((-1, 3)),), _polynomial),
    RateRecord(
        Sinusoidal, (_VECTOR,) * 4, _sinusoidal,
        bound=lambda m: lengths((np.abs(m.bias) + np.abs(m.amplitude)).T),
    ),
    RateRecord(
        Coning, (Field(),) * 2, _coning,
        bound=lambda m: np.abs(2.0 * m.frequency * np.sin(0.5 * m.angle)),
    ),
    RateRecord(
        Precession, (Field(),) * 4, _precession, bound=lambda m: np.hypot(m.transverse, m.axial)
    ),
    RateRecord(
        Slew, (_VECTOR, Field(above_zero=True), Field()), _slew,
        bound=lambda m: 2.0 * lengths(m.rotation.T) / m.duration,
    ),
)  # fmt: skip
RECORDS: dict[type, RateRecord] = {r.model: r for r in _ALL if r.model is not None}
USER = RateRecord(None, (), lambda t, m: m)


def bound(law: Law, params: Numbers) -> Numbers | None:
    """No less than |w| (rad/s) of each body at any time; None where there is no such bound.

    ``params`` are flat, (P,) or (N, P).
    """
    p = np.atleast_2d(params)
    if law.record is SUM:
        parts = [bound(part, own.T) for part, own in law.split(p.T)]
        known = [part for part in parts if part is not None]
        return np.sum(known, axis=0) if len(known) == len(parts) else None
    found = law.record.bound
    return None if found is None else np.asarray(found(law.numbers(None, p.T)))


def is_constant(law: Law) -> bool:
    """Whether a rate never changes along its axes."""
    return law.record.model is Constant


__all__ = ["Coning", "Constant", "Polynomial", "Precession", "Sinusoidal", "Slew", "Sum"]


def __dir__() -> list[str]:
    return __all__
