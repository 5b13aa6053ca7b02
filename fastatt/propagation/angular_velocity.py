"""Angular velocity back from a history of attitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised
from fastatt.scene.time_series import derivatives


def angular_velocity(
    q: ArrayLike, dt: ArrayLike, *, frame: str = "body", order: int = 4
) -> NDArray[np.float64]:
    """w = 2 q*∘q̇ (body axes) or 2 q̇∘q* (inertial axes) of attitudes at instants, rad/s.

    ``q`` is (S, 4) or (S, N, 4), time first, of either sign; ``dt`` the interval or the (S − 1,)
    intervals, s. The derivative is that of the polynomial through ``order`` + 1 neighbours, centred
    where they are there (Berrut and Trefethen, SIAM Rev. 46 (2004), eq. 9.4): the error falls as
    dt^order; noise of size e in q comes out as some e/dt.

    Raises ``ValueError`` for fewer than ``order`` + 1 attitudes, other shapes, or intervals that
    are not positive or too short for the rates to be numbers.
    """
    checks.choice("frame", frame, ("body", "inertial"))
    m = checks.whole("order", order, 1) + 1
    found = checks.attitudes("q", q, "(S, 4) or (S, N, 4)")
    n = found.shape[0]
    if n < m:
        raise ValueError(f"q: has {n} attitudes; accepted with order {m - 1}: at least {m}")
    spans = checks.array("dt", dt, f"a number or ({n - 1},)")
    if spans.ndim == 0:
        scale = checks.real("dt", spans, zero=False)
        t = np.arange(n, dtype=np.float64)
    else:
        checks.refuse("dt", spans, spans <= 0.0, "intervals above 0")
        scale = float(spans.max())
        t = np.concatenate([[0.0], np.cumsum(spans / scale)])

    unit = normalised(found.astype(np.float64))
    turned = (unit[1:] * unit[:-1]).sum(axis=-1, keepdims=True) < 0.0
    sign = np.where(np.logical_xor.accumulate(turned, axis=0), -1.0, 1.0)
    unit[1:] *= sign
    with np.errstate(all="ignore"):
        qdot = derivatives(t, unit, m) / scale
        u, v = unit[..., 1:], qdot[..., 1:]
        cross = np.cross(u, v) if frame == "inertial" else np.cross(v, u)
        w = np.asarray(2.0 * (unit[..., :1] * v - qdot[..., :1] * u + cross))
    if not np.isfinite(w).all():
        raise ValueError(
            f"dt: rates over {scale} s overflow; accepted: longer, more even intervals"
        )
    return w
