"""The arrays that are the same in all runs of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.status import Status

if TYPE_CHECKING:
    from fastatt.running.plan import Plan


def fixed(plan: Plan, rates: Any, h: Any, rows_each: int) -> dict[str, NDArray[Any]]:
    """Parameters, turns a step that are known by rates, flags and stages, by names.

    ``rows_each`` rows share a body's.
    """

    def rows(x: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(x, rows_each, axis=0) if rows_each > 1 and len(x) > 1 else x

    params = np.ascontiguousarray(np.atleast_2d(plan.packed.params))
    with np.errstate(over="ignore", invalid="ignore"):
        turns = np.atleast_1d(np.multiply(0.0 if rates is None else rates, np.abs(h)))
    found: dict[str, Any] = {"p": params, "known": turns, "flags": flags_of(plan, params)}
    stages = np.array(plan.choice.method.stages, dtype=np.float64).reshape(-1, 3)
    return {"stages": stages, **{name: rows(x) for name, x in found.items()}}


def flags_of(plan: Plan, params: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Flags that bodies have from the start: (1,) or (N,).

    Of parameters beyond the precision's range, and of damping beyond what the method can do.
    """
    lost = (np.abs(params) > np.finfo(plan.kind).max).any(axis=-1)
    fast = plan.damped > plan.choice.method.damping_limit
    found = lost * np.uint8(Status.NON_FINITE) | fast * np.uint8(Status.STEP_TOO_LARGE)
    return np.ascontiguousarray(found, dtype=np.uint8)
