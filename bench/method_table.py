"""The tables of the page of methods: errors at two step sizes, speed and operations of a step.

python bench/method_table.py coning samples         # and free top torqued, two minutes
python bench/method_table.py                        # the table of gyro-logs.md
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection

import numpy as np

import fastatt as fa
from fastatt import METHODS
from fastatt.propagation.inspect_step import job_of
from fastatt.trade.ensembles import BODY_SCENES, SAMPLES, cases, problem, study
from fastatt.trade.measure import machine_line

# what the rows of an input are called
NAMES = {
    "coning": "rate function",
    "samples": "samples",
    "free": "free bodies",
    "top": "heavy tops",
    "torqued": "any torque",
}
STEPS = (0.2, 0.025)
BODIES, LOGS = (64, 2) if os.environ.get("FASTATT_SMOKE") else (4096, 60)


def operations(name: str, source: str) -> int | None:
    """Floating-point operations of a step of one body; None without steps or at samples."""
    if source == SAMPLES or not METHODS[name].is_stepped:
        return None
    return job_of(problem(source, 2).ensemble.scene, name, "quat", "float64").operations


def main(*sources: str, n_bodies: int = BODIES, methods: Collection[str] = METHODS) -> None:
    """Print one line a method and input: error at two steps, speed at the smaller, summary once."""
    coarse, fine = STEPS
    print(
        f"| method | for | order | error, dt={coarse:g} s | error, dt={fine:g} s | M steps/s "
        "| operations a step | |"
    )
    print("| --- " * 8 + "|")
    summaries = {name: method.summary for name, method in METHODS.items()}
    for source in sources:
        bodies = study(source, n_bodies)
        steps = [round(bodies.problem.duration / dt) for dt in STEPS]
        quats = [x for x in cases(source) if x.representation == "quat" and x.method in methods]
        rows = bodies.timed({case: bodies.rows(case, steps) for case in quats})
        for name in dict.fromkeys(row.method for row in rows):
            ladder = [row for row in rows if row.method == name]
            errors, last = [f"{row.error_median:.1e}" for row in ladder], ladder[-1]
            method, speed = METHODS[name], last.n_steps / last.seconds_per_body
            is_of_bodies = source in BODY_SCENES
            order = method.order_of(BODY_SCENES[source].kind) if is_of_bodies else method.order
            print(
                f"| `{name}` | {NAMES[source]} | {order or 'exact'} | {errors[0]} | {errors[-1]} "
                f"| {speed / 1e6:.0f} | {operations(name, source) or ''} "
                f"| {summaries.pop(name, '')} |"
            )


def logs(n_logs: int = LOGS, seconds: float = 10.0, noise: float = 1e-3) -> None:
    """Print mean and standard deviation, over logs, of the largest error of each method."""
    methods = ("previous", "trapezoid", "coning2", "picard")
    print(f"| motion, intervals | {' | '.join(methods)} |\n{'| --- ' * 5}|")
    r = np.random.default_rng(0)
    nearer = []
    for motion, low, high in (("slow", 0.3, 1.1), ("brisk", 1.0, 4.1)):
        for n in (200, 600, 2000):
            errors = np.empty((2, len(methods), n_logs))
            for k in range(n_logs):
                waves = zip(
                    r.uniform(0.0, 1.0, (3, 3)), r.uniform(low, high, (3, 3)),
                    r.uniform(0.0, 2.0 * np.pi, (3, 3)), strict=True,
                )  # fmt: skip
                t = np.linspace(0.0, seconds, 8 * n + 1)[:, None]
                rates = sum(a * np.sin(w * t + p) for a, w, p in waves)
                truth = fa.integrate_rates(rates, seconds / n / 8, method="picard")[::8]
                noisy = rates[::8] + r.normal(0.0, noise, (n + 1, 3))
                for i, samples in enumerate((rates[::8], noisy)):
                    for j, method in enumerate(methods):
                        q = fa.integrate_rates(samples, seconds / n, method=method)
                        errors[i, j, k] = fa.angle_between(q, truth).max()
            for kind, of_kind in zip(("clean", "noisy"), errors, strict=True):
                cells = (f"{x.mean():.1e} ± {x.std():.0e}" for x in of_kind)
                print(f"| {motion}, {n}, {kind} | {' | '.join(cells)} |")
            nearer.append(np.mean(errors[1, 3] < errors[1, 0]))
    print(f"\npicard is nearer than previous in {np.mean(nearer):.0%} of the noisy logs")


if __name__ == "__main__":
    if sys.argv[1:]:
        print(f"{machine_line()}\n")
        main(*sys.argv[1:])
    else:
        logs()
