"""Drift statistics gathered during a run, in a fixed amount of memory for each body."""

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

# the bins are powers of 2, from below the round-off of float64 to errors of any size
_LOWEST, _BINS = -56, 64


class Measure:
    """One measure of the drift at the saves of every body: its maximum and a histogram.

    The histogram has 64 bins, each a factor of 2 wide, and takes 256 bytes for each body.

    Attributes
    ----------
    maximum : ndarray of shape (N,)
        The largest value of each body.
    """

    def __init__(self, n_bodies: int) -> None:
        self.maximum = np.zeros(n_bodies)
        self._counts: NDArray[Any] = np.zeros((n_bodies, _BINS), dtype=np.uint32)

    def __repr__(self) -> str:
        worst = self.maximum.max(initial=0.0)
        return f"Measure({self.maximum.size} bodies, at most {worst:.3g})"

    @classmethod
    def joined(cls, parts: Sequence[Measure]) -> Measure:
        """The saves of several groups as those of one; a body without results is infinite."""
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
        """Add the values (S, N) of some saves."""
        self.maximum = np.maximum(self.maximum, values.max(axis=0, initial=0.0))
        with np.errstate(divide="ignore"):
            power = np.nan_to_num(np.log2(values), nan=_BINS, posinf=_BINS, neginf=_LOWEST)
        place = np.clip(np.floor(power).astype(np.int64) - _LOWEST, 0, _BINS - 1)
        n = self.maximum.size
        flat = (place + _BINS * np.arange(n)).ravel()
        self._counts += np.bincount(flat, minlength=n * _BINS).reshape(n, _BINS).astype(np.uint32)

    def percentile(self, percent: float) -> NDArray[np.float64]:
        """The value that a given percentage of a body's saves do not exceed.

        Parameters
        ----------
        percent : float
            Percentage, 0 to 100.

        Returns
        -------
        ndarray of shape (N,)
            The percentile of each body, right to a factor of 2.

        Raises
        ------
        ValueError
            If ``percent`` is not between 0 and 100.
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
    """The drift of a run over its saves, as :func:`drift_statistics` gathers it.

    Attributes
    ----------
    norm, orthogonality : Measure
        Norm and orthogonality errors, as :class:`Drift` defines them.
    energy, momentum : Measure or None
        Relative changes of energy and angular momentum; None if the scene does not conserve them.
    saves : int
        Number of saves.
    trajectory : Trajectory
        The final state and the status.
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
    save_every: int,
    **options: Any,
) -> DriftStatistics:
    """Propagate and collect statistics of the drift without storing a history.

    The run holds 17 saves at a time in memory, and 1 kB of counts for each body.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3), optional
        Initial angular velocities along body axes, rad/s.
    save_every : int
        Number of steps between two saves at which the drift is measured.
    **options : dict
        Further arguments of :func:`fastatt.propagate`, except ``on_save`` and ``progress``.

    Returns
    -------
    DriftStatistics
        The largest value and a histogram of each measure, for each body. Changes of energy and
        momentum are relative to the largest values of the 17 saves in memory.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`fastatt.propagate`.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> found = fa.drift_statistics(
    ...     body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.1, n_steps=100, save_every=10
    ... )
    >>> found.saves, bool(found.energy.maximum.max() < 1e-13)
    (10, True)
    """
    for name in ("on_save", "progress"):
        if name in options:
            raise TypeError(f"{name}: found; accepted: save_every alone")
    checks.whole("save_every", save_every, 1)
    found: dict[str, Measure] = {}
    saves = 0
    begin: dict[str, NDArray[Any]] = {}

    def since_begin(name: str, values: NDArray[Any]) -> Any:
        """The values together with those of the initial save."""
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

    last = propagate(scene, q0, w0, save_every=save_every, on_save=take, **options)
    return DriftStatistics(
        norm=found["norm"],
        orthogonality=found["orthogonality"],
        energy=found.get("energy"),
        momentum=found.get("momentum"),
        saves=saves,
        trajectory=last,
    )
