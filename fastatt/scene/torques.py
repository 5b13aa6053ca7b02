"""External torque: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Torques are in N·m along
body axes; fields and weights that are fixed in space are given along inertial axes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.controller import RECORD as CONTROLLER
from fastatt.scene.controller import pack_controller
from fastatt.scene.models import SUM, Law, Model, Packed, Sum
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_models import (
    FREE,
    MODELS,
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
from fastatt.scene.torque_record import Dependence, Pose, TorqueRecord
from fastatt.tracing.called import nested, points
from fastatt.tracing.formulas import Vector, as_like, plus, quat
from fastatt.tracing.nodes import NotStraight
from fastatt.tracing.user import UserFunction, user_function

#: records of the models, by class
RECORDS = {**MODELS, QuaternionPD: CONTROLLER}
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
    return law.record.potential(t, pose, law.numbers(t, p))


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
    damping = law.record.damping
    if damping is None:
        return None
    coefficients = damping(law.numbers(None, p))
    return tuple(c / i for c, i in zip(coefficients, moments, strict=True))


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
    arm, pull = record.lever(packed.structure.numbers(None, np.moveaxis(packed.params, -1, 0)))
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
    QuaternionPD: pack_controller,
    Custom: _pack_custom,
    Sampled: _pack_sampled,
}

__all__ = [
    "AxisDamping", "CentralGravityGradient", "Constant", "ConstantInertial", "Custom", "Damping",
    "GravityGradient", "GravityGradientAt", "HeavyTop", "KeplerGravityGradient", "MagneticDipole",
    "QuadraticDamping", "QuaternionPD", "Rotor", "Sampled", "Sum",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
