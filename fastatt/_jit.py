"""The only place with Numba options.

``contract`` lets a multiply and an add fuse into one FMA, ``nsz`` ignores the sign of zero.
``arcp`` and ``afn`` gain little and cost ulps; ``nnan`` and ``ninf`` would delete every check
for a non-finite state. The callee needs the same options as the caller, or LLVM neither fuses
nor vectorises across the call; without ``forceinline`` a step of 100 flops stays a call, and a
loop that calls stays scalar.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import cfunc, config, njit, types
from numba.core.caching import FunctionCache
from numba.core.errors import TypingError
from numba.extending import register_jitable

_ARITHMETIC: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
    "nogil": True,
}
_INLINED: dict[str, Any] = {**_ARITHMETIC, "forceinline": True}


#: files that every loop depends on
_PARTS = Path(__file__), Path(__file__).parent / "codegen" / "call.py"


def address_loop(function: Callable[..., Any], *constants: Any) -> Callable[..., Any]:
    """Compile a loop of whole numbers, the addresses of arrays among them; Numba keeps it on disk.

    The loop calls functions of its file, functions of ``codegen/call.py``, and generated code by
    address. Numba notices an edit of the loop's file; a hash of the other files and of the imported
    ``constants`` is part of its name. A call releases the GIL. Without a compiler the result is the
    Python function, which takes arrays.
    """
    if config.DISABLE_JIT:
        return function
    sources = [file.read_bytes() for file in _PARTS]
    parts = hashlib.sha256(b"".join([*sources, repr(constants).encode()])).hexdigest()[:16]
    function.__qualname__ = f"{function.__qualname__}_{parts}"
    signature = types.int64(*[types.int64] * function.__code__.co_argcount)
    for _ in range(2):
        try:
            return _called(cfunc(signature, cache=True, error_model="numpy")(function))
        except Exception:  # noqa: BLE001  # no folder to write to, damaged files
            with contextlib.suppress(Exception):
                FunctionCache(function).flush()
    return _called(cfunc(signature, error_model="numpy")(function))


def _called(found: Any) -> Callable[..., Any]:
    call = found.ctypes
    call.function = found  # the machine code lives as long as this reference
    return call  # type: ignore[no-any-return]


#: a part of a loop, in the same file
loop_part = njit(error_model="numpy", nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _has_integer(ty: types.Type) -> bool:
    if isinstance(ty, types.BaseTuple):
        return any(_has_integer(t) for t in ty)
    return isinstance(ty, (types.Integer, types.IntegerLiteral, types.Boolean))


@functools.cache
def _sources() -> tuple[int, int]:
    """A stamp of the whole package's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        info = path.stat()
        digest.update(f"{path}:{info.st_mtime_ns}:{info.st_size};".encode())
    return int.from_bytes(digest.digest()[:7]), 0


def _kept(dispatcher: Any) -> None:
    """Keep machine code on disk as long as no source of the package changes.

    Numba checks the function's own file only, so that callers would not notice an edit of a kernel.
    Without a writable folder nothing is kept. The folder is determined when a function is first
    compiled, since doing so for all kernels at import would take as long as importing them.
    """
    compile_signature = dispatcher.compile
    first = True

    def compile_kept(sig: Any) -> Any:
        nonlocal first
        if first:
            first = False
            with contextlib.suppress(RuntimeError):
                dispatcher.enable_caching()
                dispatcher._cache._cache_file._source_stamp = _sources()  # noqa: SLF001
        return compile_signature(sig)

    dispatcher.compile = compile_kept


def kernel(function: Callable[..., Any], *, cache: bool = True) -> Any:
    """Compile a scalar kernel, which is callable from Python and inlined into any jitted caller.

    A kernel takes floats and tuples of floats and keeps their precision. Constants are written
    ``type(x)(0.5)``; an integer would truncate them and is refused.
    """
    dispatcher = njit(**_INLINED)(function)
    if cache and not config.DISABLE_JIT:
        _kept(dispatcher)
    return _of_floats(dispatcher, function.__name__)


def around_formulas(function: Callable[..., Any], *, spliced: bool = False) -> Any:
    """Compile a function that calls generated formulas, without changing their roundings.

    Numba would apply a kernel's ``fastmath`` to their operations too. ``spliced`` inlines the
    function into its callers, without machine code of its own.
    """
    options = {**_INLINED, "fastmath": False, "inline": "always" if spliced else "never"}
    return _of_floats(njit(**options)(function), function.__name__)


def _of_floats(dispatcher: Any, name: str) -> Any:
    """A dispatcher that refuses integers."""
    if config.DISABLE_JIT:
        return dispatcher
    compile_signature = dispatcher.compile

    def compile_floats(sig: Any) -> Any:
        args = sig.args if hasattr(sig, "args") else sig
        if any(_has_integer(ty) for ty in args):
            raise TypingError(
                f"{name}: found an integer among the arguments {tuple(args)}; "
                "kernels accept float64 or float32 only: write 1.0 instead of 1"
            )
        return compile_signature(sig)

    dispatcher.compile = compile_floats
    return dispatcher


def plain(function: Any) -> Callable[..., Any]:
    """The Python function of a kernel."""
    found: Callable[..., Any] = getattr(function, "py_func", function)
    return found


def recompile(function: Callable[..., Any]) -> Any:
    """Compile a user-defined function with the kernels' options, so that LLVM can inline it."""
    return njit(**_INLINED)(getattr(function, "py_func", function))


def with_options_of(dispatcher: Any, function: Callable[..., Any]) -> Any:
    """Compile a function with the options of another one."""
    options = {k: x for k, x in dispatcher.targetoptions.items() if k != "nopython"}
    return njit(**options)(function)


def helper(function: Any) -> Any:
    """A function for jitted code that is inlined into its caller."""
    return register_jitable(**_INLINED)(function)


def enough(name: str, size: int) -> Any:
    """A check for jitted code that an array has enough numbers; formulas do not check lengths."""
    message = f"{name}: found fewer than {size} numbers; accepted: {size}"

    @helper
    def check(x: Any) -> None:
        if len(x) < size:
            raise ValueError(message)

    return check
