"""Lie-group methods for a prescribed rate, which are defined by their exponents.

Such a method only rotates its state, q∘exp(u1)∘exp(u2)…, so that it stays a rotation by
construction. Iserles, Munthe-Kaas, Nørsett and Zanna, *Acta Numerica* 9 (2000) 215.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, reduce
from typing import Any

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

    def rate(at: Any) -> Vector:
        asked.append(motion.rate(at))
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


def lie_method(
    name: str,
    order: int,
    exponents: Callable[..., Any],
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
        rate=lie_step(exponents, turns),
        constant=one_exponential if exact_for_constant else None,
        body=body,
    )
    return Method(
        name=name,
        order=order,
        scenes=("rate",) if body is None else ("rate", *BODIES),
        uses=("rotate",),
        conserves=("norm",),
        limits={**dict.fromkeys(FAMILIES, limit), BODY: body_limit},
        steps=steps,
        exact_for_constant=exact_for_constant,
        compensates=True,
        **fields,
    )


def lie_group(
    name: str, *, order: int, exponents: Callable[..., Any], limit: float = 1.0
) -> Method:
    """Define a Lie-group method for prescribed rates.

    The step is q∘exp(u1)∘exp(u2)…, with exponents that a function computes from the rate. The
    method is accepted wherever a method's name is.

    Parameters
    ----------
    name : str
        Name of the method.
    order : int
        Declared order, which :func:`check_convergence` compares with the measured one.
    exponents : callable
        ``f(w, t, h) -> (u1, u2, …)``, rotation vectors along body axes, rad, as tuples of three.
        w(t) is the rate, rad/s, t the time at the start of the step, s, and h the step size, s. The
        function is always followed: it may use arithmetic, ``a if c else b``, ``math`` and the
        kernels of :mod:`fastatt.kernels`.
    limit : float, default 1.0
        Largest ``|w| h`` of a step, rad; beyond it the status is ``STEP_TOO_LARGE``.

    Returns
    -------
    Method
        The method.

    Raises
    ------
    TypeError, ValueError
        If an argument does not fit, or if the exponents do not add up to h w at a constant rate.

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
    if not callable(exponents):
        raise TypeError(f"exponents: found {checks.brief(exponents)}; accepted: a function")
    found_limit = checks.above_zero("limit", limit, "above 0, rad")
    try:
        formula = traceable(exponents)
        rate_calls, exponentials, within = _recorded(formula)
    except (TraceError, RefusedError) as error:
        raise TypeError(f"exponents: {error}; accepted: f(w, t, h) -> (u1, u2, …)") from error
    return lie_method(
        named(name),
        checks.whole("order", order, 1),
        formula,
        rate_calls=rate_calls,
        exponentials=exponentials,
        within=within,
        limit=found_limit,
        exact_for_constant=False,
        source="user-defined",
        summary="user-defined",
    )


def _recorded(formula: Callable[..., Any]) -> tuple[int, int, bool]:
    """How often exponents evaluate the rate, how many there are, and whether within the step only.

    Raises ``ValueError`` if the function does not return a tuple of exponents, or if they do not
    add up to the rotation of a step at a constant rate, which order 1 requires.
    """
    graph = Graph()
    asked: list[Any] = []

    def rate(at: Any) -> Vector:
        asked.append(at)
        return graph.inputs("double", "w", 3)

    exponents = formula(rate, graph.input("double", "t"), graph.input("double", "h"))
    fits = isinstance(exponents, (tuple, list)) and all(
        isinstance(u, (tuple, list))
        and len(u) == 3
        and all(isinstance(x, (Number, float, int)) for x in u)
        for u in exponents
    )
    if not fits or not exponents or not asked:
        raise ValueError(
            "exponents: found a function that gives no tuple of exponents made from w(t); "
            "accepted: f(w, t, h) -> (u1, u2, …), each of three numbers"
        )
    total = Flat(graph, (*plus(*map(tuple, exponents)), *asked), "double")
    values = {("w", 0): 0.3, ("w", 1): -0.5, ("w", 2): 0.7, ("t",): 0.4}
    for h in (1e-6, 1e-2, 1.0):  # what a higher power of h adds is large in large steps
        values["h",] = h
        turned = function(total)(*(values[name] for name in total.inputs()))
        turned, times = turned[:3], turned[3:]
        wanted = [h * values["w", k] for k in range(3)]
        if not all(abs(a - b) <= 1e-9 * h for a, b in zip(turned, wanted, strict=True)):
            rates = tuple(float(round(x / h, 9)) for x in turned)
            raise ValueError(
                f"exponents: at the constant rate (0.3, -0.5, 0.7) they add up to h {rates}; "
                f"accepted: h w (with h = {h})"
            )
    shares = [(time - values["t",]) / values["h",] for time in times]
    return len(asked), len(exponents), all(-1e-6 < share < 1.0 + 1e-6 for share in shares)
