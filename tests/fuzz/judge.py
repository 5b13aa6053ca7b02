"""What is called, and what is wrong with a result."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fastatt as fa

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


def _same_angle(traj: Any, q0: Any, w: Any, steps: int, inertial: bool) -> str | None:
    """Of a constant rate: the closed form, where its argument is well-conditioned."""
    start, rate = floats(q0), floats(w)
    if start is None or rate is None or not (traj.status == 0).any():
        return None
    start, rate = np.atleast_2d(start), np.atleast_2d(rate)
    with np.errstate(all="ignore"):
        turn = rate * (traj.dt * steps)
        sane = (np.abs(turn) < 1e3).all() & (np.abs(start).max(-1) > 1e-30).all()
        sane &= (np.abs(start) < 1e30).all()
        if not sane:
            return None
        half = 0.5 * np.linalg.norm(turn, axis=-1, keepdims=True)
        u = np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * turn], axis=-1)
    q0 = start / np.linalg.norm(start, axis=-1, keepdims=True)
    right = fa.quat_multiply(u, q0) if inertial else fa.quat_multiply(q0, u)
    q = np.atleast_2d(traj.q[-1])
    off = np.asarray(fa.angle_between(q.astype(np.float64), right))
    off = off[np.broadcast_to(traj.status == 0, off.shape)].max(initial=0.0)
    allowed = 1e-10 if q.dtype == np.float64 else 3e-3
    if traj.method != "magnus4":
        allowed = 0.3
    return f"status 0, wrong by {off:.0e} rad" if off > allowed else None


def _free_invariants(q: Any, w: Any, moments: Any, ok: Any) -> str | None:
    """|I w| and energy are those of the start: (S, N, 3)."""
    with np.errstate(all="ignore"):
        m = w.astype(np.longdouble) * moments
        for name, x in (("energy", (m * w).sum(-1)), ("momentum", (m * m).sum(-1))):
            far = np.abs(x - x[:1])[:, ok] > 0.05 * np.abs(x[:1])[:, ok]
            if far.any():
                return f"status 0, {name} changed"
    return None


def anything(result: Any) -> str | None:
    return None
