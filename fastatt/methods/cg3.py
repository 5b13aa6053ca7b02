"""CG3: Crouch-Grossman, three exponentials."""

from __future__ import annotations

from typing import Any

from fastatt.flat.formulas import scale
from fastatt.methods.lie import lie_method, turn_of_exponents


def exponents(w: Any, t: Any, h: Any) -> Any:
    return (
        scale(13.0 / 51.0 * h, w(t)),
        scale(-2.0 / 3.0 * h, w(t + 0.75 * h)),
        scale(24.0 / 17.0 * h, w(t + 17.0 / 24.0 * h)),
    )


METHOD = lie_method(
    "cg3",
    3,
    exponents,
    turns=turn_of_exponents,
    rate_calls=3,
    exponentials=3,
    limit=1.8,  # of the last turn, 24/17 |w|h
    summary="exponentials of frozen rates, the historical alternative; magnus4 beats it in both",
    source="Crouch and Grossman, J. Nonlinear Sci. 3 (1993) 1",
)
