"""Force on a body, for Newton's equation in body axes μ(V̇ + Ω×V) = F.

Forces are in N along body axes; weights and other forces fixed in space are given along inertial
axes. Numbers of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fastatt.scene import models
from fastatt.scene.models import (
    Law,
    Model,
    Number,
    Packed,
    PositiveNumber,
    Resources,
    Sum,
    TabledVector,
    UserModel,
)
from fastatt.tracing.formulas import Vector, dot, quat, scale
from fastatt.tracing.graph import apply


class Force(Model):
    """Base of forces: ``formula(t, q, w, v, r)``, N along body axes.

    v and r are () where no velocity or position is carried, or where it is not stepped with the
    attitude. The optional method ``squared_rate(r)`` gives the square of the rate (rad/s) at which
    a body at r falls round a centre.
    """

    kind = "force"
    squared_rate: ClassVar[Any] = None


class Constant(Force):
    """A force along body axes, such as a thrust: (3,), (N, 3) or a table, N."""

    force: TabledVector

    def formula(self: Any, t: Any, q: Vector, w: Vector, v: Vector, r: Vector) -> Any:
        return self.force


class ConstantInertial(Force):
    """A force along inertial axes, such as a weight: (3,), (N, 3) or a table, N."""

    force: TabledVector

    def formula(self: Any, t: Any, q: Vector, w: Vector, v: Vector, r: Vector) -> Any:
        return quat.rotate_inverse(q, self.force)


class Drag(Force):
    """Linear drag F = −c V. ``coefficient`` c: a number or (N,), kg/s."""

    coefficient: Number

    def formula(self: Any, t: Any, q: Vector, w: Vector, v: Vector, r: Vector) -> Any:
        return scale(-self.coefficient, v)


class CentralGravity(Force):
    """Gravity of a point mass at the origin: F = −(μ m/r³) r, r the position that is carried, m.

    ``gravitational_parameter`` μ, m³/s²: a number or (N,), that of the Earth (IERS Conventions
    2010, table 1.1) unless said; m is the scene's mass. Methods whose record says ``couples`` take
    it; a step may be no longer than their limit at the rate 2 √(μ/r³).
    """

    gravitational_parameter: PositiveNumber = 3.986004418e14
    reads_position = True


class Custom(UserModel, Force):
    """A user's ``@njit`` function ``force(t, q, w, v, p) -> (f1, f2, f3)``, N along body axes.

    t in s; q, w and v (m/s, body axes) as tuples, p the tuple of ``params``, (P,) or (N, P). With
    ``uses_position`` it is ``force(t, q, w, v, r, p)``, r the position, m, along inertial axes. All
    is then stepped as one system, by methods whose record says ``couples``.
    """

    uses_position: bool = False


class _Weight(CentralGravity):
    """``CentralGravity`` with the scene's mass, kg."""

    mass: Number = 1.0

    def formula(self: Any, t: Any, q: Vector, w: Vector, v: Vector, r: Vector) -> Any:
        k = -self.mass * falling(r, self.gravitational_parameter)
        return quat.rotate_inverse(q, scale(k, r))

    def squared_rate(self: Any, r: Vector) -> Any:
        return falling(r, self.gravitational_parameter)


# messages name a model by its class
_Weight.__name__ = CentralGravity.__name__


def falling(r: Vector, gravitational_parameter: Any) -> Any:
    """μ/r³, 1/s²: square of the rate of a circular orbit."""
    inverse = 1.0 / apply("sqrt", dot(r, r))
    return gravitational_parameter * inverse * (inverse * inverse)


def _weighed(model: Any, mass: NDArray[np.float64]) -> Any:
    if isinstance(model, Sum) and isinstance(model.terms, (tuple, list)):
        return Sum(tuple(_weighed(term, mass) for term in model.terms))
    if isinstance(model, CentralGravity):
        return _Weight(model.gravitational_parameter, mass)
    return model


def pack(
    model: Any,
    n_bodies: int | None,
    mass: NDArray[np.float64],
    resources: Resources | None = None,
) -> Packed:
    """``models.pack`` of a force; ``mass`` is () or (N,), kg."""
    return models.pack(_weighed(model, mass), Force, n_bodies, resources)


def squares_of_rates(law: Law, r: Vector, p: Vector) -> list[Any]:
    """Squares of the rates (rad/s) at which a body falls round the centres that are known."""
    if law.parts:
        return [x for part, own in law.split(p) for x in squares_of_rates(part, r, own)]
    return [] if law.model.squared_rate is None else [law.numbers(None, p).squared_rate(r)]


__all__ = ["CentralGravity", "Constant", "ConstantInertial", "Custom", "Drag", "Sum"]


def __dir__() -> list[str]:
    return __all__
