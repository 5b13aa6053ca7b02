"""What a run hands out: where it lies in the run's memory, and the fields of its trajectory."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.propagation.trajectory import Results


@dataclass(frozen=True)
class Handed:
    """Numbers that are handed out of each body: attitudes, then what is carried beside them.

    ``beside`` are the names of the latter with the numbers of each, ``common`` the fields that all
    trajectories of a plan share.
    """

    n_bodies: int
    kind: np.dtype[Any]
    stored: int
    beside: dict[str, int]
    common: dict[str, Any]

    @property
    def width(self) -> int:
        """How many there are."""
        return self.stored + sum(self.beside.values())

    @cached_property
    def _spans(self) -> list[tuple[str, slice]]:
        """Where each of what is beside the attitudes lies."""
        ends = pairwise(accumulate(self.beside.values(), initial=self.stored))
        return [(x, slice(*each)) for x, each in zip(self.beside, ends, strict=True)]

    def fields(self, t: NDArray[np.float64], results: Results, one_body: bool) -> dict[str, Any]:
        """Fields of a trajectory of some saves."""
        found = {
            "t": t,
            "norm_error": results.norm_error,
            "status": results.status,
            "one_body": one_body,
        }
        return {**self.common, **found, **self.parts(results.out)}

    def parts(self, out: NDArray[Any]) -> dict[str, Any]:
        """Attitudes, and what is carried beside them, of what is handed out (S, N, k or more)."""
        carried = {name: out[:, :, span] for name, span in self._spans}
        found = {"state": out[:, :, : self.stored], "carried": carried}
        return {**found, "norm_error": out[..., -1]} if out.shape[2] > self.width else found
