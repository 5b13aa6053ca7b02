"""The tiles of an ensemble in groups, performed by several threads, and the length of a piece."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import Any

from fastatt.engine.program import Program
from fastatt.engine.tape import BLOCK
from fastatt.threads import in_threads

_OPERATIONS = 2_000_000_000  # of the first piece of a group of tiles
_SECONDS = 0.1  # of a piece of a group, after which Ctrl-C is answered
# tiles of a group, and of one whose bodies call a function, which may take any time
_TILES, _CALLING = 64, 1
#: steps of a block, and of the first pieces, if steps call a function
CALLING_LENGTH = 2
# steps of the first piece in which events are looked for, and of the shortest
_EVENTS, _LEAST = 1024, 64


class InterruptedRun(KeyboardInterrupt):
    """Ctrl-C during a run; ``trajectory`` holds the results so far.

    Bodies that did not reach the end have the status ``UNFINISHED``, and NaN in their later saves.
    """

    trajectory: Any = None


class Pool:
    """Threads for the tiles of some bodies, and the steps of a piece by the time they take."""

    def __init__(self, program: Program, bodies: int, n_threads: int) -> None:
        width, formulas = program.job.width, program.formulas
        calls = formulas.calls > 0
        self._n_threads, self._grain = n_threads, CALLING_LENGTH if calls else BLOCK
        tiles = -(-bodies // width)
        most = max(8 * n_threads if n_threads > 1 else 1, tiles // (_CALLING if calls else _TILES))
        groups = min(tiles, most)
        self._bounds = [tiles * i // groups for i in range(groups + 1)]
        self._steps = CALLING_LENGTH
        if not calls:
            most = min(bodies, width * (-(-tiles // groups)))
            each = _OPERATIONS // max(1, formulas.operations) // most
            self._steps = min(each, _EVENTS) if program.job.events else each

    def pace(self) -> int:
        """The number of steps of the next piece."""
        return max(self._steps, self._grain)

    def perform(self, call: Callable[[int, int], object]) -> None:
        """``call(first_tile, last_tile)`` for all groups of tiles.

        Raises ``InterruptedRun`` on Ctrl-C, within a second.
        """
        seconds = [0.0]

        def timed(first: int, last: int) -> None:
            begin = perf_counter()
            call(first, last)
            seconds.append(perf_counter() - begin)

        calls = [partial(timed, a, b) for a, b in pairwise(self._bounds)]
        try:
            in_threads(calls, self._n_threads)
        except KeyboardInterrupt:
            raise InterruptedRun from None
        most = _SECONDS / max(1e-9, *seconds)
        self._steps = int(self._steps * min(2.0, most)) if most < 1.0 or most > 2.0 else self._steps

    def shorten(self) -> None:
        """Take fewer steps in a piece, since bodies performed it again."""
        self._steps = max(self._steps // 4, _LEAST)
