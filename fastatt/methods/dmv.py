"""DMV: the discrete Moser-Veselov step with modified inertia, to orders 2 to 10, for free bodies.

What is stepped is not m but u = h m/(2K), K the modified moments, which a free body keeps. The step
is implicit in c, the tangent of half the turn: c1 = (1 + |c|²) u1 + κ1 c2 c3, cyclic, κ1 =
(K2 − K3)/K1; then q∘(1, c)/√(1 + |c|²) and u1 + 2 κ1 c2 c3/(1 + |c|²). No trigonometry; keeps |m|,
the energy and the momentum in space.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import helper, hook
from fastatt.kernels import moser_veselov as mv
from fastatt.kernels.vec3 import dot
from fastatt.methods.method import FREE, Kernels, Method, register
from fastatt.motion import attitude_of, momentum_of
from fastatt.representations import carry, compose, gain_vector


class DMV2(NamedTuple):
    """Tag."""


class DMV4(NamedTuple):
    """Tag."""


class DMV6(NamedTuple):
    """Tag."""


class DMV8(NamedTuple):
    """Tag."""


class DMV10(NamedTuple):
    """Tag."""


LEVELS: dict[type, int] = {DMV2: 0, DMV4: 1, DMV6: 2, DMV8: 3, DMV10: 4}


def coefficients(level: Any, inertia: Any) -> Any:
    """All coefficients of a level, flat: 0, 4, 10, 18 or 28 numbers."""
    raise NotImplementedError(level)


def corrections(level: Any, C: Any, H: Any, k: Any) -> Any:
    """(s, d) of the modified moments from the coefficients k."""
    raise NotImplementedError(level)


def tolerance(x: Any) -> Any:
    """Square of the change below which Newton's iteration in the type of x has converged."""
    raise NotImplementedError


@hook(tolerance)
def _tolerance(x: types.Float) -> Any:
    # Newton's last change e leaves e²: 1e-6 leaves 1e-12, less than any level's own error there
    square = 1e-12 if x == types.float64 else 1e-7
    return lambda x: type(x)(square)


@hook(coefficients)
def _coefficients(level: types.BaseNamedTuple, inertia: types.BaseTuple) -> Any:
    n = LEVELS[level.instance_class]
    return (
        lambda level, inertia: (),
        lambda level, inertia: mv.coefficients2(inertia),
        lambda level, inertia: mv.coefficients2(inertia) + mv.coefficients4(inertia),
        lambda level, inertia: (
            mv.coefficients2(inertia) + mv.coefficients4(inertia) + mv.coefficients6(inertia)
        ),
        lambda level, inertia: (
            mv.coefficients2(inertia)
            + mv.coefficients4(inertia)
            + mv.coefficients6(inertia)
            + mv.coefficients8(inertia)
        ),
    )[n]


@helper
def add_pairs(x, y):
    return x[0] + y[0], x[1] + y[1]


@hook(corrections)
def _corrections(level: types.BaseNamedTuple, C: types.Type, H: types.Type, k: types.Type) -> Any:
    def none(level, C, H, k):
        F = type(C)
        return F(0.0), F(0.0)

    def two(level, C, H, k):
        return mv.corrections2(C, H, k)

    def four(level, C, H, k):
        return add_pairs(mv.corrections2(C, H, k), mv.corrections4(C, H, k[4:]))

    def six(level, C, H, k):
        low = add_pairs(mv.corrections4(C, H, k[4:]), mv.corrections6(C, H, k[10:]))
        return add_pairs(mv.corrections2(C, H, k), low)

    def eight(level, C, H, k):
        low = add_pairs(mv.corrections6(C, H, k[10:]), mv.corrections8(C, H, k[18:]))
        return add_pairs(mv.corrections2(C, H, k), add_pairs(mv.corrections4(C, H, k[4:]), low))

    return (none, two, four, six, eight)[LEVELS[level.instance_class]]


@helper
def scaled_inertia(p):
    """Principal moments over the largest one."""
    largest = p[3] if p[3] > p[4] else p[4]
    largest = p[5] if p[5] > largest else largest
    return (p[3] / largest, p[4] / largest, p[5] / largest), largest


@helper
def modified(level, h, m, inertia, largest, k):
    """h/(2K) of each axis and (K2 − K3)/K1, cyclic, for a step h at momentum m."""
    F = type(h)
    f = h / largest
    n = (f * m[0], f * m[1], f * m[2])
    square = mv.squared(n)
    C = F(0.5) * mv.power_sum(square)
    H = F(0.5) * (square[0] / inertia[0] + square[1] / inertia[1] + square[2] / inertia[2])
    s, d = corrections(level, C, H, k)
    inverse = mv.modified_inverse(inertia, s, d)
    g = F(0.5) * f
    return (g * inverse[0], g * inverse[1], g * inverse[2]), mv.asymmetry(inverse)


def prepare(method, rep, model, h, x, p):
    inertia, largest = scaled_inertia(p)
    a, kappa = modified(
        method, h, momentum_of(rep, x), inertia, largest, coefficients(method, inertia)
    )
    return a + kappa + (squared_turn(h, momentum_of(rep, x), p),)


@helper
def squared_turn(h, m, p):
    """(|m| h/I_min)²: what the series of the modified moments are in, of a needle far beyond |w| h.

    Not the turn that is solved for: near π the modified moments make it small again.
    """
    most = p[0] if p[0] > p[1] else p[1]
    most = p[2] if p[2] > most else most
    f = h * (most + most)
    return f * f * dot(m, m)


def enter(method, rep, model, t, s, k, x, p, e):
    return attitude_of(rep, x) + carry(rep, mv.product(e[:3], momentum_of(rep, x)))


def leave(method, rep, model, t, s, k, x, p, e):
    u = momentum_of(rep, x)
    return attitude_of(rep, x) + carry(rep, (u[0] / e[0], u[1] / e[1], u[2] / e[2]))


@helper
def turned(rep, a, u, kappa, z):
    """The attitude after one step, c and 1/(1 + |c|²); z, infinite where c did not converge."""
    F = type(u[0])
    c, change = mv.solve(u, kappa)
    r, inverse = mv.rotation(c)
    return compose(rep, a, r), c, inverse, z if change < tolerance(z) else F(math.inf)


def step(method, rep, model, t, h, k, x, p, e):
    F = type(h)
    u = momentum_of(rep, x)
    kappa = e[3:6]
    a, c, inverse, z = turned(rep, attitude_of(rep, x), u, kappa, e[6])
    f = F(2.0) * inverse
    d = (
        f * kappa[0] * (c[1] * c[2]),
        f * kappa[1] * (c[2] * c[0]),
        f * kappa[2] * (c[0] * c[1]),
    )
    return a + gain_vector(rep, u, d), z


def _method(cls: Any) -> Method:
    order = 2 * LEVELS[cls] + 2
    register(cls, Kernels(stage=step, extras=7, prepare=prepare, enter=enter, leave=leave))
    summary = "no trigonometry; keeps energy and momentum"
    return Method(
        tag=cls(),
        name=f"dmv{order}",
        order=order,
        scenes=FREE,
        representations=("quat", "dcm"),
        conserves=("norm", "momentum", "energy"),
        rate_calls=1,
        exponentials=0,
        compensates=True,
        measure="momentum",
        limits=dict.fromkeys(("quat", "dcm"), 0.7 if order == 2 else 1.0),
        summary=f"{summary}; near machine precision at moderate steps" if order == 10 else summary,
        source="Hairer and Vilmart, J. Phys. A 39 (2006) 13225",
    )


METHODS = tuple(_method(cls) for cls in LEVELS)
