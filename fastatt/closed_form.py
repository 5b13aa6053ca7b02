"""Closed forms of the motion of free bodies and heavy symmetric tops at any times.

Their error does not accumulate over steps; it grows only with the rotation angle ``|w| t``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks, rounding
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.codegen.processor import processor
from fastatt.codegen.rows import RowFunction, precision_of
from fastatt.scene.inertia import EQUAL, Principal, about_arm, is_symmetric, principal, refuse
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import lever_of
from fastatt.threads import number_of
from fastatt.tracing import formulas
from fastatt.tracing.graph import flattened

__all__ = ["free_body", "heavy_top", "symmetric_top"]


def free_body(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
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
    body = principal(inertia, allow_unphysical=allow_unphysical)
    return _at_times(_free_form(body), q0, w0, t, dtype, n_threads)


def symmetric_top(
    q0: ArrayLike,
    w0: ArrayLike,
    inertia: ArrayLike,
    t: ArrayLike,
    *,
    allow_unphysical: bool = False,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Attitude and angular velocity of torque-free bodies with two equal moments, in closed form.

    The motion is a regular precession. :func:`free_body` takes these bodies, too, and any other.

    Parameters
    ----------
    q0 : array_like of shape (4,) or (N, 4)
        Attitudes at t = 0, body to inertial, scalar first, of any norm above zero.
    w0 : array_like of shape (3,) or (N, 3)
        Angular velocities at t = 0 along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments, or tensors, kg·m². Two moments are equal within 1e-12 of the largest.
    t : float or array_like of shape (T,)
        Time or times, s.
    allow_unphysical : bool, default False
        As in :func:`free_body`.
    dtype : {float64, float32}, optional
        As in :func:`free_body`.
    n_threads : int, optional
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
    body = principal(inertia, allow_unphysical=allow_unphysical)
    refuse(
        body.moments,
        ~is_symmetric(body.moments),
        f"no two moments are equal to {EQUAL:g} of the largest",
        "a symmetric body, or free_body for any other",
    )
    return _at_times(_free_form(body), q0, w0, t, dtype, n_threads)


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
    from fastatt.scene.torques import HeavyTop

    torque = HeavyTop(arm, weight)
    scene = Scene(inertia=inertia, torque=torque, allow_unphysical=allow_unphysical)
    return _at_times(solution_of(scene), q0, w0, t, dtype, n_threads)


def _at_times(
    motion: BodySolution,
    q0: ArrayLike,
    w0: ArrayLike,
    t: ArrayLike,
    dtype: DTypeLike | None,
    n_threads: int | None,
) -> tuple[NDArray[Any], NDArray[Any]]:
    precision = checks.precision(dtype, q0, w0)
    start = checks.attitudes("q0", q0)
    rates = checks.array("w0", w0, "(3,) or (N, 3)")
    times = checks.array("t", t, "a number or (T,)")
    threads = number_of(n_threads)
    bodies = {"q0": start, "w0": rates, "inertia": motion.body.moments, "arm, weight": motion.pull}
    n = _same_rows(bodies)
    if text := rounding.of_angles(turned(rates, times, motion.gain), precision):
        rounding.warn(f"t: found rotations by {text}")
    flat = np.require(times.reshape(-1), precision, ["C", "A"])
    first = start.astype(precision), rates.astype(precision)
    q, w = (np.empty((flat.size, n or 1, k), precision) for k in (4, 3))
    with np.errstate(over="ignore", invalid="ignore"):
        evaluate(motion, first, flat, threads, (q, w))
    shape = times.shape if n is None else (*times.shape, n)
    return q.reshape((*shape, 4)), w.reshape((*shape, 3))


def _same_rows(arguments: dict[str, NDArray[Any]]) -> int | None:
    """The number of bodies, None if no argument has rows; refuses different numbers but one."""
    rows = {name: len(x) for name, x in arguments.items() if x.ndim == 2}
    first = next((name for name, n in rows.items() if n > 1), "")
    for name, n in rows.items():
        if n not in (1, rows.get(first, 1)):
            raise ValueError(f"{name}: has {n} rows; accepted: one, or {rows[first]} as of {first}")
    return rows.get(first, 1 if rows else None)


# inputs with their sizes; axes are those of ``Principal``, if there are any
_INPUTS = {"q": 4, "w": 3, "moments": 3, "axes": 4, "pull": 3, "t": None}


class Solution(NamedTuple):
    """The solution of a motion in two formulas.

    ``prepare`` computes constants from (q, w, moments), and from the ``pull`` too if ``pulled``;
    ``state`` computes the attitude and w from the constants, the moments and t.
    """

    prepare: Callable[..., Any]
    state: Callable[[Any, Any, Any], tuple[Any, Any]]
    pulled: bool = False


def _free(constants: Any, moments: Any, t: Any) -> tuple[Any, Any]:
    q, m = formulas.free_body.evaluate(constants, t)
    return q, tuple(a / b for a, b in zip(m, moments, strict=True))


def _top(constants: Any, moments: Any, t: Any) -> Any:
    return formulas.heavy_top.evaluate(constants, t)


_FREE_BODY = Solution(formulas.free_body.setup_rate, _free)
_HEAVY_TOP = Solution(formulas.heavy_top.setup, _top, pulled=True)


class BodySolution(NamedTuple):
    """The closed form of given bodies.

    ``pull`` is the moment of the weight about the fixed point, N·m, which acts on the third axes,
    (3,) or (N, 3) along inertial axes. ``gain``, rad/s, bounds the growth of ``|w|``: the square
    root of ``|w|²`` + ``gain²`` at the start is never exceeded.
    """

    solution: Solution
    body: Principal
    pull: NDArray[np.float64] = np.zeros(3)
    gain: NDArray[np.float64] = np.zeros(())


def solution_of(scene: Scene) -> BodySolution:
    """The closed form of a scene's motion.

    Raises ``ValueError``, with the body or the torque, if there is none.
    """
    if "closed form" not in scene.memo:
        scene.memo["closed form"] = _solution_of(scene)
    known = scene.memo["closed form"]
    assert isinstance(known, BodySolution)
    return known


def _solution_of(scene: Scene) -> BodySolution:
    if scene.torque is None:
        return _free_form(scene.principal)
    lever = lever_of(scene.torque)
    if lever is None:
        raise ValueError(
            f"torque: found {checks.brief(scene.torque)}; accepted by the closed form: none, or "
            "HeavyTop or MagneticDipole of numbers"
        )
    arm, pull = lever
    top, reach = about_arm(scene.principal, arm)  # raises for an arm along no axis of symmetry
    _check_above_zero(top)
    pull = reach[..., None] * pull
    # A |w|² grows by 4 |pull| at most
    gain = 2.0 * np.sqrt(np.linalg.norm(pull, axis=-1) / top.moments[..., 0])
    return BodySolution(_HEAVY_TOP, top, pull, gain)


def _free_form(body: Principal) -> BodySolution:
    _check_above_zero(body)
    return BodySolution(_FREE_BODY, body)


def _check_above_zero(body: Principal) -> None:
    """Refuse moments of zero, for which there is no closed form."""
    if (body.moments < 0.0).any():
        raise ValueError(
            f"inertia: found the principal moment {body.moments.min():.6g}; accepted by the closed "
            "form: above 0, though allow_unphysical lets it pass elsewhere"
        )


def evaluate(
    motion: BodySolution,
    start: tuple[NDArray[Any], NDArray[Any]],
    t: NDArray[Any],
    threads: int,
    out: tuple[NDArray[Any], NDArray[Any]],
    attitude: Attitude = QUATERNION,
) -> None:
    """Write what a trajectory holds of the attitudes (T, N, k), and w (T, N, 3), at times (T,)."""
    moments, axes = motion.body
    state = _function(motion.solution, precision_of(start[0].dtype), attitude, axes is not None)
    # axes that are the body axes are not read
    bodies = *start, moments, np.zeros(4) if axes is None else axes, motion.pull
    state(*bodies, t[:, None], n_threads=threads, out=out)


@functools.cache
def _function(
    solution: Solution, precision: str, attitude: Attitude, is_turned: bool
) -> RowFunction:
    """The attitudes and angular velocities of bodies at times.

    ``is_turned`` says that the principal axes are not the body axes.
    """
    quat = formulas.quat

    def constants(q: Any, w: Any, moments: Any, axes: Any, pull: Any) -> Any:
        if is_turned:
            q, w = quat.mul(q, axes), quat.rotate_inverse(axes, w)
        pulls = (pull,) if solution.pulled else ()
        return tuple(flattened(solution.prepare(quat.normalise(q), w, moments, *pulls)))

    def state(q: Any, w: Any, moments: Any, axes: Any, pull: Any, t: Any, constants: Any) -> Any:
        q, w = solution.state(constants, moments, t)
        if is_turned:
            q, w = quat.mul(q, quat.conj(axes)), quat.rotate(axes, w)
        return q if attitude is QUATERNION else attitude.raw(attitude.start(q)), tuple(w)

    native, results = processor().fuses, (attitude.stored, 3)
    return RowFunction(state, _INPUTS, results, precision, native=native, constants=constants)


def turned(w: NDArray[Any], t: NDArray[Any], gain: NDArray[np.float64]) -> NDArray[np.float64]:
    """The largest ``|w| t`` of each body, rad, with the ``gain`` of a ``BodySolution``."""
    with np.errstate(over="ignore", invalid="ignore"):
        rates = np.asarray(w, dtype=np.float64)
        squares = (rates * rates) @ np.ones(3) + gain * gain
        return np.asarray(np.sqrt(squares) * np.abs(t).max(initial=0.0))
