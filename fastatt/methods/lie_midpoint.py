"""Lie midpoint: one exponential of the rate at the middle of the step."""

from __future__ import annotations

from typing import Any

from fastatt.flat.formulas import scale
from fastatt.methods.lie import lie_method, turn_of_exponents


def exponents(w: Any, t: Any, h: Any) -> Any:
    return (scale(h, w(t + 0.5 * h)),)


METHOD = lie_method(
    "lie_midpoint",
    2,
    exponents,
    turns=turn_of_exponents,
    rate_calls=1,
    exponentials=1,
    limit=0.7,
    reversible=("rate",),
    summary="exponential of the rate at the middle; exact for a constant rate, reversible",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), §5",
)
