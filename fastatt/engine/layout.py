"""How the engine's machine code finds what it works on: numbers, arrays and rows by their names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastatt.flat.code import I64, REALS, Code, Int

#: bodies side by side; of few, one vector
WIDTH = 64
#: steps between two looks at how far a tile's bodies turned: enough that what is done once a block
#: costs the cheapest step next to nothing
BLOCK = 256

#: numbers of bodies and of rows, from save to save in bodies, the span
INTS = (
    "bodies", "rows_q", "rows_y", "rows_p", "rows_known", "rows_flags", "stride", "first", "last",
    "n_steps", "save_every", "slot", "restore", "origin", "stages", "rows_own",
)  # fmt: skip
#: times, and what the status is judged by
NUMBERS = ("t0", "h", "edge", "quiet", "limit", "norm", "invariant")
ARRAYS = (
    "q0", "y0", "p", "known", "flags", "stages", "x", "watch", "out", "defect", "status", "told",
    "dt", "times", "slots", "careful",
)  # fmt: skip

_CHARS = I64.as_pointer()
#: types of (whole numbers, doubles, addresses), with which every function of a program begins
ARGUMENTS = (I64.as_pointer(), REALS["double"].as_pointer(), _CHARS)


class Given:
    """What a function of the program was given, loaded when it is asked for."""

    def __init__(self, code: Code, arguments: Sequence[Any]) -> None:
        self.code = code
        self._ints, self._numbers, self._addresses = arguments
        self.arguments = tuple(arguments)

    def whole(self, name: str) -> Int:
        """A whole number."""
        return Int(self.code, self.code.load(self._ints, INTS.index(name)))

    def number(self, name: str) -> Any:
        """A number of double precision."""
        return self.code.load(self._numbers, NUMBERS.index(name))

    def array(self, name: str | int, kind: Any) -> Any:
        """Address of an array; of a table or a function by its place after the named ones."""
        at = ARRAYS.index(name) if isinstance(name, str) else len(ARRAYS) + name
        address = self.code.load(self._addresses, at)
        return self.code.b.inttoptr(address, kind)


class Rows:
    """Where what belongs to a lane lies in a tile's memory, a row of ``width`` numbers each."""

    def __init__(self, width: int, **sizes: int) -> None:
        self.width = width
        self.first: dict[str, int] = {}
        at = 0
        for name, size in sizes.items():
            self.first[name] = at
            at += size
        self.sizes = sizes
        self.count = at

    def offset(self, name: str, i: int = 0) -> int:
        """Index of a row's first number."""
        return (self.first[name] + i) * self.width
