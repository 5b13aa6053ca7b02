"""Gravity-gradient torques, in given orbits and at positions."""

from __future__ import annotations

from typing import Any

import numpy as np

from fastatt import checks
from fastatt.scene.models import Number, PositiveNumber, TabledVector, Vector3
from fastatt.scene.torque_record import ROUNDED, Dependence, Pose, Torque, check_unit
from fastatt.tracing.formulas import dot, plus, quat, rigid, scale, vec3
from fastatt.tracing.graph import apply


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
        return _gravity_gradient_at(pose.beside.position, self.gravitational_parameter, pose)


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
