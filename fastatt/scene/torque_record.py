"""A torque model's record: its formula, at a pose of the body, and what it may be used for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene.models import Record
from fastatt.tracing.formulas import Vector, quat


class Dependence(IntEnum):
    """How a torque depends on w: not, by linear damping along principal axes, or somehow."""

    POSITION = 0
    DAMPED = 1
    RATE = 2


class Pose:
    """Where a torque is evaluated: an attitude, the angular velocity and the principal moments.

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
    """A class of torques: ``formula(t, pose, model)``, N·m along the axes of the pose.

    ``depends`` says how on w, and has no default: taken for independent, a torque is evaluated at
    a standstill by the splittings. ``damping(model)`` gives the coefficients (N·m·s, three) of what
    is linear damping; ``decay(model)`` a bound of them in numpy; ``potential(t, pose, model)`` the
    potential energy, J, where there is one. ``lever(model)`` gives (arm, pull), in body and in
    inertial axes, of a potential energy arm·Cᵀpull: a symmetric body with the arm on its axis has a
    closed form. ``momentum(model)`` gives the wheels' momentum of a user's model, N·m·s, body axes,
    of torques that keep the momentum of body and wheels.
    """

    depends: Dependence
    #: the same along all axes, or given along principal ones
    axis_free: bool
    potential: Callable[..., Any] | None = None
    damping: Callable[[Any], Vector] | None = None
    decay: Callable[[Any], Any] | None = None
    lever: Callable[[Any], tuple[Vector, Vector]] | None = None
    momentum: Callable[[Any], Any] | None = None
