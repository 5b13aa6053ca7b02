"""Torque models: their parameters and formulas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.scene.models import (
    Number,
    PackedLaw,
    Resources,
    TabledMomentum,
    TabledVector,
    UserModel,
    Vector3,
    along_axes,
    resources_of,
)
from fastatt.scene.torque_record import Dependence, Pose, Torque
from fastatt.tracing.called import nested, points
from fastatt.tracing.formulas import Vector, as_like, dot, minus, rigid, vec3
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.user import UserFunction, user_function


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

    coefficient: Vector3
    depends = Dependence.DAMPED

    def decay(self) -> Any:
        found = np.abs(np.asarray(self.coefficient, dtype=np.float64))
        return found.max(axis=-1) if found.ndim else found

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        c = along_axes(f"{argument}: Damping.coefficient", self.coefficient)
        damping: Torque = _DampingOfAxes(c) if c.shape[-1] == 3 else _EqualDamping(c[..., 0])
        return damping.pack(n_bodies, argument, resources)


class _EqualDamping(Torque):
    """Damping with one coefficient for all axes."""

    coefficient: Number
    depends = Dependence.DAMPED
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.damping(pose.w, self.linear_damping())

    def linear_damping(self) -> Any:
        return (self.coefficient,) * 3


class _DampingOfAxes(Torque):
    """Damping with a coefficient for each body axis."""

    coefficient: Vector3
    depends = Dependence.DAMPED

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.damping(pose.w, self.coefficient)

    def linear_damping(self) -> Any:
        return self.coefficient


# error messages name a model by its class
_EqualDamping.__name__ = _DampingOfAxes.__name__ = Damping.__name__


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


class Custom(UserModel, Torque):
    """A torque given by a user-defined function.

    Parameters
    ----------
    function : callable
        ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m along body axes, plain or jitted. Its arguments
        are the time, s, the unit quaternion, the angular velocity, rad/s, and the parameters, all
        but t as tuples. With ``uses_position`` it is ``torque(t, q, w, v, r, p)``, with the
        velocity v along body axes, m/s, and the position r along inertial axes, m. With ``states``
        it takes the states s before p and returns ``(torque, ds/dt)``.
    params : array_like of shape (P,) or (N, P), optional
        Parameters p of the function.
    uses_rate : bool, default True
        False promises that the function does not depend on w, so that splitting methods accept it.
        The promise is checked at a few points.
    potential : callable, optional
        ``potential(t, q, p)``, the potential energy, J, plain or jitted, for :func:`fastatt.drift`.
        With ``uses_position`` it is ``potential(t, q, r, p)``, the energy of torque and force
        together.
    uses_position : bool, default False
        Whether the function depends on velocity or position. The scene then needs mass, and
        everything is stepped as one system, by methods for which ``Method.couples`` is True.
    states : int, default 0
        Number of states s of the function, which are stepped with the attitude as one system.

    Examples
    --------
    >>> import fastatt as fa
    >>> def spring(t, q, w, p):
    ...     return 0.0, 0.0, -p[0] * q[0] * q[3]
    >>> torque = fa.torques.Custom(spring, (0.5,), uses_rate=False)
    """

    uses_rate: bool = True
    potential: Callable[..., Any] | None = None
    uses_position: bool = False
    states: int = 0  # type: ignore[misc]

    @property
    def depends(self) -> Dependence:  # type: ignore[override]
        uses_rate = checks.flag("uses_rate", self.uses_rate)
        return Dependence.RATE if uses_rate else Dependence.POSITION

    @property
    def energy(self) -> Any:
        return None if self.potential is None else self._energy

    def _energy(self: Any, t: Any, pose: Pose) -> Any:
        return self.potential.given(t, pose.quaternion, pose.beside.position, self.params)

    def formula(self: Any, t: Any, pose: Pose, *states: Vector) -> Any:
        placed = pose.beside[:2] if self.uses_position else ()
        found = self.function.call(t, pose.quaternion, pose.w, *placed, *states, self.params)
        return as_like(found, pose.moments[0])

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        law, params = super().pack(n_bodies, argument, resources)
        function = law.model.function
        # checked when the scene is made, not at each run
        if (
            not checks.flag("uses_rate", self.uses_rate)
            and n_bodies is None
            and _uses_rate(function, params)
        ):
            raise ValueError(
                f"{argument}: found Custom.uses_rate False with {function.name}, which gives other "
                "torques at some w than at w = 0; accepted: True, or a function that does not use w"
            )
        if self.potential is not None:
            form = self.form.replace("torque", "potential")
            energy = user_function(self.potential, form, law.count, params)
            resources.update(resources_of(energy))
            law = replace(law, model=replace(law.model, potential=energy))
        return law, params


class _NoTorque(Torque):
    """The torque of a free body."""

    depends = Dependence.POSITION
    axis_free = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return 0.0, 0.0, 0.0

    def energy(self, t: Any, pose: Pose) -> Any:
        return 0.0


FREE = _NoTorque()


def _uses_rate(function: UserFunction, params: NDArray[np.float64]) -> bool:
    """Whether a user-defined torque at a few points differs from the torque at w = 0."""
    for point in points(function.sizes, params, function.span):
        t, q, w, *rest = nested(point, function.sizes)
        values = []
        for v in (w, (0.0, 0.0, 0.0)):
            try:
                values.append(function.call(t, q, v, *rest))
            except TraceError:  # the function raises an error at these numbers
                values.append((np.nan,) * function.form.results)
        turning, still = np.array(values)
        size = np.max(np.abs(still), where=np.isfinite(still), initial=0.0)
        if not np.allclose(turning, still, rtol=0.0, atol=1e-9 * size, equal_nan=True):
            return True
    return False
