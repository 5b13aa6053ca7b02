"""Rates, torques and forces along the bodies' path: their jumps and their time scales."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.attitudes import QUATERNION
from fastatt.codegen.rows import rows
from fastatt.propagation.breakpoints import breaks_within
from fastatt.scene.equations import Body, PrescribedRate, Structure, acceleration
from fastatt.scene.torque_record import CoupledStates
from fastatt.tracing.formulas import quat
from fastatt.trade.measure import Case, Problem

_BODIES = 64  # bodies, evenly from the first to the last, and those with extreme numbers
#: in all, 1024 to 16384 for each body
SAMPLES = 2**19
_SUSPECTS = 4  # intervals of a body with the largest changes, which are bisected
_HALVINGS = 24
# share of the range: a change that stays above it after all bisections is a jump
_JUMP = 1e-3
_STEPS = 4.0  # steps of a reference in the time of a change
# share of the largest value: a range below it is rounding
_CONSTANT = 1e-8
#: what is accepted where a rate, torque or force jumps in time
BREAKPOINTS = (
    "fa.Scene(..., breakpoints=times) of all jumps and corners in time, where steps then end"
)
_IN_TIME = f"a smooth function; {BREAKPOINTS}"
_SMOOTHER = (
    "a smooth function, such as tanh(w/w_s) for the sign of w; in a run a fa.torques.Switch, whose "
    "side the function reads in place of its comparison; fa.torques.SampledControl for a "
    "controller; an event of fa.propagate that ends the run at the jump"
)


class Forcing(NamedTuple):
    """Steps that resolve rates, torques and forces, and where one jumps ("" for none).

    ``jump`` also says what is accepted in place of it.
    """

    steps: int
    jump: str


def forcing(problem: Problem, case: Case, n_steps: int, samples: int = SAMPLES) -> Forcing:
    """Sample rates, torques and forces along a path from a run in ``n_steps`` steps.

    There are many more samples than steps, one at random in each interval. The intervals with the
    largest changes are bisected repeatedly; for a continuous function the change then falls.
    """
    even = np.linspace(0, problem.ensemble.size - 1, _BODIES).astype(np.intp)
    problem = problem.take(np.union1d(even, problem.ensemble.extremes))
    size = problem.ensemble.size
    count = int(np.clip(samples // size, 1024, 16384))
    chance = np.random.default_rng(0).uniform(size=count)
    times = problem.t0 + (np.arange(count) + chance) * (problem.duration / count)
    # both sides of each breakpoint, where jumps are declared
    scene = problem.ensemble.scene
    breaks = breaks_within(scene, problem.t0, problem.duration)
    times = np.sort(np.concatenate([times, breaks.high[:-1], breaks.low[1:]]))
    run = problem.run(case, n_steps, save_at=times)
    signs = np.where((run.q[1:] * run.q[:-1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    q = run.q.copy()
    q[1:] *= np.cumprod(signs, axis=0)
    t = np.broadcast_to(run.t[:, None, None], (*q.shape[:2], 1))
    carried = [run.carried.get(name, 0.0 * q[..., 1:]) for name in ("w", "v", "r")]
    carried.append(run.carried.get("s", q[..., :0]))
    path = np.concatenate([t, q, *carried], axis=-1)
    with np.errstate(all="ignore"):
        steps, jump = 1, ""
        for name, f in _acting(problem, path).items():
            finest, where = _examined(problem, path, name, f)
            steps = max(steps, finest)
            if where is not None:
                jump = jump or f"the {name} {where}"
    return Forcing(steps, jump)


def _examined(
    problem: Problem, path: NDArray[np.float64], name: str, f: NDArray[np.float64]
) -> tuple[int, str | None]:
    """Steps that resolve a quantity (S, N, 3), and where it jumps, if it does, in words."""
    ranges = np.ptp(f, axis=0).max(axis=-1)
    varies = ranges > _CONSTANT * np.abs(f).max(axis=(0, 2))
    changes = np.abs(np.diff(f, axis=0)).max(axis=-1)
    crossing = np.diff(path[:, 0, 0]) <= 2.0 * np.spacing(np.abs(path[1:, 0, 0]))
    changes[crossing] = 0.0
    if not (varies & np.isfinite(ranges)).any():
        return 1, None
    slopes = (changes / np.diff(path[..., 0], axis=0))[~crossing].max(axis=0)
    steps = _STEPS * problem.duration * np.max(slopes[varies] / ranges[varies])
    suspects = np.argsort(changes, axis=0)[-_SUSPECTS:, :, None]
    low, high = (np.take_along_axis(path, suspects + k, axis=0) for k in (0, 1))
    f_low, f_high = _acting(problem, low)[name], _acting(problem, high)[name]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        f_middle = _acting(problem, middle)[name]
        left = np.abs(f_middle - f_low).max(axis=-1) > np.abs(f_high - f_middle).max(axis=-1)
        left = left[..., None]
        low, high = np.where(left, low, middle), np.where(left, middle, high)
        f_low, f_high = np.where(left, f_low, f_middle), np.where(left, f_middle, f_high)
    gaps = np.where(varies, np.abs(f_high - f_low).max(axis=-1) / ranges, 0.0)
    k, body = np.unravel_index(np.nanargmax(gaps), gaps.shape)
    if not gaps[k, body] > _JUMP:
        return int(min(steps, 2**31)) + 1, None
    # a jump in time is there for the earlier state too
    later = low.copy()
    later[..., 0] = high[..., 0]
    change = np.abs(_acting(problem, later)[name] - f_low)[k, body].max()
    in_time = change > 0.5 * ranges[body] * gaps[k, body]
    how, accepted = ("", _IN_TIME) if in_time else (" with the state", _SMOOTHER)
    place = f"t = {low[k, body, 0]:.6g} s (body {problem.ensemble.places[body]})"
    return 1, (f"jumps{how} near {place}, where no method keeps its order; accepted: {accepted}")


def _acting(problem: Problem, path: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Rates, or accelerations by torques and forces, (S, N, 3), at t, q, w, v, r, s (S, N, k)."""
    packed = problem.ensemble.scene.packed(problem.ensemble.size)
    structure = packed.structure
    names = ["rate" if isinstance(structure.rotation, PrescribedRate) else "torque"]
    names += [] if structure.force is None else ["force"]
    n = structure.rotation.law.states
    inputs = {"t": None, "q": 4, "w": 3, "v": 3, "r": 3, "s": n, "p": structure.n_params}
    formula = rows(
        partial(_formula, structure), inputs, (3,) * len(names), key=(_formula, structure)
    )
    states = np.split(path[..., 1:], (4, 7, 10, 13), axis=-1)
    p = packed.params[..., : structure.n_params]
    accelerations = formula(path[..., 0], *states, p, tables=packed.tables)
    return dict(zip(names, accelerations, strict=True))


def _formula(structure: Structure, t: Any, q: Any, w: Any, v: Any, r: Any, s: Any, p: Any) -> Any:
    rotation, n = structure.rotation, structure.rotation.n_params
    r = r if structure.position else ()
    params, q = p[:n], quat.normalise(q)
    accelerations, motion = [], None
    if isinstance(rotation, PrescribedRate):
        accelerations.append(rotation.law.formula(t, params, states=s)[:3])
    else:
        motion, attitude, rate = Body(QUATERNION, rotation, params, q[0]), q, w
        if motion.axes is not None:
            attitude, rate = quat.mul(q, motion.axes), quat.rotate_inverse(motion.axes, w)
        torque = motion.torque(t, attitude, rate, CoupledStates(v, r, s))
        inverse = zip(motion.half_inverse, torque[:3], strict=True)
        accelerations.append(tuple(2.0 * k * x for k, x in inverse))
    if structure.force is not None:
        coupled = CoupledStates(v, r, s)
        shown = motion.shown(t, coupled) if isinstance(motion, Body) else None
        accelerations.append(acceleration(structure.force, t, q, w, coupled, p[n:], shown))
    return tuple(accelerations)
