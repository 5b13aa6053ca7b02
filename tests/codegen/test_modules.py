"""Machine code on disk: whole or not there, trusted or not used, never stale, of limited size."""

from __future__ import annotations

import ctypes
import io
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import llvmlite
import numba
import pytest
from numba import config, types
from numba.core import caching

from fastatt import _jit
from fastatt.cli import main
from fastatt.codegen import modules as store
from fastatt.codegen.processor import described

ROOT = Path(__file__).resolve().parents[2]
TEXT = "def run(x): x[0] = {}.0\n"
# one run, its result and what became of functions
RUN = """
import numpy as np
import fastatt as fa
from fastatt.codegen import modules as store
run = fa.propagate(fa.Scene(rate=fa.rates.Coning(0.5, 1.0)), [1, 0, 0, 0], dt=0.1, n_steps=5)
print(run.q[-1, 0], store.made, store.hits)
"""


def process(code, cache, *, package=ROOT, **env):
    """Last line that a new process prints, in words."""
    names = {"FASTATT_CACHE": str(cache), "PYTHONPATH": str(package), **env}
    given = {k: v for k, v in {**os.environ, **names}.items() if v is not None}
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env=given, cwd=package, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()[-1].split()


def answer(n):
    room = (ctypes.c_double * 1)()
    arguments = (types.CPointer(types.float64),)
    store.generated(TEXT.format(n), arguments, {}, "").ctypes(room)
    return room[0]


def files_of(cache, suffix):
    return sorted(x for x in cache.rglob(f"*{suffix}") if x.is_file())


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty folder that this process uses."""
    path = tmp_path / "cache"
    monkeypatch.setenv("FASTATT_CACHE", str(path))
    monkeypatch.setattr("numba.config.CACHE_DIR", "")
    store._found.cache_clear()
    monkeypatch.setattr(store, "hits", 0)
    monkeypatch.setattr(store, "made", 0)
    yield path
    store._found.cache_clear()
    store.surroundings.cache_clear()


# files


@pytest.mark.parametrize(
    ("of", "name"), [(numba, "__version__"), (llvmlite, "__version__"), (sys, "version")]
)
def test_what_another_version_left_is_not_taken(cache, monkeypatch, of, name):
    """Of Numba, llvmlite or Python: its file has another name."""
    assert answer(42) == 42
    monkeypatch.setattr(of, name, getattr(of, name) + ".1")
    store.surroundings.cache_clear()
    assert answer(42) == 42
    assert (store.made, store.hits, len(list(cache.glob("*.py")))) == (2, 0, 2)


@pytest.mark.parametrize("edited", ["codegen/emitter.py", "codegen/lanes.py", "tracing/nodes.py"])
def test_what_other_sources_emitted_is_not_taken(cache, monkeypatch, tmp_path, edited):
    """Those that write machine code, and those that say what operations there are."""
    for folder in ("codegen", "tracing"):
        shutil.copytree(ROOT / "fastatt" / folder, tmp_path / folder)
    monkeypatch.setattr(store, "__file__", str(tmp_path / "codegen" / "modules.py"))
    for _ in range(2):
        store.surroundings.cache_clear()
        answer(42)
    assert (store.made, store.hits) == (1, 1)
    with (tmp_path / edited).open("a", encoding="utf-8") as file:
        file.write("\n")
    store.surroundings.cache_clear()
    answer(42)
    assert (store.made, store.hits, len(list(cache.glob("*.py")))) == (2, 1, 2)


@pytest.mark.parametrize(
    "other",
    [
        ("x86_64-linux-gnu", "skylake", "+sse2,+avx,+avx2"),
        ("x86_64-linux-gnu", "znver3", "+sse2,+avx"),
        ("x86_64-apple-darwin", "skylake", "+sse2,+avx"),
    ],
    ids=["features", "name", "triple"],
)
def test_what_another_processor_compiled_is_not_taken(cache, monkeypatch, other):
    """Of a folder that machines share: another one may lack what this one has."""
    for target in (("x86_64-linux-gnu", "skylake", "+sse2,+avx"), other):
        monkeypatch.setattr(store, "processor", lambda target=target: described(*target))
        store.surroundings.cache_clear()
        answer(42)
    assert (store.made, store.hits, len(list(cache.glob("*.py")))) == (2, 0, 2)


def test_a_program_is_made_once_and_found_then(cache):
    assert [answer(42), answer(42), answer(43)] == [42, 42, 43]
    assert (store.made, store.hits) == (2, 1)
    programs, size = store.usage()
    files = [x for x in cache.rglob("*") if x.is_file()]
    assert (programs, size) == (2, sum(f.stat().st_size for f in files))
    store.clear()
    assert [x for x in cache.rglob("*") if x.is_file()] == []


DAMAGES = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "end": lambda data: data[:-1],
    "begin": lambda data: b"x" + data[1:],
    "bit": lambda data: data[:100] + bytes([data[100] ^ 1]) + data[101:],
}


@pytest.mark.parametrize("suffix", [".py", ".nbi", ".nbc"])
@pytest.mark.parametrize("damaged", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_made_anew(cache, damaged, suffix):
    assert answer(42) == 42
    (file,) = files_of(cache, suffix)
    file.write_bytes(damaged(file.read_bytes().ljust(101)))
    assert answer(42) == 42
    # a source is put right, and what was compiled of it still fits
    assert (store.made, store.hits) == ((1, 1) if suffix == ".py" else (2, 0))
    assert answer(42) == 42
    assert store.hits == (2 if suffix == ".py" else 1)


def test_files_that_are_missing_are_made_anew(cache):
    """Machine code without its mark is not loaded, whoever put it there."""
    assert answer(42) == 42
    for n, suffix in enumerate((".ok", ".nbi", ".nbc", ".py")):
        for file in files_of(cache, suffix):
            file.unlink()
        assert answer(42) == 42
        assert len(files_of(cache, suffix)) >= 1
        assert store.made == (2 + n if suffix != ".py" else 4)
    assert store.hits == 1


def test_folders_do_not_share_files(cache, monkeypatch):
    """Of one name, where Numba keeps both in a folder of its own."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(cache.parent / "numba"))
    for name in ("a", "b", "a", "b"):
        monkeypatch.setenv("FASTATT_CACHE", str(cache.parent / name / "cache"))
        store._found.cache_clear()
        assert answer(42) == 42
    assert (store.made, store.hits) == (2, 2)
    assert store.usage()[0] == 1
    store.clear()
    assert len(files_of(cache.parent, ".nbc")) == 1


def test_the_files_not_used_for_longest_go(cache, monkeypatch):
    names = []
    for n in range(4):
        answer(n)
        names += sorted({x.stem for x in files_of(cache, ".py")} - set(names))
    for age, name in enumerate(names):
        past = time.time() - 1000.0 * (4 - age)
        for mark in files_of(cache, ".ok"):
            if mark.name.startswith(name):
                os.utime(mark, (past, past))
    answer(0)  # the oldest, used again
    left = cache / "left.part"
    left.write_bytes(b"")
    os.utime(left, (0.0, 0.0))
    young = cache / "young.part"
    young.write_bytes(b"")
    monkeypatch.setattr(store, "LIMIT", store.usage()[1] - 1)
    monkeypatch.setattr(store, "made", 64)
    store._trim(cache)
    assert {x.stem for x in files_of(cache, ".py")} == {names[0], *names[2:]}
    assert len(files_of(cache, ".nbc")) == len(files_of(cache, ".nbi")) == 3
    assert files_of(cache, ".part") == [young]


def test_what_cannot_be_written_is_compiled_in_memory(cache, monkeypatch):
    """A folder that may not be written to, on a disk that is full: no file is half there."""

    def full(*args, **options):
        raise OSError(28, "No space left on device")

    assert store.folder() == cache
    monkeypatch.setattr(store.tempfile, "mkstemp", full)
    assert [answer(42), answer(42)] == [42, 42]
    assert (store.made, store.hits) == (2, 0)
    assert [x for x in cache.rglob("*") if x.is_file()] == []


def test_a_file_that_may_not_be_renamed_leaves_nothing(cache, monkeypatch):
    store.folder()

    def refused(*args):
        raise PermissionError("no")

    monkeypatch.setattr(Path, "replace", refused)
    assert answer(42) == 42
    assert [x for x in cache.rglob("*") if x.is_file()] == []


# folders


@pytest.mark.parametrize("value", ["0", "off", " No ", ""])
def test_it_can_be_switched_off(cache, monkeypatch, value):
    monkeypatch.setenv("FASTATT_CACHE", value)
    assert store.folder() is None
    assert store.reason() == f"FASTATT_CACHE={value} switches it off"
    assert answer(42) == 42
    assert store.usage() == (0, 0)
    store.clear()
    assert not cache.exists()


def test_it_works_where_no_folder_can_be(cache, monkeypatch):
    monkeypatch.setenv("FASTATT_CACHE", "/dev/null/cache")
    assert store.folder() is None
    assert "/dev/null" in store.reason()
    assert answer(42) == 42


@pytest.mark.parametrize("inside", ["", "__pycache__"])
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722])
def test_a_folder_that_others_may_write_to_is_not_trusted(cache, mode, inside):
    answer(42)
    (cache / inside).chmod(mode)
    store._found.cache_clear()
    assert store.folder() is None
    assert "others may write to it" in store.reason()
    assert answer(42) == 42
    assert (store.made, store.hits) == (2, 0)


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root may chown")
def test_another_users_folder_is_not_trusted(cache):
    cache.mkdir(mode=0o700)
    os.chown(cache, 4321, -1)
    assert store.folder() is None
    assert "another user's" in store.reason()


def test_the_folder_is_the_users_own(cache):
    assert store.folder() == cache
    assert cache.stat().st_mode & 0o777 == 0o700


def test_a_read_only_folder_is_read(cache, monkeypatch):
    """Its functions are loaded; without any in it, it is of no use."""
    answer(42)
    before = files_of(cache, "")
    ensure = caching._CacheLocator.ensure_cache_path

    def refused(self):
        if Path(self.get_cache_path()).is_relative_to(cache):
            raise PermissionError("no")
        ensure(self)

    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", refused)  # root writes anywhere
    monkeypatch.setattr(store.os, "access", lambda *about: False)
    store._found.cache_clear()
    assert store.folder() == cache
    assert [answer(42), answer(43), answer(42)] == [42, 43, 42]
    assert (store.made, store.hits) == (2, 2)
    assert files_of(cache, "") == before
    shutil.rmtree(cache)
    cache.mkdir(mode=0o700)
    store._found.cache_clear()
    assert store.folder() is None
    assert "may not be written to" in store.reason()
    assert answer(42) == 42


@pytest.mark.parametrize(
    "env",
    [
        {"FASTATT_CACHE": None, "XDG_CACHE_HOME": None, "HOME": None},
        {"FASTATT_CACHE": None, "XDG_CACHE_HOME": None, "HOME": "/dev/null"},
    ],
    ids=["no home", "home is none"],
)
def test_it_works_where_nothing_can_be_kept(tmp_path, env):
    # without a home of one's own, that of the user: not to be written to here
    if env.get("HOME", "") is None:
        env = {**env, "XDG_CACHE_HOME": "/dev/null"}
    q, made, hits = process(RUN, tmp_path, **env)
    assert 0.0 < float(q) < 1.0
    assert (int(made) > 0, int(hits)) == (True, 0)


def test_the_home_is_used_where_no_folder_is_named(tmp_path):
    env = {"FASTATT_CACHE": None, "XDG_CACHE_HOME": None, "HOME": str(tmp_path)}
    code = "from fastatt.codegen import modules as store; print(store.folder())"
    (found,) = process(code, tmp_path, **env)
    assert Path(found).is_relative_to(tmp_path)
    assert process(code, "~/there", HOME=str(tmp_path)) == [str(tmp_path / "there")]


# processes


TOGETHER = """
import ctypes, multiprocessing as mp, sys
from numba import config, types
from numba.core import caching
from fastatt.codegen import modules
def answer(n):
    room = (ctypes.c_double * 1)()
    arguments = (types.CPointer(types.float64),)
    modules.generated(f"def run(x): x[0] = {n}.0\\n", arguments, {}, "").ctypes(room)
    return int(room[0])
def work(barrier, queue):
    barrier.wait()
    queue.put([answer(n) for n in range(5)])
if __name__ == "__main__":
    context = mp.get_context(sys.argv[1])
    barrier, queue = context.Barrier(3), context.Queue()
    some = [context.Process(target=work, args=(barrier, queue)) for _ in range(3)]
    [p.start() for p in some]
    found = [queue.get() for _ in some]
    [p.join() for p in some]
    again = [answer(n) for n in range(5)]
    print(found == [again] * 3, modules.made, modules.hits)
"""


@pytest.mark.parametrize("start", ["spawn", "fork"])
def test_processes_may_write_at_once(tmp_path, start):
    if start not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {start} here")
    script = tmp_path / "together.py"
    script.write_text(TOGETHER)
    folder = tmp_path / "cache"
    done = subprocess.run(
        [sys.executable, str(script), start],
        env={
            **os.environ, "FASTATT_CACHE": str(folder), "PYTHONPATH": str(ROOT),
            "NUMBA_CACHE_DIR": "",
        },
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    # what they left is whole
    assert done.stdout == "True 0 5\n", done.stderr
    assert len(list(folder.glob("*.py"))) == 5
    assert list(folder.glob("*.part")) == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_while_another_thread_compiles_does_not_hang(tmp_path):
    """The fork waits until the compiler is free."""
    code = """
import os, threading, time
from numba.core.compiler_lock import global_compiler_lock
import fastatt as fa
import fastatt.codegen.modules
held = threading.Event()
def compiling():
    with global_compiler_lock:
        held.set()
        time.sleep(0.3)
threading.Thread(target=compiling).start()
held.wait()
child = os.fork()
if not child:
    body = fa.Scene(inertia=(2.0, 1.0, 0.7))
    run = fa.propagate(body, [1, 0, 0, 0], [0, 0, 1], dt=0.1, n_steps=1, method="rk4")
    os._exit(7 if run.status[0] == 0 else 1)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert process(code, tmp_path / "c") == ["7"]


EDITED = """
import numpy as np
import fastatt as fa
from fastatt.codegen import modules as store
assert fa.__file__.startswith({package!r})
scene, q = fa.Scene(rate=fa.rates.Coning(0.5, 1.0)), [0.6, 0.5, -0.4, 0.48]
for method in ("magnus4", "rk4"):
    run = fa.propagate(scene, q, method=method, dt=0.1, n_steps=5)
    print(run.q[-1, 0], end=" ")
print(fa.kernels.dcm.add((1.0,) * 9, (2.0,) * 9)[0], store.made, store.hits)
"""


def test_an_edited_source_is_never_served_stale(tmp_path):
    """A method's coefficient and kernels changed: other results; changed back: the first, kept.

    The kernels' are the loop that holds one, and what Numba compiled of a caller in another file.
    """
    shutil.copytree(ROOT / "fastatt", tmp_path / "copy" / "fastatt")
    edits = {
        "methods/magnus4.py": ("0.14433756729740643", "0.15"),
        "kernels/quat.py": ("F(0.5) * w[1]", "F(0.4) * w[1]"),
        "kernels/vec3.py": ("a[0] + b[0]", "a[0] - b[0]"),
    }
    sources = {tmp_path / "copy" / "fastatt" / name: edit for name, edit in edits.items()}
    texts = {file: file.read_text(encoding="utf-8") for file in sources}

    def found():
        caches = {"cache": tmp_path / "c", "NUMBA_CACHE_DIR": str(tmp_path / "n")}
        package = tmp_path / "copy"
        return process(EDITED.format(package=str(package)), package=package, **caches)

    first = found()
    for file, edit in sources.items():
        assert edit[0] in texts[file]
        file.write_text(texts[file].replace(*edit), encoding="utf-8")
    other = found()
    for file, text in texts.items():
        file.write_text(text, encoding="utf-8")
    again = found()
    assert [a != b for a, b in zip(other[:3], first[:3], strict=True)] == [True] * 3
    assert int(other[3]) > 0
    assert again == [*first[:3], "0", str(int(first[3]) + int(first[4]))]


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_loop_is_kept_until_it_is_edited(tmp_path, monkeypatch):
    """Or its files are damaged, or the calls that it takes from another file are edited."""
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "numba"))
    file, calls = tmp_path / "loop.py", tmp_path / "call.py"
    monkeypatch.setattr(_jit, "_PARTS", (calls,))

    def loop(added=1, called="first"):
        text = f"def run(x):\n    return x + {added}\n"
        if not file.exists() or file.read_text() != text:  # Numba 0.61 compares times
            file.write_text(text)
        calls.write_text(called)
        scope = {"__name__": "loop"}
        exec(compile(text, str(file), "exec"), scope)
        found = _jit.address_loop(scope["run"])
        return found(41), found.function.cache_hits

    assert [loop(), loop(), loop(added=2), loop(added=2, called="second")] == [
        (42, 0), (42, 1), (43, 0), (43, 0),
    ]  # fmt: skip
    for suffix in (".nbi", ".nbc"):
        for damaged in ("empty", "half"):
            for kept in files_of(tmp_path, suffix):
                kept.write_bytes(DAMAGES[damaged](kept.read_bytes()))
            assert loop() == (42, 0)
            assert loop() == (42, 1)


# what is said


class Screen(io.StringIO):
    def __init__(self, terminal):
        super().__init__()
        self.terminal = terminal

    def isatty(self):
        return self.terminal


@pytest.mark.parametrize("terminal", [True, False])
def test_a_long_wait_is_said_once_and_only_at_a_terminal(cache, monkeypatch, terminal):
    screen = Screen(terminal)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(store, "_WAIT", store._Wait())
    store._WAIT.add(0.6 * store.LONG)
    assert screen.getvalue() == ""
    store._WAIT.add(0.6 * store.LONG)
    store._WAIT.add(2.0 * store.LONG)
    line = "fastatt: compiling for this machine, once ('fastatt precompile' does it)\n"
    assert screen.getvalue() == (line if terminal else "")


@pytest.mark.parametrize("silent", [True, False])
def test_only_what_is_compiled_counts(cache, monkeypatch, silent):
    screen = Screen(terminal=True)
    answer(42)
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(store, "_WAIT", store._Wait())
    monkeypatch.setattr(store, "LONG", 0.0)
    if silent:
        store.say_nothing()
    answer(42)
    assert screen.getvalue() == ""
    answer(43)
    assert screen.getvalue().count("\n") == (0 if silent else 1)


def test_the_command_tells_where_and_clears(cache, capsys):
    answer(42)
    size = sum(f.stat().st_size for f in cache.rglob("*") if f.is_file())
    assert main(["cache"]) == 0
    assert capsys.readouterr().out == f"1 programs, {size / 1e6:.1f} MB in {cache}\n"
    assert main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out == f"0 programs, 0.0 MB in {cache}\n"


def test_precompile_without_a_folder_is_refused(cache, capsys, monkeypatch):
    monkeypatch.setenv("FASTATT_CACHE", "0")
    assert main(["precompile"]) == 2
    found = capsys.readouterr().err
    assert found == "fastatt: nothing is kept: FASTATT_CACHE=0 switches it off\n"
