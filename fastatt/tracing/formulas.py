"""The kernels for recorded numbers, and tuples of such numbers combined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from typing import Any

from fastatt import kernels
from fastatt.tracing.graph import choose
from fastatt.tracing.recorded import Recorded
from fastatt.tracing.trace import kind_of, stand_in

compensated: Any = stand_in(kernels.compensated)
coning: Any = stand_in(kernels.coning)
dcm: Any = stand_in(kernels.dcm)
euler313: Any = stand_in(kernels.euler313)
free_body: Any = stand_in(kernels.free_body)
heavy_top: Any = stand_in(kernels.heavy_top)
moser_veselov: Any = stand_in(kernels.moser_veselov)
quat: Any = stand_in(kernels.quat)
rigid: Any = stand_in(kernels.rigid)
so3: Any = stand_in(kernels.so3)
trig: Any = stand_in(kernels.trig)
vec3: Any = stand_in(kernels.vec3)

Vector = tuple[Any, ...]


def as_like(x: Any, like: Any) -> Any:
    """x in the precision of ``like``; of tuples each number."""
    if isinstance(x, tuple):
        return tuple(as_like(y, like) for y in x)
    return kind_of(like)(x)


def plus(*vectors: Vector) -> Vector:
    """The sum."""
    return tuple(reduce(lambda a, b: a + b, column) for column in zip(*vectors, strict=True))


def minus(x: Vector, y: Vector) -> Vector:
    """x − y."""
    return tuple(a - b for a, b in zip(x, y, strict=True))


def opposite(x: Vector) -> Vector:
    """−x."""
    return tuple(-a for a in x)


def scale(k: Any, x: Vector) -> Vector:
    """k x."""
    return tuple(k * a for a in x)


def product(x: Vector, y: Vector) -> Vector:
    """x_i y_i."""
    return tuple(a * b for a, b in zip(x, y, strict=True))


def axpy(k: Any, x: Vector, y: Vector) -> Vector:
    """k x + y."""
    return tuple(k * a + b for a, b in zip(x, y, strict=True))


def dot(x: Vector, y: Vector) -> Any:
    """Σ x_i y_i."""
    return reduce(lambda a, b: a + b, (a * b for a, b in zip(x, y, strict=True)))


def weighted(weights: Sequence[float], vectors: Sequence[Vector]) -> tuple[float, Vector]:
    """(k, y) with k y = Σ weights[i] vectors[i], k the largest weight, a product a vector less."""
    terms = [(w, v) for w, v in zip(weights, vectors, strict=True) if w != 0.0]
    k, first = max(terms, key=lambda term: abs(term[0]))
    rest = [(w, v) for w, v in terms if v is not first]
    return k, reduce(lambda y, term: axpy(term[0] / k, term[1], y), rest, first)


def largest(vectors: Iterable[Vector]) -> Vector:
    """Of each number the one that is largest in size."""
    return reduce(
        lambda x, y: tuple(
            choose(abs(a) > abs(b), a, b) if isinstance(a, Recorded) or isinstance(b, Recorded)
            else max(a, b, key=abs)
            for a, b in zip(x, y, strict=True)
        ),
        vectors,
    )  # fmt: skip
