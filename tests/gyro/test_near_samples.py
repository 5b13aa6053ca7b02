"""Samples whose times nearly coincide, through which polynomials would magnify noise."""

import numpy as np
import pytest

import fastatt as fa

UNTURNED = (1.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("method", ["previous", "coning2", "picard"])
@pytest.mark.parametrize("increments", [False, True])
def test_samples_that_nearly_coincide_do_not_magnify_noise(method, increments):
    """Of a body at rest, with the noise of a gyro or the resolution of its angle."""
    rng = np.random.default_rng(8)
    for short, at in ((4e-6, 300), (2e-7, 1), (5e-5, -1), (1e-9, slice(40, 600, 9))):
        times = np.arange(601) / 150.0
        times[at] = times[np.arange(601)[at] - 1] + short
        spans = np.diff(times)
        noise = rng.normal(0.0, 2e-5 if increments else 3e-3, (601 - increments, 3))
        options = {"increments": increments, "max_gap": 1.0}
        least = "hold" if increments else "trapezoid"
        straight = fa.integrate_rates(noise, spans, method=least, **options)
        q = fa.integrate_rates(noise, spans, method=method, **options)
        assert (
            fa.angle_between(q, straight).max() < 4.0 * fa.angle_between(straight, UNTURNED).max()
        )


@pytest.mark.parametrize("method", ["previous", "coning2", "picard"])
def test_random_latencies_do_not_magnify_noise(method):
    rng = np.random.default_rng(9)
    for latency in (rng.exponential(3e-3, 3001), rng.uniform(0.0, 0.02, 3001)):
        spans = np.diff(np.sort(np.arange(3001) / 100.0 + latency))
        noise = rng.normal(0.0, 2e-3, (3001, 3))
        straight = fa.integrate_rates(noise, spans, method="trapezoid", max_gap=1.0)
        q = fa.integrate_rates(noise, spans, method=method, max_gap=1.0)
        assert (
            fa.angle_between(q, UNTURNED).max() < 4.0 * fa.angle_between(straight, UNTURNED).max()
        )
