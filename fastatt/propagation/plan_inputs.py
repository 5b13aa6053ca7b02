"""The arrays that are the same in all runs of a plan."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastatt.engine.run import Fixed
from fastatt.engine.status import Status

if TYPE_CHECKING:
    from fastatt.propagation.plan import Plan

# bodies from which on it pays to look for what they have in common, and rows that are looked at
_MANY, _ROWS = 64, 1 << 16


def fixed(plan: Plan, rates: Any) -> Fixed:
    """What the bodies of a plan have whose rates, rad/s, are known, or None."""
    params = _numbers(plan)
    with np.errstate(over="ignore", invalid="ignore"):
        angles = np.multiply(0.0 if rates is None else rates, np.abs(plan.clock.steps))
    known = np.ascontiguousarray(np.atleast_1d(angles), dtype=np.float64)
    return Fixed(params, known, flags_of(plan, params))


def fixed_with_other_numbers(plan: Plan, was: Fixed) -> Fixed:
    """The same of a plan with other parameters."""
    params = _numbers(plan)
    return was._replace(params=params, flags=flags_of(plan, params))


def _numbers(plan: Plan) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.atleast_2d(plan.packed.params), dtype=np.float64)


def alike(plan: Plan, *, asked: bool) -> tuple[int, ...]:
    """Numbers of the parameters that many bodies have in common, where others are their own.

    None of a user's function if the plan may be asked for others. No bit depends on it.
    """
    params = plan.packed.params
    if params.ndim == 1 or len(params) < _MANY or plan.choice.device:
        return ()
    can_change = own_numbers(plan) if asked and plan.scene.params is not None else ()
    bits = params.view(np.int64)
    found = [k for k in range(params.shape[1]) if k not in can_change]
    for a, b in ((0, _MANY), *((a, a + _ROWS) for a in range(_MANY, len(params), _ROWS))):
        same = (bits[a:b, found] == bits[0, found]).all(axis=0)
        found = [k for k, is_alike in zip(found, same, strict=True) if is_alike]
        if not found:
            break
    return tuple(found)


def own_numbers(plan: Plan) -> range:
    """Which of the parameters are those of the scene's own function: the last of what turns it."""
    end = plan.packed.structure.turning.n_params
    return range(end - np.atleast_1d(np.asarray(plan.scene.params)).shape[-1], end)


def flags_of(plan: Plan, params: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Flags that bodies have from the start: (1,) or (N,).

    Of parameters beyond the precision's range, and of damping beyond what the method can do.
    """
    lost = (np.abs(params) > np.finfo(plan.kind).max).any(axis=-1)
    fast = plan.damped > plan.choice.method.damping_limit
    found = lost * np.uint8(Status.NON_FINITE) | fast * np.uint8(Status.STEP_TOO_LARGE)
    return np.ascontiguousarray(found, dtype=np.uint8)
