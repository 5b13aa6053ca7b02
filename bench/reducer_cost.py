"""What a function that sees every step costs, beside the run without it: ``fastatt.reducer``.

``python bench/reducer_cost.py`` takes a quarter of a minute on one core; the runs are
interleaved, and the least time of each counts. Beside the time stand the operations that the
function adds to a step.
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np

import fastatt as fa
from fastatt.propagation.inspect_step import job_of

SMALL = bool(os.environ.get("FASTATT_SMOKE"))


def largest(t, q, w, s):
    """Largest |w|²."""
    z = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    return max(z, s[0])


def three(t, q, w, s):
    """Largest |w|², first time near a direction, steps on the far side of it."""
    z = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    c = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
    first = t if c > 0.98 and s[1] < 0.0 else s[1]
    return max(z, s[0]), first, (s[2] + 1.0 if c < 0.0 else s[2])


def cases(n):
    """Name, scene, rates, method and steps."""
    rng = np.random.default_rng(1)
    w0 = rng.normal(0.0, 0.3, (n, 3))
    free = fa.Scene(inertia=(3.0, 2.0, 1.0))
    orbit = fa.torques.GravityGradient(mean_motion=1.1e-3)
    orbiting = fa.Scene(inertia=rng.uniform(1.0, 1.5, (n, 3)), torque=orbit)
    cones = fa.Scene(rate=fa.rates.Coning(rng.uniform(0.1, 1.0, n), frequency=2.0))
    yield "free bodies", free, w0, "rk4", 400
    yield "free bodies", free, w0, "rk8", 80
    yield "gravity gradient", orbiting, w0, "rk8", 60
    yield "cones", cones, None, "magnus4", 300


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--bodies", type=int, default=100 if SMALL else 10_000)
    parser.add_argument("--repeats", type=int, default=1 if SMALL else 40)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    watches = [None, fa.reducer(largest, start=0.0), fa.reducer(three, start=(0.0, -1.0, 0.0))]
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (args.bodies, 1))
    shared = {"dt": 0.01, "n_threads": args.threads}
    print("| scene | method | operations | million steps/s | largest rate | three numbers |")
    print("| --- | --- | --- | --- | --- | --- |")
    for name, scene, w0, method, steps in cases(args.bodies):
        best = [np.inf] * len(watches)
        for repeat in range(-1, args.repeats):  # once to compile
            for i, watch in enumerate(watches):
                begun = time.perf_counter()
                fa.propagate(scene, q0, w0, n_steps=steps, method=method, reduce=watch, **shared)
                taken = time.perf_counter() - begun
                best[i] = min(best[i], taken) if repeat >= 0 else np.inf
        speed = args.bodies * steps / best[0] / 1e6
        own, *operations = (
            job_of(scene, method, "quat", "float64", watch).formulas.operations for watch in watches
        )
        more = " | ".join(
            f"{n - own:+d}: {100 * (x / best[0] - 1):+.0f} %"
            for n, x in zip(operations, best[1:], strict=True)
        )
        print(f"| {name} | {method} | {own} | {speed:.0f} | {more} |")


if __name__ == "__main__":
    main()
