"""Spacecraft with reaction wheels beside other solutions: Basilisk's scenario, and slews.

    python bench/wheels.py            # four minutes, most of them Basilisk's thousand bodies

The first table tells how far two solutions of ``wheel_feedback`` are from each other over 10
minutes, at the samples: modified Rodrigues parameters σ and the speeds of the wheels. The second
has times on one core and, of a thousand bodies with other starts, the largest difference of σ at
the end from ``rk8`` and from ``rk4`` on MRPs, which Basilisk takes too. Basilisk takes part where
it is installed.

In the others 10^5 bodies rotate by 40° to 100° and come to rest under PID control, evaluated at all
times or every 0.5 s and held. Three wheels with friction and a largest torque do it; a thruster
pushes for 3 s, and the time at which the pointing error first falls below 0.2° is compared with the
begin of an eclipse. Beside the speed stand the largest differences of ten bodies from SciPy's
DOP853 (relative tolerance 1e-12, begun anew at each breakpoint and sample time).
"""

from __future__ import annotations

import math
import os
from functools import partial
from importlib.util import find_spec
from itertools import pairwise
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import wheel_feedback as feedback
from peers_wheels import BasiliskWheels
from scipy.integrate import solve_ivp

import fastatt as fa
from fastatt.trade.timing import once, time_in_turns

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
BODIES, COMPARED, STEPS = (200, 2, (0.5,)) if SMALL else (100_000, 10, (0.5, 0.25, 0.1))
END, PULSE, PERIOD = 250.0, (150.0, 153.0), 0.5
PUSH = 0.1  # N·m
STIFFNESS, RESET, DAMPING = 0.5, 0.02, 5.0  # N·m/rad, N·m/(rad s), N·m·s
WHEEL = 0.02  # kg·m²
VISCOUS, COULOMB, SLOW = 1e-5, 1e-3, 1.0  # N·m·s, N·m, rad/s
#: of an orbit of 95 minutes, 7000 km from the centre of the Earth; where the Sun sets there
ORBIT, BEGUN, SUNSET = 1.1e-3, 1.88, math.sqrt(1.0 - (6378.0 / 7000.0) ** 2)


def continuous(t, q, w, s, p):
    """PID control at all times: s is the integral of the error, of large errors of less."""
    error = tuple(2.0 * q[0] * x for x in q[1:])
    torque = tuple(-p[0] * e - p[1] * x - p[2] * v for e, x, v in zip(error, s, w, strict=True))
    return torque, tuple(e / (1.0 + 100.0 * e * e) for e in error)


def discrete(t, q, w, s, p):
    """The same at sample times: s is a sum."""
    torque, slope = continuous(t, q, w, s, p)
    return torque, tuple(x + PERIOD * e for x, e in zip(s, slope, strict=True))


def thruster(t, q, w, p):
    return (PUSH if PULSE[0] < t < PULSE[1] else 0.0), 0.0, 0.0


def sun(t, q, w, p):
    """Falls through zero where the eclipse begins."""
    return math.cos(ORBIT * t + BEGUN) + SUNSET


def pointing(t, q, w, p):
    """Falls through zero where the pointing error is 0.2°."""
    return math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3]) - math.sin(math.radians(0.1))


EVENTS = [fa.event(sun, direction=-1), fa.event(pointing, direction=-1)]


class Slew(NamedTuple):
    """Bodies with their controller: ``largest`` torques of motors are (N, 1)."""

    scene: fa.Scene
    wheels: Any
    inertia: Any
    largest: Any
    start: dict[str, Any]
    is_sampled: bool

    def run(self, dt: float) -> fa.Trajectory:
        return fa.propagate(self.scene, **self.start, dt=dt, t_end=END, method="rk8", events=EVENTS)


def slew_of(n: int, *, is_sampled: bool) -> Slew:
    """n bodies whose numbers differ."""
    rng = np.random.default_rng(7)
    inertia = rng.uniform((18.0, 16.0, 13.0), (22.0, 19.0, 16.0), (n, 3))  # wheels included
    largest = rng.uniform(0.04, 0.06, (n, 1))
    gains = (STIFFNESS, RESET, DAMPING)
    law = fa.torques.Custom(continuous, gains, states=3)
    if is_sampled:
        law = fa.torques.SampledControl(discrete, PERIOD, gains, states=3)
    wheels = fa.torques.ReactionWheels(
        np.eye(3), WHEEL, law, viscous=VISCOUS, coulomb=COULOMB, coulomb_speed=SLOW,
        max_torque=largest,
    )  # fmt: skip
    scene = fa.Scene(
        inertia=wheels.body_inertia(inertia),
        torque=fa.torques.Sum((wheels, fa.torques.Custom(thruster, uses_rate=False))),
        breakpoints=PULSE,
    )
    axes = rng.normal(size=(n, 3))
    angles = np.radians(rng.uniform(40.0, 100.0, n))
    vectors = axes * (angles / np.linalg.norm(axes, axis=1))[:, None]
    w0 = rng.normal(0.0, 1e-3, (n, 3))
    momenta = wheels.momenta(rng.uniform(-20.0, 20.0, (n, 3)), w0)
    s0 = np.concatenate([momenta, np.zeros((n, 6 if is_sampled else 3))], axis=1)
    start = {"q0": fa.rotation_vector_to_quat(vectors), "w0": w0, "s0": s0}
    return Slew(scene, wheels, inertia, largest, start, is_sampled)


def truth(slew: Slew, body: int) -> tuple[Any, Any, Any, list[float]]:
    """(q, w, speeds) at the end and the times of the events, by DOP853.

    Its unknowns are the speeds of wheels, its equations those of the whole spacecraft.
    """
    inertia, (largest,) = slew.inertia[body].tolist(), slew.largest[body].tolist()
    gains = STIFFNESS, RESET, DAMPING

    def slope(t, y, push, held):
        a, b, c, d, *w = y[:7].tolist()
        size, speeds, memory = math.hypot(a, b, c, d), y[7:10].tolist(), y[10:].tolist()
        torque, error = continuous(t, (a / size, b / size, c / size, d / size), w, memory, gains)
        net = [
            min(max(-u, -largest), largest) - VISCOUS * x - COULOMB * x / math.hypot(x, SLOW)
            for u, x in zip(torque if held is None else held, speeds, strict=True)
        ]
        m = [i * v + WHEEL * x for i, v, x in zip(inertia, w, speeds, strict=True)]
        spin = (
            (push + m[1] * w[2] - m[2] * w[1] - net[0]) / (inertia[0] - WHEEL),
            (m[2] * w[0] - m[0] * w[2] - net[1]) / (inertia[1] - WHEEL),
            (m[0] * w[1] - m[1] * w[0] - net[2]) / (inertia[2] - WHEEL),
        )
        turned = (
            -0.5 * (b * w[0] + c * w[1] + d * w[2]),
            0.5 * (a * w[0] + c * w[2] - d * w[1]),
            0.5 * (a * w[1] + d * w[0] - b * w[2]),
            0.5 * (a * w[2] + b * w[1] - c * w[0]),
        )
        accelerated = [u / WHEEL - v for u, v in zip(net, spin, strict=True)]
        more = (0.0, 0.0, 0.0) if slew.is_sampled else error
        return [*turned, *spin, *accelerated, *more]

    def watch(g):
        def event(t, y, push, held):
            return g(t, y[:4] / np.linalg.norm(y[:4]), y[4:7], ())

        event.direction = -1
        return event

    q0, w0, s0 = (slew.start[name][body] for name in ("q0", "w0", "s0"))
    y = np.concatenate([q0, w0, s0[:3] / WHEEL - w0, np.zeros(3)])
    edges = {0.0, *PULSE, END}
    if slew.is_sampled:
        edges |= {PERIOD * k for k in range(round(END / PERIOD))}
    times = [math.nan, math.nan]
    watched = [watch(sun), watch(pointing)]
    for a, b in pairwise(sorted(edges)):
        held = None
        if slew.is_sampled:
            if a % PERIOD == 0.0:
                kept, y[10:] = discrete(a, y[:4], y[4:7], y[10:], gains)
            held = kept
        push = PUSH if PULSE[0] <= a < PULSE[1] else 0.0
        made = solve_ivp(
            slope, (a, b), y, "DOP853", rtol=1e-12, atol=1e-13, args=(push, held), events=watched
        )
        y = made.y[:, -1]
        y[:4] /= np.linalg.norm(y[:4])
        found = zip(times, made.t_events, strict=True)
        times = [x if math.isfinite(x) or not t.size else float(t[0]) for x, t in found]
    return y[:4], y[4:7], y[7:10], times


class Errors(NamedTuple):
    """Largest differences from DOP853."""

    attitude: float
    speed: float
    time: float


def errors(slew: Slew, run: fa.Trajectory, wanted: list[Any]) -> Errors:
    """Of the first bodies of a run: rad, rad/s, s."""
    speeds = slew.wheels.speeds(run.s, run.w)[-1]
    return Errors(
        max(float(fa.angle_between(run.q[-1, k], x[0])) for k, x in enumerate(wanted)),
        max(float(np.abs(speeds[k] - x[2]).max()) for k, x in enumerate(wanted)),
        max(float(np.abs(run.event_times[k] - x[3]).max()) for k, x in enumerate(wanted)),
    )


def slews() -> None:
    """Print speed and differences of the slews."""
    columns = "controller, dt/s, run/s, M body-steps/s, attitude/rad, wheel/(rad/s), event/s"
    print(f"| {columns.replace(', ', ' | ')} |")
    print("| --- " * 7 + "|")
    for is_sampled in (False, True):
        slew = slew_of(BODIES, is_sampled=is_sampled)
        wanted = [truth(slew, body) for body in range(COMPARED)]
        slew_of(10, is_sampled=is_sampled).run(STEPS[0])  # which compiles the loop
        for dt in STEPS:
            begin = perf_counter()
            run = slew.run(dt)
            seconds = perf_counter() - begin
            apart = errors(slew, run, wanted)
            name = "every 0.5 s" if is_sampled else "at all times"
            speed = BODIES * END / dt / seconds / 1e6
            print(
                f"| {name} | {dt} | {seconds:.1f} | {speed:.1f} | {apart.attitude:.1e} | "
                f"{apart.speed:.1e} | {apart.time:.1e} |"
            )
        eclipse, settled = run.event_times.T
        share = np.mean(settled < eclipse)
        print(f"\n{share:.1%} settle before the eclipse at {eclipse[0]:.1f} s.", end=" ")
        print(f"Flags: {run.status_counts()}\n")


def differences(samples: int) -> None:
    """Print how far two solutions are from each other, at the samples."""
    exact = feedback.truth(feedback.SCENARIO, samples)
    mrps = {"method": "rk4", "representation": "mrp"}
    found = {
        "mpmath": (np.array([x.sigma for x in exact]), np.array([x.speeds for x in exact])),
        "`rk8`": feedback.craft().histories(samples, method="rk8"),
        "`rk4`, MRPs": feedback.craft().histories(samples, **mrps),
        "a sample late": feedback.craft(feedback.late).histories(
            samples, method="rk4", representation="mrp"
        ),
        "at all times": feedback.craft(is_sampled=False).histories(samples, method="rk8"),
    }
    pairs = [("`rk8`", "mpmath"), ("`rk4`, MRPs", "mpmath")]
    pairs += [("`rk8`", "a sample late"), ("`rk8`", "at all times")]
    if find_spec("Basilisk") is not None:
        found["Basilisk"] = BasiliskWheels(samples).histories()
        found["Basilisk, late"] = BasiliskWheels(samples, is_late=True).histories()
        pairs += [("Basilisk", "`rk4`, MRPs"), ("Basilisk", "mpmath")]
        pairs += [("Basilisk, late", "a sample late")]
    print("| compared | with | σ, largest | σ at the end | speeds, rad/s, largest |")
    print("| --- " * 5 + "|")
    for one, other in pairs:
        sigma, speeds = (np.abs(a - b) for a, b in zip(found[one], found[other], strict=True))
        figures = sigma.max(), sigma[-1].max(), speeds.max()
        print(f"| {one} | {other} | {' | '.join(f'{x:.1e}' for x in figures)} |")


def times(samples: int, bodies: int) -> None:
    """Print the times of both programs, and how far apart their ends are."""
    ours, common = feedback.craft(), {"dt": feedback.PERIOD, "n_steps": samples, "n_threads": 1}
    spent, ends = {}, {}
    for label, options in (
        ("`rk8`", {"method": "rk8"}),
        ("`rk4`", {"method": "rk4"}),
        ("`rk4`, MRPs", {"method": "rk4", "representation": "mrp"}),
    ):
        spent[label] = []
        for n in (1, bodies):
            plan, start = (
                fa.plan(ours.scene, n, **common, **options),
                ours.start(feedback.starts(n)),
            )
            run = plan(**start)
            spent[label].append(time_in_turns([partial(plan, **start)])[0].least)
        ends[label] = fa.quat_to_mrp(run.q[-1])
    if find_spec("Basilisk") is not None:
        theirs, each = BasiliskWheels(samples), list(zip(*feedback.starts(bodies), strict=True))
        theirs.run(*each[0])
        one = time_in_turns([partial(theirs.run, *each[0])])[0].least
        together, runs = once(lambda: [theirs.run(*start) for start in each])
        ends["Basilisk"] = np.reshape(runs, (-1, 3))
        spent["Basilisk"] = [one, together]
    print(f"\n| | one body, ms | {bodies} bodies, s | off `rk8` | off `rk4`, MRPs |")
    print("| --- " * 5 + "|")
    for label, (one, together) in spent.items():
        apart = (np.abs(ends[label] - ends[other]).max() for other in ("`rk8`", "`rk4`, MRPs"))
        figures = f"{1e3 * one:.2f} | {together:.2f} | {' | '.join(f'{x:.1e}' for x in apart)}"
        print(f"| {label} | {figures} |")


if __name__ == "__main__":
    differences(50 if SMALL else feedback.SAMPLES)
    times(50 if SMALL else feedback.SAMPLES, 20 if SMALL else 1000)
    print()
    slews()
