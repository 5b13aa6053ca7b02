"""Machine code: of this processor, kept on disk under the hash of the text that it is made from.

The text holds every formula that is in it, so that an edit anywhere gives another name: a file is
never stale. What cannot be kept is compiled in memory.

A program's functions are compiled and kept one by one, for those that programs have in common: two
methods on one scene differ in the block of steps, hardly in how a tile begins, is saved and judged.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import sys
import threading
from time import perf_counter
from typing import Any

import llvmlite
from llvmlite import binding as llvm

from fastatt.flat import store

_LOCK = threading.Lock()
#: seconds of compiling beyond which a user is told
LONG = 1.0


class Processor:
    """What the compiler may use: name, features, the width of a vector in bytes.

    A 64-bit ARM has vectors of 16 bytes and fused multiplications, whether it says so or not.
    """

    def __init__(self, name: str, features: str, triple: str = "") -> None:
        self.name, self.features = name, features
        found = dict.fromkeys(f[1:] for f in features.split(",") if f.startswith("+"))
        self.fuses = "fma" in found or triple.startswith(("aarch64", "arm64"))
        self.vector = 64 if "avx512f" in found else 32 if "avx" in found else 16


@functools.cache
def processor() -> Processor:
    """That of this machine, or what ``NUMBA_CPU_NAME`` and ``NUMBA_CPU_FEATURES`` say instead."""
    name = os.environ.get("NUMBA_CPU_NAME") or llvm.get_host_cpu_name()
    features = os.environ.get("NUMBA_CPU_FEATURES")
    if features is None:
        features = llvm.get_host_cpu_features().flatten()
    return Processor(name, features, llvm.get_default_triple())


# characters of a program beyond which code is chosen in a time that does not grow with its square
_LONG = 580_000


def _target(effort: int = 2) -> Any:
    """A machine to write code for; an engine owns its own."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    cpu = processor()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu.name, features=cpu.features, opt=effort, codemodel="jitdefault", jit=True
    )


def _module(text: str) -> tuple[Any, Any]:
    """(target machine, module) of a program in LLVM's language.

    No pass runs over it first: equal operations are one already, and what all lanes share stands
    before their loop. Passes took as long again and gained nothing that could be measured.
    """
    machine = _target(1 if len(text) > _LONG else 2)
    module = llvm.parse_assembly(text)
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    return machine, module


def object_of(text: str) -> bytes:
    """Machine code of a program in LLVM's language."""
    machine, module = _module(text)
    return bytes(machine.emit_object(module))


def assembly_of(text: str) -> str:
    """The same as text that can be read."""
    machine, module = _module(text)
    return str(machine.emit_assembly(module))


class Compiled:
    """A program in memory."""

    def __init__(self, *codes: bytes) -> None:
        machine = _target()
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        for code in codes:
            engine.add_object_file(llvm.ObjectFileRef.from_data(code))
        engine.finalize_object()
        self._engine = engine
        self.codes = codes

    def address(self, name: str) -> int:
        """Where a function lies."""
        return int(self._engine.get_function_address(name))

    def function(self, name: str, *arguments: Any) -> Any:
        """A function for ctypes, which lets go of the GIL while it runs."""
        found = ctypes.CFUNCTYPE(ctypes.c_int64, *arguments)(self.address(name))
        found.program = self  # type: ignore[attr-defined]  # it lives as long as the function
        return found


def key_of(text: str) -> str:
    """Name of a function's machine code: of its text, the compiler and the processor."""
    cpu = processor()
    parts = (text, llvmlite.__version__, cpu.name, cpu.features)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def compiled(text: str) -> Compiled:
    """The program, from disk or made now."""
    with _LOCK:
        return Compiled(*map(_found, functions_of(text)))


def functions_of(text: str) -> list[str]:
    """A program's functions, each a program that declares what it calls."""
    head, *rest = text.split("\ndefine ")
    if len(rest) < 2:
        return [text]
    bodies, _, between = zip(*[x.rpartition("\n}") for x in rest], strict=True)
    lines = "\n".join((head, *between)).splitlines()
    used = [list(dict.fromkeys(_names(body))) for body in bodies]
    known = {name: x for x in lines for name in _names(x)}
    for (own, *_), body in zip(used, bodies, strict=True):
        known[own] = "declare " + body.partition("\n")[0]
    shared = [x for x in lines if x and not _names(x)]
    return [
        "\n".join((*shared, *(known[name] for name in names[1:]), f"define {body}\n}}\n"))
        for names, body in zip(used, bodies, strict=True)
    ]


def _names(text: str) -> list[str]:
    """Of functions and tables."""
    return [x.partition('"')[0] for x in text.split('@"')[1:]]


def _found(text: str) -> bytes:
    """Machine code of a function, from disk or made now."""
    key = key_of(text)
    code = store.read(key)
    if code is None:
        begin = perf_counter()
        code = object_of(text)
        _WAIT.add(perf_counter() - begin)
        store.write(key, code)
    return code


class _Wait:
    """What compiling has taken: said once, where somebody waits at a terminal."""

    def __init__(self) -> None:
        self.seconds, self.silent = 0.0, False

    def add(self, seconds: float) -> None:
        """Count some more."""
        self.seconds += seconds
        if self.seconds > LONG and not self.silent:
            self.silent = True
            if sys.stderr is not None and sys.stderr.isatty():
                sys.stderr.write(
                    "fastatt: compiling for this machine, once; 'fastatt warm' does it beforehand\n"
                )


_WAIT = _Wait()


def say_nothing() -> None:
    """Compile without a word about how long it takes."""
    _WAIT.silent = True


def _renew() -> None:
    """A thread that held the lock is not there in a forked process."""
    global _LOCK  # noqa: PLW0603
    _LOCK = threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)
