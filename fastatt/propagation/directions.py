"""Directions that are fixed in inertial space, as a rotating body sees them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fastatt import checks
from fastatt.attitudes import DIRECTION
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import Choice, method_of
from fastatt.propagation.initial import Initial
from fastatt.propagation.plan import prepared
from fastatt.propagation.schedule import schedule_of
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of


def propagate_directions(
    scene: Scene,
    v0: ArrayLike,
    *,
    dt: float,
    n_steps: int,
    method: str | Method = "magnus4",
    save_every: int | None = None,
    dtype: DTypeLike | None = None,
    n_threads: int | None = None,
    t0: float = 0.0,
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Propagate directions that are fixed in inertial space, as the rotating body sees them.

    The vectors satisfy Poisson's equation v̇ = v×w, along body axes. If only directions are needed,
    such as that of a star or of gravity, this function propagates three numbers for each direction
    instead of an attitude. For a scene with ``frame="inertial"`` the vectors are fixed in the body,
    and their components are along inertial axes.

    Parameters
    ----------
    scene : Scene
        A scene with a rate, without inertia, mass or states.
    v0 : array_like of shape (3,), (M, 3) or (N, M, 3)
        Initial vectors, of any length: one, M for one body, or M for each of N bodies.
    dt : float
        Step size, s; negative propagates backwards.
    n_steps : int
        Number of steps, at least 0.
    method : str or Method, default "magnus4"
        A method for prescribed rates.
    save_every : int, optional
        Number of steps between saves, as in :func:`propagate`.
    dtype : {float64, float32}, optional
        Precision; the default is that of ``v0`` if it is a float32 array, and float64 otherwise.
    n_threads : int, optional
        Number of threads, as in :func:`propagate`.
    t0 : float, default 0.0
        Time of ``v0``, s.

    Returns
    -------
    t : ndarray of shape (S,)
        Times of the saves, s.
    v : ndarray of shape (S,) + v0.shape
        The vectors at these times.

    Raises
    ------
    ValueError, TypeError
        If the scene has inertia, mass or states, or if an argument does not fit, as in
        :func:`propagate`.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> scene = fa.Scene(rate=fa.rates.Constant((0.0, 0.0, 0.5)))
    >>> t, v = fa.propagate_directions(scene, [1.0, 0.0, 0.0], dt=0.1, n_steps=10)
    >>> np.allclose(v[-1], [np.cos(0.5), -np.sin(0.5), 0.0])
    True
    """
    if as_scene(scene).kind != "rate" or scene.is_coupled:
        raise ValueError(
            "scene: found inertia, mass or states; accepted: a scene with a rate alone"
        )
    record = method_of(scene, method, "quat")
    v = checks.array("v0", v0, "(3,), (M, 3) or (N, M, 3)")
    if v.ndim == 3 and scene.rows is not None:
        scene.packed(len(v))  # raises if the scene has another number of bodies
        scene = scene[np.repeat(np.arange(len(v)), v.shape[1])]
    start = Initial.of(v.reshape(-1, 3), {}, checks.precision(dtype, v0))
    t0 = checks.real("t0", t0)
    schedule = schedule_of(dt, n_steps, None, save_every, t0=t0)
    plan = prepared(scene, start.bodies, Choice(record, DIRECTION), schedule, start.q.dtype)
    flat = plan.run(start, t0, n_threads=number_of(n_threads))
    return flat.t, flat.state.reshape((flat.t.size, *v.shape))
