"""How fast the states of a scene change by themselves, compared with the steps of a method."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastatt.attitudes import QUATERNION
from fastatt.propagation.initial import Initial
from fastatt.scene.equations import Body, PrescribedRate, Structure
from fastatt.scene.models import Packed
from fastatt.scene.torque_record import CoupledStates
from fastatt.tracing.finished import Flat
from fastatt.tracing.formulas import quat
from fastatt.tracing.graph import Graph
from fastatt.tracing.source import function

# bodies that are checked, and the share of a state by which it is changed
_BODIES, _SHARE = 64, 1e-6


def fastest_states(packed: Packed, start: Initial, t0: float) -> tuple[float, float]:
    """The fastest decay and frequency of a scene's states at the start of a run, 1/s.

    They are the largest −Re λ and abs(Im λ) of the eigenvalues λ of ∂ṡ/∂s.
    """
    structure: Structure = packed.structure
    law = structure.rotation.law
    stepped = [k for k, clock in enumerate(law.clocks) if clock is None]
    if not stepped:
        return 0.0, 0.0
    flat = _derivatives(structure)
    some = np.unique(np.linspace(0, start.bodies - 1, _BODIES).astype(np.int64))

    def of(rows: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(rows[some] if len(rows) > 1 else rows[:1], dtype=np.float64)

    p = np.atleast_2d(packed.params)
    q, y = of(start.q), of(start.y)
    s = np.broadcast_to(y[:, y.shape[1] - law.states :], (some.size, law.states))
    values: dict[Any, Any] = {("t",): t0}
    for name, array in (("q", q), ("y", y), ("p", of(p))):
        values |= {(name, k): column for k, column in enumerate(array.T)}
    values |= {("s", k): column for k, column in enumerate(s.T)}
    call, names = function(flat, packed.tables), flat.inputs()

    def slopes(changed: dict[Any, Any]) -> NDArray[np.float64]:
        results = call(*({**values, **changed}[name] for name in names))
        columns = [np.broadcast_to(x, some.size) for x in results]
        return np.stack([columns[k] for k in stepped], axis=-1)

    jacobian = np.empty((some.size, len(stepped), len(stepped)))
    for j, k in enumerate(stepped):
        step = _SHARE * np.maximum(1.0, np.abs(s[:, k]))
        above, below = (slopes({("s", k): s[:, k] + x}) for x in (step, -step))
        jacobian[:, :, j] = (above - below) / (2.0 * step[:, None])
    seen = jacobian[np.isfinite(jacobian).all(axis=(1, 2))]
    roots = np.linalg.eigvals(seen) if seen.size else np.zeros((1, 1))
    return float(max(0.0, -roots.real.min())), float(np.abs(roots.imag).max())


def _derivatives(structure: Structure) -> Flat:
    """ṡ as a graph of the time, the attitude, the rest of the state, and the parameters."""
    graph, rotation = Graph(), structure.rotation
    n, states = rotation.n_params, rotation.law.states
    of_rate = isinstance(rotation, PrescribedRate)
    carried = 3 * (not of_rate) + 3 * (structure.force is not None) + 3 * structure.position
    t, q = graph.input("double", "t"), quat.normalise(graph.inputs("double", "q", 4))
    y, s = graph.inputs("double", "y", carried), graph.inputs("double", "s", states)
    p = graph.inputs("double", "p", structure.n_params)[:n]
    if isinstance(rotation, PrescribedRate):
        return Flat(graph, rotation.law.formula(t, p, states=s)[3:], "double")
    w, v, r = y[:3], y[3:6], y[6:9]
    motion = Body(QUATERNION, rotation, p, q[0])
    if motion.axes is not None:
        q, w = quat.mul(q, motion.axes), quat.rotate_inverse(motion.axes, w)
    return Flat(graph, motion.torque(t, q, w, CoupledStates(v, r, s))[3:], "double")
