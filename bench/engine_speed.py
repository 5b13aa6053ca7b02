"""Speed of the engine: ensembles, breakpoints, sampled controllers, saves, events and tables.

    python bench/engine_speed.py [WORD ...]

Processor time of a run that makes its tape and of one that has it, each the least of some. With
words only the rows whose names contain one of them. For a comparison of two builds run it with
each, one after the other, with ``PYTHONPATH``.
"""

from __future__ import annotations

import math
import os
import sys
import time
import warnings

import numpy as np

import fastatt as fa

RNG = np.random.default_rng(20261126)
RUNS = 1 if os.environ.get("FASTATT_SMOKE") else 5


def ensemble(n):
    """Attitudes and rates of n bodies, or of one."""
    q = RNG.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    w = RNG.normal(0.0, 0.3, (n, 3))
    return (q, w) if n > 1 else (q[0], w[0])


def fan(t, q, w, p):
    return p[0] * math.sin(t) - 0.1 * w[0], -0.1 * w[1], p[1] * q[1] - 0.1 * w[2]


def damp(t, q, w, p):
    return -0.5 * w[0], -0.5 * w[1], -0.5 * w[2]


def height(t, q, w, p):
    return q[0] * q[0] - 0.25


MOMENTS = (2.0, 1.0, 2.0 / 3.0)
FREE = fa.Scene(inertia=MOMENTS)
TICKS = np.linspace(-1.0, 200.0, 2000)
CUBIC = fa.TimeSeries(TICKS, np.sin(np.outer(TICKS, (1.0, 0.7, 0.4))))
#: what keeps tapes
SCENES = [FREE]


def cases():
    """(name, body-steps, function) of each row."""
    many, one = ensemble(8192), ensemble(1)
    for method, n in (("rk4", 2000), ("rkmk4", 1000), ("kahan_li8", 300), ("rk8", 500)):
        yield (
            f"8192 bodies, {method}", 8192 * n,
            lambda m=method, n=n: fa.propagate(
                FREE, *many, dt=0.01, n_steps=n, method=m, n_threads=1
            ),
        )  # fmt: skip
    single = [x.astype(np.float32) for x in many]
    yield (
        "8192 bodies, rk8, float32", 8192 * 500,
        lambda: fa.propagate(FREE, *single, dt=0.01, n_steps=500, method="rk8", n_threads=1),
    )  # fmt: skip
    yield (
        "8192 bodies, rk4, every step saved", 8192 * 100,
        lambda: fa.propagate(
            FREE, *many, dt=0.01, n_steps=100, method="rk4", save_every=1, n_threads=1
        ),
    )  # fmt: skip
    moments = np.sort(RNG.uniform(0.0, 10.0, 100))
    yield (
        "8192 bodies, 100 save_at times", 8192 * 1000,
        lambda: fa.propagate(FREE, *many, dt=0.01, save_at=moments, method="rk4", n_threads=1),
    )  # fmt: skip
    yield (
        "one body, one step",
        1, lambda: fa.propagate(FREE, *one, dt=0.01, n_steps=1, method="rk4"),
    )  # fmt: skip
    plan = fa.plan(FREE, 1, dt=0.01, n_steps=1, method="rk4")
    yield "one body, one step of a plan", 1, lambda: plan(*one)
    for name, every in (("plain", None), ("10^5 saves", 1)):
        yield (
            f"one body, {name}", 100_000,
            lambda every=every: fa.propagate(
                FREE, *one, dt=0.01, n_steps=100_000, save_every=every, method="rk4", n_threads=1
            ),
        )  # fmt: skip
    times = np.sort(RNG.uniform(0.0, 1000.0, 10_000))
    yield (
        "one body, 10^4 save_at times", 100_000,
        lambda: fa.propagate(FREE, *one, dt=0.01, save_at=times, method="rk4", n_threads=1),
    )  # fmt: skip
    broken = fa.Scene(
        inertia=MOMENTS, torque=fan, params=(0.2, 0.1), breakpoints=np.arange(1.005, 600.0)
    )
    SCENES.append(broken)
    yield (
        "one body, a breakpoint every second", 60_000,
        lambda: fa.propagate(broken, *one, dt=0.01, n_steps=60_000, method="rk4", n_threads=1),
    )  # fmt: skip
    sampled = fa.Scene(
        inertia=MOMENTS,
        torque=fa.torques.SampledControl(fa.torques.Custom(damp), period=0.1),
    )
    SCENES.append(sampled)
    yield (
        "one body, a controller sampled at 10 Hz", 20_000,
        lambda: fa.propagate(
            sampled, *one, s0=(0.0, 0.0, 0.0), dt=0.03, n_steps=20_000, method="rk4", n_threads=1
        ),
    )  # fmt: skip
    crowd = ensemble(100_000)
    yield (
        "10^5 bodies, exact, one save", 100_000 * 100,
        lambda: fa.propagate(FREE, *crowd, dt=0.01, n_steps=100, method="exact", n_threads=1),
    )  # fmt: skip
    event = fa.event(height)
    yield (
        "10^5 bodies, an event", 100_000 * 200,
        lambda: fa.propagate(
            FREE, *crowd, dt=0.05, n_steps=200, method="rk4", events=[event], n_threads=1
        ),
    )  # fmt: skip
    cone = fa.Scene(rate=lambda t, p: CUBIC(t))
    some = ensemble(8192)[0]
    yield (
        "8192 bodies, magnus4, a table at one time", 8192 * 1000,
        lambda: fa.propagate(cone, some, dt=0.01, n_steps=1000, method="magnus4", n_threads=1),
    )  # fmt: skip
    shifts = RNG.uniform(0.0, 1.0, (8192, 1))
    own = fa.Scene(rate=lambda t, p: CUBIC(t + p[0]), params=shifts)
    yield (
        "8192 bodies, magnus4, a table at own times", 8192 * 1000,
        lambda: fa.propagate(own, some, dt=0.01, n_steps=1000, method="magnus4", n_threads=1),
    )  # fmt: skip


def least_time(run, repeats, prepare=lambda: None):
    """The least processor time of some runs, s, each after ``prepare``."""
    least = math.inf
    for _ in range(RUNS):
        prepare()
        begin = time.process_time()
        for _ in range(repeats):
            run()
        least = min(least, (time.process_time() - begin) / repeats)
    return least


def forget():
    """Drop the tapes that the scenes keep."""
    for scene in SCENES:
        scene.memo.clear()


def main():
    warnings.simplefilter("ignore")
    words = sys.argv[1:]
    for name, steps, run in cases():
        if words and not any(word in name for word in words):
            continue
        run()
        repeats = 1 if steps > 1 else 500
        first = least_time(run, 1, forget)
        again = least_time(run, repeats)
        shown = f"first {1e3 * first:9.3f} ms, again {1e3 * again:9.3f} ms"
        print(f"{name:42} {shown} {1e9 * again / steps:10.2f} ns a step", flush=True)


if __name__ == "__main__":
    main()
