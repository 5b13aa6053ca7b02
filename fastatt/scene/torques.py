"""External torques: built-in models and user-defined functions.

Torques are in N·m along body axes. Fields and weights that are fixed in space are given along
inertial axes. The parameters of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fastatt import checks
from fastatt.scene.controller import QuaternionPD, SampledControl
from fastatt.scene.models import (
    Number,
    NumberOrVector,
    PositiveNumber,
    Sum,
    TabledMomentum,
    TabledVector,
    Vector3,
    on_each_axis,
)
from fastatt.scene.reaction_wheels import ReactionWheels
from fastatt.scene.switch import Switch
from fastatt.scene.torque_record import ROUNDED, Custom, Dependence, Pose, Torque, check_unit
from fastatt.tracing.formulas import dot, minus, plus, quat, rigid, scale, vec3
from fastatt.tracing.graph import apply


class Constant(Torque):
    """A constant torque along body axes, such as a thruster's.

    The potential energy is not defined.

    Parameters
    ----------
    torque : array_like of shape (3,) or (N, 3), or TimeSeries
        Torque, N·m; a table makes it a function of time.

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.Constant((0.0, 0.0, 0.1))
    """

    torque: TabledVector
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return self.torque


class ConstantInertial(Torque):
    """A constant torque along inertial axes.

    The potential energy is not defined.

    Parameters
    ----------
    torque : array_like of shape (3,) or (N, 3), or TimeSeries
        Torque, N·m; a table makes it a function of time.

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.ConstantInertial((0.0, 0.0, 0.1))
    """

    torque: TabledVector
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return pose.to_body(self.torque)


class Damping(Torque):
    """Linear damping τ_i = −c_i w_i.

    Parameters
    ----------
    coefficient : array_like
        c, N·m·s: a number, or one for each body axis, (3,). One for each body is (N, 1) or (N, 3).

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Damping(0.02))
    """

    coefficient: NumberOrVector
    depends = Dependence.DAMPED

    @property
    def axis_free(self: Any) -> bool:  # type: ignore[override]
        return len(self.coefficient) == 1

    def formula(self, t: Any, pose: Pose) -> Any:
        return rigid.damping(pose.w, self.linear_damping())

    def linear_damping(self: Any) -> Any:
        return on_each_axis(self.coefficient)

    def decay(self) -> Any:
        return self.coefficient


class QuadraticDamping(Torque):
    """Quadratic damping τ = −c ``|w|`` w.

    Parameters
    ----------
    coefficient : float or array_like of shape (N,)
        c, N·m·s².

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.QuadraticDamping(0.02)
    """

    coefficient: Number
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.quadratic_damping(pose.w, self.coefficient)


class HeavyTop(Torque):
    """The torque of a weight about a fixed point, τ = r × Cᵀ(0, 0, −W).

    The inertia of the scene is that about the fixed point. The torque has a potential energy. A
    symmetric body whose arm lies on its axis has a closed form (the method "exact").

    Parameters
    ----------
    arm : array_like of shape (3,) or (N, 3)
        Vector r from the fixed point to the centre of mass along body axes, m.
    weight : float or array_like of shape (N,)
        Weight W, along −z of the inertial axes, N.

    Examples
    --------
    >>> import fastatt as fa
    >>> top = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0, 0, 0.1), 10.0))
    """

    arm: Vector3
    weight: Number
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        # half of the vertical: the doubling is done to what stays
        return vec3.cross(vec3.scale(-2.0 * self.weight, self.arm), pose.to_body((0.0, 0.0, 0.5)))

    def energy(self: Any, t: Any, pose: Pose) -> Any:
        return self.weight * dot(self.arm, pose.to_body((0.0, 0.0, 1.0)))

    def lever(self) -> Any:
        return self.arm, (0.0, 0.0, self.weight)


class MagneticDipole(Torque):
    """The torque of a magnetic dipole in a field, τ = μ × CᵀB.

    The torque has a potential energy if dipole and field are constant.

    Parameters
    ----------
    dipole : array_like of shape (3,) or (N, 3), or TimeSeries
        Dipole moment μ along body axes, A·m².
    field : array_like of shape (3,) or (N, 3), or TimeSeries
        Magnetic field B along inertial axes, T.

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.MagneticDipole((0.0, 0.0, 0.1), (3e-5, 0.0, 0.0))
    """

    dipole: TabledVector
    field: TabledVector
    depends = Dependence.POSITION

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return vec3.cross(self.dipole, pose.to_body(self.field))

    def energy(self: Any, t: Any, pose: Pose) -> Any:
        return -dot(self.dipole, pose.to_body(self.field))

    def lever(self: Any) -> Any:
        return self.dipole, -self.field


class Rotor(Torque):
    """Wheels with angular momentum h in the body (a gyrostat), τ = h×w − dh/dt.

    The inertia of the scene is that of the whole body with its wheels locked. Energy and angular
    momentum of body and wheels are conserved if h is constant.

    Parameters
    ----------
    momentum : array_like of shape (3,) or (N, 3), or TimeSeries
        Angular momentum h of the wheels along body axes, N·m·s, constant or a cubic table.

    References
    ----------
    Hughes, *Spacecraft Attitude Dynamics* (1986), §6.1.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=fa.torques.Rotor((0.0, 0.0, 0.5)))
    """

    momentum: TabledMomentum

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        momentum, slope = self.momentum
        gyroscopic = vec3.cross(momentum, pose.w)
        return minus(gyroscopic, slope) if slope else gyroscopic

    def energy(self, t: Any, pose: Pose) -> Any:
        return 0.0

    def wheel_momentum(self) -> Any:
        return self.momentum


class GravityGradient(Torque):
    """Gravity-gradient torque τ = 3 n² o×(I o) in a circular orbit.

    I is the inertia of the scene, with the moments of its :class:`ReactionWheels` about their axes.
    o is the direction from the planet to the body. At t = 0 it lies along ``radial``, and a quarter
    of an orbit later along ``along``.

    Parameters
    ----------
    mean_motion : float or array_like of shape (N,)
        Mean motion n, rad/s.
    radial : array_like of shape (3,) or (N, 3), default (1, 0, 0)
        Unit vector along inertial axes.
    along : array_like of shape (3,) or (N, 3), default (0, 1, 0)
        Unit vector along inertial axes, normal to ``radial``.

    References
    ----------
    Hughes, *Spacecraft Attitude Dynamics* (1986), §8.1.

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.GravityGradient(mean_motion=1.1e-3)
    """

    mean_motion: Number
    radial: Vector3 = (1.0, 0.0, 0.0)
    along: Vector3 = (0.0, 1.0, 0.0)
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        o = pose.to_body(rigid.orbit_direction(t, self.mean_motion, self.radial, self.along))
        return _gravity_gradient(o, self.mean_motion, pose)

    def check(self: Any, name: str) -> None:
        check_unit(f"{name}.radial", self.radial, self.mean_motion)
        check_unit(f"{name}.along", self.along, self.mean_motion)
        across = (np.clip(self.radial, -1.0, 1.0) * np.clip(self.along, -1.0, 1.0)).sum(axis=0)
        off = (self.mean_motion != 0.0) & (np.abs(across) > ROUNDED)
        checks.refuse(f"{name}.radial·along", across, off, "0, vectors at right angles")


class GravityGradientAt(Torque):
    """Gravity-gradient torque τ = 3 (μ/r³) o×(I o) at a given position r o.

    Parameters
    ----------
    position : array_like of shape (3,) or (N, 3), or TimeSeries
        Position relative to the planet's centre along inertial axes, m.
    gravitational_parameter : float or array_like of shape (N,), default 3.986004418e14
        μ, m³/s². The default is that of the Earth (IERS Conventions 2010, table 1.1).

    References
    ----------
    Hughes, *Spacecraft Attitude Dynamics* (1986), equation 8.1.13.

    Examples
    --------
    >>> import fastatt as fa
    >>> torque = fa.torques.GravityGradientAt((7.0e6, 0.0, 0.0))
    """

    position: TabledVector
    gravitational_parameter: PositiveNumber = 3.986004418e14
    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return _gravity_gradient_at(self.position, self.gravitational_parameter, pose)


class CentralGravityGradient(Torque):
    """Gravity-gradient torque τ = 3 (μ/r³) o×(I o) at the propagated position r o.

    The position is relative to the planet's centre. The scene needs mass and a force, such as
    :class:`fastatt.forces.CentralGravity`. Methods for which ``Method.couples`` is True accept it.

    Parameters
    ----------
    gravitational_parameter : float or array_like of shape (N,), default 3.986004418e14
        μ, m³/s². The default is that of the Earth (IERS Conventions 2010, table 1.1).

    References
    ----------
    Hughes, *Spacecraft Attitude Dynamics* (1986), equation 8.1.13.

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(
    ...     inertia=(3.0, 2.0, 1.0), torque=fa.torques.CentralGravityGradient(), mass=10.0,
    ...     force=fa.forces.CentralGravity(),
    ... )
    """

    gravitational_parameter: PositiveNumber = 3.986004418e14
    depends = Dependence.POSITION
    axis_free = True
    reads_position = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return _gravity_gradient_at(pose.coupled.position, self.gravitational_parameter, pose)


def _gravity_gradient_at(r: Any, gravitational_parameter: Any, pose: Pose) -> Any:
    """The gravity-gradient torque at a position r, m, from a point mass, along inertial axes."""
    inverse = 1.0 / apply("sqrt", dot(r, r))
    rate = apply("sqrt", gravitational_parameter * inverse) * inverse
    return _gravity_gradient(pose.to_body(scale(inverse, r)), rate, pose)


def _gravity_gradient(o: Any, rate: Any, pose: Pose) -> Any:
    """The gravity-gradient torque of body and wheels in a direction o from the planet."""
    torque = rigid.gravity_gradient(o, pose.moments, rate)
    for moment, axis in pose.wheels():
        along = axis if pose.axes is None else quat.rotate_inverse(pose.axes, axis)
        pull = scale(3.0 * rate * rate * moment * dot(along, o), along)
        torque = plus(torque, vec3.cross(o, pull))
    return torque


__all__ = [
    "CentralGravityGradient", "Constant", "ConstantInertial", "Custom", "Damping",
    "GravityGradient", "GravityGradientAt", "HeavyTop", "MagneticDipole", "QuadraticDamping",
    "QuaternionPD", "ReactionWheels", "Rotor", "SampledControl", "Sum", "Switch",
]  # fmt: skip


def __dir__() -> list[str]:
    return __all__
