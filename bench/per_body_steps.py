"""Per-body step sizes beside one step size for all: time at equal largest error.

``python bench/per_body_steps.py`` takes half a minute; spin rates are log-uniform over two decades.
"""

from __future__ import annotations

import os
from time import perf_counter

import numpy as np

import fastatt as fa

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
BODIES, REFERENCE = (200, 200) if SMALL else (20_000, 3000)
END = 20.0 if SMALL else 100.0


def problems():
    """Scene, initial values, method and tolerance by name."""
    chance = np.random.default_rng(1)
    q = chance.normal(size=(BODIES, 4))
    axes = chance.normal(size=(BODIES, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    spins = np.exp(chance.uniform(np.log(0.05), np.log(5.0), BODIES))[:, None]
    upright = np.tile([np.cos(0.3), np.sin(0.3), 0.0, 0.0], (BODIES, 1))
    top = fa.torques.HeavyTop((0.0, 0.0, 0.2), 1.0)
    orbit = fa.torques.GravityGradient(0.05)
    return {
        "free bodies": (fa.Scene(inertia=(2.0, 1.0, 2 / 3)), q, spins * axes, "rk4", 1e-5),
        "gravity gradient": (
            fa.Scene(inertia=(2.0, 1.5, 1.0), torque=orbit), q, spins * axes, "rk8", 1e-5,
        ),
        "heavy tops": (
            fa.Scene(inertia=(1.0, 1.0, 0.5), torque=top), upright, spins * (0, 0.1, 1), "rk8",
            1e-8,
        ),
    }  # fmt: skip


def shortest(run, rounds=2 if SMALL else 7):
    """Seconds of a call, and what it gives."""
    found, result = np.inf, run()
    for _ in range(rounds):
        begun = perf_counter()
        result = run()
        found = min(found, perf_counter() - begun)
    return found, result


def main():
    print("| bodies | method | steps | error | one dt, steps | error | times as long |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, (scene, q, w, method, tol) in problems().items():
        few = slice(REFERENCE)
        fine = {"dt": END / 8000, "n_steps": 8000, "method": "rk8", "compensated": True}
        truth = fa.propagate(scene, q[few], w[few], **fine).q

        def error_of(n, scene=scene, q=q, w=w, method=method, truth=truth, few=few):
            run = fa.propagate(scene, q[few], w[few], dt=END / n, n_steps=n, method=method)
            return fa.angle_between(run.q, truth).max()

        own = fa.per_body_steps(scene, q, w, t_end=END, tol=tol, method=method)
        seconds, run = shortest(
            lambda scene=scene, q=q, w=w, own=own: fa.propagate(scene, q, w, **own.arguments)
        )
        error = fa.angle_between(run.q[:, few], truth).max()
        n = int(own.n_steps.max())
        for _ in range(8):
            if 0.95 < (ratio := error_of(n) / error) < 1.05:
                break
            n = max(1, round(n * ratio ** (1.0 / fa.METHODS[method].order)))
        same, _ = shortest(
            lambda scene=scene, q=q, w=w, n=n, method=method: fa.propagate(
                scene, q, w, dt=END / n, n_steps=n, method=method
            )
        )
        print(
            f"| {name} | {method} | {own.n_steps.min()} to {own.n_steps.max()} | {error:.1e} | {n} "
            f"| {error_of(n):.1e} | {same / seconds:.1f} |"
        )


if __name__ == "__main__":
    main()
