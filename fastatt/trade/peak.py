"""The machine's peak: how many floating-point operations a second it does with all at hand."""

from __future__ import annotations

import ctypes
from functools import cache
from time import perf_counter

from llvmlite import ir

from fastatt.flat import machine
from fastatt.flat.code import I64, REALS, Code, text_of
from fastatt.flat.rows import lanes_of

# enough that no chain waits: two units of a latency of four or five cycles; they fit the registers
_CHAINS = 12
_UNROLLED = 8
# some 0.5 ms a run: among as many, one is not disturbed
_LOOPS = 20_000
_RUNS = 200


def program(kind: str) -> str:
    """Chains of x = a x + b in registers, in LLVM's language: ``peak(n, result, a, b)``."""
    module = ir.Module("peak")
    real = REALS[kind]
    code = Code(module, "peak", [I64, real.as_pointer(), real, real])
    n, result, a, b = code.function.args
    lanes = lanes_of(kind)
    wide = ir.VectorType(real, lanes)
    factor, term = code.splat(a, lanes), code.splat(b, lanes)
    fma = code.intrinsic("llvm.fma" if machine.processor().fuses else "llvm.fmuladd", wide, 3)
    b_ = code.b
    before, loop, after = b_.block, b_.append_basic_block("loop"), b_.append_basic_block("after")
    b_.branch(loop)
    b_.position_at_end(loop)
    left = b_.phi(I64)
    left.add_incoming(n, before)
    # in registers: no pass brings there what lies in memory
    chains = [b_.phi(wide) for _ in range(_CHAINS)]
    for k, x in enumerate(chains):
        x.add_incoming(code.splat(code.real(kind, float(k)), lanes), before)
    values = list(chains)
    for _ in range(_UNROLLED):
        values = [b_.call(fma, [x, factor, term]) for x in values]
    rest = b_.sub(left, ir.Constant(I64, 1))
    left.add_incoming(rest, loop)
    for x, value in zip(chains, values, strict=True):
        x.add_incoming(value, loop)
    b_.cbranch(b_.icmp_signed(">", rest, ir.Constant(I64, 0)), loop, after)
    b_.position_at_end(after)
    total = values[0]
    for x in values[1:]:
        total = b_.fadd(total, x)
    code.b.store(total, code.b.bitcast(result, wide.as_pointer()), align=4)
    code.give(0)
    return text_of(module)


@cache
def peak(kind: str) -> float:
    """Operations a second of one core, in "double" or "single" precision; an fma counts as two.

    Measured in some 0.1 s: vectors in registers multiplied and added, the best of many short runs.
    """
    lanes = lanes_of(kind)
    real = ctypes.c_double if kind == "double" else ctypes.c_float
    number = ctypes.c_int64
    run = machine.compiled(program(kind)).function("peak", number, ctypes.c_void_p, real, real)
    room = (real * lanes)()

    def timed() -> float:
        begin = perf_counter()
        run(_LOOPS, ctypes.addressof(room), 0.5, 1.0)
        return perf_counter() - begin

    return 2.0 * lanes * _CHAINS * _UNROLLED * _LOOPS / min(timed() for _ in range(_RUNS))
