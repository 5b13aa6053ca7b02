"""A formula over the samples of logs, each sample's result the next one's state: a lane a log."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.codegen.lanes import Shape, lane_function
from fastatt.codegen.memory import address_of
from fastatt.codegen.row_loops import log_loop
from fastatt.codegen.rows import Program, in_pieces, lanes_of, without_compiler
from fastatt.tracing.traced import plain

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
            step, fixed = plain(self.traced, {}), [column for x in wide for column in x.T]
            for i in range(n):
                now = [column for x in samples for column in x[:, i].T]
                state = np.stack(np.broadcast_arrays(*step([*state.T, *now, *fixed])), axis=1)
            return state
        lanes = self._shape.lanes
        run_logs = log_loop(self.kind, lanes)
        head = self._made.address, 0, n, address_of(state), self.size
        numbers = [*head, len(samples), len(wide)]
        for x in samples:
            numbers += [address_of(x), *(k // x.itemsize for k in x.strides[:2]), x.shape[2]]
        for x in wide:
            numbers += [address_of(x), x.strides[0] // x.itemsize, x.shape[1]]
        table = array("q", numbers)

        memory = self._memory(self._shape)

        def run(first: int, last: int) -> None:
            _held, *at = memory.made()
            run_logs(table.buffer_info()[0], *at, first, last)

        in_pieces(n_logs, n_threads, run, lanes)
        return state

    @cached_property
    def _made(self) -> Any:
        return lane_function(self._shape, [self._formula(range(self.size))])

    @property
    def _shape(self) -> Shape:
        lanes = lanes_of(self.kind)
        return Shape(self.kind, lanes, lanes)


def _rows(x: NDArray[Any]) -> Array:
    """With the numbers of a row side by side."""
    return np.ascontiguousarray(x, dtype=np.float64)
