"""Bodies with their initial states, and some of them with what acts on them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene import Scene


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A scene with initial states, as ``propagate`` takes them."""

    scene: Scene
    q0: NDArray[Any]
    w0: NDArray[Any] | None = None
    v0: NDArray[Any] | None = None
    r0: NDArray[Any] | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        q0: ArrayLike,
        w0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        r0: ArrayLike | None = None,
    ) -> Ensemble:
        """The same from whatever numbers a user gives.

        Raises ``TypeError`` and ``ValueError`` for what is no scene, no attitude, no vector, and
        for numbers of bodies that do not fit.
        """
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
        start = checks.attitudes("q0", q0)
        vectors = [
            None if x is None else checks.array(name, x, "(3,) or (N, 3)", [(3,), (-1, 3)])
            for name, x in (("w0", w0), ("v0", v0), ("r0", r0))
        ]
        found = cls(scene, start, *vectors)
        scene.packed(found.size)
        return found

    @cached_property
    def size(self) -> int:
        """Number of bodies."""
        states = (self.q0, self.w0, self.v0, self.r0)
        return max((len(x) for x in states if x is not None and x.ndim == 2), default=1)

    def take(self, rows: NDArray[np.intp]) -> Ensemble:
        """The bodies of some rows, each with its own numbers."""

        def chosen(x: NDArray[Any] | None) -> Any:
            return None if x is None else np.broadcast_to(x, (self.size, x.shape[-1]))[rows]

        states = [chosen(x) for x in (self.q0, self.w0, self.v0, self.r0)]
        return Ensemble(self.scene[rows], *states)
