"""Closed forms at any times, of free bodies and tops: no error that grows but that of |w| t."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.propagation.closed_forms import (
    FREE_BODY,
    SYMMETRIC_TOP,
    BodySolution,
    Evaluation,
    check_above_zero,
    heavy_top_form,
    rows,
    turned,
)
from fastatt.scene.inertia import EQUAL, is_symmetric, principal, refuse
from fastatt.threads import number_of

#: what is done with numbers of a body that are not finite
INVALID = ("raise", "flag")


def free_body(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitude and angular velocity of bodies without torque, at any times, in closed form.

    Errors are at most 1e-15 (1 + |w| t) rad and as much in relation to |w| for principal moments;
    near the separatrix too, where the given numbers are taken as exact.

    Parameters
    ----------
    q0 : (4,) or (N, 4), attitudes at t = 0, body to inertial, scalar first, of any length but zero.
    w0 : (3,) or (N, 3), angular velocities at t = 0, body axes, rad/s.
    inertia : principal moments (3,) or (N, 3) in any order, or tensors (3, 3) or (N, 3, 3), kg·m².
    t : time or times (T,), s, in any order and of either sign.
    allow_unphysical : admit inertia that no body has, of moments above 0.
    dtype : float64 or float32 (errors 1e9 times as large, less time; turning within 1e-17 rad
        of the intermediate axis stays there); None takes float32 when ``q0`` and ``w0`` are float32
        arrays, else float64.
    n_threads : None takes every processor that this process may use; results do not depend on it.
    invalid : "raise" refuses ``q0`` and ``w0`` that are not finite, and a zero quaternion; "flag"
        gives NaN for such bodies alone.

    Warns
    -----
    StepWarning : where |w| t is so large that half the digits of the precision are lost.

    Returns
    -------
    q, w : (4,), (3,) of one body at one time, (N, 4), (N, 3) of an ensemble; times come first:
        (T, 4), (T, 3) and (T, N, 4), (T, N, 3).

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.
    """
    options = dtype, n_threads, invalid
    body = principal(inertia, allow_unphysical=allow_unphysical)
    check_above_zero(body)
    return _at_times(BodySolution(FREE_BODY, body), q0, w0, t, options)


def symmetric_top(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Regular precession of bodies with two equal moments: ``free_body`` with two exponentials.

    q(t) = exp(L t/A)∘q0∘exp(e (1/C − 1/A) m·e t) with L in inertial axes, e the axis of symmetry,
    C the moment about it and A the other two, equal to 1e-12 of the largest (their mean counts).
    Arguments and results are those of :func:`free_body`.

    Raises ``ValueError`` where no two moments are equal, and as ``free_body`` does.
    """
    options = dtype, n_threads, invalid
    body = principal(inertia, allow_unphysical=allow_unphysical)
    check_above_zero(body)
    refuse(
        body.moments,
        ~is_symmetric(body.moments),
        f"no two moments are equal to {EQUAL:g} of the largest",
        "a symmetric body, or free_body for any other",
    )
    return _at_times(BodySolution(SYMMETRIC_TOP, body), q0, w0, t, options)


def heavy_top(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    arm: ArrayLike,
    weight: ArrayLike,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    invalid: str = "raise",
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Heavy symmetric tops, the torque of ``torques.HeavyTop``, at any times, in closed form.

    Errors are at most 1e-15 (1 + W t) rad and as much in relation to W, and what the motion
    makes of the rounding of q0 and w0; W² = |w0|² + 4 weight |arm|/A. Lagrange's top as Klein and
    Sommerfeld solve it, by a theta quotient for each Cayley-Klein parameter (*The Theory of the
    Top*, 1897-1910).

    Parameters
    ----------
    q0, w0, t, allow_unphysical, dtype, n_threads, invalid : as of :func:`free_body`.
    inertia : principal moments (3,) or (N, 3), or tensors, about the fixed point, kg·m². Those
        about two axes normal to the arm are equal, to 1e-12 of the largest (their mean counts).
    arm : (3,) or (N, 3), from the fixed point to the centre of mass, body axes, m.
    weight : a number or (N,), along −z of inertial axes, N.

    Returns
    -------
    q, w : as of :func:`free_body`.

    Raises
    ------
    ValueError, TypeError : an argument that does not fit, by name, with what is accepted.

    Examples
    --------
    >>> import fastatt as fa
    >>> q, w = fa.closed_form.heavy_top(
    ...     [1, 0, 0, 0], [0.1, 0, 30], (1.0, 1.0, 0.5), 10.0, arm=(0, 0, 0.1), weight=10.0
    ... )
    """
    body = principal(inertia, allow_unphysical=allow_unphysical)
    arms = checks.array("arm", arm, "(3,) or (N, 3)", [(3,), (-1, 3)]).astype(np.float64)
    weights = checks.array("weight", weight, "a number or (N,)").astype(np.float64)
    _same_rows({"arm": arms, "weight": weights[..., None], "inertia": body.moments})
    form = heavy_top_form(body, (arms, weights[..., None] * (0.0, 0.0, 1.0)))
    return _at_times(form, q0, w0, t, (dtype, n_threads, invalid))


def _same_rows(given: dict[str, NDArray[Any]]) -> int | None:
    """How many bodies there are, None where nothing has rows; refuses other numbers but one."""
    rows = {name: len(x) for name, x in given.items() if x.ndim == 2}
    first = next((name for name, n in rows.items() if n > 1), "")
    for name, n in rows.items():
        if n not in (1, rows.get(first, 1)):
            raise ValueError(f"{name}: has {n} rows; accepted: one, or {rows[first]} as of {first}")
    return rows.get(first, 1 if rows else None)


def _at_times(
    form: BodySolution, q0: ArrayLike, w0: ArrayLike, t: ArrayLike, options: tuple[Any, Any, str]
) -> tuple[NDArray[Any], NDArray[Any]]:
    dtype, n_threads, invalid = options
    precision = checks.precision(dtype, q0, w0)
    flag = checks.choice("invalid", invalid, INVALID) == "flag"
    start = checks.attitudes("q0", q0, flag=flag)
    rates = checks.array("w0", w0, "(3,) or (N, 3)", flag=flag)
    times = checks.array("t", t, "a number or (T,)")
    threads = number_of(n_threads)
    pull = np.zeros(3) if form.pull is None else form.pull
    n = _same_rows({"q0": start, "w0": rates, "inertia": form.body.moments, "arm, weight": pull})
    if text := rounding.of_angles(turned(rates, times, form.gain), precision):
        rounding.warn(f"t: found turns of {text}")
    flat = np.require(times.reshape(-1), precision, ["C", "A"])
    size = flat.size, n or 1
    q, w = np.empty((*size, 4), precision), np.empty((*size, 3), precision)
    motion = Evaluation(form, precision, size)
    motion.fill((rows(start, precision), rows(rates, precision)), flat, (q, w), threads)
    shape = times.shape if n is None else (*times.shape, n)
    return q.reshape((*shape, 4)), w.reshape((*shape, 3))
