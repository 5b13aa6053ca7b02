"""Scenes that are propagated."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import fastatt as fa
from fuzz.draw import NO_METHODS, WORDS, Draw
from fuzz.judge import Call, trajectory

# targets


def run_options(d: Draw, kinds: tuple[str | None, ...] = (None,)) -> dict[str, Any]:
    options: dict[str, Any] = {"dt": d.real(), "n_steps": d.whole(), "n_threads": 1}
    if d.chance(0.6):
        options["save_every"] = d.one((1, 2, None, d.whole()))
    for name, p, value in (
        ("t0", 0.1, lambda: d.real(1.0)),
        ("n_threads", 0.05, d.whole),
        ("normalise", 0.1, lambda: d.one(("output", "never", 2, d.whole(), d.one(WORDS)))),
        ("representation", 0.03, lambda: d.one(WORDS)),
        ("on_save", 0.02, lambda: d.one((str, 3, "x"))),
    ):
        if d.chance(p):
            options[name] = value()
    options["dtype"] = d.one(kinds) if d.chance(0.97) else d.one((int, "f2", "x", 7, [], object))
    return options


class Run(NamedTuple):
    """A scene that is propagated: its model, the method and its representation are compiled."""

    scene: Callable[[Draw], fa.Scene]
    method: str
    representation: str = "quat"
    kinds: tuple[str | None, ...] = ("float64",)
    compensated: bool = False


def moments(d: Draw, *shape: int) -> NDArray[np.float64]:
    """Principal moments that a body can have, of wild sizes too."""
    scale = 10.0 ** d.rng.uniform(-300, 300) if d.chance(0.3) else 1.0
    return scale * d.rng.uniform(1.0, 1.6, size=shape)


def constant_rate(d: Draw) -> fa.Scene:
    frame = d.one(("body", "inertial"))
    return fa.Scene(rate=fa.rates.Constant(d.numbers(d.one(((3,), (2, 3))))), frame=frame)


def free_body(d: Draw) -> fa.Scene:
    return fa.Scene(inertia=moments(d, *d.one(((3,), (2, 3)))))


def damped_body(d: Draw) -> fa.Scene:
    return fa.Scene(inertia=moments(d, 3), torque=fa.torques.Damping(float(d.numbers(()))))


def moving_body(d: Draw) -> fa.Scene:
    mass = float(moments(d))
    return fa.Scene(inertia=moments(d, 3), mass=mass, force=d.numbers((3,)))


RUNS = (
    Run(constant_rate, "magnus4", kinds=("float64", "float32", None)),
    Run(constant_rate, "rk4", "euler313"),
    Run(free_body, "exact"),
    Run(free_body, "dmv10"),
    Run(free_body, "strang2"),
    Run(damped_body, "rk4", "dcm"),
    Run(moving_body, "rk4"),
    Run(constant_rate, "magnus4", compensated=True),
    Run(free_body, "rk4", compensated=True),
)
ARGUMENTS = (
    "scene", "q0", "w0", "v0", "r0", "dt", "n_steps", "method", "representation", "save_every",
    "dtype", "n_threads", "t0", "compensated", "normalise", "on_save", "rate", "inertia",
    "params", "frame", "torque", "mass", "force", "every",
    "allow_unphysical",
)  # fmt: skip


def propagated(d: Draw, runs: tuple[Run, ...]) -> Call:
    run = d.one(runs)
    scene: Any = None
    while scene is None:
        with contextlib.suppress(ValueError), np.errstate(all="ignore"):
            scene = run.scene(d)
    q0 = d.array((4,), (2, 4), (2, 4))
    options = {"method": run.method, "representation": run.representation}
    options |= run_options(d, run.kinds)
    if run.compensated:
        options["compensated"] = d.one((True, True, True, 1, False, 0, None))
    if options["representation"] is None or options["representation"] != run.representation:
        options["method"] = None if d.chance(0.5) else run.method
        options["representation"] = "matrix"
    if d.chance(0.04):
        options["method"] = d.one(NO_METHODS)
    w0 = None
    if scene.kind != "rate" or d.chance(0.02):
        w0 = d.array((3,), (2, 3))
    if scene.moves or d.chance(0.02):
        options["v0"] = d.array((3,), (2, 3))
    if d.chance(0.02):
        scene = d.one((scene.rate, None, "scene", fa.Scene, 3))

    def judge(traj: Any) -> str | None:
        if traj is None:
            return "gave None"
        return trajectory(traj, raw=options.get("normalise") == "never")

    return Call(fa.propagate, (scene, q0, w0), options, judge, ARGUMENTS)
