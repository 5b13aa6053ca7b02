"""The equations of motion that a method steps: of an attitude, a body, and what moves with it.

A state is a tuple: the numbers of the attitude, then the angular momentum along principal axes and
what else the scene requires. Rates, torques and forces are laws (``scene.models``), which describe
the formulas; the parameters are passed separately, as a flat tuple.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from functools import partial
from typing import Any, NamedTuple, Self

from fastatt.attitudes import QUATERNION, Attitude
from fastatt.scene.law import Law
from fastatt.scene.torque_record import (
    UNCOUPLED,
    CoupledStates,
    Pose,
    damping_rates,
    wheels_of,
)
from fastatt.tracing.formulas import (
    Vector,
    as_like,
    axpy,
    dcm,
    dot,
    minus,
    opposite,
    plus,
    quat,
    rigid,
    scale,
    vec3,
)
from fastatt.tracing.graph import Double, choose, larger


class PrescribedRate(NamedTuple):
    """Structure of a scene with a prescribed rate, along body axes or inertial axes.

    Its parameters are those of the law.
    """

    law: Law
    inertial: bool = False

    @property
    def n_params(self) -> int:
        """Number of parameters."""
        return self.law.count


class RigidBody(NamedTuple):
    """Structure of a rigid body; ``turned`` if the principal axes are not the body axes.

    Its parameters are ½/I (3), I (3), c of ``rigid.gyroscopic_coefficients`` (3), the quaternion p
    of the principal axes (4 or none), and those of the torque.
    """

    law: Law
    turned: bool = False

    @property
    def axes(self) -> int:
        """Number of parameters of the principal axes."""
        return 4 if self.turned else 0

    @property
    def n_params(self) -> int:
        """Number of parameters."""
        return 9 + self.axes + self.law.count


class Structure(NamedTuple):
    """The rates, torques and forces of a scene without their numbers.

    Its parameters are those of ``rotation``, and with mass 1/μ, μ and those of the force. Next to
    the rotation it has the velocity, the position and the states of ``rotation``'s law.
    """

    rotation: PrescribedRate | RigidBody
    force: Law | None = None
    #: whether the position is propagated
    position: bool = False

    @property
    def n_params(self) -> int:
        """Number of parameters."""
        return self.rotation.n_params + (0 if self.force is None else 2 + self.force.count)

    @property
    def reads_position(self) -> bool:
        """Whether the torque or the force depends on the position."""
        if self.force is None:
            return False
        return self.force.reads_position or self.rotation.law.reads_position

    @property
    def coupled(self) -> int:
        """Size of velocity, position and states."""
        moved = (0 if self.force is None else 3) + (3 if self.position else 0)
        return moved + self.rotation.law.states

    @property
    def tail(self) -> int:
        """Size of the auxiliary state."""
        return self.coupled + (3 if isinstance(self.rotation, RigidBody) else 0)


class EquationsOfMotion:
    """The interface between a method's step and a scene in a representation.

    Each class has ``at(t)``, what ``field`` needs of a time and is evaluated once for all stages
    that share it; ``field(g, x)``, the time derivative of a state without low parts, then that of
    the scene's states; ``base(x)``, the state without its low parts; ``advanced(x, d)``, x + d with
    the rounding error kept in the low parts; ``speed_squared(g, xdot, x)``, the square of the rate
    (rad/s) that limits an explicit step; ``begin(q, auxiliary)``, the state at an attitude and an
    auxiliary state; ``output(x, finish)``, the numbers that a trajectory holds and the norm error,
    where ``finish`` converts the attitude; and ``pose(t, x)``, attitude and angular velocity of the
    body axes.
    """

    attitude: Attitude
    _between: tuple[Any, Any] | None = None

    def __init__(self, attitude: Attitude) -> None:
        self.attitude = attitude

    def evaluate_between(self, low: Any, high: Any) -> None:
        """Limit the times at which rates, torques and forces are evaluated.

        They lie next to two breakpoints, so that a step that ends at a breakpoint does not evaluate
        beyond it.
        """
        self._between = low, high

    def instant(self, t: Any) -> Any:
        """The time at which rates, torques and forces are evaluated for the time t."""
        if self._between is None:
            return t
        low, high = self._between
        return choose(t < low, low, choose(t > high, high, t))

    @property
    def plain(self) -> Attitude:
        """The attitude without low parts."""
        return self.attitude.plain

    def near(self, x: Vector) -> Self:
        """The equations less than π away from a state without low parts.

        They are smooth also where an attitude is no rotation, as within a step of a matrix.
        """
        motion = copy(self)
        motion.attitude = self.attitude.near(x[: self.plain.size])
        return motion

    def turned(self, x: Vector, u: Vector) -> Any:
        """An attitude rotated by a rotation vector."""
        return self.attitude.rotate(x, u)

    def invariants(self, x: Vector) -> Vector:
        """The invariants of the motion; () if there are none."""
        return ()

    def sides(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> list[Vector]:
        """On which side of their jumps the models of a torque are."""
        return []


class Turning(EquationsOfMotion):
    """The equations of an attitude with a prescribed rate."""

    def __init__(self, attitude: Attitude, structure: PrescribedRate, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        self.structure, self.p, self._like = structure, p, like

    def rate(self, t: Any, states: Vector = ()) -> Vector:
        """w(t), rad/s, along the body axes of the state that is stepped, in its precision.

        The time derivatives of the law's states follow.
        """
        results = self.structure.law.formula(self.instant(t), self.p, states=states)
        w = opposite(results[:3]) if self.structure.inertial else results[:3]
        return tuple(as_like(x, self._like) for x in (*w, *results[3:]))

    def at(self, t: Any) -> Any:
        return t if self.structure.law.states else self.rate(t)

    def _rate(self, g: Any, coupled: CoupledStates) -> Vector:
        """The rate and the derivatives of states; ``at`` evaluated it if it depends on no state."""
        return self.rate(g, coupled.states) if self.structure.law.states else g

    def field(self, g: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> Any:
        w = self._rate(g, coupled)
        return (*self.plain.derivative(x, w[:3]), *w[3:])

    def base(self, x: Vector) -> Vector:
        return self.attitude.value(x)

    def advanced(self, x: Vector, d: Vector) -> Any:
        return self.attitude.add(x, d)

    def speed_squared(
        self, g: Any, xdot: Vector, x: Vector, coupled: CoupledStates = UNCOUPLED
    ) -> Any:
        return self.attitude.speed_squared(xdot, self._rate(g, coupled)[:3])

    def begin(self, q: Vector, auxiliary: Vector) -> Any:
        a = self.attitude.start(q)
        return self.attitude.flip(a) if self.structure.inertial else a

    def output(self, x: Vector, finish: Callable[[Vector], Any]) -> Any:
        return finish(self.attitude.flip(x) if self.structure.inertial else x)

    def pose(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> tuple[Vector, Vector]:
        w = self.rate(t, coupled.states)[:3]
        if not self.structure.inertial:
            return self.attitude.quaternion(x), w
        q = self.attitude.quaternion(self.attitude.flip(x))
        return q, quat.rotate_inverse(q, opposite(w))


class Body(EquationsOfMotion):
    """The equations of a rigid body, whose state is the attitude and the momentum m.

    The momentum is along principal axes, N·m·s.
    """

    def __init__(self, attitude: Attitude, structure: RigidBody, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        self.structure = structure
        numbers = as_like(tuple(p[: 9 + structure.axes]), like)
        self.half_inverse, self.moments, self.gyroscopic = numbers[:3], numbers[3:6], numbers[6:9]
        self.axes = numbers[9:] if structure.turned else None
        #: the moments in the precision of the parameters, for torques
        self.axes_given = p[9:13] if structure.turned else None
        self.torque_numbers = p[9 + structure.axes :]
        self.is_free = not structure.law.terms

    def attitude_of(self, x: Vector) -> Vector:
        """The attitude in a state."""
        return x[: self.attitude.size]

    def momentum_of(self, x: Vector) -> Vector:
        """The momentum in a state, with its low part."""
        return x[self.attitude.size :]

    def angular_velocity(self, m: Vector) -> Vector:
        """w = I⁻¹ m, rad/s, principal axes."""
        v = [k * u for k, u in zip(self.half_inverse, m, strict=False)]
        return tuple(a + a for a in v)

    def _posed(self, time: Any, a: Vector, w: Vector, coupled: CoupledStates) -> Pose:
        wheels = partial(wheels_of, self.structure.law, self.torque_numbers)
        shown = self.shown(time, coupled)
        return Pose(self.plain, a, w, self.moments, coupled, self.axes_given, wheels, shown=shown)

    def shown(self, time: Any, coupled: CoupledStates) -> Callable[[Pose, str], Vector]:
        """The numbers that a term shows at a pose, by its name."""
        law, p = self.structure.law, self.torque_numbers

        def shown(pose: Pose, name: str) -> Vector:
            numbers = law.shown(pose, name, time, p, coupled.states)
            return tuple(as_like(x, pose.w[0]) for x in numbers)

        return shown

    def torque(self, t: Any, a: Vector, w: Vector, coupled: CoupledStates = UNCOUPLED) -> Vector:
        """Torque (N·m, principal axes) at an attitude a, in its plain form, and a rate w.

        The time derivatives of the law's states follow.
        """
        time, law = self.instant(t), self.structure.law
        pose = self._posed(time, a, w, coupled)
        torque = law.formula(time, pose, self.torque_numbers, states=coupled.states)
        return tuple(as_like(x, a[0]) for x in torque)

    def updated_states(
        self, t: Any, a: Vector, m: Vector, coupled: CoupledStates, *jump: Any
    ) -> Vector:
        """The law's states after a sample time, at attitude a and momentum m without low parts."""
        time, law = self.instant(t), self.structure.law
        pose = self._posed(time, a, self.angular_velocity(m), coupled)
        states = law.updated(time, pose, self.torque_numbers, coupled.states, *jump)
        return tuple(as_like(x, a[0]) for x in states)

    def momentum_rate(
        self, t: Any, a: Vector, m: Vector, coupled: CoupledStates = UNCOUPLED
    ) -> Vector:
        """ṁ = m×w + τ at an attitude a and a momentum m, then the derivatives of the states."""
        gyroscopic: Vector = rigid.gyroscopic(m, self.gyroscopic)
        if self.is_free:
            return gyroscopic
        torque = self.torque(t, a, self.angular_velocity(m), coupled)
        return (*plus(gyroscopic, torque[:3]), *torque[3:])

    def at(self, t: Any) -> Any:
        return t

    def field(self, g: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> Vector:
        n = self.plain.size
        a, m = x[:n], x[n:]
        v = tuple(k * u for k, u in zip(self.half_inverse, m, strict=True))
        return (*self.plain.half_derivative(a, v), *self.momentum_rate(g, a, m, coupled))

    def base(self, x: Vector) -> Vector:
        a, m = self.attitude_of(x), self.momentum_of(x)
        return (*self.attitude.value(a), *m[:3])

    def advanced(self, x: Vector, d: Vector) -> Vector:
        n = self.plain.size
        a, m = self.attitude_of(x), self.momentum_of(x)
        return (*self.attitude.add(a, d[:n]), *self.attitude.add_vector(m, d[n:]))

    def speed_squared(
        self, g: Any, xdot: Vector, x: Vector, coupled: CoupledStates = UNCOUPLED
    ) -> Any:
        n = self.plain.size
        w = self.angular_velocity(x[n:])
        return self.attitude.speed_squared(xdot[:n], w)

    def kick(self, t: Any, h: Any, a: Vector, m: Vector) -> Vector:
        """The momentum after h s of torque at a fixed attitude, with exact linear damping."""
        torque = self.torque(t, a, (0.0, 0.0, 0.0))
        law, turned = self.structure.law, self.structure.turned
        rates = damping_rates(law, self.moments, self.torque_numbers, turned=turned)
        if rates is None:
            return axpy(h, torque, m)
        decays = [rigid.exp_decay(k * h) for k in rates]
        return tuple(e * u + h * f * b for (e, f), u, b in zip(decays, m, torque, strict=True))

    def begin(self, q: Vector, auxiliary: Vector) -> Vector:
        a = self.attitude.start(q)
        w = auxiliary
        if self.axes is not None:
            # a matrix has exact zeros for permuted axes: without them the rounding of a needle's
            # spin would enter the other axes and be multiplied by their moments
            w = dcm.rotate_inverse(dcm.from_quat(self.axes), w)
            a = self.attitude.compose(a, self.axes)
        return (*a, *self.attitude.carry(rigid.momentum(w, self.moments)))

    def output(self, x: Vector, finish: Callable[[Vector], Any]) -> tuple[Vector, Any]:
        a, w = self.attitude_of(x), self.angular_velocity(self.momentum_of(x)[:3])
        if self.axes is not None:
            w = dcm.rotate(dcm.from_quat(self.axes), w)
            a = self.attitude.compose(a, quat.conj(self.axes))
        y, d = finish(a)
        return (*y, *w), d

    def invariants(self, x: Vector) -> Vector:
        """``|m|²`` and 2T of a free body."""
        if not self.is_free:
            return ()
        m = self.momentum_of(x)[:3]
        return dot(m, m), dot(m, self.angular_velocity(m))

    def sides(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> list[Vector]:
        time, base, n = self.instant(t), self.base(x), self.plain.size
        pose = self._posed(time, base[:n], self.angular_velocity(base[n:]), coupled)
        return self.structure.law.sides(time, pose, self.torque_numbers, coupled.states)

    def pose(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> tuple[Vector, Vector]:
        q = self.attitude.quaternion(self.attitude_of(x))
        w = self.angular_velocity(self.momentum_of(x)[:3])
        if self.axes is None:
            return q, w
        return quat.mul(q, quat.conj(self.axes)), quat.rotate(self.axes, w)


def rotation_of(
    structure: PrescribedRate | RigidBody, attitude: Attitude, p: Vector, like: Any
) -> Turning | Body:
    """The equations of a rotation; ``like`` has the state's precision."""
    if isinstance(structure, PrescribedRate):
        return Turning(attitude, structure, p, like)
    return Body(attitude, structure, p, like)


def acceleration(
    force: Law, t: Any, q: Vector, w: Vector, coupled: CoupledStates, p: Any, shown: Any = None
) -> Any:
    """The acceleration by a force, m/s² along body axes; p are 1/μ, μ and its parameters.

    ``shown`` shows the numbers of the torque's terms.
    """
    pose = Pose(QUATERNION, q, w, coupled=coupled, mass=p[1], shown=shown)
    acting = force.formula(t, pose, p[2:])
    return scale(p[0], as_like(tuple(acting), q[0]))


class Coupled(EquationsOfMotion):
    """The equations of motion of a scene with mass or states, as one system.

    v̇ = F/μ − w×v along body axes and, if the position is propagated, ṙ = C v along inertial axes,
    together with the equations of the rotation. These may depend on v, r and the states, and
    contain the time derivatives of the states.
    """

    def __init__(self, attitude: Attitude, structure: Structure, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        n = structure.rotation.n_params
        self.inner = rotation_of(structure.rotation, attitude, p[:n], like)
        # stages are evaluated without low parts
        self.stage = rotation_of(structure.rotation, attitude.plain, p[:n], like)
        self._coupled, self._force = structure.coupled, structure.force
        self._states = structure.rotation.law.states
        #: 1/μ, μ and the parameters of the force; empty without a force
        self._numbers = p[n:]
        #: squares of the orbital rates at the stages of the step that is being recorded
        self._squares: list[Any] = []

    def evaluate_between(self, low: Any, high: Any) -> None:
        super().evaluate_between(low, high)
        self.inner.evaluate_between(low, high)
        self.stage.evaluate_between(low, high)

    def near(self, x: Vector) -> Self:
        motion = super().near(x)
        motion.inner, motion.stage = self.inner.near(x), self.stage.near(x)
        return motion

    def _split(self, x: Vector) -> tuple[Vector, Vector]:
        """The state of the rotation, and velocity, position and states as far as there are any."""
        n = len(x) - self._coupled
        return x[:n], x[n:]

    def _named(self, moved: Vector) -> CoupledStates:
        """Velocity, position and states by their names."""
        n = len(moved) - self._states
        return CoupledStates(moved[: min(3, n)], moved[3:n], moved[n:])

    def _translation(self, force: Law, t: Any, a: Vector, coupled: CoupledStates) -> Vector:
        """v̇ along body axes and, if the position is propagated, ṙ along inertial axes."""
        v, r = coupled.velocity, coupled.position
        q, w = self.stage.pose(t, a, coupled)
        q = quat.renormalise(q)
        time, body = self.instant(t), self.stage
        shown = body.shown(time, coupled) if isinstance(body, Body) else None
        push = acceleration(force, time, q, w, coupled, self._numbers, shown)
        if r:
            terms = force.having("squared_rate", None, self._numbers[2:])
            self._squares += [x.squared_rate(r) for x in terms]
        return (*minus(push, vec3.cross(w, v)), *(quat.rotate(q, v) if r else ()))

    def at(self, t: Any) -> Any:
        return t, self.inner.at(t)

    def field(self, g: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> Vector:
        t, of_rotation = g
        a, moved = self._split(x)
        coupled = self._named(moved)
        translated = () if self._force is None else self._translation(self._force, t, a, coupled)
        rotated = self.inner.field(of_rotation, a, coupled)
        n = len(rotated) - self._states
        return (*rotated[:n], *translated, *rotated[n:])

    def updated(self, t: Any, x: Vector, *jump: Any) -> Vector:
        """The state after a sample time, of a body: its states jump, all else goes on.

        ``jump`` is one of the law's.
        """
        assert isinstance(self.inner, Body)
        a, moved = self._split(x)
        base, n = self.inner.base(a), self.plain.size
        states = self.inner.updated_states(t, base[:n], base[n:], self._named(moved), *jump)
        return (*x[: len(x) - self._states], *states)

    def shown(self, t: Any, x: Vector, names: Iterable[str]) -> list[Vector]:
        """What terms of a body's torque show at a state, by their names."""
        assert isinstance(self.stage, Body)
        q, w = self.pose(t, x)
        shown = self.stage.shown(self.instant(t), self._named(self._split(x)[1]))
        return [
            shown(Pose(QUATERNION, quat.renormalise(q), w, shown=shown), name) for name in names
        ]

    def crossed(self, t: Any, x: Vector) -> list[Any]:
        """The functions of a body's switches at a state, in doubles."""
        body = self.stage
        if not isinstance(body, Body):
            return []
        time, (q, w) = self.instant(t), self.pose(t, x)
        coupled = CoupledStates(*(tuple(map(Double, y)) for y in self._named(self._split(x)[1])))
        q, w = (tuple(map(Double, y)) for y in (quat.renormalise(q), w))
        pose = Pose(QUATERNION, q, w, coupled=coupled, shown=body.shown(time, coupled))
        return body.structure.law.crossed(time, pose, body.torque_numbers, coupled.states)

    def base(self, x: Vector) -> Vector:
        a, moved = self._split(x)
        return (*self.inner.base(a), *moved)

    def advanced(self, x: Vector, d: Vector) -> Vector:
        (a, moved), (d_a, d_moved) = self._split(x), self._split(d)
        return (*self.inner.advanced(a, d_a), *plus(moved, d_moved))

    def speed_squared(
        self, g: Any, xdot: Vector, x: Vector, coupled: CoupledStates = UNCOUPLED
    ) -> Any:
        a, moved = self._split(x)
        square = self.inner.speed_squared(g[1], self._split(xdot)[0], a, self._named(moved))
        for of_stage in self._squares:
            # times four, since limits hold for a quaternion, which rotates at half the body's rate
            square = larger(square, as_like(4.0 * of_stage, x[0]))
        self._squares.clear()
        return square

    def begin(self, q: Vector, auxiliary: Vector) -> Vector:
        y, moved = self._split(auxiliary)
        return (*self.inner.begin(q, y), *moved)

    def output(self, x: Vector, finish: Callable[[Vector], Any]) -> tuple[Vector, Any]:
        a, moved = self._split(x)
        y, d = self.inner.output(a, finish)
        return (*y, *moved), d

    def invariants(self, x: Vector) -> Vector:
        return self.inner.invariants(self._split(x)[0])

    def sides(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> list[Vector]:
        a, moved = self._split(x)
        return self.inner.sides(t, a, self._named(moved))

    def pose(self, t: Any, x: Vector, coupled: CoupledStates = UNCOUPLED) -> tuple[Vector, Vector]:
        a, moved = self._split(x)
        return self.inner.pose(t, a, self._named(moved))


Motion = Turning | Body | Coupled


def motion_of(structure: Structure, attitude: Attitude, p: Vector, like: Any) -> Motion:
    """The equations of motion of a scene; ``like`` has the state's precision."""
    if structure.coupled:
        return Coupled(attitude, structure, p, like)
    return rotation_of(structure.rotation, attitude, p, like)
