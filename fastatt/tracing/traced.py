"""Formulas for arguments of given forms, as graphs.

The form of a number is its precision; that of a tuple is its class with the forms of its parts.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fastatt.tracing.finished import Flat, resources_of
from fastatt.tracing.graph import Condition, Graph, Number, choose
from fastatt.tracing.nodes import TraceError

WIDEST = 64
"""Directions of dual numbers that go side by side."""


class Tuple(NamedTuple):
    """The form of a tuple: its class and the forms of its parts."""

    cls: type
    parts: tuple[Any, ...]


class Traced(NamedTuple):
    """A formula for arguments of given forms: its graph, the form of its result, its lanes.

    The arguments are the inputs ("x", k).
    """

    flat: Flat
    form: Any
    lanes: int

    @property
    def resources(self) -> list[tuple[str, Any]]:
        """The resources of its graph in memory."""
        return resources_of(self.flat)


def trace(
    formula: Callable[..., Any], forms: Sequence[Any], widest: int = WIDEST, precision: str = "", *,
    native: bool = False,
) -> Traced:  # fmt: skip
    """Trace a formula for arguments of given forms; with ``widest`` 0 without lanes for directions.

    ``precision`` is that of all results; by default each result has its own. ``native`` is that
    of the graph.
    """
    constants = "single" if set(flattened_forms(forms)) == {"single"} else "double"
    graph, places, numbers = Graph(widest, native=native), itertools.count(), list[Any]()

    def number(form: str) -> Any:
        return graph.input(form, "x", next(places))

    result = formula(*(assembled(form, number) for form in forms))
    form = _result(result, constants, numbers)
    precisions = ["double" if x == "truth" else x for x in flattened_forms((form,))]
    flat = Flat(graph, numbers, precision or precisions)
    asked = (
        node.args[1 if node.op == "in" else 0]
        for node in flat.nodes
        if node.op == "lane" or (node.op == "in" and node.args[0] == "direction")
    )
    # the power of 2 that holds the directions of inputs and results
    return Traced(flat, form, 1 << max(asked, default=0).bit_length())


def flattened_forms(forms: Sequence[Any]) -> Iterator[str]:
    """The precisions of the numbers of given forms, in order."""
    for form in forms:
        if isinstance(form, Tuple):
            yield from flattened_forms(form.parts)
        else:
            yield form


def assembled(form: Any, number: Callable[[str], Any]) -> Any:
    """A value of a given form, of numbers that are made one by one from theirs."""
    if isinstance(form, Tuple):
        parts = [assembled(part, number) for part in form.parts]
        return tuple(parts) if form.cls is tuple else form.cls(*parts)
    return number(form)


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
        return x.precision
    if isinstance(x, (float, int, np.number)):
        numbers.append(float(x))
        return constants
    raise TraceError(f"a result of {type(x).__name__}")
