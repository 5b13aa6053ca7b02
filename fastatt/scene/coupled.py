"""Equations of motion in which velocity, position or states are stepped with the attitude."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

from fastatt.attitudes import Attitude
from fastatt.scene.equations import Body, EquationsOfMotion, Structure, motion_of
from fastatt.scene.forces import squares_of_rates
from fastatt.scene.models import Law
from fastatt.scene.torque_record import ALONE, Beside
from fastatt.tracing.formulas import Vector, as_like, minus, plus, quat, scale, vec3
from fastatt.tracing.functions import larger


class Coupled(EquationsOfMotion):
    """The equations of motion of a scene with mass or states, as one system.

    v̇ = F/μ − w×v along body axes and, if the position is propagated, ṙ = C v along inertial axes,
    together with the equations of the rotation. These may depend on v, r and the states, and
    contain the time derivatives of the states.
    """

    def __init__(self, attitude: Attitude, structure: Structure, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        n = structure.turning.n_params
        self.inner = motion_of(structure.turning, attitude, p[:n], like)
        # stages are evaluated without low parts
        self.stage = motion_of(structure.turning, attitude.plain, p[:n], like)
        self._beside, self._force = structure.beside, structure.force
        self._states = structure.turning.law.states
        #: 1/μ and the parameters of the force; empty without a force
        self._numbers = p[n:]
        #: squares of the orbital rates at the stages of the step that is being recorded
        self._squares: list[Any] = []

    def evaluate_between(self, low: Any, high: Any) -> None:
        super().evaluate_between(low, high)
        self.inner.evaluate_between(low, high)
        self.stage.evaluate_between(low, high)

    def near(self, x: Vector) -> Self:
        found = super().near(x)
        found.inner, found.stage = self.inner.near(x), self.stage.near(x)
        return found

    def _split(self, x: Vector) -> tuple[Vector, Vector]:
        """The state of the rotation, and velocity, position and states as far as there are any."""
        n = len(x) - self._beside
        return x[:n], x[n:]

    def _named(self, moved: Vector) -> Beside:
        """Velocity, position and states by their names."""
        n = len(moved) - self._states
        return Beside(moved[: min(3, n)], moved[3:n], moved[n:])

    def _translation(self, force: Law, t: Any, a: Vector, beside: Beside) -> Vector:
        """v̇ along body axes and, if the position is propagated, ṙ along inertial axes."""
        v, r = beside.velocity, beside.position
        q, w = self.stage.pose(t, a, beside)
        q = quat.renormalise(q)
        acting = force.formula(self.instant(t), q, w, *beside, self._numbers[1:])
        push = scale(self._numbers[0], as_like(tuple(acting), v[0]))
        if r:
            self._squares += squares_of_rates(force, r, self._numbers[1:])
        return (*minus(push, vec3.cross(w, v)), *(quat.rotate(q, v) if r else ()))

    def at(self, t: Any) -> Any:
        return t, self.inner.at(t)

    def field(self, g: Any, x: Vector, beside: Beside = ALONE) -> Vector:
        t, given = g
        a, moved = self._split(x)
        beside = self._named(moved)
        translated = () if self._force is None else self._translation(self._force, t, a, beside)
        found = self.inner.field(given, a, beside)
        n = len(found) - self._states
        return (*found[:n], *translated, *found[n:])

    def updated(self, t: Any, x: Vector) -> Vector:
        """The state after a sample time, of a body: its states jump, all else goes on."""
        assert isinstance(self.inner, Body)
        a, moved = self._split(x)
        base, n = self.inner.base(a), self.plain.size
        states = self.inner.updated_states(t, base[:n], base[n:], self._named(moved))
        return (*x[: len(x) - self._states], *states)

    def base(self, x: Vector) -> Vector:
        a, moved = self._split(x)
        return (*self.inner.base(a), *moved)

    def advanced(self, x: Vector, d: Vector) -> Vector:
        (a, moved), (d_a, d_moved) = self._split(x), self._split(d)
        return (*self.inner.advanced(a, d_a), *plus(moved, d_moved))

    def turning(self, g: Any, xdot: Vector, x: Vector, beside: Beside = ALONE) -> Any:
        a, moved = self._split(x)
        square = self.inner.turning(g[1], self._split(xdot)[0], a, self._named(moved))
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

    def pose(self, t: Any, x: Vector, beside: Beside = ALONE) -> tuple[Vector, Vector]:
        a, moved = self._split(x)
        return self.inner.pose(t, a, self._named(moved))
