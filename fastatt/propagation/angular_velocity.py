"""Angular velocities from a history of attitudes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised
from fastatt.scene.time_series import derivatives


def angular_velocity(
    q: ArrayLike, dt: ArrayLike, *, frame: str = "body", order: int = 4
) -> NDArray[np.float64]:
    """Angular velocities at the times of a history of attitudes.

    The result is w = 2 q*∘q̇ along body axes, or 2 q̇∘q* along inertial axes.

    Parameters
    ----------
    q : array_like, shape (S, 4) or (S, N, 4)
        Attitudes, body to inertial, scalar first, time first. The sign of each quaternion does not
        matter.
    dt : float or array_like of shape (S - 1,)
        The interval, or the intervals, between the attitudes, s.
    frame : {"body", "inertial"}, default "body"
        Axes of the result.
    order : int, default 4
        Degree of the polynomial that is differentiated; the error falls as dt^order.

    Returns
    -------
    ndarray, shape (S, 3) or (S, N, 3)
        Angular velocities, rad/s.

    Raises
    ------
    ValueError
        If there are fewer than ``order`` + 1 attitudes, if a shape is another one, or if an
        interval is not positive or so short that the rates overflow.

    Notes
    -----
    The derivative is that of the polynomial through ``order`` + 1 neighbouring attitudes, which are
    centred except near the ends. Noise of size e in q becomes noise of the order of e/dt.

    References
    ----------
    Berrut and Trefethen, *SIAM Review* 46 (2004), equation 9.4.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> t = np.arange(9) * 0.1
    >>> q = np.stack([np.cos(t / 4), 0 * t, 0 * t, np.sin(t / 4)], axis=1)
    >>> np.allclose(fa.angular_velocity(q, 0.1), [0.0, 0.0, 0.5], atol=1e-7)
    True
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
