"""GBS-16: the explicit midpoint rule, extrapolated in eight columns.

A step is crossed by the midpoint rule in 4, 6, … 26 substeps. Its error is a series in the squares
of their lengths, seven terms of which a weighted sum of the results takes away. A stage is one
substep, of one slope: a Runge-Kutta method of high order combines a dozen slopes, which takes
longer than most torques do. Gragg, SIAM J. Numer. Anal. 2 (1965) 384.
"""

from __future__ import annotations

import math
from typing import Any

from fastatt.flat.formulas import Vector, axpy, largest, plus, scale
from fastatt.methods.method import BODIES, Method, Steps

#: substeps of each column: few, but far enough apart for small weights, which multiply rounding
COLUMNS = (4, 6, 8, 10, 12, 16, 20, 26)
_WEIGHTS = [math.prod(n * n / (n * n - m * m) for m in COLUMNS if m != n) for n in COLUMNS]


def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
    start = motion.base(x)
    slopes = [motion.field(motion.at(t), start)]
    none: Vector = (0.0,) * len(start)
    d = none
    for n, weight in zip(COLUMNS, _WEIGHTS, strict=True):
        # how far a column is from the start: rounded at that size, not at the state's
        before, now = none, scale(h * (1.0 / n), slopes[0])
        for k in range(1, n):
            slopes.append(motion.field(motion.at(t + (k / n) * h), plus(start, now)))
            before, now = now, axpy(h * (2.0 / n), slopes[-1], before)
        d = axpy(weight, now, d)
    most = largest(slopes) if motion.attitude.has_poles else slopes[-1]
    return motion.advanced(x, d), h * h * motion.turning(motion.at(t), most, plus(start, now))


METHOD = Method(
    name="gbs16",
    order=2 * len(COLUMNS),
    scenes=BODIES,
    representations=("quat",),
    uses=("derivative",),
    conserves=(),
    rate_calls=1 + sum(n - 1 for n in COLUMNS),
    exponentials=0,
    couples=True,
    limits={"quat": 5.9},
    steps=Steps(body=step),
    damping_limit=7.5,
    summary="extrapolated midpoint rule: torques that are quick to evaluate, errors below 1e-7",
    source="Hairer, Nørsett, Wanner, Solving ODEs I (1993), §II.9, eqs. 9.10 and 9.13",
)
