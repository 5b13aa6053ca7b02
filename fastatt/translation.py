"""Velocity and position: over one step beside an attitude, or as one system with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastatt.attitudes import Attitude
from fastatt.flat.formulas import (
    Vector,
    as_like,
    axpy,
    minus,
    newton,
    plus,
    quat,
    scale,
    vec3,
)
from fastatt.flat.functions import larger
from fastatt.forces import squares_of_rates
from fastatt.motion import Body, Motion, Structure, Turning, motion_of


class Translation:
    """What a scene with mass carries beside a motion: velocity, and position if it is asked for."""

    def __init__(self, motion: Turning | Body, structure: Structure, p: Vector) -> None:
        assert structure.force is not None
        self.motion, self._moved, self._force = motion, structure.moved, structure.force
        self._inverse_mass, self._numbers = p[0], p[1:]

    def split(self, x: Vector) -> tuple[Vector, Vector, Vector]:
        """State of the motion, velocity (body axes), position (inertial axes) or ()."""
        n = len(x) - self._moved
        return x[:n], x[n : n + 3], x[n + 3 :]

    def acceleration(self, t: Any, q: Vector, w: Vector, v: Vector, r: Vector = ()) -> Vector:
        """F/μ along body axes; r is the position where something reads it."""
        force = self._force.formula(t, q, w, v, r, self._numbers)
        return scale(self._inverse_mass, as_like(tuple(force), v[0]))

    def moved(self, t: Any, h: Any, x: Vector, turned: Vector) -> Vector:
        """Velocity and position after a step from the state x, whose motion ends in ``turned``."""
        before, v, r = self.split(x)
        q0, w0 = self.motion.pose(t, before)
        q1, w1 = self.motion.pose(t + h, turned)
        end, d = self._step(t, h, (q0, w0), (q1, w1), v)
        return (*end, *(plus(r, d) if r else ()))

    def _step(self, t: Any, h: Any, start: Any, end: Any, v: Vector) -> tuple[Vector, Vector]:
        """(velocity at the end, what the body moved), along the axes of the start and of space."""
        (q0, w0), (q1, w1) = start, end
        half = 0.5 * h
        q0, q1 = quat.renormalise(q0), quat.renormalise(q1)
        u = quat.log(quat.mul(quat.conj(q0), q1))
        turn, wm = newton.middle(u, h, w0, w1)
        em, e1 = quat.exp(turn), quat.exp(u)
        qm = quat.mul(q0, em)
        k1 = self.acceleration(t, q0, w0, v)
        v2 = quat.rotate_inverse(em, axpy(half, k1, v))
        k2 = quat.rotate(em, self.acceleration(t + half, qm, wm, v2))
        v3 = quat.rotate_inverse(em, axpy(half, k2, v))
        f = self.acceleration(t + half, qm, wm, v3)
        k3 = quat.rotate(em, f)
        v4 = quat.rotate_inverse(e1, axpy(h, k3, v))
        k4 = quat.rotate(e1, self.acceleration(t + h, q1, w1, v4))
        velocity = quat.rotate_inverse(e1, newton.velocity(h, u, v, k1, k2, k3, k4, f))
        return velocity, quat.rotate(q0, newton.displacement(h, u, v, k1, k2, k3, f))

    def squares_of_rates(self, r: Vector) -> list[Any]:
        """Squares of the rates (rad/s) at which the body falls round centres."""
        return squares_of_rates(self._force, r, self._numbers)


class Coupled(Motion):
    """What turns with what moves: its state is that of the motion, the velocity, the position.

    v̇ = F/μ − w×v and ṙ = C v, beside the motion's own equations, in which r and v may stand.
    """

    def __init__(self, attitude: Attitude, structure: Structure, p: Vector, like: Any) -> None:
        super().__init__(attitude)
        n = structure.turning.n_params
        self.inner = motion_of(structure.turning, attitude, p[:n], like)
        # stages have no low parts
        self._stage = motion_of(structure.turning, attitude.plain, p[:n], like)
        self._moved = Translation(self._stage, structure, p[n:])
        #: of the rates of falling at the stages of the step that is being recorded
        self._squares: list[Any] = []

    def at(self, t: Any) -> Any:
        return t, self.inner.at(t)

    def field(self, g: Any, x: Vector, place: Vector = ()) -> Vector:
        t, given = g
        a, v, r = self._moved.split(x)
        q, w = self._stage.pose(t, a)
        q = quat.renormalise(q)
        push = self._moved.acceleration(t, q, w, v, r)
        self._squares += self._moved.squares_of_rates(r)
        turned = self.inner.field(given, a, (v, r))
        return (*turned, *minus(push, vec3.cross(w, v)), *quat.rotate(q, v))

    def base(self, x: Vector) -> Vector:
        a, v, r = self._moved.split(x)
        return (*self.inner.base(a), *v, *r)

    def advanced(self, x: Vector, d: Vector) -> Vector:
        a, v, r = self._moved.split(x)
        turned = self.inner.advanced(a, d[:-6])
        return (*turned, *plus((*v, *r), d[-6:]))

    def turning(self, g: Any, xdot: Vector, x: Vector) -> Any:
        square = self.inner.turning(g[1], xdot[:-6], x[:-6])
        for of_stage in self._squares:
            # four times: a quaternion, for which limits hold, turns at half the body's rate
            square = larger(square, as_like(4.0 * of_stage, x[0]))
        self._squares.clear()
        return square

    def begin(self, q: Vector, beside: Vector) -> Vector:
        return (*self.inner.begin(q, beside[:-6]), *beside[-6:])

    def hand_out(self, x: Vector, finish: Callable[[Vector], Any]) -> tuple[Vector, Any]:
        y, d = self.inner.hand_out(x[:-6], finish)
        return (*y, *x[-6:]), d

    def invariants(self, x: Vector) -> Vector:
        return self.inner.invariants(x[:-6])

    def pose(self, t: Any, x: Vector) -> tuple[Vector, Vector]:
        return self.inner.pose(t, x[:-6])
