"""Formulas for arguments of given forms: a graph, or three of them around a loop.

The form of a number is its kind; that of a tuple is its class with the forms of its parts.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastatt.tracing.dual import Dual, mapped, value
from fastatt.tracing.finished import Flat, resources_of
from fastatt.tracing.graph import Condition, Graph, Number, choose, flattened
from fastatt.tracing.nodes import TraceError

WIDEST = 64
"""Directions of dual numbers that go side by side."""


class Tuple(NamedTuple):
    """The form of a tuple: its class and the forms of its parts."""

    cls: type
    parts: tuple[Any, ...]


class Recurrence:
    """A formula that takes a step with each row of a table of constants, compiled as a loop.

    ``begin(*args)`` returns (x, e): the changing numbers, and those that a step needs in addition
    to the arguments. ``step(x, e, row, *args)`` returns the next x, and ``end(x, e, *args)`` the
    result. x and e are numbers in tuples, nested in any way, also dual ones. Called with traced
    numbers, all steps are written out.
    """

    def __init__(
        self,
        begin: Callable[..., Any],
        step: Callable[..., Any],
        end: Callable[..., Any],
        table: Sequence[Sequence[float]],
    ) -> None:
        functools.update_wrapper(self, begin)
        self.begin, self.step, self.end = begin, step, end
        self.table = tuple(map(tuple, table))

    def __call__(self, *args: Any) -> Any:
        """All steps, written out."""
        x, e = self.begin(*args)
        for row in self.table:
            x = self.step(x, e, row, *args)
        return self.end(x, e, *args)


class Loop(NamedTuple):
    """The graphs before the end of a recurrence: its start, and its step for each row of the table.

    ``begin`` returns the numbers ("s", 0), ("s", 1), ...; ``step`` takes them and ("row", k) and
    returns new values of the first of them. Those in ``wide`` have a lane for each direction.
    """

    begin: Flat
    step: Flat
    wide: frozenset[int]
    table: tuple[tuple[float, ...], ...]


class Traced(NamedTuple):
    """A formula for arguments of given forms: its graph, the form of its result, its lanes.

    The graph of a recurrence is that of its end, after ``loop``. The arguments are the inputs ("x",
    k).
    """

    flat: Flat
    form: Any
    lanes: int
    loop: Loop | None = None

    @property
    def flats(self) -> tuple[Flat, ...]:
        """Its graphs, in the order in which they run."""
        loop = self.loop
        return (self.flat,) if loop is None else (loop.begin, loop.step, self.flat)

    @property
    def resources(self) -> list[tuple[str, Any]]:
        """The resources of its graphs in memory."""
        return resources_of(*self.flats)

    def spelled(self, resources: Sequence[tuple[str, Any]]) -> str:
        """The whole computation as text, with tables and functions by their places."""
        rest = None if self.loop is None else (sorted(self.loop.wide), self.loop.table)
        return repr((self.lanes, rest, [flat.spelled(resources) for flat in self.flats]))


def trace(
    formula: Callable[..., Any], forms: Sequence[Any], widest: int = WIDEST, kind: str = "", *,
    native: bool = False,
) -> Traced:  # fmt: skip
    """Trace a formula for arguments of given forms; with ``widest`` 0 without lanes for directions.

    ``kind`` is that of all results; by default each result has its own kind. ``native`` is that of
    the graph.
    """
    constants = "single" if set(flattened_forms(forms)) == {"single"} else "double"
    if isinstance(formula, Recurrence) and len(formula.table) > 1:
        return _recurring(formula, forms, constants, widest)
    graph = Graph(widest, native=native)
    form, flat = _ended(graph, formula(*_arguments(graph, forms)), constants, kind)
    return Traced(flat, form, _lanes((flat,)))


def flattened_forms(forms: Sequence[Any]) -> Iterator[str]:
    """The kinds of the numbers of given forms, in order."""
    for form in forms:
        if isinstance(form, Tuple):
            yield from flattened_forms(form.parts)
        else:
            yield form


def _arguments(graph: Graph, forms: Sequence[Any]) -> list[Any]:
    places = itertools.count()
    return [_inputs(graph, form, places) for form in forms]


def _inputs(graph: Graph, form: Any, places: Iterator[int]) -> Any:
    if isinstance(form, Tuple):
        parts = [_inputs(graph, part, places) for part in form.parts]
        return tuple(parts) if form.cls is tuple else form.cls(*parts)
    return graph.input(form, "x", next(places))


def _ended(graph: Graph, found: Any, constants: str, kind: str = "") -> tuple[Any, Flat]:
    """Form and graph of a result."""
    numbers: list[Any] = []
    form = _result(found, constants, numbers)
    kinds = ["double" if own == "truth" else own for own in flattened_forms((form,))]
    return form, Flat(graph, numbers, kind or kinds)


def _result(x: Any, constants: str, numbers: list[Any]) -> Any:
    """The form of a result; its numbers are added to ``numbers``."""
    if isinstance(x, (tuple, list)):
        cls = type(x) if hasattr(x, "_fields") else tuple
        return Tuple(cls, tuple(_result(part, constants, numbers) for part in x))
    if isinstance(x, (bool, Condition)):
        numbers.append(choose(x, 1.0, 0.0))
        return "truth"
    if isinstance(x, Number):
        numbers.append(x)
        return x.kind
    if isinstance(x, (float, int, np.number)):
        numbers.append(float(x))
        return constants
    raise TraceError(f"a result of {type(x).__name__}")


def _lanes(flats: Sequence[Flat]) -> int:
    """The power of 2 that holds the directions of the graphs' inputs and results."""
    nodes = itertools.chain.from_iterable(flat.nodes for flat in flats)
    asked = (
        node.args[1 if node.op == "in" else 0]
        for node in nodes
        if node.op == "lane" or (node.op == "in" and node.args[0] == "direction")
    )
    return 1 << max(asked, default=0).bit_length()


# recurrences


class _Leaf(NamedTuple):
    """A number passed from one graph to the next: its kind, and its number of derivatives."""

    kind: str
    slopes: int


def _recurring(formula: Recurrence, forms: Sequence[Any], constants: str, widest: int) -> Traced:
    graph = Graph(widest)
    x, e = formula.begin(*_arguments(graph, forms))
    moving = [_Leaf(_kind(y) or constants, _slopes(y)) for y in flattened(x)]
    kept = [y for y in flattened(e) if _kind(y)]
    fixed = [_Leaf(_kind(y), _slopes(y)) for y in kept]
    begun, size = graph, len(formula.table[0])
    while True:
        graph = Graph(widest)
        given = _crossed(graph, (x, e), moving, fixed)
        row = graph.inputs(constants, "row", size)
        after = flattened(formula.step(*given, row, *_arguments(graph, forms)))
        if len(after) != len(moving):
            raise TraceError(f"a step from {len(moving)} numbers to {len(after)}")
        # a number may acquire derivatives in the first step
        grown = [
            _Leaf(a.kind, max(a.slopes, _slopes(y))) for a, y in zip(moving, after, strict=True)
        ]
        if grown == moving:
            break
        moving = grown
    before = _apart(begun, [*flattened(x), *kept], [*moving, *fixed])
    step = _apart(graph, after, moving)
    graph = Graph(widest)
    given = _crossed(graph, (x, e), moving, fixed)
    form, flat = _ended(graph, formula.end(*given, *_arguments(graph, forms)), constants)
    firsts = itertools.accumulate((1 + a.slopes for a in moving), initial=0)
    places = (range(k + 1, k + 1 + a.slopes) for k, a in zip(firsts, moving, strict=False))
    wide = frozenset(itertools.chain.from_iterable(places))
    return Traced(flat, form, _lanes((before, step, flat)), Loop(before, step, wide, formula.table))


def _kind(x: Any) -> str:
    """Precision of a number, "" for a known one."""
    if isinstance(x, Condition):
        raise TraceError("a truth value that goes from step to step")
    parts = (x.value, *x.slopes) if isinstance(x, Dual) else (x,)
    return next((y.kind for y in parts if isinstance(y, Number)), "")


def _slopes(x: Any) -> int:
    return len(x.slopes) if isinstance(x, Dual) else 0


def _crossed(
    graph: Graph, values: Any, moving: Sequence[_Leaf], fixed: Sequence[_Leaf]
) -> tuple[Any, Any]:
    """(x, e) as inputs of another graph; known numbers of e stay known."""
    places = itertools.count()
    x, e = values

    def number(leaf: _Leaf) -> Any:
        numbers = [graph.input(leaf.kind, "s", next(places)) for _ in range(1 + leaf.slopes)]
        return Dual(numbers[0], tuple(numbers[1:])) if leaf.slopes else numbers[0]

    first, second = iter(moving), iter(fixed)
    return (
        mapped(lambda y: number(next(first)), x),
        mapped(lambda y: number(next(second)) if _kind(y) else y, e),
    )


def _apart(graph: Graph, values: Sequence[Any], leaves: Sequence[_Leaf]) -> Flat:
    """The graph of some numbers with their derivatives."""
    numbers: list[Any] = []
    kinds: list[str] = []
    for x, leaf in zip(values, leaves, strict=True):
        numbers += [value(x), *(x.slopes if isinstance(x, Dual) else (0.0,) * leaf.slopes)]
        kinds += [leaf.kind] * (1 + leaf.slopes)
    return Flat(graph, numbers, kinds)
