"""Elliptic integrals and theta functions against mpmath, with the figures of their docstrings."""

import math

import mpmath as mp
import oracle
import pytest
from each import each
from oracle import EPS, powers, relative, uniform

from fastatt.kernels import elliptic

# complementary moduli: anywhere, near 1, near 0, and where the two series meet (K = 2K')
MODULI = {
    "any": uniform(0.0, 1.0, 60),
    "round": [math.sqrt(1.0 - x) for x in powers(-30, -1, 40)],
    "separatrix": powers(-12, -1, 60),
    "seam": uniform(0.171, 0.172, 30),
}


def modulus(kc):
    """k of a complementary modulus."""
    return math.sqrt((1.0 - kc) * (1.0 + kc))


def complete(kc):
    """K by the arithmetic-geometric mean."""
    return mp.pi / 2 / mp.agm(1, kc)


def first_kind(y, kc):
    """F of the amplitude whose cotangent is y, as Carlson's RF(cs², ds², ns²)."""
    y2 = mp.mpf(y) ** 2
    return mp.elliprf(y2, y2 + mp.mpf(kc) ** 2, y2 + 1)


@pytest.mark.parametrize("xs", [uniform(-60, 60, 1000), uniform(-1, 1, 1000), powers(-300, 0, 300)])
def test_waves(xs):
    for x in [0.0, *xs]:
        s, c = elliptic.waves(x, 1.0)
        assert relative(s, mp.sinh(x)) <= 5e-16
        assert relative(c, mp.cosh(x)) <= 5e-16
        s, c = elliptic.waves(x, 0.0)
        assert abs(s - mp.sin(x)) <= 1.4e-16
        assert abs(c - mp.cos(x)) <= 1.4e-16
        assert relative(elliptic.exp_minus(abs(x)), mp.exp(-abs(mp.mpf(x)))) <= 5e-16


def test_waves_beyond_their_range():
    for x in (61.0, 1e10, math.inf):
        assert elliptic.waves(x, 1.0) == elliptic.waves(60.0, 1.0)
        assert elliptic.waves(-x, 1.0) == elliptic.waves(-60.0, 1.0)
    assert elliptic.waves(1e6 + 0.1, 0.0) == pytest.approx(
        (math.sin(1e6 + 0.1), math.cos(1e6 + 0.1))
    )
    assert all(math.isnan(c) for wide in (0.0, 1.0) for c in elliptic.waves(math.nan, wide))


@pytest.mark.parametrize("kcs", [*MODULI.values(), powers(-150, 0, 100)])
def test_first_kind_pair(kcs):
    """Of either modulus, from amplitudes of nothing to a quarter turn."""
    n = len(kcs)
    cots = zip([0.0, *powers(-12, 6, n - 1)], [*powers(-12, 6, n - 1), 0.0], strict=True)
    for kc, (y, yc) in zip(kcs, cots, strict=True):
        # the complement of the larger one to all its digits
        k = max(float(mp.sqrt(1 - mp.mpf(kc) ** 2)), 1e-150)
        large = 1 - mp.mpf(min(k, kc)) ** 2
        of_kc, of_k = (kc, mp.sqrt(large)) if kc <= k else (mp.sqrt(large), k)
        u, K, c, Kc = elliptic.first_kind_pair(y, kc, yc, k)
        assert relative(K, complete(of_kc)) <= 4e-16
        assert relative(Kc, complete(of_k)) <= 4e-16
        for found, true in ((u, first_kind(y, of_kc)), (c, first_kind(yc, of_k))):
            assert relative(found, true) <= 8e-16


@pytest.mark.parametrize("y", [0.0, 1e-300, 0.3, 1.0, 7.0, 1e17, 1e300])
def test_first_kind_pair_at_its_ends(y):
    """k' = 0 counts as 1e-150; a circle's angle and what a hyperbola has instead."""
    u, K, c, Kc = elliptic.first_kind_pair(y, 0.0, y, 1.0)
    assert elliptic.first_kind_pair(y, 1e-150, y, 1.0) == (u, K, c, Kc)
    assert elliptic.first_kind_pair(y, 1.0, y, 0.0) == (c, Kc, u, K)
    assert relative(K, mp.log(4 / mp.mpf("1e-150"))) <= EPS
    assert Kc == math.pi / 2
    assert relative(c, mp.atan2(1, y)) <= 4e-16
    y = min(y, 1e17)
    assert relative(u, mp.asinh(1 / mp.mpf(y)) if y > 1e-150 else K) <= 8e-16


@pytest.mark.parametrize("kcs", MODULI.values(), ids=MODULI)
def test_jacobi(kcs):
    for kc, x in zip(kcs, uniform(-4, 4, len(kcs)), strict=True):
        m = 1 - mp.mpf(kc) ** 2
        for u in (1e-9 * x, x, 10.0 * x):
            true = [mp.re(mp.ellipfun(f, u, m=m)) for f in ("sn", "cn", "dn")]
            for found, exact in zip(elliptic.jacobi(u, kc), true, strict=True):
                assert abs(found - exact) <= 1e-15 + 3e-16 * abs(u)


@pytest.mark.parametrize("u", [0.0, 1e-5, 0.5, -3.0, 20.0, -300.0, 1e6])
def test_jacobi_at_the_ends(u):
    """k = 0: sin, cos, 1. k = 1: tanh, sech, sech, without a period."""
    assert oracle.distance(elliptic.jacobi(u, 1.0), (mp.sin(u), mp.cos(u), 1)) <= 1e-15 + EPS * abs(
        u
    )
    sech = mp.sech(u)
    assert oracle.distance(elliptic.jacobi(u, 0.0), (mp.tanh(u), sech, sech)) <= 1e-15


def test_jacobi_differential_equations():
    """y' = (y2 y3, −y1 y3, −.51 y1 y2) from (0, 1, 1), its period and its state at t = 12."""
    kc = math.sqrt(0.49)
    found = elliptic.jacobi(12.0, kc)
    assert found == pytest.approx(
        (-0.7053978095225717, -0.7088116324671581, 0.8638466903702221), abs=2e-15
    )
    _, quarter, _, _ = elliptic.first_kind_pair(0.0, kc, 0.0, math.sqrt(0.51))
    assert 4.0 * quarter == pytest.approx(7.450563209330954, rel=4e-16)


@each("kc", [0.999999, 0.7, 0.3, 0.18, 0.16, 1e-3, 1e-8])
@each("share", [0.0, 1e-6, 0.3, 0.8, 1.0])
def test_theta_pair(kc, share):
    """exp(iχ) A : exp(iχ) B as θ4 : θ1 in phase and, but for a constant, in size, over periods."""
    K, Kc = complete(kc), complete(mp.sqrt(1 - mp.mpf(kc) ** 2))
    c = share * float(Kc)
    g = elliptic.theta_pair(float(K), float(Kc), c)
    nome = mp.exp(-2 * mp.pi * Kc / K)
    sizes = []
    for u in uniform(-2.5 * float(K), 2.5 * float(K), 12):
        ar, ai, br, bi, chi = elliptic.theta_pair_at(g, g[16] * u)
        z = mp.pi * mp.mpc(u, -c) / (2 * K)
        even, odd = mp.jtheta(4, z, nome), mp.jtheta(1, z, nome)
        a, b = mp.mpc(ar, ai), mp.mpc(br, bi)
        turn = mp.exp(1j * mp.mpf(chi)) * a / abs(a) * abs(even) / even
        assert abs(turn - 1) <= 1e-14
        sizes.append(b / a * even / odd)
    bound = 2e-12 if kc < 1e-5 else 2e-14  # K of a float: its error times |dθ/du| over θ
    assert all(abs(s / sizes[0] - 1) <= bound for s in sizes)
    assert sizes[0].real > 0
    assert abs(sizes[0].imag) <= bound * abs(sizes[0])
