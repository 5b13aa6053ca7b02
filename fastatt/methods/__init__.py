"""The list of methods. A file defines one or several, with their steps and their records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module

from fastatt.methods.method import Method

# the file of each method, which is imported when the method is first used
_FILES = {
    "lie_euler": "crouch_grossman",
    "lie_midpoint": "crouch_grossman",
    "rk4": "explicit",
    "magnus4": "magnus",
    "magnus6": "magnus",
    "magnus8": "magnus",
    "gauss12": "gauss12",
    "cf4": "cf4",
    "rkmk4": "rkmk4",
    "cg3": "crouch_grossman",
    "rk8": "explicit",
    "rk9": "explicit",
    "gbs16": "gbs16",
    "strang2": "strang",
    "kahan_li8": "strang",
    "dmv2": "dmv",
    "dmv10": "dmv",
    "exact": "exact",
    "hold": "samples",
    "trapezoid": "samples",
    "previous": "samples",
    "coning2": "samples",
    "picard": "picard",
}


@cache
def _defined_in(file: str) -> dict[str, Method]:
    values = vars(import_module(f"fastatt.methods.{file}")).values()
    return {x.name: x for x in values if isinstance(x, Method)}


class _Methods(Mapping[str, Method]):
    """The methods of the library by name."""

    def __getitem__(self, name: str) -> Method:
        return _defined_in(_FILES[name])[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_FILES)

    def __len__(self) -> int:
        return len(_FILES)

    def __repr__(self) -> str:
        return f"METHODS: {', '.join(self)}"


METHODS: Mapping[str, Method] = _Methods()

__all__ = ["METHODS", "Method"]
