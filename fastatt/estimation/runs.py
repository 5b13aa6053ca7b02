"""The derivative of a whole run, and its transpose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.estimation import tangent
from fastatt.estimation.derivatives import of_body, tangent_rows
from fastatt.methods import Method
from fastatt.propagation.propagate import propagate
from fastatt.propagation.trajectory import Trajectory
from fastatt.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class RunTangent:
    """What becomes of small changes over a run: the product of its steps' transitions.

    ``steps`` (S, ..., K, K), the first step's first; those of ``sample_transitions(...).matrix``
    take (δθ, δb) over a gyro log. Of the K numbers the first D = ``size`` are those of a change;
    the others, 0 before the run and left out after it, are internal to the steps: those of
    :func:`run_tangent` take (δθ, δm, δs), δs the relative change of a quaternion's length.
    """

    steps: NDArray[Any]
    size: int | None = None

    @cached_property
    def matrix(self) -> NDArray[Any]:
        """A = Φ_S … Φ_2 Φ_1, (..., D, D)."""
        found = np.broadcast_to(np.eye(self.steps.shape[-1]), self.steps.shape[1:])
        for step in self.steps:
            found = step @ found
        return np.asarray(found[..., : self.size, : self.size])

    def tangent(self, before: ArrayLike) -> NDArray[Any]:
        """A x: the change (..., D) after the run from that before it, without the matrix A."""
        x = self._change("before", before)
        for step in self.steps:
            x = step @ x
        return x[..., : self.size, 0]

    def adjoint(self, after: ArrayLike) -> NDArray[Any]:
        """Aᵀ y: the gradient (..., D) to the state before from that to the state after."""
        y = self._change("after", after)
        for step in self.steps[::-1]:
            y = np.swapaxes(step, -1, -2) @ y
        return y[..., : self.size, 0]

    def _change(self, name: str, value: ArrayLike) -> NDArray[Any]:
        whole = self.steps.shape[-1]
        size = self.size or whole
        found = checks.array(name, value, f"(..., {size})", [(size,), (-1, size)])
        return np.pad(found, [(0, 0)] * (found.ndim - 1) + [(0, whole - size)])[..., None]


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
    """A run of rigid bodies, every step of it, and its derivative.

    With δm = I δw it takes (δθ, δm) at the start to those at the end, exact but for rounding: the
    product of the derivatives of the method's steps, along the quaternions of the run before
    they are normalised, whose length a Runge-Kutta method changes. 49 numbers a step and body are
    kept. Arguments are those of ``fastatt.propagate``; without ``method``, ``rk8``.

    Raises ``ValueError`` or ``TypeError`` as :func:`body_tangent` and ``fastatt.propagate`` do.

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
    run, stepped = (
        propagate(
            scene, q0, w0, dt=dt, n_steps=n_steps, method=record, save_every=1, t0=t0,
            dtype=np.float64, n_threads=n_threads, normalise=normalise,
        )
        for normalise in ("output", "never")
    )  # fmt: skip
    q, w = ((x[:, None] if run.one_body else x)[:-1] for x in (stepped.q, stepped.w))
    *_, full = tangent_rows(record, packed, (run.t[:-1, None], run.dt), (q, w), n_threads)
    return run, RunTangent(full[:, 0] if run.one_body else full, size=tangent.UNIT)
