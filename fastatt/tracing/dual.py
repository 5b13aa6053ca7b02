"""Dual numbers: traced numbers with their derivatives in a few directions.

A formula that is called with dual numbers returns its derivatives along with its value: forward
differentiation (Griewank and Walther, *Evaluating Derivatives*, 2008, chapter 3), exact to
rounding. Derivatives that are structurally 0 disappear. Comparisons use values; the derivative of a
value that is not selected is not used; that of a value that is not finite has no meaning.

In a graph with lanes for directions (``Graph.lanes``) a dual number holds one derivative with a
lane for each direction, which takes a sixth of the operations for six directions.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fastatt.kernels import trig
from fastatt.tracing import functions, graph
from fastatt.tracing.graph import Condition, Double, Number
from fastatt.tracing.nodes import Composed, Recorded, TraceError

_STEP = 2.0**-17
"""Of differences: near the cube root of an ulp, where rounding and truncation are alike."""

Slope = Callable[[Any, Any], Any]

_COMPARISONS = (operator.lt, operator.le, operator.gt, operator.ge, operator.eq, operator.ne)


def _comparison(test: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda x, y: test(x.value, value(y))


class Dual(Composed):
    """A value and its derivatives, each a number of a graph or a known one."""

    __slots__ = ("slopes", "value")
    value: Any
    slopes: tuple[Any, ...]

    def __init__(self, value: Any, slopes: tuple[Any, ...]) -> None:
        self.value, self.slopes = value, slopes

    @property
    def kind(self) -> str:
        """Precision of the value, "" for a known one."""
        return self.value.kind if isinstance(self.value, Number) else ""

    def precision(self) -> Callable[[Any], Any]:
        """``type(x)``, as for its value."""
        return self.value.precision() if isinstance(self.value, Number) else _as_is

    def cast(self, to: type[Number]) -> Any:
        """The number in another precision."""
        slopes = [to(slope) if isinstance(slope, Number) else slope for slope in self.slopes]
        return _dual(to(self.value), slopes)

    def __add__(self, other: Any) -> Any:
        a, b, pairs = _aligned(self, other)
        return _dual(a + b, [da + db for da, db in pairs])

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        a, b, pairs = _aligned(self, other)
        return _dual(a - b, [da - db for da, db in pairs])

    def __rsub__(self, other: Any) -> Any:
        return _dual(other - self.value, [-slope for slope in self.slopes])

    def __mul__(self, other: Any) -> Any:
        a, b, pairs = _aligned(self, other)
        return _dual(a * b, [da * b + a * db for da, db in pairs])

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return _quotient(self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _quotient(other, self)

    def __pow__(self, power: Any) -> Any:
        return self.raised(power)

    def __neg__(self) -> Any:
        return _dual(-self.value, [-slope for slope in self.slopes])

    def __abs__(self) -> Any:
        below = self.value < 0.0
        return _dual(abs(self.value), [graph.choose(below, -slope, slope) for slope in self.slopes])

    __lt__, __le__, __gt__, __ge__, __eq__, __ne__ = map(_comparison, _COMPARISONS)
    __hash__ = None  # type: ignore[assignment]

    def through(self, result: Any, slope: Any) -> Any:
        """The result of a function whose derivative at this number is ``slope``."""
        return _dual(result, [slope * d for d in self.slopes])

    def applied(self, function: str) -> Any:
        """A function of one number."""
        if function == "abs":
            return abs(self)
        result = _applied(function, self.value)
        if function in ("rint", "floor"):
            return result
        return self.through(result, _SLOPES[function](self.value, result))

    def raised(self, power: Any) -> Any:
        """A power that is a whole number or half of one."""
        if power == 0.5:
            return self.applied("sqrt")
        result = _raised(self.value, power)
        return self.through(result, power * _raised(self.value, power - 1)) if power else result

    @classmethod
    def chosen(cls, test: Any, a: Any, b: Any) -> Any:
        """``a if test else b``."""
        x, y, pairs = _aligned(a, b)
        return _dual(
            graph.choose(test, x, y),
            [da if _same(da, db) else graph.choose(test, da, db) for da, db in pairs],
        )

    @classmethod
    def larger(cls, a: Any, b: Any) -> Any:
        """The larger of two."""
        x, y, pairs = _aligned(a, b)
        first = x > y
        return _dual(functions.larger(x, y), [graph.choose(first, da, db) for da, db in pairs])

    @classmethod
    def opaque(cls, function: int, results: int, args: Sequence[Any]) -> tuple[Any, ...]:
        """A function that can't be traced, with central differences as its derivatives.

        An argument x is moved by 2⁻¹⁷ max(``|x|``, 1) in both directions. The error of a derivative
        is some 1e-10 if the function changes over a scale of 1.
        """
        values = [value(x) for x in args]
        everything = [y for x in args for y in (x, *getattr(x, "slopes", ()))]
        like = next(x for x in map(value, everything) if isinstance(x, Number))
        found = functions.opaque(function, results, values, like)
        slopes = [[0.0] * _size(args) for _ in range(results)]
        for k, x in enumerate(args):
            if not isinstance(x, Dual):
                continue
            step = _STEP * functions.larger(abs(Double(x.value)), 1.0)
            above, below = Double(x.value) + step, Double(x.value) - step
            ends = [
                functions.opaque(function, results, [*values[:k], end, *values[k + 1 :]], like)
                for end in (above, below)
            ]
            # the difference after rounding
            inverse = 1.0 / (above - below)
            for row, high, low in zip(slopes, *ends, strict=True):
                slope = (high - low) * inverse
                row[:] = [s + slope * d for s, d in zip(row, x.slopes, strict=True)]
        return tuple(_dual(x, row) for x, row in zip(found, slopes, strict=True))

    @classmethod
    def called(cls, formula: Callable[..., Any], function: Any, args: tuple[Any, ...]) -> Any:
        """A traced function: by a rule if there is one, else by the chain rule for one number."""
        rule = _RULES.get(function)
        if rule is not None:
            return rule(formula, *args)
        return _chained(formula, args[0]) if len(args) == 1 else formula(*args)


def _chained(formula: Callable[..., Any], x: Dual) -> Any:
    """A function of one number by its derivative and the chain rule."""
    return mapped(
        lambda y: x.through(y.value, y.slopes[0]) if isinstance(y, Dual) else y,
        formula(Dual(x.value, (1.0,))),
    )


def mapped(function: Callable[[Any], Any], values: Any) -> Any:
    """A function of each number of nested tuples."""
    if isinstance(values, (tuple, list)):
        made = [mapped(function, part) for part in values]
        return type(values)(*made) if hasattr(values, "_fields") else tuple(made)
    return function(values)


def _as_is(x: Any) -> Any:
    return x if isinstance(x, Recorded) else float(x)


def _dual(x: Any, slopes: Sequence[Any]) -> Any:
    """A dual number, or a plain one if no derivative remains."""
    if all(not isinstance(slope, Number) and slope == 0.0 for slope in slopes):
        return x
    return Dual(x, tuple(slopes))


def _size(values: Sequence[Any]) -> int:
    return next(len(x.slopes) for x in values if isinstance(x, Dual))


def _aligned(a: Any, b: Any) -> tuple[Any, Any, list[tuple[Any, Any]]]:
    """(value of a, value of b, their derivatives pair by pair)."""
    none = (0.0,) * _size((a, b))
    da = a.slopes if isinstance(a, Dual) else none
    db = b.slopes if isinstance(b, Dual) else none
    return value(a), value(b), list(zip(da, db, strict=True))


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, Number) or isinstance(b, Number):
        return isinstance(a, Number) and isinstance(b, Number) and a.at == b.at
    return bool(a == b)


def _quotient(a: Any, b: Any) -> Any:
    x, y, pairs = _aligned(a, b)
    result, inverse = x / y, 1.0 / y
    if not isinstance(b, Dual):
        return _dual(result, [da * inverse for da, _ in pairs])
    return _dual(result, [(da - result * db) * inverse for da, db in pairs])


def _applied(function: str, x: Any) -> Any:
    """A function of a number; for a known number evaluated by Python."""
    if isinstance(x, Number):
        return graph.apply(function, x)
    return float(getattr(np, _NUMPY.get(function, function))(x))


def _raised(x: Any, power: Any) -> Any:
    return functions.raised(x, power) if isinstance(x, Number) else float(x) ** power


_NUMPY = {"asin": "arcsin", "acos": "arccos"}

# functions with their derivatives from x and f(x)
_SLOPES: dict[str, Slope] = {
    "sqrt": lambda x, f: 0.5 / f,
    "exp": lambda x, f: f,
    "log": lambda x, f: 1.0 / x,
    "tan": lambda x, f: 1.0 + f * f,
    "tanh": lambda x, f: (1.0 - f) * (1.0 + f),
    "sinh": lambda x, f: _applied("cosh", x),
    "cosh": lambda x, f: _applied("sinh", x),
    "asin": lambda x, f: 1.0 / _applied("sqrt", (1.0 - x) * (1.0 + x)),
    "acos": lambda x, f: -1.0 / _applied("sqrt", (1.0 - x) * (1.0 + x)),
}


def _sincos(formula: Callable[..., Any], x: Dual) -> tuple[Any, Any]:
    s, c = formula(x.value)
    return x.through(s, c), x.through(c, -s)


def _half(formula: Callable[..., Any], z: Dual) -> tuple[Any, Any]:
    """sin(θ/2)/θ by its polynomial; the derivative of cos(θ/2) by θ² is −¼ times it."""
    s, _ = _chained(formula, z)
    _, c = formula(z.value)
    return s, z.through(c, -0.25 * value(s))


def _atan2(formula: Callable[..., Any], y: Any, x: Any) -> Any:
    b, a, pairs = _aligned(y, x)
    inverse = 1.0 / (a * a + b * b)
    return _dual(formula(b, a), [(a * db - b * da) * inverse for db, da in pairs])


# kernels whose derivatives take fewer operations than those of their polynomials
_RULES: dict[Any, Callable[..., Any]] = {
    trig.sincos: _sincos,
    trig.sincos_bounded: _sincos,
    trig.atan2: _atan2,
    trig.half_sinc_cos: _half,
    trig.half_sinc_cos_wide: _half,
}

# seeds and results


def seed(values: Sequence[Any], size: int, first: int = 0, like: Any = None) -> tuple[Any, ...]:
    """Numbers as dual ones with ``size`` directions, from the direction ``first`` on.

    Known numbers are included; if all are known, ``like`` is a number of the graph and of the
    precision.
    """
    numbers = [x for x in (like, *values) if isinstance(x, Number)]
    if not numbers:
        raise TraceError("a seed of known numbers alone")
    places = range(first, first + len(values))
    of, kind = numbers[0].graph, numbers[0].kind
    units: list[tuple[Any, ...]]
    if of.lanes >= size > 1:
        units = [(of.input(kind, "direction", k),) for k in places]
    else:
        units = [tuple(float(i == k) for i in range(size)) for k in places]
    return tuple(Dual(x, unit) for x, unit in zip(values, units, strict=True))


def value(x: Any) -> Any:
    """The value of a number, dual or plain; for tuples that of each."""
    return mapped(lambda y: y.value if isinstance(y, Dual) else y, x)


def derivatives(x: Any, size: int) -> tuple[Any, ...]:
    """The ``size`` derivatives of a number; for a plain one all are 0."""
    if isinstance(x, Condition):
        raise TraceError("the derivative of a truth value")
    if not isinstance(x, Dual):
        return (0.0,) * size
    if len(x.slopes) == size:
        return x.slopes
    (slope,) = x.slopes
    lanes = range(size)
    return tuple(functions.lane(slope, k) if isinstance(slope, Number) else slope for k in lanes)
