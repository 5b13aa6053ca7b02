"""Every method at the extremes: its error, or the status that says that there is no trusting it.

``python bench/extremes.py`` writes the tables to ``bench/EXTREMES.md``; ``--quick`` runs
quaternions in float64 alone, ``--long`` takes the energy over 10^7 steps. References are closed
forms. The rule that every cell is held to: a body with status 0 is right, to what the order of its
method, the rounding of its precision and the conditioning of its motion allow.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import multiprocessing
import os
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipj

import fastatt as fa

Array = NDArray[np.float64]
OUT = Path(__file__).with_name("EXTREMES.md")

# what a step may err by, rad a rad turned, where its status is 0: the word of the records' limits
PROMISE = 0.1
# a step rounds each number of the state, and each angle, a few times
ROUNDINGS = 16.0
# Error of a step, rad a rad turned, over measure^order: twice the worst below the limit of cones
# with half angles of 0.5, 1 and 2 rad, and of free bodies that can exist. The measure is the turn θ
# in a step, or what the method's limit is of; of splittings, whose limit is of g, it is
# (g² θ^(order−2))^(1/order).
OF_CONES = {
    "lie_euler": 2.0, "lie_midpoint": 0.4, "rk4": 0.035, "magnus4": 0.035, "magnus6": 4e-3,
    "cf4": 0.011, "rkmk4": 0.023, "cg3": 0.11,
}  # fmt: skip
OF_BODIES = {
    "rk4": 0.017, "cf4": 0.017, "rkmk4": 0.017, "rk8": 4e-7, "strang2": 0.33, "suzuki4": 0.014,
    "kahan_li6": 7e-4, "kahan_li8": 1.1e-5, "dmv2": 0.44, "dmv4": 0.021, "dmv6": 6e-4,
    "dmv8": 3e-6, "dmv10": 4e-8,
}  # fmt: skip
OF_PENDULA = {
    "rk4": 3e-4, "cf4": 3e-4, "rkmk4": 3e-4, "rk8": 1.2e-8, "strang2": 1.5e-3, "suzuki4": 4e-5,
    "kahan_li6": 2e-6, "kahan_li8": 8e-9, "srkn4": 1.2e-7, "srkn6": 2e-9,
}  # fmt: skip
# a matrix turns by the angle, a quaternion by half of it
OF_PENDULA_IN_MATRICES = {"rk8": 2.8e-7}
OF_RATES = {
    "hold": 2.0, "trapezoid": 0.8, "previous": 0.5, "coning2": 6.0, "coning3": 3.0,
    "picard": 500.0,
}  # fmt: skip
OF_INCREMENTS = {
    "hold": 0.3, "previous": 0.07, "coning2": 0.8, "coning3": 3.0, "coning3_optimal": 3.0,
    "picard": 130.0,
}  # fmt: skip
ANGLES = ("euler313", "rotation_vector")
# the same of coordinates, whose own speed has to stay below their limit
ANGLES_PROMISE = 1e-3
START = np.array([0.6, 0.5, -0.4, 0.48]) / np.linalg.norm([0.6, 0.5, -0.4, 0.48])
ONE = np.array([1.0, 0.0, 0.0, 0.0])


class Case(NamedTuple):
    """A row: a method on a representation in a precision."""

    method: str
    representation: str = "quat"
    dtype: str = "float64"

    @property
    def record(self) -> fa.Method:
        return fa.METHODS[self.method]

    @property
    def eps(self) -> float:
        return float(np.finfo(self.dtype).eps)

    @property
    def work(self) -> int:
        """Times that a step touches the state: stages, or terms of a series."""
        record = self.record
        return max(record.rate_calls, len(record.stages), record.order // 2, 2)


class Outcome(NamedTuple):
    """Error of each body of a cell and what it may be, rad, and status, each (N,)."""

    error: Array
    allowed: Array
    status: NDArray[np.uint8]

    @property
    def wrong(self) -> NDArray[np.bool_]:
        """Bodies whose status is 0 and whose error is more than can be explained."""
        return (self.status == 0) & ~(self.error <= self.allowed)

    @property
    def text(self) -> str:
        """The worst error of status 0 and the names of all flags."""
        parts = []
        fine = self.status == 0
        if fine.any():
            worst = float(np.max(self.error[fine]))
            parts.append(f"{worst:.0e}" if worst else "0")
        every = int(np.bitwise_or.reduce(self.status))
        parts += [flag.name for flag in fa.Status if flag and every & flag]
        return " ".join(parts) + (" **wrong**" if self.wrong.any() else "")


class Column(NamedTuple):
    """An extreme, and which cases it is for."""

    name: str
    run: Callable[[Case], Outcome]
    fits: Callable[[Case], bool] = lambda case: True


class Table(NamedTuple):
    """Extremes side by side, for the methods of one kind of scene."""

    title: str
    text: str
    scene: str
    columns: Sequence[Column]


# quaternions


def mul(p: Array, q: Array) -> Array:
    return np.asarray(fa.quat_multiply(p, q))


def exp(u: Array) -> Array:
    return np.asarray(fa.rotation_vector_to_quat(u))


def angle(p: Array, q: Array) -> Array:
    """Angle between attitudes, rad; of what is no attitude NaN."""
    p = np.asarray(p, dtype=float)
    bad = ~np.isfinite(p).all(axis=-1) | ~(np.abs(np.linalg.norm(p, axis=-1) - 1.0) < 1e-3)
    safe = np.where(bad[..., None], ONE, p)
    return np.where(bad, np.nan, fa.angle_between(safe, q))


# what is allowed


def share(coefficients: Mapping[str, float], method: str, order: int, grows: Array) -> Array:
    """Error, rad a rad turned, that a step of status 0 may have: at most the limits' promise."""
    # the closed form is of order 0 and makes no steps
    power = np.minimum(grows, 10.0) ** order if order else 0.0 * grows
    return np.asarray(np.minimum(PROMISE, coefficients.get(method, 1e9) * power))


def truncation(case: Case, theta: Array) -> Array:
    """Error that a step at a given rate may have, rad, where the body turns by theta rad."""
    if case.representation in ANGLES:
        return np.full_like(theta, ANGLES_PROMISE * case.record.limit(case.representation))
    return theta * share(OF_CONES, case.method, case.record.order, theta)


def truncation_of_body(case: Case, inertia: Array, w: Array, h: float) -> Array:
    """The same of a free body's step, rad or |Δm|/|m|."""
    theta = abs(h) * np.linalg.norm(w, axis=-1)
    if case.representation in ANGLES:
        return np.full_like(theta, ANGLES_PROMISE * case.record.limit(case.representation))
    order = case.record.order_of("free")
    grows = measured(case, inertia, w, h)
    if case.record.sorted_axes:
        # a commutator has both rotors' angles; the others of its factors may be either's
        grows = (grows**2 * turn_of_body(inertia, w, h) ** (order - 2)) ** (1.0 / order)
    return theta * share(OF_BODIES, case.method, order, grows)


def rounding(case: Case, n_steps: int, turned: Array) -> Array:
    """Round-off of a run that turns by so many rad in all."""
    return np.asarray(ROUNDINGS * case.eps * (n_steps * case.work + turned))


def propagate(
    case: Case, scene: fa.Scene, q0: Array, w0: Array | None = None, **options: Any
) -> Any:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return fa.propagate(
            scene, q0, w0, method=case.method, representation=case.representation,
            dtype=case.dtype, n_threads=1, invalid="flag", **options,
        )  # fmt: skip


# given rates


def single(x: Any) -> Array:
    """Numbers that both precisions hold."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(x, dtype=np.float32).astype(float)


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


def as_it_is(case: Case, q0: Array) -> Array:
    return q0


def times(factor: float) -> Callable[[Case, Array], Array]:
    return lambda case, q0: factor * q0


def least(case: Case, q0: Array) -> Array:
    """Another attitude, of the smallest numbers that there are."""
    smallest = float(np.finfo(case.dtype).smallest_subnormal)
    return np.tile(np.array([3.0, 1.0, -2.0, 1.0]) * smallest, (len(q0), 1))


def coning(
    theta: float,
    given: Callable[[Case, Array], Array] = as_it_is,
    n_steps: int = N_STEPS,
) -> Callable[[Case], Outcome]:
    """Cones whose half angles let them turn at half to twice the rate of the body.

    ``given`` makes of the initial quaternions others, of any length.
    """

    def run(case: Case) -> Outcome:
        a, frequency = single(CONES), single(theta / (2.0 * np.sin(0.5 * CONES)))
        q0 = given(case, mul(START, cone(a, 0.0 * a)))
        scene = rates(a, frequency, np.zeros((len(a), 3)))
        got = propagate(case, scene, q0, dt=1.0, n_steps=n_steps)
        unit = q0 / np.abs(q0).max(axis=-1, keepdims=True)
        unit /= np.linalg.norm(unit, axis=-1, keepdims=True)
        first = mul(unit, cone(a, 0.0 * a) * (1.0, -1.0, -1.0, -1.0))
        end = mul(first, cone(a, n_steps * frequency))
        turn = frequency * 2.0 * np.sin(0.5 * a)
        allowed = n_steps * truncation(case, turn) + rounding(case, n_steps, n_steps * frequency)
        return Outcome(angle(got.q[-1], end), allowed, got.status)

    return run


THETAS: Mapping[str, float] = {
    "0": 0.0, "1e-300": 1e-300, "1e-12": 1e-12, "1e-3": 1e-3, "1": 1.0, "π−": math.pi - 1e-6,
    "π+": math.pi + 1e-6, "2π": 2.0 * math.pi, "100": 100.0, "1e6": 1e6,
}  # fmt: skip


# free bodies

V = (0.6, 0.8, 1.0)
H = (2.0, 1.0, 0.625)  # of the literature's body, numbers that both precisions hold
SHAPES: Mapping[str, tuple[float, float, float]] = {
    "V": V,
    "rod 1e-3": (1e-3, 1.0, 1.0),
    "needle 1e3": (1.0, 1e3, 1000.5),
    "needle 1e6": (1.0, 1e6, 1000000.5),
    "rod 1e6": (1.0, 1e6, 1e6),
    "disc": (1.0, 1.0, 2.0),
    "disc ±2 %": (0.5, 0.52, 1.0),
    "1+1e-6": (1.0, 1.0 + 2.0**-20, 1.0 + 2.0**-19),
    "1, 2, 2.9": (1.0, 2.0, 2.9),
    "1, 1e6, 2e6": (1.0, 1e6, 2e6),
    "1, 2, 1e6": (1.0, 2.0, 1e6),
}
BODY_STEPS = 16


def spins(inertia: Array) -> Array:
    """Rates of size 1: random ones, random momenta, and turning about each axis, (11, 3)."""
    rng = np.random.default_rng(4)
    w = np.vstack([rng.normal(size=(4, 3)), rng.normal(size=(4, 3)) / inertia, np.eye(3)])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


def rolled(rows: Array) -> Array:
    """Rows whose axes are the first in turn: what a method does to the order of axes shows."""
    return np.take_along_axis(rows, (np.arange(3) + np.arange(len(rows))[:, None]) % 3, axis=1)


def asymmetry(inertia: Array, m: Array, h: float) -> Array:
    """|m|h times the geometric mean of both rotors' 1/I: what a splitting errs by, 0 if exact."""
    low, middle, high = np.sort(inertia, axis=-1).T
    size = np.linalg.norm(m, axis=-1)
    return np.asarray(
        abs(h) * size * np.sqrt((1.0 / low - 1.0 / middle) * (1.0 / middle - 1.0 / high))
    )


def turn_of_body(inertia: Array, w: Array, h: float) -> Array:
    """Turn in a step, rad: Euler's equations of what can't exist turn faster than the body does."""
    apart = np.abs(np.roll(inertia, 1, axis=-1) - np.roll(inertia, -1, axis=-1)) / inertia
    return np.asarray(abs(h) * np.linalg.norm(w, axis=-1) * np.maximum(1.0, apart.max(axis=-1)))


def measured(case: Case, inertia: Array, w: Array, h: float) -> Array:
    """What the error of a step of a free body grows with."""
    m = inertia * w
    if case.record.sorted_axes:
        return asymmetry(inertia, m, h)
    if case.method.startswith("dmv"):
        return np.asarray(abs(h) * np.linalg.norm(m, axis=-1) / np.abs(inertia).min(axis=-1))
    return turn_of_body(inertia, w, h)


def closed(inertia: Array, q0: Array, w0: Array, t: float) -> tuple[Array, Array]:
    q, w = fa.exact.free_body(q0, w0, inertia, t, allow_unphysical=True)
    return q, w


def conditioning(inertia: Array, q0: Array, w0: Array, t: float) -> Array:
    """How many times a change of the momentum, relative, is found in the state after t s."""
    most = np.ones(len(w0))
    size = 1e-7
    m = inertia * w0
    length = np.linalg.norm(m, axis=1, keepdims=True)
    for at in (0.5 * t, t):
        q, w = closed(inertia, q0, w0, at)
        for direction in np.eye(3):
            p, v = closed(inertia, q0, (m + size * length * direction) / inertia, at)
            apart = np.maximum(
                angle(p, q), np.linalg.norm(inertia * (v - w), axis=1) / length[:, 0]
            )
            with np.errstate(invalid="ignore"):
                most = np.fmax(most, 1.0 + apart / size)
    return most


def invariants_lost(inertia: Array, q0: Array, w0: Array, q: Array, w: Array) -> Array:
    """Largest relative change of the momentum in space and of the energy."""

    def kept(q: Array, w: Array) -> tuple[Array, Array]:
        in_space = np.einsum("nij,nj->ni", fa.quat_to_dcm(q), inertia * w)
        return in_space, 0.5 * (inertia * w * w).sum(axis=-1)

    (before, energy), (after, work) = kept(q0, w0), kept(q, w)
    size = above_zero(np.linalg.norm(before, axis=1))
    energy = above_zero(energy)
    # dT = w·dm: a needle's energy is in the least of its momenta
    ratio = 1.0 + np.linalg.norm(w0, axis=1) * size / energy
    off = np.abs(work / energy - 1.0) / ratio
    return np.maximum(np.linalg.norm(after - before, axis=1) / size, off)


def above_zero(x: Array) -> Array:
    return np.where(x > 0.0, x, 1.0)


def free(inertia: Any, w0: Array, h: float, n_steps: int) -> Callable[[Case], Outcome]:
    """Free bodies against the closed form; where rounding alone decides, their invariants."""

    def run(case: Case) -> Outcome:
        rows = rolled(single(np.broadcast_to(inertia, w0.shape)))
        w = rolled(w0 if case.dtype == "float64" else single(w0))
        q0 = np.tile(START, (len(w), 1))
        scene = fa.Scene(inertia=rows, allow_unphysical=True)
        got = propagate(case, scene, q0, w, dt=h, n_steps=n_steps)
        return compare(case, rows, q0, w, h, n_steps, got)

    return run


def compare(
    case: Case, inertia: Array, q0: Array, w0: Array, h: float, n_steps: int, got: Any
) -> Outcome:
    size = above_zero(np.linalg.norm(inertia * w0, axis=1))
    turn = abs(h) * np.linalg.norm(w0, axis=1)
    step = truncation_of_body(case, inertia, w0, h)
    work = rounding(case, n_steps, n_steps * turn)
    q, w = closed(inertia, q0, w0, n_steps * h)
    end_q, end_w = np.asarray(got.q[-1], float), np.asarray(got.w[-1], float)
    with np.errstate(all="ignore"):
        grown = conditioning(inertia, q0, w0, n_steps * h)
        allowed = step * (1.0 + (n_steps - 1) * grown) + work * grown
        error = np.maximum(angle(end_q, q), np.linalg.norm(inertia * (end_w - w), axis=1) / size)
        lost = invariants_lost(inertia, q0, w0, end_q, end_w)
    chaotic = allowed > 1.0
    error = np.where(chaotic, lost, error)
    return Outcome(error, np.where(chaotic, n_steps * step + work, allowed), got.status)


def shape(name: str, theta: float = 0.1) -> Column:
    inertia = np.array(SHAPES[name])
    return Column(name, free(inertia, theta * spins(inertia), 1.0, BODY_STEPS))


def turning(name: str, theta: float) -> Column:
    return Column(name, free(np.array(V), theta * spins(np.array(V)), 1.0, BODY_STEPS))


def about_intermediate(perturbation: float) -> Column:
    """Body H about its intermediate axis, perturbed along both others, 20 s."""
    sides = np.array([[1, 0], [0, 1], [1, 1], [-1, 1]]) * perturbation
    m = np.column_stack([sides[:, 0], np.ones(4), sides[:, 1]])
    m /= np.linalg.norm(m, axis=1, keepdims=True)
    return Column(f"{perturbation:g}", free(np.array(H), m / H, 0.05, 400))


def scaled(name: str, factor: float) -> Column:
    """Inertia in other units: bit for bit by a power of two, else to round-off."""

    def run(case: Case) -> Outcome:
        inertia = single(V)
        w = single(0.1 * spins(inertia))
        q0 = np.tile(START, (len(w), 1))
        ends = []
        for s in (1.0, factor):
            scene = fa.Scene(inertia=np.tile(inertia * s, (len(w), 1)))
            ends.append(propagate(case, scene, q0, w, dt=1.0, n_steps=BODY_STEPS))
        a, b = ends
        gap = np.abs(a.q[-1] - b.q[-1]).max(axis=-1) + np.abs(a.w[-1] - b.w[-1]).max(axis=-1) / 0.1
        exact = math.frexp(factor)[0] == 0.5
        cond = conditioning(np.tile(inertia, (len(w), 1)), q0, w, float(BODY_STEPS))
        work = rounding(case, BODY_STEPS, 0.1 * BODY_STEPS * cond)
        allowed = cond * (0.0 if exact else work)
        return Outcome(gap.astype(float), allowed, b.status)

    return Column(name, run)


# damping and weights

TORQUED_STEPS = 32


def torqued(inertia: Array, drag: Array | None, weight: Array, arm: Array) -> fa.Scene:
    """Gravity gradient, weight and, if not None, damping: one type of scene, zeros switch off."""
    n = len(inertia)
    terms: tuple[Any, ...] = (
        fa.torques.GravityGradient(np.zeros(n)),
        fa.torques.HeavyTop(arm, weight),
    )
    if drag is not None:
        terms = (*terms, fa.torques.Damping(drag))
    return fa.Scene(inertia=inertia, torque=fa.torques.Sum(terms))


def takes(case: Case, damped: bool) -> bool:
    record = case.record
    return "torqued" in record.scenes and (not damped or record.takes != fa.torques.POSITION)


def damping(x: float) -> Column:
    """Bodies turning about a principal axis, or spheres about any: w decays as exp(−ct/I)."""
    inertia = np.array([[1.0, 2.0, 2.5], [2.0, 1.0, 2.5], [1.0, 2.0, 2.5], [1.0, 1.0, 1.0]])
    theta = 0.0625
    w0 = theta * np.vstack([np.eye(3), AXES[1:2]])
    moment = np.array([1.0, 1.0, 2.5, 1.0])

    def run(case: Case) -> Outcome:
        drag = single(x * inertia.min(axis=1))
        w = single(w0)
        n = len(w)
        scene = torqued(inertia, drag, np.zeros(n), np.zeros((n, 3)))
        rate = drag / moment
        q0 = np.tile(START, (n, 1))
        error = np.zeros(n)
        got = propagate(case, scene, q0, w, dt=1.0, n_steps=TORQUED_STEPS, save_every=1)
        for s, t in enumerate(got.t):
            left = np.exp(-rate * t)[:, None]
            turned = w * -np.expm1(-rate * t)[:, None] / rate[:, None]
            size = np.linalg.norm(w, axis=1)
            off = np.linalg.norm(np.asarray(got.w[s], float) - left * w, axis=1) / size
            off = np.maximum(off, angle(got.q[s], mul(q0, exp(turned))) / size)
            error = np.maximum(error, off)  # NaN stays
        order = case.record.order
        step = np.minimum(PROMISE, np.minimum(rate, 10.0) ** order / math.factorial(order))
        own = rounding(case, TORQUED_STEPS, np.zeros(n)) / theta
        allowed = step / -np.expm1(-rate) + own
        return Outcome(error, allowed, got.status)

    return Column(f"{x:g}", run, lambda case: takes(case, True))


def pendulum(x: float) -> Column:
    """A weight that swings 90° to each side, frequency times step x: Jacobi's functions."""
    inertia = np.array([[0.6, 0.8, 1.0], [0.6, 1.0, 0.8], [1.0, 0.6, 0.8], [0.8, 1.0, 0.6]])
    # of the swing, that of the least or largest moment; the weight hangs along −e3
    axis = np.array([0, 1, 0, 1])
    k = math.sin(math.radians(45.0))

    def run(case: Case) -> Outcome:
        rows = single(inertia)
        n = len(rows)
        moment = rows[np.arange(n), axis]
        arm = np.tile([0.0, 0.0, -1.0], (n, 1))
        weight = single(moment * x * x)
        frequency = np.sqrt(weight / moment)
        w0 = np.zeros((n, 3))
        w0[np.arange(n), axis] = single(2.0 * k * frequency)
        modulus = w0[np.arange(n), axis] / (2.0 * frequency)
        damped = None if case.record.takes == fa.torques.POSITION else np.zeros(n)
        scene = torqued(rows, damped, weight, arm)
        q0 = np.tile(ONE, (n, 1))
        error, turn = np.zeros(n), np.abs(w0).max(axis=1)
        got = propagate(case, scene, q0, w0, dt=1.0, n_steps=TORQUED_STEPS, save_every=1)
        for s, t in enumerate(got.t):
            sn, cn, dn, _ = ellipj(frequency * t, modulus**2)
            half = np.arctan2(modulus * sn, dn)
            turned = np.zeros((n, 3))
            turned[np.arange(n), axis] = 2.0 * half
            speed = np.zeros((n, 3))
            speed[np.arange(n), axis] = 2.0 * modulus * frequency * cn
            off = np.linalg.norm(np.asarray(got.w[s], float) - speed, axis=1) / turn
            error = np.maximum(error, np.maximum(off, angle(got.q[s], exp(turned))))
        known = OF_PENDULA
        if case.representation.startswith("dcm"):
            known = OF_PENDULA | OF_PENDULA_IN_MATRICES
        step = share(known, case.method, case.record.order_of("torqued"), turn)
        # an error of the frequency grows with time: the phase's with its square
        along = 1.0 + TORQUED_STEPS * frequency
        own = rounding(case, TORQUED_STEPS, TORQUED_STEPS * turn)
        allowed = along * (TORQUED_STEPS * step + own)
        return Outcome(error, allowed, got.status)

    return Column(f"{x:g}", run, lambda case: takes(case, False))


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
    if scene == "rate":
        return "reversible" in record.summary
    return is_symplectic(record)


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


# samples

SAMPLES = 6


def coning_log(
    a: float, frequency: float, h: float, n: int, *, increments: bool
) -> tuple[Array, Array, Array, float]:
    """Samples of a cone, its first attitude, all attitudes, and the interval."""
    p = frequency * h * np.arange(n + 1.0)
    size, axial = math.sin(a), -2.0 * math.sin(0.5 * a) ** 2
    if increments:
        middle, half = 0.5 * (p[:-1] + p[1:]), 0.5 * frequency * h
        chord = 2.0 * size * math.sin(half)
        data = np.stack(
            [-chord * np.sin(middle), chord * np.cos(middle), np.full(n, axial * 2.0 * half)],
            axis=1,
        )
    else:
        data = frequency * np.stack(
            [-size * np.sin(p), size * np.cos(p), np.full(n + 1, axial)], axis=1
        )
    first = mul(START, cone(np.array(a), np.array(0.0)))
    return data, first, mul(START, cone(np.full(n + 1, a), p)), h


def sampled(theta: float, a: float, *, increments: bool) -> Callable[[Case], Outcome]:
    """A cone, or with a = 0 a constant rate, sampled once a turn of theta rad."""

    def run(case: Case) -> Outcome:
        n = SAMPLES
        if a:
            frequency = theta / (2.0 * math.sin(0.5 * a))
            data, first, truth, _ = coning_log(a, frequency, 1.0, n, increments=increments)
        else:
            frequency = theta
            data = np.tile(theta * AXES[1], (n if increments else n + 1, 1))
            first = START
            truth = mul(START, exp(np.arange(n + 1.0)[:, None] * data[0]))
        q = np.full((n + 1, 4), np.nan)
        with warnings.catch_warnings(record=True) as heard, contextlib.suppress(ValueError):
            warnings.simplefilter("always")
            q = fa.integrate_rates(
                data, 1.0, first, method=case.method, increments=increments, dtype=case.dtype,
                n_threads=1,
            )  # fmt: skip
        refused = not np.isfinite(q).all()  # angles that float32 does not hold
        said = refused or any(issubclass(w.category, UserWarning) for w in heard)
        order = case.record.order_of("increments" if increments else "sampled rates")
        known = OF_INCREMENTS if increments else OF_RATES
        iterated = case.method == "picard"  # the others are exact
        step = share(known, case.method, order, np.array(theta)) if a or iterated else 0.0
        allowed = n * theta * step + rounding(case, 12 * n, n * max(theta, frequency))
        error = np.max(angle(q, truth))
        status = np.uint8(fa.Status.STEP_TOO_LARGE if said else 0)
        return Outcome(error[None], allowed[None], status[None])

    return run


# the tables


def scales() -> list[Column]:
    def column(factor: float) -> Column:
        fits_single = 1e-30 <= factor <= 1e30
        return Column(
            f"{factor:g}",
            coning(0.1, times(factor)),
            lambda case: fits_single or case.dtype == "float64",
        )

    factors = (1e200, 1e-200, 1e300, 1e-300, 1e30, 1e-30, 2.5)
    return [*map(column, factors), Column("least", coning(0.1, least))]


def has_order(case: Case) -> bool:
    """Whether half the step tells the error: not of angles near a pole, nor of the closed form."""
    return case.representation not in ANGLES and case.record.order > 0


def poles(*, body: bool) -> list[Column]:
    def column(name: str, kind: str, distance: float, representation: str) -> Column:
        return Column(
            name,
            passage(kind, distance, body=body),
            lambda case: case.representation == representation,
        )

    euler, vector = ANGLES
    return [
        column("3-1-3 at 0", "at 0", 0.0, euler),
        column("at π", "at π", 0.0, euler),
        *[column(f"past 0 by {d:g}", "past 0", d, euler) for d in (0.1, 1e-3, 0.0)],
        *[column(f"2π by {d:g}", "past 2π", d, vector) for d in (0.5, 1e-3, 0.0)],
    ]


TABLES = (
    Table(
        "A constant rate",
        "Columns: |w|h, rad a step; 8 steps along three axes. Error, rad.",
        "rate",
        [Column(name, constant(theta)) for name, theta in THETAS.items()],
    ),
    Table(
        "Coning",
        "Columns: |w|h; 8 steps on cones with half angles of 0.5, 1 and 2 rad. Error, rad.",
        "rate",
        [Column(name, coning(theta)) for name, theta in THETAS.items()],
    ),
    Table(
        "Initial quaternions",
        "Columns: length of q0, least: of subnormal numbers; cones at |w|h = 0.1. Error, rad.",
        "rate",
        scales(),
    ),
    Table(
        "Free bodies of all shapes",
        "Columns: principal moments, V is (0.6, 0.8, 1), the last two can't exist; 16 steps of "
        "|w|h = 0.1 in 11 directions, axes in three orders. Error: angle, rad, or |Δm|/|m|.",
        "free",
        [shape(name) for name in SHAPES],
    ),
    Table(
        "A free body's step",
        "Columns: |w|h of body V in 11 directions, 16 steps. Error: angle, rad, or |Δm|/|m|; where "
        "rounding alone would lose the trajectory, energy or momentum, relative.",
        "free",
        [turning(name, theta) for name, theta in THETAS.items()],
    ),
    Table(
        "About the intermediate axis",
        "Columns: perturbation of the momentum, 1 N·m·s, of moments (2, 1, 0.625) kg·m², 400 steps "
        "of 0.05 s. Error as above.",
        "free",
        [about_intermediate(x) for x in (1.0, 1e-4, 1e-8, 1e-16, 0.0)],
    ),
    Table(
        "Units of inertia",
        "Columns: factor. Change of the result, of powers of two 0.",
        "free",
        [
            scaled("1e-12", 1e-12),
            scaled("1e12", 1e12),
            scaled("2^-40", 2.0**-40),
            scaled("2^40", 2.0**40),
        ],
    ),
    Table(
        "Damping",
        "Columns: c h/I_min; 32 steps of |w|h = 0.0625, w exp(−ct/I) exactly. Error over the "
        "initial |w|, or over the turn of the first step.",
        "torqued",
        [damping(x) for x in (0.1, 1.0, 2.5, 3.0, 10.0, 100.0, 1000.0)],
    ),
    Table(
        "A weight on a pendulum",
        "Columns: frequency times step; 32 steps, 90° to each side. Error, rad, or of w, relative.",
        "torqued",
        [pendulum(x) for x in (1e-6, 1e-3, 0.1, 0.3, 1.0, 3.0, 10.0)],
    ),
    *(
        Table(
            f"Poles, {'free bodies' if body else 'given rates'}",
            "3-1-3 angles that start at a nutation of 0 and π or pass 0 so far away, rad; rotation "
            "vectors that pass 2π. 64 steps. Error, rad.",
            "free" if body else "rate",
            poles(body=body),
        )
        for body in (False, True)
    ),
    *(
        Table(
            f"Agreement with itself, {name}",
            "Half the step: error as a run of half the step tells it, less the true one, rad. "
            "Reversal: 200 steps of 0.05 s and back, rad.",
            scene,
            [Column("half the step", half, has_order), Column("reversal", back)],
        )
        for name, scene, half, back in (
            ("coning", "rate", doubling_rates, reversal_rates),
            ("free bodies", "free", doubling_bodies, reversal_bodies),
        )
    ),
    Table(
        "Many steps, constant rate",
        "Columns: steps of 0.006 rad. Error, rad.",
        "rate",
        [Column("1e4", long_rates(10_000)), Column("1e6", long_rates(1_000_000))],
    ),
    Table(
        "Many steps, free body",
        "Columns: steps of 0.01 rad of body V. Error as above.",
        "free",
        [
            Column(
                f"{n:.0e}".replace("e+0", "e"),
                free(np.array(V), 0.01 * spins(np.array(V))[:4], 1.0, n),
            )
            for n in (10_000, 1_000_000)
        ],
    ),
    *(
        Table(
            f"Sampled {'increments' if increments else 'rates'}, {name}",
            "Columns: |w|h between samples; 6 intervals. Error, rad. A log has no status: "
            "STEP_TOO_LARGE stands for a warning, or for a refusal.",
            "increments" if increments else "sampled rates",
            [Column(k, sampled(theta, a, increments=increments)) for k, theta in THETAS.items()],
        )
        for increments in (False, True)
        for name, a in (("constant", 0.0), ("coning", 1.0))
    ),
)


def cases(*, quick: bool = False) -> list[Case]:
    """All rows there are."""
    return [
        Case(m.name, r, d)
        for m in fa.METHODS.values()
        for r in (m.representations[:1] if quick else m.representations)
        for d in (("float64",) if quick else ("float64", "float32"))
    ]


def row(case: Case) -> dict[tuple[str, str], Outcome]:
    """All cells of a row, by table and column."""
    return {
        (table.title, column.name): column.run(case)
        for table in TABLES
        if table.scene in case.record.scenes
        for column in table.columns
        if column.fits(case)
    }


def lines(table: Table, rows: Mapping[Case, Mapping[tuple[str, str], Outcome]]) -> Iterable[str]:
    """A table in Markdown."""
    names = [column.name for column in table.columns]
    yield from (f"## {table.title}", "", table.text, "")
    yield f"| method | on | {' | '.join(names)} |"
    yield f"| --- | --- |{' --- |' * len(names)}"
    for case, cells in rows.items():
        found = [cells.get((table.title, name)) for name in names]
        if any(found):
            on = case.representation + (" f32" if case.dtype == "float32" else "")
            text = " | ".join(cell.text if cell else "" for cell in found)
            yield f"| {case.method} | {on} | {text} |"
    yield ""


# where each method stops


SHARES = np.concatenate([np.linspace(0.5, 0.999, 16), [2.0]])  # of a limit: up to it, and beyond


def steps_of_cones(case: Case) -> tuple[Array, NDArray[np.uint8]]:
    """Error of a step, rad a rad turned, and status at shares of the limit, (17, M) each."""
    theta, a = np.meshgrid(SHARES * case.record.limit(case.representation), CONES, indexing="ij")
    frequency = (theta / (2.0 * np.sin(0.5 * a))).ravel()
    a = a.ravel()
    q0 = mul(START, cone(a, 0.0 * a))
    got = propagate(case, rates(a, frequency, np.zeros((len(a), 3))), q0, dt=1.0, n_steps=1)
    error = angle(got.q[-1], mul(START, cone(a, frequency))) / theta.ravel()
    return error.reshape(theta.shape), got.status.reshape(theta.shape)


def steps_of_bodies(case: Case) -> tuple[Array, NDArray[np.uint8]]:
    """The same of free bodies that can exist, in many directions."""
    limits = SHARES * case.record.limit(case.representation, body=True)
    inertia, w0 = [], []
    for name in ("V", "rod 1e-3", "needle 1e3", "disc", "disc ±2 %", "1, 2, 2.9"):
        w = spins(np.array(SHAPES[name]))
        moments = np.tile(SHAPES[name], (len(w), 1))
        size = measured(case, moments, w, 1.0)
        some = size > 1e-3  # else exact at any step
        inertia.append(moments[some])
        w0.append(w[some] / size[some, None])
    moments, w = np.vstack(inertia), np.vstack(w0)
    error, status = [], []
    for limit in limits:
        q0 = np.tile(START, (len(w), 1))
        got = propagate(case, fa.Scene(inertia=moments), q0, limit * w, dt=1.0, n_steps=1)
        q, _ = closed(moments, q0, limit * w, 1.0)
        error.append(angle(got.q[-1], q) / (limit * np.linalg.norm(w, axis=1)))
        status.append(got.status)
    return np.array(error), np.array(status)


def number(x: float) -> str:
    return "none" if math.isinf(x) else f"{x:.3g}"


def told_by(status: NDArray[np.uint8]) -> str:
    """The flags that all of the bodies carry one of."""
    names = [f.name or "" for f in fa.Status if f and (status & f).any()]
    return ", ".join(names) + ("" if status.all() else " (not all)")


def limits_table() -> Iterable[str]:
    """Each method's limits and what happens at and beyond them, on quaternions in float64."""
    yield from ("## Where each method stops", "")
    yield (
        "The limit is of |w|h, rad a step or an interval of a log; of strang2 and its compositions "
        "of |m|h √(|1/I1 − 1/I2| |1/I3 − 1/I2|), of dmv and srkn of |m|h/I_min, of cg3 of 24/17 "
        "|w|h. Errors are the worst of one step of status 0 on the cones and bodies below, from "
        "half the limit on; flags are those of steps of twice the limit."
    )
    yield from ("", "| method | for | limit | error at it, rad a rad | beyond | c h/I up to |")
    yield "| --- | --- | --- | --- | --- | --- |"
    for record in fa.METHODS.values():
        case = Case(record.name)
        damped = number(record.damping_limit) if "torqued" in record.scenes else ""
        for scene, run in (("rate", steps_of_cones), ("free", steps_of_bodies)):
            if scene not in record.scenes:
                continue
            limit = record.limit("quat", body=scene == "free")
            cells = [number(limit), "", ""]
            if math.isfinite(limit):
                error, status = run(case)
                cells[1:] = f"{error[status == 0].max():.0e}", told_by(status[-1])
            kind, own = ("rates", "") if scene == "rate" else ("bodies", damped)
            yield f"| {record.name} | {kind} | {' | '.join(cells)} | {own} |"
        if record.scenes == ("torqued",):
            limit = record.limit("quat", body=True)
            yield f"| {record.name} | bodies under a torque | {number(limit)} | | | |"
        for scene, key in (("sampled rates", "rates"), ("increments", "increments")):
            if scene in record.scenes:
                limit = number(record.limits[key])
                yield f"| {record.name} | {scene} | {limit} | | StepWarning | |"
    yield ""


# the least error of each precision


SECONDS = 20.0
LADDER = [2**k for k in range(5, 16)]


def ends_of_cones(case: Case) -> Iterable[tuple[float, float]]:
    """(|w|h, largest error at the end) on the cones, 1 rad/s about their axes."""
    a, one = single(CONES), np.ones(3)
    q0 = mul(START, cone(a, 0.0 * a))
    truth = mul(START, cone(a, SECONDS * one))
    scene = rates(a, one, np.zeros((3, 3)))
    for n in LADDER:
        got = propagate(case, scene, q0, dt=SECONDS / n, n_steps=n)
        yield SECONDS / n * 2.0 * math.sin(0.5 * a.max()), float(angle(got.q[-1], truth).max())


def ends_of_bodies(case: Case) -> Iterable[tuple[float, float]]:
    """The same of body V turning at 1 rad/s in 11 directions."""
    w0 = single(spins(np.array(V)))
    q0 = np.tile(START, (len(w0), 1))
    inertia = single(np.tile(V, (len(w0), 1)))
    truth, _ = closed(inertia, q0, w0, SECONDS)
    for n in LADDER:
        got = propagate(case, fa.Scene(inertia=inertia), q0, w0, dt=SECONDS / n, n_steps=n)
        yield SECONDS / n, float(angle(got.q[-1], truth).max())


def ends_of_logs(case: Case) -> Iterable[tuple[float, float]]:
    """The same of a log of the cone of 1 rad."""
    increments = "sampled rates" not in case.record.scenes
    for n in LADDER:
        data, q0, truth, h = coning_log(1.0, 1.0, SECONDS / n, n, increments=increments)
        q = fa.integrate_rates(
            data, h, q0, method=case.method, increments=increments, dtype=case.dtype, n_threads=1
        )
        yield h * 2.0 * math.sin(0.5), float(angle(q[-1], truth[-1]))


def floors_table() -> Iterable[str]:
    """Where rounding takes over, for each method and both precisions, on quaternions."""
    yield from ("## The least error of each precision", "")
    yield (
        f"Largest error after {SECONDS:g} s on the cones (1 rad/s about their axes), of body V "
        "(1 rad/s, 11 directions) and of logs of the cone of 1 rad, at the best of steps from "
        "20/32 to 20/32768 s, and its |w|h: a smaller step gains nothing."
    )
    yield from ("", "| method | for | float64, rad | at | float32, rad | at |")
    yield "| --- | --- | --- | --- | --- | --- |"
    kinds = {
        "rate": ("rates", ends_of_cones),
        "free": ("bodies", ends_of_bodies),
        "sampled rates": ("sampled rates", ends_of_logs),
        "increments": ("increments", ends_of_logs),
    }
    for record in fa.METHODS.values():
        logs = "sampled rates" in record.scenes  # which say as much as increments
        scenes = [s for s in kinds if s in record.scenes and (s != "increments" or not logs)]
        for scene in scenes:
            name, run = kinds[scene]
            cells = []
            for dtype in ("float64", "float32"):
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    at, least = min(run(Case(record.name, dtype=dtype)), key=lambda x: x[1])
                cells += [f"{least:.0e}", f"{at:.0e}" if record.order else "any"]
            yield f"| {record.name} | {name} | {' | '.join(cells)} |"
    yield ""


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
    """Of free bodies, or, of methods that need a torque, of heavy tops."""
    inertia, q0, w0 = ensemble()
    arm = np.tile([0.1, 0.2, 0.3], (ENSEMBLE, 1))
    weight = np.zeros(ENSEMBLE)
    if "free" in case.record.scenes:
        scene = fa.Scene(inertia=inertia)
    else:
        weight = np.ones(ENSEMBLE)
        scene = torqued(inertia, None, weight, arm)
    got = propagate(case, scene, q0, w0, dt=h, n_steps=n_steps, save_every=n_steps // saves)
    height = np.einsum("snj,nj->sn", got.C[:, :, 2], arm)
    total = 0.5 * (inertia * got.w * got.w).sum(-1) + weight * height
    # kinetic energy makes the scale: the total may be near 0
    change = (total - total[0]) / (0.5 * (inertia * w0 * w0).sum(-1))
    found = slope(change, got.t / h)
    return Drift(*found, float(np.abs(change).max()))


def is_symplectic(record: fa.Method) -> bool:
    """Splittings of the Hamiltonian, and DMV, a variational integrator."""
    return record.tag is not None and (
        record.takes < fa.torques.RATE or "energy" in record.conserves
    )


def energy_table(n_steps: int) -> Iterable[str]:
    yield from (f"## Energy over {n_steps:.0e} steps".replace("e+0", "e"), "")
    yield (
        f"{ENSEMBLE} bodies of moments about (0.6, 0.8, 1), 1 rad/s, steps of 0.1 s; srkn: heavy "
        "tops. Relative to the kinetic energy: slope a step with its standard error over the "
        "bodies, the largest change, and the slope in standard errors."
    )
    yield from ("", "| method | slope | ± | largest | slope/± |", "| --- | --- | --- | --- | --- |")
    for record in fa.METHODS.values():
        if is_symplectic(record) or record.name == "rk4":
            d = energy(Case(record.name), n_steps)
            ratio = d.slope / d.uncertainty
            yield (
                f"| {record.name} | {d.slope:.1e} | {d.uncertainty:.1e} | {d.largest:.1e} "
                f"| {ratio:.1f} |"
            )
    yield ""


HEADER = """\
# Every method at the extremes

Made by `make extremes`. A cell holds the worst error among bodies of status 0, and the flags of all
bodies. **wrong** would mark a body of status 0 whose error is more than the method's order, the
rounding of its precision (16 ulps for each time that a step touches the state) and the
conditioning of its motion (measured on the closed form) explain, or more than 0.1 rad a rad turned.
There are {wrong} in {total} cells.

No status sees a rate that changes faster than a step resolves: cones here turn at up to twice the
rate of the body.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="quaternions in float64 alone")
    parser.add_argument("--long", action="store_true", help="energy over 10^7 steps too")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at once")
    parser.add_argument("--out", type=Path, default=OUT, help="the page, Markdown")
    options = parser.parse_args(arguments)
    every = cases(quick=options.quick)
    # a process ends after some rows: what was compiled stays in its memory
    with multiprocessing.get_context("spawn").Pool(options.jobs, maxtasksperchild=8) as pool:
        rows = {}
        for case, found in zip(every, pool.imap(row, every), strict=True):
            rows[case] = found
            print(len(rows), "of", len(every), *case, file=sys.stderr)
    cells = [cell for found in rows.values() for cell in found.values()]
    wrong = sum(bool(cell.wrong.any()) for cell in cells)
    page = [HEADER.format(wrong=wrong, total=len(cells)), *limits_table()]
    page += floors_table()
    for table in TABLES:
        page += lines(table, rows)
    page += energy_table(10_000_000 if options.long else 100_000)
    text = "\n".join(page)
    options.out.write_text(text, encoding="utf-8")
    print(text)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
