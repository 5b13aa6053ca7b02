"""An ensemble's run: the program of its job, the arrays it works on, and what calls it."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numba import config
from numpy.typing import NDArray

from fastatt.engine.job import Job
from fastatt.engine.layout import NUMBERS, Table
from fastatt.engine.own_steps import OwnWriter
from fastatt.engine.plain import PlainProgram
from fastatt.engine.tiles import Writer
from fastatt.flat.machine import compiled
from fastatt.flat.rows import DTYPES, address_of


@dataclass(frozen=True)
class Span:
    """What one call of the program does: steps [first, last) of a run of ``n_steps``.

    Saves are every ``save_every`` steps from ``origin`` on, with which the run began, and at the
    end, the first in slot ``slot`` of the output: 1 where slot 0 holds the initial state, else 0.
    The state is brought back to its group every ``restore`` steps, or never if that is 0.
    """

    first: int
    last: int
    n_steps: int
    save_every: int
    slot: int
    restore: int = 0
    origin: int = 0

    def part(self, first: int, last: int) -> Span:
        """Some of its steps."""
        return replace(self, first=first, last=last)


class Program:
    """The machine code of a job: the quick form at once, the careful one when a body needs it."""

    def __init__(self, job: Job) -> None:
        self.formulas = job.formulas
        self._job = job
        self._lock = threading.Lock()
        writer = OwnWriter if job.own_steps else Writer
        self._code = compiled(writer(job, self.formulas).quick())
        address = ctypes.c_void_p
        number = ctypes.c_int64
        self.tiles = self._code.function("tiles", number, number, address)
        self._careful: Any = None
        #: address of a block's careful form, 0 if it was not asked for yet
        self.careful_at = 0

    def careful(self) -> int:
        """Address of a block's careful form, compiled now if it was not."""
        with self._lock:
            if not self.careful_at:
                self._careful = compiled(Writer(self._job, self.formulas).careful())
                self.careful_at = self._careful.address("careful")
        return self.careful_at


@lru_cache(maxsize=256)
def program(job: Job, *, plain: bool) -> Program | PlainProgram:
    """The program of a job, made once a process; ``plain`` is without machine code."""
    return PlainProgram(job) if plain else Program(job)


def prepare(job: Job) -> Program | PlainProgram:
    """What runs a job, compiled if it was not."""
    return program(job, plain=bool(config.DISABLE_JIT))


class Run:
    """One run of a job for so many bodies: the arrays and numbers that its program works on.

    ``x`` (N, k) are the states and ``watch`` (3, N) what is watched of them, ``is_kept`` where
    somebody keeps both; ``told`` is, after a call, the largest turn of a step, rad, and whether any
    body has a flag.
    """

    x: NDArray[Any]
    watch: NDArray[Any]
    is_kept = False

    def __init__(self, made: Any, resources: Mapping[Any, Any], bodies: int) -> None:
        self._program, self._resources = made, resources
        #: whether it runs without this machine code, on arrays that it must be given (``put``)
        self.is_plain = not isinstance(made, Program)
        formulas = made.formulas
        self.is_timed = formulas.is_timed
        self.table = Table()
        self._arrays: dict[str, NDArray[Any]] = {}
        self._given = [resources[name] for name in formulas.resources]
        found = [x if isinstance(x, int) else address_of(x) for x in self._given]
        self._addresses = (ctypes.c_int64 * len(found))(*found)
        self.told = (ctypes.c_double * 2)()
        at = ctypes.addressof
        self.set(resources=at(self._addresses), told=at(self.told), bodies=bodies)
        self._shape, self._dtype = (bodies, formulas.size), DTYPES[formulas.job.kind]
        self.renew()
        self._where = ctypes.addressof(self.table)
        self._lock = threading.Lock()

    def renew(self) -> None:
        """Other memory for the states in the place of what is kept."""
        self.x = np.empty(self._shape, self._dtype)
        self.watch = np.empty((3, len(self.x)), self._dtype)
        self.put(x=self.x, watch=self.watch)

    def set(self, **values: float) -> None:
        """Numbers of the program."""
        for name, value in values.items():
            setattr(self.table, name, value)

    def put(self, **arrays: NDArray[Any]) -> None:
        """Where arrays lie, whose rows follow each other: who calls keeps them alive."""
        self.set(**{name: address_of(array) for name, array in arrays.items()})
        if self.is_plain:
            self._arrays.update(arrays)

    def load(self, given: Any, memory: Any, offsets: tuple[int, int, int], t0: float) -> None:
        """Initial states (q, y, rows of q, rows of y), where results go, and when it begins.

        What is handed out begins in ``memory``, departures and flags at the first two ``offsets``.
        """
        q, y, rows_q, rows_y = given[:4]
        table = self.table
        table.out = at = _at(_byte(memory))
        table.defect, table.status = at + offsets[0], at + offsets[1]
        try:
            table.q0, table.y0 = _at(_byte(q)), _at(_byte(y))
        except (TypeError, ValueError, BufferError):  # read-only or empty
            table.q0, table.y0 = address_of(q), address_of(y)
        table.rows_q, table.rows_y, table.t0 = rows_q, rows_y, t0

    def __call__(self, tiles: int) -> None:
        """Steps of the span that the numbers tell on all tiles, in the caller's thread."""
        self.told[0] = self.told[1] = 0.0
        if self.is_plain:
            self._slowly(self._span, 0, tiles)
            return
        first = self._program.tiles(0, tiles, self._where)
        while first < tiles:
            self.table.careful = self._program.careful()
            first = self._program.tiles(first, tiles, self._where)

    @property
    def _span(self) -> Span:
        return Span(*(getattr(self.table, name) for name in Span.__dataclass_fields__))

    def part(self, span: Span, first: int, last: int) -> None:
        """Steps of a span on the tiles [first, last); several threads may call it at a time."""
        if self.is_plain:
            self._slowly(span, first, last)
            return
        table, told = Table.from_buffer_copy(self.table), (ctypes.c_double * 2)()
        for name, value in span.__dict__.items():
            setattr(table, name, value)
        table.told, table.careful = ctypes.addressof(told), self._program.careful_at
        while first < last:
            first = self._program.tiles(first, last, ctypes.addressof(table))
            if first < last:
                table.careful = self._program.careful()
        with self._lock:
            self.told[:] = list(map(max, self.told, told))

    def _slowly(self, span: Span, first: int, last: int) -> None:
        numbers = {name: getattr(self.table, name) for name in NUMBERS}
        told = self._program.run(self._arrays, numbers, span, (first, last), self._resources)
        with self._lock:
            self.told[:] = list(map(max, self.told, told))


_at, _byte = ctypes.addressof, ctypes.c_char.from_buffer
