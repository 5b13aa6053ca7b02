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
import math
import operator
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import TypingError, config, njit, types
from numba.extending import register_jitable

from fastatt._numba import LOOP, NEW, compiled, differs, keep, moved, replacing
from fastatt._store import kept

_COMMON: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_INLINED: dict[str, Any] = {**_COMMON, "fastmath": {"contract", "nsz"}, "forceinline": True}
_LOOP: dict[str, Any] = {**_COMMON, **LOOP}
_CHECKED: dict[str, Any] = {"boundscheck": True, "error_model": "python", "nogil": True}
#: rounds of the loops of a function of a user
MOST_ROUNDS = 1_000_000


if config.DISABLE_JIT:
    raise ImportError(
        f"NUMBA_DISABLE_JIT: found {config.DISABLE_JIT}; accepted: unset or 0, since formulas and "
        "loops run as machine code only"
    )
if not Path(__file__).with_suffix(".py").is_file():
    raise ImportError(
        f"fastatt: found {__file__} without its source; accepted: an installation in folders with "
        "all .py files, from which formulas are made"
    )

# what was compiled lives as long as these references
_MACHINES: list[Any] = []


def machine(function: Callable[..., Any], signature: Any) -> Callable[..., Any]:
    """Compile a loop over arrays for a signature, or load it.

    The result takes arguments of these types without a check of theirs, and releases the GIL.
    """

    def make(file: str | None) -> Any:
        source = moved(function, file) if file else function
        return njit(signature, **_LOOP, cache=file is not None)(source)

    name = f"{function.__module__}.{function.__qualname__}"
    loop = kept(f"{name}\0{signature}\0{_stamp()}", make)
    _MACHINES.append(loop)
    others = njit(**_LOOP)(function)

    def call(*args: Any) -> Any:
        try:
            return loop(*args)
        except TypeError:  # Numba converts no named tuples
            return others(*args)

    return compiled(loop) or call


#: a part of a machine
loop_part = njit(**_LOOP, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _has_integer(ty: types.Type) -> bool:
    if isinstance(ty, types.BaseTuple):
        return any(_has_integer(t) for t in ty)
    return isinstance(ty, (types.Integer, types.IntegerLiteral, types.Boolean))


@functools.cache
def _stamp() -> str:
    """A stamp of the whole package's sources."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        info = path.stat()
        digest.update(f"{path}:{info.st_mtime_ns}:{info.st_size};".encode())
    return digest.hexdigest()[:16]


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a scalar kernel, which is callable from Python and inlined into any jitted caller.

    A kernel takes floats and tuples of floats and keeps their precision. Constants are written
    ``type(x)(0.5)``; an integer would truncate them and is refused.
    """
    if NEW:
        _try_refusal()
    return _of_floats(function, _INLINED, is_kept=True)


@functools.cache
def _try_refusal() -> None:
    with contextlib.suppress(TypingError):
        _of_floats(lambda x: x, _INLINED)(1)
        warnings.warn(f"kernels: {NEW} does not refuse integers; accepted: floats", stacklevel=2)


def around_formulas(function: Callable[..., Any], *, spliced: bool = False) -> Any:
    """Compile a function that calls generated formulas, without changing their roundings.

    Numba would apply a kernel's ``fastmath`` to their operations too. ``spliced`` inlines the
    function into its callers and compiles no machine code for it alone.
    """
    options = {**_INLINED, "fastmath": False, "inline": "always" if spliced else "never"}
    return _of_floats(function, options)


def _of_floats(
    function: Callable[..., Any], options: dict[str, Any], *, is_kept: bool = False
) -> Any:
    """A compiled function that refuses integers."""
    dispatcher: Any = njit(**options)(function)
    try:
        compile_signature, is_new = dispatcher.compile, is_kept
    except Exception:  # noqa: BLE001  # ``kernel`` tells
        return dispatcher

    def compile_floats(sig: Any) -> Any:
        args = sig.args if hasattr(sig, "args") else sig
        if any(_has_integer(ty) for ty in args):
            raise TypingError(
                f"{function.__name__}: found an integer among the arguments {tuple(args)}; "
                "kernels accept float64 or float32 only: write 1.0 instead of 1"
            )
        nonlocal is_new
        # not at import, where looking for the folders of all kernels would double the time
        if is_new:
            is_new = False
            keep(dispatcher, _stamp())
        return compile_signature(sig)

    dispatcher.compile = compile_floats
    return dispatcher


def formula_in_jitted_code(formula: Any, file: str | None) -> Any:
    """The result of ``formula(0.5, (2, 3))`` in a function of that file, which Numba is to keep."""
    scope = {"formula": formula, "__name__": __name__}
    exec(compile("def trial(x, y): return formula(x, y)", str(file), "exec"), scope)
    return njit(cache=True)(scope["trial"])(0.5, np.array([2.0, 3.0]))


def plain(function: Any) -> Callable[..., Any]:
    """The Python function of a kernel."""
    python: Callable[..., Any] = getattr(function, "py_func", function)
    return python


def checked(function: Callable[..., Any]) -> Any:
    """Compile a user-defined function with checks of indices and Python's division.

    Whole numbers beyond 64 bits and loops of more than ``MOST_ROUNDS`` rounds raise an error.
    """
    try:
        pipeline = _checking()
        if NEW:
            _try_checks()
    except Exception as error:
        what = f"an interface of compiler passes ({type(error).__name__}: {error})"
        raise differs(what, "functions that are followed") from error
    return njit(pipeline_class=pipeline, **_CHECKED)(function)


@functools.cache
def _try_checks() -> None:
    trial: Any = njit(pipeline_class=_checking(), **_CHECKED)(_powers)
    for n, rounds in ((40, 1), (1, MOST_ROUNDS + 2)):
        with contextlib.suppress(OverflowError):
            raise ValueError(f"{n} to the power {n}, {rounds} times, gives {trial(n, rounds)}")
    if trial(3, 2) != 54:
        raise ValueError("3 to the power 3, two times, is not 54")


def _powers(n: int, rounds: int) -> int:
    total = 0
    for _ in range(rounds):
        total += n**n
    return total


@functools.cache
def _checking() -> type:
    def exact(whole: Any, of_floats: Any) -> Any:
        @njit
        def operate(a, b):  # type: ignore[no-untyped-def]
            result = whole(a, b)
            if not abs(float(result) - of_floats(float(a), float(b))) < 1e18:
                raise OverflowError
            return result

        return operate

    @njit
    def counted(rounds):  # type: ignore[no-untyped-def]
        if rounds == MOST_ROUNDS:
            raise OverflowError
        return rounds + 1

    of_floats = {
        **{op: op for op in (operator.add, operator.sub, operator.mul)},
        operator.pow: njit(lambda a, b: a**b if b >= 0.0 else math.inf),
        operator.lshift: njit(lambda a, b: a * 2.0**b),
    }
    operations = {op: exact(op, x) for op, x in of_floats.items()}
    in_place = {getattr(operator, f"i{op.__name__}"): x for op, x in operations.items()}
    return replacing(operations | in_place, counted)


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
