"""Random scenes whose rate or torque jumps: is a promise of advice or of per-body steps broken.

Scenes are drawn at random: thruster pulses, jumps, ramps, smooth pulses and drag, of a rigid body
or as a rate, and the tolerance and the duration with them. What is recommended is run on all bodies
and compared with a run of rk8 whose steps end at each jump and corner, which a run of half as many
steps confirms. Printed are how many promises were kept and broken, and how many cases were refused,
warned of, or beyond what the comparison knows; of scenes that declare their breakpoints as well.

    python bench/hostile.py                       # 300 scenes, 400 runs
    python bench/hostile.py --scenes 8 --runs 16
"""

from __future__ import annotations

import argparse
import os
import warnings
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import fastatt as fa
from fastatt.trade.measure import machine_line

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
_STEPS = 800  # of the reference, between breakpoints
_ROUNDED = 1e-12  # rad, which is taken off errors
_CONFIRMED = 0.02  # of the tolerance: what half the steps may change


def pulse(t, q, w, p):
    """A thruster that is on from p[1] to p[2] s."""
    on = p[0] if p[1] < t < p[2] else 0.0
    return on, 0.5 * on, 0.0


def jump(t, q, w, p):
    """A torque that is reversed at p[1] s."""
    k = p[0] if t < p[1] else -p[0]
    return k, 0.0, 0.3 * k


def ramp(t, q, w, p):
    """A torque that grows from p[1] to p[2] s."""
    share = min(max((t - p[1]) / (p[2] - p[1]), 0.0), 1.0)
    return 0.2 * p[0] * share, p[0] * share, 0.0


def shot(t, q, w, p):
    """A smooth pulse at p[1] s, p[2] − p[1] wide."""
    x = (t - p[1]) / (p[2] - p[1])
    return p[0] / (1.0 + x * x * x * x), 0.0, 0.1 * p[0]


def drag(t, q, w, p):
    """Quadratic drag and a constant torque."""
    size = (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) ** 0.5
    return p[0] - 0.2 * size * w[0], -p[0] - 0.2 * size * w[1], 0.5 * p[0] - 0.2 * size * w[2]


def rate_pulse(t, p):
    on = p[0] if p[1] < t < p[2] else 0.0
    return 0.3 + on, 0.2, 0.1 * on


def rate_ramp(t, p):
    share = min(max((t - p[1]) / (p[2] - p[1]), 0.0), 1.0)
    return p[0] * share, 0.4, 0.1


#: function, whether it is a rate, and how many of p[1], p[2] are breakpoints
KINDS: dict[str, tuple[Callable[..., Any], bool, int]] = {
    "pulse": (pulse, False, 2),
    "jump": (jump, False, 1),
    "ramp": (ramp, False, 2),
    "smooth pulse": (shot, False, 0),
    "drag": (drag, False, 0),
    "pulse of a rate": (rate_pulse, True, 2),
    "ramp of a rate": (rate_ramp, True, 2),
}


class Case(NamedTuple):
    """A scene with its bodies, and where steps of a reference have to end."""

    kind: str
    scene: fa.Scene
    q0: Any
    w0: Any
    t0: float
    t_end: float
    tol: float
    breaks: list[float]


def draw(
    seed: int, number: int, bodies: int, *, rates: bool = True, declared: bool = False
) -> Case:
    """A case of one kind after another; its scene has breakpoints where they are ``declared``."""
    rng = np.random.default_rng((seed, number))
    kinds = [k for k, (_, is_rate, _) in KINDS.items() if rates or not is_rate]
    kind = kinds[number % len(kinds)]
    function, is_rate, breaks = KINDS[kind]
    t_end, t0 = 10.0 ** rng.uniform(0.3, 1.5), float(rng.choice([0.0, 0.0, 7.0]))
    begin = t0 + t_end * rng.uniform(0.1, 0.8)
    width = t_end * 10.0 ** rng.uniform(-2.5, -0.8)
    if rng.random() < 0.3:  # even times, on which steps may end by chance
        begin, width = t0 + t_end * rng.integers(1, 8) / 8, t_end / 2.0 ** rng.integers(4, 9)
    p = (10.0 ** rng.uniform(-1.0, 0.5), begin, begin + width)
    breakpoints = p[1 : 1 + breaks] if declared else ()
    if is_rate:
        scene = fa.Scene(rate=function, params=p, breakpoints=breakpoints)
    else:
        a = rng.uniform(0.5, 2.0, 3)
        scene = fa.Scene(inertia=a.sum() - a, torque=function, params=p, breakpoints=breakpoints)
    q0 = rng.normal(size=(bodies, 4))
    w0 = None if is_rate else rng.normal(size=(bodies, 3)) * 10.0 ** rng.uniform(-1.0, 0.3)
    tol = 10.0 ** rng.uniform(-10.0, -2.0)
    return Case(kind, scene, q0, w0, t0, t_end, tol, list(p[1 : 1 + breaks]))


def truth(case: Case, steps: int) -> Any:
    """The attitudes at the end, by rk8 or magnus8 with steps that end at the breakpoints.

    Between two of them the rate or torque is continued, so that the first and the last evaluation
    of a step see neither side's neighbour.
    """
    ends = [case.t0, *case.breaks, case.t0 + case.t_end]
    q, w = case.q0, case.w0
    size, begin, end = case.scene.packed(None).params[-3:]
    function = KINDS[case.kind][0]
    for first, last in pairwise(ends):
        middle = 0.5 * (first + last)
        p = (size, begin, end)
        if case.breaks and "ramp" not in case.kind and begin < middle < end:
            p = (size, -1e9, 1e9)
        elif case.breaks and not begin < middle < end:
            p = (size, 1e9, 2e9) if middle < begin else (size, -2e9, -1e9)
        n = steps * (8 if case.kind == "smooth pulse" else 1)
        what = {"rate": function} if w is None else {"torque": function}
        scene = fa.Scene(inertia=case.scene.inertia, params=p, **what)
        run = fa.propagate(
            scene, q, w, t0=first, dt=(last - first) / n, n_steps=n,
            method="magnus8" if w is None else "rk8",
        )  # fmt: skip
        q, w = run.q[-1], None if w is None else run.w[-1]
    return q


def outcome(case: Case, chosen: Any) -> tuple[str, float]:
    """Whether the promise was kept, and the share of it that the true error takes."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = fa.propagate(case.scene, case.q0, case.w0, **chosen.arguments)
    if caught or run.status.any():
        return "warned", 0.0
    fine, finer = truth(case, _STEPS // 2), truth(case, _STEPS)
    own = fa.angle_between(fine, finer).max()
    if own > _CONFIRMED * case.tol and own > _ROUNDED:
        return "unknown", float(own)
    error = float(fa.angle_between(run.q[-1], finer).max())
    # the instants of the saves are rounded, and so is the truth
    share = max(error - own - _ROUNDED, 0.0) / chosen.expected_error
    kept = share <= 1.001 and chosen.expected_error <= case.tol
    return "kept" if kept else "broken", share


def tried(case: Case, choose: Callable[..., Any], **options: Any) -> tuple[str, str, float]:
    """What ``recommend`` or ``per_body_steps`` does with one case."""
    try:
        chosen = choose(
            case.scene, case.q0, case.w0, t_end=case.t0 + case.t_end, t0=case.t0, tol=case.tol,
            **options,
        )  # fmt: skip
    except ValueError as refusal:
        if not str(refusal).startswith(("scene: ", "tol: ")):
            raise
        return case.kind, "refused", 0.0
    return case.kind, *outcome(case, chosen)


def advised(seed: int, number: int, *, declared: bool = False) -> tuple[str, str, float]:
    """What ``recommend`` does with a case."""
    case = draw(seed, number, 12, declared=declared)
    methods = ["rk4", "magnus8"] if case.w0 is None else ["rk4", "rk8"]
    return tried(case, fa.recommend, dtypes=["float64"], methods=methods)


def stepped(seed: int, number: int, *, declared: bool = False) -> tuple[str, str, float]:
    """What per-body steps do with a case."""
    case = draw(seed, number, 24, rates=False, declared=declared)
    method = ("rk8", "rk4", "rk9", "gbs16")[number // 5 % 4]
    return tried(case, fa.per_body_steps, method=method)


def table(name: str, found: list[tuple[str, str, float]]) -> list[str]:
    """A line a kind: cases, kept, refused, warned of, beyond the comparison, broken."""
    lines = []
    for kind in dict.fromkeys(kind for kind, *_ in found):
        own = [(result, share) for k, result, share in found if k == kind]
        counts = Counter(result for result, _ in own)
        worst = max((share for result, share in own if result in ("kept", "broken")), default=0.0)
        cells = [counts[x] for x in ("kept", "refused", "warned", "unknown", "broken")]
        lines.append(f"| {name} | {kind} | {' | '.join(map(str, cells))} | {worst:.2f} |")
    return lines


def report(scenes: int, runs: int, seed: int, seconds: float = float("inf")) -> list[str]:
    """Both tables, within a time."""
    lines = [
        "| advice | rate or torque | kept | refused | warned | unknown | broken | largest share |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    begin = perf_counter()
    parts = (
        ("recommend", advised, scenes, 0.2),
        ("recommend with breakpoints", partial(advised, declared=True), scenes, 0.5),
        ("per-body steps", stepped, runs, 0.7),
        ("per-body steps with breakpoints", partial(stepped, declared=True), runs, 1.0),
    )
    for name, trial, count, share in parts:
        found = []
        for number in range(count):
            if perf_counter() - begin > share * seconds:
                break
            found.append(trial(seed, number))
        lines += table(f"{name}, {len(found)} cases", found)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--scenes", type=int, default=8 if SMALL else 100)
    parser.add_argument("--runs", type=int, default=8 if SMALL else 130)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="at most")
    arguments = parser.parse_args()
    print(machine_line())
    print("\n".join(report(arguments.scenes, arguments.runs, arguments.seed, arguments.seconds)))


if __name__ == "__main__":
    main()
