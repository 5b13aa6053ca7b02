"""Start: import and first calls of a whole process, on an empty and on a filled cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# what is run first, and which methods come after it in the same process
CASES = {
    "rk4, free body": ("fa.Scene(inertia=(2.0, 1.0, 2 / 3))", "rk4", ["cf4", "dmv10", "kahan_li8"]),
    "magnus4, coning": (
        "fa.Scene(rate=fa.rates.Coning(np.linspace(0.2, 1.5, 1000), 1.0))",
        "magnus4",
        ["cf4", "magnus6", "rkmk4"],
    ),
    "rk8, heavy top": (
        "fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0.0, 0.0, 0.5), 2.0))",
        "rk8",
        ["rk4", "rkmk4", "strang2"],
    ),
}
SCRIPT = """
import json, sys
from time import perf_counter
begin = perf_counter()
import numba
numba_there = perf_counter()
import numpy as np, fastatt as fa
imported = perf_counter()
scene = {scene}
q = np.tile([1.0, 0.0, 0.0, 0.0], (1000, 1))
w = (None,) if scene.kind == "rate" else (np.full((1000, 3), 0.1),)
calls = []
for method in {methods}:
    before = perf_counter()
    fa.propagate(scene, q, *w, dt=0.01, n_steps=100, method=method)
    calls.append(perf_counter() - before)
json.dump([numba_there - begin, imported - numba_there, *calls], sys.stdout)
"""


def _start(case: str, cache: Path) -> list[float]:
    """Seconds of Numba's import, of fastatt's own, and of each method's first call."""
    cache.chmod(0o700)
    scene, first, more = CASES[case]
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(scene=scene, methods=[first, *more])],
        env={**os.environ, "FASTATT_CACHE": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba")},
        capture_output=True,
        text=True,
        check=True,
    )
    return list(map(float, json.loads(result.stdout)))


@pytest.mark.benchmark(group="start")
@pytest.mark.parametrize("cache", ["empty", "filled"])
@pytest.mark.parametrize("case", CASES)
def test_start(benchmark, tmp_path, case, cache):
    """A whole process: ``extra_info`` tells its parts."""
    if cache == "filled":
        _start(case, tmp_path)
    found = benchmark.pedantic(_start, args=(case, tmp_path), rounds=1 if cache == "empty" else 5)
    numba, ours, first, *further = found
    benchmark.extra_info["import numba, s"] = round(numba, 3)
    benchmark.extra_info["import fastatt besides, s"] = round(ours, 3)
    benchmark.extra_info["import and first call, s"] = round(numba + ours + first, 3)
    benchmark.extra_info["a further method, s"] = [round(x, 3) for x in further]
