"""Where machine code is kept between processes: one file a function, named by its hash.

``FASTATT_CACHE`` names the folder, or switches it off with ``0``; without it that for the user's
caches is taken. A folder that others may write to is not trusted, a file that is damaged is made
anew, and where nothing can be written nothing is.
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
from pathlib import Path

_MARK = b"fastatt1"
#: bytes that the folder may hold before the oldest files go
LIMIT = 256 << 20
_ABANDONED = 3600.0  # s

#: how many functions were read from disk, and how many were made, since the start of the process
hits = made = 0


def folder() -> Path | None:
    """The folder, made if it was not there; None where nothing is kept."""
    return _found()[0]


def reason() -> str:
    """Why nothing is kept; empty where it is."""
    return _found()[1]


@functools.cache
def _found() -> tuple[Path | None, str]:
    chosen = os.environ.get("FASTATT_CACHE")
    if chosen is not None and chosen.strip().lower() in ("", "0", "off", "no"):
        return None, f"FASTATT_CACHE={chosen} switches it off"
    try:
        path = Path(chosen).expanduser() if chosen else _user_folder() / "fastatt"
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        info = path.stat()
        if hasattr(os, "getuid"):
            if info.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                return None, f"{path} is not trusted: others may write to it"
            if info.st_uid not in (os.getuid(), 0):
                return None, f"{path} is not trusted: it is another user's"
        if not os.access(path, os.W_OK | os.X_OK) and not any(path.iterdir()):
            return None, f"{path} may not be written to"
    except (OSError, RuntimeError) as error:
        return None, str(error)
    return path, ""


def _user_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def read(key: str) -> bytes | None:
    """What was kept under a key, None if nothing is, or nothing whole."""
    global hits  # noqa: PLW0603
    path = folder()
    if path is None:
        return None
    try:
        data = (path / f"{key}.o").read_bytes()
    except OSError:
        return None
    head = len(_MARK) + 32
    if data[: len(_MARK)] != _MARK or hashlib.sha256(data[head:]).digest() != data[8:head]:
        return None
    hits += 1
    with contextlib.suppress(OSError):
        os.utime(path / f"{key}.o")  # what is used is not old
    return data[head:]


def write(key: str, code: bytes) -> None:
    """Keep machine code: written beside and renamed, so that no reader sees half a file."""
    global made  # noqa: PLW0603
    made += 1
    path = folder()
    if path is None:
        return
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_MARK + hashlib.sha256(code).digest() + code)
            Path(name).replace(path / f"{key}.o")
        except OSError:
            Path(name).unlink(missing_ok=True)
        if made % 64 == 1:
            _trim(path)


def _trim(path: Path) -> None:
    """Remove the files that were not used for longest, and what a writer that died left."""
    now = time.time()
    for file in path.glob("*.part"):
        if now - file.stat().st_mtime > _ABANDONED:
            file.unlink(missing_ok=True)
    files = sorted((f.stat().st_mtime, f.stat().st_size, f) for f in path.glob("*.o"))
    excess = sum(size for _, size, _ in files) - LIMIT
    for _, size, file in files:
        if excess <= 0:
            break
        file.unlink(missing_ok=True)
        excess -= size


def usage() -> tuple[int, int]:
    """(files, bytes) in the folder."""
    path = folder()
    sizes = []
    for file in path.glob("*.o") if path else ():
        with contextlib.suppress(OSError):  # another process may have removed it
            sizes.append(file.stat().st_size)
    return len(sizes), sum(sizes)


def clear() -> None:
    """Remove every file.

    Raises ``OSError`` where they may not be removed.
    """
    path = folder()
    for pattern in ("*.o", "*.part"):
        for file in path.glob(pattern) if path else ():
            file.unlink(missing_ok=True)
