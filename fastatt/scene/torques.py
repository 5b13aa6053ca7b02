"""External torques: built-in models and user-defined functions.

Torques are in N·m along body axes. Fields and weights that are fixed in space are given along
inertial axes. The parameters of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.scene import models
from fastatt.scene.controller import QuaternionPD
from fastatt.scene.gravity_gradient import (
    CentralGravityGradient,
    GravityGradient,
    GravityGradientAt,
)
from fastatt.scene.models import Law, Packed, Resources, Sum
from fastatt.scene.reaction_wheels import ReactionWheels
from fastatt.scene.sampled_control import SampledControl
from fastatt.scene.torque_models import (
    FREE,
    Constant,
    ConstantInertial,
    Custom,
    Damping,
    HeavyTop,
    MagneticDipole,
    QuadraticDamping,
    Rotor,
)
from fastatt.scene.torque_record import Dependence, Pose, Torque
from fastatt.tracing.formulas import Vector, plus


def potential_of(law: Law, t: Any, pose: Pose, p: Vector) -> Any:
    """Potential energy (J) of a law that has one."""
    if law.parts:
        return sum(potential_of(part, t, pose, own) for part, own in law.split(p))
    model = law.numbers(t, p)
    return model.energy(t, pose if model.axis_free else pose.along_body)


def damping_rates(law: Law, moments: Vector, p: Vector, *, turned: bool = False) -> Vector | None:
    """c_i/I_i, 1/s, of the linear damping among the terms of a law; None if there is none.

    ``turned`` says that the principal axes are not the body axes.
    """
    if law.parts:
        found = [damping_rates(part, moments, own, turned=turned) for part, own in law.split(p)]
        known = [x for x in found if x is not None]
        return plus(*known) if known else None
    # the flow of damping along axes other than principal ones is not known
    if law.model.linear_damping is None or (turned and not law.model.axis_free):
        return None
    coefficients = law.numbers(None, p).linear_damping()
    return tuple(c / i for c, i in zip(coefficients, moments, strict=True))


def wheels_of(law: Law, p: Vector) -> list[tuple[Any, Vector]]:
    """(moment of inertia, axis) of each reaction wheel among the terms of a law."""
    if law.parts:
        return [wheel for part, own in law.split(p) for wheel in wheels_of(part, own)]
    return [] if law.model.wheels is None else law.numbers(None, p).wheels()


def is_free(law: Law) -> bool:
    """Whether a law is that of a free body."""
    return bool(law.model == FREE)


def fastest_decay(model: Any, moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """An upper bound of c/I of the linear damping in a model, 1/s, for each body or for all."""
    if isinstance(model, Sum):
        return sum((fastest_decay(term, moments) for term in model.terms), np.zeros(()))
    if not isinstance(model, Torque) or model.decay is None:
        return np.zeros(())
    return np.asarray(model.decay() / moments.min(axis=-1))


def lever_of(model: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """(arm, pull) of a model that has a lever, each (3,) or (N, 3); None for any other model."""
    if not isinstance(model, Torque) or model.lever is None:
        return None
    law, params = model.pack(None, "torque", {})
    if any(law.look_ups):  # tables depend on time
        return None
    arm, pull = law.numbers(None, np.moveaxis(params, -1, 0)).lever()
    return np.stack(arm, axis=-1), np.stack(np.broadcast_arrays(*pull), axis=-1)


def has_potential(law: Law) -> bool:
    """Whether kinetic plus potential energy is conserved under a law."""
    # tables depend on time
    return all(not any(leaf.look_ups) and leaf.model.energy is not None for leaf in law.leaves())


def dependence(law: Law, *, turned: bool = False) -> Dependence:
    """How a law depends on w; damping per axis counts as such only if axes are not ``turned``."""
    if law.parts:
        return max(dependence(part, turned=turned) for part in law.parts)
    found: Dependence = law.model.depends
    if found is Dependence.DAMPED and turned and not law.model.axis_free:
        return Dependence.RATE
    return found


def pack(model: Any, n_bodies: int | None, resources: Resources | None = None) -> Packed:
    """``models.pack`` of a torque, or of none."""
    return models.pack(FREE if model is None else model, Torque, n_bodies, resources)


__all__ = [
    "CentralGravityGradient", "Constant", "ConstantInertial", "Custom", "Damping",
    "GravityGradient", "GravityGradientAt", "HeavyTop", "MagneticDipole", "QuadraticDamping",
    "QuaternionPD", "ReactionWheels", "Rotor", "SampledControl", "Sum",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
