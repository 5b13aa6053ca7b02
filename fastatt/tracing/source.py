"""A graph's operations as Python text, for reading and for running on floats and arrays.

``a*b + c`` is a multiplication and an addition here, where machine code may fuse them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from fastatt.tracing.finished import Flat
from fastatt.tracing.nodes import COMPARISONS, Node, operands

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
        self.functions = list(dict.fromkeys(n.args[0] for n in flat.nodes if n.op == "opaque"))
        self.lines: list[str] = []
        self._uses = _uses(flat)
        self._mixed = len({node.kind for node in flat.nodes if node.kind}) > 1
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
        if op == "/" and all(isinstance(x, ast.Constant) for x in args):
            # Python refuses to divide a constant by 0
            args = [call_of(node.kind, args[0]), args[1]]
        if op == "select" and self._mixed:
            args = [call_of(node.kind, x) if isinstance(x, ast.Constant) else x for x in args]
        if op in _FORMS:
            form = ast.parse(_FORMS[op], mode="eval").body
            return _Operands(args).visit(form)  # type: ignore[no-any-return]
        if op == "item":
            return ast.Subscript(args[0], ast.Constant(node.args[1]))
        if op == "gather":
            args = [ast.Name(table_name(node.args[0])), *args]
        elif op == "lane":
            args = [ast.Constant(node.args[0]), *args]
        name = self.function_name(node.args[0]) if op == "opaque" else op
        name = {"cast": node.kind, "select": "where", "not": "logical_not"}.get(op, name)
        return call_of(name, *args)

    def function_name(self, function: Any) -> str:
        """Name of a function that is not traced."""
        name = _identifier(getattr(function, "name", "opaque"))
        others = [f for f in self.functions if _identifier(getattr(f, "name", "opaque")) == name]
        return name if len(others) == 1 else f"{name}_{others.index(function)}"


def table_name(key: Any) -> str:
    """Name of the array of a table: a number, or one in a user-defined function."""
    return f"table{getattr(key, 'digest', key)}"


def function(flat: Flat, tables: Mapping[int, Any] | None = None) -> Callable[..., tuple[Any, ...]]:
    """The graph as a Python function of its inputs, in the order of ``flat.inputs()``.

    It takes floats or arrays that broadcast, of either precision, and computes in theirs by IEEE
    754: a division by 0 is not an error. ``tables`` are the arrays that the graph reads; functions
    that are not traced are called with floats.
    """
    text = GraphText(flat)
    comma = "," if len(text.results) == 1 else ""
    body = "\n    ".join([*text.lines, f"return ({', '.join(text.results)}{comma})"])
    program = compile(f"def flat({', '.join(text.names)}):\n    {body}\n", "<flat>", "exec")
    scope: dict[str, Any] = dict(SCOPE)
    scope |= {table_name(k): np.asarray(x) for k, x in (tables or {}).items()}
    scope |= {text.function_name(opaque): _each(opaque) for opaque in text.functions}
    by_precision: dict[Any, Callable[..., Any]] = {}

    def call(*given: Any) -> tuple[Any, ...]:
        values = [np.asarray(x) for x in given]
        kind = np.result_type(np.float32 if values else np.float64, *values)
        if kind not in by_precision:
            own = {**scope, "where": _where(kind)}
            exec(program, own)
            by_precision[kind] = own["flat"]
        # NumPy scalars divide by 0 and overflow as arrays do
        with np.errstate(all="ignore"):
            results = by_precision[kind](*(x if x.ndim else x[()] for x in values))
        floats = all(isinstance(x, (float, int)) and not isinstance(x, np.generic) for x in given)
        if floats:
            return tuple(map(float, results))
        # constants are floats, as in the text
        return tuple(kind.type(x) if type(x) is float else x for x in results)

    return call


def _where(kind: Any) -> Callable[[Any, Any, Any], Any]:
    def in_kind(x: Any) -> Any:
        return kind.type(x) if isinstance(x, float) and not isinstance(x, np.generic) else x

    def where(test: Any, a: Any, b: Any) -> Any:
        a, b = in_kind(a), in_kind(b)
        if isinstance(test, np.ndarray):
            return np.where(test, a, b)
        return a if test else b

    return where


def _each(opaque: Any) -> Callable[..., tuple[Any, ...]]:
    """A function of floats, applied to each element of arrays."""

    def call(*args: Any) -> tuple[Any, ...]:
        if not any(isinstance(x, np.ndarray) for x in args):
            return tuple(opaque(*map(float, args)))
        arrays = np.broadcast_arrays(*args)
        rows = [tuple(opaque(*map(float, row))) for row in zip(*map(np.ravel, arrays), strict=True)]
        return tuple(np.reshape(column, arrays[0].shape) for column in zip(*rows, strict=True))

    return call


def _gather(table: Any, index: Any) -> Any:
    return table.reshape(-1)[np.asarray(index).astype(np.int64)]


#: NumPy's functions by their names in the text
SCOPE: dict[str, Any] = {
    "abs": np.abs,
    "acos": np.arccos,
    "asin": np.arcsin,
    "cosh": np.cosh,
    "double": np.float64,
    "exp": np.exp,
    "floor": np.floor,
    "gather": _gather,
    "lane": lambda k, x: np.asarray(x)[..., k],
    "larger": np.maximum,
    "log": np.log,
    "logical_not": np.logical_not,
    "nan": np.nan,
    "rint": np.rint,
    "single": np.float32,
    "sinh": np.sinh,
    "sqrt": np.sqrt,
    "tan": np.tan,
    "tanh": np.tanh,
}


def _names(inputs: list[tuple[Any, ...]]) -> list[str]:
    """A name for each input: ("q", 1) is q1."""
    found: list[str] = []
    for parts in inputs:
        name = _identifier("".join(map(str, parts)))
        if name in found or name in SCOPE:
            name = _identifier("_".join(map(str, parts)))
        while name in found or name in SCOPE or re.fullmatch(r"t\d+", name):
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
