"""What a run hands out: where it lies in the run's memory, and the fields of its trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.running.trajectory import Results


@dataclass(frozen=True)
class Handed:
    """Numbers that are handed out of each body: attitudes, then what is carried beside them.

    ``beside`` are the names of the latter with the numbers of each, ``told`` fields that all
    trajectories have in common.
    """

    n_bodies: int
    kind: np.dtype[Any]
    stored: int
    beside: dict[str, int]
    told: dict[str, Any]

    @property
    def width(self) -> int:
        """How many there are."""
        return self.stored + sum(self.beside.values())

    @cached_property
    def _spans(self) -> list[tuple[str, slice]]:
        """Where each of what is beside the attitudes lies."""
        ends = pairwise(accumulate(self.beside.values(), initial=self.stored))
        return [(x, slice(*each)) for x, each in zip(self.beside, ends, strict=True)]

    def layout(self, saves: int) -> tuple[int, int, int]:
        """Where in a run's memory the departures and the flags begin, and where it ends."""
        each = saves * self.n_bodies * self.kind.itemsize
        flags = each * (self.width + 1)
        return each * self.width, flags, flags + self.n_bodies

    def out(self, raw: NDArray[np.uint8], saves: int) -> NDArray[Any]:
        """What is handed out of each body, in a run's memory."""
        return np.ndarray((saves, self.n_bodies, self.width), self.kind, raw)

    def views(self, raw: NDArray[np.uint8], saves: int) -> Results:
        """The arrays in a run's memory."""
        first, second, _ = self.layout(saves)
        n, kind = self.n_bodies, self.kind
        # in half the time of slices and views
        return Results(
            self.out(raw, saves),
            np.ndarray((saves, n), kind, raw, first),
            np.ndarray(n, np.uint8, raw, second),
        )

    def fields(self, t: NDArray[np.float64], results: Results, one_body: bool) -> dict[str, Any]:
        """Fields of a trajectory of some saves."""
        told = {"t": t, "defect": results.defect, "status": results.status, "one_body": one_body}
        return {**self.told, **told, **self.parts(results.out)}

    def some(self, name: str, raw: NDArray[np.uint8], saves: int) -> dict[str, Any]:
        """Fields that are found along with one, if that is sooner than all of them."""
        if name in ("state", "carried"):
            return self.parts(self.out(raw, saves))
        return self.told if name in self.told else {}

    def parts(self, out: NDArray[Any]) -> dict[str, Any]:
        """Attitudes, and what is carried beside them, of what is handed out (S, N, k or more)."""
        carried = {name: out[:, :, span] for name, span in self._spans}
        found = {"state": out[:, :, : self.stored], "carried": carried}
        return {**found, "defect": out[..., -1]} if out.shape[2] > self.width else found
