"""A representation of the attitude as a record of formulas, which all methods use."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from fastatt._cached import cached_property
from fastatt.tracing.formulas import Vector, dot, plus, quat
from fastatt.tracing.graph import choose

#: a function of tuples of traced numbers; None if a representation does not have it
Formula = Any

#: groups of representations that share the limits of steps
FAMILIES = ("quaternion", "matrix", "mrp", "coordinates")


def same(x: Any) -> Any:
    """Return the argument."""
    return x


def body_speed(xdot: Vector, w: Vector) -> Any:
    """``|w|²``, for representations whose numbers change no faster than the body rotates."""
    return dot(w, w)


def coordinate_speed(xdot: Vector, w: Vector) -> Any:
    """``|ẋ|²``, for coordinates, which change faster than the body rotates near a pole.

    It is infinite at the pole, where ẋ is not finite.
    """
    square = dot(xdot, xdot)
    return choose(square < math.inf, square, math.inf)


def composed(compose: Formula) -> dict[str, Formula]:
    """``compose`` x∘q, with the rotations that follow from it."""
    return {
        "compose": compose,
        "rotate": lambda x, u: compose(x, quat.exp(u)),
        "rotate_short": lambda x, u: compose(x, quat.exp_short(u)),
    }


@dataclass(frozen=True, eq=False)
class Attitude:
    """A representation of the attitude: how it is stored while it is propagated.

    Formulas take and return tuples of traced numbers: x is the state of ``size`` numbers, q a unit
    quaternion from body to inertial axes, u a rotation vector (rad, body axes), w an angular
    velocity (rad/s, body axes), v a vector. A method accepts the representations that have the
    formulas that it uses.
    """

    name: str
    size: int
    #: number of values that a trajectory holds
    stored: int
    #: ``start(q)``, the state at a quaternion of any norm above zero
    start: Formula
    #: ``finish(x)``: (the values that a trajectory holds, the norm error)
    finish: Formula = lambda x: (x, 0.0)
    #: ``derivative(x, w)``, ẋ
    derivative: Formula = None
    #: ``rotate(x, u)``, x∘exp(u); ``rotate_short`` for angles of at most π
    rotate: Formula = None
    rotate_short: Formula = None
    #: ``compose(x, q)``, x∘q
    compose: Formula = None
    #: ``quaternion(x)``, the attitude as a unit quaternion
    quaternion: Formula = None
    #: ``nearby(x, q)``: the quaternion, of the sign of one less than π away, smooth also at states
    #: that are no rotation; None if ``quaternion`` is
    nearby: Formula = None
    #: ``to_body(x, v)``, Cᵀ v, an inertial vector along body axes
    to_body: Formula = None
    #: ``flip(x)``, the inverse attitude
    flip: Formula = None
    #: ``restore(x)``: (the projected state, the norm error)
    restore: Formula = None
    #: what a trajectory holds if the state is not projected
    raw: Formula = same
    #: ẋ at the rate 2w, if it takes fewer operations than ``derivative``
    half_derivative: Formula = None
    #: rotated about the first and the third axis, from cosine and sine of half the angle
    rotate_first: Formula = None
    rotate_third: Formula = None
    #: square of the rate that limits an explicit step
    speed_squared: Formula = body_speed
    #: which limits of steps hold, of ``FAMILIES``: those of quaternions, which change at half the
    #: body's rate, of matrices, which change at its rate, of modified Rodrigues parameters, or of
    #: coordinates with poles
    family: str = ""
    #: the representation without low parts, for one that compensates rounding
    uncompensated: Attitude | None = None
    #: size of an initial attitude, 4 for a quaternion
    coordinates: int = 4
    #: x + d of a compensated state, for its attitude and for a vector; a vector with its low parts
    add: Formula = plus
    add_vector: Formula = plus
    carry: Formula = same
    #: matrices (…, 3, 3), quaternions (…, 4), or 3-1-3 Euler angles (…, 3) of stored values
    to_dcm_array: Formula = None
    to_quat_array: Formula = None
    to_euler313_array: Formula = None

    def __post_init__(self) -> None:
        """Set the formulas that follow from others."""
        start, quaternion, derivative = self.start, self.quaternion, self.derivative
        following: dict[str, Formula] = {
            "compose": lambda x, q: start(quat.mul(quaternion(x), q)),
            "to_body": lambda x, v: quat.rotate_inverse(quaternion(x), v),
            "half_derivative": lambda x, v: derivative(x, plus(v, v)),
        }
        for name, formula in following.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, formula)

    def __reduce__(self) -> Any:
        """Pickle by name, since the formulas contain nested functions."""
        from fastatt import attitudes

        return _known, (next(k for k, x in attitudes.KNOWN.items() if x is self),)

    @property
    def compensated(self) -> bool:
        """Whether it compensates rounding."""
        return self.uncompensated is not None

    @property
    def has_poles(self) -> bool:
        """Whether its coordinates have poles, near which they change without bound."""
        return self.speed_squared is not body_speed

    @property
    def plain(self) -> Attitude:
        """The representation without low parts."""
        return self.uncompensated or self

    @cached_property
    def short(self) -> Attitude:
        """The representation whose ``rotate`` is for angles of at most π."""
        if self.rotate_short is None or self.rotate is self.rotate_short:
            return self
        low = self.uncompensated
        return replace(
            self, rotate=self.rotate_short, uncompensated=None if low is None else low.short
        )

    def near(self, x: Vector) -> Attitude:
        """The representation whose ``quaternion`` is smooth less than π away from a state."""
        nearby = self.nearby
        if nearby is None:
            return self
        q = self.quaternion(x)
        return replace(self, quaternion=lambda x: nearby(x, q))

    def value(self, x: Vector) -> Vector:
        """The state without its low parts."""
        return x[: len(x) // 2] if self.compensated else x


def _known(name: str) -> Attitude:
    """The representation of a name."""
    from fastatt import attitudes

    return attitudes.KNOWN[name]
