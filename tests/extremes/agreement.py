"""Runs against themselves: half the step, and back; coordinates near their poles."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import fastatt as fa
from extremes.bodies import H, closed, conditioning, spins, truncation_of_body
from extremes.cases import (
    ONE,
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
from extremes.rates import CONES, N_STEPS, cone, rates

# agreement with itself


def told(ends: Sequence[Any], order: int, truth: Array, floor: Array) -> Outcome:
    """Error of the first of two runs as the second, of half the step, tells it."""
    estimate = angle(ends[0].q[-1], np.asarray(ends[1].q[-1], float)) / (1.0 - 0.5**order)
    true = angle(ends[0].q[-1], truth)
    return Outcome(np.abs(estimate - true), 0.4 * true + floor, ends[0].status | ends[1].status)


def doubling_rates(case: Case) -> Outcome:
    theta = single(min(0.4, 0.5 * case.record.limit(case.representation)))
    a = single(CONES)
    frequency = theta / (2.0 * np.sin(0.5 * a))
    q0 = mul(START, cone(a, 0.0 * a))
    scene = rates(a, frequency, np.zeros((len(a), 3)))
    ends = [propagate(case, scene, q0, dt=1.0 / k, n_steps=k * N_STEPS) for k in (1, 2)]
    floor = rounding(case, 2 * N_STEPS, N_STEPS * frequency)
    return told(ends, case.record.order, mul(START, cone(a, N_STEPS * frequency)), floor)


def doubling_bodies(case: Case) -> Outcome:
    order = case.record.order_of("free")
    h = 0.25 if order < 8 else 0.5
    inertia = np.tile(H, (4, 1))
    w0 = single(0.5 * spins(inertia[0])[:4])
    q0 = np.tile(START, (4, 1))
    scene = fa.Scene(inertia=inertia)
    ends = [propagate(case, scene, q0, w0, dt=h / k, n_steps=k * N_STEPS) for k in (1, 2)]
    q, _ = closed(inertia, q0, w0, h * N_STEPS)
    floor = rounding(case, 2 * N_STEPS, np.ones(4)) * conditioning(inertia, q0, w0, h * N_STEPS)
    return told(ends, order, q, floor)


def is_symmetric(record: fa.Method, scene: str) -> bool:
    """Whether a step of −h takes back one of h."""
    return scene in record.reversible


BACK = 200  # steps of 0.05 s and as many back


def reversal_rates(case: Case) -> Outcome:
    a, q0 = single(CONES), mul(START, cone(CONES, 0.0 * CONES))
    scene = rates(a, np.ones(3), np.zeros((3, 3)))
    out = propagate(case, scene, q0, dt=0.05, n_steps=BACK)
    back = propagate(case, scene, out.q[-1], dt=-0.05, n_steps=BACK, t0=0.05 * BACK)
    turn = 0.1 * np.sin(0.5 * a)
    step = 0.0 if is_symmetric(case.record, "rate") else truncation(case, turn)
    allowed = 2 * BACK * step + rounding(case, 2 * BACK, 2 * BACK * turn)
    return Outcome(angle(back.q[-1], q0), allowed, out.status | back.status)


def reversal_bodies(case: Case) -> Outcome:
    inertia = np.array([[2.0, 1.0, 2.0 / 3.0]])
    w0 = np.array([[math.cos(1.1), 0.0, math.sin(1.1)]]) / inertia
    q0, scene = ONE[None], fa.Scene(inertia=inertia)
    out = propagate(case, scene, q0, w0, dt=0.05, n_steps=BACK)
    back = propagate(case, scene, out.q[-1], out.w[-1], dt=-0.05, n_steps=BACK)
    turn = 0.05 * np.linalg.norm(w0, axis=1)
    symmetric = is_symmetric(case.record, "free")
    step = 0.0 if symmetric else truncation_of_body(case, inertia, w0, 0.05)
    error = np.maximum(angle(back.q[-1], q0), np.abs(back.w[-1] - w0).max(axis=1))
    allowed = 2 * BACK * step + rounding(case, 2 * BACK, 2 * BACK * turn)
    cond = conditioning(inertia, q0, w0, 0.05 * BACK)
    return Outcome(error, allowed * cond, out.status | back.status)


# coordinates at and near their poles


def passage(kind: str, distance: float, *, body: bool) -> Callable[[Case], Outcome]:
    """A constant rate whose coordinates start at a pole, or pass it so far away.

    Of a body it is that about the axis of its largest moment.
    """
    x, y, z = np.eye(3)
    start, w = {
        "at 0": (exp(0.4 * z), 0.01 * x),
        "at π": (mul(exp(math.pi * x), exp(0.4 * z)), 0.01 * x),
        "past 0": (mul(exp(distance * y), exp(0.32 * x)), -0.01 * x),
        "past 2π": (exp(3.0 * x + distance * y), 0.1 * x),
    }[kind]
    n = 64

    def run(case: Case) -> Outcome:
        rate, q0, options = single(w)[None], start[None], {"dt": 1.0, "n_steps": n, "save_every": 1}
        if body:
            scene = fa.Scene(inertia=np.array([[1.25, 1.0, 0.75]]))
            got = propagate(case, scene, q0, rate, **options)
        else:
            got = propagate(case, rates(np.zeros(1), np.zeros(1), rate), q0, **options)
        turn = np.linalg.norm(rate, axis=1)
        errors = angle(got.q[:, 0], mul(start, exp(got.t[:, None] * rate)))
        allowed = n * truncation(case, turn) + 1e3 * rounding(case, n, n * turn)
        return Outcome(np.max(errors)[None], allowed, got.status)

    return run
