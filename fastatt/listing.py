"""The methods as text: name, order, scenes, operations a step, representations, source."""

from __future__ import annotations

import numpy as np

from fastatt import precompile
from fastatt.methods import METHODS, Method
from fastatt.propagation.choice_of_method import fits
from fastatt.propagation.closed_forms import LEVERS
from fastatt.propagation.inspect_step import job_of
from fastatt.scene.torque_record import Dependence

# how a method's list of scenes is read: name on the command line, in words, as records have it
SCENES = {
    "rate": ("rate functions", ("rate",)),
    "free": ("free bodies", ("spherical", "symmetric", "free")),
    "torqued": ("torqued bodies", ("torqued",)),
    "samples": ("samples", ("sampled rates", "increments")),
}
# what a method that is not for any torque asks of it
_TAKEN = {
    Dependence.DAMPED: "torque free of w but for linear damping",
}
# on which operations are counted
_COUNTED = ("coning", "free", "heavy top")


def listed(scene: str | None = None) -> str:
    """The methods, or those for a kind of scene of ``SCENES``, two lines each."""
    chosen = [SCENES[scene]] if scene else list(SCENES.values())
    found = [m for m in METHODS.values() if any(set(m.scenes) & set(own) for _, own in chosen)]
    width = max(len(m.name) for m in found)
    lines = []
    for m in found:
        lines.append(f"{m.name:{width}}  {_order(m)}; {_fits(m)}: {m.summary}")
        stored = ", ".join(m.representations)
        lines.append(f"{'':{width}}  {_operations(m)}{stored}; {m.source}")
    return "\n".join(lines)


def _order(m: Method) -> str:
    if not m.order:
        return "closed form"
    others = "".join(f", {order} for {scene}" for scene, order in m.orders.items())
    return f"order {m.order}{others}"


def _operations(m: Method) -> str:
    """Operations a step on usual scenes, in words."""
    found: dict[str, int] = {}
    for name in _COUNTED:
        scene = precompile.SCENES[name](1.0)
        if m.is_stepped and fits(m, scene, "quat"):
            found[name] = job_of(scene, m, "quat", np.float64).formulas.operations
    return f"operations {', '.join(f'{n} {k}' for n, k in found.items())}; " if found else ""


def _fits(m: Method) -> str:
    """The scenes of a method, in words."""
    words = []
    for name, (plural, own) in SCENES.items():
        found = [scene for scene in own if scene in m.scenes]
        if name == "samples" and len(found) == 1:
            words += found
        elif found:
            words.append(plural)
    if m.is_exact:
        words[-1] += f" ({' or '.join(LEVERS)} along the axis of a symmetric body)"
    if m.takes in _TAKEN:
        words[-1] += f" ({_TAKEN[m.takes]})"
    return ", ".join(words)
