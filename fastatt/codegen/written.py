"""Formulas that are written in place of calls in jitted code.

For single steps in code of users alone: imported when the first of them is compiled.
"""

from __future__ import annotations

import inspect
import weakref
from collections.abc import Iterator, Sequence
from typing import Any

from llvmlite import ir
from numba import TypingError, types

from fastatt._numba import Line, first_numbers, in_tuple, never_kept, written_type
from fastatt._store import within_numba
from fastatt.codegen.call import ACCEPTED, TYPES
from fastatt.codegen.emitter import POINTERS, Emitter
from fastatt.codegen.instructions import BIT, I64, Code, alike
from fastatt.codegen.rows import addresses
from fastatt.tracing.traced import Traced, Tuple

_TYPES = {**TYPES, "truth": types.boolean}
_PRECISIONS = {ty: precision for precision, ty in TYPES.items()}


class _Shielded(Code):
    """Operations that keep their roundings where the caller's ``fastmath`` changes others."""

    def of(self, name: str, *args: Any) -> Line:
        """An operation on values of one type."""
        of = args[0].type
        result = alike(of, BIT) if " " in name else of
        names = ", ".join([x.get_reference() for x in args])
        return Line(self.b, result, f"{name} {of} {names}")

    def call(self, function: Any, args: Sequence[Any]) -> Line:
        """The result of a function that the module declares."""
        of = function.function_type.return_type
        typed = ", ".join(map(_typed, args))
        return Line(self.b, of, f"call {of} {function.get_reference()}({typed})")

    def select(self, test: Any, a: Any, b: Any) -> Line:
        """a if the test holds, else b."""
        return Line(self.b, a.type, f"select {_typed(test)}, {_typed(a)}, {_typed(b)}")


def _typed(x: Any) -> str:
    return f"{x.type} {x.get_reference()}"


def _form_of_type(ty: Any, name: str, size: int = 0) -> Any:
    if ty in _PRECISIONS:
        return _PRECISIONS[ty]
    if size and isinstance(ty, types.Array) and ty.ndim == 1 and ty.dtype in _PRECISIONS:
        return Tuple(tuple, (_PRECISIONS[ty.dtype],) * size)
    if isinstance(ty, types.BaseTuple):
        named = isinstance(ty, types.BaseNamedTuple)
        parts = tuple(_form_of_type(part, name) for part in ty.types)
        return Tuple(ty.instance_class if named else tuple, parts)
    raise TypingError(f"{name}: found {ty} among the arguments; {ACCEPTED}")


def _type_of_form(form: Any) -> Any:
    if isinstance(form, Tuple):
        named = None if form.cls is tuple else form.cls
        return types.BaseTuple.from_types([_type_of_form(part) for part in form.parts], named)
    return _TYPES[form]


# calls


def numba_type(scalar: Any) -> Any:
    """The Numba type of a formula, which is written in place of a call."""
    formula = _Formula(scalar)
    return written_type()(scalar.__name__, formula.typed, formula.written)


class _Formula:
    """A formula as its type for Numba sees it."""

    def __init__(self, scalar: Any) -> None:
        self._name = scalar.__name__
        # Numba keeps the type, with all that it refers to
        self._scalar: Any = weakref.proxy(scalar)
        #: tables and functions, whose addresses machine code has
        self._read: list[Any] = []

    def _traced(self, of: Sequence[Any]) -> tuple[tuple[Any, ...], Traced]:
        """(forms of arguments of these types, the formula for them)."""
        pairs = zip(of, self._scalar.sizes, strict=False)
        forms = tuple(_form_of_type(ty, self._name, n) for ty, n in pairs)
        before = within_numba.set(True)
        try:
            return forms, self._scalar.traced(forms)
        finally:
            within_numba.reset(before)

    def typed(self, args: Any, named: Any) -> tuple[Any, list[Any], inspect.Signature]:
        """(type of the result, types of the arguments, the signature) of a call."""
        parameters = self._scalar.parameters
        try:
            of = [types.unliteral(ty) for ty in parameters.bind(*args, **named).args]
            result = self._traced(of)[1].form
        except TypeError as error:
            raise TypingError(f"{self._name}: {error}") from error
        return _type_of_form(result), of, parameters

    def written(self, context: Any, builder: Any, of: Sequence[Any], args: Sequence[Any]) -> Any:
        """The result of a call."""
        forms, formula = self._traced(of)
        code, tables = _Shielded(builder), self._scalar.tables
        keys, pointers = formula.resources, {}
        self._read.append((keys, tables if keys else None))
        never_kept(builder.module)
        for key, address in zip(keys, addresses(keys, tables), strict=True):
            pointers[key] = builder.inttoptr(ir.Constant(I64, address), POINTERS[key[0]])
        numbers: list[Any] = []
        for form, ty, x in zip(forms, of, args, strict=True):
            if isinstance(ty, types.Array):
                numbers += first_numbers(context, builder, ty, x, len(form.parts))
            else:
                numbers += _numbers(builder, form, x)

        def number(name: tuple[Any, ...], precision: str) -> tuple[Any, bool]:
            return code.cast(precision, numbers[name[1]]), False

        results = Emitter(code, formula.lanes, pointers)(formula.flat, number)
        return _formed(context, builder, formula.form, iter(value for value, _ in results))


def _numbers(builder: Any, form: Any, value: Any) -> Iterator[Any]:
    """The numbers of an argument."""
    if isinstance(form, Tuple):
        for i, part in enumerate(form.parts):
            yield from _numbers(builder, part, builder.extract_value(value, i))
    else:
        yield value


def _formed(context: Any, builder: Any, form: Any, numbers: Iterator[Any]) -> Any:
    """Numbers, brought into a form."""
    if isinstance(form, Tuple):
        parts = [_formed(context, builder, part, numbers) for part in form.parts]
        return in_tuple(context, builder, _type_of_form(form), parts)
    x = next(numbers)
    return builder.fcmp_unordered("!=", x, ir.Constant(x.type, 0.0)) if form == "truth" else x
