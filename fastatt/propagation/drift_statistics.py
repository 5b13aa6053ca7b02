"""Drift statistics gathered while a run goes on: a fixed number of bytes a body, no history."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.propagation.drift import drift
from fastatt.propagation.propagate import propagate
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene

# a share of powers of 2: below round-off of float64 up to a motion that is lost
_LOWEST, _BINS = -56, 64


class Measure:
    """The values of one measure at the saves of every body, as their maximum and a histogram.

    ``maximum`` (N,). 64 bins of a factor of 2 hold the rest: 256 bytes a body.
    """

    def __init__(self, n_bodies: int) -> None:
        self.maximum = np.zeros(n_bodies)
        self._counts: NDArray[Any] = np.zeros((n_bodies, _BINS), dtype=np.uint32)

    def __repr__(self) -> str:
        worst = self.maximum.max(initial=0.0)
        return f"Measure({self.maximum.size} bodies, at most {worst:.3g})"

    @classmethod
    def joined(cls, parts: Sequence[Measure]) -> Measure:
        """The saves of many bodies as those of one; a body that is lost is infinitely far."""
        found = cls(1)
        worst = [
            np.where(np.isnan(part.maximum), np.inf, part.maximum).max(initial=0.0)
            for part in parts
        ]
        found.maximum = np.array([max(worst, default=0.0)])
        counts = [part._counts.sum(axis=0, dtype=np.uint64) for part in parts]  # noqa: SLF001
        found._counts = np.sum(counts, axis=0, keepdims=True)
        return found

    def add(self, values: NDArray[Any]) -> None:
        """Values (S, N) of some saves."""
        self.maximum = np.maximum(self.maximum, values.max(axis=0, initial=0.0))
        with np.errstate(divide="ignore"):
            power = np.nan_to_num(np.log2(values), nan=_BINS, posinf=_BINS, neginf=_LOWEST)
        place = np.clip(np.floor(power).astype(np.int64) - _LOWEST, 0, _BINS - 1)
        n = self.maximum.size
        flat = (place + _BINS * np.arange(n)).ravel()
        self._counts += np.bincount(flat, minlength=n * _BINS).reshape(n, _BINS).astype(np.uint32)

    def percentile(self, percent: float) -> NDArray[np.float64]:
        """What so many percent of a body's saves do not exceed, (N,); right to a factor of 2.

        Raises ``ValueError`` for what is not between 0 and 100.
        """
        share = checks.real("percent", percent) / 100.0
        if not 0.0 <= share <= 1.0:
            raise ValueError(f"percent: found {percent}; accepted: 0 to 100")
        running = self._counts.cumsum(axis=1)
        wanted = np.maximum(np.ceil(share * running[:, -1:]), 1.0)
        place = np.argmax(running >= wanted, axis=1)
        upper = np.where(place < _BINS - 1, 2.0 ** (place + _LOWEST + 1), np.inf)
        return np.asarray(np.minimum(upper, self.maximum))


@dataclass(frozen=True, eq=False)
class DriftStatistics:
    """Drifts of a run, as ``fastatt.drift`` defines them, over its saves.

    Each is a :class:`Measure` or, where the scene does not keep it, None. ``trajectory`` holds the
    final state and the status.
    """

    norm: Measure
    orthogonality: Measure
    energy: Measure | None
    momentum: Measure | None
    saves: int
    trajectory: Trajectory


def drift_statistics(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike | None = None,
    *,
    every: int,
    **options: Any,
) -> DriftStatistics:
    """Propagate and gather the drift every so many steps, without storing a history.

    ``options`` are those of :func:`fastatt.propagate` but ``save_every``, ``on_save`` and
    ``progress``; 17 saves are in memory at a time, and 1 kB of counts a body. Energies and momenta
    are in relation to the largest of those 17.

    Raises ``ValueError`` or ``TypeError`` as ``propagate`` does.
    """
    for name in ("save_every", "on_save", "progress"):
        if name in options:
            raise TypeError(f"{name}: found; accepted: every, the steps between two looks")
    checks.whole("every", every, 1)
    found: dict[str, Measure] = {}
    saves = 0
    begin: dict[str, NDArray[Any]] = {}

    def since_begin(name: str, values: NDArray[Any]) -> Any:
        """The values with those of the initial save before them."""
        if saves:
            return np.concatenate([begin[name], values])
        begin[name] = values[:1].copy()
        return values

    def take(piece: Trajectory) -> None:
        nonlocal saves
        carried = {name: since_begin(name, x) for name, x in piece.carried.items()}
        rest = {
            name: since_begin(name, getattr(piece, name)) for name in ("t", "state", "norm_error")
        }
        piece = replace(piece, carried=carried, **rest)
        measured = drift(piece, scene)
        saves += piece.t.size - 1
        for name in ("norm", "orthogonality", "energy", "momentum"):
            values = getattr(measured, name)
            if values is not None:
                rows = values.reshape(piece.t.size, -1)[1:]
                found.setdefault(name, Measure(rows.shape[1])).add(rows)

    last = propagate(scene, q0, w0, save_every=every, on_save=take, **options)
    return DriftStatistics(
        norm=found["norm"],
        orthogonality=found["orthogonality"],
        energy=found.get("energy"),
        momentum=found.get("momentum"),
        saves=saves,
        trajectory=last,
    )
