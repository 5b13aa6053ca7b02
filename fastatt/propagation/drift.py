"""The drift of a trajectory: the change of quantities that the exact motion conserves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import angle_between, quat_rotate
from fastatt.attitudes.attitude import same
from fastatt.propagation.energy import angular_momentum, kinetic_energy, potential_energy
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.reaction_wheels import ReactionWheels
from fastatt.scene.scene import Scene, as_scene
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Torque


@dataclass(frozen=True, eq=False)
class Drift:
    """The drift of a trajectory, as :func:`drift` measures it.

    Each array is (S, N), or (S,) for one body.

    Attributes
    ----------
    norm : ndarray
        The norm error ``||q| − 1|`` of the propagated state, before it was projected for output.
    orthogonality : ndarray
        The orthogonality error ‖C Cᵀ − 1‖ (Frobenius norm) of the propagated state, before it was
        projected for output.
    energy : ndarray or None
        The change of kinetic plus potential energy since the first save, relative to the largest
        kinetic energy of all saves. The kinetic energy is that of the rotation, and also that of
        the translation if the torque depends on the position. None if the torque has no potential,
        or for a rate scene.
    momentum : ndarray or None
        The length of the change of the angular momentum along inertial axes, wheels included, since
        the first save, relative to the largest angular momentum of all saves. None under a torque.
    trajectory : Trajectory
        The trajectory.
    """

    norm: NDArray[Any]
    orthogonality: NDArray[Any]
    energy: NDArray[Any] | None
    momentum: NDArray[Any] | None
    trajectory: Trajectory

    def angle_to(self, reference: ArrayLike) -> Any:
        """Geodesic angle between the trajectory's attitudes and reference attitudes.

        Parameters
        ----------
        reference : array_like
            Quaternions or rotation matrices, in a shape that broadcasts against the trajectory's.

        Returns
        -------
        ndarray
            The angle, rad.
        """
        return angle_between(self.trajectory.q, reference)


def drift(run: Trajectory, scene: Scene) -> Drift:
    """Measure the drift of a trajectory from the invariants of its scene, for each save and body.

    Parameters
    ----------
    run : Trajectory
        A run with a history.
    scene : Scene
        The scene of the run.

    Returns
    -------
    Drift
        The norm and orthogonality errors, and the relative changes of energy and angular momentum.

    Raises
    ------
    TypeError
        If the arguments are not a trajectory and a scene.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.1, n_steps=100, save_every=50)
    >>> bool(fa.drift(run, body).energy.max() < 1e-13)
    True
    """
    if not isinstance(run, Trajectory):
        raise TypeError(f"run: found {checks.brief(run)}; accepted: a Trajectory")
    as_scene(scene)
    norm_error = np.abs(run.norm_error[:, 0] if run.one_body else run.norm_error)
    C = run.dcm
    matrix = np.sqrt(((C @ np.swapaxes(C, -1, -2) - np.eye(3)) ** 2).sum(axis=(-2, -1)))
    length = np.abs(np.linalg.norm(run.q, axis=-1) - 1.0)
    attitude = run.attitude
    of_matrix = attitude.to_dcm_array is not None
    of_quaternion = not of_matrix and attitude.to_quat_array in (None, same)
    return Drift(
        norm=norm_error if of_quaternion else length,
        orthogonality=norm_error if of_matrix else matrix,
        energy=_energy(run, scene),
        momentum=_momentum(run, scene),
        trajectory=run,
    )


def _energy(trajectory: Trajectory, scene: Scene) -> NDArray[Any] | None:
    if scene.inertia is None or not scene.has_potential:
        return None
    kinetic = kinetic_energy(trajectory.w, scene.inertia)
    q = trajectory.q[:, None] if trajectory.one_body else trajectory.q
    r = None
    with np.errstate(over="ignore", invalid="ignore"):
        if scene.reads_position:
            r = np.reshape(trajectory.r, (*q.shape[:-1], 3))
            v = trajectory.v.astype(np.float64)
            kinetic = kinetic + 0.5 * np.asarray(scene.mass) * (v * v).sum(axis=-1)
        total = kinetic + potential_energy(scene, q, trajectory.t, r).reshape(kinetic.shape)
        return _relative(np.abs(total - total[0]), kinetic)


def _momentum(trajectory: Trajectory, scene: Scene) -> NDArray[Any] | None:
    torque = scene.torque
    wheels = torque.wheel_momentum if isinstance(torque, Torque) else None
    is_driven = isinstance(torque, ReactionWheels)
    if scene.inertia is None or not (torque is None or wheels or is_driven):
        return None
    inside = angular_momentum(trajectory.w, scene.inertia)
    if isinstance(torque, ReactionWheels):
        inside = inside + torque.momentum(trajectory.s)
    elif wheels is not None:
        inside = inside + _of_wheels(wheels(), trajectory)
    total = quat_rotate(trajectory.q, inside)
    with np.errstate(over="ignore", invalid="ignore"):
        change = np.linalg.norm(total - total[0], axis=-1)
        return _relative(change, np.linalg.norm(total, axis=-1))


def _of_wheels(momentum: Any, trajectory: Trajectory) -> NDArray[Any]:
    """Angular momentum of wheels, which broadcasts against (S, N, 3), or (S, 3) for one body."""
    if not isinstance(momentum, TimeSeries):
        return np.asarray(momentum)
    found = momentum.at(trajectory.t)
    if trajectory.one_body:
        return found.reshape(-1, 3)
    return found if found.ndim == 3 else found[:, None]


def _relative(change: NDArray[Any], scale: NDArray[Any]) -> NDArray[Any]:
    most = scale.max(axis=0)
    return change / np.where(most > 0.0, most, 1.0)
