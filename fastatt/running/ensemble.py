"""Bodies with their initial states, and some of them with what acts on them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, forces, rates, torques
from fastatt.models import Record, Sum
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
        return Ensemble(_scene_of(self.scene, rows), *states)


def _scene_of(scene: Scene, rows: NDArray[np.intp]) -> Scene:
    """The scene of some bodies: numbers that each body has of its own, of these alone."""
    own: dict[str, Any] = {}
    if scene.params is not None and np.ndim(scene.params) == 2:
        own["params"] = np.asarray(scene.params)[rows]
    if scene.inertia is not None and scene.principal.moments.ndim == 2:
        own["inertia"] = found = np.asarray(scene.inertia, dtype=np.float64)[rows]
        if found.shape == (3, 3):  # which a scene takes for one tensor
            own["inertia"] = found[:, :, None] * np.eye(3)
    if np.ndim(scene.mass if scene.mass is not None else 0.0):
        own["mass"] = np.asarray(scene.mass)[rows]
    for name, records in _RECORDS.items():
        model = getattr(scene, name)
        if hasattr(model, "_fields"):
            own[name] = _model_of(model, records, rows)
        elif np.ndim(model if not callable(model) else 0.0) == 2:
            own[name] = np.asarray(model)[rows]
    return replace(scene, **own) if own else scene


_RECORDS: dict[str, Mapping[type, Record]] = {
    "rate": rates.RECORDS,
    "torque": torques.RECORDS,
    "force": forces.RECORDS,
}


def _model_of(model: Any, records: Mapping[type, Record], rows: NDArray[np.intp]) -> Any:
    """A model's numbers of some bodies; its record says how many dimensions those of one have."""
    if isinstance(model, Sum):
        return Sum(tuple(_model_of(term, records, rows) for term in model.terms))
    if isinstance(model, torques.Sampled):
        return model
    if isinstance(model, (torques.Custom, forces.Custom)):
        shared = model.params is None or np.ndim(model.params) < 2
        return model if shared else model._replace(params=np.asarray(model.params)[rows])
    fields = zip(model, records[type(model)].fields, strict=True)
    return type(model)(
        *[np.asarray(x)[rows] if np.ndim(x) > len(each.shape) else x for x, each in fields]
    )
