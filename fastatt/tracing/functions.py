"""Functions of traced numbers that are not operators: powers, remainders, look-ups, calls."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from fastatt.tracing.graph import Double, Number, _lifted, _made, _pair, apply, choose
from fastatt.tracing.native import SHORTER
from fastatt.tracing.nodes import Composed, Recorded, TraceError, composed_of


def raised(x: Any, power: Any) -> Any:
    """x to a whole or half power of size at most 64."""
    if isinstance(power, Recorded):
        raise TraceError("a power that is not known beforehand")
    if isinstance(x, Composed):
        return x.raised(power)
    if not abs(power) <= 64 or 2 * power != int(2 * power):
        raise TraceError(f"a power of {power}; accepted are whole ones and halves, up to 64")
    if power != int(power):
        whole = int(abs(power) - 0.5)
        result = apply("sqrt", x) * raised(x, whole)
        return 1.0 / result if power < 0 else result
    n, result, square = abs(int(power)), 1.0, x
    while n:
        if n & 1:
            result = result * square
        square = square * square if n > 1 else square
        n >>= 1
    return 1.0 / result if power < 0 else result


def divided(x: Any, y: Any) -> tuple[Any, Any]:
    """(x // y, x % y) as in Python: the whole number below, and a remainder with the sign of y.

    With fused multiplications the remainder has Python's bits while ``|x/y|`` < 2⁵³; without, the
    results are those of x moved by an ulp. Division by 0 gives a remainder of NaN.
    """
    below, size = y < 0.0, abs(y)
    dividend = choose(below, -x, x)
    whole = dividend / size
    whole = apply("floor", whole) if isinstance(whole, Recorded) else math.floor(whole)
    rest = dividend - whole * size
    # a quotient may be rounded up to the next whole number, but never down below one
    past = rest < 0.0
    rest = choose(past, rest + size, rest)
    return choose(past, whole - 1.0, whole), choose(below, -rest, rest)


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
