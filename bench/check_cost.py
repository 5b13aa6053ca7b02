"""What the looks at each step's turn cost: every method beside itself with ``looks=False``.

    python bench/check_cost.py                  # every method on quaternions
    python bench/check_cost.py --only magnus4   # the cases with magnus4 in their name
    python bench/check_cost.py --representation dcm

The two take turns in one process, on one thread; the cost is the median of the paired ratios of
time, less 1, and its standard error that of a median of normal numbers.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Iterator

import numpy as np

import fastatt as fa
from fastatt.kernels.trig import sincos

BODIES = 4096
SHORT = 200
LONG = 0.05  # s
INERTIA = (2.0, 1.0, 2 / 3)


def linear_rate(t, p):
    """w(t) = p + p′ t: the cheapest that a user could write."""
    return p[0] + t * p[3], p[1] + t * p[4], p[2] + t * p[5]


def swinging_rate(t, p):
    """A sine and a cosine."""
    s, c = sincos(p[3] * t)
    return p[0] * s, p[1] * c, p[2] + p[0] * s * c


def scenes(n: int) -> dict[str, tuple[fa.Scene, np.ndarray | None]]:
    """Scenes of n bodies, with their initial rates."""
    generator = np.random.default_rng(0)
    w0 = generator.normal(size=(n, 3))
    angle, frequency = generator.uniform(0.2, 1.5, n), generator.uniform(0.5, 2.0, n)
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


class Pair:
    """A case with looks and without, timed in turns."""

    def __init__(
        self, n: int, scene: fa.Scene, w0: np.ndarray | None, method: str, stored: str
    ) -> None:
        self.given = (scene, np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), w0)
        self.options = {"method": method, "representation": stored, "dt": 0.01, "n_threads": 1}

    def seconds(self, steps: int, looks: bool) -> float:
        """Of one call."""
        begin = time.perf_counter()
        fa.propagate(*self.given, n_steps=steps, looks=looks, **self.options)
        return time.perf_counter() - begin

    def cost(self, steps: int, rounds: int) -> tuple[float, float]:
        """(cost of the looks, its standard error)."""
        ratios = []
        for k in range(rounds):
            order = (True, False) if k % 2 else (False, True)
            taken = {looks: self.seconds(steps, looks) for looks in order}
            ratios.append(taken[True] / taken[False])
        spread = np.subtract(*np.percentile(ratios, [75, 25])) / 1.349
        return float(np.median(ratios)) - 1.0, 1.2533 * spread / math.sqrt(rounds)


def pairs(representation: str, only: str = "", n: int = BODIES) -> Iterator[tuple[str, Pair]]:
    """Every stepped method on every scene that it takes, by name."""
    for title, (scene, w0) in scenes(n).items():
        for method in fa.methods_for(scene, representation):
            name = f"{title}, {method}"
            if fa.METHODS[method].is_stepped and only in name:
                yield name, Pair(n, scene, w0, method, representation)


def main() -> None:
    """Print a line a case: long runs, and short ones."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="cases with this in their name")
    parser.add_argument("--rounds", type=int, default=31)
    parser.add_argument("--representation", default="quat")
    arguments = parser.parse_args()
    print(f"| case | steps | cost | | {SHORT} steps | |")
    print("| --- | --- | --- | --- | --- | --- |")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fa.StepWarning)
        for name, pair in pairs(arguments.representation, arguments.only):
            once = min(pair.seconds(SHORT, looks) for looks in (True, False, True))
            steps = max(SHORT, int(SHORT * LONG / once))
            long, error = pair.cost(steps, arguments.rounds)
            short, other = pair.cost(SHORT, arguments.rounds)
            print(
                f"| {name} | {steps} | {long:.1%} | ± {error:.1%} | {short:.1%} | ± {other:.1%} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
