"""All that the package uses of Numba and llvmlite beyond their documentation, with the reasons.

Seen with Numba 0.61.2 and 0.68.1, llvmlite 0.44 and 0.50. What is imported or called here raises if
it is gone; ``check`` tries what would fail without a word.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import llvmlite
import numba
from llvmlite import binding, ir
from llvmlite.binding import newpassmanagers as passes
from numba import config, njit, typeof, types
from numba.core import ir as numba_ir
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.imputils import lower_builtin, lower_constant
from numba.core.ir_utils import mk_unique_var
from numba.core.typed_passes import PreLowerStripPhis
from numba.core.typing.templates import signature
from numba.np.unsafe.ndarray import to_fixed_tuple

__all__ = ["to_fixed_tuple"]  # as it is

#: an option for loops that allocate nothing: without it atomic counts of references to arrays take
#: longer than cheap formulas; Numba refuses it if it is not there
LOOP = {"_nrt": False}
#: the newest release of Numba that was seen
_SEEN = 0, 68
_BYTE = ir.IntType(8)
#: the value of a type without values, such as None
NOTHING = ir.Constant(_BYTE.as_pointer(), None)
_WIDE = '"prefer-vector-width"="512"'


# machine code on disk


def moved(function: Any, file: str) -> Any:
    """A function as if its source were another file, beside which Numba keeps machine code."""
    code = function.__code__.replace(co_filename=file)
    name, values = function.__name__, function.__defaults__
    return FunctionType(code, function.__globals__, name, values, function.__closure__)


def folder_of(file: str) -> Path:
    """The folder in which Numba keeps machine code of a source file.

    Raises ``RuntimeError`` if there is none.
    """
    return Path(njit(cache=True)(moved(folder_of, file)).stats.cache_path)


def keep(dispatcher: Any, stamp: str) -> None:
    """Keep what a dispatcher compiles on disk, in files of its own for each stamp of all sources.

    Numba's own stamp is that of one file. Without a writable folder nothing is kept.
    """
    function = dispatcher.py_func
    name = function.__qualname__
    function.__qualname__ = f"{name}-{stamp}"  # by which Numba names its files
    with contextlib.suppress(RuntimeError):
        dispatcher.enable_caching()
    function.__qualname__ = name


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
    found, features = binding.get_host_cpu_features(), config.CPU_FEATURES
    if not config.ENABLE_AVX:
        found.update({name: False for name in found if name.startswith("avx")})
    name = config.CPU_NAME or binding.get_host_cpu_name()
    return binding.get_process_triple(), name, found.flatten() if features is None else features


# since llvmlite 0.45 its pass managers have two bases with this method, of which the first does
# nothing: each manager would stay, a megabyte for each function that is compiled
for _managers in (passes.ModulePassManager, passes.FunctionPassManager):
    _managers._dispose = getattr(passes, "NewPassManager", _managers)._dispose  # noqa: SLF001


def needed(made: Any) -> Any:
    """What is to be kept of something compiled for as long as it is called.

    That is nothing but for releases that were not seen: so far Numba releases no machine code, and
    what it made on the way is as large.
    """
    return made if numba.version_info.short > _SEEN else None


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


# other functions in place of some operations


def replacing(operations: Mapping[Any, Any], counted: Any) -> type:
    """A compiler, as a ``pipeline_class``, which calls functions instead of some operations.

    ``operations`` are those of whole numbers, by functions of ``operator``, and ``counted`` gives
    the number of rounds of a function's loops after the next one.
    """

    @register_pass(mutates_CFG=False, analysis_only=False)
    class Replaced(FunctionPass):  # type: ignore[misc]
        _name = "operations of whole numbers and loops"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            blocks = state.func_ir.blocks
            for block in blocks.values():
                for x in [*block.body]:
                    e: Any = getattr(x, "value", None)
                    is_binary = isinstance(e, numba_ir.Expr) and e.op.endswith("binop")
                    of = state.calltypes[e].args if is_binary and e.fn in operations else [None]
                    if all(isinstance(kind, types.Integer) for kind in of):
                        function, at = operations[e.fn], block.body.index(x)
                        x.value = _call(state, block, at, function, e.lhs, e.rhs)
            first = blocks[min(blocks)]
            rounds = numba_ir.Var(first.scope, mk_unique_var("rounds"), first.loc)
            state.typemap[rounds.name] = types.int64
            for loop in compute_cfg_from_blocks(blocks).loops().values():
                block = blocks[loop.header]
                call = _call(state, block, 0, counted, rounds)
                block.body.insert(1, numba_ir.Assign(call, rounds, block.loc))
            none = numba_ir.Const(0, first.loc)
            first.body.insert(0, numba_ir.Assign(none, rounds, first.loc))
            return True

    class Replacing(CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(Replaced, PreLowerStripPhis)
            passes.finalize()
            return [passes]

    return Replacing


def _call(state: Any, block: Any, at: int, function: Any, *args: Any) -> Any:
    """A call of a jitted function, which is read before the statement ``at`` of a block."""
    name, loc, kind = mk_unique_var("function"), block.loc, typeof(function)
    called = numba_ir.Var(block.scope, name, loc)
    block.body.insert(at, numba_ir.Assign(numba_ir.Global(name, function, loc), called, loc))
    call, given = numba_ir.Expr.call(called, args, (), loc), [state.typemap[x.name] for x in args]
    state.typemap[name] = kind
    state.calltypes[call] = kind.get_call_type(state.typingctx, given, {})
    return call


# the check


@functools.cache
def check() -> None:
    """Try what would fail without a word. Raises ``ImportError`` with the versions."""
    module = ir.Module("checked")
    never_kept(module)
    function = ir.Function(module, ir.FunctionType(ir.VoidType(), ()), "checked")
    prefer_wide_vectors(function)
    ir.IRBuilder(function.append_basic_block()).ret_void()
    trials = {"attributes of functions": _WIDE in str(module)}
    for what, holds in trials.items():
        if not holds:
            raise ImportError(
                f"numba: found {numba.__version__} with llvmlite {llvmlite.__version__}, where "
                f"this differs: {what}; accepted: the versions that pip installs with the package"
            )
