"""Formulas that are written in place of calls in jitted code.

For single steps in code of users alone: imported when the first of them is compiled, since Numba
and llvmlite do not document most of what it uses.
"""

from __future__ import annotations

import inspect
import itertools
import uuid
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from llvmlite import ir
from numba import TypingError, types
from numba.core.imputils import lower_constant
from numba.core.typing.templates import signature
from numba.extending import NativeValue, lower_builtin, models, register_model, unbox

from fastatt._numba import NOTHING
from fastatt._store import within_numba
from fastatt.codegen.call import ACCEPTED, TYPES
from fastatt.codegen.emitter import POINTERS, Emitter
from fastatt.codegen.instructions import BIT, I64, Code, alike
from fastatt.codegen.rows import addresses
from fastatt.tracing.traced import Traced, Tuple

_TYPES = {**TYPES, "truth": types.boolean}
_PRECISIONS = {ty: precision for precision, ty in TYPES.items()}
_BYTE = ir.IntType(8)


def never_kept(module: Any) -> None:
    """Tell Numba that the code of this module, and code linked with it, is for this process only.

    Numba keeps nothing on disk that has a variable of such a name. LLVM does not remove variables
    that ``llvm.compiler.used`` lists.
    """
    name = "numba.dynamic.globals.formula"
    if name not in module.globals:
        held = ir.GlobalVariable(module, _BYTE, name)
        held.linkage, held.initializer = "internal", ir.Constant(_BYTE, 0)
        pointers = ir.ArrayType(_BYTE.as_pointer(), 1)
        used = ir.GlobalVariable(module, pointers, "llvm.compiler.used")
        used.linkage, used.section = "appending", "llvm.metadata"
        used.initializer = ir.Constant(pointers, [held])


# instructions


class Line:
    """An instruction as text, formatted once and not with a format for each of its parts."""

    __slots__ = ("_name", "_text", "type")
    opname, metadata = "", ("dbg",)
    _numbers = itertools.count()

    def __init__(self, builder: Any, kind: Any, text: str) -> None:
        self.type, self._name = kind, f"%-{next(self._numbers)}"
        self._text = f"{self._name} = {text}"
        builder._insert(self)  # noqa: SLF001

    def get_reference(self) -> str:
        """Name of the result."""
        return self._name

    def __str__(self) -> str:
        return self._text


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
        given = ", ".join(map(_typed, args))
        return Line(self.b, of, f"call {of} {function.get_reference()}({given})")

    def select(self, test: Any, a: Any, b: Any) -> Line:
        """a if the test holds, else b."""
        return Line(self.b, a.type, f"select {_typed(test)}, {_typed(a)}, {_typed(b)}")


def _typed(x: Any) -> str:
    return f"{x.type} {x.get_reference()}"


# a function that writes itself where it is called


class FormulaType(types.Callable, types.Opaque):  # type: ignore[misc]
    """The type of a function that is written in place of each call, one type for each function.

    ``typed(arguments, keywords)`` returns (result type, argument types, the ``inspect.Signature``);
    ``write(context, builder, argument types, arguments)`` writes a call. ``overload`` could call a
    function of this module only, and compiles one more function for each.
    """

    def __init__(self, name: str, typed: Callable[..., Any], write: Callable[..., Any]) -> None:
        self._typed, self._write = typed, write
        super().__init__(name=f"{name}:{uuid.uuid4().hex}")
        lower_builtin(self, types.VarArg(types.Any))(self._lower)

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Signature of a call."""
        result, arguments, parameters = self._typed(args, kws)
        return signature(result, *arguments).replace(pysig=parameters)

    def get_call_signatures(self) -> Any:
        """No signatures are known beforehand."""
        return (), False

    def get_impl_key(self, sig: Any) -> FormulaType:
        """The key under which the lowering is registered."""
        return self

    def _lower(self, context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return self._write(context, builder, sig.args, args)


@lower_constant(FormulaType)  # type: ignore[untyped-decorator]
def _constant(context: Any, builder: Any, ty: Any, value: Any) -> Any:
    return NOTHING


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


def numba_type(scalar: Any) -> FormulaType:
    """The Numba type of a formula, which is written in place of a call."""
    name = scalar.__name__
    # Numba keeps the type, with all that it refers to
    held: Any = weakref.proxy(scalar)
    read: list[Any] = []  # tables and functions, whose addresses machine code has

    def forms_of(given: Sequence[Any]) -> tuple[Any, ...]:
        pairs = zip(given, held.sizes, strict=False)
        return tuple(_form_of_type(ty, name, n) for ty, n in pairs)

    def traced(forms: tuple[Any, ...]) -> Traced:
        before = within_numba.set(True)
        try:
            return held.traced(forms)  # type: ignore[no-any-return]
        finally:
            within_numba.reset(before)

    def typed(args: Any, named: Any) -> tuple[Any, list[Any], inspect.Signature]:
        try:
            bound = held.parameters.bind(*args, **named).args
            given = [types.unliteral(ty) for ty in bound]
            result = traced(forms_of(given)).form
        except TypeError as error:
            raise TypingError(f"{name}: {error}") from error
        return _type_of_form(result), given, held.parameters

    def written(context: Any, builder: Any, given: Sequence[Any], args: Sequence[Any]) -> Any:
        forms = forms_of(given)
        formula = traced(forms)
        code = _Shielded(builder)
        keys, pointers = formula.resources, {}
        read.append((keys, held.tables if keys else None))
        never_kept(builder.module)
        for key, at in zip(keys, addresses(keys, held.tables), strict=True):
            pointers[key] = builder.inttoptr(ir.Constant(I64, at), POINTERS[key[0]])
        numbers: list[Any] = []
        for form, ty, x in zip(forms, given, args, strict=True):
            of_array = isinstance(ty, types.Array)
            numbers += (
                _read(context, builder, ty, x, form) if of_array else _taken(builder, form, x)
            )

        def number(name: tuple[Any, ...], precision: str) -> tuple[Any, bool]:
            return code.cast(precision, numbers[name[1]]), False

        results = Emitter(code, formula.lanes, pointers)(formula.flat, number)
        return _made(context, builder, formula.form, iter(value for value, _ in results))

    return FormulaType(name, typed, written)


def _taken(builder: Any, form: Any, value: Any) -> Iterator[Any]:
    """The numbers of an argument."""
    if isinstance(form, Tuple):
        for i, part in enumerate(form.parts):
            yield from _taken(builder, part, builder.extract_value(value, i))
    else:
        yield value


def _read(context: Any, builder: Any, ty: Any, value: Any, form: Any) -> Iterator[Any]:
    """The numbers of an array, as many as its form has."""
    array = context.make_array(ty)(context, builder, value)
    step = builder.extract_value(array.strides, 0)
    begin = builder.ptrtoint(array.data, step.type)
    for i in range(len(form.parts)):
        at = builder.add(begin, builder.mul(step, ir.Constant(step.type, i)))
        yield builder.load(builder.inttoptr(at, array.data.type))


def _made(context: Any, builder: Any, form: Any, numbers: Iterator[Any]) -> Any:
    """Numbers, brought into a form."""
    if isinstance(form, Tuple):
        parts = [_made(context, builder, part, numbers) for part in form.parts]
        return context.make_tuple(builder, _type_of_form(form), parts)
    x = next(numbers)
    return builder.fcmp_unordered("!=", x, ir.Constant(x.type, 0.0)) if form == "truth" else x


register_model(FormulaType)(models.OpaqueModel)


@unbox(FormulaType)  # type: ignore[untyped-decorator]
def _unboxed(ty: Any, value: Any, c: Any) -> NativeValue:
    return NativeValue(NOTHING)
