"""Reaction wheels: flywheels in the body whose speeds are states, driven by motors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks
from fastatt.scene import models
from fastatt.scene.inertia import is_tensor
from fastatt.scene.law import AT_CROSSINGS, Law, Sampling, Term
from fastatt.scene.models import Field, PackedTerm, Packing, Parameters, join
from fastatt.scene.torque_record import Pose, Torque, check_unit
from fastatt.tracing.formulas import Vector, as_like, dot, plus, quat, scale, vec3
from fastatt.tracing.graph import apply, choose
from fastatt.tracing.signature import SIGNATURES
from fastatt.tracing.user import UserFunction, user_function

#: a number of each wheel
_OfWheels = Annotated[ArrayLike, Field((-1,))]
_Rows = Annotated[ArrayLike, Field((-1, 3))]

# of the largest speed: where the torque that accelerates falls to 0
_FADE = 0.01


class ReactionWheels(Torque):
    """Reaction wheels that rotate about axes fixed in the body, driven by motors against friction.

    The state of wheel k is its angular momentum about its axis a_k, relative to inertial space:
    h_k = J_k (Ω_k + a_k·w), N·m·s, with its speed Ω_k relative to the body. With the net torque
    u_k of motor and friction, Hughes (1986), §3.4::

        ḣ_k = u_k,    u_k = command_k − viscous_k Ω_k − coulomb_k Ω_k / √(Ω_k² + coulomb_speed_k²),
        I ẇ = −w×(I w + Σ a_k h_k) − Σ a_k u_k + other torques

    so that the angular momentum C (I w + Σ a_k h_k) of body and wheels is constant in inertial axes
    unless other torques act. ``inertia`` of the scene is I, the spacecraft's inertia **without**
    the moments of the wheels about their axes; ``body_inertia`` subtracts these from the inertia of
    the whole spacecraft. A gravity-gradient torque of the same scene acts on the whole spacecraft.

    A run takes the initial values of the states as ``s0`` and returns the states as ``run.s``.
    ``momenta`` computes h from speeds, and ``speeds`` computes speeds from ``run.s``. With K wheels
    the states are, in this order:

    - the K angular momenta h, N·m·s;
    - the held torques, N·m, of a sampled command: K, one for each motor, if the command is a
      function with ``period``; three, along body axes, if it is a ``SampledControl``;
    - the states of the command;
    - with ``divides`` the K signs of the speeds, 1 or -1; with 0 those at the start are found.

    Parameters
    ----------
    axes : array_like
        Unit vectors a_k along body axes, of shape (K, 3) or (N, K, 3). They are normalised; a
        length that differs from 1 by more than 1e-3 is refused.
    inertia : array_like
        Moments of inertia J_k about the axes, kg·m², above 0: a number for all wheels, or an array
        of shape (K,), (N, 1) or (N, K). Friction and limits take the same shapes.
    command : callable, Torque or None
        The torques that are commanded to the motors. A model of ``fastatt.torques`` computes the
        torque on the body, N·m, which the pseudo-inverse of the axes distributes over the wheels.
        The model may have states, such as a PID controller ``Custom(function, params, states=3)``,
        or be sampled (``SampledControl``). A function ``command(t, q, w, s, p)`` returns the torque
        on each wheel, N·m, as a tuple of K, or as a number if there is one wheel; s is the tuple of
        the speeds Ω, rad/s, followed by the states of the function. None leaves the motors off.
    params : array_like of shape (P,) or (N, P), optional
        The argument p of a ``command`` that is a function.
    states : int
        Number of states of a ``command`` that is a function. With states it returns two tuples: the
        torques, and the time derivatives of the states (with ``period`` their next values).
    period : float, optional
        Time between samples, s, above 0, of a ``command`` that is a function. It is evaluated at
        the sample times start + k period, and its torques are held in between, as in
        :class:`SampledControl`. Without ``period`` the command is evaluated at all times.
    start : float
        A sample time, s, on the same clock as ``t0``.
    viscous : array_like
        Coefficient of viscous friction, N·m·s, 0 or more.
    coulomb : array_like
        Coulomb friction, N·m, 0 or more.
    coulomb_speed : array_like
        Width of the range of speeds in which Coulomb friction changes its sign, rad/s, above 0. At
        five times this speed and above, the friction is within 2 % of ``coulomb``. Steps must be
        shorter than the time in which a wheel passes this range; one that passes it
        sets the flag ``Status.JUMP``. With ``divides`` it has no effect.
    max_torque : array_like, optional
        Largest torque of a motor, N·m, 0 for one that failed. Commands that exceed it are cut off.
    max_speed : array_like, optional
        Largest speed to which a motor accelerates its wheel, rad/s, above 0. Over the last
        hundredth of the range the accelerating torque falls linearly to 0.
    divides : bool, default False
        Whether steps are divided where the speed of a wheel passes 0, as at the crossings of a
        :class:`Switch`. The friction is then coulomb_k sgn(Ω_k), and methods keep their order. A
        wheel that friction holds slides, with the flag ``Status.SLIDING``.

    Raises
    ------
    ValueError
        If the axes are not unit vectors, or a number has the wrong shape or sign.
    TypeError
        If the command is neither a function nor a model.

    See Also
    --------
    SampledControl : A sampled torque on the body, which can be a ``command``; it does not read the
        speeds of the wheels.

    Notes
    -----
    Where a motor reaches or leaves a limit, its torque has a corner in time, and the step that
    contains the corner is less accurate. A wheel that friction holds is not exactly at rest: it
    creeps at the speed at which the smooth friction balances the motor.

    Examples
    --------
    Three wheels take up the momentum of a body that is brought to rest:

    >>> import numpy as np
    >>> import fastatt as fa
    >>> wheels = fa.torques.ReactionWheels(
    ...     np.eye(3), 0.01, fa.torques.QuaternionPD(1.0, 2.0), viscous=1e-6, max_torque=0.1
    ... )
    >>> body = fa.Scene(inertia=wheels.body_inertia((2.0, 1.5, 1.0)), torque=wheels)
    >>> w0 = [0.05, -0.1, 0.02]
    >>> run = fa.propagate(
    ...     body, [1, 0, 0, 0], w0, s0=wheels.momenta(0.0, w0), dt=0.1, n_steps=600
    ... )
    >>> print(np.abs(run.w[-1]).max() < 1e-6, run.s[-1].round(2))
    True [ 0.1  -0.15  0.02]
    """

    axes: _Rows
    inertia: _OfWheels
    command: Callable[..., Any] | Torque | None = None
    params: Parameters = None
    states: int = 0  # type: ignore[misc]
    period: float | None = None
    start: float = 0.0
    viscous: _OfWheels = 0.0
    coulomb: _OfWheels = 0.0
    coulomb_speed: _OfWheels = 1.0
    max_torque: Parameters = None
    max_speed: Parameters = None
    divides: bool = False

    def __post_init__(self) -> None:
        name, command = "ReactionWheels", self.command
        axes, _ = self._numbers(name)
        self._sampling(name)
        checks.flag(f"{name}.divides", self.divides)
        of_function = {
            "params": self.params is not None,
            "states": checks.whole(f"{name}.states", self.states, 0) > 0,
            "period": self.period is not None,
        }
        if command is None or isinstance(command, models.Model):
            place = "without command" if command is None else "beside a model"
            for key in (key for key, is_given in of_function.items() if is_given):
                raise ValueError(f"{name}.{key}: found {place}; accepted: with a function")
        elif not callable(command):
            raise TypeError(
                f"{name}.command: found {checks.brief(command)}; accepted: a function "
                f"{SIGNATURES['command'].with_states(axes.shape[-2]).call} or a model of "
                "fastatt.torques"
            )

    def pack(self, packing: Packing) -> PackedTerm:
        name = f"{packing.argument}: ReactionWheels"
        axes, columns = self._numbers(name)
        count = axes.shape[-2]
        columns["axes"] = axes.reshape(*axes.shape[:-2], -1)
        columns |= {"distribution": np.zeros(0), "params": np.zeros(0)}
        command: Law | UserFunction | None = None
        sampled, memory = self._sampling(name), int(self.states)
        if isinstance(self.command, models.Model):
            of_command = packing._replace(argument=f"{name}.command")
            command, columns["params"] = models.packed_law(self.command, Torque, of_command)
            if any(x.exerts_nothing for x in command.models):
                raise ValueError(
                    f"{name}.command: found SampledControl with holds, which exerts nothing; "
                    "accepted: a torque on the body"
                )
            inverse = -np.linalg.pinv(axes)  # of rows a_k: (3, K)
            columns["distribution"] = np.swapaxes(inverse, -1, -2).reshape(*axes.shape[:-2], -1)
        elif self.command is not None:
            params = columns["params"] = models.parameters(f"{name}.params", self.params)
            command = user_function(
                self.command, "command", params.shape[-1], params, count + memory, memory
            )
            packing.tables.update(command.tables)
        states = count * (1 if sampled is None else 2) + memory
        states += command.states if isinstance(command, Law) else 0
        states += count * self.divides
        sizes = tuple(column.shape[-1] for column in columns.values())
        nothing: dict[str, Any] = dict.fromkeys(columns)
        driven = _Driven(
            **nothing, command=command, states=states, sampled=sampled, count=count,
            divides=self.divides, rubs=bool((columns["coulomb"] > 0.0).any()) and not self.divides,
        )  # fmt: skip
        term = Term(driven, sizes, (None,) * len(sizes))
        return term, join(list(columns.values()), packing.n_bodies, name)

    def shown(self) -> dict[str, int]:
        """The angular momenta and the speeds of the wheels."""
        count = np.shape(self.axes)[-2]
        return {"": count, ".speeds": count}

    def corners(self) -> NDArray[np.float64]:
        """Those of a command that is a model."""
        return self.command.corners() if isinstance(self.command, models.Model) else np.zeros(0)

    def _sampling(self, name: str) -> Sampling | None:
        """The sample times of a command that is a function."""
        start = checks.real(f"{name}.start", self.start)
        if self.period is None:
            return None
        return Sampling(checks.above_zero(f"{name}.period", self.period, "above 0, s"), start)

    def _unit_axes(self, name: str) -> NDArray[np.float64]:
        axes = models.numbers(f"{name}.axes", self.axes, "(K, 3) or (N, K, 3)")
        check_unit(f"{name}.axes", np.moveaxis(axes, -1, 0), 1.0)
        return np.asarray(axes / np.linalg.norm(axes, axis=-1, keepdims=True))

    def _numbers(self, name: str) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
        """Unit axes (K, 3) or (N, K, 3), and numbers of each wheel (K,), (N, K), (0,) for none."""
        axes = self._unit_axes(name)
        columns, count = {"axes": axes}, axes.shape[-2]
        shapes = f"a number, (1,) or ({count},), (N, 1) or (N, {count}) per body"
        for key in ("inertia", "viscous", "coulomb", "coulomb_speed", "max_torque", "max_speed"):
            value, label = getattr(self, key), f"{name}.{key}"
            columns[key] = np.zeros(0)
            if value is not None or not key.startswith("max"):
                each = models.numbers(label, value, shapes)
                if key in ("inertia", "coulomb_speed", "max_speed"):
                    checks.refuse(label, each, each <= 0.0, "above 0")
                checks.refuse(label, each, each < 0.0, "0 or more")
                columns[key] = np.broadcast_to(each, (*each.shape[:-1], count))
        return axes, columns

    def momenta(self, speeds: ArrayLike, w: ArrayLike) -> NDArray[np.float64]:
        """Angular momenta of the wheels about their axes, h = J (Ω + a·w).

        Parameters
        ----------
        speeds : array_like, shape (..., K)
            Speeds Ω relative to the body, rad/s; a number for all wheels.
        w : array_like, shape (..., 3)
            Angular velocities along body axes, rad/s.

        Returns
        -------
        ndarray, shape (..., K)
            Angular momenta, N·m·s: ``s0`` of a run. If the command is sampled or has states, these
            follow in ``s0``.

        Examples
        --------
        >>> import fastatt as fa
        >>> wheels = fa.torques.ReactionWheels([[0, 0, 1]], 0.1)
        >>> wheels.momenta(speeds=20.0, w=[0, 0, 0.5]).round(6)
        array([2.05])
        """
        axes, columns = self._numbers("ReactionWheels")
        along = np.einsum("...ki,...i->...k", axes, np.asarray(w, np.float64, order="C"))
        return np.asarray(columns["inertia"] * (np.asarray(speeds, dtype=np.float64) + along))

    def speeds(self, s: ArrayLike, w: ArrayLike) -> NDArray[np.float64]:
        """Speeds of the wheels relative to the body, Ω = h/J − a·w.

        Parameters
        ----------
        s : array_like, shape (..., n)
            States of a run, ``Trajectory.s``, whose first K are those of the wheels.
        w : array_like, shape (..., 3)
            Angular velocities along body axes, rad/s.

        Returns
        -------
        ndarray, shape (..., K)
            Speeds, rad/s.

        Examples
        --------
        >>> import fastatt as fa
        >>> wheels = fa.torques.ReactionWheels([[0, 0, 1]], 0.1)
        >>> wheels.speeds(s=[2.05], w=[0, 0, 0.5]).round(6)
        array([20.])
        """
        axes, columns = self._numbers("ReactionWheels")
        along = np.einsum("...ki,...i->...k", axes, np.asarray(w, np.float64, order="C"))
        momenta = np.asarray(s, order="C")[..., : axes.shape[-2]]
        return np.asarray(momenta / columns["inertia"] - along)

    def momentum(self, s: ArrayLike) -> NDArray[np.float64]:
        """Angular momentum of all wheels along body axes, Σ a_k h_k.

        Parameters
        ----------
        s : array_like, shape (..., n)
            States of a run, ``Trajectory.s``, whose first K are those of the wheels.

        Returns
        -------
        ndarray, shape (..., 3)
            Angular momentum, N·m·s.

        Examples
        --------
        >>> import fastatt as fa
        >>> fa.torques.ReactionWheels([[0, 0, 1], [1, 0, 0]], 0.1).momentum([2.0, 0.5])
        array([0.5, 0. , 2. ])
        """
        axes = self._unit_axes("ReactionWheels")
        return np.asarray(
            np.einsum("...k,...ki->...i", np.asarray(s, order="C")[..., : axes.shape[-2]], axes)
        )

    def body_inertia(self, inertia: ArrayLike) -> NDArray[np.float64]:
        """Subtract the moments of the wheels, Σ J_k a_k a_kᵀ, for ``inertia`` of the scene.

        Parameters
        ----------
        inertia : array_like, shape (3,), (3, 3), (N, 3) or (N, 3, 3)
            Moments or tensors of the spacecraft with the wheels held, kg·m².

        Returns
        -------
        ndarray, shape (3, 3) or (N, 3, 3)
            Tensors without the moments of the wheels about their axes, kg·m².

        Raises
        ------
        ValueError
            If a moment of the result is not above 0.

        Examples
        --------
        >>> import numpy as np
        >>> import fastatt as fa
        >>> wheels = fa.torques.ReactionWheels([[0, 0, 1]], 0.1)
        >>> np.diag(wheels.body_inertia((2.0, 2.0, 1.5)))
        array([2. , 2. , 1.4])
        """
        tensor = checks.array("inertia", inertia, "(3,), (3, 3), (N, 3) or (N, 3, 3)")
        if not is_tensor(tensor):
            tensor = tensor[..., None] * np.eye(3)
        axes, columns = self._numbers("ReactionWheels")
        body = tensor - np.einsum("...k,...ki,...kj->...ij", columns["inertia"], axes, axes)
        lowest = np.linalg.eigvalsh(body)[..., 0]
        checks.refuse("inertia: its lowest moment without wheels", lowest, lowest <= 0.0, "above 0")
        return np.asarray(body)


class _Driven(Torque):
    """Wheels as formulas take them."""

    axes: _Rows
    inertia: _OfWheels
    viscous: _OfWheels
    coulomb: _OfWheels
    coulomb_speed: _OfWheels
    max_torque: _OfWheels
    max_speed: _OfWheels
    #: rows of motors' torques by the torque on the body that is commanded
    distribution: _Rows
    params: _OfWheels
    command: Law | UserFunction | None = None
    states: int = 0  # type: ignore[misc]
    #: sample times of a command that is a function
    sampled: Sampling | None = None
    #: the number of wheels, whether steps are divided where their speeds change their signs, and
    #: whether a step across such a change is flagged
    count: int = 0
    divides: bool = False
    rubs: bool = False

    @property
    def samplings(self) -> Any:  # type: ignore[override]
        if isinstance(self.command, Law):
            return self.command.samplings
        return () if self.sampled is None else (self.sampled,)

    @property
    def clocks(self: Any) -> tuple[Sampling | None, ...]:
        _, of_command, sides = self._split((self.sampled,) * self.states)
        of_command = self.command.clocks if isinstance(self.command, Law) else of_command
        return (*(None,) * self.count, *of_command, *(AT_CROSSINGS,) * len(sides))

    def _split(self, states: Any) -> tuple[Any, Any, Any]:
        """The momenta, what the command has, and the signs of the speeds, if they are held."""
        count, end = self.count, self.states - self.count * self.divides
        return states[:count], states[count:end], states[end:]

    def show(self: Any, name: str, t: Any, pose: Pose, states: Vector) -> Vector:
        momenta = states[: len(self.inertia)]
        return self._speeds(momenta, pose.along_body) if name == "speeds" else momenta

    @property
    def reads_position(self) -> bool:  # type: ignore[override]
        """That of a command that is a model."""
        return isinstance(self.command, Law) and self.command.reads_position

    @property
    def reads_sign(self) -> bool:  # type: ignore[override]
        """That of a command that is a model."""
        return isinstance(self.command, Law) and self.command.reads_sign

    def crossed(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        """Those of a command that is a model, and the speeds, if their signs are held."""
        momenta, more, sides = self._split(states)
        is_law = isinstance(self.command, Law)
        of_command = self.command.crossed(t, pose, self.params, more) if is_law else ()
        return (*of_command, *(self._speeds(momenta, pose.along_body) if sides else ()))

    def wheels(self: Any) -> Any:
        return list(zip(self.inertia, self.axes, strict=True))

    def evaluate(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        (momenta, more, sides), body = self._split(states), pose.along_body
        speeds = self._speeds(momenta, body)
        motors, slopes = self._commanded(t, pose, speeds, more)
        motors = tuple(self._within_limits(k, u, speeds[k]) for k, u in enumerate(motors))
        slows = zip(self.coulomb_speed, speeds, strict=True)
        signs = sides or [x / apply("sqrt", slow * slow + x * x) for slow, x in slows]
        each = zip(self.viscous, self.coulomb, speeds, signs, strict=True)
        friction = tuple(c * x + f * sign for c, f, x, sign in each)
        net = tuple(u - f for u, f in zip(motors, friction, strict=True))
        inside = plus(*(scale(h, a) for h, a in zip(momenta, self.axes, strict=True)))
        reaction = plus(*(scale(-u, a) for u, a in zip(net, self.axes, strict=True)))
        torque = plus(vec3.cross(inside, body.w), reaction)
        if pose.axes is not None:
            torque = quat.rotate_inverse(pose.axes, torque)
        return (*torque, *net, *slopes, *(0.0,) * len(sides))

    def update(self: Any, t: Any, pose: Pose, states: Vector, sampling: Sampling) -> Any:
        momenta, more, sides = self._split(states)
        if isinstance(self.command, Law):
            new = self.command.updated(t, pose, self.params, more, None, sampling)
        else:
            speeds = self._speeds(momenta, pose.along_body)
            new = self._called(t, pose, (*speeds, *more[self.count :]))
        return (*momenta, *new, *sides)

    def sides(self: Any, t: Any, pose: Pose, states: Vector) -> list[Vector]:
        momenta, more, _ = self._split(states)
        of_command = isinstance(self.command, Law)
        sides = self.command.sides(t, pose, self.params, more) if of_command else []
        if not self.rubs:
            return sides
        speeds = self._speeds(momenta, pose.along_body)
        each = zip(self.coulomb, self.coulomb_speed, speeds, strict=True)
        # opposite speeds are far apart if their product is above the square of the width
        return sides + [(f * x, f * slow) for f, slow, x in each]

    def _speeds(self: Any, momenta: Vector, body: Pose) -> Vector:
        """The speeds of the wheels relative to the body."""
        return tuple(
            h / j - dot(a, body.w) for h, j, a in zip(momenta, self.inertia, self.axes, strict=True)
        )

    def _called(self: Any, t: Any, pose: Pose, states: Vector) -> Any:
        """What a command that is a function returns, in a row."""
        body = pose.along_body
        torques = self.command.call(t, body.quaternion, body.w, states, self.params)
        torques = tuple(torques) if isinstance(torques, (tuple, list)) else (torques,)
        return as_like(torques, pose.moments[0])

    def _commanded(self: Any, t: Any, pose: Pose, speeds: Vector, states: Vector) -> Any:
        """Torques that are commanded of the motors, and the time derivatives of states."""
        count = len(speeds)
        if self.command is None:
            return (0.0,) * count, ()
        if isinstance(self.command, Law):
            acting = self.command.formula(t, pose, self.params, states=states)
            torque = acting[:3] if pose.axes is None else quat.rotate(pose.axes, acting[:3])
            return tuple(dot(row, torque) for row in self.distribution), acting[3:]
        if self.sampled is not None:
            return states[:count], (0.0,) * len(states)
        results = self._called(t, pose, (*speeds, *states))
        return results[:count], results[count:]

    def _within_limits(self: Any, k: int, torque: Any, speed: Any) -> Any:
        """A motor's torque within what it can give."""
        if self.max_torque:
            limit = self.max_torque[k]
            torque = choose(torque > limit, limit, choose(torque < -limit, -limit, torque))
        if self.max_speed:
            forward = choose(torque < 0.0, -speed, speed)
            room = (self.max_speed[k] - forward) * (1.0 / _FADE) / self.max_speed[k]
            torque = torque * choose(room < 0.0, 0.0, choose(room > 1.0, 1.0, room))
        return torque


# messages name a model by its class
_Driven.__name__ = ReactionWheels.__name__
