"""CF4: commutator-free, two exponentials."""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import body_step, lie_method
from fastatt.tracing.formulas import Vector, axpy, dot, minus, plus, scale
from fastatt.tracing.graph import larger


def exponents(w: Any, t: Any, h: Any) -> Any:
    a = w(t + 0.21132486540518713 * h)
    b = w(t + 0.7886751345948129 * h)
    # weights ¼ ± √3/6
    big = 0.5386751345948129 * h
    small = -0.038675134594812865 * h
    return axpy(big, a, scale(small, b)), axpy(small, a, scale(big, b))


def turns(exponents: list[Vector], rates: list[Vector], h: Any) -> Any:
    # each exponential is about half of the rotation
    u, v = exponents
    return 4.0 * larger(dot(u, u), dot(v, v))


def body(slope: Any, t: Any, h: Any, m: Vector) -> Any:
    half = 0.5 * h
    k1, n1 = slope(t, (), m)
    to_middle, m2 = scale(half, k1), axpy(half, n1, m)
    k2, n2 = slope(t + half, (to_middle,), m2)
    m3 = axpy(half, n2, m)
    k3, n3 = slope(t + half, (scale(half, k2),), m3)
    m4 = axpy(h, n3, m)
    k4, n4 = slope(t + h, (to_middle, scale(h, axpy(-0.5, k1, k3))), m4)
    # exp(h/12 (3, 2, 2, −1)) exp(h/12 (−1, 2, 2, 3))
    twelfth = 1.0 / 12.0 * h
    middle = scale(2.0, plus(k2, k3))
    u = scale(twelfth, minus(axpy(3.0, k1, middle), k4))
    v = scale(twelfth, minus(axpy(3.0, k4, middle), k1))
    return (u, v), scale(1.0 / 6.0 * h, plus(axpy(2.0, plus(n2, n3), n1), n4))


METHOD = lie_method(
    "cf4",
    4,
    exponents,
    turns=turns,
    body=body_step(body, turns),
    rate_calls=2,
    body_calls=4,
    exponentials=2,
    limit=2.2,
    body_limit=1.9,
    damping_limit=1.7,
    reversible=("rate",),
    tried_on=(),
    summary="two exponentials of weighted sums of rates, without commutators",
    source="Celledoni, Marthinsen, Owren, Future Gen. Comp. Syst. 19 (2003) 341",
)
