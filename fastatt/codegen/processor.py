"""The target of Numba's compiler: the width of a vector, and whether products and sums fuse."""

from __future__ import annotations

import functools
from typing import NamedTuple

from fastatt._numba import target
from fastatt.codegen.memory import DTYPES


class Processor(NamedTuple):
    """The target of Numba's compiler: its name, the bytes of a vector, fused multiplications.

    ``key`` distinguishes all properties on which machine code depends.
    """

    name: str
    vector: int
    fuses: bool
    key: str

    def lanes(self, precision: str) -> int:
        """Numbers of a precision, "double" or "single", in one vector."""
        return self.vector // DTYPES[precision].itemsize


def described(triple: str, name: str, features: str) -> Processor:
    """The processor of a target triple, a name and a list of features.

    A 64-bit ARM has vectors of 16 bytes and fused multiplications, whatever its features say.
    """
    has = {feature[1:] for feature in features.split(",") if feature.startswith("+")}
    fuses = "fma" in has or triple.startswith(("aarch64", "arm64"))
    vector = 64 if "avx512f" in has else 32 if "avx" in has else 16
    return Processor(name, vector, fuses, f"{triple}\0{name}\0{features}")


@functools.cache
def processor() -> Processor:
    """The processor that Numba compiles for, as ``NUMBA_CPU_NAME`` and others may set it."""
    return described(*target())
