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
        nodes, made = graph.nodes, dict[int, Node]()
        live = _live(dict(enumerate(nodes)), ends)
        uses = Counter(chain(ends, *(operands(nodes[i]) for i in live)))
        for i in live:
            made[i] = nodes[i]
            if nodes[i].op in ("+", "-"):
                product = self._product(nodes, uses, i)
                left = nodes[i].args[0]
                k = self._negated_product(nodes, uses, left)
                if product is None and nodes[i].op == "-" and k is not None:
                    # −(a b) − c: with the sign at a there is one instruction
                    a, b = nodes[k].args
                    made[left] = Node("neg", nodes[i].precision, (a,))
                    made[i] = Node("fms", nodes[i].precision, (left, b, nodes[i].args[1]))
                elif product is not None:
                    op, k, other = product
                    a, b = nodes[k].args
                    made[i] = Node(op, nodes[i].precision, (a, b, other))
        self.nodes, self.results = _numbered(made, ends)

    @classmethod
    def of(cls, made: Mapping[int, Node], ends: Sequence[int]) -> Flat:
        """The operations, in order and fused already, that the results ``ends`` need."""
        found = cls.__new__(cls)
        found.nodes, found.results = _numbered(made, ends)
        return found

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


def without_shared_calls(flat: Flat, is_shared: Callable[[Node], bool]) -> tuple[Flat | None, Flat]:
    """A graph in two parts: calls of untraced functions with shared inputs alone, and the rest.

    The first returns the results of those calls, which are inputs ("called", k) of the rest; it is
    None if there are none. No compiler moves a call of an unknown function out of a loop.
    """
    shared: set[int] = set()
    for i, node in enumerate(flat.nodes):
        given = is_shared(node) if node.op == "in" else all(k in shared for k in operands(node))
        if given:
            shared.add(i)
    made = dict(enumerate(flat.nodes))
    ends: list[int] = []
    for i, node in enumerate(flat.nodes):
        if node.op == "item" and i in shared:
            made[i] = Node("in", node.precision, ("called", len(ends)))
            ends.append(i)
    if not ends:
        return None, flat
    return Flat.of(dict(enumerate(flat.nodes)), ends), Flat.of(made, flat.results)


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


def _numbered(made: Mapping[int, Node], ends: Sequence[int]) -> tuple[list[Node], list[int]]:
    """(operations that results need, results), renumbered; before by the keys of ``made``."""
    place = {i: k for k, i in enumerate(_live(made, ends))}
    nodes = [renamed(made[i], [place[k] for k in operands(made[i])]) for i in place]
    return nodes, [place[i] for i in ends]


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
        self._has_own: list[bool] = []
        self._picked: dict[int, int] = {}

    @property
    def flat(self) -> Flat:
        """The graph of the values, in the order of their inputs."""
        return Flat.of(dict(enumerate(self._graph.nodes)), list(self._picked))

    def without(self, flat: Flat, *, more: bool = True) -> Flat:
        """The rest of a graph; without ``more``, only values of other graphs are replaced."""
        own = self._own(flat.nodes)
        made = dict(enumerate(flat.nodes))
        wanted = set(flat.results)
        for i in reversed(range(len(flat.nodes))):
            if i not in wanted:
                continue
            node = made[i]
            at = own.get(i)
            if (
                at is not None
                and node.precision
                and self._costs[at] >= _WORTH
                and self._has_own[at]
            ):
                if more:
                    self._picked.setdefault(at, len(self._picked))
                if at in self._picked:
                    node = made[i] = Node("in", node.precision, (self.name, self._picked[at]))
            wanted.update(operands(node))
        rest = Flat.of(made, flat.results)
        rest.groups = flat.groups
        return rest

    def _own(self, nodes: Sequence[Node]) -> dict[int, int]:
        """The operations that depend on the group alone, with their numbers among these."""
        own: dict[int, int] = {}
        for i, node in enumerate(nodes):
            ops = operands(node)
            given = node.op == "const" or (node.op == "in" and node.args[0] == self.group)
            if given or (node.op not in SPECIAL and all(k in own for k in ops)):
                args = [own[k] for k in ops] if ops else node.args
                own[i] = self._graph.add(node.op, node.precision, *args)
                if own[i] == len(self._costs):
                    cost = _WORTH if node.op == "cast" else 1 if ops else 0
                    self._costs.append(cost + sum(self._costs[k] for k in args if ops))
                    named = node.op == "in" and node.args[1] not in self.alike
                    self._has_own.append(named or any(self._has_own[k] for k in args if ops))
        return own
