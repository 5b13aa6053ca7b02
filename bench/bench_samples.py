"""Sampled rates: logs against a plain copy of the same bytes and a peer, short ones by the call."""

from __future__ import annotations

import os
from time import perf_counter

import numpy as np
import pytest
import quaternion
from problems import Coning

import fastatt as fa
from fastatt.gyro.integrate import methods_for_samples
from fastatt.trade.ensembles import coning_rates

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_LOGS, N_SAMPLES = (2_000, 100) if SMOKE else (100_000, 100)
LONG = 100_000 if SMOKE else 10_000_000
H = 0.01
START = np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0])


def _best(call, repeats: int = 5) -> float:
    call()
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        call()
        times.append(perf_counter() - begin)
    return min(times)


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
@pytest.mark.parametrize("memory", ["new", "used"])
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("method", methods_for_samples())
def test_many_logs(benchmark, logs, method, dtype, memory):
    """Beside it: numpy copying as many bytes as come in and go out, to new or to used memory."""
    problem, rates = logs
    data = rates.astype(dtype)
    used = np.ones((N_LOGS, N_SAMPLES, 4), dtype=dtype)
    source = np.ones(data.size + used.size, dtype=dtype)
    target = np.ones_like(source)
    out = used if memory == "used" else None

    def copy() -> None:
        np.copyto(target if memory == "used" else np.empty_like(source), source)

    def run() -> np.ndarray:
        return fa.integrate_rates(data, H, problem.q0, method=method, out=out)

    reference = _best(copy)
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
    reference = 10.0 * _best(lambda: _peer(part), repeats=2)
    q = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    _report(benchmark, LONG, reference, "numpy-quaternion", _long_error(q))


def _long_error(q: np.ndarray) -> float:
    t = H * (len(q) - 1)
    exact = [np.cos(0.5), np.sin(0.5) * np.cos(t), np.sin(0.5) * np.sin(t), 0.0]
    return float(fa.angle_between(q[-1].astype(float), exact))


@pytest.mark.benchmark(group="one long log beside a copy")
@pytest.mark.parametrize("method", methods_for_samples())
def test_one_long_log_beside_a_copy(benchmark, long_log, method):
    """Beside it: numpy copying as many bytes as come in and go out, all to used memory."""
    out = np.ones((LONG, 4))
    source = np.ones(long_log.size + out.size)
    target = np.ones_like(source)
    reference = _best(lambda: np.copyto(target, source))

    def run() -> np.ndarray:
        return fa.integrate_rates(long_log, H, START, method=method, out=out)

    q = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    _report(benchmark, LONG, reference, "numpy's copy", _long_error(q))


@pytest.mark.benchmark(group="a call")
@pytest.mark.parametrize("method", methods_for_samples())
@pytest.mark.parametrize("call", ["log of 1000 samples", "push of one sample"])
def test_calls(benchmark, long_log, method, call):
    flow = fa.GyroIntegrator(START, H, method=method)
    if call == "push of one sample":
        benchmark(flow.push, long_log[0])
    else:
        benchmark(fa.integrate_rates, long_log[:1000], H, START, method=method)
