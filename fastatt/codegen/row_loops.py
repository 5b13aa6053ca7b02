"""Rows of arrays through lanes: their loads and stores, and the loop over rows and samples.

A block of rows is loaded into lanes, a formula works on them (``fastatt.codegen.lanes``), and its
results are stored. The last block is filled with copies of the last row, so that every row is
computed by the same instructions, whatever the number of rows. Arrays are (S, B, k) with any
strides: a stride of 0 says which rows, or samples, share numbers.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from fastatt._jit import loop_part, machine
from fastatt.codegen.call import TYPES, call
from fastatt.codegen.lanes import Part

#: inputs and results of ``perform_rows``, filled up with arrays of no columns
INPUTS, RESULTS = 6, 5


@loop_part
def load(source, sample, first_row, rows, to):
    """Copy rows of an array to lanes; its last row serves the lanes after it."""
    first_row = min(first_row, source.shape[1] - 1)
    count = min(rows.shape[1], source.shape[1] - first_row)
    lanes, some = rows[to : to + source.shape[2]], source[sample, first_row : first_row + count]
    for i in range(lanes.shape[0]):
        for j in range(count):
            lanes[i, j] = some[j, i]
    if count < lanes.shape[1]:
        for i in range(lanes.shape[0]):
            for j in range(count, lanes.shape[1]):
                lanes[i, j] = lanes[i, count - 1]


@loop_part
def store(rows, source, to, sample, first_row, count):
    """Copy lanes to rows of an array."""
    lanes, some = rows[source : source + to.shape[2]], to[sample, first_row : first_row + count]
    for i in range(lanes.shape[0]):
        for j in range(count):
            some[j, i] = lanes[i, j]


def perform_rows(entry, whole, rows, sources, results, held, first_result):
    """Apply a formula to the rows of all samples, one after the other.

    What is the same for the next sample, or the next rows, is not loaded again. ``whole`` is the
    address of the formula's resources. The first ``held`` rows of lanes are those on which its
    constants depend; ``first_result`` is the first row with results, 0 for a state that goes from
    sample to sample.
    """
    for b in range(0, sources[0].shape[1], rows.shape[1]):
        count = min(sources[0].shape[1] - b, rows.shape[1])
        for s in range(sources[0].shape[0]):
            to, is_other = 0, False
            for source in sources:
                if source.shape[2] == 0:
                    break
                is_sampled = source.strides[0] != 0 and source.shape[0] > 1
                is_new = is_sampled or (s == 0 and source.strides[1] != 0)
                if is_new or s == b == 0:
                    load(source, s, b, rows, to)
                    is_other = is_other or to < held
                to += source.shape[2]
            if is_other:
                call(entry, Part.CONSTANTS, (rows.ctypes.data, whole), (count,))
            call(entry, Part.EACH, (rows.ctypes.data, whole), (count,))
            row = first_result
            for result in results:
                if result.shape[2] == 0:
                    break
                store(rows, row, result, s, b, count)
                row += result.shape[2]


@functools.cache
def row_machine(precision: str) -> Callable[..., None]:
    """``perform_rows`` for a precision."""
    real, n = TYPES[precision], types.int64
    source, result = types.Array(real, 3, "A", readonly=True), types.Array(real, 3, "A")
    arrays = types.UniTuple(source, INPUTS), types.UniTuple(result, RESULTS)
    return machine(perform_rows, types.void(n, n, types.Array(real, 2, "C"), *arrays, n, n))


def filled(arrays: list[Any], n: int) -> tuple[Any, ...]:
    """The arrays with columns, then as many without as are missing to ``n``."""
    wide, shape = [x for x in arrays if x.shape[2]], (*arrays[0].shape[:2], 0)
    return *wide, *[np.empty(shape, arrays[0].dtype)] * (n - len(wide))


def joined(arrays: list[Any], n: int) -> list[Any]:
    """At most ``n`` arrays, the last of which has the columns of those that are too many."""
    if len(arrays) <= n:
        return arrays
    return [*arrays[: n - 1], np.concatenate(arrays[n - 1 :], axis=-1)]
