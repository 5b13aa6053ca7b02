"""Ensembles in chunks: the bits of one run, whatever the chunks, on processes that die too."""

from __future__ import annotations

import linecache
import os
import signal
import time
import warnings
from contextlib import contextmanager

import numpy as np
import pytest
from each import in_tiers
from ways import given

import fastatt as fa

N = 70
RNG = np.random.default_rng(4)
Q0, W0 = RNG.normal(size=(N, 4)), RNG.normal(size=(N, 3))
OWN = fa.Scene(inertia=np.array([2.0, 1.5, 1.0]) * RNG.uniform(0.9, 1.1, (N, 1)))
SHARED = fa.Scene(inertia=(2.0, 1.5, 1.0))
STEPS = {"dt": 0.02, "n_steps": 30}
RK4 = {**STEPS, "method": "rk4"}
SOME = ("rate, single", "rk4, low parts", "position", "states", "closed form", "events")
RUNS = {way: given(way, slice(N), n=60, save_every=8, t0=0.3) for way in SOME} | {
    "from a time to another": given(
        "breakpoints", slice(N), n=None, t0=0.3, t_end=0.9, save_every=2
    ),
    "one attitude for all": (OWN, {"q0": Q0[0], "w0": W0, **RK4}),
    "arrays of single precision": (SHARED, {"q0": Q0.astype("f4"), "w0": W0.astype("f4"), **RK4}),
}
OFTEN = RUNS.keys() - {"rate, single", "rk4, low parts", "closed form"}
NAMES = ("q0", "w0", "v0", "r0")


@pytest.fixture(scope="module", autouse=True)
def _libraries():
    """Imported where these tests run, not by every process that collects them."""
    global Client, LocalCluster, da, dask, fd  # noqa: PLW0603
    import dask
    import dask.array as da
    from distributed import Client, LocalCluster

    from fastatt import dask as fd


def lazily(x):
    return da.from_array(x, chunks=(30, -1)[2 - x.ndim :])


@pytest.fixture(autouse=True)
def _here():
    """Where nothing else is said, one chunk after the other in this process."""
    with dask.config.set(scheduler="synchronous"):
        yield


@contextmanager
def workers(n):
    """Their client; the dashboard has any port, for clusters of other processes."""
    options = {"threads_per_worker": 1, "dashboard_address": ":0"}
    with LocalCluster(n_workers=n, **options) as cluster, Client(cluster) as client:
        yield client


@pytest.fixture(scope="module")
def client():
    with workers(1) as client:
        yield client


def same(found, expected):
    return found.dtype == expected.dtype and np.array_equal(found, expected, equal_nan=True)


@pytest.mark.parametrize("name", in_tiers(OFTEN, RUNS))
def test_bits_do_not_depend_on_chunks(name):
    scene, arguments = RUNS[name]
    whole = fa.propagate(scene, **arguments)
    in_chunks = {n: lazily(x) if n in NAMES else x for n, x in arguments.items()}
    for chunks, these in ((33, arguments), ((1, 68, 1), arguments), (None, in_chunks)):
        lazy = fd.propagate(scene, chunks=chunks, **these)
        found, q, status = dask.compute(lazy, lazy.q, lazy.status)
        assert isinstance(found, fa.Trajectory)
        assert found.summary() == whole.summary()
        assert same(found.t, whole.t)
        assert same(lazy.t, whole.t)
        carried = [*(("v", "r") if scene.moves else ()), *(("s",) if scene.states else ())]
        carried += ["event_times"] if "events" in arguments else []
        for part in ("q", "w", "status", "dcm", "norm_error", *carried):
            assert same(getattr(found, part), getattr(whole, part)), part
        assert same(q, whole.q)
        assert same(status, whole.status)
        for part in ("q", "w", "status", *carried):
            assert getattr(lazy, part).shape == getattr(whole, part).shape, part


def test_precision_is_that_of_all_arrays():
    lazy = fd.propagate(SHARED, Q0.astype("f4"), lazily(W0), **STEPS)
    assert lazy.q.dtype == lazy.q.compute().dtype == np.float64


def test_a_computed_run_is_a_trajectory(tmp_path):
    """What a user does with a run goes on from there."""
    run = fd.propagate(SHARED, Q0, W0, chunks=33, save_every=10, **RK4).compute()
    whole = fa.propagate(SHARED, Q0, W0, save_every=10, **RK4)
    for x in (run, whole):
        x.to_csv(tmp_path / f"{x is run}.csv")
    assert (tmp_path / "True.csv").read_bytes() == (tmp_path / "False.csv").read_bytes()
    assert np.array_equal(fa.drift(run, SHARED).energy, fa.drift(whole, SHARED).energy)
    assert fa.interpolate(run.t, run.q, run.w, [0.33])[0].shape == (1, N, 4)
    run.plot(tmp_path / "run.png", SHARED)
    # whose end would be that of one chunk
    with pytest.raises(ValueError, match="save_end: found a trajectory that does not hold its end"):
        run.save_end(tmp_path / "end")


def test_each_chunk_runs_once_and_on_one_thread(monkeypatch):
    """When it is asked for; all that is asked for at once comes of the same run."""
    threads = []

    def counted(*args, **options):
        threads.append(options["n_threads"])
        return fa.propagate(*args, **options)

    monkeypatch.setattr("fastatt.dask.chunks.run_chunk", counted)
    lazy, whole = (
        fd.propagate(SHARED, Q0, W0, chunks=30, **RK4),
        fa.propagate(SHARED, Q0, W0, **RK4),
    )
    assert threads == []
    dask.compute(lazy, lazy.q, lazy.w, lazy.status)
    assert threads == [1, 1, 1]
    (kept,) = dask.persist(lazy)
    assert same(kept.compute().q, whole.q)
    assert same(kept.w.compute(), whole.w)
    assert len(threads) == 6
    with pytest.raises(AttributeError, match="v: found none; accepted: t, q, w, status"):
        _ = kept.v


def kill_first(block, marker):
    """The numbers; the first process that is asked for them dies."""
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return block


@pytest.mark.slow
def test_a_killed_worker_changes_nothing(tmp_path):
    marker = tmp_path / "died"
    q0 = da.from_array(Q0, chunks=(10, -1)).map_blocks(kill_first, marker, meta=Q0[:0])
    lazy = fd.propagate(SHARED, q0, W0, **RK4)
    with workers(2) as client, dask.config.set(scheduler=client):
        before = set(client.scheduler_info(n_workers=-1)["workers"])
        found = dask.compute(lazy)[0]
        assert before != set(client.scheduler_info(n_workers=-1)["workers"])
    assert marker.exists()
    whole = fa.propagate(SHARED, Q0, W0, **RK4)
    assert same(found.q, whole.q)
    assert same(found.w, whole.w)
    assert same(found.status, whole.status)


CELL = """
from numba import njit

def half(x):
    return 0.5 * x if x > 0.0 else x

@njit
def torque(t, q, w, p):
    return -half(w[0]) * p[0], -p[0] * w[1], 0.0
"""


def test_functions_of_a_notebook_are_traced_on_workers(client):
    """Of which the worker has no file."""
    linecache.cache["<cell 1>"] = (len(CELL), None, CELL.splitlines(keepends=True), "<cell 1>")
    names = {}
    exec(compile(CELL, "<cell 1>", "exec"), names)
    scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=names["torque"], params=RNG.random((N, 1)))
    # what can not be rebuilt on a worker is tried for ever
    reason = client.submit(lambda scene: scene.functions[0].reason, scene).result(timeout=60)
    assert reason == ""
    with dask.config.set(scheduler=client):
        found = fd.propagate(scene, Q0, W0, chunks=40, **RK4).q.compute()
    assert same(found, fa.propagate(scene, Q0, W0, **RK4).q)


def test_warnings_of_workers_arrive(client):
    """They come beside the results, not with them."""
    with warnings.catch_warnings(record=True) as told, dask.config.set(scheduler=client):
        warnings.simplefilter("always")
        fd.propagate(SHARED, Q0, 100.0 * W0, chunks=40, **RK4).status.compute()
        for _ in range(100):
            if len(told) >= 2:
                break
            time.sleep(0.05)
    assert {w.category for w in told} == {fa.StepWarning}
    assert sorted(str(w.message)[:17] for w in told) == ["bodies 0 to 39: d", "bodies 40 to 69: "]


def test_one_bad_body():
    bad = Q0.copy()
    bad[45] = np.nan
    lazy = da.from_array(bad, chunks=(30, -1))
    with pytest.raises(ValueError, match=r"q0\[15") as caught:
        fd.propagate(SHARED, lazy, W0, **RK4).q.compute()
    assert caught.value.__notes__ == ["in the chunk of bodies 30 to 59"]
    with pytest.raises(ValueError, match=r"q0\[45"):
        fd.propagate(SHARED, bad, W0, **RK4)
    fast = W0.copy()
    fast[45] = 1e200
    lazy = da.from_array(fast, chunks=(30, -1))
    with pytest.warns(fa.StepWarning, match="bodies 30 to 59: dt: a step of body 15"):
        found = dask.compute(fd.propagate(SHARED, Q0, lazy, **RK4))[0]
    fine = np.arange(N) != 45
    assert np.flatnonzero(found.status).tolist() == [45]
    assert same(found.q[:, fine], fa.propagate(SHARED, Q0, W0, **RK4).q[:, fine])


def of_unknown_size():
    return da.from_array(Q0, chunks=(30, -1))[da.from_array(W0[:, 0], chunks=30) > 0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fd.propagate(SHARED, Q0[0], W0[0], **STEPS), "q0: found one body"),
        (lambda: fd.propagate(OWN, Q0[:9], W0[:9], **STEPS), f"inertia: found {N} bodies"),
        (lambda: fd.propagate(SHARED, lazily(Q0), W0[:9], **STEPS), "rows"),
        (lambda: fd.propagate(SHARED, lazily(W0), W0, **STEPS), "q0"),
        (lambda: fd.propagate(SHARED, of_unknown_size(), W0, **STEPS), "q0: found unknown sizes"),
        (lambda: fd.propagate(SHARED, Q0, W0, chunks=0, **STEPS), "chunks: found 0"),
        (lambda: fd.propagate(SHARED, Q0, W0, chunks=2.5, **STEPS), "chunks: found 2.5"),
        (lambda: fd.propagate(SHARED, Q0, W0, chunks=(9, 9), **STEPS), "chunks: found 18 bodies"),
        (lambda: fd.propagate(SHARED, Q0, W0, **{**STEPS, "dt": 0.0}), "dt"),
        (lambda: fd.propagate(SHARED, Q0, W0, method="magnus4", **STEPS), "method: found"),
        (lambda: fd.propagate("free", Q0, W0, **STEPS), "scene: found"),
    ],
)
def test_wrong_arguments_are_named_before_anything_runs(call, message):
    with pytest.raises((TypeError, ValueError), match=message.replace("(", r"\(")):
        call()
