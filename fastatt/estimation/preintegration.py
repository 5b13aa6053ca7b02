"""Preintegration of a gyro and an accelerometer between two times i and j, as kernels.

Rates ω (rad/s) and specific forces a (m/s²) along body axes, with biases subtracted, give
increments that do not depend on the state at i (Forster, Carlone, Dellaert and Scaramuzza, *IEEE
Transactions on Robotics* 33 (2017) 1):

    ΔR = C_iᵀ C_j,  Δv = C_iᵀ (v_j − v_i − g Δt),  Δp = C_iᵀ (p_j − p_i − v_i Δt − ½ g Δt²),

with their derivatives by both biases and the covariance of their errors (δφ, δv, δp): ΔR_true =
ΔR exp [δφ], δφ in body axes at j, δv and δp along the body axes at i. Velocities are along inertial
axes here, and g is the acceleration by gravity.

Each sample is held over its interval h. Within it the motion is exact for constant ω and constant a
along body axes: Δv += ΔR h Jl(ωh) a, Δp += Δv h + ΔR h²
(½ + (θ − sin θ)/θ³ [ωh] + (θ²/2 + cos θ − 1)/θ⁴ [ωh]²) a.

Noise is given by spectral densities, σ_g² (rad²/s) and σ_a² (m²/s³): each sample has an error of
variance σ²/h, which is held over the interval too (Forster, equation 39; the attitude gains
σ_g² h Jr Jrᵀ).
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

__all__ = ["add_sample", "begin", "corrected", "navigate"]


class PreintegratedRotation(NamedTuple):
    """Preintegrated rotation of a gyro.

    Attributes
    ----------
    t : float
        Time, s.
    q : tuple of 4 float
        ΔR as a unit quaternion.
    jacobian : tuple of 9 float
        Derivative ∂φ/∂b_g, s, row by row.
    covariance : tuple of 6 float
        Covariance of δφ, rad², in the order (11, 12, 13, 22, 23, 33).
    """

    t: Any
    q: Any
    jacobian: Any
    covariance: Any


class Preintegrated(NamedTuple):
    """State of a preintegration, as nested tuples with matrices row by row.

    Attributes
    ----------
    rotation : PreintegratedRotation
        The rotation.
    v, p : tuple of 3 float
        Δv, m/s, and Δp, m.
    vg, va : tuple of 9 float
        ∂Δv/∂b_g and ∂Δv/∂b_a.
    pg, pa : tuple of 9 float
        ∂Δp/∂b_g and ∂Δp/∂b_a.
    rv, rp, vp : tuple of 9 float
        Off-diagonal blocks of the covariance.
    vv, pp : tuple of 6 float
        Diagonal blocks of the covariance, in the order (11, 12, 13, 22, 23, 33).
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
    """The state before the first sample.

    Parameters
    ----------
    like : float
        A number of the precision of the state.

    Returns
    -------
    Preintegrated
        The state.
    """
    F = type(like)
    o = F(0.0)
    three = (o, o, o)
    six = (o, o, o, o, o, o)
    nine = (o, o, o, o, o, o, o, o, o)
    rotation = PreintegratedRotation(o, (F(1.0), o, o, o), nine, six)
    return Preintegrated(rotation, three, three, nine, nine, nine, nine, nine, nine, six, nine, six)


@_formula
def add_sample(s, w, a, h, gyro, accel):
    """Add a sample to a preintegration.

    Parameters
    ----------
    s : Preintegrated
        The state.
    w : tuple of 3 float
        Rate, less the bias, rad/s.
    a : tuple of 3 float
        Specific force, less the bias, m/s².
    h : float
        Interval over which both are held, s.
    gyro : float
        Noise density σ_g² of the gyro, rad²/s.
    accel : float
        Noise density σ_a² of the accelerometer, m²/s³.

    Returns
    -------
    Preintegrated
        The state after the sample.
    """
    r = s.rotation
    u = scale(h, w)
    dv, dp, slopes = _exact(w, a, h)
    c = dcm.from_quat(r.q)
    f, g = error_state.transition(u, h)
    # derivatives of (φ, v, p) after the sample by its rate, and of (v, p) by its specific force
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


@scalar_function
def _exact(w, a, h):
    """(Δv, Δp, 9 + 9 + 9 + 9 derivatives) of one sample along the axes at its start."""
    s = seed((*w, *a), 6)
    u = formulas.scale(h, s[:3])
    v = formulas.scale(h, formulas.so3.turned_integral(u, s[3:]))
    p = formulas.scale(h * h, formulas.so3.turned_second_integral(u, s[3:]))
    return value(v), value(p), (*_halves(v), *_halves(p))


def _halves(x: Any) -> Any:
    """The derivatives by the rate and by the specific force, row by row."""
    rows = [derivatives(c, 6) for c in x]
    return sum((row[:3] for row in rows), ()), sum((row[3:] for row in rows), ())


def _forward(across: Any, x: Any) -> Any:
    """A x with the three 3×3 blocks of A."""
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
    """Correct the increments for changed biases, to first order.

    Parameters
    ----------
    s : Preintegrated
        The state.
    gyro : tuple of 3 float
        Increase of the gyro bias, rad/s.
    accel : tuple of 3 float
        Increase of the accelerometer bias, m/s².

    Returns
    -------
    tuple
        (ΔR, Δv, Δp).
    """
    r = s.rotation
    q = quat.mul(r.q, quat.exp(dcm.rotate(r.jacobian, gyro)))
    v = add(s.v, add(dcm.rotate(s.vg, gyro), dcm.rotate(s.va, accel)))
    p = add(s.p, add(dcm.rotate(s.pg, gyro), dcm.rotate(s.pa, accel)))
    return q, v, p


@_formula
def navigate(q, v, p, g, t, change):
    """Predict the state at j from the state at i.

    Parameters
    ----------
    q : tuple of 4 float
        Attitude at i, body to inertial.
    v : tuple of 3 float
        Velocity at i along inertial axes, m/s.
    p : tuple of 3 float
        Position at i along inertial axes, m.
    g : tuple of 3 float
        Acceleration by gravity along inertial axes, m/s².
    t : float
        Time from i to j, s.
    change : tuple
        (ΔR, Δv, Δp), such as the result of :func:`corrected`.

    Returns
    -------
    tuple
        (q, v, p) at j.
    """
    F = type(t)
    dq, dv, dp = change
    end = axpy(F(0.5) * t * t, g, axpy(t, v, p))
    return quat.mul(q, dq), axpy(t, g, add(v, quat.rotate(q, dv))), add(end, quat.rotate(q, dp))
