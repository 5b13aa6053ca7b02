"""LLVM's optimiser changes no bit of a result: operations are written as they are to be rounded."""

from __future__ import annotations

import json
import os
import subprocess
import sys

RUNS = """
import json, math, warnings
import numpy as np
import fastatt as fa

warnings.simplefilter("ignore")
found = {}
start = np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, -0.5, 0.5]]), np.array([[0.1, 2.0, 0.3]] * 2)


def torque(t, q, w, p):
    return math.sin(t) * q[1] - 0.1 * w[0], (0.2 if t < 0.25 else -0.1) * w[2], math.exp(-t) * q[3]


def called(t, q, w, p):
    return math.gamma(1.5 + t) * q[1], -0.1 * w[1], 0.0


def keep(name, *arrays):
    found[name] = [np.ascontiguousarray(x).tobytes().hex() for x in arrays]


free, turned = fa.Scene(inertia=(2.0, 1.0, 0.7)), fa.Scene(inertia=(2.0, 1.0, 0.7), torque=torque)
cone, damped = fa.rates.Coning(0.5, 1.0), fa.torques.Damping(0.1)
for method, representation in (
    ("rk4", "quat"), ("rk8", "dcm"), ("gbs16", "quat"), ("rk4", "mrp"), ("rk4", "dcm_rows"),
    ("strang2", "quat"), ("lie_euler", "quat"), ("magnus4", "quat"),
):
    scene = fa.Scene(rate=cone) if method in ("lie_euler", "magnus4") else free
    given = start[:1] if scene.kind == "rate" else start
    for dtype in ("float64", "float32"):
        run = fa.propagate(
            scene, *given, dt=0.1, n_steps=9, method=method, representation=representation,
            dtype=dtype, save_every=3,
        )
        keep(f"{method} {representation} {dtype}", run.q, run.w)
for name, scene, options in (
    ("followed", turned, {}),
    ("called", fa.Scene(inertia=(2.0, 1.0, 0.7), torque=called), {}),
    ("model", fa.Scene(inertia=(2.0, 1.0, 0.7), torque=damped), {}),
    ("compensated", turned, {"compensated": True}),
    ("large steps", free, {"method": "strang2", "dt": 3.0}),
):
    run = fa.propagate(scene, *start, **({"dt": 0.1, "n_steps": 9, "method": "rk4"} | options))
    keep(name, run.q, run.w)
rates = np.random.default_rng(1).normal(size=(40, 3))
for method in ("coning2", "picard"):
    keep(method, fa.integrate_rates(rates, 0.1, method=method))
keep("rows", fa.quat_multiply(*start[:1], start[0][::-1]))
print(json.dumps(found))
"""


def test_optimised_and_not_give_the_same_bits(tmp_path):
    found = []
    for level in ("3", "0"):
        env = {"NUMBA_OPT": level, "FASTATT_CACHE": str(tmp_path / level)}
        done = subprocess.run(
            [sys.executable, "-c", RUNS],
            env=os.environ | env, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.append(json.loads(done.stdout))
    assert len(found[0]) >= 20
    assert {name for name, bits in found[0].items() if found[1][name] != bits} == set()
