"""The loop over rows of arrays, and over samples of each row, compiled by Numba.

A block of rows is gathered into lanes, a formula works on them (``fastatt.codegen.lanes``), and its
results are scattered. A last block is filled with copies of the last row, so that every row meets
the same instructions whatever the number of rows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

from fastatt._jit import address_loop
from fastatt.codegen.call import call_generated, reals, wholes

#: the table of ``run_rows``: address of the function and of its resources, rows in all, the length
#: of the last leading axis, samples, the first row of lanes with results, how many inputs and
#: outputs. Address, strides along both leading axes and from sample to sample, and width of each
#: input follow, address and width of each output
ENTRY, WHOLE, TOTAL, INNER, SAMPLES, RESULTS, N_INPUTS, N_OUTPUTS, ARRAYS = range(9)


def _run_rows(kind: str, block: int) -> Callable[..., int]:
    def run_rows(numbers: int, memory: int, places: int, first: int, last: int) -> int:
        """Rows [first, last) of the arrays in the table, all by their addresses.

        ``memory`` is the address of the formula's rows, and ``places`` that of 3 blocks of numbers.
        Of each sample after the first those inputs are read that have a stride from one to the
        next.
        """
        table = wholes(numbers)
        total, inner = table[TOTAL], table[INNER]
        rows, whole, place = reals(memory, kind), wholes(table[WHOLE]), wholes(places)
        for base in range(first, last, block):
            count = min(block, last - base)
            s, b = base // inner, base % inner
            # usually the rows of a block are successive along the last axis
            follow = b + block <= inner
            for j in range(0 if follow else block):
                place[block + j], place[2 * block + j] = s, b
                if base + j + 1 < total:
                    b += 1
                    if b == inner:
                        s, b = s + 1, 0
            for sample in range(table[SAMPLES]):
                at, to = ARRAYS, 0
                for _ in range(table[N_INPUTS]):
                    source, outer, step = reals(table[at], kind), table[at + 1], table[at + 2]
                    later, width = table[at + 3], table[at + 4]
                    at += 5
                    if sample > 0 and later == 0:
                        to += width * block
                        continue
                    shift = sample * later
                    first_of = s * outer + b * step + shift
                    for j in range(0 if follow else block):
                        row = place[block + j] * outer + place[2 * block + j] * step
                        place[j] = row + shift
                    for i in range(width):
                        if follow:
                            for j in range(block):
                                rows[to + j] = source[first_of + j * step + i]
                        else:
                            for j in range(block):
                                rows[to + j] = source[place[j] + i]
                        to += block
                call_generated(table[ENTRY], 0, (rows, whole), (count,))
            to = table[RESULTS] * block
            for _ in range(table[N_OUTPUTS]):
                target, width = reals(table[at], kind), table[at + 1]
                for i in range(width):
                    for j in range(count):
                        target[(base + j) * width + i] = rows[to + j]
                    to += block
                at += 2
        return last

    return run_rows


@functools.cache
def row_loop(kind: str, block: int) -> Callable[..., int]:
    """``run_rows(numbers, memory, places, first, last)`` for a precision and lanes in a block."""
    return address_loop(_run_rows(kind, block))
