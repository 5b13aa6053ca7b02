"""Start: import and first call, on an empty and on a filled cache."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

SCRIPT = """
from time import perf_counter
begin = perf_counter()
import numpy as np, fastatt as fa
imported = perf_counter()
scene = fa.Scene(rate=fa.rates.Coning(1.0, 1.0))
fa.propagate(scene, np.tile([1.0, 0.0, 0.0, 0.0], (1000, 1)), dt=0.01, n_steps=100)
print(imported - begin, perf_counter() - imported)
"""


def _start(cache) -> tuple[float, float]:
    cache.chmod(0o700)
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "FASTATT_CACHE": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba")},
        capture_output=True,
        text=True,
        check=True,
    )
    imported, called = map(float, result.stdout.split())
    return imported, called


@pytest.mark.benchmark(group="start")
@pytest.mark.parametrize("cache", ["empty", "filled"])
def test_start(benchmark, tmp_path, cache):
    """A whole process: ``extra_info`` tells import and first ensemble call apart."""
    if cache == "filled":
        _start(tmp_path)
    found = benchmark.pedantic(_start, args=(tmp_path,), rounds=1 if cache == "empty" else 5)
    benchmark.extra_info["import, s"], benchmark.extra_info["first call, s"] = (
        round(x, 3) for x in found
    )
