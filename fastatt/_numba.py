"""What the core uses of Numba and llvmlite beyond their documentation, with the reasons.

Without any of it the core gives the same numbers, in more time or memory. ``codegen.written`` has
what single steps in code of users need. With a release that was not seen, what would fail without a
word is tried.
"""

from __future__ import annotations

import contextlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import llvmlite
import numba
from llvmlite import binding, ir
from numba import config, njit, types

#: the newest releases that were seen, and what is found
SEEN = {"Numba": (0, 68), "llvmlite": (0, 50), "Python": (3, 13)}
FOUND = {
    "Numba": numba.__version__, "llvmlite": llvmlite.__version__, "Python": sys.version.split()[0],
}  # fmt: skip
#: what is newer than that; empty if nothing is
NEW = ", ".join(
    f"{name} {found} (seen: up to {'.'.join(map(str, SEEN[name]))})"
    for name, found in FOUND.items()
    if tuple(map(int, re.findall(r"\d+", found)[:2])) > SEEN[name]
)
#: the value of a type without values, such as None
NOTHING = ir.Constant(ir.IntType(8).as_pointer(), None)


def differs(what: str, then: str) -> ImportError:
    """The error where an interface is not as it was."""
    versions = ", ".join(f"{name} {found}" for name, found in FOUND.items())
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
    found, features = binding.get_host_cpu_features(), config.CPU_FEATURES
    if not config.ENABLE_AVX:
        found.update({name: False for name in found if name.startswith("avx")})
    name = config.CPU_NAME or binding.get_host_cpu_name()
    return binding.get_process_triple(), name, found.flatten() if features is None else features


# since llvmlite 0.45 its pass managers have two bases with this method, of which the first does
# nothing: each manager would stay, a megabyte for each function that is compiled
if not NEW:
    from llvmlite.binding import newpassmanagers as _passes

    for _managers in (_passes.ModulePassManager, _passes.FunctionPassManager):
        _managers._dispose = getattr(_passes, "NewPassManager", _managers)._dispose  # noqa: SLF001


def needed(made: Any) -> Any:
    """What is to be kept of something compiled for as long as it is called.

    That is nothing of releases that were seen: they release no machine code, and what they made on
    the way is as large.
    """
    return made if NEW else None


def compiled(dispatcher: Any) -> Callable[..., Any] | None:
    """The only compiled function of a dispatcher, called without a check of argument types."""
    with contextlib.suppress(Exception):
        (made,) = dispatcher.overloads.values()
        if callable(made.entry_point):
            return made.entry_point  # type: ignore[no-any-return]
    return None
