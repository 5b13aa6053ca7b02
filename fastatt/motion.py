"""The equations of motion that a method steps: of an attitude whose rate is given, or of a body.

The state is a tuple: the attitude's numbers, then what the scene makes the body carry, its angular
momentum along principal axes. A model's tag says which: a model of ``fastatt.rates``, or ``Body``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import types

from fastatt._jit import helper, hook
from fastatt.columns import unpack
from fastatt.kernels import dcm, quat, rigid
from fastatt.kernels.vec3 import add, axpy, dot
from fastatt.models import Model, count
from fastatt.rates import InertialAxes, rate
from fastatt.representations import (
    COMPENSATED,
    OPERATIONS,
    carry,
    compose,
    derivative,
    finish,
    flip,
    gain,
    gain_vector,
    half_derivative,
    initial,
    restore,
    speed_squared,
    value,
)
from fastatt.torques import AxisDamping, Damping, Free, Sum, damping_rates, torque


class Body(NamedTuple):
    """Tag of a rigid body; ``axes`` has four numbers where principal axes are not the body's.

    Its parameters: ½/I (3), I (3), c of ``rigid.gyroscopic_coefficients`` (3), the quaternion p of
    the principal axes (4 or none), the torque's.
    """

    torque: Model
    axes: Any = ()


class Moving(NamedTuple):
    """Tag of a scene that carries the velocity, and the position if ``position`` has three numbers.

    Its parameters: those of ``model``, 1/μ, the force's.
    """

    model: Model
    force: Model
    position: Any = ()


def _parts(model: Any) -> tuple[type, Any]:
    """Class and fields of a tag, or of its type as the compiler sees it."""
    if isinstance(model, types.BaseNamedTuple):
        return model.instance_class, model.types
    return type(model), model


def tail(model: Any) -> int:
    """Numbers handed out beside the attitude; ``model`` is a tag or its type."""
    cls, fields = _parts(model)
    if cls is Moving:
        return tail(fields[0]) + 3 + len(fields[2])
    return 3 if cls is Body else 0


def carried(rep: type, model: Any) -> int:
    """Numbers of state a body; ``model`` is a tag or its type."""
    cls, fields = _parts(model)
    turning = fields[0] if cls is Moving else model
    low = 3 if rep in COMPENSATED and _parts(turning)[0] is Body else 0
    return OPERATIONS[rep].size + low + tail(model)


def handed_out(rep: type, model: Any) -> int:
    """Numbers that a save hands out for a body; ``model`` is a tag or its type."""
    return OPERATIONS[rep].stored + tail(model)


def own_parameters(model: types.BaseNamedTuple) -> int:
    """How many parameters the motion's model has that is within a ``Moving`` one's type."""
    inner = model.types[0]
    if inner.instance_class is Body:
        return 9 + len(inner.types[1]) + count(inner.types[0])
    return count(inner)


def start(rep: Any, model: Any, q0: Any, w0: Any, b: Any, p: Any) -> Any:
    """The state of body b from its rows; one row of ``q0`` or ``w0`` stands for all bodies.

    A row of ``w0`` holds what the scene carries: angular velocity, velocity, position.
    """
    raise NotImplementedError(model)


def begin(rep: Any, model: Any, a: Any, y: Any, p: Any) -> Any:
    """The state at attitude a and with y beside it: angular velocity, velocity, position."""
    raise NotImplementedError(model)


def hand_out(rep: Any, model: Any, x: Any, p: Any, raw: Any) -> Any:
    """(attitude and angular velocity as the trajectory holds them, departure from the group).

    ``raw`` leaves the attitude as it is, else it is brought back to the group.
    """
    raise NotImplementedError(model)


def restored(rep: Any, model: Any, x: Any) -> Any:
    """(the state with its attitude nearer to the group, departure from it before)."""
    raise NotImplementedError(model)


def invariants(rep: Any, model: Any, x: Any, p: Any) -> Any:
    """(|m|², 2T), which a free body keeps; () of all else."""
    raise NotImplementedError(model)


def given(model: Any, t: Any, p: Any, like: Any) -> Any:
    """What ``field`` needs of the time t: the rate or, of a body, t itself."""
    raise NotImplementedError(model)


def field(rep: Any, model: Any, g: Any, x: Any, p: Any) -> Any:
    """Time derivative of the state x."""
    raise NotImplementedError(model)


def momentum_rate(rep: Any, model: Any, t: Any, a: Any, m: Any, p: Any) -> Any:
    """ṁ = m×w + τ at attitude a and momentum m."""
    raise NotImplementedError(model)


def base(rep: Any, model: Any, x: Any) -> Any:
    """The state without its low parts, as that of ``plain(rep)``."""
    raise NotImplementedError(model)


def advanced(rep: Any, model: Any, x: Any, d: Any) -> Any:
    """x + d, d a change of ``base``; what rounding loses is kept where x has room for it."""
    raise NotImplementedError(model)


def turning(rep: Any, model: Any, g: Any, xdot: Any, x: Any, p: Any) -> Any:
    """Square of the rate (rad/s) that limits an explicit step."""
    raise NotImplementedError(model)


def attitude_of(rep: Any, x: Any) -> Any:
    """The attitude's part of a body's state."""
    raise NotImplementedError(rep)


def momentum_of(rep: Any, x: Any) -> Any:
    """The momentum's part of a body's state, along principal axes, N·m·s, and its low part."""
    raise NotImplementedError(rep)


def torque_on(rep: Any, model: Any, t: Any, a: Any, w: Any, p: Any) -> Any:
    """Torque (N·m, principal axes) at attitude a and rate w."""
    raise NotImplementedError(model)


def kick(rep: Any, model: Any, t: Any, h: Any, a: Any, m: Any, p: Any) -> Any:
    """The momentum after h s of torque at a standstill, of linear damping exactly."""
    raise NotImplementedError(model)


def angular_velocity(m: Any, p: Any) -> Any:
    """w = I⁻¹ m, rad/s."""
    raise NotImplementedError


@hook(start)
def _start(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    q0: types.Array,
    w0: types.Array,
    b: types.Type,
    p: types.BaseTuple,
) -> Any:
    beside = (0.0,) * tail(model)
    return lambda rep, model, q0, w0, b, p: begin(
        rep, model, row_attitude(rep, q0, b), row_beside(w0, b, beside), p
    )


@hook(begin)
def _begin(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    a: types.BaseTuple,
    y: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    if model.instance_class is Moving:
        first = tail(model.types[0])
        return lambda rep, model, a, y, p: begin(rep, model.model, a, y[:first], p) + y[first:]
    if model.instance_class is InertialAxes:
        return lambda rep, model, a, y, p: flip(rep, a)
    if model.instance_class is not Body:
        return lambda rep, model, a, y, p: a

    def impl(rep, model, a, y, p):
        return a + carry(rep, rigid.momentum(y, p[3:6]))

    def impl_turned(rep, model, a, y, p):
        axes = p[9:13]
        # by the matrix, whose zeros are exact for a permutation of axes: a needle's spin that leaks
        # into the other axes would be multiplied by their moments
        w = dcm.rotate_inverse(dcm.from_quat(axes), y)
        return compose(rep, a, axes) + carry(rep, rigid.momentum(w, p[3:6]))

    return impl_turned if len(model.types[1]) else impl


@helper
def row_attitude(rep, q0, b):
    """The attitude of body b."""
    return initial(rep, q0, min(b, q0.shape[0] - 1))


@helper
def row_beside(w0, b, beside):
    """What body b carries beside it."""
    return unpack(w0[min(b, w0.shape[0] - 1)], beside)


@hook(hand_out)
def _hand_out(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    x: types.Type,
    p: types.Type,
    raw: types.Type,
) -> Any:
    if model.instance_class is Moving:
        n = carried(rep.instance_class, model.types[0])

        def impl_moving(rep, model, x, p, raw):
            y, d = hand_out(rep, model.model, x[:n], p, raw)
            return y + x[n:], d

        return impl_moving
    if model.instance_class is InertialAxes:
        return lambda rep, model, x, p, raw: finish(rep, flip(rep, x), raw)
    if model.instance_class is not Body:
        return lambda rep, model, x, p, raw: finish(rep, x, raw)
    turned = len(model.types[1]) > 0

    def impl(rep, model, x, p, raw):
        w = angular_velocity(momentum_of(rep, x), p)
        a, d = finish(rep, attitude_of(rep, x), raw)
        return a + w, d

    def impl_turned(rep, model, x, p, raw):
        axes = p[9:13]
        w = dcm.rotate(dcm.from_quat(axes), angular_velocity(momentum_of(rep, x), p))
        a, d = finish(rep, compose(rep, attitude_of(rep, x), quat.conj(axes)), raw)
        return a + w, d

    return impl_turned if turned else impl


@hook(restored)
def _restored(rep: types.BaseNamedTuple, model: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    n = OPERATIONS[rep.instance_class].size

    def impl(rep, model, x):
        a, d = restore(rep, x[:n])
        return a + x[n:], d

    return impl


@hook(invariants)
def _invariants(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    x: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    if model.instance_class is Moving:
        n = carried(rep.instance_class, model.types[0])
        return lambda rep, model, x, p: invariants(rep, model.model, x[:n], p)
    if model.instance_class is not Body or model.types[0].instance_class is not Free:
        return lambda rep, model, x, p: ()

    def impl(rep, model, x, p):
        m = momentum_of(rep, x)
        u = (m[0], m[1], m[2])
        return dot(u, u), dot(u, angular_velocity(m, p))

    return impl


@hook(given)
def _given(model: types.BaseNamedTuple, t: types.Type, p: types.BaseTuple, like: types.Type) -> Any:
    if model.instance_class is Body:
        return lambda model, t, p, like: type(like)(t)
    return lambda model, t, p, like: rate(model, t, p, like)


@hook(field)
def _field(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    g: types.Type,
    x: types.Type,
    p: types.BaseTuple,
) -> Any:
    if model.instance_class is not Body:
        return lambda rep, model, g, x, p: derivative(rep, x, g)

    def impl(rep, model, g, x, p):
        a = attitude_of(rep, x)
        m = momentum_of(rep, x)
        v = (p[0] * m[0], p[1] * m[1], p[2] * m[2])
        return half_derivative(rep, a, v) + momentum_rate(rep, model, g, a, m, p)

    return impl


@hook(momentum_rate)
def _momentum_rate(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    t: types.Type,
    a: types.BaseTuple,
    m: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    if model.types[0].instance_class is Free:
        return lambda rep, model, t, a, m, p: rigid.gyroscopic(m, p[6:9])
    return lambda rep, model, t, a, m, p: add(
        rigid.gyroscopic(m, p[6:9]), torque_on(rep, model, t, a, angular_velocity(m, p), p)
    )


@hook(base)
def _base(rep: types.BaseNamedTuple, model: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    if rep.instance_class not in COMPENSATED:
        return lambda rep, model, x: x
    if model.instance_class is not Body:
        return lambda rep, model, x: value(rep, x)
    return lambda rep, model, x: value(rep, attitude_of(rep, x)) + value(rep, momentum_of(rep, x))


@hook(advanced)
def _advanced(
    rep: types.BaseNamedTuple, model: types.BaseNamedTuple, x: types.BaseTuple, d: types.BaseTuple
) -> Any:
    if rep.instance_class not in COMPENSATED or model.instance_class is not Body:
        return lambda rep, model, x, d: gain(rep, x, d)
    return lambda rep, model, x, d: (
        gain(rep, attitude_of(rep, x), d[:4]) + gain_vector(rep, momentum_of(rep, x), d[4:])
    )


@hook(turning)
def _turning(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    g: types.Type,
    xdot: types.Type,
    x: types.Type,
    p: types.BaseTuple,
) -> Any:
    if model.instance_class is not Body:
        return lambda rep, model, g, xdot, x, p: speed_squared(rep, xdot, g)
    return lambda rep, model, g, xdot, x, p: speed_squared(
        rep, attitude_of(rep, xdot), angular_velocity(momentum_of(rep, x), p)
    )


@hook(attitude_of)
def _attitude_of(rep: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    n = OPERATIONS[rep.instance_class].size
    return lambda rep, x: x[:n]


@hook(momentum_of)
def _momentum_of(rep: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    n = OPERATIONS[rep.instance_class].size
    end = n + (6 if rep.instance_class in COMPENSATED else 3)
    return lambda rep, x: x[n:end]


@hook(angular_velocity)
def _angular_velocity(m: types.BaseTuple, p: types.BaseTuple) -> Any:
    return lambda m, p: (
        p[0] * m[0] + p[0] * m[0],
        p[1] * m[1] + p[1] * m[1],
        p[2] * m[2] + p[2] * m[2],
    )


@hook(torque_on)
def _torque_on(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    t: types.Type,
    a: types.BaseTuple,
    w: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    n = 9 + len(model.types[1])
    return lambda rep, model, t, a, w, p: torque(model.torque, rep, t, a, w, p[3:6], p[n:])


@hook(kick)
def _kick(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    t: types.Type,
    h: types.Type,
    a: types.BaseTuple,
    m: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    n = 9 + len(model.types[1])
    zero = (0.0, 0.0, 0.0)

    def impl(rep, model, t, h, a, m, p):
        F = type(h)
        still = (F(zero[0]), F(zero[1]), F(zero[2]))
        return axpy(h, torque_on(rep, model, F(t), a, still, p), m)

    def impl_damped(rep, model, t, h, a, m, p):
        F = type(h)
        still = (F(zero[0]), F(zero[1]), F(zero[2]))
        b = torque_on(rep, model, F(t), a, still, p)
        d = damping_rates(model.torque, p[3:6], p[n:])
        e1, f1 = rigid.exp_decay(d[0] * h)
        e2, f2 = rigid.exp_decay(d[1] * h)
        e3, f3 = rigid.exp_decay(d[2] * h)
        return e1 * m[0] + h * f1 * b[0], e2 * m[1] + h * f2 * b[1], e3 * m[2] + h * f3 * b[2]

    return impl_damped if _is_damped(model.types[0]) else impl


def _is_damped(tag: types.BaseNamedTuple) -> bool:
    if tag.instance_class is Sum:
        return any(_is_damped(term) for term in tag.types[0])
    return tag.instance_class in (Damping, AxisDamping)
