"""What holds for every test: a fresh cache, no screen, examples that are the same each time."""

from __future__ import annotations

import gc
import os
import sys

import numba_cache
import pytest
from hypothesis import settings

if "NUMBA_CACHE_DIR" not in os.environ:
    if "numba" in sys.modules:
        raise RuntimeError("numba was imported before NUMBA_CACHE_DIR could be set")
    os.environ["NUMBA_CACHE_DIR"] = str(numba_cache.cache_dir())
os.environ["MPLBACKEND"] = "Agg"

# the first example of a test compiles, so no example has a deadline
settings.register_profile("fastatt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("fastatt")

# the compiler's short-lived objects: collecting them on the way takes an eighth of the time
gc.disable()


@pytest.fixture(scope="module", autouse=True)
def _collect_garbage():
    yield
    gc.collect()
