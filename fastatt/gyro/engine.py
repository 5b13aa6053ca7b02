"""What runs of a log: a method's windows as machine code, under the loops that all methods share.

A method's windows are compiled on their own, for turns of at most π and, when a log first holds a
longer one, for any: the loops give back control where they would need it, and go on from there.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import quat_multiply
from fastatt.flat import machine
from fastatt.flat.code import text_of
from fastatt.gyro.chunk import Job, scratch_size
from fastatt.gyro.loops import Loops
from fastatt.gyro.turns import WindowsLoop
from fastatt.gyro.windows import Window

_KINDS = {np.dtype(np.float64): "double", np.dtype(np.float32): "single"}
_SCRATCH = threading.local()
# programs are made once: threads that meet the need of one together wait for the first
_MAKING = threading.Lock()


class Run:
    """Logs of one kind and a method's window: what is worked on, and how far turns went.

    ``data`` (N, n, 3) are samples, ``before`` and ``after`` (N, k, 3) those beyond the logs' ends,
    ``spans`` the interval, s, or the intervals; ``out`` (N, m, 4) takes attitudes. All arrays are
    C-contiguous, of one precision.
    """

    def __init__(
        self,
        window: Window,
        increments: bool,
        data: NDArray[Any],
        ends: tuple[NDArray[Any], NDArray[Any]],
        spans: Any,
        out: NDArray[Any],
    ) -> None:
        uneven = isinstance(spans, np.ndarray)
        self._window, self._increments = window, increments
        self._held = (data, *ends, np.atleast_1d(spans), out)
        self._kind = _KINDS[data.dtype]
        self._windows = functools.partial(windows, window, increments, self._kind, uneven)
        with _MAKING:
            self._loops = _loops(self._kind)
        before, after = ends
        of_one = 1.0 if increments else 0.0 if uneven else abs(float(spans))
        # an iteration has one form for all angles
        near = 0.0 if window.iteration else window.near
        self._job = Job(
            data=data.ctypes.data,
            n_samples=data.shape[1],
            before=before.ctypes.data,
            n_before=before.shape[1],
            after=after.ctypes.data,
            n_after=after.shape[1],
            spans=self._held[3].ctypes.data,
            n_spans=spans.size if uneven else 0,
            out=out.ctypes.data,
            n_out=out.shape[1],
            history=window.history,
            span=window.span,
            extra=not increments,
            by_interval=uneven and not increments,
            near=near,
            factor=of_one,
        )
        self._short = self._made(False) if near else None
        self._wide = None if near else self._made(True)

    def side_by_side(
        self,
        stretches: tuple[NDArray[np.int64], NDArray[np.int64]],
        count: int,
        q: NDArray[Any],
        peak: NDArray[Any],
        lanes: tuple[int, int],
    ) -> None:
        """Carry lanes [first, last) of attitudes ``q (L, 4)`` to the ends of their logs.

        ``stretches`` are the log of each lane (L,) and its first interval (L,), ``count`` intervals
        before the end; ``peak (L,)`` gets the largest component of a lane's angles over an
        interval, rad.
        """
        job = self._with(peak)
        job.body, job.start = (of_lane.ctypes.data for of_lane in stretches)
        job.count = count
        sweep, last = self._loops["sweep"], lanes[1]
        self._through(job, lanes, lambda *given, at: sweep(*given, q.ctypes.data, at, last))
        rest = (self._held[-1].shape[1] - 1) % self._window.span
        if self._window.iteration and rest:
            self._finish(stretches[0][slice(*lanes)], rest)

    def _finish(self, logs: NDArray[np.int64], rest: int) -> None:
        """The last ``rest`` intervals of some logs, fewer than a window has, cut into as many.

        Beyond a log's end the polynomial is soon so large that no iteration holds it.
        """
        data, *_, spans, out = self._held
        with np.errstate(over="ignore", invalid="ignore"):  # looked at in the result
            samples, apart, ends = _cut(data[logs], spans, rest, self._window, self._increments)
        n, span = len(logs), self._window.span
        turns = np.empty((n, span + 1, 4), dtype=out.dtype)
        unit = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=out.dtype), (n, 1))
        none = np.zeros((n, 1, 3), dtype=out.dtype)
        run = Run(self._window, self._increments, samples, (none, none), apart, turns)
        own = np.arange(n), np.zeros(n, dtype=np.int64)
        run.side_by_side(own, span, unit, np.zeros(n, dtype=out.dtype), (0, n))
        out[logs, -rest:] = quat_multiply(out[logs, -rest - 1][:, None], turns[:, ends])

    def find_turns(
        self, log: int, totals: NDArray[Any], peak: NDArray[Any], tiles: tuple[int, int]
    ) -> None:
        """The turns of tiles [first, last) of one log, ``TILE`` intervals each: ``totals (T, 4)``.

        ``peak (T,)`` gets the largest component of a tile's angles over an interval, rad.
        """
        unit = np.array([1.0, 0.0, 0.0, 0.0], dtype=totals.dtype)
        job = self._with(peak)
        job.log, job.totals = log, totals.ctypes.data
        along, last = self._loops["along"], tiles[1]
        self._through(job, tiles, lambda *given, at: along(*given, unit.ctypes.data, 0, at, last))

    def along(self, log: int, q: NDArray[Any], peak: NDArray[Any], tiles: tuple[int, int]) -> None:
        """Write the attitudes of tiles from q (4,), at the first's start; it ends at the last's.

        ``peak`` is as for ``find_turns``.
        """
        job = self._with(peak)
        job.log = log
        along, last = self._loops["along"], tiles[1]
        self._through(job, tiles, lambda *given, at: along(*given, q.ctypes.data, 1, at, last))

    def chain(self, q: NDArray[Any], totals: NDArray[Any]) -> None:
        """Turn q (4,) by further turns (n, 4), one after the other."""
        self._loops["chain"](q.ctypes.data, totals.ctypes.data, len(totals))

    def _with(self, peak: NDArray[Any]) -> Job:
        job = Job.from_buffer_copy(self._job)
        job.peak = peak.ctypes.data
        return job

    def _made(self, wide: bool) -> machine.Compiled:
        with _MAKING:
            return self._windows(wide)

    def _through(self, job: Job, bounds: tuple[int, int], call: Callable[..., int]) -> None:
        at, last = bounds
        work = _scratch(self._kind)
        while at < last:
            job.short, job.wide = (
                form.address("windows") if form else 0 for form in (self._short, self._wide)
            )
            at = call(ctypes.addressof(job), work.ctypes.data, at=at)
            if at < last:
                self._wide = self._made(True)


def _cut(
    data: NDArray[Any], spans: NDArray[Any], rest: int, window: Window, increments: bool
) -> tuple[NDArray[Any], Any, NDArray[np.int64]]:
    """Samples and intervals of a window that covers the last ``rest`` intervals of logs.

    The samples are those of the polynomial through the last whole window, or all there is. Equal
    intervals are one number. The third are the places where the logs' own intervals end.
    """
    near = min(window.samples(increments), data.shape[1])
    gaps = np.broadcast_to(spans, len(spans) if len(spans) > 1 else near)
    gaps = gaps[len(gaps) - near + (not increments) :].astype(np.float64)
    parts = window.span // rest + (np.arange(rest) < window.span % rest)
    fine = np.repeat(gaps[-rest:] / parts, parts)
    nodes = np.concatenate([[0.0], np.cumsum(gaps)])
    at = nodes[-1 - rest] + np.concatenate([[0.0], np.cumsum(fine)])
    same = np.eye(len(nodes), dtype=bool)
    ratios = (at[:, None, None] - nodes) / np.where(same, 1.0, nodes[:, None] - nodes)
    lagrange = np.where(same, 1.0, ratios).prod(axis=-1)
    if increments:  # the polynomial is that of the running angle, from 0 at the first node
        values = np.diff(lagrange[:, 1:] @ data[:, -near:].cumsum(axis=1), axis=1)
    else:
        values = lagrange @ data[:, -near:]
    apart = fine.astype(data.dtype)
    return values.astype(data.dtype), apart[0] if np.ptp(apart) == 0.0 else apart, parts.cumsum()


def _scratch(kind: str) -> NDArray[np.uint8]:
    """Scratch memory, one for each thread."""
    found: NDArray[np.uint8] | None = getattr(_SCRATCH, kind, None)
    if found is None:
        whole = np.zeros(scratch_size(kind) + 64, dtype=np.uint8)
        found = whole[-whole.ctypes.data % 64 :]
        setattr(_SCRATCH, kind, found)
    return found


@functools.cache
def _loops(kind: str) -> dict[str, Any]:
    """The functions of a precision."""
    made = machine.compiled(text_of(Loops(kind).module))
    address, whole = ctypes.c_void_p, ctypes.c_int64
    return {
        "sweep": made.function("sweep", address, address, address, whole, whole),
        "along": made.function("along", address, address, address, whole, whole, whole),
        "chain": made.function("chain", address, address, whole),
    }


@functools.cache
def windows(
    window: Window, increments: bool, kind: str, uneven: bool, wide: bool
) -> machine.Compiled:
    """A method's loop over a chunk's windows, on all lanes; compiled, or from disk.

    ``uneven`` intervals stand in rows, equal ones are one number; ``wide`` takes turns of any
    angle.
    """
    return machine.compiled(text_of(WindowsLoop(window, increments, kind, uneven, wide).module))
