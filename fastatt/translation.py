"""One step of a scene, with the velocity and the position that it may carry along."""

from __future__ import annotations

from typing import Any

from numba import types

from fastatt._jit import helper, hook
from fastatt.forces import force
from fastatt.kernels import newton, quat
from fastatt.kernels.vec3 import add, axpy
from fastatt.methods.method import step
from fastatt.motion import (
    Body,
    Moving,
    angular_velocity,
    attitude_of,
    carried,
    momentum_of,
    own_parameters,
)
from fastatt.rates import InertialAxes, rate
from fastatt.representations import attitude, flip


def full_step(
    method: Any, rep: Any, model: Any, t: Any, h: Any, k: Any, x: Any, p: Any, e: Any
) -> Any:
    """``step`` of all that the scene carries."""
    raise NotImplementedError(model)


def pose(rep: Any, model: Any, t: Any, x: Any, p: Any) -> Any:
    """(q, w): the attitude and the angular velocity of the body axes."""
    raise NotImplementedError(model)


@hook(pose)
def _pose(
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    t: types.Type,
    x: types.BaseTuple,
    p: types.BaseTuple,
) -> Any:
    if model.instance_class is InertialAxes:

        def inertial(rep, model, t, x, p):
            w = rate(model, t, p, x[0])
            q = attitude(rep, flip(rep, x))
            return q, quat.rotate_inverse(q, (-w[0], -w[1], -w[2]))

        return inertial
    if model.instance_class is not Body:
        return lambda rep, model, t, x, p: (attitude(rep, x), rate(model, t, p, x[0]))

    def body(rep, model, t, x, p):
        return attitude(rep, attitude_of(rep, x)), angular_velocity(momentum_of(rep, x), p)

    def turned_body(rep, model, t, x, p):
        axes = p[9:13]
        q = quat.mul(attitude(rep, attitude_of(rep, x)), quat.conj(axes))
        return q, quat.rotate(axes, angular_velocity(momentum_of(rep, x), p))

    return turned_body if len(model.types[1]) else body


@helper
def translate(model, t, h, q0, w0, q1, w1, v, p):
    """(velocity at the end, what the body moved), along the axes of the start and of space."""
    F = type(h)
    t = F(t)
    half = F(0.5) * h
    inverse_mass = p[0]
    q0 = quat.renormalise(q0)
    q1 = quat.renormalise(q1)
    u = quat.log(quat.mul(quat.conj(q0), q1))
    turn, wm = newton.middle(u, h, w0, w1)
    em = quat.exp(turn)
    e1 = quat.exp(u)
    qm = quat.mul(q0, em)
    f1 = force(model, t, q0, w0, v, p[1:])
    k1 = (inverse_mass * f1[0], inverse_mass * f1[1], inverse_mass * f1[2])
    v2 = quat.rotate_inverse(em, axpy(half, k1, v))
    f2 = force(model, t + half, qm, wm, v2, p[1:])
    k2 = quat.rotate(em, (inverse_mass * f2[0], inverse_mass * f2[1], inverse_mass * f2[2]))
    v3 = quat.rotate_inverse(em, axpy(half, k2, v))
    f3 = force(model, t + half, qm, wm, v3, p[1:])
    f = (inverse_mass * f3[0], inverse_mass * f3[1], inverse_mass * f3[2])
    k3 = quat.rotate(em, f)
    v4 = quat.rotate_inverse(e1, axpy(h, k3, v))
    f4 = force(model, t + h, q1, w1, v4, p[1:])
    k4 = quat.rotate(e1, (inverse_mass * f4[0], inverse_mass * f4[1], inverse_mass * f4[2]))
    end = quat.rotate_inverse(e1, newton.velocity(h, u, v, k1, k2, k3, k4, f))
    return end, quat.rotate(q0, newton.displacement(h, u, v, k1, k2, k3, f))


@hook(full_step)
def _full_step(
    method: types.Type,
    rep: types.BaseNamedTuple,
    model: types.BaseNamedTuple,
    t: types.Type,
    h: types.Type,
    k: types.Type,
    x: types.BaseTuple,
    p: types.BaseTuple,
    e: types.Type,
) -> Any:
    if model.instance_class is not Moving:
        return lambda method, rep, model, t, h, k, x, p, e: step(
            method, rep, model, t, h, k, x, p, e
        )
    n = carried(rep.instance_class, model.types[0])
    m = own_parameters(model)
    end = n + 3

    def moved(method, rep, model, t, h, k, x, p, e):
        y, z = step(method, rep, model.model, t, h, k, x[:n], p[:m], e)
        q0, w0 = pose(rep, model.model, t, x[:n], p[:m])
        q1, w1 = pose(rep, model.model, t + h, y, p[:m])
        v, _ = translate(model.force, t, h, q0, w0, q1, w1, x[n:end], p[m:])
        return y + v, z

    def moved_with_position(method, rep, model, t, h, k, x, p, e):
        y, z = step(method, rep, model.model, t, h, k, x[:n], p[:m], e)
        q0, w0 = pose(rep, model.model, t, x[:n], p[:m])
        q1, w1 = pose(rep, model.model, t + h, y, p[:m])
        v, d = translate(model.force, t, h, q0, w0, q1, w1, x[n:end], p[m:])
        return y + v + add(x[end:], d), z

    return moved_with_position if len(model.types[2]) else moved
