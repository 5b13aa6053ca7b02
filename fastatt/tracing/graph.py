"""Graphs of operations, and the numbers that record them when formulas are called.

Equal operations are merged, known zeros and ones are simplified, and the order is kept otherwise. A
number is ``Double`` or ``Single``; a Python float is a constant in the precision of the other
operand, so that Python itself evaluates operations of constants.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from fastatt.tracing.nodes import Node, TraceError, operands


class Graph:
    """Operations in the order in which they were recorded.

    ``lanes`` is the number of directions of dual numbers that one number holds, 0 for none: inputs
    ("direction", k) are then 1 in lane k and 0 in the others.

    An operation on numbers of two precisions has the wider one. If the graph is ``narrow``, it has
    the narrower one, except for sums of values that depend on a time (``time``) and a time interval
    (``span``). Sines of values that depend on a time are narrow too. A graph for machine code only
    may be ``native`` (``fastatt.tracing.native``). While a graph is ``strict``, as for a
    user-defined function, 0 x, 0/x and x − x are operations, since they are NaN for a NaN.
    """

    def __init__(self, lanes: int = 0, *, native: bool = False) -> None:
        self.lanes, self.native = lanes, native
        self.narrow = self.strict = False
        self.nodes: list[Node] = []
        self._known: dict[tuple[Any, ...], int] = {}
        self._times: set[int] = set()
        self._spans: set[int] = set()
        self._of_time: list[tuple[bool, bool]] = []

    def add(self, op: str, precision: str, *args: Any) -> int:
        """The number of an operation, which is added if it is new."""
        # 0.0 and -0.0 are equal as keys, and NaN does not equal itself
        key = (op, precision, tuple(map(float.hex, args)) if op == "const" else args)
        number = self._known.setdefault(key, len(self.nodes))
        if number == len(self.nodes):
            self.nodes.append(Node(op, precision, args))
        return number

    def input(self, precision: str, *name: Any) -> Number:
        """An input; ``name`` is the name by which a program finds it."""
        return recorded(self, "in", precision, *name)  # type: ignore[no-any-return]

    def inputs(self, precision: str, group: str, n: int) -> tuple[Number, ...]:
        """Numbers (group, 0) to (group, n − 1)."""
        return tuple(self.input(precision, group, i) for i in range(n))

    def time(self, t: Number) -> Number:
        """Mark a number as a time."""
        return self._marked(self._times, t)

    def span(self, h: Number) -> Number:
        """Mark a number as a time interval."""
        return self._marked(self._spans, h)

    def _marked(self, among: set[int], x: Number) -> Number:
        among.add(x.at)
        self._of_time.clear()
        return x

    def of_time(self, at: int) -> tuple[bool, bool]:
        """Whether an operation depends on a time, and whether on time intervals only."""
        for i in range(len(self._of_time), at + 1):
            parts = [self._of_time[k] for k in operands(self.nodes[i])]
            timed = i in self._times or any(a for a, _ in parts)
            span = i in self._spans or self.nodes[i].op == "const"
            self._of_time.append((timed, span or (bool(parts) and all(b for _, b in parts))))
        return self._of_time[at]


# traced numbers


class Recorded:
    """A traced number: of a graph, or composed of numbers of a graph."""

    __slots__ = ()
    # numpy's numbers call its operators
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    def own_type(self) -> Callable[[Any], Any]:
        """``type(x)``: a function that converts to the precision of x."""
        return type(self)

    __pos__ = lambda self: self  # noqa: E731
    __bool__ = lambda self: bool(self != 0.0)  # noqa: E731
    __divmod__ = lambda self, other: divided(self, other)  # noqa: E731
    __rdivmod__ = lambda self, other: divided(other, self)  # noqa: E731
    __floordiv__ = lambda self, other: divmod(self, other)[0]  # noqa: E731
    __rfloordiv__ = lambda self, other: divmod(other, self)[0]  # noqa: E731
    __mod__ = lambda self, other: divmod(self, other)[1]  # noqa: E731
    __rmod__ = lambda self, other: divmod(other, self)[1]  # noqa: E731
    __rpow__ = lambda self, base: raised(base, self)  # noqa: E731

    def __float__(self) -> Any:
        raise TraceError("a number that is not known beforehand, where Python wants a known one")

    __int__ = __index__ = __float__


class Composed(Recorded):
    """A number composed of numbers of a graph, such as a dual number.

    Its class has ``cast``, ``applied``, ``raised``, ``chosen``, ``larger``, ``opaque`` and
    ``called``, which replace the functions of these names.
    """

    __slots__ = ()
    cast: Any
    applied: Any
    raised: Any


def composed_of(*values: Any) -> Any:
    """The class of the first composed number, None if there is none."""
    return next((type(x) for x in values if isinstance(x, Composed)), None)


def lifted(x: Any, like: Number) -> Number:
    """A number as one of the graph and, for a known one, of the precision of another."""
    if isinstance(x, Number):
        return x
    if not isinstance(x, (int, float, np.number, np.bool_)):
        raise TraceError(f"arithmetic with {type(x).__name__}")
    return recorded(like.graph, "const", like.precision, float(x))  # type: ignore[no-any-return]


def pair(a: Any, b: Any, op: str = "") -> tuple[Number, Number]:
    """Both operands as numbers of one precision; see ``Graph``."""
    like = a if isinstance(a, Number) else b
    a, b = lifted(a, like), lifted(b, like)
    if a.precision != b.precision:
        graph = a.graph
        wide, other = (a, b) if a.precision == "double" else (b, a)
        later = op in ("+", "-") and graph.of_time(wide.at)[0] and graph.of_time(other.at)[1]
        keeps = not graph.narrow or later
        precision = Double if keeps else Single
        a, b = precision(a), precision(b)
    return a, b


def _binary(op: str, a: Any, b: Any) -> Any:
    if type(a) is not type(b):
        if isinstance(b, Composed):
            return NotImplemented
        a, b = pair(a, b, op)
    return recorded(a.graph, op, a.precision, a.at, b.at)


def _is(x: Any, value: float) -> bool:
    return not isinstance(x, Number) and isinstance(x, (int, float, np.number)) and x == value


def _drops_out(x: Any) -> bool:
    """Whether 0 x, 0/x and x − x are 0 for any x."""
    return not (isinstance(x, Number) and x.graph.strict)


def _negative(x: Any) -> Any:
    """y if x is −y, else None."""
    if isinstance(x, Number) and x.graph.nodes[x.at].op == "neg":
        return -x
    return None


def _sum(a: Any, b: Any) -> Any:
    if _is(a, 0.0) or _is(b, 0.0):
        return b if _is(a, 0.0) else a
    if (y := _negative(b)) is not None:
        return _difference(a, y)
    if (x := _negative(a)) is not None and not isinstance(b, Composed):
        return _difference(b, x)
    return _binary("+", a, b)


def _difference(a: Any, b: Any) -> Any:
    if _is(b, 0.0):
        return a
    if _is(a, 0.0):
        return -b
    same = isinstance(a, Number) and isinstance(b, Number) and a.at == b.at
    if same and _drops_out(a):
        return 0.0  # the bracket of a constant rate is zero
    if (y := _negative(b)) is not None:
        return _sum(a, y)
    return _binary("-", a, b)


def _product(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if not isinstance(x, Recorded):
            if _is(x, 0.0) and _drops_out(y):
                return 0.0
            if _is(x, 1.0):
                return y
            if _is(x, -1.0):
                return -y
        # signs move outwards, where sums absorb them, so that −k b and k b share a product
        elif (positive := _negative(x)) is not None and not isinstance(y, Composed):
            return -_product(positive, y)
    return _binary("*", a, b)


def _quotient(a: Any, b: Any) -> Any:
    if _is(a, 0.0) and _drops_out(b):
        return 0.0
    return a if _is(b, 1.0) else _binary("/", a, b)


def _turned(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda b, a: operation(a, b)


def _comparison(op: str) -> Callable[[Any, Any], Any]:
    def compare(a: Any, b: Any) -> Any:
        if not isinstance(b, (Number, int, float, np.number)):
            return NotImplemented
        a, b = pair(a, b)
        return recorded(a.graph, op, "", a.at, b.at)

    return compare


class Number(Recorded):
    """A number of a graph."""

    __slots__ = ("at", "graph")
    precision = ""
    at: int
    graph: Graph

    def __new__(cls, x: Any) -> Any:
        """x in this precision, the meaning of ``type(y)(x)`` in a kernel."""
        if isinstance(x, Number):
            is_same = x.precision == cls.precision
            return x if is_same else recorded(x.graph, "cast", cls.precision, x.at)
        return x.cast(cls) if isinstance(x, Composed) else cls.rounded(x)

    @staticmethod
    def rounded(x: Any) -> float:
        """A known number rounded to this precision, for kernels that test the smallest number."""
        return float(x)

    __add__, __radd__ = _sum, _turned(_sum)
    __sub__, __rsub__ = _difference, _turned(_difference)
    __mul__, __rmul__ = _product, _turned(_product)
    __truediv__, __rtruediv__ = _quotient, _turned(_quotient)

    __pow__ = lambda self, power: raised(self, power)  # noqa: E731
    __abs__ = lambda self: apply("abs", self)  # noqa: E731

    def __neg__(self) -> Any:
        node = self.graph.nodes[self.at]
        if node.op == "neg":
            return _operation(self.graph, node.args[0], self.precision)
        return apply("neg", self)

    __lt__, __le__, __gt__, __ge__ = map(_comparison, ("<", "<=", ">", ">="))
    __eq__, __ne__ = map(_comparison, ("==", "!="))
    __hash__ = None


class Double(Number):
    """A number of double precision."""

    __slots__ = ()
    precision = "double"


class Single(Number):
    """A number of single precision."""

    __slots__ = ()
    precision = "single"

    @staticmethod
    def rounded(x: Any) -> float:
        """A known number rounded to single precision."""
        return ctypes.c_float(x).value


def _joined(op: str, a: Any, b: Any) -> Any:
    """a and b, or a or b; a known one decides, or drops out."""
    for x, y in ((a, b), (b, a)):
        if isinstance(x, (bool, np.bool_)):
            return y if x == (op == "and") else bool(x)
    return recorded(a.graph, op, "", a.at, b.at)


#: a and b, for conditions
both = partial(_joined, "and")
#: a or b, for conditions
either = partial(_joined, "or")


def negated(a: Any) -> Any:
    """not a."""
    if not isinstance(a, Condition):
        return not a
    node = a.graph.nodes[a.at]
    if node.op == "not":
        return _operation(a.graph, node.args[0], "")
    return recorded(a.graph, "not", "", a.at)


class Condition:
    """A truth value of a graph."""

    __slots__ = ("at", "graph")
    precision = ""
    at: int
    graph: Graph

    __and__ = __rand__ = lambda a, b: both(a, b)
    __or__ = __ror__ = lambda a, b: either(a, b)
    __invert__ = negated
    __hash__ = None  # type: ignore[assignment]

    def __bool__(self) -> bool:
        raise TraceError("a branch on a condition that is not known beforehand")


CLASSES: dict[str, type[Number]] = {"double": Double, "single": Single}


def recorded(graph: Graph, op: str, precision: str, *args: Any) -> Any:
    """An operation that is added to a graph, as a number or, of the precision "", a condition."""
    return _operation(graph, graph.add(op, precision, *args), precision)


def _operation(graph: Graph, at: int, precision: str) -> Any:
    """The operation ``at``."""
    operation = object.__new__(CLASSES.get(precision, Condition))
    operation.graph, operation.at = graph, at  # type: ignore[attr-defined]
    return operation


def choose(test: Any, a: Any, b: Any) -> Any:
    """``a if test else b``, for numbers, conditions and tuples of them."""
    if isinstance(test, Recorded):
        test = test != 0.0  # type: ignore[comparison-overlap]
    if not isinstance(test, Condition):
        return a if test else b
    if isinstance(a, (tuple, list)):
        if not isinstance(b, (tuple, list)) or len(a) != len(b):
            raise TraceError("a choice between tuples of two lengths")
        parts = [choose(test, x, y) for x, y in zip(a, b, strict=True)]
        return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
    if isinstance(a, Condition) or isinstance(b, Condition) or isinstance(a, bool):
        if not all(isinstance(x, (Condition, bool, np.bool_)) for x in (a, b)):
            raise TraceError("a choice between a number and a truth value")
        if a is test:
            return either(test, b)
        return both(test, a) if b is test else either(both(test, a), both(negated(test), b))
    if (composed := composed_of(a, b)) is not None:
        return composed.chosen(test, a, b)
    if not isinstance(a, Number) and not isinstance(b, Number):
        if a is b or a == b:
            return a
        if not all(isinstance(x, (int, float, np.number)) for x in (a, b)):
            raise TraceError(f"a choice between {type(a).__name__} and {type(b).__name__}")
        # two constants have the precision of the compared numbers
        a = number(test.graph, a, _compared(test))
    a, b = pair(a, b)
    inner = a.graph.nodes[a.at]
    if inner.op == "select" and inner.args[2] == b.at:  # of nested conditions
        test = both(test, _operation(a.graph, inner.args[0], ""))
        a = _operation(a.graph, inner.args[1], a.precision)
    return a if a.at == b.at else recorded(a.graph, "select", a.precision, test.at, a.at, b.at)


def _compared(test: Condition) -> str:
    """Precision of the first numbers that a condition compares."""
    node = test.graph.nodes[test.at]
    while not node.precision:
        node = test.graph.nodes[node.args[0]]
    return node.precision


def apply(function: str, x: Any) -> Any:
    """A function of one number."""
    if isinstance(x, Composed):
        return x.applied(function)
    if not isinstance(x, Number):
        raise TraceError(f"{function} of {type(x).__name__}")
    return recorded(x.graph, function, x.precision, x.at)


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
    a, b = pair(a, b)
    return recorded(a.graph, "larger", a.precision, a.at, b.at)


def row(table: Any, index: Any, count: int) -> tuple[Any, ...]:
    """Successive doubles of an array, from a whole ``index`` (a number of double precision) on."""
    begin = index.graph.add("row", "", table, count, index.at)
    return tuple(recorded(index.graph, "element", "double", begin, k) for k in range(count))


def lane(x: Number, k: int) -> Any:
    """The number in lane k of a value that has a lane for each direction."""
    return recorded(x.graph, "lane", x.precision, k, x.at)


def opaque(function: int, results: int, args: Sequence[Any], like: Number) -> tuple[Any, ...]:
    """The results, as doubles, of a compiled function that can't be traced."""
    if (composed := composed_of(*args)) is not None:
        return composed.opaque(function, results, args)  # type: ignore[no-any-return]
    numbers = [Double(lifted(x, like)).at for x in args]
    called = like.graph.add("opaque", "", function, results, *numbers)
    return tuple(recorded(like.graph, "item", "double", called, i) for i in range(results))


def number(graph: Graph, x: Any, precision: str) -> Number:
    """x as a number of a graph and a precision."""
    if isinstance(x, Number):
        return CLASSES[precision](x)  # type: ignore[no-any-return]
    if isinstance(x, (bool, Condition, Composed)):
        what = type(x).__name__ if isinstance(x, Composed) else "truth value"
        raise TraceError(f"a {what} where a number of a graph is wanted")
    return recorded(graph, "const", precision, float(x))  # type: ignore[no-any-return]


@contextlib.contextmanager
def strictly(numbers: Sequence[Any]) -> Iterator[None]:
    """Python's arithmetic in the graph of some numbers, where they may be NaN."""
    leaves = (y for x in numbers for y in (getattr(x, "value", x), *getattr(x, "slopes", ())))
    of = next((x.graph for x in leaves if isinstance(x, Number)), Graph())
    was, of.strict = of.strict, True
    try:
        yield
    finally:
        of.strict = was


def flattened(values: Any) -> list[Any]:
    """The numbers of nested tuples, in order."""
    if isinstance(values, (tuple, list)):
        return [x for value in values for x in flattened(value)]
    return [values]
