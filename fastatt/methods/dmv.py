"""DMV: the discrete Moser-Veselov step with modified inertia, of orders 2 and 10, for free bodies.

The step is taken in u = h m/(2K) in place of m, with the modified moments K, which a free body
conserves. It is implicit in c, the tangent of half the rotation angle: c1 = (1 + ``|c|²``) u1 +
κ1 c2 c3, cyclic, with κ1 = (K2 − K3)/K1. The new attitude is q∘(1, c)/√(1 + ``|c|²``) and the new
u1 is u1 + 2 κ1 c2 c3/(1 + ``|c|²``). There is no trigonometry; ``|m|``, the energy and the angular
momentum along inertial axes are conserved.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

from fastatt.attitudes.attitude import FAMILIES
from fastatt.methods.method import FREE, Method, Steps
from fastatt.tracing.formulas import Vector, dot, kernels, scale, vec3
from fastatt.tracing.graph import Single, choose

mv = kernels("moser_veselov")


def prepare(motion: Any, h: Any, x: Vector, *, corrected: bool) -> Vector:
    """h/(2K) for each axis, (K2 − K3)/K1, cyclic, and (``|m|`` h/I_min)².

    The last is the variable of the series of the modified moments, for a needle far above ``|w|
    h``. The rotation angle of the step is not used: near π the modified moments make it small.
    """
    m = motion.momentum_of(x)[:3]
    largest = vec3.largest(motion.moments)
    inertia = tuple(i / largest for i in motion.moments)
    f = h / largest
    square = mv.squared(scale(f, m))
    C = 0.5 * mv.power_sum(square)
    H = 0.5 * (square[0] / inertia[0] + square[1] / inertia[1] + square[2] / inertia[2])
    s, d = mv.corrections(C, H, mv.coefficients(inertia)) if corrected else (0.0, 0.0)
    inverse = mv.modified_inverse(inertia, s, d)
    most = vec3.largest(motion.half_inverse)
    turn = scale(h * (most + most), m)
    return (*scale(0.5 * f, inverse), *mv.asymmetry(inverse), dot(turn, turn))


def enter(motion: Any, t: Any, s: Any, k: Any, x: Vector, e: Vector) -> Vector:
    u = mv.product(e[:3], motion.momentum_of(x)[:3])
    return (*motion.attitude_of(x), *motion.attitude.carry(u))


def leave(motion: Any, t: Any, s: Any, k: Any, x: Vector, e: Vector) -> Vector:
    m = tuple(u / a for u, a in zip(motion.momentum_of(x)[:3], e[:3], strict=True))
    return (*motion.attitude_of(x), *motion.attitude.carry(m))


def stage(motion: Any, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> Any:
    u, kappa = motion.momentum_of(x), e[3:6]
    c, change = mv.solve(u[:3], kappa)
    turn, inverse = mv.rotation(c)
    a = motion.attitude.compose(motion.attitude_of(x), turn)
    f = 2.0 * inverse
    d = (f * kappa[0] * (c[1] * c[2]), f * kappa[1] * (c[2] * c[0]), f * kappa[2] * (c[0] * c[1]))
    # after a last change e Newton's iteration has the error e², below that of either order
    most = 1e-7 if isinstance(u[0], Single) else 1e-12
    z = choose(change < most, e[6], math.inf)
    return (*a, *motion.attitude.add_vector(u, d)), z


def _method(order: int, limit: float, summary: str, *, corrected: bool) -> Method:
    """A method with moments that are corrected up to an order."""
    return Method(
        name=f"dmv{order}",
        order=order,
        scenes=FREE,
        uses=("compose",),
        conserves=("norm", "momentum", "energy"),
        rate_calls=1,
        compensates=True,
        measure="momentum",
        limits=dict.fromkeys(FAMILIES, limit),
        steps=Steps(
            stage=stage,
            prepare=partial(prepare, corrected=corrected),
            enter=enter,
            leave=leave,
            iterates=True,
        ),
        reversible=FREE,
        symplectic=not corrected,
        tried_on=FREE if corrected else (),
        summary=f"no trigonometry; conserves energy and angular momentum{summary}",
        source="Hairer and Vilmart, J. Phys. A 39 (2006) 13225",
    )


DMV2 = _method(2, 0.7, "", corrected=False)
DMV10 = _method(10, 1.0, "; near machine precision at moderate steps", corrected=True)
