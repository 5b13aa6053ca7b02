"""An ensemble's tiles and steps in pieces, on a few threads."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from threading import Event
from typing import Any

from fastatt.engine.layout import BLOCK
from fastatt.threads import in_threads, progress_bar

_PIECE = 20_000_000  # body-steps between two looks at Ctrl-C: about 0.1 s


def run_ensemble(
    call: Callable[[Any, int, int], Any],
    span: Any,
    bodies_and_width: tuple[int, int],
    n_threads: int,
    progress: bool,
) -> None:
    """All tiles and steps of a span: ``call(span, tile_first, tile_last)``."""
    n_bodies, width = bodies_and_width
    n_tiles = -(-n_bodies // width)
    pieces = min(n_tiles, max(8 * n_threads if n_threads > 1 else 1, n_tiles // 1024))
    bounds = [n_tiles * i // pieces for i in range(pieces + 1)]
    with progress_bar(progress, n_bodies * (span.last - span.first), "step") as done:

        def task(first: int, last: int) -> Callable[[Event], None]:
            bodies = min(last * width, n_bodies) - first * width
            steps = max(1, _PIECE // ((last - first) * width * BLOCK)) * BLOCK

            def work(stop: Event) -> None:
                n = span.first
                while not stop.is_set():
                    until = min(n + steps, span.last)
                    call(span.part(n, until), first, last)
                    done((until - n) * bodies)
                    n = until
                    if n == span.last:
                        return

            return work

        in_threads([task(a, b) for a, b in pairwise(bounds)], n_threads)
