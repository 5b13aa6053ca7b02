"""Finished graphs: the operations that some results need, with fused multiplications."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any

from fastatt.tracing.graph import Graph, number
from fastatt.tracing.nodes import SPECIAL, Node, operands, renamed

#: least number of operations of a value that is kept in memory instead of being computed again
_WORTH = 3
#: operations that use a resource in memory, and what it is
_RESOURCES = {"row": "table", "opaque": "function"}


class Flat:
    """The operations that some results of a graph need, in order, with fused multiplications.

    ``a*b + c`` becomes one ``fma`` if the product is used only there. This is decided here and not
    by a compiler, so that every form of a formula rounds alike.
    """

    #: how many of the results belong together, by name, if these groups have names
    groups: Mapping[str, int] = MappingProxyType({})

    def __init__(
        self, graph: Graph, results: Iterable[Any], precisions: str | Sequence[str]
    ) -> None:
        values = list(results)
        each = [precisions] * len(values) if isinstance(precisions, str) else list(precisions)
        ends = [number(graph, x, precision).at for x, precision in zip(values, each, strict=True)]
        nodes = dict(enumerate(graph.nodes))
        live = _live(nodes, ends)
        uses = Counter(chain(ends, *(operands(nodes[i]) for i in live)))
        for i in live:
            nodes.update(_fused(graph.nodes, uses, i))
        self.nodes, self.results = _numbered(nodes, ends)

    @classmethod
    def of(cls, nodes: Mapping[int, Node], ends: Sequence[int]) -> Flat:
        """The operations, in order and fused already, that the results ``ends`` need."""
        flat = cls.__new__(cls)
        flat.nodes, flat.results = _numbered(nodes, ends)
        return flat

    @property
    def operations(self) -> int:
        """Floating-point operations; an fma counts as two, selections and comparisons as one."""
        free = ("const", "in", "item", "element", "cast", "lane")
        return sum(
            0 if n.op in free else 2 if n.op in ("fma", "fms", "fnma") else 1 for n in self.nodes
        )

    def inputs(self) -> list[tuple[Any, ...]]:
        """Names of the inputs."""
        return [n.args for n in self.nodes if n.op == "in"]

    def spelled(self, resources: Sequence[tuple[str, Any]]) -> str:
        """The whole computation as text, with resources by their places in ``resources``."""
        places = {key: i for i, key in enumerate(resources)}

        def spelled(node: Node) -> Any:
            if node.op not in _RESOURCES:
                return node.op, node.precision, node.args
            return node.op, node.precision, places[_RESOURCES[node.op], node.args[0]], node.args[1:]

        return repr(([spelled(node) for node in self.nodes], self.results))


def _fused(nodes: Sequence[Node], uses: Mapping[int, int], i: int) -> dict[int, Node]:
    """What a sum becomes with a product that is used only there; nothing if there is none."""
    op, precision, args = nodes[i]
    if op not in ("+", "-"):
        return {}

    def is_used_once(k: int, op: str = "*") -> bool:
        return nodes[k].op == op and uses[k] == 1

    (a, b), minus = args, op == "-"
    if is_used_once(a):
        return {i: Node("fms" if minus else "fma", precision, (*nodes[a].args, b))}
    if is_used_once(b):
        return {i: Node("fnma" if minus else "fma", precision, (*nodes[b].args, a))}
    if minus and is_used_once(a, "neg") and is_used_once(nodes[a].args[0]):
        # −(x y) − b: with the sign at x there is one instruction
        x, y = nodes[nodes[a].args[0]].args
        return {a: Node("neg", precision, (x,)), i: Node("fms", precision, (a, y, b))}
    return {}


def without_shared_calls(flat: Flat, is_shared: Callable[[Node], bool]) -> tuple[Flat | None, Flat]:
    """A graph in two parts: calls of untraced functions with shared inputs alone, and the rest.

    The first returns the results of those calls, which are inputs ("called", k) of the rest; it is
    None if there are none. No compiler moves a call of an unknown function out of a loop.
    """
    shared: set[int] = set()
    nodes = dict(enumerate(flat.nodes))
    ends: list[int] = []
    for i, node in enumerate(flat.nodes):
        if is_shared(node) if node.op == "in" else shared.issuperset(operands(node)):
            shared.add(i)
            if node.op == "item":
                nodes[i] = Node("in", node.precision, ("called", len(ends)))
                ends.append(i)
    if not ends:
        return None, flat
    return Flat.of(dict(enumerate(flat.nodes)), ends), Flat.of(nodes, flat.results)


def resources_of(*flats: Flat) -> list[tuple[str, Any]]:
    """The resources of graphs in memory: ("table", its number) and ("function", itself)."""
    nodes = chain.from_iterable(flat.nodes for flat in flats)
    return list(dict.fromkeys((_RESOURCES[n.op], n.args[0]) for n in nodes if n.op in _RESOURCES))


def _live(nodes: Mapping[int, Node], ends: Sequence[int]) -> list[int]:
    """The numbers of the operations that results need, in order."""
    live = set(ends)
    for i in sorted(nodes, reverse=True):
        if i in live:
            live.update(operands(nodes[i]))
    return sorted(live)


def _numbered(nodes: Mapping[int, Node], ends: Sequence[int]) -> tuple[list[Node], list[int]]:
    """(operations that results need, results), renumbered; before by the keys of ``nodes``."""
    place = {i: k for k, i in enumerate(_live(nodes, ends))}
    needed = [renamed(nodes[i], [place[k] for k in operands(nodes[i])]) for i in place]
    return needed, [place[i] for i in ends]


class Constants:
    """Parts of some graphs that depend on the inputs of one group only, to be computed once.

    Parts that depend only on inputs of the group with numbers in ``alike`` are excluded.
    ``without`` returns a graph in which such values are inputs (``name``, k); ``flat`` computes
    them. No rounding changes, since multiplications are fused already.
    """

    def __init__(self, group: str, name: str, alike: Collection[int] = ()) -> None:
        self.group, self.name, self.alike = group, name, alike
        self._graph = Graph()
        self._costs: list[int] = []
        #: whether they depend on numbers that are not in ``alike``
        self._differs: list[bool] = []
        self._picked: dict[int, int] = {}

    @property
    def flat(self) -> Flat:
        """The graph of the values, in the order of their inputs."""
        return Flat.of(dict(enumerate(self._graph.nodes)), list(self._picked))

    def without(self, flat: Flat, *, more: bool = True) -> Flat:
        """The rest of a graph; without ``more``, only values of other graphs are replaced."""
        alone, nodes, wanted = self._alone(flat.nodes), dict(enumerate(flat.nodes)), {*flat.results}
        for i in reversed(range(len(flat.nodes))):
            if i not in wanted:
                continue
            k, node = alone.get(i, -1), nodes[i]
            if k >= 0 and node.precision and self._costs[k] >= _WORTH and self._differs[k]:
                if more:
                    self._picked.setdefault(k, len(self._picked))
                if k in self._picked:
                    nodes[i] = Node("in", node.precision, (self.name, self._picked[k]))
            wanted.update(operands(nodes[i]))
        rest = Flat.of(nodes, flat.results)
        rest.groups = flat.groups
        return rest

    def _alone(self, nodes: Sequence[Node]) -> dict[int, int]:
        """The operations that depend on the group alone, with their numbers among these."""
        alone: dict[int, int] = {}
        for i, node in enumerate(nodes):
            parts = operands(node)
            is_leaf = node.op == "const" or (node.op == "in" and node.args[0] == self.group)
            if is_leaf or (node.op not in SPECIAL and all(k in alone for k in parts)):
                parts = tuple(alone[k] for k in parts)
                alone[i] = self._graph.add(node.op, node.precision, *(parts or node.args))
                if alone[i] == len(self._costs):
                    cost = _WORTH if node.op == "cast" else 1 if parts else 0
                    self._costs.append(cost + sum(self._costs[k] for k in parts))
                    differs = node.op == "in" and node.args[1] not in self.alike
                    self._differs.append(differs or any(self._differs[k] for k in parts))
        return alone
