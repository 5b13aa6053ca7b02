"""Lie-group methods, which are defined by their exponents.

Such a method only rotates its state, q∘exp(u1)∘exp(u2)…, so that it stays a rotation by
construction. Iserles, Munthe-Kaas, Nørsett and Zanna, *Acta Numerica* 9 (2000) 215.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, reduce
from typing import Any, NamedTuple

import numpy as np

from fastatt import checks
from fastatt.attitudes.attitude import FAMILIES
from fastatt.methods.method import BODIES, BODY, Method, Steps, named
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import Vector, axpy, dot, minus, plus, scale, weighted
from fastatt.tracing.graph import Graph, Number, larger
from fastatt.tracing.nodes import RefusedError, TraceError
from fastatt.tracing.source import function
from fastatt.tracing.trace import traceable


def one_exponential(motion: Any, t: Any, h: Any, x: Vector) -> Any:
    """The exponential of the rate at the middle of the step, which is exact for a constant rate."""
    u = scale(h, motion.rate(t + 0.5 * h))
    return motion.turned(x, u), dot(u, u)


def gauss_polynomial(w: Any, t: Any, h: Any, n: int) -> list[Vector]:
    """h times the coefficients of the rate's polynomial through n Gauss nodes, n even.

    The variable is the time from the middle of the step divided by h. For a constant rate all
    coefficients but the first are exactly 0.
    """
    nodes, even, odd = _fits(n)
    pairs = [(w(t + (0.5 - x) * h), w(t + (0.5 + x) * h)) for x in nodes]
    sums = [plus(*pair) for pair in pairs]
    moved = [minus(s, sums[0]) for s in sums[1:]]
    gaps = [minus(b, a) for a, b in pairs]
    coefficients = []
    for of_sums, of_gaps in zip(even, odd, strict=True):
        for weights, vectors in ((of_sums[1:], moved), (of_gaps, gaps)):
            k, v = weighted(weights, vectors)
            coefficients.append(scale(h * k, v))
    coefficients[0] = axpy(0.5 * h, sums[0], coefficients[0])
    return coefficients


@cache
def _fits(n: int) -> tuple[Any, Any, Any]:
    """Nodes on one side of the middle; coefficients from sums and differences of both sides."""
    nodes = 0.5 * np.polynomial.legendre.leggauss(n)[0][n // 2 :]
    even = 2.0 * np.vander(nodes**2, increasing=True)
    fits = (np.linalg.inv(even), np.linalg.inv(even * nodes[:, None]))
    return nodes.tolist(), *(fit.tolist() for fit in fits)


def turn_of_sum(exponents: list[Vector], rates: list[Vector], h: Any) -> Any:
    """Squared rotation angle of a method with one exponential, or with equal ones.

    The first rate of the step is included, since the exponents become small again where a series
    fails.
    """
    n = float(len(exponents) ** 2)
    turns = [n * dot(u, u) for u in exponents]
    return reduce(larger, [*turns, h * h * dot(rates[0], rates[0])])


def asking(motion: Any) -> tuple[Callable[[Any], Vector], list[Vector]]:
    """The rate as a function of the time, and a list of the rates that it has returned."""
    asked: list[Vector] = []

    def rate(time: Any) -> Vector:
        asked.append(motion.rate(time))
        return asked[-1]

    return rate, asked


def lie_step(exponents: Callable[..., Any], turns: Callable[..., Any]) -> Callable[..., Any]:
    """The step of ``exponents(w, t, h) -> (u1, u2, …)``, with the rate w(t)."""

    def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
        rate, asked = asking(motion)
        turned = [tuple(u) for u in exponents(rate, t, h)]
        for u in turned:
            x = motion.turned(x, u)
        return x, turns(turned, asked, h)

    return step


def body_step(
    stages: Callable[..., Any], turns: Callable[..., Any] = turn_of_sum
) -> Callable[..., Any]:
    """The step of ``stages(slope, t, h, m) -> ((u1, u2, …), d)``, as in :func:`lie_group`."""

    def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
        start, rates = motion.attitude.value(motion.attitude_of(x)), []

        def slope(time: Any, exponents: Any, m: Any) -> tuple[Vector, Vector]:
            attitude = reduce(motion.plain.rotate, map(tuple, exponents), start)
            rates.append(motion.angular_velocity(tuple(m)))
            return rates[-1], motion.momentum_rate(time, attitude, tuple(m))

        exponents, change = stages(slope, t, h, motion.momentum_of(x)[:3])
        exponents = [tuple(u) for u in exponents]
        end = reduce(motion.turned, exponents, motion.attitude_of(x))
        momentum = motion.attitude.add_vector(motion.momentum_of(x), tuple(change))
        return (*end, *momentum), turns(exponents, rates, h)

    return step


def lie_method(
    name: str,
    order: int,
    exponents: Callable[..., Any] | None,
    *,
    turns: Callable[..., Any] = turn_of_sum,
    body: Callable[..., Any] | None = None,
    limit: float = math.pi,
    body_limit: float = math.inf,
    exact_for_constant: bool = True,
    **fields: Any,
) -> Method:
    """Record of a method that rotates the state by its exponents; ``body`` steps bodies."""
    steps = Steps(
        rate=None if exponents is None else lie_step(exponents, turns),
        constant=one_exponential if exact_for_constant else None,
        body=body,
    )
    return Method(
        name=name,
        order=order,
        scenes=("rate",) * (exponents is not None) + BODIES * (body is not None),
        uses=("rotate",),
        conserves=("norm",),
        limits={**dict.fromkeys(FAMILIES, limit), BODY: body_limit},
        steps=steps,
        exact_for_constant=exact_for_constant,
        compensates=True,
        **fields,
    )


def lie_group(
    name: str,
    *,
    order: int,
    exponents: Callable[..., Any] | None = None,
    body: Callable[..., Any] | None = None,
    limit: float = 1.0,
) -> Method:
    """Define a Lie-group method for prescribed rates, rigid bodies or both.

    The step is q∘exp(u1)∘exp(u2)…, with exponents that a function computes. The method is accepted
    wherever a method's name is.

    Parameters
    ----------
    name : str
        Name of the method.
    order : int
        Declared order, which :func:`check_convergence` compares with the measured one.
    exponents : callable, optional
        ``f(w, t, h) -> (u1, u2, …)`` for prescribed rates: rotation vectors along body axes, rad,
        as tuples of three. w(t) is the rate, rad/s, t the time at the start of the step, s, and h
        the step size, s. The function is always followed: it may use arithmetic, ``a if c else b``,
        ``math`` and the kernels of :mod:`fastatt.kernels`.
    body : callable, optional
        ``f(slope, t, h, m) -> ((u1, u2, …), d)`` for rigid bodies, followed too: the exponents, and
        the change d of the momentum m along body axes, N·m·s. ``slope(time, (u1, …), m)`` returns
        the angular velocity, rad/s, and dm/dt = m×w + τ, N·m, of a body with momentum m at a time,
        after rotations by exponents from the start of the step, () for none.
    limit : float, default 1.0
        Largest ``|w| h`` of a step, rad; beyond it the status is ``STEP_TOO_LARGE``.

    Returns
    -------
    Method
        The method.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or if the exponents do not add up to h w at a constant rate
        and d is not h dm/dt at a constant one.

    Examples
    --------
    >>> import fastatt as fa
    >>> def midpoint(w, t, h):
    ...     u = w(t + 0.5 * h)
    ...     return ((h * u[0], h * u[1], h * u[2]),)
    >>> mine = fa.lie_group("mine", order=2, exponents=midpoint)
    >>> scene = fa.Scene(rate=fa.rates.Coning(0.5, 1.0))
    >>> fa.propagate(scene, [1, 0, 0, 0], dt=0.01, n_steps=100, method=mine).method
    'mine'
    """
    if exponents is None and body is None:
        raise TypeError("exponents, body: found neither; accepted: one of them, or both")
    largest = checks.above_zero("limit", limit, "above 0, rad")
    of_rate = None if exponents is None else _recorded("exponents", exponents)
    of_body = None if body is None else _recorded("body", body)
    records = [record for record in (of_rate, of_body) if record]
    return lie_method(
        named(name),
        checks.whole("order", order, 1),
        of_rate and of_rate.formula,
        body=of_body and body_step(of_body.formula),
        rate_calls=records[0].calls,
        body_calls=records[-1].calls,
        exponentials=max(record.exponentials for record in records),
        within=all(record.within for record in records),
        limit=largest,
        body_limit=largest,
        exact_for_constant=False,
        source="user-defined",
        summary="user-defined",
    )


#: what the functions of :func:`lie_group` return, by its arguments
_ACCEPTED = {
    "exponents": "f(w, t, h) -> (u1, u2, …), each of three numbers",
    "body": "f(slope, t, h, m) -> ((u1, u2, …), d), each of three numbers",
}


class _Recorded(NamedTuple):
    """A function as traced: evaluations, exponentials, and whether all are within the step."""

    formula: Callable[..., Any]
    calls: int
    exponentials: int
    within: bool


def _recorded(name: str, definition: Any) -> _Recorded:
    """Trace a function of :func:`lie_group`, named by its argument.

    Raises ``TypeError`` if it cannot be followed, and ``ValueError`` if it does not return
    exponents and, of a body, a change, or if at constant rates they are not those of a step, which
    order 1 requires.
    """
    if not callable(definition):
        raise TypeError(f"{name}: found {checks.brief(definition)}; accepted: a function")
    graph, of_body = Graph(), name == "body"
    w, n, m = (graph.inputs("double", letter, 3) for letter in "wnm")
    asked: list[Any] = []

    def rate(time: Any, *_: Any) -> Any:
        asked.append(time)
        return (w, n) if of_body else w

    try:
        formula = traceable(definition)
        step = graph.input("double", "t"), graph.input("double", "h")
        returned = formula(rate, *step, m) if of_body else formula(rate, *step)
    except (TraceError, RefusedError) as error:
        raise TypeError(f"{name}: {error}; accepted: {_ACCEPTED[name]}") from error
    pair = of_body and isinstance(returned, (tuple, list)) and len(returned) == 2
    exponents, changes = (returned[0], [returned[1]]) if pair else (returned, [])
    is_listed = isinstance(exponents, (tuple, list)) and bool(exponents) and pair == of_body
    if not asked or not is_listed or not all(map(_is_vector, [*exponents, *changes])):
        raise ValueError(
            f"{name}: found a function that gives no tuple of exponents made from "
            f"{'slope' if of_body else 'w(t)'}; accepted: {_ACCEPTED[name]}"
        )
    results = *plus(*map(tuple, exponents)), *(x for change in changes for x in change)
    total = Flat(graph, (*results, *asked), "double")
    numbers = (0.3, -0.5, 0.7, 0.2, 0.4, -0.6, 0.1, 0.2, 0.3)
    slopes = numbers[: len(results)]
    letters = [(letter, k) for letter in "wnm" for k in range(3)]
    values: dict[Any, float] = {**dict(zip(letters, numbers, strict=True)), ("t",): 0.4}
    for h in (1e-6, 1e-2, 1.0):  # what a higher power of h adds is large in large steps
        values["h",] = h
        outputs = function(total)(*(values[key] for key in total.inputs()))
        ends, times = outputs[: len(results)], outputs[len(results) :]
        if not all(abs(a - h * b) <= 1e-9 * h for a, b in zip(ends, slopes, strict=True)):
            sums = tuple(float(round(x / h, 9)) for x in ends)
            raise ValueError(
                f"{name}: at the constant rate {slopes[:3]} they add up to h {sums[:3]}"
                + f", and d at dm/dt = {slopes[3:]} is h {sums[3:]}" * of_body
                + f"; accepted: h w{' and h dm/dt' * of_body} (with h = {h})"
            )
    shares = [(time - values["t",]) / values["h",] for time in times]
    within = all(-1e-6 < share < 1.0 + 1e-6 for share in shares)
    return _Recorded(formula, len(asked), len(exponents), within)


def _is_vector(u: Any) -> bool:
    return (
        isinstance(u, (tuple, list))
        and len(u) == 3
        and all(isinstance(x, (Number, float, int)) for x in u)
    )
