"""Motions whose attitude is known, in plain numpy, and the helpers that several tests share.

One family of rates, coning plus a parabola of time for each body, serves most tests: with zeros in
the right places it is pure coning or a constant rate, and every method is compiled for it once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.integrate import solve_ivp

import fastatt as fa

EPS = 2.0**-52
START = np.array([0.6, 0.5, -0.4, 0.48])  # an attitude away from every chart's singularity
START /= np.linalg.norm(START)


def same(a, b):
    """Every bit of two arrays: NaN equals NaN, 0 does not equal −0."""
    return a.shape == b.shape and a.dtype == b.dtype and a.tobytes() == b.tobytes()


# quaternions (..., 4), scalar first, from the definitions


def mul(p, q):
    p, q = np.asarray(p, float), np.asarray(q, float)
    s = p[..., :1] * q[..., :1] - (p[..., 1:] * q[..., 1:]).sum(-1, keepdims=True)
    v = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    return np.concatenate([s, v], axis=-1)


def conj(q):
    return np.asarray(q) * (1.0, -1.0, -1.0, -1.0)


def exp(u):
    u = np.asarray(u, float)
    half = 0.5 * np.linalg.norm(u, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * u], axis=-1)


def matrix(q):
    """C with v_i = C v_b: its columns are q∘e∘q*."""
    e = np.concatenate([np.zeros((3, 1)), np.eye(3)], axis=1)
    q = np.asarray(q, float)[..., None, :]
    return np.swapaxes(mul(mul(q, e), conj(q))[..., 1:], -1, -2)


def rotate(q, v):
    """Inertial components of the vector v given in the body."""
    return np.einsum("...ij,...j->...i", matrix(q), v)


def angle(p, q):
    """Angle between attitudes, rad; relative precision near 0."""
    d = mul(conj(p), q)
    return 2.0 * np.arctan2(np.linalg.norm(d[..., 1:], axis=-1), np.abs(d[..., 0]))


# closed forms


def coning(t, a, omega):
    t = np.asarray(t, float)
    c, s, o = np.cos(0.5 * a), np.sin(0.5 * a), np.zeros_like(t)
    return np.stack([c + o, s * np.cos(omega * t), s * np.sin(omega * t), o], axis=-1)


def precession(t, transverse, axial, frequency, phase, q0=(1.0, 0.0, 0.0, 0.0)):
    """Of w = (A cos(kt + φ0), A sin(kt + φ0), s): q0∘exp(w' t)∘exp(−e3 k t), w' = w(0) + k e3."""
    t = np.asarray(t, float)[..., None]
    w = np.array([transverse * np.cos(phase), transverse * np.sin(phase), axial + frequency])
    return mul(mul(q0, exp(t * w)), exp(-frequency * t * np.array([0.0, 0.0, 1.0])))


def attitude(rate, t0, t1, q0=(1.0, 0.0, 0.0, 0.0), *, frame="body", panels=32):
    """q(t1) of q̇ = ½ q∘w(t), or ½ w∘q, by Gauss collocation with 12 nodes a panel (order 24).

    ``rate`` takes times (k,) to (k, ..., 3); rounding is all its error, a few 1e-16.
    """
    x, weights = legendre.leggauss(12)
    p = legendre.legvander(x, 12)
    k = np.arange(1, 12)
    integrals = np.concatenate([x[:, None] + 1.0, (p[:, 2:] - p[:, :-2]) / (2 * k + 1)], axis=1)
    integrate = integrals @ np.linalg.inv(p[:, :12]) / 2.0
    h = (t1 - t0) / panels
    q = np.asarray(q0, float)
    for panel in range(panels):
        w = np.asarray(rate(t0 + h * (panel + 0.5 * (x + 1.0))), float)
        w = 0.5 * np.concatenate([np.zeros((*w.shape[:-1], 1)), w], axis=-1)
        nodes = np.broadcast_to(q, (*w.shape[:-1], 4))
        for _ in range(25):
            slope = mul(nodes, w) if frame == "body" else mul(w, nodes)
            nodes = q + h * np.einsum("ij,j...->i...", integrate, slope)
        q = q + 0.5 * h * np.einsum("j,j...->...", weights, slope)
        q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return q


def body_motion(inertia, torque, y, begin, end, *, more=lambda t, q, w, y: ()):
    """(q, w, more) at the end by SciPy's DOP853, from Euler's equations as they stand.

    ``torque`` and ``more``, the slopes of what stands after q and w in y, are of (t, q, w, y).
    """
    inertia = np.diag(inertia) if np.ndim(inertia) == 1 else np.asarray(inertia)

    def slope(t, y):
        q, w = y[:4] / np.linalg.norm(y[:4]), y[4:7]
        spin = np.linalg.solve(inertia, torque(t, q, w, y) - np.cross(w, inertia @ w))
        turned = 0.5 * mul(y[:4], np.append(0.0, w))
        return np.concatenate([turned, spin, np.atleast_1d(more(t, q, w, y))])

    y = solve_ivp(slope, (begin, end), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return np.concatenate([y[:4] / np.linalg.norm(y[:4]), y[4:]])


# the family of rates


@dataclass
class Motion:
    """Bodies with rates coning(a, Ω) + c0 + c1 t + c2 t²: a, Ω (N,), c (N, 3, 3)."""

    a: np.ndarray
    omega: np.ndarray
    c: np.ndarray

    @property
    def model(self):
        terms = fa.rates.Coning(self.a, self.omega), fa.rates.Polynomial(self.c)
        return fa.rates.Sum(terms)

    @property
    def scene(self):
        return fa.Scene(rate=self.model)

    @property
    def shared(self):
        """The first body's rates for all."""
        terms = fa.rates.Coning(self.a[0], self.omega[0]), fa.rates.Polynomial(self.c[0])
        return fa.Scene(rate=fa.rates.Sum(terms))

    def take(self, bodies):
        return Motion(self.a[bodies], self.omega[bodies], self.c[bodies])

    def rate(self, t):
        """(..., N, 3) at times (...)."""
        t = np.asarray(t, float)[..., None]
        s, c = np.sin(self.omega * t), np.cos(self.omega * t)
        k = self.omega * np.sin(self.a)
        axial = np.broadcast_to(-2.0 * self.omega * np.sin(0.5 * self.a) ** 2, s.shape)
        t = t[..., None]
        polynomial = self.c[:, 0] + t * self.c[:, 1] + t * t * self.c[:, 2]
        return np.stack([-k * s, k * c, axial], axis=-1) + polynomial

    def increments(self, t):
        """Integrals of the rate over the intervals between the times (n + 1,), (n, N, 3)."""
        t = np.asarray(t, float)
        middle, half = 0.5 * (t[1:] + t[:-1])[:, None], 0.5 * (t[1:] - t[:-1])[:, None]
        # sums to products: the small differences keep their digits
        chord = 2.0 * np.sin(self.a) * np.sin(self.omega * half)
        axial = -4.0 * self.omega * np.sin(0.5 * self.a) ** 2 * half
        cone = np.stack(
            [-chord * np.sin(self.omega * middle), chord * np.cos(self.omega * middle), axial], -1
        )
        m, d = middle[..., None], half[..., None]
        line = self.c[:, 0] + m * self.c[:, 1] + (m * m + d * d / 3.0) * self.c[:, 2]
        return cone + 2.0 * d * line

    def attitude(self, t0, t1, q0=START, *, frame="body"):
        return attitude(self.rate, t0, t1, q0, frame=frame)


def generic(n, seed=6):
    """Rates of about 1.5 rad/s, no axis or plane distinguished."""
    rng = np.random.default_rng(seed)
    scale = np.array([0.5, 0.4, 0.2])[:, None]
    return Motion(
        rng.uniform(0.4, 0.9, n), rng.uniform(0.8, 1.4, n), scale * rng.uniform(-1, 1, (n, 3, 3))
    )


def steady(w):
    """Constant rates (N, 3) in the same family, to the last bit."""
    w = np.atleast_2d(np.asarray(w, float))
    c = np.zeros((len(w), 3, 3))
    c[:, 0] = w
    return Motion(np.zeros(len(w)), np.zeros(len(w)), c)


def cone(a, omega):
    """Pure coning in the same family."""
    return Motion(np.array([a]), np.array([omega]), np.zeros((1, 3, 3)))


# observed orders

# three bodies whose rates change far faster than they rotate: the nodes limit the error of gauss12,
# not its series
SWIFT = Motion(np.array([0.01, 0.009, 0.011]), np.array([40.0, 36.0, 44.0]), np.zeros((3, 3, 3)))
SWIFT_LADDER = (30, 36, 42, 48, 54)


LADDER = np.array([2, 3, 4, 5, 6, 8, 12, 18, 24, 36, 48, 72, 96, 144, 192, 288, 384, 576, 768])


def observed_order(error, span=2.0, floor=2e-13, ladder=LADDER, least=3):
    """Slope of log error over log h, of the four finest steps whose error is above round-off.

    ``error(n)`` is the error (rad) at the end of ``span`` seconds in n steps. Points above 0.03 rad
    are no longer asymptotic.
    """
    found = []
    for n in ladder:
        e = error(int(n))
        if floor < e < 0.03:
            found.append((span / n, e))
        elif e <= floor:
            break
    assert len(found) >= least, found
    h, e = np.log(found[-4:]).T
    return float(np.polyfit(h, e, 1)[0])


# methods

RALSTON3 = fa.runge_kutta(
    "ralston3", order=3, c=(0, 1 / 2, 3 / 4), a=((1 / 2,), (0, 3 / 4)), b=(2 / 9, 1 / 3, 4 / 9)
)

# whose step takes half a second to compile: tested where no other formula stands for theirs
LENGTHY = {m.name for m in fa.METHODS.values() if m.is_stepped and m.order > 8 and m.rate_calls > 4}


def representations(method):
    return method.representations[: 1 if method.name in LENGTHY else None]


def combinations(*, scene="rate", exponential=None):
    """(method, representation) pairs that fit a scene, from the list of methods."""
    return [
        (m.name, r)
        for m in fa.METHODS.values()
        if scene in m.scenes and exponential in (None, m.exponentials > 0)
        for r in representations(m)
    ]
