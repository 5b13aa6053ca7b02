"""Windows of gyro samples one at a time, from Python and from a user's ``@njit`` code.

The formulas are those of :func:`fastatt.integrate_rates`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from numba.np.unsafe.ndarray import to_fixed_tuple

from fastatt._jit import helper, kernel
from fastatt.codegen.scalar import scalar_function
from fastatt.gyro.integrate import method_of
from fastatt.kernels import quat
from fastatt.methods import coning2 as _coning2
from fastatt.methods import coning3 as _coning3
from fastatt.methods import hold as _hold
from fastatt.methods import previous as _previous
from fastatt.methods import trapezoid as _trapezoid
from fastatt.methods.windows import Iteration, products
from fastatt.tracing.traced import Recurrence

# squared angle up to which the short exponential holds, less a margin
_SHORT = 9.0


@kernel
def turned(q, u):
    """q∘exp(u): bit for bit the same by the short exponential, where it holds, as by the other."""
    F = type(q[0])
    if u[0] * u[0] + u[1] * u[1] + u[2] * u[2] < F(_SHORT):
        return quat.mul(q, quat.exp_short(u))
    return quat.mul(q, quat.exp(u))


@helper
def _one(q, u):
    return turned(q, u)


@helper
def _two(q, u):
    return turned(q, u[:3]) + turned(q, u[3:])


@helper
def _three(q, u):
    return turned(q, u[:3]) + turned(q, u[3:6]) + turned(q, u[6:])


# attitudes after each of so many rotation vectors from the same attitude, flat
_TURNED: dict[int, Any] = {1: _one, 2: _two, 3: _three}


@kernel
def hold(q, w, h):
    """Attitude h s later at the rate w (rad/s, body axes), held: q∘exp(h w)."""
    return turned(q, _hold.rates(w, (h,)))


@kernel
def hold_increments(q, u):
    """Attitude after the angle increment u (rad), taken for a rotation vector: q∘exp(u)."""
    return turned(q, u)


@kernel
def trapezoid(q, w0, w1, h):
    """Attitude h s later by the mean of the rates w0 before and w1 after (rad/s)."""
    return turned(q, _trapezoid.rates(w0 + w1, (h,)))


@kernel
def previous(q, w0, w1, w2, h0, h1):
    """Attitude at the newest sample from q at w1's instant: a parabola through three rates.

    w0, w1, w2 (rad/s) were sampled h0 and h1 s apart, w2 the newest: causal, order 3.
    """
    return turned(q, _previous.rates(w0 + w1 + w2, (h0, h1)))


@kernel
def previous_increments(q, u0, u1, h0, h1):
    """Attitude after the newest increment u1 (rad) over h1 s, u0 the one over the h0 s before."""
    return turned(q, _previous.increments(u0 + u1, (h0, h1)))


@kernel
def coning2(q, w0, w1, w2, h0, h1):
    """(q1, q2): attitudes h0 and h0 + h1 s after q, from rates at all three instants; order 4."""
    found = _two(q, _coning2.rates(w0 + w1 + w2, (h0, h1)))
    return found[:4], found[4:]


@kernel
def coning2_increments(q, u0, u1, h0, h1):
    """(q1, q2): attitudes after each of two increments (rad) over h0 and h1 s."""
    found = _two(q, _coning2.increments(u0 + u1, (h0, h1)))
    return found[:4], found[4:]


@kernel
def coning3(q, w0, w1, w2, w3, h0, h1, h2):
    """(q1, q2, q3): attitudes at the ends of three intervals, from rates at all four instants."""
    found = _three(q, _coning3.rates(w0 + w1 + w2 + w3, (h0, h1, h2)))
    return found[:4], found[4:8], found[8:]


@kernel
def coning3_increments(q, u0, u1, u2, h0, h1, h2):
    """(q1, q2, q3): attitudes after each of three increments (rad) over h0, h1 and h2 s."""
    found = _three(q, _coning3.increments(u0 + u1 + u2, (h0, h1, h2)))
    return found[:4], found[4:8], found[8:]


@kernel
def coning3_optimal_increments(q, u0, u1, u2):
    """(q1, q2, q3) of increments (rad) over equal intervals, the last optimal for pure coning."""
    one = type(u0[0])(1.0)
    found = _three(q, _coning3.increments_optimal(u0 + u1 + u2, (one, one, one)))
    return found[:4], found[4:8], found[8:]


@dataclass(frozen=True)
class SampleStepper:
    """One window of gyro samples, made by :func:`sample_step`.

    The window covers ``span`` intervals and reads ``history`` intervals before it; it holds
    ``samples`` rates at the ends of all these intervals, rad/s, or increments over them, rad.

    ``step(q, v, h)`` gives the ``span`` attitudes after q, flat: v are the samples and h the
    intervals (s), flat tuples, the oldest first.
    ``step_into(samples, intervals, out, work)`` fills out[1:]: samples (``samples``, 3), intervals
    (``history + span``,), out (``span`` + 1, 4) whose first row is the attitude at the window's
    start, work (``work``,), which no method needs any more; arrays of one float type, contiguous.
    """

    method: str
    history: int
    span: int
    samples: int
    work: int
    step: Any
    step_into: Any


def sample_step(method: str, *, increments: bool = False) -> SampleStepper:
    """One window of a method for sampled rates or angle increments, by its name.

    The formulas are those of :func:`fastatt.integrate_rates`, which gives the same attitudes bit
    for bit as far as the compiler fuses the same operations, but for the first and last ones of a
    log, where it has to extrapolate.

    Raises ``ValueError`` for a method that does not take such samples.
    """
    window = method_of(method, increments).window
    sizes = 3 * window.samples(increments), window.intervals, 4 * window.span
    if window.iteration is not None:
        step = scalar_function(_passes(window.iteration, increments))
        step_into = kernel(_into(step, *sizes), cache=False)
    else:
        # it closes over plain functions alone, which Numba's disk cache knows again
        plain = _stepped(_TURNED[window.span], window.formula(increments))
        step, step_into = kernel(plain), kernel(_into(helper(plain), *sizes))
    return SampleStepper(
        method=method, history=window.history, span=window.span, samples=window.samples(increments),
        work=0, step=step, step_into=step_into,
    )  # fmt: skip


def _stepped(apply: Any, formula: Any) -> Callable[..., Any]:
    def step(q, v, h):
        return apply(q, formula(v, h))

    return step


def _passes(iteration: Iteration, increments: bool) -> Recurrence:
    def step(q: Any, v: Any, h: Any) -> Any:
        return iteration.begin(increments, v, h), ()

    def again(state: Any, _: Any, *given: Any) -> Any:
        return iteration.again(state)

    def end(state: Any, _: Any, q: Any, *given: Any) -> Any:
        return tuple(products(q, iteration.read(state[:-1])))

    return Recurrence(step, again, end, ((0.0,),) * iteration.passes)


def _into(step: Any, n_samples: int, n_intervals: int, size: int) -> Callable[..., Any]:
    def step_into(samples, intervals, out, work):
        q = (out[0, 0], out[0, 1], out[0, 2], out[0, 3])
        v = to_fixed_tuple(samples.ravel(), n_samples)
        d = step(q, v, to_fixed_tuple(intervals, n_intervals))
        for i in range(size):
            out[1 + i // 4, i % 4] = d[i]

    return step_into
