"""Allocations of compiled code, counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.runtime import _nrt_python, rtsys


@contextmanager
def counted() -> Iterator[Callable[[], int]]:
    """A function that says how many there were, ever."""
    was_on = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()
    yield lambda: rtsys.get_allocation_stats().alloc
    if not was_on:
        _nrt_python.memsys_disable_stats()


def is_made_in(text: str) -> bool:
    """Whether a program in LLVM's language makes any."""
    return "call ptr @NRT_MemInfo_alloc" in text or "call i8* @NRT_MemInfo_alloc" in text
