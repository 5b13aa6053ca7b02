"""The base of torque models, and the pose of the body at which a torque is evaluated."""

from __future__ import annotations

from enum import IntEnum
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene.models import Model
from fastatt.tracing.formulas import Vector, quat


class Dependence(IntEnum):
    """How a torque depends on w: not, by linear damping along principal axes, or somehow."""

    POSITION = 0
    DAMPED = 1
    RATE = 2


class Beside(NamedTuple):
    """What is stepped with an attitude, () where it is not there.

    The velocity is along body axes, the position along inertial ones; states are a user's own.
    """

    velocity: Vector = ()
    position: Vector = ()
    states: Vector = ()


ALONE = Beside()


class Pose:
    """Where a torque is evaluated: an attitude, the angular velocity and the principal moments.

    ``beside`` is what is stepped with the attitude, its velocity along body axes whatever those of
    the pose; ``axes`` the quaternion of the principal axes, along which the pose is, where these
    are not the body's.
    """

    def __init__(
        self,
        attitude: Attitude,
        x: Vector,
        w: Vector,
        moments: Vector,
        beside: Beside = ALONE,
        axes: Vector | None = None,
    ) -> None:
        self._attitude, self._x = attitude, x
        self.w, self.moments, self.beside, self.axes = w, moments, beside, axes

    @cached_property
    def quaternion(self) -> Any:
        """The attitude as a quaternion, unit as far as the state is."""
        return self._attitude.quaternion(self._x)

    def to_body(self, v: Vector) -> Any:
        """Components of an inertial vector along the axes of the pose."""
        return self._attitude.to_body(self._x, v)

    @cached_property
    def along_body(self) -> Pose:
        """The pose along the body's axes."""
        if self.axes is None:
            return self
        q = quat.mul(self.quaternion, quat.conj(self.axes))
        return Pose(QUATERNION, q, quat.rotate(self.axes, self.w), self.moments, self.beside)


class Torque(Model):
    """Base of torques: ``formula(t, pose)``, N·m along the axes of the pose.

    With ``states`` it is ``formula(t, pose, states)``, and their derivatives follow the torque.

    Optional methods say what else a torque may be used for: ``energy(t, pose)`` is the potential
    energy, J; ``linear_damping()`` the three coefficients, N·m·s, of linear damping, ``decay()`` a
    bound of them in numpy; ``lever()`` (arm, pull), in body and in inertial axes, of a potential
    energy arm·Cᵀpull: a symmetric body with the arm on its axis has a closed form;
    ``wheel_momentum()`` that of wheels, N·m·s, body axes, of torques that keep the momentum of body
    and wheels.
    """

    kind = "torque"
    #: how it depends on w; splittings evaluate a torque of POSITION at a standstill
    depends: ClassVar[Dependence] = Dependence.RATE
    #: whether the formula holds along any axes, and not along the body's alone
    axis_free: ClassVar[bool] = False
    energy: ClassVar[Any] = None
    linear_damping: ClassVar[Any] = None
    decay: ClassVar[Any] = None
    lever: ClassVar[Any] = None
    wheel_momentum: ClassVar[Any] = None

    def evaluate(self, *state: Any) -> Any:
        """The torque along the axes of a pose, (t, pose) and, of one with some, states."""
        t, pose, *states = state
        if pose.axes is None or self.axis_free:
            return self.formula(t, pose, *states)
        found = self.formula(t, pose.along_body, *states)
        return (*quat.rotate_inverse(pose.axes, found[:3]), *found[3:])
