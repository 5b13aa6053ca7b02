"""What the compiled code is: packed, cached, free of the GIL, without allocation."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from exact import START, combinations, generic, matrices_slow
from llvmlite import binding
from numba import njit
from numba.core.runtime import _nrt_python, rtsys

import fastatt as fa
from fastatt._jit import driver
from fastatt.engine import pool, tiles

ROOT = Path(fa.__file__).resolve().parents[1]
BODIES = generic(64)
Q0 = np.broadcast_to(START, (64, 4))


def run(scene=None, method="magnus4", representation="quat", n=4, h=0.01, q0=Q0, **options):
    options = {"method": method, "representation": representation, "n_threads": 1, **options}
    return fa.propagate(BODIES.scene if scene is None else scene, q0, dt=h, n_steps=n, **options)


# packed arithmetic

ARITHMETIC = re.compile(r"^\s+v?(?:fn?m(?:add|sub)\w*?|mul|add|sub|div|sqrt)([ps])([ds])\s")
CONVERSION = re.compile(r"^\s+v?cvt(?:ps2pd|pd2ps|ss2sd|sd2ss)\s")
LARGE = 40  # operations that tell a step from a copy or a comparison


def innermost_loops(assembly):
    """Lines from each label to a jump back to it, with no other such pair between."""
    lines = [line for line in assembly.splitlines() if line.strip()]
    labels, spans = {}, []
    for i, line in enumerate(lines):
        if label := re.match(r"^(\.L\w+):", line):
            labels[label[1]] = i
        elif (jump := re.match(r"^\s+j\w+\s+(\.L\w+)", line)) and jump[1] in labels:
            spans.append((labels[jump[1]], i))
    inner = [
        (a, b)
        for a, b in spans
        if not any((c, d) != (a, b) and a <= c and d <= b for c, d in spans)
    ]
    return [lines[a:b] for a, b in inner]


def count(lines):
    """Arithmetic instructions by kind: packed or scalar (p, s), double or single (d, s)."""
    found = {"pd": 0, "sd": 0, "ps": 0, "ss": 0}
    for line in lines:
        if match := ARITHMETIC.match(line):
            found[match[1] + match[2]] += 1
    return found


def packed_steps(assembly, kind="pd"):
    """Innermost loops with a step's worth of packed arithmetic and no other, nor any call."""
    out = []
    for lines in innermost_loops(assembly):
        found = count(lines)
        alone = sum(found.values()) == found[kind]
        calls = any(re.match(r"^\s+call", line) for line in lines)
        if found[kind] >= LARGE and alone and not calls:
            out.append(lines)
    return out


def assembly(monkeypatch, scene, method, representation, dtype="float64"):
    """Of the driver's one signature for this run, compiled anew where the disk had it."""
    shared = tiles.cached_run_tiles
    for compiled in (shared, driver(tiles.run_tiles, cache=False)):
        seen = []

        def record(*args, compiled=compiled, seen=seen):
            compiled(*args)
            seen.append(args)

        monkeypatch.setattr(tiles, "cached_run_tiles", record)
        monkeypatch.setattr(tiles, "uncached_run_tiles", record)
        run(scene, method, representation, dtype=dtype)
        signature = tuple(compiled.typeof_pyval(a) for a in seen[0])
        if compiled.stats.cache_misses.get(signature) or compiled is not shared:
            return compiled.inspect_asm(signature)
    raise AssertionError


needs_avx = pytest.mark.skipif(
    not binding.get_host_cpu_features().get("avx"), reason="no AVX: nothing to pack into"
)
TILES = [pair for pair in combinations() if pair[1] in ("quat", "dcm")]
ROWS = {
    "constant": fa.rates.Constant(BODIES.c[:, 0]),
    "polynomial": fa.rates.Polynomial(BODIES.c),
    "coning": fa.rates.Coning(BODIES.a, BODIES.omega),
}


@needs_avx
@pytest.mark.parametrize(("method", "representation"), matrices_slow(TILES))
def test_step_is_packed(monkeypatch, method, representation):
    """With coning, a parabola and each body's own parameters: sines, products and loads.

    Of an exponential both the loop for turns of up to π and the one for any turn; where the
    compiler kept a scalar twin for arrays that overlap, it must not be the only one.
    """
    text = assembly(monkeypatch, BODIES.scene, method, representation)
    assert len(packed_steps(text)) >= (2 if fa.METHODS[method].exponentials else 1)


@needs_avx
@pytest.mark.parametrize("model", ROWS)
def test_step_is_packed_with_every_model(monkeypatch, model):
    text = assembly(monkeypatch, fa.Scene(rate=ROWS[model]), "magnus4", "quat")
    assert len(packed_steps(text)) >= 2


@pytest.mark.slow
@needs_avx
@pytest.mark.parametrize("method", ["rk4", "magnus4", "magnus6", "cg3"])
def test_float32_step_is_packed_without_conversions(monkeypatch, method):
    text = assembly(monkeypatch, BODIES.scene, method, "quat", "float32")
    steps = packed_steps(text, "ps")
    assert len(steps) >= (2 if fa.METHODS[method].exponentials else 1)
    assert not [line for lines in steps for line in lines if CONVERSION.match(line)]


@njit
def with_libm(t, p):
    return math.sin(p[0] * t), p[1], p[2]


@needs_avx
def test_a_call_of_libm_makes_the_loop_scalar(monkeypatch):
    """What the criterion above is there to see."""
    scene = fa.Scene(rate=with_libm, params=BODIES.c[:, 0])
    assert packed_steps(assembly(monkeypatch, scene, "lie_midpoint", "quat")) == []


@needs_avx
def test_the_packed_loop_is_the_one_that_runs():
    """Two lanes of float32 for one of float64, one for one in scalar code."""
    n = 20_000

    def seconds(dtype):
        begin = time.perf_counter()
        run(n=n, h=1e-4, dtype=dtype)
        return time.perf_counter() - begin

    best = {d: min(seconds(d) for _ in range(7)) for d in ("float64", "float32")}
    assert best["float32"] < 0.8 * best["float64"]


# the disk cache


CALL = """
import json, sys
import fastatt as fa
from fastatt.engine import tiles
rate = fa.rates.Constant([[0.1, 0.2, 0.3]] * 3)
params = None
if sys.argv[1] == "user":
    from numba import njit
    @njit
    def rate(t, p):
        return 0.1, p[0], 0.3
    params = [0.2]
scene = fa.Scene(rate=rate, params=params)
traj = fa.propagate(scene, [[1.0, 0, 0, 0]] * 3, dt=0.1, n_steps=3, method="lie_euler")
stats = tiles.cached_run_tiles.stats
print(json.dumps([sum(stats.cache_hits.values()), sum(stats.cache_misses.values())]))
"""


def call(folder, which):
    """(hits, misses) of the driver in a process of its own, and the folder's files after it."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", CALL, which],
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    files = {
        p.relative_to(folder): (p.stat().st_size, p.stat().st_mtime_ns)
        for p in folder.rglob("*")
        if p.is_file()
    }
    return json.loads(done.stdout), files


def test_second_process_compiles_nothing(tmp_path):
    """Nor does the folder grow; a user's own function is compiled each time and leaves nothing."""
    first, before = call(tmp_path, "built-in")
    assert first == [0, 1]
    second, after = call(tmp_path, "built-in")
    assert second == [1, 0]
    assert after == before

    users, once = call(tmp_path, "user")
    assert users == [0, 0]
    assert [p for p in set(once) - set(before) if "run_tiles" in p.name] == []
    _, twice = call(tmp_path, "user")
    assert twice == once


# memory and the GIL


@pytest.fixture
def allocations():
    """Counts allocations of compiled code while the test runs."""
    was_on = _nrt_python.memsys_stats_enabled()
    _nrt_python.memsys_enable_stats()
    yield lambda: rtsys.get_allocation_stats().alloc
    if not was_on:
        _nrt_python.memsys_disable_stats()


@pytest.mark.parametrize(("method", "representation"), [("magnus4", "quat"), ("rk4", "dcm")])
def test_steps_allocate_nothing(allocations, method, representation):
    def made(n, bodies=64):
        before = allocations()
        run(generic(bodies).scene, method, representation, n, q0=np.tile(START, (bodies, 1)))
        return allocations() - before

    few = made(100)
    assert few > 0  # the tiles themselves are counted
    assert made(100) == few
    assert made(1000) == few
    assert made(1000, 192) == few  # one set of tiles for all tiles of a thread


def test_one_log_allocates_nothing_by_sample(allocations):
    def made(n):
        before = allocations()
        fa.integrate_rates(np.full((n, 3), 0.1), 0.01, method="hold", n_threads=1)
        return allocations() - before

    assert made(1537) == made(15361) > 0


def test_driver_releases_the_gil(monkeypatch):
    """Another thread counts at some share of its own speed while one long call runs."""
    monkeypatch.setattr(pool, "_PIECE", 10**12)  # the whole run in one call of the driver
    n = 100_000
    run(method="magnus6", n=10)

    def counted(done):
        total = 0
        while not done():
            total += 1
        return total

    begin = time.perf_counter()
    alone = counted(lambda: time.perf_counter() - begin > 0.1) / 0.1
    with ThreadPoolExecutor(1) as worker:
        started = threading.Event()

        def work():
            started.set()
            begin = time.perf_counter()
            run(method="magnus6", n=n)
            return time.perf_counter() - begin

        future = worker.submit(work)
        started.wait()
        beside = counted(future.done)
        seconds = future.result()
    assert seconds > 0.05
    assert beside > 0.1 * alone * seconds


def test_bodies_run_on_several_threads(monkeypatch):
    """Pieces of an ensemble reach the driver from as many threads as asked for."""
    seen = set()
    real = tiles.cached_run_tiles
    barrier = threading.Barrier(2, timeout=20.0)

    def watched(*args):
        if threading.get_ident() not in seen:
            seen.add(threading.get_ident())
            barrier.wait()
        real(*args)

    monkeypatch.setattr(tiles, "cached_run_tiles", watched)
    bodies = generic(640)
    run(bodies.scene, n=4, q0=np.tile(START, (640, 1)), n_threads=2)
    assert len(seen) == 2


def test_an_error_in_one_piece_stops_the_run(monkeypatch):
    calls = []

    def broken(*args):
        calls.append(args)
        raise RuntimeError("piece")

    monkeypatch.setattr(tiles, "cached_run_tiles", broken)
    bodies = generic(6400)
    with pytest.raises(RuntimeError, match="piece"):
        run(bodies.scene, q0=np.tile(START, (6400, 1)), n_threads=2)
    assert len(calls) < 16


def test_progress_counts_every_step(monkeypatch):
    pytest.importorskip("tqdm")
    import tqdm

    done = []

    class Bar(tqdm.tqdm):
        def update(self, n=1):
            done.append(n)
            return super().update(n)

        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs, disable=True)

    monkeypatch.setattr(tqdm, "tqdm", Bar)
    bodies = generic(200)
    run(bodies.scene, n=130, q0=np.tile(START, (200, 1)), n_threads=2, progress=True)
    assert sum(done) == 200 * 130
    done.clear()
    fa.integrate_rates(np.full((3, 5000, 3), 0.1), 0.01, method="hold", progress=True)
    assert sum(done) == 3 * 4999
