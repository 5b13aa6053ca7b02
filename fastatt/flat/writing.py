"""Traced formulas in LLVM's language, derivatives side by side, and as functions of numbers."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from fastatt.flat import machine
from fastatt.flat.code import I64, REALS, Cells, Code, text_of
from fastatt.flat.llvm import POINTERS, Emitter
from fastatt.flat.traced import Loop, Traced, Tuple, flattened_forms, plain, trace


def write(code: Code, traced: Traced, given: Any, resources: Mapping[Any, Any]) -> list[Any]:
    """The results, each of its kind, of values that are given.

    The graphs of a formula follow each other, with lanes for the directions of dual numbers.
    """
    lanes = traced.lanes
    emit = Emitter(code, lanes, machine.processor().fuses, resources)
    # what is given, and what a loop's step is given anew: the state with whether it has lanes
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
        # a vector of many directions is wider than what memory on the stack is aligned to
        cells = Cells(code, [x.type for x in first], align=8)
        cells.set(first)
        with code.loop(0, len(loop.table)) as i:
            found["s"] = [*zip(cells.get(), wide, strict=True), *state[n:]]
            found["row"] = [code.load(table, i * size + k) for k in range(size)]
            cells.set(alike(emit(loop.step, find)))
        found["s"] = [*zip(cells.get(), wide, strict=True), *state[n:]]
    return [value for value, _ in emit(traced.flat, find)]


def _table(code: Code, loop: Loop) -> Any:
    """Where the constants of a loop are in the program."""
    kinds = (node.kind for node in loop.step.nodes if node.args[:1] == ("row",))
    kind = REALS[next(kinds, "double")]
    numbers = [x for row in loop.table for x in row]
    of = ir.ArrayType(kind, len(numbers))
    table = ir.GlobalVariable(code.module, of, code.module.get_unique_name("table"))
    table.linkage, table.global_constant = "internal", True
    table.initializer = ir.Constant(of, numbers)
    return code.b.bitcast(table, kind.as_pointer())


# functions of numbers, for Python


def in_memory(
    traced: Traced, forms: Sequence[Any], addresses: Sequence[int]
) -> Callable[[Sequence[float]], Any]:
    """A formula compiled, as a function of its arguments' numbers."""
    kinds = list(flattened_forms(forms))
    pointer = ctypes.c_void_p
    program = machine.compiled(_program(traced, kinds))
    run = program.function("scalar", ctypes.c_char_p, pointer, pointer)
    count = len(traced.flat.results)
    room = ctypes.c_double * max(1, count)
    places = (ctypes.c_int64 * max(1, len(addresses)))(*addresses)
    # Python's own way to lay numbers in a row takes a third of the time of ctypes'
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


def _program(traced: Traced, kinds: Sequence[str]) -> str:
    """A program with ``scalar(arguments, results, addresses)``, of arrays of float64 and int64."""
    module = ir.Module("scalar")
    double = REALS["double"]
    code = Code(module, "scalar", [double.as_pointer(), double.as_pointer(), I64.as_pointer()])
    b = code.b
    source, target, places = code.function.args
    given = []
    for k, kind in enumerate(kinds):
        x = code.load(source, k)
        given.append(x if kind == "double" else b.fptrunc(x, REALS[kind]))
    pointers = {
        key: b.inttoptr(code.load(places, i), POINTERS[key[0]])
        for i, key in enumerate(traced.resources)
    }
    for i, x in enumerate(write(code, traced, given, pointers)):
        code.store(target, i, x if x.type == double else b.fpext(x, double))
    code.give(0)
    return text_of(module)


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
