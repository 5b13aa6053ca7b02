"""A finished graph: what is left of it for some results, multiplications fused."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from fastatt.flat.graph import Graph, number
from fastatt.flat.nodes import SPECIAL, Node, operands


class Flat:
    """What is left of a graph for some results: operations in order, multiplications fused.

    ``a*b + c`` becomes one ``fma`` where the product has no other use: chosen here and not by a
    compiler, so that every form of a formula rounds alike.
    """

    def __init__(self, graph: Graph, results: Iterable[Any], kinds: str | Sequence[str]) -> None:
        values = list(results)
        each = [kinds] * len(values) if isinstance(kinds, str) else list(kinds)
        ends = [number(graph, x, kind).at for x, kind in zip(values, each, strict=True)]
        nodes = graph.nodes
        uses: dict[int, int] = {}
        live: set[int] = set()
        todo = list(ends)
        while todo:
            i = todo.pop()
            uses[i] = uses.get(i, 0) + 1
            if i not in live:
                live.add(i)
                todo += operands(nodes[i])
        self._place: dict[int, int] = {}
        self.nodes: list[Node] = []
        fused: set[int] = set()
        made: dict[int, Node] = {}
        for i in sorted(live):
            made[i] = nodes[i]
            if nodes[i].op in ("+", "-"):
                product = self._product(nodes, uses, i)
                left = nodes[i].args[0]
                k = self._negated_product(nodes, uses, left)
                if product is None and nodes[i].op == "-" and k is not None:
                    # −(a b) − c: the sign goes to a, for which there is an instruction
                    a, b = nodes[k].args
                    made[left] = Node("neg", nodes[i].kind, (a,))
                    made[i] = Node("fms", nodes[i].kind, (left, b, nodes[i].args[1]))
                    fused.add(k)
                elif product is not None:
                    op, k, other = product
                    a, b = nodes[k].args
                    made[i] = Node(op, nodes[i].kind, (a, b, other))
                    fused.add(k)
        for i in sorted(live - fused):
            node = made[i]
            ops = operands(node)
            rest = node.args[: len(node.args) - len(ops)] if node.op in SPECIAL else ()
            if node.op in ("const", "in"):
                rest = node.args
            if node.op == "item":
                renamed = (self._place[node.args[0]], node.args[1])
            else:
                renamed = (*rest, *(self._place[k] for k in ops))
            self._place[i] = len(self.nodes)
            self.nodes.append(Node(node.op, node.kind, renamed))
        self.results = [self._place[i] for i in ends]

    @staticmethod
    def _product(nodes: list[Node], uses: dict[int, int], i: int) -> tuple[str, int, int] | None:
        a, b = nodes[i].args
        minus = nodes[i].op == "-"
        if nodes[a].op == "*" and uses[a] == 1:
            return "fms" if minus else "fma", a, b
        if nodes[b].op == "*" and uses[b] == 1:
            return "fnma" if minus else "fma", b, a
        return None

    @staticmethod
    def _negated_product(nodes: list[Node], uses: dict[int, int], i: int) -> int | None:
        """The product of which i is the negative, if neither has another use."""
        if nodes[i].op != "neg" or uses[i] != 1:
            return None
        (k,) = nodes[i].args
        return k if nodes[k].op == "*" and uses[k] == 1 else None

    @property
    def operations(self) -> int:
        """Floating-point operations, an fma counted as two, selections and comparisons as one."""
        free = ("const", "in", "item", "cast", "lane")
        return sum(
            0 if n.op in free else 2 if n.op in ("fma", "fms", "fnma") else 1 for n in self.nodes
        )

    def inputs(self) -> list[tuple[Any, ...]]:
        """Names of the numbers that are given."""
        return [n.args for n in self.nodes if n.op == "in"]
