"""The loops over rows of arrays and over the samples of logs, compiled by Numba.

A block of rows is gathered into lanes, a formula works on them (``fastatt.codegen.lanes``), and its
results are scattered. A last block is filled up with the last row, so that every row meets the same
instructions whatever their number.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

from numba import types

from fastatt._jit import address_loop
from fastatt.codegen.call import call_generated, reals, wholes

#: the table of ``run_rows``: address of the function and of its resources, rows in all, the length
#: of the last leading axis, how many inputs and outputs. Address, strides along both leading axes
#: and width of each input follow, address and width of each output
ENTRY, WHOLE, TOTAL, INNER, N_INPUTS, N_OUTPUTS, ARRAYS = range(7)
#: the table of ``run_logs``: the same two addresses, samples, address and size of the states, how
#: many arrays are sampled and how many are given for a whole log. Address, strides from log to log
#: and from sample to sample and width of the first follow, address, stride and width of the others
N_SAMPLES, STATES, SIZE, N_SAMPLED, N_GIVEN, LOGS = range(2, 8)


def _run_rows(kind: str, block: int) -> Callable[..., int]:
    def run_rows(numbers: int, memory: int, places: int, first: int, last: int) -> int:
        """Rows [first, last) of the arrays in the table, all by their addresses.

        ``memory`` is the address of the formula's rows, and ``places`` that of 3 blocks of numbers.
        """
        table = wholes(numbers)
        total, inner = table[TOTAL], table[INNER]
        rows, whole, place = reals(memory, kind), wholes(table[WHOLE]), wholes(places)
        for base in range(first, last, block):
            count = min(block, last - base)
            s, b = base // inner, base % inner
            # usually a block's rows follow each other along the last axis
            follow = b + block <= inner
            for j in range(0 if follow else block):
                place[block + j], place[2 * block + j] = s, b
                if base + j + 1 < total:
                    b += 1
                    if b == inner:
                        s, b = s + 1, 0
            at, to = ARRAYS, 0
            for _ in range(table[N_INPUTS]):
                source, outer, step = reals(table[at], kind), table[at + 1], table[at + 2]
                first_of = s * outer + b * step
                for j in range(0 if follow else block):
                    place[j] = place[block + j] * outer + place[2 * block + j] * step
                for i in range(table[at + 3]):
                    if follow:
                        for j in range(block):
                            rows[to + j] = source[first_of + j * step + i]
                    else:
                        for j in range(block):
                            rows[to + j] = source[place[j] + i]
                    to += block
                at += 4
            call_generated(table[ENTRY], 0, (rows, whole), (count,))
            for _ in range(table[N_OUTPUTS]):
                target, width = reals(table[at], kind), table[at + 1]
                for i in range(width):
                    for j in range(count):
                        target[(base + j) * width + i] = rows[to + j]
                    to += block
                at += 2
        return last

    return run_rows


def _run_logs(kind: str, lanes: int) -> Callable[..., int]:
    def run_logs(numbers: int, memory: int, places: int, first: int, last: int) -> int:
        """Logs [first, last): each block's states through all samples, a formula each sample."""
        table = wholes(numbers)
        size = table[SIZE]
        rows, whole, log = reals(memory, kind), wholes(table[WHOLE]), wholes(places)
        states = reals(table[STATES], kind)
        for base in range(first, last, lanes):
            count = min(lanes, last - base)
            for j in range(lanes):
                log[j] = base + min(j, count - 1)
            for i in range(size):
                for j in range(lanes):
                    rows[i * lanes + j] = states[log[j] * size + i]
            at = LOGS
            moving = size * lanes
            to = moving
            for _ in range(table[N_SAMPLED]):
                to += table[at + 3] * lanes
                at += 4
            for _ in range(table[N_GIVEN]):
                source, stride = reals(table[at], kind), table[at + 1]
                for i in range(table[at + 2]):
                    for j in range(lanes):
                        rows[to + j] = source[log[j] * stride + i]
                    to += lanes
                at += 3
            for n in range(table[N_SAMPLES]):
                at, to = LOGS, moving
                for _ in range(table[N_SAMPLED]):
                    source, outer = reals(table[at], kind), table[at + 1]
                    inner = n * table[at + 2]
                    for i in range(table[at + 3]):
                        for j in range(lanes):
                            rows[to + j] = source[log[j] * outer + inner + i]
                        to += lanes
                    at += 4
                call_generated(table[ENTRY], 0, (rows, whole), (lanes,))
            for i in range(size):
                for j in range(count):
                    states[(base + j) * size + i] = rows[i * lanes + j]
        return last

    return run_logs


_SIGNATURE = types.int64(*[types.int64] * 5)


@functools.cache
def row_loop(kind: str, block: int) -> Callable[..., int]:
    """``run_rows(numbers, memory, places, first, last)`` for a precision and lanes in a block."""
    return address_loop(_SIGNATURE, _run_rows(kind, block))


@functools.cache
def log_loop(kind: str, lanes: int) -> Callable[..., int]:
    """``run_logs(numbers, memory, places, first, last)`` for a precision and lanes in a block."""
    return address_loop(_SIGNATURE, _run_logs(kind, lanes))
