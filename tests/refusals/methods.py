"""Of methods: those that do not fit, those of one's own that are none, and single steps."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from exact import generic

import fastatt as fa
from fastatt import torques as t
from fastatt.kernels import vec3

ONE, SPIN = (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3)
CONING = generic(2).shared
BODY = fa.Scene(inertia=(2.0, 1.0, 0.8))
TORQUED = fa.Scene(inertia=(2.0, 1.0, 0.8), torque=t.QuadraticDamping(0.1))
TABLEAU = {"c": (0, 1 / 2, 3 / 4), "a": ((1 / 2,), (0, 3 / 4)), "b": (2 / 9, 1 / 3, 4 / 9)}


def run(scene, method, **options):
    w0 = None if scene is CONING else SPIN
    return partial(fa.propagate, scene, ONE, w0, dt=0.1, n_steps=1, method=method, **options)


def tableau(**changes):
    return partial(fa.runge_kutta, **{"name": "wrong", "order": 3, **TABLEAU, **changes})


def middle(w, t, h):
    return (tuple(h * x for x in w(t + 0.5 * h)),)


def group(exponents=middle, **changes):
    return partial(fa.lie_group, **{"name": "mine", "order": 2, "exponents": exponents, **changes})


def endless(w, t, h):
    u = w(t)
    while u[0] > 0.0:
        u = (u[0] - h, u[1], u[2])
    return (u,)


def shifted(power):
    """Exponents that are off by a power of the step."""

    def exponents(w, t, h):
        u = w(t + 0.5 * h)
        return ((h * u[0] + 1e-4 * h**power, h * u[1], h * u[2]),)

    return group(exponents)


MINE = group()()
FEW = "exponents: found a function that gives no tuple of exponents made from w(t); accepted: f(w, "
CONSTANT = "exponents: at the constant rate "
OTHER = CONSTANT + "(0.3, -0.5, 0.7) they add up to h "
STUDY = partial(fa.work_precision, t_end=1.0, dtypes=["float64"])


def one_step(scene=BODY, **options):
    return partial(fa.single_step, scene, **options)


def state_of(body):
    scene = fa.Scene(inertia=[[2.0, 1.0, 0.7], [1.0, 2.0, 1.5]])
    return lambda: fa.single_step(scene, method="rk4").state(ONE, SPIN, body=body)


def start(*given):
    return lambda: fa.single_step(CONING, method="magnus4").state(*given)


UNFIT = [
    (BODY, "magnus4", "magnus4 needs a rate; this scene has inertia"),
    (CONING, "dmv2", "dmv2 needs inertia; this scene has a rate"),
    (TORQUED, "dmv2", "dmv2 is for spherical, symmetric, free bodies; this is torqued"),
    (TORQUED, "strang2", "strang2 needs a torque that does not depend on w, but for linear"),
    (TORQUED, "hold", "hold is for samples: fastatt.integrate_rates"),
    (TORQUED, "RK45", "nearest: rk8"),
    (TORQUED, "RK_4", "nearest: rk4"),
    (TORQUED, "gbs", "nearest: gbs16"),
]

REFUSED = [
    *[(f"method: found '{method}'; accepted: …({reason}", run(scene, method))
      for scene, method, reason in UNFIT],
    ("method: found 'dmv2'; accepted: rk4, cf4, rkmk4, rk8, rk9, gbs16", run(TORQUED, "dmv2")),
    ("method: found 'mine'; …(mine ", run(BODY, MINE)),
    ("method: found 'dmv2'; …(dmv2 ", run(CONING, fa.METHODS["dmv2"])),
    ("method for representation \"euler313\": found 'mine'; accepted: rk4",
     run(CONING, MINE, representation="euler313")),
    ("methods: found mine, for rate; accepted … (free): ",
     partial(STUDY, BODY, ONE, SPIN, methods=[MINE])),
    # tableaux
    ("a[1]: its sum is 0.85; accepted: the node c[2]", tableau(a=((1 / 2,), (0.1, 3 / 4)))),
    ("a, b: a condition of order 1 gives 0.888888888888", tableau(b=(2 / 9, 1 / 3, 3 / 9))),
    ("a, b: a condition of order 2 gives 0.444444444444", tableau(b=(3 / 9, 2 / 9, 4 / 9))),
    ("a, b: a condition of order 4 gives", tableau(order=4)),
    ("order: found 0; accepted: a whole number of at least 1", tableau(order=0)),
    ("order: found 3.0; accepted: a whole number", tableau(order=3.0), TypeError),
    ("c, a, b: found 3 nodes, 1 rows and 3 weights; accepted: as", tableau(a=((1 / 2,),))),
    ("a[1]: found 1 numbers; accepted: 2", tableau(a=((1 / 2,), (3 / 4,)))),
    ("c[0]: found 0.1; accepted: 0, of an explicit method", tableau(c=(0.1, 1 / 2, 3 / 4))),
    ("b[0] is nan; accepted: finite numbers", tableau(b=(math.nan, 1 / 3, 4 / 9))),
    ("c: has shape (); accepted: (s,)", tableau(c=3)),
    ("b: found 'abc'; accepted: real numbers of shape (s,)", tableau(b="abc"), TypeError),
    ("name: found ''; accepted: a name", tableau(name=""), TypeError),
    ("limit: found 0.0; accepted: above 0, rad", tableau(limit=0.0)),
    # exponents
    *[(FEW, group(x))
     for x in (lambda w, t, h: ((h, h, h),), lambda w, t, h: (w(t)[:2],), lambda w, t, h: w(t))],
    (OTHER + "(0.15, -0.25, 0.35); accepted: h w",
     group(lambda w, t, h: (vec3.scale(0.5 * h, w(t)),))),
    (OTHER, group(lambda w, t, h: (w(t),))),
    *[(CONSTANT, shifted(power)) for power in (2, 3, 6)],
    *[("exponents: ", group(x), TypeError)
     for x in (endless, lambda w, t: (w(t),), lambda w, t, h: (np.linalg.det(w(t)),))],
    ("exponents: found 3; accepted: a function", group(3), TypeError),
    ("exponents, body: found neither", group(None), TypeError),
    ("body: found 3; accepted: a function", group(body=3), TypeError),
    *[("body: found a function that gives no tuple of exponents", group(body=x))
      for x in (lambda s, t, h, m: s(t, (), m), lambda s, t, h, m: (s(t, (), m), m, m),
                lambda s, t, h, m: ((m,), m))],
    ("body: at the constant rate (0.3, -0.5, 0.7) they add up to h (0.3, -0.5, 0.7), and d at",
     group(body=lambda s, t, h, m: (
         (vec3.scale(h, s(t, (), m)[0]),), vec3.scale(2.0 * h, s(t, (), m)[1])))),
    ("order: found 0; accepted: a whole number of at least 1", group(order=0)),
    ("limit: found 0.0; accepted: above 0, rad", group(limit=0.0)),
    ("limit: found nan", group(limit=math.nan)),
    ("limit: found 'far'", group(limit="far"), TypeError),
    ("name: found ''; accepted: a name", group(name=""), TypeError),
    ("name: found 'rk4', a method of the library; accepted: another", group(name="rk4")),
    # single steps
    ("method: found 'exact'; accepted: rk4, cf4", one_step(method="exact")),
    ("method: found 'mine'; accepted: rk4, cf4, … (mine needs a rate", one_step(method=MINE)),
    ("representation: found 'gibbs'", one_step(representation="gibbs")),
    ("position: found True", one_step(position=True)),
    ("scene: found 3", one_step(3), TypeError),
    ("scene: found a sampled controller; accepted",
     one_step(fa.Scene(inertia=(2.0, 1.0, 0.8), torque=t.SampledControl(t.Damping(0.1), 0.25)))),
    ("dtype", one_step(dtype="int"), TypeError),
    *[("body: found", state_of(x)) for x in (2, -1)],
    ("state: found 2 arguments; accepted: q", start(ONE, (1.0, 0.0, 0.0)), TypeError),
    ("q is the zero quaternion", start((0.0, 0.0, 0.0, 0.0))),
]  # fmt: skip
