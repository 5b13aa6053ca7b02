"""A row and a cell of the tables, and what an error may be where the status is 0."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fastatt as fa
from fastatt.methods import Method

Array = NDArray[np.float64]

# what a step may err by, rad a rad turned, where its status is 0: the word of the records' limits
PROMISE = 0.1
# a step rounds each number of the state, and each angle, a few times
ROUNDINGS = 16.0
# Error of a step, rad a rad turned, over measure^order: twice the worst below the limit of cones
# with half angles of 0.5, 1 and 2 rad, and of free bodies that can exist. The measure is the turn θ
# in a step, or what the method's limit is of; of splittings, whose limit is of g, it is
# (g² θ^(order−2))^(1/order). `python bench/extremes_page.py --coefficients METHOD` measures them.
OF_CONES = {
    "lie_euler": 2.0, "lie_midpoint": 0.4, "rk4": 0.035, "magnus4": 0.035, "magnus6": 4e-3,
    "magnus8": 4e-4, "gauss12": 8.4e-8, "cf4": 0.011, "rkmk4": 0.023, "cg3": 0.11,
}  # fmt: skip
OF_BODIES = {
    "rk4": 0.017, "cf4": 0.017, "rkmk4": 0.017, "rk8": 4.5e-7, "rk9": 1.7e-7, "gbs16": 1.2e-13,
    "strang2": 0.33, "kahan_li8": 1.1e-5, "dmv2": 0.44, "dmv10": 4e-8,
}  # fmt: skip
# a matrix turns by the angle, a quaternion by half of it
OF_BODIES_IN_MATRICES = {"rk4": 0.024, "rk8": 1.6e-6, "rk9": 7e-7}
OF_PENDULA = {
    "rk4": 3e-4, "cf4": 3e-4, "rkmk4": 3e-4, "rk8": 1.2e-8, "rk9": 7e-9, "gbs16": 1.1e-15,
    "strang2": 1.5e-3, "kahan_li8": 8e-9,
}  # fmt: skip
OF_PENDULA_IN_MATRICES = {"rk8": 2.8e-7, "rk9": 9.5e-8, "gbs16": 4e-14}
OF_RATES = {
    "hold": 2.0, "trapezoid": 0.8, "previous": 0.5, "coning2": 6.0, "picard": 500.0,
}  # fmt: skip
OF_INCREMENTS = {
    "hold": 0.3, "previous": 0.07, "coning2": 0.8, "picard": 130.0,
}  # fmt: skip
ANGLES = ("euler313",)
# the same of coordinates, whose own speed has to stay below their limit
ANGLES_PROMISE = 1e-3
START = np.array([0.6, 0.5, -0.4, 0.48]) / np.linalg.norm([0.6, 0.5, -0.4, 0.48])
ONE = np.array([1.0, 0.0, 0.0, 0.0])


class Case(NamedTuple):
    """A row: a method on a representation in a precision, carrying what rounding loses or not."""

    method: str
    representation: str = "quat"
    dtype: str = "float64"
    compensated: bool = False

    @property
    def record(self) -> Method:
        return fa.METHODS[self.method]

    @property
    def eps(self) -> float:
        return float(np.finfo(self.dtype).eps)

    @property
    def work(self) -> int:
        """Times that a step touches the state: stages, or terms of a series."""
        record = self.record
        return max(record.rate_calls, len(record.stages), record.order // 2, 2)


class Outcome(NamedTuple):
    """Error of each body of a cell and what it may be, rad, and status, each (N,)."""

    error: Array
    allowed: Array
    status: NDArray[np.uint16]

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Bodies whose status is 0 and whose error is more than can be explained."""
        return (self.status == 0) & ~(self.error <= self.allowed)

    @property
    def text(self) -> str:
        """The worst error of status 0 and the names of all flags."""
        parts = []
        fine = self.status == 0
        if fine.any():
            worst = float(np.max(self.error[fine]))
            parts.append(f"{worst:.0e}" if worst else "0")
        every = int(np.bitwise_or.reduce(self.status))
        parts += [flag.name for flag in fa.Status if flag and every & flag]
        return " ".join(parts) + (" **wrong**" if self.wrong.any() else "")


class Column(NamedTuple):
    """An extreme, and which cases it is for."""

    name: str
    run: Callable[[Case], Outcome]
    fits: Callable[[Case], bool] = lambda case: True


class Table(NamedTuple):
    """Extremes side by side, for the methods of one kind of scene."""

    title: str
    text: str
    scene: str
    columns: Sequence[Column]


# quaternions


def mul(p: Array, q: Array) -> Array:
    return np.asarray(fa.quat_multiply(p, q))


def exp(u: Array) -> Array:
    return np.asarray(fa.rotation_vector_to_quat(u))


def angle(p: Array, q: Array) -> Array:
    """Angle between attitudes, rad; of what is no attitude NaN."""
    p = np.asarray(p, dtype=float)
    bad = ~np.isfinite(p).all(axis=-1) | ~(np.abs(np.linalg.norm(p, axis=-1) - 1.0) < 1e-3)
    safe = np.where(bad[..., None], ONE, p)
    return np.where(bad, np.nan, fa.angle_between(safe, q))


# what is true of all methods


def kept(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, which works once for the same numbers."""
    found: dict[Any, Any] = {}

    @functools.wraps(function)
    def asked(*args: Any) -> Any:
        key = tuple((x.shape, x.tobytes()) if isinstance(x, np.ndarray) else x for x in args)
        if key not in found:
            found[key] = function(*args)
        return found[key]

    return asked


# what is allowed


def share(coefficients: Mapping[str, float], method: str, order: int, grows: Array) -> Array:
    """Error, rad a rad turned, that a step of status 0 may have: at most the limits' promise."""
    # the closed form is of order 0 and makes no steps
    power = np.minimum(grows, 10.0) ** order
    if order and method not in coefficients:
        raise LookupError(
            f"{method}: the tables of tests/extremes/cases.py need its coefficients, which "
            f"`python bench/extremes_page.py --coefficients {method}` prints"
        )
    return np.asarray(np.minimum(PROMISE, coefficients.get(method, 0.0) * power))


def of_matrices(
    case: Case, known: Mapping[str, float], differ: Mapping[str, float]
) -> Mapping[str, float]:
    """Coefficients, with those that differ on direction cosines, which turn by the whole angle."""
    return {**known, **differ} if case.representation.startswith("dcm") else known


def truncation(case: Case, theta: Array) -> Array:
    """Error that a step at a given rate may have, rad, where the body turns by theta rad."""
    if case.representation in ANGLES:
        return np.full_like(theta, ANGLES_PROMISE * case.record.limit(case.representation))
    return theta * share(OF_CONES, case.method, case.record.order, theta)


def rounding(case: Case, n_steps: int, turned: Array) -> Array:
    """Round-off of a run that turns by so many rad in all."""
    return np.asarray(ROUNDINGS * case.eps * (n_steps * case.work + turned))


def propagate(
    case: Case, scene: fa.Scene, q0: Array, w0: Array | None = None, **options: Any
) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return fa.propagate(
            scene, q0, w0, method=case.method, representation=case.representation,
            dtype=case.dtype, n_threads=1, compensated=case.compensated, **options,
        )  # fmt: skip


# given rates


def single(x: Any) -> Array:
    """Numbers that both precisions hold."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(x, dtype=np.float32).astype(float)
