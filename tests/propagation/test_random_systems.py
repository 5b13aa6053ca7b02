"""States, breakpoints and events together: 40 random systems beside DOP853 with its own events.

All bodies are one ensemble. The reference starts anew at each breakpoint.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from each import in_tiers
from exact import RALSTON3
from scipy.integrate import solve_ivp

import fastatt as fa
from fastatt.propagation.choice_of_method import methods_for

N = 40
BREAKS, END, DT = (0.83, 1.91, 2.5, 3.333), 4.0, 0.02
RNG = np.random.default_rng(11)
MOMENTS = RNG.uniform(1.0, 1.4, (N, 3))
MASS = RNG.uniform(1.0, 3.0, N)
# stiffness, damping, reset, pulse, lag, misalignment, friction, wheel torque; a third of them 0
PARAMS = RNG.uniform(0.2, 1.0, (N, 8)) * (RNG.uniform(size=(N, 8)) > 1 / 3)
# thrust, drag, pull to the origin
FORCE = RNG.uniform(0.2, 1.0, (N, 3)) * (RNG.uniform(size=(N, 3)) > 1 / 3)
Q0 = RNG.normal(size=(N, 4))
START = {
    "q0": Q0 / np.linalg.norm(Q0, axis=1)[:, None],
    "w0": RNG.normal(size=(N, 3)),
    "v0": RNG.normal(size=(N, 3)),
    "r0": RNG.normal(size=(N, 3)),
    "s0": RNG.normal(scale=0.3, size=(N, 3)),
}


def is_open(t):
    return 0.83 < t < 1.91 or 2.5 < t < 3.333


def torque(t, q, w, s, p):
    """PID about one axis, a thruster behind a valve with a lag, and a wheel with friction."""
    integral, valve, h = s
    error = 2.0 * q[0] * q[1]
    on_wheel = p[7] * math.sin(3.0 * t) - p[6] * h
    acting = (
        -p[0] * error - p[1] * w[0] - p[2] * integral - h * w[1],
        h * w[0] + p[5] * valve,
        -on_wheel + (p[3] if is_open(t) else 0.0),
    )
    return acting, (error, p[4] * ((1.0 if is_open(t) else 0.0) - valve), on_wheel)


def force(t, q, w, v, r, s, p):
    pull = fa.kernels.quat.rotate_inverse(q, r)
    return (
        p[0] * s[1] - p[1] * v[0] - p[2] * pull[0],
        -p[1] * v[1] - p[2] * pull[1],
        -p[1] * v[2] * s[1] - p[2] * pull[2],
    )


def wheel_limit(t, q, w, s, p):
    return s[2] - 0.1


def height(t, q, w, p):
    return 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])


def distance(t, q, w, v, r, p):
    return r[0] * r[0] + r[1] * r[1] + r[2] * r[2] - 2.0


def power(t, q, w, v, r, s, p):
    return p[3] * w[2] + s[1] * v[0] - 0.1 * r[2]


EVENTS = [
    fa.event(wheel_limit), fa.event(height, -1), fa.event(distance), fa.event(power, 1),
    fa.event(height, 1),
]  # fmt: skip
SCENE = fa.Scene(
    inertia=MOMENTS,
    torque=torque,
    params=PARAMS,
    states=3,
    mass=MASS,
    force=fa.forces.Custom(force, FORCE, uses_position=True),
    breakpoints=BREAKS,
)


def parts(y):
    return tuple(y[:4]), tuple(y[4:7]), tuple(y[7:10]), tuple(y[10:13]), tuple(y[13:])


def truth(body):
    """(state at the end, times of the events)."""
    (a, b, c), mass = MOMENTS[body].tolist(), float(MASS[body])
    own, push = tuple(PARAMS[body].tolist()), tuple(FORCE[body].tolist())

    def slope(t, y, inside):
        (i, j, k, l), (x, y_, z), v, r, s = parts(y.tolist())  # noqa: E741
        size = math.hypot(i, j, k, l)
        q, w = (i / size, j / size, k / size, l / size), (x, y_, z)
        found, change = torque(inside(t), q, w, s, own)
        f = force(inside(t), q, w, v, r, s, push)
        turned = (-j * x - k * y_ - l * z, i * x + k * z - l * y_, i * y_ + l * x - j * z)
        return [
            *(0.5 * u for u in (*turned, i * z + j * y_ - k * x)),
            (found[0] + (b - c) * y_ * z) / a,
            (found[1] + (c - a) * z * x) / b,
            (found[2] + (a - b) * x * y_) / c,
            f[0] / mass - (y_ * v[2] - z * v[1]),
            f[1] / mass - (z * v[0] - x * v[2]),
            f[2] / mass - (x * v[1] - y_ * v[0]),
            *fa.kernels.quat.rotate(q, v),
            *change,
        ]

    def watched(k):
        def g(t, y, inside):
            q, w, v, r, s = parts(y.tolist())
            given = {4: (q, w), 5: (q, w, s), 6: (q, w, v, r), 7: (q, w, v, r, s)}
            function = EVENTS[k].function
            return function(t, *given[function.__code__.co_argcount], own)

        g.direction = EVENTS[k].direction
        return g

    y, times = np.concatenate([START[name][body] for name in START]), np.full(len(EVENTS), np.nan)
    for begin, end in pairwise((0.0, *BREAKS, END)):
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin) * (1.0 - 1e-15)
        made = solve_ivp(
            slope, (begin, end), y, "DOP853", rtol=1e-13, atol=1e-13, max_step=0.1,
            events=[watched(k) for k in range(len(EVENTS))],
            args=(lambda t, m=middle, h=half: min(max(t, m - h), m + h),),
        )  # fmt: skip
        y = made.y[:, -1]
        firsts = [x[0] if x.size else np.nan for x in made.t_events]
        times = np.where(np.isnan(times), firsts, times)
    return y, times


def largest(run, wanted):
    """The largest difference of a run's end from states (N, 16)."""
    found = [np.abs(fa.angle_between(run.q[-1], wanted[:, :4])).max()]
    for name, part in zip("wvrs", np.split(wanted[:, 4:], (3, 6, 9), axis=1), strict=True):
        found.append(np.abs(getattr(run, name)[-1] - part).max())
    return max(found)


@pytest.fixture(scope="module")
def reference():
    ends, times = zip(*(truth(body) for body in range(N)), strict=True)
    return np.array(ends), np.array(times)


def test_states_breakpoints_and_events_are_those_of_dop853(reference):
    ends, times = reference
    assert all(f.followed for f in SCENE.functions)
    run = fa.propagate(SCENE, **START, dt=DT, t_end=END, method="rk8", events=EVENTS)
    assert largest(run, ends) < 1e-11
    np.testing.assert_allclose(run.event_times, times, rtol=0.0, atol=1e-9)
    assert (np.isfinite(times).sum(axis=0) > 5).all()
    assert (np.isnan(times).sum(axis=0) > 0).any()


LADDERS = {"rk4": (80, 160), "rk8": (10, 20), "rk9": (8, 16), "gbs16": (4, 6), RALSTON3: (80, 160)}


@pytest.mark.parametrize("method", in_tiers(["rk4"], [*methods_for(SCENE), RALSTON3]), ids=str)
def test_order_across_breakpoints_with_states(method, reference):
    """The largest error of the ensemble falls as local errors of all parts of steps do together."""
    steps = LADDERS[method]
    order = method.order if method is RALSTON3 else fa.METHODS[method].order
    runs = [fa.propagate(SCENE, **START, dt=END / n, n_steps=n, method=method) for n in steps]
    coarse, fine = (largest(run, reference[0]) for run in runs)
    parts = [np.diff(np.union1d(np.linspace(0.0, END, n + 1), BREAKS)) for n in steps]
    predicted = [(x ** (order + 1)).sum() for x in parts]
    assert fine > 1e-11
    assert math.log(coarse / fine) > 0.85 * math.log(predicted[0] / predicted[1])
