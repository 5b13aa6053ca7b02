"""Motions of sigma points.

A motion steps an ensemble with attitudes (M, 4) and auxiliary states (M, K):
``motion(q, y) -> (q, y)``. ``gyro_motion`` and ``scene_motion`` make motions, and users may define
others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.arrays import angles_of, length_shorter, normalised
from fastatt.estimation.filters import Floats, turned
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.propagate import propagate
from fastatt.scene.scene import Scene, as_scene
from fastatt.threads import number_of

Motion = Callable[[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class TimedMotion:
    """A motion over some seconds, with rates that differ as the first auxiliary numbers do."""

    motion: Motion
    seconds: float

    def __call__(self, q: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Attitudes and auxiliary states after the motion."""
        return self.motion(q, y)


def gyro_motion(gyro: ArrayLike, dt: float) -> Motion:
    """Return the motion at the rate of a gyro sample minus the bias.

    The bias is the first three numbers of the auxiliary state.

    Parameters
    ----------
    gyro : array_like of shape (3,) or (N, 3)
        Gyro sample, rad/s, held for ``dt``, or one for each of N filters, whose points follow each
        other in equal numbers.
    dt : float
        Interval, s.

    Returns
    -------
    Motion
        A function ``motion(q, y) -> (q, y)`` of attitudes (M, 4) and auxiliary states (M, K), for
        :meth:`UKF.predict`.

    Examples
    --------
    >>> import numpy as np
    >>> import fastatt as fa
    >>> motion = fa.estimation.gyro_motion((0.0, 0.0, 0.5), 0.1)
    >>> q, y = motion(np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)), np.zeros((5, 3)))
    >>> q.shape, y.shape
    ((5, 4), (5, 3))
    """
    samples = np.atleast_2d(checks.array("gyro", gyro, "(3,) or (N, 3)"))
    h = checks.real("dt", dt, zero=False)

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        q, y = _points(q, y, "a bias")
        if len(q) % len(samples):
            raise ValueError(
                f"q: found {len(q)} points; accepted: equal numbers for each of the "
                f"{len(samples)} gyro samples"
            )
        each = np.repeat(samples, len(q) // len(samples), axis=0)
        u = angles_of("gyro", h * (each - y[:, :3]), length_shorter)
        return turned(normalised(q), u), y

    return TimedMotion(motion, abs(h))


def scene_motion(
    scene: Scene,
    dt: float,
    n_steps: int,
    *,
    method: str | None = None,
    t0: float = 0.0,
    n_threads: int | None = None,
) -> Motion:
    """Return the motion of a scene over some steps.

    Parameters
    ----------
    scene : Scene
        A scene with inertia or with a rate.
    dt : float
        Step size, s.
    n_steps : int
        Number of steps.
    method : str or Method, optional
        The method, as in :func:`fastatt.propagate`.
    t0 : float, default 0.0
        Time at which the motion begins, s.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.

    Returns
    -------
    Motion
        A function ``motion(q, y) -> (q, y)`` of attitudes (M, 4) and auxiliary states (M, K). For a
        scene with inertia the first three auxiliary numbers are the angular velocity along body
        axes, rad/s.
    """
    carries = as_scene(scene).kind != "rate"
    record, begin = method_of(scene, method, "quat"), checks.real("t0", t0)
    steps, threads = checks.whole("n_steps", n_steps, 0), number_of(n_threads)

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        q, y = _points(q, y, "an angular velocity" if carries else "")
        moved = propagate(
            scene, q, y[:, :3] if carries else None, dt=dt, n_steps=steps, method=record, t0=begin,
            n_threads=threads,
        )  # fmt: skip
        return moved.q[-1], np.hstack([moved.w[-1], y[:, 3:]]) if carries else y

    seconds = abs(checks.real("dt", dt, zero=False)) * steps
    return TimedMotion(motion, seconds if carries else 0.0)


def _points(q: ArrayLike, y: ArrayLike, first: str) -> tuple[Floats, Floats]:
    """Attitudes and auxiliary states, whose first three numbers are ``first``, if it is given."""
    attitudes = checks.attitudes("q", q, "(M, 4)").astype(np.float64)
    states = checks.array("y", y, f"({len(attitudes)}, K)").astype(np.float64)
    if first and states.shape[1] < 3:
        raise ValueError(
            f"y: has shape {states.shape}; accepted: {first} of three numbers in each row"
        )
    return attitudes, states


def moved_rows(motion: Motion, q: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Checked results of a motion: unit quaternions (M, 4) and auxiliary states (M, K)."""
    accepted = "a function motion(q, y) -> (q, y)"
    moved: Any = checks.function("motion", motion, accepted)(q, y)
    if not isinstance(moved, (tuple, list)) or len(moved) != 2:
        raise TypeError(f"motion: returns {checks.brief(moved)}; accepted: {accepted}")
    attitudes = checks.attitudes("motion: q", moved[0], f"({len(q)}, 4)")
    numbers = checks.array("motion: y", moved[1], str(y.shape))
    return normalised(attitudes), numbers.astype(np.float64)
