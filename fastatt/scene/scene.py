"""``Scene``: the inertia, rates, torques and forces of bodies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastatt import checks, rounding
from fastatt._cached import cached_property
from fastatt._jit import plain
from fastatt.kernels import rigid
from fastatt.scene import models, torque_record
from fastatt.scene.equations import PrescribedRate, RigidBody, Structure
from fastatt.scene.inertia import (
    Principal,
    is_sorted,
    is_spherical,
    is_symmetric,
    principal,
    sort_axes,
)
from fastatt.scene.law import Law, Place, Sampling
from fastatt.scene.models import Packed, join, numbers, row_count
from fastatt.scene.switch import Switch
from fastatt.scene.time_series import TimeSeries
from fastatt.scene.torque_record import Dependence
from fastatt.tracing.signature import SIGNATURES
from fastatt.tracing.user import UserFunction

# bodies of which the kind is asked first
_FIRST = 64


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """The bodies that are propagated, with their rates, torques and forces.

    A scene has either a prescribed ``rate``, or ``inertia`` and optionally a ``torque``; then
    Euler's equations are integrated. With ``mass`` and ``force`` the velocity is propagated too.
    Each number may be the same for all bodies, or an array with one row for each body.

    Parameters
    ----------
    rate : model or callable, optional
        Angular velocity as a function of time: a model of :mod:`fastatt.rates`, or a function
        ``rate(t, p) -> (w1, w2, w3)``, rad/s, with t in s and the tuple p of ``params``.
    params : array_like of shape (P,) or (N, P), optional
        Parameters of the user-defined rate or torque.
    frame : {"body", "inertial"}, default "body"
        Axes along which the rate is given: q̇ = ½ q∘w for "body", q̇ = ½ w∘q for "inertial".
    inertia : array_like of shape (3,), (3, 3), (N, 3) or (N, 3, 3), optional
        Principal moments, or tensors along the body axes, kg·m². A (3, 3) array is one tensor.
    torque : model or callable, optional
        A model of :mod:`fastatt.torques`, or a function ``torque(t, q, w, p) -> (t1, t2, t3)``, N·m
        along body axes, with the unit quaternion q, the angular velocity w, rad/s, and ``params``
        p.
    allow_unphysical : bool, default False
        Accept an inertia that no rigid body can have.
    mass : float or array_like of shape (N,), optional
        Mass, kg. The velocity v along body axes is then propagated, by m (v̇ + w×v) = F.
    force : model, array_like or callable, optional
        A model of :mod:`fastatt.forces`, (3,) or (N, 3) in N along body axes, or a function
        ``force(t, q, w, v, p)`` without parameters. Required with ``mass``.
    states : int, default 0
        Number n of states s of the user-defined function, such as the integral of a controller, the
        speed of a wheel or a flexible mode. The function is then ``torque(t, q, w, s, p) ->
        (torque, ds/dt)`` or ``rate(t, s, p) -> (rate, ds/dt)``, with tuples of 3 and of n numbers.
        The force may read the states, as ``force(t, q, w, v, s, p)``.
    breakpoints : array_like of shape (B,), default ()
        Times, s, at which a rate, torque or force jumps or has a kink. Steps end there, so that the
        method keeps its order. Those of tables in models and of ``rates.Slew`` are known. All
        bodies share them: for times (N, k) of each body give ``np.unique(times)``, each of which
        costs all bodies a step, or let the torque read a ``torques.Switch`` of ``t - p[0]``.

    Attributes
    ----------
    rows : int or None
        Number of bodies if any number differs between bodies; None if all bodies share all numbers.
    parts : dict of str to slice
        Where the states of each term of a :class:`fastatt.torques.Sum` with names are in ``run.s``
        and ``s0``. ``s0`` may also be a mapping of these names to initial values, (n,) or (N, n);
        those of controllers may be missing, and are then 0.

    Raises
    ------
    TypeError, ValueError
        If a model or a frame is unknown, a number has the wrong shape, or inertia is not that of a
        body.

    Notes
    -----
    A user-defined function is frozen: values that it refers to are read when the scene is made, and
    later changes of them do not reach it. It is then followed, so that its operations become part
    of the compiled loop, or called by the loop, or refused (:attr:`functions` says which).

    q and −q are the same attitude. In the representation "quat" the quaternion that a function
    receives changes continuously from ``q0`` on; in others its sign may be another one and jump. A
    torque, force or event that differs for the two, such as ``q[1]`` in place of ``q[0] * q[1]``,
    is refused there.

    If a torque or a force depends on the position, or if there are states, everything is stepped as
    one system, to the order of the method, by methods for which ``Method.couples`` is True.

    A step that contains a breakpoint is divided into shorter steps of the same method. A part that
    ends at the breakpoint evaluates the function just before it, and a part that begins there just
    after it, so that ``<`` and ``<=`` in the function give the same result.

    A scene keeps read-only copies of its arrays; ``dataclasses.replace`` makes a changed scene.
    Scenes with equal values are equal. ``scene[bodies]``, with an index, a slice or an array, is
    the scene of these bodies alone; numbers that all bodies share stay shared.

    Examples
    --------
    A free body, and one with damping and a user-defined torque:

    >>> import fastatt as fa
    >>> fa.Scene(inertia=(2.0, 1.0, 2 / 3)).kind
    'free'
    >>> def torque(t, q, w, p):
    ...     return -p[0] * w[0], -p[0] * w[1], -p[1] * w[2]
    >>> fa.Scene(inertia=(2.0, 1.0, 2 / 3), torque=torque, params=(0.02, 0.05)).kind
    'torqued'
    """

    rate: Any = None
    params: ArrayLike | None = None
    frame: str = "body"
    inertia: ArrayLike | None = None
    torque: Any = None
    allow_unphysical: bool = False
    mass: ArrayLike | None = None
    force: Any = None
    states: int = 0
    breakpoints: Any = ()
    #: the number of bodies, if any number differs between bodies
    rows: ClassVar[int | None] = None
    #: whether a torque or a force depends on the position, which is then propagated
    needs_position: ClassVar[bool] = False
    #: when states of a sampled controller jump
    samplings: ClassVar[tuple[Sampling, ...]] = ()
    #: the samplings of the jumps, in their order
    jumps: ClassVar[tuple[Sampling, ...]] = ()
    #: for each state the sampling that sets it, None if it is stepped
    clocks: ClassVar[tuple[Sampling | None, ...]] = ()
    #: of the rate or the torque, and of the force
    _law: ClassVar[Law]
    _force: ClassVar[Law | None]

    def __post_init__(self) -> None:
        checks.choice("frame", self.frame, ("body", "inertial"))
        checks.flag("allow_unphysical", self.allow_unphysical)
        if (self.rate is None) == (self.inertia is None):
            told = "neither" if self.rate is None else "both"
            if self.rate is None and self.torque is not None:
                told = "neither, with a torque, which needs inertia"
            raise ValueError(f"rate, inertia: found {told}; accepted: one of them")
        if self.params is not None and not callable(self._acting):
            raise ValueError(
                f"params: found {checks.brief(self.params)} with the model "
                f"{type(self._acting).__name__}; accepted: params with a function only"
            )
        if (self.mass is None) != (self.force is None):
            missing = "force" if self.force is None else "mass"
            raise ValueError(f"{missing}: is missing; mass and force go together")
        if self.rate is not None and self.torque is not None:
            raise ValueError("torque: found with a rate; accepted: with inertia only")
        if self.rate is None and self.frame != "body":
            raise ValueError('frame: found "inertial" with inertia; accepted: "body"')
        checks.whole("states", self.states, 0)
        object.__setattr__(self, "breakpoints", _breakpoints(self.breakpoints))
        if self.breakpoints and self._acting is None and self.mass is None:
            raise ValueError(
                "breakpoints: found for a free body; accepted: with a rate, torque or force"
            )
        for name in ("rate", "torque", "force"):
            object.__setattr__(self, name, _held(getattr(self, name)))
        structure, params, _ = self.packed(None)
        if self.mass is None and structure.rotation.law.reads_position:
            raise ValueError(
                "torque: found one that depends on the position, without a mass; accepted: "
                "with mass and force"
            )
        carried = structure.rotation.law.states
        if self.states not in (0, carried):
            raise ValueError(
                f"states: found {self.states} with {checks.brief(self._acting)}; accepted: "
                f"{carried}, the number of its states, or a function that takes them"
            )
        if any(isinstance(x.model, Switch) and not x.name for x in structure.rotation.law.terms):
            raise ValueError(
                "torque: found a Switch without a name; accepted: a term of a Sum with names"
            )
        for law in filter(None, (structure.rotation.law, structure.force)):
            _warn_of_pulses(law)
        object.__setattr__(self, "_law", structure.rotation.law)
        object.__setattr__(self, "_force", structure.force)
        object.__setattr__(self, "clocks", tuple(structure.rotation.law.clocks))
        object.__setattr__(self, "states", carried)
        object.__setattr__(self, "samplings", structure.rotation.law.samplings)
        object.__setattr__(self, "jumps", tuple(x for _, x in structure.rotation.law.jumps))
        # computed once, since it takes long for many bodies
        object.__setattr__(self, "rows", len(params) if params.ndim == 2 else None)
        object.__setattr__(self, "needs_position", structure.reads_position)
        for field in fields(self):
            object.__setattr__(self, field.name, _read_only(getattr(self, field.name)))

    @property
    def _given(self) -> tuple[Any, ...]:
        return tuple(getattr(self, field.name) for field in fields(self))

    @property
    def _key(self) -> tuple[Any, ...]:
        return tuple(map(_key, self._given))

    def __repr__(self) -> str:
        shown = [
            f"{field.name}={checks.brief(x)}"
            for field, x in zip(fields(self), self._given, strict=True)
            if isinstance(x, np.ndarray) or x != field.default
        ]
        return f"Scene({', '.join(shown)})"

    def __reduce__(self) -> Any:
        """The constructor's arguments."""
        return type(self), self._given

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Scene) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    def __getitem__(self, bodies: Any) -> Scene:
        if self.rows is None:
            return self
        rows = np.arange(self.rows)[bodies]
        dims = {"rate": 1, "params": 1, "torque": 1, "mass": 0, "force": 1}
        numbers = {name: _of_rows(getattr(self, name), rows, n) for name, n in dims.items()}
        inertia: Any = self.inertia
        if inertia is not None and self.principal.moments.ndim == 2:
            numbers["inertia"] = chosen = inertia[rows]
            if inertia.ndim == 2 and chosen.shape == (3, 3):  # would be one tensor
                numbers["inertia"] = chosen[:, :, None] * np.eye(3)
        return replace(self, **numbers)

    __iter__ = None  # a scene whose bodies share all numbers has no length

    @property
    def _acting(self) -> Any:
        return self.torque if self.rate is None else self.rate

    @cached_property
    def kind(self) -> str:
        """The kind of the scene: "rate", "spherical", "symmetric", "free" or "torqued".

        Moments are equal if they differ by less than 1e-12 of the largest, for all bodies.
        """
        if self.rate is not None:
            return "rate"
        if self.torque is not None:
            return "torqued"
        moments = self.principal.moments
        for kind, is_so in (("spherical", is_spherical), ("symmetric", is_symmetric)):
            # the first bodies tell that of most ensembles
            if is_so(moments[:_FIRST]).all() and is_so(moments).all():
                return kind
        return "free"

    @property
    def is_constant(self) -> bool:
        """Whether the rate is constant along its axes, so that one exponential is exact."""
        return self.rate is not None and self._law.is_constant

    @cached_property
    def principal(self) -> Principal:
        """Principal moments, kg·m², and axes of ``inertia``. ``ValueError`` for a rate scene."""
        if self.inertia is None:
            raise ValueError("inertia: this scene has none; accepted: a scene with inertia")
        body = principal(self.inertia, allow_unphysical=self.allow_unphysical)
        return Principal(*map(_read_only, body))

    def dependence(self, *, sorted_axes: bool = False) -> Dependence:
        """How the torque depends on w."""
        body = self.principal
        turned = body.axes is not None or (sorted_axes and not is_sorted(body.moments))
        return torque_record.dependence(self._law, turned=turned)

    @property
    def terms(self) -> list[tuple[Any, Place]]:
        """The models of rate or torque that are added, and the place of each in the law."""
        return list(zip(models.terms_of(self._acting), self._law.places, strict=True))

    @property
    def parts(self) -> dict[str, slice]:
        """Where the states of each term with a name are in ``run.s`` and ``s0``."""
        return {
            x.term.name: x.states for x in self._law.places if x.term.name and x.term.model.states
        }

    @property
    def switches(self) -> dict[str, int]:
        """Where the sides of the torque's switches are among the states, by their names."""
        return self._law.switches

    @property
    def reads_sign(self) -> bool:
        """Whether the torque depends on the sign of the quaternion."""
        return self._law.reads_sign

    @property
    def reads_position(self) -> bool:
        """Whether the torque depends on the position."""
        return self._law.reads_position

    @cached_property
    def has_potential(self) -> bool:
        """Whether kinetic plus potential energy is conserved."""
        return self.rate is None and torque_record.has_potential(self._law)

    @cached_property
    def functions(self) -> tuple[UserFunction, ...]:
        """The user-defined functions, as a tuple; ``followed`` of each says whether it is followed.

        A followed function becomes part of the compiled loop: it is vectorised and kept in the disk
        cache. One that can't be followed (``reason`` says why), or is too long, is called for each
        body; a rate whose parameters all bodies share is called once for a group of bodies.
        """
        laws = (self._law, self._force)
        return tuple(f for law in laws if law is not None for f in _functions_of(law))

    @property
    def wheels(self) -> list[tuple[Any, slice]]:
        """The models of reaction wheels, each with the part of the states that it has."""
        acting = list(_flattened(self.torque))
        places = [place.states for place in self._law.places]
        pairs = zip(acting, places, strict=True) if len(acting) == len(places) else ()
        return [(model, part) for model, part in pairs if hasattr(model, "momenta")]

    @property
    def moves(self) -> bool:
        """Whether the velocity is propagated."""
        return self.mass is not None

    @property
    def is_coupled(self) -> bool:
        """Whether a velocity or states are stepped with the attitude as one system."""
        return self.moves or self.states > 0

    def carried(self, *, position: bool) -> dict[str, int]:
        """The parts of a state next to the attitude, in their order, with the size of each."""
        sizes = {
            "w": 3 * (self.kind != "rate"), "v": 3 * self.moves, "r": 3 * position,
            "s": self.states,
        }  # fmt: skip
        return {name: n for name, n in sizes.items() if n}

    def packed(
        self, n_bodies: int | None, *, sorted_axes: bool = False, position: bool = False
    ) -> Packed:
        """The structure and the flat parameters of the scene, for a number of bodies.

        ``sorted_axes`` puts the intermediate principal axis second; ``position`` is propagated too.
        """
        kept, key = self.memo.setdefault("packed", {}), (sorted_axes, position)
        packed: Packed | None = kept.get(key)
        if packed is None or n_bodies not in (None, self.rows or n_bodies):
            if self.rows is not None:  # those of many bodies take memory
                kept.clear()
            packed = kept[key] = self._packed(n_bodies, *key)
            packed.params.setflags(write=False)
        return packed

    @cached_property
    def memo(self) -> dict[Any, Any]:
        """Results that are computed once: packed parameters, methods that fit, and plans."""
        return {}

    def _packed(self, n_bodies: int | None, sorted_axes: bool, position: bool) -> Packed:
        packed = (
            self._rate(n_bodies) if self.rate is not None else self._body(n_bodies, sorted_axes)
        )
        if self.mass is None:
            return packed
        from fastatt.scene import forces

        mass = _masses(self.mass)
        model = self.force
        if isinstance(model, (list, tuple, np.ndarray)):
            model = forces.Constant(model)
        elif callable(model):
            model = forces.Custom(model)
        context = {"tables": packed.tables, "states": packed.structure.rotation.law.states}
        context["shown"] = models.shown_in(self.torque)
        force = models.pack(model, forces.Force, n_bodies, **context)
        columns = [packed.params, 1.0 / mass[..., None], mass[..., None], force.params]
        structure = packed.structure._replace(force=force.structure)
        structure = structure._replace(position=position or structure.reads_position)
        return Packed(structure, join(columns, n_bodies, "mass, force"), packed.tables)

    def _rate(self, n_bodies: int | None) -> Packed:
        from fastatt.scene import rates

        model = self.rate
        if callable(model):
            model = rates.Custom(model, self.params, self.states)
        packed = models.pack(model, rates.Rate, n_bodies)
        structure = Structure(PrescribedRate(packed.structure, self.frame == "inertial"))
        return packed._replace(structure=structure)

    def _body(self, n_bodies: int | None, sorted_axes: bool = False) -> Packed:
        body = self.principal
        rows = body.moments.shape[0] if body.moments.ndim == 2 else None
        if rows is not None and n_bodies not in (None, rows):
            raise ValueError(f"inertia: found {rows} bodies; accepted: {row_count(n_bodies, rows)}")
        if sorted_axes:
            body = sort_axes(body)
        model = self.torque
        if callable(model):
            model = torque_record.Custom(model, self.params, states=self.states)
        acting = torque_record.pack(model, n_bodies)
        columns_of_moments = tuple(np.moveaxis(body.moments, -1, 0))
        # the kernel's formula on whole columns
        gyroscopic = np.stack(plain(rigid.gyroscopic_coefficients)(columns_of_moments), axis=-1)
        columns = [0.5 / body.moments, body.moments, gyroscopic]
        if body.axes is not None:
            columns.append(body.axes)
        params = join([*columns, acting.params], n_bodies, "inertia, torque")
        structure = Structure(RigidBody(acting.structure, body.axes is not None))
        return acting._replace(structure=structure, params=params)


def _warn_of_pulses(law: Law) -> None:
    """Warn of functions that compare the time with what they read, where no step ends."""
    for model in law.models:
        function: Any = model.function if isinstance(model, models.UserModel) else None
        if function is None or function.recording is None:
            continue
        first = sum(max(n, 1) for n in SIGNATURES[model.role].before)
        read = range(first, first + sum(max(n, 1) for _, n in function.signature.reads))
        if read and function.recording.compares(range(1), read):
            names = ", ".join(name for name, _ in function.signature.reads)
            rounding.warn(
                f"{model.kind}: found {function.described}, which compares the time with {names}; "
                "no step ends where the result changes, so that such steps are of order 1: let it "
                "read the side of a Switch of the difference, or what a SampledControl holds"
            )


def _flattened(model: Any) -> Iterator[Any]:
    """The terms of sums, or the model itself."""
    if not isinstance(model, models.Sum):
        yield model
        return
    for term in model.values:
        yield from _flattened(term)


def _functions_of(law: Law) -> Iterator[UserFunction]:
    """User-defined functions of a law, and of the controllers in it."""
    for model in law.models:
        for value in model.values:
            if isinstance(value, UserFunction):
                yield value
            elif isinstance(value, Law):
                yield from _functions_of(value)


def _held(value: Any) -> Any:
    """A function, also of a model, as a scene holds it: it is frozen when it is first packed."""
    if isinstance(value, models.Model):
        return value.of(map(_held, value.values))
    if isinstance(value, tuple):
        return tuple(map(_held, value))
    is_given = callable(value) and not isinstance(value, (TimeSeries, UserFunction, type))
    return UserFunction(value) if is_given else value


def _read_only(value: Any) -> Any:
    """Read-only numbers, also those of a model: tuples of numbers, else copies of arrays."""
    if isinstance(value, models.Model):
        return value.of(map(_read_only, value.values))
    if isinstance(value, (list, tuple)) and all(map(np.isscalar, value)):
        return tuple(value)
    if value is None or callable(value):
        return value
    array = np.array(value, order="C")
    array.setflags(write=False)
    return array if array.ndim else array.item()


def _key(value: Any) -> Any:
    """A hashable value that is equal for equal numbers."""
    if isinstance(value, models.Model):
        return (type(value), getattr(value, "names", ()), *map(_key, value.values))
    if isinstance(value, tuple) and any(isinstance(x, str) for x in value):
        return value
    if isinstance(value, (tuple, np.ndarray)):
        return np.shape(value), (np.asarray(value, np.float64) + 0.0).tobytes()  # −0 equals 0
    return value


def _of_rows(value: Any, rows: Any, dims: int = 1) -> Any:
    """Numbers, also those of a model, of some bodies; numbers of one body have ``dims`` axes."""
    if isinstance(value, models.Sum):
        return value.of(_of_rows(term, rows) for term in value.terms)
    if isinstance(value, models.Model):
        numbers = {
            name: _of_rows(getattr(value, name), rows, len(field.shape))
            for name, field in value.fields.items()
        }
        # the model of a controller within another
        inner = {x.name: getattr(value, x.name) for x in fields(value)}  # type: ignore[arg-type]
        numbers |= {k: _of_rows(x, rows) for k, x in inner.items() if isinstance(x, models.Model)}
        return replace(value, **numbers)  # type: ignore[type-var]
    if isinstance(value, TimeSeries):
        return value[rows] if value.layout.by_row else value
    if value is None or callable(value) or np.ndim(value) <= dims:  # shared
        return value
    return np.asarray(value)[rows]


def as_scene(scene: object) -> Scene:
    """The scene; raises ``TypeError`` for anything else."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: found {checks.brief(scene)}; accepted: a fastatt.Scene")
    return scene


def _breakpoints(value: Any) -> tuple[float, ...]:
    times = () if value is None else value
    accepted = (
        "times (B,) of all bodies, s; for times of each body give np.unique(times), or let the "
        "torque read the side of a torques.Switch of t - p[0]"
    )
    instants = checks.array("breakpoints", times, accepted, [(), (0,), (-1,)])
    return tuple(np.unique(instants.astype(np.float64)).tolist())


def _masses(value: ArrayLike) -> NDArray[np.float64]:
    mass = numbers("mass", value, "a number or (N,), kg")
    with np.errstate(divide="ignore", over="ignore"):
        checks.refuse("mass", mass, (mass <= 0.0) | np.isinf(1.0 / mass), "above 0, kg")
    return mass
