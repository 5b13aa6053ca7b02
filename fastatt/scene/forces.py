"""Forces on a body, for Newton's equation along body axes, m (v̇ + w×v) = F.

Forces are in N. Those that are fixed in space, such as weights, are given along inertial axes. The
parameters of a model may be arrays with one row per body.
"""

from __future__ import annotations

from typing import Any, ClassVar

from fastatt.scene.models import (
    Model,
    Number,
    PositiveNumber,
    Sum,
    TabledVector,
    UserModel,
)
from fastatt.scene.torque_record import Pose
from fastatt.tracing.formulas import Vector, dot, scale
from fastatt.tracing.graph import apply
from fastatt.tracing.signature import SIGNATURES
from fastatt.tracing.user import UserFunction

#: the roles of a user-defined force
_ROLES = "force", "force at position"


class Force(Model):
    """Base class of forces: ``formula(t, pose)``, N along body axes.

    ``pose.coupled`` has velocity, position and the states of the scene's rate or torque. The
    optional method ``squared_rate(r)`` returns the square of the orbital rate (rad/s) of a body at
    r.
    """

    kind = "force"
    squared_rate: ClassVar[Any] = None


class Constant(Force):
    """A constant force along body axes, such as a thrust.

    Parameters
    ----------
    force : array_like of shape (3,) or (N, 3), or TimeSeries
        Force, N; a table makes it a function of time.

    Examples
    --------
    >>> import fastatt as fa
    >>> thrust = fa.forces.Constant((0.0, 0.0, 5.0))
    """

    force: TabledVector

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return self.force


class ConstantInertial(Force):
    """A constant force along inertial axes, such as a weight.

    Parameters
    ----------
    force : array_like of shape (3,) or (N, 3), or TimeSeries
        Force, N; a table makes it a function of time.

    Examples
    --------
    >>> import fastatt as fa
    >>> weight = fa.forces.ConstantInertial((0.0, 0.0, -9.80665))
    """

    force: TabledVector

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return pose.to_body(self.force)


class Drag(Force):
    """Linear drag F = −c v.

    Parameters
    ----------
    coefficient : float or array_like of shape (N,)
        c, kg/s.

    Examples
    --------
    >>> import fastatt as fa
    >>> drag = fa.forces.Drag(0.1)
    """

    coefficient: Number

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        return scale(-self.coefficient, pose.coupled.velocity)


class CentralGravity(Force):
    """Gravity of a point mass at the origin, F = −(μ m/r³) r.

    r is the position of the body, m, and m the mass of the scene. Methods for which
    ``Method.couples`` is True accept this force. The check of the step size treats 2 √(μ/r³) as a
    rate of rotation.

    Parameters
    ----------
    gravitational_parameter : float or array_like of shape (N,), default 3.986004418e14
        μ, m³/s². The default is that of the Earth (IERS Conventions 2010, table 1.1).

    Examples
    --------
    >>> import fastatt as fa
    >>> scene = fa.Scene(inertia=(3.0, 2.0, 1.0), mass=10.0, force=fa.forces.CentralGravity())
    """

    gravitational_parameter: PositiveNumber = 3.986004418e14
    reads_position = True

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        r = pose.coupled.position
        return pose.to_body(scale(-pose.mass * self.squared_rate(r), r))

    def squared_rate(self: Any, r: Vector) -> Any:
        inverse = 1.0 / apply("sqrt", dot(r, r))
        return self.gravitational_parameter * inverse * (inverse * inverse)


class Custom(UserModel, Force):
    """A force given by a user-defined function.

    Parameters
    ----------
    function : callable
        ``force(t, q, w, v, p) -> (f1, f2, f3)``, N along body axes, plain or jitted. Its arguments
        are the time, s, the quaternion, the angular velocity, rad/s, the velocity along body axes,
        m/s, and the parameters, all but t as tuples. With ``uses_position`` it is ``force(t, q, w,
        v, r, p)``, with the position r along inertial axes, m. In a scene with states a function
        with one argument more takes all states s, before p: ``force(t, q, w, v, s, p)`` or
        ``force(t, q, w, v, r, s, p)``.
    params : array_like of shape (P,) or (N, P), optional
        Parameters p of the function.
    uses_position : bool, default False
        Whether the function depends on the position. Attitude, velocity and position are then
        stepped as one system, by methods for which ``Method.couples`` is True.
    reads : str or tuple of str, default ()
        Names of terms of the torque, a :class:`fastatt.torques.Sum`, whose numbers the function
        takes as tuples, one for each name, before s: ``force(t, q, w, v, valve, p)``.

    Examples
    --------
    >>> import fastatt as fa
    >>> def drag(t, q, w, v, p):
    ...     return -p[0] * v[0], -p[0] * v[1], -p[1] * v[2]
    >>> force = fa.forces.Custom(drag, (0.1, 0.3))
    """

    uses_position: bool = False
    reads: str | tuple[str, ...] = ()  # type: ignore[assignment]

    def formula(self: Any, t: Any, pose: Pose) -> Any:
        v, r, s = pose.coupled
        placed = (r,) if self.uses_position else ()
        read = map(pose.shown, self.reads)
        return self.function.call(t, pose.quaternion, pose.w, v, *placed, *read, s, self.params)

    def takes(self, states: int) -> int:
        """The number of a scene's states that the function takes, by the number of its arguments.

        Raises ``TypeError`` for more arguments than it can take.
        """
        function = self.function
        if not isinstance(function, UserFunction):
            function = UserFunction(function)
        names, signature = function.required, SIGNATURES[self.role]
        more = len(names) - len(signature.before) - len(self.reads) - 1
        if more <= 0:
            return 0
        # the states, not a position that was not asked for
        if more > 1 or not states or ("r" in names and not self.uses_position):
            reads = [(name, 0) for name in self.reads]
            signatures = [SIGNATURES[name].with_reads(reads) for name in _ROLES]
            calls = [each.with_states(n).call for each in signatures for n in (0, 1)]
            raise TypeError(
                f"force: found {function.called_as}; accepted: "
                f"{calls[0]}, in a scene with states also {calls[1]}, and with uses_position=True "
                f"{calls[2]} or {calls[3]}"
            )
        return states


__all__ = ["CentralGravity", "Constant", "ConstantInertial", "Custom", "Drag", "Sum"]


def __dir__() -> list[str]:
    return __all__
