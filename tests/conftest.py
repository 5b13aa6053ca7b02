"""What holds for every test: caches of their own, no screen, examples that stay the same."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

_ROOT = Path(__file__).resolve().parents[1]
for _name, _folder in (("FASTATT_CACHE", ".fastatt_cache"), ("NUMBA_CACHE_DIR", ".numba_cache")):
    if _name not in os.environ:
        if "numba" in sys.modules:
            raise RuntimeError(f"numba was imported before {_name} could be set")
        os.environ[_name] = str(_ROOT / _folder)
os.environ["MPLBACKEND"] = "Agg"

# the first example of a test compiles, so no example has a deadline
settings.register_profile("fastatt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("fastatt")

# the compiler's short-lived objects: collecting them on the way takes an eighth of the time
gc.disable()
_MANY = 18_000_000  # of them, about 5 GB: two processes that share the suite hold 4 GB each


@pytest.fixture(scope="module", autouse=True)
def _collect_garbage():
    """Now and then; what is alive then, compiled code above all, is not looked at again."""
    yield
    if gc.get_count()[0] > _MANY:
        gc.collect()
        gc.freeze()


def pytest_sessionstart():
    """Workers compile the loops that all of them load, each its share, before any test."""
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count == 1:
        return
    from fastatt.engine.loop import tile_loop

    own = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    ways = [(False, False), (True, False), (False, True)]
    loops = [(kind, *way) for kind in ("double", "single") for way in ways]
    for kind, per_body, events in loops[own::count]:
        tile_loop(kind, per_body=per_body, events=events)


def pytest_unconfigure():
    """The interpreter collects once more before it ends, all that was ever compiled."""
    gc.freeze()


@pytest.fixture(params=["pyarrow", "numpy"])
def reader(request, monkeypatch):
    """Both ways to read numbers."""
    if request.param == "numpy":
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    else:
        pytest.importorskip("pyarrow")
