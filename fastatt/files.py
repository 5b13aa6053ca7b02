"""Files that are written whole or not at all."""

from __future__ import annotations

import csv
import os
import platform
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from secrets import token_hex
from typing import IO, Any

from fastatt import checks

_LETTERS = 24  # of a name, that the name of a part has


def target(name: str, path: str | os.PathLike[str]) -> Path:
    """The path of a file to be written; ``name`` is that of the argument.

    Raises ``ValueError`` for a folder, ``TypeError`` for what is no path.
    """
    file = checks.path(name, path)
    if file.is_dir():
        raise ValueError(f"{name}: found the directory {file}; accepted: a file")
    return file


@contextmanager
def writing(
    name: str, path: str | os.PathLike[str], *, text: str | None = None
) -> Iterator[IO[Any]]:
    """An open file for the contents of ``path``, of bytes, or of text in an encoding.

    It is a new file in the folder of ``path``, and replaces a regular file, or takes a new name, at
    the end, unless an error is raised. A device, a pipe and the target of a symbolic link are
    written to themselves.

    Raises as :func:`target` does, and ``OSError``.
    """
    whole = target(name, path)
    options: dict[str, Any] = {"encoding": text, "newline": ""} if text else {}
    letter = "" if text else "b"
    if whole.is_symlink() or (whole.exists() and not whole.is_file()):
        with whole.open(f"w{letter}", **options) as file:
            yield file
        return
    # of a long name its first letters, since a folder limits names to 255 bytes
    part = f".{whole.name[:_LETTERS]}.{platform.node()[:_LETTERS]}-"
    _remove_left(whole.parent, part)
    temporary = whole.with_name(f"{part}{os.getpid()}-{token_hex(8)}.part")
    try:
        file = temporary.open(f"x{letter}", **options)
    except OSError as error:  # of the folder
        raise type(error)(error.errno, error.strerror, str(whole)) from None
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if whole.exists():
            shutil.copymode(whole, temporary)
        temporary.replace(whole)
    finally:
        temporary.unlink(missing_ok=True)


def _remove_left(folder: Path, part: str) -> None:
    """Remove the parts of a file that processes left which were killed on this machine."""
    with suppress(OSError):
        for left in folder.iterdir():
            if left.name.startswith(part) and left.suffix == ".part":
                process = left.name.removeprefix(part).partition("-")[0]
                if process.isdigit() and not _is_alive(int(process)):
                    left.unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    """Whether a process may still write; on Windows the question would end it."""
    if os.name == "posix":
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return False
        except OSError:
            return True
    return True


def write_csv(
    name: str,
    path: str | os.PathLike[str],
    columns: Iterable[str],
    rows: Iterable[Sequence[Any]],
) -> None:
    """Write rows of values as CSV after a line of names, without rounding any number.

    Raises as :func:`writing` does.
    """
    with writing(name, path, text="utf-8") as file:
        # the text of Python's floats is the shortest from which the same number is read
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)
