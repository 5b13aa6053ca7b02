"""How far a trajectory has drifted from what the exact motion keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between
from fastatt.scene import Scene
from fastatt.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Drift:
    """Departures from the invariants, each (S, N), or (S,) for one body.

    ``norm``: | |q| − 1 |; ``orthogonality``: ‖C Cᵀ − 1‖ (Frobenius); both of the propagated state,
    before it was brought back to the group for output. ``energy``, ``momentum``: None for a rate
    scene.
    """

    norm: NDArray[Any]
    orthogonality: NDArray[Any]
    energy: NDArray[Any] | None
    momentum: NDArray[Any] | None
    trajectory: Trajectory

    def angle_to(self, reference: ArrayLike) -> Any:
        """Geodesic angle to reference attitudes, rad; quaternions or matrices that broadcast."""
        return angle_between(self.trajectory.q, reference)


def drift(trajectory: Trajectory, scene: Scene) -> Drift:
    """Departures of a trajectory from its scene's invariants, per save and body.

    Raises ``TypeError`` when the arguments are not a trajectory and a scene.
    """
    if not isinstance(trajectory, Trajectory):
        raise TypeError(f"trajectory: found {checks.brief(trajectory)}; accepted: a Trajectory")
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    defect = np.abs(trajectory.defect[:, 0] if trajectory.one_body else trajectory.defect)
    C = trajectory.C
    matrix = np.sqrt(((C @ np.swapaxes(C, -1, -2) - np.eye(3)) ** 2).sum(axis=(-2, -1)))
    length = np.abs(np.linalg.norm(trajectory.q, axis=-1) - 1.0)
    of_quaternion = trajectory.representation == "quat"
    of_matrix = trajectory.representation in ("dcm", "dcm_rows")
    return Drift(
        norm=defect if of_quaternion else length,
        orthogonality=defect if of_matrix else matrix,
        energy=None,
        momentum=None,
        trajectory=trajectory,
    )
