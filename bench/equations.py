"""The equations of motion that every peer is given, on floats, arrays, tracers and symbols alike.

The state is (q, w/2), which has the fewest products, or q alone where the rate is given. Parameters
of a body are the factors of Euler's equations and, in the potential of a heavy top, those of its
torque, half the size of a push, or those of the gravity gradient in a circular orbit; of coning,
the sizes and the frequency of half the rate. With three wheels along the axes half their momenta
follow the state, and the inverse moments and half the motors' torques the factors.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

FREE, TOP, PUSHED, ORBIT = "free", "top", "pushed", "orbit"
CONING, WHEELS = "coning", "wheels"
N_STATE = {FREE: 7, TOP: 7, PUSHED: 7, ORBIT: 7, CONING: 4, WHEELS: 10}
# products of two functions of time, sines among them: what a Taylor series pays for
N_PRODUCTS = {FREE: 15, TOP: 19, PUSHED: 18, ORBIT: 35, CONING: 10, WHEELS: 21}


def turn(q: Any, x: Any, y: Any, z: Any) -> Any:
    """q∘(0, x, y, z): the derivative of q at the rate 2 (x, y, z)."""
    return (
        -q[1] * x - q[2] * y - q[3] * z,
        q[0] * x + q[2] * z - q[3] * y,
        q[0] * y - q[1] * z + q[3] * x,
        q[0] * z + q[1] * y - q[2] * x,
    )


def slope(
    kind: str,
    sin: Callable[..., Any],
    cos: Callable[..., Any],
    compiled: Callable[..., Any] = lambda function: function,
) -> Callable[..., Any]:
    """f(t, y, p), the derivative of y as a tuple; ``compiled`` is applied to every function."""
    turned = compiled(turn)

    def free(t, y, p):
        spin = (p[0] * (y[5] * y[6]), p[1] * (y[6] * y[4]), p[2] * (y[4] * y[5]))
        return turned(y, y[4], y[5], y[6]) + spin  # Numba does not unpack

    def top(t, y, p):
        spin = (
            p[0] * (y[5] * y[6]) + p[3] * (y[0] * y[1] + y[2] * y[3]),
            p[1] * (y[6] * y[4]) + p[4] * (y[0] * y[2] - y[1] * y[3]),
            p[2] * (y[4] * y[5]),
        )
        return turned(y, y[4], y[5], y[6]) + spin

    def pushed(t, y, p):
        s = sin(t)
        spin = (p[0] * (y[5] * y[6]), p[1] * (y[6] * y[4]), p[2] * (y[4] * y[5]) + p[3] * (s * s))
        return turned(y, y[4], y[5], y[6]) + spin

    def orbit(t, y, p):
        c, s = cos(p[4] * t), sin(p[4] * t)
        o = (  # the radial direction in body axes
            c * (1.0 - 2.0 * (y[2] * y[2] + y[3] * y[3])) + 2.0 * s * (y[1] * y[2] + y[0] * y[3]),
            2.0 * c * (y[1] * y[2] - y[0] * y[3]) + s * (1.0 - 2.0 * (y[1] * y[1] + y[3] * y[3])),
            2.0 * (c * (y[1] * y[3] + y[0] * y[2]) + s * (y[2] * y[3] - y[0] * y[1])),
        )
        spin = (
            p[0] * (y[5] * y[6] - p[3] * (o[1] * o[2])),
            p[1] * (y[6] * y[4] - p[3] * (o[2] * o[0])),
            p[2] * (y[4] * y[5] - p[3] * (o[0] * o[1])),
        )
        return turned(y, y[4], y[5], y[6]) + spin

    def coning(t, y, p):
        return turned(y, -p[0] * sin(p[1] * t), p[0] * cos(p[1] * t), -p[2])

    def wheels(t, y, p):
        spin = (
            p[0] * (y[5] * y[6]) + p[3] * (2.0 * (y[8] * y[6] - y[9] * y[5]) - p[6]),
            p[1] * (y[6] * y[4]) + p[4] * (2.0 * (y[9] * y[4] - y[7] * y[6]) - p[7]),
            p[2] * (y[4] * y[5]) + p[5] * (2.0 * (y[7] * y[5] - y[8] * y[4]) - p[8]),
        )
        return turned(y, y[4], y[5], y[6]) + spin + (p[6], p[7], p[8])

    functions = {
        FREE: free, TOP: top, PUSHED: pushed, ORBIT: orbit, CONING: coning, WHEELS: wheels,
    }  # fmt: skip
    return compiled(functions[kind])


def of_body(inertia: np.ndarray, *, potential: bool = False) -> np.ndarray:
    """Parameters (..., 3), or (..., 5) of the heavy top whose weight times arm is 1 N·m."""
    i1, i2, i3 = np.moveaxis(np.asarray(inertia, float), -1, 0)
    factors = [2.0 * (i2 - i3) / i1, 2.0 * (i3 - i1) / i2, 2.0 * (i1 - i2) / i3]
    return np.stack([*factors, 1.0 / i1, 1.0 / i2] if potential else factors, axis=-1)


def of_push(inertia: np.ndarray) -> np.ndarray:
    """Parameters (4,) of a body whose third rate is pushed by 0.25 sin² t, rad/s²."""
    return np.append(of_body(inertia), 0.125)


def of_orbit(inertia: np.ndarray, mean_motion: float) -> np.ndarray:
    """Parameters (5,) of a body in a circular orbit, whose mean motion is in rad/s."""
    return np.append(of_body(inertia), [0.75 * mean_motion**2, mean_motion])


def of_wheels(inertia: np.ndarray) -> np.ndarray:
    """Parameters (9,) of a body with wheels whose motors are off."""
    return np.concatenate([of_body(inertia), 1.0 / np.asarray(inertia, float), np.zeros(3)])


def of_coning(angle: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    """Parameters (N, 3) of half angles (rad) and frequencies (rad/s)."""
    half = 0.5 * angle
    return np.stack(
        [0.5 * frequency * np.sin(angle), frequency, frequency * np.sin(half) ** 2], axis=-1
    )
