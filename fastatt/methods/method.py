"""What a method says of itself, and the step that every driver calls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from numba import types

from fastatt._jit import helper, hook
from fastatt.kernels.vec3 import dot, scale
from fastatt.motion import Body, Moving
from fastatt.rates import is_constant, rate
from fastatt.representations import bears_witness, has_poles, turn
from fastatt.torques import RATE

#: key of the limits of a rigid body
BODY = "body"
FREE = ("spherical", "symmetric", "free")
BODIES = (*FREE, "torqued")


@dataclass(frozen=True)
class Method:
    """One method's record: everything that tests, benches, tables and advice are made from.

    ``limits`` is the largest |w|h (rad a step) for which a step is trustworthy, by representation:
    its error is then at most 0.1 rad a rad turned, for rates that change no faster than the body
    turns; of ``dmv`` and ``srkn`` the largest |m|h/I_min, of ``strang2`` and its compositions the
    largest |m|h √(|1/I1 − 1/I2| |1/I3 − 1/I2|), I2 the intermediate moment. That of a rigid body
    stands under "body", those of samples under "rates" and "increments". Beyond, the body's status
    says so, but where the rate is constant and the method ``exact_for_constant``.
    ``damping_limit`` is the largest c h/I of linear damping, whose factor is then right to 0.1.
    ``rate_calls`` is the number of evaluations of the rate or the torque a step, ``exponentials``
    that of exponentials.
    """

    name: str
    order: int
    scenes: tuple[str, ...]
    representations: tuple[str, ...]
    conserves: tuple[str, ...]
    rate_calls: int
    exponentials: int
    limits: Mapping[str, float]
    source: str
    tag: Any = None
    summary: str = ""
    exact_for_constant: bool = False
    orders: Mapping[str, int] = field(default_factory=dict)
    #: (h, k, c) of each stage of a step: its share of free motion and of the other flow, and at
    #: which share of the step the other flow acts; none for a method of one stage
    stages: tuple[tuple[float, float, float], ...] = ()
    #: needs the principal axes in ascending order
    sorted_axes: bool = False
    #: how a torque may depend on w: ``torques.POSITION``, ``DAMPED`` or ``RATE``
    takes: int = RATE
    #: what ``limits`` hold for: "turn", "momentum" or "asymmetry"
    measure: str = "turn"
    #: largest c h/I, of linear damping
    damping_limit: float = math.inf
    #: whether it can carry what rounding loses
    compensates: bool = False

    @property
    def translates(self) -> bool:
        """Whether velocity and position can be carried along: what is stepped is the state."""
        return type(self.tag) in _kernels and not is_staged(type(self.tag))

    def order_of(self, scene: str) -> int:
        """Order on one kind of scene, where it differs from ``order``."""
        return self.orders.get(scene, self.order)

    def limit(self, representation: str, *, body: bool = False) -> float:
        """Largest |w|h, rad."""
        own = self.limits.get(representation, math.inf)
        return min(own, self.limits.get(BODY, math.inf)) if body else own


class Kernels(NamedTuple):
    """What a driver compiles of a method, chosen by its tag and by the kind of model.

    ``rate`` and ``body`` are steps ``f(method, rep, model, t, h, x, p)``, ``constant`` is that of a
    rate which never changes, where it is another one. ``at_times`` says that a look at some steps
    of ``rate`` will do, since its z is never infinite; ``exponentials`` that it only turns the
    state. ``stage`` is one stage of a splitting, ``f(method, rep, model, t, h, k, x, p, e)``.
    ``prepare(method, rep, model, h, x, p)`` gives the ``extras`` numbers e that a run needs of each
    body, from its initial state.
    ``enter`` and ``leave`` change between the state and the one that is stepped:
    ``f(method, rep, model, t, s, k, x, p, e)`` at time t, s after the start.
    """

    rate: Callable[..., Any] | None = None
    constant: Callable[..., Any] | None = None
    body: Callable[..., Any] | None = None
    stage: Callable[..., Any] | None = None
    extras: int = 0
    prepare: Callable[..., Any] | None = None
    enter: Callable[..., Any] | None = None
    leave: Callable[..., Any] | None = None
    at_times: bool = False
    exponentials: bool = False


def step(method: Any, rep: Any, model: Any, t: Any, h: Any, k: Any, x: Any, p: Any, e: Any) -> Any:
    """(x(t + h), z): one step, and z the squared angle (rad²) that it turns at a time.

    ``method``, ``rep`` and ``model`` are tags; x and h share a type; p are flat parameters. Of a
    splitting it is a stage: h s of free motion, then k s of the other flow. z is infinite where an
    iteration did not converge.
    """
    raise NotImplementedError(method)


def prepare(method: Any, rep: Any, model: Any, h: Any, x: Any, p: Any) -> Any:
    """The numbers of a body that a run with step h needs besides its parameters."""
    raise NotImplementedError(method)


def enter(method: Any, rep: Any, model: Any, t: Any, s: Any, k: Any, x: Any, p: Any, e: Any) -> Any:
    """The state as the method steps it."""
    raise NotImplementedError(method)


def leave(method: Any, rep: Any, model: Any, t: Any, s: Any, k: Any, x: Any, p: Any, e: Any) -> Any:
    """The state from what the method steps."""
    raise NotImplementedError(method)


_kernels: dict[type, Kernels] = {}


def register(cls: type, kernels: Kernels) -> None:
    """Make ``kernels`` those of the tag class ``cls``."""
    _kernels[cls] = kernels


@helper
def larger(a, b):
    """The larger of two squared turns."""
    return a if a > b else b


@helper
def one_exponential(method, rep, model, t, h, x, p):
    """The exponential of the rate at the middle of the step."""
    F = type(h)
    u = scale(h, rate(model, t + F(0.5) * h, p, h))
    return turn(rep, x, u), dot(u, u)


def extras(method: type) -> int:
    """How many numbers ``prepare`` gives."""
    return _kernels[method].extras


def seen_at_times(method: type, rep: types.BaseNamedTuple, model: types.BaseNamedTuple) -> bool:
    """Whether a look at some steps will do.

    Not near a pole, which is passed in one; of exponentials where the state's length bears them
    witness.
    """
    found = _kernels[method]
    turning = model.types[0] if model.instance_class is Moving else model
    if turning.instance_class is Body or not found.at_times:
        return False
    kind = rep.instance_class
    return bears_witness(kind) if found.exponentials else not has_poles(kind)


def is_staged(method: type) -> bool:
    """Whether what is stepped is not the state itself."""
    return _kernels[method].stage is not None


@hook(step)
def _step(
    method: types.BaseNamedTuple,
    rep: types.Type,
    model: types.BaseNamedTuple,
    t: types.Type,
    h: types.Type,
    k: types.Type,
    x: types.Type,
    p: types.Type,
    e: types.Type,
) -> Any:
    found = _kernels[method.instance_class]
    if found.stage is not None:
        return found.stage
    chosen = found.body if model.instance_class is Body else found.rate
    if found.constant is not None and is_constant(model):
        chosen = found.constant
    function: Any = helper(chosen)
    return lambda method, rep, model, t, h, k, x, p, e: function(method, rep, model, t, h, x, p)


@hook(prepare)
def _prepare(
    method: types.BaseNamedTuple,
    rep: types.Type,
    model: types.Type,
    h: types.Type,
    x: types.Type,
    p: types.Type,
) -> Any:
    found = _kernels[method.instance_class].prepare
    return found or (lambda method, rep, model, h, x, p: ())


def _unchanged(method, rep, model, t, s, k, x, p, e):
    return x


@hook(enter)
def _enter(
    method: types.BaseNamedTuple,
    rep: types.Type,
    model: types.Type,
    t: types.Type,
    s: types.Type,
    k: types.Type,
    x: types.Type,
    p: types.Type,
    e: types.Type,
) -> Any:
    return _kernels[method.instance_class].enter or _unchanged


@hook(leave)
def _leave(
    method: types.BaseNamedTuple,
    rep: types.Type,
    model: types.Type,
    t: types.Type,
    s: types.Type,
    k: types.Type,
    x: types.Type,
    p: types.Type,
    e: types.Type,
) -> Any:
    return _kernels[method.instance_class].leave or _unchanged


def lie_method(
    tag: Any,
    function: Callable[..., Any],
    *,
    body: Callable[..., Any] | None = None,
    name: str,
    order: int,
    rate_calls: int,
    exponentials: int,
    summary: str,
    source: str,
    limit: float = math.pi,
    body_limit: float = math.inf,
    damping_limit: float = math.inf,
    exact_for_constant: bool = True,
) -> Method:
    """Record of a method whose state only ever turns: it stays on the group by construction."""
    # of a constant rate every such method is this one
    constant = one_exponential if exact_for_constant else None
    kernels = Kernels(rate=function, constant=constant, body=body, at_times=True, exponentials=True)
    register(type(tag), kernels)
    representations = ("quat", "dcm", "dcm_rows")
    return Method(
        tag=tag,
        name=name,
        order=order,
        scenes=("rate",) if body is None else ("rate", *BODIES),
        representations=representations,
        conserves=("norm",),
        rate_calls=rate_calls,
        exponentials=exponentials,
        limits={**dict.fromkeys((*representations, "direction"), limit), BODY: body_limit},
        summary=summary,
        source=source,
        exact_for_constant=exact_for_constant,
        damping_limit=damping_limit,
        compensates=True,
    )
