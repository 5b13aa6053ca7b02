"""Compile the usual programs beforehand, in parallel processes.

Each case is run for a few steps, since a run decides what it compiles: one body, and ensembles with
shared and with per-body parameters. One body rotates too far for the small-angle form.
"""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from fastatt import arrays
from fastatt.attitudes import ATTITUDES
from fastatt.codegen import modules
from fastatt.engine.loop import WIDTH
from fastatt.gyro.integrate import integrate_rates
from fastatt.methods import METHODS
from fastatt.propagation import closed_form
from fastatt.propagation.choice_of_method import fits, methods_for
from fastatt.propagation.drift import drift
from fastatt.propagation.propagate import propagate
from fastatt.rounding import noted
from fastatt.scene import rates, torques
from fastatt.scene.scene import Scene
from fastatt.threads import default_threads, progress_bar

# a whole tile; the narrower program of 2 to 32 bodies is compiled when it is needed
_BODIES = WIDTH
_STEPS = 3
# away from the poles of Euler's angles
_TILTED = (0.8, 0.5, 0.3, 0.1)
_USUAL = tuple(name for name, attitude in ATTITUDES.items() if attitude.is_usual)
_OWN = np.linspace(0.9, 1.1, _BODIES)
_MOMENTS = np.array([2.0, 1.0, 0.7])


def _body(x: Any, torque: Any = None) -> Scene:
    return Scene(inertia=np.multiply.outer(x, _MOMENTS), torque=torque)


#: scenes without a user-defined function, with shared or per-body parameters x
SCENES: Mapping[str, Callable[[Any], Scene]] = {
    "constant rate": lambda x: Scene(rate=rates.Constant(np.multiply.outer(x, [0.1, 0.2, 0.3]))),
    "coning": lambda x: Scene(rate=rates.Coning(0.5 * x, x)),
    "free": _body,
    "heavy top": lambda x: _body(x, torques.HeavyTop(arm=(0.0, 0.0, 0.1), weight=x)),
    "gravity gradient and damping": lambda x: _body(
        x, torques.Sum((torques.GravityGradient(0.1 * x), torques.Damping(0.01 * x)))
    ),
}


@dataclass(frozen=True)
class Task:
    """A case to compile: a method on a scene, or on one of ``SCENES`` by its name.

    A method for logs has no scene. A task without a method compiles the functions of arrays.
    """

    scene: Scene | str | None
    method: str = ""
    representation: str = "quat"
    dtype: str = "float64"

    def run(self) -> None:
        """Run the case."""
        with noted(), np.errstate(all="ignore"):
            if not self.method:
                _functions(self.dtype)
            elif self.scene is None:
                _log(self)
            elif isinstance(self.scene, str):
                for x, n in (1.0, 1), (1.0, _BODIES), (_OWN, _BODIES):
                    _steps(self, SCENES[self.scene](x), n)
            else:
                params = self.scene.packed(None).params
                for n in (1, _BODIES) if params.ndim == 1 else (len(params),):
                    _steps(self, self.scene, n)


def _steps(task: Task, scene: Scene, n: int) -> None:
    q = np.tile(_TILTED, (n, 1))
    w = None if scene.kind == "rate" else np.tile([0.1, 0.2, 0.3], (n, 1))
    carried: dict[str, Any] = {"v0": np.zeros((n, 3))} if scene.moves else {}
    if scene.states:
        carried["s0"] = np.zeros((n, scene.states))
    placed: dict[str, Any] = {"r0": np.ones((n, 3))}
    if scene.needs_position:
        carried |= placed
    run = partial(
        propagate, scene, q, w, n_steps=_STEPS, method=task.method, dtype=task.dtype,
        representation=task.representation, **carried,
    )  # fmt: skip
    if scene.moves and not scene.needs_position and task.representation in _USUAL:
        run(dt=0.01, **placed)
    found = run(dt=0.01)
    # conversions of the states
    _ = found.q, found.w, found.dcm
    drift(found, scene)
    # beyond the limit of the small-angle form of any method
    if w is not None:
        w[0] *= 2000.0
    run(dt=20.0 if w is None else 0.01)


def _log(task: Task) -> None:
    scenes = METHODS[task.method].scenes
    for increments, wanted in ((False, "sampled rates"), (True, "increments")):
        if wanted in scenes:
            # the loop for one log differs from that for many
            for data in np.full((2000, 3), 1e-3), np.full((32, 20, 3), 1e-3):
                integrate_rates(
                    data, 0.01, method=task.method, increments=increments, dtype=task.dtype,
                    n_threads=1,
                )  # fmt: skip


def _functions(dtype: str) -> None:
    """Conversions between attitudes, and the closed form at one time and at many."""
    q = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=dtype), (_BODIES, 1))
    v = np.full((_BODIES, 3), 0.1, dtype=dtype)
    arrays.angle_between(q, q)
    arrays.quat_multiply(q, q)
    arrays.dcm_to_quat(arrays.quat_to_dcm(q))
    arrays.euler313_to_quat(arrays.quat_to_euler313(q))
    arrays.rotation_vector_to_quat(arrays.quat_to_rotation_vector(q))
    arrays.mrp_to_quat(arrays.quat_to_mrp(q))
    arrays.quat_rotate(q, v)
    arrays.quat_rotate_inverse(q, v)
    for moments in (_MOMENTS, np.multiply.outer(_OWN, _MOMENTS)):
        for t in (1.0, np.array([0.0, 1.0])):
            closed_form.free_body(q, v, moments, t, dtype=dtype)


def _dtypes(everything: bool) -> tuple[str, ...]:
    return ("float64", "float32") if everything else ("float64",)


def usual(*, everything: bool = False) -> list[Task]:
    """Every method on every scene, on quaternions and matrices in double precision.

    ``everything`` adds single precision and all other representations.
    """
    logs = ["", *(m.name for m in METHODS.values() if m.window is not None)]
    found = [Task(None, name, dtype=dtype) for name in logs for dtype in _dtypes(everything)]
    for name in SCENES:
        found += of_scene(SCENES[name](1.0), name, everything=everything)
    return found


def of_scene(scene: Scene, name: str = "", *, everything: bool = False) -> list[Task]:
    """Every method that fits a scene, which is given itself or by its name in ``SCENES``."""
    sent = replace(scene)  # without the scene's caches
    return [
        Task(name or sent, method, representation, dtype)
        for method in methods_for(scene)
        for representation in METHODS[method].representations
        if everything or representation in _USUAL
        for dtype in _dtypes(everything)
        if fits(METHODS[method], scene, representation)
    ]


def _run_alone(task: bytes) -> None:
    """Run a task in a new process."""
    modules.say_nothing()
    pickle.loads(task).run()


def precompile(
    tasks: Sequence[Task], *, processes: int | None = None, progress: bool = False
) -> str:
    """Compile the programs of tasks; returns their number, size and folder as text.

    Raises ``ValueError`` if programs can't be kept on disk.
    """
    if modules.folder() is None:
        raise ValueError(where())
    # pickled here, since an error in the pool's thread might block
    sent = [pickle.dumps(task) for task in tasks]
    workers = max(1, min(processes or default_threads(), len(tasks)))
    before, _ = modules.usage()
    spawn = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(workers, mp_context=spawn) as pool,
        progress_bar(progress, len(tasks), "case") as done,
    ):
        # after an error, tasks that have not begun are cancelled
        for _ in pool.map(_run_alone, sent):
            done(1)
    return f"{modules.usage()[0] - before} programs made; {where()}"


def where() -> str:
    """Number, size and folder of the programs on disk."""
    folder = modules.folder()
    if folder is None:
        return f"nothing is kept: {modules.reason()}"
    files, size = modules.usage()
    return f"{files} programs, {size / 1e6:.1f} MB in {folder}"
