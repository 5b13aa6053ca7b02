"""Where the saves of a run go: to memory, to a function, to a file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt.codegen import memory
from fastatt.engine.run import Crossings, Results, Run
from fastatt.engine.status import Status
from fastatt.engine.tape import Piece
from fastatt.files import target, writing
from fastatt.propagation.schedule import Schedule, refuse_pairs
from fastatt.propagation.trajectory import Trajectory
from fastatt.threads import number_of

# numbers of a history that are written at a time, before the run
_WRITTEN = 1 << 20


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

    A history may be larger than memory, of which 16 saves take a part at a time. The file holds
    (S, N, k) numbers: the attitudes, then w, v, r and s if the scene has them, then the norm error.
    When a run begins, it has its whole size on the disk, and replaces a file of that name: saves
    that are not made yet are NaN. The times of the saves, s, are in ``*.times.npy``.

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
    schedule: Schedule, n_threads: int | None, progress: bool, on_save: Any, checkpoint: Any
) -> dict[str, Any]:
    """The options of a run by ``propagate`` or ``resume``, as ``Plan.run`` takes them.

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
    refuse_pairs({"dt (N,)": schedule.is_per_body, **is_given})
    if on_save is not None and schedule.every is None and schedule.save_at is None:
        raise ValueError("on_save: found without saves; accepted: with save_every or save_at")
    return {
        "n_threads": None if n_threads is None else number_of(n_threads),
        "progress": progress,
        "on_save": next(iter(functions), None),
        "file": next(iter(files), None),
        "checkpoint": None if checkpoint is None else target("checkpoint", checkpoint),
        "keeps_end": True,
    }


class History:
    """A file of (S, N, k) numbers: attitudes, then w, v, r and s if present, then norm errors.

    Saves that were not made are NaN. A file next to it has the times.
    """

    def __init__(
        self, target: Path, shape: tuple[int, int, int], dtype: np.dtype[Any],
        times: NDArray[np.float64],
    ) -> None:  # fmt: skip
        #: the number of saves in the file
        self.saves = 0
        check_room(shape, dtype, target)
        saves, bodies, values = self._shape = (*shape[:2], shape[2] + 1)
        self._dtype = dtype
        if target.exists() and not target.is_file():
            raise ValueError(
                f"on_save: found {target}, which cannot be mapped; accepted: a regular file, or a "
                "new name"
            )
        # an array of the file before may still be mapped
        with writing("on_save", target) as file:
            empty = {
                "descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False,
                "shape": self._shape,
            }  # fmt: skip
            np.lib.format.write_array_header_1_0(file, empty)
            self._begin = file.tell()
            many = min(saves, 1 + _WRITTEN // (bodies * values))
            blank = np.full((many, bodies, values), np.nan, dtype)
            for first in range(0, saves, many):
                file.write(blank[: saves - first].data)
            file.flush()
            os.fsync(file.fileno())  # of which a disk that is full may tell
            with writing("on_save", target.with_suffix(".times.npy")) as beside:
                np.save(beside, times)
        self._file = target.open("r+b")
        self._file.seek(self._begin)

    def __call__(self, piece: Trajectory) -> None:
        """Write a few saves."""
        columns = [piece.state, *piece.carried.values(), piece.norm_error[..., None]]
        # written, since a disk that is full ends a process that changes a map
        self._file.write(np.concatenate(columns, axis=-1).data)
        self._file.flush()
        self.saves += piece.t.size

    @property
    def array(self) -> NDArray[Any]:
        """The numbers, mapped into memory."""
        return np.memmap(self._file, self._dtype, "r+", self._begin, self._shape)

    def close(self) -> None:
        """Write no more."""
        self._file.close()


class InterruptedRun(KeyboardInterrupt):
    """Ctrl-C during a run; ``trajectory`` holds the results so far.

    Bodies that did not reach the end have the status ``UNFINISHED``, and NaN in their later saves.
    """

    def __init__(self, trajectory: Trajectory | None = None) -> None:
        super().__init__()
        self.trajectory = trajectory


class Output:
    """The saves of a run: all in memory, or a few at a time, which ``takers`` are handed.

    ``trajectory_of`` is called with times and results for a trajectory.
    """

    def __init__(
        self, schedule: Schedule, times: NDArray[np.float64], arrays: Callable[[int], Results],
        trajectory_of: Callable[..., Trajectory],
        takers: Sequence[Callable[[Trajectory], object] | None],
    ) -> None:  # fmt: skip
        self._schedule, self._times, self._trajectory_of = schedule, times, trajectory_of
        self._takers = [take for take in takers if take is not None]
        self._file = next((x for x in self._takers if isinstance(x, History)), None)
        #: whether a few saves are in memory at a time
        self.is_ring = bool(self._takers)
        #: (first, end) of these
        self.batches = schedule.batches if self.is_ring else [(0, schedule.saves)]
        self._left = self.batches[::-1]
        # parts of the crossings that functions took
        self._crossed = 0
        #: the last attitudes that a function took
        self._last: NDArray[Any] | None = None
        #: counts what is done
        self.done: Callable[[int], object] = lambda _: None
        self.results = arrays(max(end - first for first, end in self.batches))

    @property
    def length(self) -> tuple[int, str]:
        """How much a progress bar counts, and what: saves that a function takes, or else steps."""
        if self.is_ring:
            return self._times.size, "save"
        return self.results.status.size * self._schedule.n_steps, "step"

    @property
    def stops(self) -> list[int]:
        """The numbers of the saves after which a piece ends."""
        return [end - 1 for _, end in self.batches[:-1]]

    def take(self, run: Run, piece: Piece) -> None:
        """Hand out the saves of a piece, or count its steps."""
        if not self.is_ring:
            before, after = piece.share
            steps = round(self._schedule.n_steps * after) - round(self._schedule.n_steps * before)
            self.done(run.results.status.size * steps)
        elif self._left and piece.saved >= self._left[-1][1]:
            self.hand_out(*self._left.pop())

    def hand_out(self, first: int, end: int) -> None:
        """Hand out the saves [first, end)."""
        if not self.is_ring:
            return
        saves, status, event_times, crossings = self.results
        # flags and times of events change later
        new, self._crossed = Crossings(crossings[self._crossed :]), len(crossings)
        results = Results(saves[: end - first], status.copy(), event_times.copy(), new)
        piece = self._trajectory_of(self._times[first:end], results, q_before=self._last)
        for take in self._takers:
            take(piece)
        self._last = piece.last_taken
        self.done(end - first)

    def close(self) -> None:
        """Close the file, if there is one."""
        if self._file is not None:
            self._file.close()

    def so_far(self) -> Trajectory | None:
        """The saves of an interrupted run; None of saves that a function has taken."""
        if self._file is not None:
            self.results.status[:] = Status.UNFINISHED
        elif self.is_ring:
            return None
        return self.trajectory(None)

    def trajectory(self, end: Any) -> Trajectory:
        """The trajectory of a run: of all saves that are kept so far, or of the last."""
        times, results, file = self._times, self.results, self._file
        if file is not None:
            times, results = times[: file.saves], results._replace(saves=file.array[: file.saves])
        elif self.is_ring:
            first, last = self.batches[-1]
            last -= first
            times, results = times[-1:], results._replace(saves=results.saves[last - 1 : last])
        return self._trajectory_of(times, results, end=end)


def check_room(shape: tuple[int, int, int], dtype: np.dtype[Any], file: Path | None = None) -> None:
    """Raise ``MemoryError``, with the sizes, if saves do not fit into memory or on the disk."""
    saves, bodies, values = shape
    need = saves * bodies * (values + 1) * dtype.itemsize
    if need <= memory.LITTLE:
        return
    free, where = memory.available(), "memory"
    if file is not None:
        free, where = shutil.disk_usage(file.resolve().parent).free, "disk"
    if free is not None and need > free:
        raise MemoryError(
            f"save_every: {saves} saves of {bodies} bodies take {need / 1e9:.3g} GB, of "
            f"{free / 1e9:.3g} GB of free {where}; accepted: fewer saves, or "
            'on_save=fa.to_file("history.npy") on a disk that holds them'
        )
