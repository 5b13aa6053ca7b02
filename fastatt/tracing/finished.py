"""A finished graph: what is left of it for some results, multiplications fused."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush
from itertools import chain
from typing import Any

from fastatt.tracing.graph import Graph, number
from fastatt.tracing.nodes import SPECIAL, Node, operands, renamed

#: operations that a value must take to be kept in memory rather than computed again
_WORTH = 3
#: results that may wait before the order is changed: a processor has 16 or 32 registers
_REGISTERS = 24
#: operations that find something in memory, and what
_RESOURCES = {"gather": "table", "opaque": "function"}


class Flat:
    """What is left of a graph for some results: operations in order, multiplications fused.

    ``a*b + c`` becomes one ``fma`` where the product is used only there: chosen here and not by a
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
                elif product is not None:
                    op, k, other = product
                    a, b = nodes[k].args
                    made[i] = Node(op, nodes[i].kind, (a, b, other))
        self.nodes, self.results = _numbered(made, ends)

    @classmethod
    def of(cls, made: Mapping[int, Node], ends: Sequence[int]) -> Flat:
        """What of operations in order, fused already, is needed for the results ``ends``."""
        found = cls.__new__(cls)
        found.nodes, found.results = _numbered(made, ends)
        return found

    def first(self, n: int) -> Flat:
        """What the first n results need."""
        return Flat.of(dict(enumerate(self.nodes)), self.results[:n])

    def in_few_registers(self) -> Flat:
        """The graph in an order in which few results wait."""
        order = _ordered(self.nodes, self.results)
        at = {i: k for k, i in enumerate(order)}
        found = Flat.__new__(Flat)
        found.nodes = [
            renamed(self.nodes[i], [at[k] for k in operands(self.nodes[i])]) for i in order
        ]
        found.results = [at[i] for i in self.results]
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
        """Floating-point operations, an fma counted as two, selections and comparisons as one."""
        free = ("const", "in", "item", "cast", "lane")
        return sum(
            0 if n.op in free else 2 if n.op in ("fma", "fms", "fnma") else 1 for n in self.nodes
        )

    def inputs(self) -> list[tuple[Any, ...]]:
        """Names of the numbers that are given."""
        return [n.args for n in self.nodes if n.op == "in"]

    def spelled(self, resources: Sequence[tuple[str, Any]]) -> str:
        """All that it computes, as text; tables and functions by their places in ``resources``."""
        places = {key: i for i, key in enumerate(resources)}

        def spelled(node: Node) -> Any:
            if node.op not in _RESOURCES:
                return node.op, node.kind, node.args
            return node.op, node.kind, places[_RESOURCES[node.op], node.args[0]], node.args[1:]

        return repr(([spelled(node) for node in self.nodes], self.results))


def without_shared_calls(flat: Flat, is_shared: Callable[[Node], bool]) -> tuple[Flat | None, Flat]:
    """A graph in two: the calls of opaque functions of shared inputs alone, and the rest.

    The first gives the results of those calls, which are inputs ("called", k) of the rest; it is
    None where there are none. No compiler takes a call of an unknown function out of a loop.
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
            made[i] = Node("in", node.kind, ("called", len(ends)))
            ends.append(i)
    if not ends:
        return None, flat
    return Flat.of(dict(enumerate(flat.nodes)), ends), Flat.of(made, flat.results)


def resources_of(*flats: Flat) -> list[tuple[str, Any]]:
    """What graphs find in memory: ("table", its number) and ("function", itself)."""
    nodes = chain.from_iterable(flat.nodes for flat in flats)
    return list(dict.fromkeys((_RESOURCES[n.op], n.args[0]) for n in nodes if n.op in _RESOURCES))


def _numbered(made: Mapping[int, Node], ends: Sequence[int]) -> tuple[list[Node], list[int]]:
    """(operations that results need, results), numbered anew; before by the keys of ``made``."""
    live = set(ends)
    for i in sorted(made, reverse=True):
        if i in live:
            live.update(operands(made[i]))
    place = {i: k for k, i in enumerate(sorted(live))}
    nodes = [renamed(made[i], [place[k] for k in operands(made[i])]) for i in place]
    return nodes, [place[i] for i in ends]


@dataclass(frozen=True)
class Forms:
    """A step as a graph: the state after it, then its squared rotation angle if monitored."""

    monitored: Flat
    size: int

    @cached_property
    def plain(self) -> Flat:
        """The state alone, to the same bits."""
        whole = len(self.monitored.results) == self.size
        return self.monitored if whole else self.monitored.first(self.size).in_few_registers()


class Constants:
    """What of some graphs depends on the inputs of one group alone: to be computed once.

    Not what depends on those of the group alone that are numbered ``alike``.

    ``without`` gives a graph in which such values are inputs (``name``, k); ``flat`` computes them.
    No rounding changes: multiplications are fused already.
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
        """The rest of a graph; with no ``more`` only what is computed for another one is taken."""
        own = self._own(flat.nodes)
        made = dict(enumerate(flat.nodes))
        wanted = set(flat.results)
        for i in reversed(range(len(flat.nodes))):
            if i not in wanted:
                continue
            node = made[i]
            at = own.get(i)
            if at is not None and node.kind and self._costs[at] >= _WORTH and self._has_own[at]:
                if more:
                    self._picked.setdefault(at, len(self._picked))
                if at in self._picked:
                    node = made[i] = Node("in", node.kind, (self.name, self._picked[at]))
            wanted.update(operands(node))
        return Flat.of(made, flat.results)

    def _own(self, nodes: Sequence[Node]) -> dict[int, int]:
        """Which operations are of the group alone: their numbers among all such."""
        own: dict[int, int] = {}
        for i, node in enumerate(nodes):
            ops = operands(node)
            given = node.op == "const" or (node.op == "in" and node.args[0] == self.group)
            if given or (node.op not in SPECIAL and all(k in own for k in ops)):
                args = [own[k] for k in ops] if ops else node.args
                own[i] = self._graph.add(node.op, node.kind, *args)
                if own[i] == len(self._costs):
                    cost = _WORTH if node.op == "cast" else 1 if ops else 0
                    self._costs.append(cost + sum(self._costs[k] for k in args if ops))
                    named = node.op == "in" and node.args[1] not in self.alike
                    self._has_own.append(named or any(self._has_own[k] for k in args if ops))
        return own


# an order for few registers


def _ordered(made: Sequence[Node], ends: Iterable[int]) -> list[int]:
    """The operations' numbers in an order in which few results wait; ``ends`` are the results.

    Results that wait take the processor's registers. Goodman and Hsu, *Code scheduling and register
    allocation in large basic blocks* (1988): of what can be done next, what frees most; of equals
    what was written first.
    """
    order = range(len(made))
    free = {i for i in order if made[i].op in ("const", "in")}
    taken = {i: set(operands(made[i])) - free for i in order}
    kept = set(ends)
    if _waiting(order, taken, kept, free) <= _REGISTERS:
        return list(order)
    users: dict[int, list[int]] = {i: [] for i in order}
    for i in order:
        for k in taken[i]:
            users[k].append(i)
    missing = {i: len(taken[i]) for i in order}
    left = {i: len(users[i]) + (i in kept) for i in order}
    done = set(free)

    def cost(i: int) -> int:
        return -sum(left[k] == 1 for k in taken[i])

    found = [i for i in order if i in free]
    ready = [(cost(i), i) for i in order if i not in free and not missing[i]]
    heapify(ready)
    while ready:
        _, i = heappop(ready)
        if i in done:
            continue
        done.add(i)
        found.append(i)
        for k in taken[i]:
            left[k] -= 1
            if left[k] == 1:
                # its last user frees it, which is worth more than it was
                for j in users[k]:
                    if j not in done and not missing[j]:
                        heappush(ready, (cost(j), j))
        for j in users[i]:
            missing[j] -= 1
            if not missing[j]:
                heappush(ready, (cost(j), j))
    return found


def _waiting(
    order: Sequence[int], taken: Mapping[int, set[int]], kept: set[int], free: set[int]
) -> int:
    """Most results that wait at once."""
    uses = {i: int(i in kept) for i in order}
    for i in order:
        for k in taken[i]:
            uses[k] += 1
    live = most = 0
    for i in order:
        if i in free:
            continue
        live += 1
        most = max(most, live)
        for k in taken[i]:
            uses[k] -= 1
            live -= uses[k] == 0
    return most
