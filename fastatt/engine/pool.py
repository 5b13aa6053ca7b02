"""Pieces of an ensemble on a few threads, with progress and a way out between pieces.

A serial driver that releases the GIL, called from a small pool, needs no ``parallel=True`` (2.5 s
of compile time a driver) and nests under other schedulers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from threading import Event
from typing import Any

from fastatt.engine.tiles import BLOCK, WIDTH, Run

_PIECE = 20_000_000  # body-steps between two looks at Ctrl-C: about 0.1 s


def default_threads() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def progress_bar(wanted: bool, total: int, unit: str) -> Iterator[Callable[[int], object]]:
    """A tqdm bar's ``update``, or a function that does nothing.

    Raises ``ImportError`` when a bar is wanted and tqdm is not installed.
    """
    if not wanted:
        yield lambda done: None
        return
    try:
        from tqdm import tqdm
    except ImportError:
        raise ImportError(
            "progress: needs tqdm; install it with pip install 'fastatt[progress]'"
        ) from None
    with tqdm(total=total, unit=unit, unit_scale=True) as bar:
        yield bar.update


def in_threads(tasks: list[Callable[[Event], None]], n_threads: int) -> None:
    """Run tasks, each of which looks at the event between its pieces and stops when it is set."""
    stop = Event()
    if n_threads == 1 or len(tasks) == 1:
        for task in tasks:
            task(stop)
        return
    with ThreadPoolExecutor(min(n_threads, len(tasks))) as pool:
        futures = [pool.submit(task, stop) for task in tasks]
        try:
            for future in futures:
                future.result()
        except BaseException:
            stop.set()
            for future in futures:
                future.cancel()
            raise


def run_ensemble(
    call: Callable[[Run, int, int], Any],
    run: Run,
    n_bodies: int,
    n_threads: int,
    progress: bool,
) -> None:
    """Call the driver for all tiles and steps of a run: ``call(run, tile_first, tile_last)``."""
    n_tiles = -(-n_bodies // WIDTH)
    pieces = min(n_tiles, max(8 * n_threads if n_threads > 1 else 1, n_tiles // 1024))
    bounds = [n_tiles * i // pieces for i in range(pieces + 1)]
    with progress_bar(progress, n_bodies * (run.last - run.first), "step") as done:

        def task(first: int, last: int) -> Callable[[Event], None]:
            bodies = min(last * WIDTH, n_bodies) - first * WIDTH
            steps = max(1, _PIECE // ((last - first) * WIDTH * BLOCK)) * BLOCK

            def work(stop: Event) -> None:
                n = run.first
                while not stop.is_set():
                    until = min(n + steps, run.last)
                    call(run._replace(first=n, last=until), first, last)
                    done((until - n) * bodies)
                    n = until
                    if n == run.last:
                        return

            return work

        in_threads([task(a, b) for a, b in pairwise(bounds)], n_threads)
