"""Picard's passes beside the linear system that they solve, and the ends of logs."""

from __future__ import annotations

import numpy as np
import pytest
from each import each
from exact import START, angle, attitude, mul
from numpy.polynomial import legendre

import fastatt as fa
from fastatt.methods.picard import METHOD, SPAN

LIMITS = {False: METHOD.limits["rates"], True: METHOD.limits["increments"]}
KINDS = pytest.mark.parametrize("increments", [False, True])


def turning(w):
    """(4, 4): q∘w = q @ turning(w)."""
    a, b, c = w
    return np.array([[0, a, b, c], [-a, 0, -c, b], [-b, c, 0, -a], [-c, -b, a, 0]])


def polynomial(data, t, increments):
    """w (rad/s) as Legendre series of x on [-1, 1] from the first instant to the last."""
    x = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    fitted = np.concatenate([np.zeros((1, 3)), np.cumsum(data, axis=0)]) if increments else data
    series = np.linalg.solve(legendre.legvander(x, len(x) - 1), fitted)
    return legendre.legder(series, scl=2.0 / (t[-1] - t[0])) if increments else series


def collocated(data, spans, increments):
    """One window's attitudes and largest rate: the collocation, solved as a linear system."""
    t = np.concatenate([[0.0], np.cumsum(spans)])
    x, _ = legendre.leggauss(SPAN)
    basis = np.linalg.inv(legendre.legvander(x, SPAN - 1))  # a column of series for each node
    integrals = legendre.legint(basis, lbnd=-1.0, scl=t[-1] / 2.0)
    to_nodes = legendre.legvander(x, SPAN) @ integrals
    w = legendre.legvander(x, SPAN)[:, : SPAN + 1] @ np.vstack(
        [polynomial(data, t, increments), np.zeros((int(increments), 3))]
    )
    half = np.array([0.5 * turning(v) for v in w])
    # slopes k_i = (1 + Σ_j a_ij k_j) W_i
    system = np.eye(4 * SPAN) - np.einsum("ij,ilm->imjl", to_nodes, half).reshape(24, 24)
    slopes = np.linalg.solve(system, half[:, 0].ravel()).reshape(SPAN, 4)
    q = (1.0, 0.0, 0.0, 0.0) + legendre.legvander(2.0 * t / t[-1] - 1.0, SPAN) @ integrals @ slopes
    return q / np.linalg.norm(q, axis=1, keepdims=True), np.abs(w).max()


def window(kind, size, increments, rng):
    """Samples (rad) of seven instants or six intervals of 1 s, the largest of length ``size``."""
    n = SPAN + (not increments)
    t = np.arange(n)
    if kind == "cone":
        w = np.stack([np.cos(0.5 * t), np.sin(0.5 * t), 0.3 + 0.0 * t], axis=1)
    elif kind == "noise":
        w = rng.normal(size=(n, 3))
        w /= np.linalg.norm(w, axis=1, keepdims=True)
    else:
        w = rng.choice([-1.0, 1.0], (n, 3))
    return size / np.linalg.norm(w, axis=1).max() * w


def rounding(rate):
    """Ulps: 8 where passes stop, of which 1.8 times are left where each takes off a third.

    And as many as six levels of differences round what they add up to, on three axes, over half of
    six intervals.
    """
    return 16 + 6 * 3 * SPAN / 2 * rate


@KINDS
@pytest.mark.parametrize("kind", ["cone", "noise", "signs"])
@each("share", [0.1, 0.9, 1.0])
@each(("dtype", "uneven"), [("f8", 0.0), ("f4", 0.0), ("f8", 0.3)])
def test_passes_go_on_until_round_off(increments, kind, share, dtype, uneven):
    """Up to the limits, of samples without any smoothness too; of uneven intervals below them."""
    rng = np.random.default_rng(int(1e3 * share))
    eps = np.finfo(dtype).eps
    size = share * LIMITS[increments] * (1.0 - uneven)
    data = np.stack([window(kind, size, increments, rng) for _ in range(8)]).astype(dtype)
    spans = rng.uniform(1.0 - uneven, 1.0 + uneven, SPAN)
    dt = spans if uneven else 1.0
    found = fa.integrate_rates(data, dt, method="picard", increments=increments)
    for q, v in zip(found, data, strict=True):
        expected, rate = collocated(v.astype(float), spans, increments)
        assert np.abs(q - expected).max() <= rounding(rate) * eps


# the ends of logs


@KINDS
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("n", [2, 5, 8, 11, 12])
def test_the_end_of_a_log_is_that_of_its_last_polynomial(increments, uneven, n):
    """Through the last whole window, or all there is, and of noise too: no sample beyond is used.

    Beyond the end a polynomial through noise is a thousand times as large as what it goes through.
    """
    rng = np.random.default_rng(n)
    data = 0.1 * rng.normal(size=(n + (not increments), 3))
    spans = rng.uniform(0.7, 1.3, n) if uneven else np.ones(n)
    dt = spans if uneven else 1.0
    q = fa.integrate_rates(data, dt, START, method="picard", increments=increments)
    rest, near = n % SPAN, min(n, SPAN)
    t = np.concatenate([[0.0], np.cumsum(spans[n - near :])])
    series = polynomial(data[n - near :], t, increments)

    def rate(at):
        return legendre.legval(2.0 * at / t[-1] - 1.0, series).T

    for k in range(rest):
        begin, end = t[near - rest], t[near - rest + k + 1]
        turned = mul(q[n - rest], attitude(rate, begin, end, panels=4))
        # six nodes hold a polynomial of degree six times an attitude to a tenth of a turn of noise
        assert angle(q[n - rest + k + 1], turned) <= 0.1 * 0.1


@pytest.mark.parametrize("n", [200, 2000])
@pytest.mark.parametrize("speed", [1.3, 2.9])
def test_picard_is_the_nearest_on_smooth_logs(n, speed):
    """Regular samples of 20 s without noise."""

    def smooth(t):
        w = (
            0.8 * np.sin(speed * t),
            0.5 * np.cos(0.7 * speed * t) + 0.2,
            0.4 * np.sin(1.4 * speed * t),
        )
        return np.stack(w, axis=-1)

    t = np.linspace(0.0, 20.0, n)
    true = attitude(smooth, 0.0, 20.0, panels=64)
    picard, other = (
        angle(fa.integrate_rates(smooth(t), t[1], method=name)[-1], true)
        for name in ("picard", "coning2")
    )
    assert 10.0 * picard < other
