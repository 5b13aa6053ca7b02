"""Machine code on disk: whole or not there, trusted or not used, never stale, of limited size."""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import shutil
import subprocess
import sys
import threading
import time
import weakref
from pathlib import Path

import pytest
from numba import types

from fastatt import _jit
from fastatt import _store as store
from fastatt.cli import main
from fastatt.codegen import modules

ROOT = Path(__file__).resolve().parents[2]
LIBC = ctypes.CDLL(None)
TEXT = "def run(x): x[0] = {}.0\n"
# one run, its result and what became of functions
RUN = """
import numpy as np
import fastatt as fa
from fastatt import _store as store
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
    code = modules.generated(TEXT.format(n), arguments, {}, "")
    ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address)(room)
    return room[0]


def files_of(cache, name="*"):
    return sorted(x for x in cache.rglob(name) if x.is_file())


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
    modules.surroundings.cache_clear()


def test_one_thread_compiles_at_a_time_but_none_within_numba_waits():
    """Which another waits for that has the lock."""
    entered = {within: threading.Event() for within in (False, True)}

    def enter(within):
        store.within_numba.set(within)
        with store.alone():
            entered[within].set()

    threads = [threading.Thread(target=enter, args=[within]) for within in entered]
    with store.alone():
        for thread in threads:
            thread.start()
        assert entered[True].wait(60.0)
        assert not entered[False].wait(0.1)
    for thread in threads:
        thread.join()
    assert entered[False].is_set()


# files


EDITED = ("codegen/emitter.py", "codegen/lanes.py", "tracing/nodes.py", "_numba.py")


@pytest.mark.parametrize("edited", EDITED)
def test_what_other_sources_emitted_is_not_taken(cache, monkeypatch, tmp_path, edited):
    """Those that write machine code, and those that say what operations there are."""
    for folder in ("codegen", "tracing"):
        shutil.copytree(ROOT / "fastatt" / folder, tmp_path / folder)
    shutil.copy(ROOT / "fastatt" / "_numba.py", tmp_path)
    monkeypatch.setattr(modules, "__file__", str(tmp_path / "codegen" / "modules.py"))
    for _ in range(2):
        modules.surroundings.cache_clear()
        answer(42)
    assert (store.made, store.hits) == (1, 1)
    with (tmp_path / edited).open("a", encoding="utf-8") as file:
        file.write("\n")
    modules.surroundings.cache_clear()
    answer(42)
    assert (store.made, store.hits, len(files_of(cache))) == (2, 1, 2)


OTHERS = {
    "Numba": lambda patch: patch.setitem(store.FOUND, "Numba", "0.1"),
    "llvmlite": lambda patch: patch.setitem(store.FOUND, "llvmlite", "0.1"),
    "Python": lambda patch: patch.setattr(sys, "version", "3.1"),
    "features": ("x86_64-linux-gnu", "skylake", "+sse2,+avx,+avx2"),
    "name": ("x86_64-linux-gnu", "znver3", "+sse2,+avx"),
    "triple": ("x86_64-apple-darwin", "skylake", "+sse2,+avx"),
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_what_others_compiled_is_not_taken(cache, monkeypatch, other):
    """Of a folder that machines and versions share: its file has another name."""
    for target in (("x86_64-linux-gnu", "skylake", "+sse2,+avx"), other):
        if callable(target):
            target(monkeypatch)
        else:
            monkeypatch.setattr(store, "target", lambda target=target: target)
        modules.surroundings.cache_clear()
        assert answer(42) == 42
    assert (store.made, store.hits, len(files_of(cache))) == (2, 0, 2)


def test_a_program_is_made_once_and_found_then(cache):
    assert [answer(42), answer(42), answer(43)] == [42, 42, 43]
    assert (store.made, store.hits) == (2, 1)
    programs, size = store.usage()
    assert (programs, size) == (2, sum(f.stat().st_size for f in files_of(cache)))
    store.clear()
    assert files_of(cache) == []


# memory


class Emission:
    """Writes nothing."""

    def __call__(self, code, args):
        pass


@pytest.mark.skipif(not hasattr(LIBC, "mallinfo2"), reason="not the GNU C library")
def test_what_the_compiler_made_on_the_way_is_released(cache):
    """Machine code stays, and what Numba keeps with it."""
    number = ctypes.c_size_t

    class Info(ctypes.Structure):
        _fields_ = (("others", number * 7), ("used", number), ("free", number * 2))

    LIBC.mallinfo2.restype = Info

    def compiled(n):
        emission, arguments = Emission(), (types.CPointer(types.float64),)
        text = f"def run(x):\n    x[0] = {n}.0\n    step(x)\n"
        code = modules.generated(text, arguments, {"step": (arguments, emission)}, "")
        return weakref.ref(emission), code.address

    def used():
        gc.collect()
        return LIBC.mallinfo2().used

    for n in range(5):
        compiled(n)
    before = used()
    references, addresses = zip(*map(compiled, range(5, 25)), strict=True)
    assert used() - before < 20 * 60_000, used() - before
    assert {x() for x in references} == {None}
    room = (ctypes.c_double * 1)()
    for n, address in enumerate(addresses, 5):
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(address)(room)
        assert room[0] == n


DAMAGES = {
    "empty": lambda data: b"",
    "half": lambda data: data[: len(data) // 2],
    "end": lambda data: data[:-1],
    "begin": lambda data: b"x" + data[1:],
    "bit": lambda data: data[:100] + bytes([data[100] ^ 1]) + data[101:],
}


@pytest.mark.parametrize("damaged", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_file_is_made_anew(cache, damaged):
    assert answer(42) == 42
    (file,) = files_of(cache)
    file.write_bytes(damaged(file.read_bytes()))
    assert [answer(42), answer(42)] == [42, 42]
    assert (store.made, store.hits) == (2, 1)


def test_the_files_not_used_for_longest_go(cache, monkeypatch):
    names = []
    for n in range(4):
        answer(n)
        names += [x for x in files_of(cache) if x not in names]
    for age, name in enumerate(names):
        past = time.time() - 1000.0 * (4 - age)
        os.utime(name, (past, past))
    answer(0)  # the oldest, used again
    left = cache / "fastatt_left.part"
    left.write_bytes(b"")
    os.utime(left, (0.0, 0.0))
    young = cache / "fastatt_young.part"
    young.write_bytes(b"")
    monkeypatch.setattr(store, "LIMIT", store.usage()[1] - 1)
    monkeypatch.setattr(store, "made", 64)
    store._trim()
    assert {*files_of(cache)} == {names[0], *names[2:], young}


def refused(*args, **options):
    raise PermissionError("no")


@pytest.mark.parametrize("of", [(store.tempfile, "mkstemp"), (Path, "replace")])
def test_what_cannot_be_written_is_compiled_in_memory(cache, monkeypatch, of):
    """A folder that may not be written to, on a disk that is full: no file is half there."""
    assert store.folder() == cache
    assert cache.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr(*of, refused)
    assert [answer(42), answer(42)] == [42, 42]
    assert (store.made, store.hits) == (2, 0)
    assert files_of(cache) == []


# folders


@pytest.mark.parametrize("value", ["0", "off", " No ", "", "/dev/null/cache"])
def test_it_can_be_switched_off(cache, monkeypatch, value):
    """Nor is there one where no folder can be."""
    monkeypatch.setenv("FASTATT_CACHE", value)
    assert store.folder() is None
    told = "/dev/null" if value.startswith("/") else f"FASTATT_CACHE={value} switches it off"
    assert told in store.reason()
    assert answer(42) == 42
    assert store.usage() == (0, 0)
    store.clear()
    assert not cache.exists()


@pytest.mark.parametrize("mode", [0o777, 0o775, 0o722])
def test_a_folder_that_others_may_write_to_is_not_trusted(cache, mode):
    answer(42)
    cache.chmod(mode)
    store._found.cache_clear()
    assert store.folder() is None
    assert "others may write to it" in store.reason()
    assert answer(42) == 42
    assert (store.made, store.hits) == (2, 0)


def test_a_folder_of_numba_that_others_may_write_to_is_said_once(cache, monkeypatch, tmp_path):
    folder = tmp_path / "numba"
    monkeypatch.setattr("numba.config.CACHE_DIR", str(folder))
    store._check_numbas.cache_clear()
    answer(42)
    folder.chmod(0o777)
    store._check_numbas.cache_clear()
    with pytest.warns(UserWarning, match=r"NUMBA_CACHE_DIR: .* others may write to it"):
        answer(43)
    made = store.made
    answer(44)  # a second warning would be an error
    answer(44)  # nor is it kept where others could change what Numba loads
    assert store.made == made + 2
    store._check_numbas.cache_clear()


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root may chown")
def test_another_users_folder_is_not_trusted(cache):
    cache.mkdir(mode=0o700)
    os.chown(cache, 4321, -1)
    assert store.folder() is None
    assert "another user's" in store.reason()


def test_a_read_only_folder_is_read(cache, monkeypatch):
    """Its functions are loaded; without any in it, it is of no use."""
    answer(42)
    before = files_of(cache)
    # root writes anywhere
    monkeypatch.setattr(store.os, "access", lambda *about: False)
    monkeypatch.setattr(store.tempfile, "mkstemp", refused)
    own, touch = cache.resolve(), os.utime
    monkeypatch.setattr(
        store.os, "utime", lambda x, *y: refused() if own in Path(x).parents else touch(x, *y)
    )
    store._found.cache_clear()
    assert store.folder() == cache
    assert [answer(42), answer(43), answer(42)] == [42, 43, 42]
    assert (store.made, store.hits) == (2, 2)
    assert files_of(cache) == before
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
    code = "from fastatt import _store as store; print(store.folder())"
    (found,) = process(code, tmp_path, **env)
    assert Path(found).is_relative_to(tmp_path)
    assert process(code, "~/there", HOME=str(tmp_path)) == [str(tmp_path / "there")]


@pytest.mark.parametrize("first", ["fastatt.kernels.quat", "fastatt.propagation.propagate"])
def test_what_is_to_run_without_a_compiler_is_refused(tmp_path, first):
    """By whichever module is imported first."""
    code = f"""
try:
    import {first}
except ImportError as error:
    print(str(error).replace(" ", "_"))
"""
    (found,) = process(code, tmp_path, NUMBA_DISABLE_JIT="1")
    assert found == (
        "NUMBA_DISABLE_JIT:_found_1;_accepted:_unset_or_0,"
        "_since_formulas_and_loops_run_as_machine_code_only"
    )


# processes


TOGETHER = """
import multiprocessing as mp, sys
from fastatt import _store
from test_store import answer
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
    print(found == [again] * 3, _store.made, _store.hits)
"""


@pytest.mark.parametrize("start", ["spawn", "forkserver"])
def test_processes_may_write_at_once(tmp_path, start):
    if start not in multiprocessing.get_all_start_methods():
        pytest.skip(f"no {start} here")
    script = tmp_path / "together.py"
    script.write_text(TOGETHER)
    folder = tmp_path / "cache"
    done = subprocess.run(
        [sys.executable, str(script), start],
        env={
            **os.environ, "FASTATT_CACHE": str(folder), "NUMBA_CACHE_DIR": "",
            "PYTHONPATH": os.pathsep.join((str(ROOT), str(Path(__file__).parent))),
        },
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    # what they left is whole
    assert done.stdout == "True 0 5\n", done.stderr
    assert len(files_of(folder)) == 5


AFTER_EDITS = """
import numpy as np
import fastatt as fa
from fastatt import _store as store
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
        "methods/magnus.py": ("0.14433756729740643", "0.15"),
        "kernels/quat.py": ("F(0.5) * w[1]", "F(0.4) * w[1]"),
        "kernels/vec3.py": ("a[0] + b[0]", "a[0] - b[0]"),
    }
    sources = {tmp_path / "copy" / "fastatt" / name: edit for name, edit in edits.items()}
    texts = {file: (file.read_text(encoding="utf-8"), file.stat()) for file in sources}

    def found():
        caches = {"cache": tmp_path / "c", "NUMBA_CACHE_DIR": str(tmp_path / "n")}
        package = tmp_path / "copy"
        return process(AFTER_EDITS.format(package=str(package)), package=package, **caches)

    first = found()
    for file, edit in sources.items():
        assert edit[0] in texts[file][0]
        file.write_text(texts[file][0].replace(*edit), encoding="utf-8")
    other = found()
    for file, (text, info) in texts.items():
        file.write_text(text, encoding="utf-8")
        os.utime(file, ns=(info.st_atime_ns, info.st_mtime_ns))
    again = found()
    assert [a != b for a, b in zip(other[:3], first[:3], strict=True)] == [True] * 3
    assert int(other[3]) > 0
    assert again == [*first[:3], "0", str(int(first[3]) + int(first[4]))]


@pytest.mark.parametrize("damaged", DAMAGES.values(), ids=DAMAGES)
def test_a_machine_is_kept_until_the_package_is_edited(cache, monkeypatch, damaged):
    """Or its file is damaged, or the folder is not there any more."""

    def loop(added=1, stamp="1"):
        monkeypatch.setattr(_jit, "_stamp", lambda: stamp)
        scope = {"__name__": "loop"}
        exec(f"def run(x):\n    return x + {added}\n", scope)
        return _jit.machine(scope["run"], types.int64(types.int64))(41)

    assert [loop(), loop(), loop(added=2, stamp="2"), loop()] == [42, 42, 43, 42]
    assert (store.made, store.hits) == (2, 2)
    for file in files_of(cache):
        file.write_bytes(damaged(file.read_bytes()))
    assert [loop(), loop()] == [42, 42]
    assert (store.made, store.hits) == (3, 3)
    shutil.rmtree(cache)
    assert [loop(), loop()] == [42, 42]
    assert (store.made, store.hits) == (4, 4)


# what is said


def test_the_command_tells_where_and_clears(cache, capsys):
    answer(42)
    size = sum(f.stat().st_size for f in files_of(cache))
    assert main(["cache"]) == 0
    assert capsys.readouterr().out == f"1 programs, {size / 1e6:.1f} MB in {cache}\n"
    assert main(["cache", "--clear"]) == 0
    assert capsys.readouterr().out == f"0 programs, 0.0 MB in {cache}\n"
