"""Preintegration of whole logs, one or many, and sample by sample from Python."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numba import types
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt._jit import driver, helper, hook
from fastatt.columns import store, unpack
from fastatt.estimation import preintegration as pre
from fastatt.estimation.threads import spread
from fastatt.integrate import intervals

_TRIPLE = (0.0, 0.0, 0.0)
_QUATERNION = (0.0, 0.0, 0.0, 0.0)
_ROW = (0.0,) * 101
_MODELS: dict[str, Any] = {"held": pre.Held(), "white": pre.White(), "forster": pre.Forster()}
_ADD: dict[Any, Any] = {
    pre.Held: pre.add_sample, pre.White: pre.add_sample_white, pre.Forster: pre.add_sample_forster
}  # fmt: skip


@helper
def flat(s):
    """All 101 numbers of a state."""
    r = s.rotation
    means = (r.t, *r.q, *s.v, *s.p)
    slopes = (*r.jacobian, *s.vg, *s.va, *s.pg, *s.pa)
    return means + slopes + (*r.covariance, *s.rv, *s.rp, *s.vv, *s.vp, *s.pp)


@helper
def nested(x):
    """The state of 101 numbers."""
    r = pre.PreintegratedRotation(x[0], x[1:5], x[11:20], x[56:62])
    return pre.Preintegrated(
        r, x[5:8], x[8:11], x[20:29], x[29:38], x[38:47], x[47:56], x[62:71], x[71:80], x[80:86],
        x[86:95], x[95:101],
    )  # fmt: skip


def add(model: Any, s: Any, w: Any, a: Any, h: Any, gyro: Any, accel: Any) -> Any:
    """The state a sample later."""
    raise NotImplementedError(model)


@hook(add)
def _add(
    model: types.BaseNamedTuple, s: types.Type, w: types.Type, a: types.Type, h: types.Type,
    gyro: types.Type, accel: types.Type,
) -> Any:  # fmt: skip
    operation = _ADD[model.instance_class]
    return lambda model, s, w, a, h, gyro, accel: operation(s, w, a, h, gyro, accel)


@driver
def _logs(model, gyro, accel, spans, bg, ba, variances, out, first, last):
    for b in range(first, last):
        cg = unpack(bg[min(b, bg.shape[0] - 1)], _TRIPLE)
        ca = unpack(ba[min(b, ba.shape[0] - 1)], _TRIPLE)
        s = nested(unpack(out[b], _ROW))
        for i in range(gyro.shape[1]):
            w = unpack(gyro[b, i], _TRIPLE)
            a = unpack(accel[b, i], _TRIPLE)
            s = add(
                model, s, (w[0] - cg[0], w[1] - cg[1], w[2] - cg[2]),
                (a[0] - ca[0], a[1] - ca[1], a[2] - ca[2]), spans[i], variances[0], variances[1],
            )  # fmt: skip
        store(out.T, 0, b, flat(s))


@driver
def _rotations(white, gyro, spans, bg, variance, out, first, last):
    for b in range(first, last):
        c = unpack(bg[min(b, bg.shape[0] - 1)], _TRIPLE)
        s = nested(unpack(out[b], _ROW)).rotation
        for i in range(gyro.shape[1]):
            w = unpack(gyro[b, i], _TRIPLE)
            w = (w[0] - c[0], w[1] - c[1], w[2] - c[2])
            if white:
                s = pre.add_rotation_white(s, w, spans[i], variance)
            else:
                s = pre.add_rotation(s, w, spans[i], variance)
        store(out.T, 0, b, (s.t, *s.q))
        store(out.T, 11, b, s.jacobian)
        store(out.T, 56, b, s.covariance)


@driver
def _corrected(rows, gyro, accel, q1, v1, p1):
    for b in range(q1.shape[0]):
        s = nested(unpack(rows[min(b, rows.shape[0] - 1)], _ROW))
        g = unpack(gyro[min(b, gyro.shape[0] - 1)], _TRIPLE)
        a = unpack(accel[min(b, accel.shape[0] - 1)], _TRIPLE)
        q, v, p = pre.corrected(s, g, a)
        store(q1.T, 0, b, q)
        store(v1.T, 0, b, v)
        store(p1.T, 0, b, p)


@driver
def _navigated(rows, change, state, g, out):
    dq, dv, dp = change
    q0, v0, p0 = state
    q1, v1, p1 = out
    for b in range(q1.shape[0]):
        d = (unpack(dq[b], _QUATERNION), unpack(dv[b], _TRIPLE), unpack(dp[b], _TRIPLE))
        q = unpack(q0[min(b, q0.shape[0] - 1)], _QUATERNION)
        v = unpack(v0[min(b, v0.shape[0] - 1)], _TRIPLE)
        p = unpack(p0[min(b, p0.shape[0] - 1)], _TRIPLE)
        q, v, p = pre.navigate(q, v, p, g, rows[min(b, rows.shape[0] - 1), 0], d)
        store(q1.T, 0, b, q)
        store(v1.T, 0, b, v)
        store(p1.T, 0, b, p)


@dataclass(frozen=True, eq=False)
class Preintegration:
    """What a gyro and an accelerometer say of the motion between two instants i and j.

    One log gives the shapes written here, N logs the same after (N,). ``duration`` () s;
    ``rotation`` ΔR (4,), a unit quaternion; ``velocity`` Δv (3,), m/s, and ``position`` Δp (3,), m,
    along the body axes at i. ``rotation_gyro`` (3, 3) is the derivative of ΔR, in body axes at j,
    to the gyro's bias; ``velocity_gyro``, ``velocity_accel``, ``position_gyro`` and
    ``position_accel`` those of Δv and Δp to both biases. ``covariance`` (9, 9) is that of the
    errors of (ΔR, Δv, Δp); of a gyro alone all but the rotation's is zero.
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

    @property
    def _one(self) -> bool:
        return self.rotation.ndim == 1

    def corrected(
        self, gyro_bias: ArrayLike = _TRIPLE, accel_bias: ArrayLike = _TRIPLE
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """(ΔR, Δv, Δp) for biases larger by these, (3,) or (N, 3), to first order.

        Raises ``ValueError`` or ``TypeError`` for other shapes.
        """
        found = self._corrected(gyro_bias, accel_bias)
        return _unless(self._one and len(found[0]) == 1, found)

    def _corrected(self, gyro_bias: ArrayLike, accel_bias: ArrayLike) -> tuple[Any, Any, Any]:
        rows = _triples(gyro_bias=gyro_bias, accel_bias=accel_bias)
        n = _count(preintegrated=self.rows, **rows)
        out = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3))
        _corrected(self.rows, *rows.values(), *out)
        return out

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

        Raises ``ValueError`` or ``TypeError`` for other shapes.
        """
        change = self._corrected(gyro_bias, accel_bias)
        g = tuple(checks.array("gravity", gravity, "(3,)", [(3,)]).astype(np.float64).tolist())
        start = np.atleast_2d(checks.attitudes("q", q)).astype(np.float64)
        state = (start, *_triples(v=v, p=p).values())
        n = _count(preintegrated=change[0], q=state[0], v=state[1], p=state[2])
        wide = tuple(np.ascontiguousarray(np.broadcast_to(x, (n, x.shape[1]))) for x in change)
        out = np.empty((n, 4)), np.empty((n, 3)), np.empty((n, 3))
        _navigated(self.rows, wide, state, g, out)
        return _unless(self._one and n == 1, out)


# first column of each block of the covariance
_BLOCKS = {(0, 0): 56, (0, 1): 62, (0, 2): 71, (1, 1): 80, (1, 2): 86, (2, 2): 95}
_UPPER = [0, 1, 2, 1, 3, 4, 2, 4, 5]
_SHAPES: tuple[tuple[int, ...], ...] = ((), (4,), (3,), (3,), *((3, 3),) * 5)


def _unpacked(rows: NDArray[np.float64], one: bool) -> Preintegration:
    n = len(rows)
    parts = []
    first = 0
    for shape in _SHAPES:
        size = math.prod(shape)
        parts.append(rows[:, first : first + size].reshape(n, *shape))
        first += size
    covariance = np.empty((n, 3, 3, 3, 3))
    for (i, j), first in _BLOCKS.items():
        block = rows[:, first : first + (6 if i == j else 9)]
        block = (block[:, _UPPER] if i == j else block).reshape(n, 3, 3)
        covariance[:, i, :, j] = block
        covariance[:, j, :, i] = np.swapaxes(block, 1, 2)
    parts.append(covariance.reshape(n, 9, 9))
    found = [part[0] if one else part for part in parts]
    return Preintegration(*[*found, rows])


def _unless(one: bool, found: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    return (found[0][0], found[1][0], found[2][0]) if one else found


def _triples(**values: ArrayLike) -> dict[str, NDArray[np.float64]]:
    return {
        name: np.atleast_2d(
            checks.array(name, value, "(3,) or (N, 3)", [(3,), (-1, 3)]).astype(np.float64)
        )
        for name, value in values.items()
    }


def _count(**rows: NDArray[Any]) -> int:
    found = {name: len(value) for name, value in rows.items()}
    if len(set(found.values()) - {1}) > 1:
        text = ", ".join(f"{name} {n}" for name, n in found.items())
        raise ValueError(f"{next(iter(rows))}: found rows {text}; accepted: one number of logs")
    return max(found.values())


def preintegrate(
    gyro: ArrayLike,
    accel: ArrayLike | None,
    dt: ArrayLike,
    *,
    gyro_noise: float = 0.0,
    accel_noise: float = 0.0,
    gyro_bias: ArrayLike = _TRIPLE,
    accel_bias: ArrayLike = _TRIPLE,
    model: str = "held",
    n_threads: int | None = None,
) -> Preintegration:
    """Rotation, velocity and position increments of a log, their bias derivatives and covariance.

    Parameters
    ----------
    gyro : (n, 3) or (N, n, 3), rad/s, body axes, each sample held over its interval.
    accel : the same shape, specific force, m/s²; None for a gyro alone.
    dt : the interval, s, or the n intervals.
    gyro_noise, accel_noise : densities σ_g, rad/√s, and σ_a, m/s^1.5: of samples with standard
        deviation s at intervals h, s √h.
    gyro_bias, accel_bias : (3,) or (N, 3), taken off the samples.
    model : "held", motion within a sample exact for constant ω and a in body axes, noise held with
        the sample; "white", noise that goes on within it; "forster", the published form.

    Raises
    ------
    ValueError, TypeError : a shape that does not fit, a number that is not finite, an interval not
        above 0, a negative density.
    """
    kind = _MODELS[checks.choice("model", model, _MODELS)]
    accepted = [(-1, 3), (-1, -1, 3)]
    w = checks.array("gyro", gyro, "(n, 3) or (N, n, 3)", accepted)
    one = w.ndim == 2
    w = np.ascontiguousarray(w[None] if one else w, dtype=np.float64)
    n_logs, n = w.shape[:2]
    bg = _bias("gyro_bias", gyro_bias, n_logs)
    ba = _bias("accel_bias", accel_bias, n_logs)
    spans = np.ascontiguousarray(
        np.broadcast_to(intervals(dt, n, np.inf, np.dtype(np.float64)), (n,))
    )
    variances = tuple(
        _density(name, value) ** 2
        for name, value in (("gyro_noise", gyro_noise), ("accel_noise", accel_noise))
    )
    rows = np.zeros((n_logs, len(_ROW)))
    rows[:, 1] = 1.0
    call: Callable[[int, int], Any]
    if accel is None:
        call = partial(_rotations, model == "white", w, spans, bg, variances[0], rows)
    else:
        a = checks.array("accel", accel, "the shape of gyro", accepted)
        if a.shape != np.shape(gyro):
            raise ValueError(f"accel: has shape {a.shape}; accepted: {np.shape(gyro)}, as gyro")
        a = np.ascontiguousarray(a.reshape(w.shape), dtype=np.float64)
        call = partial(_logs, kind, w, a, spans, bg, ba, variances, rows)
    spread(n_logs, n_threads, call, least=1)
    return _unpacked(rows, one)


def _bias(name: str, value: ArrayLike, n_logs: int) -> NDArray[np.float64]:
    found = _triples(**{name: value})[name]
    if len(found) not in (1, n_logs):
        raise ValueError(
            f"{name}: has shape {found.shape}; accepted: (3,) or ({n_logs}, 3), one a log"
        )
    return found


def _density(name: str, value: float) -> float:
    found = checks.real(name, value)
    if found < 0.0:
        raise ValueError(f"{name}: found {found}; accepted: at least 0")
    return found


class Preintegrator:
    """Preintegration sample by sample, from Python; arguments as those of :func:`preintegrate`.

    ``state`` is the tuple that the kernels take (``add_sample`` and its company).
    """

    def __init__(
        self,
        *,
        gyro_noise: float = 0.0,
        accel_noise: float = 0.0,
        gyro_bias: ArrayLike = _TRIPLE,
        accel_bias: ArrayLike = _TRIPLE,
        model: str = "held",
    ) -> None:
        self._add = _ADD[type(_MODELS[checks.choice("model", model, _MODELS)])]
        self._variances = (
            _density("gyro_noise", gyro_noise) ** 2,
            _density("accel_noise", accel_noise) ** 2,
        )
        self._gyro_bias = _bias("gyro_bias", gyro_bias, 1)[0].tolist()
        self._accel_bias = _bias("accel_bias", accel_bias, 1)[0].tolist()
        self.reset()

    def reset(self) -> None:
        """Begin again, at the instant of the last sample's end."""
        self.state = pre.begin(1.0)

    def add(self, gyro: ArrayLike, accel: ArrayLike, dt: float) -> None:
        """One sample: rate (3,), rad/s, and specific force (3,), m/s², held for ``dt`` s.

        Raises ``ValueError`` or ``TypeError`` for other shapes, and for an interval not above 0.
        """
        h = checks.real("dt", dt)
        if h <= 0.0:
            raise ValueError(f"dt: found {h}; accepted: an interval above 0")
        w, a = (
            checks.array(name, value, "(3,)", [(3,)]).tolist()
            for name, value in (("gyro", gyro), ("accel", accel))
        )
        w = tuple(float(x) - b for x, b in zip(w, self._gyro_bias, strict=True))
        a = tuple(float(x) - b for x, b in zip(a, self._accel_bias, strict=True))
        self.state = self._add(self.state, w, a, h, *self._variances)

    @property
    def result(self) -> Preintegration:
        """What the samples so far give."""
        return _unpacked(np.array([flat(self.state)]), one=True)
