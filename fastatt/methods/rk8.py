"""RK8: an explicit Runge-Kutta method of order 8 on the numbers of the state."""

from __future__ import annotations

import math
from typing import NamedTuple

from fastatt.columns import combine
from fastatt.methods import rk4
from fastatt.methods.method import BODIES, Kernels, Method, register
from fastatt.motion import field, given, turning

_S = math.sqrt(21.0)
_A3 = (1 / 4, 1 / 4)
_A4 = (1 / 7, (-7 - 3 * _S) / 98, (21 + 5 * _S) / 49)
_A5 = ((11 + _S) / 84, (18 + 4 * _S) / 63, (21 - _S) / 252)
_A6 = ((5 + _S) / 48, (9 + _S) / 36, (-231 + 14 * _S) / 360, (63 - 7 * _S) / 80)
_A7 = (
    (10 - _S) / 42,
    (-432 + 92 * _S) / 315,
    (633 - 145 * _S) / 90,
    (-504 + 115 * _S) / 70,
    (63 - 13 * _S) / 35,
)
_A8 = (1 / 14, (14 - 3 * _S) / 126, (13 - 3 * _S) / 63, 1 / 9)
_A9 = (1 / 32, (91 - 21 * _S) / 576, 11 / 72, (-385 - 75 * _S) / 1152, (63 + 13 * _S) / 128)
_A10 = (
    1 / 14,
    1 / 9,
    (-733 - 147 * _S) / 2205,
    (515 + 111 * _S) / 504,
    (-51 - 11 * _S) / 56,
    (132 + 28 * _S) / 245,
)
_A11 = (
    (-42 + 7 * _S) / 18,
    (-18 + 28 * _S) / 45,
    (-273 - 53 * _S) / 72,
    (301 + 53 * _S) / 72,
    (28 - 28 * _S) / 45,
    (49 - 7 * _S) / 18,
)
_B = (1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20)
_EARLY = (7 - _S) / 14
_LATE = (7 + _S) / 14


class RK8(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    start = given(model, t, p, h)
    middle = given(model, t + F(0.5) * h, p, h)
    early = given(model, t + F(_EARLY) * h, p, h)
    late = given(model, t + F(_LATE) * h, p, h)
    k1 = field(rep, model, start, x, p)
    k2 = field(rep, model, middle, combine(h, (0.5,), (k1,), x), p)
    k3 = field(rep, model, middle, combine(h, _A3, (k1, k2), x), p)
    k4 = field(rep, model, late, combine(h, _A4, (k1, k2, k3), x), p)
    k5 = field(rep, model, late, combine(h, _A5, (k1, k3, k4), x), p)
    k6 = field(rep, model, middle, combine(h, _A6, (k1, k3, k4, k5), x), p)
    k7 = field(rep, model, early, combine(h, _A7, (k1, k3, k4, k5, k6), x), p)
    k8 = field(rep, model, early, combine(h, _A8, (k1, k5, k6, k7), x), p)
    k9 = field(rep, model, middle, combine(h, _A9, (k1, k5, k6, k7, k8), x), p)
    k10 = field(rep, model, late, combine(h, _A10, (k1, k5, k6, k7, k8, k9), x), p)
    end = combine(h, _A11, (k5, k6, k7, k8, k9, k10), x)
    k11 = field(rep, model, given(model, t + h, p, h), end, p)
    x = combine(h, _B, (k1, k8, k9, k10, k11), x)
    return x, h * h * turning(rep, model, start, k1, end, p)


register(RK8, Kernels(body=step))

METHOD = Method(
    tag=RK8(),
    name="rk8",
    order=8,
    scenes=BODIES,
    representations=("quat", "dcm", "dcm_rows", "euler313", "rotation_vector"),
    conserves=(),
    rate_calls=11,
    exponentials=0,
    limits=rk4.METHOD.limits,
    summary="explicit, 11 stages: any torque, tight tolerances",
    source="Cooper and Verner, SIAM J. Numer. Anal. 9 (1972) 389",
)
