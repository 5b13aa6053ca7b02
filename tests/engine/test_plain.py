"""``NUMBA_DISABLE_JIT=1``: the same formulas in Python."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import EPS, START, generic
from numba import njit

import fastatt as fa

ROOT = Path(fa.__file__).resolve().parents[1]
N, STEPS = 70, 20
BODIES = generic(N)
Q0 = np.tile(START, (N, 1))
RNG = np.random.default_rng(9)
INERTIA = np.sort(1.0 + 0.5 * RNG.random((N, 3)))
W0, V0 = RNG.normal(size=(2, N, 3))
ARM = (0.1, 0.2, 0.3)
TENSOR = np.array([[2.0, 0.2, 0.1], [0.2, 2.5, -0.3], [0.1, -0.3, 3.0]])


@njit
def straight(t, p):
    speed = p[0] if math.sin(3.0 * t) > p[1] else p[2]
    return speed, 0.2 * math.cos(t), -speed


@njit
def winding(t, p):
    return p[0] * math.gamma(1.5 + math.sin(t)), p[1], p[2]


@njit
def field(t, q, w, p):
    x = fa.kernels.quat.rotate_inverse(q, (0.0, 0.0, p[0]))
    return x[0] - 0.1 * w[0], x[1], x[2] * math.exp(-t)


HEAVY = fa.torques.HeavyTop(ARM, 2.0)
SAMPLED = fa.torques.Sampled(RNG.normal(size=(9, 3)) * 0.2, 0.25)
ALL = fa.torques.Sum((HEAVY, SAMPLED, fa.torques.AxisDamping((0.1, 0.2, 0.3))))
SHARED = fa.Scene(rate=fa.rates.Coning(0.5, 1.0))
INERTIAL = fa.Scene(rate=BODIES.model, frame="inertial")
USERS = fa.Scene(rate=straight, params=BODIES.c[:, 0])
CALLED = fa.Scene(rate=winding, params=BODIES.c[:, 0])
FREE = fa.Scene(inertia=INERTIA)
TOP = fa.Scene(inertia=(1.0, 1.0, 1.6))
BALL = fa.Scene(inertia=(1.0, 1.0, 1.0))
TORQUED = fa.Scene(inertia=(1.0, 2.0, 2.5), torque=ALL)
KICKED = fa.Scene(inertia=INERTIA, torque=fa.torques.Sum((HEAVY, SAMPLED)))
DAMPED = fa.Scene(inertia=INERTIA, torque=fa.torques.Damping(0.1))
TURNED = fa.Scene(inertia=TENSOR, torque=field, params=[0.3])
FALLING = fa.Scene(inertia=TENSOR, mass=2.0, force=fa.forces.ConstantInertial((0.0, 0.0, -9.8)))
GLIDING = fa.Scene(rate=BODIES.model, mass=1.5, force=fa.forces.Drag(0.2))
FAR = fa.Scene(rate=fa.rates.Polynomial(BODIES.c * np.linspace(1.0, 100.0, N)[:, None, None]))

AT = np.linspace(0.0, 0.05 * STEPS, 5)
EVENTS = [
    fa.event(lambda t, q, w, p: (t - 0.52) ** 2 - 1e-6),
    fa.event(lambda t, q, w, p: w[0] - 0.1, terminal=True),
]

# name: scene, method, representation, other options
RUNS = {
    "shared coning": (SHARED, "magnus4", "quat", {}),
    "each coning": (BODIES.scene, "magnus6", "quat", {}),
    "matrices": (BODIES.scene, "cf4", "dcm", {"normalise": 8}),
    "rows": (INERTIAL, "cg3", "dcm_rows", {}),
    "angles": (BODIES.scene, "rk4", "euler313", {}),
    "mrp": (BODIES.scene, "rk4", "mrp", {}),
    "vector": (BODIES.scene, "rk4", "rotation_vector", {}),
    "compensated": (BODIES.scene, "rkmk4", "quat", {"compensated": True}),
    "traced": (USERS, "lie_euler", "quat", {"normalise": "never"}),
    "called": (CALLED, "lie_midpoint", "quat", {}),
    "beyond": (FAR, "lie_midpoint", "quat", {}),
    "free": (FREE, "rk8", "quat", {}),
    "free, compensated": (FREE, "dmv10", "quat", {"compensated": True}),
    "symmetric": (TOP, "strang2", "quat", {}),
    "spherical": (BALL, "dmv4", "dcm", {}),
    "torqued": (TORQUED, "rk4", "quat", {"t0": 0.3}),
    "kicked": (KICKED, "kahan_li6", "quat", {}),
    "damped": (DAMPED, "kahan_li6", "dcm", {}),
    "turned": (TURNED, "rkmk4", "quat", {}),
    "falling": (FALLING, "rk4", "quat", {"r0": V0}),
    "gliding": (GLIDING, "rk4", "quat", {}),
    "events": (FREE, "rk4", "quat", {"events": EVENTS}),
    "events, kicked": (KICKED, "kahan_li6", "quat", {"events": EVENTS}),
    "events, times": (FREE, "rk4", "quat", {"events": EVENTS, "save_every": None, "save_at": AT}),
}
SINGLE = ("each coning", "matrices", "compensated", "called", "beyond", "symmetric", "torqued")
CASES = [(name, "float64") for name in RUNS] + [(name, "float32") for name in SINGLE]


def run(name, dtype="float64", **options):
    scene, method, representation, more = RUNS[name]
    w0 = None if scene.kind == "rate" else W0
    v0 = V0 if scene.moves else None
    given = {"save_every": 16} | more | options
    return fa.propagate(
        scene, Q0, w0, v0=v0, dt=0.05, n_steps=STEPS, method=method,
        representation=representation, dtype=dtype, **given,
    )  # fmt: skip


def results(name, dtype):
    traj = run(name, dtype)
    found = {
        "t": traj.t,
        "state": traj.state,
        "w": traj.w,
        "norm_error": traj.norm_error,
        "q": traj.q,
    }
    if traj.found is not None:
        found["event times"] = np.nan_to_num(traj.event_times.T)
    return {**found, **traj.carried, "status": traj.status}


@pytest.fixture(scope="module")
def in_python(tmp_path_factory):
    """The results of all runs in a process that compiles nothing."""
    path = tmp_path_factory.mktemp("plain") / "runs.npz"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, str(path)],
        cwd=ROOT,
        env={
            **os.environ,
            "NUMBA_DISABLE_JIT": "1",
            "FASTATT_CACHE": "0",
            "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "tests"))),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0", "programs"]
    with np.load(path) as file:
        return dict(file)


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
@pytest.mark.parametrize(("name", "dtype"), CASES)
def test_python_gives_what_machine_code_gives(name, dtype, in_python):
    """But for fused products: 20 steps of some roundings each."""
    eps = EPS if dtype == "float64" else 2.0**-23
    compiled = results(name, dtype)
    for key, value in compiled.items():
        other = in_python[f"{name}/{dtype}/{key}"]
        assert other.shape == value.shape, key
        assert other.dtype == value.dtype, key
        if key == "status":
            assert other.tolist() == value.tolist()
            continue
        fine = compiled["status"] == 0 if key != "t" else slice(None)
        a, b = (x if key == "t" else x[:, fine] for x in (value, other))
        assert a.size
        size = max(1.0, float(np.abs(a).max()))
        assert np.abs(a - b).max() < 225 * eps * size, key  # 5e-14 in double precision


if __name__ == "__main__":
    from fastatt.codegen import modules

    found = {}
    for name, dtype in CASES:
        found |= {f"{name}/{dtype}/{k}": v for k, v in results(name, dtype).items()}
    np.savez(sys.argv[1], **found)
    print(modules.hits + modules.made, "programs")
