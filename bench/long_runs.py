"""Round-off over long runs: how errors grow with the number of steps, carried along or not.

    python bench/long_runs.py                    # 10^7 steps of 64 bodies, a minute
    python bench/long_runs.py --steps 1e9        # half an hour

Bodies turn at constant rates of 6e-3 rad a step, in all directions, so that a method's own error is
none; the angle is known to 40 digits, the length of the quaternion is 1. An exponent is the slope
of the logarithm of the root mean square over the bodies: 1 where rounding is biased, 0.5 where it
is random (Brouwer's law). The step is a power of two, so that its products are exact.

The second table is of free bodies and heavy tops that turn by some 4e-3 rad a step, where the
truncation error is below rounding, against their closed forms. An energy that walks at random makes
the rate, and with it the angle, drift: its exponent is above 1.
"""

from __future__ import annotations

import argparse
import os
import time
from functools import partial

import mpmath
import numpy as np

import fastatt as fa
from fastatt.trade.timing import time_in_turns

SMALL = bool(os.environ.get("FASTATT_SMOKE"))
# steps and bodies of the runs with many bodies, and at most of the long ones
MANY, BODIES, MOST = (2000, 50, 20_000) if SMALL else (100_000, 10_000, 10**12)
BODY_STEPS = 4096 if SMALL else 1 << 22
BODY_METHODS = {
    "free bodies": ("rk8", "rk9", "kahan_li8", "dmv10"),
    "heavy tops": ("rk8", "rk9", "kahan_li8"),
}
STEP = 1.0 / 128.0
TURN = 6e-3
BODY = (2.0, 1.0, 0.7)
MODES = {
    "plain": {},
    "normalised every step": {"normalise": 1},
    "compensated": {"compensated": True},
}


def exact_attitudes(w, t):
    """Attitudes (N, 4) at the time t of bodies that turn at rates w (N, 3) from (1, 0, 0, 0)."""
    rows = []
    with mpmath.workdps(40):
        for rate in w:
            v = [mpmath.mpf(float(x)) for x in rate]
            size = mpmath.sqrt(sum(x * x for x in v))
            half = size * mpmath.mpf(float(t)) / 2
            f = mpmath.sin(half) / size
            rows.append([float(mpmath.cos(half)), *(float(f * x) for x in v)])
    return np.array(rows)


def exponent(steps, errors):
    """Slope of log error over log steps."""
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def rms(x):
    return float(np.sqrt(np.mean(np.square(x, dtype=np.float64))))


def grow(method, mode, n_steps, n_bodies, dtype):
    """Errors of angle and length at 1-2-5 numbers of steps, and body-steps a second."""
    generator = np.random.default_rng(1)
    w = generator.normal(size=(n_bodies, 3))
    w = (w * (TURN / STEP) / np.linalg.norm(w, axis=1, keepdims=True)).astype(dtype)
    scene = fa.Scene(rate=fa.rates.Constant(w))
    least = max(1, n_steps // 10_000)
    marks = {k * least for d in range(5) for k in (1 * 10**d, 2 * 10**d, 5 * 10**d)}
    wanted = sorted(m for m in marks if m <= n_steps)
    rows = []

    def look(piece):
        for s in range(1, piece.t.size):
            n = round(piece.t[s] / STEP)
            if n in wanted:
                angle = fa.angle_between(
                    piece.q[s].astype(np.float64), exact_attitudes(w, n * STEP)
                )
                rows.append((n, rms(angle), rms(piece.norm_error[s])))

    start = time.perf_counter()
    q0 = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype), (n_bodies, 1))
    fa.propagate(
        scene, q0, dt=STEP, n_steps=n_steps, method=method, save_every=least, on_save=look,
        **MODES[mode],
    )  # fmt: skip
    return rows, n_bodies * n_steps / (time.perf_counter() - start)


def report(method, mode, n_steps, n_bodies, dtype):
    rows, speed = grow(method, mode, n_steps, n_bodies, dtype)
    n, angle, norm = np.array(rows).T
    print(
        f"| {method} | {dtype} | {mode} | {int(n[-1]):.0e} x {n_bodies} | {angle[-1]:.1e} | "
        f"{exponent(n, angle):.2f} | {norm[-1]:.1e} | {exponent(n, np.maximum(norm, 1e-20)):.2f} | "
        f"{speed / 1e6:.0f} |",
        flush=True,
    )


def spinning():
    """Free bodies and heavy tops, with initial values; each turns at 1 rad/s or little more."""
    w0 = np.random.default_rng(5).normal(size=(16, 3))
    w0 /= np.linalg.norm(w0, axis=1)[:, None]
    q0 = np.tile([1.0, 0.0, 0.0, 0.0], (16, 1))
    top = fa.torques.HeavyTop((0.0, 0.0, 0.1), 1.0)
    return {
        "free bodies": (fa.Scene(inertia=BODY), q0, w0),
        "heavy tops": (fa.Scene(inertia=(1.0, 1.0, 0.5), torque=top), q0, w0),
    }


def energies(scene, run):
    """Kinetic energies with the potential ones of a weight at the height of the arm's end, J."""
    height = 0.0 if scene.torque is None else fa.quat_rotate(run.q, scene.torque.arm)[..., 2]
    return fa.kinetic_energy(run.w, scene.inertia) + height


def report_bodies(label, method, mode, n_steps):
    """A row for a method and a mode: errors after the last step, and their exponents."""
    scene, q0, w0 = spinning()[label]
    steps = np.array([n_steps // 16, n_steps // 4, n_steps])
    run = fa.propagate(
        scene, q0, w0, dt=STEP / 2, n_steps=n_steps, save_at=steps * STEP / 2, method=method,
        **MODES[mode],
    )  # fmt: skip
    exact = fa.propagate(scene, q0, w0, dt=STEP / 2, n_steps=n_steps, save_at=run.t, method="exact")
    errors = {
        "angle": [rms(x) for x in fa.angle_between(run.q, exact.q)],
        "energy": [rms(x) for x in np.abs(energies(scene, run) / energies(scene, exact) - 1.0)],
        "norm": [rms(x) for x in run.norm_error],
    }
    cells = (f"{x[-1]:.1e} | {exponent(steps, np.maximum(x, 1e-20)):.2f}" for x in errors.values())
    print(f"| {label} | {method} | {mode} | {n_steps:.0e} | {' | '.join(cells)} |", flush=True)


def speeds():
    """Speed of each mode, that of the plain one being 1: coning and free bodies, 300 steps."""
    generator = np.random.default_rng(0)
    n = 256 if SMALL else 16384
    q0, w0 = generator.normal(size=(n, 4)), generator.normal(size=(n, 3))
    angle, frequency = generator.uniform(0.2, 1.5, n), generator.uniform(0.5, 2.0, n)
    coning = fa.Scene(rate=fa.rates.Coning(angle, frequency))
    for scene, rates, method in ((coning, None, "magnus4"), (fa.Scene(inertia=BODY), w0, "rk8")):
        calls = {**MODES, "normalised every ten steps": {"normalise": 10}}
        common = {"dt": 0.01, "n_steps": 300, "method": method, "n_threads": 1}
        plain, *_ = times = time_in_turns([
            partial(fa.propagate, scene, q0, rates, **common, **options)
            for options in calls.values()
        ])  # fmt: skip
        told = (f"{x} {plain.least / y.least:.2f}" for x, y in zip(calls, times, strict=True))
        print(f"{method}: " + ", ".join(told), flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=float, default=1e7, help="of 64 bodies, compensated")
    parser.add_argument("--method", default="magnus4", help="a method for prescribed rates")
    arguments = parser.parse_args()
    steps = min(int(arguments.steps), MOST)
    print(
        "| method | | mode | steps x bodies | angle, rad | exponent | norm | exponent | M steps/s |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for mode in MODES:
        report(arguments.method, mode, MANY, BODIES, "float64")
    for mode in ("plain", "compensated"):
        report(arguments.method, mode, MANY, BODIES, "float32")
    report(arguments.method, "plain", min(steps, 10**8), 64, "float64")
    report(arguments.method, "compensated", steps, 64, "float64")
    print()
    print(
        "| scene | method | mode | steps | angle, rad | exponent | energy | exponent | norm "
        "| exponent |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for label in spinning():
        for method in BODY_METHODS[label]:
            modes = ["plain"] + ["compensated"] * fa.METHODS[method].compensates
            for mode in modes:
                report_bodies(label, method, mode, BODY_STEPS)
    print()
    speeds()


if __name__ == "__main__":
    main()
