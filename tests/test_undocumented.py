"""What the package uses of Numba and llvmlite beyond their documentation stands in one file."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import fastatt
from fastatt import _numba

PACKAGE = Path(fastatt.__file__).parent
# documented: llvmlite's layer of instructions, and Numba's functions for extensions
DOCUMENTED = {"numba", "numba.extending", "numba.types", "llvmlite", "llvmlite.ir"}
SCRIPT = """
from pathlib import Path
import kept_function
from fastatt import _jit, _numba
_numba.check()
_jit._kept(kept_function.add)
kept_function.add(1.0, 2.0)
print(
    sum(kept_function.add.stats.cache_hits.values()),
    len(list(_numba.folder_of(kept_function.add.py_func).iterdir())),
)
"""


def test_the_check_holds_and_files_are_found_in_two_processes(tmp_path):
    (tmp_path / "kept_function.py").write_text(
        "from numba import njit\n@njit\ndef add(x, y):\n    return x + y\n"
    )
    path = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    env = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for hits in (0, 1):
        told = subprocess.run(
            [sys.executable, "-c", SCRIPT], env=env, capture_output=True, text=True, check=True
        )
        assert told.stdout.split() == [str(hits), "2"]


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("never_kept", lambda module: None, "code is not to be kept"),
        ("prefer_wide_vectors", lambda function: None, "attributes"),
    ],
)
def test_the_check_names_what_differs(monkeypatch, name, value, what):
    monkeypatch.setattr(_numba, name, value)
    with pytest.raises(ImportError, match=what):
        _numba.check.__wrapped__()


def test_no_other_file_uses_what_is_not_documented():
    found = []
    for file in PACKAGE.rglob("*.py"):
        if file.name == "_numba.py":
            continue
        source = file.read_text()
        for node in ast.walk(ast.parse(source)):
            modules = [x.name for x in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            of = [x for x in modules if x.partition(".")[0] in ("numba", "llvmlite")]
            found += [(file.name, x) for x in of if x not in DOCUMENTED]
        assert ".pointee" not in source
    assert found == []
