"""The leaderboard's problems: ensembles and a gyro log, each with an independent reference.

Coning is known in closed form; rigid bodies, free, on a point and in orbit, are integrated in
mpmath by the tests' oracle; the log is of a known smooth motion, with the spectrum of a recorded
one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from importlib.metadata import files
from pathlib import Path
from typing import Any

import equations
import numba
import numpy as np
import wheel_feedback

import fastatt as fa
from fastatt.gyro import GyroLog
from fastatt.trade.ensembles import coning_attitudes, coning_rates

N_BODIES, N_EXACT = 1024, 20
QUICK_BODIES, QUICK_EXACT = 64, 2
# a body of matter, and one from the literature
REAL = (1.2, 1.0, 2.0 / 3.0)
TRIAXIAL = (2.0, 1.0, 2.0 / 3.0)
TRIAXIAL_TOP = (1.0, 0.8, 0.5)
DEBRIS, MEAN_MOTION = (1000.0, 900.0, 300.0), 1.1e-3  # kg·m², rad/s
# weight times arm is 1 N·m
TOP = fa.Scene(inertia=(1.0, 1.0, 0.5), torque=fa.torques.HeavyTop((0.0, 0.0, 0.1), 10.0))
RECORDING = "walking_xsens_lowerLeg.txt"
ONE, MANY = "one", "many"
_DIGITS = 20
# references that took long to find, by what they belong to
_KNOWN = Path(__file__).parents[1] / "results" / "references"


@dataclass(frozen=True)
class Problem:
    """N bodies over ``t_end``; the attitudes at the end of the first of them are known.

    ``kind`` and ``parameters`` are those of ``equations``. ``growth``: error at the end, rad, over
    the relative error of the start. ``coning``: half angles and frequencies. ``sampled``: the rate
    is given at instants only. ``s0``: states beside attitude and rate, those of the wheels first;
    ``samples_of_control``: how often a torque is computed that is held in between.
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
    s0: np.ndarray | None = None
    samples_of_control: int = 0

    @property
    def n_exact(self) -> int:
        return len(self.truth)

    @cached_property
    def y0(self) -> np.ndarray:
        """States of ``equations`` at the start, (N, k)."""
        parts = [self.q0] if self.w0 is None else [self.q0, 0.5 * self.w0]
        if self.s0 is not None:
            parts.append(0.5 * self.s0[:, :3])
        return np.ascontiguousarray(np.concatenate(parts, axis=1))

    def parameters_of(self, k: int) -> np.ndarray:
        return self.parameters if self.parameters.ndim == 1 else self.parameters[k]

    @property
    def start(self) -> dict[str, np.ndarray]:
        """What a run of ours starts from, by the names of its arguments."""
        given = {"q0": self.q0, "w0": self.w0, "s0": self.s0}
        return {name: x for name, x in given.items() if x is not None}

    def of_body(self, k: int) -> tuple[fa.Scene, dict[str, np.ndarray]]:
        """Scene and start of body k alone."""
        start = {name: x[k] for name, x in self.start.items()}
        if self.coning is None:
            return self.scene, start
        return fa.Scene(rate=fa.rates.Coning(*(x[k] for x in self.coning))), start

    def samples(self, n: int) -> np.ndarray:
        """Rates (N, n + 1, 3) at equally spaced instants from 0 to ``t_end``."""
        return coning_rates(*self.coning, np.linspace(0.0, self.t_end, n + 1))

    def units(self, mode: str) -> int:
        """How many bodies a run covers."""
        return self.n_exact if mode == ONE else len(self.q0)

    def angles(self, q: np.ndarray) -> np.ndarray:
        """Those to the reference, rad, of each body."""
        return fa.angle_between(np.asarray(q[: self.n_exact], float), self.truth)


@dataclass(frozen=True)
class Log:
    """Samples of a gyro, and the attitudes at their instants."""

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

    def angles(self, q: np.ndarray) -> np.ndarray:
        """Those to the reference, rad, at each instant."""
        return fa.angle_between(np.asarray(q, float), self.truth)


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
        problem, name=f"{problem.name}-sampled", title=f"{problem.title}, sampled", sampled=True
    )


def _known(find: Callable[[], np.ndarray], *inputs: Any) -> np.ndarray:
    """What ``find`` gives, kept from run to run."""
    key = sha256(b"".join(np.asarray(x, float).tobytes() for x in inputs)).hexdigest()[:16]
    path = _KNOWN / f"{key}.npy"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, find())
    return np.load(path)


def _bodies(
    name: str,
    title: str,
    scene: fa.Scene,
    q0: np.ndarray,
    m0: np.ndarray,
    t_end: float,
    quick: bool,
    kind: str = equations.FREE,
) -> Problem:
    import rigid_oracle as oracle

    exact = min(_sizes(quick)[1], 8 if kind == equations.ORBIT else N_EXACT)  # 10 s each
    inertia = np.asarray(scene.inertia)
    w0, third = m0 / inertia, float(inertia[2])
    parameters, torque = {
        equations.FREE: lambda: (equations.of_body(inertia), None),
        equations.TOP: lambda: (
            equations.of_body(inertia, potential=True), oracle.heavy_top(10.0, (0.0, 0.0, 0.1)),
        ),
        equations.PUSHED: lambda: (
            equations.of_push(inertia),
            lambda t, q, w: (0, 0, oracle.functions_of(t).sin(t) ** 2 * third / 4),
        ),
        equations.ORBIT: lambda: (
            equations.of_orbit(inertia, MEAN_MOTION), oracle.gravity_gradient(inertia, MEAN_MOTION),
        ),
    }[kind]()  # fmt: skip

    def end(k: int, digits: int) -> list[float]:
        start = q0[k].tolist(), w0[k].tolist()
        state = oracle.integrate(inertia, *start, t_end, torque, digits=digits)
        return [float(x) for x in state.q]

    def ends() -> np.ndarray:
        return np.array([end(0, _DIGITS + 6)] + [end(k, _DIGITS) for k in range(exact)])

    better, *truth = _known(ends, parameters, q0[:exact], w0[:exact], t_end)
    truth = np.array(truth)
    check = max(1e-16, fa.angle_between(truth[0], better))
    starts = w0[:exact], w0[:exact] * (1.0 + 1e-7 * np.random.default_rng(5).normal(size=3))
    moved = fa.angle_between(*(
        fa.propagate(scene, q0[:exact], w, dt=t_end / 800, n_steps=800, method="rk8").q[-1]
        for w in starts
    ))  # fmt: skip
    return Problem(
        name=name,
        title=title,
        kind=kind,
        scene=scene,
        q0=q0,
        w0=w0,
        t_end=t_end,
        parameters=parameters,
        truth=truth,
        reference=f"mpmath with {_DIGITS} digits, with {_DIGITS + 6} it differs by {check:.0e} rad",
        growth=max(1.0, float(np.sqrt(np.mean(moved**2))) / 1e-7),
    )


def _aligned(n: int) -> np.ndarray:
    return np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))


def free_body(quick: bool, t_end: float = 10.0) -> Problem:
    """Momenta of size 1 in all directions."""
    n = _sizes(quick)[0]
    m0 = np.random.default_rng(1).normal(size=(n, 3))
    m0 /= np.linalg.norm(m0, axis=1, keepdims=True)
    scene = fa.Scene(inertia=REAL)
    name = "free" if t_end == 10.0 else "free-long"
    title = f"free triaxial body, {t_end:.0f} s"
    return _bodies(name, title, scene, _aligned(n), m0, t_end, quick)


def free_long(quick: bool) -> Problem:
    """The same for some sixteen turns."""
    return free_body(quick, 100.0)


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


def heavy_top(quick: bool, scene: fa.Scene = TOP) -> Problem:
    """Nutating tops, tilted by 0.3 to 1.2 rad, with a spin of 3 to 6 rad/s."""
    n = _sizes(quick)[0]
    generator = np.random.default_rng(2)
    turn, spin = generator.uniform(0.0, 2.0 * np.pi, (2, n))
    q0 = fa.euler313_to_quat(np.stack([turn, generator.uniform(0.3, 1.2, n), spin], axis=1))
    across = generator.normal(scale=0.3, size=(n, 2))
    w0 = np.column_stack([across, generator.uniform(3.0, 6.0, n)])
    m0 = w0 * np.asarray(scene.inertia)
    name, title = ("top", "symmetric") if scene is TOP else ("top-triaxial", "triaxial")
    return _bodies(name, f"heavy {title} top, 10 s", scene, q0, m0, 10.0, quick, equations.TOP)


def triaxial_top(quick: bool) -> Problem:
    """The same of bodies for which no closed form is known."""
    return heavy_top(quick, fa.Scene(inertia=TRIAXIAL_TOP, torque=TOP.torque))


@numba.njit
def _push(t, q, w, p):
    """0.25 sin² t of acceleration about an axis whose moment is 6."""
    s = math.sin(t)
    return 0.0, 0.0, 1.5 * s * s


def sciml(quick: bool) -> Problem:
    """SciMLBenchmarks' rigid body, whose attitude is asked for too; others start within a tenth."""
    n = _sizes(quick)[0]
    w0 = (1.0, 0.0, 0.9) * np.random.default_rng(8).uniform(0.9, 1.1, (n, 3))
    w0[0] = 1.0, 0.0, 0.9
    scene = fa.Scene(inertia=(1.0, 4.0, 6.0), torque=_push)
    title = "SciMLBenchmarks' rigid body, 10 s"
    m0 = w0 * np.asarray(scene.inertia)
    return _bodies("sciml", title, scene, _aligned(n), m0, 10.0, quick, equations.PUSHED)


def debris(quick: bool) -> Problem:
    """A defunct satellite, tumbling at 0.6 to 2.9 °/s about any axis, for an orbit of 7000 km."""
    n = _sizes(quick)[0]
    generator = np.random.default_rng(11)
    w0 = generator.normal(size=(n, 3))
    w0 *= generator.uniform(0.01, 0.05, (n, 1)) / np.linalg.norm(w0, axis=1, keepdims=True)
    scene = fa.Scene(inertia=DEBRIS, torque=fa.torques.GravityGradient(MEAN_MOTION))
    return _bodies(
        "debris", "tumbling debris, gravity gradient, an orbit of 5712 s", scene, _aligned(n),
        w0 * np.asarray(DEBRIS), 5712.0, quick, equations.ORBIT,
    )  # fmt: skip


def wheels(quick: bool) -> Problem:
    """Basilisk's ``scenarioAttitudeFeedbackRW``, and other starts."""
    n, exact = _sizes(quick)
    exact, samples = min(exact, 4), 60 if quick else wheel_feedback.SAMPLES
    craft, start = wheel_feedback.craft(), wheel_feedback.starts(n)

    def end(k: int, digits: int) -> np.ndarray:
        one = wheel_feedback.Start(*(x[k] for x in start))
        return fa.mrp_to_quat(wheel_feedback.truth(one, samples, digits)[-1].sigma)

    def ends() -> np.ndarray:
        return np.array([end(0, _DIGITS + 6)] + [end(k, _DIGITS) for k in range(exact)])

    t_end = samples * wheel_feedback.PERIOD
    better, *truth = _known(ends, *(x[:exact] for x in start), t_end)
    check = max(1e-16, fa.angle_between(truth[0], better))
    return Problem(
        name="wheels",
        title=f"three wheels, torques sampled at 10 Hz, {t_end:.0f} s",
        kind=equations.WHEELS,
        scene=craft.scene,
        t_end=t_end,
        parameters=equations.of_wheels(np.array(wheel_feedback.HUB) - wheel_feedback.WHEEL),
        truth=np.array(truth),
        reference=f"mpmath with {_DIGITS} digits, with {_DIGITS + 6} it differs by {check:.0e} rad",
        samples_of_control=samples,
        **craft.start(start),
    )


def recording(name: str) -> Path:
    """A gyro log that scikit-kinematics installs."""
    path = next(f for f in files("scikit-kinematics") if f.match(f"tests/data/{name}"))
    return Path(path.locate())


def recorded(name: str) -> GyroLog:
    """Its samples, in rad/s, which the files do not say."""
    return fa.read_gyro_log(recording(name), unit="rad/s")


def _from_the_maker() -> str:
    """The methods' largest angles from the attitudes of a maker's filter, on its recording."""
    log = recorded("data_xsens.txt")
    maker = np.genfromtxt(recording("data_xsens.txt"), skip_header=5)[:, -4:]
    angles = []
    for method in ("trapezoid", "previous", "coning2"):
        q = fa.integrate_rates(log.rates, log.dt, maker[0], method=method)
        angles.append(fa.angle_between(q, maker).max())
    least, most = np.degrees([min(angles), max(angles)])
    return f"the methods are {least:.0f} to {most:.0f}° from a maker's filter on another recording"


def gyro_log(quick: bool) -> Log:
    """A leg of a walker, 120 Hz, its harmonics above the noise, each at another phase.

    Noise is what the highest tenth of frequencies has. The three axes keep their phases to each
    other, which are what coning is.
    """
    from scipy.integrate import solve_ivp

    log = recorded(RECORDING)
    rates, h = log.rates[: 201 if quick else None], float(np.mean(log.dt))
    n = len(rates)
    t = h * np.arange(n)
    waves = np.fft.rfft(rates, axis=0) / n
    power = np.abs(waves) ** 2
    floor = np.mean(power[-len(power) // 10 :], axis=0)
    waves *= np.sqrt(np.maximum(0.0, 1.0 - floor / np.maximum(power, floor)))
    generator = np.random.default_rng(9)
    waves[1:] *= 2.0 * np.exp(2j * np.pi * generator.uniform(size=(len(waves) - 1, 1)))
    circles = 2j * np.pi * np.fft.rfftfreq(n, h)

    def rate(t: float) -> np.ndarray:
        return (np.exp(circles * t) @ waves).real

    def attitudes() -> np.ndarray:
        return solve_ivp(
            lambda t, q: equations.turn(q, *(0.5 * rate(t))), (0.0, t[-1]), [1.0, 0.0, 0.0, 0.0],
            "DOP853", t_eval=t, rtol=1e-10, atol=1e-10, max_step=h,
        ).y.T  # fmt: skip

    clean = np.array([rate(x) for x in t])
    noisy = clean + np.sqrt(n * floor) * generator.normal(size=clean.shape)
    ends = (fa.integrate_rates(x, h, method="trapezoid") for x in (clean, noisy))
    apart = fa.angle_between(*ends)
    return Log(
        name="log",
        title=f"simulated gyro, spectrum of a walking leg, {1.0 / h:.0f} Hz, {t[-1]:.0f} s",
        rates=clean,
        dt=h,
        truth=_known(attitudes, rates, h),
        reference="DOP853 at 1e-10 on the sum of harmonics; white noise of the recording's level, "
        f"left out here, would add {np.sqrt(np.mean(apart**2)):.0e} rad to every method; "
        f"{_from_the_maker()}, which does not distinguish them",
    )


PROBLEMS = {
    "coning-small": coning_small,
    "coning-large": coning_large,
    "coning-small-sampled": lambda quick: _sampled(coning_small(quick)),
    "coning-large-sampled": lambda quick: _sampled(coning_large(quick)),
    "free": free_body,
    "free-long": free_long,
    "dzhanibekov": dzhanibekov,
    "separatrix": near_separatrix,
    "top": heavy_top,
    "top-triaxial": triaxial_top,
    "sciml": sciml,
    "debris": debris,
    "wheels": wheels,
    "log": gyro_log,
}
