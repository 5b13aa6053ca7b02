"""Basilisk's ``scenarioAttitudeFeedbackRW`` rebuilt: a hub with three wheels, feedback of MRPs.

    python bench/wheel_feedback.py    # three minutes, most of them Basilisk's thousand bodies

Every 0.1 s a torque is computed from the attitude and the angular velocity, and the motors exert
it, as far as they can, until the next sample. The first table tells how far two solutions are from
each other over 10 minutes, at the samples: modified Rodrigues parameters σ and the speeds of the
wheels. The second has times on one core and, of a thousand bodies with other starts, the largest
difference of σ at the end from ``rk8`` and from ``rk4`` on MRPs, which Basilisk takes too. Basilisk
takes part where it is installed. Gravity exerts no torque on the hub and is left out.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import mpmath as mp
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import rigid_oracle as oracle

import fastatt as fa
from fastatt.kernels import mrp
from fastatt.trade.measure import best_time

SAMPLES, PERIOD = 6000, 0.1  # s
RPM = math.pi / 30.0
HUB = (900.0, 800.0, 600.0)  # kg·m², wheels included
#: Honeywell HR16 of 50 N·m·s at 6000 rpm: rad/s, N·m
LARGEST_SPEED, LARGEST_TORQUE = 6000.0 * RPM, 0.2
WHEEL = 50.0 / LARGEST_SPEED
STIFFNESS, DAMPING = 3.5, 30.0  # N·m, N·m·s


class Start(NamedTuple):
    """σ, angular velocity along body axes, rad/s, and speeds of the wheels, rad/s."""

    sigma: Any
    w: Any
    speeds: Any


SCENARIO = Start((0.1, 0.2, -0.3), (0.001, -0.01, 0.03), (100.0 * RPM, 200.0 * RPM, 300.0 * RPM))


def starts(n: int) -> Start:
    """Those of n bodies, attitudes in all directions; the first is the scenario's."""
    rng = np.random.default_rng(10)
    sigma = rng.normal(size=(n, 3))
    sigma *= rng.uniform(0.0, 1.0, (n, 1)) / np.linalg.norm(sigma, axis=1, keepdims=True)
    w, speeds = rng.normal(0.0, 0.01, (n, 3)), rng.normal(0.0, 200.0 * RPM, (n, 3))
    for drawn, first in zip((sigma, w, speeds), SCENARIO, strict=True):
        drawn[0] = first
    return Start(sigma, w, speeds)


def feedback(t, q, w, p):
    """Torque on the body: −K σ − P w."""
    return tuple(-p[0] * x - p[1] * v for x, v in zip(mrp.from_quat(q), w, strict=True))


def late(t, q, w, s, p):
    """The same, a sample later: the memory is the torque that was computed before."""
    return s, feedback(t, q, w, p)


class Craft(NamedTuple):
    """A scene with its wheels; ``extra`` states follow the momenta of the wheels."""

    scene: fa.Scene
    wheels: Any
    extra: int

    def start(self, start: Start) -> dict[str, Any]:
        """``q0``, ``w0`` and ``s0`` of a run."""
        momenta = self.wheels.momenta(start.speeds, start.w)
        more = np.zeros((*momenta.shape[:-1], self.extra))
        s0 = np.concatenate([momenta, more], axis=-1)
        return {"q0": fa.mrp_to_quat(start.sigma), "w0": np.asarray(start.w), "s0": s0}

    def run(self, samples: int = SAMPLES, **options: Any) -> fa.Trajectory:
        """The scenario, saved at every sample."""
        return fa.propagate(
            self.scene, **self.start(SCENARIO), dt=PERIOD, n_steps=samples, save_every=1, **options
        )

    def histories(self, samples: int, **options: Any) -> tuple[np.ndarray, np.ndarray]:
        """σ and the speeds of the wheels at every sample."""
        run = self.run(samples, **options)
        return fa.quat_to_mrp(run.q), self.wheels.speeds(run.s, run.w)


def craft(control: Callable[..., Any] = feedback, *, is_sampled: bool = True) -> Craft:
    """The spacecraft of the scenario."""
    gains, memory = (STIFFNESS, DAMPING), 3 if control is late else 0
    law = fa.torques.Custom(control, gains)
    if is_sampled:
        law = fa.torques.SampledControl(control, PERIOD, gains, states=memory)
    wheels = fa.torques.ReactionWheels(
        np.eye(3), WHEEL, law, max_torque=LARGEST_TORQUE, max_speed=LARGEST_SPEED
    )
    scene = fa.Scene(inertia=wheels.body_inertia(HUB), torque=wheels)
    return Craft(scene, wheels, 3 + memory if is_sampled else 0)


def truth(start: Start, samples: int, digits: int = 20) -> list[Start]:
    """The state at every sample, from the start on, in mpmath.

    Between samples the momentum of a wheel is a line, so that the body is one under a torque.
    """
    body = [x - WHEEL for x in HUB]
    found = []
    with mp.workdps(digits + 12):
        sigma, w, speeds = ([mp.mpf(float(x)) for x in v] for v in start)
        period, wheel, square = mp.mpf(PERIOD), mp.mpf(WHEEL), sum(x * x for x in sigma)
        q = [(1 - square) / (1 + square), *(2 * x / (1 + square) for x in sigma)]
        h = [wheel * (x + v) for x, v in zip(speeds, w, strict=True)]
        for _ in range(samples):
            found.append(_state(q, w, h))
            wanted = [STIFFNESS * x + DAMPING * v for x, v in zip(_mrp(q), w, strict=True)]
            u = [min(max(x, -LARGEST_TORQUE), LARGEST_TORQUE) for x in wanted]
            reaction = _reaction(h, u, digits)
            q, w = oracle.integrate(body, q, w, period, reaction, digits)[:2]
            h = [x + period * y for x, y in zip(h, u, strict=True)]
        return [*found, _state(q, w, h)]


def _mrp(q: Any) -> list[Any]:
    factor = mp.sign(q[0]) / (1 + abs(q[0]))
    return [factor * x for x in q[1:]]


def _state(q: Any, w: Any, h: Any) -> Start:
    speeds = [x / WHEEL - v for x, v in zip(h, w, strict=True)]
    return Start(*(np.array([float(x) for x in v]) for v in (_mrp(q), w, speeds)))


def _reaction(h: Any, u: Any, digits: int) -> Callable[..., Any]:
    """Torque on the body of wheels with momenta h + u t: (h + u t)×w − u."""
    with oracle.many_digits(digits + 12):
        h, u = ([oracle.to_gmpy2(x) for x in v] for v in (h, u))

    def torque(t, q, w):
        inside = [x + t * y for x, y in zip(h, u, strict=True)]
        return [x - y for x, y in zip(oracle.cross(inside, w), u, strict=True)]

    return torque


def differences(samples: int) -> None:
    """Print the first table."""
    exact = truth(SCENARIO, samples)
    found = {
        "mpmath": (np.array([x.sigma for x in exact]), np.array([x.speeds for x in exact])),
        "`rk8`": craft().histories(samples, method="rk8"),
        "`rk4`, MRPs": craft().histories(samples, method="rk4", representation="mrp"),
        "a sample late": craft(late).histories(samples, method="rk4", representation="mrp"),
        "at all times": craft(is_sampled=False).histories(samples, method="rk8"),
    }
    pairs = [("`rk8`", "mpmath"), ("`rk4`, MRPs", "mpmath")]
    pairs += [("`rk8`", "a sample late"), ("`rk8`", "at all times")]
    if find_spec("Basilisk") is not None:
        from peers_wheels import BasiliskWheels

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
    """Print the second table."""
    ours, common = craft(), {"dt": PERIOD, "n_steps": samples, "n_threads": 1}
    spent, ends = {}, {}
    for label, options in (
        ("`rk8`", {"method": "rk8"}),
        ("`rk4`", {"method": "rk4"}),
        ("`rk4`, MRPs", {"method": "rk4", "representation": "mrp"}),
    ):
        spent[label] = []
        for n in (1, bodies):
            plan, start = fa.plan(ours.scene, n, **common, **options), ours.start(starts(n))
            plan(**start)
            seconds, run = best_time(lambda plan=plan, start=start: plan(**start), 5)
            spent[label].append(seconds)
        ends[label] = fa.quat_to_mrp(run.q[-1])
    if find_spec("Basilisk") is not None:
        from peers_wheels import BasiliskWheels

        theirs, each = BasiliskWheels(samples), list(zip(*starts(bodies), strict=True))
        one, _ = best_time(lambda: theirs.run(*each[0]), 5)
        begin = perf_counter()
        ends["Basilisk"] = np.reshape([theirs.run(*start) for start in each], (-1, 3))
        spent["Basilisk"] = [one, perf_counter() - begin]
    print(f"\n| | one body, ms | {bodies} bodies, s | off `rk8` | off `rk4`, MRPs |")
    print("| --- " * 5 + "|")
    for label, (one, together) in spent.items():
        apart = (np.abs(ends[label] - ends[other]).max() for other in ("`rk8`", "`rk4`, MRPs"))
        figures = f"{1e3 * one:.2f} | {together:.2f} | {' | '.join(f'{x:.1e}' for x in apart)}"
        print(f"| {label} | {figures} |")


if __name__ == "__main__":
    smoke = bool(os.environ.get("FASTATT_SMOKE"))
    differences(50 if smoke else SAMPLES)
    times(50 if smoke else SAMPLES, 20 if smoke else 1000)
