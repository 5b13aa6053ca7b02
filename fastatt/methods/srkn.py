"""SRKN: kicks by the torque between steps of free motion, for torques that do not depend on w.

Coefficients of the Runge-Kutta-Nyström splittings of Blanes and Moan, whose fewer order conditions
hold for an energy quadratic in the momenta. The free motion between kicks is a Moser-Veselov step
of higher order than the splitting, so that it adds nothing that can be seen.
"""

from __future__ import annotations

import math
from typing import Any

from fastatt.flat.formulas import Vector
from fastatt.flat.formulas import moser_veselov as mv
from fastatt.methods import dmv
from fastatt.methods.method import Method, Steps
from fastatt.methods.strang import stages
from fastatt.torques import Dependence

_LEVEL = 3


def prepare(motion: Any, h: Any, x: Vector) -> Vector:
    inertia, _ = dmv.scaled_inertia(motion)
    return dmv.coefficients(_LEVEL, inertia)


def stage(motion: Any, t: Any, h: Any, k: Any, x: Vector, e: Vector) -> Any:
    m = motion.momentum_of(x)
    a, kappa = dmv.modified(_LEVEL, h, m, dmv.scaled_inertia(motion), e)
    z = dmv.squared_turn(motion, h, m)
    b, c, inverse, z = dmv.turned(motion, motion.attitude_of(x), mv.product(a, m), kappa, z)
    f = 2.0 * inverse
    m = (
        m[0] + f * kappa[0] / a[0] * (c[1] * c[2]),
        m[1] + f * kappa[1] / a[1] * (c[2] * c[0]),
        m[2] + f * kappa[2] / a[2] * (c[0] * c[1]),
    )
    return (*b, *motion.kick(t, k, b, m)), z


def kicked(motion: Any, t: Any, k: Any, x: Vector) -> Vector:
    a = motion.attitude_of(x)
    return (*a, *motion.kick(t, k, a, motion.momentum_of(x)))


STEPS = Steps(
    stage=stage,
    prepare=prepare,
    enter=lambda motion, t, s, k, x, e: kicked(motion, t, k, x),
    leave=lambda motion, t, s, k, x, e: kicked(motion, t, -k, x),
)


def _method(order: int, kicks: tuple[float, ...], drifts: tuple[float, ...]) -> Method:
    return Method(
        name=f"srkn{order}",
        order=order,
        scenes=("torqued",),
        representations=("quat", "dcm"),
        uses=("compose",),
        conserves=("norm",),
        rate_calls=len(drifts),
        exponentials=0,
        measure="momentum",
        limits=dict.fromkeys(("quat", "dcm"), 1.0),
        steps=STEPS,
        stages=stages(kicks, drifts),
        reversible=("torqued",),
        summary="kicks between steps of free motion; torques that do not depend on w",
        source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, table 3",
        takes=Dependence.POSITION,
    )


_K4 = (0.0829844064174052, 0.396309801498368, -0.0390563049223486)
_D4 = (0.245298957184271, 0.604872665711080)
_K6 = (
    0.0414649985182624,
    0.198128671918067,
    -0.0400061921041533,
    0.0752539843015807,
    -0.0115113874206879,
)
_D6 = (
    0.123229775946271,
    0.290553797799558,
    -0.127049212625417,
    -0.246331761062075,
    0.357208872795928,
)
_D4_HALF = (*_D4, 0.5 - math.fsum(_D4))
_K6_HALF = (*_K6, 0.5 - math.fsum(_K6))
METHODS = (
    _method(4, (*_K4, 1.0 - 2.0 * math.fsum(_K4), *_K4[::-1]), (*_D4_HALF, *_D4_HALF[::-1])),
    _method(6, (*_K6_HALF, *_K6_HALF[::-1]), (*_D6, 1.0 - 2.0 * math.fsum(_D6), *_D6[::-1])),
)
