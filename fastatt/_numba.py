"""What the package uses of Numba and llvmlite beyond their documentation, with the reasons.

Without the first part the core gives the same numbers, in more time or memory. Functions of users
that Numba compiles need the second part, and single steps in code of users the third; these import
what they use when they are first called. With a release that was not seen, what would fail without
a word is tried.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import re
import sys
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import llvmlite
import numba
from llvmlite import binding, ir
from numba import config, njit, typeof, types
from numba.extending import NativeValue, lower_builtin, models, register_model, unbox

#: the newest releases that were seen, and what is found
SEEN = {"Numba": (0, 68), "llvmlite": (0, 50), "Python": (3, 13)}
FOUND = {
    "Numba": numba.__version__, "llvmlite": llvmlite.__version__, "Python": sys.version.split()[0],
}  # fmt: skip
#: what is newer than that; empty if nothing is
NEW = ", ".join(
    f"{name} {version} (seen: up to {'.'.join(map(str, SEEN[name]))})"
    for name, version in FOUND.items()
    if tuple(map(int, re.findall(r"\d+", version)[:2])) > SEEN[name]
)
#: the value of a type without values, such as None
NOTHING = ir.Constant(ir.IntType(8).as_pointer(), None)


def differs(what: str, then: str) -> ImportError:
    """The error where an interface is not as it was."""
    versions = ", ".join(f"{name} {version}" for name, version in FOUND.items())
    return ImportError(f"numba: found {versions}, where this differs: {what}; accepted: {then}")


# options


def _is_known(option: dict[str, bool]) -> bool:
    try:
        njit(types.void(), **option)(lambda: None)
    except Exception:  # noqa: BLE001  # Numba refuses it
        return False
    return True


#: an option for loops that allocate nothing: without it atomic counts of references to arrays take
#: longer than cheap formulas
LOOP: dict[str, bool] = {"_nrt": False}
if NEW and not _is_known(LOOP):
    LOOP = {}


# machine code on disk


def moved(function: Any, file: str) -> Any:
    """A function as if its source were another file, next to which Numba keeps machine code."""
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
    with contextlib.suppress(Exception):
        dispatcher.enable_caching()
    function.__qualname__ = name


# compilation


def target() -> tuple[str, str, str]:
    """Triple, processor and features for which Numba compiles, on which vectors depend."""
    has, features = binding.get_host_cpu_features(), config.CPU_FEATURES
    if not config.ENABLE_AVX:
        has.update({name: False for name in has if name.startswith("avx")})
    name = config.CPU_NAME or binding.get_host_cpu_name()
    return binding.get_process_triple(), name, has.flatten() if features is None else features


# since llvmlite 0.45 its pass managers have two bases with this method, of which the first does
# nothing: each manager would stay, a megabyte for each function that is compiled
if not NEW:
    from llvmlite.binding import newpassmanagers as _managers

    for _manager in (_managers.ModulePassManager, _managers.FunctionPassManager):
        _manager._dispose = getattr(_managers, "NewPassManager", _manager)._dispose  # noqa: SLF001


def needed(function: Any) -> Any:
    """What is to be kept of something compiled for as long as it is called.

    That is nothing of releases that were seen: they release no machine code, and what they made on
    the way is as large.
    """
    return function if NEW else None


def compiled(dispatcher: Any) -> Callable[..., Any] | None:
    """The only compiled function of a dispatcher, called without a check of argument types."""
    with contextlib.suppress(Exception):
        (result,) = dispatcher.overloads.values()
        if callable(result.entry_point):
            return result.entry_point  # type: ignore[no-any-return]
    return None


# other functions in place of some operations, in functions of users that Numba compiles


def replacing(operations: Mapping[Any, Any], counted: Any) -> type:
    """A compiler, as a ``pipeline_class``, which calls functions instead of some operations.

    ``operations`` are those of whole numbers, by functions of ``operator``, and ``counted`` gives
    the number of rounds of a function's loops after the next one.
    """
    from numba.core.compiler import CompilerBase, DefaultPassBuilder
    from numba.core.compiler_machinery import FunctionPass, register_pass
    from numba.core.typed_passes import PreLowerStripPhis

    @register_pass(mutates_CFG=False, analysis_only=False)
    class Replaced(FunctionPass):  # type: ignore[misc]
        _name = "operations of whole numbers and loops"

        def __init__(self) -> None:
            super().__init__()

        def run_pass(self, state: Any) -> bool:
            for block in state.func_ir.blocks.values():
                _replace(state, block, operations)
            _count_rounds(state, counted)
            return True

    class Replacing(CompilerBase):  # type: ignore[misc]
        def define_pipelines(self) -> list[Any]:
            passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
            passes.add_pass_after(Replaced, PreLowerStripPhis)
            passes.finalize()
            return [passes]

    return Replacing


def _replace(state: Any, block: Any, operations: Mapping[Any, Any]) -> None:
    """Replace the operations of whole numbers in a block."""
    for x in [*block.body]:
        e: Any = getattr(x, "value", None)
        is_binary = getattr(e, "op", "").endswith("binop")
        of = state.calltypes[e].args if is_binary and e.fn in operations else [None]
        if all(isinstance(kind, types.Integer) for kind in of):
            place = block.body.index(x)
            x.value = _call(state, block, place, operations[e.fn], e.lhs, e.rhs)


def _count_rounds(state: Any, counted: Any) -> None:
    """Count the rounds of all loops in one variable."""
    from numba.core import ir as numba_ir
    from numba.core.analysis import compute_cfg_from_blocks
    from numba.core.ir_utils import mk_unique_var

    blocks = state.func_ir.blocks
    first = blocks[min(blocks)]
    rounds = numba_ir.Var(first.scope, mk_unique_var("rounds"), first.loc)
    state.typemap[rounds.name] = types.int64
    for loop in compute_cfg_from_blocks(blocks).loops().values():
        block = blocks[loop.header]
        call = _call(state, block, 0, counted, rounds)
        block.body.insert(1, numba_ir.Assign(call, rounds, block.loc))
    none = numba_ir.Const(0, first.loc)
    first.body.insert(0, numba_ir.Assign(none, rounds, first.loc))


def _call(state: Any, block: Any, place: int, function: Any, *args: Any) -> Any:
    """A call of a jitted function, which is read before a statement of a block."""
    from numba.core import ir as numba_ir
    from numba.core.ir_utils import mk_unique_var

    name, loc, kind = mk_unique_var("function"), block.loc, typeof(function)
    read = numba_ir.Var(block.scope, name, loc)
    block.body.insert(place, numba_ir.Assign(numba_ir.Global(name, function, loc), read, loc))
    call, of = numba_ir.Expr.call(read, args, (), loc), [state.typemap[x.name] for x in args]
    state.typemap[name] = kind
    state.calltypes[call] = kind.get_call_type(state.typingctx, of, {})
    return call


# formulas that are written in place of calls, in code of users


class Line:
    """An instruction as text, which ``fastmath`` of the code around it does not change."""

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


def never_kept(module: Any) -> None:
    """Tell Numba that the code of this module, and code linked with it, is for this process only.

    Numba keeps nothing on disk that has a variable of such a name. LLVM does not remove variables
    that ``llvm.compiler.used`` lists.
    """
    name, byte = "numba.dynamic.globals.formula", ir.IntType(8)
    if name not in module.globals:
        held = ir.GlobalVariable(module, byte, name)
        held.linkage, held.initializer = "internal", ir.Constant(byte, 0)
        pointers = ir.ArrayType(byte.as_pointer(), 1)
        used = ir.GlobalVariable(module, pointers, "llvm.compiler.used")
        used.linkage, used.section = "appending", "llvm.metadata"
        used.initializer = ir.Constant(pointers, [held])


def first_numbers(context: Any, builder: Any, ty: Any, value: Any, n: int) -> list[Any]:
    """The first n numbers of an array of one axis."""
    array = context.make_array(ty)(context, builder, value)
    step = builder.extract_value(array.strides, 0)
    begin = builder.ptrtoint(array.data, step.type)
    places = [builder.add(begin, builder.mul(step, ir.Constant(step.type, i))) for i in range(n)]
    return [builder.load(builder.inttoptr(x, array.data.type)) for x in places]


def in_tuple(context: Any, builder: Any, ty: Any, parts: Any) -> Any:
    """Values as a tuple."""
    return context.make_tuple(builder, ty, parts)


@functools.cache
def written_type() -> type:
    """The class of types of functions that are written in place of each call, one for a function.

    ``typed(arguments, keywords)`` returns (result type, argument types, the ``inspect.Signature``);
    ``write(context, builder, argument types, arguments)`` writes a call. ``overload`` could call a
    function of one module only, and compiles one more function for each.
    """
    from numba.core.imputils import lower_constant

    class Written(types.Callable, types.Opaque):  # type: ignore[misc]
        def __init__(self, name: str, typed: Callable[..., Any], write: Callable[..., Any]) -> None:
            self._typed = typed
            super().__init__(name=f"{name}:{uuid.uuid4().hex}")
            lower_builtin(self, types.VarArg(types.Any))(
                lambda context, builder, sig, args: write(context, builder, sig.args, args)
            )

        def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
            result, arguments, parameters = self._typed(args, kws)
            return result(*arguments).replace(pysig=parameters)

        def get_call_signatures(self) -> Any:
            return (), False

        def get_impl_key(self, sig: Any) -> Any:
            return self

    lower_constant(Written)(lambda context, builder, ty, value: NOTHING)
    register_model(Written)(models.OpaqueModel)
    unbox(Written)(lambda ty, value, c: NativeValue(NOTHING))
    return Written
