"""Rows of an array on a few threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from threading import Event
from typing import Any

from fastatt import checks
from fastatt.engine import pool


def spread(n: int, n_threads: int | None, call: Callable[[int, int], Any], least: int = 64) -> None:
    """``call(first, last)`` over n rows, in pieces of at least ``least`` on each thread.

    Raises ``ValueError`` or ``TypeError`` for a number of threads that is none.
    """
    threads = (
        pool.default_threads() if n_threads is None else checks.whole("n_threads", n_threads, 1)
    )
    pieces = max(1, min(4 * threads if threads > 1 else 1, n // least))
    bounds = [n * i // pieces for i in range(pieces + 1)]

    def task(first: int, last: int, stop: Event) -> None:
        if not stop.is_set():
            call(first, last)

    pool.in_threads([partial(task, *ends) for ends in pairwise(bounds)], threads)
