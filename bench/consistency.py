"""How consistent filters are from wide starts on: ``python bench/consistency.py``, half a minute.

Filters whose attitude is known to a deviation about each axis are given two directions by turns, 90
or 40 degrees apart, or attitudes. Each entry is the largest mean over them of the normalised
estimation error squared (NEES) after any of 20 updates, of which 6 are due: more says that the
errors are larger than the covariance tells.
"""

from __future__ import annotations

import argparse
import os
import warnings
from collections.abc import Callable

import numpy as np

import fastatt as fa
from fastatt import estimation as es

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
DEVIATIONS = (0.1, 0.2, 0.5, 0.7, 1.0)
TRUTH = np.array([0.5, -0.5, 0.5, 0.5])
BIAS = 1e-3
UPDATES = 20
NO_NOISE = {"angle_noise": 0.0, "bias_noise": 0.0}
Update = Callable[[es.MEKF | es.UKF, int, np.random.Generator], object]


def vectors(sigma: float, apart: float, *, as_function: bool = False) -> Update:
    def update(f: es.MEKF | es.UKF, k: int, rng: np.random.Generator) -> None:
        r = np.array([np.cos(apart * (k % 2)), np.sin(apart * (k % 2)), 0.0])
        seen = fa.quat_rotate_inverse(TRUTH, r) + rng.normal(0.0, sigma, (len(f.q), 3))
        if as_function:
            f.update(lambda q, y: fa.quat_rotate_inverse(q, r), seen, sigma**2 * np.eye(3))
        else:
            f.update_vector(seen, r, sigma)

    return update


def attitudes(*sigma: float) -> Update:
    def update(f: es.MEKF | es.UKF, k: int, rng: np.random.Generator) -> None:
        errors = np.array(sigma) * rng.normal(size=(len(f.q), 3))
        seen = fa.quat_multiply(TRUTH, fa.rotation_vector_to_quat(errors))
        f.update_attitude(seen, np.array(sigma))

    return update


RIGHT, OBLIQUE = np.pi / 2, np.radians(40.0)
CASES: dict[str, tuple[type, Update]] = {
    "MEKF, vectors of 1e-2 rad": (es.MEKF, vectors(1e-2, RIGHT)),
    "MEKF, vectors of 1e-2 rad, 40°": (es.MEKF, vectors(1e-2, OBLIQUE)),
    "MEKF, vectors of 1e-4 rad, 40°": (es.MEKF, vectors(1e-4, OBLIQUE)),
    "UKF, vectors of 1e-2 rad, 40°": (es.UKF, vectors(1e-2, OBLIQUE)),
    "MEKF, attitudes of 1e-3 and 1e-2 rad": (es.MEKF, attitudes(1e-3, 1e-3, 1e-2)),
    "`UKF.update`, vectors of 1e-2 rad": (es.UKF, vectors(1e-2, RIGHT, as_function=True)),
    "`UKF.update`, vectors of 1e-3 rad": (es.UKF, vectors(1e-3, RIGHT, as_function=True)),
}


def largest_nees(kind: type, update: Update, deviation: float, n: int) -> float:
    """Of n filters, the largest mean after any update."""
    rng = np.random.default_rng(0)
    errors, bias = rng.normal(0.0, deviation, (n, 3)), rng.normal(0.0, BIAS, (n, 3))
    start = fa.quat_multiply(TRUTH, fa.rotation_vector_to_quat(errors))
    P = np.diag([deviation**2] * 3 + [BIAS**2] * 3)
    f = kind(start, P, **NO_NOISE) if kind is es.MEKF else kind(start, np.zeros(3), P)
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of vectors from 0.7 rad on
        for k in range(UPDATES):
            update(f, k, rng)
            found.append(float(np.mean(f.nees(TRUTH, bias))))
    return max(found)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--filters", type=int, default=50 if SMALL else 5000)
    n = parser.parse_args().filters
    print("| start known to |", " | ".join(f"{x:g} rad" for x in DEVIATIONS), "|")
    print("| --- |" + " --- |" * len(DEVIATIONS))
    for name, (kind, update) in CASES.items():
        found = [largest_nees(kind, update, x, n) for x in DEVIATIONS]
        row = [f"{x:.1f}" if x < 10.0 else f"{float(f'{x:.2g}'):,.0f}" for x in found]
        print(f"| {name} |", " | ".join(row), "|")


if __name__ == "__main__":
    main()
