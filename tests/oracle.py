"""Reference formulas in mpmath (50 digits) and samples that several tests share.

Everything here comes from definitions, not from the kernels. Vectors and quaternions are mpmath
columns, matrices mpmath 3×3; floats are taken exactly.
"""

import math

import mpmath as mp
import numpy as np

mp.mp.dps = 50
EPS = 2.0**-52


# comparison


def numbers(x):
    """The numbers of x, exactly."""
    return [
        c if isinstance(c, mp.mpf) else mp.mpf(float(c) if isinstance(c, np.generic) else c)
        for c in x
    ]


def vec(x):
    """The same as an mpmath column."""
    return mp.matrix(numbers(x))


def floats(x):
    """The numbers of x rounded to a tuple of floats."""
    return tuple(float(c) for c in x)


def norm(x):
    """Euclidean (Frobenius) length; mpmath numbers neither overflow nor underflow."""
    return mp.sqrt(mp.fsum(numbers(x), squared=True))


def _gap(a, b):
    return norm([x - y for x, y in zip(numbers(a), numbers(b), strict=True)])


def distance(a, b):
    """|a − b| of two sequences of numbers."""
    return float(_gap(a, b))


def error(a, b):
    """|a − b| / |b| of two sequences of numbers, 0 for equal zeros."""
    gap = _gap(a, b)
    return float(gap / norm(b)) if gap else 0.0


def relative(found, true):
    """|found − true| / |true| of numbers, 0 for equal zeros."""
    gap = abs(mp.mpf(found) - true)
    return float(gap / abs(true)) if gap else 0.0


def attitude_error(a, b):
    """|a ∓ b| of two unit quaternions, half the angle between their attitudes when small."""
    return min(distance(a, b), distance(a, -vec(b)))


def vector_error(a, u):
    """``error`` of two rotation vectors; within 4 ulps of π, −u is as good as u."""
    wrong = error(a, u)
    return min(wrong, error(a, -vec(u))) if norm(u) > math.pi - 4 * EPS else wrong


def slope(xs, errors):
    """Slope of log error over log x: the observed order."""
    return float(np.polyfit(np.log(floats(xs)), np.log(floats(errors)), 1)[0])


def entries(a):
    """A 3×3 matrix as its nine entries, row by row."""
    return [a[i, j] for i in range(3) for j in range(3)]


def square(c):
    """Nine entries, row by row, as a 3×3 matrix."""
    c = vec(c)
    return mp.matrix([[c[3 * i + j] for j in range(3)] for i in range(3)])


# vectors and quaternions


def cross(a, b):
    return mp.matrix(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def hat(v):
    """[v×]."""
    return mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def quat_mul(p, q):
    """Hamilton product (p0 q0 − p·q, p0 q + q0 p + p×q)."""
    a, b, c, d = p
    e, f, g, h = q
    return mp.matrix(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g + c * e + d * f - b * h,
            a * h + d * e + b * g - c * f,
        ]
    )


def quat_conj(q):
    return mp.matrix([q[0], -q[1], -q[2], -q[3]])


def pure(v):
    """The quaternion (0, v)."""
    return mp.matrix([0, *vec(v)])


def quat_exp(u):
    """(cos θ/2, sin(θ/2) u/θ) of a rotation vector."""
    u = vec(u)
    theta = norm(u)
    s = mp.sin(theta / 2) / theta if theta else mp.mpf(1) / 2
    return mp.matrix([mp.cos(theta / 2), *(s * u)])


def quat_log(q):
    """The shorter rotation vector of q, which need not be a unit quaternion."""
    q = vec(q)
    v = mp.matrix(q[1:])
    length = norm(v)
    if not length:
        return v
    angle = 2 * mp.atan2(length, abs(q[0]))
    return v * (-angle if q[0] < 0 else angle) / length


def quat_angle(p, q):
    """Angle between the attitudes of two quaternions, 2 atan2(|v|, |w|) of p*∘q."""
    r = quat_mul(quat_conj(vec(p)), vec(q))
    return 2 * mp.atan2(norm(r[1:]), abs(r[0]))


def quat_matrix(q):
    """C of q/|q|, its columns the images q∘e∘q*."""
    q = vec(q)
    images = [quat_mul(quat_mul(q, pure(e)), quat_conj(q)) for e in np.eye(3)]
    return mp.matrix([[c[i + 1] for c in images] for i in range(3)]) / norm(q) ** 2


def euler313_rate(angles, derivative):
    """w = (φ̇ sinθ sinψ + θ̇ cosψ, φ̇ sinθ cosψ − θ̇ sinψ, φ̇ cosθ + ψ̇)."""
    _, t, p = numbers(angles)
    f, n, s = numbers(derivative)
    return (
        f * mp.sin(t) * mp.sin(p) + n * mp.cos(p),
        f * mp.sin(t) * mp.cos(p) - n * mp.sin(p),
        f * mp.cos(t) + s,
    )


# rotation vectors


def isotropic(b, c, v):
    """1 + b [v] + c [v]², [v]² = v vᵀ − |v|² 1."""
    v = vec(v)
    x, y, z = b * v
    on = 1 - c * mp.fdot(v, v)
    p, q, r = c * v
    return mp.matrix(
        [
            [on + p * v[0], p * v[1] - z, p * v[2] + y],
            [q * v[0] + z, on + q * v[1], q * v[2] - x],
            [r * v[0] - y, r * v[1] + x, on + r * v[2]],
        ]
    )


def coefficients(z):
    """(sin θ/θ, (1 − cos θ)/θ², (θ − sin θ)/θ³) of z = θ² as hypergeometric series."""
    y = -mp.mpf(z) / 4
    return mp.hyp0f1(1.5, y), mp.hyp1f2(1, 1.5, 2, y) / 2, mp.hyp1f2(1, 2, 2.5, y) / 6


def inverse_coefficient(z):
    """(1 − (θ/2) cot(θ/2))/θ² of z = θ²: the ratio j₁/j₀ as hypergeometric series."""
    y = -mp.mpf(z) / 16
    return mp.hyp0f1(2.5, y) / mp.hyp0f1(1.5, y) / 12


def rodrigues(u):
    """exp [u×] = 1 + sin θ/θ [u] + (1 − cos θ)/θ² [u]²."""
    u = vec(u)
    s, b, _ = coefficients(norm(u) ** 2)
    return isotropic(s, b, u)


def right_jacobian(u, step=mp.mpf(10) ** -20):
    """Jr by its definition exp(u + δ) = exp(u)∘exp(Jr δ), central differences: error 1e-20."""
    u = vec(u)

    def moved(i, x):
        d = mp.matrix([x if j == i else 0 for j in range(3)])
        return quat_log(quat_mul(quat_conj(quat_exp(u)), quat_exp(u + d)))

    columns = [(moved(i, step) - moved(i, -step)) / (2 * step) for i in range(3)]
    return mp.matrix([[c[i] for c in columns] for i in range(3)])


# samples, the same at every run


def uniform(low, high, n, seed=0):
    """n random numbers from low to high."""
    return np.random.default_rng(seed).uniform(low, high, n).tolist()


def powers(low, high, n, seed=0):
    """n random powers of ten from 10^low to 10^high."""
    return [10.0**x for x in uniform(low, high, n, seed)]


def directions(n, seed=0):
    """n random unit vectors."""
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return [tuple(x) for x in (v / np.linalg.norm(v, axis=1)[:, None]).tolist()]


def quaternions(n, seed=0):
    """n random unit quaternions, uniform over the rotations."""
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return [tuple(x) for x in (q / np.linalg.norm(q, axis=1)[:, None]).tolist()]


def vectors(n, seed=0, size=1.0):
    """n random vectors with normal components."""
    v = np.random.default_rng(seed).normal(size=(n, 3)) * size
    return [tuple(x) for x in v.tolist()]


def rotation_vectors(angles, seed=0):
    """A rotation vector of each angle, in random directions."""
    axes = directions(len(angles), seed)
    return [tuple(float(a) * c for c in e) for a, e in zip(angles, axes, strict=True)]


def _angles(regime, n, seed):
    x = np.random.default_rng(seed).uniform(size=n)
    if regime == "tiny":
        return 10.0 ** (-300.0 * x)
    if regime == "near pi":
        return np.append(math.pi - 10.0 ** (-3.0 - 13.0 * x[1:]), math.pi)
    return np.maximum(math.pi * x, 0.01)


REGIMES = ("uniform", "tiny", "near pi")


def rotations(regime, n, seed=0):
    """n rotation vectors of angles in [0.01, π], in [1e-300, 1] or in π − [1e-3, 1e-16]."""
    return rotation_vectors(_angles(regime, n, seed), seed + 1)


def attitudes(regime, n, seed=0):
    """The unit quaternions of ``rotations``, to the last ulp."""
    return [floats(quat_exp(u)) for u in rotations(regime, n, seed)]
