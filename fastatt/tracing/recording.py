"""The operations of a user's function by their names, in no precision, and how they are replayed.

A call replays them with numbers of a graph, which decide precision and derivatives; on arrays they
are evaluated with NumPy.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.tracing import graph
from fastatt.tracing.graph import Condition, Double, Recorded
from fastatt.tracing.nodes import COMPARISONS, Node, operands
from fastatt.tracing.operations import OPERATIONS
from fastatt.tracing.source import evaluated, performed

Numbers = NDArray[np.float64]


class Table:
    """An array from which a formula reads by position; equal ones are one."""

    def __init__(self, data: Any) -> None:
        self.data: Numbers = np.array(data, np.float64).ravel()
        self.digest = hashlib.sha256(self.data.tobytes()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Table) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


class Recording(NamedTuple):
    """The operations of a function and the numbers of its results.

    ``nodes`` are in no precision; a table is the first argument of "gather" and "look".
    """

    nodes: tuple[Node, ...]
    results: tuple[int, ...]

    @property
    def tables(self) -> dict[Any, Numbers]:
        """The tables that it reads."""
        tables = (node.args[0] for node in self.nodes if node.op in ("gather", "look"))
        return {table: table.data for table in tables}

    def compares(self, *inputs: range) -> bool:
        """Whether it compares numbers that depend on some of each of several ranges of inputs."""
        depends: list[set[int]] = []
        for node in self.nodes:
            itself = {k for k, x in enumerate(inputs) if node.op == "in" and node.args[0] in x}
            depends.append(itself.union(*(depends[i] for i in operands(node))))
            if node.op in COMPARISONS and len(depends[-1]) == len(inputs):
                return True
        return False

    def replay(self, numbers: Sequence[Any]) -> list[Any]:
        """The results for numbers of a graph, dual numbers, or known ones."""
        values = performed(self.nodes, numbers, _replayed)
        return [values[i] for i in self.results]

    def evaluate(self, numbers: Any) -> list[Any]:
        """The values of all nodes for arrays of numbers, by IEEE's rules."""
        return performed(self.nodes, numbers, evaluated)

    def results_of(self, values: Sequence[Any], n: int) -> Numbers:
        """The results, (n, results), among the values of all nodes at n points."""
        columns = [np.broadcast_to(values[i], n) for i in self.results]
        return np.stack(columns, axis=-1).astype(float)


def _replayed(node: Node, numbers: list[Any]) -> Any:
    op, args = node.op, node.args
    if not any(isinstance(x, (Recorded, Condition)) for x in numbers):
        value = evaluated(node, numbers)
        return value if op in ("look", "item", "const") else value.item()
    if op == "gather":
        index, last = numbers[0], float(len(args[0].data) - 1)
        inside = graph.both(index >= 0.0, index <= last)
        return graph.row(args[0], Double(graph.choose(inside, index, 0.0)), 1)[0]
    if op == "look":
        return args[0].traced_at(*numbers)
    return OPERATIONS[op].traced(*numbers)
