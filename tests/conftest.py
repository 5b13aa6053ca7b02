"""What holds for every test: caches of their own, no screen, examples that stay the same."""

import ctypes
import gc
import os
import sys
from pathlib import Path
from weakref import WeakKeyDictionary

import pytest
from hypothesis import settings

_ROOT = Path(__file__).resolve().parents[1]
if "numba" in sys.modules:
    raise RuntimeError("numba was imported before its cache could be set")
os.environ.setdefault("NUMBA_CACHE_DIR", str(_ROOT / ".numba_cache"))
os.environ.setdefault("FASTATT_CACHE", str(_ROOT / ".fastatt_cache"))
os.environ["MPLBACKEND"] = "Agg"

# the first example of a test compiles, so no example has a deadline
settings.register_profile("fastatt", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("fastatt")

# the compiler makes many short-lived objects: the default of 700 would collect all the time
gc.set_threshold(20_000)


#: scenes that files make when they are imported, whose programs would stay with them
_SCENES = []


def pytest_collection_finish():
    """Leave all that the files made out of later collections, which take as long as it is large."""
    from fastatt import Scene

    _SCENES.extend(x for x in gc.get_objects() if type(x) is Scene)
    gc.collect()
    gc.freeze()


#: folders whose files run the same programs
_SHARING = ("estimation", "gyro", "trade")


@pytest.fixture(scope="module", autouse=True)
def _forget(request):
    """Clear the library's caches after each file, so that its programs can be collected."""
    yield
    if request.path.parent.name in _SHARING:
        return
    for name, module in list(sys.modules.items()):
        if name.startswith("fastatt."):
            for value in list(vars(module).values()):
                getattr(value, "cache_clear", int)()
                if isinstance(value, WeakKeyDictionary):
                    value.clear()
    for scene in _SCENES:
        scene.memo.clear()
    gc.collect()
    getattr(ctypes.CDLL(None), "malloc_trim", int)(0)


def pytest_sessionstart():
    """Workers compile the loops that all of them load, each its share, before any test."""
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if count == 1:
        return
    from fastatt.engine.machine import tile_machine

    own = int(os.environ["PYTEST_XDIST_WORKER"].removeprefix("gw"))
    ways = [(any_angle, forks) for any_angle in (False, True) for forks in (False, True)]
    machines = [(kind, *way) for kind in ("double", "single") for way in ways]
    for kind, any_angle, forks in machines[own::count]:
        tile_machine(kind, any_angle=any_angle, forks=forks)
