"""Given rates: constant ones, cones, initial quaternions of any length, many steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

import fastatt as fa
from extremes.cases import (
    START,
    Array,
    Case,
    Outcome,
    angle,
    exp,
    mul,
    propagate,
    rounding,
    single,
    truncation,
)


def rates(a: Array, frequency: Array, w: Array) -> fa.Scene:
    """Coning, or a constant rate which the scene does not know to be one."""
    c = np.zeros((len(w), 3, 3))
    c[:, 0] = w
    return fa.Scene(rate=fa.rates.Sum((fa.rates.Coning(a, frequency), fa.rates.Polynomial(c))))


AXES = single([[0.0, 0.0, 1.0], [2.0 / 3, -1.0 / 3, 2.0 / 3], [-0.6, 0.8, 0.0]])
CONES = np.array([0.5, 1.0, 2.0])
N_STEPS = 8


def constant(theta: float, *, known: bool = True) -> Callable[[Case], Outcome]:
    """A constant rate along three axes, as the model that says so or as another."""

    def run(case: Case) -> Outcome:
        w = AXES * theta if case.dtype == "float64" else single(AXES * theta)
        zero = np.zeros(len(w))
        scene = fa.Scene(rate=fa.rates.Constant(w)) if known else rates(zero, zero, w)
        q0 = np.tile(START, (len(w), 1))
        got = propagate(case, scene, q0, dt=1.0, n_steps=N_STEPS)
        turn = np.linalg.norm(w, axis=1)
        step = truncation(case, turn)
        if case.record.exact_for_constant:
            step = 0.0 * step
        allowed = N_STEPS * step + rounding(case, N_STEPS, N_STEPS * turn)
        return Outcome(angle(got.q[-1], mul(START, exp(N_STEPS * w))), allowed, got.status)

    return run


def cone(a: Array, phase: Array) -> Array:
    s = np.sin(0.5 * a)
    return np.stack([np.cos(0.5 * a), s * np.cos(phase), s * np.sin(phase), 0.0 * a], axis=-1)


def coning(theta: float, n_steps: int = N_STEPS, size: float = 1.0) -> Callable[[Case], Outcome]:
    """Cones whose half angles let them turn at half to twice the rate of the body.

    The initial quaternions are of any length, and their numbers may be subnormal.
    """

    def run(case: Case) -> Outcome:
        a, frequency = single(CONES), single(theta / (2.0 * np.sin(0.5 * CONES)))
        first = cone(a, 0.0 * a)
        q0 = size * mul(START, first)
        q0 = q0 if case.dtype == "float64" else single(q0)
        scene = rates(a, frequency, np.zeros((len(a), 3)))
        got = propagate(case, scene, q0, dt=1.0, n_steps=n_steps)
        unit = q0 / np.abs(q0).max(axis=-1, keepdims=True)
        unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
        base = mul(unit, first * (1.0, -1.0, -1.0, -1.0))
        end = mul(base, cone(a, n_steps * frequency))
        turn = frequency * 2.0 * np.sin(0.5 * a)
        allowed = n_steps * truncation(case, turn) + rounding(case, n_steps, n_steps * frequency)
        return Outcome(angle(got.q[-1], end), allowed, got.status)

    return run


THETAS: Mapping[str, float] = {
    "0": 0.0, "1e-300": 1e-300, "1e-12": 1e-12, "1e-3": 1e-3, "1": 1.0, "π−": math.pi - 1e-6,
    "π+": math.pi + 1e-6, "2π": 2.0 * math.pi, "100": 100.0, "1e6": 1e6,
}  # fmt: skip


# far from where time or angles are counted from


def clock(t0: float) -> Callable[[Case], Outcome]:
    """Cones with numbers of their own, not rounded to the state's precision, from t0 on."""

    def run(case: Case) -> Outcome:
        frequency = 0.1 / (2.0 * np.sin(0.5 * CONES))
        q0 = mul(START, cone(CONES, frequency * t0))
        scene = rates(CONES, frequency, np.zeros((len(CONES), 3)))
        got = propagate(case, scene, q0, dt=1.0, n_steps=N_STEPS, t0=t0)
        end = mul(START, cone(CONES, frequency * (t0 + N_STEPS)))
        # the time and each phase are rounded, those of the truth too
        phase = 4.0 * frequency * np.spacing(abs(t0) + N_STEPS)
        turned = N_STEPS * frequency
        step = truncation(case, np.full(len(CONES), 0.1))
        allowed = N_STEPS * step + rounding(case, N_STEPS, turned) + phase
        return Outcome(angle(got.q[-1], end), allowed, got.status)

    return run


def at_once(theta: float) -> Callable[[Case], Outcome]:
    """One step at a constant rate; of status 0 it is wrong by what 0.1 rad of rounding makes."""

    def run(case: Case) -> Outcome:
        w = single(AXES * theta)
        q0 = np.tile(START, (len(w), 1))
        got = propagate(case, fa.Scene(rate=fa.rates.Constant(w)), q0, dt=1.0, n_steps=1)
        turn = np.linalg.norm(w, axis=1)
        step = 0.0 * turn if case.record.exact_for_constant else truncation(case, turn)
        allowed = np.minimum(step + rounding(case, 1, turn), 0.3)
        return Outcome(angle(got.q[-1], mul(START, exp(w))), allowed, got.status)

    return run


# many steps


def long_rates(n_steps: int) -> Callable[[Case], Outcome]:
    def run(case: Case) -> Outcome:
        w = single(0.006 * AXES)
        q0 = np.tile(START, (len(w), 1))
        got = propagate(case, fa.Scene(rate=fa.rates.Constant(w)), q0, dt=1.0, n_steps=n_steps)
        turn = np.linalg.norm(w, axis=1)
        step = 0.0 * turn if case.record.exact_for_constant else truncation(case, turn)
        allowed = n_steps * step + rounding(case, n_steps, n_steps * turn)
        return Outcome(angle(got.q[-1], mul(START, exp(n_steps * w))), allowed, got.status)

    return run
