"""``math``, ``numpy`` and Python's builtins for traced numbers."""

from __future__ import annotations

import builtins
import functools
import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from fastatt.tracing import arrays, functions, graph, nodes
from fastatt.tracing.graph import Condition
from fastatt.tracing.nodes import Recorded, TraceError

_INSTRUCTIONS = {
    "sqrt": "sqrt", "fabs": "abs", "abs": "abs", "absolute": "abs", "rint": "rint",
    "round": "rint", "around": "rint", "floor": "floor",
}  # fmt: skip

#: why random numbers are refused
RANDOM = (
    "random numbers; accepted: a function that returns the same for the same arguments, since a "
    "step evaluates it several times. A fastatt.TimeSeries or samples hold numbers that are drawn "
    "before the run"
)


def is_recorded(*values: Any) -> bool:
    """Whether one of the values, or a part of a tuple, is a traced number."""
    return any(
        isinstance(x, (Recorded, Condition)) or arrays.is_array(x)
        for x in graph.flattened(list(values))
    )


def kind_of(x: Any) -> Any:
    """``type(x)``: the precision of a number; for a constant a function that changes nothing."""
    if isinstance(x, Recorded):
        return x.precision()
    if isinstance(x, (float, int)) and not isinstance(x, bool):
        return _float
    return type(x)


def refused(name: str) -> Callable[..., Any]:
    """Replaces an unknown function: it can be referred to, but not called."""

    def refuse(*_: Any, **__: Any) -> Any:
        raise TraceError(f"{name}, which is not among the functions that are known here")

    return refuse


class Mathematics:
    """Replaces ``math`` or ``numpy``, with functions that vectorise."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._module, name)
        label = f"{self._module.__name__}.{name}"
        if label == "numpy.random":
            raise TraceError(RANDOM)
        if isinstance(value, type(math)):
            return Mathematics(value)
        if not callable(value):
            return value

        # numpy's function of this name is another one
        known = label if label == "math.remainder" else name

        def call(*args: Any, **named: Any) -> Any:
            if not is_recorded(*args, *named.values()):
                found = value(*args, **named)
                return arrays.new(name, found) if isinstance(found, np.ndarray) else found
            if label.startswith("numpy"):
                made = arrays.made_of(name, value, args, named)
                if made is not None:
                    return made
            formula = None if named else formula_of(known, len(args))
            if formula is None:
                raise TraceError(f"{label} of numbers that are not known beforehand")
            if label.startswith("numpy") and any(np.ndim(nodes.boxed(x)) for x in args):
                return nodes.each(call, *args)
            return formula(*args)

        return call


def formula_of(name: str, n_arguments: int) -> Callable[..., Any] | None:
    """A function of ``math`` or ``numpy`` for traced numbers; None for an unknown one."""
    if name in _FORMULAS:
        return _FORMULAS[name]
    if n_arguments == 1 and name in _INSTRUCTIONS:
        return functools.partial(graph.apply, _INSTRUCTIONS[name])
    if n_arguments == 1 and name in nodes.LIBRARY:
        return functools.partial(graph.apply, name)
    return None


@functools.cache
def _kernel(name: str) -> Callable[..., Any]:
    from fastatt.kernels import trig
    from fastatt.tracing.trace import stand_in

    found: Callable[..., Any] = stand_in(getattr(trig, name))
    return found


def _of_all(choose: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    def reduced(*values: Any) -> Any:
        return functools.reduce(choose, values[0] if len(values) == 1 else values)

    return reduced


def _nan(x: Any) -> Any:
    return x != x  # noqa: PLR0124


# Python's give the first of equal numbers, and the first if one is NaN; numpy's give NaN
_least = _of_all(lambda a, b: graph.choose(b < a, b, a))
_most = _of_all(lambda a, b: graph.choose(b > a, b, a))


def _extreme(better: Callable[[Any, Any], Any], k: int) -> Callable[[Any, Any], Any]:
    """The second of two numbers if it is better, or if the k-th of them is NaN."""
    return lambda *pair: graph.choose(graph.either(better(*pair[::-1]), _nan(pair[k])), *pair[::-1])


_minimum, _maximum = _extreme(operator.lt, 1), _extreme(operator.gt, 1)


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


def _fsum(values: Any) -> Any:
    """The sum, with the rounding error of each addition added."""
    from fastatt.kernels import compensated
    from fastatt.tracing.trace import stand_in

    total: Any = 0.0
    lost: Any = 0.0
    for x in values:
        total, rest = stand_in(compensated.two_sum)(total, x)
        lost = lost + rest
    return total + lost


def _copysign(x: Any, y: Any) -> Any:
    """The sign of a zero y is ignored, as in all compiled formulas."""
    size = abs(x)
    return graph.choose(y < 0.0, -size, size)


def _log(x: Any, base: Any = None) -> Any:
    found = graph.apply("log", x) if isinstance(x, Recorded) else math.log(x)
    if base is None:
        return found
    return found / (graph.apply("log", base) if isinstance(base, Recorded) else math.log(base))


def _other_side(x: Any) -> Any:
    """The other leg of a right triangle with hypotenuse 1, by a product without cancellation."""
    return graph.apply("sqrt", (1.0 - x) * (1.0 + x))


def _to(kind: type[graph.Number]) -> Callable[[Any], Any]:
    return lambda x: kind(x) if isinstance(x, Recorded) else float(x)


def _sines(x: Any) -> tuple[Any, Any]:
    """(sin x, cos x); NaN if neighbouring numbers are so far apart that no digit remains."""
    most = {"double": 2.0**50, "single": 2.0**21}.get(getattr(x, "kind", ""), math.inf)
    known = graph.both(x < most, x > -most)
    s, c = _kernel("sincos")(x)
    return graph.choose(known, s, math.nan), graph.choose(known, c, math.nan)


_FORMULAS: dict[str, Callable[..., Any]] = {
    "sin": lambda x: _sines(x)[0],
    "cos": lambda x: _sines(x)[1],
    "tan": lambda x: operator.truediv(*_sines(x)),
    "atan": lambda x: _kernel("atan2")(x, 1.0),
    "asin": lambda x: _kernel("atan2")(x, _other_side(x)),
    "acos": lambda x: _kernel("atan2")(_other_side(x), x),
    "atan2": lambda y, x: _kernel("atan2")(y, x),
    "log": _log,
    "log2": lambda x: graph.apply("log", x) * (1.0 / math.log(2.0)),
    "log10": lambda x: graph.apply("log", x) * (1.0 / math.log(10.0)),
    "exp2": lambda x: graph.apply("exp", x * math.log(2.0)),
    "hypot": lambda *values: graph.apply("sqrt", sum((x * x for x in values), 0.0)),
    "sign": lambda x: graph.choose(x > 0.0, 1.0, graph.choose(x < 0.0, -1.0, x)),
    "copysign": _copysign,
    "ceil": _ceil,
    "trunc": lambda x: graph.choose(x < 0.0, _ceil(x), graph.apply("floor", x)),
    "fmod": _fmod,
    "fsum": _fsum,
    "math.remainder": _remainder,
    "mod": lambda x, y: functions.divided(x, y)[1],
    "floor_divide": lambda x, y: functions.divided(x, y)[0],
    "minimum": _minimum,
    "maximum": _maximum,
    "fmin": _extreme(operator.lt, 0),
    "fmax": _extreme(operator.gt, 0),
    "clip": lambda x, low, high: _minimum(_maximum(x, low), high),
    "where": graph.choose,
    "square": lambda x: x * x,
    "reciprocal": lambda x: 1.0 / x,
    "isnan": _nan,
    "isfinite": lambda x: abs(x) < math.inf,
    "isinf": lambda x: abs(x) == math.inf,
    "pow": functions.raised,
    "radians": lambda x: x * (math.pi / 180.0),
    "degrees": lambda x: x * (180.0 / math.pi),
    "logical_and": graph.both,
    "logical_or": graph.either,
    "logical_not": graph.negated,
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "negative": operator.neg,
    "float64": _to(graph.Double),
    "float32": _to(graph.Single),
}
_FORMULAS |= {
    other: _FORMULAS[name]
    for other, name in {
        "arctan": "atan", "arcsin": "asin", "arccos": "acos", "arctan2": "atan2",
        "remainder": "mod", "power": "pow", "deg2rad": "radians", "rad2deg": "degrees",
        "true_divide": "divide",
    }.items()
}  # fmt: skip


def _float(x: Any = 0.0) -> Any:
    return x if isinstance(x, Recorded) else float(x)


def _round(x: Any, *digits: Any) -> Any:
    if not is_recorded(x):
        return round(x, *digits)
    if digits:
        raise TraceError("round to some digits")
    return graph.apply("rint", x)


def _isinstance(x: Any, kinds: Any) -> bool:
    if is_recorded(x) and not isinstance(x, (tuple, list)):
        raise TraceError("isinstance of a number that is not known beforehand")
    return isinstance(x, kinds)


def _builtins() -> dict[str, Any]:
    """Python's builtins by name, in forms that work on traced numbers as on floats."""
    # numpy's methods import modules when they are called
    as_they_are = (
        "__import__", "abs", "all", "any", "bool", "dict", "divmod", "enumerate", "filter", "int",
        "iter", "len", "list", "map", "next", "range", "reversed", "set", "slice", "sorted", "str",
        "sum", "tuple", "zip",
    )  # fmt: skip
    found: dict[str, Any] = {}
    for name, value in vars(builtins).items():
        is_error = isinstance(value, type) and issubclass(value, BaseException)
        if name in as_they_are or is_error or not callable(value):
            found[name] = value
        else:
            found[name] = refused(name)
    return found | {
        "float": _float,
        "isinstance": _isinstance,
        "max": _most,
        "min": _least,
        "pow": lambda x, n: x**n,
        "round": _round,
        "type": kind_of,
    }


BUILTINS = _builtins()
