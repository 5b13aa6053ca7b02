"""Of scenes: inertia, mass, rates, functions of users, tables, rows."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

import fastatt as fa
from fastatt import rates as r
from fastatt import torques as t

NAN, INF = np.nan, np.inf
MOMENTS, SPIN = (0.6, 0.8, 1.0), [0.9, -0.4, 1.2]
NOTHING = np.zeros((0, 3))
BODIES = fa.Scene(inertia=np.full((5, 3), 1.0))


def scene(**given):
    return partial(fa.Scene, **given)


def rate(model, **more):
    return scene(rate=model, **more)


def body(**more):
    return scene(inertia=MOMENTS, **more)


def inertia(moments, **more):
    return scene(inertia=moments, **more)


def tilted(*moments):
    c = fa.quat_to_dcm([0.9, 0.3, -0.2, 0.1])
    a = c @ np.diag(moments) @ c.T
    return 0.5 * (a + a.T)


SKEW = [[1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]


# functions of users


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


def by_series(t, p):
    total = 0.0
    while total < p[0]:
        total += HELD(t)
    return total, 0.0, 0.0


HELD = fa.TimeSeries([0.0, 1.0], [0.5, 0.5])


def beyond(t, q, w, p):
    return p[3], 0.0, 0.0


def braked(t, q, w, p):
    return -HELD(t) * w[0], 0.0, 0.0


def still(t, q, w, p):
    return 0.0, 0.0, 0.0


def of_states(t, q, w, s, p, gains=(1.0, 2.0)):
    return (-s[0], 0.0, 0.0), s[0]


def integral(t, q, w, s, p):
    return (-s[0], -s[1], -s[2]), q[1:]


def drawn(t, q, w, v, r, p):
    return r[1] + 0.2 * t, -r[0], -0.3 * v[2]


def damped(t, q, w, v, r, p):
    return -w[0], v[1], r[2]


def at_position(t, q, w, v, r, p):
    return 0.0, 0.0, r[2]


def of_all(t, q, w, v, r, s, p):
    return 0.0, 0.0, r[2] * s[1]


def thrust(t, q, w, v, s, p):
    return 0.0, -0.2 * v[1], p[0] * s[0]


AT_POSITION = t.Custom(drawn, uses_position=True)
MOVED = {"mass": 2.0, "force": (0.0, 0.0, 1.0)}
TORQUES = (
    "torque: found of_states(t, q, w, s, p, gains); accepted: torque(t, q, w, p), or with "
    "states=n torque(t, q, w, s, p), or with uses_position=True torque(t, q, w, v, r, p)"
)
FORCES = (
    "accepted: force(t, q, w, v, p), in a scene with states also force(t, q, w, v, s, p), and with "
    "uses_position=True force(t, q, w, v, r, p) or force(t, q, w, v, r, s, p)"
)
SYSTEM = {"inertia": MOMENTS, "torque": integral, "states": 3, "mass": 2.0}


def table(t, values, **options):
    return partial(fa.TimeSeries, t, values, **options)


UNPHYSICAL = [
    ("inertia is (1, 0, 1): a principal moment is not above 0", [1.0, 0.0, 1.0]),
    ("inertia is (1, -1, 1): a principal moment is not above 0", [1.0, -1.0, 1.0]),
    ("inertia is (1, 1, 2.6): no body has one moment above the sum of the others", [1, 1, 2.6]),
    ("…by more than 25%", [1.0, 1.0, 2.5 * (1.0 + 1e-9)]),
    ("inertia[2] is (3, 1, 1)", [[1.0, 1.0, 1.0]] * 2 + [[3.0, 1.0, 1.0], [1.0, 1.0, 1.0]]),
    ("inertia[1] is (1, 0, 1)", [[1.0, 1.0, 1.0], [1.0, 0.0, 1.0]]),
    ("inertia: the tensor is not symmetric, elements differ by 0.1", SKEW),
    ("inertia[1]: the tensor is not symmetric", [np.eye(3), SKEW]),
    ("…a principal moment is not above 0", tilted(-1.0, 1.0, 1.0)),
    ("…no body has one moment above the sum of the others", tilted(1.0, 1.0, 3.0)),
]

REFUSED = [
    ("rate, inertia: found neither; accepted: one of them", scene()),
    ("rate: found float; accepted: a model of fastatt.rates (Coning", rate(3.0), TypeError),
    ("rate: found <built-in function len>; accepted: a function rate(t", rate(len), TypeError),
    ("rate: Constant.w: has shape (2,); accepted: (3,", rate(r.Constant([1, 2]))),
    ("rate: Constant.w: has shape (0, 3)", rate(r.Constant(NOTHING))),
    ("rate: Constant.w[1] is nan", rate(r.Constant([1, NAN, 3]))),
    ("rate: Constant.w: found 'x'", rate(r.Constant("x")), TypeError),
    ("rate: Polynomial.coefficients: has shape (0", rate(r.Polynomial(NOTHING))),
    ("rate: Polynomial.coefficients: has shape (3,)", rate(r.Polynomial([1, 2, 3]))),
    ("rate: Coning.angle[1] is inf", rate(r.Coning([1, INF], 1))),
    ("rate: Coning.angle: has shape (0,) and is empty", rate(r.Coning([], 1.0))),
    ("rate: Coning: found parameters for 2 and", rate(r.Coning([1, 2], [1, 2, 3]))),
    ("rate: Slew.duration[1] is -2.0", rate(r.Slew([1, 2, 3], [1.0, -2.0]))),
    ("rate: Sum: Constant.w: has shape (2,)", rate(r.Sum((r.Constant([1, 2]),)))),
    ("rate: found a Sum with names, a; accepted: a sequence of terms",
     rate(r.Sum({"a": r.Constant(SPIN)}))),
    ("frame: found 'space'; accept", rate(r.Constant(SPIN), frame="space")),
    ("params: found [1] with the mode", rate(r.Constant(SPIN), params=[1])),
    ("rate, inertia: found both", rate(r.Constant(SPIN), inertia=MOMENTS)),
    ("torque: found with a rate", rate(r.Constant(SPIN), torque=t.Damping(0.1))),
    ("rate, inertia: found neither, with a torque, which needs", scene(torque=t.Damping(0.1))),
    ('frame: found "inertial" with inertia', body(frame="inertial")),
    ("…parameters for 2 and 4 bodies", inertia([MOMENTS] * 4, torque=t.Damping([[0.1], [0.2]]))),
    ("params: found … with the model Damping; accepted: ", body(torque=t.Damping(0.1), params=[1])),
    ("params: found … with the model NoneType; accepted: ", body(params=[1.0])),
    ("breakpoints: found for a free body; accepted", body(breakpoints=(1.0,))),
    ("breakpoints[1] is nan", body(torque=still, breakpoints=(1.0, NAN))),
    ("breakpoints: …(2, 1)…np.unique…Switch of t", body(torque=still, breakpoints=[[1.0], [2.0]])),
    ("breakpoints: ", body(torque=still, breakpoints="soon"), TypeError),
    # inertia
    ("inertia: has shape (2,); accepted: (3,), (3, 3), (N, 3)", inertia([1.0, 2.0])),
    ("inertia: has shape ()", inertia(1.0)),
    ("inertia: has shape (2, 3, 2)", inertia(np.ones((2, 3, 2)))),
    ("inertia: has shape (0, 3) and is empty; accepted: (3,)", inertia(NOTHING)),
    ("inertia: has shape (0, 3, 3) and is empty", inertia(np.zeros((0, 3, 3)))),
    ("inertia[1] is nan; accepted: finite numbers", inertia([1.0, NAN, 1.0])),
    ("inertia[0, 0, 0] is inf", inertia(np.full((2, 3, 3), INF))),
    ("inertia: found 'round'; accepted: real numbers", inertia("round"), TypeError),
    ("inertia: found", inertia([1j, 1.0, 1.0]), TypeError),
    ("inertia: found 1e+300; accepted: up to", inertia([1e300] * 3)),
    *[("inertia is …: too small; accepted: from 1e-100", inertia(x)) for x in (
        [1e-120, 1.0, 1.0], [1.0, 1e-120, 1.0], [1.0, 1.0, 1e-120])],
    *[(message + "…accepted: …allow_unphysical=True", inertia(x)) for message, x in UNPHYSICAL],
    ("inertia: …moments of three bodies as (3, 3, 3)…allow_unphysical=True",
     inertia([[1, 1, 1], [1, 1, 2.0], [1, 1, 1]])),
    ("inertia…a principal moment is 0; accepted: any other",
     inertia([1.0, 0.0, 1.0], allow_unphysical=True)),
    ("inertia: found 4 bodies; accepted: 5", lambda: fa.Scene(inertia=np.ones((4, 3))).packed(5)),
    ("inertia: …accepted: 1, … or 4 with q0 of shape (4, 4)",
     lambda: fa.Scene(inertia=np.ones((4, 3))).packed(1)),
    # rows
    ("inertia: has shape (0, 3)", lambda: BODIES[:0]),
    ("index 5 is out of bounds", lambda: BODIES[5], IndexError),
    ("too many indices", lambda: BODIES[0, 1], IndexError),
    ("…not iterable", lambda: iter(BODIES), TypeError),
    # mass, force, position
    ("force: is missing; mass and force go together", body(mass=1.0)),
    ("mass: is missing; mass and force go together", body(force=SPIN)),
    ("mass is 0.0; accepted: above 0, kg", body(mass=0.0, force=SPIN)),
    ("mass is 5e-324; accepted: above 0", body(mass=5e-324, force=SPIN)),
    ("mass[1] is -2.0; accepted: above 0, kg", body(mass=[1.0, -2.0], force=SPIN)),
    ("mass: has shape (0,) and is ", body(mass=[], force=SPIN)),
    ("force: Constant.force: has shape (2,); accepted:", body(mass=1.0, force=(1, 2))),
    ("force: found float; accepted: a model of", body(mass=1.0, force=3.0), TypeError),
    ("force: CentralGravity.gravitational_parameter is -1.0; acc",
     body(mass=1.0, force=fa.forces.CentralGravity(-1.0))),
    ("force: found a Sum with names",
     body(mass=1.0, force=fa.forces.Sum({"a": fa.forces.Constant((0, 0, 0))}))),
    *[("torque: found one that depends on the position", body(torque=x))
     for one in (t.CentralGravityGradient(), AT_POSITION)
     for x in (one, t.Sum((t.Damping(0.1), one)))],
    ("torque: found still(t, q, w, p); accepted: torque(",
     body(torque=t.Custom(still, uses_position=True)), TypeError),
    ("torque: …uses_rate False with damped, which gives",
     body(**MOVED, torque=t.Custom(damped, uses_rate=False, uses_position=True))),
    *[("force: found …; " + FORCES, scene(**SYSTEM, force=x), TypeError)
      for x in (at_position, of_all)],
    ("force: found …; " + FORCES, body(mass=2.0, force=thrust), TypeError),
    ("force: found of_all(", body(mass=2.0, force=fa.forces.Custom(of_all, uses_position=True)),
     TypeError),
    # functions of users
    ("rate: found two_numbers(t, p) with a result that is tuple of 2; accepted: 3 num",
     rate(two_numbers, params=[1.0, 2.0]), TypeError),
    ("rate: found an_array(t, p) with a result that is ndarray of 2; accepted: 3 numbers",
     rate(an_array, params=[1.0, 2.0]), TypeError),
    ("rate: …no_such_name(t, p), p of 2 numbers, is not followed: an error on every",
     rate(no_such_name, params=[1.0, 2.0]), TypeError),
    ("rate: …needs_three(t, p), p of 2 numbers, is not followed: an error on every path",
     rate(needs_three, params=[1.0, 2.0]), TypeError),
    ("rate: found one_argument(t); accepted: rate(t, p), or with states=n rate(t, s, p)",
     rate(one_argument), TypeError),
    (TORQUES, body(torque=of_states), TypeError),
    ("params: has shape (2, 2, 3); accepted: (P,) or (N, P",
     rate(needs_three, params=np.ones((2, 2, 3)))),
    ("params: found 'ab'", rate(needs_three, params="ab"), TypeError),
    ("params: has shape (0, 3) and is empty", rate(needs_three, params=NOTHING)),
    ("…params: found parameters for 3 bodies; accepted: 2",
     lambda: fa.Scene(rate=needs_three, params=np.ones((3, 3))).packed(2)),
    ("…by_series…not followed: a loop…not compiled: a TimeSeries", rate(by_series, params=[1.0]),
     TypeError),
    ("torque: …<lambda>(t, q, w, p)…a result that is tuple of 2; accepted: 3 numbers, N·m",
     body(torque=lambda t, q, w, p: (0.0, 1.0)), TypeError),
    ("torque: …<lambda>(t, q, w, p)…a result that is float; accepted: 3 numbers, N·m",
     body(torque=lambda t, q, w, p: 0.0), TypeError),
    ("torque: …beyond(t, q, w, p)…is not followed: an error on every path, such as IndexError: tup",
     body(torque=beyond, params=(1.0, 2.0)), TypeError),
    *[("…in the place of", body(torque=x), TypeError) for x in (
        lambda t, w, q, p: w, lambda time, omega, quat, p: omega, lambda q, t, w, p: w)],
    ("…in the place of", body(torque=lambda t, q, w, p, s: ((0.0, 0.0, 0.0), (s[0],)), states=1),
     TypeError),
    ("torque: found Custom.uses_rate False with braked",
     body(torque=t.Custom(braked, uses_rate=False))),
    # states
    ("states: found -1", body(torque=integral, states=-1)),
    ("states: found 1.5", body(torque=integral, states=1.5), TypeError),
    ("states: found 'three'", body(torque=integral, states="three"), TypeError),
    *[("states: found 2 with", body(torque=x, states=2)) for x in (None, t.Damping(0.1))],
    *[("torque: …a tuple of 2, the time derivatives of s", body(torque=x, states=2), TypeError)
      for x in (lambda t, q, w, s, p: (0.0, 0.0, s[0]),
                lambda t, q, w, s, p: ((0.0, 0.0, s[0]), s[:1]))],
    # tables
    ("t: found 1 time; accepted: at least 2", table([0.0], [1.0])),
    ("t[2] is 2.0 after 2.0; accepted: ascending", table([0, 2, 2], [1, 2, 3])),
    ("t[1] is nan; accepted: finite", table([0.0, NAN], [1, 2])),
    ("values: has shape (3,); accepted: (2,), (2, k) or", table([0, 1], [1, 2, 3])),
    ("values[1] is inf; accepted: finite", table([0, 1], [1, INF])),
    ("kind: found 'spline'; accepted: cubic,", table([0, 1], [1, 2], kind="spline")),
    ("outside: found 'wrap'; accepted: nan,", table([0, 1], [1, 2], outside="wrap")),
    ("slopes: found of shape (2,) for linea", table([0, 1], [1, 2], kind="linear", slopes=[0, 0])),
    ("t: found intervals from 1e-09 to 1 s; accepted: the short",
     table([0.0, 1e-9, 1.0], [1, 2, 3])),
    ("times: has shape (); accepted: (S,)", lambda: HELD.at(1.5)),
    ("row: found 1; accepted: table(t)", lambda: HELD(0.5, 1), TypeError),
    ("row: found None; accepted: table(t, row)", lambda: fa.TimeSeries([0, 1], [[[1], [2]]])(0.5),
     TypeError),
]  # fmt: skip
