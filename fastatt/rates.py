"""Angular velocity as a function of time: built-in models and a user's own function.

A model is a ``NamedTuple`` of numbers, or of arrays with one row per body. Rates are in rad/s,
along body axes unless the scene says ``frame="inertial"``; times in s, angles in rad.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from fastatt._jit import hook, kernel
from fastatt.columns import axpy
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import add, neg
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

_VECTOR = Field((3,))


class Constant(NamedTuple):
    """w(t) = w. ``w``: (3,) or (N, 3)."""

    w: ArrayLike


class Polynomial(NamedTuple):
    """w(t) = Σ c_k t^k. ``coefficients``: (K, 3) or (N, K, 3), the constant term first."""

    coefficients: ArrayLike


class Sinusoidal(NamedTuple):
    """w(t) = bias + amplitude sin(frequency t + phase), axis by axis; each (3,) or (N, 3)."""

    bias: ArrayLike
    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = (0.0, 0.0, 0.0)


class Coning(NamedTuple):
    """The z axis sweeps a cone of half ``angle`` a at ``frequency`` Ω without turning round it.

    w = (−Ω sin a sin Ωt, Ω sin a cos Ωt, −2Ω sin²(a/2)), exact attitude
    q = (cos a/2, sin(a/2) cos Ωt, sin(a/2) sin Ωt, 0): Goodman and Robinson, ASME J. Appl. Mech.
    25 (1958) 210. Numbers or (N,).
    """

    angle: ArrayLike
    frequency: ArrayLike


class Precession(NamedTuple):
    """Rate of constant size whose transverse part turns in the body, as in a free symmetric top.

    w = (A cos(kt + φ0), A sin(kt + φ0), s). Numbers or (N,): ``transverse`` A, ``axial`` s,
    ``frequency`` k, ``phase`` φ0.
    """

    transverse: ArrayLike
    axial: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0


class Slew(NamedTuple):
    """Rest-to-rest turn by ``rotation`` (rad, (3,) or (N, 3)) in ``duration`` s from ``start`` on.

    w = rotation/T (1 − cos(2πs/T)) within the slew, 0 outside: rate and acceleration continuous.
    """

    rotation: ArrayLike
    duration: ArrayLike
    start: ArrayLike = 0.0


@kernel
def constant(t, p):
    """w = p."""
    return p


@kernel
def sinusoidal(t, p):
    """w_i = b_i + A_i sin(f_i t + φ_i); p = (b, A, f, φ)."""
    s0, _ = sincos(p[6] * t + p[9])
    s1, _ = sincos(p[7] * t + p[10])
    s2, _ = sincos(p[8] * t + p[11])
    return p[0] + p[3] * s0, p[1] + p[4] * s1, p[2] + p[5] * s2


@kernel
def coning(t, p):
    """Coning of half angle p[0] at p[1] rad/s."""
    F = type(p[0])
    s, c = sincos(p[1] * t)
    a, b = sincos(F(0.5) * p[0])
    k = F(2.0) * p[1] * a
    return -k * b * s, k * b * c, -k * a


@kernel
def precession(t, p):
    """(A cos(kt + φ0), A sin(kt + φ0), s); p = (A, s, k, φ0)."""
    s, c = sincos(p[2] * t + p[3])
    return p[0] * c, p[0] * s, p[1]


@kernel
def slew(t, p):
    """Versine rate profile; p = (rotation, T, start)."""
    F = type(p[0])
    x = (t - p[4]) / p[3]
    x = F(0.0) if x < F(0.0) else x
    x = F(1.0) if x > F(1.0) else x
    s, _ = sincos(F(3.141592653589793) * x)
    k = F(2.0) * s * s / p[3]
    return k * p[0], k * p[1], k * p[2]


# model class: its kernel and its fields
_MODELS: dict[type, tuple[Any, tuple[Field, ...]]] = {
    Constant: (constant, (_VECTOR,)),
    Polynomial: (None, (Field((-1, 3)),)),
    Sinusoidal: (sinusoidal, (_VECTOR,) * 4),
    Coning: (coning, (Field(),) * 2),
    Precession: (precession, (Field(),) * 4),
    Slew: (slew, (_VECTOR, Field(above_zero=True), Field())),
}
_CALL = "rate(t, p)"
_FUNCTIONS = UserFunctions("rate", _CALL, (types.float64,), 3, "rad/s")


class InertialAxes(NamedTuple):
    """Tag: the model's rates are along inertial axes; the flipped attitude turns at −w."""

    model: Model


def is_constant(tag: Any) -> bool:
    """Whether a tag's type, as the compiler sees it, is that of a rate which never changes."""
    cls = tag.instance_class
    return cls is Constant or (cls is InertialAxes and is_constant(tag.types[0]))


def bound(tag: Any, params: NDArray[np.float64], longest: float) -> NDArray[np.float64] | None:
    """No less than |w| (rad/s) of each body for |t| <= longest; None of a user's function.

    ``params`` are flat, (P,) or (N, P).
    """
    cls = type(tag)
    if cls is InertialAxes:
        return bound(tag.model, params, longest)
    p = np.atleast_2d(params)
    if cls is Sum:
        ends = np.cumsum([0, *(count(term) for term in tag.terms)])
        parts = [
            bound(term, p[:, a:b], longest)
            for term, a, b in zip(tag.terms, ends, ends[1:], strict=False)
        ]
        known = [part for part in parts if part is not None]
        return np.sum(known, axis=0) if len(known) == len(parts) else None
    return _BOUNDS[cls](p, longest) if cls in _BOUNDS else None


def lengths(v: NDArray[Any]) -> NDArray[np.float64]:
    """Of rows (N, 3); a matrix product, since numpy reduces short rows slowly."""
    return np.asarray(np.sqrt((v * v) @ np.ones(3)))


def _longest_polynomial(p: NDArray[np.float64], longest: float) -> Any:
    powers = np.float64(longest) ** np.arange(p.shape[1] // 3)
    return sum(lengths(p[:, 3 * k : 3 * k + 3]) * power for k, power in enumerate(powers))


# model class: what |w| of parameters (N, P) is not above for |t| <= T
_BOUNDS: dict[type, Callable[[NDArray[np.float64], float], Any]] = {
    Constant: lambda p, T: lengths(p),
    Polynomial: _longest_polynomial,
    Sinusoidal: lambda p, T: lengths(np.abs(p[:, :3]) + np.abs(p[:, 3:6])),
    Coning: lambda p, T: np.abs(2.0 * p[:, 1] * np.sin(0.5 * p[:, 0])),
    Precession: lambda p, T: np.hypot(p[:, 0], p[:, 1]),
    Slew: lambda p, T: 2.0 * lengths(p[:, :3]) / p[:, 3],
}


def horner(t: Any, p: Any) -> Any:
    """Σ p_k t^k with vector coefficients p, flat, the constant term first."""
    raise NotImplementedError


@hook(horner)
def _horner(t: types.Type, p: types.BaseTuple) -> Any:
    if len(p) == 3:
        return lambda t, p: p
    return lambda t, p: axpy(t, horner(t, p[3:]), p[:3])


def rate(model: Any, t: Any, p: Any, like: Any) -> Any:
    """w(t) of a model's tag with its flat parameters p, as three floats of the type of ``like``."""
    raise NotImplementedError


@hook(rate)
def _rate(model: types.BaseNamedTuple, t: types.Type, p: types.BaseTuple, like: types.Type) -> Any:
    def impl(model, t, p, like):
        F = type(like)
        w = evaluate(model, t, p)
        return F(w[0]), F(w[1]), F(w[2])

    return impl


def evaluate(model: Any, t: Any, p: Any) -> Any:
    """w(t) in the precision of t and p, in the axes of the flipped state."""
    raise NotImplementedError


@hook(evaluate)
def _evaluate(model: types.BaseNamedTuple, t: types.Type, p: types.BaseTuple) -> Any:
    cls = model.instance_class
    if cls is InertialAxes:
        return lambda model, t, p: neg(evaluate(model.model, t, p))
    if cls is Polynomial:
        return lambda model, t, p: horner(t, p)
    if cls is Sum:
        sizes = [count(ty) for ty in model.types[0]]
        return (
            _sum_of(sizes[0])
            if len(sizes) > 1
            else lambda model, t, p: evaluate(model.terms[0], t, p)
        )
    function = _MODELS[cls][0] if cls in _MODELS else _FUNCTIONS[cls]
    return lambda model, t, p: function(t, p)


def _sum_of(first: int) -> Any:
    return lambda model, t, p: add(
        evaluate(model.terms[0], t, p[:first]), evaluate(Sum(model.terms[1:]), t, p[first:])
    )


def pack(model: Model, n_bodies: int | None, argument: str = "rate") -> Packed:
    """Check a model's numbers and lay them out flat.

    Raises ``TypeError`` for something that is no model, ``ValueError`` for numbers that are not
    finite or of the wrong shape.
    """
    if type(model) is Sum:
        return pack_sum(model, pack, n_bodies, argument)
    if type(model) not in _MODELS:
        raise no_model(model, argument, "rates", (*_MODELS, Sum), _CALL)
    return pack_fields(model, _MODELS[type(model)][1], n_bodies, argument)


def pack_user(
    function: Callable[..., Any], params: ArrayLike | None, n_bodies: int | None
) -> Packed:
    """The same for a user's function and its parameters, (P,) shared or (N, P)."""
    joined = join([params_of(params)], n_bodies, "params")
    return Packed(_FUNCTIONS.tag(function, joined.shape[-1]), joined, False)


__all__ = [
    "Coning",
    "Constant",
    "Polynomial",
    "Precession",
    "Sinusoidal",
    "Slew",
    "Sum",
]
