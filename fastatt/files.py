"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import IO, Any

from fastatt import checks


def target(name: str, path: str | os.PathLike[str]) -> Path:
    """The path of a file to be written; ``name`` is that of the argument.

    Raises ``ValueError`` for a folder, ``TypeError`` for what is no path.
    """
    found = checks.path(name, path)
    if found.is_dir():
        raise ValueError(f"{name}: found the directory {found}; accepted: a file")
    return found


@contextmanager
def writing(
    name: str, path: str | os.PathLike[str], *, text: str | None = None
) -> Iterator[IO[Any]]:
    """An open file for the contents of ``path``, of bytes, or of text in an encoding.

    It stands beside a regular file or a new name, and takes its place at the end, unless an error
    is raised. A device, a pipe and the target of a symbolic link are written to themselves.

    Raises as :func:`target` does, and ``OSError``.
    """
    whole = target(name, path)
    kind: dict[str, Any] = {"encoding": text, "newline": ""} if text else {}
    letter = "" if text else "b"
    if whole.is_symlink() or (whole.exists() and not whole.is_file()):
        with whole.open(f"w{letter}", **kind) as file:
            yield file
        return
    beside = whole.with_name(f".{token_hex(8)}.part")
    try:
        file = beside.open(f"x{letter}", **kind)
    except OSError as error:  # of the folder
        raise type(error)(error.errno, error.strerror, str(whole)) from None
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if whole.exists():
            shutil.copymode(whole, beside)
        beside.replace(whole)
    finally:
        beside.unlink(missing_ok=True)
