"""A graph's operations as Python text, for reading and for running on floats and arrays.

``a*b + c`` is a multiplication and an addition here, where machine code may fuse them.
"""

from __future__ import annotations

import ast
import functools
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from typing import Any

import numpy as np

from fastatt.tracing.finished import Flat
from fastatt.tracing.nodes import Node, operands
from fastatt.tracing.operations import OPERATIONS

_DEPTH = 5  # operations nested in one expression
_LENGTH = 80  # characters of an expression beyond which it gets a separate line


class GraphText:
    """A graph as a Python function: ``names`` of its arguments, its ``lines``, its ``results``.

    Intermediate values are named t1 and so on.
    """

    def __init__(self, flat: Flat) -> None:
        self.names = ["".join(map(str, parts)) for parts in flat.inputs()]
        self.lines: list[str] = []
        names, texts = iter(self.names), list[tuple[str, int]]()
        uses = Counter(chain(flat.results, *map(operands, flat.nodes)))
        for i, node in enumerate(flat.nodes):
            if node.op in ("in", "const"):
                texts.append((next(names) if node.op == "in" else repr(node.args[0]), 0))
                continue
            inner = [texts[k] for k in operands(node)]
            text = _text(node, [x for x, _ in inner])
            depth = 1 + max((d for _, d in inner), default=0)
            if uses[i] > 1 or i in flat.results or depth == _DEPTH or len(text) > _LENGTH:
                self.lines.append(f"t{len(self.lines) + 1} = {text}")
                text, depth = f"t{len(self.lines)}", 0
            texts.append((text, depth))
        self.results = [texts[i][0] for i in flat.results]

    def __str__(self) -> str:
        return "\n".join([*self.lines, f"return {', '.join(self.results)}"])


def _text(node: Node, parts: Sequence[str]) -> str:
    """An operation as an expression of its operands."""
    op, args = node.op, node.args
    if op in OPERATIONS and OPERATIONS[op].text:
        text = OPERATIONS[op].text.format(*(f"({x})" for x in parts))
        return ast.unparse(ast.parse(text))  # without needless brackets
    if op in ("item", "element"):
        return f"{parts[0]}[{args[1]}]"
    if op == "row":
        table, count = args[:2]
        parts = [f"table{getattr(table, 'digest', table)}", *parts, str(count)]
    elif op == "lane":
        parts = [str(args[0]), *parts]
    elif op == "opaque":
        op = re.sub(r"\W", "_", getattr(args[0], "name", op))
    name = {"cast": node.precision, "select": "where", "not": "logical_not"}.get(op, op)
    return f"{name}({', '.join(parts)})"


def function(flat: Flat, tables: Mapping[Any, Any] | None = None) -> Callable[..., tuple[Any, ...]]:
    """The graph as a Python function of its inputs, in the order of ``flat.inputs()``.

    It takes floats or arrays that broadcast, of either precision, and computes in theirs by IEEE
    754: a division by 0 is not an error. ``tables`` are the arrays that the graph reads; functions
    that are not traced are called with floats.
    """

    def call(*inputs: Any) -> tuple[Any, ...]:
        # NumPy scalars divide by 0 and overflow as arrays do
        numbers = [np.asarray(x)[()] for x in inputs]
        scalar = np.result_type(np.float32 if numbers else np.float64, *numbers).type
        operate = functools.partial(evaluated, tables=tables, scalar=scalar)
        values = performed(flat.nodes, numbers, operate)
        results = [values[i] for i in flat.results]
        if all(isinstance(x, (float, int)) and not isinstance(x, np.generic) for x in inputs):
            return tuple(map(float, results))
        return tuple(scalar(x) if type(x) is float else x for x in results)

    return call


def performed(
    nodes: Iterable[Node], inputs: Iterable[Any], operate: Callable[..., Any]
) -> list[Any]:
    """The values of all operations, of which ``operate`` gives one, from those of the inputs."""
    values, numbers = list[Any](), iter(inputs)
    with np.errstate(all="ignore"):
        for node in nodes:
            of = [values[i] for i in operands(node)]
            values.append(next(numbers) if node.op == "in" else operate(node, of))
    return values


def evaluated(
    node: Node, numbers: Sequence[Any], tables: Any = None, scalar: Any = np.float64
) -> Any:
    """The value of an operation of arrays or numbers; constants are ``scalar``."""
    op, args = node.op, node.args
    if op == "const":
        return args[0]
    if op == "select" or all(type(x) is float for x in numbers):
        numbers = [scalar(x) if type(x) is float else x for x in numbers]
    if op in ("item", "element"):
        return numbers[0][args[1]]
    if op == "gather":
        return _taken(args[0].data, numbers[0])
    if op == "row":
        data = args[0].data if tables is None else tables[args[0]]
        return [_taken(data, numbers[0] + k) for k in range(args[1])]
    if op == "look":
        return args[0].numbers_at(*numbers)
    if op == "lane":
        return numbers[0][..., args[0]]
    if op == "cast":
        return {"double": np.float64, "single": np.float32}[node.precision](numbers[0])
    if op == "opaque":
        boxes = np.broadcast_arrays(*numbers)
        rows = [args[0](*map(float, x)) for x in zip(*map(np.ravel, boxes), strict=True)]
        return np.reshape(np.transpose(rows), (args[1], *boxes[0].shape))
    return OPERATIONS[op].array(*numbers)


def _taken(data: Any, index: Any) -> Any:
    """The number of an array at a whole index, or the nearest that it has."""
    table = np.ravel(data)
    return table[np.clip(np.nan_to_num(index), 0, table.size - 1).astype(np.int64)]
