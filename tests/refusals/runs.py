"""Of runs: ``propagate``, ``resume``, ``plan``, events, what is read off a trajectory, advice."""

from __future__ import annotations

import functools
from functools import partial

import numpy as np
from exact import RALSTON3, START, generic

import fastatt as fa
from fastatt import torques as t

NAN, INF = np.nan, np.inf
Q, SPIN, MOMENTS = [1.0, 0.0, 0.0, 0.0], [0.9, -0.4, 1.2], (0.6, 0.8, 1.0)
CONING, CONES = generic(2).shared, generic(3).scene
BODY, TWO = fa.Scene(inertia=MOMENTS), fa.Scene(inertia=[MOMENTS] * 2)
THREE = np.tile(Q, (3, 1))
RATE_METHODS = ", ".join(m.name for m in fa.METHODS.values() if "rate" in m.scenes)


def run(**changes):
    return partial(
        fa.propagate, **{"scene": CONING, "q0": START, "dt": 0.1, "n_steps": 3, **changes}
    )


def body(**changes):
    return run(**{"scene": BODY, "w0": SPIN, **changes})


def until(t_end, dt=0.1, **changes):
    return body(n_steps=None, dt=dt, t_end=t_end, **changes)


def directions(**changes):
    given = {"scene": CONING, "v0": [0.0, 0.0, 1.0], "dt": 0.1, "n_steps": 3}
    return partial(fa.propagate_directions, **given | changes)


# states, mass, controllers


def wheel(t, q, w, s, p):
    return (-w[1] * s[0], w[0] * s[0], -p[0]), p[0]


def turning(t, s, p):
    return (s[0], 0.3, p[0] * s[1]), (s[1], -s[0])


def braked(t, q, w, v, r, p):
    return -0.1 * r[0], v[1], r[2]


WHEEL = fa.Scene(inertia=MOMENTS, torque=wheel, states=1, params=(0.3,))
TURNING = fa.Scene(rate=turning, states=2, params=(0.7,))
MOVED = fa.Scene(inertia=MOMENTS, mass=2.0, force=(0.3, -0.2, 0.5))
PLACED = fa.Scene(
    inertia=MOMENTS, mass=2.0, force=(0, 0, 0), torque=t.Custom(braked, uses_position=True)
)
SAMPLED = fa.Scene(inertia=MOMENTS, torque=t.SampledControl(t.QuaternionPD(1.0, 1.0), 0.25))
HELD = t.SampledControl(lambda t, q, w, p: w, 1.0, holds=3)
NAMED = fa.Scene(inertia=MOMENTS, torque=t.Sum({"b": HELD}))
WHEELS = t.ReactionWheels(np.eye(3), 0.02, t.QuaternionPD(1.0, 5.0))
DRIVEN = fa.Scene(inertia=(20.0, 18.0, 15.0), torque=t.Sum({"wheels": WHEELS}))
STATES = "accepted: rk4, rk8, rk9, gbs16 ("
# with a clock that no double tells apart
CLOCKS = [
    fa.Scene(
        inertia=MOMENTS, torque=t.SampledControl(t.QuaternionPD(1.0, 1.0), period, start=start)
    )
    for period, start in ((1e-320, 0.0), (0.1, 1e300), (1e-9, 0.0))
]


# resumed


def swing(t, q, w, p):
    return p[0] * np.sin(t), p[1] * w[1], 0.0


def other_swing(t, q, w, p):
    return p[0] * np.cos(t), p[1] * w[1], 0.0


def swung(torque=swing, params=(0.3, -0.1), **options):
    return fa.Scene(inertia=MOMENTS, torque=torque, params=params, **options)


def sampled(law):
    return fa.Scene(inertia=MOMENTS, torque=t.SampledControl(law, 0.25))


def thrust(size):
    pulse = fa.TimeSeries([0.0, 1.0, 2.0], [[0.0] * 3, [size, 0.0, 0.0], [0.0] * 3])
    return fa.Scene(inertia=MOMENTS, torque=t.Constant(pulse))


def resumed(scene, other=None, *, method="rk4", then=None, **options):
    """A run that begins with one scene and goes on with another."""

    def call():
        held = {"s0": np.zeros(scene.states)} if scene.states else {}
        begun = fa.propagate(scene, Q, SPIN, dt=0.05, n_steps=2, method=method, **held)
        fa.resume(other or scene, begun, method=then, **options or {"n_steps": 1})

    return call


def without_end(**options):
    def call():
        fa.resume(BODY, body(**{"n_steps": None, "method": "rk4", **options})(), n_steps=1)

    return call


TABLEAU = {"c": (0, 1 / 2, 1), "a": ((1 / 2,), (-1, 2)), "b": (1 / 6, 2 / 3, 1 / 6)}
SAME_NAME = fa.runge_kutta("ralston3", order=3, **TABLEAU)
ANOTHER_SCENE = [
    ("scene: differs from that of the run", resumed(first, second))
    for first, second in (
        (BODY, fa.Scene(inertia=(0.6, 0.8, 1.1))),
        (BODY, fa.Scene(inertia=MOMENTS, torque=t.HeavyTop((0.0, 0.0, 0.5), 2.0))),
        (BODY, CONING),
        (BODY, MOVED),
        (swung(), swung(other_swing)),
        (swung(), swung(params=(0.3, -0.2))),
        (thrust(0.1), thrust(0.2)),
        (swung(breakpoints=[5.0]), swung(breakpoints=[6.0])),
        (sampled(t.Damping(0.1)), sampled(t.Damping(0.2))),
        (sampled(lambda t, q, w, p: w), sampled(lambda t, q, w, p: (w[1], w[0], w[2]))),
    )
]


# plans, events, what is read off a run


def planned(scene=BODY, *values, n=5, plan=(), **call):
    def made():
        plan_of = fa.plan(scene, n, dt=0.05, n_steps=3, method="rk4", **dict(plan))
        plan_of(*values or (np.tile(Q, (5, 1)), SPIN), **call)

    return made


def height(t, q, w, p):
    return 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])


def event(g, **options):
    return body(events=[fa.event(g)], method="rk8", **options)


def between(**changes):
    good = {"t": np.arange(3.0), "q": THREE, "w": np.zeros((3, 3)), "times": 0.5}
    return partial(fa.interpolate, **good | changes)


@functools.cache
def done(**options):
    return body(method="rk4", dt=1.0, n_steps=2, **options)()


W = np.ones((3, 5, 3))


def of_bodies(q0, w0, inertia, time, **options):
    return partial(fa.closed_form.free_body, q0, w0, inertia, time, **options)


def at(place, value, **options):
    """The closed form with one argument another."""
    given = [Q, (0.1, 0.2, 0.3), (2.0, 1.0, 1.5), 1.0]
    given[place] = value
    return of_bodies(*given, **options)


THIRD, TOP = (0.0, 0.0, 1.0), (1.0, 1.0, 0.5)


def top(**changes):
    given = {"arm": THIRD, "weight": 1.0} | changes
    return partial(fa.closed_form.heavy_top, [Q, [0, 1, 0, 0]], THIRD, TOP, 1.0, **given)


def exactly(torque, inertia=TOP, **options):
    scene = fa.Scene(inertia=inertia, torque=torque, **options)
    return body(scene=scene, method="exact")


# advice


def advised(function=fa.recommend, scene=CONES, **changes):
    given = {"t_end": 6.0, "tol": 1e-3} if function is fa.recommend else {"t_end": 6.0}
    return partial(function, scene, THREE, **given | changes)


def own_steps(**changes):
    given = {"t_end": 10.0, "tol": 1e-3, "method": "rk4"} | changes
    return partial(fa.per_body_steps, BODY, Q, SPIN, **given)


def of_own(**options):
    return body(q0=np.tile(Q, (70, 1)), method="rk4", **options)


COUNTS = np.arange(20, 90)
FAST = {"q0": Q, "w0": [1e200, 0.0, 0.0]}
STUDY = fa.work_precision

ENDS = [
    ("n_steps, t_end: found neither", None),
    ("t_end: found -1.0; accepted: a time after t0, 0.0", -1.0),
    ("t_end: found inf; accepted: a finite number", INF),
]

REFUSED = [
    ("q0: has shape (3,); accepted: (4,) or (N, 4)", run(q0=[1, 0, 0])),
    ("q0[1] is the zero quaternion", run(q0=[Q, [0, 0, 0, 0]])),
    ("q0[1, 2] is nan; accepted: finite numbers", run(q0=[Q, [1, 0, NAN, 0]])),
    ("q0: found 'north'; accepted: real numbers", run(q0="north"), TypeError),
    ("q0: found", run(q0=[1j, 0, 0, 0]), TypeError),
    ("q0[2] is nan", run(q0=np.ma.array([1.0, 0, 0, 0], mask=[0, 0, 1, 0]))),
    ("q0: found array([['a', 'b', 'c', 'd'], [", run(q0=np.array([list("abcd")] * 9)), TypeError),
    ("q0: has shape (0, 4) and is empty; accepted: (4,) or (N, 4)", body(q0=np.zeros((0, 4)))),
    ("rate: …found parameters for 200 bodies; accepted: 1, … q0 of shape (200, 4)",
     run(scene=generic(200).scene)),
    ("dt: found 0.0; accepted: a finite number other than 0", run(dt=0.0)),
    ("dt: found 'fast'; accepted: a finite number", run(dt="fast"), TypeError),
    ("dt: found 2 steps; accepted: one, or 1 of the bodies", run(dt=[0.1, 0.2])),
    ("dt: has shape (1, 1); accepted: a number or (N,)", run(dt=np.array([[0.1]]))),
    ("dt: 3 steps of 1e+308 s from 0.0 s overflow", run(dt=1e308)),
    ("n_steps: found 1180591620717411303424; accepted: a whole nu", run(n_steps=2**70)),
    ("n_steps: found -1; accepted: a whole number of at least 0", run(n_steps=-1)),
    ("n_steps: found 2.0; accepted: a whole number", run(n_steps=2.0), TypeError),
    ("on_save: found 3; accepted: a function", run(on_save=3, save_every=1), TypeError),
    ("on_save: found without saves", run(on_save=print)),
    ("save_every: found 0", run(save_every=0)),
    ("save_every: found 'all'", run(save_every="all"), TypeError),
    ("n_threads: found 0", run(n_threads=0)),
    ("t0: found inf", run(t0=INF)),
    ("dtype: found", run(dtype=np.int32), TypeError),
    ("dtype: found 'float16'; accepted: float64, float32 or None", run(dtype="float16"), TypeError),
    ("representation: found 'matrix'; accepted: quat, d", run(representation="matrix")),
    ("method: found 'rk5'; accepted: " + RATE_METHODS, run(method="rk5")),
    ("method: found 'xxxx", run(method="x" * 5000)),
    ("method for representation ", run(method="magnus4", representation="euler313")),
    ("scene: found Constant(", run(scene=fa.rates.Constant([0, 0, 1])), TypeError),
    ("…found parameters for 3 bodies; accep", run(scene=CONES, q0=[Q, Q])),
    ("checkpoint: found 3; accepted: a path", body(checkpoint=3), TypeError),
    ("compensated: found with method strang2; accepted with …rk4",
     body(method="strang2", compensated=True)),
    *[("normalise: found …never, or a whole", body(normalise=x)) for x in ("always", 0)],
    *[("normalise: found …never, or a whole", body(normalise=x), TypeError) for x in (1.5, None)],
    # bodies
    ("w0: is missing; a scene with inertia needs (3,) or (N, 3), rad/s", body(w0=None)),
    ("w0: has shape (2,); accepted: (3,) or (N, 3)", body(w0=[1.0, 2.0])),
    ("w0: has shape (0, 3)", body(w0=np.zeros((0, 3)))),
    ("w0[1, 1] is inf; accepted: finite numbers", body(w0=[SPIN, [0.0, INF, 0.0]])),
    ("w0: found 'fast'; accepted: real numbers of shape (3,)", body(w0="fast"), TypeError),
    ("w0: found, but this scene has none; a scene with inertia", run(w0=SPIN)),
    ("…w0: found rows w0 3, q0 2; accepted: one number of", body(q0=[Q] * 2, w0=[SPIN] * 3)),
    ("inertia: found 2 bodies; accepted: 5", body(scene=TWO, q0=[Q] * 5)),
    ("…found parameters for 2 bodies; accepted: 5 bodies",
     body(scene=fa.Scene(inertia=MOMENTS, torque=t.Damping([[0.1], [0.2]])), q0=[Q] * 5)),
    ('method for representation "euler313"', body(method="strang2", representation="euler313")),
    ('method for representation "dcm_rows"', body(method="strang2", representation="dcm_rows")),
    # directions
    ("v0: has shape (2,); accepted: (3,), (M, 3) or (N, M, 3)", directions(v0=[1.0, 2.0])),
    ("v0[1] is nan", directions(v0=[0.0, NAN, 1.0])),
    ("…parameters for 3 bodies", directions(scene=CONES)),
    ("…parameters for 3 bodies", directions(scene=CONES, v0=np.ones((2, 5, 3)))),
    ("scene: found inertia, mass or states; accepted: a scene with", directions(scene=BODY)),
    # ends and saves
    *[(message, until(end, dt)) for dt in (0.1, [0.1]) for message, end in ENDS],
    ("n_steps: found with t_end; accepted: one of", body(t_end=1.0)),
    ("n_steps: found with t_end; accepted: one of", body(dt=[0.1], t_end=1.0)),
    *[("dt, t_end: found … steps in … s; accepted: fewer", x)
     for x in (until(1e300), until(1e308), until(None, save_at=[1e149]))],
    ("dt: found 5 steps; accepted: one, or 70", of_own(dt=1.5 / COUNTS[:5])),
    ("n_steps: body … ends after", of_own(dt=1.5 / COUNTS, n_steps=30)),
    ("dt: found steps of both signs", of_own(dt=1.5 / COUNTS * (-1) ** COUNTS, n_steps=COUNTS)),
    ("n_steps: found array", of_own(dt=1.5 / COUNTS, n_steps=COUNTS[:4])),
    ("save_every: found with dt (N,)", of_own(dt=1.5 / COUNTS, n_steps=COUNTS, save_every=2)),
    ("save_every: found with", of_own(save_every=2, save_at=[0.1])),
    ("save_at[1] is 0.4…; accepted", of_own(save_at=[0.1, 0.4])),
    ("save_at[0] is -1; accepted: from 0.5 to 0.5", until(None, t0=0.5, save_at=[-1.0])),
    ("save_at: found times out of order", of_own(save_at=[0.2, 0.1])),
    # mass, position, states and samples
    ("v0: is missing; a scene with mass needs", body(scene=MOVED)),
    ("r: is not carried; it is in a scene with mass",
     lambda: body(scene=MOVED, v0=[0, 0, 1], method="rk4")().r),
    ("v0: found, but this scene has none; a scene with mass", body(v0=[0, 0, 1])),
    ("method: found 'cf4'; accepted: rk4, rk8, rk9, gbs16 (cf4 steps no vel",
     body(scene=MOVED, v0=[0, 0, 1], method="cf4")),
    ("method: found 'cf4'; accepted: rk4, rk8, rk9, gbs16 (cf4 steps no vel",
     body(scene=PLACED, v0=[0, 0, 1], r0=[0, 0, 1], method="cf4")),
    ("r0: is missing; a scene whose torque or force reads it", body(scene=PLACED, v0=[0, 0, 1])),
    *[(f"method: found '{x}'; {STATES}", body(scene=WHEEL, s0=(1.0,), method=x))
     for x in ("strang2", "rkmk4", "cf4", "kahan_li8", "dmv2")],
    (f"method: found 'magnus4'; {STATES}", run(scene=TURNING, s0=(1.0, 0.0), method="magnus4")),
    ("s0: is missing; a scene with states needs (2,) or", run(scene=TURNING)),
    ("s0: …accepted: (2,) or (N, 2)", run(scene=TURNING, s0=(1.0, 2.0, 3.0))),
    ("…rows", run(scene=TURNING, q0=THREE, s0=np.zeros((2, 2)))),
    ("s0[1, 1] is nan", run(scene=TURNING, s0=[[1.0, 1.0], [1.0, NAN]])),
    ("s0: found, but this scene has none", body(s0=(1.0, 2.0))),
    ("s: is not carried", lambda: done().s),
    ("dt: found -0.1 with a sampled controller; accepted",
     body(scene=SAMPLED, s0=[0] * 3, dt=-0.1)),
    *[("…SampledControl.period is …and .start …; accepted: up", body(scene=x, s0=[0] * 3, dt=10.0))
     for x in CLOCKS],
    ("s0: found 'c'; accepted: 'b'", body(scene=NAMED, s0={"c": [0]})),
    ("s0['wheels']: is missing", body(scene=DRIVEN, s0={})),
    ("s0['wheels']…(3,) or (N, 3)", body(scene=DRIVEN, s0={"wheels": [0.0, 1.0]})),
    # events
    ("event_times: the run had no events", lambda: done().event_times),
    ("method with events: found 'exact'; accepted: ",
     body(method="exact", events=fa.event(height))),
    ("events: found …; accepted: a list of fastatt.event", body(events=[height]), TypeError),
    ("…found …; accepted: event(t, q, w, p)", event(lambda t: t), TypeError),
    ("…no position is carried", event(lambda t, q, w, v, r, p: t)),
    ("…event(t, q, w, s, p), but the scene has no states", event(lambda t, q, w, s, p: s[0])),
    ("…p empty, without params, is not followed: an error on every path, such as IndexError",
     event(lambda t, q, w, p: w[0] - p[0]), TypeError),
    *[("…True or False", event(g), TypeError)
     for g in (lambda t, q, w, p: w[0] > 0.3, lambda t, q, w, p: bool(w[0] > 0.3 and t > 1.0))],
    ("…in the place of", event(lambda t, w, q, p: w[0]), TypeError),
    ("representation: found dcm with …−q",
     event(lambda t, q, w, p: q[1] - 0.2, representation="dcm")),
    ("direction: found 2; accepted: -1, 0, 1", lambda: fa.event(height, 2)),
    ("g: found 3", lambda: fa.event(3), TypeError),
    # runs that go on
    *ANOTHER_SCENE,
    ("method: is missing; accepted: the Method ralston3 of the run",
     resumed(BODY, method=RALSTON3)),
    ("scene: differs … or a method of one's own does",
     resumed(BODY, method=RALSTON3, then=SAME_NAME)),
    ("method: found 'rk4'; accepted: dmv10, as in the run",
     resumed(BODY, method="dmv10", then="rk4")),
    ("scene: found one that does not fit the run (method", resumed(BODY, swung(), method="dmv10")),
    ("t_end: found 0.05; accepted: 0.1, the end of the run, or after it",
     resumed(BODY, t_end=0.05)),
    ("n_steps, t_end: found neither; accepted: one of them", resumed(BODY, n_threads=1)),
    ("on_save: found without saves", resumed(BODY, n_steps=1, on_save=print)),
    ("save_at[0] is", resumed(BODY, save_at=[0.01, 0.5])),
    *[("run: found a trajectory that does not hold its end", without_end(**options))
     for options in ({"n_steps": 2, "method": "exact"}, {"save_at": [0.07]}, {"t_end": 0.12},
     {"t_end": 0.2, "dt": [0.1, 0.1], "q0": [Q, Q]})],
    ("run: found 3; accepted: a trajectory or a file's path",
     lambda: fa.resume(BODY, 3, n_steps=1), TypeError),
    # plans
    ("q0: found 3 bodies; accepted: 5", planned(BODY, THREE, [SPIN] * 3)),
    ("params: found, but the scene", planned(params=(1.0,))),
    ("params", planned(swung(), params=(1.0,))),
    ("params[1] is nan", planned(swung(), params=(1.0, NAN))),
    ("n_bodies: found 0", planned(n=0)),
    ("n_bodies: found 2.5", planned(n=2.5), TypeError),
    ("position: found True, but this scene", planned(plan={"position": True})),
    ("r0: accepted, and needed…position=True",
     planned(MOVED, v0=[0, 0, 1], r0=[0, 0, 1], plan={"position": False})),
    # what is read off a run
    ("t: found … rising or falling", between(t=[0.0, 1.0, 1.0])),
    ("times[0] is 2.1; accepted: 0.0 to 2.0", between(times=2.1)),
    ("w: has shape (3, 2, 3); accepted: (3, 3)", between(w=np.zeros((3, 2, 3)))),
    ("q[0] is the zero quaternion", between(q=np.zeros((3, 4)))),
    ("w[0, 0] is nan; accepted: finite", between(w=np.full((3, 3), NAN))),
    ("q, w: found with a run; accepted: interpolate(run, t",
     lambda: fa.interpolate(done(save_every=1), done().q, done().w, 0.5), TypeError),
    ("times: found None", lambda: fa.interpolate(done(save_every=1)), TypeError),
    ("times[1] is 2.5; accepted: 0.0 to 2.0",
     lambda: fa.interpolate(done(save_every=1), [0.5, 2.5])),
    ("t: found …; accepted: two or more", lambda: fa.interpolate(done(), 0.3)),
    ("run: has 1 save, …accepted: two or more (save_every=", lambda: fa.drift(done(), BODY)),
    *[("scene: differs from that of the run", lambda x=x: fa.drift(done(save_every=1), x))
     for x in (fa.Scene(inertia=(0.6, 0.8, 1.1)), CONING,
     fa.Scene(inertia=MOMENTS, torque=t.Damping(0.1)))],
    *[("inertia: has shape (…4…); accepted: (3,), ",
     partial(fa.angular_momentum, W, np.ones(shape))) for shape in ((4,), (3, 4), (4, 3, 4))],
    ("…three bodies", partial(fa.angular_momentum, W[:, :3], [[2.0, 1.0, 1.5]] * 3)),
    ("…accepted: one number of bodies", partial(fa.angular_momentum, W, np.ones((6, 3)))),
    ("path: found 3; accepted: a path", lambda: fa.to_file(3), TypeError),
    ("path: found 'history.csv'; accepted: *.npy", lambda: fa.to_file("history.csv")),
    # closed forms
    ("q0: has shape (3,); accepted: (4,) or (N, 4)", at(0, (1, 0, 0))),
    ("q0 is the zero quaternion", at(0, (0, 0, 0, 0))),
    ("w0: has shape (2,); accepted: (3,) or (N, 3)", at(1, (1, 2))),
    ("w0[2] is nan; accepted: finite numbers", at(1, (1, 2, NAN))),
    ("w0: has 3 rows; accepted: one, or 2 as",
     of_bodies(np.eye(4)[:2], np.ones((3, 3)), MOMENTS, 1.0)),
    ("inertia: has 4 rows; accepted: one, or",
     of_bodies(np.eye(4)[:2], SPIN, np.ones((4, 3)), 1.0)),
    ("inertia is …not above 0", at(2, (1, -1, 1))),
    ("inertia: found the principal moment -1; accepted by",
     at(2, (2.0, -1.0, 1.5), allow_unphysical=True)),
    ("t: has shape (1, 1); accepted: a number or (T,)", at(3, [[1.0]])),
    ("t[1] is inf", at(3, [0.0, INF])),
    ("t: found 'now'; accepted: real numbers", at(3, "now"), TypeError),
    ("n_threads: found 0; accepted: …at least 1", at(3, 1.0, n_threads=0)),
    ("inertia[1] is (1, 1.2, 1.5): no two moments",
     partial(fa.closed_form.symmetric_top, Q, SPIN, [(1.0, 1.0, 1.5), (1.0, 1.2, 1.5)], 1.0)),
    ("torque: HeavyTop.arm: has shape (2,)", top(arm=(1.0, 2.0))),
    ("arm, weight: has 3 rows; accepted: one, or 2 as of q0", top(arm=[THIRD] * 3)),
    ("…weight is nan", top(weight=NAN)),
    ("…for 2 and 3 bodies", top(arm=[THIRD] * 2, weight=np.ones(3))),
    ("…with arm (1, 0, 0) along principal axes", top(arm=(1.0, 0.0, 0.0))),
    ("…inertia[1] is (1, 1.1, 0.5) with arm[1] (0, 0, 1) along principal axes; accepted",
     exactly(t.HeavyTop(THIRD, 1.0), [TOP, (1.0, 1.1, 0.5)])),
    ("…inertia[1] is (1, 1, 0.5) with arm[1] (0, 0.1, 1)",
     exactly(t.HeavyTop([THIRD, (0.0, 0.1, 1.0)], 1.0))),
    ("…torque: found Damping(…); accepted by the closed form: none, or HeavyTop or Magnetic",
     exactly(t.Damping(0.1))),
    ("…torque: found MagneticDipole",
     exactly(t.MagneticDipole(THIRD, fa.TimeSeries([0.0, 1.0], [THIRD, THIRD])))),
    ("…inertia: found the principal moment -0.5; accepted by the closed form: above 0",
     exactly(t.HeavyTop(THIRD, 1.0), (1.0, 1.0, -0.5), allow_unphysical=True)),
    # advice
    *[("w0[0] is 1e+200; accepted: up to 1e+150 rad/s", call)
     for call in (partial(fa.per_body_steps, BODY, **FAST, tol=1e-3, t_end=1.0, method="rk4"),
     partial(STUDY, BODY, **FAST, t_end=1.0, methods=["rk4"]),
     partial(fa.check_convergence, BODY, **FAST, dt=0.1, n_steps=4))],
    ("tol: found 0.0; accepted: a number above 0", advised(tol=0.0)),
    ("t_end: found -1.0", advised(t_end=-1.0)),
    ("methods: found 'rk8'", advised(methods=["rk8"])),
    ("sample: found 0", advised(sample=0)),
    ("tol: found 1e-16; accepted: at least …", advised(tol=1e-16)),
    ("tol: found 1e-09; accepted: what can be reached, …",
     advised(tol=1e-9, methods=["rk4"], dtypes=["float32"])),
    *[(f"tol: found {tol:g}; accepted: at least … is rounding", own_steps(tol=tol))
     for tol in (1e-300, 1e-16, 3e-15)],
    *[("t_end: found 5.0; accepted: a time after t0, 7", advised(function, t0=7.0, t_end=5.0))
     for function in (fa.recommend, STUDY)],
    ("t_end: found 0.0", advised(STUDY, t_end=0.0)),
    ("methods: found 'exact'; accepted: lie_euler", advised(STUDY, methods=["exact"])),
    ("representations: found 'gibbs'", advised(STUDY, representations=["gibbs"])),
    ("dtypes: found 'float16'", advised(STUDY, dtypes=["float16"])),
    ("…of which nothing fits", advised(STUDY, methods=["magnus4"], representations=["euler313"])),
    ("…of which nothing fits", advised(STUDY, methods=[])),
    ("sample: found 0", advised(STUDY, sample=0)),
    ("methods: found 'rk4' twice; accepted: different names",
     advised(STUDY, methods=["rk4", "rk4"])),
    *[("n_steps: found", advised(STUDY, n_steps=x), error)
     for x, error in (([0], ValueError), (20, TypeError), ([], ValueError))],
    *[(f"quantile: found {x}; accepted: a num", call) for x in (0.0, 1.5)
     for call in (advised(quantile=x), own_steps(quantile=x))],
    *[(f"{name}: found 0", partial(fa.check_convergence, CONES, THREE, dt=0.1,
     **{"n_steps": 4, name: 0})) for name in ("n_steps", "sample")],
    ("dt: found 4.0 with … sampled every 0.25 s",
     partial(fa.check_convergence, SAMPLED, Q, SPIN, s0=[0] * 3, dt=4.0, n_steps=5, method="rk4")),
]  # fmt: skip
