"""Histories that do not fit into memory: files that grow by a few saves at a time."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.engine.run import Results
from fastatt.files import writing
from fastatt.propagation.trajectory import Trajectory

# bytes below which the free memory is not checked
_LITTLE = 1 << 30


@dataclass(frozen=True)
class ToFile:
    """A file for the saves of a run; :func:`to_file` makes it.

    Attributes
    ----------
    path : Path
        The file.
    """

    path: Path


def to_file(path: str | os.PathLike[str]) -> ToFile:
    """Write the saves of a run to a file: ``propagate(..., on_save=fa.to_file(path))``.

    The file grows by 16 saves at a time, so that a history may be larger than memory. It holds
    (S, N, k) numbers: the attitudes, then w, v, r and s if the scene has them, then the norm error.

    Parameters
    ----------
    path : str or os.PathLike
        ``*.npy``, which the trajectory then maps into memory.

    Returns
    -------
    ToFile
        For the argument ``on_save`` of :func:`fastatt.propagate`.

    Raises
    ------
    TypeError
        If ``path`` is not a path.
    ValueError
        If the file is of another kind.

    Examples
    --------
    >>> import fastatt as fa
    >>> fa.to_file("history.npy").path.name
    'history.npy'
    """
    target = checks.path("path", path, "a path, *.npy")
    if target.suffix != ".npy":
        raise ValueError(f"path: found {checks.brief(target.name)}; accepted: *.npy")
    return ToFile(target)


def saving(on_save: Any) -> tuple[Callable[[Trajectory], object] | None, Path | None]:
    """The function and the file in ``on_save``, each at most once.

    Raises ``TypeError`` and ``ValueError`` for anything else.
    """
    given = on_save if isinstance(on_save, (list, tuple)) else [on_save]
    files = [x.path for x in given if isinstance(x, ToFile)]
    functions = [x for x in given if x is not None and not isinstance(x, ToFile)]
    for found in functions:
        if not callable(found):
            raise TypeError(
                f"on_save: found {checks.brief(found)}; accepted: a function, fa.to_file(path), or "
                "one of each"
            )
    if max(len(files), len(functions)) > 1:
        raise ValueError("on_save: found two of a kind; accepted: one function and one file")
    return next(iter(functions), None), next(iter(files), None)


class History:
    """A file of (S, N, k) numbers: attitudes, then w, v, r and s if present, then norm errors.

    It is mapped into memory, as ``array``.
    """

    def __init__(self, target: Path, shape: tuple[int, int, int], kind: np.dtype[Any]) -> None:
        #: the number of saves in the file
        self.saves = 0
        _check_room(shape, kind, _free_on_disk(target), "disk")
        shape = (*shape[:2], shape[2] + 1)
        if target.exists() and not target.is_file():
            raise ValueError(
                f"on_save: found {target}, which cannot be mapped; accepted: a regular file, or a "
                "new name"
            )
        # an array of the file before may still be mapped
        with writing("on_save", target) as file:
            empty = {
                "descr": np.lib.format.dtype_to_descr(kind), "fortran_order": False, "shape": shape
            }  # fmt: skip
            np.lib.format.write_array_header_1_0(file, empty)
            file.truncate(file.tell() + math.prod(shape) * kind.itemsize)
        self.array = np.load(target, mmap_mode="r+")

    def __call__(self, piece: Trajectory) -> None:
        """Write a few saves."""
        rows = slice(self.saves, self.saves + piece.t.size)
        columns = [piece.state, *piece.carried.values(), piece.norm_error[..., None]]
        self.array[rows] = np.concatenate(columns, axis=-1)
        self.saves = rows.stop

    def results(self, saves: int, status: NDArray[np.uint8]) -> Results:
        """The first saves, if the file is mapped into memory."""
        return Results(self.array[:saves], status, np.empty((status.size, 0)))


def check_memory(shape: tuple[int, int, int], kind: np.dtype[Any]) -> None:
    """Raise ``MemoryError``, with the sizes, if an array does not fit into memory."""
    if _bytes(shape, kind) > _LITTLE and (free := _available()) is not None:
        _check_room(shape, kind, free, "memory")


def _bytes(shape: tuple[int, int, int], kind: np.dtype[Any]) -> int:
    return shape[0] * shape[1] * (shape[2] + 1) * kind.itemsize


def _check_room(shape: tuple[int, int, int], kind: Any, free: int, where: str) -> None:
    saves, bodies, _ = shape
    need = _bytes(shape, kind)
    if need > _LITTLE and need > free:
        raise MemoryError(
            f"save_every: {saves} saves of {bodies} bodies take {need / 1e9:.3g} GB, of "
            f"{free / 1e9:.3g} GB of free {where}; accepted: fewer saves, or "
            'on_save=fa.to_file("history.npy") on a disk that holds them'
        )


def _free_on_disk(path: Path) -> int:
    return shutil.disk_usage(path.resolve().parent).free


def _available() -> int | None:
    """Bytes of available memory; None if the system does not report them."""
    try:
        with Path("/proc/meminfo").open() as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None
