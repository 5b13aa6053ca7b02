"""Calls in parallel threads, with progress and interruption between them.

Compiled loops release the GIL. A small pool of Python threads works under other schedulers too,
unlike Numba's threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TypeVar

from fastatt import checks

T = TypeVar("T")


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
    """Make calls in their order; if one raises, those that have not begun are dropped."""
    if n_threads == 1 or len(calls) == 1:
        return [call() for call in calls]
    pool = ThreadPoolExecutor(min(n_threads, len(calls)))
    try:
        return [future.result() for future in [pool.submit(call) for call in calls]]
    finally:
        pool.shutdown(cancel_futures=True)
