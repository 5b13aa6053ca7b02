"""Quaternion kernels against mpmath, and the axioms that they obey."""

import math

import mpmath as mp
import numpy as np
import oracle as mo
import pytest
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from fastatt.kernels import quat

N = 300
ONE = (1.0, 0.0, 0.0, 0.0)
# one product of unit quaternions or of a matrix and a vector rounds by less than this
PRODUCT = 4 * mo.EPS
FINITE = st.floats(allow_nan=False, allow_infinity=False)
arbitrary = settings(max_examples=300, deadline=None, derandomize=True, database=None)

regimes = pytest.mark.parametrize("regime", mo.REGIMES)


def pairs(regime, n=N):
    """Two attitudes, apart by the angles of the regime."""
    first = mo.quaternions(n, 11)
    apart = mo.rotations(regime, n, 12)
    second = [
        mo.floats(mo.quat_mul(mo.vec(p), mo.quat_exp(u))) for p, u in zip(first, apart, strict=True)
    ]
    return list(zip(first, second, strict=True))


# exponential and logarithm


@regimes
def test_exp(regime):
    for u in mo.rotations(regime, 1000):
        q, true = quat.exp(u), mo.quat_exp(u)
        assert mo.distance(q, true) <= 4e-16
        assert mo.error(q[1:], true[1:]) <= 4e-16


@regimes
def test_exp_short_is_exp(regime):
    inside = [tuple(c * (1.0 - 2.0 * mo.EPS) for c in u) for u in mo.rotations(regime, 1000)]
    for u in [*inside, (math.pi, 0.0, 0.0), (0.0, 0.0, -math.pi)]:
        assert quat.exp_short(u) == quat.exp(u)


@regimes
def test_log(regime):
    for q in mo.attitudes(regime, 1000):
        assert mo.error(quat.log(q), mo.quat_log(q)) <= 1e-15
        opposite = tuple(-c for c in q)
        assert mo.error(quat.log(opposite), mo.quat_log(opposite)) <= 1e-15


@pytest.mark.parametrize("size", [1e-200, 1e-3, 7.0, 1e200])
def test_log_of_any_length(size):
    for q in mo.quaternions(N):
        q = tuple(size * c for c in q)
        assert mo.error(quat.log(q), mo.quat_log(q)) <= 1e-15


def test_nothing_is_lost_at_zero_and_at_half_a_turn():
    for u in ((0.0, 0.0, 0.0), (0.0, -0.0, 0.0)):
        assert quat.exp(u) == quat.exp_short(u) == ONE
    assert quat.log(ONE) == quat.log((-1.0, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert quat.exp((2e-300, 0.0, -4e-310)) == (1.0, 1e-300, 0.0, -2e-310)
    assert quat.log((1.0, 1e-300, 0.0, -2e-310)) == (2e-300, 0.0, -4e-310)
    for size in (1.0, 5e-324):
        for sign in (1.0, -1.0):
            assert quat.log((0.0, 0.0, sign * size, 0.0)) == (0.0, sign * math.pi, 0.0)
    assert quat.log((5e-324, 0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
    assert np.isnan(quat.log((0.0, 0.0, 0.0, 0.0))).all()


def test_exp_beyond_pi():
    """The angle may move by 1.5 ulps, the quaternion by half of that."""
    for u in mo.rotation_vectors(mo.powers(math.log10(math.pi), 6, 1000)):
        allowed = 5e-16 + 0.75 * math.ulp(float(mo.norm(u)))
        assert mo.distance(quat.exp(u), mo.quat_exp(u)) <= allowed


def test_exp_next_to_whole_and_half_turns():
    """On a coordinate axis θ is exact, so that nothing is allowed for its rounding."""
    for k in mo.uniform(1, 318309, 300):
        turn = math.floor(k) * math.pi
        for x in (turn - math.ulp(turn), turn, turn + math.ulp(turn)):
            assert mo.distance(quat.exp((0.0, x, 0.0)), mo.quat_exp((0, x, 0))) <= 5.5e-16


@njit
def single_exp(x, y, z):
    """exp in float32, what Python's floats can't ask for."""
    return quat.exp((np.float32(x), np.float32(y), np.float32(z)))


HUGE = [1e7, 1e16, 9.9e16, 1.1e17, 1e100, 9e149, 1.1e150, 1e200, 1e308]


@each("size, single", [*((x, False) for x in HUGE), *((x, True) for x in (1e3, 1e10, 1e18, 1e38))])
def test_exp_of_huge_angles(size, single):
    """Of each precision: unit, about the given axis."""
    eps = mo.EPS * 2**29 if single else mo.EPS
    for u in mo.rotation_vectors([size] * 50):
        q = single_exp(*u) if single else quat.exp(u)
        assert abs(mo.norm(q) - 1) <= 5e-16 / mo.EPS * eps
        axis, v = mo.vec(u) / mo.norm(u), mo.vec(q[1:]) / mo.norm(q[1:])
        assert min(mo.distance(v, axis), mo.distance(v, -axis)) <= 2 * eps


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_exp_shows_a_non_finite_angle(bad, place):
    u = [0.1, 0.2, 0.3]
    u[place] = bad
    assert np.isnan(quat.exp(tuple(u))).any()


# length


@arbitrary
@given(st.tuples(FINITE, FINITE, FINITE, FINITE).filter(any))
def test_normalise_anything(q):
    for found, true in zip(quat.normalise(q), mo.vec(q) / mo.norm(q), strict=True):
        assert abs(found - true) <= 4e-16


@each(
    "q",
    [
        (1e200, -3e200, 2e200, 5e200), (1e-200, -3e-200, 2e-200, 5e-200),
        (1.7e308, 1.7e308, -1.7e308, 1.7e308), (5e-324, 0.0, -5e-324, 1e-323),
        (1e-310, 2e-310, 3e-310, 0.0), (1e200, 1e-200, 1.0, 0.0), (3e-5, 4e-5, 1e-320, 0.0),
        (3e200, 4e200, 5e-50, 0.0),
    ],
)  # fmt: skip
def test_normalise_extremes(q):
    """Each component to its own rounding, but for what is subnormal."""
    for found, true in zip(quat.normalise(q), mo.vec(q) / mo.norm(q), strict=True):
        assert abs(found - true) <= max(4 * mo.EPS * abs(true), 5e-324)


@each("bad", [math.nan, math.inf, None])
@each("place", range(4))
def test_normalise_what_has_no_direction(bad, place):
    q = [0.0] * 4 if bad is None else [0.5] * 4
    if bad is not None:
        q[place] = bad
    assert np.isnan(quat.normalise(tuple(q))).all()


def test_renormalise_is_of_second_order():
    sizes = [1e-1, 1e-2, 1e-3, 1e-4]
    q = (0.1, 0.7, -0.5, 0.5)
    for sign in (1, -1):
        left = []
        for e in sizes:
            found = quat.renormalise(mo.floats(mo.vec(q) / mo.norm(q) * (1 + sign * e)))
            assert mo.error(found, mo.vec(q) / mo.norm(q) * mo.norm(found)) <= 4 * mo.EPS
            left.append(1 - mo.norm(found))
        assert mo.slope(sizes[1:], left[1:]) == pytest.approx(2, abs=0.01)
        assert float(left[-1]) == pytest.approx(1.5e-8, rel=1e-3)


# products and rotations


@regimes
def test_product(regime):
    for p, q in zip(mo.quaternions(N, 3), mo.attitudes(regime, N, 1), strict=True):
        assert mo.distance(quat.mul(p, q), mo.quat_mul(mo.vec(p), mo.vec(q))) <= PRODUCT
        assert quat.mul(p, ONE) == quat.mul(ONE, p) == p
        assert quat.conj(p) == mo.floats(mo.quat_conj(p))
        assert quat.dot(p, q) == pytest.approx(float(mp.fdot(p, q)), abs=PRODUCT)


@regimes
def test_rotate(regime):
    for q, v in zip(mo.attitudes(regime, N), mo.directions(N, 7), strict=True):
        matrix = mo.quat_matrix(q)
        assert mo.distance(quat.rotate(q, v), matrix * mo.vec(v)) <= 2 * PRODUCT
        assert mo.distance(quat.rotate_inverse(q, v), matrix.T * mo.vec(v)) <= 2 * PRODUCT


# kinematics


def test_derivative():
    for q, w in zip(mo.quaternions(N, 1), mo.vectors(N, 2, size=3.0), strict=True):
        true = mo.quat_mul(mo.vec(q), mo.pure(w)) / 2
        assert mo.error(quat.derivative(q, w), true) <= PRODUCT
        true = mo.quat_mul(mo.pure(w), mo.vec(q)) / 2
        assert mo.error(quat.derivative_inertial(q, w), true) <= PRODUCT


@regimes
def test_rate_inverts_derivative(regime):
    for q, w in zip(mo.attitudes(regime, N), mo.vectors(N, 4, size=100.0), strict=True):
        assert mo.error(quat.rate(q, quat.derivative(q, w)), w) <= 2 * PRODUCT
        assert mo.error(quat.rate_inertial(q, quat.derivative_inertial(q, w)), w) <= 2 * PRODUCT


# angle and interpolation


@regimes
def test_angle(regime):
    for p, q in pairs(regime):
        true = mo.quat_angle(p, q)
        allowed = 5e-16 * true if true > 1e-8 else 1e-16
        assert abs(quat.angle(p, q) - true) <= allowed
        assert quat.angle(p, q) == quat.angle(q, p)
    assert quat.angle(p, p) == 0.0
    half = quat.angle(ONE, (0.0, 0.6, 0.0, -0.8))
    assert half == pytest.approx(math.pi, rel=5e-16, abs=0)


@pytest.mark.parametrize("regime", ["uniform", "tiny"])
def test_slerp(regime):
    for (p, q), s in zip(pairs(regime), mo.uniform(-0.5, 1.5, N), strict=True):
        u = mo.quat_log(mo.quat_mul(mo.quat_conj(mo.vec(p)), mo.vec(q)))
        true = mo.quat_mul(mo.vec(p), mo.quat_exp(mp.mpf(s) * u))
        assert mo.distance(quat.slerp(p, q, s), true) <= 4 * PRODUCT


def test_slerp_near_half_a_turn():
    """The axis is that of p*∘q, whose scalar part, at least 1e-9 here, must keep its sign."""
    short = mo.powers(-8, -3, N)
    for p, e, x in zip(mo.quaternions(N, 14), mo.directions(N, 15), short, strict=True):
        u = (mp.pi - x) * mo.vec(e)
        q = mo.floats(mo.quat_mul(mo.vec(p), mo.quat_exp(u)))
        middle = mo.quat_mul(mo.vec(p), mo.quat_exp(u / 2))
        assert mo.attitude_error(quat.slerp(p, q, 0.5), middle) <= 4 * PRODUCT
        assert mo.attitude_error(quat.slerp(p, tuple(-c for c in q), 0.5), middle) <= 4 * PRODUCT
