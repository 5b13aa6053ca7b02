"""Of models of torques: their numbers, controllers, wheels, terms that read each other."""

from __future__ import annotations

from functools import partial

import numpy as np

import fastatt as fa
from fastatt import torques as t

MOMENTS = (0.6, 0.8, 1.0)
ONE = [1.0, 0.0, 0.0, 0.0]
PD = t.QuaternionPD(1.0, 1.0)
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.48, -0.6, 0.64]])


def scene(torque):
    return partial(fa.Scene, inertia=MOMENTS, torque=torque)


def pd(*given):
    return scene(t.QuaternionPD(*given))


def wheels(**changes):
    return partial(t.ReactionWheels, **{"axes": AXES, "inertia": 0.02} | changes)


def driven(**options):
    return lambda: fa.Scene(inertia=(2.0, 1.5, 1.0), torque=wheels(**options)())


def without_wheels(whole, moment, axes=AXES[:3]):
    return lambda: t.ReactionWheels(axes, moment).body_inertia(whole)


def of_table(model, values, kind="cubic"):
    return scene(model(fa.TimeSeries([0, 1], values, kind=kind)))


def spin_up(t, q, w, s, p):
    return 0.1 * s[0], 0.0, 0.0, 0.0


def held(t, q, w, p):
    return w


def growth(t, q, w, other, s, p):
    return (0.0, 0.0, 0.0), (p[0] * other[0],)


def memory(t, q, w, s, p):
    return (0.0, 0.0, 0.0), s


HELD = t.SampledControl(held, 1.0, holds=3)
THREE, TURNED_OVER = np.ones((2, 3)), [ONE, np.negative(ONE)]


def terms(**named):
    return scene(t.Sum(named))


REFUSED = [
    ("torque: found float; accepted: a model of fastatt.torques (CentralGravityGradient",
     scene(3.0), TypeError),
    ("torque: found Constant; accepted: a model", scene(fa.rates.Constant([1.0, 0.0, 0.0])),
     TypeError),
    ("torque: found 'function'; accepted: a function torque(", scene(t.Custom("function")),
     TypeError),
    ("torque: Sum: found float; accepted: a model of", scene(t.Sum((t.Damping(1.0), 3.0))),
     TypeError),
    ("Sum.terms: is empty", lambda: t.Sum(())),
    ("Sum.terms: found 3.0; accepted", lambda: t.Sum(3.0), TypeError),
    ("torque: Damping.coefficient: found 'much'; accepted: real", scene(t.Damping("much")),
     TypeError),
    ("torque: Damping.coefficient is nan", scene(t.Damping(np.nan))),
    ("torque: …has shape (2,); accepted: a number, (1,) or (3,) per axis, (N, 1)",
     scene(t.Damping([0.1, 0.2]))),
    ("torque: Constant.torque: has shape (2,); accepted: (3,)", scene(t.Constant([1.0, 2.0]))),
    ("torque: Constant.torque[0, 1] is inf", scene(t.Constant([[1.0, np.inf, 0.0]]))),
    ("torque: HeavyTop.weight: has shape (1, 1)", scene(t.HeavyTop([0.0, 0.0, 1.0], [[1.0]]))),
    ("torque: MagneticDipole: found paramete",
     scene(t.MagneticDipole(np.ones((2, 3)), np.ones((4, 3))))),
    ("torque: …radial: its length is 7000000.0; accepted: 1",
     scene(t.GravityGradient(0.5, (7e6, 0, 0)))),
    ("torque: …radial·along is 0.8; accepted: 0",
     scene(t.GravityGradient(0.5, along=(0.8, 0.6, 0)))),
    ("torque: …radial: its length[1] is",
     scene(t.GravityGradient([0.5, 0.5], [(1, 0, 0), (0, 0, 0)]))),
    ("torque: QuaternionPD.target: has shape (3,)", pd(1.0, 1.0, [1.0, 0.0, 0.0])),
    ("torque: …target: its length is 1.41", pd(1.0, 1.0, (1, 1, 0, 0))),
    ("torque: QuaternionPD.stiffness is -1.0; accepted: 0 or more", pd(-1.0, 0.0)),
    ("torque: QuaternionPD.damping[1] is -2.0; accepted: 0 or more", pd(1.0, (1, -2, 1))),
    ("torque: …its lowest eigenvalue is -1.0; accepted", pd(np.diag([1.0, 1.0, -1.0]), 0.0)),
    ("torque: …damping: its asymmetry is 4.0; accept", pd(1.0, np.arange(9.0).reshape(3, 3))),
    ("torque: …shape (2,); accepted: a number, (3,) per axis, (1, 1) or", pd([1.0, 2.0], 1.0)),
    ("torque: QuaternionPD.limit is 0.0; accepted: above 0", pd(1.0, 1.0, ONE, 0.0)),
    ("torque: …limit: has shape (2,); accepted: a num", pd(1.0, 1.0, ONE, (1.0, 2.0))),
    # tables
    ("torque: Rotor.momentum: found <TimeSeries: 4 numbers, 0 s",
     of_table(t.Rotor, np.ones((2, 4)))),
    *[(f'torque: …found a table of kind "{kind}"; accepted: "cubic"',
     of_table(t.Rotor, THREE, kind)) for kind in ("linear", "previous")],
    ("torque: Damping.coefficient: found <TimeSeries: 1 numbers, 0 s to",
     of_table(t.Damping, [1, 2])),
    ("torque: QuaternionPD.target of row 0 changes its sign, or rotates by π or more, after",
     of_table(lambda table: t.QuaternionPD(1.0, 1.0, table), TURNED_OVER)),
    # sampled controllers
    ("SampledControl.period: found 0.0; accepted: above 0",
     lambda: t.SampledControl(PD, period=0.0)),
    ("SampledControl.control: found 3; accepted: a funct", lambda: t.SampledControl(3, 0.1),
     TypeError),
    ("torque: SampledControl.control: Damping.c… is nan",
     scene(t.SampledControl(t.Damping(np.nan), 0.1))),
    ("SampledControl…params, states, holds or reads beside a model",
     lambda: t.SampledControl(PD, 0.1, params=(1.0,))),
    ("torque: …found a model with 4 states; accepted: a model without",
     scene(t.SampledControl(t.Custom(memory, states=4), 0.1))),
    ("torque: found 64 sampled controllers; accepted: up to 63", scene(t.Sum([HELD] * 64))),
    # wheels
    *[("ReactionWheels.axes: …accepted: (K, 3)", wheels(axes=x))
     for x in ([1.0, 0.0, 0.0], AXES.T)],
    ("ReactionWheels.axes: its length", wheels(axes=[[2.0, 0.0, 0.0]])),
    ("ReactionWheels.inertia: …accepted: a number, (1,) or (4,)", wheels(inertia=[1.0, 2.0])),
    ("ReactionWheels.inertia is 0.0; accepted: above 0", wheels(inertia=0.0)),
    ("ReactionWheels.viscous is -1.0; accepted: 0 or more", wheels(viscous=-1.0)),
    ("ReactionWheels.max_torque[3] is -0.1; accepted: 0 or m", wheels(max_torque=[1, 1, 1, -0.1])),
    ("ReactionWheels.max_speed is 0.0; accepted: above 0", wheels(max_speed=0.0)),
    ("ReactionWheels.command: found 3.0; accepted: a function command(", wheels(command=3.0),
     TypeError),
    *[(f"ReactionWheels.{x}: found beside", wheels(command=t.Damping(1.0), **{x: 1}))
     for x in ("params", "period", "states")],
    ("ReactionWheels.period…0.0; accepted: above 0", wheels(command=spin_up, period=0.0)),
    ("ReactionWheels.states: found without command; accepted: with a function", wheels(states=2)),
    ("…that is tuple of 2; accepted: 4 numbers", driven(command=lambda t, q, w, s, p: (t, t)),
     TypeError),
    ("…spin_up(t, q, w, s, p)", driven(command=spin_up, states=2), TypeError),
    *[("inertia: its lowest moment …; accepted: above 0", without_wheels(*x))
     for x in (((3.0, 2.0, 1.0), 2.5), (np.eye(3), 1.0))],
    ("inertia: its lowest moment without wheels[1] is -1",
     without_wheels((3.0, 3.0, 3.0), [[0.1], [4.0]], [[0, 0, 1]])),
    ("…ReactionWheels.command: found SampledControl with holds, which exerts nothing",
     driven(axes=AXES[:3], command=HELD)),
    # terms by name
    ("Sum.terms: found the name 'b c'; accepted: identifiers",
     lambda: t.Sum({"a": t.Custom(growth, reads="b"), "b c": HELD})),
    ("Sum.terms: found a Sum with", lambda: t.Sum({"a": t.Sum([HELD])})),
    ("Sum.terms: found the name 'b' twice", scene(t.Sum([t.Sum({"b": HELD}), t.Sum({"b": HELD})]))),
    ("torque: Sum: reads: found 'c'; accepted: 'a', 'b'",
     terms(a=t.Custom(growth, states=1, reads="c"), b=HELD)),
    ("torque: reads: found 'c'; accepted: names of terms that show numbers, of torques.Sum",
     scene(t.Custom(growth, states=1, reads="c"))),
    ("…QuaternionPD.target: found 'b', which has 3 numbers; accepted: 4",
     terms(a=t.QuaternionPD(1.0, 1.0, target="b"), b=HELD)),
    ("…Damping.coefficient: found 'b'", terms(a=t.Damping("b"), b=HELD), TypeError),
    ("Custom.reads: found 3; accepted: a name", lambda: t.Custom(held, reads=3), TypeError),
    ("SampledControl.reads: found", lambda: t.SampledControl(held, 1.0, reads=[3]), TypeError),
    ("torque: …torque(t, q, w, b, p), or with states=n …=True torque(t, q, w, v, r, b, p)",
     terms(a=t.Custom(held, reads="b"), b=HELD), TypeError),
]  # fmt: skip
