"""Preintegration of a gyro and an accelerometer between two instants i and j.

Forster, Carlone, Dellaert and Scaramuzza, IEEE Trans. Robotics 33 (2017) 1. Rates ω (rad/s) and
specific forces a (m/s²) along body axes, biases subtracted, give increments that do not depend on
the state at i:

    ΔR = C_iᵀ C_j,  Δv = C_iᵀ (v_j − v_i − g Δt),  Δp = C_iᵀ (p_j − p_i − v_i Δt − ½ g Δt²),

their derivatives to both biases and the covariance of their errors (δφ, δv, δp): ΔR_true =
ΔR exp [δφ], δφ in body axes at j, δv and δp along the body axes at i. Velocities are along inertial
axes here, and g the acceleration by gravity.

Each sample is held over its interval h. Within it the motion is exact for a constant ω and a
constant a along body axes: Δv += ΔR h Jl(ωh) a, Δp += Δv h + ΔR h²
(½ + (θ − sin θ)/θ³ [ωh] + (θ²/2 + cos θ − 1)/θ⁴ [ωh]²) a.

Noise is given by spectral densities, σ_g² (rad²/s) and σ_a² (m²/s³): each sample has an error of
variance σ²/h, held over the interval too (Forster, eq. 39; attitude gains σ_g² h Jr Jrᵀ).
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from fastatt.codegen.scalar import scalar_function
from fastatt.kernels import dcm, error_state, quat, so3, sym3
from fastatt.kernels.vec3 import add, axpy, scale
from fastatt.tracing import formulas
from fastatt.tracing.dual import derivatives, seed, value

_formula = partial(scalar_function, rewritten=True)


class PreintegratedRotation(NamedTuple):
    """What a gyro gives: time (s), ΔR, ∂φ/∂b_g (s), covariance of δφ (rad²) as of ``sym3``."""

    t: Any
    q: Any
    jacobian: Any
    covariance: Any


class Preintegrated(NamedTuple):
    """State of a preintegration, nested tuples; matrices row by row.

    ``rotation`` is a :class:`PreintegratedRotation`; ``v`` (m/s) and ``p`` (m); ``vg`` ∂Δv/∂b_g,
    ``va`` ∂Δv/∂b_a, ``pg`` and ``pa`` those of Δp; ``rv``, ``rp``, ``vv``, ``vp``, ``pp`` the other
    blocks of the covariance, ``vv`` and ``pp`` as of ``sym3``.
    """

    rotation: Any
    v: Any
    p: Any
    vg: Any
    va: Any
    pg: Any
    pa: Any
    rv: Any
    rp: Any
    vv: Any
    vp: Any
    pp: Any


@_formula
def begin(like):
    """The state before the first sample, in the type of ``like``."""
    F = type(like)
    o = F(0.0)
    three = (o, o, o)
    six = (o, o, o, o, o, o)
    nine = (o, o, o, o, o, o, o, o, o)
    rotation = PreintegratedRotation(o, (F(1.0), o, o, o), nine, six)
    return Preintegrated(rotation, three, three, nine, nine, nine, nine, nine, nine, six, nine, six)


@scalar_function
def _exact(w, a, h):
    """(Δv, Δp, 9 + 9 + 9 + 9 derivatives) of one sample along the axes of its start."""
    s = seed((*w, *a), 6)
    u = formulas.scale(h, s[:3])
    v = formulas.scale(h, formulas.so3.turned_integral(u, s[3:]))
    p = formulas.scale(h * h, formulas.so3.turned_second_integral(u, s[3:]))
    return value(v), value(p), (*_halves(v), *_halves(p))


def _halves(x: Any) -> Any:
    """The derivatives to the rate and to the specific force, row by row."""
    rows = [derivatives(c, 6) for c in x]
    return sum((row[:3] for row in rows), ()), sum((row[3:] for row in rows), ())


@_formula
def add_sample(s, w, a, h, gyro, accel):
    """Rate w (rad/s) and specific force a (m/s²), biases off, held for h s; σ_g² and σ_a² held."""
    r = s.rotation
    u = scale(h, w)
    dv, dp, slopes = _exact(w, a, h)
    c = dcm.from_quat(r.q)
    f, g = error_state.transition(u, h)
    # derivatives of (φ, v, p) after the sample to its rate, and of (v, p) to its specific force
    rw = _scaled(-1.0, g)
    vw, va, pw, pa = (dcm.mul(c, x) for x in slopes)
    # A = [f 0 0; b 1 0; d h 1] takes (δφ, δv, δp) across the sample
    b = _scaled(-1.0, dcm.mul(c, so3.hat(dv)))
    d = _scaled(-1.0, dcm.mul(c, so3.hat(dp)))
    across = f, b, d, h
    jacobian, vg, pg = _forward(across, (r.jacobian, s.vg, s.pg))
    rr, vv, pp = sym3.full(r.covariance), sym3.full(s.vv), sym3.full(s.pp)
    rv, rp, vp = s.rv, s.rp, s.vp
    columns = (
        (rr, dcm.transpose(rv), dcm.transpose(rp)), (rv, vv, dcm.transpose(vp)), (rp, vp, pp)
    )  # fmt: skip
    # the rows of A P, transposed, are the columns of (A P)ᵀ: A (A P)ᵀ = A P Aᵀ
    moved = [_forward(across, column) for column in columns]
    rows = [[dcm.transpose(column[i]) for column in moved] for i in range(3)]
    (rr, vr, pr), (_, vv, pv), (_, _, pp) = (_forward(across, row) for row in rows)
    k = gyro / h
    m = accel / h
    return Preintegrated(
        rotation=PreintegratedRotation(
            t=r.t + h,
            q=quat.renormalise(quat.mul(r.q, quat.exp(u))),
            jacobian=_less(jacobian, rw),
            covariance=sym3.upper(_plus(rr, k, rw, rw)),
        ),
        v=add(s.v, dcm.rotate(c, dv)),
        p=add(axpy(h, s.v, s.p), dcm.rotate(c, dp)),
        vg=_less(vg, vw),
        va=_less(s.va, va),
        pg=_less(pg, pw),
        pa=_less(dcm.add(s.pa, dcm.scale(h, s.va)), pa),
        rv=_plus(dcm.transpose(vr), k, rw, vw),
        rp=_plus(dcm.transpose(pr), k, rw, pw),
        vv=sym3.upper(_plus(_plus(vv, k, vw, vw), m, va, va)),
        vp=_plus(_plus(dcm.transpose(pv), k, vw, pw), m, va, pa),
        pp=sym3.upper(_plus(_plus(pp, k, pw, pw), m, pa, pa)),
    )


def _forward(across: Any, x: Any) -> Any:
    """A x of three 3×3 blocks."""
    f, b, d, h = across
    r, v, p = x
    position = dcm.add(dcm.mul(d, r), dcm.add(dcm.scale(h, v), p))
    return dcm.mul(f, r), dcm.add(dcm.mul(b, r), v), position


def _plus(a: Any, k: Any, x: Any, y: Any) -> Any:
    """A + k x yᵀ."""
    return dcm.add(a, dcm.scale(k, dcm.mul(x, dcm.transpose(y))))


def _scaled(k: float, a: Any) -> Any:
    return dcm.scale(type(a[0])(k), a)


def _less(a: Any, b: Any) -> Any:
    return dcm.add(a, _scaled(-1.0, b))


@_formula
def corrected(s, gyro, accel):
    """(ΔR, Δv, Δp) for biases that are larger by ``gyro`` and ``accel``, to first order."""
    r = s.rotation
    q = quat.mul(r.q, quat.exp(dcm.rotate(r.jacobian, gyro)))
    v = add(s.v, add(dcm.rotate(s.vg, gyro), dcm.rotate(s.va, accel)))
    p = add(s.p, add(dcm.rotate(s.pg, gyro), dcm.rotate(s.pa, accel)))
    return q, v, p


@_formula
def navigate(q, v, p, g, t, change):
    """(q, v, p) at j from those at i (v and p along inertial axes), g (m/s²) and (ΔR, Δv, Δp)."""
    F = type(t)
    dq, dv, dp = change
    end = axpy(F(0.5) * t * t, g, axpy(t, v, p))
    return quat.mul(q, dq), axpy(t, g, add(v, quat.rotate(q, dv))), add(end, quat.rotate(q, dp))
