"""The tiles and steps of an ensemble in pieces, run by several threads."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from threading import Event
from time import perf_counter
from typing import Any

from fastatt.threads import in_threads

_PIECE = 2_000_000  # body-steps of the first piece, between two checks for Ctrl-C
_SECONDS = 0.1  # between two checks
# tiles of a piece, and of one whose bodies call a function, which may take any time
_TILES, _CALLING = 64, 1


class InterruptedRun(KeyboardInterrupt):
    """Ctrl-C during a run; ``trajectory`` holds the results so far.

    Bodies that did not reach the end have the status ``UNFINISHED``, and NaN in their later saves.
    """

    #: (first tile, last tile, steps done)
    reached: list[tuple[int, int, int]]
    trajectory: Any = None


def run_ensemble(
    call: Callable[[Any, int, int], Any],
    span: Any,
    bodies_and_width: tuple[int, int],
    n_threads: int,
    done: Callable[[int], object] | None = None,
    *,
    calls: bool = False,
) -> None:
    """Run all tiles and steps of a span: ``call(span, tile_first, tile_last)``.

    ``done`` is called with the number of body-steps taken; ``calls`` says that steps call a
    user-defined function, which may take any time. Raises ``InterruptedRun`` on Ctrl-C, within a
    second.
    """
    n_bodies, width = bodies_and_width
    n_tiles = -(-n_bodies // width)
    pieces = min(
        n_tiles,
        max(8 * n_threads if n_threads > 1 else 1, n_tiles // (_CALLING if calls else _TILES)),
    )
    bounds = [n_tiles * i // pieces for i in range(pieces + 1)]
    reached = dict.fromkeys(pairwise(bounds), span.first)

    def task(first: int, last: int) -> Callable[[Event], None]:
        bodies = min(last * width, n_bodies) - first * width
        block = (last - first) * width * span.block

        def work(stop: Event) -> None:
            is_known = not calls and span.grain > 1
            n, blocks = span.first, max(1, _PIECE // block) if is_known else 1
            while not stop.is_set():
                until = min(span.end_of_piece(n, blocks * span.grain), span.last)
                begun = perf_counter()
                call(span.part(n, until), first, last)
                if done is not None:
                    done((until - n) * bodies)
                n = reached[first, last] = until
                if n == span.last:
                    return
                blocks = max(1, min(2 * blocks, int(blocks * _SECONDS / (perf_counter() - begun))))

        return work

    try:
        in_threads([task(a, b) for a, b in pairwise(bounds)], n_threads)
    except KeyboardInterrupt:
        stopped = InterruptedRun()
        stopped.reached = [(a, b, n) for (a, b), n in reached.items()]
        raise stopped from None
