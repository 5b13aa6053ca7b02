"""Force on a body, for Newton's equation in body axes μ(V̇ + Ω×V) = F.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Forces are in N along
body axes; weights and other forces fixed in space are given along inertial axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.scene import models
from fastatt.scene.models import SUM, Field, Law, Model, Packed, Record, Sum, join, pack_user
from fastatt.scene.time_series import TimeSeries
from fastatt.tracing.formulas import Vector, dot, quat, scale
from fastatt.tracing.graph import apply


class Constant(NamedTuple):
    """A force along body axes, such as a thrust: (3,), (N, 3) or a table, N."""

    force: ArrayLike | TimeSeries


class ConstantInertial(NamedTuple):
    """A force along inertial axes, such as a weight: (3,), (N, 3) or a table, N."""

    force: ArrayLike | TimeSeries


class Drag(NamedTuple):
    """Linear drag F = −c V. ``coefficient`` c: a number or (N,), kg/s."""

    coefficient: ArrayLike


class CentralGravity(NamedTuple):
    """Gravity of a point mass at the origin: F = −(μ m/r³) r, r the position that is carried, m.

    ``gravitational_parameter`` μ, m³/s²: a number or (N,), that of the Earth (IERS Conventions
    2010, table 1.1) unless said; m is the scene's mass. Methods whose record says ``couples`` take
    it; a step may be no longer than their limit at the rate 2 √(μ/r³).
    """

    gravitational_parameter: ArrayLike = 3.986004418e14


class Custom(NamedTuple):
    """A user's ``@njit`` function ``force(t, q, w, v, p) -> (f1, f2, f3)``, N along body axes.

    t in s; q, w and v (m/s, body axes) as tuples, p the tuple of ``params``, (P,) or (N, P). With
    ``uses_position`` it is ``force(t, q, w, v, r, p)``, r the position, m, along inertial axes. All
    is then stepped as one system, by methods whose record says ``couples``.
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None
    uses_position: bool = False


class _Weight(NamedTuple):
    """``CentralGravity`` with the scene's mass, kg."""

    gravitational_parameter: Any
    mass: Any


def _central_gravity(t: Any, q: Vector, w: Vector, v: Vector, r: Vector, m: Any) -> Any:
    return quat.rotate_inverse(q, scale(-m.mass * falling(r, m.gravitational_parameter), r))


def falling(r: Vector, gravitational_parameter: Any) -> Any:
    """μ/r³, 1/s²: square of the rate of a circular orbit."""
    inverse = 1.0 / apply("sqrt", dot(r, r))
    return gravitational_parameter * inverse * (inverse * inverse)


@dataclass(frozen=True, eq=False)
class ForceRecord(Record):
    """A class of forces, with the square of the rate (rad/s) at which a body falls round a centre.

    ``squared_rate(model, r)`` is that at a position; None where there is no centre.
    """

    squared_rate: Callable[[Any, Vector], Any] | None = None


# formulas of (t, q, w, v, r, model): force (N) along body axes at an attitude, a rate, a
# velocity and a position, () where none is carried or where it is not stepped with the attitude
_VECTOR = Field((3,), table="values")
_ALL = (
    ForceRecord(Constant, (_VECTOR,), lambda t, q, w, v, r, m: m.force),
    ForceRecord(
        ConstantInertial, (_VECTOR,), lambda t, q, w, v, r, m: quat.rotate_inverse(q, m.force)
    ),
    ForceRecord(Drag, (Field(),), lambda t, q, w, v, r, m: scale(-m.coefficient, v)),
    ForceRecord(CentralGravity, (Field(above_zero=True),), _central_gravity, reads_position=True),
)
_WEIGHT = ForceRecord(
    _Weight, (Field(), Field()), _central_gravity, reads_position=True,
    squared_rate=lambda m, r: falling(r, m.gravitational_parameter),
)  # fmt: skip
RECORDS: dict[type, ForceRecord] = {r.model: r for r in _ALL if r.model is not None}
USER = {
    at: ForceRecord(None, (), lambda *given: given[-1], reads_position=at) for at in (False, True)
}


def _pack_custom(model: Custom, n_bodies: int | None, argument: str) -> Packed:
    record = USER[bool(model.uses_position)]
    return pack_user(model.function, "force", record, model.params, n_bodies)


def pack(model: Model, n_bodies: int | None, mass: NDArray[np.float64]) -> Packed:
    """``models.pack`` of a force; ``mass`` is () or (N,), kg."""

    def pack_gravity(model: CentralGravity, n_bodies: int | None, argument: str) -> Packed:
        packed = models.pack_fields(model, RECORDS[CentralGravity], n_bodies, argument)
        params = join([packed.params, mass[..., None]], n_bodies, argument)
        return packed._replace(structure=Law(_WEIGHT, (1, 1)), params=params)

    others: dict[type, Any] = {Custom: _pack_custom, CentralGravity: pack_gravity}
    return models.pack(model, n_bodies, "force", RECORDS, others)


def squares_of_rates(law: Law, r: Vector, p: Vector) -> list[Any]:
    """Squares of the rates (rad/s) at which a body falls round the centres that are known."""
    if law.record is SUM:
        return [x for part, own in law.split(p) for x in squares_of_rates(part, r, own)]
    rate = law.record.squared_rate
    return [] if rate is None else [rate(law.numbers(None, p), r)]


__all__ = ["CentralGravity", "Constant", "ConstantInertial", "Custom", "Drag", "Sum"]


def __dir__() -> list[str]:
    return __all__
