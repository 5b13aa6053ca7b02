"""The machine's peak: floating-point operations in a second with all operands in registers."""

from __future__ import annotations

import ctypes
from functools import cache
from time import perf_counter
from typing import Any

from numpy.typing import NDArray

from fastatt.codegen.lanes import LaneFormula, LaneProgram, Place, Shape
from fastatt.codegen.memory import DTYPES, address_of, aligned
from fastatt.codegen.processor import processor
from fastatt.tracing.finished import Flat
from fastatt.tracing.graph import Graph

# enough chains for two units with a latency of four or five cycles; they fit into the registers
CHAINS = 12
UNROLLED = 16
# runs of some 0.5 ms, one of which is undisturbed
_LOOPS = 10_000
_RUNS = 200
_TEXT = """def run(part, rows, whole, count):
    for i in range(count):
        formula(rows, whole, 0)
"""


@cache
def chains(kind: str) -> tuple[Any, NDArray[Any]]:
    """Chains of x = a x + b, and their memory: ``run(0, rows, whole, loops)``."""
    graph = Graph()
    a, b = graph.inputs(kind, "x", 2)
    values = list(graph.inputs(kind, "chain", CHAINS))
    for _ in range(UNROLLED):
        values = [a * x + b for x in values]
    lanes = processor().lanes(kind)
    shape, rows = Shape(kind, lanes, lanes), [Place(2 + k) for k in range(CHAINS)]
    inputs = {("x", k): Place(k) for k in range(2)}
    inputs |= {("chain", k): row for k, row in enumerate(rows)}
    formula = LaneFormula(Flat(graph, values, kind), inputs, rows)
    made = LaneProgram(_TEXT, {"formula": formula}, shape, {"rows": kind}, (), numbers=1)
    return made.compiled(), aligned((2 + CHAINS) * lanes, DTYPES[kind])


@cache
def peak(kind: str) -> float:
    """Operations a second of one core, in "double" or "single" precision; an fma counts as two.

    Measured in some 0.1 s: vectors in registers multiplied and added, the best of many short runs.
    """
    function, memory = chains(kind)
    integer, pointer = ctypes.c_int64, ctypes.c_void_p
    run = ctypes.CFUNCTYPE(None, integer, pointer, pointer, integer)(function.address)
    rows = address_of(memory)

    def timed() -> float:
        begin = perf_counter()
        run(0, rows, 0, _LOOPS)
        return perf_counter() - begin

    lanes = processor().lanes(kind)
    return 2.0 * lanes * CHAINS * UNROLLED * _LOOPS / min(timed() for _ in range(_RUNS))
