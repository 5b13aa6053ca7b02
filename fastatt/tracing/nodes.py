"""The parts of graphs: operations by name, and traced numbers as Python sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")


class TraceError(TypeError):
    """A function can't be traced: a branch on a number, a loop or an unknown function."""

    #: "file:line" in the user's code, if it is known; it is part of the message
    where = ""


class RefusedError(TypeError):
    """A user-defined function that a scene does not accept, whether it could be traced or not."""


class Node(NamedTuple):
    """An operation: its name, the precision of its result ("" for a condition), its operands."""

    op: str
    precision: str
    args: tuple[Any, ...]


#: for operations that are not arithmetic: which of their arguments are operations
SPECIAL = {
    "const": slice(0), "in": slice(0), "gather": slice(1, None), "look": slice(1, None),
    "row": slice(2, None), "opaque": slice(2, None), "lane": slice(1, None), "item": slice(1),
    "element": slice(1),
}  # fmt: skip


def operands(node: Node) -> tuple[int, ...]:
    """Numbers of the operations that are a node's operands."""
    return node.args[SPECIAL.get(node.op, slice(None))]


def renamed(node: Node, taken: Sequence[int]) -> Node:
    """The operation with other operands."""
    args = list(node.args)
    args[SPECIAL.get(node.op, slice(None))] = taken
    return node._replace(args=tuple(args))


# traced numbers


def functions_of_numbers() -> Any:
    """``fastatt.tracing.functions``, which imports this module."""
    from fastatt.tracing import functions

    return functions


class Recorded:
    """A traced number: of a graph, or composed of numbers of a graph."""

    __slots__ = ()
    # numpy's numbers call its operators
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    def own_type(self) -> Callable[[Any], Any]:
        """``type(x)``: a function that converts to the precision of x."""
        return type(self)

    def __pos__(self) -> Any:
        return self

    def __bool__(self) -> bool:
        return bool(self != 0.0)  # type: ignore[comparison-overlap]

    def __divmod__(self, other: Any) -> Any:
        return functions_of_numbers().divided(self, other)

    def __rdivmod__(self, other: Any) -> Any:
        return functions_of_numbers().divided(other, self)

    __floordiv__ = lambda self, other: divmod(self, other)[0]  # noqa: E731
    __rfloordiv__ = lambda self, other: divmod(other, self)[0]  # noqa: E731
    __mod__ = lambda self, other: divmod(self, other)[1]  # noqa: E731
    __rmod__ = lambda self, other: divmod(other, self)[1]  # noqa: E731

    def __rpow__(self, base: Any) -> Any:
        return functions_of_numbers().raised(base, self)

    def __float__(self) -> Any:
        raise TraceError("a number that is not known beforehand, where Python wants a known one")

    __int__ = __index__ = __float__


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
