"""Free bodies of all shapes, damping and weights, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

import fastatt as fa
from extremes.cases import (
    ANGLES,
    ANGLES_PROMISE,
    OF_BODIES,
    OF_BODIES_IN_MATRICES,
    OF_PENDULA,
    OF_PENDULA_IN_MATRICES,
    ONE,
    PROMISE,
    START,
    Array,
    Case,
    Column,
    Outcome,
    angle,
    exp,
    kept,
    mul,
    of_matrices,
    propagate,
    rounding,
    share,
    single,
)
from extremes.rates import AXES


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
    known = of_matrices(case, OF_BODIES, OF_BODIES_IN_MATRICES)
    return theta * share(known, case.method, order, grows)


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


@kept
def closed(inertia: Array, q0: Array, w0: Array, t: float) -> tuple[Array, Array]:
    q, w = fa.closed_form.free_body(q0, w0, inertia, t, allow_unphysical=True)
    return q, w


@kept
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


# damping and weights

TORQUED_STEPS = 32


def torqued(inertia: Array, drag: Array, weight: Array, arm: Array) -> fa.Scene:
    """Gravity gradient, weight and damping: one type of scene, zeros switch off."""
    n = len(inertia)
    terms = (
        fa.torques.GravityGradient(np.zeros(n)),
        fa.torques.HeavyTop(arm, weight),
        fa.torques.Damping(drag[:, None]),
    )
    return fa.Scene(inertia=inertia, torque=fa.torques.Sum(terms))


def takes_torques(case: Case) -> bool:
    return "torqued" in case.record.scenes and case.record.is_stepped


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
            with np.errstate(over="ignore"):  # then the error is infinite
                off = np.linalg.norm(np.asarray(got.w[s], float) - left * w, axis=1) / size
            off = np.maximum(off, angle(got.q[s], mul(q0, exp(turned))) / size)
            error = np.maximum(error, off)  # NaN stays
        order = case.record.order
        step = np.minimum(PROMISE, np.minimum(rate, 10.0) ** order / math.factorial(order))
        own = rounding(case, TORQUED_STEPS, np.zeros(n)) / theta
        allowed = step / -np.expm1(-rate) + own
        return Outcome(error, allowed, got.status)

    return Column(f"{x:g}", run, takes_torques)


# moments, and the axis of the swing, that of the least or largest; the weight hangs along −e3
PENDULA = np.array([[0.6, 0.8, 1.0], [0.6, 1.0, 0.8], [1.0, 0.6, 0.8], [0.8, 1.0, 0.6]])
SWING = np.array([0, 1, 0, 1])


class Swing(NamedTuple):
    """Error of each body, status, and error that a step's may become: a number for each of its."""

    error: Array
    status: NDArray[np.uint16]
    frequency: Array
    turn: Array

    @property
    def along(self) -> Array:
        """An error of the frequency grows with time: the phase's with its square."""
        return np.asarray(1.0 + TORQUED_STEPS * self.frequency)


def swing(case: Case, x: float) -> Swing:
    """A weight that swings 90° to each side, frequency times step x: Jacobi's functions."""
    k = math.sin(math.radians(45.0))
    rows = single(PENDULA)
    each = np.arange(len(rows))
    moment = rows[each, SWING]
    arm = np.tile([0.0, 0.0, -1.0], (len(rows), 1))
    weight = single(moment * x * x)
    frequency = np.sqrt(weight / moment)
    w0 = np.zeros((len(rows), 3))
    w0[each, SWING] = single(2.0 * k * frequency)
    modulus = w0[each, SWING] / (2.0 * frequency)
    scene = torqued(rows, np.zeros(len(rows)), weight, arm)
    q0 = np.tile(ONE, (len(rows), 1))
    error, turn = np.zeros(len(rows)), np.abs(w0).max(axis=1)
    got = propagate(case, scene, q0, w0, dt=1.0, n_steps=TORQUED_STEPS, save_every=1)
    for s, t in enumerate(got.t):
        sn, cn, dn, _ = scipy.special.ellipj(frequency * t, modulus**2)
        half = np.arctan2(modulus * sn, dn)
        turned = np.zeros((len(rows), 3))
        turned[each, SWING] = 2.0 * half
        speed = np.zeros((len(rows), 3))
        speed[each, SWING] = 2.0 * modulus * frequency * cn
        off = np.linalg.norm(np.asarray(got.w[s], float) - speed, axis=1) / turn
        error = np.maximum(error, np.maximum(off, angle(got.q[s], exp(turned))))
    return Swing(error, got.status, frequency, turn)


def pendulum(x: float) -> Column:
    """A weight on a pendulum, and what its steps may err by."""

    def run(case: Case) -> Outcome:
        of = swing(case, x)
        known = of_matrices(case, OF_PENDULA, OF_PENDULA_IN_MATRICES)
        step = share(known, case.method, case.record.order_of("torqued"), of.turn)
        own = rounding(case, TORQUED_STEPS, TORQUED_STEPS * of.turn)
        return Outcome(of.error, of.along * (TORQUED_STEPS * step + own), of.status)

    return Column(f"{x:g}", run, takes_torques)


# a torque that reads the attitude, on bodies from a sphere to a needle

WEIGHED: Mapping[str, tuple[float, float, float]] = {
    "sphere": (1.0, 1.0, 1.0),
    "1+1e-3": (1.0, 1.0009765625, 1.001953125),
    "disc": (1.0, 1.0, 2.0),
    "rod": (0.0625, 1.0, 1.0),
    "needle": (0.0009765625, 1.0, 1.0),
    "V": V,
}
# torque of the weight: h² times it over the least moment; share of its impulse that a step may miss
PULL, MISSED = 2.0**-7, 0.2
_FINE = 0.05  # rad a step of the reference


@kept
def weighed(rows: Array, q0: Array, w0: Array, weight: Array, arm: Array) -> tuple[Array, Array]:
    """(q, w) after ``TORQUED_STEPS`` s, in steps so small that order 8 leaves rounding."""
    fine = max(1, math.ceil(np.linalg.norm(w0, axis=1).max() / _FINE), 64)
    scene = torqued(rows, np.zeros(len(rows)), weight, arm)
    got = propagate(Case("rk8"), scene, q0, w0, dt=1.0 / fine, n_steps=TORQUED_STEPS * fine)
    return np.asarray(got.q[-1]), np.asarray(got.w[-1])


def turning_under_weight(theta: float) -> Column:
    """A weight on bodies that turn by theta a step, which samples its torque too seldom, or not."""

    def run(case: Case) -> Outcome:
        directions = spins(np.ones(3))
        rows = single(np.repeat(list(WEIGHED.values()), len(directions), axis=0))
        w0 = single(theta * np.tile(directions, (len(WEIGHED), 1)))
        q0 = np.tile(START, (len(rows), 1))
        least = rows.min(axis=1)
        arm = np.tile([0.375, 0.5, 0.75], (len(rows), 1))
        weight = PULL * least
        scene = torqued(rows, np.zeros(len(rows)), weight, arm)
        got = propagate(case, scene, q0, w0, dt=1.0, n_steps=TORQUED_STEPS)
        q, w = weighed(rows, q0, w0, weight, arm)
        size = np.linalg.norm(rows * w0, axis=1)
        with np.errstate(all="ignore"):
            off = np.linalg.norm(rows * (np.asarray(got.w[-1], float) - w), axis=1) / size
        error = np.maximum(angle(got.q[-1], q), off)
        n = TORQUED_STEPS
        turn = np.linalg.norm(w0, axis=1)
        missed = MISSED * PULL * n * np.maximum(0.5 * n, 1.0 / theta)
        step = truncation_of_body(case, rows, w0, 1.0) * (1.0 + n * np.maximum(turn, 1.0))
        own = rounding(case, n, n * turn) * (1.0 + n * rows.max(axis=1) / least)
        return Outcome(error, missed + step + own, got.status)

    def fits(case: Case) -> bool:
        return takes_torques(case) and case.representation not in ANGLES

    return Column(f"{theta:.3g}", run, fits)
