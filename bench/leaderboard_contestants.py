"""The leaderboard's contestants: fastatt and the libraries that a user would pick instead.

Each has a ladder of settings from coarse to fine, for bodies one at a time (a call each) and, where
the library takes ensembles, for all at once. What can be prepared beforehand is prepared for all.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import equations
import leaderboard_solvers as solvers
import leaderboard_wheels as wheels
import numba
import numpy as np
from leaderboard_problems import MANY, ONE, Log, Problem
from leaderboard_solvers import PYTHON, QUICK, Contestant, Run, at_tolerance, tolerances

import fastatt as fa
from fastatt.gyro.integrate import methods_for_samples
from fastatt.kernels import free_body, heavy_top
from fastatt.propagation.choice_of_method import methods_for
from fastatt.propagation.inspect_step import job_of

OURS = "fastatt"
_STEPS = [round(8 * 2 ** (k / 2)) for k in range(18)]
_INTERVALS = [round(12 * 2 ** (k / 2)) for k in range(15)]
# what is worth its compilation in single precision: short calls for errors of 1e-3 to 1e-6
_SINGLE = ("magnus4", "magnus6", "cf4", "rk8", "exact", "trapezoid", "previous", "coning2")


# fastatt


def _ours(problem: Problem, quick: bool) -> Iterator[Contestant]:
    names = methods_for_samples() if problem.sampled else methods_for(problem.scene, "quat")
    # the closed form and high orders first: lower ones need not be refined beyond their times
    for name in sorted(names, key=lambda name: -(fa.METHODS[name].order or math.inf)):
        if quick and name not in QUICK["methods"][problem.kind]:
            continue
        for dtype in ("float64", "float32") if name in _SINGLE and not quick else ("float64",):
            label = name if dtype == "float64" else f"{name} float32"
            if problem.sampled:
                ladder = _our_samples(problem, name, dtype, quick)
            else:
                ladder = our_plans(problem, name, dtype, _our_steps(problem, quick))
            yield Contestant(OURS, label, ladder)


def _our_steps(problem: Problem, quick: bool) -> list[int]:
    """Steps end at the samples of a controller: fewer there cannot be, and more need not."""
    if problem.samples_of_control:
        return [problem.samples_of_control]
    return QUICK["steps"] if quick else _STEPS


def our_loop(problem: Problem, name: str, quick: bool) -> Contestant:
    """``fa.single_step``, or the closed form's kernels, in a user's ``@njit`` loop, a call a body.

    It is worth its compilation for methods that lead elsewhere.
    """
    closed = name == "exact"
    run = _closed_loop(problem) if closed else _stepped_loop(problem, name)
    rows = range(problem.n_exact)
    starts = [tuple(problem.q0[k].tolist()) for k in rows]
    rates = [() if problem.w0 is None else tuple(problem.w0[k].tolist()) for k in rows]
    if closed:
        own = [tuple(np.asarray(problem.scene.inertia).tolist())] * len(rows)
    else:
        params = fa.single_step(problem.scene, method=name).params
        own = [params if isinstance(params, tuple) else params[k] for k in rows]

    def ladder(mode: str) -> Iterator[Run]:
        for n in (1,) if closed else QUICK["steps"] if quick else _STEPS:

            def call(n=n) -> list[np.ndarray]:
                bodies = zip(starts, rates, own, strict=True)
                return [run(q, w, problem.t_end, n, p) for q, w, p in bodies]

            if mode == ONE:
                yield Run(_setting(name, n), call, np.asarray, work=_work(problem, name, n))

    return Contestant(OURS, f"{name} in a loop", ladder)


def _stepped_loop(problem: Problem, name: str) -> Callable[..., Any]:
    stepper = fa.single_step(problem.scene, method=name)
    start, enter, advance = stepper.start, stepper.enter, stepper.advance
    leave, read = stepper.leave, stepper.read

    @numba.njit
    def run(q, w, t_end, n, p):
        h = t_end / n
        y, e = enter(0.0, h, start(q, w, p), p)
        for i in range(n):
            y = advance(i * h, h, y, p, e)
        return read(leave(t_end, t_end, h, y, p, e), p)[0]

    return run


def _closed_loop(problem: Problem) -> Callable[..., Any]:
    if problem.kind == equations.TOP:
        begin, evaluate = heavy_top.setup, heavy_top.evaluate
        torque = problem.scene.torque
        pull = (0.0, 0.0, torque.weight * torque.arm[2])

        @numba.njit
        def setup(q, w, p):
            return begin(q, w, p, pull)
    else:
        setup, evaluate = free_body.setup_rate, free_body.evaluate

    @numba.njit
    def run(q, w, t_end, n, p):
        return evaluate(setup(q, w, p), n * t_end)[0]

    return run


def _setting(name: str, n: int) -> str:
    return "closed form" if name == "exact" else f"{n} steps"


def _work(problem: Problem, name: str, n: int) -> Callable[[], float]:
    """Operations of a body in n steps; none are counted where the number has no meaning."""
    if name == "exact":
        return lambda: 0.0
    return lambda: float(n * job_of(problem.scene, name, "quat", "float64").operations)


def our_plans(problem: Problem, name: str, dtype: str, numbers: Iterable[int]):
    """``fa.plan`` beforehand, and a call of it."""
    options = {"method": name, "dtype": dtype, "n_threads": 1}
    closed = name == "exact"

    def ladder(mode: str) -> Iterator[Run]:
        for n in (1,) if closed else numbers:
            options.update(dt=problem.t_end / n, n_steps=n)
            if mode == MANY:
                plan = fa.plan(problem.scene, len(problem.q0), **options)
                start = {key: x.astype(dtype) for key, x in problem.start.items()}

                def call(plan=plan, start=start) -> np.ndarray:
                    return plan(**start).q[-1]
            else:
                bodies = [problem.of_body(k) for k in range(problem.n_exact)]
                plans = [(fa.plan(scene, 1, **options), start) for scene, start in bodies]

                def call(plans=plans) -> list[np.ndarray]:
                    return [plan(**start).q[-1] for plan, start in plans]

            yield Run(_setting(name, n), call, np.asarray, work=_work(problem, name, n))

    return ladder


def _our_samples(problem: Problem, name: str, dtype: str, quick: bool):
    def ladder(mode: str) -> Iterator[Run]:
        bodies = problem.units(mode)
        for n in QUICK["intervals"] if quick else _INTERVALS:
            data = problem.samples(n)[:bodies].astype(dtype)
            q0, h = problem.q0[:bodies], problem.t_end / n
            out = np.empty((bodies, n + 1, 4), dtype=dtype)

            def call(data=data, q0=q0, h=h, out=out) -> np.ndarray:
                return fa.integrate_rates(data, h, q0, method=name, n_threads=1, out=out)

            def calls(data=data, q0=q0, h=h, out=out) -> np.ndarray:
                for k in range(bodies):
                    fa.integrate_rates(data[k], h, q0[k], method=name, n_threads=1, out=out[k])
                return out

            yield Run(f"{n} intervals", calls if mode == ONE else call, _last)

    return ladder


def _last(q: np.ndarray) -> np.ndarray:
    return q[:, -1]


# libraries of attitudes


def _numpy_quaternion(problem: Problem, quick: bool) -> Iterator[Contestant]:
    """``integrate_angular_velocity`` turns at rates in inertial axes.

    Coning, given in body axes, turns the conjugate at the opposite rate.
    """
    import quaternion

    if problem.kind != equations.CONING:
        return

    def body(k: int, tol: float) -> np.ndarray:
        size, frequency, along = problem.parameters_of(k).tolist()

        def reversed_rate(t):
            s, c = math.sin(frequency * t), math.cos(frequency * t)
            return 2.0 * size * s, -2.0 * size * c, 2.0 * along

        start = quaternion.quaternion(*problem.q0[k]).conj()
        with warnings.catch_warnings():
            _, q = quaternion.integrate_angular_velocity(
                reversed_rate, 0.0, problem.t_end, start, tol
            )
        return q[-1].conj().components

    def ladder(mode: str) -> Iterator[Run]:
        for tol in tolerances(quick) if mode == ONE else ():
            yield at_tolerance(tol, lambda tol=tol: [body(k, tol) for k in range(problem.n_exact)])

    yield Contestant("numpy-quaternion", "integrate_angular_velocity", ladder, 100.0, bound=PYTHON)


def _middles(rates: np.ndarray) -> np.ndarray:
    """Means of neighbouring samples, for libraries that hold a rate over an interval."""
    return 0.5 * (rates[..., :-1, :] + rates[..., 1:, :])


def _accumulate(rates: np.ndarray, h: float, q0: np.ndarray) -> np.ndarray:
    """numpy-quaternion: the exponentials of half the angles and their running product."""
    import quaternion

    turns = np.exp(quaternion.from_vector_part(0.5 * h * _middles(rates)))
    start = quaternion.from_float_array(q0)[..., None]
    return np.multiply.accumulate(np.concatenate([start, turns], axis=-1), axis=-1)


def _ahrs(method: str) -> Callable[[np.ndarray, float, np.ndarray], np.ndarray]:
    from ahrs.filters import AngularRate

    def solve(rates: np.ndarray, h: float, q0: np.ndarray) -> np.ndarray:
        # its first rate is not used
        held = np.concatenate([rates[:1], _middles(rates)])
        return np.asarray(AngularRate(gyr=held, q0=q0, Dt=h, method=method).Q)

    return solve


def _skinematics() -> Callable[[np.ndarray, float, np.ndarray], np.ndarray]:
    from skinematics.quat import calc_quat

    return lambda rates, h, q0: calc_quat(rates, q0, 1.0 / h, "bf")


def _spline(tol: float) -> Callable[[np.ndarray, float, np.ndarray], np.ndarray]:
    """numpy-quaternion on a cubic spline of the samples, of the conjugate at the opposite rate."""
    import quaternion

    def solve(rates: np.ndarray, h: float, q0: np.ndarray) -> np.ndarray:
        t = h * np.arange(len(rates))
        start = quaternion.quaternion(*q0).conj()
        _, q = quaternion.integrate_angular_velocity((t, -rates), 0.0, t[-1], start, tol)
        return np.conjugate(q)

    return solve


def _components(q: Any) -> np.ndarray:
    import quaternion

    return quaternion.as_float_array(q) if np.asarray(q).dtype != float else np.asarray(q)


_Solver = Callable[[np.ndarray, float, np.ndarray], np.ndarray]


class Sampler(NamedTuple):
    """A method for samples and the order of its error in the interval, if that is all it has."""

    method: str
    solve: _Solver
    order: float | None = None
    bound: str = PYTHON


def _samplers(package: str, tol: float) -> list[Sampler]:
    """``tol`` is for what integrates to a tolerance."""
    if package == "numpy-quaternion":
        return [
            Sampler("exp, accumulate", _accumulate, 2.0, "order 2"),
            Sampler("integrate_angular_velocity", _spline(tol)),
        ]
    if package == "ahrs":
        return [Sampler("closed", _ahrs("closed"), order=2.0), Sampler("series", _ahrs("series"))]
    return [Sampler("calc_quat", _skinematics(), order=2.0)]


def _sampled_peer(package: str, problem: Problem, quick: bool) -> Iterator[Contestant]:
    def ladder_of(solve: _Solver):
        def ladder(mode: str) -> Iterator[Run]:
            if mode == MANY and solve is not _accumulate:
                return
            for n in QUICK["intervals"] if quick else _INTERVALS[::2]:
                data, h = problem.samples(n)[: problem.units(mode)], problem.t_end / n

                def one(data=data, h=h) -> list[np.ndarray]:
                    return [solve(data[k], h, problem.q0[k])[-1] for k in range(len(data))]

                def many(data=data, h=h) -> np.ndarray:
                    return solve(data, h, problem.q0)[:, -1]

                call = one if mode == ONE else many
                yield Run(f"{n} intervals", call, _components)

        return ladder

    for method, solve, order, bound in _samplers(package, tol=1e-9):
        if not quick or order is not None:
            yield Contestant(package, method, ladder_of(solve), None, order, bound)


# by problem

# module to look for, and the contestants of function and body problems
_PEERS: dict[str, tuple[str, Callable[..., Iterator[Contestant]] | None]] = {
    "heyoka": ("heyoka", solvers.heyoka),
    "CyRK": ("CyRK", solvers.cyrk),
    "scipy": ("scipy", solvers.scipy),
    "diffrax": ("diffrax", solvers.diffrax),
    "MuJoCo": ("mujoco", solvers.mujoco),
    "Basilisk": ("Basilisk", solvers.basilisk),
    "Exudyn": ("exudyn", solvers.exudyn),
    "numpy-quaternion": ("quaternion", _numpy_quaternion),
    "ahrs": ("ahrs", None),
    "scikit-kinematics": ("skinematics", None),
}
SAMPLED = ("numpy-quaternion", "ahrs", "scikit-kinematics")
PACKAGES = (OURS, *_PEERS)
DISTRIBUTIONS = {"Basilisk": "bsk", "Exudyn": "exudyn"}


def missing() -> list[str]:
    """Libraries that are not installed."""
    return [name for name, (module, _) in _PEERS.items() if find_spec(module) is None]


def contestants(problem: Problem | Log, package: str, quick: bool) -> Iterable[Contestant]:
    """Those of a library that fit a problem."""
    if isinstance(problem, Log):
        return list(_on_log(problem, package, quick))
    if package == OURS:
        return _ours(problem, quick)
    if problem.sampled:
        return _sampled_peer(package, problem, quick) if package in SAMPLED else ()
    build = wheels.PEERS.get(package) if problem.samples_of_control else _PEERS[package][1]
    return () if build is None else build(problem, quick)


def _on_log(log: Log, package: str, quick: bool) -> Iterator[Contestant]:
    start = np.array([1.0, 0.0, 0.0, 0.0])

    def once(call: Callable[[], Any]):
        return lambda mode: [Run("", call, _components)] if mode == ONE else []

    if package == OURS:
        for name in ("trapezoid",) if quick else methods_for_samples():
            call = partial(fa.integrate_rates, log.rates, log.dt, start, method=name, n_threads=1)
            yield Contestant(OURS, name, once(call))
    elif package in SAMPLED:
        for method, solve, *_ in _samplers(package, tol=1e-6):
            yield Contestant(package, method, once(partial(solve, log.rates, log.dt, start)))
