"""A short notation for operations in LLVM's language, within a function that Numba writes."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

I64 = ir.IntType(64)
I32 = ir.IntType(32)
BIT = ir.IntType(1)
REALS: dict[str, Any] = {"double": ir.DoubleType(), "single": ir.FloatType()}


class Line:
    """An operation as text, formatted once; llvmlite treats it as an instruction of its own.

    An operation without a ``kind`` has no result.
    """

    __slots__ = ("_name", "_text", "type")
    opname, metadata = "", ("dbg",)
    _numbers = itertools.count()

    def __init__(self, builder: Any, kind: Any, text: str) -> None:
        self.type, self._name = kind, f"%-{next(self._numbers)}"
        self._text = text if kind is None else f"{self._name} = {text}"
        builder._insert(self)  # noqa: SLF001

    def get_reference(self) -> str:
        """Name of the result."""
        return self._name

    def __str__(self) -> str:
        return self._text


def prepare_for_vectors(function: Any) -> None:
    """Let a function keep whole vectors, in registers and, if these are too few, on its stack.

    LLVM halves the vectors of Intel's processors unless it is asked not to; llvmlite's own check
    does not know the attribute. A vector on the stack takes one cache line, not parts of two.
    """
    set.add(function.attributes, '"prefer-vector-width"="512"')
    function.attributes.alignstack = 64
    # a function that it were inlined into would have another stack
    function.attributes.add("noinline")


class Code:
    """Writes operations where a builder of llvmlite's stands."""

    def __init__(self, builder: Any) -> None:
        self.b, self.module = builder, builder.module

    def of(self, name: str, *args: Any, kind: Any = None) -> Line:
        """An operation on values of one type, which is the result's unless ``kind`` differs."""
        of = args[0].type
        names = ", ".join([x.get_reference() for x in args])
        return Line(self.b, kind or of, f"{name} {of} {names}")

    def call(self, function: Any, args: Sequence[Any]) -> Line:
        """The result of a function that the module declares."""
        of = function.function_type.return_type
        given = ", ".join(map(_typed, args))
        return Line(self.b, of, f"call {of} {function.get_reference()}({given})")

    def select(self, test: Any, a: Any, b: Any) -> Line:
        """a where the test holds, else b."""
        return Line(self.b, a.type, f"select {_typed(test)}, {_typed(a)}, {_typed(b)}")

    def room(self, kind: Any, n: int = 1) -> Any:
        """Memory for n values on the function's stack."""
        with self.b.goto_entry_block():
            made = self.b.alloca(kind, ir.Constant(I32, n))
        made.align = 64
        return made

    def place(self, pointer: Any, index: Any) -> Any:
        """Address of an element; ``index`` is a number or one of LLVM's."""
        index = ir.Constant(I64, index) if isinstance(index, int) else index
        text = f"getelementptr inbounds {pointer.type.pointee}, {_typed(pointer)}, {_typed(index)}"
        return Line(self.b, pointer.type, text)

    def load(self, pointer: Any, index: Any) -> Any:
        """An element."""
        return self._loaded(self.place(pointer, index))

    def constant_load(self, pointer: Any, index: Any) -> Any:
        """An element of an array that does not change while the function runs."""
        loaded = self.b.load(self.place(pointer, index))
        loaded.set_metadata("invariant.load", self.module.add_metadata([]))
        return loaded

    def store(self, pointer: Any, index: Any, value: Any) -> None:
        """Change an element."""
        self._stored(value, self.place(pointer, index))

    def vector(self, pointer: Any, index: Any, n: int) -> Any:
        """n elements in a row, aligned to the size of the vector, or one element."""
        if n == 1:
            return self.load(pointer, index)
        at = self._as_vector(pointer, index, n)
        return self._loaded(at, f", align {_aligned(at)}")

    def store_vector(self, pointer: Any, index: Any, value: Any) -> None:
        """Change as many elements in a row as the value has."""
        if not isinstance(value.type, ir.VectorType):
            self.store(pointer, index, value)
            return
        at = self._as_vector(pointer, index, value.type.count)
        self._stored(value, at, f", align {_aligned(at)}")

    def _as_vector(self, pointer: Any, index: Any, n: int) -> Any:
        to = ir.VectorType(pointer.type.pointee, n).as_pointer()
        return Line(self.b, to, f"bitcast {_typed(self.place(pointer, index))} to {to}")

    def _loaded(self, pointer: Any, how: str = "") -> Line:
        kind = pointer.type.pointee
        return Line(self.b, kind, f"load {kind}, {_typed(pointer)}{how}")

    def _stored(self, value: Any, pointer: Any, how: str = "") -> None:
        Line(self.b, None, f"store {_typed(value)}, {_typed(pointer)}{how}")

    @contextmanager
    def loop(self, n: int) -> Iterator[Any]:
        """for index in range(n), n > 0."""
        b = self.b
        before = b.block
        body, after = map(b.append_basic_block, ("body", "after"))
        b.branch(body)
        b.position_at_end(body)
        index = b.phi(I64)
        index.add_incoming(ir.Constant(I64, 0), before)
        yield index
        following = b.add(index, ir.Constant(I64, 1))
        index.add_incoming(following, b.block)
        b.cbranch(b.icmp_signed("<", following, ir.Constant(I64, n)), body, after)
        b.position_at_end(after)

    def real(self, kind: str, value: float) -> Any:
        """A constant."""
        return ir.Constant(REALS[kind], value)

    def splat(self, value: Any, n: int) -> Any:
        """A vector of n times the same, or the value itself where n is 1."""
        if n == 1:
            return value
        if isinstance(value, ir.Constant):
            return ir.Constant(ir.VectorType(value.type, n), [value] * n)
        to = ir.VectorType(value.type, n)
        one = Line(self.b, to, f"insertelement {to} undef, {_typed(value)}, i32 0")
        first = f"<{n} x i32> zeroinitializer"
        return Line(self.b, to, f"shufflevector {_typed(one)}, {to} undef, {first}")

    def narrow(self, kind: str, value: Any) -> Any:
        """A double, or a vector of doubles, in a precision."""
        if kind == "double":
            return value
        vector = isinstance(value.type, ir.VectorType)
        to = ir.VectorType(REALS[kind], value.type.count) if vector else REALS[kind]
        return self.b.fptrunc(value, to)

    def declared(self, name: str, result: Any, arguments: Sequence[Any]) -> Any:
        """A function of that name, defined elsewhere."""
        found = self.module.globals.get(name)
        return found or ir.Function(self.module, ir.FunctionType(result, arguments), name)

    def intrinsic(self, name: str, kind: Any, n: int = 1) -> Any:
        """LLVM's function of that name for a type, of n arguments of it."""
        return self.declared(f"{name}.{_suffix(kind)}", kind, [kind] * n)


class Cells:
    """Numbers and vectors that change, each in memory on the stack: ``cells[i]``, or all of them.

    ``align`` is given for vectors that are wider than the alignment of the stack.
    """

    def __init__(self, code: Code, kinds: Iterable[Any], align: int | None = None) -> None:
        self._b, self._align = code.b, align
        self._places = [code.room(kind) for kind in kinds]

    def get(self) -> list[Any]:
        """The values."""
        return [self._b.load(place, align=self._align) for place in self._places]

    def set(self, values: Iterable[Any]) -> None:
        """Change the values."""
        for place, value in zip(self._places, values, strict=True):
            self._b.store(value, place, align=self._align)


def _typed(x: Any) -> str:
    return f"{x.type} {x.get_reference()}"


def _aligned(pointer: Any) -> int:
    """Alignment of a vector: its size, and at most a cache line."""
    kind = pointer.type.pointee
    size: int = kind.count * (8 if kind.element == REALS["double"] else 4)
    return min(64, size)


def _suffix(kind: Any) -> str:
    if isinstance(kind, ir.VectorType):
        return f"v{kind.count}{_suffix(kind.element)}"
    return "f64" if kind == REALS["double"] else "f32"
