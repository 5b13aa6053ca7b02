"""``os.fork`` in a process with threads: a child inherits locks, not the threads that hold them.

Modules are imported when they are first needed, and Numba compiles behind a lock: a fork waits
until all other threads have finished compiling and importing modules of fastatt or the compiler. It
never waits for other modules: one whose import runs a whole program may take arbitrarily long.
"""

from __future__ import annotations

import _imp
import os
import sys
from importlib import import_module
from threading import get_ident
from typing import Any

_bootstrap: Any = import_module("importlib._bootstrap")
_AWAITED = ("fastatt", "numba", "llvmlite")


def _imported_elsewhere() -> list[str]:
    """Names of those modules that other threads import at the moment."""
    found = []
    for name, lock_of in list(_bootstrap._module_locks.items()):  # noqa: SLF001
        lock = lock_of() if name.partition(".")[0] in _AWAITED else None
        if lock is not None and lock.owner not in (None, get_ident()):
            found.append(name)
    return found


def _compiler_lock() -> Any:
    module = sys.modules.get("numba.core.compiler_lock")
    return getattr(module, "global_compiler_lock", None)


_held: list[Any] = []


def _before() -> None:
    while True:
        # nothing is held while something is waited for: who imports may compile, and the reverse
        compiler = _compiler_lock()
        if compiler is not None:
            compiler.acquire()
        _imp.acquire_lock()
        elsewhere = _imported_elsewhere()
        if not elsewhere:
            _held.append(compiler)
            return
        _imp.release_lock()
        if compiler is not None:
            compiler.release()
        for name in elsewhere:
            _bootstrap._lock_unlock_module(name)  # noqa: SLF001


def _after() -> None:
    _imp.release_lock()
    compiler = _held.pop()
    if compiler is not None:
        compiler.release()


def guard() -> None:
    """Let forks of this process wait for other threads, where there are forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=_before, after_in_parent=_after, after_in_child=_after)
