"""The derivative of a whole run, and its transpose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.estimation import tangent
from fastatt.estimation.derivatives import of_body, tangent_rows
from fastatt.methods import Method
from fastatt.propagation.breakpoints import breaks_within
from fastatt.propagation.propagate import propagate
from fastatt.propagation.schedule import schedule_of
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class RunTangent:
    """The derivative of a run: the product of the transitions of its steps.

    Parameters
    ----------
    steps : ndarray of shape (S, ..., K, K)
        Transitions, the first step's first. Those of ``sample_transitions(...).matrix`` give the
        derivative of (δθ, δb) over a gyro log.
    size : int, optional
        Number D of components of a change; the other K − D are internal to the steps, 0 before the
        run and left out after it. Those of :func:`run_tangent` are (δθ, δm, δs), with the relative
        change δs of a quaternion's norm.
    """

    steps: NDArray[Any]
    size: int | None = None

    @cached_property
    def matrix(self) -> NDArray[Any]:
        """A = Φ_S … Φ_2 Φ_1: (..., D, D)."""
        product = np.broadcast_to(np.eye(self.steps.shape[-1]), self.steps.shape[1:])
        for step in self.steps:
            product = step @ product
        return np.asarray(product[..., : self.size, : self.size])

    def tangent(self, before: ArrayLike) -> NDArray[Any]:
        """Change after the run, A x, without computing the matrix A.

        Parameters
        ----------
        before : array_like of shape (..., D)
            Change x before the run.

        Returns
        -------
        ndarray of shape (..., D)
            Change after the run.
        """
        x = self._change("before", before)
        for step in self.steps:
            x = step @ x
        return x[..., : self.size, 0]

    def adjoint(self, after: ArrayLike) -> NDArray[Any]:
        """Gradient with respect to the state before the run, Aᵀ y.

        Parameters
        ----------
        after : array_like of shape (..., D)
            Gradient y with respect to the state after the run.

        Returns
        -------
        ndarray of shape (..., D)
            Gradient with respect to the state before the run.
        """
        y = self._change("after", after)
        for step in self.steps[::-1]:
            y = np.swapaxes(step, -1, -2) @ y
        return y[..., : self.size, 0]

    def _change(self, name: str, value: ArrayLike) -> NDArray[Any]:
        whole = self.steps.shape[-1]
        size = self.size or whole
        change = checks.array(name, value, f"(..., {size})", [(size,), (-1, size)])
        return np.pad(change, [(0, 0)] * (change.ndim - 1) + [(0, whole - size)])[..., None]


def run_tangent(
    scene: Scene,
    q0: ArrayLike,
    w0: ArrayLike,
    *,
    dt: float,
    n_steps: int,
    method: str | Method | None = None,
    t0: float = 0.0,
    n_threads: int | None = None,
) -> tuple[Trajectory, RunTangent]:
    """Propagate rigid bodies, save every step, and compute the derivative of the run.

    Parameters
    ----------
    scene : Scene
        A scene with inertia.
    q0 : array_like of shape (4,) or (N, 4)
        Initial attitudes, as in :func:`fastatt.propagate`.
    w0 : array_like of shape (3,) or (N, 3)
        Initial angular velocities along body axes, rad/s.
    dt : float
        Step size, s.
    n_steps : int
        Number of steps.
    method : str or Method, optional
        The method; the default is rk8.
    t0 : float, default 0.0
        Time of the initial state, s.
    n_threads : int, optional
        Number of threads, as in :func:`fastatt.propagate`.

    Returns
    -------
    run : Trajectory
        The run, with every step saved.
    tangent : RunTangent
        The derivative of (δθ, δm) at the end by that at the start, δm = I δw.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`body_tangent` and :func:`fastatt.propagate`, or if
        breakpoints lie in the run.

    Notes
    -----
    The derivative is exact to rounding. It is the product of the derivatives of the method's steps
    along the quaternions before they are normalised, whose norm a Runge-Kutta method changes. 49
    numbers are kept for each step and body.

    Examples
    --------
    >>> import fastatt as fa
    >>> from fastatt import estimation as es
    >>> body = fa.Scene(inertia=(2.0, 1.0, 1.4))
    >>> run, whole = es.run_tangent(
    ...     body, [1, 0, 0, 0], [0, 0, 1], dt=0.1, n_steps=10, method="strang2"
    ... )
    >>> print(f"{whole.matrix[2, 5]:.3f}")  # a larger momentum about z is ahead after 1 s
    0.714
    """
    record, packed = of_body(scene, method)
    checks.real("dt", dt)
    checks.whole("n_steps", n_steps, 0)
    run, stepped = (
        propagate(
            scene, q0, w0, dt=dt, n_steps=n_steps, method=record, save_every=1, t0=t0,
            dtype=np.float64, n_threads=n_threads, normalise=normalise,
        )
        for normalise in ("output", "never")
    )  # fmt: skip
    _refuse_parts(scene, run)
    q, w = ((x[:, None] if run.one_body else x)[:-1] for x in (stepped.q, stepped.w))
    *_, full = tangent_rows(record, packed, (run.t[:-1, None], run.dt), (q, w), n_threads)
    return run, RunTangent(full[:, 0] if run.one_body else full, size=tangent.UNIT)


def _refuse_parts(scene: Scene, run: Trajectory) -> None:
    """Raise ``ValueError`` for a run across breakpoints, or whose steps corners divide."""
    first, last = sorted(run.t[[0, -1]].tolist())
    clock, begin = schedule_of(run.dt, len(run.t) - 1), float(run.t[0])
    legs = clock.legs(clock.h, breaks_within(scene, begin, clock.duration))
    if any(first <= x <= last for x in scene.breakpoints) or (legs["dt"] != clock.h).any():
        raise ValueError(
            "scene: found breakpoints, or times of a table within steps; accepted: a run "
            "between breakpoints, and steps that end at the times of the table"
        )
