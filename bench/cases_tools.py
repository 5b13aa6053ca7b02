"""Cases of other software: NASA's check case 2, Basilisk, JSBSim, MuJoCo, GTSAM, SciML."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from cases_rows import Case, Row, at_most, printed
from numba import njit

import fastatt as fa
from fastatt import estimation

IDENTITY = (1.0, 0.0, 0.0, 0.0)
DEGREE = math.pi / 180.0


def free(inertia: Any, w0: Any, t: float) -> Any:
    """Attitude and rate at t of a free body that starts along inertial axes."""
    return fa.closed_form.free_body(IDENTITY, w0, inertia, t)


def mrp(q: Any) -> Any:
    """Modified Rodrigues parameters, of at most a quarter of the way around."""
    q = q if q[0] >= 0.0 else -q
    return q[1:] / (1.0 + q[0])


# NASA


BRICK = (0.001894220, 0.006211019, 0.007194665)
EARTH = 7.292115e-5  # rad/s
# at 30 s, of SIM 01 to 06: longitude; yaw, pitch, roll; rates: °, °/s
NESC = {
    "SIM 01": (
        5.74552194388e-5,
        "-4.289355039311268, -3.81965492049295, -56.151307596646866",
        "12.61839077566776, -17.3974747618308, 31.11958888682995",
    ),
    "SIM 04": (
        5.74552213287e-5,
        "-4.28935504226, -3.81965492189, -56.1513075938",
        "12.6183907757, -17.3974747619, 31.1195888868",
    ),
}
# SIM 01's file starts with 29.99999999994°/s for 30, and 30 s of the Earth's rate as all files give
# it, to 7 digits, are as little as 9e-9° known
ATTITUDE_KNOWN = 30.0 * (6e-11 + 5e-12 / DEGREE)


def nesc() -> Iterator[Row]:
    q, w = free(BRICK, np.array([10.0, 20.0, 30.0]) * DEGREE, 30.0)
    for name, (longitude, angles, rates) in NESC.items():
        yaw, pitch, roll = (float(x) * DEGREE for x in angles.split(", "))
        turns = (
            (longitude * DEGREE + 30.0 * EARTH, 0.0, 0.0), (0.0, 0.0, yaw), (0.0, pitch, 0.0),
            (roll, 0.0, 0.0),
        )  # fmt: skip
        theirs: Any = np.array(IDENTITY)
        for turn in turns:
            theirs = fa.quat_multiply(theirs, fa.rotation_vector_to_quat(turn))
        apart = float(fa.angle_between(q, theirs)) / DEGREE
        yield Row(
            f"attitude, {name}", f"yaw, pitch, roll {angles}°", f"{apart:.1e}° from it", apart,
            ATTITUDE_KNOWN, "°",
        )  # fmt: skip
        found = np.abs(w / DEGREE - [float(x) for x in rates.split(", ")]).max()
        ours = ", ".join(f"{x:.11f}" for x in w / DEGREE)
        yield Row(f"rate, {name}, °/s", rates, ours, float(found), ATTITUDE_KNOWN / 30.0, "°/s")


# Basilisk


# 100 N·m·s at 6000 rpm
WHEEL = 100.0 / (6000.0 * math.pi / 30.0)
HUB = np.array([900.0, 800.0, 600.0])
HUB_RATE = np.array([0.08, 0.01, 0.0])
SPEEDS = np.array([500.0, 200.0, -150.0]) * math.pi / 30.0
# of the 0.5 N·m that the third motor is commanded it gives the 0.2 N·m that it can
COMMANDED, LARGEST = (0.2, 0.1, -0.5), 0.2


def first_half(t, q, w, s, p):
    """The motors' torques, until they are switched off."""
    return COMMANDED if t < 0.5 else (0.0, 0.0, 0.0)


def second_half(t, q, w, s, p):
    """The torque of a motor that is switched on after 5 s."""
    return 0.2 if t > 5.0 else 0.0


def basilisk() -> Iterator[Row]:
    q, _ = free((500.0, 200.0, 300.0), (0.5, -0.4, 0.7), 10.0)
    theirs = "3.73034285e-1, -2.39564413e-3, 2.08570797e-1"
    yield printed("σ, free, 10 s", theirs, mrp(q))
    wheels = fa.torques.ReactionWheels(np.eye(3), WHEEL, first_half, max_torque=LARGEST)
    scene = fa.Scene(inertia=wheels.body_inertia(HUB), torque=wheels, breakpoints=0.5)
    s0 = wheels.momenta(SPEEDS, HUB_RATE)
    run = fa.propagate(scene, IDENTITY, HUB_RATE, s0=s0, dt=0.01, n_steps=100, method="rk8")
    theirs = "1.99853994e-2, 2.45647716e-3, 8.45356279e-6"
    yield printed("σ, three wheels, 1 s", theirs, mrp(run.q[-1]))
    # about one axis all is known: a hub of 2 kg·m² and the wheel that turns in it
    wheel = fa.torques.ReactionWheels([[0, 0, 1]], WHEEL, second_half)
    scene = fa.Scene(
        inertia=wheel.body_inertia((2.0, 2.0, 2.0 + WHEEL)), torque=wheel, breakpoints=5.0
    )
    w0, speed = (0.0, 0.0, 0.35), 100.0 * math.pi / 30.0
    run = fa.propagate(
        scene, IDENTITY, w0, s0=wheel.momenta(speed, w0), dt=0.1, n_steps=100, method="rk8"
    )
    angle = 2.0 * math.atan2(run.q[-1, 3], run.q[-1, 0])
    theirs = speed + (2.0 + WHEEL) * 0.2 / (2.0 * WHEEL) * 5.0
    found = wheel.speeds(run.s[-1], run.w[-1])[0]
    yield printed("rate, one wheel, 10 s", "-0.15000000", [run.w[-1, 2]])
    yield printed("angle, one wheel, 10 s", "2.25000000", [angle])
    yield printed("speed of the wheel, 10 s", f"{theirs:.8f}", [found])


# JSBSim


TOP, TOP_RATE = (10.0, 20.0, 26.0), (1.0, 15.0, 1.0)
METHODS = ("rk4", "strang2", "dmv10")


def jsbsim() -> Iterator[Row]:
    scene = fa.Scene(inertia=TOP)
    true, _ = free(TOP, TOP_RATE, 10.0)
    for name in METHODS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", fa.StepWarning)
            run = fa.propagate(scene, IDENTITY, TOP_RATE, dt=1 / 120, n_steps=1200, method=name)
        error = float(fa.angle_between(run.q[-1], true)) / DEGREE
        order = fa.METHODS[name].order
        theirs, limit = ("0.199°", 0.199) if order > 2 else ("24.7°", 24.7)
        kind = "Adams-Bashforth 5" if order > 2 else "Adams-Bashforth 2"
        yield at_most(f"error of {name}, 120 Hz, 10 s", f"{theirs}, {kind}", error, limit, "°")
    # (f now + f a step ago)/2 for (f now + f a step ahead)/2
    rule = fa.runge_kutta("late", order=1, c=(0, -1), a=((-1,),), b=(1 / 2, 1 / 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", fa.ConvergenceWarning)
        found = fa.check_convergence(
            scene, IDENTITY, TOP_RATE, dt=1 / 960, n_steps=24, method=replace(rule, order=2)
        )
    assert not found.passed
    # an order is a whole number
    yield printed("order of the trapezoidal rule so taken", "1", [found.order], 0.5)


# MuJoCo


def mujoco() -> Iterator[Row]:
    half = np.array([0.1, 0.2, 0.3])
    inertia = (half @ half - half**2) / 3.0
    scene = fa.Scene(inertia=inertia)
    for name in METHODS:
        run = fa.propagate(
            scene, IDENTITY, (1.0, 2.0, 3.0), dt=0.01, n_steps=500, save_every=500, method=name
        )
        energy = np.abs(np.diff(run.w[[0, -1]] ** 2 @ inertia)).item()
        energy /= float(run.w[0] ** 2 @ inertia)
        momentum = np.linalg.norm(np.diff(fa.quat_rotate(run.q, run.w * inertia), axis=0))
        yield at_most(f"E/E0 off 1 by, {name}", "0.07", energy, 0.07, "")
        yield at_most(f"momentum off by, {name}", "5e-3", float(momentum), 5e-3, "N·m·s")


# GTSAM, manif


LUND = np.array([
    [-0.98582676, -0.03958746, -0.16303092],
    [-0.03997006, -0.88835923, 0.45740671],
    [-0.16293753, 0.45743998, 0.87418537],
])  # fmt: skip
NEAR_PI = np.array([
    [-0.999957, 0.00922903, 0.00203116],
    [0.00926964, 0.999739, 0.0208927],
    [-0.0018374, 0.0209105, -0.999781],
])  # fmt: skip


def log(C: Any) -> Any:
    return fa.quat_to_rotation_vector(fa.dcm_to_quat(C))


def gtsam() -> Iterator[Row]:
    ours = log(LUND)
    # the matrix is off the rotations by half of ‖C Cᵀ − 1‖; the logarithm near π takes π/2 of that
    departure = math.pi / 4.0 * float(np.linalg.norm(LUND @ LUND.T - np.eye(3)))
    for way, theirs in (
        ("quaternion", "0.264451979, -0.742197651, -3.04098211"),
        ("matrix", "0.264452, -0.742197708, -3.04098184"),
    ):
        apart = float(np.abs(ours - [float(x) for x in theirs.split(", ")]).max())
        shown = ", ".join(f"{x:.9f}" for x in ours)
        yield Row(f"log near π, by the {way}", theirs, shown, apart, departure, "rad")
    yield printed("angle near π", "3.1396582", [float(np.linalg.norm(log(NEAR_PI)))])
    u = np.array([1e-8, 0.0, 0.0])
    back = log(fa.quat_to_dcm(fa.rotation_vector_to_quat(u)))
    yield at_most("log exp(1e-8, 0, 0) off by", "1e-15", float(np.abs(back - u).max()), 1e-15, "")
    u = np.array([0.0, 0.0, 1e-9])
    element = float(estimation.left_jacobian_inverse(u)[0, 1])
    yield printed("Jl⁻¹ at 1e-9, first row, second column", "5.0e-10", [element])


# SciML


@njit
def push(t, q, w, p):
    """0.25 sin² t of acceleration about an axis whose moment is 6."""
    return 0.0, 0.0, 1.5 * math.sin(t) ** 2


def sciml() -> Iterator[Row]:
    # (I2 − I3)/I1 = −2, (I3 − I1)/I2 = 1.25, (I1 − I2)/I3 = −0.5
    scene = fa.Scene(inertia=(1.0, 4.0, 6.0), torque=push)
    run = fa.propagate(scene, IDENTITY, (1.0, 0.0, 0.9), dt=0.01, n_steps=1000, method="rk8")
    yield printed("y(10)", "-0.66886242298013, -0.58769840220407, 2.01077739307361", run.w[-1])


CASES = (
    Case(
        "NASA's NESC atmospheric check case 2",
        """\
A brick tumbles freely for 30 s from (10, 20, 30)°/s; the body starts along north, east and down.
Attitude and rate are the last lines of `Atmos_02_sim_*.csv` in `nasa/simupy-flight`.
The inertial attitude is the rotation by longitude and of the Earth, then yaw, pitch and roll.
The attitude is known to 1e-8°: of SIM 01 the first line has 29.99999999994°/s for 30°/s,
and the Earth's rate is given to 7 digits.""",
        "off ours by 3.5e-9° (SIM 01), 5.2e-9° (04), 7.9e-5° (05), 2.8e-3° (06) and 3.71° (02); "
        "JSBSim's pull request 1453 puts its default at 2.5°.",
        nesc,
    ),
    Case(
        "Basilisk's spacecraft and wheels",
        """\
Modified Rodrigues parameters from `test_spacecraft.py`, `SCTransAndRotation`,
and from `test_reactionWheelStateEffector_integrated.py`, `BalancedWheels`.
Wheels are Honeywell HR16 of 100 N·m·s at 6000 rpm, without friction; motors stop after 0.5 s.
The last three figures are the closed form that `BOE` of the same file compares with:
one wheel whose motor starts after 5 s, in a hub of 2 kg·m² about its axis.""",
        "held to 1e-8 and 1e-7 of the numbers by their tests.",
        basilisk,
    ),
    Case(
        "JSBSim's rotation notebook",
        """\
A free body, I = (10, 20, 26), w = (1, 15, 1), of van Zon and Schofield, for 10 s at 120 Hz.
The notebook is `check_cases/notebooks/rotation`; figures are those of JSBSim 1.3.3 run so.
Its "trapezoidal" rule takes the slope of a step ago for that of a step ahead.
Written as a tableau it is refused with order 2, and `fa.check_convergence` finds its order.""",
        "off by 36.8° (Euler), 24.7°, 6.2°, 0.28° and 0.199° (Adams-Bashforth 2 to 5); "
        "the trapezoidal rule diverges after 5.6 s, and at 240 Hz is off as Euler's at 120 Hz.",
        jsbsim,
    ),
    Case(
        "MuJoCo's free box",
        """\
`engine_forward_test.cc`, `FreeBodyConservation`: half sizes .1, .2, .3 m, 1 kg, w = (1, 2, 3).
500 steps of 0.01 s; figures are its comments' for `implicitfast`, the better of two.""",
        "E/E0 is 1.09 by Euler, 0.93 by implicitfast.",
        mujoco,
    ),
    Case(
        "GTSAM's literals near π, manif's near 0",
        """\
`testRot3.cpp`: a matrix of the Lund data set, whose C Cᵀ is off 1 by 9e-7, and one near π.
The logarithm of a matrix is known no better than the matrix is a rotation.
manif's issue 223: its Jl⁻¹ had +W/2 for −W/2 near 0; its one test was at 1e-9.""",
        "GTSAM's own two ways differ by 2.7e-7 rad.",
        gtsam,
    ),
    Case(
        "SciMLBenchmarks' rigid body",
        """\
y' = (−2 y2 y3, 1.25 y1 y3, −0.5 y1 y2 + 0.25 sin² t), y(0) = (1, 0, 0.9): moments 1, 4 and 6.
The benchmark prints no end value; this one is of those equations in mpmath, to 20 digits.""",
        "the benchmark's own reference is Vern7 at 1e-14.",
        sciml,
    ),
)
