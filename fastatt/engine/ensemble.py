"""An ensemble's run: the program of its job, the arrays it works on, and what calls it."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from numba import config
from numpy.typing import NDArray

from fastatt.engine.job import Job
from fastatt.engine.layout import ARRAYS, INTS, NUMBERS
from fastatt.engine.own_steps import OwnWriter
from fastatt.engine.plain import PlainProgram
from fastatt.engine.tiles import Writer
from fastatt.flat.machine import compiled
from fastatt.flat.rows import address_of


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
        self.tiles = self._code.function("tiles", number, number, address, address, address)
        self._careful: Any = None

    def careful(self) -> int:
        """Address of a block's careful form, compiled now if it was not."""
        with self._lock:
            if self._careful is None:
                self._careful = compiled(Writer(self._job, self.formulas).careful())
        return int(self._careful.address("careful"))

    @property
    def careful_if_there(self) -> int:
        """The same, 0 if it was not asked for yet."""
        return 0 if self._careful is None else int(self._careful.address("careful"))


@lru_cache(maxsize=256)
def program(job: Job) -> Program:
    """The program of a job, made once a process."""
    return Program(job)


@lru_cache(maxsize=256)
def plain_program(job: Job) -> PlainProgram:
    """The same, without machine code."""
    return PlainProgram(job)


def prepare(job: Job) -> Program | PlainProgram:
    """What runs a job, compiled if it was not."""
    return plain_program(job) if config.DISABLE_JIT else program(job)


class Run:
    """One run of a job: the arrays and numbers that its program works on.

    ``told`` is, after a call, the largest turn of a step, rad, and whether any body has a flag.
    """

    def __init__(self, made: Any, resources: Mapping[Any, Any]) -> None:
        self._resources = resources
        self._plain = None if isinstance(made, Program) else made
        #: whether it runs without this machine code, on arrays that it must be given (``put``)
        self.is_plain = self._plain is not None
        self._program = made if isinstance(made, Program) else None
        formulas = made.formulas
        self.is_timed = formulas.is_timed
        self.ints = (ctypes.c_int64 * len(INTS))()
        self.numbers = (ctypes.c_double * len(NUMBERS))()
        self.addresses = (ctypes.c_int64 * (len(ARRAYS) + len(formulas.resources)))()
        self._arrays: dict[str, NDArray[Any]] = {}
        self._given = [resources[name] for name in formulas.resources]
        for i, x in enumerate(self._given):
            self.addresses[len(ARRAYS) + i] = x if isinstance(x, int) else address_of(x)
        self.told = (ctypes.c_double * 2)()
        self.addresses[_TOLD] = ctypes.addressof(self.told)
        given = (self.ints, self.numbers, self.addresses)
        self._where = tuple(ctypes.addressof(x) for x in given)
        self._lock = threading.Lock()

    def put(self, **arrays: NDArray[Any]) -> None:
        """Where arrays lie, whose rows follow each other: who calls keeps them alive."""
        for name, array in arrays.items():
            self.addresses[_ARRAYS[name]] = address_of(array)
        if self._plain is not None:
            self._arrays.update(arrays)

    def lend(self, x: NDArray[Any], watch: NDArray[Any]) -> None:
        """Other memory for states and what is watched."""
        self.addresses[_X], self.addresses[_WATCH] = address_of(x), address_of(watch)
        if self.is_plain:
            self._arrays.update(x=x, watch=watch)

    def load(self, given: Any, memory: Any, offsets: tuple[int, int, int], t0: float) -> None:
        """Initial states (q, y, rows of q, rows of y), where results go, and when it begins.

        What is handed out begins in ``memory``, departures and flags at the first two ``offsets``.
        """
        q, y, rows_q, rows_y = given[:4]
        a, ints = self.addresses, self.ints
        a[_OUT] = at = _at(_byte(memory))
        a[_DEFECT], a[_STATUS] = at + offsets[0], at + offsets[1]
        try:
            a[_Q0], a[_Y0] = _at(_byte(q)), _at(_byte(y))
        except (TypeError, ValueError, BufferError):  # read-only or empty
            a[_Q0], a[_Y0] = address_of(q), address_of(y)
        ints[_ROWS_Q], ints[_ROWS_Y] = rows_q, rows_y
        self.numbers[_T0] = t0

    def count(self, **values: int) -> None:
        """Whole numbers of the program."""
        for name, value in values.items():
            self.ints[_INTS[name]] = value

    def name(self, **values: float) -> None:
        """Numbers of the program."""
        for name, value in values.items():
            self.numbers[_NUMBERS[name]] = value

    def __call__(self, tiles: int) -> None:
        """Steps of the span that the numbers tell on all tiles, in the caller's thread."""
        self.told[0] = self.told[1] = 0.0
        if self._program is None:
            self._slowly(self._span, 0, tiles)
            return
        first = self._program.tiles(0, tiles, *self._where)
        while first < tiles:
            self.addresses[_CAREFUL] = self._program.careful()
            first = self._program.tiles(first, tiles, *self._where)

    @property
    def _span(self) -> Span:
        return Span(*(self.ints[_INTS[name]] for name in Span.__dataclass_fields__))

    def part(self, span: Span, first: int, last: int) -> None:
        """Steps of a span on the tiles [first, last); several threads may call it at a time."""
        if self._program is None:
            self._slowly(span, first, last)
            return
        ints = type(self.ints).from_buffer_copy(self.ints)
        for name, value in span.__dict__.items():
            ints[_INTS[name]] = value
        addresses = type(self.addresses).from_buffer_copy(self.addresses)
        told = (ctypes.c_double * 2)()
        addresses[_TOLD] = ctypes.addressof(told)
        addresses[_CAREFUL] = self._program.careful_if_there
        where = [ctypes.addressof(x) for x in (ints, self.numbers, addresses)]
        while first < last:
            first = self._program.tiles(first, last, *where)
            if first < last:
                addresses[_CAREFUL] = self._program.careful()
        with self._lock:
            self.told[:] = list(map(max, self.told, told))

    def _slowly(self, span: Span, first: int, last: int) -> None:
        assert self._plain is not None
        numbers = dict(zip(NUMBERS, self.numbers, strict=True))
        told = self._plain.run(self._arrays, numbers, span, (first, last), self._resources)
        with self._lock:
            self.told[:] = list(map(max, self.told, told))


_at, _byte = ctypes.addressof, ctypes.c_char.from_buffer
_INTS, _NUMBERS, _ARRAYS = (
    {name: i for i, name in enumerate(names)} for names in (INTS, NUMBERS, ARRAYS)
)
_TOLD, _CAREFUL, _Q0, _Y0, _X, _WATCH, _OUT, _DEFECT, _STATUS = (
    _ARRAYS[name]
    for name in ("told", "careful", "q0", "y0", "x", "watch", "out", "defect", "status")
)
_ROWS_Q, _ROWS_Y = (_INTS[name] for name in ("rows_q", "rows_y"))
_T0 = _NUMBERS["t0"]
