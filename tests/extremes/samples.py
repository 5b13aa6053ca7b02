"""Logs of a constant rate and of a cone."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable

import numpy as np

import fastatt as fa
from extremes.cases import (
    OF_INCREMENTS,
    OF_RATES,
    START,
    Array,
    Case,
    Outcome,
    angle,
    exp,
    mul,
    rounding,
    share,
)
from extremes.rates import AXES, cone

# samples

SAMPLES = 6


def coning_log(
    a: float, frequency: float, h: float, n: int, *, increments: bool
) -> tuple[Array, Array, Array, float]:
    """Samples of a cone, its first attitude, all attitudes, and the interval."""
    p = frequency * h * np.arange(n + 1.0)
    size, axial = math.sin(a), -2.0 * math.sin(0.5 * a) ** 2
    if increments:
        middle, half = 0.5 * (p[:-1] + p[1:]), 0.5 * frequency * h
        chord = 2.0 * size * math.sin(half)
        data = np.stack(
            [-chord * np.sin(middle), chord * np.cos(middle), np.full(n, axial * 2.0 * half)],
            axis=1,
        )
    else:
        data = frequency * np.stack(
            [-size * np.sin(p), size * np.cos(p), np.full(n + 1, axial)], axis=1
        )
    first = mul(START, cone(np.array(a), np.array(0.0)))
    return data, first, mul(START, cone(np.full(n + 1, a), p)), h


def sampled(theta: float, a: float, *, increments: bool) -> Callable[[Case], Outcome]:
    """A cone, or with a = 0 a constant rate, sampled once a turn of theta rad."""

    def run(case: Case) -> Outcome:
        n = SAMPLES
        if a:
            frequency = theta / (2.0 * math.sin(0.5 * a))
            data, first, truth, _ = coning_log(a, frequency, 1.0, n, increments=increments)
        else:
            frequency = theta
            data = np.tile(theta * AXES[1], (n if increments else n + 1, 1))
            first = START
            truth = mul(START, exp(np.arange(n + 1.0)[:, None] * data[0]))
        q = np.full((n + 1, 4), np.nan)
        with warnings.catch_warnings(record=True) as heard, contextlib.suppress(ValueError):
            warnings.simplefilter("always")
            q = fa.integrate_rates(
                data, 1.0, first, method=case.method, increments=increments, dtype=case.dtype,
                n_threads=1,
            )  # fmt: skip
        refused = not np.isfinite(q).all()  # angles that float32 does not hold
        said = refused or any(issubclass(w.category, UserWarning) for w in heard)
        order = case.record.order_of("increments" if increments else "sampled rates")
        known = OF_INCREMENTS if increments else OF_RATES
        iterated = case.method == "picard"  # the others are exact
        step = share(known, case.method, order, np.array(theta)) if a or iterated else 0.0
        allowed = n * theta * step + rounding(case, 12 * n, n * max(theta, frequency))
        error = np.max(angle(q, truth))
        status = np.uint16(fa.Status.STEP_TOO_LARGE if said else 0)
        return Outcome(error[None], allowed[None], status[None])

    return run
