"""Preintegration of a gyro and an accelerometer between two instants i and j.

Forster, Carlone, Dellaert and Scaramuzza, IEEE Trans. Robotics 33 (2017) 1. From rates ω (rad/s)
and specific forces a (m/s²) along body axes, biases taken off, follow what does not depend on the
state at i:

    ΔR = C_iᵀ C_j,  Δv = C_iᵀ (v_j − v_i − g Δt),  Δp = C_iᵀ (p_j − p_i − v_i Δt − ½ g Δt²),

their derivatives to both biases and the covariance of their errors (δφ, δv, δp): ΔR_true =
ΔR exp [δφ], δφ in body axes at j, δv and δp along the body axes at i. Velocities are along inertial
axes here, and g the acceleration by gravity.

Each sample is held over its interval h. Within it the motion is exact for a constant ω and a
constant a along body axes: Δv += ΔR h Jl(ωh) a, Δp += Δv h + ΔR h²
(½ + (θ − sin θ)/θ³ [ωh] + (θ²/2 + cos θ − 1)/θ⁴ [ωh]²) a.

Noise is given by spectral densities, σ_g² (rad²/s) and σ_a² (m²/s³). *Held* noise is one number a
sample, of variance σ²/h, held with it (Forster, eq. 39; attitude gains σ_g² h Jr Jrᵀ). *White*
noise goes on within the sample: attitude gains σ_g² h 1, velocity and position what that does to
them to leading order in |ω| h.
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


def _rotated(s: Any, u: Any, h: Any, noise: Any) -> Any:
    """The rotation's part a sample later, and Φ11; ``noise`` is what δφ gains."""
    turn = quat.exp(u)
    f, g = error_state.transition(u, h)
    q = quat.renormalise(quat.mul(s.q, turn))
    jacobian = dcm.add(dcm.mul(f, s.jacobian), g)
    covariance = sym3.add(sym3.congruence(f, s.covariance), noise)
    return PreintegratedRotation(s.t + h, q, jacobian, covariance), f


def _isotropic(k: Any) -> Any:
    o = type(k)(0.0)
    return k, o, o, k, o, k


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


def _held_noise(c: Any, u: Any, h: Any, slopes: Any, gyro: Any, accel: Any) -> Any:
    """(rr, rv, rp, vv, vp, pp) of noise held over the sample."""
    r = dcm.scale(h, so3.right_jacobian(u))
    vg, va, pg, pa = slopes
    vg, va = dcm.mul(c, vg), dcm.mul(c, va)
    pg, pa = dcm.mul(c, pg), dcm.mul(c, pa)
    k = gyro / h
    m = accel / h
    vp = dcm.add(
        dcm.scale(k, dcm.mul(vg, dcm.transpose(pg))), dcm.scale(m, dcm.mul(va, dcm.transpose(pa)))
    )
    return (
        sym3.scale(k, sym3.product(r, r)),
        dcm.scale(k, dcm.mul(r, dcm.transpose(vg))),
        dcm.scale(k, dcm.mul(r, dcm.transpose(pg))),
        sym3.add(sym3.scale(k, sym3.product(vg, vg)), sym3.scale(m, sym3.product(va, va))),
        vp,
        sym3.add(sym3.scale(k, sym3.product(pg, pg)), sym3.scale(m, sym3.product(pa, pa))),
    )


def _white_noise(c: Any, a: Any, h: Any, gyro: Any, accel: Any) -> Any:
    """The same of white noise: B(s) in attitude moves the velocity by −[a] ∫ B ds."""
    F = type(h)
    m = dcm.mul(c, so3.hat(a))
    t = dcm.scale(-gyro * h * h, dcm.transpose(m))
    square = sym3.scale(gyro * h * h * h, sym3.product(m, m))
    k = accel * h
    vp = sym3.add(sym3.scale(F(0.125) * h, square), _isotropic(F(0.5) * h * k))
    return (
        _isotropic(gyro * h),
        dcm.scale(F(0.5), t),
        dcm.scale(F(1.0 / 6.0) * h, t),
        sym3.add(sym3.scale(F(1.0 / 3.0), square), _isotropic(k)),
        sym3.full(vp),
        sym3.add(sym3.scale(F(0.05) * h * h, square), _isotropic(F(1.0 / 3.0) * h * h * k)),
    )


def _less(a: Any, b: Any) -> Any:
    return dcm.add(a, dcm.scale(type(a[0])(-1.0), b))


def _added(s: Any, w: Any, h: Any, parts: Any, noise: Any) -> Any:
    """The state a sample later, from its increments, their derivatives and its noise."""
    F = type(h)
    v, p, (vw, va, pw, pa) = parts
    n_rr, n_rv, n_rp, n_vv, n_vp, n_pp = noise
    r = s.rotation
    c = dcm.from_quat(r.q)
    moved, f = _rotated(r, scale(h, w), h, n_rr)
    # A = [f 0 0; b 1 0; d h 1] takes (δφ, δv, δp) across the sample
    b = dcm.scale(F(-1.0), dcm.mul(c, so3.hat(v)))
    d = dcm.scale(F(-1.0), dcm.mul(c, so3.hat(p)))
    vr = dcm.transpose(s.rv)
    # rows v and p of A P
    a_vr = dcm.add(sym3.mul(b, r.covariance), vr)
    a_vv = dcm.add(dcm.mul(b, s.rv), sym3.full(s.vv))
    a_vp = dcm.add(dcm.mul(b, s.rp), s.vp)
    a_pr = dcm.add(sym3.mul(d, r.covariance), dcm.add(dcm.scale(h, vr), dcm.transpose(s.rp)))
    a_pv = dcm.add(dcm.mul(d, s.rv), dcm.add(dcm.scale(h, sym3.full(s.vv)), dcm.transpose(s.vp)))
    a_pp = dcm.add(dcm.mul(d, s.rp), dcm.add(dcm.scale(h, s.vp), sym3.full(s.pp)))
    vv = sym3.add(sym3.product(a_vr, b), sym3.upper(a_vv))
    vp = dcm.add(dcm.mul(a_vr, dcm.transpose(d)), dcm.add(dcm.scale(h, a_vv), a_vp))
    pp = sym3.add(sym3.product(a_pr, d), sym3.upper(dcm.add(dcm.scale(h, a_pv), a_pp)))
    vg = dcm.add(s.vg, dcm.mul(b, r.jacobian))
    pg = dcm.add(dcm.add(s.pg, dcm.scale(h, s.vg)), dcm.mul(d, r.jacobian))
    return Preintegrated(
        rotation=moved,
        v=add(s.v, dcm.rotate(c, v)),
        p=add(axpy(h, s.v, s.p), dcm.rotate(c, p)),
        vg=_less(vg, dcm.mul(c, vw)),
        va=_less(s.va, dcm.mul(c, va)),
        pg=_less(pg, dcm.mul(c, pw)),
        pa=_less(dcm.add(s.pa, dcm.scale(h, s.va)), dcm.mul(c, pa)),
        rv=dcm.add(dcm.mul(f, dcm.transpose(a_vr)), n_rv),
        rp=dcm.add(dcm.mul(f, dcm.transpose(a_pr)), n_rp),
        vv=sym3.add(vv, n_vv),
        vp=dcm.add(vp, n_vp),
        pp=sym3.add(pp, n_pp),
    )


@_formula
def add_sample(s, w, a, h, gyro, accel):
    """Rate w (rad/s) and specific force a (m/s²), biases off, held for h s; σ_g² and σ_a² held."""
    parts = _exact(w, a, h)
    noise = _held_noise(dcm.from_quat(s.rotation.q), scale(h, w), h, parts[2], gyro, accel)
    return _added(s, w, h, parts, noise)


@_formula
def add_sample_white(s, w, a, h, gyro, accel):
    """``add_sample`` with white noise."""
    noise = _white_noise(dcm.from_quat(s.rotation.q), a, h, gyro, accel)
    return _added(s, w, h, _exact(w, a, h), noise)


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
