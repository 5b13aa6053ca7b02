"""The drift of a trajectory: the change of quantities that the exact motion conserves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt.arrays import angle_between, quat_rotate
from fastatt.attitudes.attitude import same
from fastatt.interchange.run_tables import check_run
from fastatt.invariants.energy import angular_momentum, kinetic_energy, potential_energy
from fastatt.scene.reaction_wheels import ReactionWheels
from fastatt.scene.scene import Scene, as_scene
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Torque, lever_of

if TYPE_CHECKING:
    from fastatt.propagation.trajectory import Trajectory

# why quantities are not conserved
_REASONS = {
    "energy": "no potential energy of the torque is known",
    "momentum": "a torque acts",
    "momentum_along_field": "no uniform field acts",
}
_OF_A_RATE = "the scene has a rate"


@dataclass(frozen=True, eq=False, repr=False)
class Drift:
    """The drift of a trajectory, as :func:`drift` measures it.

    Each array is (S, N), or (S,) for one body. ``print`` shows the largest values, and the reasons
    for those that are None.

    Attributes
    ----------
    norm : ndarray
        The norm error ``||q| − 1|`` of the propagated state, before it was renormalised.
    orthogonality : ndarray
        The orthogonality error ‖C Cᵀ − 1‖ (Frobenius norm) of the propagated state, before it was
        renormalised.
    energy : ndarray or None
        The change of kinetic plus potential energy since the first save, relative to the largest
        kinetic energy of all saves. The kinetic energy is that of the rotation, and also that of
        the translation if the torque depends on the position. None if the torque has no potential
        energy or its potential energy is not known, as that of a user-defined function, and for a
        rate scene.
    momentum : ndarray or None
        The length of the change of the angular momentum along inertial axes, wheels included, since
        the first save, relative to the largest angular momentum of a part, body or wheel, of all
        saves. None under a torque, and for a rate scene.
    momentum_along_field : ndarray or None
        The change of the component of the angular momentum along a uniform field, relative to the
        largest angular momentum of all saves: the vertical component for ``torques.HeavyTop``, and
        that along the field for ``torques.MagneticDipole``. None under other torques and for fields
        that change with time.
    reasons : dict
        For each quantity that is None, why the scene does not conserve it.
    trajectory : Trajectory
        The trajectory.
    """

    norm: NDArray[Any]
    orthogonality: NDArray[Any]
    energy: NDArray[Any] | None
    momentum: NDArray[Any] | None
    momentum_along_field: NDArray[Any] | None
    reasons: dict[str, str]
    trajectory: Trajectory

    def __repr__(self) -> str:
        n, saves = self.trajectory.status.size, self.trajectory.t.size
        lines = [f"Drift of {n} bod{'y' if n == 1 else 'ies'} over {saves} saves, largest values:"]
        for name in ("norm", "orthogonality", "energy", "momentum", "momentum_along_field"):
            values = getattr(self, name)
            told = f"None, {self.reasons[name]}" if values is None else f"{values.max():.1e}"
            lines.append(f"  {name:<20}  {told}")
        return "\n".join(lines)

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
        A run with two saves or more.
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
    ValueError
        If the run has one save only, to which nothing can be compared.

    Examples
    --------
    >>> import fastatt as fa
    >>> body = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    >>> run = fa.propagate(body, [1, 0, 0, 0], [0.1, 0.3, -0.2], dt=0.1, n_steps=100, save_every=50)
    >>> bool(fa.drift(run, body).energy.max() < 1e-13)
    True
    >>> print(fa.drift(run, body))  # doctest: +ELLIPSIS
    Drift of 1 body over 3 saves, largest values:
      norm                  ...
      orthogonality         ...
      energy                ...
      momentum              ...
      momentum_along_field  None, no uniform field acts
    """
    check_run(run)
    as_scene(scene)
    if len(run.t) < 2:
        raise ValueError(
            "run: has 1 save, to which nothing can be compared; accepted: two or more (save_every=)"
        )
    if not _is_of(run, scene):
        raise ValueError("scene: differs from that of the run; accepted: the scene of the run")
    norm_error = np.abs(run.norm_error[:, 0] if run.one_body else run.norm_error)
    C = run.dcm
    matrix = np.sqrt(((C @ np.swapaxes(C, -1, -2) - np.eye(3)) ** 2).sum(axis=(-2, -1)))
    length = np.abs(np.linalg.norm(run.q, axis=-1) - 1.0)
    attitude = run.attitude
    of_matrix = attitude.to_dcm_array is not None
    of_quaternion = not of_matrix and attitude.to_quat_array is same
    why, measured = dict.fromkeys(_REASONS, _OF_A_RATE), dict.fromkeys(_REASONS)
    if scene.inertia is not None:
        why = _REASONS
        with np.errstate(over="ignore", invalid="ignore"):
            measures = (_energy, _momentum, _along_field)
            measured = {x: f(run, scene) for x, f in zip(_REASONS, measures, strict=True)}
    return Drift(
        norm=norm_error if of_quaternion else length,
        orthogonality=norm_error if of_matrix else matrix,
        **measured,
        reasons={name: why[name] for name, values in measured.items() if values is None},
        trajectory=run,
    )


def _is_of(run: Trajectory, scene: Scene) -> bool:
    """Whether a run is of a scene, but for the parameters that a call of a plan may replace."""
    method, position = run.record, "r" in run.carried
    bodies = run.status.size
    packed = scene.packed(bodies, sorted_axes=method.sorted_axes, position=position)
    if run.packed is None:  # it was computed elsewhere
        return True
    if packed.structure != run.packed.structure:
        return False
    end = packed.structure.rotation.n_params
    user = 0 if scene.params is None else np.shape(scene.params)[-1]
    return all(
        np.array_equal(packed.params[..., part], run.packed.params[..., part])
        for part in (slice(0, end - user), slice(end, None))
    )


def _energy(trajectory: Trajectory, scene: Scene) -> NDArray[Any] | None:
    if not scene.has_potential:
        return None
    kinetic = kinetic_energy(trajectory.w, np.asarray(scene.inertia))
    q = trajectory.q[:, None] if trajectory.one_body else trajectory.q
    r = None
    if scene.reads_position:
        r = np.reshape(trajectory.r, (*q.shape[:-1], 3))
        v = trajectory.v.astype(np.float64)
        kinetic = kinetic + 0.5 * np.asarray(scene.mass) * (v * v).sum(axis=-1)
    total = kinetic + potential_energy(scene, q, trajectory.t, r).reshape(kinetic.shape)
    return _relative(np.abs(total - total[0]), kinetic)


def _momentum(trajectory: Trajectory, scene: Scene) -> NDArray[Any] | None:
    inside = angular_momentum(trajectory.w, np.asarray(scene.inertia))
    largest = np.linalg.norm(inside, axis=-1)
    for torque, place in scene.terms:
        wheels = torque.wheel_momentum if isinstance(torque, Torque) else None
        if isinstance(torque, ReactionWheels):
            momenta = trajectory.s[..., place.states]
            inside = inside + torque.momentum(momenta)
            of_wheel = np.abs(momenta[..., : np.shape(torque.axes)[-2]]).max(axis=-1)
            largest = np.maximum(largest, of_wheel)
        elif wheels is not None:
            of_wheels = _of_wheels(wheels(), trajectory)
            inside = inside + of_wheels
            largest = np.maximum(largest, np.linalg.norm(of_wheels, axis=-1))
        elif not place.term.model.exerts_nothing:
            return None
    total = quat_rotate(trajectory.q, inside)
    return _relative(np.linalg.norm(total - total[0], axis=-1), largest)


def _along_field(trajectory: Trajectory, scene: Scene) -> NDArray[Any] | None:
    lever = lever_of(scene.torque)
    if lever is None:
        return None
    field = lever[1]
    strength = np.linalg.norm(field, axis=-1, keepdims=True)
    total = quat_rotate(trajectory.q, angular_momentum(trajectory.w, np.asarray(scene.inertia)))
    along = (total * (field / np.where(strength > 0.0, strength, 1.0))).sum(axis=-1)
    return _relative(np.abs(along - along[0]), np.linalg.norm(total, axis=-1))


def _of_wheels(momentum: Any, trajectory: Trajectory) -> NDArray[Any]:
    """Angular momentum of wheels, which broadcasts against (S, N, 3), or (S, 3) for one body."""
    if not isinstance(momentum, TimeSeries):
        return np.asarray(momentum)
    momenta = momentum.at(trajectory.t)
    if trajectory.one_body:
        return momenta.reshape(-1, 3)
    return momenta if momenta.ndim == 3 else momenta[:, None]


def _relative(change: NDArray[Any], scale: NDArray[Any]) -> NDArray[Any]:
    most = scale.max(axis=0)
    return change / np.where(most > 0.0, most, 1.0)
