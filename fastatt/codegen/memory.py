"""Arrays for generated code and loops: their precision, alignment and addresses."""

from __future__ import annotations

import ctypes
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

DTYPES: dict[str, np.dtype[Any]] = {"double": np.dtype(np.float64), "single": np.dtype(np.float32)}
#: bytes of a cache line
LINE = 64
#: bytes below which the free memory is not checked
LITTLE = 1 << 30
_BYTE = ctypes.c_char


def aligned(n: int, dtype: np.dtype[Any]) -> NDArray[Any]:
    """n zeros that begin at a multiple of a cache line."""
    size = n * dtype.itemsize
    memory = np.zeros(size + LINE, np.uint8)
    first = -address_of(memory) % LINE
    return memory[first : first + size].view(dtype)


def address_of(x: NDArray[Any]) -> int:
    """Address of an array's first number; 0 of an empty array."""
    if x.size == 0:
        return 0
    try:  # takes a quarter of the time of the other way
        return ctypes.addressof(_BYTE.from_buffer(x))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):  # read-only, or with gaps
        return int(x.__array_interface__["data"][0])


def available() -> int | None:
    """Bytes of available memory; None if the system does not report them."""
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    return None
