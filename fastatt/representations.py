"""How an attitude is stored while it is propagated, and what every method needs of it.

A representation is an empty ``NamedTuple``: a tag whose type chooses the kernels when a driver
is compiled. Four operations stand for all of them: ``turn`` (compose with an exponential),
``derivative`` (the linear kinematic equation), ``flip`` (the inverse attitude, which turns rates
in inertial axes into rates in body axes) and ``finish`` (what is handed out, and how far the
state had left the group).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import hook, kernel
from fastatt.columns import plus, select
from fastatt.kernels import compensated, dcm, euler313, quat, so3
from fastatt.kernels.vec3 import dot, neg


class Quat(NamedTuple):
    """Unit quaternion, 4 numbers."""


class QuatShort(NamedTuple):
    """As ``Quat``, turns of at most π."""


class QuatCompensated(NamedTuple):
    """Quaternion and what rounding has left out of it, 8 numbers."""


class QuatCompensatedShort(NamedTuple):
    """As ``QuatCompensated``, turns of at most π."""


class Dcm(NamedTuple):
    """Direction cosine matrix, 9 numbers."""


class DcmShort(NamedTuple):
    """As ``Dcm``, turns of at most π."""


class DcmRows(NamedTuple):
    """Two rows of the matrix, 6 numbers; the third is their cross product (Darboux)."""


class DcmRowsShort(NamedTuple):
    """As ``DcmRows``, turns of at most π."""


class Direction(NamedTuple):
    """One inertial direction in body axes, 3 numbers (Poisson's equation in vector form)."""


class DirectionShort(NamedTuple):
    """As ``Direction``, turns of at most π."""


class Euler313(NamedTuple):
    """3-1-3 Euler angles, 3 numbers."""


class RotationVector(NamedTuple):
    """Rotation vector from the reference attitude, 3 numbers (Bortz)."""


Tag = Any  # an instance of one of the classes above


def initial(rep: Tag, q0: Any, b: Any) -> Any:
    """The state of body b: its row of initial attitudes, quaternions of any length but zero."""
    raise NotImplementedError(rep)


def turn(rep: Tag, x: Any, u: Any) -> Any:
    """x∘exp(u): the state x turned by the rotation vector u (rad, body axes)."""
    raise NotImplementedError(rep)


def derivative(rep: Tag, x: Any, w: Any) -> Any:
    """Time derivative of the state x at body rates w (rad/s)."""
    raise NotImplementedError(rep)


def half_derivative(rep: Tag, x: Any, v: Any) -> Any:
    """Time derivative of the state x at body rates 2v (rad/s): of a quaternion three flops less."""
    raise NotImplementedError(rep)


def speed_squared(rep: Tag, xdot: Any, w: Any) -> Any:
    """Square of the rate (rad/s) that limits an explicit step: of the body or of its angles."""
    raise NotImplementedError(rep)


def compose(rep: Tag, x: Any, q: Any) -> Any:
    """x∘q: the state x turned by a unit quaternion q in body axes."""
    raise NotImplementedError(rep)


def attitude(rep: Tag, x: Any) -> Any:
    """The state as a quaternion, unit as far as the state is."""
    raise NotImplementedError(rep)


def to_body(rep: Tag, x: Any, v: Any) -> Any:
    """Cᵀ v: the inertial vector v along body axes."""
    raise NotImplementedError(rep)


def flip(rep: Tag, x: Any) -> Any:
    """State of the inverse attitude."""
    raise NotImplementedError(rep)


def plain(rep: Tag) -> Any:
    """Tag of the same representation without low parts."""
    raise NotImplementedError(rep)


def value(rep: Tag, x: Any) -> Any:
    """The state without its low parts."""
    raise NotImplementedError(rep)


def gain(rep: Tag, x: Any, d: Any) -> Any:
    """x + d: what rounding loses is kept in the low parts of x, where it has any."""
    raise NotImplementedError(rep)


def gain_vector(rep: Tag, x: Any, d: Any) -> Any:
    """x + d of a 3-vector that is carried beside the attitude."""
    raise NotImplementedError(rep)


def carry(rep: Tag, v: Any) -> Any:
    """A 3-vector as it is carried beside the attitude: with a low part or without."""
    raise NotImplementedError(rep)


def restore(rep: Tag, x: Any) -> Any:
    """(the state nearer to its group, departure from it before)."""
    raise NotImplementedError(rep)


def finish(rep: Tag, x: Any, raw: Any) -> Any:
    """(what the trajectory holds, departure from the group).

    The state is brought back to its group, unless ``raw`` wants it as it is.
    """
    raise NotImplementedError(rep)


@kernel
def _same(x):
    return x


@kernel
def _turn_quat(x, u):
    return quat.mul(x, quat.exp(u))


@kernel
def _turn_quat_short(x, u):
    return quat.mul(x, quat.exp_short(u))


@kernel
def _turn_dcm(x, u):
    return dcm.mul(x, dcm.exp(u))


@kernel
def _turn_dcm_short(x, u):
    return dcm.mul(x, dcm.exp_short(u))


@kernel
def _turned_rows(x, r):
    a = dcm.rotate(r, (x[0], x[1], x[2]))
    b = dcm.rotate(r, (x[3], x[4], x[5]))
    return a[0], a[1], a[2], b[0], b[1], b[2]


@kernel
def _turn_rows(x, u):
    return _turned_rows(x, dcm.exp(neg(u)))


@kernel
def _turn_rows_short(x, u):
    return _turned_rows(x, dcm.exp_short(neg(u)))


@kernel
def _turn_direction(x, u):
    return quat.rotate_inverse(quat.exp(u), x)


@kernel
def _turn_direction_short(x, u):
    return quat.rotate_inverse(quat.exp_short(u), x)


@kernel
def _start_compensated(q):
    o = type(q[0])(0.0)
    return (*quat.normalise(q), o, o, o, o)


@kernel
def _attitude_compensated(x):
    return x[0], x[1], x[2], x[3]


@kernel
def _to_body_compensated(x, v):
    return quat.rotate_inverse((x[0], x[1], x[2], x[3]), v)


@kernel
def _flip_compensated(x):
    return x[0], -x[1], -x[2], -x[3], x[4], -x[5], -x[6], -x[7]


@kernel
def _carry(v):
    o = type(v[0])(0.0)
    return v[0], v[1], v[2], o, o, o


@kernel
def _compose_dcm(x, q):
    return dcm.mul(x, dcm.from_quat(q))


@kernel
def _compose_rows(x, q):
    return _turned_rows(x, dcm.from_quat(quat.conj(q)))


@kernel
def _compose_angles(x, q):
    return euler313.from_quat(quat.mul(euler313.to_quat(x), q))


@kernel
def _compose_vector(x, q):
    return quat.log(quat.mul(quat.exp(x), q))


@kernel
def _rows_to_dcm(x):
    return dcm.close_rows((x[0], x[1], x[2]), (x[3], x[4], x[5]))


@kernel
def _attitude_rows(x):
    return dcm.to_quat(_rows_to_dcm(x))


@kernel
def _to_body_rows(x, v):
    return dcm.rotate_inverse(_rows_to_dcm(x), v)


@kernel
def _to_body_angles(x, v):
    return quat.rotate_inverse(euler313.to_quat(x), v)


@kernel
def _to_body_vector(x, v):
    return quat.rotate_inverse(quat.exp(x), v)


@kernel
def _derivative_rows(x, w):
    a = dcm.derivative_row((x[0], x[1], x[2]), w)
    b = dcm.derivative_row((x[3], x[4], x[5]), w)
    return a[0], a[1], a[2], b[0], b[1], b[2]


@kernel
def _body_speed(xdot, w):
    return dot(w, w)


@kernel
def _angle_speed(xdot, w):
    return dot(xdot, xdot)


@kernel
def _flip_rows(x):
    c = dcm.transpose(_rows_to_dcm(x))
    return c[0], c[1], c[2], c[3], c[4], c[5]


@kernel
def _flip_angles(x):
    F = type(x[0])
    return F(math.pi) - x[2], x[1], F(math.pi) - x[0]


@kernel
def _start_dcm(q):
    return dcm.from_quat(quat.normalise(q))


@kernel
def _start_rows(q):
    c = dcm.from_quat(quat.normalise(q))
    return c[0], c[1], c[2], c[3], c[4], c[5]


@kernel
def _start_euler313(q):
    return euler313.from_quat(quat.normalise(q))


@kernel
def _finish_quat(x):
    F = type(x[0])
    return quat.normalise(x), math.sqrt(quat.dot(x, x)) - F(1.0)


@kernel
def _finish_compensated(x):
    F = type(x[0])
    q = (x[0], x[1], x[2], x[3])
    # |q|² − 1 of both parts: the squares' own rounding would hide a defect of an ulp
    low = x[0] * x[4] + x[1] * x[5] + x[2] * x[6] + x[3] * x[7]
    n = quat.dot(q, q)
    return quat.normalise(q), F(0.5) * ((n - F(1.0)) + (low + low))


@kernel
def _finish_dcm(x):
    return dcm.orthonormalise(dcm.orthonormalise(x)), dcm.defect(x)


@kernel
def _finish_rows(x):
    p = (x[0], x[1], x[2])
    r = (x[3], x[4], x[5])
    a, b = dcm.orthonormalise_rows(p, r)
    a, b = dcm.orthonormalise_rows(a, b)
    return dcm.close_rows(a, b), dcm.defect(dcm.close_rows(p, r))


@kernel
def _finish_direction(x):
    return x, math.sqrt(dot(x, x))


@kernel
def _restore_quat(x):
    F = type(x[0])
    return quat.renormalise(x), math.sqrt(quat.dot(x, x)) - F(1.0)


@kernel
def _restore_compensated(x):
    F = type(x[0])
    _, d = _finish_compensated(x)
    # of 16 ulps and more: less is rounding of d, and mended would turn the attitude one way,
    # 3e-20 rad at a time
    m = -d if F(1.0) + F(0.03125) * abs(d) > F(1.0) else F(0.0)
    return compensated.add_quat(x, (m * x[0], m * x[1], m * x[2], m * x[3])), d


@kernel
def _restore_dcm(x):
    return dcm.orthonormalise(x), dcm.defect(x)


@kernel
def _restore_rows(x):
    p = (x[0], x[1], x[2])
    r = (x[3], x[4], x[5])
    a, b = dcm.orthonormalise_rows(p, r)
    return (*a, *b), dcm.defect(dcm.close_rows(p, r))


@kernel
def _finish_angles(x):
    F = type(x[0])
    return x, F(0.0) * x[0]


class Operations(NamedTuple):
    """The kernels of one representation; ``short`` is its twin for turns of at most π.

    ``raw`` hands the state out as it is, ``restore`` brings it nearer to its group; None where
    the state is on no group, or is already what is handed out.
    """

    size: int
    stored: int
    start: Any
    turn: Any
    compose: Any
    attitude: Any
    to_body: Any
    derivative: Any
    speed_squared: Any
    flip: Any
    finish: Any
    short: type | None = None
    restore: Any = None
    raw: Any = None


_QUAT = Operations(
    4,
    4,
    quat.normalise,
    _turn_quat,
    quat.mul,
    _same,
    quat.rotate_inverse,
    quat.derivative,
    _body_speed,
    quat.conj,
    _finish_quat,
    QuatShort,
    _restore_quat,
)
_COMPENSATED = Operations(
    8,
    4,
    _start_compensated,
    compensated.turn,
    compensated.compose,
    _attitude_compensated,
    _to_body_compensated,
    None,
    _body_speed,
    _flip_compensated,
    _finish_compensated,
    QuatCompensatedShort,
    _restore_compensated,
    _attitude_compensated,
)
_DCM = Operations(
    9,
    9,
    _start_dcm,
    _turn_dcm,
    _compose_dcm,
    dcm.to_quat,
    dcm.rotate_inverse,
    dcm.derivative,
    _body_speed,
    dcm.transpose,
    _finish_dcm,
    DcmShort,
    _restore_dcm,
)
_ROWS = Operations(
    6,
    9,
    _start_rows,
    _turn_rows,
    _compose_rows,
    _attitude_rows,
    _to_body_rows,
    _derivative_rows,
    _body_speed,
    _flip_rows,
    _finish_rows,
    DcmRowsShort,
    _restore_rows,
    _rows_to_dcm,
)
_DIRECTION = Operations(
    3,
    3,
    _same,
    _turn_direction,
    None,
    None,
    None,
    dcm.derivative_row,
    _body_speed,
    _same,
    _finish_direction,
    DirectionShort,
)
OPERATIONS: dict[type, Operations] = {
    Quat: _QUAT,
    QuatShort: _QUAT._replace(turn=_turn_quat_short, short=None),
    QuatCompensated: _COMPENSATED,
    QuatCompensatedShort: _COMPENSATED._replace(turn=compensated.turn_short, short=None),
    Dcm: _DCM,
    DcmShort: _DCM._replace(turn=_turn_dcm_short, short=None),
    DcmRows: _ROWS,
    DcmRowsShort: _ROWS._replace(turn=_turn_rows_short, short=None),
    Direction: _DIRECTION,
    DirectionShort: _DIRECTION._replace(turn=_turn_direction_short, short=None),
    Euler313: Operations(
        3,
        3,
        _start_euler313,
        None,
        _compose_angles,
        euler313.to_quat,
        _to_body_angles,
        euler313.derivative,
        _angle_speed,
        _flip_angles,
        _finish_angles,
    ),
    RotationVector: Operations(
        3,
        3,
        quat.log,
        None,
        _compose_vector,
        quat.exp,
        _to_body_vector,
        so3.dexpinv,
        _angle_speed,
        neg,
        _finish_angles,
    ),
}

_PLAIN: dict[type, type] = {QuatCompensated: Quat, QuatCompensatedShort: QuatShort}
COMPENSATED = frozenset(_PLAIN)

QUAT = Quat()
REPRESENTATIONS: dict[str, type] = {
    "quat": Quat,
    "dcm": Dcm,
    "dcm_rows": DcmRows,
    "euler313": Euler313,
    "rotation_vector": RotationVector,
}


@hook(initial)
def _initial(rep: types.BaseNamedTuple, q0: types.Array, b: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].start
    if OPERATIONS[rep.instance_class] is _DIRECTION:
        return lambda rep, q0, b: (q0[b, 0], q0[b, 1], q0[b, 2])
    return lambda rep, q0, b: operation((q0[b, 0], q0[b, 1], q0[b, 2], q0[b, 3]))


@hook(turn)
def _turn(rep: types.BaseNamedTuple, x: types.Type, u: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].turn
    return lambda rep, x, u: operation(x, u)


@hook(derivative)
def _derivative(rep: types.BaseNamedTuple, x: types.Type, w: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].derivative
    return lambda rep, x, w: operation(x, w)


@hook(half_derivative)
def _half_derivative(rep: types.BaseNamedTuple, x: types.Type, v: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].derivative
    if OPERATIONS[rep.instance_class].derivative is quat.derivative:
        return lambda rep, x, v: quat.mul_vector(x, v)
    return lambda rep, x, v: operation(x, (v[0] + v[0], v[1] + v[1], v[2] + v[2]))


def has_poles(rep: type) -> bool:
    """Whether its numbers turn faster than the body does, at a pole without bound."""
    return OPERATIONS[rep].speed_squared is not _body_speed


def bears_witness(rep: type) -> bool:
    """Whether what spoils an exponential shows in the state's length: of a quaternion it does.

    A matrix made of a bad quaternion near ±1 is a good one, of a wrong angle.
    """
    return OPERATIONS[rep].derivative is quat.derivative or rep in COMPENSATED


@hook(speed_squared)
def _speed_squared(rep: types.BaseNamedTuple, xdot: types.Type, w: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].speed_squared
    return lambda rep, xdot, w: operation(xdot, w)


@hook(compose)
def _compose(rep: types.BaseNamedTuple, x: types.Type, q: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].compose
    return lambda rep, x, q: operation(x, q)


@hook(attitude)
def _attitude(rep: types.BaseNamedTuple, x: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].attitude
    return lambda rep, x: operation(x)


@hook(to_body)
def _to_body(rep: types.BaseNamedTuple, x: types.Type, v: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].to_body
    return lambda rep, x, v: operation(x, v)


@hook(flip)
def _flip(rep: types.BaseNamedTuple, x: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].flip
    return lambda rep, x: operation(x)


@hook(finish)
def _finish(rep: types.BaseNamedTuple, x: types.Type, raw: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].finish
    as_it_is = OPERATIONS[rep.instance_class].raw or _same

    def impl(rep, x, raw):
        y, d = operation(x)
        return select(raw, as_it_is(x), y), d

    return impl


@hook(restore)
def _restore(rep: types.BaseNamedTuple, x: types.Type) -> Any:
    operation = OPERATIONS[rep.instance_class].restore
    if operation is None:
        return lambda rep, x: (x, type(x[0])(0.0))
    return lambda rep, x: operation(x)


@hook(plain)
def _plain(rep: types.BaseNamedTuple) -> Any:
    if rep.instance_class in _PLAIN:
        tag = _PLAIN[rep.instance_class]
        return lambda rep: tag()
    return lambda rep: rep


@hook(value)
def _value(rep: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    if rep.instance_class in _PLAIN:
        n = len(x) // 2
        return lambda rep, x: x[:n]
    return lambda rep, x: x


@hook(gain)
def _gain(rep: types.BaseNamedTuple, x: types.BaseTuple, d: types.BaseTuple) -> Any:
    if rep.instance_class in _PLAIN:
        return lambda rep, x, d: compensated.add_quat(x, d)
    return lambda rep, x, d: plus(x, d)


@hook(gain_vector)
def _gain_vector(rep: types.BaseNamedTuple, x: types.BaseTuple, d: types.BaseTuple) -> Any:
    if rep.instance_class in _PLAIN:
        return lambda rep, x, d: compensated.add_vector(x, d)
    return lambda rep, x, d: plus(x, d)


@hook(carry)
def _carried_vector(rep: types.BaseNamedTuple, v: types.BaseTuple) -> Any:
    if rep.instance_class in _PLAIN:
        return lambda rep, v: _carry(v)
    return lambda rep, v: v
