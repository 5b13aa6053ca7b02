"""Operations by name: what a graph is made of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")


LIBRARY = ("exp", "log", "tan", "tanh", "sinh", "cosh", "asin", "acos")


class NotStraight(TypeError):  # noqa: N818
    """What was called is no straight line: a branch on a number, a loop, an unknown function."""

    #: "file:line" of the user's, where it is known; it is part of the message
    where = ""


class Node(NamedTuple):
    """One operation: its name, the precision of its result ("" of a condition), its operands."""

    op: str
    kind: str
    args: tuple[Any, ...]


# of an operation that is no arithmetic: which of its arguments are operations
SPECIAL: dict[str, Callable[[tuple[Any, ...]], tuple[int, ...]]] = {
    "const": lambda args: (),
    "in": lambda args: (),
    "gather": lambda args: args[1:],
    "opaque": lambda args: args[2:],
    # (k, x): what x is in lane k
    "lane": lambda args: args[1:],
    "item": lambda args: args[:1],
}


def operands(node: Node) -> tuple[int, ...]:
    """Numbers of the operations that a node takes."""
    return SPECIAL[node.op](node.args) if node.op in SPECIAL else node.args


def renamed(node: Node, taken: Sequence[int]) -> Node:
    """The same operation of others."""
    if not taken:
        return node
    if node.op == "item":
        return Node(node.op, node.kind, (*taken, node.args[1]))
    rest = node.args[: len(node.args) - len(taken)] if node.op in SPECIAL else ()
    return Node(node.op, node.kind, (*rest, *taken))
