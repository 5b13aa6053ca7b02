"""Compile what is usual before it is needed, in processes side by side.

What a program is made for is decided where runs are, so each case is run for a few steps: one body,
and an ensemble with numbers that all share and with each body's own; one of them turns too far for
the quick form.
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

# those of a whole tile: of 2 to 32 bodies it is narrower, and compiled when it is needed
_BODIES = WIDTH
_STEPS = 3
# away from the poles of Euler's angles
_TILTED = (0.8, 0.5, 0.3, 0.1)
_USUAL = tuple(name for name, attitude in ATTITUDES.items() if attitude.is_usual)
_OWN = np.linspace(0.9, 1.1, _BODIES)
_MOMENTS = np.array([2.0, 1.0, 0.7])


def _body(x: Any, torque: Any = None) -> Scene:
    return Scene(inertia=np.multiply.outer(x, _MOMENTS), torque=torque)


#: scenes that need no user's function, with numbers x that all share or of each body's own
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
    """What one process compiles at a time: a method on a scene of its own or on one of ``SCENES``.

    A method for logs has no scene; without a method it is what takes arrays, the closed form
    included.
    """

    scene: Scene | str | None
    method: str = ""
    representation: str = "quat"
    dtype: str = "float64"

    def run(self) -> None:
        """Do what compiles it."""
        with noted(), np.errstate(all="ignore"):
            if not self.method:
                _functions(self.dtype)
            elif self.scene is None:
                _log(self)
            elif isinstance(self.scene, str):
                for x, n in (1.0, 1), (1.0, _BODIES), (_OWN, _BODIES):
                    _steps(self, SCENES[self.scene](x), n)
            else:
                own = self.scene.packed(None).params
                for n in (1, _BODIES) if own.ndim == 1 else (len(own),):
                    _steps(self, self.scene, n)


def _steps(task: Task, scene: Scene, n: int) -> None:
    q = np.tile(_TILTED, (n, 1))
    w = None if scene.kind == "rate" else np.tile([0.1, 0.2, 0.3], (n, 1))
    still = np.zeros((n, 3))
    carried: dict[str, Any] = {"v0": still} if scene.moves else {}
    placed: dict[str, Any] = {"r0": still + 1.0}
    if scene.needs_position:
        carried |= placed
    run = partial(
        propagate, scene, q, w, n_steps=_STEPS, method=task.method, dtype=task.dtype,
        representation=task.representation, **carried,
    )  # fmt: skip
    if carried and not scene.needs_position and task.representation in _USUAL:
        run(dt=0.01, **placed)
    found = run(dt=0.01)
    # what a trajectory makes of its states
    _ = found.q, found.w, found.dcm
    drift(found, scene)
    # beyond any limit: what the quick form is not for
    if w is not None:
        w[0] *= 2000.0
    run(dt=20.0 if w is None else 0.01)


def _log(task: Task) -> None:
    scenes = METHODS[task.method].scenes
    for increments, wanted in ((False, "sampled rates"), (True, "increments")):
        if wanted in scenes:
            # one log is integrated in another way than many
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
    arrays.quat_rotate(q, v)
    arrays.quat_rotate_inverse(q, v)
    for moments in (_MOMENTS, np.multiply.outer(_OWN, _MOMENTS)):
        for t in (1.0, np.array([0.0, 1.0])):
            closed_form.free_body(q, v, moments, t, dtype=dtype)


def usual(*, everything: bool = False) -> list[Task]:
    """Every method on every scene, on quaternions and matrices in double precision.

    ``everything`` adds single precision and all other representations.
    """
    dtypes = ("float64", "float32") if everything else ("float64",)
    found = [Task(None, dtype=dtype) for dtype in dtypes]
    for name in SCENES:
        found += of_scene(SCENES[name](1.0), name, everything=everything)
    logs = [m.name for m in METHODS.values() if m.window is not None]
    return found + [Task(None, name, dtype=dtype) for name in logs for dtype in dtypes]


def of_scene(scene: Scene, name: str = "", *, everything: bool = False) -> list[Task]:
    """Every method that fits a scene, or one of ``SCENES`` by its name."""
    dtypes = ("float64", "float32") if everything else ("float64",)
    sent = replace(scene)  # without what the scene keeps of its own making
    return [
        Task(name or sent, method, representation, dtype)
        for method in methods_for(scene)
        for representation in METHODS[method].representations
        if everything or representation in _USUAL
        for dtype in dtypes
        if fits(METHODS[method], scene, representation)
    ]


def _run_alone(task: bytes) -> None:
    """Run a task in a process of its own."""
    modules.say_nothing()
    pickle.loads(task).run()


def precompile(
    tasks: Sequence[Task], *, processes: int | None = None, progress: bool = False
) -> str:
    """Compile what tasks need, and say how many programs are kept, how large, and where.

    Raises ``ValueError`` where nothing can be kept.
    """
    if modules.folder() is None:
        raise ValueError(where())
    # here, where what fails is seen: in the pool's own thread it may wait for ever
    sent = [pickle.dumps(task) for task in tasks]
    workers = max(1, min(processes or default_threads(), len(tasks)))
    before, _ = modules.usage()
    spawn = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(workers, mp_context=spawn) as pool,
        progress_bar(progress, len(tasks), "case") as done,
    ):
        # where one fails, those that were not begun are cancelled
        for _ in pool.map(_run_alone, sent):
            done(1)
    return f"{modules.usage()[0] - before} programs made; {where()}"


def where() -> str:
    """The folder of machine code, how many programs are in it, how large they are."""
    folder = modules.folder()
    if folder is None:
        return f"nothing is kept: {modules.reason()}"
    files, size = modules.usage()
    return f"{files} programs, {size / 1e6:.1f} MB in {folder}"
