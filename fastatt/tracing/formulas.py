"""Kernels for traced numbers, and operations on tuples of such numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any

from fastatt.tracing.graph import Recorded, choose
from fastatt.tracing.operations import own_type_of
from fastatt.tracing.trace import Traceable

Vector = tuple[Any, ...]


def kernels(module: str) -> Any:
    """A module of kernels for traced numbers."""
    return Traceable(f"fastatt.kernels.{module}")


dcm = kernels("dcm")
euler313 = kernels("euler313")
free_body = kernels("free_body")
heavy_top = kernels("heavy_top")
mrp = kernels("mrp")
quat = kernels("quat")
rigid = kernels("rigid")
so3 = kernels("so3")
trig = kernels("trig")
vec3 = kernels("vec3")


def as_like(x: Any, like: Any) -> Any:
    """x in the precision of ``like``; for tuples each number."""
    if isinstance(x, tuple):
        return tuple(as_like(y, like) for y in x)
    return own_type_of(like)(x)


def plus(*vectors: Vector) -> Vector:
    """Sum of vectors."""
    return tuple(reduce(lambda a, b: a + b, column) for column in zip(*vectors, strict=True))


def minus(x: Vector, y: Vector) -> Vector:
    """Difference x − y."""
    return tuple(a - b for a, b in zip(x, y, strict=True))


def opposite(x: Vector) -> Vector:
    """Opposite vector −x."""
    return tuple(-a for a in x)


def scale(k: Any, x: Vector) -> Vector:
    """Multiple k x."""
    return tuple(k * a for a in x)


def product(x: Vector, y: Vector) -> Vector:
    """Elementwise product x_i y_i."""
    return tuple(a * b for a, b in zip(x, y, strict=True))


def axpy(k: Any, x: Vector, y: Vector) -> Vector:
    """Sum k x + y."""
    return tuple(k * a + b for a, b in zip(x, y, strict=True))


def dot(x: Vector, y: Vector) -> Any:
    """Scalar product Σ x_i y_i."""
    return reduce(lambda a, b: a + b, (a * b for a, b in zip(x, y, strict=True)))


def weighted(weights: Sequence[float], vectors: Sequence[Vector]) -> tuple[float, Vector]:
    """(k, y) with k y = Σ weights[i] vectors[i] and the largest weight k, to save products."""
    terms = [(w, v) for w, v in zip(weights, vectors, strict=True) if w != 0.0]
    k, first = max(terms, key=lambda term: abs(term[0]))
    rest = [(w, v) for w, v in terms if v is not first]
    return k, reduce(lambda y, term: axpy(term[0] / k, term[1], y), rest, first)


def largest(vectors: Iterable[Vector]) -> Vector:
    """For each component the number of largest size."""
    return reduce(
        lambda x, y: tuple(
            choose(abs(a) > abs(b), a, b) if isinstance(a, Recorded) or isinstance(b, Recorded)
            else max(a, b, key=abs)
            for a, b in zip(x, y, strict=True)
        ),
        vectors,
    )  # fmt: skip
