"""Magnus methods: one exponential of a truncated Magnus expansion.

The bracket of right multiplication is [x, y] = −x×y.
"""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import gauss_polynomial, lie_method
from fastatt.tracing.formulas import axpy, minus, plus, scale, vec3


def fourth(w: Any, t: Any, h: Any) -> Any:
    a = w(t + 0.21132486540518713 * h)
    b = w(t + 0.7886751345948129 * h)
    # u = h (a + b)/2 + (√3/12) h² a×b; with b − a the bracket is exactly 0 for a constant rate
    bracket = vec3.cross(a, minus(b, a))
    mean = scale(0.5, plus(a, b))
    return (scale(h, axpy(0.14433756729740643 * h, bracket, mean)),)


MAGNUS4 = lie_method(
    "magnus4",
    4,
    fourth,
    rate_calls=2,
    exponentials=1,
    limit=1.8,
    reversible=("rate",),
    summary="two Gauss nodes and one commutator; the least operations of order 4, reversible",
    source="Iserles and Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983",
)


def sixth(w: Any, t: Any, h: Any) -> Any:
    w1 = w(t + 0.1127016653792583 * h)
    w2 = w(t + 0.5 * h)
    w3 = w(t + 0.8872983346207417 * h)
    a1 = scale(h, w2)
    a2 = scale(1.2909944487358056 * h, minus(w3, w1))
    a3 = scale(10.0 / 3.0 * h, axpy(-2.0, w2, plus(w1, w3)))
    c1 = vec3.cross(a2, a1)
    c2 = scale(1.0 / 60.0, vec3.cross(a1, axpy(2.0, a3, c1)))
    left = axpy(-20.0, a1, minus(c1, a3))
    bracket = vec3.cross(plus(a2, c2), left)
    return (axpy(1.0 / 240.0, bracket, axpy(1.0 / 12.0, a3, a1)),)


MAGNUS6 = lie_method(
    "magnus6",
    6,
    sixth,
    rate_calls=3,
    exponentials=1,
    limit=3.0,
    reversible=("rate",),
    summary="three Gauss nodes and nested commutators; for tight tolerances, reversible",
    source="Blanes, Casas, Oteo, Ros, Phys. Rep. 470 (2009), eq. 257",
)


def eighth(w: Any, t: Any, h: Any) -> Any:
    a1, a2, a3, a4 = gauss_polynomial(w, t, h, 4)
    first, second = axpy(1.0 / 28.0, a3, a1), axpy(3.0 / 28.0, a4, a2)
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


MAGNUS8 = lie_method(
    "magnus8",
    8,
    eighth,
    rate_calls=4,
    exponentials=1,
    limit=3.0,
    reversible=("rate",),
    summary="four Gauss nodes and six commutators; errors of 1e-6 to 1e-9, reversible",
    source="Blanes, Casas, Ros, BIT 40 (2000) 434; Phys. Rep. 470 (2009), §5.2",
)
