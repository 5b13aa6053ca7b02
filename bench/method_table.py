"""The tables of the page of methods, from the ``trade.csv`` that ``fastatt trade`` leaves.

python bench/method_table.py results/trade.csv coning samples    # the path, and the scenes
python bench/method_table.py                                     # that of gyro-logs.md
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

import fastatt as fa
from fastatt import METHODS
from fastatt.propagation.inspect_step import job_of
from fastatt.trade.ensembles import BODY_SCENES, SAMPLES, problem
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


def ladders(path: Path) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Rows on quaternions in float64, by method and input."""
    found: dict[tuple[str, str], list[dict[str, str]]] = {}
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            if (row["representation"], row["dtype"]) == ("quat", "float64"):
                found.setdefault((row["method"], row["input"]), []).append(row)
    return found


def at(ladder: list[dict[str, str]], dt: float) -> dict[str, str] | None:
    """The row of a step; that of the closed form, which has none, is its only one."""
    if len(ladder) == 1:
        return ladder[0]
    return next((r for r in ladder if abs(float(r["dt"]) - dt) < 1e-9), None)


def operations(name: str, source: str) -> int | None:
    """Floating-point operations of a step of one body; None without steps or at samples."""
    if source == SAMPLES or not METHODS[name].is_stepped:
        return None
    return job_of(problem(source, 2).ensemble.scene, name, "quat", "float64").operations


def main(path: Path, *scenes: str) -> None:
    """Print one line a method and input: error at two steps, speed at the smaller, summary once."""
    coarse, fine = STEPS
    print(
        f"| method | for | order | error, dt={coarse:g} s | error, dt={fine:g} s | M steps/s "
        "| operations a step | |"
    )
    print("| --- " * 8 + "|")
    summaries = {name: method.summary for name, method in METHODS.items()}
    for (name, source), ladder in ladders(path).items():
        if scenes and source not in scenes:
            continue
        method = METHODS[name]
        order = method.order_of(BODY_SCENES[source].kind) if source in BODY_SCENES else method.order
        first, last = at(ladder, coarse), at(ladder, fine)
        # a ladder may begin with smaller steps, or end with larger ones
        errors = [f"{float(x['error_median']):.1e}" if x else "" for x in (first, last)]
        last = last or ladder[-1]
        speed = int(last["n_steps"]) / float(last["seconds_per_body"])
        print(
            f"| `{name}` | {NAMES.get(source, source)} | {order or 'exact'} "
            f"| {errors[0]} | {errors[1]} | {speed / 1e6:.0f} "
            f"| {operations(name, source) or ''} | {summaries.pop(name, '')} |"
        )


def logs(n_logs: int = 60, seconds: float = 10.0, noise: float = 1e-3) -> None:
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
        main(Path(sys.argv[1]), *sys.argv[2:])
    else:
        logs()
