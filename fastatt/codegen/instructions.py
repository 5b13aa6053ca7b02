"""A short notation for operations in LLVM's language, within a function that Numba writes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

I64 = ir.IntType(64)
I32 = ir.IntType(32)
BIT = ir.IntType(1)
_BUILDERS = {"and": "and_", "or": "or_"}
_COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
REALS: dict[str, Any] = {"double": ir.DoubleType(), "single": ir.FloatType()}


def alike(ty: Any, element: Any) -> Any:
    """An element's type, or that of as many as a type has if it is a vector's."""
    return ir.VectorType(element, ty.count) if isinstance(ty, ir.VectorType) else element


def prepare_for_vectors(function: Any) -> None:
    """Let a function keep whole vectors, in registers and, if there are too few, on its stack.

    A vector on the stack takes one cache line, not parts of two.
    """
    function.attributes.alignstack = 64
    # a function that it was inlined into would have another stack
    function.attributes.add("noinline")


class Code:
    """Writes operations at the position of an llvmlite builder."""

    def __init__(self, builder: Any) -> None:
        self.b, self.module = builder, builder.module

    def of(self, name: str, *args: Any) -> Any:
        """An operation on values of one type."""
        operation, _, compared = name.partition(" ")
        if compared:
            compare = self.b.fcmp_ordered if compared[0] == "o" else self.b.fcmp_unordered
            return compare(_COMPARISONS[compared[1:]], *args)
        return getattr(self.b, _BUILDERS.get(operation, operation))(*args)

    def call(self, function: Any, args: Sequence[Any]) -> Any:
        """The result of a function that the module declares."""
        return self.b.call(function, args)

    def select(self, test: Any, a: Any, b: Any) -> Any:
        """a if the test holds, else b."""
        return self.b.select(test, a, b)

    def room(self, ty: Any, n: int = 1) -> Any:
        """Memory for n values on the stack of the function."""
        with self.b.goto_entry_block():
            memory = self.b.alloca(ty, ir.Constant(I32, n))
        memory.align = 64
        return memory

    def place(self, pointer: Any, index: Any) -> Any:
        """Address of an element; ``index`` is a number or an LLVM value."""
        index = ir.Constant(I64, index) if isinstance(index, int) else index
        return self.b.gep(pointer, [index], inbounds=True)

    def load(self, pointer: Any, index: Any) -> Any:
        """An element."""
        return self.b.load(self.place(pointer, index))

    def constant_load(self, pointer: Any, index: Any, n: int = 1) -> Any:
        """An element, or n doubles, of an array that does not change during a call."""
        loaded = self.vector("double", pointer, index, n, align=8)
        loaded.set_metadata("invariant.load", self.module.add_metadata([]))
        return loaded

    def columns(self, rows: Sequence[Any], n: int) -> list[Any]:
        """Vectors of the first, second, ... of the n numbers of rows; sizes are powers of two."""
        if n == 1:
            return [self.vector_of(rows)]
        m, step = len(rows), 1
        columns = [self._joined(rows[i::n]) for i in range(n)]
        while step < n:
            # what lies ``step`` to the right in one vector goes to the one ``step`` further
            left = [k if not k & step else m + k - step for k in range(m)]
            right = [k + step if not k & step else m + k for k in range(m)]
            for i in range(n):
                if not i & step:
                    pair = columns[i], columns[i + step]
                    columns[i] = self._shuffled(*pair, left)
                    columns[i + step] = self._shuffled(*pair, right)
            step *= 2
        return columns

    def _joined(self, vectors: Sequence[Any]) -> Any:
        """The numbers of vectors, one after the other."""
        while len(vectors) > 1:
            every = range(2 * vectors[0].type.count)
            pairs = zip(vectors[::2], vectors[1::2], strict=True)
            vectors = [self._shuffled(a, b, every) for a, b in pairs]
        return vectors[0]

    def _shuffled(self, a: Any, b: Any, places: Sequence[int]) -> Any:
        mask = ir.Constant(ir.VectorType(I32, len(places)), list(places))
        return self.b.shuffle_vector(a, b, mask)

    def store(self, pointer: Any, index: Any, value: Any) -> None:
        """Change an element."""
        self.b.store(value, self.place(pointer, index))

    def vector(self, precision: str, pointer: Any, index: Any, n: int, *, align: int = 0) -> Any:
        """n successive elements, aligned to the size of the vector by default, or one element."""
        if n == 1:
            return self.load(pointer, index)
        many = ir.VectorType(REALS[precision], n)
        return self.b.load(self._as_vector(many, pointer, index), align=align or _aligned(many))

    def store_vector(self, pointer: Any, index: Any, value: Any) -> None:
        """Change as many successive elements as the value has."""
        if isinstance(value.type, ir.VectorType):
            place = self._as_vector(value.type, pointer, index)
            self.b.store(value, place, align=_aligned(value.type))
        else:
            self.store(pointer, index, value)

    def _as_vector(self, ty: Any, pointer: Any, index: Any) -> Any:
        return self.b.bitcast(self.place(pointer, index), ty.as_pointer())

    def lane(self, vector: Any, k: int) -> Any:
        """The number in a lane."""
        return self.b.extract_element(vector, ir.Constant(I32, k))

    def vector_of(self, numbers: Sequence[Any]) -> Any:
        """A vector of numbers."""
        vector: Any = ir.Constant(ir.VectorType(numbers[0].type, len(numbers)), ir.Undefined)
        for k, x in enumerate(numbers):
            vector = self.b.insert_element(vector, x, ir.Constant(I32, k))
        return vector

    def splat(self, value: Any, n: int) -> Any:
        """A vector of n equal values, or the value itself if n is 1."""
        if n == 1:
            return value
        if isinstance(value, ir.Constant):
            return ir.Constant(ir.VectorType(value.type, n), [value] * n)
        undefined = ir.Constant(ir.VectorType(value.type, n), ir.Undefined)
        one = self.b.insert_element(undefined, value, ir.Constant(I32, 0))
        first = ir.Constant(ir.VectorType(I32, n), [0] * n)
        return self.b.shuffle_vector(one, undefined, first)

    def cast(self, precision: str, value: Any) -> Any:
        """A number, or a vector of numbers, in a precision."""
        to = alike(value.type, REALS[precision])
        if value.type == to:
            return value
        return (self.b.fpext if precision == "double" else self.b.fptrunc)(value, to)

    def declared(self, name: str, result: Any, arguments: Sequence[Any]) -> Any:
        """A function of that name, defined elsewhere."""
        known = self.module.globals.get(name)
        return known or ir.Function(self.module, ir.FunctionType(result, arguments), name)

    def intrinsic(self, name: str, ty: Any, n: int = 1) -> Any:
        """LLVM's function of that name for a type, with n arguments of it."""
        return self.declared(f"{name}.{_suffix(ty)}", ty, [ty] * n)


def _aligned(ty: Any) -> int:
    """Alignment of a vector: its size, and at most a cache line."""
    size: int = ty.count * (8 if ty.element == REALS["double"] else 4)
    return min(64, size)


def _suffix(ty: Any) -> str:
    if isinstance(ty, ir.VectorType):
        return f"v{ty.count}{_suffix(ty.element)}"
    return "f64" if ty == REALS["double"] else "f32"
