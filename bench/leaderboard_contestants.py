"""The leaderboard's contestants: fastatt and the libraries that a user would pick instead.

Each has a ladder of settings from coarse to fine, for bodies one at a time (a call each) and, where
the library takes ensembles, for all at once. Every peer gets the same equations, compiled where it
takes compiled functions, and what it can prepare beforehand is prepared: integrators, layouts.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.util import find_spec
from typing import Any, NamedTuple

import equations
import numba
import numpy as np
import peers_bodies as peers
from leaderboard_problems import MANY, ONE, Log, Problem

import fastatt as fa
from fastatt.integrate import methods_for_samples

OURS = "fastatt"
_STEPS = [round(8 * 2 ** (k / 2)) for k in range(18)]
_INTERVALS = [round(12 * 2 ** (k / 2)) for k in range(15)]
_EXPONENTS = range(3, 14)
# what is worth its compilation in single precision: short calls for errors of 1e-3 to 1e-6
_SINGLE = ("magnus4", "magnus6", "rk8", "exact", "trapezoid", "previous", "coning2")
# worth a loop of the user's own, where a call to propagate would outweigh its steps
_LOOPS = {
    equations.CONING: ("magnus4", "magnus6"),
    equations.FREE: ("rk8", "dmv8", "dmv10"),
    equations.TOP: ("rk8",),
}
_QUICK = {
    "steps": [32, 128], "intervals": [96, 192], "exponents": [6, 12],
    "methods": {
        equations.CONING: ("magnus6", "trapezoid"),
        equations.FREE: ("exact",),
        equations.TOP: ("rk8",),
    },
}  # fmt: skip


class Run(NamedTuple):
    """One setting: ``call`` is what is timed, ``attitudes`` gives those at the end from its result.

    Of a log the attitudes at all instants. ``tol``: the tolerance, where there is one.
    """

    setting: str
    call: Callable[[], Any]
    attitudes: Callable[[Any], np.ndarray]
    tol: float | None = None


class Contestant(NamedTuple):
    """A method of a library; ``ladder(mode)`` gives its runs, none where it has no such mode.

    ``claim``: the error at the end is below so many tolerances times the problem's growth;
    ``order``: that with which it falls with the number of samples.
    """

    package: str
    method: str
    ladder: Callable[[str], Iterable[Run]]
    claim: float | None = None
    order: float | None = None


# fastatt


def _ours(problem: Problem, quick: bool) -> Iterator[Contestant]:
    names = methods_for_samples() if problem.sampled else fa.methods_for(problem.scene, "quat")
    # the closed form and high orders first: lower ones need not be refined beyond their times
    for name in sorted(names, key=lambda name: -(fa.METHODS[name].order or math.inf)):
        if quick and name not in _QUICK["methods"][problem.kind]:
            continue
        for dtype in ("float64", "float32") if name in _SINGLE and not quick else ("float64",):
            label = name if dtype == "float64" else f"{name} float32"
            if problem.sampled:
                ladder = _our_samples(problem, name, dtype, quick)
            elif name == "exact":
                ladder = _our_closed_form(problem, dtype)
            else:
                ladder = _our_steps(problem, name, dtype, quick)
            yield Contestant(OURS, label, ladder)

    for name in () if problem.sampled else _LOOPS[problem.kind][: 1 if quick else None]:
        yield Contestant(OURS, f"{name} in a loop", _our_loop(problem, name, quick))


def _our_loop(problem: Problem, name: str, quick: bool):
    """``fa.single_step`` in a user's ``@njit`` loop, a call a body."""
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

    def ladder(mode: str) -> Iterator[Run]:
        rows = range(problem.n_exact)
        starts = [tuple(problem.q0[k].tolist()) for k in rows]
        rates = [() if problem.w0 is None else tuple(problem.w0[k].tolist()) for k in rows]
        shared = isinstance(stepper.params, tuple)
        own = [stepper.params if shared else stepper.params[k] for k in rows]
        for n in (_QUICK["steps"] if quick else _STEPS) if mode == ONE else ():

            def call(n=n) -> list[np.ndarray]:
                bodies = zip(starts, rates, own, strict=True)
                return [run(q, w, problem.t_end, n, p) for q, w, p in bodies]

            yield Run(f"{n} steps", call, np.asarray)

    return ladder


def _our_steps(problem: Problem, name: str, dtype: str, quick: bool):
    options = {"method": name, "dtype": dtype, "n_threads": 1}
    bodies = [problem.of_body(k) for k in range(problem.n_exact)]
    ensemble = {"scene": problem.scene, "q0": problem.q0}
    if problem.w0 is not None:
        ensemble["w0"] = problem.w0

    def ladder(mode: str) -> Iterator[Run]:
        for n in _QUICK["steps"] if quick else _STEPS:
            step = {"dt": problem.t_end / n, "n_steps": n, **options}

            def one(step=step) -> list[np.ndarray]:
                return [fa.propagate(**body, **step).q[-1] for body in bodies]

            def many(step=step) -> np.ndarray:
                return fa.propagate(**ensemble, **step).q[-1]

            yield Run(f"{n} steps", one if mode == ONE else many, np.asarray)

    return ladder


def _our_closed_form(problem: Problem, dtype: str):
    inertia = problem.scene.inertia

    def solve(q0: np.ndarray, w0: np.ndarray) -> np.ndarray:
        return fa.exact.free_body(q0, w0, inertia, problem.t_end, dtype=dtype, n_threads=1)[0]

    def one() -> list[np.ndarray]:
        return [solve(problem.q0[k], problem.w0[k]) for k in range(problem.n_exact)]

    def many() -> np.ndarray:
        return solve(problem.q0, problem.w0)

    return lambda mode: [Run("closed form", one if mode == ONE else many, np.asarray)]


def _our_samples(problem: Problem, name: str, dtype: str, quick: bool):
    def ladder(mode: str) -> Iterator[Run]:
        bodies = problem.units(mode)
        for n in _QUICK["intervals"] if quick else _INTERVALS:
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


# libraries that integrate any equations to a tolerance


def _tolerances(quick: bool) -> list[float]:
    return [10.0**-k for k in (_QUICK["exponents"] if quick else _EXPONENTS)]


def _at(tol: float, call: Callable[[], Any]) -> Run:
    return Run(f"tolerance {tol:.0e}", call, _attitudes, tol)


def _attitudes(states: Any) -> np.ndarray:
    return np.array(states)[:, :4]


def _heyoka(problem: Problem, quick: bool) -> Iterator[Contestant]:
    import heyoka as hy

    cheap = problem.kind == equations.CONING

    def scalar(tol: float) -> Run:
        slope = equations.slope(problem.kind, hy.sin, hy.cos)
        n = problem.parameters.shape[-1]
        shared = problem.parameters.ndim == 1
        y = hy.make_vars(*(f"y{i}" for i in range(problem.y0.shape[1])))
        own = problem.parameters if shared else [hy.par[i] for i in range(n)]
        system = list(zip(y, slope(hy.time, y, own), strict=True))
        integrator = hy.taylor_adaptive(system, problem.y0[0], tol=tol)
        state = integrator.state

        def call() -> list[np.ndarray]:
            ends = []
            for k in range(problem.n_exact):
                integrator.time = 0.0
                state[:] = problem.y0[k]
                if not shared:
                    integrator.pars[:] = problem.parameters[k]
                integrator.propagate_until(problem.t_end)
                ends.append(state[:4].copy())
            return ends

        return _at(tol, call)

    def batch(tol: float, group: int) -> Run:
        system = peers.TaylorBatch(problem.kind, problem.parameters, tol, group=group)
        starts = system.lanes(problem.y0)
        own = None if system.parameters is None else system.lanes(system.parameters)
        return Run(
            f"tolerance {tol:.0e}, {group} bodies a system",
            lambda: system.run(starts, own, problem.t_end),
            lambda ends: system.bodies(ends, len(problem.y0))[:, :4],
            tol,
        )

    def ladder(mode: str) -> Iterator[Run]:
        for tol in [*_tolerances(quick), *([] if quick else [1e-14, 1e-15])]:
            if mode == ONE:
                yield scalar(tol)
                continue
            groups = (1, 2, 4, 8) if tol > 1e-6 else (1, 2, 4) if cheap else (1, 2)
            for group in (1,) if quick else groups:
                yield batch(tol, group)

    yield Contestant("heyoka", "Taylor", ladder, claim=100.0)


def _compiled(kind: str) -> Callable[..., Any]:
    return equations.slope(kind, math.sin, math.cos, numba.njit)


@cache
def _cyrk_driver() -> Callable[..., Any]:
    from CyRK import nbsolve2_ivp

    @numba.njit
    def run(address, starts, parameters, t_end, tol, method, ends):
        for k in range(len(starts)):
            own = parameters[min(k, len(parameters) - 1)]
            found = nbsolve2_ivp(
                address, (0.0, t_end), starts[k], method=method, args=own, rtol=tol, atol=tol,
                force_retain_solver=False,
            )  # fmt: skip
            ends[k] = np.nan
            if found.success:
                ends[k] = found.y[:, found.size - 1]
            found.free()
        return ends

    return run


@cache
def _cyrk_function(kind: str) -> Any:
    from CyRK.nb.numba_solver import cyjit_sig

    slope, n = _compiled(kind), equations.N_STATE[kind]

    @numba.cfunc(cyjit_sig)
    def function(dy, t, y, p):
        found = slope(t, y, p)
        for i in range(n):
            dy[i] = found[i]

    return function


def _cyrk(problem: Problem, quick: bool) -> Iterator[Contestant]:
    run, address = _cyrk_driver(), _cyrk_function(problem.kind).address
    parameters = np.atleast_2d(problem.parameters)

    def ladder_of(method: str):
        def ladder(mode: str) -> Iterator[Run]:
            ends = np.empty_like(problem.y0)
            rows = [slice(k, k + 1) for k in range(problem.n_exact)]
            bodies = [
                (problem.y0[r], parameters[r] if len(parameters) > 1 else parameters, ends[r])
                for r in rows
            ]

            def one(tol: float) -> np.ndarray:
                for y0, own, end in bodies:
                    run(address, y0, own, problem.t_end, tol, method, end)
                return ends

            def many(tol: float) -> np.ndarray:
                return run(address, problem.y0, parameters, problem.t_end, tol, method, ends)

            for tol in _tolerances(quick):
                call = one if mode == ONE else many
                yield _at(tol, lambda tol=tol, call=call: call(tol))

        return ladder

    for method in ("DOP853",) if quick else ("DOP853", "VERN8", "VERN7", "TSIT5"):
        yield Contestant("CyRK", method, ladder_of(method), claim=100.0)


def _diffrax(problem: Problem, quick: bool) -> Iterator[Contestant]:
    import jax

    jax.config.update("jax_enable_x64", True)
    for name in ("Dopri8",) if quick else ("Dopri8", "Tsit5"):
        one, many = _diffrax_solvers(problem.kind, name)
        yield Contestant("diffrax", name, _diffrax_ladder(problem, quick, one, many), claim=100.0)


@cache
def _diffrax_solvers(kind: str, name: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    import diffrax
    import jax
    import jax.numpy as jnp

    slope, solver = equations.slope(kind, jnp.sin, jnp.cos), getattr(diffrax, name)()
    term = diffrax.ODETerm(lambda t, y, p: jnp.stack(slope(t, y, p)))

    def solve(y0, p, t_end, tol):
        control = diffrax.PIDController(rtol=tol, atol=tol)
        return diffrax.diffeqsolve(
            term, solver, 0.0, t_end, None, y0, p, stepsize_controller=control, max_steps=100_000,
            saveat=diffrax.SaveAt(t1=True), adjoint=diffrax.ForwardMode(),
        ).ys[0]  # fmt: skip

    return jax.jit(solve), jax.jit(jax.vmap(solve, in_axes=(0, 0, None, None)))


def _diffrax_ladder(problem: Problem, quick: bool, one: Callable, many: Callable):
    import jax.numpy as jnp

    n = len(problem.y0)
    starts = jnp.asarray(problem.y0)
    parameters = jnp.asarray(np.broadcast_to(problem.parameters, (n, problem.parameters.shape[-1])))
    rows = [(starts[k], parameters[k]) for k in range(problem.n_exact)]

    def each(tol: float) -> list[Any]:
        return [one(y0, p, problem.t_end, tol).block_until_ready() for y0, p in rows]

    def together(tol: float) -> Any:
        return many(starts, parameters, problem.t_end, tol).block_until_ready()

    def ladder(mode: str) -> Iterator[Run]:
        for tol in _tolerances(quick):
            call = each if mode == ONE else together
            yield _at(tol, lambda tol=tol, call=call: call(tol))

    return ladder


@cache
def _array_slopes(kind: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """For one state, and for all states of an ensemble one after another in one array."""
    slope, n = _compiled(kind), equations.N_STATE[kind]

    @numba.njit
    def one(t, y, p):
        return np.array(slope(t, y, p))

    @numba.njit
    def many(t, y, p):
        dy = np.empty_like(y)
        for k in range(y.size // n):
            found = slope(t, y[k * n : (k + 1) * n], p[k])
            for i in range(n):
                dy[k * n + i] = found[i]
        return dy

    return one, many


def _scipy(problem: Problem, quick: bool) -> Iterator[Contestant]:
    from scipy import integrate

    one, many = _array_slopes(problem.kind)
    t_end, n, size = problem.t_end, len(problem.y0), problem.y0.shape[1]
    rows = [(problem.y0[k], problem.parameters_of(k)) for k in range(problem.n_exact)]
    all_parameters = np.ascontiguousarray(
        np.broadcast_to(problem.parameters, (n, problem.parameters.shape[-1]))
    )

    def solve_ivp(method: str):
        def body(y0: np.ndarray, p: np.ndarray, tol: float) -> np.ndarray:
            return integrate.solve_ivp(
                one, (0.0, t_end), y0, method, args=(p,), rtol=tol, atol=tol
            ).y[:, -1]

        return body

    def odeint(y0: np.ndarray, p: np.ndarray, tol: float) -> np.ndarray:
        span = [0.0, t_end]
        return integrate.odeint(
            one, y0, span, args=(p,), rtol=tol, atol=tol, mxstep=100_000, tfirst=True
        )[-1]

    def dop853(y0: np.ndarray, p: np.ndarray, tol: float) -> np.ndarray:
        solver = integrate.ode(one).set_integrator("dop853", rtol=tol, atol=tol, nsteps=100_000)
        return solver.set_initial_value(y0, 0.0).set_f_params(p).integrate(t_end)

    def ensemble(tol: float) -> np.ndarray:
        return integrate.solve_ivp(
            many, (0.0, t_end), problem.y0.ravel(), "DOP853", args=(all_parameters,), rtol=tol,
            atol=tol,
        ).y[:, -1].reshape(n, size)  # fmt: skip

    def ladder_of(body: Callable[..., np.ndarray]):
        def ladder(mode: str) -> Iterator[Run]:
            if mode == MANY and body is not first:
                return
            for tol in _tolerances(quick):
                call = (
                    (lambda tol=tol: [body(*row, tol) for row in rows])
                    if mode == ONE
                    else (lambda tol=tol: ensemble(tol))
                )
                yield _at(tol, call)

        return ladder

    first = solve_ivp("DOP853")
    yield Contestant("scipy", "solve_ivp DOP853", ladder_of(first), claim=100.0)
    if not quick:
        yield Contestant("scipy", "solve_ivp LSODA", ladder_of(solve_ivp("LSODA")), claim=1e4)
        yield Contestant("scipy", "odeint", ladder_of(odeint), claim=1e4)
        yield Contestant("scipy", "ode dop853", ladder_of(dop853), claim=100.0)


# libraries of attitudes


def _numpy_quaternion(problem: Problem, quick: bool) -> Iterator[Contestant]:
    """``integrate_angular_velocity`` turns at rates in inertial axes.

    Coning, given in body axes, turns the conjugate at the opposite rate. A free body turns at the
    rate that belongs to its momentum, fixed in space.
    """
    import quaternion

    if problem.kind == equations.TOP:
        return
    turns = [_rate_in_space(problem, k) for k in range(problem.n_exact)]

    def body(k: int, tol: float) -> np.ndarray:
        rate, conjugated = turns[k]
        start = quaternion.quaternion(*problem.q0[k])
        with warnings.catch_warnings():
            _, q = quaternion.integrate_angular_velocity(
                rate, 0.0, problem.t_end, start.conj() if conjugated else start, tol
            )
        end = q[-1].conj() if conjugated else q[-1]
        return end.components

    def ladder(mode: str) -> Iterator[Run]:
        if mode == MANY:
            return
        for tol in _tolerances(quick):
            yield _at(tol, lambda tol=tol: [body(k, tol) for k in range(problem.n_exact)])

    yield Contestant("numpy-quaternion", "integrate_angular_velocity", ladder, claim=100.0)


def _rate_in_space(problem: Problem, k: int) -> tuple[Callable[..., Any], bool]:
    """The rate, and whether it is that of the conjugate."""
    import quaternion

    p = problem.parameters_of(k).tolist()
    if problem.kind == equations.CONING:

        def reversed_rate(t):
            s, c = math.sin(p[1] * t), math.cos(p[1] * t)
            return 2.0 * p[0] * s, -2.0 * p[0] * c, 2.0 * p[2]

        return reversed_rate, True
    moments = [float(i) for i in problem.scene.inertia]
    start = quaternion.quaternion(*problem.q0[k])
    momentum = problem.w0[k] * moments
    momentum = start * quaternion.quaternion(0.0, *momentum) * start.conj()

    def rate(t, q):
        inside = q.conj() * momentum * q
        x, y, z = inside.x / moments[0], inside.y / moments[1], inside.z / moments[2]
        outside = q * quaternion.quaternion(0.0, x, y, z) * q.conj() / q.norm() ** 2
        return outside.x, outside.y, outside.z

    return rate, False


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


def _samplers(package: str, tol: float) -> list[Sampler]:
    """``tol`` is for what integrates to a tolerance."""
    if package == "numpy-quaternion":
        return [
            Sampler("exp, accumulate", _accumulate, order=2.0),
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
            for n in _QUICK["intervals"] if quick else _INTERVALS[::2]:
                data, h = problem.samples(n)[: problem.units(mode)], problem.t_end / n

                def one(data=data, h=h) -> list[np.ndarray]:
                    return [solve(data[k], h, problem.q0[k])[-1] for k in range(len(data))]

                def many(data=data, h=h) -> np.ndarray:
                    return solve(data, h, problem.q0)[:, -1]

                call = one if mode == ONE else many
                yield Run(f"{n} intervals", call, _components)

        return ladder

    for method, solve, order in _samplers(package, tol=1e-9):
        if not quick or order is not None:
            yield Contestant(package, method, ladder_of(solve), order=order)


# by problem

# module to look for, and the contestants of function and body problems
_PEERS: dict[str, tuple[str, Callable[..., Iterator[Contestant]] | None]] = {
    "heyoka": ("heyoka", _heyoka),
    "CyRK": ("CyRK", _cyrk),
    "scipy": ("scipy", _scipy),
    "diffrax": ("diffrax", _diffrax),
    "numpy-quaternion": ("quaternion", _numpy_quaternion),
    "ahrs": ("ahrs", None),
    "scikit-kinematics": ("skinematics", None),
}
SAMPLED = ("numpy-quaternion", "ahrs", "scikit-kinematics")
PACKAGES = (OURS, *_PEERS)


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
    build = _PEERS[package][1]
    return () if build is None else build(problem, quick)


def _on_log(log: Log, package: str, quick: bool) -> Iterator[Contestant]:
    start = np.array([1.0, 0.0, 0.0, 0.0])

    def once(call: Callable[[], Any]):
        return lambda mode: [Run("", call, _components)] if mode == ONE else []

    if package == OURS:
        for name in ("trapezoid",) if quick else methods_for_samples():
            yield Contestant(
                OURS,
                name,
                once(
                    lambda name=name: fa.integrate_rates(
                        log.rates, log.dt, start, method=name, n_threads=1
                    )
                ),
            )
    elif package in SAMPLED:
        for method, solve, _ in _samplers(package, tol=1e-6):
            yield Contestant(
                package, method, once(lambda solve=solve: solve(log.rates, log.dt, start))
            )
