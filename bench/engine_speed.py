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
from functools import partial

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
BROKEN = fa.Scene(
    inertia=MOMENTS, torque=fan, params=(0.2, 0.1), breakpoints=np.arange(1.005, 600.0)
)
SAMPLED = fa.Scene(
    inertia=MOMENTS, torque=fa.torques.SampledControl(fa.torques.Custom(damp), period=0.1)
)
ONE_TIME = fa.Scene(rate=lambda t, p: CUBIC(t))
OWN_TIMES = fa.Scene(rate=lambda t, p: CUBIC(t + p[0]), params=RNG.uniform(0.0, 1.0, (8192, 1)))
SCENES = FREE, BROKEN, SAMPLED, ONE_TIME, OWN_TIMES
DEFAULTS = {"dt": 0.01, "method": "rk4", "n_threads": 1}


def cases():
    """(name, body-steps, function) of each row."""
    many, one, crowd = ensemble(8192), ensemble(1), ensemble(100_000)
    single, some, magnus = [x.astype(np.float32) for x in many], many[:1], {"method": "magnus4"}
    instants = {"n_steps": None, "save_at": np.sort(RNG.uniform(0.0, 10.0, 100))}
    dense = {"n_steps": None, "save_at": np.sort(RNG.uniform(0.0, 1000.0, 10_000))}
    memory, event = {"s0": (0.0, 0.0, 0.0), "dt": 0.03}, {"events": [fa.event(height)], "dt": 0.05}
    rows = (
        ("8192 bodies, rk4", FREE, many, 2000, {}),
        ("8192 bodies, rkmk4", FREE, many, 1000, {"method": "rkmk4"}),
        ("8192 bodies, kahan_li8", FREE, many, 300, {"method": "kahan_li8"}),
        ("8192 bodies, rk8", FREE, many, 500, {"method": "rk8"}),
        ("8192 bodies, rk8, float32", FREE, single, 500, {"method": "rk8"}),
        ("8192 bodies, rk4, every step saved", FREE, many, 100, {"save_every": 1}),
        ("8192 bodies, 100 save_at times", FREE, many, 1000, instants),
        ("one body, one step", FREE, one, 1, {}),
        ("one body, plain", FREE, one, 100_000, {}),
        ("one body, 10^5 saves", FREE, one, 100_000, {"save_every": 1}),
        ("one body, 10^4 save_at times", FREE, one, 100_000, dense),
        ("one body, a breakpoint every second", BROKEN, one, 60_000, {}),
        ("one body, a controller sampled at 10 Hz", SAMPLED, one, 20_000, memory),
        ("10^5 bodies, exact, one save", FREE, crowd, 100, {"method": "exact"}),
        ("10^5 bodies, an event", FREE, crowd, 200, event),
        ("8192 bodies, magnus4, a table at one time", ONE_TIME, some, 1000, magnus),
        (
            "8192 bodies, magnus4, a table at own times",
            OWN_TIMES,
            some,
            1000,
            {"method": "magnus4"},
        ),
    )
    plan = fa.plan(FREE, 1, dt=0.01, n_steps=1, method="rk4")
    yield "one body, one step of a plan", 1, partial(plan, *one)
    for name, scene, start, n_steps, options in rows:
        bodies = 1 if start[0].ndim == 1 else len(start[0])
        options = {**DEFAULTS, "n_steps": n_steps, **options}
        yield name, bodies * n_steps, partial(fa.propagate, scene, *start, **options)


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
