"""Choices in a function's source, rewritten where Python itself would have to know a number.

In kernels ``a if c else b`` becomes a choice. In functions of users it becomes one if both values
are arithmetic, and an ``if`` that only assigns such a value does too: one execution path in place
of two. Source is used only if it compiles to the function's own bytecode.
"""

from __future__ import annotations

import ast
import functools
import linecache
import types
from typing import Any

from fastatt.tracing.frozen import codes_of

_SYMBOLS = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
_CHANGES = {ast.Add: "iadd", ast.Sub: "isub", ast.Mult: "imul", ast.Div: "itruediv"}
#: what can be evaluated where Python would not
_PURE = (
    ast.Name, ast.Constant, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop, ast.expr_context,
    ast.Attribute, ast.Subscript, ast.Slice, ast.Tuple, ast.List, ast.Lambda, ast.arguments,
    ast.arg,
)  # fmt: skip
#: functions of libraries that take the elements of an iterator
_TAKING = {"fsum", "prod", "sumprod", "dist", "fromiter"}
#: the argument of functions that are added, which tells them from those of the file
_OURS = "__later__"


def rewritten(code: types.CodeType, known: frozenset[str] | None = None) -> types.CodeType | None:
    """The code of the rewritten function; None if there is no source.

    ``known`` are the names of modules and functions of libraries in a function of users, None for a
    kernel.
    """
    text, place = "".join(linecache.getlines(code.co_filename)), _place(code)
    try:
        before = _codes(text, code.co_filename, changes=False, known=None)
        after = _codes(text, code.co_filename, changes=True, known=known)
    except (SyntaxError, ValueError):
        return None
    return after[place] if before.get(place) == code else None


@functools.lru_cache(maxsize=256)
def _codes(
    text: str, file: str, *, changes: bool, known: frozenset[str] | None
) -> dict[Any, types.CodeType]:
    """The code of a file's functions, rewritten or not, by what tells them from each other."""
    tree = ast.parse(text)
    if changes:
        tree = (_InKernels() if known is None else _InFunctions(known, tree)).visit(tree)
    return {_place(code): code for code in codes_of(compile(tree, file, "exec", dont_inherit=True))}


def _place(code: types.CodeType) -> Any:
    n = code.co_argcount + code.co_kwonlyargcount
    return code.co_name, code.co_firstlineno, code.co_varnames[:n], code.co_freevars


class _InKernels(ast.NodeTransformer):
    """``a if c else b`` as ``__choose__(c, lambda: a, lambda: b)``."""

    def visit_IfExp(self, e: ast.IfExp) -> Any:
        self.generic_visit(e)
        return _at(_call("__choose__", e.test, _later(e.body), _later(e.orelse)), e)


class _InFunctions(ast.NodeTransformer):
    """Choices between two values as ``__choose__``, and changes of a value as ``__changed__``."""

    def __init__(self, known: frozenset[str], tree: ast.Module) -> None:
        nodes = [*ast.walk(tree)]
        stored = {x.id for x in nodes if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Store)}
        self._known = known - stored - {x.arg for x in nodes if isinstance(x, ast.arg)}

    def visit_IfExp(self, e: ast.IfExp) -> Any:
        self.generic_visit(e)
        if not self._fits(e.test, e.body, e.orelse):
            return e
        return _at(_choice("__choose__", e.test, _later(e.body), _later(e.orelse)), e)

    def visit_If(self, e: ast.If) -> Any:
        self.generic_visit(e)
        match e:
            case ast.If(_, [ast.Assign([target], a)], [ast.Assign([other], b)]):
                if ast.dump(target) != ast.dump(other):
                    return e
            case ast.If(_, [ast.Assign([ast.Name() | ast.Subscript() as target], a)], []):
                b = _read(target)
            case ast.If(_, [ast.AugAssign(target, op, a)], []) if type(op) in _CHANGES:
                old, name = _read(target), ast.Constant(_CHANGES[type(op)])
                if not self._fits(e.test, old, a):
                    return e
                changed = _choice("__changed__", e.test, name, old, _later(a))
                return _at(ast.Assign([target], changed), e)
            case _:
                return e
        chosen = self.visit_IfExp(ast.IfExp(e.test, a, b))
        return e if isinstance(chosen, ast.IfExp) else _at(ast.Assign([target], chosen), e)

    def _fits(self, test: ast.expr, *values: ast.expr) -> bool:
        """Whether a test is one comparison, and values can be evaluated on both of its sides."""
        return (
            isinstance(test, ast.Compare) and len(test.ops) == 1 and type(test.ops[0]) in _SYMBOLS
            and all(self._is_pure(x) for value in values for x in ast.walk(value))
        )  # fmt: skip

    def _is_pure(self, x: ast.AST) -> bool:
        if not isinstance(x, ast.Call):
            return isinstance(x, _PURE)
        of: Any = x.func
        while isinstance(of, ast.Attribute):
            of = of.value
        name = getattr(x.func, "attr", getattr(of, "id", ""))
        is_known = isinstance(of, ast.Name) and of.id in {*self._known, "__choose__", "__changed__"}
        of_numbers = name not in _TAKING and (name not in ("min", "max") or len(x.args) > 1)
        return is_known and of_numbers and not x.keywords


def _choice(name: str, test: Any, *more: ast.expr) -> ast.expr:
    op = ast.Constant(_SYMBOLS[type(test.ops[0])])
    return _call(name, op, test.left, test.comparators[0], *more)


def _read(target: ast.expr) -> ast.expr:
    """What is assigned to, as a value."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _at(node: Any, where: ast.AST) -> Any:
    """A new node, and its new parts, at the place of an old one."""
    return ast.fix_missing_locations(ast.copy_location(node, where))


def _later(e: ast.expr) -> ast.expr:
    argument = ast.arguments([], [ast.arg(_OURS)], None, [], [], None, [ast.Constant(None)])
    return ast.Lambda(argument, e)


def _call(name: str, *args: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, ast.Load()), list(args), [])
