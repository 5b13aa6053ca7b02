"""The quaternion controller, with gains as numbers, per axis or as matrices, and a torque limit."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.models import Field, PackedLaw, Resources
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Pose, Torque, check_unit
from fastatt.tracing.formulas import Vector, dot, minus, product, quat, rigid, scale

TabledQuaternion = Annotated[ArrayLike | TimeSeries, Field((4,), table="slopes")]
#: gains as 1, 3 or 9 numbers
_Gains = Annotated[ArrayLike, Field((-1,))]


class QuaternionPD(Torque):
    """Attitude controller τ = −K sgn(e0) (e1, e2, e3) − D w, with the attitude error e = target*∘q.

    The vector part of e is half the rotation vector when the error is small, so that a stiffness of
    K N·m gives K/2 N·m/rad. If the target moves, its angular velocity along body axes is subtracted
    from w. The torque jumps where e0 passes 0; a step across the jump has order 1 with any method.

    Parameters
    ----------
    stiffness : array_like
        K, N·m: a number, one for each body axis, (3,), or a matrix along body axes, (3, 3), which
        is symmetric and has no negative eigenvalues. One for each body is (N, 1, 1) or (N, 3, 3).
    damping : array_like
        D, N·m·s, in the same shapes.
    target : array_like or TimeSeries, default (1, 0, 0, 0)
        Unit quaternions (4,) or (N, 4), or a table of them, whose signs are continuous from sample
        to sample.
    limit : array_like, optional
        Largest torque along each body axis, N·m, above 0: a number, (3,), (N, 1) or (N, 3).

    References
    ----------
    Wie, *Space Vehicle Dynamics and Control* (2008), §7.3.

    Examples
    --------
    >>> import fastatt as fa
    >>> pd = fa.torques.QuaternionPD((2.0, 1.0, 1.0), 3.0, limit=0.1)
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=pd)
    """

    stiffness: Annotated[ArrayLike, Field((3, 3))]
    damping: Annotated[ArrayLike, Field((3, 3))]
    target: TabledQuaternion = (1.0, 0.0, 0.0, 0.0)
    limit: Annotated[ArrayLike | None, Field((3,))] = None

    def decay(self) -> Any:
        """The largest damping gain, for a matrix a bound of its eigenvalues; (N,) if per body."""
        found = np.abs(np.asarray(self.damping, dtype=np.float64))
        if found.ndim >= 2:
            return found.sum(axis=-1).max(axis=-1)
        return found.max(axis=-1) if found.ndim else found

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        name = f"{argument}: QuaternionPD"
        if isinstance(self.target, TimeSeries):
            _check_signs(name, self.target)
        k = _gains(f"{name}.stiffness", self.stiffness)
        c = _gains(f"{name}.damping", self.damping)
        if self.limit is None:
            made: Torque = _Feedback(k, c, self.target)
        else:
            limit = models.along_axes(f"{name}.limit", self.limit)
            limit = np.broadcast_to(limit, (*limit.shape[:-1], 3))
            made = _LimitedFeedback(k, c, self.target, limit)
        return made.pack(n_bodies, argument, resources)


class _Feedback(Torque):
    """A controller with its gains as formulas take them."""

    stiffness: _Gains
    damping: _Gains
    target: TabledQuaternion

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        (target, slope), w = self.target, pose.w
        if slope:
            # angular velocity of the target, q, along body axes: 2 q* (dq/dt q*) q
            rate = quat.mul(slope, quat.conj(target))
            size = dot(target, target)
            target = quat.normalise(target)
            w = minus(w, pose.to_body(tuple(2.0 * x / size for x in rate[1:])))
        error = rigid.target_error(target, pose.quaternion)
        if len(self.stiffness) == len(self.damping) == 1:
            return rigid.quaternion_feedback(error, w, self.stiffness[0], self.damping[0])
        shorter = scale(-rigid.sign_of_scalar(error), error[1:])
        return minus(_gained(self.stiffness, shorter), _gained(self.damping, w))

    def check(self: Any, name: str) -> None:
        check_unit(f"{name}.target", self.target[0], np.abs(self.stiffness).max(axis=0))


class _LimitedFeedback(_Feedback):
    """A controller with a largest torque along each axis."""

    limit: Annotated[ArrayLike, Field((3,), above_zero=True)]

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return rigid.saturated(_Feedback.formula(self, t, pose), self.limit)


# error messages name a model by its class
_Feedback.__name__ = _LimitedFeedback.__name__ = QuaternionPD.__name__


def _gained(gain: Vector, v: Vector) -> Vector:
    """The product of a vector with a number, a number per axis, or a matrix."""
    if len(gain) == 9:
        return tuple(dot(gain[3 * i : 3 * i + 3], v) for i in range(3))
    return product(gain * 3 if len(gain) == 1 else gain, v)


def _check_signs(name: str, target: TimeSeries) -> None:
    q = target.samples
    rotated = np.argwhere((q[:, 1:] * q[:, :-1]).sum(axis=-1) <= 0.0)
    if len(rotated):
        row, k = rotated[0]
        raise ValueError(
            f"{name}.target of row {row} changes its sign, or rotates by π or more, after sample "
            f"{k}; accepted: quaternions whose signs are continuous"
        )


def _gains(name: str, value: Any) -> NDArray[np.float64]:
    """Gains as rows of 1, 3 or 9 numbers, (n,) for all bodies or (N, n).

    Raises ``ValueError`` for other shapes, negative gains and matrices that are not symmetric.
    """
    gains = models.numbers(name, value)
    if gains.shape == (1, 1):  # one number for each body
        gains = gains[0, 0]
    if gains.shape not in ((), (3,), (3, 3)) and not (
        gains.ndim == 3 and gains.size and gains.shape[1:] in ((1, 1), (3, 3))
    ):
        raise ValueError(
            f"{name} {checks.shape(gains)}; accepted: a number, (3,) per axis, a (3, 3) matrix, "
            "and of each body (N, 1, 1) or (N, 3, 3)"
        )
    if gains.shape[-2:] != (3, 3):
        checks.refuse(name, gains, gains < 0.0, "0 or more")
        return gains.reshape(-1) if gains.ndim < 3 else gains.reshape(-1, 1)
    size = np.abs(gains).max(axis=(-2, -1))
    lowest = np.linalg.eigvalsh(gains)[..., 0]
    asymmetry = np.abs(gains - np.swapaxes(gains, -2, -1)).max(axis=(-2, -1))
    checks.refuse(f"{name}: its asymmetry", asymmetry, asymmetry > 1e-9 * size, "0")
    checks.refuse(f"{name}: its lowest eigenvalue", lowest, lowest < -1e-9 * size, "0 or more")
    return gains.reshape(*gains.shape[:-2], 9)
