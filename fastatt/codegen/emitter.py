"""The operations of a graph in LLVM's language, on single numbers or on vectors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from llvmlite import ir

from fastatt.codegen.instructions import BIT, I32, I64, REALS, Code, alike
from fastatt.codegen.processor import processor
from fastatt.tracing.finished import Flat
from fastatt.tracing.nodes import Node, operands
from fastatt.tracing.operations import OPERATIONS

Given = Callable[[tuple[Any, ...], str], tuple[Any, bool]]


class Emitter:
    """Writes the operations of a graph.

    ``given(name, precision)`` returns the value of an input and whether it has lanes, one for each
    body; directions of dual numbers have lanes, too. Values that depend on inputs without lanes
    only are computed once. ``resources`` has the pointers of tables and of functions that are not
    traced.
    """

    def __init__(self, code: Code, lanes: int, resources: Mapping[Any, Any]) -> None:
        self.code, self.lanes, self.resources = code, lanes, resources
        self.fuses = processor().fuses
        self._spreads: dict[int, Any] = {}

    def __call__(self, flat: Flat, given: Given) -> list[tuple[Any, bool]]:
        """(value, whether it has lanes) of each result."""
        self._spreads.clear()
        values: list[tuple[Any, bool]] = []
        for node in flat.nodes:
            values.append(self._node(node, values, given))
        return [values[i] for i in flat.results]

    def _spread(self, value: Any, has_lanes: bool) -> Any:
        """A value as a vector, made once in a graph."""
        if has_lanes:
            return value
        if id(value) not in self._spreads:
            self._spreads[id(value)] = self.code.splat(value, self.lanes)
        return self._spreads[id(value)]

    def _node(self, node: Node, values: list[tuple[Any, bool]], given: Given) -> tuple[Any, bool]:
        op, precision = node.op, node.precision
        if op == "const":
            return ir.Constant(REALS[precision], node.args[0]), False
        if op == "in":
            is_direction = node.args[0] == "direction"
            return (self._direction if is_direction else given)(node.args, precision)
        if op == "opaque":
            return self._called(node, values)
        if op in ("item", "element"):
            numbers, has_lanes = values[node.args[0]]
            return numbers[node.args[1]], has_lanes
        if op == "lane":
            k, vector = node.args
            value, has_lanes = values[vector]
            return self.code.lane(value, k) if has_lanes else value, False
        if op == "row":
            return self._row(*node.args[:2], *values[node.args[2]])
        args, has_lanes = self._taken(operands(node), values)
        return self._operation(op, precision, args, has_lanes), has_lanes

    def _taken(self, at: Sequence[int], values: list[tuple[Any, bool]]) -> tuple[list[Any], bool]:
        """Operands, all as vectors if one of them has lanes."""
        taken = [values[i] for i in at]
        has_lanes = any(wide for _, wide in taken)
        return [self._spread(*x) if has_lanes else x[0] for x in taken], has_lanes

    def _direction(self, name: tuple[Any, ...], precision: str) -> tuple[Any, bool]:
        """The input ("direction", k): 1 in lane k, 0 in others."""
        units = [float(i == name[1]) for i in range(self.lanes)]
        if self.lanes == 1:
            return ir.Constant(REALS[precision], 1.0), False
        return ir.Constant(ir.VectorType(REALS[precision], self.lanes), units), True

    def _operation(self, op: str, precision: str, args: list[Any], has_lanes: bool) -> Any:
        code, of = self.code, args[0].type
        if op == "cast":
            return code.cast(precision, args[0])
        if op in ("fma", "fms", "fnma"):
            return self._fused(op, *args)
        if op in _WRITTEN:
            return _WRITTEN[op](code, *args)
        name = OPERATIONS[op].llvm
        if name.startswith("llvm."):
            return code.call(code.intrinsic(name, of), args)
        if name.startswith("@"):
            return self._by_lane(partial(self._library, name[1:]), args, has_lanes)[0]
        # of truths, to be different is the exclusive or
        return code.of("xor" if of == alike(of, BIT) and " " in name else name, *args)

    def _fused(self, op: str, x: Any, y: Any, z: Any) -> Any:
        code = self.code
        if not self.fuses:
            product = code.of("fmul", x, y)
            terms = (z, product) if op == "fnma" else (product, z)
            return code.of("fadd" if op == "fma" else "fsub", *terms)
        x = code.of("fneg", x) if op == "fnma" else x
        z = code.of("fneg", z) if op == "fms" else z
        return code.call(code.intrinsic("llvm.fma", z.type, 3), [x, y, z])

    def _by_lane(
        self, function: Callable[..., list[Any]], args: Sequence[Any], has_lanes: bool
    ) -> list[Any]:
        """The results of a function of single numbers, lane by lane."""
        if not has_lanes:
            return function(*args)
        lanes = range(self.lanes)
        each = [function(*(self.code.lane(x, k) for x in args)) for k in lanes]
        return [self.code.vector_of(numbers) for numbers in zip(*each, strict=True)]

    def _library(self, op: str, x: Any) -> list[Any]:
        """A function of the C library, in double precision."""
        code, double = self.code, REALS["double"]
        function = code.declared(op, double, [double])
        result = code.b.call(function, [code.cast("double", x)])
        return [code.cast("double" if x.type == double else "single", result)]

    def _row(self, key: Any, count: int, index: Any, has_lanes: bool) -> tuple[list[Any], bool]:
        """Successive numbers of a table, which does not change, from an index on."""
        table, code = self.resources["table", key], self.code
        if not has_lanes:
            begin = code.place(table, code.b.fptosi(index, I64))
            return [code.constant_load(begin, k) for k in range(count)], has_lanes
        first = code.b.fptosi(index, ir.VectorType(I32, self.lanes))
        each = (code.b.zext(code.lane(first, k), I64) for k in range(self.lanes))
        begins = [code.place(table, x) for x in each]
        numbers: list[Any] = []
        while len(numbers) < count:
            # as many at a time as there are in a vector, which is faster than one by one
            rest = count - len(numbers)
            n = min(processor().lanes("double"), 1 << (rest.bit_length() - 1))
            numbers += code.columns([code.constant_load(x, len(numbers), n) for x in begins], n)
        return numbers, True

    def _called(self, node: Node, values: list[tuple[Any, bool]]) -> tuple[list[Any], bool]:
        """A function ``f(double* arguments, double* results)`` that is not traced."""
        function, n_results, *numbers = node.args
        code, double = self.code, REALS["double"]
        arguments = code.room(double, max(1, len(numbers)))
        results = code.room(double, n_results)

        def call(*numbers: Any) -> list[Any]:
            for i, value in enumerate(numbers):
                code.store(arguments, i, value)
            code.b.call(self.resources["function", function], [arguments, results])
            return [code.load(results, i) for i in range(n_results)]

        args, has_lanes = self._taken(numbers, values)
        return self._by_lane(call, args, has_lanes), has_lanes


class _Format(NamedTuple):
    """How numbers lie in memory: integers of their size, bits of the fraction, exponent of 1."""

    bits: Any
    sign: int
    places: int
    bias: int


def _format(ty: Any) -> _Format:
    if ty == alike(ty, REALS["double"]):
        return _Format(alike(ty, I64), 63, 52, 1023)
    return _Format(alike(ty, I32), 31, 23, 127)


def larger(code: Code, x: Any, y: Any) -> Any:
    """The larger of two numbers that are not negative, or NaN, compared as integers."""
    bits, sign, *_ = _format(x.type)
    b = code.b
    # a NaN may have its sign bit set, such as the result of inf − inf
    size = _equal(bits, 2**sign - 1)
    a, c = (b.and_(b.bitcast(each, bits), size) for each in (x, y))
    return b.bitcast(b.select(b.icmp_signed(">", a, c), a, c), x.type)


def raised(code: Code, most: Any, x: Any) -> Any:
    """The larger of a number and one that may be NaN, which is ignored."""
    return code.select(code.of("fcmp ogt", x, most), x, most)


def _power_of_two(code: Code, n: Any) -> Any:
    """2ⁿ for whole n: the last bits of 1.5·2⁵² + n become the exponent."""
    bits, _, places, bias = _format(n.type)
    b = code.b
    ends = b.bitcast(code.of("fadd", n, _equal(n.type, 1.5 * 2.0**places + bias)), bits)
    return b.bitcast(b.shl(ends, _equal(bits, places)), n.type)


def _exponent(code: Code, x: Any) -> Any:
    """The exponent of x > 0, in the last bits of 2⁵²."""
    bits, _, places, bias = _format(x.type)
    b, unit = code.b, 2.0**places
    ends = b.lshr(b.bitcast(x, bits), _equal(bits, places))
    put = b.or_(ends, b.bitcast(_equal(x.type, unit), bits))
    return code.of("fsub", b.bitcast(put, x.type), _equal(x.type, unit + bias))


def _equal(ty: Any, value: Any) -> Any:
    """A constant of a type, equal in each lane."""
    vector = isinstance(ty, ir.VectorType)
    return ir.Constant(ty, [value] * ty.count if vector else value)


#: operations of several instructions, or of another form
_WRITTEN: dict[str, Callable[..., Any]] = {
    "select": lambda code, *args: code.select(*args),
    "not": lambda code, x: code.b.not_(x),
    "larger": larger,
    "power_of_two": _power_of_two,
    "exponent": _exponent,
}


_DOUBLES = REALS["double"].as_pointer()
#: types of a formula's resources in memory: tables, and functions that are not traced
POINTERS = {
    "table": _DOUBLES,
    "function": ir.FunctionType(ir.VoidType(), [_DOUBLES, _DOUBLES]).as_pointer(),
}


def pointers_of(code: Code, whole: Any, resources: Sequence[tuple[str, Any]]) -> dict[Any, Any]:
    """Pointers of tables and functions, whose addresses an array holds."""
    return {
        key: code.b.inttoptr(code.constant_load(whole, i), POINTERS[key[0]])
        for i, key in enumerate(resources)
    }
