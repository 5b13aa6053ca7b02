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
from fastatt.arrays import normalised
from fastatt.estimation.filters import Floats
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.propagate import propagate
from fastatt.scene import rates
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


def gyro_motion(gyro: ArrayLike, dt: float, *, n_threads: int | None = None) -> Motion:
    """Return the motion at the rate of a gyro sample minus the bias.

    The bias is the first three numbers of the auxiliary state.

    Parameters
    ----------
    gyro : array_like of shape (3,) or (N, 3)
        Gyro sample, rad/s, held for ``dt``, or one for each of N filters, whose points follow each
        other in equal numbers.
    dt : float
        Interval, s.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.

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
    sample = checks.array("gyro", gyro, "(3,) or (N, 3)")
    seconds, threads = abs(checks.real("dt", dt, zero=False)), number_of(n_threads)

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        q, y = _points(q, y)
        if y.shape[1] < 3:
            raise ValueError(
                f"y: has shape {y.shape}; accepted: a bias of three numbers in each row"
            )
        each = sample
        if sample.ndim == 2:
            if len(q) % len(sample):
                raise ValueError(
                    f"q: found {len(q)} points; accepted: equal numbers for each of the "
                    f"{len(sample)} gyro samples"
                )
            each = np.repeat(sample, len(q) // len(sample), axis=0)
        scene = Scene(rate=rates.Constant(each - y[:, :3]))
        moved = propagate(scene, q, dt=dt, n_steps=1, method="lie_euler", n_threads=threads)
        return moved.q[-1], y

    return TimedMotion(motion, seconds)


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
        q, y = _points(q, y)
        if carries and y.shape[1] < 3:
            raise ValueError(
                f"y: has shape {y.shape}; accepted: an angular velocity of three numbers in each "
                "row"
            )
        moved = propagate(
            scene, q, y[:, :3] if carries else None, dt=dt, n_steps=steps, method=record, t0=begin,
            n_threads=threads,
        )  # fmt: skip
        return moved.q[-1], np.hstack([moved.w[-1], y[:, 3:]]) if carries else y

    seconds = abs(checks.real("dt", dt, zero=False)) * steps
    return TimedMotion(motion, seconds if carries else 0.0)


def _points(q: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    attitudes = checks.attitudes("q", q, "(M, 4)").astype(np.float64)
    return attitudes, checks.array("y", y, f"({len(attitudes)}, K)").astype(np.float64)


def moved_rows(motion: Motion, q: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Checked results of a motion: unit quaternions (M, 4) and auxiliary states (M, K)."""
    accepted = "a function motion(q, y) -> (q, y)"
    found: Any = checks.function("motion", motion, accepted)(q, y)
    if not isinstance(found, (tuple, list)) or len(found) != 2:
        raise TypeError(f"motion: returns {checks.brief(found)}; accepted: {accepted}")
    attitudes = checks.attitudes("motion: q", found[0], f"({len(q)}, 4)")
    numbers = checks.array("motion: y", found[1], str(y.shape))
    return normalised(attitudes), numbers.astype(np.float64)
