"""Calls of few bodies, and one large ensemble: overhead and cost a body-step."""

from __future__ import annotations

import os

import pytest
import scale

import fastatt as fa

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
OPTIONS = {"dt": 0.01, "method": "rk4"}


@pytest.mark.parametrize("n", [1, 10, 100])
@pytest.mark.parametrize("by", ["plan", "propagate"])
@pytest.mark.benchmark(group="one step")
def test_one_step(benchmark, by, n):
    """Compared with 40 µs of a plan's call and 120 of ``propagate``."""
    values = scale.states(n)
    plan = fa.plan(scale.FREE, n, n_steps=1, **OPTIONS)
    run = plan(*values)
    calls = {
        "plan": lambda: plan(*values),
        "propagate": lambda: fa.propagate(scale.FREE, *values, n_steps=1, **OPTIONS),
    }
    found = benchmark(calls[by])
    assert found.q[-1].tobytes() == run.q[-1].tobytes()
    if benchmark.stats:
        wanted = 120.0 if by == "propagate" else 40.0
        benchmark.extra_info["of what is wanted"] = 1e6 * benchmark.stats["median"] / wanted


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("n", [8, 1000, 100_000])
@pytest.mark.benchmark(group="many steps")
def test_many_steps(benchmark, n, threads):
    """Nanoseconds a body-step."""
    steps = 10 if SMOKE else max(100, 20_000_000 // n)
    values = scale.states(100 if SMOKE else n)
    options = {"n_steps": steps, "n_threads": threads, **OPTIONS}
    run = benchmark.pedantic(
        lambda: fa.propagate(scale.FREE, *values, **options), rounds=1 if SMOKE else 5
    )
    assert not run.status.any()
    if benchmark.stats:
        each = benchmark.stats["median"] / (len(values[0]) * steps)
        benchmark.extra_info["ns a body-step"] = 1e9 * each
