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
from fastatt.engine.layout import ARRAYS, NUMBERS, packed_ints
from fastatt.engine.plain import PlainProgram
from fastatt.engine.tiles import Writer
from fastatt.flat.machine import compiled


@dataclass(frozen=True)
class Span:
    """What one call of the program does: steps [first, last) of a run of ``n_steps``.

    Saves are every ``save_every`` steps and at the end, the first in slot ``slot`` of the output:
    1 where slot 0 holds the initial state, else 0. The state is brought back to its group every
    ``restore`` steps, or never if that is 0.
    """

    first: int
    last: int
    n_steps: int
    save_every: int
    slot: int
    restore: int = 0

    def part(self, first: int, last: int) -> Span:
        """Some of its steps."""
        return replace(self, first=first, last=last)


class Program:
    """The machine code of a job: the quick form at once, the careful one when a body needs it."""

    def __init__(self, job: Job) -> None:
        self.formulas = job.formulas
        self._job = job
        self._lock = threading.Lock()
        self._code = compiled(Writer(job, self.formulas).quick())
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


class Arrays:
    """The arrays and numbers that a program works on, kept alive as long as it may run."""

    def __init__(
        self,
        job: Job,
        arrays: Mapping[str, NDArray[Any] | None],
        *,
        t0: float,
        h: float,
        resources: Mapping[Any, Any],
    ) -> None:
        self._plain = plain_program(job) if config.DISABLE_JIT else None
        self.program = program(job) if self._plain is None else None
        stages = np.array(job.method.stages, dtype=np.float64).reshape(-1, 3)
        edge = 0.5 * stages[-1, 1] * h if len(stages) else 0.0
        self._arrays = {**arrays, "stages": stages}
        formulas = (self.program or self._plain).formulas  # type: ignore[union-attr]
        given = [resources[name] for name in formulas.resources]
        self.is_timed = formulas.is_timed
        self._resources = resources
        values = [self._address(self._arrays.get(name)) for name in ARRAYS]
        values += [x if isinstance(x, int) else x.ctypes.data for x in given]
        self._addresses = np.array(values, dtype=np.int64)
        self._named = {"t0": t0, "h": h, "edge": edge}
        self._numbers = np.array([self._named[name] for name in NUMBERS])
        self.job = job
        x, p = self._arrays["x"], self._arrays["p"]
        assert x is not None
        assert p is not None
        self._ints = {
            "bodies": len(x),
            "rows_q": self._rows("q0"),
            "rows_y": self._rows("y0"),
            "rows_p": len(p),
            "stages": len(stages),
        }

    @staticmethod
    def _address(array: NDArray[Any] | None) -> int:
        if array is None:
            return 0
        if not array.flags.c_contiguous:
            raise ValueError(f"array of shape {array.shape}: rows that do not follow each other")
        return int(array.__array_interface__["data"][0])  # a tenth of the time of ctypes

    def _rows(self, name: str) -> int:
        array = self._arrays[name]
        assert array is not None
        return len(array)

    def run(self, span: Span, first: int, last: int) -> None:
        """Steps of a span on the tiles [first, last)."""
        if self._plain is not None:
            self._plain.run(self._arrays, self._named, span, (first, last), self._resources)
            return
        assert self.program is not None
        ints = packed_ints({**self._ints, **span.__dict__})
        addresses = self._addresses.copy()
        careful = ARRAYS.index("careful")
        addresses[careful] = self.program.careful_if_there
        given = (ints.ctypes.data, self._numbers.ctypes.data, addresses.ctypes.data)
        while first < last:
            first = self.program.tiles(first, last, *given)
            if first < last:
                addresses[careful] = self.program.careful()
