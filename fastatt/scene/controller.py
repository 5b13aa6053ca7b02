"""The quaternion controller: gains of all axes, of each, or a matrix, and a limit of the torque."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.models import Field, Packed
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_models import QuaternionPD, check_unit
from fastatt.scene.torque_record import Dependence, Pose, TorqueRecord
from fastatt.tracing.formulas import Vector, dot, minus, product, quat, rigid, scale


# what formulas take: gains of 1, 3 or 9 numbers
class _Plain(NamedTuple):
    stiffness: Any
    damping: Any
    target: Any


class _Limited(NamedTuple):
    stiffness: Any
    damping: Any
    target: Any
    limit: Any


# models are named by their class in messages
_Plain.__name__ = _Limited.__name__ = QuaternionPD.__name__


def _torque(t: Any, pose: Pose, m: Any) -> Any:
    (target, slope), w = m.target, pose.w
    if slope:
        # the target's own rate, seen from the body: 2 q* (dq/dt q*) q of the target's unit q
        rate = quat.mul(slope, quat.conj(target))
        size = dot(target, target)
        target = quat.normalise(target)
        w = minus(w, pose.to_body(tuple(2.0 * x / size for x in rate[1:])))
    error = rigid.target_error(target, pose.quaternion)
    if len(m.stiffness) == len(m.damping) == 1:
        torque = rigid.quaternion_feedback(error, w, m.stiffness[0], m.damping[0])
    else:
        shorter = scale(-rigid.sign_of_scalar(error), error[1:])
        torque = minus(_gained(m.stiffness, shorter), _gained(m.damping, w))
    return rigid.saturated(torque, m.limit) if isinstance(m, _Limited) else torque


def _gained(gain: Vector, v: Vector) -> Vector:
    """A number, a number per axis or a matrix times a vector."""
    if len(gain) == 9:
        return tuple(dot(gain[3 * i : 3 * i + 3], v) for i in range(3))
    return product(gain * 3 if len(gain) == 1 else gain, v)


def largest_damping(model: QuaternionPD) -> Any:
    """The largest damping gain or, of a matrix, a bound of its eigenvalues; (N,) if per body."""
    found = np.abs(np.asarray(model.damping, dtype=np.float64))
    if found.ndim >= 2:
        return found.sum(axis=-1).max(axis=-1)
    return found.max(axis=-1) if found.ndim else found


@lru_cache(maxsize=18)
def _record(stiffness: int, damping: int, limited: bool) -> TorqueRecord:
    fields = [*(Field((n,)) for n in (stiffness, damping)), Field((4,), table="slopes")]
    if limited:
        fields.append(Field((3,), True))
    model = _Limited if limited else _Plain
    return TorqueRecord(model, tuple(fields), _torque, Dependence.RATE, False)


#: a controller of matrices, from whose fields a scene takes rows
RECORD = TorqueRecord(
    QuaternionPD, (Field((3, 3)), Field((3, 3)), Field((4,), table="slopes"), Field((3,))),
    _torque, Dependence.RATE, False, decay=largest_damping,
)  # fmt: skip


def pack_controller(model: QuaternionPD, n_bodies: int | None, argument: str) -> Packed:
    """Check a controller's numbers and lay them out flat.

    Raises ``ValueError`` for gains, limits and targets that cannot be.
    """
    name = f"{argument}: QuaternionPD"
    if isinstance(model.target, TimeSeries):
        _check_signs(name, model.target)
    k = _gains(f"{name}.stiffness", model.stiffness)
    c = _gains(f"{name}.damping", model.damping)
    record = _record(k.shape[-1], c.shape[-1], model.limit is not None)
    given: Any = _Plain(k, c, model.target)
    if model.limit is not None:
        given = _Limited(k, c, model.target, _limit(f"{name}.limit", model.limit))
    packed = models.pack_fields(given, record, n_bodies, argument)
    if not isinstance(model.target, TimeSeries):
        p, at = np.moveaxis(packed.params, -1, 0), k.shape[-1] + c.shape[-1]
        check_unit(f"{name}.target", p[at : at + 4], np.abs(p[: k.shape[-1]]).max(axis=0))
    return packed


def _check_signs(name: str, target: TimeSeries) -> None:
    q = target.samples
    rotated = np.argwhere((q[:, 1:] * q[:, :-1]).sum(axis=-1) <= 0.0)
    if len(rotated):
        row, k = rotated[0]
        raise ValueError(
            f"{name}.target of row {row} turns its sign, or by half a turn, behind sample {k}; "
            "accepted: quaternions whose signs go on"
        )


def _limit(name: str, value: Any) -> NDArray[np.float64]:
    limit = models.numbers(name, value)
    if limit.ndim > 2 or limit.shape[-1:] not in ((), (1,), (3,)):
        raise ValueError(
            f"{name} {checks.shape(limit)}; accepted: a number, (3,) per axis, (N, 1) or (N, 3) "
            "per body"
        )
    return np.broadcast_to(limit, (*limit.shape[:-1], 3))


def _gains(name: str, value: Any) -> NDArray[np.float64]:
    """Gains as rows of 1, 3 or 9 numbers, (n,) of all bodies or (N, n).

    Raises ``ValueError`` for other shapes, negative gains and matrices that are not symmetric.
    """
    gains = models.numbers(name, value)
    if gains.shape == (1, 1):  # a body's number of (N, 1, 1)
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
