"""The parts of graphs: operations by their names; and the errors of what can not be followed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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
