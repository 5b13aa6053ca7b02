"""What holds for every test: a fresh cache, no screen, examples that are the same each time."""

from __future__ import annotations

import os
import sys

import numba_cache
from hypothesis import settings

if "NUMBA_CACHE_DIR" not in os.environ:
    if "numba" in sys.modules:
        raise RuntimeError("numba was imported before NUMBA_CACHE_DIR could be set")
    os.environ["NUMBA_CACHE_DIR"] = str(numba_cache.cache_dir())
os.environ["MPLBACKEND"] = "Agg"

# the first example of a test compiles, so no example has a deadline
settings.register_profile("fastatt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("fastatt")
