"""Preintegration of whole logs, one or many, and sample by sample from Python."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.arrays import normalised, quat_multiply, quat_rotate, rotation_vector_to_quat
from fastatt.codegen.rows import LogFunction
from fastatt.estimation import preintegration as pre
from fastatt.estimation.amounts import at_least_zero, common_number, interval, triples
from fastatt.gyro.integrate import intervals
from fastatt.threads import number_of
from fastatt.tracing.formulas import Vector, minus

_TRIPLE = (0.0, 0.0, 0.0)
# numbers of a state's parts, those of its rotation first
_WIDTHS = (1, 4, 9, 6, 3, 3, 9, 9, 9, 9, 9, 9, 6, 9, 6)
_SIZE, _ROTATION = sum(_WIDTHS), sum(_WIDTHS[:4])


def nested(x: Vector) -> pre.Preintegrated:
    """The state of 101 numbers."""
    t, *parts = (x[end - n : end] for n, end in zip(_WIDTHS, accumulate(_WIDTHS), strict=True))
    return pre.Preintegrated(pre.PreintegratedRotation(*t, *parts[:3]), *parts[3:])


def _step(x: Vector, w: Vector, a: Vector, h: Vector, bg: Vector, ba: Vector, v: Vector) -> Any:
    return pre.add_sample(nested(x), minus(w, bg), minus(a, ba), *h, *v)


_LOGS = LogFunction(_step, _SIZE, {"w": 3, "a": 3, "h": 1}, {"bg": 3, "ba": 3, "variances": 2})


@dataclass(frozen=True, eq=False)
class Preintegration:
    """What a gyro and an accelerometer say of the motion between two instants i and j.

    One log gives the shapes written here, N logs the same after (N,). ``duration`` () s;
    ``rotation`` ΔR (4,), a unit quaternion; ``velocity`` Δv (3,), m/s, and ``position`` Δp (3,), m,
    along the body axes at i. ``rotation_gyro`` (3, 3) is the derivative of ΔR, in body axes at j,
    to the gyro's bias; ``velocity_gyro``, ``velocity_accel``, ``position_gyro`` and
    ``position_accel`` those of Δv and Δp to both biases. ``covariance`` (9, 9) is that of the
    errors of (ΔR, Δv, Δp). Of a gyro alone all but what is the rotation's is NaN.
    """

    duration: NDArray[np.float64]
    rotation: NDArray[np.float64]
    velocity: NDArray[np.float64]
    position: NDArray[np.float64]
    rotation_gyro: NDArray[np.float64]
    velocity_gyro: NDArray[np.float64]
    velocity_accel: NDArray[np.float64]
    position_gyro: NDArray[np.float64]
    position_accel: NDArray[np.float64]
    covariance: NDArray[np.float64]
    #: all numbers, a row of 101 for each log
    rows: NDArray[np.float64]

    def corrected(
        self, gyro_bias: ArrayLike = _TRIPLE, accel_bias: ArrayLike = _TRIPLE
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """(ΔR, Δv, Δp) for biases larger by these, (3,) or (N, 3), to first order.

        Raises ``ValueError`` or ``TypeError`` for other shapes.
        """
        gyro, accel = self._vectors(gyro_bias=gyro_bias, accel_bias=accel_bias)
        q = quat_multiply(self.rotation, rotation_vector_to_quat(_times(self.rotation_gyro, gyro)))
        v = self.velocity + _times(self.velocity_gyro, gyro) + _times(self.velocity_accel, accel)
        p = self.position + _times(self.position_gyro, gyro) + _times(self.position_accel, accel)
        return np.broadcast_to(q, (*v.shape[:-1], 4)), v, p

    def _vectors(self, **given: ArrayLike) -> list[NDArray[Any]]:
        """Vectors (3,) or (N, 3), of one log or of each."""
        found = {name: checks.array(name, x, "(3,) or (N, 3)") for name, x in given.items()}
        rows = {name: np.atleast_2d(x) for name, x in found.items()}
        common_number("logs", preintegrated=self.rows, **rows)
        return list(found.values())

    def predict(
        self,
        q: ArrayLike,
        v: ArrayLike,
        p: ArrayLike,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.80665),
        gyro_bias: ArrayLike = _TRIPLE,
        accel_bias: ArrayLike = _TRIPLE,
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """(q, v, p) at j from those at i: (4,), (3,), (3,) or a row for each log.

        Velocities (m/s) and positions (m) are along inertial axes, ``gravity`` (3,) m/s² too; the
        biases are what they have grown by since the samples were added.

        Raises ``ValueError`` or ``TypeError`` for other shapes, and for samples of a gyro alone.
        """
        if np.isnan(self.rows[:, _ROTATION:]).all():
            raise ValueError(
                "accel: found None where the samples were added; accepted: samples, without which "
                "only the attitude at j is known: fastatt.quat_multiply(q, rotation)"
            )
        dq, dv, dp = self.corrected(gyro_bias, accel_bias)
        g = checks.array("gravity", gravity, "(3,)")
        start = normalised(checks.attitudes("q", q).astype(np.float64))
        v0, p0 = self._vectors(v=v, p=p)
        common_number("logs", preintegrated=self.rows, q=np.atleast_2d(start))
        t = self.duration[..., None]
        position = p0 + t * v0 + 0.5 * t * t * g + quat_rotate(start, dp)
        velocity = np.broadcast_to(v0 + t * g + quat_rotate(start, dv), position.shape)
        attitude = np.broadcast_to(quat_multiply(start, dq), (*position.shape[:-1], 4))
        return attitude, velocity, position


_UPPER = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # of a symmetric block, as of ``sym3``


def _unpacked(rows: NDArray[np.float64], one: bool) -> Preintegration:
    n = len(rows)
    t, q, slopes, rr, v, p, *parts = np.split(rows, np.cumsum(_WIDTHS[:-1]), axis=1)
    covariance = np.empty((n, 3, 3, 3, 3))
    blocks = zip(combinations_with_replacement(range(3), 2), (rr, *parts[4:]), strict=True)
    for (i, j), numbers in blocks:
        block = (numbers[:, _UPPER] if i == j else numbers).reshape(n, 3, 3)
        covariance[:, i, :, j] = block
        covariance[:, j, :, i] = np.swapaxes(block, 1, 2)
    matrices = [x.reshape(n, 3, 3) for x in (slopes, *parts[:4])]
    found = t[:, 0], q, v, p, *matrices, covariance.reshape(n, 9, 9)
    return Preintegration(*[*(x[0] if one else x for x in found), rows])


def _times(A: NDArray[Any], x: NDArray[Any]) -> NDArray[Any]:
    return np.asarray((A @ x[..., None])[..., 0])


def preintegrate(
    gyro: ArrayLike,
    accel: ArrayLike | None,
    dt: ArrayLike,
    *,
    gyro_noise: float = 0.0,
    accel_noise: float = 0.0,
    gyro_bias: ArrayLike = _TRIPLE,
    accel_bias: ArrayLike = _TRIPLE,
    n_threads: int | None = None,
) -> Preintegration:
    """Rotation, velocity and position increments of a log, their bias derivatives and covariance.

    Parameters
    ----------
    gyro : (n, 3) or (N, n, 3), rad/s, body axes, each sample held over its interval.
    accel : the same shape, specific force, m/s²; None for a gyro alone, whose rotation is found.
    dt : the interval, s, or the n intervals.
    gyro_noise, accel_noise : densities σ_g, rad/√s, and σ_a, m/s^1.5: of samples with standard
        deviation s at intervals h, s √h.
    gyro_bias, accel_bias : (3,) or (N, 3), taken off the samples.

    Raises
    ------
    ValueError, TypeError : a shape that does not fit, a number that is not finite, an interval not
        above 0, a negative density.
    """
    w = checks.array("gyro", gyro, "(n, 3) or (N, n, 3)")
    one = w.ndim == 2
    w = np.ascontiguousarray(w[None] if one else w, dtype=np.float64)
    n_logs, n = w.shape[:2]
    bg, ba = triples("gyro_bias", gyro_bias, n_logs), triples("accel_bias", accel_bias, n_logs)
    spans = np.ascontiguousarray(
        np.broadcast_to(intervals(dt, n, np.inf, np.dtype(np.float64)), (n,))
    )
    variances = _variances(gyro_noise, accel_noise)
    a: NDArray[np.float64] = np.zeros((1, 1, 3))
    if accel is not None:
        forces = checks.array("accel", accel, f"{np.shape(gyro)}, as gyro", [np.shape(gyro)])
        a = np.asarray(forces.reshape(w.shape), dtype=np.float64)
    h, threads = spans[None, :, None], number_of(n_threads)
    state = _LOGS(_start(n_logs), (w, a, h), (bg, ba, variances), threads)
    if accel is None:
        state[:, _ROTATION:] = np.nan
    return _unpacked(state, one)


def _start(n_logs: int) -> NDArray[np.float64]:
    """States before the first sample."""
    state = np.zeros((n_logs, _SIZE))
    state[:, 1] = 1.0
    return state


def _variances(gyro_noise: float, accel_noise: float) -> NDArray[np.float64]:
    found = at_least_zero("gyro_noise", gyro_noise), at_least_zero("accel_noise", accel_noise)
    return np.square([found])


class Preintegrator:
    """Preintegration sample by sample, from Python; arguments as those of :func:`preintegrate`."""

    def __init__(
        self,
        *,
        gyro_noise: float = 0.0,
        accel_noise: float = 0.0,
        gyro_bias: ArrayLike = _TRIPLE,
        accel_bias: ArrayLike = _TRIPLE,
    ) -> None:
        biases = triples("gyro_bias", gyro_bias, 1), triples("accel_bias", accel_bias, 1)
        self._given = *biases, _variances(gyro_noise, accel_noise)
        self.reset()

    def reset(self) -> None:
        """Begin again, at the instant of the last sample's end."""
        self._row = _start(1)

    def add(self, gyro: ArrayLike, accel: ArrayLike, dt: float) -> None:
        """One sample: rate (3,), rad/s, and specific force (3,), m/s², held for ``dt`` s.

        Raises ``ValueError`` or ``TypeError`` for other shapes, and for an interval not above 0.
        """
        h = np.full((1, 1, 1), interval(dt))
        w, a = checks.array("gyro", gyro, "(3,)"), checks.array("accel", accel, "(3,)")
        self._row = _LOGS(self._row, (w[None, None], a[None, None], h), self._given, 1)

    @property
    def state(self) -> pre.Preintegrated:
        """The tuple that kernels such as ``add_sample`` take."""
        return nested(tuple(self._row[0].tolist()))

    @property
    def result(self) -> Preintegration:
        """What the samples so far give."""
        return _unpacked(self._row, one=True)
