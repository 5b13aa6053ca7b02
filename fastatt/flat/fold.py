"""A formula over the samples of logs, each sample's result the next one's state: a lane a log."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.flat import machine
from fastatt.flat.code import REALS, Code
from fastatt.flat.llvm import Emitter
from fastatt.flat.rows import (
    Program,
    address_of,
    columns,
    copy,
    in_pieces,
    lanes_of,
    without_compiler,
)
from fastatt.flat.traced import plain

Array = NDArray[np.float64]


class Fold(Program):
    """``step(state, *sample, *given)`` over the samples of many logs, compiled at the first call.

    Parameters
    ----------
    step : gives the next state from tuples of recorded numbers: the state, what is sampled, what is
        given for a whole log. All is of double precision.
    size : numbers of the state.
    sampled, given : how many numbers of each, by name.

    A vector's lane is a log; a last block is filled up with the last log, so that what comes out
    depends neither on the number of logs nor on that of threads.
    """

    def __init__(
        self,
        step: Callable[..., Any],
        size: int,
        sampled: Mapping[str, int],
        given: Mapping[str, int],
    ) -> None:
        super().__init__(step, {"state": size, **sampled, **given}, (size,))
        self.size, self._widths = size, (list(sampled.values()), list(given.values()))

    def __call__(
        self,
        start: Array,
        sampled: Sequence[NDArray[Any]],
        given: Sequence[NDArray[Any]],
        n_threads: int = 1,
    ) -> Array:
        """The states (N, size) of N logs after their samples, from those before.

        ``sampled`` are (N, n, k) or (1, n, k), ``given`` (N, k) or (1, k), float64.
        """
        n_logs, n = len(start), max(x.shape[1] for x in sampled)
        samples = [np.broadcast_to(x, (n_logs, n, x.shape[2])) for x in map(_rows, sampled)]
        wide = [np.broadcast_to(x, (n_logs, x.shape[1])) for x in map(_rows, given)]
        state = np.array(start, dtype=np.float64, order="C")
        if without_compiler():
            run, fixed = plain(self.traced, {}), [column for x in wide for column in x.T]
            for i in range(n):
                now = [column for x in samples for column in x[:, i].T]
                state = np.stack(np.broadcast_arrays(*run([*state.T, *now, *fixed])), axis=1)
            return state
        table = [n, address_of(state)]
        for x in samples:
            table += [address_of(x), x.strides[0] // x.itemsize, x.strides[1] // x.itemsize]
        for x in wide:
            table += [address_of(x), x.strides[0] // x.itemsize]
        places = (ctypes.c_int64 * len(table))(*table)
        with self._lock:
            run_logs = self._compiled
        in_pieces(n_logs, n_threads, lambda a, b: run_logs(places, a, b), lanes_of(self.kind))
        return state

    def _code(self, lanes: int) -> Code:
        """``rows(table, first, last)``: logs [first, last) of the arrays that a table describes.

        The table holds the number of samples, the address of the states, address and strides from
        log to log and from sample to sample of what is sampled, address and stride of what is
        given.
        """
        code, (first, last), entries = self._begun()
        real, size = REALS[self.kind], self.size
        n, states = entries.number(), entries.pointer(real)
        sampled, given = self._widths
        moving = [(entries.pointer(real), entries.number(), entries.number(), k) for k in sampled]
        fixed = [(entries.pointer(real), entries.number(), k) for k in given]
        count = size + sum(sampled) + sum(given)
        at = {("x", k): k * lanes for k in range(count)}
        memory = code.room(real, lanes * count)
        emit = Emitter(code, lanes, machine.processor().fuses)
        with code.loop(first, last, lanes) as base:
            width = (last - base).at_most(lanes)
            with code.loop(0, lanes) as j:
                log = base + j.at_most(width - 1)
                copy(code, size, states, log * size, 1, memory, j, lanes)
                to = (size + sum(sampled)) * lanes
                for pointer, stride, k in fixed:
                    copy(code, k, pointer, log * stride, 1, memory, j + to, lanes)
                    to += k * lanes
            with code.loop(0, n) as i:
                with code.loop(0, lanes) as j:
                    log, to = base + j.at_most(width - 1), size * lanes
                    for pointer, outer, inner, k in moving:
                        source = log * outer + i * inner
                        copy(code, k, pointer, source, 1, memory, j + to, lanes)
                        to += k * lanes
                made = emit.wide(self.traced.flat, columns(code, memory, at, lanes))
                for k, value in enumerate(made):
                    code.store_vector(memory, k * lanes, value)
            with code.loop(0, width) as j:
                copy(code, size, memory, j, lanes, states, (base + j) * size, 1)
        code.give(0)
        return code


def _rows(x: NDArray[Any]) -> Array:
    """With the numbers of a row side by side."""
    return np.ascontiguousarray(x, dtype=np.float64)
