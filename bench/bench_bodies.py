"""Free bodies on one core: ``rk4`` beside the same loop in C, and the closed form."""

from __future__ import annotations

import os

import numpy as np
import peers_bodies as peers
import pytest

import fastatt as fa
from fastatt.trade.timing import once

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_BODIES = 256 if SMOKE else 16_384
T_END = 10.0
INERTIA = np.array([2.0, 1.0, 2.0 / 3.0])
Q0 = np.tile([1.0, 0.0, 0.0, 0.0], (N_BODIES, 1))
M0 = np.random.default_rng(1).normal(size=(N_BODIES, 3))
M0 /= np.linalg.norm(M0, axis=1, keepdims=True)


@pytest.mark.skipif(not peers.has_c(), reason="no gcc")
@pytest.mark.benchmark(group="RK4 of free bodies beside the same loop in C, one core")
@pytest.mark.parametrize("inertia", ["shared", "per body"])
def test_rk4_beside_c(benchmark, inertia):
    """Interleaved, 2000 steps a body; the ratio is the median of pairs."""
    steps = 20 if SMOKE else 2000
    moments = INERTIA if inertia == "shared" else np.tile(INERTIA, (N_BODIES, 1))
    options = {"dt": T_END / steps, "n_steps": steps, "method": "rk4", "n_threads": 1}

    def ours() -> fa.Trajectory:
        return fa.propagate(fa.Scene(inertia=moments), Q0, M0 / moments, **options)

    ratios = []
    ours()  # compiles
    for _ in range(1 if SMOKE else 9):
        ends, seconds = peers.c_rk4(moments, Q0, M0, T_END, steps)
        ratios.append(seconds / once(ours)[0])
    result = benchmark.pedantic(ours, rounds=1, warmup_rounds=0)
    benchmark.extra_info["speed of C's"] = round(float(np.median(ratios)), 3)
    benchmark.extra_info["difference, rad"] = float(fa.angle_between(result.q[-1], ends).max())


@pytest.mark.benchmark(group="closed form, one core")
@pytest.mark.parametrize("n_times", [1, 10, 1000])
def test_closed_form(benchmark, n_times):
    n = max(64, N_BODIES // n_times)
    q0, w0 = Q0[:n], (M0 / INERTIA)[:n]
    t = np.linspace(0.0, T_END, n_times) if n_times > 1 else T_END

    def ours() -> tuple[np.ndarray, np.ndarray]:
        return fa.closed_form.free_body(q0, w0, INERTIA, t, n_threads=1)

    benchmark.pedantic(ours, rounds=1 if SMOKE else 7, warmup_rounds=1)
    if benchmark.stats is not None:
        speed = n * n_times / benchmark.stats.stats.min
        benchmark.extra_info["M body-times/s"] = round(speed / 1e6, 1)
