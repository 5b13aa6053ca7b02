"""What a torque is: the base class of models, the pose at which it is evaluated, its properties.

The torques of user-defined functions are here too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from enum import IntEnum
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastatt import checks
from fastatt._cached import cached_property
from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene import models
from fastatt.scene.law import Law
from fastatt.scene.models import Model, Packed, PackedTerm, Packing, Sum, UserModel
from fastatt.tracing.formulas import Vector, as_like, plus, quat
from fastatt.tracing.user import UserFunction, user_function


class Dependence(IntEnum):
    """How a torque depends on w: not, by linear damping along principal axes, or otherwise."""

    POSITION = 0
    DAMPED = 1
    RATE = 2


class CoupledStates(NamedTuple):
    """The quantities that are stepped with an attitude; () for those that a scene does not have.

    The velocity is along body axes and the position along inertial axes; the states are those of a
    user-defined function.
    """

    velocity: Vector = ()
    position: Vector = ()
    states: Vector = ()


UNCOUPLED = CoupledStates()


class Pose:
    """Attitude, angular velocity and principal moments at which a torque is evaluated.

    ``coupled`` has the quantities that are stepped with the attitude, with the velocity along body
    axes; ``axes`` is the quaternion of the principal axes, along which the pose is given, if these
    are not the body axes. ``wheels()`` are (moment of inertia, axis along body axes) of reaction
    wheels, which the principal moments do not contain. Forces are evaluated at a pose of the body
    axes, without moments, with the ``mass``.
    """

    def __init__(
        self,
        attitude: Attitude,
        x: Vector,
        w: Vector,
        moments: Vector = (),
        coupled: CoupledStates = UNCOUPLED,
        axes: Vector | None = None,
        wheels: Callable[[], Iterable[tuple[Any, Vector]]] = tuple,
        mass: Any = None,
        shown: Callable[[Pose, str], Vector] | None = None,
    ) -> None:
        self._attitude, self._x = attitude, x
        self.w, self.moments, self.coupled, self.axes = w, moments, coupled, axes
        self.wheels, self.mass, self._shown = wheels, mass, shown

    @cached_property
    def quaternion(self) -> Any:
        """The attitude as a quaternion, of unit norm to the accuracy of the state."""
        return self._attitude.quaternion(self._x)

    def to_body(self, v: Vector) -> Any:
        """Components of an inertial vector along the axes of the pose."""
        return self._attitude.to_body(self._x, v)

    def shown(self, name: str) -> Vector:
        """The numbers that a term of the law shows, by its name."""
        assert self._shown is not None
        return self._shown(self, name)

    @cached_property
    def along_body(self) -> Pose:
        """The pose along the body axes."""
        if self.axes is None:
            return self
        q = quat.mul(self.quaternion, quat.conj(self.axes))
        w, shown = quat.rotate(self.axes, self.w), self._shown
        return Pose(QUATERNION, q, w, self.moments, self.coupled, shown=shown)


class Torque(Model):
    """Base class of torques: ``formula(t, pose)``, N·m along the axes of the pose.

    With ``states`` it is ``formula(t, pose, states)``, which returns their time derivatives after
    the torque.

    Optional methods open further uses of a torque. ``energy(t, pose)`` is the potential energy, J;
    ``linear_damping()`` the three coefficients, N·m·s, of linear damping, and ``decay()`` bounds
    of them as an array. ``lever()`` is (arm, pull), in body and in inertial axes, of a potential
    energy arm·Cᵀpull; a symmetric body with the arm on its axis has a closed form.
    ``wheel_momentum()`` is the angular momentum of wheels, N·m·s along body axes, of torques that
    conserve the momentum of body and wheels together. ``wheels()`` is (moment of inertia, axis) of
    each reaction wheel. ``sides(t, pose, states)`` are vectors that rotate by more than 90° where
    the torque jumps, for the flag of a step across.
    """

    kind = "torque"
    #: how it depends on w; splitting methods evaluate a torque of POSITION at w = 0
    depends: ClassVar[Dependence] = Dependence.RATE
    #: whether the formula holds along any axes, or along body axes only
    axis_free: ClassVar[bool] = False
    energy: ClassVar[Any] = None
    linear_damping: ClassVar[Any] = None
    decay: ClassVar[Any] = None
    lever: ClassVar[Any] = None
    wheel_momentum: ClassVar[Any] = None
    wheels: ClassVar[Any] = None
    #: whether it holds numbers for other terms and is no torque
    exerts_nothing: ClassVar[bool] = False

    def sides(self, t: Any, pose: Pose, states: Vector) -> list[Vector]:
        """Vectors that rotate by more than 90° where the torque jumps."""
        return []

    def evaluate(self, *state: Any) -> Any:
        """The torque along the axes of a pose, from (t, pose) and the states, if there are any."""
        t, pose, *states = state
        if pose.axes is None or self.axis_free:
            return self.formula(t, pose, *states)
        along_body = self.formula(t, pose.along_body, *states)
        return (*quat.rotate_inverse(pose.axes, along_body[:3]), *along_body[3:])


# tolerance of the norm of unit vectors
ROUNDED = 1e-3


def check_unit(name: str, value: Any, strength: Any) -> None:
    """Refuse vectors that have an effect and are not of unit length to a few digits."""
    with np.errstate(over="ignore"):
        size = np.linalg.norm(value, axis=0)
    off = (strength != 0.0) & (np.abs(size - 1.0) > ROUNDED)
    checks.refuse(f"{name}: its length", size, off, "1")


class Custom(UserModel, Torque):
    """A torque given by a user-defined function.

    Parameters
    ----------
    function : callable
        ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m along body axes, plain or jitted. Its arguments
        are the time, s, the unit quaternion, the angular velocity, rad/s, and the parameters, all
        but t as tuples. With ``uses_position`` it is ``torque(t, q, w, v, r, p)``, with the
        velocity v along body axes, m/s, and the position r along inertial axes, m. With ``states``
        it takes the states s before p and returns ``(torque, ds/dt)``.
    params : array_like of shape (P,) or (N, P), optional
        Parameters p of the function.
    uses_rate : bool, default True
        False promises that the function does not depend on w, so that splitting methods accept it.
        The promise is checked at a few points.
    potential : callable, optional
        ``potential(t, q, p)``, the potential energy, J, plain or jitted, for :func:`fastatt.drift`.
        A small rotation δ along body axes changes it by −τ·δ, with the torque τ.
        With ``uses_position`` it is ``potential(t, q, r, p)``, the energy of torque and force
        together.
    uses_position : bool, default False
        Whether the function depends on velocity or position. The scene then needs mass, and
        everything is stepped as one system, by methods for which ``Method.couples`` is True.
    states : int, default 0
        Number of states s of the function, which are stepped with the attitude as one system.
    reads : str or tuple of str, default ()
        Names of terms of a :class:`Sum`, whose numbers the function takes as tuples, one for each
        name, before s: ``torque(t, q, w, wheels, p)``.

    Examples
    --------
    >>> import fastatt as fa
    >>> def spring(t, q, w, p):
    ...     return 0.0, 0.0, -p[0] * q[0] * q[3]
    >>> torque = fa.torques.Custom(spring, (0.5,), uses_rate=False)
    """

    uses_rate: bool = True
    potential: Callable[..., Any] | None = None
    uses_position: bool = False
    states: int = 0  # type: ignore[misc]
    reads: str | tuple[str, ...] = ()  # type: ignore[assignment]

    @property
    def depends(self) -> Dependence:  # type: ignore[override]
        uses_rate = checks.flag("uses_rate", self.uses_rate)
        return Dependence.RATE if uses_rate else Dependence.POSITION

    @property
    def energy(self) -> Any:
        return None if self.potential is None else self._energy

    def _energy(self: Any, t: Any, pose: Pose) -> Any:
        return self.potential.call(t, pose.quaternion, pose.coupled.position, self.params)

    def formula(self: Any, t: Any, pose: Pose, *states: Vector) -> Any:
        placed = pose.coupled[:2] if self.uses_position else ()
        read = map(pose.shown, self.reads)
        torque = self.function.call(
            t, pose.quaternion, pose.w, *placed, *read, *states, self.params
        )
        return as_like(torque, pose.moments[0])

    def pack(self, packing: Packing) -> PackedTerm:
        term, params = super().pack(packing)
        function = term.model.function
        # checked when the scene is made, not at each run
        if (
            self.depends is Dependence.POSITION
            and packing.n_bodies is None
            and _uses_rate(function)
        ):
            raise ValueError(
                f"{packing.argument}: found Custom.uses_rate False with {function.name}, which "
                "gives other torques at some w than at w = 0; accepted: True, or a function that "
                "does not use w"
            )
        if self.potential is not None:
            role = self.role.replace("torque", "potential")
            energy = user_function(self.potential, role, params.shape[-1], params)
            packing.tables.update(energy.tables)
            term = replace(term, model=replace(term.model, potential=energy))
        return term, params


def _uses_rate(function: UserFunction) -> bool:
    """Whether a user-defined torque at a few points differs from the torque at w = 0."""
    for point in function.usual:
        t, q, w, *rest = function.nested(point.tolist())
        turning, still = (np.array(function.call(t, q, v, *rest)) for v in (w, (0.0, 0.0, 0.0)))
        size = np.max(np.abs(still), where=np.isfinite(still), initial=0.0)
        if not np.allclose(turning, still, rtol=0.0, atol=1e-9 * size, equal_nan=True):
            return True
    return False


def potential_of(law: Law, t: Any, pose: Pose, p: Vector) -> Any:
    """Potential energy (J) of a law that has one."""
    terms = law.having("energy", t, p)
    return sum((x.energy(t, pose if x.axis_free else pose.along_body) for x in terms), 0.0)


def damping_rates(law: Law, moments: Vector, p: Vector, *, turned: bool = False) -> Vector | None:
    """c_i/I_i, 1/s, of the linear damping among the terms of a law; None if there is none.

    ``turned`` says that the principal axes are not the body axes.
    """
    # the flow of damping along axes other than principal ones is not known
    terms = law.having("linear_damping", None, p)
    coefficients = [x.linear_damping() for x in terms if x.axis_free or not turned]
    rates = [tuple(c / i for c, i in zip(x, moments, strict=True)) for x in coefficients]
    return plus(*rates) if rates else None


def wheels_of(law: Law, p: Vector) -> list[tuple[Any, Vector]]:
    """(moment of inertia, axis) of each reaction wheel among the terms of a law."""
    return [wheel for x in law.having("wheels", None, p) for wheel in x.wheels()]


def fastest_decay(model: Any, moments: NDArray[np.float64]) -> NDArray[np.float64]:
    """An upper bound of c/I of the linear damping in a model, 1/s, for each body or for all."""
    if isinstance(model, Sum):
        return sum((fastest_decay(term, moments) for term in model.terms), np.zeros(()))
    if not isinstance(model, Torque) or model.decay is None:
        return np.zeros(())
    coefficients = np.atleast_1d(np.abs(np.asarray(model.decay(), dtype=np.float64)))
    return np.asarray(coefficients.max(axis=-1) / moments.min(axis=-1))


def lever_of(model: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """(arm, pull) of a model that has a lever, each (3,) or (N, 3); None for any other model."""
    if not isinstance(model, Torque) or model.lever is None:
        return None
    term, params = model.pack(Packing(None, "torque", {}))
    if any(term.look_ups):  # tables depend on time
        return None
    arm, pull = term.numbers(None, np.moveaxis(params, -1, 0)).lever()
    return np.stack(arm, axis=-1), np.stack(np.broadcast_arrays(*pull), axis=-1)


def has_potential(law: Law) -> bool:
    """Whether kinetic plus potential energy is conserved under a law."""
    # tables depend on time
    return all(not any(term.look_ups) and term.model.energy is not None for term in law.terms)


def dependence(law: Law, *, turned: bool = False) -> Dependence:
    """How a law depends on w; damping per axis counts as such only if axes are not ``turned``."""
    each = (
        Dependence.RATE
        if x.depends is Dependence.DAMPED and turned and not x.axis_free
        else x.depends
        for x in law.models
    )
    return max(each, default=Dependence.POSITION)


def pack(model: Any, n_bodies: int | None) -> Packed:
    """``models.pack`` of a torque, or of none."""
    if model is None:
        return Packed(Law(()), np.zeros(0), {})
    return models.pack(model, Torque, n_bodies)
