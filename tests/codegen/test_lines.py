"""The lines around formulas: what LLVM makes of them is what Python does."""

from __future__ import annotations

import ast
import ctypes

import numpy as np
import pytest
from llvmlite import ir
from numba import types

from fastatt.codegen.instructions import Code
from fastatt.codegen.lines import write_lines
from fastatt.codegen.modules import generated

TEXT = """def run(part, x, whole):
    if part == 0:
        for i in range(whole[0]):
            for j in range(1, 7, 2): add(x, 10 * i + j - 1)
    if part == 1:
        even = True
        for k in range(3):
            even = even and x[k] == x[0]
        if even: add(x, 40)
        else: add(x, 41)
    if part != 0:
        moves, left = True, 4
        while moves and left > 0:
            add(x, left + 42)
            moves, left = False, left - 1
            for k in range(50, 53):
                moves = moves or x[k] > 2.5 or x[k] < 0.0
"""


@pytest.fixture(scope="module")
def compiled():
    arguments = types.int64, types.CPointer(types.float64), types.CPointer(types.int64)

    def add(code, args):
        x, at = args
        code.store(x, at, code.b.fadd(code.load(x, at), ir.Constant(ir.DoubleType(), 1.0)))

    def emit(code, args):
        write_lines(code, TEXT, args, {"add": lambda args: add(code, args)})

    text = "def run(a, b, c):\n    lines(a, b, c)\n"
    return generated(text, arguments, {"lines": (arguments, emit)}, f"{TEXT} test_lines").ctypes


def in_python(part, x, whole):
    def add(x, at):
        x[at] += 1.0

    scope = {"add": add}
    exec(TEXT, scope)
    scope["run"](part, x, whole)


@pytest.mark.parametrize("part", [0, 1, 2])
@pytest.mark.parametrize("numbers", [(), (1,), (50,), (51, 52), (0, 1, 2, 52)])
def test_they_do_what_python_does(compiled, part, numbers):
    x = np.zeros(60)
    x[[*numbers]] = 3.0
    wanted, whole = x.copy(), np.array([3])
    in_python(part, wanted, whole)
    double, number = (ctypes.POINTER(kind) for kind in (ctypes.c_double, ctypes.c_int64))
    compiled(part, x.ctypes.data_as(double), whole.ctypes.data_as(number))
    np.testing.assert_array_equal(x, wanted)
    assert (x != 0.0).sum() > len(numbers)


@pytest.mark.parametrize("line", ["return", "x = y[1:2]", "del x", "x = -part"])
def test_others_are_refused(line):
    code = Code(ir.IRBuilder(ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), []), "f")
                             .append_basic_block()))  # fmt: skip
    with pytest.raises(NotImplementedError) as error:
        write_lines(code, f"def run(part, y):\n    {line}\n", [ir.Constant(ir.IntType(64), 1)] * 2,
                    {})  # fmt: skip
    assert str(error.value) in ast.unparse(ast.parse(line))
