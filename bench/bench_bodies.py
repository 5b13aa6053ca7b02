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
T_END = peers.T_END


@pytest.mark.skipif(not peers.has_c(), reason="no gcc")
@pytest.mark.benchmark(group="RK4 of free bodies beside the same loop in C, one core")
@pytest.mark.parametrize("inertia", ["shared", "per body"])
def test_rk4_beside_c(benchmark, inertia):
    """Interleaved, 2000 steps a body; the ratio is the median of pairs."""
    steps = 20 if SMOKE else 2000
    b = peers.free_bodies(N_BODIES)
    moments = b.inertia if inertia == "shared" else np.tile(b.inertia, (N_BODIES, 1))
    b = peers.Bodies(moments, b.q0, b.m0)
    scene = fa.Scene(inertia=moments)
    w0 = b.m0 / moments

    def ours() -> fa.Trajectory:
        return fa.propagate(
            scene, b.q0, w0, dt=T_END / steps, n_steps=steps, method="rk4", n_threads=1
        )

    ratios = []
    ours()  # compiles
    for _ in range(1 if SMOKE else 9):
        theirs = peers.c_rk4(b, steps)
        ratios.append(theirs.seconds / once(ours)[0])
    result = benchmark.pedantic(ours, rounds=1, warmup_rounds=0)
    benchmark.extra_info["speed of C's"] = round(float(np.median(ratios)), 3)
    benchmark.extra_info["difference, rad"] = float(fa.angle_between(result.q[-1], theirs.q).max())


@pytest.mark.benchmark(group="closed form, one core")
@pytest.mark.parametrize("n_times", [1, 10, 1000])
def test_closed_form(benchmark, n_times):
    b = peers.free_bodies(N_BODIES)
    n = max(64, N_BODIES // n_times)
    q0, w0 = b.q0[:n], (b.m0 / b.inertia)[:n]
    t = np.linspace(0.0, T_END, n_times) if n_times > 1 else T_END

    def ours() -> tuple[np.ndarray, np.ndarray]:
        return fa.closed_form.free_body(q0, w0, b.inertia, t, n_threads=1)

    benchmark.pedantic(ours, rounds=1 if SMOKE else 7, warmup_rounds=1)
    if benchmark.stats is not None:
        speed = n * n_times / benchmark.stats.stats.min
        benchmark.extra_info["M body-times/s"] = round(speed / 1e6, 1)
