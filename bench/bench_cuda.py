"""Steps on a GPU: how many a second, and the share of what the device's multipliers can do.

The share is a step's floating-point operations, an fma counted as two, times the rate, over the
operations a second of chains of fma in registers, measured here. A call is timed whole, with its
copies. The machine's cores run the same beside it.
"""

from __future__ import annotations

import os
from functools import cache

import numpy as np
import pytest

import fastatt as fa
from fastatt.propagation.inspect_step import job_of
from fastatt.trade.measure import best_time

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
SIZES = (4,) if SMOKE else (10_000, 100_000, 1_000_000)
STEPS = 3 if SMOKE else 5_000
CHAINS = 8
THREADS = 2 if SMOKE else 256
BLOCKS = 2 if SMOKE else 4096
TURNS = 2 if SMOKE else 20_000
INERTIA = (2.0, 1.0, 2 / 3)


cuda = pytest.importorskip("numba.cuda")
pytestmark = pytest.mark.skipif(not cuda.is_available(), reason="no GPU that Numba can use")


@cuda.jit
def chains(turns, factors, out):
    a, b = factors[0], factors[1]
    x0, x1, x2, x3, x4, x5, x6, x7 = a, b, a, b, a, b, a, b
    for _ in range(turns):
        x0, x1 = cuda.fma(x0, a, b), cuda.fma(x1, a, b)
        x2, x3 = cuda.fma(x2, a, b), cuda.fma(x3, a, b)
        x4, x5 = cuda.fma(x4, a, b), cuda.fma(x5, a, b)
        x6, x7 = cuda.fma(x6, a, b), cuda.fma(x7, a, b)
    out[cuda.grid(1)] = x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7


def scenes(n):
    """Scenes of n bodies with their initial rates."""
    generator = np.random.default_rng(0)
    w0 = generator.normal(size=(n, 3))
    gravity = fa.torques.GravityGradient(mean_motion=0.1)
    return {
        "coning": (fa.Scene(rate=fa.rates.Coning(generator.uniform(0.2, 1.5, n), 1.0)), None),
        "free": (fa.Scene(inertia=INERTIA), w0),
        "gravity gradient": (fa.Scene(inertia=INERTIA, torque=gravity), w0),
    }


@cache
def peak(dtype):
    """Operations a second of the device: chains of fma in registers."""
    factors = cuda.to_device(np.array([0.5, 1.0], dtype=dtype))
    out = cuda.device_array(THREADS * BLOCKS, dtype)

    def run():
        chains[BLOCKS, THREADS](TURNS, factors, out)
        cuda.synchronize()

    seconds, _ = best_time(run, 5)
    return 2.0 * CHAINS * TURNS * THREADS * BLOCKS / seconds


@pytest.mark.benchmark(group=f"steps on a GPU, {STEPS} a body")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("device", ["cuda", None])
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize(
    ("scene", "method"),
    [("coning", "magnus4"), ("free", "rk4"), ("free", "rk8"), ("gravity gradient", "rk4")],
)
def test_single_steps(benchmark, scene, method, n, device, dtype):
    described, w0 = scenes(n)[scene]
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    # the machine's cores take a tenth of the steps
    steps = STEPS if device else max(1, STEPS // 10)

    def run():
        return fa.propagate(
            described, q0, w0, dt=0.01, n_steps=steps, method=method, dtype=dtype, device=device
        )

    result = benchmark.pedantic(run, rounds=1 if SMOKE else 3, warmup_rounds=1)
    assert not result.status.any()
    if benchmark.stats is not None:
        rate = n * steps / benchmark.stats.stats.min
        benchmark.extra_info["G body-steps/s"] = round(rate / 1e9, 3)
        if device:
            operations = job_of(described, method, "quat", dtype).formulas.operations
            share = operations * rate / peak(dtype)
            benchmark.extra_info["share of the peak"] = round(share, 3)
