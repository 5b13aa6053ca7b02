"""Derivatives of the steps of methods, by attitude errors, by a body's state, and by parameters.

The step itself is evaluated with dual numbers (``tracing.dual``), so that every method, model and
user-defined function has derivatives from its own formula, exact to rounding.

The error of an attitude is a rotation in body axes, C_true = C exp [δθ]; that of a body's angular
momentum is δm (N·m·s, body axes), and I⁻¹ δm is that of the rate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

from fastatt.attitudes import QUATERNION
from fastatt.methods.method import Method
from fastatt.methods.windows import Window
from fastatt.scene.equations import Body, PrescribedRate, RigidBody, Turning
from fastatt.scene.law import Law
from fastatt.tracing.dual import derivatives, seed, value
from fastatt.tracing.formulas import Vector, dcm, minus, quat, rigid, scale
from fastatt.tracing.graph import larger
from fastatt.tracing.trace import traceable

Formula = Callable[..., Any]


def error(q: Vector) -> Vector:
    """δθ of a dual quaternion about its value, and the relative change δs of its norm.

    Only the derivatives of the results have a meaning.
    """
    v = value(q)
    r = quat.mul(quat.conj(v), q)
    n = 1.0 / quat.dot(v, v)
    return (*scale(n + n, r[1:]), n * r[0])


def displaced(q: Vector, d: Vector, s: Any = 0.0) -> Any:
    """(1 + s) q∘exp(d) for dual d and s with the value 0."""
    return quat.mul(q, (1.0 + s, *scale(0.5, d)))


def rows(x: Vector, size: int) -> Vector:
    """The derivatives of some numbers, row by row."""
    return tuple(slope for number in x for slope in derivatives(number, size))


# a prescribed rate


class _Unbiased(Turning):
    """A rate less a gyro bias."""

    def __init__(self, structure: PrescribedRate, p: Vector, like: Any, bias: Vector) -> None:
        super().__init__(QUATERNION, structure, p, like)
        self.bias = bias

    def rate(self, t: Any, states: Vector = ()) -> Vector:
        return minus(super().rate(t, states), self.bias)


def rate_tangent(method: Method, structure: PrescribedRate) -> Formula:
    """``f(t, h, b, p)`` -> (δq of a step of h s, Φ11, Φ12): quaternion, matrices row by row.

    The rate is that of the structure with parameters p, less the bias b.
    """
    assert method.steps is not None
    step: Any = method.steps.rate

    def tangent(t: Any, h: Any, b: Vector, p: Vector) -> Any:
        motion = _Unbiased(structure, p, h, seed(b, 3))
        x, _ = step(motion, t, h, (1.0, 0.0, 0.0, 0.0))
        return coupled(x)

    return tangent


def coupled(x: Vector) -> tuple[Any, Any, Any]:
    """δq, Φ11 and Φ12 of a dual quaternion that depends on the bias."""
    q = quat.normalise(value(x))
    return q, dcm.transpose(dcm.from_quat(q)), rows(error(x)[:3], 3)


# samples


def window_tangent(window: Window, *, increments: bool) -> Formula:
    """``f(v, h)`` -> (δq, Φ11, Φ12) of each interval of a window.

    v are its flat samples, less the bias, and h its intervals.
    """
    formula = window.formula(increments)
    assert formula is not None
    turns = traceable(formula)

    def tangent(v: Vector, h: Vector) -> Any:
        b = seed((0.0, 0.0, 0.0), 3, like=v[0])
        weights = h if increments else (1.0,) * (len(v) // 3)
        rates = [x - b[k % 3] * weights[k // 3] for k, x in enumerate(v)]
        u = turns(tuple(rates), h)
        ends = [quat.exp(u[k : k + 3]) for k in range(0, len(u), 3)]
        between = [quat.mul(quat.conj(a), b) for a, b in pairwise(ends)]
        return tuple(coupled(q) for q in (ends[0], *between))

    return tangent


# rigid bodies


def own_numbers(law: Law) -> Iterator[bool]:
    """Which of a law's flat parameters are its model's; the others select rows of tables."""
    for term in law.terms:
        for size, look_up in zip(term.sizes, term.look_ups, strict=True):
            yield from (look_up is None,) * size


#: sizes of (δθ, δm), and of (δθ, δm, δs) for quaternions of any norm
UNIT, ANY_LENGTH = 6, 7


def directions(structure: RigidBody, state: int, *, parameters: bool) -> int:
    """The number of derivatives of each number."""
    return state + (3 + sum(own_numbers(structure.law)) if parameters else 0)


def body_tangent(
    method: Method, structure: RigidBody, *, parameters: bool = False, of_rate: bool = False
) -> Formula:
    """``f(t, h, q, m, p)`` -> (q, m, Φ) after a step of h s, with Φ flat in 6 rows.

    m is along body axes. Columns are δθ, δm and, with ``parameters``, the principal moments and the
    parameters of the torque. With ``of_rate``, w replaces m, and the square of the largest rotation
    angle of the step follows; q is stepped without normalisation, and δs, the relative change of
    its norm, is the seventh row and column. The stages of a splitting method are a loop.
    """
    steps: Any = method.steps
    state = ANY_LENGTH if of_rate else UNIT
    size = directions(structure, state, parameters=parameters)

    def moving(p: Vector) -> Body:
        dual = differentiated(structure, p, size, state) if parameters else p
        return Body(QUATERNION, structure, dual, dual[0])

    def start(motion: Body, q: Vector, m: Vector, p: Vector) -> Vector:
        if of_rate:
            m = along_axes(structure, lambda w: rigid.momentum(w, p[3:6]), m, p)
        d = seed((0.0,) * state, size, like=m[0])
        a, n = displaced(q, d[:3], *d[UNIT:]), seed(m, size, 3)
        if motion.axes is not None:
            a, n = quat.mul(a, motion.axes), quat.rotate_inverse(motion.axes, n)
        return (*a, *n)

    def finish(motion: Body, x: Vector, z: Any, p: Vector) -> Any:
        a, n = x[:4], x[4:7]
        if motion.axes is not None:
            a, n = quat.mul(a, quat.conj(motion.axes)), quat.rotate(motion.axes, n)
        e = error(a)
        phi = rows((*e[:3], *n, *e[3:])[:state], size)
        q, m = quat.normalise(value(a)), value(n)
        if not of_rate:
            return q, m, phi
        body = Body(QUATERNION, structure, p, p[0])
        return q, along_axes(structure, body.angular_velocity, m, p), phi, z

    def whole(t: Any, h: Any, q: Vector, m: Vector, p: Vector) -> Any:
        motion = moving(p)
        x, z = steps.body(motion, t, h, start(motion, q, m, p))
        return finish(motion, x, value(z), p)

    if steps.stage is None:
        return whole
    share = method.ahead  # of h

    def staged(t: Any, h: Any, q: Vector, m: Vector, p: Vector) -> Any:
        motion, most = moving(p), 0.0
        x = start(motion, q, m, p)
        e = () if steps.prepare is None else steps.prepare(motion, h, x)
        if steps.enter is not None:
            x = steps.enter(motion, t, 0.0, share * h, x, e)
        for part, other, place in method.stages or ((1.0, 1.0, 0.0),):
            x, z = steps.stage(motion, t + place * h, part * h, other * h, x, e)
            most = larger(value(z), most)
        if steps.leave is not None:
            x = steps.leave(motion, t + h, h, share * h, x, e)
        return finish(motion, x, most, p)

    return staged


def differentiated(structure: RigidBody, p: Vector, size: int, first: int) -> Vector:
    """A body's parameters as dual numbers, except those of axes and of sample times.

    Their directions are number ``first`` of ``size`` and the following ones.
    """
    end = 9 + structure.axes
    i = seed(p[3:6], size, first)
    half = tuple(0.5 / x for x in i)
    mine = list(own_numbers(structure.law))
    numbers = [x for x, is_own in zip(p[end:], mine, strict=True) if is_own]
    seeds = iter(seed(numbers, size, first + 3, p[0]))
    torque = [next(seeds) if is_own else x for x, is_own in zip(p[end:], mine, strict=True)]
    return (*half, *i, *rigid.gyroscopic_coefficients(i), *p[9:end], *torque)


def along_axes(structure: RigidBody, formula: Formula, x: Vector, p: Vector) -> Any:
    """A formula of vectors along principal axes, applied to vectors along body axes."""
    if not structure.turned:
        return formula(x)
    axes = p[9:13]
    return quat.rotate(axes, formula(quat.rotate_inverse(axes, x)))
