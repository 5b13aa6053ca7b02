"""Functions of recorded numbers that are no operator: powers, remainders, look-ups, calls."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

from fastatt.flat.graph import (
    Double,
    Number,
    Single,
    _lifted,
    _made,
    _pair,
    apply,
    choose,
    flattened,
)
from fastatt.flat.nodes import NotStraight
from fastatt.flat.recorded import Composed, Recorded, composed_of


def raised(x: Any, power: Any) -> Any:
    """x to the power of a whole number or of half of one, at most 64 in size."""
    if isinstance(power, Recorded):
        raise NotStraight("a power that is not known beforehand")
    if isinstance(x, Composed):
        return x.raised(power)
    if not abs(power) <= 64 or 2 * power != int(2 * power):
        raise NotStraight(f"a power of {power}; accepted are whole ones and halves, up to 64")
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
    """(x // y, x % y) as Python's: the whole number below, and a remainder of the sign of y.

    With fused multiplications the remainder is Python's to the bit while |x/y| < 2⁵³; without, they
    are those of x moved by an ulp. By 0 the remainder is NaN.
    """
    below, size = y < 0.0, abs(y)
    dividend = choose(below, -x, x)
    whole = dividend / size
    whole = apply("floor", whole) if isinstance(whole, Recorded) else math.floor(whole)
    rest = dividend - whole * size
    # a quotient may be rounded up to the next whole number, never down below one
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
    return _made(a.graph, "larger", a.kind, a.at, b.at)


def gather(table: int, index: Any, kind: str) -> Any:
    """The number at a whole ``index`` (a number of double precision) of an array of numbers."""
    return _made(index.graph, "gather", kind, table, index.at)


def lane(x: Number, k: int) -> Any:
    """The number in lane k of one that has a lane a direction."""
    return _made(x.graph, "lane", x.kind, k, x.at)


def opaque(function: int, results: int, args: Sequence[Any], like: Number) -> tuple[Any, ...]:
    """What a compiled function that is no straight line gives of some numbers, as doubles."""
    if (composed := composed_of(*args)) is not None:
        return composed.opaque(function, results, args)  # type: ignore[no-any-return]
    at = [Double(_lifted(x, like)).at for x in args]
    called = like.graph.add("opaque", "", function, results, *at)
    return tuple(_made(like.graph, "item", "double", called, i) for i in range(results))


def called(formula: Callable[..., Any], function: Any, args: tuple[Any, ...]) -> Any:
    """``formula(*args)``, the traced form of ``function``: its derivatives may be known."""
    composed = composed_of(*args)
    if composed is not None:
        return composed.called(formula, function, args)
    if function is _trig().sincos and _is_phase(*args):
        return _of_phase(*args)
    instructions = _instructions().get(function)
    if instructions is not None:
        numbers = flattened(args)
        if all(isinstance(x, Number) and x.graph.native for x in numbers):
            return instructions(*args)
    return formula(*args)


@functools.cache
def _trig() -> Any:
    from fastatt.kernels import trig

    return trig


@functools.cache
def _instructions() -> dict[Any, Callable[..., Any]]:
    from fastatt.flat.native import INSTRUCTIONS

    return INSTRUCTIONS


def _is_phase(x: Any) -> bool:
    """Whether an angle grows with time, and its sine is wanted in single precision."""
    if not isinstance(x, Double) or not (x.graph.narrow and x.graph.many):
        return False
    return x.graph.of_time(x.at)[0]


def _of_phase(x: Double) -> Any:
    """What ``trig.sincos`` gives, of single precision: the angle alone needs the other."""
    from fastatt.flat.trace import stand_in

    quarters = x * (2.0 / math.pi)
    k = apply("rint", quarters)
    r, trig = Single(quarters - k) * (0.5 * math.pi), stand_in(_trig())
    s, c = trig.short_waves(r, r * r)
    C, S = trig.within_a_turn(Single(k - 4.0 * apply("rint", 0.25 * k)))
    return s * C + c * S, c * C - s * S
