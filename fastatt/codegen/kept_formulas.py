"""Formulas in machine code that Numba keeps on disk for a user's ``@njit(cache=True)`` function.

Numba checks the user's file alone. The formula may have been edited since, in that file's imports
or by other arguments of :func:`fastatt.single_step`. So a mark goes to disk with the machine code,
and is checked when that is loaded: the function must still refer to a formula with the same hash.
Where it does not, Numba compiles the function again, as if its file were missing.
"""

from __future__ import annotations

import functools
import hashlib
import sys
from collections.abc import Iterator
from types import CodeType, FrameType, ModuleType
from typing import Any

from numba.core.registry import CPUDispatcher

from fastatt.codegen.modules import surroundings
from fastatt.tracing.traced import Traced


class Formula:
    """A formula in a user's code; its callers depend on ``constants`` too."""

    __name__: str
    constants: str

    def traced(self, forms: tuple[Any, ...]) -> Traced:
        """The formula for arguments of some forms."""
        raise NotImplementedError


class EditedError(OSError):
    """The formula is another one now; Numba takes the file for one that is missing."""


class Mark:
    """The mark stored with a formula's machine code: its hash, and the forms of its arguments."""

    def __init__(self, name: str, forms: tuple[Any, ...], digest: str) -> None:
        self._found = name, forms, digest

    def __reduce__(self) -> Any:
        return _checked, self._found


def mark(context: Any, scalar: Formula, forms: tuple[Any, ...]) -> None:
    """Mark a function that a formula is being compiled into.

    The mark lies in the function's environment, for which Numba declares a variable in the
    function's module. The variable remains where the function is inlined, and Numba keeps the
    environments of all such variables with the machine code.
    """
    found = Mark(scalar.__name__, forms, digest_of(scalar, forms))
    context.environment.consts.append(found)


def digest_of(scalar: Formula, forms: tuple[Any, ...]) -> str:
    """A hash of what a formula computes for arguments of some forms, and of what compiles it."""
    traced = scalar.traced(forms)
    text = f"{traced.spelled(traced.resources)}\0{traced.form}\0{scalar.constants}\0{_compiler()}"
    return hashlib.sha256(text.encode()).hexdigest()


_compiler = functools.cache(surroundings)


def _checked(name: str, forms: tuple[Any, ...], digest: str) -> Mark:
    """The mark, where the function that Numba is about to load refers to the same formula."""
    for scalar in _referred(_loaded(), set()):
        if scalar.__name__ == name and digest_of(scalar, forms) == digest:
            return Mark(name, forms, digest)
    raise EditedError(f"{name}: edited since it was compiled")


def _loaded() -> Any:
    """The function that Numba is about to load: of its cache, further down this thread's stack."""
    frame: FrameType | None = sys._getframe(1)  # noqa: SLF001
    while frame is not None:
        function = getattr(frame.f_locals.get("self"), "_py_func", None)
        if function is not None:
            return function
        frame = frame.f_back
    return None


def _referred(function: Any, seen: set[int]) -> Iterator[Formula]:
    """The formulas that a function's code refers to, and that the functions it calls refer to."""
    if id(function) in seen:
        return
    seen.add(id(function))
    if isinstance(function, Formula):
        yield function
    function = getattr(function, "py_func", function)
    code = getattr(function, "__code__", None)
    if code is None:
        return
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    names = set(_names(code))
    found = [*cells, *(function.__globals__.get(name) for name in names)]
    for module in [x for x in found if isinstance(x, ModuleType)]:
        found += [getattr(module, name, None) for name in names]
    for x in found:
        if isinstance(x, (Formula, CPUDispatcher)) or hasattr(x, "__code__"):
            yield from _referred(x, seen)


def _names(code: CodeType) -> Iterator[str]:
    """Names of globals and attributes in a function's code, and in functions within it."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)
