"""Attitudes and angular velocities between the saves of a run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rounding
from fastatt.codegen.rows import kind_of, rows
from fastatt.tracing.formulas import dot, minus, plus, quat, scale, so3

_NODES = 4
# rows that are evaluated at a time
_ROWS = 1 << 16
# rad; a larger difference of the interpolants through four saves and through two is warned of
_DOUBT = 0.1


def interpolate(
    t: ArrayLike, q: ArrayLike, w: ArrayLike, times: ArrayLike, *, invalid: str = "raise"
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Interpolate attitudes and angular velocities between the saves of a run.

    Parameters
    ----------
    t : array_like of shape (S,)
        Times of the saves, s, rising or falling; at least two.
    q : array_like of shape (S, 4) or (S, N, 4)
        Attitudes at the saves, body to inertial, scalar first, of either sign.
    w : array_like of shape (S, 3) or (S, N, 3)
        Angular velocities at the saves along body axes, rad/s.
    times : float or array_like of shape (T,)
        Times of the results, s, in any order and within ``t``.
    invalid : {"raise", "flag"}, default "raise"
        "raise" refuses values that are not finite, zero quaternions, and bodies that rotate by more
        than π between two saves. "flag" returns NaN where they enter, and does not affect other
        bodies.

    Returns
    -------
    q : ndarray of shape (T, 4) or (T, N, 4)
        Unit quaternions, without the first axis if ``times`` is a number.
    w : ndarray of shape (T, 3) or (T, N, 3)
        Angular velocities along body axes, rad/s.

    Raises
    ------
    ValueError
        If an argument does not fit. With ``invalid="raise"`` also if a body rotates by more than π
        from one save to the next, since its number of revolutions is unknown then.
    TypeError
        If an argument has the wrong type.

    Warns
    -----
    StepWarning
        If the polynomials through four and through two saves differ by more than 0.1 rad, since the
        motion then changes too fast between the saves.

    Notes
    -----
    Over an interval q = q_a∘exp(s φ)∘exp(ψ(s)), where φ = log(q_a*∘q_b) and ψ is the Hermite
    polynomial through the attitudes and the rates of the four saves around it. Its degree is 7, so
    that the error falls as the interval to the 8th power, and that of the rates as the 7th. Two
    saves give orders 4 and 3, three saves 6 and 5. At a save the result is the saved value, to
    rounding. Interpolate the parts before and after a breakpoint separately, or save at the
    required times (``save_at``).

    References
    ----------
    Error of Hermite's polynomial: Davis, *Interpolation and Approximation* (1975), theorem 3.5.1.
    Polynomials in the logarithm: Park and Ravani, *ACM Transactions on Graphics* 16 (1997) 277.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=1.0, n_steps=8, save_every=1)
    >>> q, w = fa.interpolate(run.t, run.q, run.w, 2.5)
    >>> exact, _ = fa.closed_form.free_body([1, 0, 0, 0], [0.1, 0.3, -0.2], body.inertia, 2.5)
    >>> bool(fa.angle_between(q, exact) < 1e-6)
    True
    """
    flag = checks.choice("invalid", invalid, ("raise", "flag")) == "flag"
    when, asked = _checked_times(t, times)
    count = when.size
    attitudes = checks.attitudes("q", q, f"({count}, 4) or ({count}, N, 4)", flag=flag)
    wanted = (*attitudes.shape[:-1], 3)
    rates = checks.array("w", w, str(wanted), flag=flag)
    shape = asked.shape
    kind = np.result_type(attitudes, rates)
    tails = attitudes.shape[1:-1]
    attitudes = attitudes.reshape(count, -1, 4).astype(kind, copy=False)
    rates = rates.reshape(count, -1, 3).astype(kind, copy=False)
    found = _between(when, attitudes, rates, asked.ravel(), flag=flag)
    q_out, w_out = (x.reshape(*shape, *tails, x.shape[-1]) for x in found)
    return q_out, w_out


def interpolate_states(t: ArrayLike, s: ArrayLike, times: ArrayLike) -> NDArray[Any]:
    """Interpolate user-defined states, velocities or positions between the saves of a run.

    Parameters
    ----------
    t : array_like of shape (S,)
        Times of the saves, s, rising or falling; at least two.
    s : array_like of shape (S, n) or (S, N, n)
        Numbers at the saves: ``run.s``, ``run.v`` or ``run.r``. Numbers that are not finite give
        NaN at the times that they are used for, in their own column alone.
    times : float or array_like of shape (T,)
        Times of the results, s, in any order and within ``t``.

    Returns
    -------
    ndarray of shape (T, n) or (T, N, n)
        The numbers at ``times``, without the first axis if ``times`` is a number.

    Raises
    ------
    ValueError
        If an argument does not fit.
    TypeError
        If an argument has the wrong type.

    Warns
    -----
    StepWarning
        If the polynomials through eight and through four saves differ by more than a tenth of the
        range of a column, since it then changes too fast between the saves.

    Notes
    -----
    The result is the polynomial through the eight nearest saves, four on either side where they
    exist, or through all saves if there are fewer. Its error falls as the interval to the 8th
    power. At a breakpoint a derivative jumps: interpolate the parts before and after it separately,
    or save at the required times (``save_at``).

    References
    ----------
    Error of the interpolating polynomial: Davis, *Interpolation and Approximation* (1975),
    theorem 3.1.1.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> t = np.linspace(0.0, 2.0, 21)
    >>> s = np.stack([np.sin(t), np.cos(t)], axis=1)
    >>> bool(np.abs(fa.interpolate_states(t, s, 0.33) - [np.sin(0.33), np.cos(0.33)]).max() < 1e-11)
    True
    """
    when, asked = _checked_times(t, times)
    count = when.size
    values = checks.array("s", s, f"({count}, n) or ({count}, N, n)", flag=True)
    columns = values.reshape(count, -1)
    at = asked.ravel()
    out = np.empty((at.size, columns.shape[1]), values.dtype)
    apart = np.zeros(columns.shape[1])
    step = max(1, _ROWS // columns.shape[1])
    for a in range(0, at.size, step):
        part = slice(a, a + step)
        with np.errstate(all="ignore"):
            out[part] = _polynomial(when, columns, at[part], 2 * _NODES)
            rough = _polynomial(when, columns, at[part], _NODES)
            apart = np.fmax(apart, np.abs(out[part] - rough).max(axis=0, initial=0.0))
    rounded = 1e3 * np.finfo(values.dtype).eps * np.abs(columns).max(axis=0)
    poor = np.flatnonzero(apart > 0.1 * np.ptp(columns, axis=0) + rounded)
    if poor.size:
        rounding.warn(
            f"t: saves are too far apart for {poor.size} of {apart.size} columns of s, up to "
            f"{apart[poor].max():.2g} between the polynomials through eight and four of them: save "
            "more often"
        )
    return out.reshape(*asked.shape, *values.shape[1:])


def _checked_times(t: ArrayLike, times: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """Times of saves, and times between them, checked."""
    when = checks.array("t", t, "(S,)").astype(np.float64)
    gaps = np.diff(when)
    if when.size < 2 or not ((gaps > 0.0).all() or (gaps < 0.0).all()):
        raise ValueError(f"t: found {checks.brief(when)}; accepted: two or more, rising or falling")
    asked = checks.array("times", times, "a number or (T,)").astype(np.float64)
    low, high = sorted((when[0], when[-1]))
    outside = np.flatnonzero((asked < low) | (asked > high))
    if outside.size:
        raise ValueError(
            f"times[{outside[0]}] is {asked.ravel()[outside[0]]}; accepted: {low} to {high}, "
            "the saves' span"
        )
    return when, asked


def _polynomial(
    t: NDArray[np.float64], columns: NDArray[Any], times: NDArray[np.float64], most: int
) -> NDArray[Any]:
    """The polynomial through the nearest saves, at most so many, at times within ``t``."""
    n = min(most, t.size)
    way = np.sign(t[1] - t[0])
    left = np.searchsorted(way * t, way * times, side="right") - 1
    nodes = np.clip(left - (n - 1) // 2, 0, t.size - n)[:, None] + np.arange(n)
    found = np.zeros((times.size, columns.shape[1]))
    for k in range(n):
        others = np.delete(t[nodes], k, axis=1)
        own = t[nodes[:, k]]
        weight = ((times[:, None] - others) / (own[:, None] - others)).prod(axis=1)
        # a save that is not finite has no part in the saves themselves
        found += np.where(weight[:, None] == 0.0, 0.0, weight[:, None] * columns[nodes[:, k]])
    return found


def _between(
    t: NDArray[np.float64],
    q: NDArray[Any],
    w: NDArray[Any],
    times: NDArray[np.float64],
    *,
    flag: bool,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitudes (T, N, 4) and angular velocities (T, N, 3), from checked arguments."""
    count, bodies, kind = t.size, q.shape[1], q.dtype
    way = np.sign(t[1] - t[0])
    left = np.clip(np.searchsorted(way * t, way * times, side="right") - 1, 0, count - 2)
    many = min(_NODES, count)
    first = np.clip(left - 1, 0, count - many)
    far = _far(t, w, np.unique(first[:, None] + np.arange(many - 1)), flag=flag)
    # the two ends of the interval come first
    own = left[:, None] + np.arange(2)
    around = first[:, None] + np.arange(many)
    other = around[(around != own[:, :1]) & (around != own[:, 1:])].reshape(times.size, many - 2)
    nodes = np.concatenate([own, other], axis=1)
    span = np.diff(t[own])
    at = (t[nodes] - t[own[:, :1]]) / span
    s = (times - t[own[:, 0]]) / span[:, 0]
    clock = np.concatenate(
        [s[:, None], span, at[:, 2:], _weights(at[:, :2], s), _weights(at, s)], axis=1
    ).astype(kind)
    formula = rows(
        _through,
        {
            "clock": clock.shape[1],
            **{f"q{k}": 4 for k in range(many)},
            **{f"w{k}": 3 for k in range(many)},
        },
        (4, 3, None),
        kind_of(kind),
    )
    q_out = np.empty((times.size, bodies, 4), kind)
    w_out = np.empty((times.size, bodies, 3), kind)
    doubt = np.zeros(bodies)
    step = max(1, _ROWS // bodies)
    for a in range(0, times.size, step):
        part = slice(a, a + step)
        taken = nodes[part].T
        with np.errstate(all="ignore"):
            q_out[part], w_out[part], apart = formula(
                clock[part, None], *(q[k] for k in taken), *(w[k] for k in taken)
            )
        doubt = np.fmax(doubt, apart.max(axis=0))
    q_out[:, far], w_out[:, far] = np.nan, np.nan
    poor = np.flatnonzero((doubt > _DOUBT) & ~far)
    if poor.size:
        rounding.warn(
            f"t: saves of {poor.size} of {bodies} bodies are too far apart for their motion, up to "
            f"{doubt[poor].max():.2g} rad between the polynomials through four and two of them "
            f"(body {poor[0]}): save more often"
        )
    return q_out, w_out


def _far(
    t: NDArray[np.float64], w: NDArray[Any], used: NDArray[np.intp], *, flag: bool
) -> NDArray[np.bool_]:
    """Bodies that rotate by more than π over an interval in use, (N,), unless they are refused."""
    size = np.sqrt((w.astype(np.float64) ** 2).sum(axis=-1))
    span = np.abs(t[used + 1] - t[used])[:, None]
    turn = np.fmax(size[used], size[used + 1]) * span
    far = (turn > np.pi).any(axis=0)
    if far.any() and not flag:
        k, body = np.argwhere(turn > np.pi)[0]
        raise ValueError(
            f"t: between saves {used[k]} and {used[k] + 1} body {body} rotates by "
            f"{turn[k, body]:.3g} rad ({np.count_nonzero(far)} of {far.size} bodies); accepted: at "
            "most π, with saves "
            f'{np.pi / turn[k, body] * span[k, 0]:.3g} s apart; invalid="flag" leaves them out'
        )
    return np.asarray(far)


def _weights(nodes: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (T, 4 n) at s: of the values and slopes at n nodes, then those of the derivative."""
    n = nodes.shape[1]
    gaps = nodes[:, :, None] - nodes[:, None, :]
    ahead = (s[:, None] - nodes)[:, None, :] + np.zeros((n, 1))
    itself = np.arange(n)
    gaps[:, itself, itself] = 1.0
    ratio = ahead / gaps
    ratio[:, itself, itself] = 1.0
    lagrange = ratio.prod(axis=2)
    slope = np.zeros_like(lagrange)
    for k in range(n):
        rest = ratio.copy()
        rest[:, :, k] = 1.0 / gaps[:, :, k]
        rest[:, k, :] = 0.0
        slope += rest.prod(axis=2)
    inverse = 1.0 / gaps
    inverse[:, itself, itself] = 0.0
    c, x = inverse.sum(axis=2), s[:, None] - nodes
    square, double = lagrange**2, 2.0 * lagrange * slope
    value = 1.0 - 2.0 * x * c
    return np.concatenate(
        [value * square, x * square, value * double - 2.0 * c * square, square + x * double], axis=1
    )


def _through(clock: Any, *saves: Any) -> Any:
    """(q, w, difference from the cubic through two saves), from n attitudes and n rates."""
    n = len(saves) // 2
    q, w = saves[:n], saves[n:]
    s, h, at = clock[0], clock[1], clock[2:n]
    two, all_of = clock[n : n + 8], clock[n + 8 :]
    phi = quat.log(quat.mul(quat.conj(q[0]), quat.normalise(q[1])))

    def slope(psi: Any, rate: Any) -> Any:
        seen = quat.rotate_inverse(quat.exp(psi), phi)
        return so3.dexpinv(psi, minus(scale(h, rate), seen))

    start = quat.normalise(q[0])
    values, slopes = [], [minus(scale(h, x), phi) for x in w[:2]]
    for k, x, rate in zip(at, q[2:], w[2:], strict=True):
        reference = quat.mul(start, quat.exp(scale(k, phi)))
        psi = quat.log(quat.mul(quat.conj(reference), quat.normalise(x)))
        values.append(psi)
        slopes.append(slope(psi, rate))

    def at_s(weights: Any, m: int) -> Any:
        terms = [scale(b, x) for b, x in zip(weights[m : 2 * m], slopes[:m], strict=True)]
        terms += [scale(a, x) for a, x in zip(weights[2:m], values[: m - 2], strict=True)]
        return plus(*terms)

    psi, change = at_s(all_of, n), at_s(all_of[2 * n :], n)
    turn = quat.exp(psi)
    rate = plus(quat.rotate_inverse(turn, phi), so3.dexp(psi, change))
    apart = minus(psi, at_s(two, 2))
    attitude = quat.normalise(quat.mul(quat.mul(start, quat.exp(scale(s, phi))), turn))
    return attitude, tuple(x / h for x in rate), dot(apart, apart) ** 0.5
