"""The operations of a graph in LLVM's language, on single numbers or on vectors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from llvmlite import ir

from fastatt.codegen.instructions import BIT, I32, I64, REALS, Code
from fastatt.codegen.processor import processor
from fastatt.tracing.finished import Flat
from fastatt.tracing.nodes import COMPARISONS, LIBRARY, Node, operands
from fastatt.tracing.traced import Traced

_INSTRUCTIONS = {
    "abs": "llvm.fabs",
    "sqrt": "llvm.sqrt",
    "rint": "llvm.rint",
    "floor": "llvm.floor",
}
_NAMES = {"+": "fadd", "-": "fsub", "*": "fmul", "/": "fdiv", "neg": "fneg"}
_NAMES |= {"and": "and", "or": "or"}
#: comparisons with NaN are false, except "not equal"
_ORDERS = dict(zip(COMPARISONS, ("olt", "ole", "ogt", "oge", "oeq", "une"), strict=True))

Given = Callable[[tuple[Any, ...], str], tuple[Any, bool]]


class Emitter:
    """Writes the operations of a graph.

    ``given(name, kind)`` returns the value of an input and whether it has a lane for each body.
    Values that depend on inputs without lanes only are computed once. ``resources`` has the
    pointers of tables and of functions that are not traced.
    """

    def __init__(self, code: Code, lanes: int, resources: Mapping[Any, Any]) -> None:
        self.code, self.lanes, self.resources = code, lanes, resources
        self.fuses = processor().fuses
        self._spread: dict[int, Any] = {}

    def __call__(self, flat: Flat, given: Given) -> list[tuple[Any, bool]]:
        """(value, whether it has lanes) of each result."""
        self._spread.clear()
        values: list[tuple[Any, bool]] = []
        for node in flat.nodes:
            values.append(self._node(node, values, given))
        return [values[i] for i in flat.results]

    def wide(self, flat: Flat, given: Given) -> list[Any]:
        """The results as vectors."""
        return [self.spread(*found) for found in self(flat, given)]

    def spread(self, value: Any, has_lanes: bool) -> Any:
        """A value as a vector, made once in a graph."""
        if has_lanes or self.lanes == 1:
            return value
        found = self._spread.get(id(value))
        if found is None:
            found = self._spread[id(value)] = self.code.splat(value, self.lanes)
        return found

    def _node(self, node: Node, values: list[tuple[Any, bool]], given: Given) -> tuple[Any, bool]:
        op, kind = node.op, node.kind
        if op == "const":
            return self.code.real(kind, node.args[0]), False
        if op == "in":
            return given(node.args, kind)
        if op == "opaque":
            return self._called(node, values)
        if op == "item":
            made, has_lanes = values[node.args[0]]
            return made[node.args[1]], has_lanes
        if op == "lane":
            k, at = node.args
            value, has_lanes = values[at]
            if has_lanes and self.lanes > 1:
                value = self.code.b.extract_element(value, ir.Constant(I32, k))
            return value, False
        if op == "gather":
            return self._gathered(node, values[node.args[1]])
        taken = [values[i] for i in operands(node)]
        has_lanes = any(wide for _, wide in taken)
        args = [self.spread(*x) if has_lanes else x[0] for x in taken]
        return self._operation(op, kind, args, has_lanes), has_lanes

    def _operation(self, op: str, kind: str, args: list[Any], has_lanes: bool) -> Any:
        code, of = self.code, args[0].type
        if op in _NAMES:
            return code.of(_NAMES[op], *args)
        if op in ("fma", "fms", "fnma"):
            return self._fused(op, *args)
        if op in _INSTRUCTIONS:
            return code.call(code.intrinsic(_INSTRUCTIONS[op], of), args)
        if op in LIBRARY:
            return self._library(op, args[0], has_lanes)
        if op == "select":
            return code.select(*args)
        if op in COMPARISONS:
            bits = ir.VectorType(BIT, of.count) if isinstance(of, ir.VectorType) else BIT
            if of == bits:
                return code.of("xor", *args)
            return code.of(f"fcmp {_ORDERS[op]}", *args, kind=bits)
        if op == "not":
            return code.b.not_(args[0])
        if op == "cast":
            return code.cast(kind, args[0])
        if op in _BITS:
            return _BITS[op](code, *args)
        raise NotImplementedError(op)

    def _fused(self, op: str, x: Any, y: Any, z: Any) -> Any:
        code = self.code
        if not self.fuses:
            product = code.of("fmul", x, y)
            terms = (z, product) if op == "fnma" else (product, z)
            return code.of("fadd" if op == "fma" else "fsub", *terms)
        x = code.of("fneg", x) if op == "fnma" else x
        z = code.of("fneg", z) if op == "fms" else z
        return code.call(code.intrinsic("llvm.fma", z.type, 3), [x, y, z])

    def _library(self, op: str, x: Any, has_lanes: bool) -> Any:
        """A function of the C library, lane by lane, in double precision."""
        double = REALS["double"]
        function = self.code.declared(op, double, [double])

        def one(value: Any) -> Any:
            b = self.code.b
            single = value.type == REALS["single"]
            result = b.call(function, [b.fpext(value, double) if single else value])
            return b.fptrunc(result, REALS["single"]) if single else result

        return self._by_lane(one, x, has_lanes, x.type)

    def _by_lane(self, one: Callable[[Any], Any], value: Any, has_lanes: bool, kind: Any) -> Any:
        """Apply a function of one number to a value of any type, lane by lane."""
        if not (has_lanes and self.lanes > 1):
            return one(value)
        b, result = self.code.b, ir.Constant(kind, ir.Undefined)
        for k in range(self.lanes):
            lane = ir.Constant(I32, k)
            result = b.insert_element(result, one(b.extract_element(value, lane)), lane)
        return result

    def _gathered(self, node: Node, index: tuple[Any, bool]) -> tuple[Any, bool]:
        table, code = self.resources["table", node.args[0]], self.code
        value, has_lanes = index
        if has_lanes and self.lanes > 1:
            where = code.b.fptosi(value, ir.VectorType(I32, self.lanes))
            return code.cast(node.kind, code.gather(table, where)), True
        # a table does not change: what all bodies share is read once a step
        found = code.constant_load(table, code.b.fptosi(value, I64))
        return code.cast(node.kind, found), has_lanes

    def _called(self, node: Node, values: list[tuple[Any, bool]]) -> tuple[list[Any], bool]:
        """A function ``f(double* arguments, double* results)`` that is not traced."""
        number, n_results, *at = node.args
        address = self.resources["function", number]
        b, double = self.code.b, REALS["double"]
        taken = self.code.room(double, max(1, len(at)))
        made = self.code.room(double, n_results)
        has_lanes = self.lanes > 1 and any(values[i][1] for i in at)
        args = [self.spread(*values[i]) if has_lanes else values[i][0] for i in at]
        results: list[Any] = [ir.Constant(ir.VectorType(double, self.lanes), ir.Undefined)]
        results *= n_results
        for k in range(self.lanes if has_lanes else 1):
            lane = ir.Constant(I32, k)
            for i, value in enumerate(args):
                one = b.extract_element(value, lane) if has_lanes else value
                self.code.store(taken, i, one)
            b.call(address, [taken, made])
            for i in range(n_results):
                one = self.code.load(made, i)
                results[i] = b.insert_element(results[i], one, lane) if has_lanes else one
        return results, has_lanes


def _whole(kind: Any) -> tuple[Any, float]:
    """(the integer type of a floating-point type's size, 2 to the number of its fraction bits)."""
    vector = isinstance(kind, ir.VectorType)
    double = (kind.element if vector else kind) == REALS["double"]
    bits: Any = ir.IntType(64 if double else 32)
    return ir.VectorType(bits, kind.count) if vector else bits, 2.0**52 if double else 2.0**23


def larger(code: Code, x: Any, y: Any) -> Any:
    """The larger of two numbers that are not negative, or NaN, compared as integers."""
    bits, unit = _whole(x.type)
    b = code.b
    # a NaN may have its sign bit set, such as the result of inf − inf
    size = _alike(bits, 2 ** (63 if unit == 2.0**52 else 31) - 1)
    a, c = (b.and_(b.bitcast(each, bits), size) for each in (x, y))
    return b.bitcast(b.select(b.icmp_signed(">", a, c), a, c), x.type)


def raised(code: Code, most: Any, x: Any) -> Any:
    """The larger of a number and one that may be NaN, which is ignored."""
    vector = isinstance(x.type, ir.VectorType)
    bits = ir.VectorType(BIT, x.type.count) if vector else BIT
    return code.select(code.of("fcmp ogt", x, most, kind=bits), x, most)


def _power_of_two(code: Code, n: Any) -> Any:
    """2ⁿ for whole n: the last bits of 1.5·2⁵² + n become the exponent."""
    bits, unit = _whole(n.type)
    places, bias = (52, 1023) if unit == 2.0**52 else (23, 127)
    b = code.b
    ends = b.bitcast(code.of("fadd", n, _alike(n.type, 1.5 * unit + bias)), bits)
    return b.bitcast(b.shl(ends, _alike(bits, places)), n.type)


def _exponent(code: Code, x: Any) -> Any:
    """The exponent of x > 0, in the last bits of 2⁵²."""
    bits, unit = _whole(x.type)
    places, bias = (52, 1023) if unit == 2.0**52 else (23, 127)
    b = code.b
    ends = b.lshr(b.bitcast(x, bits), _alike(bits, places))
    put = b.or_(ends, b.bitcast(_alike(x.type, unit), bits))
    return code.of("fsub", b.bitcast(put, x.type), _alike(x.type, unit + bias))


def _alike(kind: Any, value: Any) -> Any:
    """A constant of a type, equal in each lane."""
    vector = isinstance(kind, ir.VectorType)
    return ir.Constant(kind, [value] * kind.count if vector else value)


_BITS: dict[str, Callable[..., Any]] = {
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


def write(code: Code, traced: Traced, given: Any, resources: Mapping[Any, Any]) -> list[Any]:
    """The results, each with its kind, from given values.

    Directions of dual numbers have lanes.
    """
    lanes = traced.lanes
    emit = Emitter(code, lanes, resources)

    def find(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
        group, k = name
        if group != "direction":
            return code.cast(kind, given[k]), False
        if lanes == 1:
            return ir.Constant(REALS[kind], 1.0), False
        units = [float(i == k) for i in range(lanes)]
        return ir.Constant(ir.VectorType(REALS[kind], lanes), units), True

    return [value for value, _ in emit(traced.flat, find)]


def pointers_of(code: Code, whole: Any, resources: Sequence[tuple[str, Any]]) -> dict[Any, Any]:
    """Pointers of tables and functions, whose addresses an array holds."""
    return {
        key: code.b.inttoptr(code.constant_load(whole, i), POINTERS[key[0]])
        for i, key in enumerate(resources)
    }
