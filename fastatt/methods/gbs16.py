"""GBS-16: the explicit midpoint rule, extrapolated in eight columns.

The midpoint rule crosses a step in 4, 6, … 24 substeps. Its error is a series in the squares of
their lengths, and a weighted sum of the results removes seven terms of it. A stage is one substep
with one slope, while a Runge-Kutta method of high order combines a dozen slopes, which takes
longer than evaluating most torques. Gragg, *SIAM Journal on Numerical Analysis* 2 (1965) 384.

In place of the momentum m, a column steps v = (h/n) I⁻¹ m, half of the body's rotation in two of
its n substeps. Multiplications by their length and by moments of inertia are thus avoided.
"""

from __future__ import annotations

import math
from typing import Any

from fastatt.methods.method import BODIES, Method, Steps
from fastatt.scene.equations import Body
from fastatt.tracing.formulas import Vector, axpy, largest, minus, plus, product, rigid, scale
from fastatt.tracing.graph import choose

#: substeps of each column: few, and far enough apart for small weights, which multiply rounding
COLUMNS = (4, 6, 8, 10, 12, 14, 18, 24)
_WEIGHTS = [math.prod(n * n / (n * n - m * m) for m in COLUMNS if m != n) for n in COLUMNS]


def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
    start = motion.base(x)
    motion = motion.near(start)
    slopes = [motion.field(motion.at(t), start)]
    column = _angles if isinstance(motion, Body) else _state
    ends = []
    for n in COLUMNS:
        end, more = column(motion, t, h, n, start, slopes[0])
        ends.append(end)
        slopes += more
    # sums of differences: the rounding of the weights' sum would act in the same way in every step
    d = ends[0]
    for weight, end in zip(_WEIGHTS, ends, strict=True):
        d = axpy(weight, minus(end, ends[0]), d)
    most = largest(slopes) if motion.attitude.has_poles else slopes[0]
    return motion.advanced(x, d), h * h * motion.speed_squared(motion.at(t), most, plus(start, d))


def _state(motion: Any, t: Any, h: Any, n: int, start: Vector, first: Vector) -> Any:
    """(the change over n substeps, their slopes), for any equations of motion."""
    slopes = []
    # the difference from the start, which is rounded at its own size
    before, now = (0.0,) * len(start), scale(h * (1.0 / n), first)
    for k in range(1, n):
        slopes.append(motion.field(motion.at(t + (k / n) * h), plus(start, now)))
        before, now = now, axpy(h * (2.0 / n), slopes[-1], before)
    return now, slopes


def _angles(motion: Any, t: Any, h: Any, n: int, start: Vector, first: Vector) -> Any:
    """Columns of a body, which steps v; slopes are computed only if the attitude has poles."""
    size = motion.plain.size
    frequency = 1.0 / choose(h == 0.0, 1.0, h)
    span = (h + h) / n
    angle = scale(span, motion.half_inverse)
    push = scale(span, angle)
    unit = (*[1.0] * size, *angle)
    i = motion.moments
    axes = zip(motion.half_inverse, motion.gyroscopic, i[1:] + i[:1], i[2:] + i[:2], strict=True)
    # 2 (I2 - I3)/I1, cyclic, without cancellation
    coupling = tuple(4.0 * (k * a) * (b * c) for k, c, a, b in axes)
    base, slopes = product(unit, start), []
    before, now = (0.0,) * len(start), product(scale(0.5 * span, unit), first)
    for k in range(1, n):
        y = plus(base, now)
        a, v = y[:size], y[size:]
        slope = (*motion.plain.half_derivative(a, v), *rigid.gyroscopic(v, coupling))
        after = plus(before, slope)
        if not motion.is_free:
            torque = motion.torque(t + (k / n) * h, a, scale(n * frequency, v))
            after = (*after[:size], *plus(after[size:], product(push, torque)))
        if motion.attitude.has_poles:
            slopes.append(scale(0.5 * n * frequency, slope))
        before, now = now, after
    return product((*[1.0] * size, *scale(n * frequency, i)), now), slopes


METHOD = Method(
    name="gbs16",
    order=2 * len(COLUMNS),
    scenes=BODIES,
    uses=("derivative",),
    rate_calls=1 + sum(n - 1 for n in COLUMNS),
    couples=True,
    limits={"quaternion": 5.9, "matrix": 2.9, "mrp": 2.9, "coordinates": 0.3},
    steps=Steps(body=step),
    damping_limit=7.3,
    tried_on=("torqued",),
    summary="extrapolated midpoint rule; for fast torque functions and errors below 1e-6",
    source="Hairer, Nørsett, Wanner, Solving ODEs I (1993), §II.9, eqs. 9.10 and 9.13",
)
