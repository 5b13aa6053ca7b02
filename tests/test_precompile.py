"""Compiled beforehand: what a later process needs is there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fastatt as fa
from fastatt import precompile

ROOT = Path(__file__).resolve().parents[1]
SCENE = """
inertia = [2.0, 1.0, 1.5]
[torque]
model = "Rotor"
momentum = [0.1, 0.0, 0.2]
"""
# the command, of two methods: that a scene's are all those that fit is in other tests
COMMAND = """
from fastatt import cli, precompile
every = precompile.of_scene
precompile.of_scene = lambda *a, **k: [t for t in every(*a, **k) if t.method in ("rk4", "cf4")]
if __name__ == "__main__":  # else its processes would run it too
    for processes in ("2", "1"):
        assert not cli.main(["precompile", "--scene-file", "scene.toml", "-j", processes])
    exec({runs!r})
"""
# works on all cases, each of which has a cache of its own
EACH = """
import os, warnings
import numpy as np
import fastatt as fa
from fastatt import precompile
from fastatt.codegen import modules
from pathlib import Path
from fastatt.trade.scene_file import read_scene
warnings.simplefilter("ignore", fa.StepWarning)
rng = np.random.default_rng(1)
q, w = rng.normal(size=(200, 4)), rng.normal(size=(200, 3))
for name, work in {work!r}.items():
    os.environ["FASTATT_CACHE"] = name
    modules._found.cache_clear()
    modules.made = modules.hits = 0
    exec(work)
    print(name, modules.made, modules.hits)
"""
# users' runs, not those that warming makes: other numbers, sizes and saves
FREE = """
for moments in ((3.0, 2.0, 1.2), rng.uniform(1.0, 1.4, (200, 3))):
    scene = fa.Scene(inertia=moments)
    run = fa.propagate(scene, q, w, dt=0.02, n_steps=70, method="rk4", save_every=7)
    fa.drift(run, scene), run.q, run.w, run.dcm
    fa.propagate(scene, q, 1000.0 * w, dt=0.02, n_steps=3, method="dmv4")
fa.propagate(fa.Scene(inertia=(3.0, 2.0, 1.2)), q[0], w[0], dt=0.02, n_steps=7, method="rk4")
"""
CONING = """
for x in (1.0, rng.uniform(0.5, 1.0, 200)):
    scene = fa.Scene(rate=fa.rates.Coning(0.3 * x, x))
    run = fa.propagate(scene, q, dt=0.02, n_steps=70, method="magnus4", save_every=7)
    fa.drift(run, scene), run.q, run.w, run.dcm
    fa.propagate(scene, q, dt=20.0, n_steps=7, method="magnus4")
"""
LOG = """
fa.integrate_rates(rng.normal(size=(5000, 3)), 0.01)
fa.integrate_rates(rng.normal(size=(100, 30, 3)), 0.01)
"""
ARRAYS = """
fa.closed_form.free_body(q, w, (3.0, 2.0, 1.2), 5.0)
fa.angle_between(q, fa.dcm_to_quat(fa.quat_to_dcm(q)))
"""
OF_FILE = """
scene = read_scene(Path("scene.toml"))
for method in ("rk4", "cf4"):
    fa.propagate(scene, q, w, dt=0.02, n_steps=70, method=method, save_every=7)
"""


def python(arguments, folder):
    """What a new process prints."""
    done = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "FASTATT_CACHE": str(folder / "cache"), "PYTHONPATH": str(ROOT)},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def each(work, folder):
    """How many functions a new process makes and how many it finds, case by case."""
    lines = python(["-c", EACH.format(work=work)], folder).splitlines()
    return {name: (int(made), int(hits)) for name, made, hits in map(str.split, lines)}


CASES = {
    "free": ([("free", "rk4"), ("free", "dmv4")], FREE),
    "coning": ([("coning", "magnus4")], CONING),
    "log": ([(None, "previous")], LOG),
    "arrays": ([(None, "")], ARRAYS),
}


def test_a_later_process_compiles_nothing(tmp_path):
    """A case's cache is filled by its own tasks alone."""
    tasks = {
        name: "".join(f"precompile.Task({scene!r}, {method!r}).run();" for scene, method in asked)
        for name, (asked, _) in CASES.items()
    }
    for made, hits in each(tasks, tmp_path).values():
        assert made > hits
    later = each({name: runs for name, (_, runs) in CASES.items()}, tmp_path)
    assert {name for name, (made, hits) in later.items() if made or not hits} == set(), later


def test_the_command_compiles_the_methods_of_a_scene(tmp_path):
    """In processes: from a cold cache to one in which the scene's runs find all they need."""
    (tmp_path / "scene.toml").write_text(SCENE)
    runs = EACH.format(work={"cache": OF_FILE})
    (tmp_path / "command.py").write_text(COMMAND.format(runs=runs))
    words, again, runs = map(str.split, python(["command.py"], tmp_path).splitlines())
    made, kept = int(words[0]), int(words[3])
    assert words[1:3] == again[1:3] == ["programs", "made;"]
    assert words[-1] == str(tmp_path / "cache")
    assert kept == made > 6
    assert again[0] == "0"
    assert runs[1] == "0"
    assert int(runs[2]) > 0


def test_what_is_usual_is_every_method():
    tasks = precompile.usual()
    for name, scene in precompile.SCENES.items():
        shared, own = scene(1.0), scene(precompile._OWN)
        assert (shared.packed(64).params.ndim, own.packed(64).params.ndim) == (1, 2)
        for made in (shared, own):
            assert {t.method for t in tasks if t.scene == name} == set(fa.methods_for(made))
    logs = {t.method for t in tasks if t.scene is None}
    assert logs - {""} == {m.name for m in fa.METHODS.values() if m.window is not None}
    assert {(t.representation, t.dtype) for t in tasks} == {("quat", "float64"), ("dcm", "float64")}


def test_everything_is_every_representation_and_precision():
    tasks = precompile.usual(everything=True)
    found = {(t.method, t.representation, t.dtype) for t in tasks if t.scene == "coning"}
    assert found == {
        (m, rep, dtype)
        for m in fa.methods_for(precompile.SCENES["coning"](1.0))
        for rep in fa.METHODS[m].representations
        for dtype in ("float64", "float32")
    }
    assert len(tasks) == len(set(map(str, tasks)))


@pytest.mark.parametrize("representation", ["rotation_vector", "euler313"])
@pytest.mark.parametrize("scene", ["coning", "free"])
def test_every_representation_is_run(scene, representation):
    """Coordinates too, which have poles."""
    precompile.Task(scene, "rk4", representation).run()


def test_a_scene_with_mass_and_rows_of_its_own():
    """Each body's numbers are taken as they are, with and without positions."""
    moments = np.array([[2.0, 1.5, 1.0], [2.0, 1.6, 1.1]])
    scene = fa.Scene(inertia=moments, mass=2.0, force=(0.0, 0.0, 1.0))
    tasks = precompile.of_scene(scene)
    assert {t.method for t in tasks} == set(fa.methods_for(scene))
    assert {t.representation for t in tasks} == {"quat", "dcm"}
    tasks[0].run()
