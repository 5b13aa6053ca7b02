"""A fork while another thread imports or compiles, as its first call does."""

import os
import subprocess
import sys
import textwrap

import pytest

FORKED = """
import os, signal, sys, threading
import fastatt
{before}
begun, may_end = threading.Event(), threading.Event()
sys.begun, sys.may_end = begun, may_end
thread = threading.Thread(target=first_call)
thread.start()
begun.wait()
threading.Timer(0.2, may_end.set).start()
child = os.fork()
if child == 0:
    signal.alarm(20)
    first_call()
    os._exit(0)
thread.join()
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
IMPORTS = """
import {name}
{name}.__path__.append(sys.argv[1])
def first_call():
    import {name}.slow
"""
COMPILES = """
from numba.core.compiler_lock import global_compiler_lock
from llvmlite.binding.ffi import lib
def first_call():
    with {lock}:
        begun.set()
        may_end.wait(5)
"""
COMPUTES = """
from fastatt._fork import cached_property
class Kept:
    @cached_property
    def value(self):
        begun.set()
        return may_end.wait(5)
def first_call():
    Kept().value
"""
LOGS = """
import logging
from numba.core.compiler_lock import global_compiler_lock
def first_call():
    with global_compiler_lock:
        begun.set()
        may_end.wait(0.5)
        logging.getLogger("numba").isEnabledFor(logging.DEBUG)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize(
    "before",
    [
        *(IMPORTS.format(name=x) for x in ("fastatt", "numpy")),
        *(COMPILES.format(lock=x) for x in ("global_compiler_lock", "lib._lock")),
        COMPUTES,
        LOGS,
    ],
    ids=["fastatt", "numpy", "numba", "llvm", "property", "logging"],
)
def test_a_child_does_not_wait_for_a_thread_that_it_does_not_have(before, tmp_path):
    (tmp_path / "slow.py").write_text("import sys\nsys.begun.set()\nsys.may_end.wait(5)\n")
    code = textwrap.dedent(FORKED).format(before=before)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, str(tmp_path)], check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0


ENDLESS = """
import os, sys, threading
import fastatt
sys.begun, sys.may_end = threading.Event(), threading.Event()
thread = threading.Thread(target=lambda: __import__("slow"))
thread.start()
sys.begun.wait()
child = os.fork()
if child == 0:
    os._exit(0)
sys.may_end.set()
thread.join()
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_waits_for_no_other_module(tmp_path):
    """The import of one may last as long as its program."""
    (tmp_path / "slow.py").write_text("import sys\nsys.begun.set()\nsys.may_end.wait()\n")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", ENDLESS], check=False, timeout=60,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0
