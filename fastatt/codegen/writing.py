"""Traced formulas in LLVM's language, derivatives side by side; and as functions of numbers."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types

from fastatt.codegen.emitter import POINTERS, Emitter
from fastatt.codegen.instructions import I64, REALS, Cells, Code
from fastatt.codegen.modules import generated
from fastatt.codegen.processor import processor
from fastatt.tracing.finished import Flat
from fastatt.tracing.traced import Loop, Traced, Tuple, flattened_forms, plain, trace

_NUMBERS, _WHOLE = types.CPointer(types.float64), types.CPointer(types.int64)
_SCALAR = "def run(numbers, results, whole):\n    formula(numbers, results, whole)\n"


def write(code: Code, traced: Traced, given: Any, resources: Mapping[Any, Any]) -> list[Any]:
    """The results, each of its kind, of values that are given.

    The graphs of a formula follow each other, with lanes for the directions of dual numbers.
    """
    lanes = traced.lanes
    emit = Emitter(code, lanes, processor().fuses, resources)
    # the inputs, and those of a loop's step: the state as pairs with whether it has lanes
    found: dict[str, Any] = {"x": given}

    def find(name: tuple[Any, ...], kind: str) -> tuple[Any, bool]:
        group, k = name
        if group == "s":
            return found["s"][k]  # type: ignore[no-any-return]
        if group != "direction":
            return found[group][k], False
        if lanes == 1:
            return ir.Constant(REALS[kind], 1.0), False
        units = [float(i == k) for i in range(lanes)]
        return ir.Constant(ir.VectorType(REALS[kind], lanes), units), True

    loop = traced.loop
    if loop is not None:
        state = emit(loop.begin, find)
        n, size = len(loop.step.results), len(loop.table[0])
        wide = [k in loop.wide and lanes > 1 for k in range(n)]

        def alike(values: Sequence[tuple[Any, bool]]) -> list[Any]:
            """Each with lanes where it has any."""
            pairs = zip(values, wide, strict=True)
            return [emit.spread(*x) if has_lanes else x[0] for x, has_lanes in pairs]

        first, table = alike(state[:n]), _table(code, loop)
        # a vector of many directions is wider than the alignment of the stack
        cells = Cells(code, [x.type for x in first], align=8)
        cells.set(first)
        with code.loop(len(loop.table)) as i:
            found["s"] = [*zip(cells.get(), wide, strict=True), *state[n:]]
            row = code.b.mul(i, ir.Constant(I64, size))
            places = [code.b.add(row, ir.Constant(I64, k)) for k in range(size)]
            found["row"] = [code.load(table, place) for place in places]
            cells.set(alike(emit(loop.step, find)))
        found["s"] = [*zip(cells.get(), wide, strict=True), *state[n:]]
    return [value for value, _ in emit(traced.flat, find)]


def _table(code: Code, loop: Loop) -> Any:
    """Pointer to the constants of a loop, which are a part of the module."""
    kinds = (node.kind for node in loop.step.nodes if node.args[:1] == ("row",))
    kind = REALS[next(kinds, "double")]
    numbers = [x for row in loop.table for x in row]
    of = ir.ArrayType(kind, len(numbers))
    table = ir.GlobalVariable(code.module, of, code.module.get_unique_name("table"))
    table.linkage, table.global_constant = "internal", True
    table.initializer = ir.Constant(of, numbers)
    return code.b.bitcast(table, kind.as_pointer())


def spelled(formula: Flat | Traced, resources: Sequence[tuple[str, Any]]) -> str:
    """All that a formula computes, as text; tables and functions by their places."""
    if isinstance(formula, Flat):
        return formula.spelled(resources)
    loop = formula.loop
    rest = None if loop is None else (sorted(loop.wide), loop.table)
    return repr((formula.lanes, rest, [flat.spelled(resources) for flat in formula.flats]))


def pointers_of(code: Code, whole: Any, resources: Sequence[tuple[str, Any]]) -> dict[Any, Any]:
    """Pointers of tables and opaque functions, whose addresses an array holds."""
    return {
        key: code.b.inttoptr(code.constant_load(whole, i), POINTERS[key[0]])
        for i, key in enumerate(resources)
    }


# functions of numbers, for Python


def in_memory(
    traced: Traced, forms: Sequence[Any], addresses: Sequence[int]
) -> Callable[[Sequence[float]], Any]:
    """A formula compiled, as a function of its arguments' numbers."""
    kinds = list(flattened_forms(forms))
    made = _compiled(traced, kinds)
    run = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_void_p, ctypes.c_void_p)(made.address)
    run.function = made  # type: ignore[attr-defined]  # it lives as long as its machine code
    count = len(traced.flat.results)
    room = ctypes.c_double * max(1, count)
    places = (ctypes.c_int64 * max(1, len(addresses)))(*addresses)
    # struct lays numbers in a row in a third of the time of ctypes
    pack, unpack = struct.Struct(f"{len(kinds)}d").pack, struct.Struct(f"{count}d").unpack_from
    assembled = _assembling(traced.form)

    def call(numbers: Sequence[float]) -> Any:
        found = room()
        run(pack(*numbers), found, places)
        return assembled(unpack(found))

    return call


def in_python(
    formula: Callable[..., Any], forms: Sequence[Any], tables: Mapping[int, Any]
) -> Callable[[Sequence[float]], Any]:
    """The same without a compiler."""
    traced = trace(formula, forms, 0)
    run, assembled = plain(traced, tables), _assembling(traced.form)
    return lambda numbers: assembled(run(numbers))


def _compiled(traced: Traced, kinds: Sequence[str]) -> Any:
    """``run(numbers, results, whole)``, of arrays of doubles and addresses of resources."""
    keys = traced.resources

    def emit(code: Code, args: Sequence[Any]) -> None:
        source, target, whole = args
        given = [code.narrow(kind, code.load(source, k)) for k, kind in enumerate(kinds)]
        values = write(code, traced, given, pointers_of(code, whole, keys))
        for i, x in enumerate(values):
            double = x.type == REALS["double"]
            code.store(target, i, x if double else code.b.fpext(x, REALS["double"]))

    arguments = _NUMBERS, _NUMBERS, _WHOLE
    key = repr((kinds, [key[0] for key in keys])) + spelled(traced, keys)
    return generated(_SCALAR, arguments, {"formula": (arguments, emit)}, key)


def unpacking(forms: Sequence[Any]) -> Callable[[Any], tuple[float, ...] | None]:
    """A function of arguments: their numbers, in order; None unless they are floats so nested."""
    scope: dict[str, Any] = {}
    lines = ["def unpacked(a):"]
    leaves: list[str] = []

    def taken(parts: Sequence[Any], name: str) -> None:
        names = [f"{name}_{k}" for k in range(len(parts))]
        lines.append(f"    if len({name}) != {len(parts)}: return None")
        if names:
            lines.append(f"    {', '.join(names)}, = {name}")
        for part, own in zip(parts, names, strict=True):
            if not isinstance(part, Tuple):
                leaves.append(own)
                continue
            scope[f"class{own}"] = part.cls
            lines.append(f"    if type({own}) is not class{own}: return None")
            taken(part.parts, own)

    taken(forms, "a")
    numbers = "".join(f"{leaf}, " for leaf in leaves)
    lines.append(f"    numbers = ({numbers})")
    lines.append("    return numbers if {*map(type, numbers)} == {float} else None")
    if any(kind != "double" for kind in flattened_forms(forms)):
        return lambda args: None
    exec("\n".join(lines), scope)
    found: Callable[[Any], tuple[float, ...] | None] = scope["unpacked"]
    return found


_OF_KIND = {"single": "single({})", "double": "{}", "truth": "bool({})"}


def _assembling(form: Any) -> Callable[[Sequence[Any]], Any]:
    """A function of a list of numbers: they in a form."""
    scope: dict[str, Any] = {"single": np.float32}
    places = iter(range(len(list(flattened_forms((form,))))))

    def made(part: Any) -> str:
        if not isinstance(part, Tuple):
            return _OF_KIND[part].format(f"r[{next(places)}]")
        inner = "".join(f"{made(x)}, " for x in part.parts)
        if part.cls is tuple:
            return f"({inner})"
        name = f"class{len(scope)}"
        scope[name] = part.cls
        return f"{name}({inner})"

    exec(f"def assembled(r):\n    return {made(form)}", scope)
    found: Callable[[Sequence[Any]], Any] = scope["assembled"]
    return found
