"""Motions of rigid bodies under torques, from the equations of motion and in closed form.

Everything here comes from definitions, not from the package. ``integrate`` carries the equations to
a chosen number of digits in gmpy2's numbers, many times as fast as mpmath's, and gives back
mpmath's. Torques are plain functions (t, q, w) to three components in body axes, with a mass
(t, q, w, v, r) as forces are; they take tuples of gmpy2's or mpmath's numbers, floats or arrays
over bodies alike. Their parameters are floats, taken exactly, or arrays over bodies. Closed forms
are mpmath numbers, attitudes and rates tuples.

Conventions: q scalar first and unit, v_inertial = q∘v_body∘q*, w in body axes, SI units.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

import gmpy2
import mpmath as mp
import numpy as np
import oracle

# vectors, quaternions and tensors as tuples of mpmath numbers, floats or arrays over bodies


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def quat_mul(p, q):
    """Hamilton product (p0 q0 − p·q, p0 q + q0 p + p×q)."""
    x = cross(p[1:], q[1:])
    return (
        p[0] * q[0] - dot(p[1:], q[1:]),
        p[0] * q[1] + q[0] * p[1] + x[0],
        p[0] * q[2] + q[0] * p[2] + x[1],
        p[0] * q[3] + q[0] * p[3] + x[2],
    )


def conj(q):
    return (q[0], -q[1], -q[2], -q[3])


def to_inertial(q, v):
    """C v = v + 2 q0 (u×v) + 2 u×(u×v), u the vector part of the unit quaternion q."""
    s, u = q[0], q[1:]
    x = cross(u, v)
    y = cross(u, x)
    return (
        v[0] + 2 * (s * x[0] + y[0]),
        v[1] + 2 * (s * x[1] + y[1]),
        v[2] + 2 * (s * x[2] + y[2]),
    )


def to_body(q, v):
    """Cᵀ v."""
    return to_inertial(conj(q), v)


def times(matrix, v):
    """Product of a 3×3 matrix, a tuple of rows, and a vector."""
    a, b, c = matrix
    return dot(a, v), dot(b, v), dot(c, v)


def tensor(inertia):
    """Rows of the inertia tensor; moments (3,), a tensor (3, 3), or (N, 3), (N, 3, 3) of bodies."""
    a = np.array(inertia.tolist() if isinstance(inertia, mp.matrix) else inertia)
    if a.shape == (3, 1) or a.shape[-2:] != (3, 3):
        moments = a.ravel() if a.shape == (3, 1) else a
        a = moments[..., None] * np.eye(3, dtype=int)
    if a.ndim == 2:
        return tuple(tuple(row) for row in a.tolist())
    return tuple(tuple(a[..., i, j] for j in range(3)) for i in range(3))


def quickly(rows):
    """The same as gmpy2's numbers."""
    return tuple(tuple(map(to_gmpy2, row)) for row in rows)


def inverse(matrix):
    """Inverse of a symmetric 3×3 matrix: its cofactors over its determinant."""
    a, b, c = matrix
    cofactors = cross(b, c), cross(c, a), cross(a, b)
    determinant = dot(a, cofactors[0])
    return tuple(tuple(cofactors[i][j] / determinant for j in range(3)) for i in range(3))


def functions_of(x):
    """Where the elementary functions of x are: mpmath, gmpy2 or numpy."""
    return {mp.mpf: mp, gmpy2.mpfr: gmpy2}.get(type(x), np)


def length(v):
    square = dot(v, v)
    return functions_of(square).sqrt(square)


def _side(x):
    """1 where x ≥ 0, −1 elsewhere."""
    if isinstance(x, np.ndarray):
        return np.where(x >= 0.0, 1.0, -1.0)
    return 1 if x >= 0 else -1


def _numbers(values, n):
    """N parameters as plain numbers or arrays over bodies, from n of them or (N, n) of bodies."""
    a = np.asarray(values, float)
    if a.ndim == 0:
        return (float(a),) * n
    return tuple(a.tolist()) if a.ndim == 1 else tuple(np.moveaxis(a, -1, 0))


# equations of motion


class State(NamedTuple):
    """Attitude, angular velocity; velocity in body axes and inertial position where carried."""

    q: Any
    w: Any
    v: Any = None
    r: Any = None


def equations(inertia, torque=None, *, force=None, mass=None):
    """(t, y) to dy/dt, y = (q, w) or (q, w, v, r) as one flat tuple.

    q̇ = ½ q∘w, (I w)˙ = I w×w + τ, and with a mass v̇ = F/μ − w×v, ṙ = C v.
    """
    inertia = tensor(inertia)
    solve = inverse(inertia)

    def slope(t, y):
        q, w, v, r = y[:4], y[4:7], y[7:10], y[10:]
        turn = [c / 2 for c in quat_mul(q, (0, *w))]
        moment = cross(times(inertia, w), w)
        if torque is not None:
            given = (t, q, w) if mass is None else (t, q, w, v, r)
            moment = [a + b for a, b in zip(moment, torque(*given), strict=True)]
        rates = (*turn, *times(solve, moment))
        if mass is None:
            return rates
        swept = cross(w, v)
        push = (0, 0, 0) if force is None else force(t, q, w, v, r)
        return (*rates, *(push[i] / mass - swept[i] for i in range(3)), *to_inertial(q, v))

    return slope


def momentum(inertia, w):
    """I w."""
    return times(tensor(inertia), w)


def kinetic_energy(inertia, w):
    """½ w·I w."""
    return dot(w, momentum(inertia, w)) / 2


# integration to many digits


@contextmanager
def many_digits(n):
    """n digits, of mpmath's and of gmpy2's numbers."""
    with mp.workdps(n), gmpy2.context(gmpy2.get_context(), precision=mp.mp.prec):
        yield


def to_gmpy2(x):
    """x as gmpy2's number."""
    if not isinstance(x, mp.mpf):
        return gmpy2.mpfr(float(x) if isinstance(x, np.generic) else x)
    sign, mantissa, exponent, _ = x._mpf_
    return gmpy2.mpfr(-mantissa if sign else mantissa) * gmpy2.mpfr(2) ** exponent


def to_mpmath(x):
    """x as mpmath's number."""
    return mp.mpf(tuple(map(int, x.as_mantissa_exp())) if isinstance(x, gmpy2.mpfr) else x)


def _midpoint(slope, t, y, first, h, n):
    """Gragg's midpoint rule over h in an even number n of substeps; its error is even in h/n."""
    d = h / n
    twice = 2 * d
    before, now = y, [a + d * b for a, b in zip(y, first, strict=True)]
    for k in range(1, n):
        rate = slope(t + k * d, now)
        before, now = now, [a + twice * b for a, b in zip(before, rate, strict=True)]
    return now


def _step(slope, t, y, h, tolerance, rows):
    """One extrapolated step: (y at t + h, rows used), or (None, rows) without convergence."""
    first = slope(t, y)
    old: list = []
    for j in range(1, rows + 1):
        new = [_midpoint(slope, t, y, first, h, 2 * j)]
        for k in range(1, j):
            ratio = gmpy2.mpfr((j - k) ** 2) / (j * j - (j - k) ** 2)
            pairs = zip(new[k - 1], old[k - 1], strict=True)
            new.append([a + (a - b) * ratio for a, b in pairs])
        if j > 2:
            gap = max(abs(a - b) for a, b in zip(new[-1], new[-2], strict=True))
            scale = max(1, *(abs(a) for a in new[-1]))
            if gap < tolerance * scale:
                return new[-1], j
            if j > rows // 2 and gap > gmpy2.sqrt(tolerance) * scale:
                break
        old = new
    return None, rows


def solve(slope, y0, instants, *, digits=30, step=0.5):
    """y at each of the instants, of ẏ = slope(t, y), y(0) = y0, as mpmath numbers.

    Gragg's midpoint rule extrapolated in the square of the substep (Bulirsch and Stoer), rows added
    until two agree to 10^−digits of the larger of 1 and |y|; the step follows the number of rows.
    ``slope`` has to be smooth: a jump in it can be missed. The error at the end is a few 10^−digits
    for stable motions.
    """
    rows = max(8, int(0.7 * digits))
    with many_digits(digits + 12):
        tolerance = gmpy2.mpfr(10) ** -digits
        t, y = to_gmpy2(0), [to_gmpy2(c) for c in y0]
        h = to_gmpy2(step)
        found = []
        for end in map(to_gmpy2, instants):
            while t != end:
                last = abs(end - t) <= h
                part = end - t if last else h * _side(end - t)
                new, used = _step(slope, t, y, part, tolerance, rows)
                if new is None:
                    h = abs(part) / 2
                    if h < gmpy2.mpfr(10) ** (-digits / 3.0):
                        raise ArithmeticError(f"no convergence at t = {float(t):.8g}")
                    continue
                t, y = (end if last else t + part), new
                if not last:
                    h *= gmpy2.mpfr(10 + rows - used) / 14
            found.append(tuple(map(to_mpmath, y)))
    return found


def integrate(
    inertia, q0, w0, t, torque=None, digits=30, force=None, mass=None, v0=None, r0=(0, 0, 0)
):
    """Motion of one body from t = 0: a State of mpmath numbers for a number t, or a list.

    Floats are taken exactly, mpmath numbers as they are. With a mass the velocity v0 and the
    inertial position r0 are carried along; torque and force are then functions of them too.
    """
    with many_digits(digits + 12):
        slope = equations(quickly(tensor(inertia)), torque, force=force, mass=mass)
    y0 = [*q0, *w0]
    if mass is not None:
        y0 += [*v0, *r0]
    single = np.ndim(t) == 0
    found = solve(slope, y0, [t] if single else t, digits=digits)
    states = [State(y[:4], y[4:7], y[7:10] or None, y[10:] or None) for y in found]
    return states[0] if single else states


# torques


def constant_body(torque):
    """A torque constant in body axes."""
    torque = _numbers(torque, 3)
    return lambda t, q, w: torque


def constant_inertial(torque):
    """A torque constant in inertial axes."""
    torque = _numbers(torque, 3)
    return lambda t, q, w: to_body(q, torque)


def linear_damping(c):
    """−c w, c one number or one an axis."""
    c = _numbers(c, 3)
    return lambda t, q, w: tuple(-a * b for a, b in zip(c, w, strict=True))


def quadratic_damping(c):
    """−c |w| w, c one number or one an axis."""
    c = _numbers(c, 3)

    def torque(t, q, w):
        size = length(w)
        return tuple(-a * size * b for a, b in zip(c, w, strict=True))

    return torque


def gravity_gradient(inertia, mean_motion):
    """3 n² o×(I o) in a circular orbit, o = Cᵀ(cos nt, sin nt, 0) the radial direction."""
    inertia, n = tensor(inertia), mean_motion

    def torque(t, q, w):
        f = functions_of(t)
        o = to_body(q, (f.cos(n * t), f.sin(n * t), 0))
        return tuple(3 * (n * (n * c)) for c in cross(o, times(inertia, o)))

    return torque


def heavy_top(weight, centre):
    """r×Cᵀ(0, 0, −weight), r the centre of mass seen from the fixed point, body axes."""
    weight, centre = float(weight), _numbers(centre, 3)
    return lambda t, q, w: cross(centre, to_body(q, (0, 0, -weight)))


def dipole(moment, field):
    """μ×Cᵀ B of a magnetic moment fixed in the body in a field fixed in space."""
    moment, field = _numbers(moment, 3), _numbers(field, 3)
    return lambda t, q, w: cross(moment, to_body(q, field))


def pd_control(kp, kd, reference=(1.0, 0.0, 0.0, 0.0)):
    """−kp sgn(e0) e − kd w, (e0, e) = q_ref*∘q: proportional and derivative, the shorter way."""
    kp, kd, reference = float(kp), float(kd), _numbers(reference, 4)

    def torque(t, q, w):
        e = quat_mul(conj(reference), q)
        side = _side(e[0])
        return tuple(-kp * side * e[i + 1] - kd * w[i] for i in range(3))

    return torque


def rotor(momentum):
    """h×w: a rotor of constant angular momentum h in body axes (gyrostat)."""
    momentum = _numbers(momentum, 3)
    return lambda t, q, w: cross(momentum, w)


def potential_v(t, q, w):
    """Of the potential U = q0² − q1² − q2² + q3²: τᵢ = −dU along ½ q∘eᵢ.

    τ = 2 (q0 q1 + q2 q3, q0 q2 − q1 q3, 0). U is C33: a heavy top of unit weight whose centre of
    mass is at e3.
    """
    return 2 * (q[0] * q[1] + q[2] * q[3]), 2 * (q[0] * q[2] - q[1] * q[3]), 0 * q[0]


def total(*torques):
    """The sum of torques."""

    def torque(t, q, w):
        parts = [f(t, q, w) for f in torques]
        return tuple(sum(p[i] for p in parts) for i in range(3))

    return torque


# closed forms


def symmetric_top(q0, w0, i1, i3, t):
    """(q, w) of the free body (I1, I1, I3): exp(L t/I1)∘q0∘exp(e3 (1/I3 − 1/I1) m3 t)."""
    q0, w0 = oracle.vec(q0), oracle.vec(w0)
    m = (i1 * w0[0], i1 * w0[1], i3 * w0[2])
    spin = (1 / mp.mpf(i3) - 1 / mp.mpf(i1)) * m[2] * t
    fixed = [c * t / i1 for c in to_inertial(q0, m)]
    q = oracle.quat_mul(oracle.quat_mul(oracle.quat_exp(fixed), q0), oracle.quat_exp((0, 0, spin)))
    c, s = mp.cos(spin), mp.sin(spin)
    return tuple(q), (c * w0[0] + s * w0[1], c * w0[1] - s * w0[0], w0[2])


# known bodies


@dataclass(frozen=True)
class Body:
    """Principal moments, momentum at t = 0 where q = 1, and {t: (m, q)} of its free motion."""

    inertia: tuple
    m0: tuple
    states: dict
    digits: int

    @property
    def w0(self):
        return tuple(m / i for m, i in zip(self.m0, self.inertia, strict=True))


# t, momentum and attitude, as printed
OF_BODY_H = """
1 .36911008085046066592 -.37284632112143345150 .85131860606988927604 .78176140149180933689
  .11851844622047864698 -.09161551799902148766 .60531734313896588275
10 .40706613658804081086 .28300742681284407600 .86844916766156164371 .76511103082931145209
  .37431955148322395406 .10285413145504199651 .51372269905400852650
"""
OF_BODY_V = """
10 1.7659625085182075 -.6954641970330891 .7795549814818711 -.7360613641607939
  -.5707869512403508 -.2993885718307901 -.2068390861046732
"""


def _states(printed):
    x = [mp.mpf(number) for number in printed.split()]
    rows = [x[i : i + 8] for i in range(0, len(x), 8)]
    return {int(t): (tuple(row[:3]), tuple(row[3:])) for t, *row in rows}


with mp.workdps(50):
    # Hairer, Lubich and Wanner, Geometric Numerical Integration
    slant = mp.mpf("1.1")
    moments = mp.mpf(2), mp.mpf(1), mp.mpf(2) / 3
    BODY_H = Body(moments, (mp.cos(slant), mp.mpf(0), mp.sin(slant)), _states(OF_BODY_H), 20)
    # Hairer and Vilmart, J. Phys. A 39 (2006)
    moments, m0 = (tuple(map(mp.mpf, x.split())) for x in (".6 .8 1", "1.8 .4 -.9"))
    BODY_V = Body(moments, m0, _states(OF_BODY_V), 16)

# body H about its intermediate axis, |m| = 1, tipped by ε towards the axis of I = 2
FLIP_TIMES = {1e-2: 22.57956386, 1e-4: 41.00024457}
