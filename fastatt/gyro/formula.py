"""Formulas on arrays of rows, a number of every lane in each row: emitted, or in Python."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from fastatt.codegen.emitter import Emitter
from fastatt.codegen.instructions import Code
from fastatt.codegen.processor import processor
from fastatt.tracing import source
from fastatt.tracing.finished import Flat


@dataclass(frozen=True)
class WindowFormula:
    """A graph applied to ``lanes`` numbers at a time of rows that hold ``width``.

    A generated text calls it by its name with all arrays, and an offset into each of them:
    ``name(*arrays, *offsets)``. ``takes`` gives the array and the first row of each group of
    inputs, ``gives`` the array and the row of each result. The groups in ``shared`` have one number
    for all lanes, at the start of a row: the offset does not count for them.
    """

    flat: Flat
    takes: Mapping[str, tuple[int, int]]
    gives: Sequence[tuple[int, int]]
    width: int
    lanes: int
    shared: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """All that its operations depend on, as text."""
        return f"{self.flat.spelled(())}{self.takes}{self.gives}{self.lanes}{self.shared}"

    def emit(self, code: Code, args: Sequence[Any]) -> None:
        """Write its operations."""
        half = len(args) // 2
        arrays, offsets = args[:half], args[half:]

        def place(array: int, row: int) -> tuple[Any, Any]:
            offset = offsets[array]
            return arrays[array], code.b.add(offset, offset.type(row * self.width))

        def find(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
            group, i = name
            array, row = self.takes[group]
            if group in self.shared:
                return code.constant_load(arrays[array], (row + i) * self.width), False
            return code.vector(*place(array, row + i), self.lanes), True

        values = Emitter(code, self.lanes, processor().fuses).wide(self.flat, find)
        for target, value in zip(self.gives, values, strict=True):
            code.store_vector(*place(*target), value)

    def in_python(self) -> Callable[..., None]:
        """The same on NumPy's arrays: operations are not fused."""
        function, inputs = source.function(self.flat), self.flat.inputs()

        def apply(*args: Any) -> None:
            half = len(args) // 2
            arrays, offsets = args[:half], args[half:]

            def part(array: int, row: int, at: int) -> NDArray[Any]:
                first = at + row * self.width
                return arrays[array][first : first + self.lanes]  # type: ignore[no-any-return]

            given = []
            for group, i in inputs:
                array, row = self.takes[group]
                at = 0 if group in self.shared else offsets[array]
                found = part(array, row + i, at)
                given.append(found[0] if group in self.shared else found)
            for (array, row), value in zip(self.gives, function(*given), strict=True):
                part(array, row, offsets[array])[:] = value

        return apply
