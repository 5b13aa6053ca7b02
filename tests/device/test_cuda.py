"""``device="cuda"``: the kernel in Numba's simulator, as a compiler leaves it, and on a GPU."""

from __future__ import annotations

import collections
import json
import math
import os
import re
import subprocess
import sys
import warnings
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from exact import EPS, START, generic

import fastatt as fa
from fastatt.device import kernel, program
from fastatt.propagation.choice_of_method import method_of
from fastatt.propagation.inspect_step import job_of

ROOT = Path(fa.__file__).resolve().parents[1]
N, STEPS = 2, 6
BODIES = generic(N)
RNG = np.random.default_rng(5)
Q0 = np.tile(START, (N, 1))
W0, V0 = RNG.normal(size=(2, N, 3))
INERTIA = np.sort(1.0 + 0.5 * RNG.random((N, 3)))
TENSOR = np.array([[2.0, 0.2, 0.1], [0.2, 2.5, -0.3], [0.1, -0.3, 3.0]])


def gamma(t, p):
    return p[0] * math.gamma(1.5 + t), p[1], p[2]


def spinning(t, p):
    return p[0] + 0.1 * t, p[1], p[2] if t > 0.2 else p[0]


def following(t, s, p):
    return (s[0], p[1], s[1]), (p[0] - s[0], -s[1] * t)


def largest(t, q, w, s):
    return max(s[0], w[0] * w[0] + w[1] * w[1] + w[2] * w[2])


FAST = np.array([[0.3, 0.2, 0.1], [70.0, 40.0, 90.0]])  # one in the quick form, one beyond π a step
SAMPLED = fa.torques.Sampled(RNG.normal(size=(9, 3)) * 0.2, 0.25)
WHEELS = fa.TimeSeries(np.linspace(0.0, 1.0, 5), RNG.normal(size=(N, 5, 3)))


def of_wheels(t, q, w, p):
    return WHEELS(t, p[0])


READ = fa.torques.Sum(
    (fa.torques.Rotor(WHEELS), fa.torques.Custom(of_wheels, np.arange(float(N))[:, None]))
)
FREE = fa.Scene(inertia=INERTIA)
# name: scene, method, other options
RUNS = {
    "coning": (BODIES.scene, "magnus4", {}),
    "inertial rows": (
        fa.Scene(rate=BODIES.model, frame="inertial"), "cg3", {"representation": "dcm_rows"},
    ),
    "beyond π, known": (fa.Scene(rate=fa.rates.Constant(FAST)), "lie_midpoint", {}),
    "beyond π": (fa.Scene(rate=spinning, params=FAST), "lie_midpoint", {"normalise": 3}),
    "mended": (
        fa.Scene(rate=spinning, params=FAST), "rk4", {"normalise": 2, "save_every": None},
    ),
    "states": (fa.Scene(rate=following, states=2, params=W0), "rk4", {"s0": V0[:, :2]}),
    "angles": (BODIES.scene, "rk4", {"representation": "euler313"}),
    "free": (FREE, "rk4", {"save_every": 1, "t0": 2.0}),
    "reduced": (FREE, "rk4", {"reduce": fa.reducer(largest, start=0.0)}),
    "compensated": (FREE, "dmv2", {"compensated": True}),
    "kicked": (fa.Scene(inertia=INERTIA, torque=SAMPLED), "strang2", {"normalise": "never"}),
    "tables": (fa.Scene(inertia=INERTIA, torque=READ), "rk4", {}),
    "falling": (
        fa.Scene(inertia=TENSOR, mass=2.0, force=fa.forces.ConstantInertial((0.0, 0.0, -9.8))),
        "rk4", {"r0": V0},
    ),
    "orbiting": (
        fa.Scene(
            inertia=TENSOR, mass=2.0, torque=fa.torques.CentralGravityGradient(0.1),
            force=fa.forces.CentralGravity(0.1),
        ),
        "rk4", {"r0": V0},
    ),
}  # fmt: skip
DOUBLE = ("inertial rows", "falling", "orbiting")
CASES = [(name, "float64") for name in RUNS]
CASES += [(name, "float32") for name in RUNS if name not in DOUBLE]


def run(name, dtype="float64", **options):
    scene, method, more = RUNS[name]
    w0 = None if scene.kind == "rate" else W0
    v0 = V0 if scene.moves else None
    given = {"save_every": 4, "n_steps": STEPS, "dtype": dtype, **more, **options}
    return fa.propagate(scene, Q0, w0, v0=v0, dt=0.05, method=method, **given)


def arrays_of(traj):
    return {
        "t": traj.t, "state": traj.state, "norm_error": traj.norm_error, "status": traj.status,
        "q": traj.q, "w": traj.w, "watch": traj.end.diagnostics, **traj.carried,
    }  # fmt: skip


def different(a, b):
    """What of two trajectories is not the same, bit for bit."""
    x, y = arrays_of(a), arrays_of(b)
    return [name for name in x if x[name].tobytes() != y[name].tobytes()]


def simulated():
    """Each run in the simulator beside the formulas in Python; what else a GPU would be asked."""
    from numba import cuda

    found = {}
    for name, dtype in CASES:
        here, there = run(name, dtype), run(name, dtype, device="cuda")
        found[f"{name}, {dtype}"] = different(here, there)
        found["flags"] = found.get("flags", 0) | int(there.status.max())
    pieces = {"device": [], None: []}
    for where, seen in (("cuda", pieces["device"]), (None, pieces[None])):

        def keep(piece, seen=seen):
            seen.append((piece.t.tolist(), piece.state.tobytes(), piece.norm_error.tobytes()))

        # more saves than are kept at a time: a run in pieces
        seen.append(run("free", n_steps=17, on_save=keep, device=where).end.diagnostics.tobytes())
    found["pieces"] = [len(pieces[None]), pieces["device"] == pieces[None]]
    left_there = fa.propagate(
        FREE, cuda.to_device(Q0), W0, dt=0.05, n_steps=STEPS, method="rk4", device="cuda"
    )
    here = fa.propagate(FREE, Q0, W0, dt=0.05, n_steps=STEPS, method="rk4")
    found["left there"] = [
        isinstance(left_there.q, np.ndarray),
        left_there.q.copy_to_host().tobytes() == here.q.tobytes(),
        left_there.w.copy_to_host().tobytes() == here.w.tobytes(),
    ]
    options = {"dt": 0.05, "method": "rk4", "device": "cuda"}
    part = fa.propagate(FREE, Q0, W0, n_steps=4, **options)
    on = fa.propagate(FREE, resume=part, n_steps=STEPS - 4, save_every=1, **options)
    found["resumed"] = [on.t.size, on.q[-1].tobytes() == here.q[-1].tobytes()]
    bad, w0 = Q0.copy(), W0.copy()
    bad[0, 0] = w0[0, 1] = np.nan
    options = {"dt": 0.05, "n_steps": STEPS, "method": "rk4", "invalid": "flag"}
    flagged = [fa.propagate(FREE, bad, w0, **options, device=x) for x in (None, "cuda")]
    found["bad"] = [x.status.tolist() for x in flagged]
    found["bad"].append(flagged[1].q[:, 1].tobytes() == here.q[:, 1].tobytes())
    found["refused"] = [
        refused(fa.Scene(rate=gamma, params=W0), None, "rk4"),
        refused(FREE, W0, "exact"),
    ]
    cuda.is_available = lambda: False
    found["no GPU"] = refused(FREE, W0, "rk4")
    return found


def refused(scene, w0, method):
    with pytest.raises(ValueError, match="cuda") as raised:
        fa.propagate(scene, Q0, w0, dt=0.05, n_steps=1, method=method, device="cuda")
    return str(raised.value)


@pytest.fixture(scope="module")
def in_simulator():
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__],
        cwd=ROOT,
        env={
            **os.environ,
            "NUMBA_ENABLE_CUDASIM": "1",
            "NUMBA_DISABLE_JIT": "1",
            "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "tests"))),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(("name", "dtype"), CASES)
def test_the_kernel_gives_the_bits_of_the_formulas_in_python(name, dtype, in_simulator):
    assert in_simulator[f"{name}, {dtype}"] == []


def test_runs_have_steps_beyond_pi_and_losses_that_mending_hides(in_simulator):
    """Else the careful form would not have been asked, nor what mending keeps."""
    lost = fa.Status.STEP_TOO_LARGE | fa.Status.NORM_LOST
    assert in_simulator["flags"] & lost == lost


def test_a_bad_body_is_flagged_alone(in_simulator):
    here, there, others = in_simulator["bad"]
    assert here == there == [fa.Status.NON_FINITE, 0]
    assert others


def test_a_run_in_pieces_goes_on_where_it_was(in_simulator):
    assert in_simulator["pieces"] == [3, True]


def test_a_run_is_resumed_to_the_same_bits(in_simulator):
    assert in_simulator["resumed"] == [STEPS - 4 + 1, True]


def test_results_stay_on_the_device_where_a_value_lies_there(in_simulator):
    assert in_simulator["left there"] == [False, True, True]


def test_the_default_method_is_stepped():
    assert method_of(FREE, None, "quat").name == "exact"
    assert method_of(FREE, None, "quat", need="is_stepped").name == "rk8"


# refusals


def test_what_no_kernel_can_run_is_refused(in_simulator):
    opaque, closed = in_simulator["refused"]
    assert opaque.startswith('device: found "cuda" with gamma, a function')
    assert closed.startswith("method with device \"cuda\": found 'exact'; accepted: rk4")


def test_a_machine_without_a_gpu_is_told_what_to_do(in_simulator):
    assert in_simulator["no GPU"] == (
        'device: found "cuda", which Numba cannot use (no GPU is there); accepted: None, or on a '
        "machine with an NVIDIA GPU pip install 'fastatt[cuda]'"
    )


def test_steps_of_each_body_are_refused():
    job = job_of(FREE, "rk4", "quat", np.dtype("float64"))
    with pytest.raises(ValueError, match=r"^device: found \"cuda\" with a dt of each body"):
        kernel.text(replace(job, own_steps=True))


def test_a_run_that_does_not_fit_is_refused_with_its_size():
    with pytest.raises(MemoryError, match=r"^device: the run takes 2 GB, 1\.5 GB are free; "):
        program._check_room(2_000_000_000, 1_500_000_000)


def test_another_device_is_refused():
    with pytest.raises(ValueError, match=r"^device: found 'gpu'; accepted: cuda$"):
        run("free", device="gpu")


# compiled


def signature(job):
    from numba import types

    def array(kind, n):
        return types.Array(kind, n, "C")

    real = types.float64 if job.kind == "double" else types.float32
    rows, params = array(real, 2), array(types.float64, 2)
    return types.void(
        *(rows, rows, params, rows, array(real, 3), rows, rows, array(types.float64, 1), params),
        *[types.float64] * 4,
        *[types.int64] * 8,
        *[array(types.float64, 1) for _ in job.formulas.resources],
    )


@pytest.mark.skipif(find_spec("numba_cuda") is None, reason="no numba-cuda")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_what_is_compiled_has_the_operations_of_the_formulas(dtype):
    """No more and no fewer, fused where they are; no local memory; single precision stays so."""
    from numba import cuda

    job = replace(job_of(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), "rk4", "quat", dtype), width=1)
    try:
        ptx, _ = cuda.compile_ptx(kernel.kernel_of(job).py_func, signature(job), cc=(9, 0))
    except (RuntimeError, ImportError) as error:
        pytest.skip(f"no compiler for devices: {error}")
    formulas = job.formulas
    wanted = collections.Counter(
        node.op
        for flat in (formulas.begin, formulas.small_angle.monitored, formulas.save)
        for node in flat.nodes
    )
    real, other = ("f64", "f32") if dtype == "float64" else ("f32", "f64")
    found = collections.Counter(re.findall(rf"\b([a-z.]+)\.{real}\b", ptx))
    assert found["fma.rn"] == wanted["fma"] + wanted["fms"] + wanted["fnma"]
    assert found["mul.rn"] == wanted["*"]
    assert found["mul"] == 0
    assert found["div.rn"] == wanted["/"]
    assert found["sqrt.rn"] == wanted["sqrt"]
    assert ".local" not in ptx
    arithmetic = re.compile(rf"\b(?:fma|mul|add|sub|div|sqrt)[a-z.]*\.{other}\b")
    assert not arithmetic.findall(ptx)


# on a GPU


@pytest.fixture(scope="module")
def gpu():
    if find_spec("numba_cuda") is None:
        pytest.skip("no numba-cuda")
    from numba import cuda

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not cuda.is_available():
            pytest.skip("no GPU")


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning", "ignore::UserWarning")
@pytest.mark.parametrize(("name", "dtype"), CASES)
@pytest.mark.usefixtures("gpu")
def test_a_gpu_gives_what_the_processor_gives(name, dtype):
    """6 steps of some roundings each, as in test_plain; statuses are the same."""
    here, there = (arrays_of(run(name, dtype, device=x)) for x in (None, "cuda"))
    assert here.pop("status").tolist() == there.pop("status").tolist()
    eps = EPS if dtype == "float64" else 2.0**-23
    for key, value in here.items():
        size = max(1.0, float(np.abs(value).max()))
        assert np.abs(value - there[key]).max() < 450 * eps * size, key


if __name__ == "__main__":
    print(json.dumps(simulated()))
