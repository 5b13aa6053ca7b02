"""External torque: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Torques are in N·m along
body axes; fields and weights that are fixed in space are given along inertial axes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import hook
from fastatt.kernels import quat, rigid
from fastatt.kernels.vec3 import add, cross, dot
from fastatt.models import (
    Field,
    Model,
    Packed,
    Sum,
    UserFunctions,
    count,
    join,
    no_model,
    pack_fields,
    pack_sum,
    params_of,
)
from fastatt.representations import QUAT, attitude, to_body


class Free(NamedTuple):
    """No torque."""


class Constant(NamedTuple):
    """A torque fixed in the body, such as a thruster's. ``torque``: (3,) or (N, 3), N·m."""

    torque: ArrayLike


class ConstantInertial(NamedTuple):
    """A torque fixed in space. ``torque``: (3,) or (N, 3), N·m, inertial axes."""

    torque: ArrayLike


class Damping(NamedTuple):
    """Linear damping τ = −c w. ``coefficient`` c: a number or (N,), N·m·s."""

    coefficient: ArrayLike


class AxisDamping(NamedTuple):
    """Linear damping, a coefficient an axis: τ_i = −c_i w_i. (3,) or (N, 3), N·m·s."""

    coefficients: ArrayLike


class QuadraticDamping(NamedTuple):
    """Quadratic damping τ = −c |w| w. ``coefficient`` c: a number or (N,), N·m·s²."""

    coefficient: ArrayLike


class GravityGradient(NamedTuple):
    """τ = 3 n² o×(I o) in a circular orbit of mean motion n, o the direction out from the planet.

    At t = 0 o lies along ``radial``, a quarter of an orbit later along ``along``, both inertial
    unit vectors. Numbers or a row per body; rad/s. Hughes, *Spacecraft Attitude Dynamics* (1986),
    §8.1.
    """

    mean_motion: ArrayLike
    radial: ArrayLike = (1.0, 0.0, 0.0)
    along: ArrayLike = (0.0, 1.0, 0.0)


class HeavyTop(NamedTuple):
    """A weight off the fixed point: τ = r × Cᵀ(0, 0, −W).

    ``arm`` r: (3,) or (N, 3), from the fixed point to the centre of mass, m, body axes; ``weight``
    W: N, along −z of inertial axes. Inertia is that about the fixed point.
    """

    arm: ArrayLike
    weight: ArrayLike


class MagneticDipole(NamedTuple):
    """τ = μ × CᵀB. ``dipole`` μ: A·m², body axes; ``field`` B: T, inertial axes; (3,) or (N, 3)."""

    dipole: ArrayLike
    field: ArrayLike


class QuaternionPD(NamedTuple):
    """Attitude controller τ = −k sgn(e0) (e1, e2, e3) − c w with e = target*∘q.

    ``stiffness`` k, N·m, ``damping`` c, N·m·s: numbers or (N,); ``target``: (4,) or (N, 4), unit.
    Wie, *Space Vehicle Dynamics and Control* (2008), §7.3.
    """

    stiffness: ArrayLike
    damping: ArrayLike
    target: ArrayLike = (1.0, 0.0, 0.0, 0.0)


class Rotor(NamedTuple):
    """Wheels of constant momentum h in the body (gyrostat): τ = h×w.

    ``momentum``: (3,) or (N, 3), N·m·s, body axes. ``inertia`` is the whole body's, wheels held.
    Hughes (1986), §6.1.
    """

    momentum: ArrayLike


class Sampled(NamedTuple):
    """A history of torques along body axes, linear between samples and held outside them.

    ``torques``: (n, 3), N·m, at times start, start + dt, …; one history for all bodies. A step of
    a whole fraction of ``dt`` keeps the order of a method: the history has a kink at each sample.
    """

    torques: ArrayLike
    dt: float
    start: float = 0.0


class Custom(NamedTuple):
    """A user's ``@njit`` function ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m along body axes.

    t in s, q and w as tuples, p the tuple of ``params``, (P,) or (N, P). ``uses_rate=False``
    promises that w is not used, which opens the splitting methods; ``potential(t, q, p)``, J, an
    ``@njit`` function too, is what ``drift`` takes the energy from.
    """

    function: Callable[..., Any]
    params: ArrayLike | None = None
    uses_rate: bool = True
    potential: Callable[..., Any] | None = None


class UserTorque(NamedTuple):
    """Tag of a ``Custom`` torque: its function's and, or ``Free``, its potential's."""

    function: Any
    potential: Any


class UserPositionTorque(NamedTuple):
    """The same of a torque that promises not to use w."""

    function: Any
    potential: Any


class Table(NamedTuple):
    """Tag of a ``Sampled`` torque; the samples travel in it, start and interval are parameters."""

    samples: Any
    start: float
    dt: float


class Turned(NamedTuple):
    """Tag of a torque along body axes, seen from principal axes that lie elsewhere.

    The first four parameters are the quaternion p with v_body = p∘v_principal∘p*.
    """

    axes: Any
    torque: Any


_VECTOR = Field((3,))
_NUMBER = Field()
# model class: its fields
_MODELS: dict[type, tuple[Field, ...]] = {
    Free: (),
    Constant: (_VECTOR,),
    ConstantInertial: (_VECTOR,),
    Damping: (_NUMBER,),
    AxisDamping: (_VECTOR,),
    QuadraticDamping: (_NUMBER,),
    GravityGradient: (_NUMBER, _VECTOR, _VECTOR),
    HeavyTop: (_VECTOR, _NUMBER),
    MagneticDipole: (_VECTOR, _VECTOR),
    QuaternionPD: (_NUMBER, _NUMBER, Field((4,))),
    Rotor: (_VECTOR,),
}
_CALL = "torque(t, q, w, p)"
_F8 = types.float64
_QUATERNION, _TRIPLE = types.UniTuple(_F8, 4), types.UniTuple(_F8, 3)
_FUNCTIONS = UserFunctions("torque", _CALL, (_F8, _QUATERNION, _TRIPLE), 3, "N·m")
_POTENTIALS = UserFunctions("potential", "potential(t, q, p)", (_F8, _QUATERNION), 1, "J")
POSITION, DAMPED, RATE = 0, 1, 2
_RATE_DEPENDENT = (QuadraticDamping, QuaternionPD, Rotor, UserTorque)
_CUSTOM = (UserTorque, UserPositionTorque)
# the same along all axes, or given along principal ones
_AXIS_FREE = (Free, ConstantInertial, Damping, QuadraticDamping, GravityGradient)


def torque(model: Any, rep: Any, t: Any, x: Any, w: Any, inertia: Any, p: Any) -> Any:
    """Torque (N·m) of a model's tag in the frame of x and w; p are its flat parameters."""
    raise NotImplementedError(model)


def damping_rates(model: Any, inertia: Any, p: Any) -> Any:
    """c_i/I_i, 1/s, of the linear damping among the terms of a model."""
    raise NotImplementedError(model)


def potential(model: Any, rep: Any, t: Any, x: Any, inertia: Any, p: Any) -> Any:
    """Potential energy (J) of a model's tag; 0 for one that does no work."""
    raise NotImplementedError(model)


@hook(torque)
def _torque(
    model: types.BaseNamedTuple,
    rep: types.Type,
    t: types.Type,
    x: types.Type,
    w: types.Type,
    inertia: types.Type,
    p: types.BaseTuple,
) -> Any:
    cls = model.instance_class
    if cls is Sum:
        return _torque_of_sum(model.types[0])
    if cls in _CUSTOM:
        return _torque_of_user(_FUNCTIONS[model.types[0].instance_class])
    return _TORQUES[cls]


def _torque_of_sum(terms: types.BaseTuple) -> Any:
    if len(terms) == 1:
        return lambda model, rep, t, x, w, inertia, p: torque(
            model.terms[0], rep, t, x, w, inertia, p
        )
    n = count(terms[0])
    return lambda model, rep, t, x, w, inertia, p: add(
        torque(model.terms[0], rep, t, x, w, inertia, p[:n]),
        torque(Sum(model.terms[1:]), rep, t, x, w, inertia, p[n:]),
    )


def _torque_of_user(function: Any) -> Any:
    def impl(model, rep, t, x, w, inertia, p):
        F = type(w[0])
        a = function(t, attitude(rep, x), w, p)
        return F(a[0]), F(a[1]), F(a[2])

    return impl


def _turned(model, rep, t, x, w, inertia, p):
    axes = p[:4]
    q = quat.mul(attitude(rep, x), quat.conj(axes))
    a = torque(model.torque, QUAT, t, q, quat.rotate(axes, w), inertia, p[4:])
    return quat.rotate_inverse(axes, a)


def _free(model, rep, t, x, w, inertia, p):
    F = type(w[0])
    return F(0.0), F(0.0), F(0.0)


def _gravity_gradient(model, rep, t, x, w, inertia, p):
    o = to_body(rep, x, rigid.orbit_direction(t, p[0], p[1:4], p[4:7]))
    return rigid.gravity_gradient(o, inertia, p[0])


def _heavy_top(model, rep, t, x, w, inertia, p):
    F = type(p[3])
    return cross(p[:3], to_body(rep, x, (F(0.0), F(0.0), -p[3])))


def _sampled(model, rep, t, x, w, inertia, p):
    F = type(w[0])
    last = model.samples.shape[0] - 1
    s = (t - p[0]) / p[1]
    s = min(max(s, F(0.0)), F(last))
    k = min(int(s), last - 1)
    f = s - F(k)
    a = model.samples[k]
    b = model.samples[k + 1]
    return a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])


_TORQUES: dict[type, Any] = {
    Free: _free,
    Turned: _turned,
    Table: _sampled,
    Constant: lambda model, rep, t, x, w, inertia, p: p,
    ConstantInertial: lambda model, rep, t, x, w, inertia, p: to_body(rep, x, p),
    Damping: lambda model, rep, t, x, w, inertia, p: rigid.damping(w, (p[0], p[0], p[0])),
    AxisDamping: lambda model, rep, t, x, w, inertia, p: rigid.damping(w, p),
    QuadraticDamping: lambda model, rep, t, x, w, inertia, p: rigid.quadratic_damping(w, p[0]),
    GravityGradient: _gravity_gradient,
    HeavyTop: _heavy_top,
    MagneticDipole: lambda model, rep, t, x, w, inertia, p: cross(p[:3], to_body(rep, x, p[3:])),
    QuaternionPD: lambda model, rep, t, x, w, inertia, p: rigid.quaternion_feedback(
        rigid.target_error(p[2:], attitude(rep, x)), w, p[0], p[1]
    ),
    Rotor: lambda model, rep, t, x, w, inertia, p: cross(p, w),
}


@hook(damping_rates)
def _damping_rates(
    model: types.BaseNamedTuple, inertia: types.BaseTuple, p: types.BaseTuple
) -> Any:
    cls = model.instance_class
    if cls is Sum and len(model.types[0]) > 1:
        n = count(model.types[0][0])
        return lambda model, inertia, p: add(
            damping_rates(model.terms[0], inertia, p[:n]),
            damping_rates(Sum(model.terms[1:]), inertia, p[n:]),
        )
    if cls is Sum:
        return lambda model, inertia, p: damping_rates(model.terms[0], inertia, p)
    if cls is Damping:
        return lambda model, inertia, p: (p[0] / inertia[0], p[0] / inertia[1], p[0] / inertia[2])
    if cls is AxisDamping:
        return lambda model, inertia, p: (p[0] / inertia[0], p[1] / inertia[1], p[2] / inertia[2])

    def impl(model, inertia, p):
        F = type(inertia[0])
        return F(0.0), F(0.0), F(0.0)

    return impl


@hook(potential)
def _potential(
    model: types.BaseNamedTuple,
    rep: types.Type,
    t: types.Type,
    x: types.Type,
    inertia: types.Type,
    p: types.BaseTuple,
) -> Any:
    cls = model.instance_class
    if cls is Sum and len(model.types[0]) > 1:
        n = count(model.types[0][0])
        return lambda model, rep, t, x, inertia, p: (
            potential(model.terms[0], rep, t, x, inertia, p[:n])
            + potential(Sum(model.terms[1:]), rep, t, x, inertia, p[n:])
        )
    if cls is Sum:
        return lambda model, rep, t, x, inertia, p: potential(model.terms[0], rep, t, x, inertia, p)
    if cls in _CUSTOM and model.types[1].instance_class is not Free:
        function = _POTENTIALS[model.types[1].instance_class]
        return lambda model, rep, t, x, inertia, p: function(t, attitude(rep, x), p)
    return _POTENTIAL_KERNELS[cls]


def _potential_turned(model, rep, t, x, inertia, p):
    q = quat.mul(attitude(rep, x), quat.conj(p[:4]))
    return potential(model.torque, QUAT, t, q, inertia, p[4:])


def _no_potential(model, rep, t, x, inertia, p):
    return type(inertia[0])(0.0)


def _potential_of_weight(model, rep, t, x, inertia, p):
    F = type(p[3])
    return p[3] * dot(p[:3], to_body(rep, x, (F(0.0), F(0.0), F(1.0))))


_POTENTIAL_KERNELS: dict[type, Any] = {
    Free: _no_potential,
    Rotor: _no_potential,
    Turned: _potential_turned,
    HeavyTop: _potential_of_weight,
    MagneticDipole: lambda model, rep, t, x, inertia, p: -dot(p[:3], to_body(rep, x, p[3:])),
}


def fastest_decay(model: Any, moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest c/I of the linear damping in a model, 1/s, of each body or of all: an upper bound."""
    least = moments.min(axis=-1)
    if isinstance(model, Sum):
        return sum((fastest_decay(term, moments) for term in model.terms), np.zeros(()))
    if isinstance(model, Damping):
        return np.asarray(np.abs(model.coefficient) / least)
    if isinstance(model, AxisDamping):
        return np.asarray(np.abs(np.asarray(model.coefficients)).max(axis=-1) / least)
    if isinstance(model, QuaternionPD):
        return np.asarray(np.abs(model.damping) / least)
    return np.zeros(())


def has_potential(tag: Any) -> bool:
    """Whether kinetic plus potential energy stays constant under a torque's tag."""
    if type(tag) is Sum:
        return all(has_potential(term) for term in tag.terms)
    if type(tag) is Turned:
        return has_potential(tag.torque)
    if type(tag) in _CUSTOM:
        return type(tag.potential) is not Free
    return type(tag) in _POTENTIAL_KERNELS


def dependence(tag: Any, *, turned: bool = False) -> int:
    """How a torque's tag depends on w: ``POSITION`` not, ``DAMPED`` along principal axes, ``RATE``.

    ``DAMPED`` is linear damping, whose flow is known; axis by axis only where the principal axes
    are the body's, not ``turned``.
    """
    if type(tag) is Sum:
        return max(dependence(term, turned=turned) for term in tag.terms)
    if type(tag) is Turned:
        return dependence(tag.torque, turned=True)
    if type(tag) is Damping or (type(tag) is AxisDamping and not turned):
        return DAMPED
    return RATE if type(tag) in (*_RATE_DEPENDENT, AxisDamping) else POSITION


def pack(
    model: Model,
    n_bodies: int | None,
    axes: NDArray[np.float64] | None = None,
    argument: str = "torque",
) -> Packed:
    """Check a model's numbers and lay them out flat, for principal axes that lie at ``axes``.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    cls = type(model)
    if cls is Sum:
        return pack_sum(model, lambda term, n, name: pack(term, n, axes, name), n_bodies, argument)
    if cls is Custom:
        packed = _pack_custom(model, n_bodies)
    elif cls is Sampled:
        packed = _pack_sampled(model, argument)
    elif cls in _MODELS:
        packed = pack_fields(model, _MODELS[cls], n_bodies, argument)
    else:
        known = {*_MODELS, Custom, Sampled, Sum} - {Free}
        raise no_model(model, argument, "torques", known, _CALL)
    if axes is None or cls in _AXIS_FREE:
        return packed
    params = join([axes, packed.params], n_bodies, argument)
    return packed._replace(tag=Turned((0.0,) * 4, packed.tag), params=params)


def _pack_custom(model: Custom, n_bodies: int | None) -> Packed:
    params = join([params_of(model.params)], n_bodies, "params")
    tag = _FUNCTIONS.tag(model.function, params.shape[-1])
    energy: Any = Free()
    if model.potential is not None:
        energy = _POTENTIALS.tag(model.potential, params.shape[-1])._replace(p=())
    made = UserTorque if model.uses_rate else UserPositionTorque
    return Packed(made(tag, energy), params, False)


def _pack_sampled(model: Sampled, argument: str) -> Packed:
    samples = checks.array(f"{argument}: Sampled.torques", model.torques, "(n, 3)", [(-1, 3)])
    if len(samples) < 2:
        raise ValueError(f"{argument}: Sampled.torques has 1 sample; accepted: at least 2")
    dt = checks.real(f"{argument}: Sampled.dt", model.dt)
    if dt <= 0.0:
        raise ValueError(f"{argument}: Sampled.dt is {dt}; accepted: above 0")
    start = checks.real(f"{argument}: Sampled.start", model.start)
    table = np.ascontiguousarray(samples, dtype=np.float64)
    return Packed(Table(table, 0.0, 0.0), np.array([start, dt]), True)


__all__ = [
    "AxisDamping",
    "Constant",
    "ConstantInertial",
    "Custom",
    "Damping",
    "GravityGradient",
    "HeavyTop",
    "MagneticDipole",
    "QuadraticDamping",
    "QuaternionPD",
    "Rotor",
    "Sampled",
    "Sum",
]
