"""Narrower vectors, no fused multiplication, ARM: the same formulas, the same bits where fused."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import START, generic
from llvmlite import binding as llvm
from machine_code import innermost_loops, texts

import fastatt as fa
from fastatt.codegen.processor import described, processor
from fastatt.propagation.inspect_step import job_of

ROOT = Path(fa.__file__).resolve().parents[1]
N = 70
BODIES = generic(N)
Q0 = np.tile(START, (N, 1))
W0 = np.random.default_rng(3).normal(size=(N, 3))
MOMENTS = np.sort(1.0 + 0.5 * np.abs(BODIES.c[:, 0]))
FAST = fa.rates.Polynomial(BODIES.c * np.linspace(1.0, 100.0, N)[:, None, None])
# name: what NUMBA_CPU_NAME and NUMBA_CPU_FEATURES say, bytes of a vector, whether it fuses
PROCESSORS = {
    "AVX2": ("haswell", "+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+avx,+avx2,+fma", 32, True),
    "no AVX": ("x86-64", "+sse2", 16, False),
}


def free():
    return fa.Scene(inertia=(2.0, 1.0, 2 / 3))


def results():
    """Of each run, state, norm_error and status; scenes are new, and remember no program."""
    found = {}
    top = fa.Scene(inertia=(1.0, 2.0, 2.5), torque=fa.torques.HeavyTop((0.1, 0.2, 0.3), 2.0))
    for name, scene, method, dtype in (
        ("free", free(), "rk4", "float64"),
        ("fast", fa.Scene(rate=FAST), "lie_midpoint", "float32"),
        ("moments", fa.Scene(inertia=MOMENTS), "dmv10", "float64"),
        ("top", top, "strang2", "float32"),
        ("rate", BODIES.scene, "magnus4", "float64"),
    ):
        w0 = None if scene.kind == "rate" else W0
        traj = fa.propagate(
            scene, Q0, w0, dt=0.05, n_steps=20, save_every=8, method=method, dtype=dtype
        )
        found |= {f"{name} {k}": getattr(traj, k) for k in ("state", "norm_error", "status")}
    return found


def results_on(name, folder):
    """The results of a process that is told what its processor is."""
    cpu, features, *known = PROCESSORS[name]
    host = re.findall(r"\+([\w.]+)", llvm.get_host_cpu_features().flatten())
    if not {*re.findall(r"\w[\w.]*", features)} <= {*host}:
        pytest.skip(f"{name}: not a part of this processor")
    path, folders = folder / "runs.npz", os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    told = {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": features, "PYTHONPATH": folders}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", __file__, str(path)],
        cwd=ROOT, env=os.environ | told, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(x) for x in known]
    with np.load(path) as file:
        return dict(file)


def different(a, b):
    return [name for name in a if a[name].tobytes() != b[name].tobytes()]


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
def test_half_the_vectors_give_the_same_bits(tmp_path):
    there = results_on("AVX2", tmp_path)
    here = results()
    assert different(here, there) == []
    assert here["fast status"].any()  # turns beyond π: the careful form was compiled there too
    assert not here["fast status"].all()


@pytest.mark.filterwarnings("ignore::fastatt.StepWarning")
def test_without_fused_multiplication_results_differ_by_rounding(tmp_path):
    there, here = results_on("no AVX", tmp_path), results()
    for name in ("free", "fast", "moments", "top", "rate"):
        fine = here[f"{name} status"] == 0
        assert fine.any()
        assert (there[f"{name} status"] == here[f"{name} status"]).all()
        a, b = (x[f"{name} state"][:, fine] for x in (here, there))
        eps = np.finfo(a.dtype).eps
        # 20 steps of some roundings each
        assert np.abs(a - b).max() < 225 * eps * max(1.0, float(np.abs(a).max()))


@pytest.fixture
def arm(monkeypatch):
    """Programs are written for a 64-bit ARM; what makes its assembly."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        target = llvm.Target.from_triple("aarch64-linux-gnu")
    except RuntimeError as error:
        pytest.skip(str(error))
    found = described("aarch64-linux-gnu", "generic", "")
    for module in ("codegen.emitter", "engine.program"):
        monkeypatch.setattr(f"fastatt.{module}.processor", lambda: found)
    machine = target.create_target_machine(cpu="generic", features="", opt=2)

    def assembly(text):
        module = llvm.parse_assembly(text)
        module.triple, module.data_layout = machine.triple, str(machine.target_data)
        return machine.emit_assembly(module)

    return assembly


@pytest.mark.newest
@pytest.mark.parametrize(("dtype", "lanes"), [("float64", "2d"), ("float32", "4s")])
def test_an_arm_computes_on_whole_vectors(arm, dtype, lanes):
    job = job_of(free(), "rk4", "quat", dtype)
    assembly = arm(texts(job)[0])
    steps = max(innermost_loops(assembly), key=len)
    fused = [match[1] for line in steps if (match := re.match(r"\tfml[as]\tv\d+\.(\w+)", line))]
    wanted = [node.op for node in job.small_angle.nodes]
    assert len(fused) == sum(op in ("fma", "fms", "fnma") for op in wanted)
    assert set(fused) == {lanes}
    # nothing is left for single numbers: what all bodies share stands before the loop
    alone = [x for x in steps if re.match(r"\tf(?:n?m(?:add|sub|ul)|add|sub|div|sqrt)\t[ds]\d+", x)]
    assert alone == []
    assert not any(re.match(r"\tbl\t", line) for line in steps)


def test_the_environment_names_the_processor():
    assert processor().vector in (16, 32, 64)
    assert described("aarch64-linux-gnu", "neoverse-n1", "+neon").vector == 16
    assert not described("x86_64-linux-gnu", "x86-64", "+sse2,-fma").fuses


if __name__ == "__main__":
    np.savez(sys.argv[1], **results())
    print(processor().vector, processor().fuses)
