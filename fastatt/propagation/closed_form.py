"""Closed forms of the motion of free bodies and heavy symmetric tops at any times.

Their error does not accumulate over steps; it grows only with the rotation angle ``|w| t``.
"""

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

#: what is done with initial values that are not finite
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
    """Attitude and angular velocity of torque-free bodies at any times, in closed form.

    Parameters
    ----------
    q0 : array_like of shape (4,) or (N, 4)
        Attitudes at t = 0, body to inertial, scalar first, of any norm above zero.
    w0 : array_like of shape (3,) or (N, 3)
        Angular velocities at t = 0 along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments in any order, or tensors, kg·m².
    t : float or array_like of shape (T,)
        Time or times, s, in any order and of either sign.
    allow_unphysical : bool, default False
        Accept positive moments that violate the triangle inequality, which no body has.
    dtype : {float64, float32}, optional
        Precision. The default is float32 if ``q0`` and ``w0`` are float32 arrays, and float64
        otherwise.
    n_threads : int, optional
        Number of threads; the default is every processor that this process may use. Results do not
        depend on it.
    invalid : {"raise", "flag"}, default "raise"
        "raise" refuses zero quaternions and values of ``q0`` and ``w0`` that are not finite. "flag"
        returns NaN for these bodies alone.

    Returns
    -------
    q : ndarray of shape (T, N, 4)
        Unit quaternions, body to inertial, scalar first. The axis T is absent for one time, and the
        axis N for one body.
    w : ndarray of shape (T, N, 3)
        Angular velocities along body axes, rad/s, with the same leading axes.

    Raises
    ------
    ValueError
        If an argument does not fit. The message names the argument and says what is accepted.
    TypeError
        If an argument has the wrong type.

    Warns
    -----
    StepWarning
        If ``|w| t`` is so large that half the digits of the precision are lost.

    Notes
    -----
    In float64 the error of the attitude is at most 1e-15 (1 + ``|w| t``) rad, and that of w as much
    relative to ``|w|``, for principal moments. This includes motions near the separatrix, where the
    given numbers are taken as exact. In float32 errors are 1e9 times as large, and rotation within
    1e-17 rad of the intermediate axis stays there.

    Examples
    --------
    >>> import fastatt as fa
    >>> q, w = fa.closed_form.free_body([1, 0, 0, 0], [0.1, 0.3, -0.2], (2.0, 1.0, 2 / 3), 10.0)
    >>> q.round(6)
    array([-0.144152,  0.611716,  0.777667,  0.016067])
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
    """Attitude and angular velocity of torque-free bodies with two equal moments, in closed form.

    The motion is a regular precession, which takes two exponentials and less time than
    :func:`free_body`.

    Parameters
    ----------
    q0 : array_like of shape (4,) or (N, 4)
        Attitudes at t = 0, body to inertial, scalar first, of any norm above zero.
    w0 : array_like of shape (3,) or (N, 3)
        Angular velocities at t = 0 along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments, or tensors, kg·m². Two moments are equal within 1e-12 of the largest;
        their mean is used.
    t : float or array_like of shape (T,)
        Time or times, s.
    allow_unphysical : bool, default False
        As in :func:`free_body`.
    dtype : {float64, float32}, optional
        As in :func:`free_body`.
    n_threads : int, optional
        As in :func:`free_body`.
    invalid : {"raise", "flag"}, default "raise"
        As in :func:`free_body`.

    Returns
    -------
    q : ndarray of shape (T, N, 4)
        Unit quaternions, as in :func:`free_body`.
    w : ndarray of shape (T, N, 3)
        Angular velocities along body axes, rad/s.

    Raises
    ------
    ValueError, TypeError
        If no two moments are equal, or if an argument does not fit, as in :func:`free_body`.

    Notes
    -----
    q(t) = exp(L t/A)∘q0∘exp(e (1/C − 1/A) m·e t), with the angular momentum L along inertial axes
    and m along body axes, the axis of symmetry e, the moment C about it and the two equal moments
    A.

    Examples
    --------
    >>> import fastatt as fa
    >>> q, w = fa.closed_form.symmetric_top([1, 0, 0, 0], [0.1, 0.0, 2.0], (1.0, 1.0, 0.5), 10.0)
    >>> q.shape, w.shape
    ((4,), (3,))
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
    """Attitude and angular velocity of heavy symmetric tops at any times, in closed form.

    The torque is that of :class:`fastatt.torques.HeavyTop`.

    Parameters
    ----------
    q0 : array_like of shape (4,) or (N, 4)
        Attitudes at t = 0, body to inertial, scalar first, of any norm above zero.
    w0 : array_like of shape (3,) or (N, 3)
        Angular velocities at t = 0 along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments, or tensors, about the fixed point, kg·m². The moments about two axes
        normal to the arm are equal within 1e-12 of the largest; their mean is used.
    t : float or array_like of shape (T,)
        Time or times, s.
    arm : array_like of shape (3,) or (N, 3)
        Vector from the fixed point to the centre of mass along body axes, m.
    weight : float or array_like of shape (N,)
        Weight, along −z of the inertial axes, N.
    allow_unphysical : bool, default False
        As in :func:`free_body`.
    dtype : {float64, float32}, optional
        As in :func:`free_body`.
    n_threads : int, optional
        As in :func:`free_body`.
    invalid : {"raise", "flag"}, default "raise"
        As in :func:`free_body`.

    Returns
    -------
    q : ndarray of shape (T, N, 4)
        Unit quaternions, as in :func:`free_body`.
    w : ndarray of shape (T, N, 3)
        Angular velocities along body axes, rad/s.

    Raises
    ------
    ValueError, TypeError
        If the body is not symmetric about the arm, or if an argument does not fit, as in
        :func:`free_body`.

    Notes
    -----
    With W² = ``|w0|²`` + 4 weight ``|arm|``/A, errors are at most 1e-15 (1 + W t) rad and as much
    relative to W, in addition to the effect of the rounding of q0 and w0 on the motion.

    References
    ----------
    Lagrange's top with a quotient of theta functions for each Cayley-Klein parameter: Klein and
    Sommerfeld, *The Theory of the Top* (1897-1910).

    Examples
    --------
    >>> import fastatt as fa
    >>> q, w = fa.closed_form.heavy_top(
    ...     [1, 0, 0, 0], [0.1, 0, 30], (1.0, 1.0, 0.5), 10.0, arm=(0, 0, 0.1), weight=10.0
    ... )
    >>> q.shape, w.shape
    ((4,), (3,))
    """
    body = principal(inertia, allow_unphysical=allow_unphysical)
    arms = checks.array("arm", arm, "(3,) or (N, 3)", [(3,), (-1, 3)]).astype(np.float64)
    weights = checks.array("weight", weight, "a number or (N,)").astype(np.float64)
    _same_rows({"arm": arms, "weight": weights[..., None], "inertia": body.moments})
    form = heavy_top_form(body, (arms, weights[..., None] * (0.0, 0.0, 1.0)))
    return _at_times(form, q0, w0, t, (dtype, n_threads, invalid))


def _same_rows(given: dict[str, NDArray[Any]]) -> int | None:
    """The number of bodies, None if no argument has rows; refuses different numbers but one."""
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
        rounding.warn(f"t: found rotations by {text}")
    flat = np.require(times.reshape(-1), precision, ["C", "A"])
    size = flat.size, n or 1
    q, w = np.empty((*size, 4), precision), np.empty((*size, 3), precision)
    motion = Evaluation(form, precision, size)
    motion.fill((rows(start, precision), rows(rates, precision)), flat, (q, w), threads)
    shape = times.shape if n is None else (*times.shape, n)
    return q.reshape((*shape, 4)), w.reshape((*shape, 3))
