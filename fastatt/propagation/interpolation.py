"""Attitudes, angular velocities and what a run carries, between its saves."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rounding
from fastatt.arrays import make_continuous, quat_multiply
from fastatt.attitudes import QUATERNION
from fastatt.codegen.rows import precision_of, rows
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.law import AT_CROSSINGS
from fastatt.tracing.formulas import dot, minus, plus, quat, scale, so3

_NODES = 4
# rows that are evaluated at a time
_ROWS = 1 << 16
# rounding of the ends of a run, as a share of its times
_SLACK = 16.0 * float(np.finfo(np.float64).eps)
# times of saves that do not exist: so far away that the other weights are those without them
_NOWHERE = 1e60
# saves that give the rate of an attitude, and the half-angle from one to the next, at most
_NEIGHBOURS, _TURN = 5, 0.25 * math.pi
# rad; a larger difference of the interpolants through four saves and through two is warned of
_DOUBT = 0.1


@overload
def interpolate(run: Trajectory, times: ArrayLike, /) -> Trajectory: ...


@overload
def interpolate(run: Trajectory, /, *, times: ArrayLike) -> Trajectory: ...


@overload
def interpolate(
    t: ArrayLike, q: ArrayLike, w: ArrayLike | None = ..., times: ArrayLike | None = ...
) -> tuple[NDArray[Any], NDArray[Any]]: ...


def interpolate(
    t: Any, q: Any = None, w: Any = None, times: Any = None
) -> Trajectory | tuple[NDArray[Any], NDArray[Any]]:
    """Interpolate a run between its saves: ``interpolate(run, times)``.

    ``interpolate(t, q, w, times)`` interpolates attitudes and angular velocities from elsewhere,
    ``interpolate(t, q, None, times)`` attitudes alone, and ``interpolate(t, q)`` gives their rates.

    Parameters
    ----------
    t : Trajectory or array_like of shape (S,)
        A run, followed by ``times`` alone; or the times of the saves, s, rising or falling; at
        least two.
    q : array_like of shape (S, 4) or (S, N, 4)
        Attitudes at the saves, body to inertial, scalar first, of either sign.
    w : array_like of shape (S, 3) or (S, N, 3), optional
        Angular velocities at the saves along body axes, rad/s. Without them they are those of
        polynomials through the rotation vectors from each attitude to its nearest neighbours, five
        saves in all, whose error falls as the interval to the 4th power. Attitudes should then
        rotate by at most π/2 from one to the next.
    times : float or array_like of shape (T,)
        Times of the results, s, in any order and within those of the saves; of attitudes without
        ``w`` those of the saves, if there are none.

    Returns
    -------
    run : Trajectory
        Of a run: the attitudes as quaternions, and the angular velocities, velocities, positions
        and states that it has, at ``times``, of which a number is one save. ``norm_error`` is that
        of the save before each time.
    q : ndarray of shape (T, 4) or (T, N, 4)
        Of arrays: unit quaternions, without the first axis if ``times`` is a number.
    w : ndarray of shape (T, 3) or (T, N, 3)
        Of arrays: angular velocities along body axes, rad/s.

    Raises
    ------
    ValueError
        If an argument does not fit.
    TypeError
        If an argument has the wrong type.

    Warns
    -----
    StepWarning
        Of bodies that rotate by more than π from one save to the next, whose number of revolutions
        is unknown, and of those that a terminal event has stopped: their results are NaN. Also if
        the polynomials through four and through two saves differ by more than 0.1 rad, or those
        through eight and through four saves of a velocity, position or state by more than a tenth
        of its range, since it then changes too fast between the saves; and if a breakpoint or a
        sample time lies between two saves.

    Notes
    -----
    Over an interval q = q_a∘exp(s φ)∘exp(ψ(s)), where φ = log(q_a*∘q_b) and ψ is the Hermite
    polynomial through the attitudes and the rates of the four saves around it. Its degree is 7, so
    that the error falls as the interval to the 8th power, and that of the rates as the 7th. Two
    saves give orders 4 and 3, three saves 6 and 5. At a save the result is the saved value, to
    rounding. A prescribed rate is evaluated at ``times``. Of saves that nearly coincide, those that
    do not bound the interval are left out, since polynomials would magnify rounding and noise.

    Velocities, positions and states are polynomials through the eight nearest saves, four on either
    side where they exist, or through all saves if there are fewer, of order 8.

    At breakpoints and sample times a derivative jumps. The polynomials of a run therefore use the
    saves between two of them only, and what controllers hold is what a save in the same interval
    has. If there is no save at such a time, a warning tells so: save there too (``save_at``). Of
    arrays such times are unknown: interpolate the parts before and after them separately.

    References
    ----------
    Errors of the polynomials: Davis, *Interpolation and Approximation* (1975), theorems 3.1.1 and
    3.5.1. Polynomials in the logarithm: Park and Ravani, *ACM Transactions on Graphics* 16 (1997)
    277.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=1.0, n_steps=8, save_every=1)
    >>> between = fa.interpolate(run, [2.5, 7.25])
    >>> exact, _ = fa.closed_form.free_body([1, 0, 0, 0], [0.1, 0.3, -0.2], body.inertia, between.t)
    >>> bool(fa.angle_between(between.q, exact).max() < 1e-6)
    True
    >>> q, w = fa.interpolate(run.t, run.q, run.w, 2.5)
    >>> q.shape, w.shape
    ((4,), (3,))
    """
    if isinstance(t, Trajectory):
        if w is not None or (q is not None and times is not None):
            raise TypeError("q, w: found with a run; accepted: interpolate(run, times)")
        return _run_between(t, q if times is None else times)
    when, asked = _checked_times(t, t if times is None and w is None else times)
    if w is None:
        w = _rates_of(when, q)
    motion = _between(_Saves.of(when, np.zeros(0)), q, w, asked.ravel())
    q_out, w_out = (x.reshape(*asked.shape, *x.shape[1:]) for x in motion)
    return q_out, w_out


def _rates_of(t: NDArray[np.float64], q: ArrayLike) -> NDArray[np.float64]:
    """Angular velocities at saves of attitudes, (S, 3) or (S, N, 3), rad/s along body axes.

    At its own save the slope of a rotation vector is the angular velocity.
    """
    q = checks.attitudes("q", q, f"({t.size}, 4) or ({t.size}, N, 4)").astype(np.float64)
    turns = (q[1:] * q[:-1]).sum(axis=-1, keepdims=True)
    fast = np.argwhere(np.abs(turns[..., 0]) < math.cos(_TURN))
    if len(fast):
        rounding.warn(
            f"q: found a rotation by more than π/2 from save {fast[0, 0]} to the next, between "
            "which the rates of attitudes are uncertain: give w, or save more often"
        )
    q = make_continuous(q)  # so that rotation vectors may exceed π
    n = min(_NEIGHBOURS, t.size)
    nodes = np.clip(np.arange(t.size) - n // 2, 0, t.size - n)[:, None] + np.arange(n)
    gaps = t[:, None] - t[nodes]
    gaps[gaps == 0.0] = 1.0
    rates = np.zeros((*q.shape[:-1], 3))
    for k in range(n):
        others = np.delete(nodes, k, axis=1)
        apart = (t[nodes[:, k], None] - t[others]).prod(axis=1)
        weight = np.delete(gaps, k, axis=1).prod(axis=1) / apart
        weight = np.where(nodes[:, k] == np.arange(t.size), 0.0, weight)
        turn = quat_multiply(q * (1.0, -1.0, -1.0, -1.0), q[nodes[:, k]])
        size = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
        angle = 2.0 * np.arctan2(size, turn[..., :1])
        vector = turn[..., 1:] * np.where(size > 0.0, angle / np.where(size > 0.0, size, 1.0), 2.0)
        rates += weight.reshape(-1, *[1] * (q.ndim - 1)) * vector
    return rates


def _run_between(run: Trajectory, times: ArrayLike) -> Trajectory:
    """A run at times between its saves."""
    if AT_CROSSINGS in run.divisions.clocks:
        raise ValueError(
            "run: found one of a scene with a Switch, at whose crossings polynomials do not hold; "
            "accepted: a run with save_at= at these times"
        )
    when, asked = _checked_times(run.t, times)
    asked = np.atleast_1d(asked)
    many = (when.size, run.status.size)
    saves = _Saves.of(when, run.divisions.every(when))
    saves.warn(asked)
    motion = _between(saves, run.q.reshape(*many, 4), run.w.reshape(*many, 3), asked, lost=True)
    carried = {
        name: _columns_between(name, saves, values, asked)
        for name, values in run.carried.items()
        if name not in ("w", "s")
    }
    if "s" in run.carried:
        carried["s"] = _states_between(run, saves, asked)
    # a prescribed rate is known at any time, unless the run was pickled
    if run.packed is None or "w" in run.carried:
        carried["w"] = motion[1]
    if run.first_crossings is not None:
        stopped = np.isfinite(run.first_crossings[:, run.terminal]).any(axis=1)
        for values in (motion[0], *carried.values()):
            values[:, stopped] = np.nan
        if stopped.any():
            rounding.warn(
                f"run: terminal events stopped {np.count_nonzero(stopped)} of {stopped.size} "
                f"bodies (body {stopped.argmax()}), whose results are NaN"
            )
    before = np.searchsorted(saves.way * when, saves.way * asked, side="right") - 1
    return replace(
        run, t=asked, state=motion[0], norm_error=run.norm_error[before], attitude=QUATERNION,
        carried=carried, end=None, crossing_numbers={}, located=(),
    )  # fmt: skip


class _Saves(NamedTuple):
    """Times of saves (S,), and how many divisions of the run lie before and until each."""

    t: NDArray[np.float64]
    before: NDArray[np.intp]
    until: NDArray[np.intp]

    @classmethod
    def of(cls, t: NDArray[np.float64], divisions: NDArray[np.float64]) -> _Saves:
        """Saves among the times at which steps were divided."""
        way, slack = np.sign(t[1] - t[0]), _SLACK * np.abs(t).max()
        edges, rising = np.sort(way * divisions), way * t
        before, until = (np.searchsorted(edges, rising + x) for x in (-slack, slack))
        return cls(t, before, until)

    @property
    def way(self) -> Any:
        """1 if times rise, -1 if they fall."""
        return np.sign(self.t[1] - self.t[0])

    def left(self, times: NDArray[np.float64]) -> NDArray[np.intp]:
        """The saves at which the intervals that contain some times begin, (T,)."""
        left = np.searchsorted(self.way * self.t, self.way * times, side="right") - 1
        return np.asarray(np.clip(left, 0, self.t.size - 2))

    def piece(self, left: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The first and the last save (T,) that no division separates from an interval.

        They are the two ends of an interval that is divided itself.
        """
        of_interval, is_whole = self.until[left], self.until[left] >= self.before[left + 1]
        first = np.searchsorted(self.until, of_interval)
        last = np.searchsorted(self.before, of_interval, side="right") - 1
        return np.where(is_whole, first, left), np.where(is_whole, last, left + 1)

    def warn(self, times: NDArray[np.float64]) -> None:
        """Warn of times in intervals that are divided."""
        left = self.left(times)
        is_between = (times != self.t[left]) & (times != self.t[left + 1])
        divided = np.unique(left[is_between & (self.until[left] < self.before[left + 1])])
        if divided.size:
            k = divided[0]
            rounding.warn(
                f"t: {divided.size} intervals between saves contain a breakpoint or a sample time, "
                f"the first from {self.t[k]:.9g} to {self.t[k + 1]:.9g} s, where the polynomials "
                "are less accurate: save there too (save_at=)"
            )


def _states_between(run: Trajectory, saves: _Saves, times: NDArray[np.float64]) -> NDArray[Any]:
    """States (S, N, n) of a run at times (T,); what controllers hold is not interpolated."""
    values = run.carried["s"]
    clocks = run.divisions.clocks or (None,) * values.shape[-1]
    states = np.full((times.size, *values.shape[1:]), np.nan, values.dtype)
    for clock in dict.fromkeys(clocks):
        columns = [k for k, x in enumerate(clocks) if x == clock]
        if clock is None:
            states[..., columns] = _columns_between("s", saves, values[..., columns], times)
            continue
        slack, samples = _SLACK * np.abs(saves.t).max(), run.divisions.samples(clock, saves.t)
        interval, of_saves = (np.searchsorted(samples, x - slack) for x in (times, saves.t))
        # a save at a sample time holds what was held until then
        after = np.minimum(np.searchsorted(saves.t, times - slack), saves.t.size - 1)
        lost = np.ones(times.size, np.bool_)
        for save in (np.maximum(after - 1, 0), after):
            same = of_saves[save] == interval
            states[np.ix_(same, range(values.shape[1]), columns)] = values[save[same]][..., columns]
            lost &= ~same
        if lost.any():
            rounding.warn(
                f"times: {np.count_nonzero(lost)} of {times.size} times, the first "
                f"{times[lost][0]:.9g} s, lie between two sample times without a save: what is "
                "held there is unknown, and NaN: save there too (save_at=)"
            )
    return states


def _columns_between(
    name: str, saves: _Saves, values: NDArray[Any], times: NDArray[np.float64]
) -> NDArray[Any]:
    """Numbers (S, N, n) of a run at times (T,), each column by itself."""
    t = saves.t
    columns = values.reshape(t.size, -1)
    out = np.empty((times.size, columns.shape[1]), values.dtype)
    apart = np.zeros(columns.shape[1])
    step = max(1, _ROWS // columns.shape[1])
    for a in range(0, times.size, step):
        part = slice(a, a + step)
        with np.errstate(all="ignore"):
            out[part] = _polynomial(saves, columns, times[part], 2 * _NODES)
            rough = _polynomial(saves, columns, times[part], _NODES)
            apart = np.fmax(apart, np.abs(out[part] - rough).max(axis=0, initial=0.0))
    rounded = 1e3 * np.finfo(values.dtype).eps * np.abs(columns).max(axis=0)
    poor = np.flatnonzero(apart > 0.1 * np.ptp(columns, axis=0) + rounded)
    if poor.size:
        rounding.warn(
            f"t: saves are too far apart for {poor.size} of {apart.size} columns of {name}, up to "
            f"{apart[poor].max():.2g} between the polynomials through eight and four of them: save "
            "more often"
        )
    return out.reshape(times.size, *values.shape[1:])


def _checked_times(t: ArrayLike, times: ArrayLike) -> tuple[NDArray[Any], NDArray[Any]]:
    """Times of saves, and times between them, checked."""
    when = checks.array("t", t, "(S,)").astype(np.float64)
    gaps = np.diff(when)
    if when.size < 2 or not ((gaps > 0.0).all() or (gaps < 0.0).all()):
        raise ValueError(f"t: found {checks.brief(when)}; accepted: two or more, rising or falling")
    asked = checks.array("times", times, "a number or (T,)").astype(np.float64)
    low, high = sorted((when[0], when[-1]))
    slack = _SLACK * max(abs(low), abs(high))
    outside = np.flatnonzero((asked < low - slack) | (asked > high + slack))
    if outside.size:
        raise ValueError(
            f"times[{outside[0]}] is {asked.ravel()[outside[0]]}; accepted: {low} to {high}, "
            "the saves' span"
        )
    return when, asked


def _polynomial(
    saves: _Saves, columns: NDArray[Any], times: NDArray[np.float64], most: int
) -> NDArray[Any]:
    """The polynomial through the nearest saves, at most so many, at times within ``t``."""
    n = min(most, saves.t.size)
    nodes, places, _ = _around(saves, times, n)
    total = np.zeros((times.size, columns.shape[1]))
    for k in range(n):
        others, itself = np.delete(places, k, axis=1), places[:, k]
        weight = ((times[:, None] - others) / (itself[:, None] - others)).prod(axis=1)
        # a save that is not finite has no part in the saves themselves
        total += np.where(weight[:, None] == 0.0, 0.0, weight[:, None] * columns[nodes[:, k]])
    return total


def _around(
    saves: _Saves, times: NDArray[np.float64], n: int
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.bool_]]:
    """Indices and times (T, n) of saves around times, the two next to them first; which exist.

    A polynomial through saves that nearly coincide magnifies noise and rounding. Each save outside
    the interval is therefore at least half of the interval, and a tenth of its distance from the
    interval, away from the one before. Saves beyond a division of the run do not exist. The index
    of a save that does not exist has no meaning.
    """
    t, rising, left = saves.t, saves.way * saves.t, saves.left(times)
    start, end = rising[left], rising[left + 1]
    below, above = [left], [left + 1]
    for _ in range(n - 2):
        edge = rising[np.maximum(below[-1], 0)]
        next_ = edge - np.maximum(0.5 * (end - start), 0.1 * (start - edge))
        below.append(np.minimum(np.searchsorted(rising, next_, side="right"), below[-1]) - 1)
        edge = rising[np.minimum(above[-1], t.size - 1)]
        next_ = edge + np.maximum(0.5 * (end - start), 0.1 * (edge - end))
        above.append(np.maximum(np.searchsorted(rising, next_), above[-1] + 1))
    every = np.stack([*below[::-1], *above], axis=1)
    first, last = saves.piece(left)
    exist = (every >= first[:, None]) & (every <= last[:, None])
    under, over = exist[:, : n - 2].sum(axis=1), exist[:, n:].sum(axis=1)
    begin = n - 2 - np.minimum(np.maximum((n - 1) // 2, n - 2 - over), under)
    chosen = begin[:, None] + np.arange(n)
    is_other = (chosen != n - 2) & (chosen != n - 1)
    chosen = np.take_along_axis(chosen, np.argsort(is_other, axis=1, kind="stable"), axis=1)
    exist = np.take_along_axis(exist, chosen, axis=1)
    nodes = np.where(exist, np.take_along_axis(every, chosen, axis=1), left[:, None])
    return nodes, np.where(exist, t[nodes], _NOWHERE * (1.0 + np.arange(n))), exist


def _between(
    saves: _Saves, q: ArrayLike, w: ArrayLike, times: NDArray[np.float64], *, lost: bool = False
) -> tuple[NDArray[Any], NDArray[Any]]:  # fmt: skip
    """Attitudes (T, 4) or (T, N, 4), and angular velocities in the same shape, at times (T,).

    Bodies may be ``lost``, with values that are not finite.
    """
    t = saves.t
    attitudes = checks.attitudes("q", q, f"({t.size}, 4) or ({t.size}, N, 4)", flag=lost)
    rates = checks.array("w", w, str((*attitudes.shape[:-1], 3)), flag=lost)
    dtype, many = np.result_type(attitudes, rates), min(_NODES, t.size)
    q, w = (
        x.reshape(t.size, -1, x.shape[-1]).astype(dtype, copy=False) for x in (attitudes, rates)
    )
    bodies = q.shape[1]
    nodes, places, exist = _around(saves, times, many)
    last = np.where(exist, nodes, 0).max(axis=1, keepdims=True)
    far = _far(t, w, np.unique(nodes[exist & (nodes != last)]))
    start = t[nodes[:, :1]]
    span = np.diff(t[nodes[:, :2]])
    shares = (places - start) / span
    s = (times[:, None] - start) / span
    others = np.where(exist, shares, 0.0)[:, 2:]
    weights = _weights(shares[:, :2], s), _weights(shares, s)
    clock = np.concatenate([s, span, others, *weights], axis=1).astype(dtype)
    sizes = {f"{group}{k}": n for group, n in (("q", 4), ("w", 3)) for k in range(many)}
    formula = rows(_through, {"clock": clock.shape[1], **sizes}, (4, 3, None), precision_of(dtype))
    q_out = np.empty((times.size, bodies, 4), dtype)
    w_out = np.empty((times.size, bodies, 3), dtype)
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
    shape = (times.size, *attitudes.shape[1:-1])
    return q_out.reshape(*shape, 4), w_out.reshape(*shape, 3)


def _far(t: NDArray[np.float64], w: NDArray[Any], used: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Bodies that rotate by more than π over an interval in use, (N,)."""
    with np.errstate(over="ignore"):
        size = np.sqrt((w.astype(np.float64) ** 2).sum(axis=-1))
    span = np.abs(t[used + 1] - t[used])[:, None]
    turn = np.fmax(size[used], size[used + 1]) * span
    far = (turn > np.pi).any(axis=0)
    if far.any():
        k, body = np.argwhere(turn > np.pi)[0]
        rounding.warn(
            f"t: {np.count_nonzero(far)} of {far.size} bodies rotate by more than π between two "
            f"saves (body {body} by {turn[k, body]:.3g} rad after save {used[k]}), so that their "
            f"results are NaN: save every {np.pi / turn[k, body] * span[k, 0]:.3g} s"
        )
    return np.asarray(far)


def _weights(nodes: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (T, 4 n) at s: of the values and slopes at n nodes, then those of the derivative."""
    n = nodes.shape[1]
    gaps = nodes[:, :, None] - nodes[:, None, :]
    ahead = (s - nodes)[:, None, :] + np.zeros((n, 1))
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
    c, x = inverse.sum(axis=2), s - nodes
    square, double = lagrange**2, 2.0 * lagrange * slope
    value = 1.0 - 2.0 * x * c
    return np.concatenate(
        [value * square, x * square, value * double - 2.0 * c * square, square + x * double], axis=1
    )


def _through(clock: Any, *saves: Any) -> Any:
    """(q, w, difference from the cubic through two saves), from n attitudes and n rates."""
    n = len(saves) // 2
    q, w = saves[:n], saves[n:]
    s, h, shares = clock[0], clock[1], clock[2:n]
    two, all_of = clock[n : n + 8], clock[n + 8 :]
    phi = quat.log(quat.mul(quat.conj(q[0]), quat.normalise(q[1])))

    def slope(psi: Any, rate: Any) -> Any:
        seen = quat.rotate_inverse(quat.exp(psi), phi)
        return so3.dexpinv(psi, minus(scale(h, rate), seen))

    start = quat.normalise(q[0])
    values, slopes = [], [minus(scale(h, x), phi) for x in w[:2]]
    for k, x, rate in zip(shares, q[2:], w[2:], strict=True):
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
