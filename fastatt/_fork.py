"""Forks of a process with threads: a child inherits locks, but not the threads that hold them.

Modules are imported when they are first needed, and Numba and LLVM compile under locks. A fork
therefore waits until all other threads have finished compiling and importing modules of fastatt,
NumPy or the compiler. It does not wait for other modules: an import that runs a whole program may
never end.

Hooks that were registered last run first. ``logging`` locks itself in its hook and a compiling
thread asks it for its level, so that it has to be there before this module registers its own; so
does ``concurrent.futures.thread``, whose hooks may not appear while a fork waits.

``functools.cached_property`` holds a lock in Python 3.11 for as long as a value is computed, which
may compile; ``cached_property`` here has none, as from Python 3.12 on.
"""

from __future__ import annotations

import _imp
import concurrent.futures.thread  # noqa: F401
import logging  # noqa: F401
import os
import sys
from collections.abc import Callable
from importlib import import_module
from threading import get_ident
from typing import Any, Generic, TypeVar, overload

_bootstrap: Any = import_module("importlib._bootstrap")
_AWAITED = ("fastatt", "numba", "llvmlite", "numpy")
_T = TypeVar("_T")


class cached_property(Generic[_T]):  # noqa: N801  # as in functools
    """An attribute that is computed when it is first read, without a lock."""

    def __init__(self, compute: Callable[[Any], _T]) -> None:
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> cached_property[_T]: ...

    @overload
    def __get__(self, instance: object, owner: type) -> _T: ...

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            return self
        # two threads may both compute it; they get one value
        return instance.__dict__.setdefault(self._name, self._compute(instance))


def _imported_elsewhere() -> list[str]:
    """Names of the modules that other threads are importing."""
    found = []
    for name, lock_of in list(_bootstrap._module_locks.items()):  # noqa: SLF001
        lock = lock_of() if name.partition(".")[0] in _AWAITED else None
        if lock is not None and lock.owner not in (None, get_ident()):
            found.append(name)
    return found


def _compiler_locks() -> list[Any]:
    """The locks of Numba and of LLVM, in the order in which a compiling thread takes them."""
    numba = sys.modules.get("numba.core.compiler_lock")
    llvm = getattr(sys.modules.get("llvmlite.binding.ffi"), "lib", None)
    found = getattr(numba, "global_compiler_lock", None), getattr(llvm, "_lock", None)
    return [lock for lock in (found[0], getattr(found[1], "_lock", None)) if lock is not None]


_held: list[list[Any]] = []


def _before() -> None:
    while True:
        # no lock is held while waiting: an importing thread may compile, and a compiling one import
        compiling = _compiler_locks()
        for lock in compiling:
            lock.acquire()
        _imp.acquire_lock()
        elsewhere = _imported_elsewhere()
        if not elsewhere:
            _held.append(compiling)
            return
        _imp.release_lock()
        for lock in reversed(compiling):
            lock.release()
        for name in elsewhere:
            _bootstrap._lock_unlock_module(name)  # noqa: SLF001


def _after() -> None:
    _imp.release_lock()
    for lock in reversed(_held.pop()):
        lock.release()


def guard() -> None:
    """Let forks of this process wait for other threads, on systems that have forks."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(before=_before, after_in_parent=_after, after_in_child=_after)
