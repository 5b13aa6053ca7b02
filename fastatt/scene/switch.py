"""Switches: the side of zero on which a function lies, which changes only where steps end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastatt.scene.law import AT_CROSSINGS, Sampling
from fastatt.scene.models import UserModel
from fastatt.scene.torque_record import Pose, Torque
from fastatt.tracing.formulas import Vector


class Switch(UserModel, Torque):
    """The side of zero, 1 or -1, on which a function of the motion lies, for other terms to read.

    A law that compares, such as a bang-bang controller or dry friction, jumps within a step, which
    is then of order 1. Let it read the side in place of its own comparison: the step of a body is
    divided where the function crosses zero, and the side changes only there, so that the method
    keeps its order. Each body has its own crossings, which ``Trajectory.crossings`` gives.

    A switch is a term of a :class:`Sum` with a name and exerts nothing. The functions of other
    terms, of the force and of events that name it in ``reads`` take its side as a number. The side
    is a state: ``run.s`` has it, ``scene.parts`` says where, and ``s0`` may set it to 1 or -1; by
    default, or with 0, it is the sign of the function at the start.

    Parameters
    ----------
    function : callable
        ``g(t, q, w, p) -> float``, with the arguments of an :func:`fastatt.event`. It should cross
        zero, as ``w[0] - 0.3`` does; where it is zero, the side is that from before.
    params : array_like of shape (P,) or (N, P), optional
        Parameters p of the function. With ``t - p[0]`` each body switches at its own time.
    uses_position : bool, default False
        Whether the function depends on velocity or position: ``g(t, q, w, v, r, p)``.
    reads : str or tuple of str, default ()
        Names of terms of the :class:`Sum`, whose numbers the function takes before p.

    Notes
    -----
    Methods for which ``Method.couples`` is True take scenes with switches. Where a function crosses
    zero in a step more than 32 times, since on either side the motion leads back to zero, the body
    slides: it gets the flag ``Status.SLIDING``, and from then on the side follows the sign after
    whole steps, which is of order 1.

    Examples
    --------
    A bang-bang controller about the first axis:

    >>> import fastatt as fa
    >>> def line(t, q, w, p):
    ...     return q[0] * q[1] + p[0] * w[0]
    >>> def jets(t, q, w, side, p):
    ...     return -p[0] * side, 0.0, 0.0
    >>> terms = {
    ...     "side": fa.torques.Switch(line, (0.4,)),
    ...     "jets": fa.torques.Custom(jets, (0.05,), reads="side"),
    ... }
    >>> scene = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=fa.torques.Sum(terms))
    >>> q0, w0 = [1, 0, 0, 0], [0.1, 0, 0]
    >>> run = fa.propagate(scene, q0, w0, dt=0.1, n_steps=100, method="rk8", save_every=20)
    >>> run.s[:, 0], run.crossings("side").t.round(6)
    (array([ 1.,  1.,  1.,  1., -1., -1.]), array([7.278754]))
    """

    uses_position: bool = False
    reads: str | tuple[str, ...] = ()  # type: ignore[assignment]
    states = 1
    exerts_nothing = True

    @property
    def role(self) -> str:
        """The role of the function."""
        return "switch at position" if self.reads_position else "switch"

    def takes(self, states: int) -> int:
        """None: the function does not take its side."""
        return 0

    def shown(self) -> Mapping[str, int]:
        """The side, a number by itself."""
        return {"": 0}

    @property
    def clocks(self) -> tuple[Sampling | None, ...]:
        """The side changes at crossings."""
        return (AT_CROSSINGS,)

    def formula(self: Any, t: Any, pose: Pose, *states: Vector) -> Any:
        """No torque, and a side that stays."""
        return 0.0, 0.0, 0.0, 0.0

    def crossed(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        """The function, whose sign is the side."""
        placed = pose.coupled[:2] if self.uses_position else ()
        read = map(pose.shown, self.reads)
        return (self.function.call(t, pose.quaternion, pose.w, *placed, *read, self.params),)
