"""Coordinates at and near their poles."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

import fastatt as fa
from extremes.cases import Case, Outcome, angle, exp, mul, propagate, rounding, single, truncation
from extremes.rates import rates


def passage(kind: str, distance: float, *, body: bool) -> Callable[[Case], Outcome]:
    """A constant rate whose coordinates start at a pole, or pass it so far away.

    Of a body it is that about the axis of its largest moment.
    """
    x, y, z = np.eye(3)
    start, w = {
        "at 0": (exp(0.4 * z), 0.01 * x),
        "at π": (mul(exp(math.pi * x), exp(0.4 * z)), 0.01 * x),
        "past 0": (mul(exp(distance * y), exp(0.32 * x)), -0.01 * x),
    }[kind]
    n = 64

    def run(case: Case) -> Outcome:
        rate, q0, options = single(w)[None], start[None], {"dt": 1.0, "n_steps": n, "save_every": 1}
        if body:
            scene = fa.Scene(inertia=np.array([[1.25, 1.0, 0.75]]))
            got = propagate(case, scene, q0, rate, **options)
        else:
            got = propagate(case, rates(np.zeros(1), np.zeros(1), rate), q0, **options)
        turn = np.linalg.norm(rate, axis=1)
        errors = angle(got.q[:, 0], mul(start, exp(got.t[:, None] * rate)))
        allowed = n * truncation(case, turn) + 1e3 * rounding(case, n, n * turn)
        return Outcome(np.max(errors)[None], allowed, got.status)

    return run
