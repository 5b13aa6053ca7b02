"""The operations of a step as text."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from fastatt import checks
from fastatt.codegen.rows import precision_of
from fastatt.engine.job import Job
from fastatt.engine.program import WIDTH
from fastatt.methods import Method
from fastatt.propagation.choice_of_method import attitude_of, method_of
from fastatt.scene.scene import Scene, as_scene
from fastatt.tracing import source

_LEGEND = {
    "x": "state: the attitude's numbers, then what the scene carries",
    "p": "parameters of the scene, of each body or of all",
    "c": "constants of each body, computed once",
    "e": "what the method prepared for the body",
    "t": "time of the step, s",
    "h": "step, s",
    "k": "step of the other flow, s",
    "angle2": "square of the largest rotation angle of a step, rad²",
}


def inspect_step(
    scene: Scene,
    method: str | Method | None = None,
    *,
    representation: str = "quat",
    dtype: DTypeLike = np.float64,
) -> str:
    """Show the loop that a run of a scene executes, as text with the number of its operations.

    A step is a sequence of operations without branches, and contains only what the scene requires.
    ``a*b + c`` is one fused instruction if the processor has it.

    Parameters
    ----------
    scene : Scene
        The bodies with their rates, torques and forces.
    method : str or Method, optional
        The method, as in :func:`fastatt.propagate`.
    representation : str, default "quat"
        The representation of the attitude.
    dtype : {float64, float32}, default float64
        Precision of the state.

    Returns
    -------
    str
        The operations of one step, one on each line.

    Raises
    ------
    ValueError, TypeError
        If an argument does not fit, as in :func:`fastatt.propagate`.

    Examples
    --------
    >>> import fastatt as fa
    >>> print(fa.inspect_step(fa.Scene(inertia=(2.0, 1.0, 2 / 3)), "rk4").splitlines()[0])
    # rk4, free, quat, double: 223 floating-point operations a step
    """
    as_scene(scene)
    job = job_of(scene, method, representation, checks.precision(dtype))
    flat = job.small_angle
    text = source.GraphText(flat)
    constants = source.GraphText(job.constants)
    groups = dict.fromkeys(name[0] for f in (job.constants, flat) for name in f.inputs())
    stages = len(job.method.stages)
    each = f" in {stages} stages" if stages > 1 else ""
    counted = f"{job.operations} floating-point operations a step{each}"
    once = [*constants.lines, *(f"c{i} = {x}" for i, x in enumerate(constants.results))]
    lines = [
        f"# {job.method.name}, {scene.kind}, {job.attitude.name}, {job.precision}: {counted}",
        *(f"# {name}: {_LEGEND[name]}" for name in (*groups, "angle2") if name in _LEGEND),
        *(f"for lane in range({WIDTH}):" for _ in once[:1]),
        *(f"    {line}" for line in once),
        "for n in range(first, last):",
        "    t = t0 + n*h",
        f"    for lane in range({WIDTH}):",
        *(f"        {line}" for line in text.lines),
    ]
    *state, angle2 = text.results
    lines += [f"        x{i} = {y}" for i, y in enumerate(state)]
    lines.append(f"        angle2 = max(angle2, {angle2})")
    return "\n".join(lines) + "\n"


def job_of(scene: Scene, method: Any, representation: Any, dtype: Any) -> Job:
    """The job of a scene, without its bodies."""
    record = method_of(scene, method, representation, stepped=True)
    packed = scene.packed(None, sorted_axes=record.sorted_axes)
    attitude, shared = attitude_of(representation), packed.params.ndim == 1
    return Job(record, attitude, packed.structure, precision_of(dtype), shared=shared)
