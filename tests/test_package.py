"""The package as it is built, installed and imported."""

from __future__ import annotations

import email
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import fastatt

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RUNTIME = {"numba", "numpy"}
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


def test_version_is_the_projects(metadata):
    assert PROJECT["dynamic"] == ["version"]
    assert fastatt.__version__ == metadata["Version"]


def test_runtime_needs_numba_and_numpy_only(metadata):
    assert names(PROJECT["dependencies"]) == RUNTIME
    required = metadata.get_all("Requires-Dist")
    assert names(r for r in required if "extra ==" not in r) == RUNTIME


def test_wheel_holds_every_module_and_the_type_marker_and_nothing_else(wheel):
    shipped = {n for n in wheel.namelist() if ".dist-info/" not in n}
    files = (ROOT / "fastatt").rglob("*.py")
    assert shipped == {p.relative_to(ROOT).as_posix() for p in files} | {"fastatt/py.typed"}


def test_readme_is_shipped(metadata):
    assert metadata["Description-Content-Type"] == "text/markdown", "pyproject.toml: readme"


def test_licence_is_shipped(wheel):
    assert any(n.endswith(".dist-info/licenses/LICENSE") for n in wheel.namelist())


def test_command_is_declared(wheel):
    (name,) = (n for n in wheel.namelist() if n.endswith(".dist-info/entry_points.txt"))
    assert "fastatt = fastatt.__main__:main" in wheel.read(name).decode()


@pytest.mark.parametrize(
    "convention",
    [
        "scalar first",
        "Hamilton",
        "v_i = q∘v_b∘q*",
        "v_i = C v_b",
        "q̇ = ½ q∘w",
        "Ċ = C [w×]",
        'frame="inertial"',
        "q̇ = ½ w∘q",
        "Ċ = [w×] C",
        "SI",
        "(S, N, 4)",
        "φ̇ sinθ sinψ + θ̇ cosψ, φ̇ sinθ cosψ − θ̇ sinψ, φ̇ cosθ + ψ̇",
    ],
)
def test_docstring_states_the_conventions(convention):
    assert convention in " ".join(fastatt.__doc__.split())


def test_public_names_exist():
    assert sorted(set(fastatt.__all__)) == sorted(fastatt.__all__)
    assert [n for n in fastatt.__all__ if not hasattr(fastatt, n)] == []


def fresh_python(code):
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_import_works_without_optional_packages():
    fresh_python(f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL})); import fastatt")


def test_import_loads_no_optional_package():
    """Numba itself loads scipy where it is installed: what counts is what comes on top."""
    loaded = fresh_python(
        "import sys, numba; before = set(sys.modules); import fastatt; "
        "print(*set(sys.modules) - before)"
    )
    assert [m for m in loaded if m.partition(".")[0] in OPTIONAL] == []
