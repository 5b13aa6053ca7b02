"""Energy and angular momentum of one body or many, from what a trajectory holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, torques
from fastatt._jit import driver
from fastatt.arrays import quat_multiply, rotate
from fastatt.columns import unpack
from fastatt.kernels import rigid
from fastatt.motion import Body, Moving
from fastatt.representations import QUAT
from fastatt.scene import Scene, as_scene


def angular_momentum(
    w: ArrayLike, inertia: ArrayLike, q: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Angular momentum I w, N·m·s, along body axes or, with attitudes ``q``, along inertial axes.

    ``w`` (3,), (N, 3) or (S, N, 3) is in rad/s along body axes, ``q`` has 4 in place of 3;
    ``inertia`` is that of a scene: moments or a tensor, for all bodies or each.

    Raises ``ValueError`` for shapes that do not fit.
    """
    rates = checks.array("w", w, "(3,), (N, 3) or (S, N, 3)", [(3,), (-1, 3), (-1, -1, 3)])
    shapes = [(3,), (3, 3), (-1, 3), (-1, 3, 3)]
    given = checks.array("inertia", inertia, "(3,), (3, 3), (N, 3) or (N, 3, 3)", shapes)
    tensor = given.shape == (3, 3) or given.ndim == 3
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            m = np.einsum("...ij,...j->...i", given, rates) if tensor else given * rates
        return np.asarray(m if q is None else rotate(q, m))
    except ValueError:
        raise ValueError(
            f"w: has shape {rates.shape}, inertia {given.shape}, q {np.asarray(q).shape}; "
            "accepted: one number of bodies"
        ) from None


def kinetic_energy(w: ArrayLike, inertia: ArrayLike) -> NDArray[np.float64]:
    """½ w·I w, J: (), (N,) or (S, N); arguments as of :func:`angular_momentum`."""
    m = angular_momentum(w, inertia)
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(0.5 * np.einsum("...i,...i->...", np.asarray(w, dtype=np.float64), m))


def kinetic_energy_symmetric(
    angles: ArrayLike, rates: ArrayLike, inertia: ArrayLike
) -> NDArray[np.float64]:
    """Kinetic energy of a symmetric top, J, in 3-1-3 angles (φ, θ, ψ) and their rates.

    ½ I1 (φ̇² sin²θ + θ̇²) + ½ I3 (φ̇ cosθ + ψ̇)²; ``angles`` and ``rates`` are (..., 3) in rad and
    rad/s, ``inertia`` is (I1, I3). Goldstein, *Classical Mechanics*, eq. 5.52.

    Raises ``ValueError`` for other shapes.
    """
    a, d = (
        checks.numbers(name, value, "real numbers (..., 3)").astype(np.float64, copy=False)
        for name, value in (("angles", angles), ("rates", rates))
    )
    if a.shape != d.shape or a.shape[-1:] != (3,):
        raise ValueError(f"angles, rates: have shapes {a.shape}, {d.shape}; accepted: (..., 3)")
    moments = checks.array("inertia", inertia, "(2,)", [(2,)])
    out = np.empty(a.shape[:-1])
    _symmetric_rows(a.reshape(-1, 3), d.reshape(-1, 3), moments.astype(np.float64), out.reshape(-1))
    return out


def potential_energy(scene: Scene, q: ArrayLike, t: ArrayLike = 0.0) -> NDArray[np.float64]:
    """Potential energy of a scene's torque, J: (), (N,) or (S, N) as of attitudes q.

    ``q`` is (4,), (N, 4) or (S, N, 4), ``t`` a number or (S,), s. Zero where nothing acts.

    Raises ``ValueError`` for a torque that has none: ``fastatt.torques`` says which do; it and
    ``TypeError`` for other shapes and things.
    """
    as_scene(scene)
    attitudes = checks.array("q", q, "(4,), (N, 4) or (S, N, 4)", [(4,), (-1, 4), (-1, -1, 4)])
    found = np.reshape(attitudes, (-1, *((1, *attitudes.shape)[-2:])))
    packed = scene.packed(found.shape[1] if attitudes.ndim > 1 else 1)
    tag, params = packed.tag, packed.params
    tag = tag.model if isinstance(tag, Moving) else tag
    if not isinstance(tag, Body) or not torques.has_potential(tag.torque):
        raise ValueError("scene: its torque has no potential; accepted: one that has, or none")
    axes = len(tag.axes)
    if axes:
        found = quat_multiply(found, params[..., 9:13])
    times = checks.array("t", t, f"a number or ({len(found)},)", [(), (len(found),)])
    times = np.broadcast_to(times.astype(np.float64), found.shape[:1])
    table = np.atleast_2d(np.concatenate([params[..., 3:6], params[..., 9 + axes :]], axis=-1))
    table = np.broadcast_to(table, (found.shape[1], table.shape[1]))
    out = np.empty(found.shape[:2])
    shape = (0.0,) * (table.shape[1] - 3)
    loop = _potential_rows if packed.cacheable else _user_potential_rows
    loop(
        tag.torque,
        shape,
        np.ascontiguousarray(table),
        np.ascontiguousarray(found, dtype=np.float64),
        np.ascontiguousarray(times),
        out,
    )
    return out.reshape(attitudes.shape[:-1])


@driver
def _symmetric_rows(angles, rates, inertia, out):
    for i in range(out.size):
        out[i] = rigid.kinetic_energy_symmetric(
            (angles[i, 0], angles[i, 1], angles[i, 2]),
            (rates[i, 0], rates[i, 1], rates[i, 2]),
            (inertia[0], inertia[1]),
        )


def _potential(model, shape, table, q, t, out):
    for s in range(out.shape[0]):
        for b in range(out.shape[1]):
            x = (q[s, b, 0], q[s, b, 1], q[s, b, 2], q[s, b, 3])
            inertia = (table[b, 0], table[b, 1], table[b, 2])
            p = unpack(table[b, 3:], shape)
            out[s, b] = torques.potential(model, QUAT, t[s], x, inertia, p)


_potential_rows = driver(_potential)
_user_potential_rows = driver(_potential, cache=False)
