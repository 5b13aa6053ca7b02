"""What runs of a log: a method's windows as machine code, under the loops that all methods share.

A method's windows are compiled on their own, for turns of at most π and, when a log first holds a
longer one, for any: the loops give back control where they would need it, and go on from there.
"""

from __future__ import annotations

import ctypes
import functools
import threading
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.arrays import quat_multiply
from fastatt.flat import machine
from fastatt.flat.code import text_of
from fastatt.flat.rows import address_of, kind_of
from fastatt.gyro import ends
from fastatt.gyro.chunk import Job, scratch_size
from fastatt.gyro.loops import Loops
from fastatt.gyro.turns import WindowsLoop
from fastatt.gyro.windows import CHUNK, LANES, Window
from fastatt.threads import each_in_threads, in_threads, number_of

_SCRATCH = threading.local()
# threads that meet a turn of any angle together wait for the first
_MAKING = threading.Lock()
NO_TURN = np.array([1.0, 0.0, 0.0, 0.0])
_AT_REST: dict[Any, NDArray[Any]] = {
    np.dtype(kind): np.tile(NO_TURN, (1, 2)).astype(kind) for kind in (np.float64, np.float32)
}
# intervals of a tile of one log, and tiles below which a thread more is no gain
_TILE, _TILES = LANES * CHUNK, 64
_SHORT = (2 * _TILES - 1) * _TILE
# tiles that take some 0.05 s, between two looks at Ctrl-C
_PIECE = 4096

_Done = Callable[[int], object] | None
_at = ctypes.addressof
_byte: Any = ctypes.c_char.from_buffer


class Run:
    """A stretch of logs and a method's window: ``n`` intervals to be turned into attitudes.

    ``data`` (N, lead + m, 3) are samples, ``lead`` of them before the stretch's first interval,
    ``spans`` the interval, s, or the intervals, (lead + n,); ``out`` (N, n + 1, 4) takes attitudes.
    All arrays are C-contiguous, of one precision. Without ``lead`` the logs begin here; they end
    here where the last window is not whole.
    """

    def __init__(
        self,
        window: Window,
        increments: bool,
        data: NDArray[Any],
        spans: Any,
        out: NDArray[Any],
        lead: int = 0,
    ) -> None:
        uneven = isinstance(spans, np.ndarray)
        self._held = data, spans, out
        program = self._program = _program(window, increments, data.dtype, uneven)
        samples, self._count = data.shape[1], out.shape[1] - 1
        missing = 0 if window.iteration else -self._count % window.span
        self._ends = program.ends(spans, samples, missing)
        job = self._job = Job.from_buffer_copy(self._ends)
        try:  # without a call: of short logs it shows
            job.data, job.out = _at(_byte(data)), _at(_byte(out))
        except (TypeError, ValueError, BufferError):  # read-only, or empty
            job.data, job.out = address_of(data), address_of(out)
        job.n_samples, job.lead, job.n_out = samples - lead, lead, self._count + 1
        job.count = self._count
        if uneven:
            job.spans, job.n_spans = address_of(spans), len(spans) - lead
        else:
            job.interval = spans
            if not increments:
                job.factor = spans

    def carry(
        self, q: NDArray[Any], *, phase: int = 0, n_threads: int | None = 1, done: _Done = None
    ) -> float:
        """Write all attitudes from p and r, q (N, 8), at the start, ``phase`` intervals of a chunk.

        It ends at the end. Gives the largest component of an angle over an interval, rad.
        """
        n_logs, count = len(q), self._count
        if n_logs == 1 and count <= _SHORT and not (phase or done):  # with as little as can be
            return self._through(self._job, "along", (0, -(-count // _TILE)), address_of(q), 1)
        head = min(-phase % CHUNK, count)
        chunks = -(-(count - head) // CHUNK)
        if n_logs >= LANES or n_logs * -(-chunks // LANES) > chunks:
            return self._side_by_side(q, (0, count), phase, n_threads, done)
        peak = self._side_by_side(q, (0, head), phase, 1, done) if head else 0.0
        if head < count:
            for log in range(n_logs):
                peak = max(peak, self._one_log(log, q[log], (head, count - head), n_threads, done))
        return peak

    def _side_by_side(
        self,
        q: NDArray[Any],
        bounds: tuple[int, int],
        phase: int,
        n_threads: int | None,
        done: _Done,
    ) -> float:
        """A lane for each log."""
        n_logs, count = len(q), bounds[1] - bounds[0]
        job = Job.from_buffer_copy(self._job)
        job.first, job.count, job.phase = bounds[0], count, phase
        if n_logs <= LANES and not done:
            return self._through(job, "sweep", (0, n_logs), address_of(q))
        n_threads = number_of(n_threads)
        tiles = -(-n_logs // LANES)
        size = LANES * max(1, min(-(-tiles // n_threads), 2_000_000 // (LANES * count)))
        peaks = []

        def task(first: int) -> None:
            last = min(first + size, n_logs)
            own = Job.from_buffer_copy(job)
            peaks.append(self._through(own, "sweep", (first, last), address_of(q)))
            if done:
                done((last - first) * count)

        each_in_threads([partial(task, first) for first in range(0, n_logs, size)], n_threads)
        return max(peaks)

    def _one_log(
        self, log: int, q: NDArray[Any], at: tuple[int, int], n_threads: int | None, done: _Done
    ) -> float:
        """Runs of tiles, each of whose lanes takes a chunk, on each thread."""
        job = Job.from_buffer_copy(self._job)
        job.log, (job.first, job.count) = log, at
        tiles = -(-at[1] // _TILE)
        if at[1] <= _SHORT and not done:
            return self._through(job, "along", (0, tiles), address_of(q), 1)
        threads = max(1, min(number_of(n_threads), tiles // _TILES))
        bounds = [tiles * i // threads for i in range(threads + 1)]
        starts = [q, *(q.copy() for _ in bounds[2:])]
        peaks = []

        def through(piece: tuple[int, int], p: NDArray[Any], write: int) -> None:
            own = Job.from_buffer_copy(job)
            peaks.append(self._through(own, "along", piece, address_of(p), write))

        if threads > 1:
            known = bounds[-2]
            totals = np.empty((known * LANES, 4), dtype=q.dtype)
            job.totals = address_of(totals)
            size = min(_PIECE, -(-known // threads))
            pieces = ((a, min(a + size, known)) for a in range(0, known, size))
            each_in_threads([partial(through, piece, q, 0) for piece in pieces], threads)
            chain = self._program.loops["chain"]
            for i in range(1, threads):
                starts[i][:] = starts[i - 1]
                first, last = (LANES * k for k in bounds[i - 1 : i + 1])
                chain(address_of(starts[i]), address_of(totals[first:]), last - first)

        def along(p: NDArray[Any], first: int, last: int, stop: Event) -> None:
            for a in range(first, last, _PIECE):
                if stop.is_set():
                    return
                z = min(a + _PIECE, last)
                through((a, z), p, 1)
                if done:
                    done(min(_TILE * z, at[1]) - _TILE * a)

        runs = zip(starts, pairwise(bounds), strict=True)
        in_threads([partial(along, p, a, z) for p, (a, z) in runs], threads)
        q[:] = starts[-1]
        return max(peaks)

    def _through(self, job: Job, name: str, bounds: tuple[int, int], q: int, *how: int) -> float:
        """Call a loop until all tiles are done; the largest component of an angle, rad."""
        at, last = bounds
        call, work = self._program.loops[name], _scratch(self._program.kind)
        where = ctypes.addressof(job)
        while at < last:
            job.short, job.wide = self._program.short, self._program.wide
            at = call(where, work, q, *how, at, last)
            if at < last:
                self._program.any_angle()
        return float(job.peak)


def finish(
    window: Window, increments: bool, data: NDArray[Any], spans: Any, out: NDArray[Any]
) -> None:
    """Attitudes ``out[:, 1:]`` from ``out[:, 0]`` of an iteration's rest, the end of logs."""
    count = out.shape[1] - 1
    samples, apart, places = ends.rest(data, spans, count, window, increments)
    turns = np.empty((len(out), window.span + 1, 4), dtype=out.dtype)
    Run(window, increments, samples, apart, turns).carry(beginning(NO_TURN, len(out), out.dtype))
    out[:, 1:] = quat_multiply(out[:, :1], turns[:, places])


def beginning(unit: NDArray[Any], n_logs: int, precision: np.dtype[Any]) -> NDArray[Any]:
    """What logs are carried from: p, unit quaternions (4,) or (N, 4), and no turn, r."""
    q = np.repeat(_AT_REST[precision], n_logs, axis=0) if n_logs > 1 else _AT_REST[precision].copy()
    if unit is not NO_TURN:
        q[:, :4] = unit
    return q


class _Program:
    """A method's windows for a kind of samples, and the loops over them.

    ``uneven`` intervals stand in rows, equal ones are one number.
    """

    def __init__(
        self, window: Window, increments: bool, precision: np.dtype[Any], uneven: bool
    ) -> None:
        kind = self.kind = kind_of(precision)
        self.loops = _loops(kind)
        self._given, self._uneven = (window, increments), uneven
        # an iteration has one form for all angles
        near = 0.0 if window.iteration else window.near
        self._job = Job(
            history=window.history, span=window.span, extra=not increments,
            by_interval=uneven and not increments, near=near, factor=float(increments),
        )  # fmt: skip
        self._whole = window.samples(increments)
        self._ends: dict[tuple[int, int], Job] = {}
        self._loop = partial(WindowsLoop, window, increments, kind, uneven)
        self._made: list[machine.Compiled] = []
        #: addresses of the windows' loop for turns of at most π and for any; 0 of none
        self.short = self._compiled(wide=False) if near else 0
        self.wide = 0 if near else self._compiled(wide=True)

    def any_angle(self) -> None:
        """Make the form for turns of any angle, if it is not there."""
        with _MAKING:
            self.wide = self.wide or self._compiled(wide=True)

    def _compiled(self, *, wide: bool) -> int:
        self._made.append(machine.compiled(text_of(self._loop(wide=wide).module)))
        return self._made[-1].address("windows")

    def ends(self, spans: Any, n: int, missing: int) -> Job:
        """A job with the tables of samples beyond the ends of logs of n, ``missing`` after them."""
        key = n if n < self._whole else self._whole, missing
        found = self._ends.get(key)
        if found is None:
            window, increments = self._given
            head = np.ascontiguousarray(ends.before(spans, n, window, increments))
            # where none is missing, what is past a window's end may be anything: the last once more
            tail = np.ones((1, 1))
            if missing:
                tail = np.ascontiguousarray(ends.after(spans, n, missing, window, increments))
            found = Job.from_buffer_copy(self._job)
            found.tables = head, tail  # which the job has the addresses of
            found.head, found.n_head = address_of(head), head.shape[1]
            found.tail, (found.n_after, found.n_tail) = address_of(tail), tail.shape
            if not self._uneven:
                self._ends[key] = found
        return found


_program = functools.cache(_Program)


def _scratch(kind: str) -> int:
    """Address of scratch memory, one for each thread."""
    found: tuple[int, NDArray[Any]] | None = getattr(_SCRATCH, kind, None)
    if found is None:
        memory = np.zeros(scratch_size(kind) + 64, dtype=np.uint8)
        at = address_of(memory)
        found = at + -at % 64, memory
        setattr(_SCRATCH, kind, found)
    return found[0]


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
