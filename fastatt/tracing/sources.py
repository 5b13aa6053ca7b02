"""The source of functions that another process gets by value: it has no file to trace them from."""

from __future__ import annotations

import linecache
import sys
from collections.abc import Callable, Iterable
from types import FunctionType
from typing import Any

from fastatt.tracing.standing import referred_to


def sources(functions: Iterable[Callable[..., Any]]) -> dict[str, str]:
    """Texts, by file, of functions and of those that they call, but for what can be imported."""
    found: dict[str, str] = {}
    seen: set[FunctionType] = set()
    todo: list[Any] = list(functions)
    while todo:
        function = todo.pop()
        plain = getattr(function, "py_func", function)
        if not isinstance(plain, FunctionType) or plain in seen or _imported(function, plain):
            continue
        seen.add(plain)
        todo += referred_to(plain).values()
        file = plain.__code__.co_filename
        found[file] = "".join(linecache.getlines(file))
    return found


def _imported(function: Any, plain: FunctionType) -> bool:
    """Whether another process finds a function by the name of its module."""
    if plain.__module__ == "__main__":
        return False
    held = getattr(sys.modules.get(plain.__module__), plain.__qualname__, None)
    return held is function or held is plain


def keep(texts: dict[str, str]) -> None:
    """Have texts found as those of their files, where these are not."""
    for file, text in texts.items():
        if text and not linecache.getlines(file):
            # as of a notebook's cell: there is no file whose change would be looked for
            linecache.cache[file] = (len(text), None, text.splitlines(keepends=True), file)
