"""Magnus-6: one exponential, three Gauss nodes, nested commutators."""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import lie_method
from fastatt.tracing.formulas import axpy, minus, plus, scale, vec3


def exponents(w: Any, t: Any, h: Any) -> Any:
    w1 = w(t + 0.1127016653792583 * h)
    w2 = w(t + 0.5 * h)
    w3 = w(t + 0.8872983346207417 * h)
    a1 = scale(h, w2)
    a2 = scale(1.2909944487358056 * h, minus(w3, w1))
    a3 = scale(10.0 / 3.0 * h, axpy(-2.0, w2, plus(w1, w3)))
    # the bracket of right multiplication is [x, y] = −x×y
    c1 = vec3.cross(a2, a1)
    c2 = scale(1.0 / 60.0, vec3.cross(a1, axpy(2.0, a3, c1)))
    left = axpy(-20.0, a1, minus(c1, a3))
    bracket = vec3.cross(plus(a2, c2), left)
    return (axpy(1.0 / 240.0, bracket, axpy(1.0 / 12.0, a3, a1)),)


METHOD = lie_method(
    "magnus6",
    6,
    exponents,
    rate_calls=3,
    exponentials=1,
    limit=3.0,
    reversible=("rate",),
    summary="three Gauss nodes and nested commutators; for tight tolerances, reversible",
    source="Blanes, Casas, Oteo, Ros, Phys. Rep. 470 (2009), eq. 257",
)
