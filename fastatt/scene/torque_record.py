"""The base class of torque models, and the pose of the body at which a torque is evaluated."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import IntEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene.models import Model
from fastatt.tracing.formulas import Vector, quat


class Dependence(IntEnum):
    """How a torque depends on w: not, by linear damping along principal axes, or otherwise."""

    POSITION = 0
    DAMPED = 1
    RATE = 2


class Beside(NamedTuple):
    """The quantities that are stepped with an attitude; () for those that a scene does not have.

    The velocity is along body axes and the position along inertial axes; the states are those of a
    user-defined function.
    """

    velocity: Vector = ()
    position: Vector = ()
    states: Vector = ()


ALONE = Beside()


class Pose:
    """Attitude, angular velocity and principal moments at which a torque is evaluated.

    ``beside`` has the quantities that are stepped with the attitude, with the velocity along body
    axes; ``axes`` is the quaternion of the principal axes, along which the pose is given, if these
    are not the body axes. ``wheels()`` are (moment of inertia, axis along body axes) of reaction
    wheels, which the principal moments do not contain.
    """

    def __init__(
        self,
        attitude: Attitude,
        x: Vector,
        w: Vector,
        moments: Vector,
        beside: Beside = ALONE,
        axes: Vector | None = None,
        wheels: Callable[[], Iterable[tuple[Any, Vector]]] = tuple,
    ) -> None:
        self._attitude, self._x = attitude, x
        self.w, self.moments, self.beside, self.axes = w, moments, beside, axes
        self.wheels = wheels

    @cached_property
    def quaternion(self) -> Any:
        """The attitude as a quaternion, of unit norm to the accuracy of the state."""
        return self._attitude.quaternion(self._x)

    def to_body(self, v: Vector) -> Any:
        """Components of an inertial vector along the axes of the pose."""
        return self._attitude.to_body(self._x, v)

    @cached_property
    def along_body(self) -> Pose:
        """The pose along the body axes."""
        if self.axes is None:
            return self
        q = quat.mul(self.quaternion, quat.conj(self.axes))
        return Pose(QUATERNION, q, quat.rotate(self.axes, self.w), self.moments, self.beside)


class Torque(Model):
    """Base class of torques: ``formula(t, pose)``, N·m along the axes of the pose.

    With ``states`` it is ``formula(t, pose, states)``, which returns their time derivatives after
    the torque.

    Optional methods open further uses of a torque. ``energy(t, pose)`` is the potential energy, J;
    ``linear_damping()`` the three coefficients, N·m·s, of linear damping, and ``decay()`` a bound
    of them in NumPy. ``lever()`` is (arm, pull), in body and in inertial axes, of a potential
    energy arm·Cᵀpull; a symmetric body with the arm on its axis has a closed form.
    ``wheel_momentum()`` is the angular momentum of wheels, N·m·s along body axes, of torques that
    conserve the momentum of body and wheels together. ``wheels()`` is (moment of inertia, axis) of
    each reaction wheel.
    """

    kind = "torque"
    #: how it depends on w; splitting methods evaluate a torque of POSITION at w = 0
    depends: ClassVar[Dependence] = Dependence.RATE
    #: whether the formula holds along any axes, or along body axes only
    axis_free: ClassVar[bool] = False
    energy: ClassVar[Any] = None
    linear_damping: ClassVar[Any] = None
    decay: ClassVar[Any] = None
    lever: ClassVar[Any] = None
    wheel_momentum: ClassVar[Any] = None
    wheels: ClassVar[Any] = None

    def evaluate(self, *state: Any) -> Any:
        """The torque along the axes of a pose, from (t, pose) and the states, if there are any."""
        t, pose, *states = state
        if pose.axes is None or self.axis_free:
            return self.formula(t, pose, *states)
        found = self.formula(t, pose.along_body, *states)
        return (*quat.rotate_inverse(pose.axes, found[:3]), *found[3:])


# tolerance of the norm of unit vectors
ROUNDED = 1e-3


def check_unit(name: str, value: Any, strength: Any) -> None:
    """Refuse vectors that have an effect and are not of unit length to a few digits."""
    with np.errstate(over="ignore"):
        size = np.linalg.norm(value, axis=0)
    off = (strength != 0.0) & (np.abs(size - 1.0) > ROUNDED)
    checks.refuse(f"{name}: its length", size, off, "1")
