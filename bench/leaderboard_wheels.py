"""Contestants for wheels under sampled control: libraries that start anew at each sample.

The torque that is held goes into the last parameters of ``equations``. All of them run body by
body, an ensemble too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import equations
import numba
import numpy as np
from leaderboard_problems import ONE, Problem
from leaderboard_solvers import (
    PYTHON,
    Contestant,
    Run,
    array_slopes,
    at_tolerance,
    cyrk_function,
    tolerances,
)
from peers_wheels import BasiliskWheels
from wheel_feedback import DAMPING, LARGEST_TORQUE, PERIOD, STIFFNESS, WHEEL

import fastatt as fa


@numba.njit
def hold(y, p):
    """Compute the motors' torques at a sample and write half of them into p."""
    factor = math.copysign(STIFFNESS, y[0]) / (1.0 + abs(y[0]))
    for i in range(3):
        torque = factor * y[1 + i] + 2.0 * DAMPING * y[4 + i]
        p[6 + i] = 0.5 * min(max(torque, -LARGEST_TORQUE), LARGEST_TORQUE)


_Advance = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _restarted(
    package: str,
    method: str,
    problem: Problem,
    quick: bool,
    advance_at: Callable[[float], _Advance],
) -> Contestant:
    """``advance_at(tol)(y, p)`` gives the state a sample later; Python loops over samples."""

    def end(k: int, advance: _Advance) -> np.ndarray:
        y, p = problem.y0[k], problem.parameters.copy()
        for _ in range(problem.samples_of_control):
            hold(y, p)
            y = advance(y, p)
        return y

    def ladder(mode: str) -> Iterator[Run]:
        for tol in tolerances(quick) if mode == ONE else ():
            advance = advance_at(tol)
            yield at_tolerance(
                tol, lambda advance=advance: [end(k, advance) for k in range(problem.n_exact)]
            )

    return Contestant(package, method, ladder, claim=100.0, bound=PYTHON)


def heyoka(problem: Problem, quick: bool) -> Iterator[Contestant]:
    import heyoka as hy

    def advance_at(tol: float) -> _Advance:
        slope = equations.slope(problem.kind, hy.sin, hy.cos)
        y = hy.make_vars(*(f"y{i}" for i in range(problem.y0.shape[1])))
        own = [hy.par[i] for i in range(len(problem.parameters))]
        system = list(zip(y, slope(hy.time, y, own), strict=True))
        integrator = hy.taylor_adaptive(system, problem.y0[0], tol=tol)
        state, held = integrator.state, integrator.pars

        def advance(y: np.ndarray, p: np.ndarray) -> np.ndarray:
            integrator.time = 0.0
            state[:], held[:] = y, p
            integrator.propagate_until(PERIOD)
            return state.copy()

        return advance

    yield _restarted("heyoka", "Taylor", problem, quick, advance_at)


def scipy(problem: Problem, quick: bool) -> Iterator[Contestant]:
    from scipy import integrate

    one, _ = array_slopes(problem.kind)

    def advance_at(tol: float) -> _Advance:
        return lambda y, p: integrate.solve_ivp(
            one, (0.0, PERIOD), y, "DOP853", args=(p,), rtol=tol, atol=tol
        ).y[:, -1]

    yield _restarted("scipy", "solve_ivp DOP853", problem, quick, advance_at)


@cache
def _cyrk_driver() -> Callable[..., Any]:
    from CyRK import nbsolve2_ivp

    @numba.njit
    def run(address, starts, parameters, samples, tol, method):
        ends = starts.copy()
        for y in ends:
            own = parameters.copy()
            for _ in range(samples):
                hold(y, own)
                found = nbsolve2_ivp(
                    address, (0.0, PERIOD), y, method=method, args=own, rtol=tol, atol=tol,
                    force_retain_solver=False,
                )  # fmt: skip
                y[:] = found.y[:, found.size - 1]
                found.free()
        return ends

    return run


def cyrk(problem: Problem, quick: bool) -> Iterator[Contestant]:
    run, address = _cyrk_driver(), cyrk_function(problem.kind).address
    given = problem.y0[: problem.n_exact], problem.parameters, problem.samples_of_control

    def ladder_of(method: str):
        def ladder(mode: str) -> Iterator[Run]:
            for tol in tolerances(quick) if mode == ONE else ():
                yield at_tolerance(tol, lambda tol=tol: run(address, *given, tol, method))

        return ladder

    for method in ("DOP853",) if quick else ("DOP853", "TSIT5"):
        yield Contestant("CyRK", method, ladder_of(method), claim=100.0)


def basilisk(problem: Problem, quick: bool) -> Iterator[Contestant]:
    del quick
    craft = BasiliskWheels(problem.samples_of_control)
    speeds = problem.s0[:, :3] / WHEEL - problem.w0
    starts = list(zip(fa.quat_to_mrp(problem.q0), problem.w0, speeds, strict=True))

    def ladder(mode: str) -> Iterator[Run]:
        if mode == ONE:
            yield Run(
                f"{problem.samples_of_control} steps",
                lambda: [craft.run(*start) for start in starts[: problem.n_exact]],
                lambda ends: fa.mrp_to_quat(np.reshape(ends, (-1, 3))),
            )

    yield Contestant("Basilisk", "spacecraft, RK4", ladder, bound="modules and messages")


PEERS = {"heyoka": heyoka, "CyRK": cyrk, "scipy": scipy, "Basilisk": basilisk}
