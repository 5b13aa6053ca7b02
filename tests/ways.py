"""Ways of a run: methods of each sort, and all that a run may carry or do beside its steps."""

import numpy as np

import fastatt as fa

N = 200  # bodies, three tiles of 64 and a part of one
DT, STEPS = 0.01, 300  # more than a block
RNG = np.random.default_rng(3)
Q0, W0 = RNG.normal(size=(N, 4)), RNG.normal(size=(N, 3))
BODY = (2.0, 1.0, 1.5)
SIZES = RNG.uniform(0.9, 1.1, (N, 1))
# the last is the same of all bodies, so that what is made of it is shared by them
OWN = np.hstack([RNG.uniform(0.1, 0.5, (N, 2)), np.full((N, 1), 3.0)])


def swing(t, q, w, p):
    return p[0] * np.sin(p[2] * t), p[1] * w[1] - q[0] * q[1], 0.1


def pulse(t, q, w, p):
    return (p[0] if 0.503 < t < 1.5 else -p[0]), q[1], 0.02 * t


def lagged(t, q, w, s, p):
    return (-p[0] * s[0], 0.0, q[2]), (p[1] * (w[0] - s[0]), s[0])


def held(t, q, w, s, p):
    return (-p[0] * w[0], -s[0], 0.0), (s[0] + 0.1 * w[1],)


def lagging(t, q, w, p):
    return q[0] * q[1] - 0.02 * w[0]


def jets(t, q, w, side, p):
    return -p[0] * side, p[1] * q[2], 0.1


def winding(t, p):
    """Called: a loop whose end is not known."""
    n = 0
    while n < 5.0 * abs(t):
        n += 1
    return p[0] * n, p[1], np.cos(t)


def motors(t, q, w, speeds, error, p):
    return [-p[0] * x - p[1] * v - 1e-3 * s for x, v, s in zip(error, w, speeds, strict=True)]


def several_clocks():
    """Controllers that read each other, at sample times of their own."""
    law = fa.torques.SampledControl(motors, 0.07, (0.2, 0.8), reads=("wheels.speeds", "error"))
    wheels = fa.torques.ReactionWheels(np.eye(3), 0.02, law, max_torque=0.5, coulomb=1e-3)
    terms = {
        "error": fa.torques.SampledControl(lambda t, q, w, p: q[1:], 0.25, start=0.1, holds=3),
        "wheels": wheels,
        "slow": fa.torques.SampledControl(fa.torques.Damping(0.01), 0.6, start=-0.3),
    }
    return fa.Scene(inertia=wheels.body_inertia(BODY), torque=fa.torques.Sum(terms))


RATE = fa.Scene(rate=fa.rates.Coning(OWN[:, 0], OWN[:, 1] + 1.0))
SHARED = fa.Scene(rate=fa.rates.Coning(0.4, 1.3))
TORQUED = fa.Scene(inertia=BODY, torque=swing, params=OWN)
SPLIT = fa.Scene(inertia=SIZES * BODY, torque=fa.torques.GravityGradient(0.3))
FREE = fa.Scene(inertia=SIZES * BODY)
MOVED = fa.Scene(inertia=BODY, mass=SIZES[:, 0], force=(0.1, 0.2, 0.3))
STATES = fa.Scene(inertia=BODY, torque=lagged, states=2, params=OWN)
SAMPLED = fa.Scene(inertia=BODY, torque=fa.torques.SampledControl(held, 0.25, (0.3,), states=1))
BROKEN = fa.Scene(
    inertia=BODY, breakpoints=(0.503, 1.5), torque=fa.torques.Custom(pulse, OWN, uses_rate=False)
)
JETS = fa.torques.Custom(jets, 3.0 * OWN, reads="side")
SWITCHED = fa.Scene(
    inertia=BODY, torque=fa.torques.Sum({"side": fa.torques.Switch(lagging), "jets": JETS})
)
EVENTS = [
    fa.event(lambda t, q, w, p: w[0], every=True),
    fa.event(lambda t, q, w, p: w[1], terminal=True),
]
WAYS = {
    "rate": (RATE, {"method": "magnus4"}),
    "shared rate": (SHARED, {"method": "magnus4", "representation": "dcm"}),
    "rate, called": (fa.Scene(rate=winding, params=OWN[:, :2]), {"method": "magnus4"}),
    "rate, single": (RATE, {"method": "magnus4", "dtype": "float32"}),
    "rk4": (TORQUED, {"method": "rk4"}),
    "rk4, single": (TORQUED, {"method": "rk4", "dtype": "float32"}),
    "rk4, low parts": (TORQUED, {"method": "rk4", "compensated": True, "normalise": 3}),
    "rk4, matrices": (TORQUED, {"method": "rk4", "representation": "dcm_rows"}),
    "rk4, angles": (TORQUED, {"method": "rk4", "representation": "euler313", "dt": -DT}),
    "rk4, never mended": (TORQUED, {"method": "rk4", "normalise": "never"}),
    "splitting": (SPLIT, {"method": "strang2"}),
    "implicit": (FREE, {"method": "dmv10"}),
    "implicit, single": (FREE, {"method": "dmv10", "dtype": "float32"}),
    "closed form": (FREE, {"method": "exact"}),
    "position": (MOVED, {"method": "rk4", "v0": W0 + 1.0, "r0": W0 - 1.0}),
    "states": (STATES, {"method": "rk4", "s0": W0[:, :2]}),
    "samples": (SAMPLED, {"method": "rk4", "s0": np.zeros((N, 4))}),
    "clocks": (several_clocks(), {"method": "rk4", "s0": 0.1 * RNG.normal(size=(N, 12))}),
    "breakpoints": (BROKEN, {"method": "rk4"}),
    "breakpoints, splitting": (BROKEN, {"method": "strang2"}),
    "switches": (SWITCHED, {"method": "rk4"}),
    "switches, single": (SWITCHED, {"method": "rk4", "dtype": "float32"}),
    "events": (TORQUED, {"method": "rk4", "events": EVENTS}),
}


def given(way, rows=slice(None), n=STEPS, **more):
    """A scene and the arguments of its run, of some bodies."""
    scene, options = WAYS[way]
    start = {"q0": Q0[rows]} | ({} if scene.kind == "rate" else {"w0": W0[rows]})
    start |= {name: options[name][rows] for name in ("v0", "r0", "s0") if name in options}
    return scene[rows], {"dt": DT, "n_steps": n, **options, **start, **more}
