"""Histories that do not fit into memory: files that grow by a few saves at a time."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.engine.run import Results
from fastatt.files import target, writing
from fastatt.propagation.end import End
from fastatt.propagation.options import Clock, RunOptions, refuse_pairs
from fastatt.propagation.trajectory import Trajectory
from fastatt.threads import number_of

# bytes below which the free memory is not checked
_LITTLE = 1 << 30
# body-steps below which one thread is as fast as several; 2 ms of the slowest method
_SHORT = 65_536


@dataclass(frozen=True)
class ToFile:
    """A file for the saves of a run; :func:`to_file` makes it.

    Attributes
    ----------
    path : Path
        The file.
    """

    path: Path


#: what ``on_save`` accepts
OnSave = Callable[[Trajectory], object] | ToFile


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
    file = checks.path("path", path, "a path, *.npy")
    if file.suffix != ".npy":
        raise ValueError(f"path: found {checks.brief(file.name)}; accepted: *.npy")
    return ToFile(file)


def options_of(
    clock: Clock, n_bodies: int, n_threads: int | None, progress: bool, on_save: Any,
    checkpoint: Any, resumed: End | None = None,
) -> RunOptions:  # fmt: skip
    """The options of a run by ``propagate`` or ``resume``, whose trajectory holds its end.

    Raises ``ValueError`` and ``TypeError`` for arguments that do not fit.
    """
    takers = [*on_save] if isinstance(on_save, (list, tuple)) else [on_save]
    files = [x.path for x in takers if isinstance(x, ToFile)]
    functions = [x for x in takers if x is not None and not isinstance(x, ToFile)]
    for taker in functions:
        if not callable(taker):
            raise TypeError(
                f"on_save: found {checks.brief(taker)}; accepted: a function, fa.to_file(path), or "
                "one of each"
            )
    if max(len(files), len(functions)) > 1:
        raise ValueError("on_save: found two of a kind; accepted: one function and one file")
    is_given = {"on_save": on_save is not None, "checkpoint": checkpoint is not None}
    refuse_pairs({"dt (N,)": clock.is_per_body, **is_given})
    if on_save is not None and clock.every is None and clock.save_at is None:
        raise ValueError("on_save: found without saves; accepted: with save_every or save_at")
    return RunOptions(
        threads_of(n_threads, n_bodies, clock.n_steps),
        progress=progress,
        on_save=next(iter(functions), None),
        file=next(iter(files), None),
        checkpoint=None if checkpoint is None else target("checkpoint", checkpoint),
        resumed=resumed,
        keep_end=True,
    )


def threads_of(n_threads: int | None, n_bodies: int, n_steps: int) -> int:
    """The number of threads of a run; by default one for a short run."""
    if n_threads is None and n_bodies * n_steps < _SHORT:
        return 1
    return number_of(n_threads)


class History:
    """A file of (S, N, k) numbers: attitudes, then w, v, r and s if present, then norm errors.

    It is mapped into memory, as ``array``.
    """

    def __init__(self, target: Path, shape: tuple[int, int, int], kind: np.dtype[Any]) -> None:
        #: the number of saves in the file
        self.saves = 0
        check_room(shape, kind, target)
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


def check_room(shape: tuple[int, int, int], kind: np.dtype[Any], file: Path | None = None) -> None:
    """Raise ``MemoryError``, with the sizes, if saves do not fit into memory or on the disk."""
    saves, bodies, values = shape
    need = saves * bodies * (values + 1) * kind.itemsize
    if need <= _LITTLE:
        return
    free, where = _available(), "memory"
    if file is not None:
        free, where = shutil.disk_usage(file.resolve().parent).free, "disk"
    if free is not None and need > free:
        raise MemoryError(
            f"save_every: {saves} saves of {bodies} bodies take {need / 1e9:.3g} GB, of "
            f"{free / 1e9:.3g} GB of free {where}; accepted: fewer saves, or "
            'on_save=fa.to_file("history.npy") on a disk that holds them'
        )


def _available() -> int | None:
    """Bytes of available memory; None if the system does not report them."""
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return None
