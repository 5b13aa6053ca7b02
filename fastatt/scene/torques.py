"""External torque: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Torques are in N·m along
body axes; fields and weights that are fixed in space are given along inertial axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene import models
from fastatt.scene.models import SUM, Field, Law, Model, Packed, Record, Sum
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_models import (
    AxisDamping,
    CentralGravityGradient,
    Constant,
    ConstantInertial,
    Custom,
    Damping,
    GravityGradient,
    GravityGradientAt,
    HeavyTop,
    KeplerGravityGradient,
    MagneticDipole,
    QuadraticDamping,
    QuaternionPD,
    Rotor,
    Sampled,
)
from fastatt.tracing.formulas import Vector, as_like, dot, minus, plus, quat, rigid, scale, vec3
from fastatt.tracing.graph import apply
from fastatt.tracing.nodes import NotStraight
from fastatt.tracing.user import UserFunction, nested, points, user_function


class Dependence(IntEnum):
    """How a torque depends on w: not, by linear damping along principal axes, or somehow."""

    POSITION = 0
    DAMPED = 1
    RATE = 2


class Pose:
    """Where a torque is asked for: an attitude, the angular velocity and the principal moments.

    ``place`` is (velocity along body axes whatever those of the pose, position), where they are
    stepped with the attitude; ``axes`` the quaternion of the principal axes, along which the pose
    is, where these are not the body's.
    """

    def __init__(
        self,
        attitude: Attitude,
        x: Vector,
        w: Vector,
        moments: Vector,
        place: Vector = (),
        axes: Vector | None = None,
    ) -> None:
        self._attitude, self._x = attitude, x
        self.w, self.moments, self.place, self.axes = w, moments, place, axes

    @cached_property
    def quaternion(self) -> Any:
        """The attitude as a quaternion, unit as far as the state is."""
        return self._attitude.quaternion(self._x)

    def to_body(self, v: Vector) -> Any:
        """Components of an inertial vector along the axes of the pose."""
        return self._attitude.to_body(self._x, v)

    @cached_property
    def along_body(self) -> Pose:
        """The same along the body's own axes."""
        if self.axes is None:
            return self
        q = quat.mul(self.quaternion, quat.conj(self.axes))
        return Pose(QUATERNION, q, quat.rotate(self.axes, self.w), self.moments, self.place)


@dataclass(frozen=True, eq=False)
class TorqueRecord(Record):
    """A class of torques: ``formula(t, pose, p)``, N·m along the axes of the pose.

    ``depends`` says how on w, and has no default: taken for independent, a torque is evaluated at
    a standstill by the splittings. ``damping(p)`` gives the coefficients (N·m·s, three) of what is
    linear damping; ``decay(model)`` a bound of them in numpy; ``potential(t, pose, p)`` the
    potential energy, J, where there is one. ``lever(p)`` gives (arm, pull), in body and in inertial
    axes, of a potential energy arm·Cᵀpull: a symmetric body with the arm on its axis has a closed
    form.
    """

    depends: Dependence
    #: the same along all axes, or given along principal ones
    axis_free: bool
    potential: Callable[..., Any] | None = None
    damping: Callable[[Any], Vector] | None = None
    decay: Callable[[Any], Any] | None = None
    lever: Callable[[Any], tuple[Vector, Vector]] | None = None


def _no_potential(t: Any, pose: Pose, p: Vector) -> float:
    return 0.0


def _gravity_gradient(t: Any, pose: Pose, p: Vector) -> Any:
    o = pose.to_body(rigid.orbit_direction(t, p[0], p[1:4], p[4:7]))
    return rigid.gravity_gradient(o, pose.moments, p[0])


def _kepler_gravity_gradient(t: Any, pose: Pose, p: Vector) -> Any:
    o, nearness = rigid.kepler_direction(p[0] * t + p[8], p[1], p[2:5], p[5:8])
    # n² a³/r³ in place of n²
    rate = p[0] * nearness * apply("sqrt", nearness)
    return rigid.gravity_gradient(pose.to_body(o), pose.moments, rate)


def _gravity_gradient_at(t: Any, pose: Pose, p: Vector) -> Any:
    inverse = 1.0 / apply("sqrt", dot(p[:3], p[:3]))
    rate = apply("sqrt", p[3] * inverse) * inverse
    return rigid.gravity_gradient(pose.to_body(scale(inverse, p[:3])), pose.moments, rate)


def _central_gravity_gradient(t: Any, pose: Pose, p: Vector) -> Any:
    return _gravity_gradient_at(t, pose, (*pose.place[1], p[0]))


def _quaternion_pd(t: Any, pose: Pose, p: Vector) -> Any:
    target, turning = p[2:6], p[6:]
    w = pose.w
    if turning:
        # the target's own rate, seen from the body: 2 q* (dq/dt q*) q of the target's unit q
        target = quat.normalise(target)
        rate = quat.mul(turning, quat.conj(p[2:6]))
        size = dot(p[2:6], p[2:6])
        own = pose.to_body(tuple(2.0 * x / size for x in rate[1:]))
        w = minus(w, own)
    error = rigid.target_error(target, pose.quaternion)
    return rigid.quaternion_feedback(error, w, p[0], p[1])


def _rotor(t: Any, pose: Pose, p: Vector) -> Any:
    gyroscopic = vec3.cross(p[:3], pose.w)
    return minus(gyroscopic, p[3:]) if p[3:] else gyroscopic


# by how much given unit vectors may be off
_ROUNDED = 1e-3
_VECTOR, _NUMBER = Field((3,)), Field()
_TABLED = Field((3,), table="values")
_POSITION, _DAMPED, _RATE = Dependence
FREE = TorqueRecord(
    None, (), lambda t, pose, p: (0.0, 0.0, 0.0), _POSITION, True, potential=_no_potential
)
_ALL = (
    TorqueRecord(Constant, (_TABLED,), lambda t, pose, p: p, _POSITION, False),
    TorqueRecord(ConstantInertial, (_TABLED,), lambda t, pose, p: pose.to_body(p), _POSITION, True),
    TorqueRecord(
        Damping, (_NUMBER,), lambda t, pose, p: rigid.damping(pose.w, (p[0],) * 3), _DAMPED, True,
        damping=lambda p: (p[0],) * 3,
        decay=lambda model: np.abs(model.coefficient),
    ),
    TorqueRecord(
        AxisDamping, (_VECTOR,), lambda t, pose, p: rigid.damping(pose.w, p), _DAMPED, False,
        damping=lambda p: p,
        decay=lambda model: np.abs(np.asarray(model.coefficients)).max(axis=-1),
    ),
    TorqueRecord(
        QuadraticDamping, (_NUMBER,), lambda t, pose, p: rigid.quadratic_damping(pose.w, p[0]),
        _RATE, True,
    ),
    TorqueRecord(GravityGradient, (_NUMBER, _VECTOR, _VECTOR), _gravity_gradient, _POSITION, True),
    TorqueRecord(
        KeplerGravityGradient, (_NUMBER, _NUMBER, _VECTOR, _VECTOR, _NUMBER),
        _kepler_gravity_gradient, _POSITION, True,
    ),
    TorqueRecord(
        GravityGradientAt, (_TABLED, Field(above_zero=True)), _gravity_gradient_at, _POSITION, True
    ),
    TorqueRecord(
        CentralGravityGradient, (Field(above_zero=True),), _central_gravity_gradient,
        _POSITION, True, reads_position=True,
    ),
    TorqueRecord(
        HeavyTop, (_VECTOR, _NUMBER),
        # half of the vertical: the doubling is done to what stays
        lambda t, pose, p: vec3.cross(
            vec3.scale(-2.0 * p[3], p[:3]), pose.to_body((0.0, 0.0, 0.5))
        ),
        _POSITION, False,
        potential=lambda t, pose, p: p[3] * dot(p[:3], pose.to_body((0.0, 0.0, 1.0))),
        lever=lambda p: (p[:3], (0.0, 0.0, p[3])),
    ),
    TorqueRecord(
        MagneticDipole, (_TABLED, _TABLED),
        lambda t, pose, p: vec3.cross(p[:3], pose.to_body(p[3:])), _POSITION, False,
        potential=lambda t, pose, p: -dot(p[:3], pose.to_body(p[3:])),
        lever=lambda p: (p[:3], -p[3:]),
    ),
    TorqueRecord(
        QuaternionPD, (_NUMBER, _NUMBER, Field((4,), table="slopes")), _quaternion_pd, _RATE, False,
        decay=lambda model: np.abs(model.damping),
    ),
    TorqueRecord(
        Rotor, (Field((3,), table="slopes"),), _rotor, _RATE, False,
        potential=_no_potential,
    ),
)  # fmt: skip
RECORDS: dict[type, TorqueRecord] = {r.model: r for r in _ALL if r.model is not None}
USER = {
    (dependence, at): TorqueRecord(
        None, (), lambda *given: given[-1], dependence, False, reads_position=at
    )
    for dependence in Dependence
    for at in (False, True)
}


def torque_of(law: Law, t: Any, pose: Pose, p: Vector) -> Vector:
    """Torque (N·m) of a law with its flat parameters, along the axes of the pose."""
    if law.record is SUM:
        return plus(*(torque_of(part, t, pose, own) for part, own in law.split(p)))
    if pose.axes is not None and not law.record.axis_free:
        return quat.rotate_inverse(pose.axes, torque_of(law, t, pose.along_body, p))  # type: ignore[no-any-return]
    if law.function is not None:
        found = law.function.given(t, pose.quaternion, pose.w, *pose.place, p)
        return as_like(found, pose.moments[0])  # type: ignore[no-any-return]
    return law.record.formula(t, pose, law.numbers(t, p))  # type: ignore[no-any-return]


def potential_of(law: Law, t: Any, pose: Pose, p: Vector) -> Any:
    """Potential energy (J) of a law that has one."""
    if law.record is SUM:
        return sum(potential_of(part, t, pose, own) for part, own in law.split(p))
    if not law.record.axis_free:
        pose = pose.along_body
    if law.potential is not None:
        return law.potential.given(t, pose.quaternion, *pose.place[1:], p)
    return law.record.potential(t, pose, p)


def damping_rates(law: Law, moments: Vector, p: Vector, *, turned: bool = False) -> Vector | None:
    """c_i/I_i, 1/s, of the linear damping among the terms of a law; None if there is none.

    ``turned`` where principal axes are not the body's.
    """
    if law.record is SUM:
        found = [damping_rates(part, moments, own, turned=turned) for part, own in law.split(p)]
        known = [x for x in found if x is not None]
        return plus(*known) if known else None
    if turned and not law.record.axis_free:
        # of damping along other axes than principal ones no flow is known
        return None
    coefficients = law.record.damping
    return coefficients and tuple(c / i for c, i in zip(coefficients(p), moments, strict=True))


def is_free(law: Law) -> bool:
    """Whether it is no torque at all."""
    return law.record is FREE


def fastest_decay(model: Any, moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest c/I of the linear damping in a model, 1/s, of each body or of all: an upper bound."""
    if isinstance(model, Sum):
        return sum((fastest_decay(term, moments) for term in model.terms), np.zeros(()))
    record = RECORDS.get(type(model))
    decay = None if record is None else record.decay
    return np.zeros(()) if decay is None else np.asarray(decay(model) / moments.min(axis=-1))


def lever_of(model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """(arm, pull) of a model whose record has a lever, each (3,) or (N, 3); None of any other."""
    record = RECORDS.get(type(model))
    if record is None or record.lever is None:
        return None
    packed = models.pack_fields(model, record, None, "torque")
    if packed.structure.look_ups:  # what a table says depends on time
        return None
    arm, pull = record.lever(np.moveaxis(packed.params, -1, 0))
    return np.stack(arm, axis=-1), np.stack(np.broadcast_arrays(*pull), axis=-1)


def has_potential(law: Law) -> bool:
    """Whether kinetic plus potential energy stays constant under a law."""
    # what a table says depends on time
    return all(
        not leaf.look_ups and (leaf.potential or leaf.record.potential) is not None
        for leaf in law.leaves()
    )


def dependence(law: Law, *, turned: bool = False) -> Dependence:
    """How a law depends on w; linear damping axis by axis only where axes are not ``turned``."""
    if law.record is SUM:
        return max(dependence(part, turned=turned) for part in law.parts)
    found: Dependence = law.record.depends
    if found is Dependence.DAMPED and turned and not law.record.axis_free:
        return Dependence.RATE
    return found


def pack(model: Model, n_bodies: int | None) -> Packed:
    """``models.pack`` of a torque, or of none."""
    if model is None:
        return Packed(Law(FREE), np.zeros(0), {})
    return models.pack(model, n_bodies, "torque", RECORDS, _OTHERS)


def _check_unit(name: str, value: NDArray[np.float64], strength: NDArray[np.float64]) -> None:
    """Refuse another length than 1, give or take the rounding of few digits, where it matters."""
    with np.errstate(over="ignore"):
        size = np.linalg.norm(value, axis=-1)
    off = (strength != 0.0) & (np.abs(size - 1.0) > _ROUNDED)
    checks.refuse(f"{name}: its length", size, off, "1")


def _pack_orbit(
    model: GravityGradient | KeplerGravityGradient, n_bodies: int | None, argument: str
) -> Packed:
    """A model whose orbit is given by two unit vectors at right angles."""
    packed = models.pack_fields(model, RECORDS[type(model)], n_bodies, argument)
    name, at = f"{argument}: {type(model).__name__}", 1
    if isinstance(model, KeplerGravityGradient):
        e, at = packed.params[..., 1], 2
        checks.refuse(f"{name}.eccentricity", e, (e < 0.0) | (e > 0.9), "0 to 0.9")
    out, along = packed.params[..., at : at + 3], packed.params[..., at + 3 : at + 6]
    first, motion = model._fields[at], packed.params[..., 0]
    _check_unit(f"{name}.{first}", out, motion)
    _check_unit(f"{name}.along", along, motion)
    across = (np.clip(out, -1.0, 1.0) * np.clip(along, -1.0, 1.0)).sum(axis=-1)
    off = (motion != 0.0) & (np.abs(across) > _ROUNDED)
    checks.refuse(f"{name}.{first}·along", across, off, "0, vectors at right angles")
    return packed


def _pack_controller(model: QuaternionPD, n_bodies: int | None, argument: str) -> Packed:
    if isinstance(model.target, TimeSeries):
        q = model.target.samples
        turned = np.argwhere((q[:, 1:] * q[:, :-1]).sum(axis=-1) <= 0.0)
        if len(turned):
            row, k = turned[0]
            raise ValueError(
                f"{argument}: QuaternionPD.target of row {row} turns its sign, or by half a turn, "
                f"behind sample {k}; accepted: quaternions whose signs go on"
            )
    packed = models.pack_fields(model, RECORDS[QuaternionPD], n_bodies, argument)
    if not isinstance(model.target, TimeSeries):
        p = packed.params
        _check_unit(f"{argument}: QuaternionPD.target", p[..., 2:], p[..., 0])
    return packed


def _uses_rate(function: UserFunction, params: NDArray[np.float64]) -> bool:
    """Whether a user's torque at a few points differs from that at a standstill."""
    for point in points(function.sizes, params, function.span):
        t, q, w, *rest = nested(point, function.sizes)
        values = []
        for v in (w, (0.0, 0.0, 0.0)):
            try:
                values.append(function.call(t, q, v, *rest))
            except NotStraight:  # an error in Python at these numbers
                values.append((np.nan,) * 3)
        turning, still = np.array(values)
        size = np.max(np.abs(still), where=np.isfinite(still), initial=0.0)
        if not np.allclose(turning, still, rtol=0.0, atol=1e-9 * size, equal_nan=True):
            return True
    return False


def _pack_custom(model: Custom, n_bodies: int | None, argument: str) -> Packed:
    dependence = Dependence.RATE if model.uses_rate else Dependence.POSITION
    record = USER[dependence, bool(model.uses_position)]
    law, params, found = models.pack_user(model.function, "torque", record, model.params, n_bodies)
    # where the scene is made, not at each run of it
    if not model.uses_rate and n_bodies is None and _uses_rate(law.function, params):
        raise ValueError(
            f"{argument}: found Custom.uses_rate False with {law.function.name}, which gives other "
            "torques at some w than at w = 0; accepted: True, or a function that does not use w"
        )
    if model.potential is not None:
        form = "potential at position" if model.uses_position else "potential"
        energy = user_function(model.potential, form, law.count, params)
        law = replace(law, potential=energy)
        found = {**found, **models.resources_of(energy)}
    return Packed(law, params, found)


def _pack_sampled(model: Sampled, n_bodies: int | None, argument: str) -> Packed:
    samples = checks.array(f"{argument}: Sampled.torques", model.torques, "(n, 3)")
    if len(samples) < 2:
        raise ValueError(f"{argument}: Sampled.torques has 1 sample; accepted: at least 2")
    dt = checks.above_zero(f"{argument}: Sampled.dt", model.dt, "above 0")
    start = checks.real(f"{argument}: Sampled.start", model.start)
    choices = ("nan", "hold")
    outside = checks.choice(f"{argument}: Sampled.outside", model.outside, choices)
    times = start + dt * np.arange(len(samples))
    table = TimeSeries(times, samples, kind="linear", outside=outside)
    return models.pack_fields(Constant(table), RECORDS[Constant], n_bodies, argument)


_OTHERS: dict[type, Any] = {
    Custom: _pack_custom, Sampled: _pack_sampled, GravityGradient: _pack_orbit,
    KeplerGravityGradient: _pack_orbit, QuaternionPD: _pack_controller,
}  # fmt: skip

__all__ = [
    "AxisDamping", "CentralGravityGradient", "Constant", "ConstantInertial", "Custom", "Damping",
    "GravityGradient", "GravityGradientAt", "HeavyTop", "KeplerGravityGradient", "MagneticDipole",
    "QuadraticDamping", "QuaternionPD", "Rotor", "Sampled", "Sum",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
