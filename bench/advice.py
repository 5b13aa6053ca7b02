"""Is the advice any good? Random scenes: what ``fastatt.recommend`` says beside a full sweep.

For each scene of each kind a tolerance and a duration are drawn; what is recommended is run on the
whole ensemble and measured against a tight reference, and every method and precision is swept for
the least number of steps that meets the tolerance. Printed are the share of scenes whose true
error is within the tolerance, and the share whose time is within 1.3 times the best of the sweep.

    python bench/advice.py --scenes 200 --seed 1
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

import fastatt as fa
from fastatt.kernels.trig import sincos
from fastatt.propagation.ensemble import Ensemble
from fastatt.trade.ladder import largest_angle, see
from fastatt.trade.measure import Case, Problem, machine_line
from fastatt.trade.reference import Reference, largest_rotation, reference
from fastatt.trade.timing import once, time_in_turns
from fastatt.trade.work_precision import cases_of

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
N_BODIES = 64 if SMALL else 4096
RATIO = 2.0 ** (1.0 / 6.0)  # between the sweep's numbers of steps
SLOWER = 2.0  # a sweep gives a case up where it takes so many times as long as the best


def swinging(t, p):
    s, c = sincos(p[3] * t)
    return p[0] * s, p[1] * c, p[2] + p[0] * s * c


def vectors(rng, n, size):
    return rng.normal(size=(n, 3)) * size


def directions(rng, n):
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def moments(rng, n):
    """Of solid bodies: the sums of two of three positive numbers."""
    a = rng.uniform(0.3, 1.5, (n, 3))
    return a.sum(axis=1, keepdims=True) - a


def torqued(rng, n, torque):
    return fa.Scene(inertia=moments(rng, n), torque=torque)


def controlled(rng, n):
    return torqued(rng, n, fa.torques.QuaternionPD(rng.uniform(0.1, 1.0), rng.uniform(0.1, 1.0)))


def several(rng, n):
    return fa.torques.Sum(
        (
            fa.torques.GravityGradient(rng.uniform(0.05, 0.3)),
            fa.torques.Damping(rng.uniform(0.01, 0.1)),
            fa.torques.Rotor(rng.normal(size=3) * 0.2),
        )
    )


KINDS: dict[str, Callable[[np.random.Generator, int], fa.Scene]] = {
    "constant": lambda r, n: fa.Scene(rate=fa.rates.Constant(vectors(r, n, 1.0))),
    "polynomial": lambda r, n: fa.Scene(
        rate=fa.rates.Polynomial(r.normal(size=(n, 4, 3)) * [[1.0], [0.1], [0.01], [1e-3]])
    ),
    "coning": lambda r, n: fa.Scene(
        rate=fa.rates.Coning(r.uniform(0.05, 1.5, n), r.uniform(0.3, 3.0, n))
    ),
    "inertial": lambda r, n: fa.Scene(
        rate=fa.rates.Sinusoidal(
            vectors(r, n, 0.5), vectors(r, n, 0.5), r.uniform(0.3, 3.0, (n, 3))
        ),
        frame="inertial",
    ),
    "function": lambda r, n: fa.Scene(rate=swinging, params=r.uniform(0.3, 1.5, (n, 4))),
    "spherical": lambda r, n: fa.Scene(inertia=np.ones(3) * r.uniform(0.5, 2.0)),
    "symmetric": lambda r, n: fa.Scene(inertia=(1.0, 1.0, r.uniform(0.3, 1.9))),
    "free": lambda r, n: fa.Scene(inertia=moments(r, n)),
    "gravity": lambda r, n: torqued(r, n, fa.torques.GravityGradient(r.uniform(0.05, 0.5))),
    "damped": lambda r, n: torqued(r, n, fa.torques.Damping(r.uniform(0.01, 0.3))),
    "top": lambda r, n: fa.Scene(
        inertia=(1.0, 1.0, r.uniform(0.3, 1.5)),
        torque=fa.torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=r.uniform(1.0, 20.0)),
    ),
    "dipole": lambda r, n: torqued(
        r, n, fa.torques.MagneticDipole(r.normal(size=3), r.normal(size=3))
    ),
    "controlled": controlled,
    "pointing": controlled,
    "rotor": lambda r, n: torqued(r, n, fa.torques.Rotor(r.normal(size=3) * 0.5)),
    "several": lambda r, n: torqued(r, n, several(r, n)),
}


@dataclass(frozen=True)
class Trial:
    """One scene: what was recommended, what was true, and the best that the sweep found."""

    number: int
    kind: str
    tol: float
    recommended: str
    n_steps: int
    true_error: float
    seconds: float
    best: str
    best_steps: int
    best_seconds: float
    advice_seconds: float
    refused: str

    @property
    def met(self) -> bool:
        return self.true_error <= self.tol

    @property
    def ratio(self) -> float:
        return self.seconds / self.best_seconds


def draw(seed: int, number: int, n: int) -> tuple[str, Problem, float]:
    """A kind in turn, with a scene, a duration and a tolerance by chance."""
    rng = np.random.default_rng((seed, number))
    kind = list(KINDS)[number % len(KINDS)]
    scene = KINDS[kind](rng, n)
    q0 = rng.normal(size=(n, 4))
    w0 = None if scene.kind == "rate" else vectors(rng, n, 10.0 ** rng.uniform(-0.5, 0.5))
    if kind == "pointing":  # energy too low for half a turn, where the controller's torque jumps
        q0 = fa.rotation_vector_to_quat(directions(rng, n) * rng.uniform(0.0, 1.5, (n, 1)))
        w0 = directions(rng, n) * rng.uniform(0.0, 0.25, (n, 1))
    t_end = 10.0 ** rng.uniform(0.3, 1.7)
    return kind, Problem(Ensemble(scene, q0, w0), t_end), 10.0 ** rng.uniform(-10.0, -2.0)


def error(problem: Problem, case: Case, n: int, known: Reference) -> float:
    """The largest over the run, at up to 16 even times and after the first 16 steps."""
    seen = see(problem, case, n, 16)
    apart = largest_angle(seen.q, known.at(seen.times)).max()
    return math.inf if seen.flagged.any() else float(apart)


def seconds_of(problem: Problem, case: Case, n: int) -> float:
    """The shorter of two runs' times."""
    return min(once(partial(problem.run, case, n))[0] for _ in range(2))


def steps(first: float, k: int) -> int:
    """The k-th number of a ladder, in which large ones have 8 times in common."""
    n = math.ceil(first * RATIO**k)
    return n if n < 64 else -(-n // 8) * 8


def least(
    problem: Problem, case: Case, tol: float, known: Reference, best: float
) -> tuple[int, float] | None:
    """The least number of steps on a fine ladder that meets the tolerance, and its time."""
    method = case.record
    if not method.order:
        return (1, seconds_of(problem, case, 1)) if error(problem, case, 1, known) <= tol else None
    turn = largest_rotation(problem)
    constant = problem.ensemble.scene.is_constant and method.exact_for_constant
    first = 1.0 if constant else max(1.0, turn / 3.0)
    low, k = -1, 0
    while True:
        n = steps(first, k)
        if error(problem, case, n, known) <= tol:
            break
        if seconds_of(problem, case, n) > SLOWER * best or n > 3e6:
            return None
        low, k = k, k + 6
    high = k
    while high - low > 1:
        k = (low + high) // 2
        good = error(problem, case, steps(first, k), known) <= tol
        low, high = (low, k) if good else (k, high)
    n = steps(first, high)
    return n, seconds_of(problem, case, n)


def sweep(
    problem: Problem, tol: float, known: Reference, best: float, methods: list[str] | None = None
) -> list[tuple[float, Case, int]]:
    """The best of every method and precision that is not far slower than ``best`` s."""
    found = []
    cases = cases_of(problem.ensemble.scene, methods, ("quat",), ("float64", "float32"))
    for case in sorted(cases, key=lambda c: -(c.record.order or 99)):
        if case.dtype == "float32" and tol < 1e-7:
            continue
        result = least(problem, case, tol, known, best)
        if result is not None:
            found.append((result[1], case, result[0]))
            best = min(best, result[1])
    return sorted(found, key=lambda item: item[0])


def trial(
    seed: int, number: int, n_bodies: int, seconds: float, methods: list[str] | None = None
) -> Trial:
    """Draw, ask, run, sweep; ``methods`` are those to choose among, None for all."""
    kind, problem, tol = draw(seed, number, n_bodies)
    e = problem.ensemble
    known = reference(problem, most=16)
    begin = perf_counter()
    try:
        chosen = fa.recommend(e.scene, e.q0, e.w0, t_end=problem.duration, tol=tol, methods=methods)
    except ValueError as refusal:
        return Trial(
            number, kind, tol, "", 0, math.inf, math.inf, "", 0, 1.0, perf_counter() - begin,
            str(refusal),
        )  # fmt: skip
    took = perf_counter() - begin
    case = chosen.case
    true = error(problem, case, chosen.n_steps, known)
    # a scene that needs 10^6 steps would be swept for hours
    bound = seconds_of(problem, case, chosen.n_steps) if true <= tol else math.inf
    best = sweep(problem, tol, known, bound, methods)[:3]
    runs = [(case, chosen.n_steps), *[(c, n) for _, c, n in best]]
    calls = [partial(problem.run, *run) for run in runs]
    own, *others = (times.least for times in time_in_turns(calls, budget=seconds))
    i = int(np.argmin(others)) if others else -1
    return Trial(
        number=number,
        kind=kind,
        tol=tol,
        recommended=str(case),
        n_steps=chosen.n_steps,
        true_error=true,
        seconds=own,
        best=str(best[i][1]) if others else str(case),
        best_steps=best[i][2] if others else chosen.n_steps,
        best_seconds=others[i] if others else own,
        advice_seconds=took,
        refused="",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenes", type=int, default=2 if SMALL else 200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bodies", type=int, default=N_BODIES)
    parser.add_argument("--seconds", type=float, default=0.3, help="of timing, a scene")
    arguments = parser.parse_args()
    print(machine_line(), flush=True)
    trials: list[Trial] = []
    # a process a kind: what was compiled for one kind is of no use to another, and takes memory
    with ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        for k in range(min(len(KINDS), arguments.scenes)):
            own = range(k, arguments.scenes, len(KINDS))
            given = arguments.seed, own, arguments.bodies, arguments.seconds
            trials += pool.submit(trials_of, *given).result()
    report(trials)


def trials_of(seed: int, numbers: Sequence[int], n_bodies: int, seconds: float) -> list[Trial]:
    warnings.simplefilter("ignore")
    methods = ["rk4"] if SMALL else None
    return [trial(seed, number, n_bodies, seconds, methods) for number in numbers]


def report(trials: list[Trial]) -> None:
    """The two shares, and the scenes that miss them."""
    asked = [t for t in trials if not t.refused]
    met = [t for t in asked if t.met]
    near = [t for t in asked if t.ratio <= 1.3]
    for t in trials:
        if t.refused:
            print(f"refused {t.kind} {t.number} tol {t.tol:.1e}: {t.refused}")
        elif not t.met or t.ratio > 1.3:
            print(
                f"{t.kind} {t.number} tol {t.tol:.1e}: {t.recommended} {t.n_steps} steps, error "
                f"{t.true_error:.1e}, {t.seconds * 1e3:.3g} ms; {t.best} {t.best_steps} steps "
                f"{t.best_seconds * 1e3:.3g} ms, {t.ratio:.2f} times"
            )
    n = max(1, len(asked))
    ratios = [t.ratio for t in asked] or [math.nan]
    took = [t.advice_seconds for t in trials]
    print(f"{len(trials)} scenes, {len(trials) - len(asked)} refused")
    print(f"error within tol: {len(met)} of {len(asked)}, {len(met) / n:.1%}")
    print(
        f"time within 1.3 of the best: {len(near)} of {len(asked)}, {len(near) / n:.1%}; ratio "
        f"{np.median(ratios):.2f} (median), {np.quantile(ratios, 0.9):.2f} (90 %)"
    )
    print(f"advice took {np.median(took):.2f} s (median), {max(took):.2f} s (longest)")


if __name__ == "__main__":
    main()
