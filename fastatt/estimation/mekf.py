"""Multiplicative extended Kalman filter: attitude and gyro bias, one filter or an ensemble of them.

The estimate is q, the gyro's bias b and the covariance of the error (δθ, δb) of
``fastatt.kernels.error_state``: q_true = q∘exp(δθ), b_true = b + δb, δθ in body axes. As kernels,
``mekf_predict`` and the updates take tuples and are called from ``@njit`` code too; a covariance is
there (P11, P12, P22) with 6, 9 and 6 numbers. ``MEKF`` is the same on arrays. Lefferts, Markley and
Shuster, J. Guidance 5 (1982) 417; Markley and Crassidis, *Fundamentals of Spacecraft Attitude
Determination and Control* (2014), §6.2. The covariance is updated in Joseph's form and symmetric by
construction.

Updates by a vector and by an attitude are linearised anew about what they find, four times (an
iterated extended Kalman filter), with the prior covariance along the axes that a rotation from the
prior estimate gives: what a vector can't tell, the rotation about it, then stays as unknown as it
was (Barrau and Bonnabel, IEEE Trans. Automatic Control 62 (2017) 1797).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.codegen.rows import Rows
from fastatt.codegen.scalar import scalar_function
from fastatt.estimation.amounts import at_least_zero, interval, variance
from fastatt.estimation.filters import (
    NEARLY_SETTLED,
    PASSES,
    Estimates,
    attitude_covariance,
    largest_square,
    measured_attitudes,
)
from fastatt.kernels import dcm, error_state, quat, sym3, trig
from fastatt.kernels.vec3 import add, axpy, dot, scale, sub
from fastatt.tracing.formulas import Vector
from fastatt.tracing.trace import stand_in

_formula = partial(scalar_function, rewritten=True)
_error_state: Any = stand_in(error_state)


@_formula
def mekf_predict(q, b, P, gyro, h, angle_variance, bias_variance):
    """(q, P) one gyro sample (rad/s, held for h s) later; b stays.

    ``angle_variance`` σ_v² (rad²/s) and ``bias_variance`` σ_u² (rad²/s³) are the squares of the
    angle random walk and of the bias random walk. Exact for a rate that is constant over h.
    """
    w = sub(gyro, b)
    u = scale(h, w)
    phi = error_state.transition(u, h)
    noise = error_state.noise(u, h, angle_variance, bias_variance)
    return quat.mul(q, quat.exp(u)), error_state.predict(P, phi, noise)


@_formula
def joseph(P, d, z, h, r):
    """(P, d, NIS) by one number z = h·δθ + noise of variance r, d = (δθ, δb) found so far, flat.

    Joseph's form, (1 − K h) P (1 − K h)ᵀ + K r Kᵀ: positive whatever the rounding of the gain.
    """
    p11, p12, p22 = P
    o = type(r)(0.0)
    one = type(r)(1.0)
    c = dcm.rotate(sym3.full(p11), h)
    e = dcm.rotate_inverse(p12, h)
    inverse = one / (dot(h, c) + r)
    k = scale(inverse, c)
    g = scale(inverse, e)
    a = dcm.add((one, o, o, o, one, o, o, o, one), outer(scale(-one, k), h))
    n11 = sym3.add(sym3.congruence(a, p11), sym3.scale(r, square(k)))
    n12 = dcm.mul(a, dcm.add(p12, outer(scale(-one, c), g)))
    n12 = dcm.add(n12, outer(scale(r, k), g))
    n22 = sym3.add(p22, sym3.scale(-inverse, square(e)))
    x = z - (h[0] * d[0] + h[1] * d[1] + h[2] * d[2])
    d = add((d[0], d[1], d[2]), scale(x, k)) + add((d[3], d[4], d[5]), scale(x, g))
    return (n11, n12, n22), d, inverse * x * x


@_formula
def outer(a, b):
    """a bᵀ, nine numbers."""
    return scale(a[0], b) + scale(a[1], b) + scale(a[2], b)


@_formula
def square(a):
    """a aᵀ, as of ``sym3``."""
    return a[0] * a[0], a[0] * a[1], a[0] * a[2], a[1] * a[1], a[1] * a[2], a[2] * a[2]


@_formula
def taken_apart(R):
    """(l1, l2, l3, r1, r2) of R = L D Lᵀ, L = [1 0 0; l1 1 0; l2 l3 1], D = diag(R11, r1, r2)."""
    o = type(R[0])(0.0)
    l1 = R[1] / R[0] if R[0] > o else o
    l2 = R[2] / R[0] if R[0] > o else o
    r1 = R[3] - l1 * R[1]
    m = R[4] - l1 * R[2]
    l3 = m / r1 if r1 > o else o
    return l1, l2, l3, r1, R[5] - l2 * R[2] - l3 * m


@_formula
def by_three(P, d, z, H, R):
    """(P, d, NIS) by three numbers z = H δθ + noise of covariance R, one after the other.

    With R = L D Lᵀ taken apart, so that nothing is inverted that a precise direction makes
    singular.
    """
    l1, l2, l3, r1, r2 = taken_apart(R)
    h0 = (H[0], H[1], H[2])
    h1 = axpy(-l1, h0, (H[3], H[4], H[5]))
    h2 = axpy(-l3, h1, axpy(-l2, h0, (H[6], H[7], H[8])))
    z1 = z[1] - l1 * z[0]
    z2 = z[2] - l2 * z[0] - l3 * z1
    P, d, n0 = joseph(P, d, z[0], h0, R[0])
    P, d, n1 = joseph(P, d, z1, h1, r1)
    P, d, n2 = joseph(P, d, z2, h2, r2)
    return P, d, n0 + n1 + n2


@_formula
def mekf_update(q, b, P, z, H, R):
    """(q, b, P, NIS) by a residual z (3) = H δθ + noise of covariance R (6, as of ``sym3``).

    H has nine numbers, row by row. NIS, the sum of the normalised innovations squared, is χ² with
    three degrees of freedom where the filter is right and R of full rank. A gate takes what this
    gives where NIS is small enough, and else what it was given. P stays along the axes of the q
    that it was given, which is right for corrections far below 1 rad.
    """
    o = type(q[0])(0.0)
    P, d, nis = by_three(P, (o, o, o, o, o, o), z, H, R)
    return corrected(q, d), add(b, (d[3], d[4], d[5])), P, nis


@_formula
def corrected(q, d):
    """q with the δθ of an error (δθ, δb), flat, taken in."""
    return quat.renormalise(quat.mul(q, quat.exp((d[0], d[1], d[2]))))


@_formula
def seen_from(a, q, P):
    """(P, d): the covariance about q and the mean error (δθ, δb) that q has, seen from a."""
    o = type(a[0])(0.0)
    r = quat.mul(quat.conj(a), q)
    return error_state.to_inertial(dcm.from_quat(r), P), (*quat.log(r), o, o, o)


@_formula
def gated(before, after, nis, gate):
    """What an update makes of an estimate, or the estimate where NIS is beyond a gate, or NaN."""
    return after if nis <= gate else before


@_formula
def mekf_update_vector(q, b, P, measured, reference, variance):
    """(q, b, P, NIS) by a vector: ``measured`` in body axes, ``reference`` along inertial ones.

    A direction to a star or the Sun, the magnetic field, gravity. ``variance`` is that of each
    component, in the vector's unit squared. The angle from the expected vector to the measured one
    is used; the difference of their lengths, of which rounding would make an angle where the others
    are precise, counts in NIS.
    """
    return by_vector(q, b, P, measured, reference, variance)[:4]


@_formula
def by_vector(q, b, P, measured, reference, variance):
    """(q, b, P, NIS, nonlinearity): of an update that is trustworthy the last is at most 1.

    It is the larger of what the variances of the attitude have lost together, rad², and of the
    normalised square of the last correction, by that of three deviations.
    """
    F = type(q[0])
    o = F(0.0)
    one = F(1.0)
    a = q
    for k in range(PASSES):
        p, d = seen_from(a, q, P)
        expected = quat.rotate_inverse(a, reference)
        length = math.sqrt(dot(expected, expected))
        n = scale(one / length if length > o else o, expected)
        x, y = across(n)
        u = dot(x, measured)
        v = dot(y, measured)
        sine = math.sqrt(u * u + v * v)
        along = dot(n, measured)
        # from the components across to the arc
        m = length * trig.atan2(sine, along) / sine if sine > o else o
        p, d, n0 = joseph(p, d, m * u, scale(-length, y), variance)
        p, d, n1 = joseph(p, d, m * v, scale(length, x), variance)
        a = corrected(a, d)
        if k == 0:
            nis = n0 + n1 + (along - length) * (along - length) / variance
    last = normalised_square(p[0], d) / F(NEARLY_SETTLED)
    nonlinearity = larger(trace(P[0]) - trace(p[0]), last)
    return a, add(b, (d[3], d[4], d[5])), p, nis, nonlinearity


@_formula
def larger(a, b):
    """The larger of two numbers."""
    return a if a > b else b


@_formula
def trace(s):
    """Trace of a symmetric matrix."""
    return s[0] + s[3] + s[5]


@_formula
def normalised_square(s, d):
    """dᵀ s⁻¹ d of a covariance s and the first three numbers of d, 0 along what has no variance."""
    o = type(d[0])(0.0)
    l1, l2, l3, s1, s2 = taken_apart(s)
    x = d[1] - l1 * d[0]
    y = d[2] - l2 * d[0] - l3 * x
    first = d[0] * d[0] / s[0] if s[0] > o else o
    second = x * x / s1 if s1 > o else o
    third = y * y / s2 if s2 > o else o
    return first + second + third


@_formula
def across(n):
    """Two axes across a unit vector: Duff et al., J. Computer Graphics Techniques 6 (2017) 1."""
    F = type(n[0])
    one = F(1.0)
    s = one if n[2] >= F(0.0) else -one
    a = -one / (s + n[2])
    m = n[0] * n[1] * a
    return (one + s * n[0] * n[0] * a, s * m, -s * n[0]), (m, s + n[1] * n[1] * a, -n[1])


@_formula
def mekf_update_attitude(q, b, P, measured, R):
    """(q, b, P, NIS) by a whole attitude, such as a star tracker's; R (6, as of ``sym3``), rad²."""
    F = type(q[0])
    o = F(0.0)
    one = F(1.0)
    a = q
    for k in range(PASSES):
        p, d = seen_from(a, q, P)
        z = quat.log(quat.mul(quat.conj(a), measured))
        p, d, found = by_three(p, d, z, (one, o, o, o, one, o, o, o, one), R)
        a = corrected(a, d)
        if k == 0:
            nis = found
    return a, add(b, (d[3], d[4], d[5])), p, nis


# ensembles: of the numbers of one filter


def _predicted(q: Vector, b: Vector, P: Vector, gyro: Vector, known: Vector) -> Any:
    q, p = mekf_predict(q, b, _error_state.blocks(P), gyro, *known)
    return q, _error_state.matrix(p)


def _by_vector(q: Vector, b: Vector, P: Vector, pair: Vector, known: Vector) -> Any:
    state = q, b, _error_state.blocks(P)
    found = by_vector(*state, pair[:3], pair[3:], known[1])
    return (*_updated(state, found, known), found[4])


def _by_attitude(q: Vector, b: Vector, P: Vector, measured: Vector, known: Vector) -> Any:
    state = q, b, _error_state.blocks(P)
    return _updated(state, mekf_update_attitude(*state, measured, known[1:]), known)


def _updated(state: Any, found: Any, known: Vector) -> Any:
    q, b, p = gated(state, found[:3], found[3], known[0])
    return q, b, _error_state.matrix(p), found[3]


def _operation(formula: Any, own: int, known: int, *outputs: int | None) -> Rows:
    inputs = {"q": 4, "b": 3, "P": 36, "own": own, "known": known}
    return Rows(formula, inputs, outputs)


_OPERATIONS = {
    "predict": _operation(_predicted, 3, 3, 4, 36),
    "vector": _operation(_by_vector, 6, 2, 4, 3, 36, None, None),
    "attitude": _operation(_by_attitude, 4, 7, 4, 3, 36, None),
}


_UPPER = [0, 1, 2, 4, 5, 8]  # of a matrix (3, 3), as of ``sym3``


class _Call(NamedTuple):
    """An operation on a filter's arrays: what is measured by each, (n, k), and what all share."""

    run: Callable[[], object]
    own: NDArray[np.float64]
    known: NDArray[np.float64]
    nis: NDArray[np.float64]
    nonlinearity: NDArray[np.float64]


class MEKF(Estimates):
    """Attitude and gyro bias of one body, or of N at once, each with its own covariance.

    Parameters
    ----------
    q : (4,) or (N, 4), attitudes, body to inertial, of any length but zero.
    covariance : (6, 6) or (N, 6, 6), of (δθ, δb) in rad and rad/s.
    bias : (3,) or (N, 3), rad/s.
    angle_noise : σ_v, rad/√s (a noise density of the rate, rad/s/√Hz, is the same number).
    bias_noise : σ_u, rad/s^1.5.
    invalid : "raise" refuses samples and measurements that are not finite; "skip" leaves out such
        a measurement for the filters that it is for, and holds the last good sample of a gyro in
        its place (before the first: no turn).

    Attributes
    ----------
    q, bias, covariance : the estimates, with the shapes above.

    Every call changes them in place. A ``predict`` of one filter takes 2 µs from Python, of many
    0.06 µs a filter.

    Updates give the normalised innovation squared (NIS), a number or (N,): χ² with three degrees of
    freedom where the filter is right, of a direction, whose length says nothing, with about two.
    One beyond ``gate`` is not used: of good measurements 1 in 1000 is beyond 16.27, of directions
    13.82 (``scipy.stats.chi2.ppf(0.999, 3)`` or 2). NIS is NaN where a measurement was left out.
    """

    def __init__(
        self,
        q: ArrayLike,
        covariance: ArrayLike,
        *,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        angle_noise: float,
        bias_noise: float,
        invalid: str = "raise",
    ) -> None:
        rates = checks.array("bias", bias, "(3,) or (N, 3)")
        super().__init__(q, "bias", rates, covariance, invalid)
        self._gyro = self._y.copy()
        self._variances = (
            at_least_zero("angle_noise", angle_noise) ** 2,
            at_least_zero("bias_noise", bias_noise) ** 2,
        )
        self._calls: dict[str, _Call] = {}

    def __getstate__(self) -> dict[str, Any]:
        # calls hold the addresses of arrays, of which a copy has its own
        return {**self.__dict__, "_calls": {}}

    def _call(self, name: str) -> _Call:
        found = self._calls.get(name)
        if found is None:
            n, operation = len(self._q), _OPERATIONS[name]
            own = np.empty((n, operation.inputs["own"] or 0))
            own = self._gyro if name == "predict" else own
            known = np.empty((1, operation.inputs["known"] or 0))
            nis, nonlinearity = np.empty(n), np.empty(n)
            state = [self._q, self._y, self._P.reshape(n, 36)]
            out = [*state, nis, nonlinearity][: len(operation.outputs)]
            if name == "predict":
                known[0, 1:] = self._variances
                out = [state[0], state[2]]
            run = operation.bound([*state, own, known], out)
            found = self._calls[name] = _Call(run, own, known[0], nis, nonlinearity)
        return found

    @property
    def bias(self) -> NDArray[np.float64]:
        """Biases, (3,) or (N, 3), rad/s."""
        return self._each(self._y)

    def predict(self, gyro: ArrayLike, dt: float) -> None:
        """Go dt s on by a gyro sample, (3,) or (N, 3), rad/s; an increment over dt divided by dt.

        Raises ``ValueError`` for another shape, an interval not above 0, and as ``invalid`` says.
        """
        rates, finite = self._vectors("gyro", gyro)
        h = interval(dt)
        call = self._calls.get("predict") or self._call("predict")
        if finite:
            call.own[:] = rates
        else:
            np.copyto(call.own, rates, where=np.isfinite(rates).all(axis=-1, keepdims=True))
        call.known[0] = h
        call.run()

    def update_vector(
        self, measured: ArrayLike, reference: ArrayLike, sigma: float, *, gate: float | None = None
    ) -> Any:
        """Use a vector: measured in body axes, its reference along inertial ones; (3,) or (N, 3).

        ``sigma`` is the standard deviation of each component, in the vectors' unit, above 0. Gives
        NIS, and does not use vectors for which it is beyond ``gate``.

        Raises ``ValueError`` for another shape, and as ``invalid`` says.
        """
        call = self._call("vector")
        seen, fixed = (
            self._vectors(*x)[0] for x in (("measured", measured), ("reference", reference))
        )
        known = largest_square(gate), variance("sigma", sigma)
        call.own[:, :3], call.own[:, 3:], call.known[:] = seen, fixed, known
        call.run()
        return self._judged(call.nis.copy(), gate, call.nonlinearity)

    def update_attitude(
        self, measured: ArrayLike, sigma: ArrayLike, *, gate: float | None = None
    ) -> Any:
        """Use attitudes, (4,) or (N, 4), unit; such as a star tracker's.

        ``sigma`` is the standard deviation about each body axis, rad, a number or (3,), or their
        covariance (3, 3). Gives NIS, and does not use attitudes for which it is beyond ``gate``.

        Raises ``ValueError`` for another shape, and as ``invalid`` says.
        """
        rows = measured_attitudes(measured, len(self._q), skips=self._skips)
        call = self._call("attitude")
        known = largest_square(gate), *attitude_covariance(sigma).ravel()[_UPPER]
        call.own[:], call.known[:] = rows, known
        call.run()
        return self._judged(call.nis.copy(), gate)

    def nees(self, q: ArrayLike, bias: ArrayLike) -> Any:
        """Normalised estimation error squared against the truth, χ² with 6 degrees of freedom."""
        return super().nees(q, bias)
