"""A formula over the samples of logs, each sample's result the next one's state: a lane a log."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from fastatt.flat import machine
from fastatt.flat.code import I64, REALS, Code, Int, text_of
from fastatt.flat.finished import Flat
from fastatt.flat.graph import Graph, flattened
from fastatt.flat.llvm import Emitter
from fastatt.flat.repeated import in_pieces
from fastatt.flat.rows import Table, address_of, columns, copy, lanes_of, without_compiler

Array = NDArray[np.float64]
_STATE, _DOUBLE = "state", "double"


class Fold:
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
        self._step, self.size = step, size
        self.sampled, self.given = dict(sampled), dict(given)
        self._lock = threading.Lock()

    @cached_property
    def flat(self) -> Flat:
        """The step's operations."""
        graph = Graph()
        sizes = {_STATE: self.size, **self.sampled, **self.given}
        made = flattened(self._step(*(graph.inputs(_DOUBLE, *item) for item in sizes.items())))
        if len(made) != self.size:
            raise ValueError(f"step: gives {len(made)} numbers; accepted: {self.size}")
        return Flat(graph, made, _DOUBLE)

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
        if without_compiler():
            return self._in_python(start, samples, wide)
        state = np.array(start, dtype=np.float64, order="C")
        table = [n, address_of(state)]
        for x in samples:
            table += [address_of(x), x.strides[0] // x.itemsize, x.strides[1] // x.itemsize]
        for x in wide:
            table += [address_of(x), x.strides[0] // x.itemsize]
        places = (ctypes.c_int64 * len(table))(*table)
        with self._lock:
            run = self._compiled
        in_pieces(n_logs, n_threads, lambda a, b: run(places, a, b), lanes_of(_DOUBLE))
        return state

    def _in_python(self, start: Array, samples: Sequence[Array], given: Sequence[Array]) -> Array:
        from fastatt.flat.source import function

        run, names = function(self.flat), self.flat.inputs()
        state = [start[:, k] for k in range(self.size)]
        fixed = _numbers(self.given, given)
        for i in range(samples[0].shape[1]):
            now = _numbers(self.sampled, [x[:, i] for x in samples])
            known = {(_STATE, k): x for k, x in enumerate(state)} | now | fixed
            state = [np.asarray(x) for x in run(*(known[name] for name in names))]
        return np.stack([np.broadcast_to(x, len(start)) for x in state], axis=1)

    @cached_property
    def _compiled(self) -> Any:
        program = machine.compiled(text_of(self._code(lanes_of(_DOUBLE)).module))
        return program.function("fold", ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)

    def _code(self, lanes: int) -> Code:
        """``fold(table, first, last)``: logs [first, last) of the arrays that a table describes.

        The table holds the number of samples, the address of the states, address and strides from
        log to log and from sample to sample of what is sampled, address and stride of what is
        given.
        """
        code = Code(ir.Module("fold"), "fold", [I64.as_pointer(), I64, I64])
        argument, first, last = code.function.args
        entries, real = Table(code, argument), REALS[_DOUBLE]
        n, states = entries.number(), entries.pointer(real)
        moving = [
            (entries.pointer(real), entries.number(), entries.number(), k)
            for k in self.sampled.values()
        ]
        fixed = [(entries.pointer(real), entries.number(), k) for k in self.given.values()]
        sizes = {_STATE: self.size, **self.sampled, **self.given}
        names = [(name, i) for name, k in sizes.items() for i in range(k)]
        at = {name: k * lanes for k, name in enumerate(names)}
        memory = code.room(real, lanes * len(names))
        heads = dict(zip(sizes, accumulate(sizes.values(), initial=0), strict=False))
        firsts = [heads[name] * lanes for name in self.sampled]
        constants = [heads[name] * lanes for name in self.given]
        emit = Emitter(code, lanes, machine.processor().fuses)
        with code.loop(Int(code, first), Int(code, last), lanes) as base:
            count = (Int(code, last) - base).at_most(lanes)
            with code.loop(0, lanes) as j:
                log = base + j.at_most(count - 1)
                copy(code, self.size, states, log * self.size, 1, memory, j, lanes)
                for to, (pointer, stride, k) in zip(constants, fixed, strict=True):
                    copy(code, k, pointer, log * stride, 1, memory, j + to, lanes)
            with code.loop(0, n) as i:
                with code.loop(0, lanes) as j:
                    log = base + j.at_most(count - 1)
                    for to, (pointer, outer, inner, k) in zip(firsts, moving, strict=True):
                        source = log * outer + i * inner
                        copy(code, k, pointer, source, 1, memory, j + to, lanes)
                made = emit.wide(self.flat, columns(code, memory, at, lanes))
                for k, value in enumerate(made):
                    code.store_vector(memory, k * lanes, value)
            with code.loop(0, count) as j:
                log = base + j
                copy(code, self.size, memory, j, lanes, states, log * self.size, 1)
        code.give(0)
        return code


def _rows(x: NDArray[Any]) -> Array:
    """With the numbers of a row side by side."""
    return np.ascontiguousarray(x, dtype=np.float64)


def _numbers(sizes: Mapping[str, int], arrays: Sequence[Array]) -> dict[Any, Array]:
    pairs = zip(sizes.items(), arrays, strict=True)
    return {(name, i): x[:, i] for (name, k), x in pairs for i in range(k)}
