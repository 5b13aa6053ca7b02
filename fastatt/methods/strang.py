"""Rotations about two principal axes, and their compositions of higher order.

With the Casimir |m|²/(2 I2) taken out, I2 the intermediate moment, the kinetic energy is that of
two rotors, ½ m1² (1/I1 − 1/I2) + ½ m3² (1/I3 − 1/I2), each of which turns body and momentum about
its axis at a constant rate; what was taken out is one rotation about the momentum. Explicit, stable
at any step, reversible; |m| and the momentum in space stay what they were.

What is stepped lies half a rotation about axis 1 ahead of the state: two rotations a stage, not
three. Under a torque a stage is all of the free motion and a kick, and half a kick ahead.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import helper, hook
from fastatt.kernels import dcm, quat
from fastatt.kernels.trig import sincos
from fastatt.kernels.vec3 import dot, scale
from fastatt.methods.method import BODIES, Kernels, Method, register
from fastatt.motion import attitude_of, kick, momentum_of
from fastatt.representations import Dcm, DcmShort, turn
from fastatt.torques import DAMPED, Free


class Strang(NamedTuple):
    """Tag."""


def turn_first(rep: Any, a: Any, c: Any, s: Any) -> Any:
    """The attitude turned about axis 1; c and s are cosine and sine of half the angle."""
    raise NotImplementedError(rep)


def turn_third(rep: Any, a: Any, c: Any, s: Any) -> Any:
    """The attitude turned about axis 3; c and s are cosine and sine of half the angle."""
    raise NotImplementedError(rep)


@hook(turn_first)
def _turn_first(rep: types.BaseNamedTuple, a: types.BaseTuple, c: types.Type, s: types.Type) -> Any:
    operation = dcm.turn_first if rep.instance_class in (Dcm, DcmShort) else quat.turn_first
    return lambda rep, a, c, s: operation(a, c, s)


@hook(turn_third)
def _turn_third(rep: types.BaseNamedTuple, a: types.BaseTuple, c: types.Type, s: types.Type) -> Any:
    operation = dcm.turn_third if rep.instance_class in (Dcm, DcmShort) else quat.turn_third
    return lambda rep, a, c, s: operation(a, c, s)


@helper
def first(rep, h, a, m, p):
    """h s of the rotor about axis 1."""
    F = type(h)
    s, c = sincos(F(-0.5) * h * p[8] * m[0])
    S = F(2.0) * s * c
    C = F(1.0) - F(2.0) * s * s
    return turn_first(rep, a, c, s), (m[0], C * m[1] + S * m[2], C * m[2] - S * m[1])


@helper
def third(rep, h, a, m, p):
    """h s of the rotor about axis 3."""
    F = type(h)
    s, c = sincos(F(0.5) * h * p[6] * m[2])
    S = F(2.0) * s * c
    C = F(1.0) - F(2.0) * s * s
    return turn_third(rep, a, c, s), (C * m[0] + S * m[1], C * m[1] - S * m[0], m[2])


@helper
def spherical(rep, h, a, m, p):
    """The attitude h s later of a sphere of moment I2."""
    return turn(rep, a, scale((h + h) * p[1], m))


def stage(method: Any, rep: Any, model: Any, t: Any, h: Any, k: Any, x: Any, p: Any, e: Any) -> Any:
    """One stage: with or without a torque."""
    raise NotImplementedError(model)


def ahead(rep: Any, model: Any, t: Any, s: Any, k: Any, x: Any, p: Any) -> Any:
    """The state k s of the last flow ahead, and s s of what is left to the end."""
    raise NotImplementedError(model)


@hook(stage)
def _stage(
    method: types.Type,
    rep: types.Type,
    model: types.BaseNamedTuple,
    t: types.Type,
    h: types.Type,
    k: types.Type,
    x: types.Type,
    p: types.Type,
    e: types.Type,
) -> Any:
    def free(method, rep, model, t, h, k, x, p, e):
        m = momentum_of(rep, x)
        a, m = third(rep, h, attitude_of(rep, x), m, p)
        a, m = first(rep, k, a, m, p)
        return a + m, e[0]

    def torqued(method, rep, model, t, h, k, x, p, e):
        F = type(h)
        half = F(0.5) * h
        a, m = first(rep, half, attitude_of(rep, x), momentum_of(rep, x), p)
        a, m = third(rep, h, a, m, p)
        a, m = first(rep, half, a, m, p)
        a = spherical(rep, h, a, m, p)
        return a + kick(rep, model, t, k, a, m, p), e[0] * dot(m, m)

    return free if model.types[0].instance_class is Free else torqued


@hook(ahead)
def _ahead(
    rep: types.Type,
    model: types.BaseNamedTuple,
    t: types.Type,
    s: types.Type,
    k: types.Type,
    x: types.Type,
    p: types.Type,
) -> Any:
    def free(rep, model, t, s, k, x, p):
        a, m = first(rep, k, attitude_of(rep, x), momentum_of(rep, x), p)
        return spherical(rep, s, a, m, p) + m

    def torqued(rep, model, t, s, k, x, p):
        a = attitude_of(rep, x)
        return a + kick(rep, model, t, k, a, momentum_of(rep, x), p)

    return free if model.types[0].instance_class is Free else torqued


def prepare(method, rep, model, h, x, p):
    # any step is stable, and exact for a symmetric body: what a step misses grows with the mean of
    # the rotors' angles, |m| h √(|1/I1 − 1/I2| |1/I3 − 1/I2|)
    return (h * h * abs(p[6] * p[8]) * known_square(rep, model, x),)


def known_square(rep: Any, model: Any, x: Any) -> Any:
    """|m|² of a free body, which keeps it; 1 of all others."""
    raise NotImplementedError(model)


@hook(known_square)
def _known_square(rep: types.Type, model: types.BaseNamedTuple, x: types.BaseTuple) -> Any:
    if model.types[0].instance_class is Free:
        return lambda rep, model, x: dot(momentum_of(rep, x), momentum_of(rep, x))
    return lambda rep, model, x: type(x[0])(1.0)


def step(method, rep, model, t, h, k, x, p, e):
    return stage(method, rep, model, t, h, k, x, p, e)


def enter(method, rep, model, t, s, k, x, p, e):
    return ahead(rep, model, t, s, k, x, p)


def leave(method, rep, model, t, s, k, x, p, e):
    return ahead(rep, model, t, s, -k, x, p)


register(Strang, Kernels(stage=step, extras=1, prepare=prepare, enter=enter, leave=leave))


def composition(half: tuple[float, ...]) -> tuple[tuple[float, float, float], ...]:
    """Stages of a palindromic composition, from the first half of its steps and the middle one."""
    steps = (*half, *half[-2::-1])
    following = (*steps[1:], steps[0])
    at = accumulate(steps)
    return tuple(
        (b, 0.5 * (b + after), c) for b, after, c in zip(steps, following, at, strict=True)
    )


def _centre(outer: tuple[float, ...]) -> tuple[float, ...]:
    return (*outer, 1.0 - 2.0 * math.fsum(outer))


# e^x of float32 ends here, and with it the growth that a stage backwards must undo
_DECAY = 88.0


def _method(
    name: str,
    order: int,
    half: tuple[float, ...],
    limit: float,
    summary: str,
    source: str,
) -> Method:
    stages = composition(half)
    backwards = max((abs(k) for _, k, _ in stages if k < 0.0), default=0.0)
    return Method(
        tag=Strang(),
        name=name,
        order=order,
        scenes=BODIES,
        representations=("quat", "dcm"),
        conserves=("norm", "momentum"),
        rate_calls=2 * len(half) - 1,
        exponentials=0,
        measure="asymmetry",
        limits=dict.fromkeys(("quat", "dcm"), limit),
        # strang2 turns the body with the rate of the middle, which a strong damping makes wrong
        damping_limit=_DECAY / backwards if backwards else 3.3,
        summary=summary,
        source=source,
        stages=stages,
        sorted_axes=True,
        takes=DAMPED,
    )


_SUZUKI = 1.0 / (4.0 - 4.0 ** (1.0 / 3.0))
STRANG2 = _method(
    "strang2",
    2,
    (1.0,),
    1.2,
    "two rotations a step: huge ensembles, any step; exact for symmetric bodies",
    "McLachlan, SIAM J. Sci. Comput. 16 (1995) 151; Touma and Wisdom, Astron. J. 107 (1994) 1189",
)
SUZUKI4 = _method(
    "suzuki4",
    4,
    _centre((_SUZUKI, _SUZUKI)),
    1.8,
    "five strang2 steps: order 4 at large steps",
    "Suzuki, Phys. Lett. A 146 (1990) 319",
)
KAHAN_LI6 = _method(
    "kahan_li6",
    6,
    _centre(
        (0.39216144400731413928, 0.33259913678935943860, -0.70624617255763935981,
         0.08221359629355080023)
    ),
    1.5,
    "nine strang2 steps: order 6, long runs without drift",
    "Kahan and Li, Math. Comp. 66 (1997) 1089",
)  # fmt: skip
KAHAN_LI8 = _method(
    "kahan_li8",
    8,
    _centre(
        (0.13020248308889008088, 0.56116298177510838456, -0.38947496264484728641,
         0.15884190655515560090, -0.39590389413323757734, 0.18453964097831570709,
         0.25837438768632204729, 0.29501172360931029887)
    ),
    1.7,
    "seventeen strang2 steps: order 8, needles and long runs",
    "Kahan and Li, Math. Comp. 66 (1997) 1089",
)  # fmt: skip
