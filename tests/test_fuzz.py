"""Hostile input is refused in one line that names an argument, or its result is right."""

from collections import Counter

import numpy as np
from each import each
from fuzzing import Draw, tried

import fastatt as fa

BODY, Q0, W0 = (2.0, 1.0, 0.7), [[1.0, 0.0, 0.0, 0.0]] * 2, [0.1, 0.2, 0.3]
STEPS = {
    "q0": Q0, "dt": 0.1, "n_steps": 3, "save_every": 1, "t0": 1.0, "normalise": "output",
    "n_threads": 1, "dtype": "float64",
}  # fmt: skip
RATE = {"rate": W0, "frame": "body"}
FREE = {"inertia": BODY, "w0": W0}
MOVED = {**FREE, "mass": 2.0, "force": W0, "v0": W0, "r0": W0}
SAMPLED = {"rates": np.full((4, 3), 0.1), "dt": 0.1, "q0": Q0[0], "max_gap": 1.0, "n_threads": 1}
NUMBERS = {3: W0, 4: Q0[0], 0: 0.7, -1: [W0, W0]}


def run(*, method, representation="quat", compensated=False, **given):
    """A run whose scene is made of hostile numbers too."""
    scene = {name: given.pop(name) for name in SCENE if name in given}
    if "rate" in scene:
        scene["rate"] = fa.rates.Constant(scene["rate"])
    if "damping" in scene:
        scene["torque"] = fa.torques.Damping(scene.pop("damping"))
    return fa.propagate(
        fa.Scene(**scene), method=method, representation=representation, compensated=compensated,
        **given,
    )  # fmt: skip


SCENE = ("rate", "frame", "inertia", "damping", "mass", "force")


def of_model(model):
    """A scene with a model, and numbers of the shapes of its fields."""
    given = {name: NUMBERS[(*field.shape, 0)[0]] for name, field in model.fields.items()}
    beside = {} if model.kind == "rate" else {"inertia": BODY}
    beside |= {"mass": 2.0} if model.kind == "force" else {}
    return lambda **given: fa.Scene(**{model.kind: model(**given), **beside}), given


def models():
    for module in (fa.rates, fa.torques, fa.forces):
        for name in module.__all__:
            model = getattr(module, name)
            if name not in ("Sum", "Custom", "ReactionWheels", "SampledControl"):
                yield of_model(model)


def targets():
    """By kind: functions with good arguments."""
    in_rates = [(m, {"representation": r}) for m, r in (("magnus4", "quat"), ("rk4", "euler313"))]
    runs = [(m, RATE | o) for m, o in (*in_rates, ("magnus4", {"compensated": True}))]
    runs += [(m, FREE) for m in ("exact", "dmv10", "strang2")]
    runs += [("rk4", FREE | {"compensated": True}), ("rk4", MOVED)]
    runs += [("rk4", FREE | {"damping": 0.1, "representation": "dcm"})]
    body = {"q0": Q0, "w0": W0, "t": [0.0, 1.0], "dtype": "float64"}
    bodies = [body | {"inertia": moments} for moments in (BODY, (1.0, 1.0, 0.7))]
    methods = ("hold", "trapezoid", "previous", "coning2", "picard")
    return {
        "propagate": [(lambda m=m, **x: run(method=m, **x), STEPS | given) for m, given in runs],
        "Scene": [*models(), (fa.Scene, {"inertia": BODY, "allow_unphysical": False})],
        "closed form": [(fa.closed_form.free_body, body) for body in bodies],
        "integrate_rates": [(fa.integrate_rates, SAMPLED | {"method": m}) for m in methods],
    }


def test_hostile_input():
    """One to three arguments of a call at a time."""
    draw, outcomes, found = Draw(7), Counter(), []
    kinds = targets()
    names = {name for kind in kinds.values() for _, given in kind for name in given}
    names |= {model for module in (fa.rates, fa.torques, fa.forces) for model in module.__all__}
    names |= {"scene", "torque"}
    for _ in range(1500):
        kind = draw.one(list(kinds))
        function, good = draw.one(kinds[kind])
        changed = draw.random.sample(sorted(good), min(len(good), draw.one((1, 1, 2, 3))))
        with np.errstate(all="ignore"):
            given = good | {name: draw.instead_of(good[name]) for name in changed}
        outcome, wrong = tried(function, given, names)
        outcomes[kind, outcome] += 1
        if wrong is not None:
            found.append(f"{kind}: {wrong}\n    {given}"[:1500])
    assert found == []
    assert min(outcomes[kind, x] for kind in kinds for x in ("returned", "refused")) > 0


def nonsense(q):
    return np.full((1, 3, 4), np.nan)


def silent(q):
    return np.asarray(q) * 2.0


def wordy(q):
    raise ValueError("q: this\nand that")


def nameless(q):
    raise TypeError("wrong")


def other(q):
    raise ZeroDivisionError("q")


def warned(q):
    return np.float64(1.0) / np.zeros(1) * np.ones((2, 4)) / np.inf + np.eye(2, 4)


@each("function", [nonsense, silent, wordy, nameless, other, warned])
def test_what_the_fuzz_is_after_is_found(function):
    assert tried(function, {"q": np.array([1.0, 0.0, 0.0, 0.0])}, ("q",))[1] is not None
