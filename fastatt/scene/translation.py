"""Attitude, rate, velocity and position as one system, stepped together."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastatt.attitudes import Attitude
from fastatt.scene.equations import EquationsOfMotion, Structure, motion_of
from fastatt.scene.forces import squares_of_rates
from fastatt.tracing.formulas import Vector, as_like, minus, plus, quat, scale, vec3
from fastatt.tracing.functions import larger


class Coupled(EquationsOfMotion):
    """The motion of a scene with mass: its state is that of the rotation, velocity and position.

    v̇ = F/μ − w×v along body axes and, where the position is carried, ṙ = C v along inertial axes,
    together with the equations of the rotation, in which v and r may stand.
    """

    def __init__(self, attitude: Attitude, structure: Structure, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        assert structure.force is not None
        n = structure.turning.n_params
        self.inner = motion_of(structure.turning, attitude, p[:n], like)
        # stages have no low parts
        self._stage = motion_of(structure.turning, attitude.plain, p[:n], like)
        self._moved, self._force = structure.moved, structure.force
        self._inverse_mass, self._numbers = p[n], p[n + 1 :]
        #: squares of the rates of falling at the stages of the step that is being recorded
        self._squares: list[Any] = []

    def evaluate_between(self, low: Any, high: Any) -> None:
        super().evaluate_between(low, high)
        self.inner.evaluate_between(low, high)
        self._stage.evaluate_between(low, high)

    def _split(self, x: Vector) -> tuple[Vector, Vector]:
        """State of the rotation; velocity and, where it is carried, position."""
        n = len(x) - self._moved
        return x[:n], x[n:]

    def _acceleration(self, t: Any, q: Vector, w: Vector, v: Vector, r: Vector) -> Vector:
        """F/μ along body axes."""
        force = self._force.formula(self.instant(t), q, w, v, r, self._numbers)
        return scale(self._inverse_mass, as_like(tuple(force), v[0]))

    def at(self, t: Any) -> Any:
        return t, self.inner.at(t)

    def field(self, g: Any, x: Vector, place: Vector = ()) -> Vector:
        t, given = g
        a, moved = self._split(x)
        v, r = moved[:3], moved[3:]
        q, w = self._stage.pose(t, a)
        q = quat.renormalise(q)
        push = self._acceleration(t, q, w, v, r)
        if r:
            self._squares += squares_of_rates(self._force, r, self._numbers)
        turned = self.inner.field(given, a, (v, r))
        return (*turned, *minus(push, vec3.cross(w, v)), *(quat.rotate(q, v) if r else ()))

    def base(self, x: Vector) -> Vector:
        a, moved = self._split(x)
        return (*self.inner.base(a), *moved)

    def advanced(self, x: Vector, d: Vector) -> Vector:
        (a, moved), (d_a, d_moved) = self._split(x), self._split(d)
        return (*self.inner.advanced(a, d_a), *plus(moved, d_moved))

    def turning(self, g: Any, xdot: Vector, x: Vector) -> Any:
        square = self.inner.turning(g[1], self._split(xdot)[0], self._split(x)[0])
        for of_stage in self._squares:
            # four times: a quaternion, for which limits hold, turns at half the body's rate
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

    def pose(self, t: Any, x: Vector) -> tuple[Vector, Vector]:
        return self.inner.pose(t, self._split(x)[0])
