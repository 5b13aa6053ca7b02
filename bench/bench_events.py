"""Events: what they add to the time of a run of free bodies by ``rk8``, on one core."""

from __future__ import annotations

import os

import numpy as np
import pytest

import fastatt as fa
from fastatt.trade.measure import best_time

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_BODIES, STEPS = (64, 20) if SMOKE else (8192, 2000)
BODY = fa.Scene(inertia=(3.0, 2.0, 1.0))


def elevation(t, q, w, p):
    """Zero where the third body axis is 0.2 rad above the horizon."""
    return 1.0 - 2.0 * (q[1] ** 2 + q[2] ** 2) - 0.19866933079506122


def eclipse(t, q, w, p):
    """Zero in the middle of the run."""
    return t - 0.25 * 0.04 * STEPS


EVENTS = {
    "one": [fa.event(elevation, direction=1)],
    "two": [fa.event(elevation, direction=1), fa.event(eclipse)],
    "one, terminal": [fa.event(elevation, direction=1, terminal=True)],
}


@pytest.mark.parametrize("which", EVENTS)
@pytest.mark.benchmark(group="rk8 of free bodies with events, one core")
def test_events(benchmark, which):
    """Interleaved with the run without events; the ratio is that of the shortest times."""
    rng = np.random.default_rng(0)
    q0 = rng.normal(size=(N_BODIES, 4))
    q0 /= np.linalg.norm(q0, axis=1, keepdims=True)
    w0 = rng.normal(0.0, 0.5, (N_BODIES, 3))  # rad/s

    def run(**events):
        return fa.propagate(
            BODY, q0, w0, dt=0.02, n_steps=STEPS, method="rk8", n_threads=1, **events
        )

    plain = run()
    found = benchmark.pedantic(lambda: run(events=EVENTS[which]), rounds=1, warmup_rounds=1)
    times = [
        [best_time(run, 1)[0], best_time(lambda: run(events=EVENTS[which]), 1)[0]]
        for _ in range(1 if SMOKE else 7)
    ]
    without, with_events = np.min(times, axis=0)
    crossed = np.isfinite(found.event_times[:, 0])
    benchmark.extra_info["time over that without events"] = round(float(with_events / without), 3)
    benchmark.extra_info["share of bodies that cross"] = round(float(crossed.mean()), 3)
    if "terminal" not in which:
        assert np.array_equal(found.q, plain.q)
