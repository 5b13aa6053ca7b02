"""Formulas as functions of numbers, for jitted code and for Python.

A formula is traced when it is first called with arguments of some types, and its graph is written
in place of the call, so that Numba has nothing to type and nothing to inline. Derivatives of dual
numbers are in the lanes of a vector, one for each direction.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import struct
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import TypingError, types
from numba.extending import NativeValue, is_jitted, models, register_model, typeof_impl, unbox

from fastatt._cached import cached_property
from fastatt._numba import (
    NOTHING,
    FormulaType,
    array_of,
    check,
    never_kept,
    tuple_of,
)
from fastatt._store import within_numba
from fastatt.codegen.call import TYPES
from fastatt.codegen.emitter import POINTERS, Emitter
from fastatt.codegen.instructions import I64, Code
from fastatt.codegen.lanes import LaneFormula, Place, Shape, lane_function
from fastatt.codegen.rows import addresses
from fastatt.tracing.graph import Recorded, flattened
from fastatt.tracing.trace import traceable
from fastatt.tracing.traced import Traced, Tuple, flattened_forms, trace

_TYPES = {**TYPES, "truth": types.boolean}
_PRECISIONS = {ty: precision for precision, ty in TYPES.items()}


class ScalarFunction:
    """A formula as a function for jitted code, and for Python.

    ``function`` is a kernel or a plain function of traced numbers, which is called as it is; with
    ``rewritten`` a function that is written like kernels are (``tracing.trace``). It takes floats
    and tuples of them, nested and named ones too, and returns such; results are of single precision
    if all arguments are. Globals of the formula are read when it is first called with arguments of
    some types. ``tables`` are the arrays that it reads; ``arrays`` names the arguments that may
    also be arrays of one axis in jitted code, in place of tuples, with the number of elements that
    are read.

    Code that calls it contains the formula at that time. Numba keeps no such code on disk, since it
    would not notice that the formula has become another one, and warns of ``@njit(cache=True)``.

    To choose between two of them by an ``if``, write a function that calls both.
    """

    __name__: str

    def __init__(
        self,
        function: Callable[..., Any],
        tables: Mapping[int, Any] | None = None,
        *,
        arrays: Mapping[str, int] | None = None,
        rewritten: bool = False,
    ) -> None:
        functools.update_wrapper(self, function)
        self._function = function
        self._rewritten = rewritten or is_jitted(function)
        self.tables = {
            k: np.ascontiguousarray(x, dtype=np.float64) for k, x in (tables or {}).items()
        }
        self.parameters = inspect.signature(function)
        sizes = dict(arrays or {})
        self.sizes = [sizes.get(name, 0) for name in self.parameters.parameters]
        self.numba_type = _numba_type(self)
        self._traced: dict[Any, Traced] = {}
        self._compiled: dict[Any, Callable[..., Any]] = {}

    @cached_property
    def formula(self) -> Callable[..., Any]:
        """The function of traced numbers, made when everything that it refers to exists."""
        return traceable(self._function) if self._rewritten else self._function

    def traced(self, forms: tuple[Any, ...]) -> Traced:
        """The formula for arguments of given forms."""
        found = self._traced.get(forms)
        if found is None:
            found = self._traced[forms] = trace(self.formula, forms)
        return found

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Traced numbers for traced numbers; otherwise floats, for float32 those of NumPy."""
        if named:
            args = self.parameters.bind(*args, **named).args
        numbers = flattened(args)
        if any(isinstance(x, Recorded) for x in numbers):
            return self.formula(*args)
        forms = tuple(_form_of(x, self.__name__) for x in args)
        if forms not in self._compiled:
            self._compiled[forms] = self._in_memory(forms)
        return self._compiled[forms](numbers)

    def _in_memory(self, forms: tuple[Any, ...]) -> Callable[[Sequence[float]], Any]:
        """The formula compiled, as a function of its arguments' numbers."""
        traced = self.traced(forms)
        n, count = len(list(flattened_forms(forms))), len(traced.flat.results)
        places = [Place(k) for k in range(n + count)]
        inputs = {("x", k): place for k, place in enumerate(places[:n])}
        formula = LaneFormula(traced.flat, inputs, places[n:], directions=traced.lanes)
        made = lane_function(Shape("double", 1, 1), formula, traced.resources)
        pointer, number = ctypes.c_void_p, ctypes.c_int64
        run = ctypes.CFUNCTYPE(None, number, pointer, pointer, number)(made.address)
        run.function = made  # type: ignore[attr-defined]  # it lives as long as its machine code
        room = ctypes.c_double * (n + count)
        at = addresses(traced.resources, self.tables)
        whole = (ctypes.c_int64 * len(at))(*at)
        # struct packs numbers in a third of the time of ctypes
        pack = struct.Struct(f"{n}d").pack_into
        unpack = struct.Struct(f"{count}d").unpack_from

        def call(numbers: Sequence[float]) -> Any:
            memory = room()
            pack(memory, 0, *numbers)
            run(0, memory, whole, 1)
            return _assembled(traced.form, iter(unpack(memory, 8 * n)))

        return call


scalar_function = ScalarFunction


def _assembled(form: Any, numbers: Iterator[float]) -> Any:
    """Numbers, brought into a form for Python."""
    if isinstance(form, Tuple):
        parts = [_assembled(part, numbers) for part in form.parts]
        return tuple(parts) if form.cls is tuple else form.cls(*parts)
    x = next(numbers)
    return bool(x) if form == "truth" else np.float32(x) if form == "single" else x


# forms


def _form_of(x: Any, name: str) -> Any:
    if isinstance(x, np.float32):
        return "single"
    if isinstance(x, float):
        return "double"
    if isinstance(x, tuple):
        return Tuple(type(x), tuple(_form_of(part, name) for part in x))
    raise TypeError(f"{name}: found {type(x).__name__} among the arguments; {_ACCEPTED}")


_ACCEPTED = "accepted are float64 or float32 and tuples of them: write 1.0 instead of 1"


def _form_of_type(ty: Any, name: str, size: int = 0) -> Any:
    if ty in _PRECISIONS:
        return _PRECISIONS[ty]
    if size and isinstance(ty, types.Array) and ty.ndim == 1 and ty.dtype in _PRECISIONS:
        return Tuple(tuple, (_PRECISIONS[ty.dtype],) * size)
    if isinstance(ty, types.BaseTuple):
        named = isinstance(ty, types.BaseNamedTuple)
        parts = tuple(_form_of_type(part, name) for part in ty.types)
        return Tuple(ty.instance_class if named else tuple, parts)
    raise TypingError(f"{name}: found {ty} among the arguments; {_ACCEPTED}")


def _type_of_form(form: Any) -> Any:
    if isinstance(form, Tuple):
        named = None if form.cls is tuple else form.cls
        return types.BaseTuple.from_types([_type_of_form(part) for part in form.parts], named)
    return _TYPES[form]


# Numba's side


def _numba_type(scalar: ScalarFunction) -> FormulaType:
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
        code = Code(builder)
        keys, pointers = formula.resources, {}
        read.append((keys, held.tables if keys else None))
        check()
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
    first, strides = array_of(context, builder, ty, value)
    step = builder.extract_value(strides, 0)
    begin = builder.ptrtoint(first, step.type)
    for i in range(len(form.parts)):
        at = builder.add(begin, builder.mul(step, ir.Constant(step.type, i)))
        yield builder.load(builder.inttoptr(at, first.type))


def _made(context: Any, builder: Any, form: Any, numbers: Iterator[Any]) -> Any:
    """Numbers, brought into a form."""
    if isinstance(form, Tuple):
        parts = [_made(context, builder, part, numbers) for part in form.parts]
        return tuple_of(context, builder, _type_of_form(form), parts)
    x = next(numbers)
    return builder.fcmp_unordered("!=", x, ir.Constant(x.type, 0.0)) if form == "truth" else x


register_model(FormulaType)(models.OpaqueModel)


@typeof_impl.register(ScalarFunction)  # type: ignore[untyped-decorator]
def _typeof(value: ScalarFunction, c: Any) -> FormulaType:
    return value.numba_type


@unbox(FormulaType)  # type: ignore[untyped-decorator]
def _unboxed(ty: Any, value: Any, c: Any) -> NativeValue:
    return NativeValue(NOTHING)
