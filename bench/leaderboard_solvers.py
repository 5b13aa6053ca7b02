"""Contestants that integrate any equations to a tolerance, and programs of rigid bodies.

Every peer gets the same equations, compiled where it takes compiled functions, and what it can
prepare beforehand is prepared: integrators, layouts, simulations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from typing import Any, NamedTuple

import equations
import numba
import numpy as np
import peers_bodies as peers
from leaderboard_problems import MANY, ONE, Problem

EXPONENTS = range(3, 14)
QUICK = {
    "steps": [40, 160], "intervals": [96, 192], "exponents": [6, 12],
    "methods": {
        equations.CONING: ("magnus6", "trapezoid"),
        equations.FREE: ("exact",),
        equations.TOP: ("exact", "rk8"),
        equations.PUSHED: ("rk8",),
        equations.ORBIT: ("gbs16",),
        equations.WHEELS: ("rk4",),
    },
}  # fmt: skip
PYTHON = "a Python loop"  # what bounds a library's speed


class Run(NamedTuple):
    """One setting: ``call`` is what is timed, ``attitudes`` gives those at the end from its result.

    Of a log the attitudes at all instants. ``tol``: the tolerance, where there is one; ``work``
    counts the operations of a body.
    """

    setting: str
    call: Callable[[], Any]
    attitudes: Callable[[Any], np.ndarray]
    tol: float | None = None
    work: Callable[[], float] = float


class Contestant(NamedTuple):
    """A method of a library; ``ladder(mode)`` gives its runs, none where it has no such mode.

    ``claim``: the error at the end is below so many tolerances times the problem's growth;
    ``order``: that with which it falls with the number of steps or samples; ``bound``: what keeps
    it from more speed.
    """

    package: str
    method: str
    ladder: Callable[[str], Iterable[Run]]
    claim: float | None = None
    order: float | None = None
    bound: str = ""


def tolerances(quick: bool) -> list[float]:
    return [10.0**-k for k in (QUICK["exponents"] if quick else EXPONENTS)]


def at_tolerance(tol: float, call: Callable[[], Any]) -> Run:
    return Run(f"tolerance {tol:.0e}", call, _attitudes, tol)


def _attitudes(states: Any) -> np.ndarray:
    return np.array(states)[:, :4]


def heyoka(problem: Problem, quick: bool) -> Iterator[Contestant]:
    import heyoka as hy

    kind = problem.kind
    cheap = kind == equations.CONING

    def scalar(tol: float) -> Run:
        slope = equations.slope(kind, hy.sin, hy.cos)
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

        def work() -> float:
            integrator.time, state[:] = 0.0, problem.y0[0]
            if not shared:
                integrator.pars[:] = problem.parameters[0]
            return peers.taylor_work(integrator, integrator.propagate_until(problem.t_end)[3], kind)

        return at_tolerance(tol, call)._replace(work=work)

    def batch(tol: float, group: int) -> Run:
        system = peers.TaylorBatch(kind, problem.parameters, tol, group)
        starts = system.lanes(problem.y0)
        own = None if system.parameters is None else system.lanes(system.parameters)
        return Run(
            f"tolerance {tol:.0e}, {group} bodies a system",
            lambda: system.run(starts, own, problem.t_end),
            lambda ends: system.bodies(ends, len(problem.y0))[:, :4],
            tol,
            system.work,
        )

    def ladder(mode: str) -> Iterator[Run]:
        for tol in [*tolerances(quick), *([] if quick else [1e-14, 1e-15])]:
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
def cyrk_function(kind: str) -> Any:
    from CyRK.nb.numba_solver import cyjit_sig

    slope, n = _compiled(kind), equations.N_STATE[kind]

    @numba.cfunc(cyjit_sig)
    def function(dy, t, y, p):
        found = slope(t, y, p)
        for i in range(n):
            dy[i] = found[i]

    return function


def cyrk(problem: Problem, quick: bool) -> Iterator[Contestant]:
    run, address = _cyrk_driver(), cyrk_function(problem.kind).address
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

            for tol in tolerances(quick):
                call = one if mode == ONE else many
                yield at_tolerance(tol, lambda tol=tol, call=call: call(tol))

        return ladder

    for method in ("DOP853",) if quick else ("DOP853", "VERN8", "VERN7", "TSIT5"):
        yield Contestant("CyRK", method, ladder_of(method), claim=100.0)


def diffrax(problem: Problem, quick: bool) -> Iterator[Contestant]:
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
        for tol in tolerances(quick):
            call = each if mode == ONE else together
            yield at_tolerance(tol, lambda tol=tol, call=call: call(tol))

    return ladder


@cache
def array_slopes(kind: str) -> tuple[Callable[..., Any], Callable[..., Any]]:
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


def scipy(problem: Problem, quick: bool) -> Iterator[Contestant]:
    from scipy import integrate

    one, many = array_slopes(problem.kind)
    t_end, n, size = problem.t_end, len(problem.y0), problem.y0.shape[1]
    rows = [(problem.y0[k], problem.parameters_of(k)) for k in range(problem.n_exact)]
    all_parameters = np.ascontiguousarray(
        np.broadcast_to(problem.parameters, (n, problem.parameters.shape[-1]))
    )

    def solve_ivp(y0: np.ndarray, p: np.ndarray, tol: float) -> np.ndarray:
        return integrate.solve_ivp(
            one, (0.0, t_end), y0, "DOP853", args=(p,), rtol=tol, atol=tol
        ).y[:, -1]

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
            if mode == MANY and body is not solve_ivp:
                return
            for tol in tolerances(quick):
                call = (
                    (lambda tol=tol: [body(*row, tol) for row in rows])
                    if mode == ONE
                    else (lambda tol=tol: ensemble(tol))
                )
                yield at_tolerance(tol, call)

        return ladder

    solvers = (
        (solve_ivp, "solve_ivp DOP853", 100.0),
        (odeint, "odeint", 1e4),
        (dop853, "ode dop853", 100.0),
    )
    for body, name, claim in solvers[: 1 if quick else None]:
        yield Contestant("scipy", name, ladder_of(body), claim, bound=PYTHON)


# programs of rigid bodies


def _in_steps(
    package: str, method: str, order: int, build: Callable[..., Any], modes: tuple[str, ...],
    kinds: tuple[str, ...] = (equations.FREE, equations.ORBIT),
):  # fmt: skip
    """A class of ``peers_bodies``, for bodies of matter: no moment above the sum of others."""

    def contestants(problem: Problem, quick: bool) -> Iterator[Contestant]:
        motion = problem.parameters[4] if problem.kind == equations.ORBIT else 0.0
        doubled = [40 * 2**k for k in range(12)]
        # of whole nanoseconds, which Basilisk counts
        whole = [n for n in doubled if round(problem.t_end * 1e9) % n == 0]

        def ladder(mode: str) -> Iterator[Run]:
            rows = np.arange(problem.units(mode))
            for n in (whole[4:6] if quick else whole) if mode in modes else ():
                body = build(problem.scene.inertia, problem.t_end, n, motion)
                groups = rows[:, None] if mode == ONE else [rows]
                starts = [body.state(problem.q0[g], problem.w0[g]) for g in groups]

                def call(body=body, starts=starts) -> list[Any]:
                    return [body.run(start) for start in starts]

                yield Run(f"{n} steps", call, body.attitudes)

        moments = np.asarray(problem.scene.inertia)
        if problem.kind in kinds and 2.0 * moments.max() <= moments.sum():
            yield Contestant(package, method, ladder, order=order, bound=f"order {order}")

    return contestants


mujoco = _in_steps("MuJoCo", "RK4", 4, peers.MuJoCoBody, (ONE, MANY), (equations.FREE,))
basilisk = _in_steps("Basilisk", "spacecraft, RK4", 4, peers.BasiliskBody, (ONE,))
exudyn = _in_steps("Exudyn", "rotation vector, RK67", 6, peers.ExudynBody, (ONE,))
