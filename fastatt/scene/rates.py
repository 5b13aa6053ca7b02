"""Angular velocity as a function of time: built-in models and a user's own function.

Rates are in rad/s, along body axes unless the scene says ``frame="inertial"``; times in s, angles
in rad. Numbers of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.scene.models import Field, Law, Model, Number, PositiveNumber, Sum, UserModel, Vector3
from fastatt.tracing.formulas import axpy, scale, trig
from fastatt.tracing.graph import choose

Numbers = NDArray[np.float64]


class Rate(Model):
    """Base of rates: ``formula(t)``, rad/s.

    With ``states`` it is ``formula(t, states)``, and their time derivatives follow the rate.

    The optional method ``bound()`` gives what |w| is not above at any time, rad/s, of a model whose
    fields are arrays (..., N).
    """

    kind = "rate"
    bound: ClassVar[Any] = None


class Constant(Rate):
    """w(t) = w. ``w``: (3,) or (N, 3)."""

    w: Vector3

    def formula(self: Any, t: Any) -> Any:
        return self.w

    def bound(self: Any) -> Any:
        return lengths(self.w.T)


class Polynomial(Rate):
    """w(t) = Σ c_k t^k. ``coefficients``: (K, 3) or (N, K, 3), the constant term first."""

    coefficients: Annotated[ArrayLike, Field((-1, 3))]

    def formula(self: Any, t: Any) -> Any:
        *before, w = self.coefficients
        for c in reversed(before):
            w = axpy(t, w, c)
        return w


class Sinusoidal(Rate):
    """w(t) = bias + amplitude sin(frequency t + phase), axis by axis; each (3,) or (N, 3)."""

    bias: Vector3
    amplitude: Vector3
    frequency: Vector3
    phase: Vector3 = (0.0, 0.0, 0.0)

    def formula(self: Any, t: Any) -> Any:
        waves = zip(self.bias, self.amplitude, self.frequency, self.phase, strict=True)
        return tuple(b + a * trig.sincos(f * t + phase)[0] for b, a, f, phase in waves)

    def bound(self: Any) -> Any:
        return lengths((np.abs(self.bias) + np.abs(self.amplitude)).T)


class Coning(Rate):
    """The z axis sweeps a cone of half ``angle`` a at ``frequency`` Ω without turning round it.

    w = (−Ω sin a sin Ωt, Ω sin a cos Ωt, −2Ω sin²(a/2)), exact attitude
    q = (cos a/2, sin(a/2) cos Ωt, sin(a/2) sin Ωt, 0): Goodman and Robinson, ASME J. Appl. Mech.
    25 (1958) 210. Numbers or (N,).
    """

    angle: Number
    frequency: Number

    def formula(self: Any, t: Any) -> Any:
        s, c = trig.sincos(self.frequency * t)
        a, b = trig.sincos(0.5 * self.angle)
        k = 2.0 * self.frequency * a
        return -k * b * s, k * b * c, -k * a

    def bound(self: Any) -> Any:
        return np.abs(2.0 * self.frequency * np.sin(0.5 * self.angle))


class Precession(Rate):
    """Rate of constant size whose transverse part turns in the body, as in a free symmetric top.

    w = (A cos(kt + φ0), A sin(kt + φ0), s). Numbers or (N,): ``transverse`` A, ``axial`` s,
    ``frequency`` k, ``phase`` φ0.
    """

    transverse: Number
    axial: Number
    frequency: Number
    phase: Number = 0.0

    def formula(self: Any, t: Any) -> Any:
        s, c = trig.sincos(self.frequency * t + self.phase)
        return self.transverse * c, self.transverse * s, self.axial

    def bound(self: Any) -> Any:
        return np.hypot(self.transverse, self.axial)


class Slew(Rate):
    """Rest-to-rest turn by ``rotation`` (rad, (3,) or (N, 3)) in ``duration`` s from ``start`` on.

    w = rotation/T (1 − cos(2πs/T)) within the slew, 0 outside: rate and acceleration continuous.
    """

    rotation: Vector3
    duration: PositiveNumber
    start: Number = 0.0

    def formula(self: Any, t: Any) -> Any:
        x = (t - self.start) / self.duration
        x = choose(x < 0.0, 0.0, x)
        x = choose(x > 1.0, 1.0, x)
        s, _ = trig.sincos(3.141592653589793 * x)
        return scale(2.0 * s * s / self.duration, self.rotation)

    def bound(self: Any) -> Any:
        return 2.0 * lengths(self.rotation.T) / self.duration


class Custom(UserModel, Rate):
    """A user's ``@njit`` function ``rate(t, p) -> (w1, w2, w3)``, rad/s.

    t in s, p the tuple of ``params``, (P,) or (N, P). With ``states``, a number, the function
    carries so many numbers of its own, s: it is ``rate(t, s, p) -> (rate, ds/dt)``, and is stepped
    with the attitude, by methods whose record says ``couples``.
    """

    states: int = 0  # type: ignore[misc]


def lengths(v: NDArray[Any]) -> Numbers:
    """Of rows (N, 3); a matrix product, since numpy reduces short rows slowly."""
    return np.asarray(np.sqrt((v * v) @ np.ones(3)))


def bound(law: Law, params: Numbers) -> Numbers | None:
    """No less than |w| (rad/s) of each body at any time; None where there is no such bound.

    ``params`` are flat, (P,) or (N, P).
    """
    p = np.atleast_2d(params)
    if law.parts:
        parts = [bound(part, own.T) for part, own in law.split(p.T)]
        known = [part for part in parts if part is not None]
        return np.sum(known, axis=0) if len(known) == len(parts) else None
    if law.model.bound is None:
        return None
    return np.asarray(law.numbers(None, p.T).bound())


def is_constant(law: Law) -> bool:
    """Whether a rate never changes along its axes."""
    return isinstance(law.model, Constant)


__all__ = [
    "Coning", "Constant", "Custom", "Polynomial", "Precession", "Sinusoidal", "Slew", "Sum",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
