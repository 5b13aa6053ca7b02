"""Speed of the engine: ensembles, breakpoints, sampled controllers, saves, events and tables.

    python bench/engine_speed.py [WORD ...]

Processor time of the making of the tape, and of the run without it, each the least of some. With
words only the rows whose names contain one of them. For a comparison of two builds run it with
each, one after the other, with ``PYTHONPATH``.
"""

from __future__ import annotations

import math
import sys
import time
import warnings

import numpy as np

import fastatt as fa
from fastatt.engine.tape import Steps
from fastatt.propagation import options, plan

RNG = np.random.default_rng(20261126)
RUNS = 3
#: processor time of the making of tapes so far, s
MADE = [0.0]


def timed(function):
    """A function that adds the time of its calls to ``MADE``."""

    def call(*args, **kwargs):
        begin = time.process_time()
        result = function(*args, **kwargs)
        MADE[0] += time.process_time() - begin
        return result

    return call


Steps.__init__, Steps._tape = timed(Steps.__init__), timed(Steps._tape)
options.legs_of, plan.breaks_within = timed(options.legs_of), timed(plan.breaks_within)


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
    at = np.sort(RNG.uniform(0.0, 10.0, 100))
    yield (
        "8192 bodies, 100 save_at times", 8192 * 1000,
        lambda: fa.propagate(FREE, *many, dt=0.01, save_at=at, method="rk4", n_threads=1),
    )  # fmt: skip
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


def main():
    warnings.simplefilter("ignore")
    words = sys.argv[1:]
    for name, steps, run in cases():
        if words and not any(word in name for word in words):
            continue
        run()
        tape = least = math.inf
        for is_new in (*[True] * RUNS, *[False] * RUNS):
            if is_new:  # else the tape may be that of the run before
                for scene in SCENES:
                    scene.memo.clear()
            MADE[0], begin = 0.0, time.process_time()
            run()
            least = min(least, time.process_time() - begin - MADE[0])
            tape = min(tape, MADE[0]) if is_new else tape
        shown = f"tape {1e3 * tape:8.2f} ms, run {1e3 * least:9.2f} ms"
        print(f"{name:42} {shown} {1e9 * least / steps:8.2f} ns a step", flush=True)


if __name__ == "__main__":
    main()
