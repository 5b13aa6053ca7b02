"""What the checks cost: every method beside itself compiled without them.

    python bench/check_cost.py                  # every method: 15 minutes on an empty cache
    python bench/check_cost.py --only magnus4   # the cases with magnus4 in their name
    python bench/check_cost.py --representation dcm

Two processes take turns, the second with an engine that looks at no turn, no invariant and no
state: nothing would be flagged there. The runs are on one thread; the cost is the median of paired
ratios of time, less 1, and its standard error that of a median of normal numbers. As one process
may be slower than another of the same code for as long as it lives, a few pairs share the rounds.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time
import warnings
from itertools import chain

import numba
import numpy as np

import fastatt as fa
from fastatt import limits
from fastatt._jit import helper, hook
from fastatt.columns import store
from fastatt.engine import tiles
from fastatt.kernels.trig import sincos
from fastatt.translation import full_step

BODIES = 4096
SHORT = 200
PAIRS = 3
INERTIA = (2.0, 1.0, 2 / 3)


@numba.njit
def linear_rate(t, p):
    """w(t) = p + p′ t: the cheapest that a user could write."""
    return p[0] + t * p[3], p[1] + t * p[4], p[2] + t * p[5]


@numba.njit
def swinging_rate(t, p):
    """A sine and a cosine."""
    s, c = sincos(p[3] * t)
    return p[0] * s, p[1] * c, p[2] + p[0] * s * c


def scenes():
    generator = np.random.default_rng(0)
    w0 = generator.normal(size=(BODIES, 3))
    angle, frequency = generator.uniform(0.2, 1.5, BODIES), generator.uniform(0.5, 2.0, BODIES)
    line = np.hstack([w0, 0.01 * w0[::-1]])
    gravity = fa.torques.GravityGradient(mean_motion=0.1)
    return {
        "constant rate": (fa.Scene(rate=fa.rates.Constant(w0)), None),
        "a user's line": (fa.Scene(rate=linear_rate, params=line), None),
        "a user's sines": (fa.Scene(rate=swinging_rate, params=line[:, :4]), None),
        "coning": (fa.Scene(rate=fa.rates.Coning(angle, frequency)), None),
        "free": (fa.Scene(inertia=INERTIA), w0),
        "gravity gradient": (fa.Scene(inertia=INERTIA, torque=gravity), w0),
    }


def names(representation):
    return [
        f"{scene}, {method}"
        for scene, (what, _) in scenes().items()
        for method in fa.methods_for(what, representation)
        if method != "exact"
    ]


@helper
def lanes_without(look, method, rep, model, rows, shape, params, shared, t, span, other):
    """``tiles.lanes`` that does not look at the turn."""
    top = tiles.height(rep, model)
    for j in range(tiles.WIDTH):
        x = tiles.state(rep, model, rows, j)
        p = tiles.parameters(params, shape, shared, rows, top, j)
        e = tiles.extras_of(method, params, shape, rows, top, j)
        x, _ = full_step(method, rep, model, t, span, other, x, p, e)
        store(rows, 0, j, x)


def departure_without(a, b, like):
    """``tiles.departure`` that looks at nothing."""
    raise NotImplementedError


@hook(departure_without)
def _departure_without(a, b, like):
    return lambda a, b, like: type(like)(0.0)


def remove_checks():
    tiles.lanes = lanes_without
    tiles.departure = departure_without
    tiles.seen_at_times = lambda *about: False
    limits.known_turns = lambda *about: np.zeros(1)
    limits.status = lambda x, *rest: np.zeros(len(x), dtype=np.uint8)
    limits.warn = lambda *seen, **options: False


def work(representation):
    """Answer each line, a case and a number of steps, with the seconds that it took."""
    what = scenes()
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (BODIES, 1))
    warnings.simplefilter("ignore")
    for line in sys.stdin:
        name, method, steps = line.strip().split(", ")
        scene, w0 = what[name]
        start = time.perf_counter()
        fa.propagate(
            scene, q0, w0, dt=0.01, n_steps=int(steps), method=method, n_threads=1,
            representation=representation,
        )  # fmt: skip
        print(time.perf_counter() - start, flush=True)


def worker(*options, **environment):
    return subprocess.Popen(
        [sys.executable, __file__, *options],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )


def ask(process, name, steps):
    process.stdin.write(f"{name}, {steps}\n")
    process.stdin.flush()
    return float(process.stdout.readline())


def paired(pairs, name, steps, rounds):
    """(cost, its standard error) of the checks of each pair's first worker."""
    ratios = []
    for i in range(rounds):
        workers = pairs[i % len(pairs)]
        order = (0, 1) if i // len(pairs) % 2 else (1, 0)
        taken = {k: ask(workers[k], name, steps) for k in order}
        ratios.append(taken[0] / taken[1])
    spread = np.subtract(*np.percentile(ratios, [75, 25])) / 1.349
    return np.median(ratios) - 1.0, 1.2533 * spread / math.sqrt(rounds)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cases with this in their name")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--representation", default="quat")
    parser.add_argument("--worker", choices=("with", "without"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        if arguments.worker == "without":
            remove_checks()
        work(arguments.representation)
        return
    kind = ("--representation", arguments.representation)
    print(f"| case | steps | cost | | {SHORT} steps | |")
    print("| --- | --- | --- | --- | --- | --- |")
    with tempfile.TemporaryDirectory() as bare:
        pairs = [
            (
                worker("--worker", "with", *kind),
                worker("--worker", "without", *kind, NUMBA_CACHE_DIR=bare),
            )
            for _ in range(PAIRS)
        ]
        for name in names(arguments.representation):
            if arguments.only not in name:
                continue
            for process in chain(*pairs):
                ask(process, name, SHORT)
            steps = max(SHORT, int(SHORT * 0.05 / ask(pairs[0][0], name, SHORT)))
            long, error = paired(pairs, name, steps, arguments.rounds)
            short, other = paired(pairs, name, SHORT, arguments.rounds)
            print(
                f"| {name} | {steps} | {long:.1%} | ± {error:.1%} | {short:.1%} | ± {other:.1%} |",
                flush=True,
            )
        for process in chain(*pairs):
            process.stdin.close()
            process.wait()


if __name__ == "__main__":
    main()
