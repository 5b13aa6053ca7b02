"""The only place with Numba options.

``contract`` lets a multiply and an add fuse into one FMA, ``nsz`` ignores the sign of zero.
``arcp`` and ``afn`` gained 3 % and cost ulps; ``nnan`` and ``ninf`` would delete every check
for a non-finite state. The callee needs the same options as the caller, or LLVM neither fuses
nor vectorises across the call; without ``forceinline`` a step of 100 flops stays a call, and a
loop that calls stays scalar.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.core.errors import TypingError
from numba.extending import overload, register_jitable

_ARITHMETIC: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
    "nogil": True,
}
_INLINED: dict[str, Any] = {**_ARITHMETIC, "forceinline": True}


def _has_integer(ty: types.Type) -> bool:
    if isinstance(ty, types.BaseTuple):
        return any(_has_integer(t) for t in ty)
    return isinstance(ty, (types.Integer, types.IntegerLiteral, types.Boolean))


def kernel(function: Callable[..., Any], *, cache: bool = True) -> Any:
    """Compile a scalar kernel: callable from Python, inlined into any jitted caller.

    A kernel takes floats and tuples of floats and keeps their precision (constants are written
    ``type(x)(0.5)``, so an integer would truncate them: it is refused).
    """
    dispatcher = njit(**_INLINED, cache=cache)(function)
    compile_signature = dispatcher.compile

    def compile_floats(sig: Any) -> Any:
        args = sig.args if hasattr(sig, "args") else sig
        if any(_has_integer(ty) for ty in args):
            raise TypingError(
                f"{function.__name__}: found an integer among the arguments {tuple(args)}; "
                "kernels accept float64 or float32 only: write 1.0 instead of 1"
            )
        return compile_signature(sig)

    dispatcher.compile = compile_floats
    return dispatcher


def recompile(function: Callable[..., Any]) -> Any:
    """A user's function with the kernels' options, so that LLVM can inline and fuse it."""
    return njit(**_INLINED)(getattr(function, "py_func", function))


def hook(function: Callable[..., Any]) -> Callable[..., Any]:
    """``@overload`` for a generic function that is chosen by the types of its tags."""
    decorated: Callable[..., Any] = overload(function, jit_options=_INLINED, strict=False)
    return decorated


def driver(function: Callable[..., Any], *, cache: bool = True) -> Any:
    """Compile a loop over tiles: entered from Python without the GIL."""
    return njit(**_ARITHMETIC, cache=cache)(function)


def helper(function: Any) -> Any:
    """A part of a driver, inlined: a tile's strides are constants only where it was made."""
    return register_jitable(**_INLINED)(function)


def part(function: Callable[..., Any]) -> Any:
    """A part of a driver that calls loops of its own, spliced in before LLVM sees either.

    As a function of its own it would be optimised first, with the strides of its arrays unknown:
    its vector loops then test for overlap at every call, and ran 4 times slower.
    """
    return register_jitable(error_model="numpy", fastmath=_ARITHMETIC["fastmath"], inline="always")(
        function
    )
