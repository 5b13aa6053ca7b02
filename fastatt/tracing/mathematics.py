"""``math``, ``numpy`` and Python's builtins for traced numbers."""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Callable
from typing import Any

from fastatt.tracing import functions, graph
from fastatt.tracing.nodes import LIBRARY, Recorded


def kind_of(x: Any) -> Any:
    """``type(x)``: the precision of a number; for a constant a function that changes nothing."""
    if isinstance(x, Recorded):
        return x.precision()
    return as_float if isinstance(x, (float, int)) and not isinstance(x, bool) else type(x)


def as_float(x: Any = 0.0) -> Any:
    """``float``, which leaves traced numbers as they are."""
    return x if isinstance(x, Recorded) else float(x)


@functools.cache
def _kernel(name: str) -> Callable[..., Any]:
    from fastatt.kernels import trig
    from fastatt.tracing.trace import stand_in

    found: Callable[..., Any] = stand_in(getattr(trig, name))
    return found


def _best(better: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Of numbers as Python's ``min``: the first of equal ones, and the first if one is NaN."""
    one = lambda a, b: graph.choose(better(b, a), b, a)  # noqa: E731
    return lambda *values: functools.reduce(one, values[0] if len(values) == 1 else values)


EXTREMES = {"min": _best(operator.lt), "max": _best(operator.gt)}


def _extreme(better: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """The second of two numbers if it is better or NaN."""
    return lambda a, b: graph.choose(graph.either(better(b, a), b != b), b, a)  # noqa: PLR0124


def _ceil(x: Any) -> Any:
    return -graph.apply("floor", -x)


def _fmod(x: Any, y: Any) -> Any:
    rest = functions.divided(abs(x), abs(y))[1]
    return graph.choose(x < 0.0, -rest, rest)


def _remainder(x: Any, y: Any) -> Any:
    """The remainder of x by the nearest multiple of y, the even one of two."""
    size = abs(y)
    rest = x - graph.apply("rint", x / size) * size
    # a quotient may be rounded to the middle between two whole numbers
    rest = graph.choose(rest > 0.5 * size, rest - size, rest)
    return graph.choose(rest < -0.5 * size, rest + size, rest)


def _copysign(x: Any, y: Any) -> Any:
    """The sign of a zero y is ignored, as in all compiled formulas."""
    size = abs(x)
    return graph.choose(y < 0.0, -size, size)


def _other_side(x: Any) -> Any:
    """The other leg of a right triangle with hypotenuse 1, by a product without cancellation."""
    return graph.apply("sqrt", (1.0 - x) * (1.0 + x))


def _sines(x: Any) -> tuple[Any, Any]:
    """(sin x, cos x); NaN if neighbouring numbers are so far apart that no digit remains."""
    most = {"double": 2.0**50, "single": 2.0**21}.get(getattr(x, "kind", ""), math.inf)
    known = graph.both(x < most, x > -most)
    s, c = _kernel("sincos")(x)
    return graph.choose(known, s, math.nan), graph.choose(known, c, math.nan)


#: functions of numbers by their names in ``math`` and in functions of users
FORMULAS: dict[str, Callable[..., Any]] = {
    **{k: functools.partial(graph.apply, k) for k in (*LIBRARY, "sqrt", "abs", "rint", "floor")},
    **EXTREMES,
    "sin": lambda x: _sines(x)[0],
    "cos": lambda x: _sines(x)[1],
    "tan": lambda x: operator.truediv(*_sines(x)),
    "atan": lambda x: _kernel("atan2")(x, 1.0),
    "asin": lambda x: _kernel("atan2")(x, _other_side(x)),
    "acos": lambda x: _kernel("atan2")(_other_side(x), x),
    "atan2": lambda y, x: _kernel("atan2")(y, x),
    "log2": lambda x: graph.apply("log", x) * (1.0 / math.log(2.0)),
    "log10": lambda x: graph.apply("log", x) * (1.0 / math.log(10.0)),
    "hypot": lambda x, y: graph.apply("sqrt", x * x + y * y),
    "sign": lambda x: graph.choose(x > 0.0, 1.0, graph.choose(x < 0.0, -1.0, x)),
    "copysign": _copysign,
    "ceil": _ceil,
    "trunc": lambda x: graph.choose(x < 0.0, _ceil(x), graph.apply("floor", x)),
    "fmod": _fmod,
    "remainder": _remainder,
    "minimum": _extreme(operator.lt),
    "maximum": _extreme(operator.gt),
}
