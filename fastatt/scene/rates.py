"""Angular velocities as functions of time: built-in models and user-defined functions.

Rates are in rad/s, along body axes unless the scene has ``frame="inertial"``; times are in s and
angles in rad. The parameters of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.scene.models import Field, Model, Number, PositiveNumber, Sum, UserModel, Vector3
from fastatt.tracing.formulas import axpy, scale, trig
from fastatt.tracing.graph import choose

Numbers = NDArray[np.float64]


class Rate(Model):
    """Base class of rates: ``formula(t)``, rad/s.

    With ``states`` it is ``formula(t, states)``, which returns their time derivatives after the
    rate.
    """

    kind = "rate"


class Constant(Rate):
    """A constant angular velocity.

    Parameters
    ----------
    w : array_like of shape (3,) or (N, 3)
        Angular velocity, rad/s.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.5)))
    """

    w: Vector3
    is_constant = True

    def formula(self: Any, t: Any) -> Any:
        return self.w


class Polynomial(Rate):
    """A polynomial in time, w(t) = Σ c_k t^k.

    Parameters
    ----------
    coefficients : array_like of shape (K, 3) or (N, K, 3)
        c_k, rad/s^(k+1), the constant term first.

    Examples
    --------
    >>> import fastatt as fa
    >>> spin_up = fa.rates.Polynomial([[0.0, 0.0, 0.1], [0.0, 0.0, 0.02]])
    """

    coefficients: Annotated[ArrayLike, Field((-1, 3))]

    def formula(self: Any, t: Any) -> Any:
        *before, w = self.coefficients
        for c in reversed(before):
            w = axpy(t, w, c)
        return w


class Sinusoidal(Rate):
    """A sine about each axis, w(t) = bias + amplitude sin(frequency t + phase).

    Parameters
    ----------
    bias : array_like of shape (3,) or (N, 3)
        Mean rate, rad/s.
    amplitude : array_like of shape (3,) or (N, 3)
        Amplitude, rad/s.
    frequency : array_like of shape (3,) or (N, 3)
        Angular frequency, rad/s.
    phase : array_like of shape (3,) or (N, 3), default (0, 0, 0)
        Phase, rad.

    Examples
    --------
    >>> import fastatt as fa
    >>> swing = fa.rates.Sinusoidal((0.0, 0.0, 0.1), (0.2, 0.0, 0.0), (3.0, 1.0, 1.0))
    """

    bias: Vector3
    amplitude: Vector3
    frequency: Vector3
    phase: Vector3 = (0.0, 0.0, 0.0)

    def formula(self: Any, t: Any) -> Any:
        waves = zip(self.bias, self.amplitude, self.frequency, self.phase, strict=True)
        return tuple(b + a * trig.sincos(f * t + phase)[0] for b, a, f, phase in waves)


class Coning(Rate):
    """Coning motion: the z axis sweeps a cone while the body does not rotate about it.

    The attitude is known in closed form, q = (cos(a/2), sin(a/2) cos Ωt, sin(a/2) sin Ωt, 0), for
    w = (−Ω sin a sin Ωt, Ω sin a cos Ωt, −2 Ω sin²(a/2)).

    Parameters
    ----------
    angle : float or array_like of shape (N,)
        Half angle a of the cone, rad.
    frequency : float or array_like of shape (N,)
        Angular frequency Ω, rad/s.

    References
    ----------
    Goodman and Robinson, *ASME Journal of Applied Mechanics* 25 (1958) 210.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Coning(0.1, frequency=2.0))
    """

    angle: Number
    frequency: Number

    def formula(self: Any, t: Any) -> Any:
        s, c = trig.sincos(self.frequency * t)
        a, b = trig.sincos(0.5 * self.angle)
        k = 2.0 * self.frequency * a
        return -k * b * s, k * b * c, -k * a


class Precession(Rate):
    """A rate of constant magnitude whose transverse part rotates in the body.

    This is the motion of a free symmetric top, w(t) = (A cos(k t + φ0), A sin(k t + φ0), s).

    Parameters
    ----------
    transverse : float or array_like of shape (N,)
        Transverse rate A, rad/s.
    axial : float or array_like of shape (N,)
        Axial rate s, rad/s.
    frequency : float or array_like of shape (N,)
        Angular frequency k of the transverse part in the body, rad/s.
    phase : float or array_like of shape (N,), default 0.0
        Phase φ0, rad.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Precession(0.1, 2.0, 1.0))
    """

    transverse: Number
    axial: Number
    frequency: Number
    phase: Number = 0.0

    def formula(self: Any, t: Any) -> Any:
        s, c = trig.sincos(self.frequency * t + self.phase)
        return self.transverse * c, self.transverse * s, self.axial


class Slew(Rate):
    """A rotation from rest to rest about a fixed axis.

    w(t) = rotation/T (1 − cos(2 π s/T)) for 0 ≤ s = t − start ≤ T, and 0 outside. Rate and angular
    acceleration are continuous. Steps end where the slew begins and ends, as at ``breakpoints`` of
    the scene, if all bodies share these times.

    Parameters
    ----------
    rotation : array_like of shape (3,) or (N, 3)
        Rotation vector of the whole slew, rad.
    duration : float or array_like of shape (N,)
        Duration T, s, above 0.
    start : float or array_like of shape (N,), default 0.0
        Time at which the slew begins, s.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Slew((0.0, 0.0, 1.5), duration=20.0))
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

    def corners(self) -> Numbers:
        """Begin and end, if all bodies share them."""
        begin, duration = np.asarray(self.start), np.asarray(self.duration)
        if begin.ndim or duration.ndim:
            return np.zeros(0)
        return np.array([begin, begin + duration], dtype=np.float64)


class Custom(UserModel, Rate):
    """A rate given by a user-defined function.

    Parameters
    ----------
    function : callable
        ``rate(t, p) -> (w1, w2, w3)``, rad/s, plain or jitted, with the time t, s, and the tuple p
        of parameters. With ``states`` it is ``rate(t, s, p) -> (rate, ds/dt)``.
    params : array_like of shape (P,) or (N, P), optional
        Parameters p of the function.
    states : int, default 0
        Number of states s of the function, which are stepped together with the attitude by methods
        for which ``Method.couples`` is True.

    Examples
    --------
    >>> import fastatt as fa
    >>> def swing(t, p):
    ...     return p[0] * t, 0.0, p[1]
    >>> scene = fa.Scene(rate=fa.rates.Custom(swing, (0.1, 0.2)))
    """

    states: int = 0  # type: ignore[misc]


__all__ = [
    "Coning", "Constant", "Custom", "Polynomial", "Precession", "Sinusoidal", "Slew", "Sum",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
