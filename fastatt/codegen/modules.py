"""Generated modules: a function of a few loops around emitted formulas, compiled by Numba.

Its machine code is kept under everything that it depends on: the loops, the graphs of operations,
and the sources that emit it.
"""

from __future__ import annotations

import functools
import hashlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

from numba import cfunc, types
from numba.extending import intrinsic

from fastatt._numba import LOOP, NOTHING, needed
from fastatt._store import alone, kept
from fastatt.codegen.instructions import Code, prepare_for_vectors

# other sources that emit it
_OTHERS = ("_numba.py", "tracing/nodes.py")

#: the arguments of an emission: their types, and ``emit(code, arguments)``
Emission = tuple[Sequence[Any], Callable[[Code, Sequence[Any]], None]]


class MachineCode(NamedTuple):
    """A compiled function at an ``address``, and what Numba may release it with."""

    address: int
    function: Any


#: the emissions of the function that is being compiled
_emissions: ContextVar[Mapping[str, Emission]] = ContextVar("emissions")


def generated(
    text: str, arguments: Sequence[Any], emissions: Mapping[str, Emission], key: str
) -> MachineCode:
    """The machine code of the function ``run`` that a text defines.

    ``text`` is the source of ``run``, plain Python that Numba compiles, and ``arguments`` are
    Numba's types of its arguments; it returns nothing. ``emissions`` are the functions that it
    calls by name, as (types of arguments, emission), and ``key`` is everything that they depend on.
    """
    called = {name: _called(name, tuple(parts)) for name, (parts, _) in emissions.items()}

    def make(file: str | None) -> MachineCode:
        scope = {"__name__": __name__, **called}  # Numba imports it to load what it kept
        exec(compile(text, file or "<fastatt>", "exec"), scope)
        token = _emissions.set(emissions)
        try:
            function = cfunc(types.void(*arguments), cache=file is not None, **LOOP)(scope["run"])
            return MachineCode(function.address, needed(function))
        finally:
            _emissions.reset(token)

    return kept(f"{text}\0{key}\0{surroundings()}", make)


def _write(name: str, builder: Any, args: Any) -> None:
    """Write an emission; Numba keeps a reference to this function by its name."""
    prepare_for_vectors(builder.function)
    _, emit = _emissions.get()[name]
    emit(Code(builder), args)


@functools.cache
def _called(name: str, arguments: tuple[Any, ...]) -> Any:
    """An intrinsic that writes the emission of this name of the function that is being compiled.

    It is the same for all functions, since Numba keeps every intrinsic, with what it refers to.
    """
    signature = types.void(*arguments)

    def lower(context: Any, builder: Any, _: Any, args: Any) -> Any:
        _write(name, builder, args)
        return NOTHING

    names = ", ".join(f"a{i}" for i in range(len(arguments)))
    scope: dict[str, Any] = {"found": (signature, lower)}
    exec(f"def emission(typing_context, {names}):\n    return found", scope)
    return intrinsic(scope["emission"])


@functools.cache
def surroundings() -> str:
    """The sources that emit machine code, as hashes."""
    folder = Path(__file__).parent
    others = (folder.parent / name for name in _OTHERS)
    files = (*sorted(folder.glob("*.py")), *others)
    return "\0".join(hashlib.sha256(file.read_bytes()).hexdigest() for file in files)


class TwoForms(ABC):
    """The function that a loop calls; its any-angle form is compiled when first needed.

    ``entry`` and ``any_angle`` are addresses; ``any_angle`` is 0 until ``compile_any_angle``. With
    ``one_form`` both are the same.
    """

    def __init__(self, *, one_form: bool = False) -> None:
        #: the compiled forms; their machine code lives as long as these
        self.functions = [self._compiled(small_angle=True)]
        self.entry = self.functions[0].address
        self.any_angle: int = self.entry if one_form else 0
        self._memory = threading.local()

    @abstractmethod
    def _compiled(self, *, small_angle: bool) -> MachineCode:
        """One of the forms."""

    @abstractmethod
    def _new_memory(self) -> Any:
        """The memory of one thread."""

    def compile_any_angle(self) -> None:
        """Compile the any-angle form, if it is not compiled."""
        with alone():
            if self.any_angle == 0:
                self.functions.append(self._compiled(small_angle=False))
                self.any_angle = self.functions[1].address

    def memory(self) -> Any:
        """The calling thread's memory."""
        if not hasattr(self._memory, "arrays"):
            self._memory.arrays = self._new_memory()
        return self._memory.arrays
