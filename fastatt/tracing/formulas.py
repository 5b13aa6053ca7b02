"""Kernels for traced numbers, and operations on tuples of such numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import reduce
from importlib import import_module
from typing import Any

from fastatt.tracing.graph import Graph, Number, _of, choose
from fastatt.tracing.mathematics import kind_of
from fastatt.tracing.nodes import Recorded, operands
from fastatt.tracing.trace import stand_in

Vector = tuple[Any, ...]
#: the largest number of operations between a factor and its inputs in the search
_DEPTH = 5


class Kernels:
    """A module of kernels for traced numbers; it is imported when one of them is first used."""

    def __init__(self, module: str) -> None:
        self._module = f"fastatt.kernels.{module}"

    def __getattr__(self, name: str) -> Any:
        kernel = self.__dict__[name] = stand_in(getattr(import_module(self._module), name))
        return kernel


dcm: Any = Kernels("dcm")
euler313: Any = Kernels("euler313")
free_body: Any = Kernels("free_body")
heavy_top: Any = Kernels("heavy_top")
mrp: Any = Kernels("mrp")
quat: Any = Kernels("quat")
rigid: Any = Kernels("rigid")
so3: Any = Kernels("so3")
trig: Any = Kernels("trig")
vec3: Any = Kernels("vec3")


def as_like(x: Any, like: Any) -> Any:
    """x in the precision of ``like``; for tuples each number."""
    if isinstance(x, tuple):
        return tuple(as_like(y, like) for y in x)
    return kind_of(like)(x)


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


def onto(y: Vector, x: Vector, k: Vector | None = None) -> Vector:
    """y_i + x_i, or y_i + k_i x_i; if x_i is a sum of products, each product is added by itself.

    k is multiplied to factors that do not depend on the state, once for all bodies that share them.
    If a product has none, the sum is computed first.
    """
    made = []
    for a, b, c in zip(y, x, k or (1.0,) * len(y), strict=True):
        found = _onto(a, b, c)
        made.append(a + c * b if found is None else found)
    return tuple(made)


def _onto(y: Any, x: Any, k: Any) -> Any:
    op, taken = _parts(x)
    if op == "*":
        product = _scaled(k, x)
        return None if product is None else y + product
    if op == "neg":
        return _onto(y, taken[0], -k)
    if not op:
        return None
    first = _onto(y, taken[0], k)
    return None if first is None else _onto(first, taken[1], k if op == "+" else -k)


def _scaled(k: Any, x: Any) -> Any:
    """k x, with k at a factor of x that does not depend on the state; None without one."""
    if isinstance(k, float) or (isinstance(x, Number) and _is_given(x.graph, x.at, _DEPTH)):
        return k * x
    op, taken = _parts(x)
    for one, other in (taken, taken[::-1]) if op == "*" else ():
        scaled = _scaled(k, one)
        if scaled is not None:
            return scaled * other
    return None


def _is_given(graph: Graph, at: int, depth: int) -> bool:
    """Whether a short search shows an operation of parameters, times and constants only."""
    node = graph.nodes[at]
    if node.op == "in":
        return bool(node.args[0] != "x")
    known = depth > 0 and node.op not in ("opaque", "item")
    return known and all(_is_given(graph, i, depth - 1) for i in operands(node))


def _parts(x: Any) -> tuple[str, list[Any]]:
    """The operation of a sum, a product or an opposite, and its operands."""
    node = x.graph.nodes[x.at] if isinstance(x, Number) else None
    if node is None or node.op not in ("+", "-", "*", "neg"):
        return "", []
    return node.op, [_of(x.graph, i, node.kind) for i in node.args]
