"""Crouch-Grossman methods: exponentials of the rate at a few times within the step.

Crouch and Grossman, *Journal of Nonlinear Science* 3 (1993) 1.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

from fastatt.methods.lie_group import lie_method
from fastatt.methods.method import Method
from fastatt.tracing.formulas import Vector, dot, scale
from fastatt.tracing.graph import larger


def turns(exponents: list[Vector], rates: list[Vector], h: Any) -> Any:
    # exponents are rates times a share of the step
    return reduce(larger, [dot(u, u) for u in exponents])


def _method(
    name: str, order: int, frozen: tuple[tuple[float, float], ...], **fields: Any
) -> Method:
    """A method with exponentials; ``frozen`` has (share of the step, time in it) of each."""

    def exponents(w: Any, t: Any, h: Any) -> Any:
        return tuple(scale(share * h, w(t + node * h)) for share, node in frozen)

    n = len(frozen)
    return lie_method(name, order, exponents, turns=turns, rate_calls=n, exponentials=n, **fields)


LIE_EULER = _method(
    "lie_euler",
    1,
    ((1.0, 0.0),),
    limit=0.1,
    tried_on=(),
    summary="exponential of the rate at the start of the step; exact for a constant rate",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)
LIE_MIDPOINT = _method(
    "lie_midpoint",
    2,
    ((1.0, 0.5),),
    limit=0.7,
    reversible=("rate",),
    summary="exponential of the rate at the midpoint; exact for a constant rate, reversible",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
CG3 = _method(
    "cg3",
    3,
    ((13.0 / 51.0, 0.0), (-2.0 / 3.0, 0.75), (24.0 / 17.0, 17.0 / 24.0)),
    limit=1.8,  # of the last rotation, 24/17 |w|h
    tried_on=(),
    summary="product of exponentials of rates; historical: magnus4 is faster and more accurate",
    source="Crouch and Grossman, J. Nonlinear Sci. 3 (1993) 1",
)
