"""A representation of the attitude as a record of formulas, which all methods use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fastatt._fork import cached_property
from fastatt.codegen.rows import kind_of, rows
from fastatt.tracing.formulas import Vector, dot, plus, quat, scale
from fastatt.tracing.graph import Graph, flattened
from fastatt.tracing.nodes import TraceError
from fastatt.tracing.trace import traceable

#: a function of tuples of traced numbers; None if a representation does not have it
Formula = Any
_PACKAGE = str(Path(__file__).parents[1])
_FORMULAS = (
    "start", "finish", "derivative", "rotate", "rotate_short", "compose", "quaternion", "to_body",
    "flip", "restore", "raw", "half_derivative", "rotate_first", "rotate_third", "speed_squared",
)  # fmt: skip


#: groups of representations that share the limits of steps
FAMILIES = ("quaternion", "matrix", "mrp", "coordinates")
# step, s, and tolerance for comparing a derivative with a finite difference
_SMALL, _ALIKE = 1e-4, 1e-9


def _told(x: Any) -> str:
    return f"({', '.join(f'{y:.6g}' for y in x)})"


def same(x: Any) -> Any:
    """Return the argument."""
    return x


def body_speed(xdot: Vector, w: Vector) -> Any:
    """``|w|²``, for representations whose numbers change no faster than the body rotates."""
    return dot(w, w)


def coordinate_speed(xdot: Vector, w: Vector) -> Any:
    """``|ẋ|²``, for coordinates, which change faster than the body rotates near a pole."""
    return dot(xdot, xdot)


def _is_own(formula: Any) -> bool:
    """Whether a formula is user-defined or a plain kernel, and has to be traced."""
    if formula is None or hasattr(formula, "py_func"):
        return formula is not None
    code = getattr(formula, "__code__", None)
    return code is None or not code.co_filename.startswith(_PACKAGE)


def composed(compose: Formula) -> dict[str, Formula]:
    """``compose`` x∘q, with the rotations that follow from it."""
    return {
        "compose": compose,
        "rotate": lambda x, u: compose(x, quat.exp(u)),
        "rotate_short": lambda x, u: compose(x, quat.exp_short(u)),
    }


@dataclass(frozen=True, eq=False)
class Attitude:
    """A representation of the attitude: how it is stored while it is propagated.

    A custom representation is accepted wherever a name is. It needs ``start``, ``quaternion`` and
    either ``derivative``, for Runge-Kutta methods, or ``rotate``, for methods with exponentials.
    The other formulas have defaults that follow from these. All formulas take and return tuples; x
    is the state of ``size`` numbers, q a unit quaternion from body to inertial axes, u a rotation
    vector (rad, body axes), w an angular velocity (rad/s, body axes).

    Formulas may be ordinary functions with ``math``, conditions and the kernels of
    :mod:`fastatt.kernels`. They are traced: called once, with numbers that record the operations.

    Parameters
    ----------
    name : str
        Name of the representation.
    size : int
        Number of values in the state.
    stored : int
        Number of values that a trajectory holds.
    start : callable
        ``start(q)`` is the state at a quaternion of any norm above zero.
    finish : callable, optional
        ``finish(x)`` returns (the values that a trajectory holds, the norm error).
    derivative : callable, optional
        ``derivative(x, w)`` is ẋ.
    rotate : callable, optional
        ``rotate(x, u)`` is x∘exp(u).
    rotate_short : callable, optional
        ``rotate`` for rotation angles of at most π.
    compose : callable, optional
        ``compose(x, q)`` is x∘q.
    quaternion : callable, optional
        ``quaternion(x)`` is the attitude as a unit quaternion.
    to_body : callable, optional
        ``to_body(x, v)`` is Cᵀ v, an inertial vector along body axes.
    flip : callable, optional
        ``flip(x)`` is the inverse attitude.
    restore : callable, optional
        ``restore(x)`` returns (the projected state, the norm error).
    raw : callable, optional
        ``raw(x)`` is what a trajectory holds if the state is not projected.
    half_derivative : callable, optional
        ẋ at the rate 2w, if it takes fewer operations than ``derivative``.
    rotate_first : callable, optional
        Rotation about the first axis, from the cosine and sine of half the angle.
    rotate_third : callable, optional
        Rotation about the third axis, from the cosine and sine of half the angle.
    speed_squared : callable, optional
        Square of the rate that limits an explicit step.
    family : str, default ""
        Which limits of steps hold: a key of ``Method.limits``. The default is the smallest limit of
        all.
    uncompensated : Attitude, optional
        The representation without compensation of rounding, for one that has it.
    coordinates : int, default 4
        Number of values of an initial attitude.
    add : callable, optional
        x + d of a compensated attitude.
    add_vector : callable, optional
        x + d of a compensated vector.
    carry : callable, optional
        A vector with the low parts of its compensation.
    to_dcm_array : callable, optional
        Matrices (..., 3, 3) of stored values (..., stored).
    to_quat_array : callable, optional
        Quaternions (..., 4) of stored values.
    to_euler313_array : callable, optional
        3-1-3 Euler angles (..., 3) of stored values.
    is_usual : bool, default False
        Whether ``fastatt precompile`` includes it by default.
    summary : str, default ""
        A line for tables.

    Raises
    ------
    TypeError, ValueError
        If a custom formula cannot be traced, or gives wrong values at one attitude and rate. The
        message names the formula.

    Examples
    --------
    >>> import math
    >>> import fastatt as fa
    >>> def derivative(x, w):  # Gibbs' vector tan(θ/2) e: ẋ = ½ (w + x×w + (x·w) x)
    ...     d = x[0] * w[0] + x[1] * w[1] + x[2] * w[2]
    ...     c = fa.kernels.vec3.cross(x, w)
    ...     return tuple(0.5 * (a + b + d * y) for a, b, y in zip(w, c, x))
    >>> def quaternion(x):
    ...     s = 1.0 / math.sqrt(1.0 + x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    ...     return s, s * x[0], s * x[1], s * x[2]
    >>> gibbs = fa.Attitude(
    ...     "gibbs", size=3, stored=3, derivative=derivative, quaternion=quaternion,
    ...     start=lambda q: (q[1] / q[0], q[2] / q[0], q[3] / q[0]),
    ... )
    >>> scene = fa.Scene(rate=fa.rates.Constant([0.0, 0.0, 1.0]))
    >>> run = fa.propagate(scene, [1, 0, 0, 0], dt=0.01, n_steps=100, representation=gibbs)
    >>> round(2.0 * math.atan2(run.q[-1, 3], run.q[-1, 0]), 9)
    1.0
    """

    name: str
    size: int
    stored: int
    start: Formula
    finish: Formula = lambda x: (x, 0.0)
    derivative: Formula = None
    rotate: Formula = None
    rotate_short: Formula = None
    compose: Formula = None
    quaternion: Formula = None
    to_body: Formula = None
    flip: Formula = None
    restore: Formula = None
    raw: Formula = same
    #: ẋ at the rate 2w, if it takes fewer operations than ``derivative``
    half_derivative: Formula = None
    #: rotated about the first and the third axis, from cosine and sine of half the angle
    rotate_first: Formula = None
    rotate_third: Formula = None
    #: square of the rate that limits an explicit step
    speed_squared: Formula = body_speed
    #: which limits of steps hold, of ``FAMILIES``: those of quaternions, which change at half the
    #: body's rate, of matrices, which change at its rate, of modified Rodrigues parameters, or of
    #: coordinates with poles; "" the smallest of all
    family: str = ""
    #: the representation without low parts, for one that compensates rounding
    uncompensated: Attitude | None = None
    #: size of an initial attitude, 4 for a quaternion
    coordinates: int = 4
    #: x + d of a compensated state, for its attitude and for a vector
    add: Formula = plus
    add_vector: Formula = plus
    carry: Formula = same
    #: matrices (…, 3, 3), quaternions (…, 4), or 3-1-3 Euler angles (…, 3) of stored values
    to_dcm_array: Formula = None
    to_quat_array: Formula = None
    to_euler313_array: Formula = None
    #: whether ``fastatt precompile`` compiles it by default
    is_usual: bool = False
    summary: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        own = [name for name in _FORMULAS if _is_own(getattr(self, name))]
        for name in own:
            try:
                object.__setattr__(self, name, traceable(getattr(self, name)))
            except TraceError as error:
                raise TypeError(f"{name}: {error}; accepted: a function of tuples") from error
        if own:
            self._check(own)
        if self.quaternion is not None:
            self._complete()
            self._read()
        if own:
            self._compare(own)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Pickle the library's representations by name, since they contain nested functions."""
        from fastatt import attitudes

        known = next((k for k, x in attitudes.KNOWN.items() if x is self), None)
        return (_known, (known,)) if known else super().__reduce_ex__(protocol)

    def _complete(self) -> None:
        """Set the formulas that follow from ``start`` and ``quaternion``."""
        start, quaternion, derivative = self.start, self.quaternion, self.derivative
        made: dict[str, Formula] = {
            "compose": lambda x, q: start(quat.mul(quaternion(x), q)),
            "to_body": lambda x, v: quat.rotate_inverse(quaternion(x), v),
            "flip": lambda x: start(quat.conj(quaternion(x))),
            "half_derivative": lambda x, v: derivative(x, plus(v, v)),
        }
        for name, formula in made.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, formula)

    def _read(self) -> None:
        """Set the stored values and their conversion to quaternions, if they are not given."""
        if self.stored != self.size and self.raw is same:
            object.__setattr__(self, "raw", lambda x: self.finish(x)[0])
        if self.to_quat_array is not None or self.to_dcm_array is not None:
            return
        if self.stored == self.size:
            inputs = {"x": self.size}

            def to_quat(state: Any) -> Any:
                (q,) = rows(self.quaternion, inputs, (4,), kind_of(state.dtype))(state)
                return q

            object.__setattr__(self, "to_quat_array", to_quat)
        elif self.stored != 4:
            raise ValueError(
                f"stored: found {self.stored} numbers of a state of {self.size}; accepted: all of "
                "them, or the 4 of a quaternion, unless to_quat_array or to_dcm_array is given"
            )

    def _check(self, own: Sequence[str]) -> None:
        """Check that custom formulas return the right number of values."""
        if self.quaternion is None or (self.derivative is None and self.rotate is None):
            raise ValueError(
                "quaternion, derivative, rotate: missing; accepted: quaternion, and derivative or "
                "rotate"
            )
        graph = Graph()
        q, x, w = (graph.inputs("double", *y) for y in (("q", 4), ("x", self.size), ("w", 3)))
        calls: dict[str, tuple[Any, ...]] = {
            "start": (q,), "derivative": (x, w), "rotate": (x, w), "rotate_short": (x, w),
            "compose": (x, q), "flip": (x,), "quaternion": (x,), "to_body": (x, w),
            "finish": (x,), "restore": (x,), "raw": (x,),
        }  # fmt: skip
        sizes = {
            "quaternion": 4, "to_body": 3, "finish": self.stored + 1, "restore": self.size + 1,
            "raw": self.stored,
        }  # fmt: skip
        for name in (*own, "finish"):
            if name not in calls:
                continue
            try:
                found = flattened(getattr(self, name)(*calls[name]))
            except TraceError as error:
                raise TypeError(f"{name}: {error}; accepted: formulas that are recorded") from error
            wanted = sizes.get(name, self.size)
            if len(found) != wanted:
                raise ValueError(f"{name}: gives {len(found)} numbers; accepted: {wanted}")

    def _compare(self, own: Sequence[str]) -> None:
        """Check that custom formulas agree with each other at one attitude and rate."""
        q, w = quat.exp((0.25, -0.15, 0.4)), (0.3, -0.5, 0.7)
        x: Any = self.start(q)
        turned, after = quat.mul(q, quat.exp(w)), quat.mul(q, quat.exp(scale(_SMALL, w)))

        def moved() -> Any:
            return plus(x, scale(_SMALL, self.derivative(x, w)))

        cases: dict[str, tuple[Any, str, Any, bool]] = {
            "start": (lambda: x, "q", q, True),
            "derivative": (moved, "q∘exp(h w), to h²", after, True),
            "rotate": (lambda: self.rotate(x, w), "q∘exp(u)", turned, True),
            "rotate_short": (lambda: self.rotate_short(x, w), "q∘exp(u)", turned, True),
            "compose": (lambda: self.compose(x, after), "x∘q", quat.mul(q, after), True),
            "flip": (lambda: self.flip(x), "the inverse of q", quat.conj(q), True),
            "restore": (lambda: self.restore(x)[0], "q", q, True),
            "to_body": (lambda: self.to_body(x, w), "q*∘v∘q", quat.rotate_inverse(q, w), False),
        }  # fmt: skip
        for name, (find, wanted, value, is_state) in cases.items():
            if name not in own and name != "start":
                continue
            found = find()
            found = self.quaternion(found) if is_state else found
            apart = min(
                max(abs(a - sign * b) for a, b in zip(found, value, strict=True))
                for sign in ((1.0, -1.0) if is_state else (1.0,))
            )
            if not apart < (_SMALL**1.5 if name == "derivative" else _ALIKE):
                both = "start, quaternion" if name == "start" else name
                raise ValueError(
                    f"{both}: of q = {_told(q)} and w = u = v = {_told(w)} comes {_told(found)}; "
                    f"accepted: {wanted}, {_told(value)}"
                )

    @property
    def compensated(self) -> bool:
        """Whether it compensates rounding."""
        return self.uncompensated is not None

    @property
    def has_poles(self) -> bool:
        """Whether its coordinates have poles, near which they change without bound."""
        return self.speed_squared is not body_speed

    @cached_property
    def plain(self) -> Attitude:
        """The representation without low parts."""
        return self.uncompensated or self

    @cached_property
    def short(self) -> Attitude:
        """The representation whose ``rotate`` is for angles of at most π."""
        if self.rotate_short is None or self.rotate is self.rotate_short:
            return self
        low = self.uncompensated
        return replace(
            self, rotate=self.rotate_short, uncompensated=None if low is None else low.short
        )

    def value(self, x: Vector) -> Vector:
        """The state without its low parts.

        Parameters
        ----------
        x : tuple
            A state.

        Returns
        -------
        tuple
            Its high parts.
        """
        return x[: len(x) // 2] if self.compensated else x


def _known(name: str) -> Attitude:
    """The library's representation of a name."""
    from fastatt import attitudes

    return attitudes.KNOWN[name]
