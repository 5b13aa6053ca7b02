"""Dual numbers: traced numbers with their derivatives in a few directions.

A formula that is called with dual numbers returns its derivatives along with its value: forward
differentiation (Griewank and Walther, *Evaluating Derivatives*, 2008, chapter 3), exact to
rounding. Derivatives that are structurally 0 disappear. Comparisons use values; the derivative of a
value that is not selected is not used; that of a value that is not finite has no meaning.

In a graph with lanes for directions (``Graph.lanes``) a dual number holds one derivative with a
lane for each direction, which takes a sixth of the operations for six directions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fastatt.kernels import trig
from fastatt.tracing import graph
from fastatt.tracing.graph import Composed, Condition, Double, Number
from fastatt.tracing.nodes import COMPARISONS, TraceError
from fastatt.tracing.operations import OPERATIONS, applied, as_float

_STEP = 2.0**-17
"""Of differences: near the cube root of an ulp, where rounding and truncation are alike."""


def _operators(op: str) -> list[Callable[[Any, Any], Any]]:
    """An operator, and the one with its operands turned."""
    of: Any = OPERATIONS[op]

    def operate(a: Any, b: Any) -> Any:
        x, y = value(a), value(b)
        result = of.traced(x, y)
        by_a, by_b = of.slope(x, y, result)
        return _through(result, (a, by_a), (b, by_b))

    return [operate, lambda b, a: operate(a, b)]


def _comparison(op: str) -> Callable[[Any, Any], Any]:
    test: Any = OPERATIONS[op].traced
    return lambda x, y: test(x.value, value(y))


class Dual(Composed):
    """A value and its derivatives, each a number of a graph or a known one."""

    __slots__ = ("slopes", "value")
    value: Any
    slopes: tuple[Any, ...]

    def __init__(self, value: Any, slopes: tuple[Any, ...]) -> None:
        self.value, self.slopes = value, slopes

    @property
    def precision(self) -> str:
        """Precision of the value, "" for a known one."""
        return self.value.precision if isinstance(self.value, Number) else ""

    def own_type(self) -> Callable[[Any], Any]:
        """``type(x)``, as for its value."""
        return self.value.own_type() if isinstance(self.value, Number) else as_float

    def cast(self, to: type[Number]) -> Any:
        """The number in another precision."""
        slopes = [to(slope) if isinstance(slope, Number) else slope for slope in self.slopes]
        return _dual(to(self.value), slopes)

    __add__, __radd__ = _operators("+")
    __sub__, __rsub__ = _operators("-")
    __mul__, __rmul__ = _operators("*")
    __truediv__, __rtruediv__ = _operators("/")
    __neg__ = lambda self: _through(-self.value, (self, -1.0))  # noqa: E731
    __abs__ = lambda self: self.applied("abs")  # noqa: E731
    __pow__ = lambda self, power: self.raised(power)  # noqa: E731
    __lt__, __le__, __gt__, __ge__, __eq__, __ne__ = map(_comparison, COMPARISONS)
    __hash__ = None  # type: ignore[assignment]

    def applied(self, function: str) -> Any:
        """A function of one number."""
        result, slope = applied(function, self.value), OPERATIONS[function].slope
        return _through(result, (self, slope(self.value, result))) if slope else result

    def raised(self, power: Any) -> Any:
        """A power that is a whole number or half of one."""
        if power == 0.5:
            return self.applied("sqrt")
        result = _raised(self.value, power)
        slope = power * _raised(self.value, power - 1) if power else 0.0
        return _through(result, (self, slope))

    @classmethod
    def chosen(cls, test: Any, a: Any, b: Any) -> Any:
        """``a if test else b``."""
        return _selected(graph.choose(test, value(a), value(b)), test, a, b)

    @classmethod
    def larger(cls, a: Any, b: Any) -> Any:
        """The larger of two."""
        x, y = value(a), value(b)
        return _selected(graph.larger(x, y), x > y, a, b)

    @classmethod
    def opaque(cls, function: int, results: int, args: Sequence[Any]) -> tuple[Any, ...]:
        """A function that can't be traced, with central differences as its derivatives.

        An argument x is moved by 2⁻¹⁷ max(``|x|``, 1) in both directions. The error of a derivative
        is some 1e-10 if the function changes over a scale of 1.
        """
        values = [value(x) for x in args]
        leaves = (y for x in args for y in (value(x), *getattr(x, "slopes", ())))
        like = next(x for x in leaves if isinstance(x, Number))
        slopes: list[list[Any]] = [[] for _ in range(results)]
        for k, x in enumerate(args):
            if not isinstance(x, Dual):
                continue
            step = _STEP * graph.larger(abs(Double(x.value)), 1.0)
            above, below = Double(x.value) + step, Double(x.value) - step
            ends = [
                graph.opaque(function, results, [*values[:k], end, *values[k + 1 :]], like)
                for end in (above, below)
            ]
            # the difference after rounding
            inverse = 1.0 / (above - below)
            for row, high, low in zip(slopes, *ends, strict=True):
                row.append((x, (high - low) * inverse))
        numbers = graph.opaque(function, results, values, like)
        return tuple(_through(x, *row) for x, row in zip(numbers, slopes, strict=True))

    @classmethod
    def called(cls, formula: Callable[..., Any], function: Any, args: tuple[Any, ...]) -> Any:
        """A traced function: by a rule if there is one, else by the chain rule for one number."""
        rule = _RULES.get(function)
        if rule is not None:
            return rule(formula, *args)
        return _chained(formula, args[0]) if len(args) == 1 else formula(*args)


def _through(result: Any, *slopes: tuple[Any, Any]) -> Any:
    """The result of a function, from its derivatives by numbers."""
    rows = [[by * slope for slope in x.slopes] for x, by in slopes if isinstance(x, Dual)]
    return _dual(result, [sum(column[1:], column[0]) for column in zip(*rows, strict=True)])


def _selected(result: Any, test: Any, a: Any, b: Any) -> Any:
    """A choice of two numbers, from its value."""
    size = next(len(x.slopes) for x in (a, b) if isinstance(x, Dual))
    pairs = zip(*(getattr(x, "slopes", (0.0,) * size) for x in (a, b)), strict=True)
    return _dual(result, [graph.choose(test, da, db) for da, db in pairs])


def _chained(formula: Callable[..., Any], x: Dual) -> Any:
    """A function of one number by its derivative and the chain rule."""
    return mapped(
        lambda y: _through(y.value, (x, y.slopes[0])) if isinstance(y, Dual) else y,
        formula(Dual(x.value, (1.0,))),
    )


def mapped(function: Callable[[Any], Any], values: Any) -> Any:
    """A function of each number of nested tuples."""
    if isinstance(values, (tuple, list)):
        parts = [mapped(function, part) for part in values]
        return type(values)(*parts) if hasattr(values, "_fields") else tuple(parts)
    return function(values)


def _dual(x: Any, slopes: Sequence[Any]) -> Any:
    """A dual number, or a plain one if no derivative remains."""
    if all(not isinstance(slope, Number) and slope == 0.0 for slope in slopes):
        return x
    return Dual(x, tuple(slopes))


def _raised(x: Any, power: Any) -> Any:
    return graph.raised(x, power) if isinstance(x, Number) else float(x) ** power


def _sincos(formula: Callable[..., Any], x: Dual) -> tuple[Any, Any]:
    s, c = formula(x.value)
    return _through(s, (x, c)), _through(c, (x, -s))


def _half(formula: Callable[..., Any], z: Dual) -> tuple[Any, Any]:
    """sin(θ/2)/θ by its polynomial; the derivative of cos(θ/2) by θ² is −¼ times it."""
    s, _ = _chained(formula, z)
    _, c = formula(z.value)
    return s, _through(c, (z, -0.25 * value(s)))


def _atan2(formula: Callable[..., Any], y: Any, x: Any) -> Any:
    b, a = value(y), value(x)
    inverse = 1.0 / (a * a + b * b)
    return _through(formula(b, a), (y, a * inverse), (x, -b * inverse))


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
    of, precision = numbers[0].graph, numbers[0].precision
    units: list[tuple[Any, ...]]
    if of.lanes >= size > 1:
        units = [(of.input(precision, "direction", k),) for k in places]
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
    return tuple(graph.lane(slope, k) if isinstance(slope, Number) else slope for k in lanes)
