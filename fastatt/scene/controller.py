"""Controllers: by the quaternion's error, and at sample times with the torque held in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.law import AT_CROSSINGS, Law, Sampling, Term
from fastatt.scene.models import (
    PER_AXIS,
    Field,
    PackedTerm,
    Packing,
    Parameters,
    join,
    on_each_axis,
)
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Custom, Pose, Torque, check_unit
from fastatt.tracing.formulas import (
    Vector,
    as_like,
    dot,
    minus,
    product,
    quat,
    rigid,
    scale,
)
from fastatt.tracing.user import UserFunction, user_function


class _Gains(Field):
    """Gains as rows of 1, 3 or 9 numbers: a number, one of each axis, or a matrix."""

    def flat(self, name: str, value: ArrayLike | None) -> NDArray[np.float64]:
        gains = models.numbers(name, value, self.accepted)
        if gains.shape[-2:] != (3, 3):
            checks.refuse(name, gains, gains < 0.0, "0 or more")
            return gains.reshape(-1) if gains.ndim < 3 else gains.reshape(-1, 1)
        size = np.abs(gains).max(axis=(-2, -1))
        lowest = np.linalg.eigvalsh(gains)[..., 0]
        asymmetry = np.abs(gains - np.swapaxes(gains, -2, -1)).max(axis=(-2, -1))
        checks.refuse(f"{name}: its asymmetry", asymmetry, asymmetry > 1e-9 * size, "0")
        checks.refuse(f"{name}: its lowest eigenvalue", lowest, lowest < -1e-9 * size, "0 or more")
        return gains.reshape(*gains.shape[:-2], 9)


class _Target(Field):
    """Quaternions, or a table of them whose signs are continuous."""

    def check_table(self, name: str, table: TimeSeries) -> None:
        super().check_table(name, table)
        q = table.samples
        rotated = np.argwhere((q[:, 1:] * q[:, :-1]).sum(axis=-1) <= 0.0)
        if len(rotated):
            row, k = rotated[0]
            raise ValueError(
                f"{name} of row {row} changes its sign, or rotates by π or more, after sample "
                f"{k}; accepted: quaternions whose signs are continuous"
            )


_EACH = "a number, (3,) per axis, (1, 1) or (3, 3), and of each body (N, 1, 1) or (N, 3, 3)"
_Gain = Annotated[ArrayLike, _Gains((3, 3), accepted=_EACH)]
_TabledQuaternion = Annotated[ArrayLike | TimeSeries, _Target((4,), table="slopes")]
_Limit = Annotated[ArrayLike | None, Field((3,), above_zero=True, accepted=PER_AXIS, optional=True)]


class QuaternionPD(Torque):
    """Attitude controller τ = −K sgn(e0) (e1, e2, e3) − D w, with the attitude error e = target*∘q.

    The vector part of e is half the rotation vector when the error is small, so that a stiffness of
    K N·m gives K/2 N·m/rad. If the target moves, its angular velocity along body axes is subtracted
    from w. The torque jumps where e0 passes 0. With ``divides`` the steps of a body are divided
    there; otherwise a step across the jump has order 1 with any method and sets the flag
    ``Status.JUMP``.

    Parameters
    ----------
    stiffness : array_like
        K, N·m: a number, one for each body axis, (3,), or a matrix along body axes, (3, 3), which
        is symmetric and has no negative eigenvalues. One for each body is (N, 1, 1) or (N, 3, 3).
    damping : array_like
        D, N·m·s, in the same shapes.
    target : array_like or TimeSeries, default (1, 0, 0, 0)
        Unit quaternions (4,) or (N, 4), or a table of them, whose signs are continuous from sample
        to sample.
    limit : array_like, optional
        Largest torque along each body axis, N·m, above 0: a number, (3,), (N, 1) or (N, 3).
    divides : bool, default False
        Whether steps are divided where e0 passes 0, as at the crossings of a :class:`Switch`, which
        keeps the order of the method. The sign of e0 is then a state, 1 or -1, that changes only
        there, and ``run.crossings`` gives the crossings, by the name of the term in a :class:`Sum`
        or "QuaternionPD". It takes methods for which ``Method.couples`` is True and the
        representation "quat".

    References
    ----------
    Wie, *Space Vehicle Dynamics and Control* (2008), §7.3.

    Examples
    --------
    >>> import fastatt as fa
    >>> pd = fa.torques.QuaternionPD((2.0, 1.0, 1.0), 3.0, limit=0.1)
    >>> scene = fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=pd)
    """

    stiffness: _Gain
    damping: _Gain
    target: _TabledQuaternion = (1.0, 0.0, 0.0, 0.0)
    limit: _Limit = None
    divides: bool = False

    @property
    def states(self) -> int:  # type: ignore[override]
        """The sign of e0, if steps are divided where it changes."""
        return int(self.divides)

    @property
    def reads_sign(self) -> bool:  # type: ignore[override]
        """With a sign that is held, the error must not change its own."""
        return self.divides

    @property
    def clocks(self) -> tuple[Sampling | None, ...]:
        """The sign changes at crossings."""
        return (AT_CROSSINGS,) * self.states

    def crossed(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        """The scalar part of the error."""
        return self._error(pose)[:1]

    def decay(self) -> Any:
        """The damping gains, for a matrix the sums of its rows, which bound its eigenvalues."""
        gains = np.abs(np.asarray(self.damping, dtype=np.float64))
        return gains.sum(axis=-1) if gains.ndim >= 2 else gains

    def formula(self: Any, t: Any, pose: Pose, *states: Vector) -> Any:
        (target, slope), w, error = self.target, pose.w, self._error(pose)
        if slope:
            # angular velocity of the target, q, along body axes: 2 q* (dq/dt q*) q
            rate = quat.mul(slope, quat.conj(target))
            size = dot(target, target)
            w = minus(w, pose.to_body(tuple(2.0 * x / size for x in rate[1:])))
        side = as_like(states[0][0], w[0]) if states else rigid.sign_of_scalar(error)
        back = scale(-1.0, scale(side, error)[1:])
        torque = minus(_gained(self.stiffness, back), _gained(self.damping, w))
        torque = rigid.saturated(torque, on_each_axis(self.limit)) if self.limit else torque
        return (*torque, *(0.0,) * len(states))

    def _error(self: Any, pose: Pose) -> Vector:
        """The attitude error, a quaternion."""
        target, slope = self.target
        error: Vector = rigid.target_error(
            quat.normalise(target) if slope else target, pose.quaternion
        )
        return error

    def sides(self, t: Any, pose: Pose, states: Vector) -> list[Vector]:
        if states:
            return []
        error = self._error(pose.along_body)
        return [scale(rigid.sign_of_scalar(error), error)]

    def check(self: Any, name: str) -> None:
        checks.flag(f"{name}.divides", self.divides)
        check_unit(f"{name}.target", self.target[0], np.abs(self.stiffness).max(axis=(0, 1)))


def _gained(gain: tuple[Vector, ...], v: Vector) -> Vector:
    """The product of a vector with a number, a number per axis, or a matrix, by rows."""
    if len(gain) == 3:
        return tuple(dot(row, v) for row in gain)
    return product(on_each_axis(gain[0]), v)


class SampledControl(Torque):
    """A controller that is evaluated at sample times start + k period, with a zero-order hold.

    At each sample time of the run, the first included, the controller computes a torque from the
    state at that time. The torque is constant along body axes until the next sample time. Steps end
    at sample times as at ``breakpoints``, so that a method keeps its order with any ``dt``. A
    ``dt`` that divides the period adds no steps; any other adds one step for each sample. With
    ``holds`` it computes numbers that exert nothing: other terms of a :class:`Sum` read them.

    The states are the three components of the held torque, N·m along body axes, or the numbers that
    are held, those that wait with a ``delay``, the next to be held first, and the memory of the
    controller. As ``command`` of ``ReactionWheels``, they follow the angular momenta of the wheels.
    A run takes their initial values as ``s0``. If it begins at a sample time, the held torque in
    ``s0`` has no effect, and zeros will do; if it begins between two sample times, that torque acts
    until the first of them. A save at a sample time holds the states from before the sample: with a
    period of 0.2 s, the held torque saved at t = 0.2 s is that of the interval from 0 to 0.2 s.

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
    holds : int, optional
        Number of numbers that the function returns in place of a torque, as a tuple, or a number if
        it is one.
    delay : int
        After how many samples what is computed is held: 0, at once. Until then what the run has
        begun with is held.
    reads : str or tuple of str
        Names of terms of a :class:`Sum`, whose numbers the function takes as tuples before s:
        ``torque(t, q, w, wheels, s, p)``.

    Raises
    ------
    ValueError
        If the period is not above 0 or the model has states.
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
    params: Parameters = None
    states: int = 0  # type: ignore[misc]
    start: float = 0.0
    holds: int | None = None
    delay: int = 0
    reads: str | tuple[str, ...] = ()

    def __post_init__(self) -> None:
        name = "SampledControl"
        checks.above_zero(f"{name}.period", self.period, "above 0, s")
        checks.real(f"{name}.start", self.start)
        memory = checks.whole(f"{name}.states", self.states, 0)
        checks.whole(f"{name}.delay", self.delay, 0)
        if self.holds is not None:
            checks.whole(f"{name}.holds", self.holds, 1)
        object.__setattr__(self, "reads", models.names_in(f"{name}.reads", self.reads))
        if isinstance(self.control, models.Model):
            if self.params is not None or memory or self.holds is not None or self.reads:
                raise ValueError(
                    f"{name}: found params, states, holds or reads beside a model; accepted: with "
                    "a function"
                )
        elif not callable(self.control):
            raise TypeError(
                f"{name}.control: found {checks.brief(self.control)}; accepted: a function "
                "torque(t, q, w, p) or a model of fastatt.torques"
            )

    def shown(self) -> dict[str, int]:
        """The numbers that are held."""
        return {"": 3 if self.holds is None else int(self.holds)}

    def pack(self, packing: Packing) -> PackedTerm:
        packing = packing._replace(argument=f"{packing.argument}: SampledControl")
        control, params = self._packed_control(packing)
        held, delay, memory = self.shown()[""], int(self.delay), int(self.states)
        sampling = Sampling(float(self.period), float(self.start))
        count = held * (1 + delay) + memory
        model = _Held(None, control, sampling, count, held, delay, tuple(self.reads))
        return Term(model, (params.shape[-1],), (None,)), params

    def _packed_control(self, packing: Packing) -> tuple[Law | UserFunction, NDArray[np.float64]]:
        """The law of a torque, or the function of numbers that exert nothing; its parameters."""
        control, memory = self.control, int(self.states)
        if self.holds is not None:
            params = join([models.parameters("params", self.params)], packing.n_bodies, "params")
            reads = models.readings(self.reads, packing)
            function = user_function(
                control, "control", params.shape[-1], params, memory, reads=reads,
                results=int(self.holds),
            )  # fmt: skip
            packing.tables.update(function.tables)
            return function, params
        packing = packing._replace(argument=f"{packing.argument}.control")
        if isinstance(control, models.Model):
            law, params = models.packed_law(control, Torque, packing)
            if law.states:
                raise ValueError(
                    f"{packing.argument}: found a model with {law.states} states; accepted: a "
                    "model without states, or a function with memory"
                )
            return law, params
        torque = Custom(control, self.params, states=memory, reads=self.reads)
        return models.packed_law(torque, Torque, packing)


class _Held(Torque):
    """A controller whose numbers are held, as formulas take it.

    Its states are those that are held, those that wait for as many samples as the ``delay``, the
    next first, and the memory.
    """

    params: Parameters
    control: Law | UserFunction
    sampling: Sampling
    states: int  # type: ignore[misc]
    holds: int = 3
    delay: int = 0
    reads: tuple[str, ...] = ()

    @property
    def exerts_nothing(self) -> bool:  # type: ignore[override]
        return not isinstance(self.control, Law)

    @property
    def samplings(self) -> tuple[Sampling, ...]:  # type: ignore[override]
        return (self.sampling,)

    @property
    def clocks(self) -> tuple[Sampling | None, ...]:
        return (self.sampling,) * self.states

    def show(self, name: str, t: Any, pose: Pose, states: Vector) -> Vector:
        return states[: self.holds]

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """That of the controller."""
        return isinstance(self.control, Law) and self.control.reads_position

    def formula(self, t: Any, pose: Pose, states: Vector) -> Any:
        torque = (0.0, 0.0, 0.0) if self.exerts_nothing else states[:3]
        return (*torque, *np.zeros(self.states))

    def update(self, t: Any, pose: Pose, states: Vector, sampling: Sampling) -> Any:
        waiting = self.holds * (1 + self.delay)
        computed = self._computed(t, pose, states[waiting:])
        return (*states[self.holds : waiting], *computed)

    def _computed(self: Any, t: Any, pose: Pose, memory: Vector) -> Vector:
        """The numbers that are to be held, and the memory for the next sample."""
        if isinstance(self.control, Law):
            numbers = self.control.formula(t, pose, self.params, states=memory)
            torque = numbers[:3] if pose.axes is None else quat.rotate(pose.axes, numbers[:3])
            return (*torque, *numbers[3:])
        body = pose.along_body
        read = (*map(body.shown, self.reads), *((memory,) if memory else ()))
        numbers = self.control.call(t, body.quaternion, body.w, *read, self.params)
        numbers = numbers if self.control.signature.results > 1 else (numbers,)
        return tuple(as_like(x, pose.moments[0]) for x in numbers)


# messages name a model by its class
_Held.__name__ = SampledControl.__name__
