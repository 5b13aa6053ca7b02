"""Parts that filters share: motions of sigma points and particles, errors, means, updates.

A motion steps an ensemble, attitudes (M, 4) and auxiliary states (M, K): ``motion(q, y) -> (q,
y)``. ``gyro_motion``, ``scene_motion`` or a user-defined function gives one.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, quat_to_rotation_vector
from fastatt.estimation.amounts import (
    attitude_covariance,
    common_number,
    covariances,
    largest_square,
    root,
    variance,
)
from fastatt.estimation.updates import operation
from fastatt.propagation.propagate import propagate
from fastatt.scene import rates
from fastatt.scene.scene import Scene

Floats = NDArray[np.float64]
Motion = Callable[[Floats, Floats], tuple[Floats, Floats]]


@dataclass(frozen=True)
class TimedMotion:
    """A motion of so many s, at rates that differ as the first auxiliary numbers do."""

    motion: Motion
    seconds: float

    def __call__(self, q: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Attitudes and auxiliary states after the motion."""
        return self.motion(q, y)


def gyro_motion(gyro: ArrayLike, dt: float, *, n_threads: int | None = None) -> Motion:
    """The motion at a gyro's rate less the bias, the first three auxiliary numbers.

    ``gyro`` (3,), rad/s, is held for dt s; (N, 3) are the rates of N filters, whose points follow
    each other in equal numbers.
    """
    sample = checks.array("gyro", gyro, "(3,) or (N, 3)")

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        if y.shape[1] < 3:
            raise ValueError(
                f"y: has shape {y.shape}; accepted: a bias of three numbers in each row"
            )
        each = np.repeat(sample, len(q) // len(sample), axis=0) if sample.ndim == 2 else sample
        scene = Scene(rate=rates.Constant(each - y[:, :3]))
        moved = propagate(scene, q, dt=dt, n_steps=1, method="lie_euler", n_threads=n_threads)
        return moved.q[-1], y

    return TimedMotion(motion, abs(checks.real("dt", dt)))


def scene_motion(
    scene: Scene,
    dt: float,
    n_steps: int,
    *,
    method: str | None = None,
    t0: float = 0.0,
    n_threads: int | None = None,
) -> Motion:
    """The motion of a scene with inertia, or of one at a given rate, for n_steps of dt s.

    The first three auxiliary numbers of a body are its angular velocity, rad/s, along body axes.
    """
    carries = scene.kind != "rate"

    def motion(q: Floats, y: Floats) -> tuple[Floats, Floats]:
        moved = propagate(
            scene, q, y[:, :3] if carries else None, dt=dt, n_steps=n_steps, method=method, t0=t0,
            n_threads=n_threads,
        )  # fmt: skip
        return moved.q[-1], np.hstack([moved.w[-1], y[:, 3:]]) if carries else y

    seconds = abs(checks.real("dt", dt)) * checks.whole("n_steps", n_steps, 0)
    return TimedMotion(motion, seconds if carries else 0.0)


def attitude_error(q: ArrayLike, q_true: ArrayLike) -> Floats:
    """δθ (..., 3), rad, of q_true = q∘exp(δθ), of quaternions of any length but zero.

    Raises ``ValueError`` for a zero quaternion.
    """
    conjugate = _not_zero("q", q) * (1.0, -1.0, -1.0, -1.0)
    return quat_to_rotation_vector(quat_multiply(conjugate, _not_zero("q_true", q_true)))


def _not_zero(name: str, q: ArrayLike) -> Floats:
    found = np.asarray(q, dtype=np.float64)
    if not found.any(axis=-1).all():
        raise ValueError(f"{name}: found a zero quaternion; accepted: of any other length")
    return found


def normalised_square(d: Floats, P: Floats) -> Floats:
    """dᵀ P⁻¹ d of rows d (..., D) and covariances (..., D, D), by |L⁻¹ d|²: never below 0."""
    L, size = root(P), d.shape[-1]
    found = np.zeros(np.broadcast_shapes(d.shape[:-1], P.shape[:-2]))
    left = np.array(np.broadcast_to(d, (*found.shape, size)))
    for k in range(size):
        x, pivot = left[..., k], L[..., k, k]
        u = np.divide(x, pivot, where=pivot != 0.0, out=np.zeros(found.shape))
        # what has no variance is 0, or beyond all bounds
        found += np.where((pivot == 0.0) & (x != 0.0), np.inf, u * u)
        left -= L[..., :, k] * u[..., None]
    return found


def mean_attitude(q: ArrayLike, weights: ArrayLike | None = None) -> Floats:
    """Mean of attitudes (..., M, 4), weighted (..., M): the eigenvector of Σ w q qᵀ, (..., 4).

    It minimises the weighted sum of squares of the matrices' distances; q and −q count the same,
    quaternions of any length as of unit length, and of the two means the one with scalar ≥ 0 is
    given. Markley, Cheng, Crassidis and Oshman, J. Guidance 30 (2007) 1193, eq. 12.

    Raises ``ValueError`` for attitudes that are no quaternions or have no one mean, such as two
    that are π rad apart, and for weights that do not fit, are negative or all 0.

    >>> import fastatt as fa
    >>> fa.mean_attitude([[1, 0, 0, 0], [0, 0, 0, 1]], weights=[1, 0])
    array([1., 0., 0., 0.])
    """
    rows = np.asarray(q, dtype=np.float64)
    if rows.ndim < 2 or rows.shape[-1] != 4 or rows.shape[-2] == 0:
        raise ValueError(f"q: has shape {rows.shape}; accepted: (..., M, 4)")
    checks.finite("q", rows)
    weighted = rows = normalised(_not_zero("q", rows))
    if weights is not None:
        w = np.asarray(weights, dtype=np.float64)
        if w.shape[-1:] != rows.shape[-2:-1]:
            raise ValueError(f"weights: has shape {w.shape}; accepted: (..., {rows.shape[-2]})")
        checks.finite("weights", w)
        if (w < 0.0).any() or not w.any(axis=-1).all():
            raise ValueError(
                f"weights: found {w.min():g} to {w.max():g}; accepted: at least 0, and some above"
            )
        weighted = rows * (w / w.max(axis=-1, keepdims=True))[..., None]
    values, vectors = np.linalg.eigh(np.swapaxes(weighted, -1, -2) @ rows)
    if (values[..., -1] - values[..., -2] <= 1e-14 * values[..., -1]).any():
        raise ValueError("q: has no one mean; accepted: attitudes that do not weigh each other out")
    found = vectors[..., -1]
    return np.asarray(np.where(found[..., :1] < 0.0, -found, found))


def moved_rows(q: ArrayLike, y: ArrayLike, shape: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Checked results of a motion: unit quaternions (M, 4) and auxiliary states (M, K)."""
    attitudes = checks.attitudes("motion: q", q, f"({shape[0]}, 4)")
    return normalised(attitudes), checks.array("motion: y", y, str(shape)).astype(np.float64)


def unit_rows(value: NDArray[Any], n: int) -> Floats:
    """n rows of unit quaternions, of one or n of any length but zero."""
    return rows_of(normalised(value), (n, 4))


def rows_of(value: NDArray[Any], shape: tuple[int, ...]) -> Floats:
    """A new array of a shape, from one row or all of them."""
    return np.array(np.broadcast_to(value, shape), dtype=np.float64, order="C")


class _Call(NamedTuple):
    """An operation on a filter's arrays: each one's own numbers, those shared, two figures."""

    run: Callable[[], object]
    own: Floats
    shared: Floats
    nis: Floats
    nonlinearity: Floats


class Estimates:
    """Attitudes, auxiliary states and covariances of (δθ, δy), of one filter or of N."""

    def __init__(
        self, q: ArrayLike, name: str, y: NDArray[Any], covariance: ArrayLike, invalid: str
    ) -> None:
        """``name`` is what the numbers y, (K,) or (N, K), are called."""
        start, size = checks.attitudes("q", q), 3 + y.shape[-1]
        shapes = f"({size}, {size}) or (N, {size}, {size})"
        P = covariances("covariance", covariance, shapes)
        given = {"q": (start, 1), name: (y, 1), "covariance": (P, 2)}
        many = {name: x for name, (x, one) in given.items() if x.ndim > one}
        n = common_number("filters", **many) if many else 1
        self._one, self._name = not many, name
        # changed in place: calls hold their addresses
        self._q, self._y = unit_rows(start, n), rows_of(y, (n, size - 3))
        self._P = rows_of(P, (n, size, size))
        self._skips = checks.choice("invalid", invalid, ("raise", "skip")) == "skip"
        self._calls: dict[str, _Call] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_calls": {}}

    def _each(self, rows: Floats) -> Floats:
        """The rows or, of one filter, its own."""
        return np.asarray(rows[0]) if self._one else rows

    def _figures(self, found: Floats) -> Any:
        return float(found[0]) if self._one else found

    def _vectors(self, name: str, value: ArrayLike) -> NDArray[Any]:
        """Vectors (3,) or (N, 3), finite or for filters that skip others."""
        return checks.array(name, value, f"(3,) or ({len(self._q)}, 3)", flag=self._skips)

    def _call(self, name: str, own: Floats | None = None) -> _Call:
        """An operation of ``updates``, on an array ``own`` of each filter's numbers."""
        found = self._calls.get(name)
        if found is None:
            n, made = len(self._q), operation(name, self._y.shape[1])
            own = np.empty((n, made.inputs["own"] or 0)) if own is None else own
            shared = np.empty((1, made.inputs["shared"] or 0))
            state, figures = [self._q, self._y, self._P.reshape(n, -1)], np.empty((2, n))
            run = made.bound([*state, own, shared], [*state, *figures][: len(made.outputs)])
            found = self._calls[name] = _Call(run, own, shared[0], *figures)
        return found

    def update_vector(
        self, measured: ArrayLike, reference: ArrayLike, sigma: float, *, gate: float | None = None
    ) -> Any:
        """Use a vector: measured in body axes, its reference along inertial ones; (3,) or (N, 3).

        ``sigma`` is the standard deviation of each component, in the vectors' unit, above 0. Gives
        NIS, and does not use vectors for which it is beyond ``gate``.

        Raises ``ValueError`` for another shape, and as ``invalid`` says.
        """
        call = self._call("vector")
        seen, known = self._vectors("measured", measured), self._vectors("reference", reference)
        call.shared[:] = largest_square(gate), variance("sigma", sigma)
        call.own[:, :3], call.own[:, 3:] = seen, known
        call.run()
        return self._checked_nis(call.nis.copy(), gate, call.nonlinearity)

    def update_attitude(
        self, measured: ArrayLike, sigma: ArrayLike, *, gate: float | None = None
    ) -> Any:
        """Use attitudes, (4,) or (N, 4), unit; such as a star tracker's.

        ``sigma`` is the standard deviation about each body axis, rad, a number or (3,), or their
        covariance (3, 3). Gives NIS, and does not use attitudes for which it is beyond ``gate``.

        Raises ``ValueError`` for another shape, and as ``invalid`` says.
        """
        shapes = f"(4,) or ({len(self._q)}, 4)"
        rows = checks.attitudes("measured", measured, shapes, flag=self._skips)
        call = self._call("attitude")
        call.shared[:] = largest_square(gate), *attitude_covariance(sigma)[np.triu_indices(3)]
        # a zero quaternion is no attitude
        call.own[:] = np.where((rows == 0.0).all(axis=-1, keepdims=True), np.nan, rows)
        call.run()
        return self._checked_nis(call.nis.copy(), gate, call.nonlinearity)

    def _checked_nis(self, nis: Floats, gate: float | None, nonlinearity: Floats) -> Any:
        """NIS; refuses measurements without one, warns of updates that are too nonlinear."""
        if not self._skips and not checks.all_finite(nis):
            lost = ~np.isfinite(nis) if gate is None else np.isnan(nis)
            if lost.any():
                k = int(np.argmax(lost))
                raise ValueError(
                    f"measured{'' if self._one else [k]}: has a normalised innovation squared of "
                    f"{nis[k]}; accepted: finite ones; this estimate is as before"
                )
        if ((nonlinearity > 1.0) & (nis <= largest_square(gate))).any():
            warnings.warn(
                "measured: an attitude was known too little for vectors as precise as these: the "
                "covariance left may be too small; begin with attitude_from_vectors, or use "
                "update_attitude first",
                stacklevel=3,
            )
        return self._figures(nis)

    @property
    def q(self) -> Floats:
        """Attitudes, (4,) or (N, 4)."""
        return self._each(self._q)

    @property
    def covariance(self) -> Floats:
        """Covariances of the errors, (D, D) or (N, D, D)."""
        return self._each(self._P)

    def nees(self, q: ArrayLike, y: ArrayLike) -> Any:
        """Normalised estimation error squared against the truth, χ² with D degrees of freedom.

        Raises ``ValueError`` or ``TypeError`` for a truth of another shape, not finite or zero.
        """
        n, k = self._y.shape
        attitudes = checks.attitudes("q", q, f"(4,) or ({n}, 4)")
        y = checks.array(self._name, y, f"({k},) or ({n}, {k})")
        d = np.concatenate([attitude_error(self._q, attitudes), y - self._y], axis=-1)
        return self._figures(normalised_square(d, self._P))
