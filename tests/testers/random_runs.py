"""Random runs: all that must not change a bit of a run, and whether it does.

Scene, method, representation, precision, rounding carried along, events, breakpoints, controllers
and states are drawn, and a number of bodies from 1 to 130.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for

ROOT = Path(__file__).resolve().parents[2]
OTHER_PROCESS = """
import pickle, sys, warnings
from random_runs import numbers, run
warnings.simplefilter("ignore")
scene, arguments = pickle.load(sys.stdin.buffer)
sys.stdout.buffer.write(pickle.dumps(numbers(run(scene, arguments))))
"""


def swing(t, q, w, p):
    return p[0] * np.sin(3.0 * t), p[1] * w[1] - q[0] * q[1], 0.1


def jumping(t, q, w, p):
    return (p[0] if 0.503 < t < 1.5 else -p[0]), q[0] * q[1], 0.02 * t


def lagged(t, q, w, s, p):
    return (-p[0] * s[0], 0.0, q[0] * q[2]), (p[1] * (w[0] - s[0]), s[0])


def held(t, q, w, s, p):
    return (-p[0] * w[0], -s[0], 0.0), (s[0] + 0.1 * w[1],)


def turning(t, p):
    return p[0] * np.sin(t), p[1], np.cos(p[0] * t)


def spin_of_x(t, q, w, p):
    return w[0]


def height(t, q, w, p):
    return q[1] * q[3] - q[0] * q[2] + 0.1


class Draw:
    """A scene with the arguments of its run."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        self.n = n = int(rng.choice([1, 2, 3, 7, 63, 64, 65, 128, rng.integers(4, 131)]))
        self.start: dict[str, Any] = {}
        self.kind = str(rng.choice(sorted(SCENES)))
        self.scene = SCENES[self.kind](self)
        self.start["q0"] = rng.normal(size=(n, 4))
        if self.scene.kind != "rate":
            self.start["w0"] = rng.normal(size=(n, 3))
        self.options = self.drawn_options()

    def one(self, *values: Any) -> Any:
        return values[self.rng.integers(len(values))]

    def sizes(self, *shape: int) -> Any:
        """Numbers of each body, or of all."""
        return self.rng.uniform(0.1, 0.6, (self.n, *shape) if self.rng.random() < 0.7 else shape)

    def inertia(self) -> Any:
        """Of each body or of all, symmetric ones and matrices among them."""
        moments = np.array(self.one((2.0, 1.0, 1.5), (1.0, 1.0, 0.6), (2.0, 1.0, 2 / 3)))
        if self.rng.random() < 0.2:
            return np.diag(moments) + 0.1
        if self.n == 3 or self.rng.random() < 0.5:  # (3, 3) may be a matrix
            return moments
        return moments * (1.0 + 0.1 * self.rng.random((self.n, 1)))

    def drawn_options(self) -> dict[str, Any]:
        rng, scene = self.rng, self.scene
        names = methods_for(scene, "quat")
        record = fa.METHODS[str(rng.choice(names))]
        fitting = [x for x in record.representations if record.name in methods_for(scene, x)]
        options: dict[str, Any] = {
            "dt": float(self.one(0.01, 1 / 64, 0.013, *[-0.02] * (self.kind != "samples"))),
            "n_steps": int(rng.integers(2, 120)),
            "t0": float(self.one(0.0, 0.25, -3.1, 100.7)),
            "method": record.name,
            "representation": str(self.one("quat", *fitting)),
            "dtype": str(self.one("float64", "float64", "float32")),
        }
        if record.compensates and options["representation"] == "quat" and rng.random() < 0.25:
            options["compensated"] = True
        if rng.random() < 0.3:
            options["normalise"] = self.one("never", 1, 3, 17)
        if record.is_stepped and scene.kind != "rate" and rng.random() < 0.4:
            terminal = bool(self.one(False, True))
            events = [fa.event(spin_of_x), fa.event(height, direction=1, terminal=terminal)]
            options["events"] = events[: int(self.one(1, 2))]
        return options


SCENES = {
    "cones": lambda d: fa.Scene(rate=fa.rates.Coning(d.sizes(), d.sizes() + 1.0)),
    "polynomials": lambda d: fa.Scene(rate=fa.rates.Polynomial(d.sizes(3, 3))),
    "inertial rate": lambda d: fa.Scene(
        rate=fa.rates.Sinusoidal(d.sizes(3), d.sizes(3), d.sizes(3)), frame="inertial"
    ),
    "rate function": lambda d: fa.Scene(rate=turning, params=d.sizes(2)),
    "free": lambda d: fa.Scene(inertia=d.inertia()),
    "gravity": lambda d: fa.Scene(inertia=d.inertia(), torque=fa.torques.GravityGradient(0.3)),
    "torque function": lambda d: fa.Scene(inertia=d.inertia(), torque=swing, params=d.sizes(2)),
    "sum": lambda d: fa.Scene(
        inertia=d.inertia(),
        torque=fa.torques.Sum((fa.torques.Damping(0.1), fa.torques.Rotor((0.1, 0.2, 0.3)))),
    ),
    "breakpoints": lambda d: fa.Scene(
        inertia=d.inertia(),
        breakpoints=(0.503, 1.5),
        torque=fa.torques.Custom(jumping, d.sizes(1), uses_rate=False),
    ),
    "moved": lambda d: (
        d.start.update(v0=d.rng.normal(size=(d.n, 3)))
        or (d.rng.random() < 0.7 and d.start.update(r0=d.rng.normal(size=(d.n, 3))))
        or fa.Scene(inertia=d.inertia(), mass=1.0 + d.sizes(), force=(0.1, 0.2, 0.3))
    ),
    "states": lambda d: (
        d.start.update(s0=d.rng.normal(size=(d.n, 2)))
        or fa.Scene(inertia=d.inertia(), torque=lagged, states=2, params=d.sizes(2))
    ),
    "samples": lambda d: (
        d.start.update(s0=np.zeros((d.n, 4)))
        or fa.Scene(
            inertia=d.inertia(),
            torque=fa.torques.SampledControl(held, float(d.one(0.25, 0.07)), (0.3,), states=1),
        )
    ),
}  # fmt: skip


def run(scene: fa.Scene, arguments: dict[str, Any], **more: Any) -> fa.Trajectory:
    return fa.propagate(scene, **{**arguments, **more})


def numbers(run: fa.Trajectory, bodies: Any = slice(None), saves: Any = slice(None)) -> list[Any]:
    """All of some bodies at some saves: NaN equals NaN, 0 does not equal −0.

    Where the sign of attitudes is not propagated it is a matter of the saves.
    """
    q = run.q if run.representation == "quat" else run.q * np.copysign(1.0, run.q[..., :1])
    histories = {"state": run.state, "q": q, "w": run.w, "norm": run.norm_error, **run.carried}
    of_bodies = {"status": run.status, "crossings": run.first_crossings}
    arrays = {name: x[saves][:, bodies] for name, x in histories.items()}
    arrays |= {name: x[bodies] for name, x in of_bodies.items() if x is not None}
    return [(name, x.shape, x.dtype.str, x.tobytes()) for name, x in arrays.items()]


def of_runs(seed: int, folder: Path) -> tuple[str, str]:
    """A run, and the same in other ways: what differs, if any."""
    draw = Draw(seed)
    scene, arguments = draw.scene, {**draw.options, **draw.start}
    about = f"{draw.n} bodies, {draw.kind}, {draw.options}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            whole = run(scene, arguments, save_every=1, n_threads=1)
        except ValueError as error:
            return f"refused: {str(error)[:30]}", ""
        for name, (made, wanted) in comparisons(draw, whole, folder, seed):
            if made != wanted:
                fields = [x[0] for x, y in zip(made, wanted, strict=False) if x != y]
                return draw.kind, f"{about}: {name} differs in {fields or 'length'}"
    return draw.kind, ""


def comparisons(draw: Draw, whole: fa.Trajectory, folder: Path, seed: int):
    """(what is done another way, (its numbers, those wanted))."""
    scene, arguments, rng, n = draw.scene, {**draw.options, **draw.start}, draw.rng, draw.n
    steps = arguments["n_steps"]
    last = numbers(whole, saves=slice(-1, None))
    plain = run(scene, arguments)
    yield "the last save alone", (numbers(plain), last)
    for k in (2, 3, 7):
        made = run(scene, arguments, save_every=1, n_threads=k)
        yield f"{k} threads", (numbers(made), numbers(whole))
    a, b = sorted(rng.integers(0, n + 1, 2).tolist())
    rows = slice(a, max(b, a + 1)) if a < n else slice(n - 1, n)
    of_rows = {name: x[rows] for name, x in draw.start.items()}
    made = run(scene[rows], {**arguments, **of_rows}, save_every=1)
    yield f"bodies {rows}", (numbers(made), numbers(whole, rows))
    every = int(rng.integers(1, steps + 2))
    saved = sorted({*range(0, steps, every), steps})
    made = run(scene, arguments, save_every=every, on_save=fa.to_file(folder / "h.npy"))
    yield f"saves every {every}, to a file", (numbers(made), numbers(whole, saves=saved))
    some = sorted(set(rng.integers(1, steps + 1, 3).tolist()) | {steps})
    if fa.METHODS[arguments["method"]].is_stepped or arguments["t0"] == 0.0:
        # a closed form takes the time since t0, which t − t0 is to rounding only
        made = run(scene, arguments, save_at=whole.t[some])
        yield f"saves at steps {some}", (numbers(made), numbers(whole, saves=some))
    yield "a pickle of the run", (numbers(pickle.loads(pickle.dumps(whole))), numbers(whole))
    copied = pickle.loads(pickle.dumps(scene))
    yield "a pickle of the scene", (numbers(run(copied, arguments)), last)
    given = {k: v for k, v in draw.options.items() if k not in ("t0", "dtype")}
    position = {"position": "r0" in draw.start} if scene.moves else {}
    plan = fa.plan(scene, n, dtype=draw.options["dtype"], t0=whole.t[0], **given, **position)
    for name, way in (("a plan", plan), ("a pickle of a plan", pickle.loads(pickle.dumps(plan)))):
        yield name, (numbers(way(**draw.start)), last)
    if fa.METHODS[arguments["method"]].is_stepped and steps > 2:
        a, b = sorted(rng.integers(0, steps + 1, 2).tolist())
        events = {"events": arguments["events"]} if "events" in arguments else {}
        first = run(scene, arguments, n_steps=a)
        middle = fa.resume(scene, first, n_steps=b - a, **events)
        middle.save_end(folder / "end")
        made = fa.resume(scene, folder / "end", n_steps=steps - b, **events)
        yield f"resumed after {a} and {b} steps", (numbers(made), last)
    if "events" not in arguments and n > 1:
        yield from own_steps(draw)
    if seed % 8 == 0:
        yield "another process without a cache", (in_another_process(scene, arguments), last)


def own_steps(draw: Draw):
    """Step sizes of each body, beside runs of one body."""
    counts = draw.rng.integers(3, 40, draw.n)
    span = 0.5 * np.sign(draw.options["dt"])
    options = {k: v for k, v in draw.options.items() if k not in ("compensated", "normalise")}
    own = {**options, "dt": span / counts, "n_steps": counts}
    together = run(draw.scene, {**own, **draw.start})
    for k in draw.rng.choice(draw.n, min(3, draw.n), replace=False).tolist():
        rows = slice(k, k + 1)
        one = {**options, **{name: x[rows] for name, x in draw.start.items()}}
        alone = run(draw.scene[rows], one, dt=span / counts[k], n_steps=int(counts[k]))
        yield f"own steps, body {k}", (numbers(together, rows), numbers(alone))


def in_another_process(scene: fa.Scene, arguments: dict[str, Any]) -> list[Any]:
    """The numbers of a run in a process of its own."""
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests" / "testers")])
    done = subprocess.run(
        [sys.executable, "-c", OTHER_PROCESS], input=pickle.dumps((scene, arguments)),
        env={**os.environ, "FASTATT_CACHE": "0", "PYTHONPATH": path}, capture_output=True,
        check=True,
    )  # fmt: skip
    return pickle.loads(done.stdout)
