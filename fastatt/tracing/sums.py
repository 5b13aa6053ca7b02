"""Sums taken in term by term, where each term is then one fused multiplication."""

from __future__ import annotations

from typing import Any

from fastatt.tracing.formulas import Vector
from fastatt.tracing.graph import Graph, Number, _of
from fastatt.tracing.nodes import operands

#: operations between a factor and what it is made of, beyond which nobody looks
_DEPTH = 5


def onto(y: Vector, x: Vector, k: Vector | None = None) -> Vector:
    """y_i + x_i, or y_i + k_i x_i, where x_i is a sum of products each product by itself.

    k goes into factors that do not depend on the state: once for all bodies that share them. Where
    a product has none, the sum is made first.
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
    """k x, k multiplied to a factor of x that does not depend on the state; None without one."""
    if isinstance(k, float) or (isinstance(x, Number) and _is_given(x.graph, x.at, _DEPTH)):
        return k * x
    op, taken = _parts(x)
    for one, other in (taken, taken[::-1]) if op == "*" else ():
        scaled = _scaled(k, one)
        if scaled is not None:
            return scaled * other
    return None


def _is_given(graph: Graph, at: int, depth: int) -> bool:
    """Whether it is soon seen that an operation takes parameters, times and constants alone."""
    node = graph.nodes[at]
    if node.op == "in":
        return bool(node.args[0] != "x")
    known = depth > 0 and node.op not in ("opaque", "item")
    return known and all(_is_given(graph, i, depth - 1) for i in operands(node))


def _parts(x: Any) -> tuple[str, list[Any]]:
    """The operation of a sum, a product or an opposite, and what it is of."""
    node = x.graph.nodes[x.at] if isinstance(x, Number) else None
    if node is None or node.op not in ("+", "-", "*", "neg"):
        return "", []
    return node.op, [_of(x.graph, i, node.kind) for i in node.args]
