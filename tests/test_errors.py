"""Wrong input: one message that names the argument, what was found and what is accepted."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from each import each
from exact import START, generic
from numba import njit

import fastatt as fa

SCENE = generic(2).shared
NAN, INF = np.nan, np.inf
Q = [1.0, 0.0, 0.0, 0.0]
LOG = np.full((20, 3), 0.1)
RATE_METHODS = [m.name for m in fa.METHODS.values() if "rate" in m.scenes]


def propagate(scene=SCENE, q0=START, **options):
    return fa.propagate(scene, q0, **{"dt": 0.1, "n_steps": 3, **options})


def changed(at, value, shape=(20, 3)):
    data = np.full(shape, 0.1)
    data[at] = value
    return data


PROPAGATE = [
    ({"q0": [1, 0, 0]}, ValueError, "q0: has shape (3,); accepted: (4,) or (N, 4)"),
    ({"q0": [Q, [0, 0, 0, 0]]}, ValueError, "q0[1] is the zero quaternion"),
    ({"q0": [Q, [1, 0, NAN, 0]]}, ValueError, "q0[1, 2] is nan; accepted: finite numbers"),
    ({"q0": "north"}, TypeError, "q0: found 'north'; accepted: real numbers"),
    ({"q0": [1j, 0, 0, 0]}, TypeError, "q0: found"),
    ({"dt": 0.0}, ValueError, "dt: found 0.0; accepted: a finite number other than 0"),
    ({"dt": "fast"}, TypeError, "dt: found 'fast'; accepted: a finite number"),
    ({"dt": [0.1, 0.2]}, ValueError, "dt: found 2 steps; accepted: one, or 1 of the bodies"),
    ({"dt": np.array([[0.1]])}, ValueError, "dt: has shape (1, 1); accepted: a number or (N,)"),
    ({"dt": 1e308}, ValueError, "dt: 3 steps of 1e+308 s from 0.0 s overflow"),
    ({"n_steps": 2**70}, ValueError, "n_steps: found 1180591620717411303424; accepted: a whole nu"),
    ({"q0": np.ma.array([1.0, 0, 0, 0], mask=[0, 0, 1, 0])}, ValueError, "q0[2] is nan"),
    ({"q0": np.array([list("abcd")] * 9)}, TypeError, "q0: found array([['a', 'b', 'c', 'd'], ["),
    ({"on_save": 3, "save_every": 1}, TypeError, "on_save: found 3; accepted: a function"),
    ({"n_steps": -1}, ValueError, "n_steps: found -1; accepted: a whole number of at least 0"),
    ({"n_steps": 2.0}, TypeError, "n_steps: found 2.0; accepted: a whole number"),
    ({"save_every": 0}, ValueError, "save_every: found 0"),
    ({"save_every": "all"}, TypeError, "save_every: found 'all'"),
    ({"n_threads": 0}, ValueError, "n_threads: found 0"),
    ({"t0": INF}, ValueError, "t0: found inf"),
    ({"dtype": np.int32}, TypeError, "dtype: found"),
    ({"dtype": "float16"}, TypeError, "dtype: found 'float16'; accepted: float64, float32 or None"),
    ({"representation": "matrix"}, ValueError, "representation: found 'matrix'; accepted: quat, d"),
    ({"method": "rk5"}, ValueError, "method: found 'rk5'; accepted: " + ", ".join(RATE_METHODS)),
    ({"method": "x" * 5000}, ValueError, "method: found 'xxxx"),
    ({"method": "magnus4", "representation": "euler313"}, ValueError, "method for representation "),
    ({"scene": fa.rates.Constant([0, 0, 1])}, TypeError, "scene: found Constant("),
    ({"scene": generic(3).scene, "q0": [Q, Q]}, ValueError, "found parameters for 3 bodies; accep"),
]


@each(("arguments", "error", "message"), PROPAGATE)
def test_propagate(arguments, error, message):
    with pytest.raises(error, match=re.escape(message)) as caught:
        propagate(**arguments)
    # one line, whatever was given
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 400


MOMENTS, SPIN = (0.6, 0.8, 1.0), [0.9, -0.4, 1.2]
BODY, TWO = fa.Scene(inertia=MOMENTS), fa.Scene(inertia=[MOMENTS] * 2)
DAMPING, DAMPINGS = fa.torques.Damping(0.1), fa.torques.Damping([[0.1], [0.2]])
DAMPED = fa.Scene(inertia=MOMENTS, torque=DAMPING)
BODIES = [
    ({"w0": None}, "w0: is missing; a scene with inertia needs (3,) or (N, 3), rad/s"),
    ({"w0": [1.0, 2.0]}, "w0: has shape (2,); accepted: (3,) or (N, 3)"),
    ({"w0": np.zeros((0, 3))}, "w0: has shape (0, 3)"),
    ({"w0": [SPIN, [0.0, INF, 0.0]]}, "w0[1, 1] is inf; accepted: finite numbers"),
    ({"w0": "fast"}, "w0: found 'fast'; accepted: real numbers of shape (3,)"),
    ({"scene": SCENE}, "w0: found, but this scene has none; a scene with inertia"),
    ({"q0": [Q] * 2, "w0": [SPIN] * 3}, "w0: found rows w0 3, q0 2; accepted: one number of"),
    ({"scene": TWO, "q0": [Q] * 5}, "inertia: found 2 bodies; accepted: 5"),
    ({"method": "magnus4"}, "method: found 'magnus4'; accepted: rk4, cf4"),
    ({"scene": DAMPED, "method": "dmv2"}, "method: found 'dmv2'; accepted: rk4, cf4, rkmk4"),
    ({"method": "strang2", "representation": "euler313"}, 'method for representation "euler313"'),
    ({"method": "strang2", "representation": "dcm_rows"}, 'method for representation "dcm_rows"'),
]


@each(("arguments", "message"), BODIES)
def test_propagate_bodies(arguments, message):
    with pytest.raises((TypeError, ValueError), match=re.escape(message)):
        propagate(**{"scene": BODY, "w0": SPIN} | arguments)


DIRECTIONS = [
    ({"v0": [1.0, 2.0]}, ValueError, "v0: has shape (2,); accepted: (3,), (M, 3) or (N, M, 3)"),
    ({"v0": [0.0, NAN, 1.0]}, ValueError, "v0[1] is nan"),
    ({"scene": generic(3).scene}, ValueError, "parameters for 3 bodies"),
    ({"scene": generic(3).scene, "v0": np.ones((2, 5, 3))}, ValueError, "parameters for 3 bodies"),
    ({"scene": BODY}, ValueError, "scene: found inertia, mass or states; accepted: a scene with"),
]


@each(("arguments", "error", "message"), DIRECTIONS)
def test_propagate_directions(arguments, error, message):
    options = {"scene": SCENE, "v0": [0.0, 0.0, 1.0], "dt": 0.1, "n_steps": 3, **arguments}
    with pytest.raises(error, match=re.escape(message)):
        fa.propagate_directions(options.pop("scene"), options.pop("v0"), **options)


R = fa.rates
SCENES = [
    ({"rate": 3.0}, TypeError, "rate: found float; accepted: a model of fastatt.rates (Coning"),
    ({"rate": None}, ValueError, "rate, inertia: found neither; accepted: one of them"),
    ({"rate": R.Constant([1, 2])}, ValueError, "rate: Constant.w: has shape (2,); accepted: (3,"),
    ({"rate": R.Constant([1, NAN, 3])}, ValueError, "rate: Constant.w[1] is nan"),
    ({"rate": R.Constant("x")}, TypeError, "rate: Constant.w: found 'x'"),
    ({"rate": R.Polynomial(np.zeros((0, 3)))}, ValueError, "Polynomial.coefficients: has shape (0"),
    ({"rate": len}, TypeError, "rate: found <built-in function len>; accepted: a function rate(t"),
    ({"inertia": [1e300, 1e300, 1e300]}, ValueError, "inertia: found 1e+300; accepted: up to"),
    (
        {"inertia": [1, 1, 1], "mass": 5e-324, "force": [0, 0, 1]},
        ValueError,
        "mass is 5e-324; accepted: above 0",
    ),
    ({"rate": R.Polynomial([1, 2, 3])}, ValueError, "Polynomial.coefficients: has shape (3,)"),
    ({"rate": R.Coning([1, INF], 1)}, ValueError, "rate: Coning.angle[1] is inf"),
    ({"rate": R.Coning([1, 2], [1, 2, 3])}, ValueError, "rate: Coning: found parameters for 2 and"),
    ({"rate": R.Slew([1, 2, 3], [1.0, -2.0])}, ValueError, "rate: Slew.duration[1] is -2.0"),
    ({"rate": R.Sum((R.Constant([1, 2]),))}, ValueError, "rate: Sum: Constant.w: has shape (2,)"),
    ({"rate": R.Constant([0, 0, 1]), "frame": "space"}, ValueError, "frame: found 'space'; accept"),
    ({"rate": R.Constant([0, 0, 1]), "params": [1]}, ValueError, "params: found [1] with the mode"),
    ({"rate": R.Constant(SPIN), "inertia": MOMENTS}, ValueError, "rate, inertia: found both"),
    ({"rate": R.Constant(SPIN), "torque": DAMPING}, ValueError, "torque: found with a rate"),
    ({"torque": DAMPING}, ValueError, "rate, inertia: found neither, with a torque, which needs"),
    ({"inertia": MOMENTS, "frame": "inertial"}, ValueError, 'frame: found "inertial" with inertia'),
    ({"inertia": [MOMENTS] * 4, "torque": DAMPINGS}, ValueError, "parameters for 2 and 4 bodies"),
]


@each(("arguments", "error", "message"), SCENES)
def test_scene(arguments, error, message):
    with pytest.raises(error, match=re.escape(message)):
        fa.Scene(**arguments)


@njit
def two_numbers(t, p):
    return t, t


@njit
def an_array(t, p):
    return np.array([t, t])


@njit
def no_such_name(t, p):
    return undefined(t), t, t  # noqa: F821


@njit
def one_argument(t):
    return t, t, t


@njit
def needs_three(t, p):
    return p[0], p[1], p[2]


@each(
    ("function", "message"),
    [
        (two_numbers, "found two_numbers(t, p) with a result that is tuple of 2; accepted: 3 num"),
        (an_array, "found an_array(t, p) with a result that is ndarray of 2; accepted: 3 numbers"),
        (no_such_name, "no_such_name(t, p), p of 2 numbers, is not followed: an error on every"),
        (needs_three, "needs_three(t, p), p of 2 numbers, is not followed: an error on every path"),
    ],
)
def test_users_rate_function(function, message):
    with pytest.raises(TypeError, match="^rate: " + re.escape(message)):
        fa.Scene(rate=function, params=[1.0, 2.0])


def test_another_number_of_arguments_is_said_to_be_so():
    """In one line, with the forms that take other arguments and how these are declared."""

    def of_states(t, q, w, s, p, gains=(1.0, 2.0)):
        return (-s[0], 0.0, 0.0), s[0]

    message = "rate: found one_argument(t); accepted: rate(t, p), or with states=n rate(t, s, p)"
    with pytest.raises(TypeError, match=f"^{re.escape(message)}$"):
        fa.Scene(rate=one_argument)
    message = (
        "torque: found of_states(t, q, w, s, p, gains); accepted: torque(t, q, w, p), or with "
        "states=n torque(t, q, w, s, p), or with uses_position=True torque(t, q, w, v, r, p)"
    )
    with pytest.raises(TypeError, match=f"^{re.escape(message)}$"):
        fa.Scene(inertia=[1, 1, 1], torque=of_states)
    assert fa.Scene(inertia=[1, 1, 1], torque=of_states, states=1).states == 1


@each(
    ("params", "error", "message"),
    [
        (np.ones((2, 2, 3)), ValueError, "params: has shape (2, 2, 3); accepted: (P,) or (N, P"),
        ("ab", TypeError, "params: found 'ab'"),
        (np.ones((0, 3)), ValueError, "params: has shape (0, 3)"),
    ],
)
def test_users_parameters(params, error, message):
    with pytest.raises(error, match=re.escape(message)):
        fa.Scene(rate=needs_three, params=params)


def test_rows_of_users_parameters_must_be_the_bodies():
    scene = fa.Scene(rate=needs_three, params=np.ones((3, 3)))
    with pytest.raises(ValueError, match=r"params: found parameters for 3 bodies; accepted: 2"):
        propagate(scene, [Q, Q])


SPANS = np.full(19, 0.1)


def spans(at, value):
    out = SPANS.copy()
    out[at] = value
    return out


SAMPLED = ["hold", "trapezoid", "previous", "coning2", "picard"]
OF_INCREMENTS = ["hold", "previous", "coning2", "picard"]
INTEGRATE = [
    ({"rates": np.ones(3)}, ValueError, "rates: has shape (3,); accepted: (n, 3) or (N, n, 3)"),
    ({"rates": np.ones((2, 2, 2, 3))}, ValueError, "rates: has shape (2, 2, 2, 3)"),
    ({"rates": [["a", "b", "c"]]}, TypeError, "rates: found"),
    ({"rates": changed(7, NAN)}, ValueError, "rates[7, 0] is nan; accepted: finite numbers"),
    ({"rates": changed((1, 5, 2), NAN, (2, 20, 3))}, ValueError, "rates[1, 5, 2] is nan"),
    ({"rates": changed((3, 1), NAN), "increments": True}, ValueError, "rates (increments)[3, 1] i"),
    ({"dt": 0.0}, ValueError, "dt: found 0.0"),
    ({"dt": -0.1}, ValueError, "dt: found -0.1"),
    ({"dt": SPANS[:-1]}, ValueError, "dt: has shape (18,); accepted: a number or (19,)"),
    ({"dt": SPANS, "increments": True}, ValueError, "dt: has shape (19,); accepted: a number or ("),
    ({"dt": spans(4, NAN)}, ValueError, "dt[4] is nan"),
    ({"dt": spans(4, 0.0)}, ValueError, "dt[4] is 0.0: a repeated time stamp"),
    ({"dt": spans(18, -0.1)}, ValueError, "dt[18] is -0.1: a decreasing time stamp"),
    ({"dt": spans(9, 1.5)}, ValueError, "dt[9] is 1.5: a gap; accepted: at most 1 s"),
    ({"dt": spans(9, 0.3), "max_gap": 0.2}, ValueError, "dt[9] is 0.3: a gap; accepted: at most 0"),
    ({"dt": SPANS, "max_gap": "no"}, TypeError, "max_gap: found 'no'"),
    ({"dt": SPANS, "max_gap": -1}, ValueError, "max_gap: found -1.0"),
    ({"dt": 0.3, "max_gap": 0.2}, ValueError, "dt: found 0.3; accepted: at most 0.2 s, max_gap"),
    ({"q0": np.zeros(4)}, ValueError, "q0 is the zero quaternion"),
    ({"q0": [Q, Q]}, ValueError, "q0: has shape (2, 4); accepted: (4,) or (1, 4), one a log"),
    ({"method": "rk4"}, ValueError, "method: found 'rk4'; accepted: " + ", ".join(SAMPLED)),
    (
        {"method": "trapezoid", "increments": True},
        ValueError,
        "method: found 'trapezoid'; accepted: " + ", ".join(OF_INCREMENTS),
    ),
]


@each(("arguments", "error", "message"), INTEGRATE)
def test_integrate_rates(arguments, error, message):
    options = {"rates": LOG, "dt": 0.1, "method": "hold", **arguments}
    with pytest.raises(error, match=re.escape(message)):
        fa.integrate_rates(options.pop("rates"), options.pop("dt"), **options)


def test_angles_too_large_for_the_precision():
    with pytest.raises(ValueError, match="rates: the angles overflow float64; accepted: smaller"):
        fa.integrate_rates(np.full((5, 3), 1e308), 10.0, method="hold")


def test_progress_needs_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with pytest.raises(ImportError, match="progress: needs tqdm"):
        propagate(progress=True)


def test_a_log_of_one_sample_has_no_intervals():
    q = fa.integrate_rates(LOG[:1], [], START, method="hold")
    assert q == pytest.approx(START[None], abs=1e-15)


def test_read_only_and_broadcast_arrays_are_taken():
    a = np.broadcast_to(START, (3, 4))
    b = np.full((3, 4), 0.5)
    b.flags.writeable = False
    expected = [fa.angle_between(START, b[0])] * 3
    assert fa.angle_between(a, b).tolist() == expected
    assert fa.quat_to_dcm(b).tolist() == fa.quat_to_dcm(b.copy()).tolist()
    assert fa.quat_multiply(a, b).tolist() == fa.quat_multiply(a.copy(), b.copy()).tolist()
