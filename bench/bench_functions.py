"""Time to make a scene of a user-defined torque: it is frozen, followed and tried beside Python.

Each round makes the functions anew, so that nothing of an earlier round is used.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import fastatt as fa

INERTIA = (2.0, 1.0, 2 / 3)
PARAMS = (0.4, 1.1, 0.05)
AXES = np.eye(3)[[0, 0, 1, 1, 2, 2]] * np.array([[1.0], [-1.0]] * 3)


def damper():
    """Damping about each axis."""

    def torque(t, q, w, p):
        return tuple(-p[2] * x for x in w)

    return torque


def saturated():
    """Feedback of the attitude and the rate, limited by its norm."""

    def torque(t, q, w, p):
        u = [-p[0] * q[0] * x - p[1] * y for x, y in zip(q[1:], w, strict=True)]
        size = math.sqrt(sum(x * x for x in u))
        if size > p[2]:
            u = [p[2] / size * x for x in u]
        return u

    return torque


def thrusters():
    """Six thrusters, each on beyond a dead zone."""

    def torque(t, q, w, p):
        u = np.zeros(3)
        for axis in AXES:
            if axis @ np.array(w) + 0.5 * (axis @ np.array(q[1:])) > p[2]:
                u -= 0.01 * axis
        return u

    return torque


@pytest.mark.parametrize("torque", [damper, saturated, thrusters], ids=lambda x: x.__name__)
def test_scene(benchmark, torque):
    """The scene, with its functions followed."""

    def start():
        return (torque(),), {}

    def make(function):
        return fa.Scene(inertia=INERTIA, torque=function, params=PARAMS)

    scene = benchmark.pedantic(make, setup=start, rounds=9, warmup_rounds=1)
    assert [x.followed for x in scene.functions] == [True]
