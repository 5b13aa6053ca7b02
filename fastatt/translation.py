"""Velocity and position over one step, beside an attitude that a method has stepped."""

from __future__ import annotations

from typing import Any

from fastatt.flat.formulas import Vector, as_like, axpy, newton, plus, quat, scale
from fastatt.motion import Body, Moving, Turning


class Translation:
    """What a scene with mass carries beside a motion: velocity, and position if it is asked for."""

    def __init__(self, motion: Turning | Body, structure: Moving, p: Vector) -> None:
        self.motion, self.structure = motion, structure
        self._inverse_mass, self._numbers = p[0], p[1:]

    def split(self, x: Vector) -> tuple[Vector, Vector, Vector]:
        """State of the motion, velocity (body axes), position (inertial axes) or ()."""
        n = len(x) - (6 if self.structure.position else 3)
        return x[:n], x[n : n + 3], x[n + 3 :]

    def acceleration(self, t: Any, q: Vector, w: Vector, v: Vector) -> Vector:
        """F/μ along body axes."""
        force = self.structure.law.formula(t, q, w, v, self._numbers)
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
