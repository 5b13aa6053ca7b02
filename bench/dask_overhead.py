"""What Dask costs beside the steps: one ensemble here on k threads, then on k local processes.

``python bench/dask_overhead.py``; the shorter of two runs of each, in turns.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import perf_counter
from typing import Any

import dask
import dask.array as da
import numpy as np
from distributed import Client, LocalCluster, wait

import fastatt as fa
from fastatt import dask as fd
from fastatt.threads import default_threads

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N, STEPS, CHUNK = (2000, 10, 500) if SMOKE else (1_000_000, 1000, 100_000)
MANY = 20 if SMOKE else 1000  # chunks of one body and one step
SCENE = fa.Scene(inertia=(2.0, 1.5, 1.0))
RK4: dict[str, Any] = {"dt": 0.01, "method": "rk4"}


def main() -> None:
    rng = np.random.default_rng(0)
    q0, w0 = rng.normal(size=(N, 4)), 0.5 * rng.normal(size=(N, 3))
    k = default_threads()
    with (
        LocalCluster(n_workers=k, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster),
    ):
        there = [da.from_array(x, chunks=(CHUNK, -1)).persist() for x in (q0, w0)]

        def on_workers() -> None:
            run = dask.persist(fd.propagate(SCENE, *there, n_steps=STEPS, **RK4))[0]
            wait([run.q, run.w, run.status])

        def to_and_fro() -> None:
            dask.compute(fd.propagate(SCENE, q0, w0, chunks=CHUNK, n_steps=STEPS, **RK4))

        def many() -> None:
            dask.compute(fd.propagate(SCENE, q0[:MANY], w0[:MANY], chunks=1, n_steps=1, **RK4))

        runs: dict[str, Callable[[], object]] = {
            f"threads of one process, {k}": lambda: fa.propagate(
                SCENE, q0, w0, n_steps=STEPS, n_threads=k, **RK4
            ),
            "workers, states made and kept there": on_workers,
            "workers, states sent and fetched": to_and_fro,
            f"{MANY} chunks of nothing": many,
        }
        times: dict[str, list[float]] = {name: [] for name in runs}
        # the first time loads what is compiled
        for again in range(1 if SMOKE else 3):
            for name, call in runs.items():
                begin = perf_counter()
                call()
                if again or SMOKE:
                    times[name].append(perf_counter() - begin)
    first = min(next(iter(times.values())))
    print(f"{N} bodies, {STEPS} steps, {CHUNK} bodies a chunk")
    for name, found in times.items():
        spread = f"{min(found):8.3f} s (at most {max(found):.3f})"
        print(f"{name:38} {spread} {min(found) / first - 1.0:+8.1%}")


if __name__ == "__main__":
    main()
