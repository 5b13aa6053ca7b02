"""SRKN: kicks by the torque between steps of free motion, for torques that do not depend on w.

Coefficients of the Runge-Kutta-Nyström splittings of Blanes and Moan, whose fewer order conditions
hold for an energy quadratic in the momenta. The free motion between kicks is a Moser-Veselov step
of higher order than the splitting, so that it adds nothing that can be seen.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import NamedTuple

from fastatt._jit import helper
from fastatt.kernels import moser_veselov as mv
from fastatt.methods import dmv
from fastatt.methods.method import Kernels, Method, register
from fastatt.motion import attitude_of, kick, momentum_of
from fastatt.torques import POSITION


class SRKN4(NamedTuple):
    """Tag."""


class SRKN6(NamedTuple):
    """Tag."""


dmv.LEVELS[SRKN4] = 3
dmv.LEVELS[SRKN6] = 3


def prepare(method, rep, model, h, x, p):
    inertia, _ = dmv.scaled_inertia(p)
    return dmv.coefficients(method, inertia)


def step(method, rep, model, t, h, k, x, p, e):
    F = type(h)
    m = momentum_of(rep, x)
    inertia, largest = dmv.scaled_inertia(p)
    a, kappa = dmv.modified(method, h, m, inertia, largest, e)
    z = dmv.squared_turn(h, m, p)
    b, c, inverse, z = dmv.turned(rep, attitude_of(rep, x), mv.product(a, m), kappa, z)
    f = F(2.0) * inverse
    m = (
        m[0] + f * kappa[0] / a[0] * (c[1] * c[2]),
        m[1] + f * kappa[1] / a[1] * (c[2] * c[0]),
        m[2] + f * kappa[2] / a[2] * (c[0] * c[1]),
    )
    return b + kick(rep, model, t, k, b, m, p), z


@helper
def kicked(rep, model, t, k, x, p):
    a = attitude_of(rep, x)
    return a + kick(rep, model, t, k, a, momentum_of(rep, x), p)


def enter(method, rep, model, t, s, k, x, p, e):
    return kicked(rep, model, t, k, x, p)


def leave(method, rep, model, t, s, k, x, p, e):
    return kicked(rep, model, t, -k, x, p)


def _stages(
    kicks: tuple[float, ...], drifts: tuple[float, ...]
) -> tuple[tuple[float, float, float], ...]:
    """A drift and the kick after it; the first kick is done with the last of the step before."""
    at = accumulate(drifts)
    after = (*kicks[1:-1], 2.0 * kicks[0])
    return tuple((b, k, c) for b, k, c in zip(drifts, after, at, strict=True))


def _method(cls: type, order: int, stages: tuple[tuple[float, float, float], ...]) -> Method:
    register(
        cls,
        Kernels(
            stage=step,
            extras=(0, 4, 10, 18, 28)[dmv.LEVELS[cls]],
            prepare=prepare,
            enter=enter,
            leave=leave,
        ),
    )
    return Method(
        tag=cls(),
        name=f"srkn{order}",
        order=order,
        scenes=("torqued",),
        representations=("quat", "dcm"),
        conserves=("norm",),
        rate_calls=len(stages),
        exponentials=0,
        measure="momentum",
        limits=dict.fromkeys(("quat", "dcm"), 1.0),
        summary="kicks between steps of free motion; torques that do not depend on w",
        source="Blanes and Moan, J. Comput. Appl. Math. 142 (2002) 313, table 3",
        stages=stages,
        takes=POSITION,
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
_FOUR = _stages((*_K4, 1.0 - 2.0 * math.fsum(_K4), *_K4[::-1]), (*_D4_HALF, *_D4_HALF[::-1]))
_SIX = _stages((*_K6_HALF, *_K6_HALF[::-1]), (*_D6, 1.0 - 2.0 * math.fsum(_D6), *_D6[::-1]))

METHODS = (_method(SRKN4, 4, _FOUR), _method(SRKN6, 6, _SIX))
