"""The record of a method for gyro samples."""

from __future__ import annotations

import math
from typing import Any

from fastatt.methods.method import Method
from fastatt.methods.windows import Window


def sampled_method(
    window: Window,
    *,
    order: int,
    of_rates: float = math.inf,
    of_increments: float = math.inf,
    **others: Any,
) -> Method:
    """Record of a method for samples, with its largest angle over an interval, rad."""
    kinds = {"sampled rates": False, "increments": True}
    return Method(
        window=window,
        order=order,
        scenes=tuple(name for name, increments in kinds.items() if window.takes(increments)),
        conserves=("norm",),
        rate_calls=1,
        exponentials=1,
        limits={"rates": of_rates, "increments": of_increments},
        **others,
    )
