"""Explicit Runge-Kutta methods on the numbers of the state, which are defined by their tableaus.

A tableau is checked when it is made: row sums, and the order conditions of every rooted tree up to
its order. Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I* (1993), §II.2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from fastatt import checks
from fastatt.attitudes.attitude import FAMILIES
from fastatt.methods.lie_group import named
from fastatt.methods.method import BODIES, Method, Steps
from fastatt.tracing.formulas import Vector, axpy, largest, scale, weighted

# order conditions beyond, 719 of order 10 alone, are not checked
_CHECKED = 9
_CLOSE = 1e-12
# the generators that multiply w: −i/2 times the Pauli matrices, and [e_k×]
_QUATERNIONS = -0.5j * np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]])
_MATRICES = np.cross(np.eye(3)[None], np.eye(3)[:, None])


@dataclass(frozen=True)
class Tableau:
    """The coefficients c, a and b of a method; a has a row for each stage but the first.

    Raises ``ValueError`` if a row does not sum to its node, or an order condition does not hold.
    """

    order: int
    c: tuple[float, ...]
    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]

    def __post_init__(self) -> None:
        numbers = (*self.c, *(x for row in self.a for x in row), *self.b)
        if not all(map(math.isfinite, numbers)):
            raise ValueError("c, a, b: found numbers that are not finite; accepted: finite ones")
        s = len(self.b)
        if len(self.c) != s or len(self.a) != s - 1:
            raise ValueError(
                f"c, a, b: found {len(self.c)} nodes, {len(self.a)} rows and {s} weights; "
                "accepted: as many nodes as weights, and a row for each stage but the first"
            )
        for i, row in enumerate(self.a, 1):
            if len(row) != i:
                raise ValueError(f"a[{i - 1}]: found {len(row)} numbers; accepted: {i}")
            if abs(math.fsum(row) - self.c[i]) > _CLOSE * max(1.0, *map(abs, row)):
                raise ValueError(
                    f"a[{i - 1}]: its sum is {math.fsum(row)!r}; accepted: the node c[{i}], "
                    f"{self.c[i]!r}"
                )
        if self.c[0] != 0.0:
            raise ValueError(f"c[0]: found {self.c[0]!r}; accepted: 0, of an explicit method")
        self._check_order()

    def _check_order(self) -> None:
        s = len(self.b)
        matrix = np.zeros((s, s))
        for i, row in enumerate(self.a, 1):
            matrix[i, :i] = row
        b = np.array(self.b)
        size = max(1.0, float(np.abs(matrix).sum(axis=1).max()), float(np.abs(b).sum()))
        values: dict[Any, Any] = {(): np.ones(s)}
        stems: dict[Any, Any] = {}

        def of(tree: Any) -> Any:
            if tree not in values:
                *rest, branch = tree
                if branch not in stems:
                    stems[branch] = matrix @ of(branch)
                values[tree] = of(tuple(rest)) * stems[branch]
            return values[tree]

        for n in range(1, min(self.order, _CHECKED) + 1):
            for tree in trees(n):
                found, wanted = float(b @ of(tree)), 1.0 / density(tree)
                if abs(found - wanted) > _CLOSE * size**2:
                    raise ValueError(
                        f"a, b: a condition of order {n} gives {found:.15g}, not {wanted:.15g}; "
                        f"accepted: a tableau of order {self.order}, or a lower order declared"
                    )

    @property
    def stages(self) -> int:
        """The number of stages."""
        return len(self.b)


@cache
def trees(n: int) -> tuple[Any, ...]:
    """Rooted trees of n nodes; a tree is the sorted tuple of its root's branches."""
    if n == 1:
        return ((),)
    found = set()
    for k in range(1, n):
        for rest in trees(n - k):
            for branch in trees(k):
                found.add(tuple(sorted((*rest, branch))))
    return tuple(sorted(found))


def nodes(tree: Any) -> int:
    """Number of nodes."""
    return 1 + sum(nodes(branch) for branch in tree)


def density(tree: Any) -> int:
    """γ of a tree: the product of the sizes of all subtrees."""
    return nodes(tree) * math.prod(density(branch) for branch in tree)


def stepped(tableau: Tableau, *, first_turn: bool = False) -> Any:
    """The step of a tableau for any equations of motion.

    z is that of the fastest stage. ``first_turn`` uses the rotation of the body at the start of the
    step in place of that of the last stage.
    """
    s = len(tableau.b)
    # the stage after which each slope of the sum is no longer needed
    rows = (*((), *tableau.a), ())
    last = [max((i for i in range(j + 1, s) if rows[i][j]), default=s) for j in range(s)]
    done = [[j for j in range(s) if last[j] == i and tableau.b[j]] for i in range(s + 1)]
    # weights are divided by the first one, to save a product, or by the largest if that is small
    k = next(tableau.b[j] for part in done for j in part)
    k = k if abs(k) > 0.1 * max(map(abs, tableau.b)) else max(tableau.b, key=abs)

    def step(motion: Any, t: Any, h: Any, x: Vector) -> Any:
        start = motion.base(x)
        given: dict[float, Any] = {}
        slopes: list[Vector] = []
        d: Vector | None = None
        y = start
        for i, (c, row) in enumerate(zip(tableau.c, ((), *tableau.a), strict=True)):
            if any(row):
                factor, sum_ = weighted(row, slopes)
                y = axpy(h * factor, sum_, start)
            # a slope that no later stage needs is added now, to keep fewer values in registers
            for j in done[i]:
                d = _added(tableau.b[j] / k, slopes[j], d)
            if c not in given:
                given[c] = motion.at(t + c * h)
            slopes.append(motion.field(given[c], y))
        for j in done[len(tableau.b)]:
            d = _added(tableau.b[j] / k, slopes[j], d)
        assert d is not None
        # coordinates may be nearer to their pole at a stage than at the start of the step
        most = largest(slopes) if motion.attitude.has_poles else slopes[0]
        z = h * h * motion.turning(given[tableau.c[0]], most, start if first_turn else y)
        return motion.advanced(x, scale(h * k, d)), z

    return step


def _added(weight: float, slope: Vector, total: Vector | None) -> Vector:
    return scale(weight, slope) if total is None else axpy(weight, slope, total)


def explicit_method(
    name: str,
    tableau: Tableau,
    of_quaternions: float,
    of_matrices: float,
    *,
    scenes: tuple[str, ...] = ("rate", *BODIES),
    first_turn: bool = False,
    **fields: Any,
) -> Method:
    """The record of a tableau, with its limits."""
    # modified Rodrigues parameters may pass from a rotation of π towards 2π within a step, where
    # they are infinite, and the rates of angles grow without bound near their poles
    of_mrp = min(0.8 * of_quaternions, 2.5)
    limits = dict(zip(FAMILIES, (of_quaternions, of_matrices, of_mrp, 0.3), strict=True))
    step = stepped(tableau, first_turn=first_turn)
    return Method(
        name=name,
        order=tableau.order,
        scenes=scenes,
        uses=("derivative",),
        conserves=(),
        rate_calls=len(set(tableau.c)) if "rate" in scenes else tableau.stages,
        exponentials=0,
        compensates=True,
        couples=True,
        limits=limits,
        steps=Steps(rate=step if "rate" in scenes else None, body=step),
        **fields,
    )


def runge_kutta(
    name: str,
    *,
    order: int,
    c: Sequence[float],
    a: Sequence[Sequence[float]],
    b: Sequence[float],
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

    Returns
    -------
    Method
        The method.

    Raises
    ------
    ValueError, TypeError
        If the numbers are not a tableau, a row does not sum to its node, or an order condition does
        not hold.

    Notes
    -----
    The limits of the step size (``Method.limits``) are measured when the method is defined. A step
    at a constant rate has an error of at most 5 % of the angle and 20 % of the norm, and one on a
    cone of half angle 0.5 rad, whose rate rotates twice as fast as the body, an error of at most
    10 % of the angle. Modified Rodrigues parameters have 0.8 of the limit of quaternions and at
    most 2.5 rad, and coordinates with poles 0.3 rad. Linear damping is limited to the largest c h/I
    whose factor has an error of at most 0.1.

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
    return explicit_method(
        named(name),
        tableau,
        min(_of_cones(tableau, _QUATERNIONS), _trusted(tableau, 0.5)),
        min(_of_cones(tableau, _MATRICES), _trusted(tableau, 1.0)),
        damping_limit=_damping(tableau),
        within=all(-_CLOSE <= c <= 1.0 + _CLOSE for c in tableau.c),
        summary="user-defined",
        source="user-defined",
    )


def _numbers(name: str, values: Any) -> tuple[float, ...]:
    return tuple(checks.array(name, values, "(s,)", flag=True).tolist())


def _growth(tableau: Tableau, z: complex) -> complex:
    """The factor of one step of y' = z y."""
    slopes: list[complex] = []
    for row in ((), *tableau.a):
        slopes.append(z * (1.0 + sum(w * k for w, k in zip(row, slopes, strict=True))))
    return 1.0 + sum(w * k for w, k in zip(tableau.b, slopes, strict=True))


def _trusted(tableau: Tableau, k: float) -> float:
    """Largest angle (rad) at a constant rate that is right to 5 %, with a norm right to 20 %."""
    for theta in np.arange(0.05, 6.0, 0.05):
        factor = _growth(tableau, 1j * k * theta)
        angle = math.atan2(factor.imag, factor.real) / k
        if abs(angle - theta) > 0.05 * theta or abs(abs(factor) - 1.0) > 0.2:
            return max(0.05, float(theta) - 0.05)
    return 6.0


def _of_cones(tableau: Tableau, generators: Any) -> float:
    """Largest rotation angle (rad) about a cone of half angle 1/2 with a relative error of 10 %.

    w rotates twice as fast as the body there. Quaternions and matrices obey Ẋ = X Σ w_k G_k, with
    the ``generators`` G, whose X(1) is exp(w(0) + Ω e3) exp(−Ω e3).
    """
    theta = np.arange(0.05, 6.01, 0.05)
    frequency = theta / (2.0 * math.sin(0.25))

    def turned(t: float) -> Any:
        s, c = np.sin(frequency * t), np.cos(frequency * t)
        across = math.sin(0.5) * frequency
        w = np.stack([-across * s, across * c, -math.sin(0.25) * theta], axis=-1)
        return np.tensordot(w, generators, 1)

    def exponential(x: Any) -> Any:
        values, v = np.linalg.eigh(1j * x)
        return (v * np.exp(-1j * values)[:, None]) @ v.conj().swapaxes(1, 2)

    slopes: list[Any] = []
    size = generators.shape[-1]
    for t, row in zip(tableau.c, ((), *tableau.a), strict=True):
        x = np.eye(size) + sum(k * d for k, d in zip(row, slopes, strict=True))
        slopes.append(x @ turned(t))
    end = np.eye(size) + sum(k * d for k, d in zip(tableau.b, slopes, strict=True))
    u, _, v = np.linalg.svd(end)
    spin = frequency[:, None, None] * generators[2]
    true = exponential(turned(0.0) + spin) @ exponential(-spin)
    trace = np.einsum("nij,nij->n", true.conj(), u @ v).real
    # the trace for a rotation by φ is 2 cos φ/2 or 1 + 2 cos φ
    half = 0.5 * (trace if size == 2 else np.sqrt(np.maximum(trace + 1.0, 0.0)))
    wrong = 2.0 * np.arccos(np.clip(half, 0.0, 1.0)) > 0.1 * theta
    return float(theta[max(0, int(wrong.argmax()) - 1)]) if wrong.any() else 6.0


def _damping(tableau: Tableau) -> float:
    """Largest c h/I for which the damping factor is right to 0.1."""
    for x in np.arange(0.05, 8.0, 0.05):
        if abs(_growth(tableau, -x) - math.exp(-x)) > 0.1:
            return max(0.05, float(x) - 0.05)
    return 8.0
