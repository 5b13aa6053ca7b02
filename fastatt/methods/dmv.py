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
from fastatt.tracing.formulas import Kernels, Vector, dot, plus, scale
from fastatt.tracing.graph import Single, choose

mv: Any = Kernels("moser_veselov")
# number of coefficients of each level, from the second power of the step on
_SIZES = (4, 6, 8, 10)


def coefficients(level: int, inertia: Vector) -> Vector:
    """All coefficients of a level, flat: 0 or 28 numbers."""
    each = (mv.coefficients2, mv.coefficients4, mv.coefficients6, mv.coefficients8)
    return tuple(k for f in each[:level] for k in f(inertia))


def corrections(level: int, C: Any, H: Any, k: Vector) -> Vector:
    """(s, d) of the modified moments from the coefficients k, added from the smallest on."""
    each = (mv.corrections2, mv.corrections4, mv.corrections6, mv.corrections8)
    found: Vector = (0.0, 0.0)
    for n in reversed(range(level)):
        at = sum(_SIZES[:n])
        found = plus(each[n](C, H, k[at : at + _SIZES[n]]), found)
    return found


def tolerance(x: Any) -> float:
    """Square of the change below which Newton's iteration, in the precision of x, has converged."""
    # after a last change e Newton's iteration has the error e²; 1e-12 is below each level's error
    return 1e-7 if isinstance(x, Single) else 1e-12


def scaled_inertia(motion: Any) -> Any:
    """Principal moments divided by the largest one, and the largest one."""
    a, b, c = motion.moments
    largest = choose(a > b, a, b)
    largest = choose(c > largest, c, largest)
    return (a / largest, b / largest, c / largest), largest


def modified(level: int, h: Any, m: Vector, scaled: Any, k: Vector) -> Any:
    """h/(2K) for each axis and (K2 − K3)/K1, cyclic, for a step h at momentum m."""
    inertia, largest = scaled
    f = h / largest
    square = mv.squared(scale(f, m))
    C = 0.5 * mv.power_sum(square)
    H = 0.5 * (square[0] / inertia[0] + square[1] / inertia[1] + square[2] / inertia[2])
    inverse = mv.modified_inverse(inertia, *corrections(level, C, H, k))
    return scale(0.5 * f, inverse), mv.asymmetry(inverse)


def squared_turn(motion: Any, h: Any, m: Vector) -> Any:
    """(``|m|`` h/I_min)², the variable of the series of the modified moments.

    For a needle it is far above ``|w| h``. The rotation angle of the step is not used: near π the
    modified moments make it small.
    """
    a, b, c = motion.half_inverse
    most = choose(a > b, a, b)
    most = choose(c > most, c, most)
    f = h * (most + most)
    u = scale(f, m)
    return dot(u, u)


def turned(motion: Any, a: Vector, u: Vector, kappa: Vector, z: Any) -> Any:
    """The attitude after one step, c and 1/(1 + ``|c|²``); z is infinite if c did not converge."""
    c, change = mv.solve(u, kappa)
    r, inverse = mv.rotation(c)
    z = choose(change < tolerance(u[0]), z, math.inf)
    return motion.attitude.compose(a, r), c, inverse, z


def prepare(level: int, motion: Any, h: Any, x: Vector) -> Vector:
    m = motion.momentum_of(x)[:3]
    scaled = scaled_inertia(motion)
    a, kappa = modified(level, h, m, scaled, coefficients(level, scaled[0]))
    return (*a, *kappa, squared_turn(motion, h, m))


def enter(motion: Any, t: Any, s: Any, k: Any, x: Vector, e: Vector) -> Vector:
    u = mv.product(e[:3], motion.momentum_of(x)[:3])
    return (*motion.attitude_of(x), *motion.attitude.carry(u))


def leave(motion: Any, t: Any, s: Any, k: Any, x: Vector, e: Vector) -> Vector:
    m = tuple(u / a for u, a in zip(motion.momentum_of(x)[:3], e[:3], strict=True))
    return (*motion.attitude_of(x), *motion.attitude.carry(m))


def stage(motion: Any, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> Any:
    u = motion.momentum_of(x)
    kappa = e[3:6]
    a, c, inverse, z = turned(motion, motion.attitude_of(x), u[:3], kappa, e[6])
    f = 2.0 * inverse
    d = (
        f * kappa[0] * (c[1] * c[2]),
        f * kappa[1] * (c[2] * c[0]),
        f * kappa[2] * (c[0] * c[1]),
    )
    return (*a, *motion.attitude.add_vector(u, d)), z


def _method(level: int) -> Method:
    order = 2 * level + 2
    summary = "no trigonometry; conserves energy and angular momentum"
    return Method(
        name=f"dmv{order}",
        order=order,
        scenes=FREE,
        uses=("compose",),
        conserves=("norm", "momentum", "energy"),
        rate_calls=1,
        compensates=True,
        measure="momentum",
        limits=dict.fromkeys(FAMILIES, 0.7 if order == 2 else 1.0),
        steps=Steps(
            stage=stage, prepare=partial(prepare, level), enter=enter, leave=leave, iterates=True
        ),
        reversible=FREE,
        symplectic=level == 0,
        summary=f"{summary}; near machine precision at moderate steps" if order == 10 else summary,
        source="Hairer and Vilmart, J. Phys. A 39 (2006) 13225",
    )


DMV2, DMV10 = _method(0), _method(4)
