"""What a run hands out: where it lies in the run's memory, and the fields of its trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.running.trajectory import Results
from fastatt.scene import Packed


class Handed:
    """Numbers that are handed out of each body: attitudes, then what is carried beside them.

    ``told`` are fields that all trajectories have in common.
    """

    def __init__(
        self,
        n_bodies: int,
        kind: np.dtype[Any],
        stored: int,
        beside: tuple[Sequence[str], Sequence[int]],
        told: dict[str, Any],
    ) -> None:
        self.n_bodies, self.kind, self.told = n_bodies, kind, told
        self._stored = stored
        self._names, self._widths = beside
        self.width = stored + sum(self._widths)

    def with_packed(self, packed: Packed) -> Handed:
        """The same of other numbers of what acts."""
        told = {**self.told, "packed": packed}
        return Handed(self.n_bodies, self.kind, self._stored, (self._names, self._widths), told)

    def layout(self, saves: int) -> tuple[int, int, int]:
        """Where in a run's memory the departures and the flags begin, and where it ends."""
        size = saves * self.n_bodies * self.kind.itemsize
        return (
            size * self.width,
            size * (self.width + 1),
            size * (self.width + 1) + self.n_bodies,
        )

    def views(self, raw: NDArray[np.uint8], saves: int) -> Results:
        """The arrays in a run's memory."""
        first, second, end = self.layout(saves)
        n, kind = self.n_bodies, self.kind
        return Results(
            raw[:first].view(kind).reshape(saves, n, self.width),
            raw[first:second].view(kind).reshape(saves, n),
            raw[second:end],
        )

    def fields(self, t: NDArray[np.float64], results: Results, one_body: bool) -> dict[str, Any]:
        """Fields of a trajectory of some saves."""
        return {
            **self.told,
            "t": t,
            "defect": results.defect,
            "status": results.status,
            "one_body": one_body,
            **self.parts(results.out),
        }

    def parts(self, out: NDArray[Any]) -> dict[str, Any]:
        """Attitudes, and what is carried beside them, of what is handed out (S, N, k or more)."""
        spans = pairwise(accumulate(self._widths, initial=self._stored))
        carried = {x: out[..., a:b] for x, (a, b) in zip(self._names, spans, strict=True)}
        found = {"state": out[..., : self._stored], "carried": carried}
        return {**found, "defect": out[..., -1]} if out.shape[2] > self.width else found
