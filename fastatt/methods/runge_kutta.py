"""Explicit Runge-Kutta methods of users, with a check of their order.

A tableau is checked by its row sums, and by the order conditions of every rooted tree up to its
order. Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I* (1993), §II.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from fastatt import checks
from fastatt.methods.explicit import Tableau, explicit_method
from fastatt.methods.method import Method, named

# order conditions beyond, 719 of order 10 alone, are not checked
_CHECKED = 9
_CLOSE = 1e-12


def runge_kutta(
    name: str,
    *,
    order: int,
    c: Sequence[float],
    a: Sequence[Sequence[float]],
    b: Sequence[float],
    limit: float = 1.0,
) -> Method:
    """Define an explicit Runge-Kutta method by its tableau.

    The method is accepted wherever a method's name is.

    Parameters
    ----------
    name : str
        Name of the method.
    order : int
        Declared order. Up to order 9 all order conditions are checked.
    c : sequence of float
        Nodes, the first of which is 0. A method with nodes outside [0, 1] refuses scenes with
        breakpoints or sampled controllers, where it would lose its order.
    a : sequence of sequence of float
        A row for each stage but the first, of one number, two, and so on.
    b : sequence of float
        Weights.
    limit : float, default 1.0
        Largest ``|w| h`` of a step, rad, and c h/I of linear damping; beyond it the status is
        ``STEP_TOO_LARGE``. Modified Rodrigues parameters have 0.8 of the limit and at most 2.5 rad,
        and coordinates with poles 0.3 rad.

    Returns
    -------
    Method
        The method.

    Raises
    ------
    ValueError, TypeError
        If the numbers are not a tableau, a row does not sum to its node, or an order condition does
        not hold.

    References
    ----------
    Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I* (1993), §II.2.

    Examples
    --------
    >>> import fastatt as fa
    >>> rk3 = fa.runge_kutta(
    ...     "ralston3", order=3, c=(0, 1 / 2, 3 / 4), a=((1 / 2,), (0, 3 / 4)),
    ...     b=(2 / 9, 1 / 3, 4 / 9),
    ... )
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> fa.propagate(scene, [1, 0, 0, 0], [0.1, 0.2, 0.3], dt=0.01, n_steps=10, method=rk3).method
    'ralston3'
    """
    rows = tuple(_numbers(f"a[{i}]", row) for i, row in enumerate(checks.several("a", a, "rows")))
    numbers = _numbers("c", c), rows, _numbers("b", b)
    tableau = Tableau(checks.whole("order", order, 1), *numbers)
    check(tableau)
    limit = checks.above_zero("limit", limit, "above 0, rad")
    return explicit_method(
        named(name),
        tableau,
        of_quaternions=limit,
        of_matrices=limit,
        damping_limit=limit,
        within=all(-_CLOSE <= c <= 1.0 + _CLOSE for c in tableau.c),
        summary="user-defined",
        source="user-defined",
    )


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    return tuple(checks.array(name, values, "(s,)").tolist())


def check(tableau: Tableau) -> None:
    """Refuse coefficients with a row that does not sum to its node, or with another order."""
    s = len(tableau.b)
    if len(tableau.c) != s or len(tableau.a) != s - 1:
        raise ValueError(
            f"c, a, b: found {len(tableau.c)} nodes, {len(tableau.a)} rows and {s} weights; "
            "accepted: as many nodes as weights, and a row for each stage but the first"
        )
    for i, row in enumerate(tableau.a, 1):
        if len(row) != i:
            raise ValueError(f"a[{i - 1}]: found {len(row)} numbers; accepted: {i}")
        if abs(math.fsum(row) - tableau.c[i]) > _CLOSE * max(1.0, *map(abs, row)):
            raise ValueError(
                f"a[{i - 1}]: its sum is {math.fsum(row)!r}; accepted: the node c[{i}], "
                f"{tableau.c[i]!r}"
            )
    if tableau.c[0] != 0.0:
        raise ValueError(f"c[0]: found {tableau.c[0]!r}; accepted: 0, of an explicit method")
    _check_order(tableau)


def _check_order(tableau: Tableau) -> None:
    s = len(tableau.b)
    matrix = np.zeros((s, s))
    for i, row in enumerate(tableau.rows):
        matrix[i, :i] = row
    b = np.array(tableau.b)
    size = max(1.0, float(np.abs(matrix).sum(axis=1).max()), float(np.abs(b).sum()))

    @cache
    def of_stages(tree: Any) -> Any:
        return math.prod((matrix @ of_stages(branch) for branch in tree), start=np.ones(s))

    for n in range(1, min(tableau.order, _CHECKED) + 1):
        for tree in trees(n):
            weight, wanted = float(b @ of_stages(tree)), 1.0 / density(tree)
            if abs(weight - wanted) > _CLOSE * size**2:
                raise ValueError(
                    f"a, b: a condition of order {n} gives {weight:.15g}, not {wanted:.15g}; "
                    f"accepted: a tableau of order {tableau.order}, or a lower order declared"
                )


@cache
def trees(n: int) -> tuple[Any, ...]:
    """Rooted trees of n nodes; a tree is the sorted tuple of its root's branches."""
    if n == 1:
        return ((),)
    grown = set()
    for k in range(1, n):
        for rest in trees(n - k):
            for branch in trees(k):
                grown.add(tuple(sorted((*rest, branch))))
    return tuple(sorted(grown))


def nodes(tree: Any) -> int:
    """Number of nodes."""
    return 1 + sum(nodes(branch) for branch in tree)


def density(tree: Any) -> int:
    """γ of a tree: the product of the sizes of all subtrees."""
    return nodes(tree) * math.prod(density(branch) for branch in tree)
