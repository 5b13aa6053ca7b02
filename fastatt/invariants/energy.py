"""Energy and angular momentum of one body or many."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import quat_rotate
from fastatt.attitudes import QUATERNION
from fastatt.codegen.rows import rows
from fastatt.scene.equations import Body, RigidBody
from fastatt.scene.inertia import is_tensor
from fastatt.scene.scene import Scene
from fastatt.scene.torque_record import CoupledStates, Pose, potential_of
from fastatt.tracing.formulas import quat


def angular_momentum(
    w: ArrayLike, inertia: ArrayLike, q: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Angular momentum I w along body axes, or along inertial axes if attitudes are given.

    Parameters
    ----------
    w : array_like of shape (3,), (N, 3) or (S, N, 3)
        Angular velocities along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments or tensors, kg·m², as in :class:`Scene`.
    q : array_like of shape (4,), (N, 4) or (S, N, 4), optional
        Attitudes, body to inertial. If given, the result is along inertial axes.

    Returns
    -------
    ndarray of shape (3,), (N, 3) or (S, N, 3)
        Angular momentum, N·m·s; NaN for a body whose angular velocity is not finite.

    Raises
    ------
    ValueError
        If the shapes do not fit each other.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.angular_momentum([0.5, 0.0, 2.0], (2.0, 1.0, 0.5)).tolist()
    [1.0, 0.0, 1.0]
    """
    rates = checks.array("w", w, "(3,), (N, 3) or (S, N, 3)", flag=True)
    moments = checks.array("inertia", inertia, "(3,), (3, 3), (N, 3) or (N, 3, 3)")
    tensor = is_tensor(moments)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            m = np.einsum("...ij,...j->...i", moments, rates) if tensor else moments * rates
        return np.asarray(m if q is None else quat_rotate(q, m))
    except ValueError:
        raise ValueError(
            f"w: has shape {rates.shape}, inertia {moments.shape}, q {np.asarray(q).shape}; "
            "accepted: one number of bodies"
        ) from None


def kinetic_energy(w: ArrayLike, inertia: ArrayLike) -> NDArray[np.float64]:
    """Rotational kinetic energy ½ w·I w.

    Parameters
    ----------
    w : array_like of shape (3,), (N, 3) or (S, N, 3)
        Angular velocities along body axes, rad/s.
    inertia : array_like of shape (3,), (N, 3), (3, 3) or (N, 3, 3)
        Principal moments or tensors, kg·m², as in :class:`Scene`.

    Returns
    -------
    ndarray of shape (), (N,) or (S, N)
        Kinetic energy, J; NaN for a body whose angular velocity is not finite.

    Raises
    ------
    ValueError
        If the shapes do not fit each other.

    Examples
    --------
    >>> import fastatt as fa
    >>> float(fa.kinetic_energy([0.5, 0.0, 2.0], (2.0, 1.0, 0.5)))
    1.25
    """
    m = angular_momentum(w, inertia)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(
            0.5 * np.einsum("...i,...i->...", np.asarray(w, np.float64, order="C"), m)
        )


def potential_energy(
    scene: Scene, q: ArrayLike, t: ArrayLike = 0.0, r: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Potential energy, J, (), (N,) or (S, N), of a scene that has one, 0 without a torque.

    If it depends on the position ``r``, m, along inertial axes, that of torque and force together.
    """
    q = np.asarray(q)
    attitudes = np.reshape(q, (-1, *((1, *q.shape)[-2:])))
    packed = scene.packed(attitudes.shape[1] if q.ndim > 1 else 1)
    rotation = packed.structure.rotation
    shape = (*attitudes.shape[:-1], 3)
    positions = np.zeros(shape) if r is None else np.reshape(r, shape)
    times = np.broadcast_to(np.asarray(t, np.float64), attitudes.shape[:1])
    p = packed.params[..., : rotation.n_params]
    inputs = {"t": None, "q": 4, "r": 3, "p": rotation.n_params}
    potential = rows(partial(_potential, rotation), inputs, (None,), key=(_potential, rotation))
    (energies,) = potential(times[:, None], attitudes, positions, p, tables=packed.tables)
    return np.asarray(energies).reshape(q.shape[:-1])


def _potential(structure: RigidBody, t: Any, q: Any, r: Any, p: Any) -> Any:
    """Potential energy at an attitude of the body axes and a position."""
    motion, q = Body(QUATERNION, structure, p, q[0]), quat.normalise(q)
    if motion.axes is not None:
        q = quat.mul(q, motion.axes)
    none = (0.0, 0.0, 0.0)
    pose = Pose(QUATERNION, q, none, motion.moments, CoupledStates(none, r), motion.axes_given)
    return (potential_of(structure.law, t, pose, motion.torque_numbers),)
