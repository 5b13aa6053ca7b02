"""A sampled controller: its torque is computed at sample times and held in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.models import Field, Law, PackedLaw, Resources, Sampling
from fastatt.scene.torque_models import Custom
from fastatt.scene.torque_record import Pose, Torque
from fastatt.tracing.formulas import Vector, quat


class SampledControl(Torque):
    """A controller that is evaluated at sample times start + k period, with a zero-order hold.

    At each sample time of the run, the first included, the controller computes a torque from the
    state at that time. The torque is constant along body axes until the next sample time. Steps end
    at sample times as at ``breakpoints``, so that a method keeps its order with any ``dt``. A
    ``dt`` that divides the period adds no steps; any other adds one step for each sample.

    The states are the three components of the held torque, N·m along body axes, followed by the
    memory of the controller. As ``command`` of ``ReactionWheels``, they follow the angular momenta
    of the wheels. A run takes their initial values as ``s0``. If it begins at a sample time, the
    held torque in ``s0`` has no effect, and zeros will do; if it begins between two sample times,
    that torque acts until the first of them. A save at a sample time holds the states from before
    the sample: with a period of 0.2 s, the held torque saved at t = 0.2 s is that of the interval
    from 0 to 0.2 s.

    Parameters
    ----------
    control : callable or Torque
        A model of ``fastatt.torques`` without states, such as ``QuaternionPD``; or a function
        ``torque(t, q, w, p)`` that returns the torque on the body, N·m along body axes; or, for a
        controller with memory, a function ``torque(t, q, w, s, p)`` that returns two tuples, the
        torque and the memory s for the next sample.
    period : float
        Time between samples, s, above 0.
    params : array_like of shape (P,) or (N, P), optional
        The argument p of a function.
    states : int
        Number of memory values of the function.
    start : float
        A sample time, s, on the same clock as ``t0``.

    Raises
    ------
    ValueError
        If the period is not above 0 or the model has states. ``Scene`` raises it if two controllers
        have different sample times.
    TypeError
        If ``control`` is neither a function nor a model.

    Notes
    -----
    A scene with a sampled controller refuses a negative ``dt`` and ``fa.single_step``. Åström,
    Wittenmark, *Computer-Controlled Systems* (1997), §2.3.

    Examples
    --------
    Proportional-derivative control at 2 Hz, on a body about its third axis:

    >>> import fastatt as fa
    >>> pd = fa.torques.SampledControl(fa.torques.QuaternionPD(0.5, 1.0), period=0.5)
    >>> body = fa.Scene(inertia=(2.0, 1.5, 1.0), torque=pd)
    >>> q0, w0 = [0.8, 0.0, 0.0, 0.6], [0.0, 0.0, 0.0]
    >>> run = fa.propagate(body, q0, w0, s0=[0, 0, 0], dt=0.1, n_steps=12, save_every=4)
    >>> print(run.t.round(1), run.s[:, 2].round(3))
    [0.  0.4 0.8 1.2] [ 0.    -0.3   -0.142 -0.052]
    """

    control: Callable[..., Any] | Torque
    period: float
    params: Annotated[ArrayLike | None, Field((-1,))] = None
    states: int = 0  # type: ignore[misc]
    start: float = 0.0

    def __post_init__(self) -> None:
        name = "SampledControl"
        checks.above_zero(f"{name}.period", self.period, "above 0, s")
        checks.real(f"{name}.start", self.start)
        memory = checks.whole(f"{name}.states", self.states, 0)
        if isinstance(self.control, models.Model):
            if self.params is not None or memory:
                raise ValueError(
                    f"{name}: found params or states beside a model; accepted: with a function"
                )
        elif not callable(self.control):
            raise TypeError(
                f"{name}.control: found {checks.brief(self.control)}; accepted: a function "
                "torque(t, q, w, p) or a model of fastatt.torques"
            )

    def pack(self, n_bodies: int | None, argument: str, resources: Resources) -> PackedLaw:
        label = f"{argument}: SampledControl.control"
        control: Any = self.control
        is_model, memory = isinstance(control, models.Model), int(self.states)
        if not is_model:
            control = Custom(control, self.params, states=memory)
        law, params = models.pack(control, Torque, n_bodies, resources, argument=label)[:2]
        if is_model and law.states:
            raise ValueError(
                f"{label}: found a model with {law.states} states; accepted: a model without "
                "states, or a function with memory"
            )
        held = _Held(None, law, Sampling(float(self.period), float(self.start)), 3 + memory)
        return Law(held, (params.shape[-1],), (None,)), params


class _Held(Torque):
    """A controller whose torque is held, as formulas take it."""

    params: Annotated[ArrayLike | None, Field((-1,))]
    control: Law
    sampling: Sampling  # type: ignore[misc]
    states: int  # type: ignore[misc]

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """That of the controller."""
        return self.control.reads_position

    def formula(self, t: Any, pose: Pose, states: Vector) -> Any:
        return (*states[:3], *np.zeros(self.states))

    def update(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        found = self.control.formula(t, pose, self.params, states=states[3:])
        torque = found[:3] if pose.axes is None else quat.rotate(pose.axes, found[:3])
        return (*torque, *found[3:])


# messages name a model by its class
_Held.__name__ = SampledControl.__name__
