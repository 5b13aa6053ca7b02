"""Magnus-4: one exponential, two Gauss nodes and one commutator."""

from __future__ import annotations

from typing import Any

from fastatt.methods.lie_group import lie_method
from fastatt.tracing.formulas import axpy, minus, plus, scale, vec3


def exponents(w: Any, t: Any, h: Any) -> Any:
    a = w(t + 0.21132486540518713 * h)
    b = w(t + 0.7886751345948129 * h)
    # u = h (a + b)/2 + (√3/12) h² a×b; with b − a the bracket is exactly 0 for a constant rate
    bracket = vec3.cross(a, minus(b, a))
    mean = scale(0.5, plus(a, b))
    return (scale(h, axpy(0.14433756729740643 * h, bracket, mean)),)


METHOD = lie_method(
    "magnus4",
    4,
    exponents,
    rate_calls=2,
    exponentials=1,
    limit=1.8,
    reversible=("rate",),
    summary="two Gauss nodes and one commutator; the least operations of order 4, reversible",
    source="Iserles and Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983",
)
