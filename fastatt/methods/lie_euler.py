"""Lie-Euler: the exponential of the rate at the start."""

from __future__ import annotations

from typing import Any

from fastatt.flat.formulas import scale
from fastatt.methods.lie import lie_method, turn_of_exponents


def exponents(w: Any, t: Any, h: Any) -> Any:
    return (scale(h, w(t)),)


METHOD = lie_method(
    "lie_euler",
    1,
    exponents,
    turns=turn_of_exponents,
    rate_calls=1,
    exponentials=1,
    limit=0.1,
    summary="exponential of the rate at the start; exact for a constant rate",
    source="Iserles, Munthe-Kaas, Nørsett, Zanna, Acta Numerica 9 (2000), eq. 2.4",
)
