"""All that the package uses of Numba and llvmlite beyond their documentation, with the reasons.

Seen with Numba 0.61.2 and 0.68.1, llvmlite 0.44 and 0.50. What is imported or called here raises if
it is gone; ``check`` tries what would fail without a word.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import uuid
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import llvmlite
import numba
from llvmlite import ir
from llvmlite.binding import newpassmanagers as passes
from numba import types
from numba.core.caching import FunctionCache
from numba.core.ccallback import _CFuncCompiler  # type: ignore[attr-defined]
from numba.core.codegen import AOTCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin, lower_constant
from numba.core.registry import CPUDispatcher, cpu_target
from numba.core.typing.templates import signature
from numba.np.unsafe.ndarray import to_fixed_tuple

__all__ = ["CPUDispatcher", "TypingError", "to_fixed_tuple"]  # as they are

#: an option for loops that allocate nothing: without it atomic counts of references to arrays take
#: longer than cheap formulas; Numba refuses it if it is not there
LOOP = {"_nrt": False}
#: held by a thread that compiles, so that two threads do not compile the same
compiler_lock = global_compiler_lock
_BYTE = ir.IntType(8)
#: the value of a type without values, such as None
NOTHING = ir.Constant(_BYTE.as_pointer(), None)
_WIDE = '"prefer-vector-width"="512"'


# machine code on disk


def keep(dispatcher: Any, stamp: tuple[int, int]) -> None:
    """Keep what a dispatcher compiles on disk, as long as a stamp of all sources is the same.

    Numba's own stamp is that of one file. Raises ``RuntimeError`` if there is no folder.
    """
    dispatcher.enable_caching()
    dispatcher._cache._cache_file._source_stamp = stamp  # noqa: SLF001


def forget(function: Callable[..., Any]) -> None:
    """Remove a function's machine code from the disk, such as files that are damaged."""
    FunctionCache(function).flush()


def folder_of(function: Callable[..., Any]) -> Path:
    """The folder in which Numba keeps machine code of the function's file."""
    return Path(FunctionCache(function).cache_path)


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


# compilation


def target() -> tuple[str, str, str]:
    """Triple, processor and features for which Numba compiles, on which vectors depend."""
    triple, name, features = _target().target_context.codegen().magic_tuple()
    return str(triple), str(name), str(features)


# since llvmlite 0.45 its pass managers have two bases with this method, of which the first does
# nothing: each manager would stay, a megabyte for each function that is compiled
for _managers in (passes.ModulePassManager, passes.FunctionPassManager):
    _managers._dispose = getattr(passes, "NewPassManager", _managers)._dispose  # noqa: SLF001


class _Apart(JITCPUCodegen):  # type: ignore[misc]
    """Numba's code generator without its engine, which keeps whatever it is given for ever."""

    _library_class = AOTCodeLibrary

    def _add_module(self, module: Any) -> None:
        pass


@functools.cache
def _target() -> Any:
    """Numba's target with that code generator."""
    context = cpu_target.target_context.subtarget(_internal_codegen=_Apart("fastatt"))
    return SimpleNamespace(
        options=cpu_target.options,
        typing_context=cpu_target.typing_context,
        target_context=context,
    )


def linked_code(function: Callable[..., Any], sig: Any) -> tuple[str, Any]:
    """The name of a function of numbers and addresses, as ``cfunc`` makes it, and its library.

    ``emit_native_object`` of the library gives its machine code.
    """
    compiler = _CFuncCompiler(function, _target(), LOOP, {}, Compiler)
    made = compiler.compile(sig.args, sig.return_type)
    library = made.library
    library.finalize()
    return made.fndesc.llvm_cfunc_wrapper_name, library


def compiled(dispatcher: Any) -> Callable[..., Any]:
    """The only compiled function of a dispatcher, called without a check of argument types."""
    (made,) = dispatcher.overloads.values()
    return made.entry_point  # type: ignore[no-any-return]


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


def prefer_wide_vectors(function: Any) -> None:
    """Let LLVM use the widest vectors, which it halves on Intel's processors.

    llvmlite's check of attributes does not know this one.
    """
    set.add(function.attributes, _WIDE)


def array_of(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, Any]:
    """The address of an array's first number, and its strides in bytes."""
    array = context.make_array(kind)(context, builder, value)
    return array.data, array.strides


def tuple_of(context: Any, builder: Any, kind: Any, values: Any) -> Any:
    """A tuple of a type of Numba."""
    return context.make_tuple(builder, kind, values)


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


# the check


@functools.cache
def check() -> None:
    """Try what would fail without a word. Raises ``ImportError`` with the versions."""
    library = _target().target_context.codegen().create_library("checked")
    module = library.create_ir_module("checked")
    never_kept(module)
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), ()), "checked")
    prefer_wide_vectors(function)
    ir.IRBuilder(function.append_basic_block()).ret_void()
    with compiler_lock:
        library.add_ir_module(module)
        library.finalize()
    trials = {
        "what tells that code is not to be kept": library.has_dynamic_globals,
        "attributes of functions": _WIDE in str(module),
        "what adds code to the engine": "_add_module" in vars(JITCPUCodegen),
    }
    with contextlib.suppress(RuntimeError):  # Numba has no folder
        kept = FunctionCache(check.__wrapped__)
        trials["stamps of sources"] = hasattr(kept._cache_file, "_source_stamp")  # noqa: SLF001
    for what, holds in trials.items():
        if not holds:
            raise ImportError(
                f"numba: found {numba.__version__} with llvmlite {llvmlite.__version__}, where "
                f"this differs: {what}; accepted: the versions that pip installs with the package"
            )
