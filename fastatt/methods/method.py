"""What a method says of itself, and its steps as formulas on recorded numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from fastatt.attitudes import ATTITUDES, QUATERNION, Attitude
from fastatt.scene.torque_record import Dependence

#: key of the limits of a rigid body
BODY = "body"
#: of a body under a torque, where that is another one
TORQUED = "torqued"
FREE = ("spherical", "symmetric", "free")
BODIES = (*FREE, "torqued")


@dataclass(frozen=True, eq=False)
class Steps:
    """The formulas of a method: plain functions on recorded numbers.

    ``rate(motion, t, h, x)`` and ``body(motion, t, h, x)`` give (x(t + h), z) of a
    ``scene.equations.Turning`` and a ``Body``, z the squared angle (rad²) of the step's largest
    rotation, infinite where an iteration did not converge. ``constant`` is ``rate`` of a rate that
    never changes, where that is another one.

    A splitting has ``stage(motion, t, h, k, x, e)`` instead: h s of free motion, then k s of the
    other flow. ``prepare(motion, h, x)`` gives the numbers e that a run with step h needs of a body
    in addition to its parameters, from its initial state; ``enter`` and ``leave`` change between
    the state and the one that is stepped: ``f(motion, t, s, k, x, e)``, s after the start t.
    """

    rate: Callable[..., Any] | None = None
    constant: Callable[..., Any] | None = None
    body: Callable[..., Any] | None = None
    stage: Callable[..., Any] | None = None
    prepare: Callable[..., Any] | None = None
    enter: Callable[..., Any] | None = None
    leave: Callable[..., Any] | None = None


@dataclass(frozen=True, eq=False)
class Method:
    """One method's record: everything that tests, benches, tables and advice are made from.

    ``limits`` is the largest |w|h (rad a step) for which a step is trustworthy, by the ``family``
    of a representation:
    its error is then at most 0.1 rad a rad turned, for rates that change no faster than the body
    turns; of ``dmv`` the largest |m|h/I_min, of ``strang2`` and its compositions the
    largest |m|h √(|1/I1 − 1/I2| |1/I3 − 1/I2|), I2 the intermediate moment, and under a torque, as
    "torqued", the largest |w|h too. That of a rigid body stands under "body", those of samples
    under "rates" and "increments". Beyond, the body's status says so, but where the rate is
    constant and the method ``exact_for_constant``.
    ``damping_limit`` is the largest c h/I of linear damping, whose factor is then right to 0.1, of
    splittings the angle to 0.1 |w|h.
    ``rate_calls`` is the number of evaluations of the rate or the torque a step, ``exponentials``
    that of exponentials.
    """

    name: str
    order: int
    scenes: tuple[str, ...]
    conserves: tuple[str, ...]
    rate_calls: int
    exponentials: int
    limits: Mapping[str, float]
    source: str
    summary: str = ""
    #: formulas of a representation that it calls: one that has them fits
    uses: tuple[str, ...] = ("start",)
    #: None of the closed form and of methods for samples
    steps: Steps | None = field(default=None, repr=False)
    #: of a method for samples: what it makes of a window of them
    window: Any = field(default=None, repr=False)
    exact_for_constant: bool = False
    orders: Mapping[str, int] = field(default_factory=dict)
    #: (h, k, c) of each stage of a step: its share of free motion and of the other flow, and at
    #: which share of the step the other flow acts; none for a method of one stage
    stages: tuple[tuple[float, float, float], ...] = field(default=(), repr=False)
    #: kinds of scenes on which a step back undoes a step, to rounding
    reversible: tuple[str, ...] = ()
    #: the step of a conservative system is a symplectic map
    symplectic: bool = False
    #: needs the principal axes in ascending order
    sorted_axes: bool = False
    #: how a torque may depend on w
    takes: Dependence = Dependence.RATE
    #: what ``limits`` hold for: "turn", "momentum" or "asymmetry"
    measure: str = "turn"
    #: largest c h/I, of linear damping
    damping_limit: float = math.inf
    #: whether it can carry what rounding loses
    compensates: bool = False
    #: whether velocity, position and states can be part of what it steps, as a scene with mass or
    #: states needs; its step of a body is then that of a rate with states too
    couples: bool = False

    def __reduce_ex__(self, protocol: Any) -> Any:
        """The library's own by their names: they are made of functions within functions."""
        listed = _listed(self.name) is self
        return (_listed, (self.name,)) if listed else super().__reduce_ex__(protocol)

    @property
    def is_stepped(self) -> bool:
        """Whether it takes steps of a scene: neither the closed form nor a method for samples."""
        return self.steps is not None

    @property
    def is_exact(self) -> bool:
        """Whether it is a closed form: no steps, any time in one evaluation."""
        return self.steps is None and self.window is None

    @property
    def reduces(self) -> bool:
        """Whether a reducer can see its steps: what is stepped is the state."""
        return self.steps is not None and self.steps.stage is None

    def order_of(self, scene: str) -> int:
        """Order on one kind of scene, where it differs from ``order``."""
        return self.orders.get(scene, self.order)

    @property
    def representations(self) -> tuple[str, ...]:
        """Names of the library's representations that fit."""
        return tuple(name for name, attitude in ATTITUDES.items() if self.stores(attitude))

    def stores(self, representation: str | Attitude) -> bool:
        """Whether a representation has the formulas that it calls; samples give quaternions."""
        if isinstance(representation, str):
            representation = ATTITUDES[representation]
        if self.window is not None:
            return representation is QUATERNION
        return all(getattr(representation, name) is not None for name in self.uses)

    def limit(
        self, representation: str | Attitude, *, body: bool = False, torqued: bool = False
    ) -> float:
        """Largest |w|h, rad, of a representation; the least that there is if it has no family."""
        if torqued and TORQUED in self.limits:
            return self.limits[TORQUED]
        key = representation if isinstance(representation, str) else representation.family
        key = ATTITUDES[key].family if key in ATTITUDES else key
        least = min((x for name, x in self.limits.items() if name != TORQUED), default=math.inf)
        own = self.limits.get(key, least)
        return min(own, self.limits.get(BODY, math.inf)) if body else own


def _listed(name: str) -> Method | None:
    """The library's method of a name."""
    from fastatt.methods import METHODS

    return METHODS.get(name)
