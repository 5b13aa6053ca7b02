"""Machine code on disk, in one folder: what Numba keeps of a function, in a file with a hash.

A file is named by the hash of everything that the code depends on, so that a change anywhere leads
to another file and nothing on disk is ever stale. It begins with the hash of its contents, without
which Numba does not see them. A folder that may only be read is read; where nothing can be kept,
each process compiles.

``FASTATT_CACHE`` names the folder, or switches it off with ``0``; otherwise it is the folder for
the user's caches.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import marshal
import os
import shutil
import stat
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

import numba

from fastatt._numba import FOUND, NEW, folder_of, target

#: bytes that the folder may hold before the files that were not used for longest are removed
LIMIT = 256 << 20
_ABANDONED = 3600.0  # s
_PREFIX, _PART = "fastatt_", ".part"
_HASH = hashlib.sha256().digest_size

#: how many functions were loaded from disk, and how many compiled, since the process started
hits = made = 0

#: whether Numba, which holds a lock of its own, calls this thread's function
within_numba = ContextVar("within_numba", default=False)
_lock = threading.RLock()
Made = TypeVar("Made")


def alone() -> contextlib.AbstractContextManager[object]:
    """One thread at a time, so that two do not compile the same.

    Within Numba a thread does not wait for one that waits for Numba.
    """
    return contextlib.nullcontext() if within_numba.get() else _lock


def kept(key: str, make: Callable[[str | None], Made]) -> Made:
    """What ``make(file)`` compiles, or loads if the folder has a file of this key.

    It compiles a function whose source seems to be that file, for Numba to keep it; for None, in
    memory. Numba reads and writes in a folder of this call alone.
    """
    global hits, made  # noqa: PLW0603
    with alone():
        _tell_versions()
        _check_numbas()
        path = folder()
        versions = *target(), repr(FOUND), sys.version
        digest = hashlib.sha256("\0".join((key, *versions)).encode()).hexdigest()[:40]
        if path is not None:
            file = path / f"{_PREFIX}{digest}"
            for before in (_read(file), {}):
                try:
                    function, after = beside(before, make)
                except Exception:  # noqa: BLE001  # of an error in the function the last one tells
                    continue
                if after == before:
                    hits += 1
                else:
                    made += 1
                    with contextlib.suppress(OSError):
                        _write(file, marshal.dumps(after))
                        _trim()
                return function
        made += 1
        return make(None)


def beside(
    files: dict[str, bytes], make: Callable[[str | None], Made]
) -> tuple[Made, dict[str, bytes]]:
    """What is made where Numba finds some files, and its files afterwards."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as folder_of_source:
        source = Path(folder_of_source) / "function.py"
        source.touch()
        os.utime(source, (0, 0))  # some releases of Numba compare it
        place = folder_of(str(source))
        try:
            if why := _others_of_numbas(place.parent):
                raise PermissionError(why)
            for name, data in files.items():
                (place / name).write_bytes(data)
            function = make(str(source))
            return function, {x.name: x.read_bytes() for x in place.iterdir()}
        finally:
            shutil.rmtree(place, ignore_errors=True)


def _read(file: Path) -> dict[str, bytes]:
    """Numba's files by name; none if they are not there or damaged."""
    try:
        contents = file.read_bytes()
    except OSError:
        return {}
    data = contents[_HASH:]
    if hashlib.sha256(data).digest() != contents[:_HASH]:
        return {}
    with contextlib.suppress(OSError):
        os.utime(file)
    files: dict[str, bytes] = marshal.loads(data)
    return files


def _write(file: Path, data: bytes) -> None:
    """Write a file under another name and rename it, so that no reader sees a part of it."""
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)  # if it was removed
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


def _others_of_numbas(path: Path, safe: int = stat.S_ISVTX) -> str:
    """How others may replace what is in a folder of Numba's, without a permission that is safe."""
    info = path.stat()
    # systems give each user a group, of the same number
    shared = stat.S_IWOTH | (0 if info.st_gid == info.st_uid else stat.S_IWGRP)
    return "" if info.st_mode & safe else _others(path, shared)


@functools.cache
def _tell_versions() -> None:
    """Warn, once, of releases that were not seen."""
    if NEW:
        told = "interfaces that may differ are tried before they are used"
        warnings.warn(f"versions: found {NEW}; {told}", stacklevel=2)


@functools.cache
def _check_numbas() -> None:
    """Warn, once, of a folder that others may write to, from which Numba loads machine code."""
    with contextlib.suppress(RuntimeError, OSError):  # Numba has no folder
        # Numba's folders for other files of the package have the same owner
        default, chosen = folder_of(__file__), numba.config.CACHE_DIR
        for path, *safe in ((default, 0), *([(Path(chosen),)] if chosen else ())):
            if why := _others_of_numbas(path, *safe):
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
