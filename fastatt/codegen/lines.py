"""The lines of Python around a program's formulas, written in LLVM's language.

They are loops over whole numbers, conditions, and calls of formulas. Numba would compile the same
lines, but its type inference and its passes over them take as long as a formula of moderate size.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils

from fastatt.codegen.instructions import BIT, I64, Code

_NUMBERS = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.And: "and_", ast.Or: "or_"}
_TESTS = {ast.Eq: "==", ast.NotEq: "!=", ast.Gt: ">", ast.Lt: "<"}


def write_lines(
    code: Code, text: str, args: Sequence[Any], calls: Mapping[str, Callable[[list[Any]], None]]
) -> None:
    """Write the body of the one function that a text defines, for values of its arguments.

    ``calls`` write what it calls by name.
    """
    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    names = [x.arg for x in function.args.args]
    _Lines(code, dict(zip(names, args, strict=True)), calls).block(function.body)


class _Lines:
    """Writes lines; ``values`` are those of names, ``places`` where assigned names are kept."""

    def __init__(
        self, code: Code, values: dict[str, Any], calls: Mapping[str, Callable[[list[Any]], None]]
    ) -> None:
        self.code, self.values, self.calls = code, values, calls
        self.places: dict[str, Any] = {}

    def block(self, lines: Sequence[ast.stmt]) -> None:
        for line in lines:
            self._line(line)

    def _line(self, line: ast.stmt) -> None:
        b = self.code.b
        match line:
            case ast.Expr(ast.Call(ast.Name(name), args)):
                self.calls[name]([self._value(x) for x in args])
            case ast.Assign([ast.Name(name)], value):
                self._assign(name, self._value(value))
            case ast.Assign([ast.Tuple(names)], ast.Tuple(values)):
                found = [self._value(x) for x in values]
                for x, value in zip(names, found, strict=True):
                    assert isinstance(x, ast.Name)
                    self._assign(x.id, value)
            case ast.If(test, then, []):
                with b.if_then(self._value(test)):
                    self.block(then)
            case ast.If(test, then, otherwise):
                with b.if_else(self._value(test)) as (yes, no):
                    with yes:
                        self.block(then)
                    with no:
                        self.block(otherwise)
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds), body):
                self._for(name, [self._value(x) for x in bounds], body)
            case ast.While(test, body):
                self._while(test, body)
            case _:
                raise NotImplementedError(ast.unparse(line))

    def _assign(self, name: str, value: Any) -> None:
        if name not in self.places:
            self.places[name] = self.code.room(value.type)
        self.code.b.store(value, self.places[name])

    def _for(self, name: str, bounds: list[Any], body: Sequence[ast.stmt]) -> None:
        first, last, step = [*([ir.Constant(I64, 0)] if len(bounds) == 1 else []), *bounds,
                             ir.Constant(I64, 1)][:3]  # fmt: skip
        with cgutils.for_range_slice(self.code.b, first, last, step) as (i, _):
            self.values[name] = i
            self.block(body)

    def _while(self, test: ast.expr, body: Sequence[ast.stmt]) -> None:
        b = self.code.b
        begin, again, end = (b.append_basic_block(x) for x in ("while", "body", "end"))
        b.branch(begin)
        b.position_at_end(begin)
        b.cbranch(self._value(test), again, end)
        b.position_at_end(again)
        self.block(body)
        b.branch(begin)
        b.position_at_end(end)

    def _value(self, x: ast.expr) -> Any:
        b = self.code.b
        match x:
            case ast.Constant(bool(value)):
                return ir.Constant(BIT, value)
            case ast.Constant(int(value)):
                return ir.Constant(I64, value)
            case ast.Name(name):
                return b.load(self.places[name]) if name in self.places else self.values[name]
            case ast.BinOp(left, op, right) | ast.BoolOp(op, [left, right]):
                return getattr(b, _NUMBERS[type(op)])(self._value(left), self._value(right))
            case ast.BoolOp(op, [left, *rest]):
                others = ast.BoolOp(op, rest)
                return getattr(b, _NUMBERS[type(op)])(self._value(left), self._value(others))
            case ast.Compare(left, [op], [ast.Constant(float(value))]):
                number = self._value(left)
                return b.fcmp_ordered(_TESTS[type(op)], number, ir.Constant(number.type, value))
            case ast.Compare(left, [op], [right]):
                one, other = self._value(left), self._value(right)
                compare = b.icmp_signed if one.type == I64 else b.fcmp_ordered
                return compare(_TESTS[type(op)], one, other)
            case ast.Subscript(array, index):
                return self.code.load(self._value(array), self._value(index))
            case _:
                raise NotImplementedError(ast.unparse(x))
