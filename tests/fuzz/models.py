"""Models, scenes and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np

import fastatt as fa
from fuzz.draw import ODD, ONE, Anything, Draw
from fuzz.judge import Call, floats, unit
from fuzz.runs import ARGUMENTS, moments

MODELS = {
    module: [getattr(module, name) for name in module.__all__]
    for module in (fa.rates, fa.torques, fa.forces)
}
_SHAPES = ((), (3,), (2, 3), (4,), (2,), (2, 2, 3))


def modelled(d: Draw, module: Any) -> Any:
    """A model with hostile numbers, in the shapes that its fields have or not."""
    if d.chance(0.05):
        return d.one((*ODD, fa.rates.Constant, fa.rates.Constant(ONE[:3]), fa.torques.Damping(0.1)))
    cls = d.one(MODELS[module])
    if cls.__name__ == "Sum":
        terms = [modelled(d, module) for _ in range(d.random.randrange(3))]
        return cls(d.one((terms, tuple(terms), tuple(terms), (3,), None, "ab", 5)))
    if cls.__name__ == "Custom":
        return cls(d.one((3, None, "f", len, Anything, Anything())), d.array((2,), (2, 2)))
    names = cls.__match_args__
    by_name = {
        "w": ((3,), (2, 3)), "coefficients": ((3,), (2, 3), (2, 2, 3)), "bias": ((3,), (2, 3)),
        "amplitude": ((3,),), "rotation": ((3,), (2, 3)), "torque": ((3,), (2, 3)),
        "force": ((3,), (2, 3)), "radial": ((3,),), "along": ((3,),), "arm": ((3,),),
        "dipole": ((3,), (2, 3)), "field": ((3,),), "target": ((4,), (2, 4)),
        "momentum": ((3,), (2, 3)), "torques": ((4, 3), (1, 3)),
    }  # fmt: skip
    numbers = [
        d.array(*by_name.get(n, ((), (), (2,))) if d.chance(0.9) else _SHAPES) for n in names
    ]
    try:
        return cls(*numbers)
    except (TypeError, ValueError):  # some models check their numbers when they are made
        return None


def inertia(d: Draw) -> Any:
    kind = d.random.random()
    if kind < 0.4:
        return d.dressed(moments(d, *d.one(((3,), (2, 3)))))
    if kind < 0.7:
        a = d.rng.standard_normal(d.one(((3, 3), (2, 3, 3))))
        tensor = np.eye(3) * 3.0 + 0.2 * (a + np.swapaxes(a, -1, -2))
        if d.chance(0.3):
            tensor = tensor * d.numbers((3, 3))
        return d.dressed(tensor * (10.0 ** d.rng.uniform(-300, 300) if d.chance(0.3) else 1.0))
    return d.array((3,), (2, 3), (3, 3), (2, 3, 3))


def scened(d: Draw) -> Call:
    options: dict[str, Any] = {}
    if d.chance(0.5):
        options["rate"] = modelled(d, fa.rates)
    if not options or d.chance(0.05):
        options["inertia"] = inertia(d)
        if d.chance(0.5):
            options["torque"] = modelled(d, fa.torques)
        if d.chance(0.3):
            options["mass"] = d.array((), (), (2,))
            options["force"] = modelled(d, fa.forces) if d.chance(0.5) else d.array((3,))
    for name, p, value in (
        ("params", 0.04, lambda: d.array((2,), (2, 2))),
        ("frame", 0.1, lambda: d.word("body", "inertial")),
        ("allow_unphysical", 0.1, lambda: d.one((True, False, None, 1))),
    ):
        if d.chance(p):
            options[name] = value()

    def judge(scene: Any) -> str | None:
        if scene.kind not in ("rate", "spherical", "symmetric", "free", "torqued"):
            return f"kind {scene.kind}"
        params = scene.packed(None).params
        return None if np.isfinite(params).all() else "parameters not finite"

    names = (*ARGUMENTS, *[m.__name__ for own in MODELS.values() for m in own])
    return Call(fa.Scene, (), options, judge, names)


def closed_form(d: Draw) -> Call:
    top = d.chance(0.3)
    function = fa.closed_form.symmetric_top if top else fa.closed_form.free_body
    q0, w0 = d.array((4,), (2, 4)), d.array((3,), (2, 3))
    body = inertia(d)
    if top and d.chance(0.6):
        body = moments(d) * np.array(d.one(((1.0, 1.0, 0.7), (0.8, 1.0, 1.0), (1, 1, 1))))
    t = d.array((), (), (3,))
    options: dict[str, Any] = {"n_threads": 1, "dtype": np.float64}
    if d.chance(0.1):
        options["dtype"] = d.one(("f8", int, "x", 3))
    if d.chance(0.1):
        options["allow_unphysical"] = d.one((True, False, 1, None))

    def judge(result: Any) -> str | None:
        q, w = result
        given = [floats(x) for x in (q0, w0, t)]
        if any(x is None for x in given):
            return None
        if not np.abs(given[0]).max(-1).all():
            return None
        bad = ~(np.isfinite(q).all(-1) & np.isfinite(w).all(-1))
        with np.errstate(all="ignore"):
            fastest = np.abs(given[1]).max()
            turn = fastest * np.abs(given[2]).max(initial=0.0)
        if bad.any():  # squares of momenta overflow, and so does the angle
            return None if fastest > 1e50 or turn > 1e16 else "not finite"
        return unit(q)

    names = ("q0", "w0", "inertia", "t", "dtype", "n_threads", "allow_unphysical")
    return Call(function, (q0, w0, body, t), options, judge, names)
