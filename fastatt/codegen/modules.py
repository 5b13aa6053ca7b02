"""Generated modules: a function of a few loops around emitted formulas, compiled by Numba.

The module's text goes to a file named by the hash of everything that its machine code depends on:
the loops, the graphs of operations, the processor, the versions of Numba and llvmlite, and the
sources that emit it. Numba's disk cache keeps the machine code next to that file, so that a change
anywhere leads to another file and nothing on disk is ever stale. A file of Numba's is loaded only
if a mark with the hash of its contents is there, which its writer leaves last. A folder that may
only be read is read; where nothing can be kept, the code is compiled in memory.

``FASTATT_CACHE`` names the folder, or switches it off with ``0``; otherwise it is the folder for
the user's caches.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.util
import itertools
import os
import shutil
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import cfunc, types
from numba.extending import intrinsic

from fastatt._numba import check, compiler_lock, files_of
from fastatt.codegen.instructions import Code, prepare_for_vectors
from fastatt.codegen.processor import processor

#: bytes that the folder may hold before the files that were not used for longest are removed
LIMIT = 256 << 20
_ABANDONED = 3600.0  # s
_PREFIX, _MARK, _INSIDE = "fastatt_", ".ok", "__pycache__"
# other sources that emit it
_OTHERS = ("_numba.py", "tracing/nodes.py")

#: how many functions were loaded from disk, and how many compiled, since the process started
hits = made = 0

#: the arguments of an emission: their types, and ``emit(code, arguments)``
Emission = tuple[Sequence[Any], Callable[[Code, Sequence[Any]], None]]


def generated(
    text: str, arguments: Sequence[Any], emissions: Mapping[str, Emission], key: str
) -> Any:
    """Numba's ``CFunc`` of the function ``run`` that a text defines.

    ``text`` is the source of ``run``, plain Python that Numba compiles, and ``arguments`` are
    Numba's types of its arguments; it returns nothing. ``emissions`` are the functions that it
    calls by name, as (types of arguments, emission), and ``key`` is everything that they depend on.
    """
    digest = hashlib.sha256(f"{text}\0{key}\0{surroundings()}".encode()).hexdigest()[:40]
    names = {name: _emitting(*emission) for name, emission in emissions.items()}
    found = None
    with compiler_lock:  # one thread at a time
        _check_numbas()
        path = folder()
        if path is not None:
            with contextlib.suppress(Exception):
                found = _kept(path, _PREFIX + digest, text, arguments, names)
        if found is None:
            found = _in_memory(text, arguments, names)
        _count(found)
    return found


def _count(found: Any) -> None:
    global hits, made  # noqa: PLW0603
    if found.cache_hits:
        hits += 1
    else:
        made += 1


def _emitting(arguments: Sequence[Any], emit: Callable[[Code, Sequence[Any]], None]) -> Any:
    """An intrinsic without a result, whose arguments have the given types."""
    signature = types.void(*arguments)

    def lower(context: Any, builder: Any, _: Any, args: Any) -> Any:
        check()
        prepare_for_vectors(builder.function)
        emit(Code(builder), args)
        return context.get_dummy_value()

    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    scope: dict[str, Any] = {"found": (signature, lower)}
    exec(f"def emission(typing_context, {names}):\n    return found", scope)
    return intrinsic(scope["emission"])


def _in_memory(text: str, arguments: Sequence[Any], names: Mapping[str, Any]) -> Any:
    scope = dict(names)
    exec(compile(text, "<fastatt>", "exec"), scope)
    return cfunc(types.void(*arguments))(scope["run"])


def _kept(
    path: Path, name: str, text: str, arguments: Sequence[Any], names: Mapping[str, Any]
) -> Any:
    """The function from the folder, compiled and stored there if it was not; None if that fails."""
    source = path / f"{name}.py"
    may_write = os.access(path, os.W_OK | os.X_OK)
    if not source.exists() or source.read_text() != text:
        if not may_write:
            return None
        _write(source, text.encode())
    if not (may_write or numba.config.CACHE_DIR):
        source = _copied(source)
    where, *files = _numba_files(source)
    for file in filter(Path.exists, files):
        if not _is_whole(file):
            file.unlink(missing_ok=True)
    for _ in range(2):
        try:
            found = _imported(source, name, text, arguments, names)
        except Exception:  # noqa: BLE001  # what another version of Numba left
            for file in where.glob(f"{name}.*"):
                file.unlink(missing_ok=True)
        else:
            if not found.cache_hits:
                with contextlib.suppress(OSError):
                    for file in filter(Path.exists, files):
                        _mark(file).touch()
                    _trim(path)
            return found
    return None


def _imported(
    source: Path, name: str, text: str, arguments: Sequence[Any], names: Mapping[str, Any]
) -> Any:
    """The function of a module, under whose name Numba's cache finds it."""
    spec = importlib.util.spec_from_file_location(name, source)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__dict__.update(names)
    sys.modules[name] = module
    try:
        exec(compile(text, str(source), "exec"), module.__dict__)
        return cfunc(types.void(*arguments), cache=True)(module.__dict__["run"])
    finally:
        del sys.modules[name]


def _numba_files(source: Path) -> tuple[Path, Path, Path]:
    """The folder in which Numba keeps a module's machine code, its index and its code there."""
    scope: dict[str, Any] = {}
    exec(compile("def run(): pass", str(source), "exec"), scope)
    return files_of(scope["run"])


def _mark(file: Path) -> Path:
    """The mark of a file with these contents; two processes that write it have different marks."""
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:40]
    return file.with_name(f"{file.name.partition('.')[0]}.{digest}{_MARK}")


def _is_whole(file: Path) -> bool:
    """Whether a file has a mark; the mark is then made new."""
    try:
        os.utime(_mark(file))
    except FileNotFoundError:  # no mark, or another process removed the file
        return False
    return True


def _copied(source: Path) -> Path:
    """A module of a read-only folder, copied to a folder that Numba accepts."""
    to = Path(_private_folder().name)
    (to / _INSIDE).mkdir(exist_ok=True)
    shutil.copy2(source, to)
    for file in (source.parent / _INSIDE).glob(f"{source.stem}.*"):
        shutil.copy2(file, to / _INSIDE)
    return to / source.name


@functools.cache
def _private_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder that is removed with the process."""
    return tempfile.TemporaryDirectory(prefix=_PREFIX)


def _write(path: Path, data: bytes) -> None:
    """Write a file under another name and rename it, so that no reader sees a part of it."""
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        # Numba compares the times of sources, so that all writers set the same one
        os.utime(name, (0.0, 0.0))
        Path(name).replace(path)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise


def _trim(path: Path) -> None:
    """Remove the modules that were not used for longest, and files of writers that died."""
    if made % 64:
        return
    with contextlib.suppress(OSError):
        now = time.time()
        for file in path.glob("*.part"):
            if now - file.stat().st_mtime > _ABANDONED:
                file.unlink(missing_ok=True)
        modules: dict[str, list[tuple[float, int, Path]]] = {}
        for file in _all_files():
            if file.suffix == ".part":
                continue
            info = file.stat()
            used = info.st_mtime if file.suffix == _MARK else 0.0
            modules.setdefault(file.name.partition(".")[0], []).append((used, info.st_size, file))
        excess = sum(size for files in modules.values() for _, size, _ in files) - LIMIT
        for files in sorted(modules.values(), key=max):
            if excess <= 0:
                break
            for _, size, file in files:
                excess -= size
                file.unlink(missing_ok=True)


@functools.cache
def surroundings() -> str:
    """What all machine code depends on: processor, versions, the emitter's sources."""
    folder = Path(__file__).parent
    others = (folder.parent / name for name in _OTHERS)
    files = (*sorted(folder.glob("*.py")), *others)
    sources = [hashlib.sha256(file.read_bytes()).hexdigest() for file in files]
    versions = (llvmlite.__version__, numba.__version__, sys.version)
    return "\0".join((processor().key, *versions, *sources))


# the folder


def folder() -> Path | None:
    """The folder, created if necessary; None if nothing is kept."""
    return _found()[0]


def reason() -> str:
    """Why nothing is kept; empty if it is."""
    return _found()[1]


@functools.cache
def _found() -> tuple[Path | None, str]:
    chosen = os.environ.get("FASTATT_CACHE")
    if chosen is not None and chosen.strip().lower() in ("", "0", "off", "no"):
        return None, f"FASTATT_CACHE={chosen} switches it off"
    try:
        path = Path(chosen).expanduser() if chosen else _user_folder() / "fastatt"
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        may_write = os.access(path, os.W_OK | os.X_OK)
        if not may_write and not any(path.iterdir()):
            return None, f"{path} may not be written to"
        if may_write:
            (path / _INSIDE).mkdir(mode=0o700, exist_ok=True)
        for one in filter(Path.exists, (path, path / _INSIDE)):
            if why := _others(one):
                return None, f"{one} is not trusted: {why}"
    except (OSError, RuntimeError) as error:
        return None, str(error)
    return path.resolve(), ""


def _others(path: Path, shared: int = stat.S_IWGRP | stat.S_IWOTH) -> str:
    """How others may write to a folder, by these permissions or as its owner; empty if not."""
    info = path.stat()
    if not hasattr(os, "getuid"):
        return ""
    if info.st_mode & shared:
        return "others may write to it"
    return "" if info.st_uid in (os.getuid(), 0) else "it is another user's"


@functools.cache
def _check_numbas() -> None:
    """Warn, once, of a folder that others may write to, from which Numba loads machine code."""
    with contextlib.suppress(RuntimeError, OSError):  # Numba has no folder
        # Numba's folders for other files of the package have the same owner
        own, chosen = _numba_files(Path(__file__))[0], numba.config.CACHE_DIR
        for path in (own, *([Path(chosen)] if chosen else ())):
            info = path.stat()
            # systems give each user a group, of the same number
            shared = stat.S_IWOTH | (0 if info.st_gid == info.st_uid else stat.S_IWGRP)
            if path != own and info.st_mode & stat.S_ISVTX:  # others cannot replace the files
                continue
            if why := _others(path, shared):
                warnings.warn(
                    f"NUMBA_CACHE_DIR: Numba loads machine code from {path}, but {why}; accepted: "
                    "a folder of your own",
                    stacklevel=2,
                )
                return


def _user_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _all_files() -> list[Path]:
    path = folder()
    if path is None:
        return []
    roots = {path, path / _INSIDE}
    for source in itertools.islice(path.glob(f"{_PREFIX}*.py"), 1):
        with contextlib.suppress(RuntimeError):  # Numba has no folder
            roots.add(_numba_files(source)[0])
    files = [file for root in roots for file in root.glob(f"{_PREFIX}*.*")]
    return [*files, *path.glob("*.part")]


def usage() -> tuple[int, int]:
    """(modules, bytes) in the folder."""
    files = _all_files()
    sizes = 0
    for file in files:
        with contextlib.suppress(OSError):  # another process may have removed it
            sizes += file.stat().st_size
    return sum(file.suffix == ".py" for file in files), sizes


def clear() -> None:
    """Remove every file.

    Raises ``OSError`` where they may not be removed.
    """
    for file in _all_files():
        file.unlink(missing_ok=True)


def where() -> str:
    """Number, size and folder of the programs on disk."""
    if folder() is None:
        return f"nothing is kept: {reason()}"
    files, size = usage()
    return f"{files} programs, {size / 1e6:.1f} MB in {folder()}"
