"""The parts of graphs: operations by name, and traced numbers as Python sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
LIBRARY = ("exp", "log", "tan", "tanh", "sinh", "cosh", "asin", "acos")


class TraceError(TypeError):
    """A function can't be traced: a branch on a number, a loop or an unknown function."""

    #: "file:line" in the user's code, if it is known; it is part of the message
    where = ""


class Node(NamedTuple):
    """An operation: its name, the precision of its result ("" for a condition), its operands."""

    op: str
    kind: str
    args: tuple[Any, ...]


# for operations that are not arithmetic: which of their arguments are operations
SPECIAL: dict[str, Callable[[tuple[Any, ...]], tuple[int, ...]]] = {
    "const": lambda args: (),
    "in": lambda args: (),
    "gather": lambda args: args[1:],
    "opaque": lambda args: args[2:],
    # (k, x): the value of x in lane k
    "lane": lambda args: args[1:],
    "item": lambda args: args[:1],
}


def operands(node: Node) -> tuple[int, ...]:
    """Numbers of the operations that are a node's operands."""
    return SPECIAL[node.op](node.args) if node.op in SPECIAL else node.args


def renamed(node: Node, taken: Sequence[int]) -> Node:
    """The operation with other operands."""
    if not taken:
        return node
    if node.op == "item":
        return Node(node.op, node.kind, (*taken, node.args[1]))
    rest = node.args[: len(node.args) - len(taken)] if node.op in SPECIAL else ()
    return Node(node.op, node.kind, (*rest, *taken))


# traced numbers

_OPERATORS = ("add", "sub", "mul", "truediv", "mod", "floordiv", "pow")
_ARITHMETIC = (
    *(f"__{side}{name}__" for name in _OPERATORS for side in ("", "r")),
    *("__lt__", "__le__", "__gt__", "__ge__", "__eq__", "__ne__"),
)


def boxed(x: Any) -> Any:
    """A number, an array or a tuple of numbers as an array of objects."""
    if not isinstance(x, Recorded):
        return np.array(x, dtype=object)
    box = np.empty((), dtype=object)
    box[()] = x
    return box


def each(formula: Callable[..., Any], *values: Any) -> Any:
    """A formula of numbers, applied to arrays that broadcast."""
    boxes = np.broadcast_arrays(*map(boxed, values))
    made = np.empty(boxes[0].shape, dtype=object)
    for k in np.ndindex(made.shape):
        made[k] = formula(*(box[k] for box in boxes))
    return made


def _on_arrays(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    """An operation that is applied to each element of an array."""

    def call(x: Any, y: Any) -> Any:
        return each(operation, x, y) if isinstance(y, np.ndarray) else operation(x, y)

    return call


def functions_of_numbers() -> Any:
    """``fastatt.tracing.functions``, which imports this module."""
    from fastatt.tracing import functions

    return functions


def _part_of(function: Callable[[Any, Any], Any], k: int) -> Callable[[Any, Any], Any]:
    return lambda x, y: function(x, y)[k]


class Recorded:
    """A traced number: of a graph, or composed of numbers of a graph."""

    __slots__ = ()
    # numpy's numbers and arrays call its operators
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    def __init_subclass__(cls) -> None:
        for name in _ARITHMETIC:
            if name in vars(cls):
                setattr(cls, name, _on_arrays(vars(cls)[name]))

    def precision(self) -> Callable[[Any], Any]:
        """``type(x)``: a function that converts to the precision of x."""
        return type(self)

    def __pos__(self) -> Any:
        return self

    def __eq__(self, other: object) -> Any:
        raise NotImplementedError

    def __ne__(self, other: object) -> Any:
        raise NotImplementedError

    def __bool__(self) -> bool:
        return bool(self != 0.0)

    def __divmod__(self, other: Any) -> Any:
        return functions_of_numbers().divided(self, other)

    def __rdivmod__(self, other: Any) -> Any:
        return functions_of_numbers().divided(other, self)

    __floordiv__, __mod__ = _part_of(__divmod__, 0), _part_of(__divmod__, 1)
    __rfloordiv__, __rmod__ = _part_of(__rdivmod__, 0), _part_of(__rdivmod__, 1)

    def __rpow__(self, base: Any) -> Any:
        return functions_of_numbers().raised(base, self)

    def __float__(self) -> float:
        raise TraceError("a number that is not known beforehand, where Python wants a float")

    def __int__(self) -> int:
        raise TraceError("a whole number made of one that is not known beforehand")

    __index__ = __int__


class Composed(Recorded):
    """A number composed of numbers of a graph, such as a dual number.

    Its class has ``cast``, ``applied``, ``raised``, ``chosen``, ``larger``, ``opaque`` and
    ``called``, which replace the functions of these names.
    """

    __slots__ = ()

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...


def composed_of(*values: Any) -> Any:
    """The class of the first composed number, None if there is none."""
    return next((type(x) for x in values if isinstance(x, Composed)), None)
