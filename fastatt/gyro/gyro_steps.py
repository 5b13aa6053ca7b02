"""Single windows of gyro samples, for Python and for jitted code.

The formulas are those of :func:`fastatt.integrate_rates`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fastatt._jit import helper, kernel
from fastatt.gyro.integrate import method_of
from fastatt.kernels import quat
from fastatt.methods import samples as _samples

__all__ = [
    "coning2", "coning2_increments", "hold", "hold_increments", "previous", "previous_increments",
    "sample_step", "trapezoid",
]  # fmt: skip

# squared angle below which the short exponential is accurate, with a margin
_SHORT = 9.0


@kernel
def turned(q, u):
    """Rotate a quaternion by a rotation vector, q∘exp(u).

    Parameters
    ----------
    q : tuple of 4 float
        Attitude, body to inertial.
    u : tuple of 3 float
        Rotation vector along body axes, rad.

    Returns
    -------
    tuple of 4 float
        The rotated attitude.

    Notes
    -----
    If the angle is small, the function evaluates a shorter series, with the same result bit for
    bit.
    """
    F = type(q[0])
    if u[0] * u[0] + u[1] * u[1] + u[2] * u[2] < F(_SHORT):
        return quat.mul(q, quat.exp_short(u))
    return quat.mul(q, quat.exp(u))


@helper
def _two(q, u):
    return turned(q, u[:3]) + turned(q, u[3:])


# attitudes after each of one or two rotation vectors from the same attitude, flat
_TURNED: dict[int, Any] = {1: turned, 2: _two}


@kernel
def hold(q, w, h):
    """Integrate one interval with a constant rate, q∘exp(h w).

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the start of the interval, body to inertial.
    w : tuple of 3 float
        Rate along body axes, rad/s.
    h : float
        Interval, s.

    Returns
    -------
    tuple of 4 float
        Attitude at the end of the interval.
    """
    return turned(q, _samples.hold_rates(w, (h,)))


@kernel
def hold_increments(q, u):
    """Integrate one interval with an angle increment as its rotation vector, q∘exp(u).

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the start of the interval, body to inertial.
    u : tuple of 3 float
        Angle increment along body axes, rad.

    Returns
    -------
    tuple of 4 float
        Attitude at the end of the interval.
    """
    return turned(q, u)


@kernel
def trapezoid(q, w0, w1, h):
    """Integrate one interval with the mean of the rates at its ends.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the start of the interval, body to inertial.
    w0 : tuple of 3 float
        Rate at the start, rad/s.
    w1 : tuple of 3 float
        Rate at the end, rad/s.
    h : float
        Interval, s.

    Returns
    -------
    tuple of 4 float
        Attitude at the end of the interval.
    """
    return turned(q, _samples.trapezoid_rates(w0 + w1, (h,)))


@kernel
def previous(q, w0, w1, w2, h0, h1):
    """Integrate the newest interval with a parabola through three rates; causal, order 3.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the time of ``w1``, body to inertial.
    w0 : tuple of 3 float
        Rate one interval before ``w1``, rad/s.
    w1 : tuple of 3 float
        Rate at the start of the newest interval, rad/s.
    w2 : tuple of 3 float
        Rate at its end, rad/s.
    h0 : float
        Interval from ``w0`` to ``w1``, s.
    h1 : float
        Interval from ``w1`` to ``w2``, s.

    Returns
    -------
    tuple of 4 float
        Attitude at the time of ``w2``.

    Notes
    -----
    The parabola magnifies noise if ``h0`` is much shorter than ``h1``; ``trapezoid`` does not. The
    same holds of ``coning2`` if either interval is much shorter than the other.
    """
    return turned(q, _samples.previous_rates(w0 + w1 + w2, (h0, h1)))


@kernel
def previous_increments(q, u0, u1, h0, h1):
    """Integrate the newest interval with its angle increment and the one before; causal, order 3.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the start of the newest interval, body to inertial.
    u0 : tuple of 3 float
        Angle increment over the interval before, rad.
    u1 : tuple of 3 float
        Angle increment over the newest interval, rad.
    h0 : float
        Interval before, s.
    h1 : float
        Newest interval, s.

    Returns
    -------
    tuple of 4 float
        Attitude at the end of the newest interval.
    """
    return turned(q, _samples.previous_increments(u0 + u1, (h0, h1)))


@kernel
def coning2(q, w0, w1, w2, h0, h1):
    """Integrate two intervals with the rates at three times; order 4.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the time of ``w0``, body to inertial.
    w0 : tuple of 3 float
        First rate, rad/s.
    w1 : tuple of 3 float
        Second rate, rad/s.
    w2 : tuple of 3 float
        Third rate, rad/s.
    h0 : float
        First interval, s.
    h1 : float
        Second interval, s.

    Returns
    -------
    tuple of two tuples of 4 float
        Attitudes at the ends of the two intervals.
    """
    attitudes = _two(q, _samples.coning2_rates(w0 + w1 + w2, (h0, h1)))
    return attitudes[:4], attitudes[4:]


@kernel
def coning2_increments(q, u0, u1, h0, h1):
    """Integrate two intervals with their angle increments; order 4.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at the start of the first interval, body to inertial.
    u0 : tuple of 3 float
        First angle increment, rad.
    u1 : tuple of 3 float
        Second angle increment, rad.
    h0 : float
        First interval, s.
    h1 : float
        Second interval, s.

    Returns
    -------
    tuple of two tuples of 4 float
        Attitudes at the ends of the two intervals.
    """
    attitudes = _two(q, _samples.coning2_increments(u0 + u1, (h0, h1)))
    return attitudes[:4], attitudes[4:]


@dataclass(frozen=True)
class SampleStepper:
    """One window of a method for gyro samples; :func:`sample_step` makes it.

    Attributes
    ----------
    method : str
        Name of the method.
    history : int
        Number of intervals that the window reads before those that it covers.
    span : int
        Number of intervals that the window covers.
    samples : int
        Number of samples in the window: rates at the ends of all these intervals, rad/s, or
        increments over them, rad.
    step : callable
        ``step(q, v, h)`` returns the ``span`` attitudes after q, flat. v are the samples and h the
        intervals, s, as flat tuples with the oldest first. For Python and jitted code.
    step_into : callable
        ``step_into(samples, intervals, out)`` fills ``out[1:]`` from arrays: samples (``samples``,
        3), intervals (``history`` + ``span``,) and out (``span`` + 1, 4), whose first row is the
        attitude at the start of the window. All arrays are contiguous and of one float type.
    """

    method: str
    history: int
    span: int
    samples: int
    step: Any
    step_into: Any


def sample_step(method: str, *, increments: bool = False) -> SampleStepper:
    """Return the step of a method for gyro samples over one window.

    Parameters
    ----------
    method : str
        A method for samples, such as "coning2". "picard" iterates and has no such step.
    increments : bool, default False
        Whether the samples are angle increments.

    Returns
    -------
    SampleStepper
        The window, with its functions ``step`` and ``step_into``.

    Raises
    ------
    ValueError
        If the method does not accept such samples.

    Notes
    -----
    The formulas are those of :func:`fastatt.integrate_rates`. The attitudes are the same, bit for
    bit if the compiler fuses the same operations, except at the ends of a log, where
    ``integrate_rates`` extrapolates.

    Examples
    --------
    >>> import fastatt as fa
    >>> stepper = fa.gyro_steps.sample_step("trapezoid")
    >>> stepper.history, stepper.span, stepper.samples
    (0, 1, 2)
    """
    window = method_of(method, increments, iterates=False).window
    sizes = 3 * window.samples(increments), window.intervals, 4 * window.span
    # it closes over plain functions alone, which Numba's disk cache recognises
    step = _stepped(_TURNED[window.span], window.formula(increments))
    return SampleStepper(
        method=method, history=window.history, span=window.span, samples=window.samples(increments),
        step=kernel(step), step_into=kernel(_into(helper(step), *sizes)),
    )  # fmt: skip


def _stepped(apply: Any, formula: Any) -> Callable[..., Any]:
    def step(q, v, h):
        return apply(q, formula(v, h))

    return step


def _into(step: Any, n_samples: int, n_intervals: int, size: int) -> Callable[..., Any]:
    numbers, times = (
        "".join(f"{name}[{k}], " for k in range(n))
        for name, n in (("v", n_samples), ("intervals", n_intervals))
    )
    text = (
        "def step_into(samples, intervals, out):\n"
        "    v, q = samples.ravel(), (out[0, 0], out[0, 1], out[0, 2], out[0, 3])\n"
        f"    d = step(q, ({numbers}), ({times}))\n"
        f"    for i in range({size}):\n"
        "        out[1 + i // 4, i % 4] = d[i]\n"
    )
    scope = {"step": step}
    exec(text, scope)
    return scope["step_into"]  # type: ignore[no-any-return]
