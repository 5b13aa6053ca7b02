"""Rigid bodies on one core: every method's speed and error, and other programs beside them.

Times of other programs leave their compilation and change of layout out; ours are whole calls.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from functools import cache

import numpy as np
import peers_bodies as peers
import pytest

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for
from fastatt.trade.measure import best_time

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_BODIES = 256 if SMOKE else 16_384
T_END = peers.T_END
TARGETS = tuple(10.0**-k for k in range(3, 13))
FREE = fa.Scene(inertia=(2.0, 1.0, 2.0 / 3.0))
TOP = fa.Scene(inertia=(0.6, 0.8, 1.0), torque=fa.torques.HeavyTop((0.0, 0.0, 1.0), 1.0))
SCENES = {"free": FREE, "potential": TOP}
ENSEMBLES = {"free": peers.free_bodies, "potential": peers.bodies_in_potential}


@cache
def bodies(scene: str) -> peers.Bodies:
    return ENSEMBLES[scene](N_BODIES)


@cache
def reference(scene: str) -> np.ndarray:
    """Attitudes at the end: the closed form, or order 8 at a step that leaves round-off."""
    b = bodies(scene)
    if scene == "free":
        return fa.closed_form.free_body(b.q0, b.m0 / b.inertia, b.inertia, T_END)[0]
    return run(scene, "rk8", 8000, "float64").q[-1]


def run(scene: str, method: str, n_steps: int, dtype: str) -> fa.Trajectory:
    b = bodies(scene)
    return fa.propagate(
        SCENES[scene], b.q0, b.m0 / b.inertia, dt=T_END / n_steps, n_steps=n_steps, method=method,
        dtype=dtype, n_threads=1,
    )  # fmt: skip


def median_error(scene: str, q: np.ndarray) -> float:
    return float(np.median(fa.angle_between(q.astype(float), reference(scene))))


CASES = [
    (scene, method, dtype)
    for scene, described in SCENES.items()
    for method in methods_for(described, "quat")
    for dtype in ("float64", "float32")
]


@pytest.mark.benchmark(group="bodies, 100 steps of 0.1 s, one core")
@pytest.mark.parametrize(("scene", "method", "dtype"), CASES)
def test_method(benchmark, scene, method, dtype):
    result = benchmark.pedantic(
        run, args=(scene, method, 100, dtype), rounds=1 if SMOKE else 5, warmup_rounds=1
    )
    benchmark.extra_info["error, rad"] = median_error(scene, result.q[-1])
    if benchmark.stats is not None:
        speed = N_BODIES * 100 / benchmark.stats.stats.min
        benchmark.extra_info["M body-steps/s"] = round(speed / 1e6, 1)


@pytest.mark.skipif(not peers.has_c(), reason="no gcc")
@pytest.mark.benchmark(group="RK4 of free bodies beside the same loop in C, one core")
@pytest.mark.parametrize("inertia", ["shared", "per body"])
def test_rk4_beside_c(benchmark, inertia):
    """Interleaved, 2000 steps a body; the ratio is the median of pairs."""
    steps = 20 if SMOKE else 2000
    b = bodies("free")
    moments = b.inertia if inertia == "shared" else np.tile(b.inertia, (N_BODIES, 1))
    b = peers.Bodies(moments, b.q0, b.m0, potential=False)
    scene = fa.Scene(inertia=moments)
    w0 = b.m0 / moments

    def ours() -> fa.Trajectory:
        return fa.propagate(
            scene, b.q0, w0, dt=T_END / steps, n_steps=steps, method="rk4", n_threads=1
        )

    ratios = []
    for _ in range(1 if SMOKE else 9):
        theirs = peers.c_rk4(b, steps)
        ratios.append(theirs.seconds / best_time(ours, 1)[0])
    result = benchmark.pedantic(ours, rounds=1, warmup_rounds=0)
    benchmark.extra_info["speed of C's"] = round(float(np.median(ratios)), 3)
    benchmark.extra_info["difference, rad"] = float(fa.angle_between(result.q[-1], theirs.q).max())


def at_targets(points: Iterable[tuple[float, float, str]]) -> dict[float, tuple[float, str]]:
    """For each target the shortest time among (seconds, error, label) that meet it."""
    found = {}
    listed = sorted(points)
    for target in TARGETS:
        fitting = [(seconds, label) for seconds, error, label in listed if error <= target]
        if fitting:
            found[target] = fitting[0]
    return found


def our_points(scene: str) -> list[tuple[float, float, str]]:
    """Every method and precision over a ladder of steps, of which the closed form takes one."""
    points = []
    ladder = (20, 40) if SMOKE else (10, 14, 20, 28, 40, 56, 80, 112, 160, 224, 320, 448, 640)

    def add(call: Callable[[], np.ndarray], label: str) -> float:
        seconds, q = best_time(call, 3)
        points.append((seconds / N_BODIES, median_error(scene, q), label))
        return points[-1][1]

    for dtype in ("float64", "float32"):
        for name in methods_for(SCENES[scene], "quat"):
            for n in (1,) if name == "exact" else ladder:
                call = lambda name=name, n=n, d=dtype: run(scene, name, n, d).q[-1]  # noqa: E731
                if add(call, f"{name} {dtype}, {n} steps") < TARGETS[-1]:
                    break
    return points


def heyoka_points(scene: str) -> list[tuple[float, float, str]]:
    points = []
    for k in (3, 6) if SMOKE else range(2, 16):
        system = peers.Heyoka(bodies(scene), 10.0**-k)
        seconds = min(system.propagate().seconds for _ in range(1 if SMOKE else 3))
        error = median_error(scene, system.propagate().q)
        points.append((seconds / N_BODIES, error, f"tolerance 1e-{k}"))
    return points


@pytest.mark.skipif(not peers.has_heyoka(), reason="no heyoka")
@pytest.mark.benchmark(group="time at equal error beside heyoka, one core")
@pytest.mark.parametrize("scene", SCENES)
def test_beside_heyoka(benchmark, scene):
    """µs a body to T = 10 s at each median error: ours, heyoka's, the ratio, our method."""
    measured: list[Callable[[str], list[tuple[float, float, str]]]] = [our_points, heyoka_points]
    ours, theirs = (at_targets(points(scene)) for points in measured)
    for target in TARGETS:
        if target in ours and target in theirs:
            own, other = ours[target], theirs[target]
            benchmark.extra_info[f"{target:.0e}"] = (
                f"{own[0] * 1e6:.3f} {other[0] * 1e6:.3f} {other[0] / own[0]:.1f} {own[1]}"
            )
    benchmark.pedantic(lambda: None, rounds=1)
    for label, line in benchmark.extra_info.items():
        print(label, line)


@pytest.mark.benchmark(group="closed form, one core")
@pytest.mark.parametrize("n_times", [1, 10, 1000])
def test_closed_form(benchmark, n_times):
    b = bodies("free")
    n = max(64, N_BODIES // n_times)
    q0, w0 = b.q0[:n], (b.m0 / b.inertia)[:n]
    t = np.linspace(0.0, T_END, n_times) if n_times > 1 else T_END

    def ours() -> tuple[np.ndarray, np.ndarray]:
        return fa.closed_form.free_body(q0, w0, b.inertia, t, n_threads=1)

    benchmark.pedantic(ours, rounds=1 if SMOKE else 7, warmup_rounds=1)
    if benchmark.stats is not None:
        speed = n * n_times / benchmark.stats.stats.min
        benchmark.extra_info["M body-times/s"] = round(speed / 1e6, 1)


@pytest.mark.benchmark(group="bodies of their own, all cores")
@pytest.mark.parametrize("method", ["rk4", "strang2", "rk8"])
def test_million_bodies(benchmark, method):
    """Each with its own inertia, orbit and damping."""
    n, steps = (1000, 2) if SMOKE else (1_000_000, 50)
    generator = np.random.default_rng(7)
    torque = fa.torques.Sum(
        (
            fa.torques.GravityGradient(generator.uniform(0.9e-3, 1.1e-3, n)),
            fa.torques.Damping(generator.uniform(0.0, 1e-3, (n, 1))),
        )
    )
    scene = fa.Scene(inertia=generator.uniform(1.0, 1.5, (n, 3)), torque=torque)
    q0, w0 = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), generator.normal(0.0, 0.1, (n, 3))

    def ours(m: int, name: str) -> fa.Trajectory:
        return fa.propagate(scene, q0, w0, dt=50.0 / m, n_steps=m, method=name)

    result = benchmark.pedantic(
        ours, args=(steps, method), rounds=1 if SMOKE else 3, warmup_rounds=1
    )
    fine = ours(2 * steps, "rk8")
    benchmark.extra_info["error, rad"] = float(
        np.median(fa.angle_between(result.q[-1], fine.q[-1]))
    )
    if benchmark.stats is not None:
        speed = n * steps / benchmark.stats.stats.min
        benchmark.extra_info["M body-steps/s"] = round(speed / 1e6, 1)
