"""Functions of traced numbers that are not operators: the larger of two, look-ups, calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fastatt.tracing.graph import (
    Double,
    Number,
    _lifted,
    _made,
    _pair,
    composed_of,
)
from fastatt.tracing.native import SHORTER


def larger(a: Any, b: Any) -> Any:
    """The larger of two numbers that are not negative; NaN counts as the largest."""
    if (composed := composed_of(a, b)) is not None:
        return composed.larger(a, b)
    if not isinstance(a, Number) and not isinstance(b, Number):
        return max(a, b)
    a, b = _pair(a, b)
    return _made(a.graph, "larger", a.precision, a.at, b.at)


def row(table: Any, index: Any, count: int) -> tuple[Any, ...]:
    """Successive doubles of an array, from a whole ``index`` (a number of double precision) on."""
    at = index.graph.add("row", "", table, count, index.at)
    return tuple(_made(index.graph, "element", "double", at, k) for k in range(count))


def lane(x: Number, k: int) -> Any:
    """The number in lane k of a value that has a lane for each direction."""
    return _made(x.graph, "lane", x.precision, k, x.at)


def opaque(function: int, results: int, args: Sequence[Any], like: Number) -> tuple[Any, ...]:
    """The results, as doubles, of a compiled function that can't be traced."""
    if (composed := composed_of(*args)) is not None:
        return composed.opaque(function, results, args)  # type: ignore[no-any-return]
    at = [Double(_lifted(x, like)).at for x in args]
    called = like.graph.add("opaque", "", function, results, *at)
    return tuple(_made(like.graph, "item", "double", called, i) for i in range(results))


def called(formula: Callable[..., Any], function: Any, args: tuple[Any, ...]) -> Any:
    """``formula(*args)``, the traced form of ``function``, or a shorter equivalent."""
    composed = composed_of(*args)
    if composed is not None:
        return composed.called(formula, function, args)
    shorter = SHORTER.get((function.__module__, function.__name__))
    found = None if shorter is None else shorter(*args)
    return formula(*args) if found is None else found
