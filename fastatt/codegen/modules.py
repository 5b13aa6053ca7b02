"""Generated modules: a function of a few loops around emitted formulas, compiled by Numba.

The machine code goes to a file named by the hash of everything that it depends on: the loops, the
graphs of operations, the processor, the versions of Numba and llvmlite, and the sources that emit
it, so that a change anywhere leads to another file and nothing on disk is ever stale. A file begins
with the hash of its contents, without which it is not loaded. A folder that may only be read is
read; where nothing can be kept, each process compiles.

``FASTATT_CACHE`` names the folder, or switches it off with ``0``; otherwise it is the folder for
the user's caches.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import stat
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import llvmlite
import numba
from llvmlite import binding
from numba import types
from numba.extending import intrinsic

from fastatt._numba import NOTHING, check, compiler_lock, folder_of, linked_code
from fastatt.codegen.instructions import Code, prepare_for_vectors
from fastatt.codegen.processor import processor

#: bytes that the folder may hold before the files that were not used for longest are removed
LIMIT = 256 << 20
_ABANDONED = 3600.0  # s
_PREFIX, _PART = "fastatt_", ".part"
_HASH = hashlib.sha256().digest_size
# other sources that emit it
_OTHERS = ("_numba.py", "tracing/nodes.py")

#: how many functions were loaded from disk, and how many compiled, since the process started
hits = made = 0

#: the arguments of an emission: their types, and ``emit(code, arguments)``
Emission = tuple[Sequence[Any], Callable[[Code, Sequence[Any]], None]]


class MachineCode:
    """A function in memory at an ``address``, which is released with this object.

    Numba's engine would keep it for ever.
    """

    def __init__(self, name: str, code: bytes) -> None:
        machine = binding.Target.from_triple(binding.get_process_triple()).create_target_machine()
        self._engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
        self._engine.add_object_file(binding.ObjectFileRef.from_data(code))
        self._engine.finalize_object()
        self.address: int = self._engine.get_function_address(name)


def generated(
    text: str, arguments: Sequence[Any], emissions: Mapping[str, Emission], key: str
) -> MachineCode:
    """The machine code of the function ``run`` that a text defines.

    ``text`` is the source of ``run``, plain Python that Numba compiles, and ``arguments`` are
    Numba's types of its arguments; it returns nothing. ``emissions`` are the functions that it
    calls by name, as (types of arguments, emission), and ``key`` is everything that they depend on.
    """
    global hits, made  # noqa: PLW0603
    digest = hashlib.sha256(f"{text}\0{key}\0{surroundings()}".encode()).hexdigest()[:40]
    with compiler_lock:  # one thread at a time
        _check_numbas()
        path = folder()
        file = None if path is None else path / f"{_PREFIX}{digest}"
        data = None if file is None else _read(file)
        if data is not None:
            hits += 1
        else:
            data = _compiled(text, arguments, emissions)
            if file is not None:
                with contextlib.suppress(OSError):
                    _write(file, data)
                    _trim()
            made += 1
        name, _, code = data.partition(b"\0")
        return MachineCode(name.decode(), code)


#: the emissions of the function that is being compiled
_emissions: ContextVar[Mapping[str, Emission]] = ContextVar("emissions")


@functools.cache
def _called(name: str, arguments: tuple[Any, ...]) -> Any:
    """An intrinsic that writes the emission of this name of the function that is being compiled.

    It is the same for all functions, since Numba keeps every intrinsic, with what it refers to.
    """
    signature = types.void(*arguments)

    def lower(context: Any, builder: Any, _: Any, args: Any) -> Any:
        check()
        prepare_for_vectors(builder.function)
        _, emit = _emissions.get()[name]
        emit(Code(builder), args)
        return NOTHING

    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    scope: dict[str, Any] = {"found": (signature, lower)}
    exec(f"def emission(typing_context, {names}):\n    return found", scope)
    return intrinsic(scope["emission"])


def _compiled(text: str, arguments: Sequence[Any], emissions: Mapping[str, Emission]) -> bytes:
    """The function's name, and an object file with it."""
    scope = {name: _called(name, tuple(parts)) for name, (parts, _) in emissions.items()}
    exec(compile(text, "<fastatt>", "exec"), scope)
    token = _emissions.set(emissions)
    try:
        name, library = linked_code(scope["run"], types.void(*arguments))
    finally:
        _emissions.reset(token)
    return name.encode() + b"\0" + bytes(library.emit_native_object())


def _read(file: Path) -> bytes | None:
    """What was written to a file; None if it is not there or damaged."""
    try:
        found = file.read_bytes()
    except OSError:
        return None
    data = found[_HASH:]
    if hashlib.sha256(data).digest() != found[:_HASH]:
        return None
    with contextlib.suppress(OSError):
        os.utime(file)
    return data


def _write(file: Path, data: bytes) -> None:
    """Write a file under another name and rename it, so that no reader sees a part of it."""
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=_PREFIX, suffix=_PART)
    try:
        with os.fdopen(handle, "wb") as part:
            part.write(hashlib.sha256(data).digest() + data)
        Path(name).replace(file)
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise


def _trim() -> None:
    """Remove the files that were not used for longest, and those of writers that died."""
    if made % 64:
        return
    files = [(file.stat(), file) for file in _all_files()]
    excess = sum(info.st_size for info, _ in files) - LIMIT
    for info, file in sorted(files, key=lambda x: x[0].st_mtime):
        is_part = file.suffix == _PART
        if time.time() - info.st_mtime > _ABANDONED if is_part else excess > 0:
            excess -= info.st_size
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
        if why := _others(path):
            return None, f"{path} is not trusted: {why}"
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
        own, chosen = folder_of(generated), numba.config.CACHE_DIR
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
    return [] if path is None else list(path.glob(f"{_PREFIX}*"))


def usage() -> tuple[int, int]:
    """(programs, bytes) in the folder."""
    files = _all_files()
    sizes = 0
    for file in files:
        with contextlib.suppress(OSError):  # another process may have removed it
            sizes += file.stat().st_size
    return sum(file.suffix != _PART for file in files), sizes


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
