"""A short notation for loops and memory in LLVM's language: the engine's loops are written in it.

An ``Int`` is a whole number of the program being made, with Python's operators; ``with loop(...)``
and ``with when(...)`` open blocks.
"""

from __future__ import annotations

import ctypes
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from llvmlite import ir

I64 = ir.IntType(64)
I32 = ir.IntType(32)
BIT = ir.IntType(1)
REALS: dict[str, Any] = {"double": ir.DoubleType(), "single": ir.FloatType()}


def text_of(module: ir.Module) -> str:
    """The program's text; the module is taken apart, whose cycles would wait for the collector."""
    text = str(module)
    for function in module.functions:
        for block in function.blocks:
            for phi in block.instructions:
                if isinstance(phi, ir.PhiInstr):
                    phi.incomings.clear()
            block.instructions.clear()
            block.terminator = block.parent = None
        function.blocks.clear()
        function.args = ()
    module.globals.clear()
    return text


class Line:
    """An operation, put into words at once; to llvmlite it is an instruction like its own.

    A compiler whose function it stands in finds nothing to change about it. Without a ``kind`` it
    has no result.
    """

    __slots__ = ("_name", "_text", "type")
    opname, metadata = "", ("dbg",)

    def __init__(self, code: Code, kind: Any, text: str) -> None:
        self.type, self._name = kind, f"%-{next(code.numbers)}"
        self._text = text if kind is None else f"{self._name} = {text}"
        code.b._insert(self)  # noqa: SLF001

    def get_reference(self) -> str:
        """How others name its result."""
        return self._name

    def __str__(self) -> str:
        return self._text


def _arithmetic(name: str) -> Callable[[Int, Any], Int]:
    return lambda x, y: Int(x.code, x.code.of(name, x.value, x.code.raw(y)))


def _comparison(name: str) -> Callable[[Int, Any], Any]:
    return lambda x, y: x.code.of(f"icmp {name}", x.value, x.code.raw(y), kind=BIT)


class Int:
    """A whole number of 64 bits."""

    def __init__(self, code: Code, value: Any) -> None:
        self.code, self.value = code, value

    __add__ = __radd__ = _arithmetic("add")
    __sub__ = _arithmetic("sub")
    __mul__ = __rmul__ = _arithmetic("mul")
    __floordiv__ = _arithmetic("sdiv")
    __mod__ = _arithmetic("srem")
    __lt__ = _comparison("slt")
    __le__ = _comparison("sle")
    __gt__ = _comparison("sgt")
    __ge__ = _comparison("sge")
    equals = _comparison("eq")

    def at_most(self, other: Any) -> Int:
        """The smaller of two."""
        return Int(self.code, self.code.select(self < other, self.value, self.code.raw(other)))

    def at_least(self, other: Any) -> Int:
        """The larger of two."""
        return Int(self.code, self.code.select(self > other, self.value, self.code.raw(other)))


class Code:
    """A function that is being written: ``name(arguments) -> a whole number``."""

    # of lines; those of another compiler's functions are counted together
    numbers = itertools.count()

    def __init__(self, module: ir.Module, name: str, arguments: Sequence[Any]) -> None:
        self.module = module
        self.function = ir.Function(module, ir.FunctionType(I64, list(arguments)), name)
        # on Intel's processors LLVM halves its vectors unless it is told otherwise
        set.add(self.function.attributes, '"prefer-vector-width"="512"')
        # what does not fit the registers goes to the stack, a cache line a vector
        self.function.attributes.alignstack = 64
        self.b = ir.IRBuilder(self.function.append_basic_block("entry"))
        self._entry = self.b.block
        self.numbers = itertools.count()

    @classmethod
    def within(cls, builder: Any) -> Code:
        """Where a builder of llvmlite's stands in a function that another compiler writes."""
        code = cls.__new__(cls)
        code.module, code.function, code.b = builder.module, builder.function, builder
        code._entry = builder.function.entry_basic_block  # noqa: SLF001
        set.add(code.function.attributes, '"prefer-vector-width"="512"')
        return code

    def of(self, name: str, *args: Any, kind: Any = None) -> Line:
        """An operation on values of one type, and of its result unless it has another ``kind``."""
        of = args[0].type
        names = ", ".join([x.get_reference() for x in args])
        return Line(self, kind or of, f"{name} {of} {names}")

    def call(self, function: Any, args: Sequence[Any]) -> Line:
        """What a function of the program gives."""
        of = function.function_type.return_type
        given = ", ".join(map(_typed, args))
        return Line(self, of, f"call {of} {function.get_reference()}({given})")

    def select(self, test: Any, a: Any, b: Any) -> Line:
        """a where the test holds, else b."""
        return Line(self, a.type, f"select {_typed(test)}, {_typed(a)}, {_typed(b)}")

    def raw(self, x: Any) -> Any:
        """LLVM's value of an Int or of a Python number."""
        return x.value if isinstance(x, Int) else ir.Constant(I64, x)

    def whole(self, x: Any) -> Int:
        """x as an Int."""
        return x if isinstance(x, Int) else Int(self, ir.Constant(I64, x))

    def room(self, kind: Any, n: int = 1, align: int = 64) -> Any:
        """Memory on the stack that lasts for the function."""
        with self.b.goto_block(self._entry):
            self.b.position_at_start(self._entry)
            made = self.b.alloca(kind, ir.Constant(I32, n))
        made.align = align
        return made

    def variable(self, value: Any) -> Any:
        """Memory for one whole number: a pointer for ``b.load`` and ``b.store``."""
        made = self.room(I64, align=8)
        self.b.store(self.raw(value), made)
        return made

    def get(self, variable: Any) -> Int:
        """What a variable holds."""
        return Int(self, self._loaded(variable))

    def set(self, variable: Any, value: Any) -> None:
        """Change what a variable holds."""
        self.b.store(self.raw(value), variable)

    def place(self, pointer: Any, index: Any) -> Any:
        """Address of an element."""
        kind, at = pointer.type, _typed(self.raw(index))
        text = f"getelementptr inbounds {kind.pointee}, {_typed(pointer)}, {at}"
        return Line(self, kind, text)

    def load(self, pointer: Any, index: Any) -> Any:
        """An element."""
        return self._loaded(self.place(pointer, index))

    def store(self, pointer: Any, index: Any, value: Any) -> None:
        """Change an element."""
        self._stored(value, self.place(pointer, index))

    def vector(self, pointer: Any, index: Any, n: int) -> Any:
        """n elements in a row."""
        at = self._as_vector(pointer, index, n)
        return self._loaded(at, f", align {_aligned(at)}")

    def store_vector(self, pointer: Any, index: Any, value: Any) -> None:
        """Change n elements in a row."""
        at = self._as_vector(pointer, index, value.type.count)
        self._stored(value, at, f", align {_aligned(at)}")

    def _as_vector(self, pointer: Any, index: Any, n: int) -> Any:
        to = ir.VectorType(pointer.type.pointee, n).as_pointer()
        return Line(self, to, f"bitcast {_typed(self.place(pointer, index))} to {to}")

    def _loaded(self, pointer: Any, how: str = "") -> Line:
        kind = pointer.type.pointee
        return Line(self, kind, f"load {kind}, {_typed(pointer)}{how}")

    def _stored(self, value: Any, pointer: Any, how: str = "") -> None:
        Line(self, None, f"store {_typed(value)}, {_typed(pointer)}{how}")

    @contextmanager
    def loop(self, first: Any, last: Any, step: int = 1) -> Iterator[Int]:
        """for index in range(first, last, step)."""
        b = self.b
        before = b.block
        head, body, after = map(b.append_basic_block, ("loop", "body", "after"))
        start, end = self.raw(first), self.raw(last)
        b.branch(head)
        b.position_at_end(head)
        index = b.phi(I64)
        index.add_incoming(start, before)
        b.cbranch(b.icmp_signed("<", index, end), body, after)
        b.position_at_end(body)
        yield Int(self, index)
        index.add_incoming(b.add(index, ir.Constant(I64, step)), b.block)
        b.branch(head)
        b.position_at_end(after)

    @contextmanager
    def lanes(self, width: int, step: int) -> Iterator[Int]:
        """for index in range(0, width, step), which is never empty: tested at its end."""
        b = self.b
        before = b.block
        body, after = map(b.append_basic_block, ("lanes", "after"))
        b.branch(body)
        b.position_at_end(body)
        index = b.phi(I64)
        index.add_incoming(ir.Constant(I64, 0), before)
        yield Int(self, index)
        following = b.add(index, ir.Constant(I64, step))
        index.add_incoming(following, b.block)
        b.cbranch(b.icmp_signed("<", following, ir.Constant(I64, width)), body, after)
        b.position_at_end(after)

    @contextmanager
    def repeat_while(self, condition: Any) -> Iterator[None]:
        """While ``condition()``, which is written at the head of the loop."""
        b = self.b
        head, body, after = map(b.append_basic_block, ("while", "body", "after"))
        b.branch(head)
        b.position_at_end(head)
        b.cbranch(condition(), body, after)
        b.position_at_end(body)
        yield
        b.branch(head)
        b.position_at_end(after)

    @contextmanager
    def when(self, condition: Any) -> Iterator[None]:
        """Only where the condition holds; a block that returns ends there."""
        b = self.b
        then, after = map(b.append_basic_block, ("then", "after"))
        b.cbranch(condition, then, after)
        b.position_at_end(then)
        yield
        if not b.block.is_terminated:
            b.branch(after)
        b.position_at_end(after)

    def give(self, value: Any) -> None:
        """Return."""
        self.b.ret(self.raw(value))

    def real(self, kind: str, value: float) -> Any:
        """A constant."""
        return ir.Constant(REALS[kind], value)

    def splat(self, value: Any, n: int) -> Any:
        """A vector of n times the same."""
        if isinstance(value, ir.Constant):
            return ir.Constant(ir.VectorType(value.type, n), [value] * n)
        to = ir.VectorType(value.type, n)
        one = Line(self, to, f"insertelement {to} undef, {_typed(value)}, i32 0")
        first = f"<{n} x i32> zeroinitializer"
        return Line(self, to, f"shufflevector {_typed(one)}, {to} undef, {first}")

    def declared(self, name: str, result: Any, arguments: Sequence[Any]) -> Any:
        """A function of that name that is found elsewhere."""
        found = self.module.globals.get(name)
        return found or ir.Function(self.module, ir.FunctionType(result, arguments), name)

    def intrinsic(self, name: str, kind: Any, n: int = 1) -> Any:
        """LLVM's function of that name for a type, of n arguments of it."""
        return self.declared(f"{name}.{_suffix(kind)}", kind, [kind] * n)

    def prefetch(self, pointer: Any) -> None:
        """Ask for the cache line of an address."""
        char = ir.IntType(8).as_pointer()
        asked = self.declared("llvm.prefetch.p0", ir.VoidType(), [char, I32, I32, I32])
        read, near, data = (ir.Constant(I32, k) for k in (0, 3, 1))
        self.b.call(asked, [self.b.bitcast(pointer, char), read, near, data])


class Cells:
    """Numbers and vectors that change, each in memory on the stack: ``cells[i]``, or all of them.

    ``align`` is that of vectors wider than such memory is aligned to.
    """

    def __init__(self, code: Code, kinds: Iterable[Any], align: int | None = None) -> None:
        self._b, self._align = code.b, align
        self._places = [code.room(kind) for kind in kinds]

    def __getitem__(self, i: int) -> Any:
        return self._b.load(self._places[i], align=self._align)

    def __setitem__(self, i: int, value: Any) -> None:
        self._b.store(value, self._places[i], align=self._align)

    def get(self) -> list[Any]:
        """What they hold."""
        return [self[i] for i in range(len(self._places))]

    def set(self, values: Iterable[Any]) -> None:
        """Change what they hold."""
        for i, value in enumerate(values):
            self[i] = value


class Given:
    """What a program was given: a structure of numbers of 8 bytes, by their names.

    They are whole numbers, doubles, and addresses.
    """

    def __init__(self, code: Code, pointer: Any, kind: type[ctypes.Structure]) -> None:
        self.code, self.pointer = code, pointer
        self._places = {field[0]: i for i, field in enumerate(kind._fields_)}

    def whole(self, name: str) -> Int:
        """A whole number."""
        return Int(self.code, self.code.load(self.pointer, self._places[name]))

    def place(self, name: str) -> Any:
        """Where a double lies."""
        at = self.code.place(self.pointer, self._places[name])
        return self.code.b.bitcast(at, REALS["double"].as_pointer())

    def number(self, name: str) -> Any:
        """A double."""
        return self.code.b.load(self.place(name))

    def array(self, name: str, kind: Any) -> Any:
        """The address of an array or of a function."""
        return self.code.b.inttoptr(self.whole(name).value, kind)


def _typed(x: Any) -> str:
    return f"{x.type} {x.get_reference()}"


def _aligned(pointer: Any) -> int:
    """Alignment of a vector: its size, and no more than that of memory on the stack."""
    kind = pointer.type.pointee
    size: int = kind.count * (8 if kind.element == REALS["double"] else 4)
    return min(64, size)


def _suffix(kind: Any) -> str:
    if isinstance(kind, ir.VectorType):
        return f"v{kind.count}{_suffix(kind.element)}"
    return "f64" if kind == REALS["double"] else "f32"
