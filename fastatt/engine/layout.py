"""How the engine's machine code finds what it works on: numbers, arrays and rows by their names."""

from __future__ import annotations

import ctypes
from itertools import accumulate

#: bodies side by side; of few, one vector
WIDTH = 64
#: steps between two looks at how far a tile's bodies turned: enough that what is done once a block
#: costs the cheapest step next to nothing
BLOCK = 256

#: times, and what the status is judged by
NUMBERS = ("t0", "h", "edge", "quiet", "limit", "norm", "invariant")
_WHOLE = (
    # numbers of bodies and of rows, from save to save in bodies, the span
    "bodies", "rows_q", "rows_y", "rows_p", "rows_known", "rows_flags", "stride", "first", "last",
    "n_steps", "save_every", "slot", "restore", "origin", "stage_count", "rows_own",
    # addresses
    "q0", "y0", "p", "known", "flags", "stages", "x", "watch", "out", "defect", "status", "told",
    "dt", "times", "slots", "careful", "resources",
)  # fmt: skip


class Table(ctypes.Structure):
    """What every function of a program is given."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in _WHOLE),
        *((name, ctypes.c_double) for name in NUMBERS),
    )


class Rows:
    """Where what belongs to a lane lies in a tile's memory, a row of ``width`` numbers each."""

    def __init__(self, width: int, **sizes: int) -> None:
        self.width, self.sizes, self.count = width, sizes, sum(sizes.values())
        self._first = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))

    def offset(self, name: str, i: int = 0) -> int:
        """Index of a row's first number."""
        return (self._first[name] + i) * self.width
