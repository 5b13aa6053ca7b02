"""Sampled rates: logs against a plain copy of the same bytes and a peer, short ones by the call."""

from __future__ import annotations

import os

import numpy as np
import pytest
import quaternion

import fastatt as fa
from fastatt.gyro.integrate import methods_for_samples
from fastatt.trade.ensembles import coning_attitudes, coning_rates
from fastatt.trade.timing import time_in_turns

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_LOGS, N_SAMPLES = (2_000, 100) if SMOKE else (100_000, 100)
LONG = 100_000 if SMOKE else 10_000_000
H = 0.01
START = np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0])


class Coning:
    """N coning bodies, angle and frequency per body."""

    def __init__(self, n_bodies: int) -> None:
        generator = np.random.default_rng(3)
        self.angle = generator.uniform(0.2, 1.5, n_bodies)
        self.frequency = generator.uniform(0.5, 2.0, n_bodies)
        self.scene = fa.Scene(rate=fa.rates.Coning(self.angle, self.frequency))
        self.q0 = self.exact(0.0)

    def exact(self, t: float) -> np.ndarray:
        return coning_attitudes(self.angle, self.frequency, np.array([t]))[0]

    def error(self, q: np.ndarray, t: float) -> float:
        return float(np.median(fa.angle_between(q, self.exact(t))))


@pytest.fixture(scope="module")
def logs():
    problem = Coning(N_LOGS)
    t = H * np.arange(N_SAMPLES)
    return problem, coning_rates(problem.angle, problem.frequency, t)


@pytest.fixture(scope="module")
def long_log():
    t = H * np.arange(LONG)
    return coning_rates(np.array([1.0]), np.array([1.0]), t)[0]


def _report(benchmark, samples: int, reference: float, name: str, error: float) -> None:
    benchmark.extra_info["error, rad"] = error
    if benchmark.stats is not None:
        seconds = benchmark.stats.stats.min
        benchmark.extra_info["M samples/s"] = round(samples / seconds / 1e6, 1)
        benchmark.extra_info[f"speed over {name}"] = round(reference / seconds, 3)


@pytest.mark.benchmark(group="many logs")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("method", methods_for_samples())
def test_many_logs(benchmark, logs, method, dtype):
    """Beside it: numpy copying as many bytes as come in and go out."""
    problem, rates = logs
    data = rates.astype(dtype)
    out = np.ones((N_LOGS, N_SAMPLES, 4), dtype=dtype)
    source = np.ones(data.size + out.size, dtype=dtype)
    target = np.ones_like(source)

    def run() -> np.ndarray:
        return fa.integrate_rates(data, H, problem.q0, method=method, out=out)

    reference = time_in_turns([lambda: np.copyto(target, source)])[0].least
    q = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    error = problem.error(q[:, -1].astype(float), H * (N_SAMPLES - 1))
    _report(benchmark, N_LOGS * N_SAMPLES, reference, "numpy's copy", error)


def _peer(rates: np.ndarray) -> np.ndarray:
    """numpy-quaternion: exponentials of half the angles, then a running product."""
    return np.multiply.accumulate(np.exp(quaternion.from_vector_part(0.5 * H * rates)))


@pytest.mark.benchmark(group="one long log")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("method", methods_for_samples())
def test_one_long_log(benchmark, long_log, method, dtype):
    """Beside it: numpy-quaternion's exp and accumulate on a tenth of the log."""
    data = long_log.astype(dtype)

    def run() -> np.ndarray:
        return fa.integrate_rates(data, H, START, method=method)

    part = long_log[: LONG // 10]
    reference = 10.0 * time_in_turns([lambda: _peer(part)])[0].least
    q = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    _report(benchmark, LONG, reference, "numpy-quaternion", _long_error(q))


def _long_error(q: np.ndarray) -> float:
    t = H * (len(q) - 1)
    exact = [np.cos(0.5), np.sin(0.5) * np.cos(t), np.sin(0.5) * np.sin(t), 0.0]
    return float(fa.angle_between(q[-1].astype(float), exact))


@pytest.mark.benchmark(group="a call")
@pytest.mark.parametrize("method", methods_for_samples())
@pytest.mark.parametrize("call", ["log of 1000 samples", "push of one sample"])
def test_calls(benchmark, long_log, method, call):
    flow = fa.GyroIntegrator(START, H, method=method)
    if call == "push of one sample":
        benchmark(flow.push, long_log[0])
    else:
        benchmark(fa.integrate_rates, long_log[:1000], H, START, method=method)
