"""Functions of users that would give a finite number that is wrong: refused, or told."""

import math
import warnings

import numpy as np
import pytest
from each import each

import fastatt as fa

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
@each("representation", ("dcm", "mrp", "dcm_rows", "euler313"))
def test_a_function_that_differs_for_q_and_minus_q(name, representation):
    scene = fa.Scene(**ODD[name])
    with pytest.raises(ValueError, match=f"representation: found {representation} with .*−q"):
        fa.propagate(
            scene, *START, **RUN, **initial(scene), method="rk4", representation=representation
        )
    fa.propagate(scene, *START, **RUN, **initial(scene), method="rk4")


@each("torque", (even_by_choice, even_by_product))
def test_a_function_of_the_attitude_alone_is_accepted(torque):
    fa.propagate(
        fa.Scene(inertia=INERTIA, torque=torque), *START, **RUN, method="rk8", representation="dcm"
    )


@each("function", (
    lambda t, q, w, p: w, lambda time, quaternion, rate, gains: rate, lambda t, q, w, s: w,
    lambda _t, _q, w, _p: w,
))  # fmt: skip
def test_other_names_are_accepted(function):
    fa.Scene(inertia=INERTIA, torque=function)


def pushed(n):
    first = fa.Scene(
        inertia=INERTIA, torque=lambda t, q, w, p: (p[0], 0.0, 0.0), params=np.arange(1.0, n + 1.0)
    )
    return first, [START[0]] * n, [START[1]] * n


@each("n", (2, 3, 130))
def test_parameters_that_look_like_one_of_each_body(n):
    with pytest.warns(RuntimeWarning, match=rf"params: found \({n},\) with {n} bodies"):
        fa.propagate(*pushed(n), **RUN)


def test_parameters_that_all_bodies_share():
    scene, q0, w0 = pushed(3)
    both = fa.Scene(
        inertia=INERTIA, torque=lambda t, q, w, p: (p[0], p[1], p[2]), params=(1.0, 2.0, 3.0)
    )
    each_own = fa.Scene(
        inertia=INERTIA, torque=lambda t, q, w, p: (p[0], 0.0, 0.0), params=[[1.0], [2.0], [3.0]]
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fa.propagate(scene, q0[0], w0[0], **RUN)
        fa.propagate(both, q0, w0, **RUN)
        fa.propagate(each_own, q0, w0, **RUN)
