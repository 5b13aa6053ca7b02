"""A scene together with initial states, and the selection of some of its bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt._cached import cached_property
from fastatt.propagation.initial import INITIAL, initial
from fastatt.scene.scene import Scene, as_scene


@dataclass(frozen=True, eq=False)
class Ensemble:
    """A scene with initial states, as ``propagate`` takes them."""

    scene: Scene
    q0: NDArray[Any]
    w0: NDArray[Any] | None = None
    v0: NDArray[Any] | None = None
    r0: NDArray[Any] | None = None
    s0: NDArray[Any] | None = None
    taken: NDArray[np.intp] | None = None  # the rows of another ensemble that these are

    @classmethod
    def of(cls, scene: Scene, *values: Any) -> Ensemble:
        """An ensemble from a scene and initial values, in the order of ``INITIAL``.

        Raises ``TypeError`` if ``scene`` is not a scene, and errors as ``propagate`` does.
        """
        q0, others = initial(as_scene(scene), values)
        ensemble = cls(scene, q0, **others)
        scene.packed(ensemble.size)
        return ensemble

    @property
    def initial(self) -> dict[str, Any]:
        """Initial values by the names of ``propagate``'s arguments."""
        return {name: getattr(self, name) for name in INITIAL}

    @cached_property
    def size(self) -> int:
        """Number of bodies."""
        states = self.initial.values()
        return max((len(x) for x in states if x is not None and x.ndim == 2), default=1)

    @property
    def places(self) -> NDArray[np.intp]:
        """The bodies' rows in the ensemble that they were taken from, or in this one."""
        return np.arange(self.size) if self.taken is None else self.taken

    @cached_property
    def extremes(self) -> NDArray[np.intp]:
        """The bodies with the smallest and the largest of each number of the scene."""
        if self.scene.rows is None:
            return np.arange(0)
        numbers = self.scene.packed(self.size).params
        return np.unique([numbers.argmin(axis=0), numbers.argmax(axis=0)])

    def take(self, rows: NDArray[np.intp]) -> Ensemble:
        """The bodies of the given rows."""

        def chosen(x: NDArray[Any] | None) -> Any:
            return None if x is None else np.broadcast_to(x, (self.size, x.shape[-1]))[rows]

        states = {name: chosen(x) for name, x in self.initial.items()}
        return Ensemble(self.scene[rows], **states, taken=self.places[rows])
