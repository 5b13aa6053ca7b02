"""What is called, and what is wrong with a result."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

REFUSALS = (ValueError, TypeError)


class Call(NamedTuple):
    """Something to be tried: what is called, with what, and what is wrong with its result."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    options: Mapping[str, Any]
    judge: Callable[[Any], str | None]
    names: tuple[str, ...]
    refusals: tuple[type[BaseException], ...] = REFUSALS


def floats(x: Any) -> NDArray[np.float64] | None:
    """What was given as finite floats, or None."""
    try:
        if np.ma.isMaskedArray(x) and np.ma.is_masked(x):
            return None
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = np.asarray(x)
            found = found.astype(np.float64) if found.dtype.kind in "fiu" else None
    except (TypeError, ValueError, OverflowError):
        return None
    return found if found is not None and np.isfinite(found).all() else None


# judges: what is wrong with a result, or None


def unit(q: Any, tolerance: float | None = None) -> str | None:
    if not isinstance(q, np.ndarray) or q.shape[-1:] != (4,):
        return "no array of quaternions"
    if not np.isfinite(q).all():
        return "attitudes not finite"
    with np.errstate(all="ignore"):
        far = np.abs(np.linalg.norm(q.astype(np.float64), axis=-1) - 1.0).max(initial=0.0)
    allowed = tolerance or 64.0 * float(np.finfo(q.dtype).eps)
    return f"attitudes not unit, by {far:.0e}" if far > allowed else None


def trajectory(traj: Any, *, raw: bool = False) -> str | None:
    """Every body with status 0 is finite, and its attitudes are unit, but for ``raw`` ones."""
    bodies = np.flatnonzero(traj.status == 0)
    if not bodies.size:
        return None
    q = traj.q[:, None] if traj.one_body else traj.q
    for name in ("q", "w", *[n for n in ("v", "r") if n in traj.carried]):
        x = q if name == "q" else getattr(traj, name)
        x = x[:, None] if traj.one_body and name != "q" else x
        if not np.isfinite(x[:, bodies]).all():
            return f"status 0, {name} not finite"
    return unit(q[:, bodies], 1e-2 if raw else None)
