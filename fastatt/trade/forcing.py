"""What acts on bodies along their path: whether it jumps, and the shortest time it changes in."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt.attitudes import QUATERNION
from fastatt.codegen.rows import rows
from fastatt.scene.equations import Body, PrescribedRate, Structure
from fastatt.tracing.formulas import quat, scale
from fastatt.trade.measure import Case, Problem

_BODIES = 64  # at most, evenly from the first to the last
_SAMPLES = 2**19  # in all, 1024 to 16384 a body
_SUSPECTS = 4  # intervals of a body that are bisected, those of the largest change
_HALVINGS = 24
# of what it ranges over: what is left of a change after all halvings is a jump, or none
_JUMP = 1e-3
_STEPS = 4.0  # of a reference, in the time that a change takes
# of the largest number: a range below is rounding
_CONSTANT = 1e-8


class Forcing(NamedTuple):
    """Steps that resolve what acts, and where it jumps: "" or "t = 5.4 s (body 3)"."""

    steps: int
    jump: str


class _Path(NamedTuple):
    """Times (S,) or (S, N), and the bodies' states (S, N, k) then."""

    t: NDArray[np.float64]
    states: tuple[NDArray[np.float64], ...]

    def middle(self, other: _Path) -> _Path:
        states = tuple(0.5 * (a + b) for a, b in zip(self.states, other.states, strict=True))
        return _Path(0.5 * (self.t + other.t), states)

    def chosen(self, other: _Path, first: NDArray[np.bool_]) -> _Path:
        """Of each body the state of one path where that is the first, else of the other."""
        pairs = zip(self.states, other.states, strict=True)
        states = tuple(np.where(first[..., None], a, b) for a, b in pairs)
        return _Path(np.where(first, self.t, other.t), states)


def forcing(problem: Problem, case: Case, n_steps: int) -> Forcing:
    """Sample rates, torques and forces along a path that a run in ``n_steps`` steps shows.

    At many more times than there are steps, one by chance in each even interval; intervals of the
    largest changes are halved again and again: of what is continuous the change falls.
    """
    few = np.unique(np.linspace(0, problem.ensemble.size - 1, _BODIES).astype(np.intp))
    problem = problem.take(few)
    size = few.size
    count = int(np.clip(_SAMPLES // size, 1024, 16384))
    chance = np.random.default_rng(0).uniform(size=count)
    times = (np.arange(count) + chance) * (problem.t_end / count)
    run = problem.run(case, n_steps, save_at=problem.t0 + times)
    carried = [run.carried.get(name, run.q[..., 1:] * 0.0) for name in ("w", "v", "r")]
    signs = np.where((run.q[1:] * run.q[:-1]).sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    q = run.q.copy()
    q[1:] *= np.cumprod(signs, axis=0)
    path = _Path(np.repeat(run.t[:, None], size, axis=1), (q, *carried))
    with np.errstate(all="ignore"):
        found = _acting(problem, path)
        steps, jump = 1, ""
        for name, f in found.items():
            finest, where = _examined(problem, path, name, f)
            steps = max(steps, finest)
            if where is not None:
                jump = jump or f"the {name} jumps near t = {where[0]:.6g} s (body {few[where[1]]})"
    return Forcing(steps, jump)


def _examined(
    problem: Problem, path: _Path, name: str, f: NDArray[np.float64]
) -> tuple[int, tuple[float, int] | None]:
    """Steps that resolve a quantity (S, N, 3), and the time and the body of a jump."""
    ranges = np.ptp(f, axis=0).max(axis=-1)
    varies = ranges > _CONSTANT * np.abs(f).max(axis=(0, 2))
    changes = np.abs(np.diff(f, axis=0)).max(axis=-1)
    if not (varies & np.isfinite(ranges)).any():
        return 1, None
    slopes = (changes / np.diff(path.t, axis=0)).max(axis=0)
    steps = _STEPS * problem.t_end * np.max(slopes[varies] / ranges[varies])
    suspects = np.argsort(changes, axis=0)[-_SUSPECTS:]

    def taken(rows: NDArray[np.intp]) -> _Path:
        states = tuple(np.take_along_axis(x, rows[..., None], axis=0) for x in path.states)
        return _Path(np.take_along_axis(path.t, rows, axis=0), states)

    low, high = taken(suspects), taken(suspects + 1)
    f_low, f_high = _acting(problem, low)[name], _acting(problem, high)[name]
    for _ in range(_HALVINGS):
        middle = low.middle(high)
        f_middle = _acting(problem, middle)[name]
        left = np.abs(f_middle - f_low).max(axis=-1) > np.abs(f_high - f_middle).max(axis=-1)
        low, high = low.chosen(middle, left), middle.chosen(high, left)
        f_low = np.where(left[..., None], f_low, f_middle)
        f_high = np.where(left[..., None], f_middle, f_high)
    gaps = np.where(varies, np.abs(f_high - f_low).max(axis=-1) / ranges, 0.0)
    k, body = np.unravel_index(np.nanargmax(gaps), gaps.shape)
    if not gaps[k, body] > _JUMP:
        return int(min(steps, 2**31)) + 1, None
    return 1, (float(low.t[k, body]), int(body))


def _acting(problem: Problem, path: _Path) -> dict[str, NDArray[np.float64]]:
    """Rates, or accelerations by torques and forces, (S, N, 3) each, at states of the bodies."""
    packed = problem.ensemble.scene.packed(problem.ensemble.size)
    structure = packed.structure
    names = ["rate" if isinstance(structure.turning, PrescribedRate) else "torque"]
    names += [] if structure.force is None else ["force"]
    inputs = {"t": None, "q": 4, "w": 3, "v": 3, "r": 3, "p": structure.n_params}
    formula = rows(
        partial(_formula, structure), inputs, (3,) * len(names), key=(_formula, structure)
    )
    p = packed.params[..., : structure.n_params]
    found = formula(path.t, *path.states, p, tables=packed.tables)
    return dict(zip(names, found, strict=True))


def _formula(structure: Structure, t: Any, q: Any, w: Any, v: Any, r: Any, p: Any) -> Any:
    turning, n = structure.turning, structure.turning.n_params
    place = () if structure.force is None else (v, r if structure.position else ())
    own, q = p[:n], quat.normalise(q)
    found = []
    if isinstance(turning, PrescribedRate):
        found.append(turning.law.formula(t, own))
    else:
        motion, attitude, rate = Body(QUATERNION, turning, own, q[0]), q, w
        if motion.axes is not None:
            attitude, rate = quat.mul(q, motion.axes), quat.rotate_inverse(motion.axes, w)
        torque = motion.torque(t, attitude, rate, place)
        inverse = zip(motion.half_inverse, torque, strict=True)
        found.append(tuple(2.0 * k * x for k, x in inverse))
    if structure.force is not None:
        force = structure.force.formula(t, q, w, *place, p[n + 1 :])
        found.append(scale(p[n], tuple(force)))
    return tuple(found)
