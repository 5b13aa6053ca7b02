"""Basilisk's ``scenarioAttitudeFeedbackRW`` rebuilt: a hub with three wheels, feedback of MRPs.

Every 0.1 s a torque is computed from the attitude and the angular velocity, and the motors exert
it, as far as they can, until the next sample. Gravity exerts no torque on the hub and is left out.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mpmath as mp
import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import rigid_oracle as oracle

import fastatt as fa
from fastatt.kernels import mrp

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
