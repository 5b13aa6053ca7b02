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
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numba import types
from numba.extending import is_jitted, typeof_impl

from fastatt._cached import cached_property
from fastatt._jit import formula_in_jitted_code
from fastatt._numba import NEW, differs
from fastatt._store import beside
from fastatt.codegen.call import ACCEPTED
from fastatt.codegen.lanes import LaneFormula, Place, Shape, lane_function
from fastatt.codegen.rows import addresses
from fastatt.tracing.called import words_of
from fastatt.tracing.graph import Recorded, flattened
from fastatt.tracing.trace import traceable
from fastatt.tracing.traced import Traced, Tuple, assembled, flattened_forms, trace


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
        self._traced: dict[Any, Traced] = {}
        self._compiled: dict[Any, Callable[..., Any]] = {}

    @cached_property
    def formula(self) -> Callable[..., Any]:
        """The function of traced numbers, made when everything that it refers to exists."""
        return traceable(self._function) if self._rewritten else self._function

    @cached_property
    def numba_type(self) -> types.Type:
        """The type for Numba, which writes the formula in place of calls."""
        try:
            return _writer()(self)
        except Exception as error:
            rest = "all but single steps in jitted code, which alone use it"
            what = f"an interface for types of functions ({words_of(error)})"
            raise differs(what, rest) from error

    def traced(self, forms: tuple[Any, ...]) -> Traced:
        """The formula for arguments of given forms."""
        if forms not in self._traced:
            self._traced[forms] = trace(self.formula, forms)
        return self._traced[forms]

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
        compiled = lane_function(Shape("double", 1, 1), formula, traced.resources)
        pointer, number = ctypes.c_void_p, ctypes.c_int64
        run = ctypes.CFUNCTYPE(None, number, pointer, pointer, number)(compiled.address)
        run.function = compiled  # type: ignore[attr-defined]  # it lives as long as its machine code
        room = ctypes.c_double * (n + count)
        places_read = addresses(traced.resources, self.tables)
        whole = (ctypes.c_int64 * len(places_read))(*places_read)
        # struct packs numbers in a third of the time of ctypes
        pack = struct.Struct(f"{n}d").pack_into
        unpack = struct.Struct(f"{count}d").unpack_from
        classes: dict[str, Any] = {"double": float, "single": np.float32, "truth": bool}

        def call(numbers: Sequence[float]) -> Any:
            memory = room()
            pack(memory, 0, *numbers)
            run(0, memory, whole, 1)
            results = iter(unpack(memory, 8 * n))
            return assembled(traced.form, lambda form: classes[form](next(results)))

        return call


scalar_function = ScalarFunction


# forms


def _form_of(x: Any, name: str) -> Any:
    if isinstance(x, np.float32):
        return "single"
    if isinstance(x, float):
        return "double"
    if isinstance(x, tuple):
        return Tuple(type(x), tuple(_form_of(part, name) for part in x))
    raise TypeError(f"{name}: found {type(x).__name__} among the arguments; {ACCEPTED}")


@typeof_impl.register(ScalarFunction)  # type: ignore[untyped-decorator]
def _typeof(value: ScalarFunction, c: Any) -> types.Type:
    return value.numba_type


@functools.cache
def _writer() -> Callable[[ScalarFunction], types.Type]:
    """The types of formulas; with releases that were not seen, one is tried."""
    from fastatt.codegen.written import numba_type

    if NEW:
        formula = ScalarFunction(lambda x, y: (x * y[0] + 1.0, y[1] - x), arrays={"y": 2})
        formula.numba_type = numba_type(formula)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Numba tells that it keeps nothing
            result, files = beside({}, functools.partial(formula_in_jitted_code, formula))
        if result != (2.0, 2.5) or files:
            raise ValueError(f"a formula in jitted code gives {result}; Numba keeps {[*files]}")
    return numba_type
