"""One program in three processes: compiled, loaded, and not optimised: the same bits.

Operations are written as they are to be rounded, so that LLVM's optimiser changes none.
"""

import json
import os
import subprocess
import sys

import pytest
from each import in_tiers

RUNS = """
import json, math, sys, warnings
import numpy as np
import fastatt as fa
from fastatt import _store

warnings.simplefilter("ignore")
found, every = {}, int(sys.argv[1])  # all programs, or every third
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
    ("rk4", "quat"), ("rk8", "dcm"), ("gbs16", "quat"), ("strang2", "quat"), ("rk4", "mrp"),
    ("rk4", "dcm_rows"), ("magnus4", "quat"), ("lie_euler", "quat"),
)[::every]:
    scene = fa.Scene(rate=cone) if method in ("lie_euler", "magnus4") else free
    given = start[:1] if scene.kind == "rate" else start
    for dtype in ("float64", "float32")[::every]:
        run = fa.propagate(
            scene, *given, dt=0.1, n_steps=9, method=method, representation=representation,
            dtype=dtype, save_every=3,
        )
        keep(f"{method} {representation} {dtype}", run.q, run.w)
winding = fa.Scene(inertia=(2.0, 1.0, 0.7), torque=called)
assert [scene.functions[0].followed for scene in (turned, winding)] == [True, False]
for name, scene, options in (
    ("followed", turned, {}),
    ("model", fa.Scene(inertia=(2.0, 1.0, 0.7), torque=damped), {}),
    ("compensated", turned, {"compensated": True}),
    ("called", winding, {}),
    ("large steps", free, {"method": "strang2", "dt": 3.0}),
)[::every]:
    run = fa.propagate(scene, *start, **({"dt": 0.1, "n_steps": 9, "method": "rk4"} | options))
    keep(name, run.q, run.w)
rates = np.random.default_rng(1).normal(size=(40, 3))
for method in ("coning2", "picard")[: 3 - every]:
    keep(method, fa.integrate_rates(rates, 0.1, method=method))
keep("rows", fa.quat_multiply(*start[:1], start[0][::-1]))
print(json.dumps([found, _store.hits, _store.made]))
"""


@pytest.mark.parametrize("every", in_tiers([3], [1, 3]))
def test_loaded_and_optimised_programs_give_the_same_bits(every, tmp_path):
    """A second process compiles nothing, nor does the folder grow."""
    script = tmp_path / "runs.py"  # a followed function's source has to be somewhere
    script.write_text(RUNS, encoding="utf-8")

    def call(level):
        folder = tmp_path / level
        env = {"NUMBA_OPT": level, "FASTATT_CACHE": str(folder), "NUMBA_CACHE_DIR": ""}
        done = subprocess.run(
            [sys.executable, "-W", "error", str(script), str(every)],
            env=os.environ | env, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        files = {x.name: x.stat() for x in folder.rglob("*") if x.is_file()}
        return *json.loads(done.stdout), {k: (x.st_ino, x.st_size) for k, x in files.items()}

    found, hits, made, files = call("3")
    assert (hits, made) == (0, len(files))
    assert len(found) == {1: 24, 3: 6}[every]
    assert call("3") == (found, made, 0, files)
    plain = call("0")[0]
    assert {name for name, bits in found.items() if plain[name] != bits} == set()
