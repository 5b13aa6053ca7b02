"""The leaderboard's problems: ensembles and a recording, each with an independent reference.

Coning is known in closed form; rigid bodies are integrated in mpmath by the tests' oracle; of a
recording no truth exists: what is known is how far half of its samples lead from all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equations
import numpy as np

import fastatt as fa
from fastatt.trade import coning_attitudes, coning_rates, find_recordings

N_BODIES, N_EXACT = 1024, 8
QUICK_BODIES, QUICK_EXACT = 64, 2
TRIAXIAL = (2.0, 1.0, 2.0 / 3.0)
# weight times arm is 1 N·m
TOP = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0.0, 0.0, 0.1), 10.0))
RECORDING = "walking_xsens_lowerLeg.txt"
ONE, MANY = "one", "many"
_DIGITS = 20


@dataclass(frozen=True)
class Problem:
    """N bodies over ``t_end``; the attitudes at the end of the first of them are known.

    ``kind`` and ``parameters`` are those of ``equations``. ``growth``: error at the end, rad, over
    the relative error of the start. ``coning``: half angles and frequencies. ``sampled``: the rate
    is given at instants only.
    """

    name: str
    title: str
    kind: str
    scene: fa.Scene
    q0: np.ndarray
    w0: np.ndarray | None
    t_end: float
    parameters: np.ndarray
    truth: np.ndarray
    reference: str
    growth: float = 1.0
    coning: tuple[np.ndarray, np.ndarray] | None = None
    sampled: bool = False

    @property
    def n_exact(self) -> int:
        return len(self.truth)

    @cached_property
    def y0(self) -> np.ndarray:
        """States of ``equations`` at the start, (N, k)."""
        parts = [self.q0] if self.w0 is None else [self.q0, 0.5 * self.w0]
        return np.ascontiguousarray(np.concatenate(parts, axis=1))

    def parameters_of(self, k: int) -> np.ndarray:
        return self.parameters if self.parameters.ndim == 1 else self.parameters[k]

    def of_body(self, k: int) -> dict[str, Any]:
        """Scene and start of body k alone, as arguments of ``fa.propagate``."""
        if self.coning is None:
            return {"scene": self.scene, "q0": self.q0[k], "w0": self.w0[k]}
        angle, frequency = (x[k] for x in self.coning)
        return {"scene": fa.Scene(rate=fa.rates.Coning(angle, frequency)), "q0": self.q0[k]}

    def samples(self, n: int) -> np.ndarray:
        """Rates (N, n + 1, 3) at equally spaced instants from 0 to ``t_end``."""
        return coning_rates(*self.coning, np.linspace(0.0, self.t_end, n + 1))

    def units(self, mode: str) -> int:
        """How many bodies a run covers."""
        return self.n_exact if mode == ONE else len(self.q0)

    def error(self, q: np.ndarray) -> float:
        """Root mean square of the angles to the reference, rad."""
        angle = fa.angle_between(np.asarray(q[: self.n_exact], float), self.truth)
        return float(np.sqrt(np.mean(angle**2)))


@dataclass(frozen=True)
class Log:
    """Every second sample of a recording, and the attitudes that all samples lead to."""

    name: str
    title: str
    rates: np.ndarray
    dt: float
    truth: np.ndarray
    reference: str

    def units(self, mode: str) -> int:
        """How many intervals a run covers."""
        del mode
        return len(self.rates) - 1

    def error(self, q: np.ndarray) -> float:
        """Root mean square over time of the angles to the reference, rad."""
        angle = fa.angle_between(np.asarray(q, float), self.truth)
        return float(np.sqrt(np.mean(angle**2)))


def _sizes(quick: bool) -> tuple[int, int]:
    return (QUICK_BODIES, QUICK_EXACT) if quick else (N_BODIES, N_EXACT)


def _coning(name: str, title: str, angle: float, frequency: float, t_end: float, quick: bool):
    """Angles and frequencies within a tenth of those given, which the first body has."""
    n, exact = _sizes(quick)
    factors = np.random.default_rng(4).uniform(0.9, 1.1, (2, n))
    factors[:, 0] = 1.0
    angles, frequencies = angle * factors[0], frequency * factors[1]
    ends = coning_attitudes(angles[:exact], frequencies[:exact], np.array([0.0, t_end]))
    return Problem(
        name=name,
        title=title,
        kind=equations.CONING,
        scene=fa.Scene(rate=fa.rates.Coning(angles, frequencies)),
        q0=coning_attitudes(angles, frequencies, np.zeros(1))[0],
        w0=None,
        t_end=t_end,
        parameters=equations.of_coning(angles, frequencies),
        truth=ends[1],
        reference="closed form, 1e-15 rad",
        coning=(angles, frequencies),
    )


def coning_small(quick: bool) -> Problem:
    return _coning("coning-small", "coning, 1°, 2 Hz, 4 s", np.pi / 180.0, 4.0 * np.pi, 4.0, quick)


def coning_large(quick: bool) -> Problem:
    return _coning("coning-large", "coning, 1 rad, 1 rad/s, 10 s", 1.0, 1.0, 10.0, quick)


def _sampled(problem: Problem) -> Problem:
    return replace(
        problem,
        name=f"{problem.name}-sampled",
        title=f"{problem.title}, sampled",
        sampled=True,
    )


def _bodies(
    name: str,
    title: str,
    scene: fa.Scene,
    q0: np.ndarray,
    m0: np.ndarray,
    t_end: float,
    quick: bool,
) -> Problem:
    import rigid_oracle as oracle

    exact = _sizes(quick)[1]
    inertia = np.asarray(scene.inertia)
    w0 = m0 / inertia
    falls = scene.torque is not None
    torque = oracle.heavy_top(10.0, (0.0, 0.0, 0.1)) if falls else None

    def end(k: int, digits: int) -> list[float]:
        start = q0[k].tolist(), w0[k].tolist()
        state = oracle.integrate(inertia, *start, t_end, torque, digits=digits, step=1.0)
        return [float(x) for x in state.q]

    truth = np.array([end(k, _DIGITS) for k in range(exact)])
    check = fa.angle_between(truth[0], np.array(end(0, _DIGITS + 6)))
    starts = w0[:exact], w0[:exact] * (1.0 + 1e-7 * np.random.default_rng(5).normal(size=3))
    if falls:
        ends = [
            fa.propagate(scene, q0[:exact], w, dt=t_end / 400, n_steps=400, method="rk8").q[-1]
            for w in starts
        ]
    else:
        ends = [fa.exact.free_body(q0[:exact], w, inertia, t_end)[0] for w in starts]
    moved = fa.angle_between(*ends)
    return Problem(
        name=name,
        title=title,
        kind=equations.TOP if falls else equations.FREE,
        scene=scene,
        q0=q0,
        w0=w0,
        t_end=t_end,
        parameters=equations.of_body(inertia, potential=falls),
        truth=truth,
        reference=f"mpmath with {_DIGITS} digits, with {_DIGITS + 6} it differs by {check:.0e} rad",
        growth=max(1.0, float(np.sqrt(np.mean(moved**2))) / 1e-7),
    )


def _aligned(n: int) -> np.ndarray:
    return np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))


def free_body(quick: bool) -> Problem:
    """Momenta of size 1 in all directions."""
    n = _sizes(quick)[0]
    m0 = np.random.default_rng(1).normal(size=(n, 3))
    m0 /= np.linalg.norm(m0, axis=1, keepdims=True)
    scene = fa.Scene(inertia=TRIAXIAL)
    return _bodies("free", "free triaxial body, 10 s", scene, _aligned(n), m0, 10.0, quick)


def dzhanibekov(quick: bool) -> Problem:
    """About the intermediate axis, tipped by 1e-4: a flip at 20.5 s, the next about to begin."""
    n = _sizes(quick)[0]
    tip = 1e-4 * np.random.default_rng(6).uniform(0.9, 1.1, n)
    tip[0] = 1e-4
    m0 = np.stack([np.sin(tip), np.cos(tip), 0.0 * tip], axis=1)
    scene = fa.Scene(inertia=TRIAXIAL)
    return _bodies(
        "dzhanibekov", "Dzhanibekov flip, tipped 1e-4, 41 s", scene, _aligned(n), m0, 41.0, quick
    )


def near_separatrix(quick: bool) -> Problem:
    """From the middle of the separatrix, 1e-6 rad beside it, and past the saddle."""
    n = _sizes(quick)[0]
    beside = 1e-6 * np.random.default_rng(7).uniform(0.9, 1.1, n)
    beside[0] = 1e-6
    angle = 0.25 * np.pi + beside
    m0 = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
    scene = fa.Scene(inertia=TRIAXIAL)
    return _bodies(
        "separatrix", "near the separatrix, 1e-6 rad, 20 s", scene, _aligned(n), m0, 20.0,
        quick,
    )  # fmt: skip


def heavy_top(quick: bool) -> Problem:
    """Nutating tops, tilted by 0.3 to 1.2 rad, with a spin of 3 to 6 rad/s."""
    n = _sizes(quick)[0]
    generator = np.random.default_rng(2)
    turn, spin = generator.uniform(0.0, 2.0 * np.pi, (2, n))
    q0 = fa.euler313_to_quat(np.stack([turn, generator.uniform(0.3, 1.2, n), spin], axis=1))
    across = generator.normal(scale=0.3, size=(n, 2))
    w0 = np.column_stack([across, generator.uniform(3.0, 6.0, n)])
    m0 = w0 * np.asarray(TOP.inertia)
    return _bodies("top", "heavy symmetric top, 10 s", TOP, q0, m0, 10.0, quick)


def gyro_log(quick: bool) -> Log:
    """A leg of a walker, 120 Hz: half of the samples are given, all of them are the reference.

    The reference turns with the cubic spline through all samples.
    """
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicSpline

    path = next(p for p in find_recordings() if p.name == RECORDING)
    log = fa.read_log(path, unit="rad/s")
    n = 201 if quick else (len(log.rates) - 1) // 2 * 2 + 1
    rates, h = log.rates[:n], float(np.mean(log.dt))
    t = h * np.arange(n)
    spline = CubicSpline(t, 0.5 * rates)

    def slope(t: float, q: np.ndarray) -> tuple:
        return equations.turn(q, *spline(t))

    start, span = [1.0, 0.0, 0.0, 0.0], (0.0, t[-1])
    full = solve_ivp(slope, span, start, "DOP853", t_eval=t, rtol=1e-10, atol=1e-10, max_step=h).y.T
    other = fa.integrate_rates(rates, h, method="previous")
    apart = np.sqrt(np.mean(fa.angle_between(other, full) ** 2))
    return Log(
        name="log",
        title=f"gyro log of a walking leg, {0.5 / h:.0f} Hz, {t[-1]:.0f} s",
        rates=np.ascontiguousarray(rates[::2]),
        dt=2.0 * h,
        truth=full[::2],
        reference="the cubic spline through twice as many samples; fastatt's previous on those "
        f"differs from it by {apart:.0e} rad",
    )


PROBLEMS = {
    "coning-small": coning_small,
    "coning-large": coning_large,
    "coning-small-sampled": lambda quick: _sampled(coning_small(quick)),
    "coning-large-sampled": lambda quick: _sampled(coning_large(quick)),
    "free": free_body,
    "dzhanibekov": dzhanibekov,
    "separatrix": near_separatrix,
    "top": heavy_top,
    "log": gyro_log,
}
