"""A graph's operations as Python text, for reading and for running on floats and arrays.

``a*b + c`` is a multiplication and an addition here, where machine code may fuse them.
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from fastatt.tracing.finished import Flat
from fastatt.tracing.nodes import COMPARISONS, LIBRARY, SPECIAL, Node, operands

_DEPTH = 5  # operations nested in one expression
_LENGTH = 80  # characters of an expression beyond which it gets a separate line
# operations that are not calls of functions, with the operands a, b and c
_FORMS = {
    "fma": "a * b + c",
    "fms": "a * b - c",
    "fnma": "c - a * b",
    "neg": "-a",
    "and": "a & b",
    "or": "a | b",
    **{op: f"a {op} b" for op in ("+", "-", "*", "/", *COMPARISONS)},
}


class _Operands(ast.NodeTransformer):
    """Replaces the names a, b and c by expressions."""

    def __init__(self, operands: Sequence[ast.expr]) -> None:
        self._operands = operands

    def visit_Name(self, e: ast.Name) -> Any:
        return self._operands["abc".index(e.id)]


class GraphText:
    """A graph as a Python function: ``names`` of its arguments, its ``lines``, its ``results``.

    Intermediate values are named ``prefix`` and a number.
    """

    def __init__(self, flat: Flat, prefix: str = "t") -> None:
        self.flat, self.prefix = flat, prefix
        self.names = _names(flat.inputs())
        self.lines: list[str] = []
        self._uses = _uses(flat)
        self._made: list[tuple[ast.expr, int]] = []
        given = iter(self.names)
        for i, node in enumerate(flat.nodes):
            name = next(given) if node.op == "in" else None
            self._made.append(self._line(i, *self._expression(node, name)))
        self.results = [ast.unparse(self._made[i][0]) for i in flat.results]

    def __str__(self) -> str:
        return "\n".join([*self.lines, f"return {', '.join(self.results)}"])

    def _line(self, i: int, made: ast.expr, depth: int) -> tuple[ast.expr, int]:
        """An expression, or the name of the line that it gets."""
        if depth == 0:
            return made, 0
        once = self._uses[i] == 1 and i not in self.flat.results
        if once and depth < _DEPTH and len(ast.unparse(made)) <= _LENGTH:
            return made, depth
        name = f"{self.prefix}{len(self.lines) + 1}"
        self.lines.append(f"{name} = {ast.unparse(made)}")
        return ast.Name(name), 0

    def _expression(self, node: Node, name: str | None) -> tuple[ast.expr, int]:
        """(the expression of an operation, its depth)."""
        op = node.op
        if name is not None:
            return ast.Name(name), 0
        if op == "const":
            return ast.Constant(node.args[0]), 0
        taken = [self._made[i] for i in operands(node)]
        depth = 1 + max((d for _, d in taken), default=0)
        return self._operation(node, [x for x, _ in taken]), depth

    def _operation(self, node: Node, args: list[ast.expr]) -> ast.expr:
        op = node.op
        if op in _FORMS:
            form = ast.parse(_FORMS[op], mode="eval").body
            return _Operands(args).visit(form)  # type: ignore[no-any-return]
        if op == "item":
            return ast.Subscript(args[0], ast.Constant(node.args[1]))
        if op == "gather":
            args = [ast.Name(f"table{getattr(node.args[0], 'digest', node.args[0])}"), *args]
        elif op == "lane":
            args = [ast.Constant(node.args[0]), *args]
        name = _identifier(getattr(node.args[0], "name", "opaque")) if op == "opaque" else op
        name = {"cast": node.kind, "select": "where", "not": "logical_not"}.get(op, name)
        return call_of(name, *args)


def function(flat: Flat, tables: Mapping[Any, Any] | None = None) -> Callable[..., tuple[Any, ...]]:
    """The graph as a Python function of its inputs, in the order of ``flat.inputs()``.

    It takes floats or arrays that broadcast, of either precision, and computes in theirs by IEEE
    754: a division by 0 is not an error. ``tables`` are the arrays that the graph reads; functions
    that are not traced are called with floats.
    """

    def call(*given: Any) -> tuple[Any, ...]:
        # NumPy scalars divide by 0 and overflow as arrays do
        values = [np.asarray(x)[()] for x in given]
        kind = np.result_type(np.float32 if values else np.float64, *values).type
        made = performed(flat.nodes, values, functools.partial(evaluated, tables=tables, kind=kind))
        results = [made[i] for i in flat.results]
        if all(isinstance(x, (float, int)) and not isinstance(x, np.generic) for x in given):
            return tuple(map(float, results))
        return tuple(kind(x) if type(x) is float else x for x in results)

    return call


def performed(
    nodes: Iterable[Node], given: Iterable[Any], operate: Callable[..., Any]
) -> list[Any]:
    """The values of all operations, of which ``operate`` gives one, from those of the inputs."""
    made, numbers = list[Any](), iter(given)
    with np.errstate(all="ignore"):
        for node in nodes:
            of = [made[i] for i in operands(node)]
            made.append(next(numbers) if node.op == "in" else operate(node, of))
    return made


def evaluated(node: Node, given: Sequence[Any], tables: Any = None, kind: Any = np.float64) -> Any:
    """The value of an operation of arrays or numbers; constants have a kind or that of others."""
    op, args = node.op, node.args
    if op == "const":
        return args[0]
    if op == "select" or all(type(x) is float for x in given):
        given = [kind(x) if type(x) is float else x for x in given]
    if op == "item":
        return given[0][args[1]]
    if op == "gather":
        table = np.ravel(args[0].data if tables is None else tables[args[0]])
        return table[np.clip(np.nan_to_num(given[0]), 0, table.size - 1).astype(np.int64)]
    if op == "look":
        return args[0].numbers_at(*given)
    if op == "lane":
        return given[0][..., args[0]]
    if op == "cast":
        return {"double": np.float64, "single": np.float32}[node.kind](given[0])
    if op == "opaque":
        boxes = np.broadcast_arrays(*given)
        rows = [args[0](*map(float, x)) for x in zip(*map(np.ravel, boxes), strict=True)]
        return np.reshape(np.transpose(rows), (args[1], *boxes[0].shape))
    return (_OPERATIONS.get(op) or getattr(np, op))(*given)


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "neg": np.negative,
    "<": np.less, "<=": np.less_equal, ">": np.greater, ">=": np.greater_equal, "==": np.equal,
    "!=": np.not_equal, "and": np.logical_and, "or": np.logical_or, "not": np.logical_not,
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2,
    "//": np.floor_divide, "%": np.mod, "pow": np.power, "larger": np.maximum,
    "fma": lambda a, b, c: a * b + c, "fms": lambda a, b, c: a * b - c,
    "fnma": lambda a, b, c: c - a * b, "select": lambda *given: np.asarray(np.where(*given))[()],
    "min": lambda a, b: np.where(b < a, b, a), "max": lambda a, b: np.where(b > a, b, a),
    "remainder": lambda x, y: x - np.rint(x / y) * y,
}  # fmt: skip
#: functions in the text
_FUNCTIONS = frozenset({
    *LIBRARY, *SPECIAL, "abs", "double", "floor", "larger", "nan", "rint", "single", "sqrt", "where"
})  # fmt: skip


def _names(inputs: list[tuple[Any, ...]]) -> list[str]:
    """A name for each input: ("q", 1) is q1."""
    found: list[str] = []
    for parts in inputs:
        name = _identifier("".join(map(str, parts)))
        while name in found or name in _FUNCTIONS or re.fullmatch(r"t\d+", name):
            name += "_"
        found.append(name)
    return found


def _identifier(name: str) -> str:
    name = re.sub(r"\W", "_", name)
    return name if name.isidentifier() else f"_{name}"


def _uses(flat: Flat) -> list[int]:
    uses = [0] * len(flat.nodes)
    for node in flat.nodes:
        for i in operands(node):
            uses[i] += 1
    return uses


def call_of(name: str, *args: ast.expr) -> ast.expr:
    """A call of a function by its name."""
    return ast.Call(ast.Name(name), list(args), [])
