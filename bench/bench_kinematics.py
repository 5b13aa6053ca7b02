"""Ensembles with a known answer: body-steps a second beside the error, for every method."""

from __future__ import annotations

import numpy as np
import pytest
from problems import T_END, Coning, numpy_rk4

import fastatt as fa

N_BODIES, N_STEPS = 16_384, 200
CASES = [
    (name, representation, dtype)
    for name, method in fa.METHODS.items()
    if "rate" in method.scenes
    for representation in method.representations
    for dtype in ("float64", "float32")
    if dtype == "float64" or representation == "quat"
]


@pytest.fixture(scope="module")
def problem() -> Coning:
    return Coning(N_BODIES)


def _steps_per_second(benchmark, bodies: int, steps: int) -> None:
    if benchmark.stats is not None:
        fastest = benchmark.stats.stats.min
        benchmark.extra_info["M body-steps/s"] = round(bodies * steps / fastest / 1e6, 1)


@pytest.mark.benchmark(group="coning ensemble")
@pytest.mark.parametrize(("method", "representation", "dtype"), CASES)
def test_method(benchmark, problem, method, representation, dtype):
    def run() -> fa.Trajectory:
        return fa.propagate(
            problem.scene, problem.q0, dt=T_END / N_STEPS, n_steps=N_STEPS, method=method,
            representation=representation, dtype=dtype,
        )  # fmt: skip

    result = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    benchmark.extra_info["error, rad"] = problem.error(result.q[-1], T_END)
    _steps_per_second(benchmark, N_BODIES, N_STEPS)


@pytest.mark.benchmark(group="coning ensemble")
def test_reference_numpy_rk4(benchmark, problem):
    """The reference: the same RK4, vectorised over bodies in plain numpy, one thread."""
    q = benchmark.pedantic(numpy_rk4, args=(problem, 20), rounds=3, warmup_rounds=1)
    benchmark.extra_info["error, rad"] = problem.error(q, T_END)
    _steps_per_second(benchmark, N_BODIES, 20)


@pytest.mark.benchmark(group="rate shared, constant or polynomial: magnus4")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("model", ["constant", "polynomial"])
def test_rate_models(benchmark, model, dtype):
    generator = np.random.default_rng(5)
    rate = {
        "constant": fa.rates.Constant(generator.normal(size=(N_BODIES, 3))),
        "polynomial": fa.rates.Polynomial(generator.normal(size=(N_BODIES, 3, 3))),
    }[model]
    scene, h = fa.Scene(rate=rate), 1e-3
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (N_BODIES, 1))

    def run(steps: int = N_STEPS, dt: float = h, method: str = "magnus4", kind: str = dtype):
        return fa.propagate(scene, q0, dt=dt, n_steps=steps, method=method, dtype=kind).q[-1]

    q = benchmark.pedantic(run, rounds=5, warmup_rounds=1)
    fine = run(2 * N_STEPS, 0.5 * h, "magnus6", "float64")
    benchmark.extra_info["error, rad"] = float(np.median(fa.angle_between(q.astype(float), fine)))
    _steps_per_second(benchmark, N_BODIES, N_STEPS)
