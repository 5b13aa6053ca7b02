"""Derivatives of the step that a method takes: of the attitude's error, of a body's, to parameters.

The step itself is compiled for dual numbers (``fastatt.dual``), so that every method, model and
user's function has its derivatives from its own formula, exact but for rounding.

The error of an attitude is a rotation in body axes, C_true = C exp [δθ]; that of a body's angular
momentum δm (N·m·s, body axes; I⁻¹ δm is that of the rate).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from numba import types

from fastatt._jit import helper, hook
from fastatt.dual import constant, derivatives, seed, value
from fastatt.kernels import dcm, quat, rigid
from fastatt.kernels.vec3 import neg
from fastatt.methods.sampled import WINDOWS, Rates
from fastatt.models import count
from fastatt.motion import angular_velocity
from fastatt.representations import QUAT, compose
from fastatt.steps import whole_step
from fastatt.torques import Sum, Table, Turned


@helper
def error(q):
    """δθ of a dual quaternion about its own value, (3,) dual: its derivatives are what counts."""
    F = type(q[0])
    v = (value(q[0]), value(q[1]), value(q[2]), value(q[3]))
    r = quat.mul(quat.conj(v), q)
    k = F(2.0) / quat.dot(v, v)
    return k * r[1], k * r[2], k * r[3]


@helper
def displaced(q, d):
    """q∘exp(d) for a dual d of value 0."""
    F = type(d[0])
    half = F(0.5)
    return quat.mul(q, (F(1.0), half * d[0], half * d[1], half * d[2]))


@helper
def values(x):
    """Values of four numbers, dual or plain."""
    return value(x[0]), value(x[1]), value(x[2]), value(x[3])


# a given rate


@helper
def rate_tangent(method, model, t, h, b, p):
    """(turn of a step of h s, Φ11, Φ12): quaternion and matrices, row by row.

    ``model`` is a sum of ``rates.Constant`` and the gyro's rate, of parameters p: the rate is that
    less the bias b.
    """
    s = seed(b, 3, 0, -1)
    like = s[0]
    F = type(h)
    o = constant(F(0.0), like)
    start = (constant(F(1.0), like), o, o, o)
    x, _ = whole_step(method, QUAT, QUAT, model, (), 0.0, t, constant(h, like), start, neg(s) + p)
    return _coupled(x, like)


@helper
def _coupled(x, like):
    """The same of a dual quaternion that the bias moves."""
    q = quat.normalise(values(x))
    e = error(x)
    rows = (
        derivatives(constant(e[0], like))
        + derivatives(constant(e[1], like))
        + derivatives(constant(e[2], like))
    )
    return q, dcm.transpose(dcm.from_quat(q)), rows


# samples


def unbiased(v: Any, b: Any, weights: Any) -> Any:
    """Flat samples less the bias b times their weights."""
    raise NotImplementedError


@hook(unbiased)
def _unbiased(v: types.BaseTuple, b: types.BaseTuple, weights: types.BaseTuple) -> Any:
    if not len(v):
        return lambda v, b, weights: ()
    return lambda v, b, weights: (
        v[0] - b[0] * weights[0],
        v[1] - b[1] * weights[0],
        v[2] - b[2] * weights[0],
        *unbiased(v[3:], b, weights[1:]),
    )


def intervals(before: Any, d: Any, like: Any) -> Any:
    """(turn, Φ11, Φ12) of each interval, from the flat dual attitudes at their ends."""
    raise NotImplementedError


@hook(intervals)
def _intervals(before: types.BaseTuple, d: types.BaseTuple, like: types.Type) -> Any:
    if not len(d):
        return lambda before, d, like: ()

    def impl(before, d, like):
        now = d[:4]
        return (_coupled(quat.mul(quat.conj(before), now), like), *intervals(now, d[4:], like))

    return impl


def window_tangent(method: Any, kind: Any, v: Any, h: Any) -> Any:
    """(turn, Φ11, Φ12) of each interval of a window of flat samples v over the intervals h."""
    raise NotImplementedError(method)


@hook(window_tangent)
def _window_tangent(
    method: types.BaseNamedTuple,
    kind: types.BaseNamedTuple,
    v: types.BaseTuple,
    h: types.BaseTuple,
) -> Any:
    window = WINDOWS[method.instance_class]
    of_rates = kind.instance_class is Rates
    turns: Any = window.rates if of_rates else window.increments
    ones = (1.0,) * (len(v) // 3)

    def impl(method, kind, v, h):
        F = type(h[0])
        b = seed((F(0.0), F(0.0), F(0.0)), 3, 0, -1)
        weights = ones if of_rates else h
        d = turns(QUAT, unbiased(v, b, weights), h)
        unit = (F(1.0), F(0.0), F(0.0), F(0.0))
        return intervals(unit, d, b[0])

    return impl


# rigid bodies


class StateOnly(NamedTuple):
    """Tag: derivatives to (δθ, δm), six directions."""


class WithParameters(NamedTuple):
    """Tag: those, and to the principal moments and the torque's numbers."""


def own_numbers(torque: Any) -> list[bool]:
    """Which of a torque's flat parameters are its model's; ``torque`` is a tag or its type.

    The others say where principal axes lie, and when samples were taken.
    """
    of_type = isinstance(torque, types.Type)
    cls, fields = (torque.instance_class, torque.types) if of_type else (type(torque), torque)
    if cls is Sum:
        return [own for term in fields[0] for own in own_numbers(term)]
    if cls is Turned:
        return [False] * 4 + own_numbers(fields[1])
    return [cls is not Table] * count(torque)


def directions(wanted: type, model: Any) -> int:
    """How many derivatives each number has; ``model`` is a tag's type."""
    return 6 if wanted is StateOnly else 9 + sum(own_numbers(model.types[0]))


def differentiated(wanted: Any, model: Any, p: Any) -> Any:
    """A body's parameters, dual where derivatives to them are wanted."""
    raise NotImplementedError(wanted)


@hook(differentiated)
def _differentiated(
    wanted: types.BaseNamedTuple, model: types.BaseNamedTuple, p: types.BaseTuple
) -> Any:
    if wanted.instance_class is StateOnly:
        return lambda wanted, model, p: p
    size = directions(wanted.instance_class, model)
    end = 9 + len(model.types[1])
    mask = sum(1 << k for k, own in enumerate(own_numbers(model.types[0])) if own)

    @helper
    def body(p):
        F = type(p[0])
        i = seed(p[3:6], size, 6, -1)
        half = (F(0.5) / i[0], F(0.5) / i[1], F(0.5) / i[2])
        return half + i + rigid.gyroscopic_coefficients(i) + p[9:end]

    if len(p) == end:
        return lambda wanted, model, p: body(p)
    return lambda wanted, model, p: body(p) + seed(p[end:], size, 9, mask)


def along_principal(model: Any, q: Any, m: Any, p: Any) -> Any:
    """(attitude of the principal axes, momentum along them), from those of the body axes."""
    raise NotImplementedError(model)


def along_body(model: Any, x: Any, p: Any) -> Any:
    """The inverse, of a state x."""
    raise NotImplementedError(model)


@hook(along_principal)
def _along_principal(
    model: types.BaseNamedTuple, q: types.BaseTuple, m: types.BaseTuple, p: types.BaseTuple
) -> Any:
    if not len(model.types[1]):
        return lambda model, q, m, p: q + m
    return lambda model, q, m, p: compose(QUAT, q, p[9:13]) + quat.rotate_inverse(p[9:13], m)


@hook(along_body)
def _along_body(model: types.BaseNamedTuple, x: types.BaseTuple, p: types.BaseTuple) -> Any:
    if not len(model.types[1]):
        return lambda model, x, p: (x[:4], x[4:7])
    return lambda model, x, p: (
        compose(QUAT, x[:4], quat.conj(p[9:13])),
        quat.rotate(p[9:13], x[4:7]),
    )


def momentum_of_rate(model: Any, w: Any, p: Any) -> Any:
    """m = I w along body axes."""
    raise NotImplementedError(model)


def rate_of_momentum(model: Any, m: Any, p: Any) -> Any:
    """w = I⁻¹ m along body axes."""
    raise NotImplementedError(model)


@hook(momentum_of_rate)
def _momentum_of_rate(model: types.BaseNamedTuple, w: types.Type, p: types.BaseTuple) -> Any:
    if not len(model.types[1]):
        return lambda model, w, p: rigid.momentum(w, p[3:6])
    return lambda model, w, p: quat.rotate(
        p[9:13], rigid.momentum(quat.rotate_inverse(p[9:13], w), p[3:6])
    )


@hook(rate_of_momentum)
def _rate_of_momentum(model: types.BaseNamedTuple, m: types.Type, p: types.BaseTuple) -> Any:
    if not len(model.types[1]):
        return lambda model, m, p: angular_velocity(m, p)
    return lambda model, m, p: quat.rotate(
        p[9:13], angular_velocity(quat.rotate_inverse(p[9:13], m), p)
    )


def body_tangent(
    wanted: Any, method: Any, model: Any, stages: Any, edge: Any, t: Any, h: Any, q: Any, m: Any,
    p: Any,
) -> Any:  # fmt: skip
    """(q, m, Φ, z) after a step of h s: Φ flat, row by row, 6 rows; z the squared turn.

    Columns are δθ, δm and, ``WithParameters``, the principal moments and the torque's numbers.
    """
    raise NotImplementedError(wanted)


@hook(body_tangent)
def _body_tangent(
    wanted: types.BaseNamedTuple, method: types.Type, model: types.BaseNamedTuple,
    stages: types.Type, edge: types.Type, t: types.Type, h: types.Type, q: types.BaseTuple,
    m: types.BaseTuple, p: types.BaseTuple,
) -> Any:  # fmt: skip
    size = directions(wanted.instance_class, model)

    def impl(wanted, method, model, stages, edge, t, h, q, m, p):
        F = type(m[0])
        d = seed((F(0.0), F(0.0), F(0.0)), size, 0, -1)
        like = d[0]
        pd = differentiated(wanted, model, p)
        x = along_principal(model, displaced(q, d), seed(m, size, 3, -1), pd)
        x, z = whole_step(method, QUAT, QUAT, model, stages, edge, t, h, x, pd)
        q1, m1 = along_body(model, x, pd)
        e = error(q1)
        phi = (
            derivatives(constant(e[0], like))
            + derivatives(constant(e[1], like))
            + derivatives(constant(e[2], like))
            + derivatives(constant(m1[0], like))
            + derivatives(constant(m1[1], like))
            + derivatives(constant(m1[2], like))
        )
        end = (value(m1[0]), value(m1[1]), value(m1[2]))
        return quat.normalise(values(q1)), end, phi, value(z)

    return impl
