"""What a choice of method rests on: samples of clean and noisy motions, and large steps of bodies.

python bench/choices.py       # both tables of the pages, some seconds
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator

import numpy as np

import fastatt as fa

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
LENGTHS = (200,) if SMALL else (200, 600, 2000)
BODIES = 20 if SMALL else 200
SPAN = 10.0  # s of a log
NOISE = 1e-3  # rad/s of each sample
STEP = 0.5  # s
SAMPLED = ("previous", "trapezoid", "coning2", "picard")
STEPPED = ("rk4", "rk8", "gbs16", "strang2", "kahan_li8", "dmv10")


def motions() -> dict[str, tuple[float, ...]]:
    """Frequencies, rad/s, of three sines an axis."""
    return {"slow": (0.3, 0.7, 1.1), "brisk": (1.0, 2.3, 4.1)}


def rates(frequencies: tuple[float, ...], t: np.ndarray) -> np.ndarray:
    """Smooth rates about all axes, rad/s, (n, 3)."""
    chance = np.random.default_rng(3)
    size, phase = chance.uniform(0.2, 1.0, (3, 3)), chance.uniform(0.0, 6.0, (3, 3))
    waves = np.sin(np.array(frequencies)[:, None] * t[:, None, None] + phase)
    return (size * waves).sum(axis=1)


def samples() -> Iterator[str]:
    """Largest error over logs of 10 s, rad, of clean samples and of noisy ones."""
    yield f"| motion, intervals | {' | '.join(SAMPLED)} |"
    yield "| --- " * (len(SAMPLED) + 1) + "|"
    fine = 20
    for name, frequencies in motions().items():
        for count in LENGTHS:
            t = np.linspace(0.0, SPAN, count + 1)
            dense = np.linspace(0.0, SPAN, fine * count + 1)
            known = fa.integrate_rates(rates(frequencies, dense), dense[1], method="picard")[::fine]
            clean = rates(frequencies, t)
            noise = np.random.default_rng(4).normal(0.0, NOISE, clean.shape)
            for kind, data in (("clean", clean), ("noisy", clean + noise)):
                errors = [
                    fa.angle_between(fa.integrate_rates(data, t[1], method=m), known).max()
                    for m in SAMPLED
                ]
                cells = " | ".join(f"{e:.0e}" for e in errors)
                yield f"| {name}, {count}, {kind} | {cells} |"


def large_steps() -> Iterator[str]:
    """Free bodies after 10 s in steps of 0.5 s: how many are flagged, errors of the others."""
    chance = np.random.default_rng(5)
    scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3))
    q0, w0 = chance.normal(size=(BODIES, 4)), chance.normal(size=(BODIES, 3))
    exact = fa.propagate(scene, q0, w0, dt=SPAN, n_steps=1, method="exact").q[-1]
    yield f"| method | flagged of {BODIES} | median error, rad | largest error, rad |"
    yield "| --- | --- | --- | --- |"
    for method in STEPPED:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fa.StepWarning)
            run = fa.propagate(scene, q0, w0, dt=STEP, n_steps=round(SPAN / STEP), method=method)
        error = fa.angle_between(run.q[-1], exact)[run.status == 0]
        yield (
            f"| `{method}` | {np.count_nonzero(run.status)} | {np.median(error):.0e} | "
            f"{error.max():.0e} |"
        )


def main() -> None:
    print("\n".join([*samples(), "", *large_steps()]))


if __name__ == "__main__":
    main()
