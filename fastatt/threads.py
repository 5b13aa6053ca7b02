"""Calls in parallel threads, with progress and interruption between them.

Compiled loops release the GIL. A small pool of Python threads works under other schedulers too,
unlike Numba's threads.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from threading import main_thread
from typing import TypeVar

from fastatt import checks

T = TypeVar("T")
_MOST = 1024  # threads of the pool


def default_threads() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def number_of(n_threads: int | None) -> int:
    """A number of threads; None gives all processors.

    Raises ``ValueError`` or ``TypeError`` for anything else.
    """
    return default_threads() if n_threads is None else checks.whole("n_threads", n_threads, 1)


def progress_bar(
    wanted: bool, total: int, unit: str
) -> AbstractContextManager[Callable[[int], object]]:
    """The ``update`` of a tqdm bar, or a function that does nothing.

    Raises ``ImportError`` if a bar is wanted and tqdm is not installed.
    """
    return _bar(total, unit) if wanted else nullcontext(lambda done: None)


@contextmanager
def _bar(total: int, unit: str) -> Iterator[Callable[[int], object]]:
    tqdm = checks.optional("progress", "tqdm", "fastatt[progress]")
    with tqdm.tqdm(total=total, unit=unit, unit_scale=True) as bar:
        yield bar.update


def in_threads(calls: Sequence[Callable[[], T]], n_threads: int) -> list[T]:
    """Make calls in their order; if one raises, those that have not begun are dropped.

    The thread that asks makes calls too, and does not wait for others that have not begun.
    """
    if n_threads == 1 or len(calls) == 1:
        return [call() for call in calls]
    results: dict[int, T] = {}
    left = deque(enumerate(calls))

    def work() -> None:
        try:
            while task := _next(left):
                results[task[0]] = task[1]()
        finally:
            left.clear()

    helpers: list[Future[None]] = []
    try:
        if main_thread().is_alive():  # no thread can begin while the process ends
            helpers += [_pool().submit(work) for _ in range(min(n_threads, len(calls)) - 1)]
        work()
    finally:
        left.clear()
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()  # raises what it raised
    return [results[i] for i in range(len(calls))]


def _next(left: deque[T]) -> T | None:
    """The next of what is left, if there is one."""
    with suppress(IndexError):
        return left.popleft()
    return None


@cache
def _pool() -> ThreadPoolExecutor:
    """The threads of this process, which stay; each begins when it is first needed."""
    return ThreadPoolExecutor(_MOST, "fastatt")


if hasattr(os, "register_at_fork"):  # a process that is forked has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
