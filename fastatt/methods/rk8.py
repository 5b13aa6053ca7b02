"""RK8: an explicit Runge-Kutta method of order 8 on the numbers of the state.

Of the methods of order 8 with 11 and 12 stages, that of Cooper and Verner (1972) and this one, this
is 40 times as accurate at the same step, which 12 stages in place of 11 do not outweigh.
"""

from __future__ import annotations

from typing import NamedTuple

from fastatt.columns import combine, largest, weighted
from fastatt.methods.method import BODIES, Kernels, Method, register
from fastatt.motion import advanced, base, field, given, turning
from fastatt.representations import plain

_C = (
    0.0,
    0.05260015195876773,
    0.0789002279381516,
    0.1183503419072274,
    0.2816496580927726,
    0.3333333333333333,
    0.25,
    0.3076923076923077,
    0.6512820512820513,
    0.6,
    0.8571428571428571,
    1.0,
)
# weights of each stage's predecessors, those of 0 left out: which they are stands in the step
_A2 = (0.05260015195876773,)
_A3 = (
    0.0197250569845379,
    0.0591751709536137,
)
_A4 = (
    0.02958758547680685,
    0.08876275643042054,
)
_A5 = (
    0.2413651341592667,
    -0.8845494793282861,
    0.924834003261792,
)
_A6 = (
    0.037037037037037035,
    0.17082860872947386,
    0.12546768756682242,
)
_A7 = (
    0.037109375,
    0.17025221101954405,
    0.06021653898045596,
    -0.017578125,
)
_A8 = (
    0.03709200011850479,
    0.17038392571223998,
    0.10726203044637328,
    -0.015319437748624402,
    0.008273789163814023,
)
_A9 = (
    0.6241109587160757,
    -3.3608926294469414,
    -0.868219346841726,
    27.59209969944671,
    20.154067550477894,
    -43.48988418106996,
)
_A10 = (
    0.47766253643826434,
    -2.4881146199716677,
    -0.590290826836843,
    21.230051448181193,
    15.279233632882423,
    -33.28821096898486,
    -0.020331201708508627,
)
_A11 = (
    -0.9371424300859873,
    5.186372428844064,
    1.0914373489967295,
    -8.149787010746927,
    -18.52006565999696,
    22.739487099350505,
    2.4936055526796523,
    -3.0467644718982196,
)
_A12 = (
    2.273310147516538,
    -10.53449546673725,
    -2.0008720582248625,
    -17.9589318631188,
    27.94888452941996,
    -2.8589982771350235,
    -8.87285693353063,
    12.360567175794303,
    0.6433927460157636,
)
_B = (
    0.054293734116568765,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
)


class RK8(NamedTuple):
    """Tag."""


def step(method, rep, model, t, h, x, p):
    F = type(h)
    start = given(model, t, p, h)
    bare = plain(rep)
    x0 = base(rep, model, x)
    k1 = field(bare, model, start, x0, p)
    y = combine(h, _A2, (k1,), x0)
    k2 = field(bare, model, given(model, t + F(_C[1]) * h, p, h), y, p)
    y = combine(h, _A3, (k1, k2), x0)
    k3 = field(bare, model, given(model, t + F(_C[2]) * h, p, h), y, p)
    y = combine(h, _A4, (k1, k3), x0)
    k4 = field(bare, model, given(model, t + F(_C[3]) * h, p, h), y, p)
    y = combine(h, _A5, (k1, k3, k4), x0)
    k5 = field(bare, model, given(model, t + F(_C[4]) * h, p, h), y, p)
    y = combine(h, _A6, (k1, k4, k5), x0)
    k6 = field(bare, model, given(model, t + F(_C[5]) * h, p, h), y, p)
    y = combine(h, _A7, (k1, k4, k5, k6), x0)
    k7 = field(bare, model, given(model, t + F(_C[6]) * h, p, h), y, p)
    y = combine(h, _A8, (k1, k4, k5, k6, k7), x0)
    k8 = field(bare, model, given(model, t + F(_C[7]) * h, p, h), y, p)
    y = combine(h, _A9, (k1, k4, k5, k6, k7, k8), x0)
    k9 = field(bare, model, given(model, t + F(_C[8]) * h, p, h), y, p)
    y = combine(h, _A10, (k1, k4, k5, k6, k7, k8, k9), x0)
    k10 = field(bare, model, given(model, t + F(_C[9]) * h, p, h), y, p)
    y = combine(h, _A11, (k1, k4, k5, k6, k7, k8, k9, k10), x0)
    k11 = field(bare, model, given(model, t + F(_C[10]) * h, p, h), y, p)
    end = combine(h, _A12, (k1, k4, k5, k6, k7, k8, k9, k10, k11), x0)
    k12 = field(bare, model, given(model, t + h, p, h), end, p)
    d = weighted(h, _B, (k1, k6, k7, k8, k9, k10, k11, k12))
    # of coordinates, which a stage may bring nearer to their pole than the start is
    most = largest(largest(largest(k1, k3), largest(k5, k7)), largest(largest(k9, k10), k12))
    return advanced(rep, model, x, d), h * h * turning(bare, model, start, most, end, p)


register(RK8, Kernels(body=step))

METHOD = Method(
    tag=RK8(),
    name="rk8",
    order=8,
    scenes=BODIES,
    representations=("quat", "dcm", "dcm_rows", "euler313", "rotation_vector"),
    conserves=(),
    rate_calls=12,
    exponentials=0,
    compensates=True,
    # stable up to 5.97
    limits={
        "quat": 3.9,
        "dcm": 3.9,
        "dcm_rows": 3.9,
        "euler313": 0.3,
        "rotation_vector": 0.3,
    },
    damping_limit=5.1,
    summary="explicit, 12 stages: any torque, tight tolerances",
    source="Dormand and Prince; Hairer, Nørsett, Wanner, Solving ODEs I (1993), §II.5, DOP853",
)
