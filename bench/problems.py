"""What every bench measures beside its time: an ensemble with a known answer, and its peers."""

from __future__ import annotations

import numpy as np

import fastatt as fa
from fastatt.trade.ensembles import coning_attitudes

T_END = 10.0


class Coning:
    """N coning bodies, angle and frequency per body."""

    def __init__(self, n_bodies: int) -> None:
        generator = np.random.default_rng(3)
        self.angle = generator.uniform(0.2, 1.5, n_bodies)
        self.frequency = generator.uniform(0.5, 2.0, n_bodies)
        self.scene = fa.Scene(rate=fa.rates.Coning(self.angle, self.frequency))
        self.q0 = self.exact(0.0)

    def exact(self, t: float) -> np.ndarray:
        return coning_attitudes(self.angle, self.frequency, np.array([t]))[0]

    def error(self, q: np.ndarray, t: float) -> float:
        return float(np.median(fa.angle_between(q, self.exact(t))))


def numpy_rk4(problem: Coning, n_steps: int) -> np.ndarray:
    """RK4 on quaternions in plain numpy, vectorised over the bodies."""
    sine, cosine = np.sin(problem.angle), np.sin(0.5 * problem.angle)
    f = problem.frequency

    def derivative(t: float, q: np.ndarray) -> np.ndarray:
        x, y, z = -f * sine * np.sin(f * t), f * sine * np.cos(f * t), -2.0 * f * cosine**2
        a, b, c, d = q.T
        return 0.5 * np.stack(
            [
                -b * x - c * y - d * z,
                a * x + c * z - d * y,
                a * y - b * z + d * x,
                a * z + b * y - c * x,
            ],
            axis=1,
        )

    h, q = T_END / n_steps, problem.q0
    for n in range(n_steps):
        t = n * h
        k1 = derivative(t, q)
        k2 = derivative(t + 0.5 * h, q + 0.5 * h * k1)
        k3 = derivative(t + 0.5 * h, q + 0.5 * h * k2)
        k4 = derivative(t + h, q + h * k3)
        q = q + (h / 6.0) * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return q
