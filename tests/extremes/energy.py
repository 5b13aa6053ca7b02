"""Energy over long runs of methods whose steps back undo their steps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

import fastatt as fa
from extremes.bodies import V, rolled
from extremes.cases import Array, Case, propagate
from fastatt.methods import Method

# energy over long runs


class Drift(NamedTuple):
    """Slope of the relative error of the energy, a step, with its standard error; largest error."""

    slope: float
    uncertainty: float
    largest: float


ENSEMBLE = 64


def ensemble() -> tuple[Array, Array, Array]:
    """Bodies of moments about (0.6, 0.8, 1) turning in all directions at 1 rad/s."""
    rng = np.random.default_rng(8)
    inertia = rolled(np.array(V) * rng.uniform(0.95, 1.05, (ENSEMBLE, 3)))
    w0 = rng.normal(size=(ENSEMBLE, 3))
    q0 = rng.normal(size=(ENSEMBLE, 4))
    return inertia, q0, w0 / np.linalg.norm(w0, axis=1, keepdims=True)


def slope(change: Array, at: Array) -> tuple[float, float]:
    """Mean slope of the columns of (S, N) over the times (S,), and its standard error."""
    centred = at - at.mean()
    slopes = centred @ change / (centred @ centred)
    return float(slopes.mean()), float(slopes.std(ddof=1) / math.sqrt(len(slopes)))


def energy(case: Case, n_steps: int, saves: int = 200, h: float = 0.1) -> Drift:
    """Of free bodies."""
    inertia, q0, w0 = ensemble()
    scene = fa.Scene(inertia=inertia)
    got = propagate(case, scene, q0, w0, dt=h, n_steps=n_steps, save_every=n_steps // saves)
    total = 0.5 * (inertia * got.w * got.w).sum(-1)
    change = (total - total[0]) / total[0]
    found = slope(change, got.t / h)
    return Drift(*found, float(np.abs(change).max()))


def keeps_energy(record: Method) -> bool:
    """Whether the energy of bodies swings about its value: of symmetric steps."""
    return not {"free", "torqued"}.isdisjoint(record.reversible)
