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
import sys
from pathlib import Path
from kept_function import add
from fastatt import _numba
_numba.check()
_numba.keep(add, sys.argv[1])
add(1.0, 2.0)
print(sum(add.stats.cache_hits.values()), len(list(Path(add.stats.cache_path).iterdir())))
"""


def test_the_check_holds_and_files_are_found_in_two_processes(tmp_path):
    (tmp_path / "kept_function.py").write_text(
        "from numba import njit\n@njit\ndef add(x, y):\n    return x + y\n"
    )
    path = os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])
    env = os.environ | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for stamp, hits, files in (("1", "0", "2"), ("1", "1", "2"), ("2", "0", "4"), ("1", "1", "4")):
        told = subprocess.run(
            [sys.executable, "-c", SCRIPT, stamp],
            env=env,
            capture_output=True,
            text=True,
            check=True,
        )
        assert told.stdout.split() == [hits, files]


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
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
