"""States beside the attitude: the cost of a user's function beside the same formulas in C.

A body under proportional, integral and derivative control of one wheel, with a motor that lags and
friction: attitude, angular momentum and three states, ten numbers, by ``rk4``.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
import peers_bodies as peers
import pytest

import fastatt as fa
from fastatt.trade.measure import best_time

SMOKE = bool(os.environ.get("FASTATT_SMOKE"))
N_BODIES, STEPS = (256, 20) if SMOKE else (16_384, 2000)
DT, MOMENTS = 0.01, (1.2, 1.0, 0.8)
# N·m/rad, N·m·s, N·m/(rad s), s, 1/s, N·m
GAINS = (0.8, 1.6, 0.15, 0.1, 0.001, 0.02)

SOURCE = r"""
enum { TILE = 64, SIZE = 10 };
typedef struct { double v[SIZE]; } state;
typedef struct { double stiffness, damping, reset, lag, friction, disturbance; } gains;
#define INLINE static inline __attribute__((always_inline))

INLINE state slope(state s, const double *j, gains p)
{
    const double x = j[0] * s.v[4], y = j[1] * s.v[5], z = j[2] * s.v[6], h = s.v[9];
    const double angle = 2.0 * s.v[0] * s.v[3];
    const double command = p.stiffness * angle + p.damping * z + p.reset * s.v[7];
    const double on_wheel = s.v[8] - p.friction * h;
    state r;
    r.v[0] = 0.5 * (-s.v[1] * x - s.v[2] * y - s.v[3] * z);
    r.v[1] = 0.5 * (s.v[0] * x + s.v[2] * z - s.v[3] * y);
    r.v[2] = 0.5 * (s.v[0] * y - s.v[1] * z + s.v[3] * x);
    r.v[3] = 0.5 * (s.v[0] * z + s.v[1] * y - s.v[2] * x);
    r.v[4] = s.v[5] * z - s.v[6] * y - y * h;
    r.v[5] = s.v[6] * x - s.v[4] * z + x * h;
    r.v[6] = s.v[4] * y - s.v[5] * x + p.disturbance - on_wheel;
    r.v[7] = angle;
    r.v[8] = (command - s.v[8]) / p.lag;
    r.v[9] = on_wheel;
    return r;
}

INLINE state add(state s, double h, state r)
{
    for (int e = 0; e < SIZE; e++) s.v[e] += h * r.v[e];
    return s;
}

/* y[10][bodies], a multiple of 64 bodies; j[3] inverse moments */
void rk4(double *y, const double *j, const double *g, long bodies, double h, long steps)
{
    const gains p = {g[0], g[1], g[2], g[3], g[4], g[5]};
    double t[SIZE][TILE] __attribute__((aligned(64)));
    for (long first = 0; first < bodies; first += TILE) {
        for (int e = 0; e < SIZE; e++)
            for (int i = 0; i < TILE; i++) t[e][i] = y[e * bodies + first + i];
        for (long n = 0; n < steps; n++)
            for (int i = 0; i < TILE; i++) {
                state s;
                for (int e = 0; e < SIZE; e++) s.v[e] = t[e][i];
                const state k1 = slope(s, j, p), k2 = slope(add(s, 0.5 * h, k1), j, p);
                const state k3 = slope(add(s, 0.5 * h, k2), j, p), k4 = slope(add(s, h, k3), j, p);
                s = add(add(add(add(s, h / 6, k1), h / 3, k2), h / 3, k3), h / 6, k4);
                for (int e = 0; e < SIZE; e++) t[e][i] = s.v[e];
            }
        for (int e = 0; e < SIZE; e++)
            for (int i = 0; i < TILE; i++) y[e * bodies + first + i] = t[e][i];
    }
}
"""


def wheel_control(t, q, w, s, p):
    integral, motor, momentum = s
    stiffness, damping, reset, lag, friction, disturbance = p
    angle = 2.0 * q[0] * q[3]
    command = stiffness * angle + damping * w[2] + reset * integral
    on_wheel = motor - friction * momentum
    torque = (-w[1] * momentum, w[0] * momentum, disturbance - on_wheel)
    return torque, (angle, (command - motor) / lag, on_wheel)


@cache
def compiled() -> ctypes._CFuncPtr:
    with tempfile.TemporaryDirectory() as folder:
        source, library = Path(folder, "states.c"), Path(folder, "states.so")
        source.write_text(SOURCE, encoding="ascii")
        flags = (*peers.C_FLAGS, "-mprefer-vector-width=512")
        subprocess.run(["gcc", *flags, str(source), "-o", str(library)], check=True)
        function = ctypes.CDLL(str(library)).rk4
    array = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
    function.argtypes = [array, array, array, ctypes.c_long, ctypes.c_double, ctypes.c_long]
    function.restype = None
    return function


@pytest.mark.skipif(not peers.has_c(), reason="no gcc")
@pytest.mark.benchmark(group="RK4 with three states beside the same loop in C, one core")
def test_states_beside_c(benchmark):
    """Interleaved; the ratio is the median of pairs."""
    generator = np.random.default_rng(3)
    q0 = generator.normal(size=(N_BODIES, 4)) * (0.1, 0.1, 0.1, 0.1) + (1.0, 0.0, 0.0, 0.0)
    q0 /= np.linalg.norm(q0, axis=1, keepdims=True)
    w0 = generator.normal(0.0, 0.1, (N_BODIES, 3))
    scene = fa.Scene(inertia=MOMENTS, torque=wheel_control, states=3, params=GAINS)

    def ours() -> fa.Trajectory:
        return fa.propagate(
            scene, q0, w0, s0=(0.0, 0.0, 0.0), dt=DT, n_steps=STEPS, method="rk4", n_threads=1
        )

    start = np.concatenate([q0, w0 * MOMENTS, np.zeros((N_BODIES, 3))], axis=1).T
    inverse, gains = 1.0 / np.array(MOMENTS), np.array(GAINS)
    ours()
    ratios = []
    for _ in range(1 if SMOKE else 9):
        y = np.ascontiguousarray(start)
        begun = time.perf_counter()
        compiled()(y, inverse, gains, N_BODIES, DT, STEPS)
        ratios.append((time.perf_counter() - begun) / best_time(ours, 1)[0])
    result = benchmark.pedantic(ours, rounds=1, warmup_rounds=0)
    benchmark.extra_info["speed of C's"] = round(float(np.median(ratios)), 3)
    benchmark.extra_info["difference of states"] = float(np.abs(result.s[-1] - y[7:].T).max())
    benchmark.extra_info["difference, rad"] = float(fa.angle_between(result.q[-1], y[:4].T).max())
