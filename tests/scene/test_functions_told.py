"""Functions of users that would give a finite number that is wrong: refused, or told."""

import math
import warnings
from functools import partial

import numpy as np
import pytest
from each import each

import fastatt as fa
from fastatt.attitudes import ATTITUDES

INERTIA = (3.0, 2.0, 1.0)
START = [0.5, 0.5, -0.5, 0.5], [0.1, 0.2, 0.3]
RUN = {"dt": 0.01, "n_steps": 3}


def odd_torque(t, q, w, p):
    return -q[1], -q[2], -q[3]


def odd_sometimes(t, q, w, p):
    return 0.3 * math.sin(t) * q[1] - 0.1 * w[0], 0.2 * q[2] * q[3], -0.15 * q[0] * q[1]


def odd_force(t, q, w, v, p):
    return q[0], 0.0, 0.0


def even_by_choice(t, q, w, p):
    side = 1.0 if q[0] >= 0.0 else -1.0
    return -side * q[1], -side * q[2], -side * q[3]


def even_by_product(t, q, w, p):
    return q[0] * q[1], 1.0 - 2.0 * q[2] ** 2, math.copysign(1.0, q[0]) * q[3]


def called(t, q, w, p):
    total = 0.0
    for k in range(int(3.0 + p[0])):
        total += k * q[1]
    return total, 0.0, 0.0


ODD = {
    "torque": {"inertia": INERTIA, "torque": odd_torque},
    "sometimes": {"inertia": INERTIA, "torque": odd_sometimes},
    "force": {"inertia": INERTIA, "mass": 2.0, "force": odd_force},
    "called": {"inertia": INERTIA, "torque": called, "params": (1.0,)},
    "term": {"inertia": INERTIA, "torque": fa.torques.Sum(
        [fa.torques.Damping(0.1), fa.torques.Custom(odd_torque)])},
    "sampled": {"inertia": INERTIA, "torque": fa.torques.SampledControl(odd_torque, 0.5)},
}  # fmt: skip


def initial(scene):
    more = {"s0": np.zeros(scene.states)} if scene.states else {}
    return more | ({"v0": [0.0, 0.0, 0.0]} if scene.moves else {})


@each("name", ODD)
def test_a_function_that_differs_for_q_and_minus_q(name):
    scene = fa.Scene(**ODD[name])
    run = partial(fa.propagate, scene, *START, **RUN, **initial(scene), method="rk4")
    for representation in set(ATTITUDES) - {"quat"}:
        with pytest.raises(ValueError, match=f"representation: found {representation} with .*−q"):
            run(representation=representation)
    run()


@each("torque", (even_by_choice, even_by_product))
def test_a_function_of_the_attitude_alone_is_accepted(torque):
    scene = fa.Scene(inertia=INERTIA, torque=torque)
    fa.propagate(scene, *START, **RUN, method="rk4", representation="dcm")


@each("function", (
    lambda t, q, w, p: w, lambda time, quaternion, rate, gains: rate, lambda t, q, w, s: w,
    lambda _t, _q, w, _p: w,
))  # fmt: skip
def test_other_names_are_accepted(function):
    fa.Scene(inertia=INERTIA, torque=function)


def pushed(n, params, torque=lambda t, q, w, p: (p[0], 0.0, 0.0)):
    scene = fa.Scene(inertia=INERTIA, torque=torque, params=params)
    return fa.propagate(scene, *([x] * n for x in START), **RUN, method="rk4")


def test_parameters_that_look_like_one_of_each_body():
    for n in (2, 3, 130):
        with pytest.warns(RuntimeWarning, match=rf"params: found \({n},\) with {n} bodies"):
            pushed(n, np.arange(1.0, n + 1.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pushed(1, (1.0, 2.0, 3.0))
        pushed(3, (1.0, 2.0, 3.0), lambda t, q, w, p: (p[0], p[1], p[2]))
        pushed(3, [[1.0], [2.0], [3.0]])
