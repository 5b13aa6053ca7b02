"""Magnus-8: one exponential, four Gauss nodes, six commutators."""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import gauss_polynomial, lie_method
from fastatt.tracing.formulas import axpy, minus, plus, scale, vec3


def exponents(w: Any, t: Any, h: Any) -> Any:
    a1, a2, a3, a4 = gauss_polynomial(w, t, h, 4)
    first, second = axpy(1.0 / 28.0, a3, a1), axpy(3.0 / 28.0, a4, a2)
    # the bracket of right multiplication is [x, y] = −x×y = y×x
    s1 = scale(-1.0 / 28.0, vec3.cross(second, first))
    r1 = scale(1.0 / 3.0, vec3.cross(axpy(-1.0 / 14.0, a3, s1), a1))
    s2 = vec3.cross(plus(second, r1), plus(first, s1))
    nested = axpy(0.5, vec3.cross(s1, a2), axpy(2.0, a3, s2))
    r2 = vec3.cross(nested, axpy(1.25, s1, a1))
    even = axpy(-1.0 / 6.0, s2, axpy(-7.0 / 3.0, s1, axpy(1.0 / 12.0, a3, a1)))
    odd = axpy(63.0, r1, minus(r2, axpy(2.25, a4, scale(9.0, a2))))
    s3 = vec3.cross(odd, even)
    mean = axpy(1.0 / 12.0, a3, a1)
    return (axpy(1.0 / 360.0, s3, axpy(-7.0 / 120.0, s2, mean)),)


METHOD = lie_method(
    "magnus8",
    8,
    exponents,
    rate_calls=4,
    exponentials=1,
    limit=3.0,
    reversible=("rate",),
    summary="four Gauss nodes and six commutators; errors of 1e-6 to 1e-9, reversible",
    source="Blanes, Casas, Ros, BIT 40 (2000) 434; Phys. Rep. 470 (2009), §5.2",
)
