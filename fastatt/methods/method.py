"""What a method says of itself, and the step that every driver calls."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from numba import types

from fastatt._jit import hook


@dataclass(frozen=True)
class Method:
    """One method's record: everything that tests, benches, tables and advice are made from.

    ``limits`` is the largest |w|h (rad a step) for which the step is trustworthy, by
    representation; beyond, the body's status says so, but where the rate is constant and the method
    ``exact_for_constant``. ``rate_calls`` is the number of rate
    evaluations a step, ``exponentials`` that of exponentials.
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

    def order_of(self, scene: str) -> int:
        """Order on one kind of scene, where it differs from ``order``."""
        return self.orders.get(scene, self.order)

    def limit(self, representation: str) -> float:
        """Largest |w|h, rad."""
        return self.limits.get(representation, math.inf)


def step(method: Any, rep: Any, model: Any, t: Any, h: Any, x: Any, p: Any) -> Any:
    """(x(t + h), z): one step, and z the squared angle (rad²) that it turns at a time.

    ``method``, ``rep`` and ``model`` are tags; x and h share a type; p are flat parameters.
    """
    raise NotImplementedError(method)


_steps: dict[type, Callable[..., Any]] = {}


def register(cls: type, function: Callable[..., Any]) -> None:
    """Make ``function`` (a step kernel) the step of the tag class ``cls``."""
    _steps[cls] = function


@hook(step)
def _step(
    method: types.BaseNamedTuple,
    rep: types.Type,
    model: types.Type,
    t: types.Type,
    h: types.Type,
    x: types.Type,
    p: types.Type,
) -> Any:
    return _steps[method.instance_class]


def lie_method(
    tag: Any,
    function: Callable[..., Any],
    *,
    name: str,
    order: int,
    rate_calls: int,
    exponentials: int,
    summary: str,
    source: str,
    exact_for_constant: bool = True,
) -> Method:
    """Record of a method whose state only ever turns: it stays on the group by construction."""
    register(type(tag), function)
    representations = ("quat", "dcm", "dcm_rows")
    return Method(
        tag=tag,
        name=name,
        order=order,
        scenes=("rate",),
        representations=representations,
        conserves=("norm",),
        rate_calls=rate_calls,
        exponentials=exponentials,
        # a Magnus series converges below π; an exponential is fine at any angle
        limits=dict.fromkeys((*representations, "direction"), math.pi),
        summary=summary,
        source=source,
        exact_for_constant=exact_for_constant,
    )
