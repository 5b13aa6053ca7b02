"""Rewriting of a function's source where Python itself would have to know a number.

``a if c else b`` becomes a choice, ``and``, ``or``, ``not`` and chained comparisons become
operations, and an ``if`` whose branches only assign becomes choices of the assigned values. If a
condition is known when the function is called, only those parts are evaluated that Python would
evaluate. Everything else stays: where Python asks whether a condition holds, ``tracing.trace``
follows both execution paths.
"""

from __future__ import annotations

import ast
import functools
import linecache
import types
from itertools import pairwise
from typing import Any

from fastatt.tracing.nodes import TraceError

_OPERATORS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)
_ASSIGNING = (ast.Assign, ast.AugAssign, ast.AnnAssign, ast.If, ast.Pass)
# statements that catch errors would catch those of tracing; those that change a variable elsewhere
# would do so once for each execution path
_REFUSED: dict[type[ast.AST], str] = {
    ast.Try: "try",
    ast.TryStar: "try",
    ast.With: "with",
    ast.Global: "global",
    ast.Nonlocal: "nonlocal",
    ast.Delete: "del",
    ast.Import: "import",
    ast.ImportFrom: "import",
    ast.ClassDef: "class",
    ast.Yield: "yield",
    ast.YieldFrom: "yield",
    ast.Await: "await",
    ast.AsyncFor: "async",
    ast.AsyncWith: "async",
    ast.AsyncFunctionDef: "async",
    ast.NamedExpr: ":=",
}
UNSET = "__unset"


def located(message: str, file: str, line: int) -> TraceError:
    """The error with its place and the source line."""
    text = linecache.getline(file, line).strip()
    error = TraceError(f"{message} ({file}:{line}{f': {text}' if text else ''})")
    error.where = f"{file}:{line}"
    return error


def name_of(code: types.CodeType) -> str:
    """Name under which the rewritten function is defined."""
    return "function" if code.co_name == "<lambda>" else code.co_name


@functools.lru_cache(maxsize=4096)
def rewritten(code: types.CodeType) -> types.CodeType:
    """The rewritten code of a module that defines the function of ``code``.

    Raises ``TraceError`` if its source can't be read or has a statement that is not accepted.
    """
    definition = _definition(code)
    for node in ast.walk(definition):
        if type(node) in _REFUSED:
            word = _REFUSED[type(node)]
            raise located(f"the statement {word}", code.co_filename, node.lineno)  # type: ignore[attr-defined]
    made = _Rewriting(_locals(definition)).visit(definition)
    module = ast.Module([made], [])
    return compile(ast.fix_missing_locations(module), code.co_filename, "exec")


def _definition(code: types.CodeType) -> ast.FunctionDef:
    """The function's definition without decorators, defaults and annotations."""
    linecache.checkcache(code.co_filename)
    text = "".join(linecache.getlines(code.co_filename))
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    found = [f for f in _functions(text) if _fits(f, code, names)]
    if len(found) != 1:
        raise TraceError(f"{code.co_name}: its source can't be read")
    # the parsed tree is cached, so that a copy is rewritten
    body = _copied(found[0].body)
    a = found[0].args
    arguments = ast.arguments(
        posonlyargs=[ast.arg(x.arg) for x in a.posonlyargs],
        args=[ast.arg(x.arg) for x in a.args],
        vararg=ast.arg(a.vararg.arg) if a.vararg else None,
        kwonlyargs=[ast.arg(x.arg) for x in a.kwonlyargs],
        kw_defaults=[None] * len(a.kwonlyargs),
        kwarg=ast.arg(a.kwarg.arg) if a.kwarg else None,
        defaults=[],
    )
    if isinstance(found[0], ast.Lambda):
        body = [ast.copy_location(ast.Return(body), found[0].body)]
    fields = {"args": arguments, "body": body, "decorator_list": [], "type_params": []}
    made = ast.FunctionDef(name=name_of(code), **fields)
    return ast.copy_location(made, found[0])


def _copied(node: Any) -> Any:
    if isinstance(node, list):
        return [_copied(x) for x in node]
    if not isinstance(node, ast.AST):
        return node
    made = type(node)(**{name: _copied(value) for name, value in ast.iter_fields(node)})
    return ast.copy_location(made, node)


@functools.lru_cache(maxsize=64)
def _functions(text: str) -> list[ast.FunctionDef | ast.Lambda]:
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return []
    return [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.Lambda))]


def _fits(node: ast.FunctionDef | ast.Lambda, code: types.CodeType, names: tuple[str, ...]) -> bool:
    """Whether a definition is that of the code, by its place, its name and its arguments."""
    a = node.args
    if tuple(x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs)) != names:
        return False
    if isinstance(node, ast.FunctionDef):
        first = min([node.lineno, *(d.lineno for d in node.decorator_list)])
        return node.name == code.co_name and first == code.co_firstlineno
    if code.co_name != "<lambda>" or node.lineno != code.co_firstlineno:
        return False
    body = node.body
    start, end = (body.lineno, body.col_offset), (body.end_lineno, body.end_col_offset)
    places = [p for p in code.co_positions() if p[0] is not None and p[3]]
    # among lambdas on one line, the one whose expression contains all names of the code
    return all(
        start <= (line, column) and (last_line, last) <= end
        for line, last_line, column, last in places
    )


def _locals(definition: ast.FunctionDef) -> set[str]:
    """Names of variables, except those of the precision of a number."""
    names: set[str] = set()
    precisions: set[str] = set()
    for node in ast.walk(definition):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.arg):
            names.add(node.arg)
        elif isinstance(node, ast.FunctionDef) and node is not definition:
            names.add(node.name)
        if isinstance(node, ast.Assign) and _is_type(node.value):
            precisions |= {t.id for t in node.targets if isinstance(t, ast.Name)}
    return names - precisions


def _is_type(e: ast.expr) -> bool:
    return isinstance(e, ast.Call) and isinstance(e.func, ast.Name) and e.func.id == "type"


class _Rewriting(ast.NodeTransformer):
    """``local`` are the function's variables; calling one may have side effects."""

    def __init__(self, local: set[str]) -> None:
        self._local = local
        self._assigned: list[set[str]] = []

    def visit_FunctionDef(self, e: ast.FunctionDef) -> Any:
        self._assigned.append(set())
        self.generic_visit(e)
        a = e.args
        given = {x.arg for x in (*a.posonlyargs, *a.args, *a.kwonlyargs, a.vararg, a.kwarg) if x}
        for x in ast.walk(a):
            if isinstance(x, ast.arg):
                x.annotation = None
        e.returns = None
        missing = sorted(self._assigned.pop() - given)
        if missing:
            targets: list[ast.expr] = [ast.Name(name, ast.Store()) for name in missing]
            e.body.insert(0, _at(ast.Assign(targets, ast.Name(UNSET, ast.Load())), e))
        return e

    def visit_IfExp(self, e: ast.IfExp) -> Any:
        pure = self._is_pure(e)
        self.generic_visit(e)
        return _call(e, "__choose", e.test, _later(e.body), _later(e.orelse)) if pure else e

    def visit_BoolOp(self, e: ast.BoolOp) -> Any:
        pure = self._is_pure(e)
        self.generic_visit(e)
        return _joined(e, "__and" if isinstance(e.op, ast.And) else "__or", e.values) if pure else e

    def visit_UnaryOp(self, e: ast.UnaryOp) -> Any:
        self.generic_visit(e)
        return _call(e, "__not", e.operand) if isinstance(e.op, ast.Not) else e

    def visit_Compare(self, e: ast.Compare) -> Any:
        fits = self._is_pure(e) and all(isinstance(op, _OPERATORS) for op in e.ops)
        self.generic_visit(e)
        if len(e.ops) == 1 or not fits:
            return e
        sides = pairwise([e.left, *e.comparators])
        pairs = [_at(ast.Compare(x, [op], [y]), e) for op, (x, y) in zip(e.ops, sides, strict=True)]
        return _joined(e, "__and", pairs)

    def visit_If(self, e: ast.If) -> Any:
        names = self._only_assigned(e)
        self.generic_visit(e)
        if not names:
            return e
        self._assigned[-1] |= set(names)
        loads: list[ast.expr] = [ast.Name(name, ast.Load()) for name in names]
        stores: list[ast.expr] = [ast.Name(name, ast.Store()) for name in names]

        def branch(name: str, statements: list[ast.stmt]) -> Any:
            """A function from the names' values before a branch to those after it."""
            body = [*map(_as_assignment, statements), ast.Return(ast.Tuple(loads, ast.Load()))]
            arguments = ast.arguments([], [*map(ast.arg, names)], None, [], [], None, [])
            fields: dict[str, Any] = {"args": arguments, "body": body}
            fields |= {"decorator_list": [], "type_params": []}
            return _at(ast.FunctionDef(name=name, **fields), e)

        yes, no = (_later(_call(e, name, *loads)) for name in ("__yes", "__no"))
        merged = _call(e, "__branch", e.test, yes, no)
        after = _at(ast.Assign([ast.Tuple(stores, ast.Store())], merged), e)
        return [branch("__yes", e.body), branch("__no", e.orelse), after]

    def _is_pure(self, e: ast.AST) -> bool:
        """Whether code can be evaluated where Python would not: its calls have no side effects."""
        for node in ast.walk(e):
            if isinstance(node, ast.Call):
                root = node.func
                while isinstance(root, (ast.Attribute, ast.Subscript)):
                    root = root.value
                known = isinstance(root, ast.Name) and root.id not in self._local
                if not known and not _is_type(root):
                    return False
        return True

    def _only_assigned(self, e: ast.If) -> list[str]:
        """The names that an ``if`` assigns; none if its branches do more than that."""
        parts = [*e.body, *e.orelse]
        nodes = [x for part in parts for x in ast.walk(part)]
        stored = [x for x in nodes if isinstance(getattr(x, "ctx", None), ast.Store)]
        fits = (
            all(isinstance(x, _ASSIGNING) for x in nodes if isinstance(x, ast.stmt))
            and all(isinstance(x, (ast.Name, ast.Tuple, ast.List)) for x in stored)
            and all(map(self._is_pure, parts))
        )
        names = dict.fromkeys(x.id for x in stored if isinstance(x, ast.Name))
        return list(names) if fits else []


def _as_assignment(e: ast.stmt) -> ast.stmt:
    """``x += y`` as ``x = x + y``, since a list would be changed for both branches."""
    if not isinstance(e, ast.AugAssign) or not isinstance(e.target, ast.Name):
        return e
    name = e.target.id
    value = ast.BinOp(ast.Name(name, ast.Load()), e.op, e.value)
    return _at(ast.Assign([ast.Name(name, ast.Store())], value), e)  # type: ignore[no-any-return]


def _at(made: Any, where: ast.AST) -> Any:
    """A new node, and its new parts, at the place of an old one."""
    made = ast.copy_location(made, where)
    return ast.fix_missing_locations(made)


def _later(e: ast.expr) -> ast.expr:
    none = ast.arguments([], [], None, [], [], None, [])
    return _at(ast.Lambda(none, e), e)  # type: ignore[no-any-return]


def _joined(where: ast.AST, name: str, parts: list[ast.expr]) -> ast.expr:
    """``name(a, lambda: name(b, lambda: c))``, which evaluates only what is needed."""
    *others, last = parts
    for part in reversed(others):
        last = _call(where, name, part, _later(last))
    return last


def _call(where: ast.AST, name: str, *args: ast.expr) -> ast.expr:
    return _at(ast.Call(ast.Name(name, ast.Load()), list(args), []), where)  # type: ignore[no-any-return]
