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
def first_call():
    import slow
"""
COMPILES = """
from numba.core.compiler_lock import global_compiler_lock
def first_call():
    with global_compiler_lock:
        begun.set()
        may_end.wait(5)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
@pytest.mark.parametrize("before", [IMPORTS, COMPILES])
def test_a_child_does_not_wait_for_a_thread_that_it_does_not_have(before, tmp_path):
    (tmp_path / "slow.py").write_text("import sys\nsys.begun.set()\nsys.may_end.wait(5)\n")
    code = textwrap.dedent(FORKED).format(before=before)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], check=False,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0
