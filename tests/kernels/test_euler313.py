"""3-1-3 Euler angles against products of elementary rotations."""

import math

import mpmath as mp
import numpy as np
import oracle as mo
import pytest

import fastatt as fa
from fastatt.kernels import euler313

N = 300
ANGLES = list(
    zip(
        mo.uniform(-math.pi, math.pi, N, 1),
        mo.uniform(0.0, math.pi, N, 2),
        mo.uniform(-math.pi, math.pi, N, 3),
        strict=True,
    )
)
FAR = [(20.0 * a, 20.0 * b, 20.0 * c) for a, b, c in ANGLES]
NEXT_TO_POLES = [
    (a, t, c) for a, _, c in ANGLES[:4] for t in (1e-300, 1e-12, 1e-4, math.pi - 1e-4, math.pi)
]
POLES = [(0.7, 0.0, -1.9), (3.0, 0.0, 2.0), (0.7, math.pi, -1.9), (-3.0, math.pi, 1.0)]
EVERYWHERE = ANGLES + FAR + NEXT_TO_POLES + POLES


def by_axes(angles):
    """Rz(φ) Rx(θ) Rz(ψ) as a quaternion."""
    phi, theta, psi = (mo.vec([a])[0] for a in angles)
    first = mo.quat_mul(mo.quat_exp([0, 0, phi]), mo.quat_exp([theta, 0, 0]))
    return mo.quat_mul(first, mo.quat_exp([0, 0, psi]))


def allowed(angles):
    """Rounding of φ ± ψ, half of it in the half angle, and that of the products."""
    return 4 * mo.EPS + 0.5 * math.ulp(max(abs(a) for a in angles) * 2)


def test_to_quat():
    for angles in EVERYWHERE:
        assert mo.distance(euler313.to_quat(angles), by_axes(angles)) <= allowed(angles)


def test_from_quat():
    for q in (*mo.quaternions(N, 1), (1.0, 0.0, 0.0, 0.0), (-1.0, 0.0, 0.0, 0.0)):
        angles = euler313.from_quat(q)
        assert 0.0 <= angles[1] <= math.pi, q
        assert mo.attitude_error(by_axes(angles), mo.vec(q) / mo.norm(q)) <= 8 * mo.EPS, q


def test_from_quat_gives_the_angles_back():
    for angles in ANGLES:
        found = mo.vec(euler313.from_quat(euler313.to_quat(angles)))
        # φ and ψ may each differ by a whole turn
        turns = [mp.nint(d / (2 * mp.pi)) for d in found - mo.vec(angles)]
        assert turns[1] == 0
        gap = found - mo.vec(angles) - 2 * mp.pi * mo.vec(turns)
        assert mo.norm(gap) <= 16 * mo.EPS * (1 + 1 / math.sin(angles[1]))


@pytest.mark.parametrize("a", [-2.0, 0.0, 0.3, 3.0])
def test_from_quat_at_the_poles(a):
    s, c = math.sin(a), math.cos(a)
    assert euler313.from_quat((c, 0.0, 0.0, s)) == pytest.approx((a, 0.0, a), rel=8 * mo.EPS, abs=0)
    found = euler313.from_quat((0.0, c, s, 0.0))
    assert found == pytest.approx((a, math.pi, -a), rel=8 * mo.EPS, abs=0)


def test_rate():
    for angles, d in zip(ANGLES + FAR, mo.vectors(2 * N, 2, size=3.0), strict=True):
        assert mo.distance(
            euler313.rate(angles, d), mo.euler313_rate(angles, d)
        ) <= 4 * mo.EPS * mo.norm(d)


def test_derivative_inverts_rate():
    """To a relative 1/sin θ, which magnifies what is lost towards the poles."""
    for angles, w in zip(ANGLES, mo.vectors(N, 4), strict=True):
        allowed = 8 * mo.EPS * mo.norm(w) / math.sin(angles[1])
        d = euler313.derivative(angles, w)
        assert mo.distance(euler313.rate(angles, d), w) <= allowed
        again = euler313.derivative(angles, euler313.rate(angles, w))
        assert mo.distance(again, w) <= allowed


def test_derivative_has_no_value_at_the_poles():
    assert not np.isfinite(euler313.derivative((0.4, 0.0, 0.3), (0.1, 0.2, 0.3))).all()
    assert not np.isfinite(euler313.derivative((0.4, 0.0, 0.0), (0.0, 0.2, 0.3))).all()
    # the float next to π is 1.2e-16 short of it
    assert abs(euler313.derivative((0.4, math.pi, 0.3), (1.0, 0.0, 0.0))[0]) > 1e15


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize(
    "q0", [(1.0, 0.0, 0.0, 0.0), (0.8, 0.0, 0.0, 0.6), (1.0, 1e-300, 0.0, 0.0)]
)
@pytest.mark.parametrize("w", [(0.0, 0.0, 1.0), (0.1, 0.2, 0.3)])
def test_a_run_that_starts_at_a_pole_is_singular(q0, w, dtype):
    """Its first derivative is infinite or NaN: both flags, of bodies and of given rates."""
    options = {"dt": 0.01, "n_steps": 3, "method": "rk4", "representation": "euler313"}
    for run in (
        fa.propagate(fa.Scene(inertia=(2.0, 1.0, 0.7)), q0, w, dtype=dtype, **options),
        fa.propagate(fa.Scene(rate=fa.rates.Constant(w)), q0, dtype=dtype, **options),
    ):
        assert run.status[0] == fa.Status.SINGULAR | fa.Status.NON_FINITE


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_non_finite_angle_shows(bad):
    assert np.isnan(euler313.to_quat((0.1, bad, 0.2))).any()
    assert np.isnan(euler313.rate((0.1, bad, 0.2), (1.0, 1.0, 1.0))).any()
