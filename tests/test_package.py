"""The package as it is built, installed and imported."""

import ast
import compileall
import email
import importlib
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import fastatt
from fastatt import methods

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OPTIONAL = ["matplotlib", "tqdm", "scipy", "dask", "distributed", "skinematics"]


def names(requirements):
    return {re.split(r"[^\w.-]", r, maxsplit=1)[0].lower() for r in requirements}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that ``pip install .`` would make."""
    target = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(target)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    (path,) = target.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        yield archive


@pytest.fixture(scope="module")
def metadata(wheel):
    (name,) = (n for n in wheel.namelist() if n.endswith(".dist-info/METADATA"))
    return email.message_from_bytes(wheel.read(name))


def test_metadata(metadata):
    """The version is the project's; what it needs to run is NumPy and Numba."""
    assert PROJECT["dynamic"] == ["version"]
    assert fastatt.__version__ == metadata["Version"]
    required = metadata.get_all("Requires-Dist")
    for needed in (PROJECT["dependencies"], [r for r in required if "extra ==" not in r]):
        assert names(needed) == {"numba", "numpy"}
    assert metadata["Description-Content-Type"] == "text/markdown", "pyproject.toml: readme"


def test_wheel_holds_every_module_the_type_marker_the_licence_and_the_command(wheel):
    shipped = {n for n in wheel.namelist() if ".dist-info/" not in n}
    files = (ROOT / "fastatt").rglob("*.py")
    typed = {"fastatt/py.typed", "fastatt/__init__.pyi"}
    assert shipped == {p.relative_to(ROOT).as_posix() for p in files} | typed
    assert any(n.endswith(".dist-info/licenses/LICENSE") for n in wheel.namelist())
    (name,) = (n for n in wheel.namelist() if n.endswith(".dist-info/entry_points.txt"))
    assert "fastatt = fastatt.__main__:main" in wheel.read(name).decode()


def test_public_names_are_those_that_type_checkers_know():
    """The table of names and the stub agree, and each name is what the stub says it is."""
    stub = ast.parse(Path(fastatt.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    modules = {name.name: node.module for node in imports for name in node.names}
    (listed,) = (ast.literal_eval(n.value) for n in stub.body if isinstance(n, ast.Assign))
    assert len(listed) == 50
    assert sorted(listed) == sorted(fastatt.__all__) == sorted(set(modules) - {"Final"})
    for name in listed:
        module = importlib.import_module(modules[name])
        found = getattr(fastatt, name)
        assert (
            found is getattr(module, name, None) or found is sys.modules[f"{modules[name]}.{name}"]
        )


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("propogate", "(nearest: propagate)"),
        ("plots", "(a module: import fastatt.plots)"),
        ("mean_attitude", "(in fastatt.estimation: mean_attitude)"),
        ("to_scipy", "(in fastatt.interchange: to_scipy)"),
        ("quat", "(in fastatt.kernels: quat)"),
    ],
)
def test_an_unknown_name_is_told_its_place(name, place):
    with pytest.raises(AttributeError, match=re.escape(place)):
        fastatt.__getattr__(name)


def test_methods_of_all_files_are_listed():
    """Each by its name, in the file that the table says, and no other."""
    files = [path.stem for path in Path(methods.__file__).parent.glob("[!_]*.py")]
    defined = {(name, file) for file in files for name in methods._defined_in(file)}
    assert defined == set(methods._FILES.items())


FIRST_RUN = f"""
import sys
import fastatt.engine.tape
print(*{{'numba', *{OPTIONAL}}} & {{*sys.modules}})
import fastatt as fa
fa.propagate(fa.Scene(inertia=(1.0, 2.0, 2.5)), [1, 0, 0, 0], [0.1, 0.2, 0.3], dt=0.01, n_steps=1,
             method="rk4")
print(*(m for m in sys.modules if m.startswith("fastatt")))
"""


def test_a_first_run_imports_what_it_needs():
    """No optional package and no compiler at first; no method but its own, no model of torques."""
    not_needed, loaded = fresh_python(FIRST_RUN).splitlines()
    assert not_needed == ""
    others = {"fastatt.methods.magnus", "fastatt.scene.torques", "fastatt.closed_form"}
    assert len(loaded.split()) <= 85
    assert not others & {*loaded.split()}


def fresh_python(code):
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.parametrize("kind", ["zip", "pyc"])
def test_an_installation_without_sources_says_so(tmp_path, kind):
    shutil.copytree(ROOT / "fastatt" / "kernels", tmp_path / "fastatt" / "kernels")
    for name in ("__init__.py", "_jit.py", "_numba.py", "_store.py", "checks.py"):
        shutil.copy(ROOT / "fastatt" / name, tmp_path / "fastatt")
    place = tmp_path
    if kind == "zip":
        place = Path(shutil.make_archive(str(tmp_path / "library"), "zip", tmp_path, "fastatt"))
    else:
        assert compileall.compile_dir(tmp_path, quiet=1, legacy=True)
        for source in tmp_path.rglob("*.py"):
            source.unlink()
    code = f"import sys; sys.path.insert(0, {str(place)!r}); import fastatt; fastatt.kernels.quat"
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    last = done.stderr.splitlines()[-1]
    assert re.match(r"ImportError: fastatt: found .* without its source; accepted: ", last)


def test_import_works_without_optional_packages():
    fresh_python(f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL})); import fastatt")
